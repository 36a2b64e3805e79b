//! How long a step's messages take: two models of the mesh.
//!
//! Input: a program's routes ([`MessageRoutes`], computed once) and the activity of a step. Output: the time of cores and
//! mesh together, (11) and (17) of `docs/energy.md`. `analytic` adds the longest route and the wait at the busiest link to
//! the slowest core; it costs about as much as counting. `queued` follows every message through finite buffers: a sender
//! whose route is full is stalled, links and receivers take one message at a time.
//!
//! The queue is semi-analytic, as SANA-FE's `detailed` schedule (schedule.cpp, read as a description): a message does not
//! move link by link; its time follows from the messages in flight along its route when it leaves. Not modelled:
//! arbitration in routers, virtual channels and flits; barrier messages, whose time is a constant.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::base::csr::Csr;
use crate::base::id::{CoreId, Id};
use crate::base::names::named_variants;
use crate::base::units::Picoseconds;
use crate::cost::constants::CostTable;
use crate::cost::host::Host;
use crate::cost::model::{StepTime, core_time, route_time, times};
use crate::ir::activity::StepActivity;
use crate::ir::placement::Route;
use crate::ir::program::{CoreImage, Program};

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

/// A link in one direction, or a sender's link into its router.
type Link = u32;

/// One message that a spike of some source sends.
#[derive(Debug, Clone, Copy)]
struct Message {
    core: CoreId,
    events_dense: u32,
    events_sparse: u32,
}

/// Where a program's messages go.
///
/// Senders are the cores and, behind them, the port of each chip, through which its inputs enter: the chip's corner.
#[derive(Debug, Clone)]
pub struct MessageRoutes {
    columns: u32,
    rows: u32,
    chip_width: u32,
    chip_height: u32,
    /// Tile of each sender.
    tiles: Vec<(u32, u32)>,
    cores: usize,
    /// By channel.
    inputs: Csr<Message>,
    /// By compartment.
    spikes: Csr<Message>,
    /// Core, slot, and number of compartments of that core, by compartment.
    seats: Vec<(CoreId, u32, u32)>,
    chips_x: u32,
}

/// Dense and sparse synapses of an input axon.
fn events(image: &CoreImage, axon: u16) -> (u32, u32) {
    let synapses = image.inputs.get(usize::from(axon)).stored;
    let dense = |format: u8| image.formats[usize::from(format)].index_bits.is_none();
    let count = synapses.iter().filter(|synapse| dense(synapse.format)).count();
    (count as u32, (synapses.len() - count) as u32)
}

impl MessageRoutes {
    /// The routes of a program's messages.
    #[must_use]
    pub fn of_program(program: &Program) -> Self {
        let mesh = *program.mesh();
        let cores = program.cores();
        let message = |target: &crate::ir::program::AxonTarget| {
            let (events_dense, events_sparse) = events(&cores[target.core], target.axon);
            Message { core: target.core, events_dense, events_sparse }
        };
        let mut inputs = Csr::default();
        for list in program.parts().channels.iter() {
            inputs.push(list.iter().map(message));
        }
        let mut spikes = Csr::default();
        let mut seats = Vec::with_capacity(program.seats().len());
        for seat in program.seats() {
            let image = &cores[seat.core];
            spikes.push(image.axons_out.get(usize::from(seat.slot)).iter().map(message));
            seats.push((seat.core, u32::from(seat.slot), image.compartments.len() as u32));
        }
        let of_cores = cores.iter().map(|image| mesh.tile(image.site));
        let corner = |chip: u32| (chip % mesh.chips_x * mesh.width, chip / mesh.chips_x * mesh.height);
        MessageRoutes {
            columns: mesh.chips_x * mesh.width,
            rows: mesh.chips_y * mesh.height,
            chip_width: mesh.width,
            chip_height: mesh.height,
            tiles: of_cores.chain((0..mesh.chips_x * mesh.chips_y).map(corner)).collect(),
            cores: cores.len(),
            inputs,
            spikes,
            seats,
            chips_x: mesh.chips_x,
        }
    }

    /// The port through which a core's inputs enter.
    fn port(&self, core: CoreId) -> usize {
        let (x, y) = self.tiles[core.index()];
        self.cores + (y / self.chip_height * self.chips_x + x / self.chip_width) as usize
    }

    fn route(&self, from: usize, to: usize) -> Route {
        let ((fx, fy), (tx, ty)) = (self.tiles[from], self.tiles[to]);
        let chip = (fx / self.chip_width).abs_diff(tx / self.chip_width)
            + (fy / self.chip_height).abs_diff(ty / self.chip_height);
        Route { east_west: fx.abs_diff(tx), north_south: fy.abs_diff(ty), chip }
    }

    fn links(&self) -> usize {
        4 * (self.columns * self.rows) as usize + self.tiles.len()
    }

    /// The sender's link into its router.
    fn first_link(&self, sender: usize) -> Link {
        4 * self.columns * self.rows + sender as u32
    }

    /// Every link on a message's route, along its row first, and whether it joins two chips. A link is numbered by
    /// the tile that it leads to and its direction.
    fn each_link(&self, from: usize, to: usize, mut see: impl FnMut(Link, bool)) {
        let ((mut x, mut y), (tx, ty)) = (self.tiles[from], self.tiles[to]);
        while x != tx {
            let (next, direction) = if x < tx { (x + 1, 0) } else { (x - 1, 1) };
            see(4 * (y * self.columns + next) + direction, x / self.chip_width != next / self.chip_width);
            x = next;
        }
        while y != ty {
            let (next, direction) = if y < ty { (y + 1, 2) } else { (y - 1, 3) };
            see(4 * (next * self.columns + x) + direction, y / self.chip_height != next / self.chip_height);
            y = next;
        }
    }

    /// Sender and message of every message of a step.
    fn each_message(&self, step: &StepActivity, mut see: impl FnMut(usize, &Message)) {
        for channel in &step.channels {
            self.inputs.get(channel.index()).iter().for_each(|message| see(self.port(message.core), message));
        }
        for compartment in &step.fired {
            let sender = self.seats[compartment.index()].0.index();
            self.spikes.get(compartment.index()).iter().for_each(|message| see(sender, message));
        }
    }

    /// Messages over the busiest link of a chip and over the busiest between chips.
    fn busiest_links(&self, step: &StepActivity) -> [u32; 2] {
        if step.channels.is_empty() && step.fired.is_empty() {
            return [0; 2];
        }
        // Difference arrays over rows (east, west) and columns (south, north): +1 where a message enters a line of tiles, -1
        // where it leaves, so the cost is independent of the route's length.
        let (columns, rows) = (self.columns as usize, self.rows as usize);
        let mut lines = [(); 4].map(|()| vec![0i32; columns * rows]);
        self.each_message(step, |sender, message| {
            let ((fx, fy), (tx, ty)) = (self.tiles[sender], self.tiles[message.core.index()]);
            let mut add = |direction: usize, line: usize, from: u32, to: u32| {
                lines[direction][line + from as usize] += 1;
                lines[direction][line + to as usize] -= 1;
            };
            add(usize::from(fx > tx), fy as usize * columns, fx.min(tx), fx.max(tx));
            add(2 + usize::from(fy > ty), tx as usize * rows, fy.min(ty), fy.max(ty));
        });
        let mut busiest = [0; 2];
        for (direction, line) in lines.iter().enumerate() {
            let (length, of_chip) = if direction < 2 { (columns, self.chip_width) } else { (rows, self.chip_height) };
            for tiles in line.chunks(length.max(1)) {
                let mut load = 0;
                for (tile, difference) in (1..).zip(tiles) {
                    load += difference;
                    let most: &mut u32 = &mut busiest[usize::from(tile % of_chip.max(1) == 0)];
                    *most = (*most).max(load as u32);
                }
            }
        }
        busiest
    }

    /// The times of a step under each preset, (11) or (17). The memory is that of an earlier step, so that a step allocates
    /// nothing of the mesh's size.
    #[must_use]
    pub fn step_times(
        &self,
        step: &StepActivity,
        tables: &[CostTable],
        timing: Timing,
        memory: &mut QueueMemory,
    ) -> Vec<StepTime> {
        let Timing { transport, tiles_used, host, followed } = timing;
        let sent = step.messages_from_inputs > 0 || step.hops.local + step.hops.links() > 0;
        let busiest = match transport {
            Transport::Queued if followed >= tables.len() => [0; 2],
            _ => self.busiest_links(step),
        };
        let analytic = |table: &CostTable| {
            let cores = step.cores.iter().map(|core| core_time(core, table)).max().unwrap_or_default();
            let way = if sent { route_time(step.longest, table) } else { Picoseconds(0) };
            // The first message finds its link free.
            let wait = |link: Picoseconds, load: u32| link.0.saturating_mul(u64::from(load.saturating_sub(1)));
            let wait = wait(table.link_time, busiest[0]).max(wait(table.link_chip_time, busiest[1]));
            (cores, Picoseconds(way.0.saturating_add(wait)))
        };
        let both = |(cores, transport): (Picoseconds, Picoseconds)| cores.0.saturating_add(transport.0);
        // What following the messages comes to under the first preset, and what (11) does.
        let mut first: Option<(u64, u64)> = None;
        let mut time = |(number, table): (usize, &CostTable)| {
            let injection = host.map_or(Picoseconds(0), |host| host.injection(step.spikes_in, table));
            let (slowest_core, transport) = match transport {
                Transport::Analytic => analytic(table),
                Transport::Queued if number < followed => {
                    let found = Queue::new(self, table, memory).run(step, injection);
                    if number == 0 && followed < tables.len() {
                        first = Some((both(found), both(analytic(table))));
                    }
                    found
                }
                Transport::Queued => {
                    let (cores, way) = analytic(table);
                    let (queued, simple) = first.unwrap_or_default();
                    let took = both((cores, way)).saturating_add(queued).saturating_sub(simple);
                    (Picoseconds(cores.0.min(took)), Picoseconds(took.saturating_sub(cores.0)))
                }
            };
            StepTime {
                injection,
                readout: host.map_or(Picoseconds(0), |host| host.readout(step.spikes_out, table)),
                slowest_core,
                transport,
                barrier: table.barrier(tiles_used),
            }
        };
        tables.iter().enumerate().map(&mut time).collect()
    }
}

/// What the time of a step depends on beside its counts and constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// The model of the mesh.
    pub transport: Transport,
    /// Tiles in the barrier.
    pub tiles_used: u64,
    /// What hands spikes over; `None` for the chips alone.
    pub host: Option<Host>,
    /// The first so many presets have their messages followed by `queued`. The others, which are ends of intervals, take the time
    /// by (11) and what following added under the first preset.
    pub followed: usize,
}

/// A message that its sender has ready.
#[derive(Debug, Clone, Copy)]
struct Ready {
    /// Time since the one before was sent.
    after: u64,
    /// The receiving core.
    to: u32,
    /// Time at the receiver.
    handling: u64,
}

/// Occupancy is fixed-point in fractions of a message: integers, so that subtracting undoes adding exactly.
const MESSAGE: u64 = 1 << 32;

/// What the queue needs of memory, to be used again. Every number is 0 between two steps.
#[derive(Debug, Clone, Default)]
pub struct QueueMemory {
    /// Of each link, in parts of a [`MESSAGE`].
    occupied: Vec<u64>,
    /// When each link can take the next message.
    free: Vec<u64>,
    /// The links whose numbers are not 0, some of them several times.
    touched: Vec<Link>,
    /// When each core has handled its messages.
    done: Vec<u64>,
    /// Time of receipt, sender, receiver, handling.
    under_way: BinaryHeap<Reverse<(u64, u32, u32, u64)>>,
    /// The links of the message that is sent, and which of them join two chips; the sender's own is first.
    path: Vec<(Link, bool)>,
}

/// Messages in flight in one step.
struct Queue<'w> {
    routes: &'w MessageRoutes,
    table: &'w CostTable,
    memory: &'w mut QueueMemory,
    /// Sum of the handling times of the messages under way.
    handling: u128,
}

impl<'w> Queue<'w> {
    fn new(routes: &'w MessageRoutes, table: &'w CostTable, memory: &'w mut QueueMemory) -> Self {
        memory.occupied.resize(routes.links(), 0);
        memory.free.resize(routes.links(), 0);
        memory.done.resize(routes.cores, 0);
        Queue { routes, table, memory, handling: 0 }
    }

    /// What each sender sends, in order, and how long it is busy after its last message.
    ///
    /// The k-th input spike of a chip enters the mesh when k / n of the injection have passed, with n spikes at the chip with most,
    /// while others are injected; cores begin when all are.
    fn senders(&self, step: &StepActivity, injection: u64) -> Vec<(Vec<Ready>, u64)> {
        let (routes, table) = (self.routes, self.table);
        let handling = |message: &Message| {
            let counts = [
                (table.axon_in_time, 1),
                (table.synapse_dense_time, message.events_dense.into()),
                (table.synapse_sparse_time, message.events_sparse.into()),
            ];
            times(&counts).0
        };
        let ready = |after: u64, message: &Message| Ready { after, to: message.core.0, handling: handling(message) };
        let mut senders: Vec<(Vec<Ready>, u64)> = vec![Default::default(); routes.tiles.len()];
        // Chips are served side by side: a spike is the next of the port that its first message enters by.
        let port = |list: &[Message]| list.first().map_or(0, |message| routes.port(message.core) - routes.cores);
        let mut spikes = vec![0u128; routes.tiles.len() - routes.cores + 1];
        for channel in &step.channels {
            spikes[port(routes.inputs.get(channel.index()))] += 1;
        }
        let most = spikes.iter().copied().max().unwrap_or(0).max(1);
        spikes.fill(0);
        for channel in &step.channels {
            let list = routes.inputs.get(channel.index());
            let number = &mut spikes[port(list)];
            *number += 1;
            let now = (u128::from(injection) * *number / most) as u64;
            for message in list {
                // Between messages a port keeps the time that has passed.
                let (messages, passed) = &mut senders[routes.port(message.core)];
                // A copy's spike for another chip may come behind that chip's own.
                let until = now.max(*passed);
                messages.push(ready(until - std::mem::replace(passed, until), message));
            }
        }
        senders[routes.cores..].iter_mut().for_each(|(_, passed)| *passed = 0);
        senders[..routes.cores].iter_mut().for_each(|(_, after)| *after = injection);
        // Visits in slot order, each for the mean time of its core's.
        let visits: Vec<u64> = step
            .cores
            .iter()
            .map(|core| {
                times(&[(table.compartment_time, core.visited), (table.compartment_active_time, core.active)]).0
            })
            .collect();
        let mut fired: Vec<_> = step.fired.iter().map(|c| (routes.seats[c.index()], c.index())).collect();
        fired.sort_unstable();
        let mut passed = vec![0u64; routes.cores];
        for &((core, slot, slots), compartment) in &fired {
            let until = (u128::from(visits[core.index()]) * u128::from(slot + 1) / u128::from(slots.max(1))) as u64;
            let sender = &mut senders[core.index()];
            // A spike that sends nothing takes its time from the next.
            sender.1 += until - std::mem::replace(&mut passed[core.index()], until) + table.spike_time.0;
            for message in routes.spikes.get(compartment) {
                sender.0.push(ready(std::mem::take(&mut sender.1) + table.axon_out_time.0, message));
            }
        }
        for (core, &visited) in visits.iter().enumerate() {
            senders[core].1 += visited - passed[core];
        }
        senders
    }

    /// Takes what was received by now out of the mesh.
    fn advance(&mut self, now: u64) {
        while let Some(&Reverse((received, from, to, handling))) = self.memory.under_way.peek()
            && received <= now
        {
            self.memory.under_way.pop();
            self.handling -= u128::from(handling);
            let (routes, occupied) = (self.routes, &mut self.memory.occupied);
            let (from, to) = (from as usize, to as usize);
            let part = MESSAGE / (u64::from(routes.route(from, to).links()) + 2);
            occupied[routes.first_link(from) as usize] -= part;
            routes.each_link(from, to, |link, _| occupied[link as usize] -= part);
        }
    }

    /// Sends a message at `now`; returns when its sender was done with it and when its receiver was.
    fn send(&mut self, now: u64, from: usize, message: Ready) -> (u64, u64) {
        let (routes, table, to) = (self.routes, self.table, message.to as usize);
        let QueueMemory { occupied, free, touched, done, under_way, path } = &mut *self.memory;
        let route = routes.route(from, to);
        path.clear();
        path.push((routes.first_link(from), false));
        routes.each_link(from, to, |link, between_chips| path.push((link, between_chips)));
        let links = path.len() as u64;
        let part = MESSAGE / (links + 1);
        let mut along = 0u128;
        for &(link, _) in &*path {
            let here = &mut occupied[link as usize];
            if *here == 0 {
                touched.push(link);
            }
            along += u128::from(*here);
            *here += part;
        }
        let mean = quotient(self.handling, (under_way.len() as u64).max(1));
        // A way holds its links' buffers; what is beyond that has to be received first.
        let beyond = along.saturating_sub(u128::from(links) * u128::from(table.link_buffer) * u128::from(MESSAGE));
        let leaves = now.saturating_add((beyond * mean / u128::from(MESSAGE)) as u64);
        let congested = quotient(along * mean / u128::from(MESSAGE), links) as u64;
        // One message after the other on each link; a sender's own link is as fast as the sender.
        let mut at = leaves;
        for &(link, between_chips) in &path[1..] {
            let free = &mut free[link as usize];
            at = at.max(*free);
            *free = at + if between_chips { table.link_chip_time.0 } else { table.link_time.0 };
        }
        let waited = at - leaves;
        let way = (route_time(route, table).0 + waited).max(congested);
        let received = done[to].max(leaves.saturating_add(way));
        done[to] = received.saturating_add(message.handling);
        under_way.push(Reverse((received, from as u32, message.to, message.handling)));
        self.handling += u128::from(message.handling);
        (leaves, done[to])
    }

    /// The busiest core's own time and what the mesh adds to it, both counted from the end of the injection.
    fn run(mut self, step: &StepActivity, injection: Picoseconds) -> (Picoseconds, Picoseconds) {
        let senders = self.senders(step, injection.0);
        let mut received = vec![0u64; self.routes.cores];
        let mut alone = 0;
        for (number, (messages, after)) in senders.iter().enumerate() {
            let time = messages.iter().map(|message| message.after).sum::<u64>() + after;
            if number < self.routes.cores {
                alone = alone.max(time.saturating_sub(injection.0));
            }
            messages.iter().for_each(|message| received[message.to as usize] += message.handling);
        }
        alone = alone.max(received.into_iter().max().unwrap_or(0));
        // Each sender's next message, the earliest first; on a tie the lower sender.
        let mut next: BinaryHeap<Reverse<(u64, usize, usize)>> = BinaryHeap::new();
        let mut last = 0;
        for (sender, (messages, after)) in senders.iter().enumerate() {
            match messages.first() {
                Some(first) => next.push(Reverse((first.after, sender, 0))),
                None => last = last.max(*after),
            }
        }
        while let Some(Reverse((mut now, sender, mut number))) = next.pop() {
            let (messages, after) = &senders[sender];
            // A sender goes on while no other is earlier.
            loop {
                self.advance(now);
                let (left, done) = self.send(now, sender, messages[number]);
                last = last.max(done);
                number += 1;
                let Some(message) = messages.get(number) else {
                    last = last.max(left.saturating_add(*after));
                    break;
                };
                now = left.saturating_add(message.after);
                if next.peek().is_some_and(|&Reverse((at, other, _))| (at, other) < (now, sender)) {
                    next.push(Reverse((now, sender, number)));
                    break;
                }
            }
        }
        self.clear();
        // What was handled before the injection ended is no time of its own.
        let took = last.saturating_sub(injection.0);
        (Picoseconds(alone.min(took)), Picoseconds(took.saturating_sub(alone)))
    }

    fn clear(&mut self) {
        let QueueMemory { occupied, free, touched, done, under_way, .. } = &mut *self.memory;
        for link in touched.drain(..) {
            occupied[link as usize] = 0;
            free[link as usize] = 0;
        }
        done.fill(0);
        under_way.clear();
    }
}

/// Division of what mostly fits into 64 bits, where it is several times faster.
fn quotient(dividend: u128, divisor: u64) -> u128 {
    u64::try_from(dividend).map_or_else(|_| dividend / u128::from(divisor), |small| (small / divisor).into())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::base::id::{ChannelId, CompartmentId};
    use crate::base::rng;
    use crate::cost::constants::tests::{preset, table};
    use crate::ir::activity::CoreCounts;

    /// A barrier of one tile and one copy.
    pub(crate) fn timing(transport: Transport) -> Timing {
        Timing { transport, tiles_used: 1, host: Some(Host::even(1, 1)), followed: usize::MAX }
    }

    /// The routes of a program of two cores without messages.
    pub(crate) fn no_routes() -> MessageRoutes {
        routes(&[(0, 0), (0, 0)], &[], &[])
    }

    /// MessageRoutes on one chip of 8 by 4 tiles, with 10 compartments a core; lists of (receiving core, dense synapses).
    fn routes(tiles: &[(u32, u32)], inputs: &[&[(u32, u32)]], spikes: &[&[(u32, u32)]]) -> MessageRoutes {
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
        MessageRoutes {
            columns: 8,
            rows: 4,
            chip_width: 8,
            chip_height: 4,
            tiles: tiles.iter().copied().chain([(0, 0)]).collect(),
            cores: tiles.len(),
            inputs: lists(inputs),
            spikes: lists(spikes),
            seats: (0..spikes.len() as u32).map(|i| (CoreId(i / 10), i % 10, 10)).collect(),
            chips_x: 1,
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
            // Chips of 4 by 2 tiles; the ports of all but the first are not drawn.
            let routes = MessageRoutes { chip_width: 4, chip_height: 2, ..routes(&tiles, &[], &spikes) };
            let fired: Vec<u32> = (0..90).filter(|&i| draw(3, 7_000 + 100 * seed + i) == 0).map(|i| i as u32).collect();
            let step = step(9, &[], &fired);
            let (mut load, mut busiest) = (vec![0u32; routes.links()], [0; 2]);
            routes.each_message(&step, |sender, message| {
                routes.each_link(sender, message.core.index(), |link, between_chips| {
                    load[link as usize] += 1;
                    let most: &mut u32 = &mut busiest[usize::from(between_chips)];
                    *most = (*most).max(load[link as usize]);
                });
            });
            assert!(busiest[0] > 0 && busiest[1] > 0, "{busiest:?}");
            assert_eq!(routes.busiest_links(&step), busiest, "seed {seed}");
        }
    }

    /// A step of cores that visit 10 compartments each, in which these fired.
    fn step(cores: usize, channels: &[u32], fired: &[u32]) -> StepActivity {
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
        let mut time = || Queue::new(routes, table, &mut memory).run(step, Picoseconds(0));
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
        // Four visits, the spike, the axon; two links east and one south; an axon and seven synapses.
        let (sent, way, handled) = (4 * 6_000 + 30_000 + 5_100, 2 * 4_100 + 6_500, 16_000 + 7 * 3_800);
        assert_eq!(queued(&routes, &step, &sana), sent + way + handled);
        // Six more visits follow while it is under way.
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
    fn a_receiver_handles_one_message_after_the_other() {
        let sana = table("sanafe-calibrated");
        let list: Vec<&[(u32, u32)]> = vec![&[(0, 50)]; 12];
        let routes = routes(&[(1, 0)], &list, &[&[] as &[_]; 10]);
        let each = 16_000 + 50 * 3_800;
        let all: Vec<u32> = (0..12).collect();
        // The first arrives over one link.
        assert_eq!(queued(&routes, &step(1, &all, &[]), &sana), 4_100 + 12 * each);
    }

    #[test]
    fn a_link_passes_one_message_after_the_other() {
        let mut constants = preset("sanafe-calibrated");
        constants.link_time.value = 1_000.0.into();
        let slow = CostTable::new(&constants).unwrap();
        // Twelve messages to twelve cores behind the same link.
        let tiles: Vec<(u32, u32)> = (0..12).map(|_| (1, 0)).collect();
        let lists: Vec<[(u32, u32); 1]> = (0..12).map(|core| [(core, 0)]).collect();
        let lists: Vec<&[(u32, u32)]> = lists.iter().map(<[_; 1]>::as_slice).collect();
        let routes = routes(&tiles, &lists, &[]);
        let mut step = step(12, &(0..12).collect::<Vec<_>>(), &[]);
        assert_eq!(queued(&routes, &step, &slow), 11 * 1_000_000 + 4_100 + 16_000);
        step.messages_from_inputs = 12;
        step.add_routes(Route { east_west: 1, north_south: 0, chip: 0 }, 12);
        let memory = &mut QueueMemory::default();
        let time = routes.step_times(&step, &[slow], timing(Transport::Analytic), memory);
        assert_eq!(time[0].transport, Picoseconds(4_100 + 11 * 1_000_000));
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
    fn what_enters_the_mesh_leaves_it() {
        let sana = table("sanafe-calibrated");
        let list: Vec<&[(u32, u32)]> = vec![&[(0, 5), (1, 3), (2, 9)]; 10];
        let routes = routes(&[(7, 3), (3, 2), (0, 0)], &list, &[&[] as &[_]; 30]);
        let mut memory = QueueMemory::default();
        let mut queue = Queue::new(&routes, &sana, &mut memory);
        for (at, message) in
            queue.senders(&step(3, &(0..10).collect::<Vec<_>>(), &[]), 0).pop().unwrap().0.iter().enumerate()
        {
            queue.send(at as u64 * 10, 3, *message);
        }
        assert!(queue.memory.occupied.iter().any(|&part| part > 0) && queue.handling > 0);
        queue.advance(u64::MAX);
        assert!(queue.memory.occupied.iter().all(|&part| part == 0) && queue.handling == 0);
        queue.clear();
        let QueueMemory { occupied, free, touched, done, under_way, .. } = &memory;
        assert!([occupied, free, done].iter().all(|numbers| numbers.iter().all(|&number| number == 0)));
        assert!(under_way.is_empty() && touched.is_empty());
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
            let (alone, added) = Queue::new(&routes, &sana, &mut memory).run(&step, Picoseconds(injection));
            alone.0 + added.0
        };
        assert_eq!(time(0), 4_100 + 12 * each);
        // The receiver is slower than the injection: it began with the first of twelve spikes.
        assert_eq!(time(12 * 1_000), 1_000 + 4_100 + 12 * each - 12 * 1_000);
        // It waits for each: the last one is left when the injection ends, and the visits are shorter.
        assert_eq!(time(12 * 1_000_000), 4_100 + each);
    }
}
