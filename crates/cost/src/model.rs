//! Energy and time of counts: equations (1) to (9) of `docs/energy.md`, and (21) for Loihi
//! 2; [`crate::transport`] has (10) and (11).
//!
//! Energy is linear in the counts, so the energy of a run is the exact sum over its steps. Time is
//! not linear (a step lasts as long as its slowest core) and needs the counts of each step.

use std::ops::Range;

use crate::constants::CostTable;
use nsim_ir::activity::{Activity, CoreCounts, HopCounts, StepActivity};
use nsim_ir::base::units::{Femtojoules, Picoseconds};
use nsim_ir::hardware::constants::StepForm;
use nsim_ir::microcode::COMPARTMENT_INSTRUCTIONS;
use nsim_ir::placement::Route;

/// Dynamic energy of the neuron cores and their mesh, by part.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Breakdown {
    /// (1) Synaptic events.
    pub synapse: Femtojoules,
    /// (2) Dendritic accumulators.
    pub dendrite: Femtojoules,
    /// (3) Compartments, visited and updated.
    pub compartment: Femtojoules,
    /// (4) Spikes.
    pub spike: Femtojoules,
    /// (5) Messages sent by cores.
    pub axon_out: Femtojoules,
    /// (6) Messages received, messages of inputs included.
    pub axon_in: Femtojoules,
    /// (7) Hops of messages.
    pub hop: Femtojoules,
    /// (8) Updates of plastic synapses.
    pub learning: Femtojoules,
}

impl Breakdown {
    /// Name and energy of every part, in a fixed order.
    pub fn parts(&self) -> [(&'static str, Femtojoules); 8] {
        [
            ("synapse", self.synapse),
            ("dendrite", self.dendrite),
            ("compartment", self.compartment),
            ("spike", self.spike),
            ("axon_out", self.axon_out),
            ("axon_in", self.axon_in),
            ("hop", self.hop),
            ("learning", self.learning),
        ]
    }

    /// The sum of the parts.
    pub fn total(&self) -> Femtojoules {
        self.parts().into_iter().map(|(_, energy)| energy).sum()
    }
}

/// Energy of one timestep.
pub fn step_energy(step: &StepActivity, table: &CostTable) -> Breakdown {
    energy_of_counts(sum_of_cores(step.cores.as_slice()), step.hops, table)
}

/// Sum of the counts of cores.
pub(crate) fn sum_of_cores(cores: &[CoreCounts]) -> CoreCounts {
    let mut sum = CoreCounts::default();
    cores.iter().for_each(|core| sum += *core);
    sum
}

/// Energy of a whole run: equal to the sum over its steps.
pub fn energy(activity: &Activity, table: &CostTable) -> Breakdown {
    energy_of_counts(activity.sum(), activity.hops(), table)
}

/// Energy of the summed counts of all cores.
pub fn energy_of_counts(sum: CoreCounts, hops: HopCounts, table: &CostTable) -> Breakdown {
    Breakdown {
        synapse: table.synapse_dense_energy * sum.events_dense + table.synapse_sparse_energy * sum.events_sparse,
        dendrite: table.dendrite_energy * (sum.visited - sum.stated),
        compartment: visit_energy(&sum, table) + table.compartment_active_energy * (sum.active - sum.stated_active),
        spike: table.spike_energy * sum.spikes,
        axon_out: table.axon_out_energy * sum.messages_out,
        axon_in: table.axon_in_energy * sum.messages_in,
        hop: table.local_hop_energy * hops.local
            + table.hop_ew_energy * hops.east_west
            + table.hop_ns_energy * hops.north_south
            + table.hop_chip_energy * hops.chip,
        learning: table.synapse_update_energy * sum.synaptic_updates,
    }
}

/// A constant of a visited compartment for the programs that models state, by their instructions.
/// An instruction's part is rounded once, so that sums over steps and cores are exact.
fn of_programs(constant: u128, counts: &CoreCounts) -> u128 {
    let parts = u128::from(COMPARTMENT_INSTRUCTIONS);
    (constant + parts / 2) / parts * u128::from(counts.instructions)
}

/// Energy of visited compartments, where a model states one by that.
fn visit_energy(counts: &CoreCounts, table: &CostTable) -> Femtojoules {
    let usual = counts.visited.saturating_sub(counts.microcode + counts.stated);
    let stated = if table.stated { counts.stated_energy.into() } else { 0 };
    Femtojoules((table.compartment_energy * usual).0 + of_programs(table.compartment_energy.0, counts) + stated)
}

/// The time of a step by part; parts are sequential.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct StepTime {
    /// Injection of the spikes of a stream by an x86 core.
    pub injection: Picoseconds,
    /// The turn of the x86 cores' process.
    pub turn: Picoseconds,
    /// Time of the slowest core.
    pub slowest_core: Picoseconds,
    /// Time that messages add to the slowest core.
    pub transport: Picoseconds,
    /// The barrier, over the tiles of a chip and between chips.
    pub barrier: Picoseconds,
    /// A step's share of the time of resetting state after a sample.
    pub reset: Picoseconds,
}

impl StepTime {
    /// Index of the slowest core among the parts.
    pub const SLOWEST_CORE: usize = 2;

    /// Name and time of every part, in a fixed order.
    pub fn parts(&self) -> [(&'static str, Picoseconds); 6] {
        [
            ("injection", self.injection),
            ("turn", self.turn),
            ("slowest core", self.slowest_core),
            ("transport", self.transport),
            ("barrier", self.barrier),
            ("reset", self.reset),
        ]
    }

    /// Time of the whole step, saturating at the type's range (213 days).
    pub fn total(&self) -> Picoseconds {
        Picoseconds(self.parts().into_iter().fold(0, |sum, (_, part)| sum.saturating_add(part.0)))
    }
}

/// The constants of a core's time, in the order of [`core_time_by_constant`].
pub const CORE_TIMES: [&str; 9] = [
    "axon_in_time",
    "synapse_dense_time",
    "synapse_sparse_time",
    "compartment_time",
    "compartment_active_time",
    "spike_time",
    "axon_out_time",
    "microcode_time",
    "synapse_update_time",
];

/// Index of the term of learning, which follows all others.
const LEARNING: usize = 8;

/// The terms of a core's time, in the order of [`CORE_TIMES`].
fn core_terms(core: &CoreCounts, table: &CostTable) -> [(Picoseconds, u64); 9] {
    let [updates, microcode] = update_terms(core, table);
    [
        (table.axon_in_time, core.messages_in),
        (table.synapse_dense_time, core.events_dense),
        (table.synapse_sparse_time, core.events_sparse),
        updates,
        (table.compartment_active_time, core.active - core.stated_active),
        (table.spike_time, core.spikes),
        (table.axon_out_time, core.messages_out),
        microcode,
        (table.synapse_update_time, core.synaptic_updates),
    ]
}

/// The longest time in which a core learns.
pub(crate) fn slowest_learning(step: &StepActivity, table: &CostTable) -> Picoseconds {
    step.cores.iter().map(|core| times(&core_terms(core, table)[LEARNING..])).max().unwrap_or_default()
}

/// The terms of updates, by the kinds of the neurons ([`CoreCounts::of_visit`]): of kinds that the
/// chip has, a pass each; and of programs that models state, each the preset's time of a program,
/// a compartment's by its instructions where it has none, or the time that its model states.
pub fn update_terms(core: &CoreCounts, table: &CostTable) -> [(Picoseconds, u64); 2] {
    let passes = (core.visited + core.second_passes).saturating_sub(core.microcode + core.stated);
    let programs = match table.by_instructions {
        true => of_programs(table.compartment_time.0.into(), core),
        false => u128::from(table.microcode_time.0) * u128::from(core.microcode),
    };
    let stated = if table.stated { core.stated_time } else { 0 };
    let programs = u64::try_from(programs).unwrap_or(u64::MAX).saturating_add(stated);
    [(table.compartment_time, passes), (Picoseconds(programs), 1)]
}

/// Indices of the terms for axon reads, synapses and dendrites.
const CORE_GROUPS: [Range<usize>; 3] = [0..1, 1..3, 3..LEARNING];

/// Time of one core's delivery and update in a step: sum of its terms (9), or the greatest (21); then
/// of its learning.
pub fn core_time(core: &CoreCounts, table: &CostTable) -> Picoseconds {
    let terms = core_terms(core, table);
    let groups = CORE_GROUPS.into_iter().map(|group| times(&terms[group]));
    let work = match table.step {
        StepForm::Sum => groups.fold(0, |sum: u64, group| sum.saturating_add(group.0)),
        StepForm::Greatest => groups.max().unwrap_or_default().0,
    };
    Picoseconds(work.saturating_add(times(&terms[LEARNING..]).0))
}

/// [`core_time`], split by constant in the order of [`CORE_TIMES`].
pub fn core_time_by_constant(core: &CoreCounts, table: &CostTable) -> [Picoseconds; 9] {
    let terms = core_terms(core, table);
    let counted = match table.step {
        StepForm::Sum => 0..terms.len(),
        StepForm::Greatest => {
            CORE_GROUPS.into_iter().max_by_key(|group| times(&terms[group.clone()])).unwrap_or_default()
        }
    };
    let counts = |place| place == LEARNING || counted.contains(&place);
    std::array::from_fn(|place| times(&terms[place..=place][..usize::from(counts(place))]))
}

/// Time of a message's route through an empty mesh.
pub fn route_time(route: Route, table: &CostTable) -> Picoseconds {
    if route.links() == 0 {
        return table.local_hop_time;
    }
    times(&[
        (table.hop_ew_time, route.east_west.into()),
        (table.hop_ns_time, route.north_south.into()),
        (table.hop_chip_time, route.chip.into()),
    ])
}

/// A saturating sum of products.
pub(crate) fn times(terms: &[(Picoseconds, u64)]) -> Picoseconds {
    Picoseconds(terms.iter().fold(0, |sum: u64, &(time, count)| sum.saturating_add(time.0.saturating_mul(count))))
}

#[cfg(test)]
pub(crate) mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::constants::tests::{preset, table};
    use crate::transport::tests::{no_routes, timing};
    use crate::transport::{QueueMemory, Timing, Transport, Words};

    /// The time of a step by the analytic model of the mesh.
    fn step_time(step: &StepActivity, table: &CostTable, tiles_used: u64) -> StepTime {
        no_routes()
            .step_times(
                step,
                std::slice::from_ref(table),
                Timing { tiles_used, ..timing(Transport::Analytic) },
                &mut QueueMemory::default(),
            )
            .remove(0)
    }

    /// Two cores: one visits 3 compartments of which 2 are active and 1 fires to both cores; 5
    /// dense events on the other.
    fn step() -> StepActivity {
        let mut step = StepActivity::new(2);
        step.cores.as_mut_slice()[0] =
            CoreCounts { messages_in: 2, visited: 3, active: 2, spikes: 1, messages_out: 2, ..Default::default() };
        step.cores.as_mut_slice()[1] =
            CoreCounts { messages_in: 1, events_dense: 5, events_sparse: 4, visited: 2, ..Default::default() };
        step.spikes_in = 1;
        step.messages_from_inputs = 1;
        step.add_routes(Route::default(), 1);
        step.add_routes(Route { east_west: 2, north_south: 1, chip: 1 }, 1);
        step.add_routes(Route { east_west: 1, north_south: 0, chip: 0 }, 1);
        step
    }

    #[test]
    fn hand_computed_energy_with_the_calibrated_preset() {
        let breakdown = step_energy(&step(), &table("sanafe-calibrated"));
        assert_eq!(breakdown.synapse, Femtojoules(5 * 35_500 + 4 * 33_600));
        assert_eq!(breakdown.compartment, Femtojoules(5 * 51_200 + 2 * 21_600));
        assert_eq!(breakdown.spike, Femtojoules(69_300));
        assert_eq!(breakdown.axon_out, Femtojoules(2 * 111_000));
        assert_eq!(breakdown.hop, Femtojoules(3 * 3_000 + 4_200));
        assert_eq!((breakdown.dendrite, breakdown.axon_in), Default::default());
        assert_eq!(breakdown.total(), Femtojoules(311_900 + 299_200 + 69_300 + 222_000 + 13_200));
    }

    #[test]
    fn own_kinds_cost_what_they_state_or_their_instructions() {
        let table = table("sanafe-calibrated");
        // Of 5 visits one states its price, and one has 30 instructions; the former is active.
        let own = CoreCounts {
            microcode: 1,
            instructions: 30,
            stated: 1,
            stated_active: 1,
            stated_energy: 12_000,
            stated_time: 5_000,
            visited: 5,
            active: 2,
            ..Default::default()
        };
        let energy = energy_of_counts(own, HopCounts::default(), &table).compartment;
        assert_eq!(energy, Femtojoules(3 * 51_200 + 4_267 * 30 + 12_000 + 21_600));
        assert_eq!(core_time(&own, &table), Picoseconds(3 * 6_000 + 6_000 * 30 / 12 + 5_000 + 3_700));
        let usual = CoreCounts { microcode: 2, instructions: 24, visited: 5, active: 2, ..Default::default() };
        let plain = CoreCounts { visited: 5, active: 2, ..Default::default() };
        assert_eq!(core_time(&usual, &table), core_time(&plain, &table));
    }

    #[test]
    fn constants_that_the_presets_leave_at_zero_are_charged_too() {
        let mut constants = preset("davies2018");
        constants.dendrite_energy.value = 1.5.into();
        constants.axon_in_energy.value = 2.25.into();
        constants.hop_chip_energy.value = 100.0.into();
        constants.hop_chip_time.value = 50.0.into();
        constants.injection_time.value = 0.007.into();
        constants.turn_time.value = 0.011.into();
        constants.reset_word_time.value = 3.0.into();
        constants.chip_hop_time.value = 0.1.into();
        let table = CostTable::new(&constants).unwrap();
        let breakdown = step_energy(&step(), &table);
        assert_eq!(breakdown.dendrite, Femtojoules(5 * 1_500));
        assert_eq!(breakdown.axon_in, Femtojoules(3 * 2_250));
        assert_eq!(breakdown.hop, Femtojoules(14_700 + 100_000));
        let timing = Timing {
            chip_hops: 3,
            reset: Words { count: 10, steps: 4 },
            sent: Words { count: 6, steps: 3 },
            ..timing(Transport::Analytic)
        };
        let memory = &mut QueueMemory::default();
        let long = no_routes().step_times(&step(), std::slice::from_ref(&table), timing, memory)[0];
        assert_eq!((long.injection, long.turn), (Picoseconds(3 * 7_000), Picoseconds(11_000)));
        assert_eq!((long.barrier, long.reset), (Picoseconds(113_000 + 300_000), Picoseconds(7_500)));
        let time = step_time(&step(), &table, 1);
        assert_eq!((time.injection, time.transport), (Picoseconds(7_000), Picoseconds(2 * 4_100 + 6_500 + 50_000)));
    }

    #[test]
    fn hand_computed_time() {
        let time = step_time(&step(), &table("sanafe-calibrated"), 2);
        let first = 2 * 16_000 + 3 * 6_000 + 2 * 3_700 + 30_000 + 2 * 5_100;
        let second = 16_000 + 5 * 3_800 + 4 * 4_700 + 2 * 6_000;
        assert!(first > second);
        assert_eq!(time.slowest_core, Picoseconds(first));
        assert_eq!(time.transport, Picoseconds(2 * 4_100 + 6_500));
        assert_eq!(time.barrier, Picoseconds(1_000_000));
        let host = time.injection.0 + time.turn.0;
        assert_eq!(time.total(), Picoseconds(first + 14_700 + 1_000_000 + host));
    }

    #[test]
    fn parts_that_overlap_take_as_long_as_the_greatest_of_them() {
        let mut greatest = table("sanafe-calibrated");
        greatest.step = StepForm::Greatest;
        // 5 dense and 4 sparse events take longer than two visits and one message.
        let step_of_two = step();
        let second = &step_of_two.cores.as_slice()[1];
        assert_eq!(core_time(second, &greatest), Picoseconds(5 * 3_800 + 4 * 4_700));
        let first = 3 * 6_000 + 2 * 3_700 + 30_000 + 2 * 5_100;
        let time = step_time(&step(), &greatest, 2);
        assert_eq!((time.slowest_core, time.transport), (Picoseconds(first), Picoseconds(0)));
        // A core with nothing else takes the time of its reads.
        let reads = CoreCounts { messages_in: 3, ..CoreCounts::default() };
        assert_eq!(core_time(&reads, &greatest), Picoseconds(3 * 16_000));
    }

    #[test]
    fn programs_take_their_own_time_and_second_passes_a_visit_each() {
        let core =
            CoreCounts { visited: 10, microcode: 4, instructions: 48, second_passes: 3, ..CoreCounts::default() };
        assert_eq!(core_time(&core, &table("loihi2-modelled")), Picoseconds(9 * 3_000 + 4 * 28_000));
        // Without a time of its own a program of twelve instructions takes a compartment's.
        assert_eq!(core_time(&core, &table("sanafe-calibrated")), Picoseconds(13 * 6_000));
        for (name, of_silent) in [("loihi2-modelled", 0), ("sanafe-calibrated", 1_899_000)] {
            let turn = |spikes| timing(Transport::Analytic).host_and_barrier(spikes, &table(name)).turn.0;
            assert_eq!((turn(0), turn(1)), (of_silent, 1_899_000), "{name}");
        }
    }

    #[test]
    fn synapses_that_learn_cost_their_updates_after_all_other_work() {
        let mut learns = step();
        learns.cores.as_mut_slice()[0].synaptic_updates = 1_000;
        // Loihi 2's are Loihi 1's over 5.
        for (name, energy, time) in
            [("davies2018", 120_000, 6_100), ("loihi1-evidence", 120_000, 6_100), ("loihi2-modelled", 24_000, 1_220)]
        {
            let table = table(name);
            let more = |of: fn(&StepActivity, &CostTable) -> u128| of(&learns, &table) - of(&step(), &table);
            assert_eq!(more(|step, table| step_energy(step, table).total().0), 1_000 * energy, "{name}");
            assert_eq!(more(|step, table| core_time(&step.cores.as_slice()[0], table).0.into()), 1_000 * time);
            for transport in [Transport::Analytic, Transport::Queued] {
                let memory = &mut QueueMemory::default();
                let mut took = |step: &StepActivity| {
                    let alone = StepActivity { hops: HopCounts::default(), longest: Route::default(), ..step.clone() };
                    let tables = std::slice::from_ref(&table);
                    no_routes().step_times(&alone, tables, timing(transport), memory)[0].slowest_core.0
                };
                let silent = StepActivity::new(2);
                let mut only = silent.clone();
                only.cores.as_mut_slice()[1].synaptic_updates = 1_000;
                assert_eq!(u128::from(took(&only) - took(&silent)), 1_000 * time, "{name}");
            }
        }
    }

    #[test]
    fn a_silent_step_moves_nothing_and_a_message_within_a_tile_takes_the_local_time() {
        let davies = table("davies2018");
        let mut step = StepActivity::new(1);
        let turn = davies.turn_time;
        assert_eq!(
            step_time(&step, &davies, 1),
            StepTime { barrier: Picoseconds(113_000), turn, ..Default::default() }
        );
        assert_eq!(step_energy(&step, &davies), Breakdown::default());
        step.add_routes(Route::default(), 1);
        assert_eq!(step_time(&step, &davies, 1).transport, Picoseconds(2_100));
    }

    #[test]
    fn times_beyond_the_range_stay_at_its_end() {
        let mut step = StepActivity::new(1);
        step.cores.as_mut_slice()[0].visited = u64::MAX;
        assert_eq!(step_time(&step, &table("davies2018"), 1).total(), Picoseconds(u64::MAX));
    }

    pub(crate) fn any_step(cores: usize) -> impl Strategy<Value = StepActivity> {
        let core = proptest::array::uniform6(0..10_000u64);
        let routes = proptest::collection::vec((0..64u32, 0..64u32, 0..4u32), 0..20);
        (proptest::collection::vec(core, cores), routes, 0..5_000u64).prop_map(move |(cores, routes, spikes_in)| {
            let mut step = StepActivity::new(cores.len());
            for (counts, [dense, sparse, visited, active, spikes, sent]) in step.cores.iter_mut().zip(cores) {
                // Each core sends to itself, so that copies sent equal copies received.
                *counts = CoreCounts {
                    messages_in: sent,
                    events_dense: dense,
                    events_sparse: sparse,
                    visited,
                    active: active.min(visited),
                    spikes: spikes.min(active).min(visited),
                    messages_out: sent,
                    microcode: active.min(visited) / 2,
                    second_passes: spikes.min(visited) / 2,
                    stated: visited / 3,
                    stated_active: active.min(visited) / 3,
                    instructions: dense,
                    stated_energy: sparse,
                    stated_time: spikes,
                    synaptic_updates: dense,
                };
            }
            for (east_west, north_south, chip) in routes {
                step.add_routes(Route { east_west, north_south, chip: chip.min(east_west + north_south) }, 1);
            }
            step.spikes_in = spikes_in;
            step
        })
    }

    proptest! {
        #[test]
        fn the_energy_of_a_run_is_the_sum_of_its_steps(
            steps in proptest::collection::vec(any_step(3), 0..12),
        ) {
            for name in ["davies2018", "sanafe-calibrated"] {
                let table = table(name);
                let mut activity = Activity::new(3);
                let mut sums = Breakdown::default().parts();
                for step in &steps {
                    activity.add_steps(step, 1);
                    for ((_, sum), (_, energy)) in sums.iter_mut().zip(step_energy(step, &table).parts()) {
                        *sum += energy;
                    }
                }
                prop_assert_eq!(energy(&activity, &table).parts(), sums);
            }
        }

        #[test]
        fn more_of_anything_never_costs_less(step in any_step(2), which in 0..8usize, more in 1..1_000u64) {
            for name in ["davies2018", "sanafe-calibrated"] {
                let table = table(name);
                let mut greater = step.clone();
                let core = &mut greater.cores.as_mut_slice()[1];
                let counts = [
                    &mut core.messages_in, &mut core.events_dense, &mut core.events_sparse, &mut core.visited,
                    &mut core.active, &mut core.spikes, &mut core.messages_out, &mut core.synaptic_updates,
                ];
                *counts.into_iter().nth(which).unwrap() += more;
                let (less_energy, more_energy) = (step_energy(&step, &table), step_energy(&greater, &table));
                for ((_, less), (_, more)) in less_energy.parts().into_iter().zip(more_energy.parts()) {
                    prop_assert!(less <= more);
                }
                prop_assert!(step_time(&step, &table, 5).total() <= step_time(&greater, &table, 5).total());
                prop_assert!(step_time(&step, &table, 5).total() <= step_time(&step, &table, 6).total());
            }
        }
    }
}
