//! Time of a step's messages: two models of the mesh.
//!
//! Input: a program's routes ([`MessageRoutes`], computed once) and the activity of a step. Output:
//! the time of cores and mesh together, (11) and (17) of `docs/energy.md`. `analytic` adds the
//! longest route and the wait at the busiest link to the slowest core; it is about as expensive as
//! counting. `queued` simulates every message through finite buffers ([`queue`]). Constants with
//! overlapping parts ([`StepForm::Greatest`]) use only the busiest link, (21), in both models.

pub mod queue;
pub mod routes;

use crate::constants::CostTable;
use crate::model::{StepTime, core_time, route_time, slowest_learning, times};
use nsim_ir::activity::StepActivity;
use nsim_ir::base::names::named_variants;
use nsim_ir::base::units::Picoseconds;
use nsim_ir::hardware::constants::{StepForm, TurnRule};

use self::queue::Queue;

/// Words that one x86 core handles in a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Words {
    /// Number of words.
    pub count: u64,
    /// Timesteps of the sample.
    pub steps: u32,
}

impl Words {
    /// No words.
    pub const NONE: Words = Words { count: 0, steps: 1 };

    /// A step's share of their time, where each word takes `each`.
    #[must_use]
    pub fn time(self, each: Picoseconds) -> Picoseconds {
        let whole = u128::from(each.0) * u128::from(self.count) / u128::from(self.steps.max(1));
        Picoseconds(u64::try_from(whole).unwrap_or(u64::MAX))
    }
}
pub use self::queue::QueueMemory;
pub use self::routes::MessageRoutes;

/// A model of the mesh.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Transport {
    /// The longest route, and the wait at the busiest link.
    Analytic,
    /// Every message through finite buffers.
    #[default]
    Queued,
}

named_variants!(Transport { Analytic = "analytic", Queued = "queued" });

/// Conditions of the time of a step, besides its counts and constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// The model of the mesh.
    pub transport: Transport,
    /// Tiles in the barrier of the fullest chip.
    pub tiles_used: u64,
    /// Cores in the barrier of the fullest chip.
    pub chip_cores: u64,
    /// Hops between chips of the barrier.
    pub chip_hops: u64,
    /// Whether x86 cores take turns, in the steps of [`TurnRule`].
    pub turn: bool,
    /// Streams of input spikes that are injected into one chip; 0: spikes take no time.
    pub streams: u64,
    /// Copies whose spikes a step counts.
    pub copies: u64,
    /// Words that an x86 core sets to zero after a sample.
    pub reset: Words,
    /// Words besides spikes that the host sends in a sample.
    pub sent: Words,
}

impl Timing {
    /// Time of injecting a stream at the chip with most copies, spike by spike.
    fn injection(&self, spikes_in: u64, table: &CostTable) -> Picoseconds {
        let spikes = (u128::from(spikes_in) * u128::from(self.streams)).div_ceil(u128::from(self.copies.max(1)));
        let spikes = times(&[(table.injection_time, u64::try_from(spikes).unwrap_or(u64::MAX))]);
        let sent = if self.streams > 0 { self.sent.time(table.injection_time) } else { Picoseconds(0) };
        Picoseconds(spikes.0.saturating_add(sent.0))
    }

    /// Equation (10): the barrier over the parts of a chip, then between chips.
    fn barrier(&self, table: &CostTable) -> Picoseconds {
        let between = times(&[(table.chip_hop_time, self.chip_hops)]);
        Picoseconds(table.barrier(self.tiles_used, self.chip_cores).0.saturating_add(between.0))
    }

    /// Returns the parts of a step's time for host and barrier; cores and messages have 0.
    pub fn host_and_barrier(&self, spikes_in: u64, table: &CostTable) -> StepTime {
        let has_turn = self.turn && (table.turn == TurnRule::EachStep || spikes_in + self.sent.count > 0);
        StepTime {
            injection: self.injection(spikes_in, table),
            turn: if has_turn { table.turn_time } else { Picoseconds(0) },
            barrier: self.barrier(table),
            reset: self.reset.time(table.reset_word_time),
            ..StepTime::default()
        }
    }
}

fn slowest_core(step: &StepActivity, table: &CostTable) -> Picoseconds {
    step.cores.iter().map(|core| core_time(core, table)).max().unwrap_or_default()
}

/// Time in which the busiest links pass their messages, except for `free` of them.
fn passing_time(busiest: [u32; 2], table: &CostTable, free: u32) -> u64 {
    let [link, between] = busiest.map(|load| u64::from(load.saturating_sub(free)));
    table.link_time.0.saturating_mul(link).max(table.link_chip_time.0.saturating_mul(between))
}

impl MessageRoutes {
    /// Returns the times of a step under each preset, (11), (17) or (21).
    pub fn step_times(
        &self,
        step: &StepActivity,
        tables: &[CostTable],
        timing: Timing,
        memory: &mut QueueMemory,
    ) -> Vec<StepTime> {
        let sent = step.messages_from_inputs > 0 || step.hops.local + step.hops.total_links() > 0;
        let crossed = self.crossed_links_in(step);
        let spikes_in = self.spikes_in(step);
        let mut busiest = [0; 2];
        if timing.transport == Transport::Analytic || tables.iter().any(|table| table.step == StepForm::Greatest) {
            for loads in self.regions.iter().map(|region| region.busiest_links(self, step)) {
                busiest = std::array::from_fn(|of| busiest[of].max(loads[of]));
            }
        }
        let times = tables.iter().map(|table| {
            let fixed = timing.host_and_barrier(spikes_in, table);
            let (slowest_core, transport) = match timing.transport {
                // (21): messages pass the busiest link while cores work.
                _ if table.step == StepForm::Greatest => {
                    let cores = slowest_core(step, table);
                    (cores, Picoseconds(passing_time(busiest, table, 0).saturating_sub(cores.0)))
                }
                Transport::Analytic => {
                    let route = if sent { route_time(crossed.longest, table) } else { Picoseconds(0) };
                    // The first message finds its link free.
                    let passing = passing_time(busiest, table, 1);
                    (slowest_core(step, table), Picoseconds(route.0.saturating_add(passing)))
                }
                Transport::Queued => self.simulated(step, table, fixed.injection, memory),
            };
            StepTime { slowest_core, transport, ..fixed }
        });
        times.collect()
    }

    /// Returns the busiest core's own time and the time that the mesh adds, over all regions.
    fn simulated(
        &self,
        step: &StepActivity,
        table: &CostTable,
        injection: Picoseconds,
        memory: &mut QueueMemory,
    ) -> (Picoseconds, Picoseconds) {
        let most = self.regions.iter().map(|region| region.most_spikes(self, step)).max().unwrap_or(0).max(1);
        let (mut alone, mut took) = (0, 0);
        for region in &self.regions {
            let (cores, added) = Queue::new(self, region, table, memory).run(step, injection, most, true);
            (alone, took) = (alone.max(cores.0), took.max(cores.0 + added.0));
        }
        // Cores learn once the step's messages are handled.
        let learning = slowest_learning(step, table).0;
        (Picoseconds(alone.saturating_add(learning)), Picoseconds(took - alone))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use std::sync::OnceLock;

    use super::routes::{KindOfGroup, Message, Region};
    use super::*;
    use crate::constants::tests::{preset, table};
    use nsim_ir::activity::CoreCounts;
    use nsim_ir::base::csr::Csr;
    use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId};
    use nsim_ir::base::rng;
    use nsim_ir::groups::Kind;
    use nsim_ir::placement::Route;

    /// Timing with a barrier of one tile, and one copy.
    pub(crate) fn timing(transport: Transport) -> Timing {
        let (reset, sent) = (Words::NONE, Words::NONE);
        Timing { transport, tiles_used: 1, chip_cores: 1, chip_hops: 0, turn: true, streams: 1, copies: 1, reset, sent }
    }

    /// The routes of a program of two cores without messages.
    pub(crate) fn no_routes() -> MessageRoutes {
        routes(&[(0, 0), (0, 0)], &[], &[])
    }

    /// MessageRoutes on one chip of 8 by 4 tiles, with 10 compartments a core; lists of (receiving
    /// core, dense synapses).
    pub(super) fn routes(tiles: &[(u32, u32)], inputs: &[&[(u32, u32)]], spikes: &[&[(u32, u32)]]) -> MessageRoutes {
        let lists = |from: &[&[(u32, u32)]]| {
            let mut lists = Csr::default();
            for list in from {
                lists.push(list.iter().map(|&(core, events_dense)| Message {
                    core: CoreId(core),
                    events_dense,
                    events_sparse: 0,
                }));
            }
            lists
        };
        let kind = Kind {
            cores: 0..tiles.len() as u32,
            channels: 0..inputs.len() as u32,
            compartments: 0..spikes.len() as u32,
            copies: 1,
        };
        MessageRoutes {
            kinds: vec![KindOfGroup { kind, groups: 1 }],
            regions: vec![
                Region {
                    columns: 8,
                    rows: 4,
                    chip_width: 8,
                    chip_height: 4,
                    chips_x: 1,
                    tiles: tiles.iter().copied().chain([(0, 0)]).collect(),
                    cores: tiles.len(),
                    groups: vec![(0, 0)],
                    entries: Vec::new(),
                    between: Vec::new(),
                }
                .with_entries(),
            ],
            inputs: lists(inputs),
            spikes: lists(spikes),
            seats: (0..spikes.len() as u32).map(|i| (CoreId(i / 10), i % 10, 10)).collect(),
            crossed: Vec::new(),
            input_times: OnceLock::new(),
        }
    }

    #[test]
    fn the_busiest_links_are_those_of_messages_followed_link_by_link() {
        let draw = |below: u64, k: u64| rng::below(below, 77, k, 0) as u32;
        for seed in 0..20 {
            let tiles: Vec<(u32, u32)> =
                (0..9).map(|i| (draw(8, 100 * seed + i), draw(4, 100 * seed + 50 + i))).collect();
            let list = |from: u64| -> Vec<(u32, u32)> {
                (0..4).map(|k| (draw(9, 1_000 + 100 * seed + 10 * from + k), 1)).collect()
            };
            let lists: Vec<Vec<(u32, u32)>> = (0..90).map(list).collect();
            let spikes: Vec<&[(u32, u32)]> = lists.iter().map(Vec::as_slice).collect();
            // Chips of 4 by 2 tiles; only the first chip has a port.
            let mut routes = routes(&tiles, &[], &spikes);
            (routes.regions[0].chip_width, routes.regions[0].chip_height) = (4, 2);
            routes.regions[0].between = routes.regions[0].between_chips();
            let region = &routes.regions[0];
            let fired: Vec<u32> = (0..90).filter(|&i| draw(3, 7_000 + 100 * seed + i) == 0).map(|i| i as u32).collect();
            let step = step(9, &[], &fired);
            let (mut load, mut busiest) = (vec![0u32; region.links()], [0; 2]);
            region.each_message(&routes, &step, |sender, to, _| {
                region.path(sender, to).into_iter().flatten().for_each(|link| {
                    load[link] += 1;
                    let most: &mut u32 = &mut busiest[usize::from(region.between[link])];
                    *most = (*most).max(load[link]);
                });
            });
            assert!(busiest[0] > 0 && busiest[1] > 0, "{busiest:?}");
            assert_eq!(region.busiest_links(&routes, &step), busiest, "seed {seed}");
        }
    }

    /// A step of cores that visit 10 compartments each, in which these fired.
    pub(super) fn step(cores: usize, channels: &[u32], fired: &[u32]) -> StepActivity {
        let mut step = StepActivity::new(cores);
        for core in step.cores.iter_mut() {
            *core = CoreCounts { visited: 10, ..Default::default() };
        }
        step.channels = channels.iter().map(|&c| ChannelId(c)).collect();
        step.fired = fired.iter().map(|&c| CompartmentId(c)).collect();
        step
    }

    fn queued(routes: &MessageRoutes, step: &StepActivity, table: &CostTable) -> u64 {
        let mut memory = QueueMemory::default();
        let mut time = || routes.simulated(step, table, Picoseconds(0), &mut memory);
        let (alone, added) = time();
        assert_eq!(time(), (alone, added), "the memory is as before");
        alone.0 + added.0
    }

    #[test]
    fn a_lone_message_is_sent_crosses_and_is_handled() {
        let sana = table("sanafe-calibrated");
        let mut spikes: Vec<&[(u32, u32)]> = vec![&[]; 20];
        spikes[3] = &[(1, 7)];
        let routes = routes(&[(0, 0), (2, 1)], &[], &spikes);
        let step = step(2, &[], &[3]);
        // Four visits, the spike, the axon; two links east, one south; an axon, seven synapses.
        let (sent, way, handled) = (4 * 6_000 + 30_000 + 5_100, 2 * 4_100 + 6_500, 16_000 + 7 * 3_800);
        assert_eq!(queued(&routes, &step, &sana), sent + way + handled);
        // Six more visits follow while it is in flight.
        assert!(6 * 6_000 < way + handled);
    }

    #[test]
    fn a_silent_step_takes_the_visits_of_the_slowest_core() {
        let sana = table("sanafe-calibrated");
        let routes = routes(&[(0, 0), (2, 1)], &[], &[&[] as &[_]; 20]);
        let mut step = step(2, &[], &[]);
        step.cores.as_mut_slice()[1].active = 5;
        assert_eq!(queued(&routes, &step, &sana), 10 * 6_000 + 5 * 3_700);
        step.fired = vec![CompartmentId(0)];
        assert_eq!(queued(&routes, &step, &sana), 10 * 6_000 + 30_000);
    }

    #[test]
    fn a_link_passes_one_message_after_the_other() {
        let mut constants = preset("sanafe-calibrated");
        constants.link_time.value = 1_000.0.into();
        let slow = CostTable::new(&constants).unwrap();
        // Twelve messages to twelve cores over one link.
        let tiles: Vec<(u32, u32)> = (0..12).map(|_| (1, 0)).collect();
        let lists: Vec<[(u32, u32); 1]> = (0..12).map(|core| [(core, 0)]).collect();
        let lists: Vec<&[(u32, u32)]> = lists.iter().map(<[_; 1]>::as_slice).collect();
        let routes = routes(&tiles, &lists, &[]);
        let mut step = step(12, &(0..12).collect::<Vec<_>>(), &[]);
        assert_eq!(queued(&routes, &step, &slow), 11 * 1_000_000 + 4_100 + 16_000);
        step.messages_from_inputs = 12;
        step.add_routes(Route { east_west: 1, north_south: 0, chip: 0 }, 12);
        let memory = &mut QueueMemory::default();
        let mut overlapping = slow.clone();
        overlapping.step = StepForm::Greatest;
        let time = routes.step_times(&step, &[slow, overlapping], timing(Transport::Analytic), memory);
        assert_eq!(time[0].transport, Picoseconds(4_100 + 11 * 1_000_000));
        // Ten visits in parallel; the link takes longer.
        assert_eq!((time[1].slowest_core, time[1].transport), (Picoseconds(60_000), Picoseconds(12_000_000 - 60_000)));
    }

    #[test]
    fn a_full_way_holds_its_sender_up() {
        // One core sends to a slow receiver first, then to one that takes longest of all.
        let mut spikes: Vec<&[(u32, u32)]> = vec![&[(1, 200)]; 10];
        spikes[9] = &[(2, 5_000)];
        spikes.extend([&[] as &[(u32, u32)]; 20]);
        let routes = routes(&[(0, 0), (1, 0), (0, 1)], &[], &spikes);
        let with = |buffer: f64| {
            let mut constants = preset("sanafe-calibrated");
            constants.link_buffer.value = buffer.into();
            queued(&routes, &step(3, &[], &(0..10).collect::<Vec<_>>()), &CostTable::new(&constants).unwrap())
        };
        let mut last = u64::MAX;
        for buffer in [0.0, 1.0, 2.0, 4.0, 16.0, 1000.0] {
            let time = with(buffer);
            assert!(time <= last, "buffer {buffer}: {time} after {last}");
            last = time;
        }
        assert!(with(0.0) > with(1000.0));
    }

    #[test]
    fn inputs_are_handled_while_others_are_injected() {
        let sana = table("sanafe-calibrated");
        let list: Vec<&[(u32, u32)]> = vec![&[(0, 50)]; 12];
        let routes = routes(&[(1, 0)], &list, &[&[] as &[_]; 10]);
        let step = step(1, &(0..12).collect::<Vec<_>>(), &[]);
        let each = 16_000 + 50 * 3_800;
        let mut memory = QueueMemory::default();
        let mut time = |injection| {
            let (alone, added) = routes.simulated(&step, &sana, Picoseconds(injection), &mut memory);
            alone.0 + added.0
        };
        // The first arrives over one link, and the receiver handles all sequentially.
        assert_eq!(time(0), 4_100 + 12 * each);
        // The receiver is slower than the injection: it began with the first of twelve spikes.
        assert_eq!(time(12 * 1_000), 1_000 + 4_100 + 12 * each - 12 * 1_000);
        // It waits for each spike: only the last one is left when the injection ends.
        assert_eq!(time(12 * 1_000_000), 4_100 + each);
    }
}
