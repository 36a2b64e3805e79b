//! Simulates every message of a step through finite buffers, where messages wait for each other.
//!
//! Input: the messages of a step on one region of chips. Output: the time at which its cores are
//! done. A sender whose route is full is stalled; links and receivers take one message at a time.
//!
//! The queue is semi-analytic, like SANA-FE's `detailed` schedule (schedule.cpp, read as a
//! description). A message does not move link by link; its time follows from the messages in flight
//! along its route when it leaves. Unlike in SANA-FE, messages that can never meet do not wait for
//! each other. Not modelled: arbitration in routers, virtual channels, flits, barrier messages.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::constants::CostTable;
use crate::model::{route_time, times, update_terms};
use crate::transport::routes::{InputTimes, Message, MessageRoutes, Region};
use nsim_ir::activity::StepActivity;
use nsim_ir::base::id::{ChannelId, CoreId, Id};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::groups::Kind;

/// A message that is ready at its sender.
#[derive(Debug, Clone, Copy)]
struct Ready {
    /// Time since the sender's previous message was sent.
    after: u64,
    /// The receiving core.
    to: u32,
    /// Handling time at the receiver.
    handling: u64,
}

impl Ready {
    fn new(after: u64, to: usize, message: &Message, table: &CostTable) -> Self {
        Ready { after, to: to as u32, handling: message.handling(table) }
    }
}

/// One message of occupancy, in fixed point, so that subtraction exactly undoes addition.
const MESSAGE: u64 = 1 << 32;

/// Memory of the queue. Between steps a number is 0 unless `Queue::prepare` rewrites it.
#[derive(Debug, Clone, Default)]
pub struct QueueMemory {
    /// Occupancy of each link between tiles, in parts of a [`MESSAGE`].
    occupied: Vec<u64>,
    /// Occupancy of each sender's link into its router, in these parts.
    leaving: Vec<u64>,
    /// Time at which each link can take the next message.
    free: Vec<u64>,
    /// Time at which each core has handled its messages.
    done: Vec<u64>,
    /// Time of receipt, sender, receiver, handling.
    under_way: BinaryHeap<Reverse<(u64, u32, u32, u64)>>,
    /// Messages of each sender, and its busy time after the last one.
    senders: Vec<(Vec<Ready>, u64)>,
    /// Handling times by receiver.
    received: Vec<u64>,
    /// Time of the visits of each core.
    visits: Vec<u64>,
    /// Core, slot, and slots of the core, of each compartment that fired; and its number.
    fired: Vec<((CoreId, u32, u32), usize)>,
    /// Time of the visits so far, by core.
    passed: Vec<u64>,
    /// The next message of each sender.
    next: BinaryHeap<Reverse<(u64, usize, usize)>>,
}

/// Replaces the contents by `size` zeros.
fn zeros(numbers: &mut Vec<u64>, size: usize) {
    numbers.clear();
    numbers.resize(size, 0);
}

/// Messages in flight in one step.
pub(super) struct Queue<'w> {
    routes: &'w MessageRoutes,
    region: &'w Region,
    table: &'w CostTable,
    memory: &'w mut QueueMemory,
    /// Sum of the handling times of the messages in flight.
    handling: u128,
}

impl<'w> Queue<'w> {
    pub(super) fn new(
        routes: &'w MessageRoutes,
        region: &'w Region,
        table: &'w CostTable,
        memory: &'w mut QueueMemory,
    ) -> Self {
        for (numbers, size) in [
            (&mut memory.occupied, region.links()),
            (&mut memory.leaving, region.tiles.len()),
            (&mut memory.free, region.links()),
            (&mut memory.done, region.cores),
        ] {
            numbers.resize(numbers.len().max(size), 0);
        }
        Queue { routes, region, table, memory, handling: 0 }
    }

    /// Whether each input spike but the last is handled, and its links are free, when the next
    /// enters. Then input spikes never meet, and all but the last are handled before a core begins.
    /// Sufficient: all enter by one port, each with at most one message, whose time through the
    /// empty mesh is at most the least time between two spikes.
    fn inputs_never_meet(&self, step: &StepActivity, injection: u64, most: u64) -> bool {
        let (routes, region, table) = (self.routes, self.region, self.table);
        let interval = injection / most.max(1);
        let mut spikes = 0;
        let free = table.link_time.0.max(table.link_chip_time.0) <= interval;
        if let Some(times) = routes.input_times(table) {
            let soon =
                |channel: &ChannelId| times.channels[channel.index()].is_none_or(|time| time.through <= interval);
            let all_soon = || times.longest <= interval || step.channels.iter().all(soon);
            return free && step.channels.len() as u64 == most && all_soon();
        }
        free && region.groups.iter().all(|&(kind, first)| {
            let Kind { cores, channels, .. } = &routes.kinds[kind].kind;
            step.channels.iter().filter(|channel| channels.contains(&channel.0)).all(|channel| {
                spikes += 1;
                match routes.inputs.get(channel.index()) {
                    [] => true,
                    [message] => {
                        let (_, route) = region.entries[first + message.core.index() - cores.start as usize];
                        route_time(route, table).0.saturating_add(message.handling(self.table)) <= interval
                    }
                    _ => false,
                }
            })
        }) && spikes == most
    }

    /// Writes the messages of each sender into the memory, in order, and its busy time after the
    /// last one. With `skip`, input messages that are over when cores begin
    /// ([`Queue::inputs_never_meet`]) are skipped; their handling is summed by receiver.
    ///
    /// The k-th input spike of a chip enters the mesh after k / n of the injection time. There are
    /// n = `most` spikes at the chip with most of them. Cores begin when all spikes are injected.
    fn prepare(&mut self, step: &StepActivity, injection: u64, most: u64, skip: bool) {
        let region = self.region;
        let skipped = if skip && self.inputs_never_meet(step, injection, most) { u128::from(most) - 1 } else { 0 };
        let QueueMemory { senders, received, .. } = &mut *self.memory;
        senders.resize_with(region.tiles.len().max(senders.len()), Default::default);
        for (messages, after) in senders.iter_mut() {
            messages.clear();
            *after = 0;
        }
        zeros(received, region.cores);
        match self.routes.input_times(self.table).filter(|_| skipped > 0) {
            Some(times) => self.prepare_last_input(times, step, injection),
            None => self.prepare_inputs(step, injection, most, skipped),
        }
        let senders = &mut self.memory.senders;
        senders[region.cores..].iter_mut().for_each(|(_, passed)| *passed = 0);
        senders[..region.cores].iter_mut().for_each(|(_, after)| *after = injection);
        self.prepare_cores(step);
    }

    /// Writes the messages of the last input spike; handling of all others is summed by receiver.
    fn prepare_last_input(&mut self, times: &InputTimes, step: &StepActivity, injection: u64) {
        let QueueMemory { senders, received, .. } = &mut *self.memory;
        let Some((last, before)) = step.channels.split_last() else { return };
        for time in before.iter().filter_map(|channel| times.channels[channel.index()]) {
            received[time.to as usize] += time.handling;
        }
        for message in self.routes.inputs.get(last.index()) {
            let to = message.core.index();
            senders[self.region.port(to)].0.push(Ready::new(injection, to, message, self.table));
        }
    }

    /// Writes messages of input spikes at their ports; a chip's first `skipped` are summed.
    fn prepare_inputs(&mut self, step: &StepActivity, injection: u64, most: u64, skipped: u128) {
        let (routes, region, table) = (self.routes, self.region, self.table);
        let QueueMemory { senders, received, .. } = &mut *self.memory;
        // Chips are served in parallel: a spike counts at the port of its first message.
        let mut spikes = vec![0u128; region.tiles.len() - region.cores + 1];
        let mut ports = region.ports(routes, step);
        for &(kind, first) in &region.groups {
            let Kind { cores, channels, .. } = &routes.kinds[kind].kind;
            for channel in step.channels.iter().filter(|channel| channels.contains(&channel.0)) {
                let number = &mut spikes[ports.next().expect("a port for each spike")];
                *number += 1;
                if *number <= skipped {
                    for message in routes.inputs.get(channel.index()) {
                        received[first + message.core.index() - cores.start as usize] += message.handling(table);
                    }
                    continue;
                }
                let now = (u128::from(injection) * *number / u128::from(most)) as u64;
                for message in routes.inputs.get(channel.index()) {
                    let to = first + message.core.index() - cores.start as usize;
                    // Between messages, a port's busy time stores the time so far.
                    let (messages, passed) = &mut senders[region.port(to)];
                    // A copy's spike for another chip may come after later spikes of that chip.
                    let until = now.max(*passed);
                    messages.push(Ready::new(until - std::mem::replace(passed, until), to, message, table));
                }
            }
        }
    }

    /// Writes the messages of spikes of cores, which visit their compartments in slot order; a
    /// visit takes the mean time of the visits on its core.
    fn prepare_cores(&mut self, step: &StepActivity) {
        let (routes, region, table) = (self.routes, self.region, self.table);
        let QueueMemory { senders, visits, fired, passed, .. } = &mut *self.memory;
        visits.clear();
        visits.extend(step.cores.iter().map(|core| {
            let [updates, microcode] = update_terms(core, table);
            times(&[updates, microcode, (table.compartment_active_time, core.active - core.stated_active)]).0
        }));
        fired.clear();
        fired.extend(step.fired.iter().map(|c| (routes.seats[c.index()], c.index())));
        fired.sort_unstable();
        zeros(passed, region.cores);
        for &(kind, first) in &region.groups {
            let Kind { cores, .. } = &routes.kinds[kind].kind;
            let begin = fired.partition_point(|((core, ..), _)| core.0 < cores.start);
            for &((core, slot, slots), compartment) in
                fired[begin..].iter().take_while(|((core, ..), _)| core.0 < cores.end)
            {
                let until = (u128::from(visits[core.index()]) * u128::from(slot + 1) / u128::from(slots.max(1))) as u64;
                let from = first + core.index() - cores.start as usize;
                let sender = &mut senders[from];
                // The time of a spike without messages delays the next message.
                sender.1 += until - std::mem::replace(&mut passed[from], until) + table.spike_time.0;
                for message in routes.spikes.get(compartment) {
                    let to = first + message.core.index() - cores.start as usize;
                    let after = std::mem::take(&mut sender.1) + table.axon_out_time.0;
                    sender.0.push(Ready::new(after, to, message, table));
                }
            }
            for core in cores.clone() {
                let at = first + (core - cores.start) as usize;
                senders[at].1 += visits[core as usize] - passed[at];
            }
        }
    }

    /// Removes the messages received by `now` from the mesh.
    fn advance(&mut self, now: u64) {
        while let Some(&Reverse((received, from, to, handling))) = self.memory.under_way.peek()
            && received <= now
        {
            self.memory.under_way.pop();
            self.handling -= u128::from(handling);
            let region = self.region;
            let (from, to) = (from as usize, to as usize);
            let path = region.path(from, to);
            let part = MESSAGE / (path.iter().map(|links| links.len() as u64).sum::<u64>() + 2);
            self.memory.leaving[from] -= part;
            path.into_iter().for_each(|links| self.memory.occupied[links].iter_mut().for_each(|here| *here -= part));
        }
    }

    /// Sends a message at `now`; returns the times at which sender and receiver are done.
    fn send(&mut self, now: u64, from: usize, message: Ready) -> (u64, u64) {
        let (region, table, to) = (self.region, self.table, message.to as usize);
        let QueueMemory { occupied, leaving, free, done, under_way, .. } = &mut *self.memory;
        let (route, path) = (region.route(from, to), region.path(from, to));
        // The sender's link into its router, then the links between tiles.
        let links = path.iter().map(|links| links.len() as u64).sum::<u64>() + 1;
        let part = MESSAGE / (links + 1);
        let mut along = u128::from(leaving[from]);
        leaving[from] += part;
        for links in path.clone() {
            // Halves are summed in 64 bits, so that the loop vectorises.
            let (mut high, mut low) = (0, 0);
            for here in &mut occupied[links] {
                (high, low) = (high + (*here >> 32), low + (*here & u64::from(u32::MAX)));
                *here += part;
            }
            along += (u128::from(high) << 32) + u128::from(low);
        }
        let mean = quotient(self.handling, (under_way.len() as u64).max(1));
        // A route holds its links' buffers of messages; messages beyond that are received first.
        let beyond = along.saturating_sub(u128::from(links) * u128::from(table.link_buffer) * u128::from(MESSAGE));
        let leaves = now.saturating_add((beyond * mean / u128::from(MESSAGE)) as u64);
        let congested = quotient(along * mean / u128::from(MESSAGE), links) as u64;
        // Each link passes messages sequentially, in the order of this function's calls. A stalled
        // message takes its turn at `now`: one at `leaves` would block those that leave before it.
        // A sender's own link is as fast as the sender.
        let mut at = now;
        for links in path {
            for (free, &between) in free[links.clone()].iter_mut().zip(&region.between[links]) {
                at = at.max(*free);
                *free = at + if between { table.link_chip_time.0 } else { table.link_time.0 };
            }
        }
        let waited = at.saturating_sub(leaves);
        let way = (route_time(route, table).0 + waited).max(congested);
        let received = done[to].max(leaves.saturating_add(way));
        done[to] = received.saturating_add(message.handling);
        under_way.push(Reverse((received, from as u32, message.to, message.handling)));
        self.handling += u128::from(message.handling);
        (leaves, done[to])
    }

    /// Returns the busiest core's own time and the time that the mesh adds, both from the end of
    /// the injection. Every message is simulated unless `skip`.
    pub(super) fn run(
        mut self,
        step: &StepActivity,
        injection: Picoseconds,
        most: u64,
        skip: bool,
    ) -> (Picoseconds, Picoseconds) {
        self.prepare(step, injection.0, most, skip);
        let senders = std::mem::take(&mut self.memory.senders);
        let mut next = std::mem::take(&mut self.memory.next);
        let received = &mut self.memory.received;
        let mut alone = 0;
        for (number, (messages, after)) in senders.iter().enumerate() {
            let time = messages.iter().map(|message| message.after).sum::<u64>() + after;
            if number < self.region.cores {
                alone = alone.max(time.saturating_sub(injection.0));
            }
            messages.iter().for_each(|message| received[message.to as usize] += message.handling);
        }
        alone = alone.max(received.iter().copied().max().unwrap_or(0));
        // Each sender's next message, the earliest first; on a tie the lower sender.
        let mut last = 0;
        for (sender, (messages, after)) in senders.iter().enumerate() {
            match messages.first() {
                Some(first) => next.push(Reverse((first.after, sender, 0))),
                None => last = last.max(*after),
            }
        }
        while let Some(Reverse((mut now, sender, mut number))) = next.pop() {
            let (messages, after) = &senders[sender];
            // A sender continues while no other sender is earlier.
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
        (self.memory.senders, self.memory.next) = (senders, next);
        self.clear();
        // Messages handled before the end of the injection add no time.
        let took = last.saturating_sub(injection.0);
        (Picoseconds(alone.min(took)), Picoseconds(took.saturating_sub(alone)))
    }

    fn clear(&mut self) {
        let QueueMemory { occupied, leaving, free, done, under_way, .. } = &mut *self.memory;
        [occupied, leaving, free, done].into_iter().for_each(|numbers| numbers.fill(0));
        under_way.clear();
    }
}

/// Divides; dividends mostly fit into 64 bits, where division is several times faster.
fn quotient(dividend: u128, divisor: u64) -> u128 {
    u64::try_from(dividend).map_or_else(|_| dividend / u128::from(divisor), |small| (small / divisor).into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::constants::tests::{preset, table};
    use crate::transport::tests::{routes, step};
    use nsim_ir::base::rng;

    #[test]
    fn what_enters_the_mesh_leaves_it() {
        let sana = table("sanafe-calibrated");
        let list: Vec<&[(u32, u32)]> = vec![&[(0, 5), (1, 3), (2, 9)]; 10];
        let routes = routes(&[(7, 3), (3, 2), (0, 0)], &list, &[&[] as &[_]; 30]);
        let mut memory = QueueMemory::default();
        let mut queue = Queue::new(&routes, &routes.regions[0], &sana, &mut memory);
        queue.prepare(&step(3, &(0..10).collect::<Vec<_>>(), &[]), 0, 10, false);
        let messages = queue.memory.senders[3].0.clone();
        for (at, message) in messages.iter().enumerate() {
            queue.send(at as u64 * 10, 3, *message);
        }
        assert!(queue.memory.occupied.iter().any(|&part| part > 0) && queue.handling > 0);
        queue.advance(u64::MAX);
        assert!(queue.memory.occupied.iter().all(|&part| part == 0) && queue.handling == 0);
        queue.clear();
        let QueueMemory { occupied, leaving, free, done, under_way, .. } = &memory;
        assert!([occupied, leaving, free, done].iter().all(|numbers| numbers.iter().all(|&number| number == 0)));
        assert!(under_way.is_empty());
    }

    #[test]
    fn a_stalled_message_does_not_block_its_links() {
        let mut constants = preset("sanafe-calibrated");
        constants.link_buffer.value = 1.0.into();
        let table = CostTable::new(&constants).unwrap();
        let routes = routes(&[(0, 0), (1, 0), (0, 0), (1, 0)], &[], &[]);
        let mut memory = QueueMemory::default();
        let mut queue = Queue::new(&routes, &routes.regions[0], &table, &mut memory);
        let handling = 776_000;
        let left: Vec<u64> = (0..8).map(|_| queue.send(0, 0, Ready { after: 0, to: 1, handling }).0).collect();
        // Seven before the last have a third of a message on each of two links, where two fit.
        assert!(left[7].abs_diff(handling * 8 / 3) < 10, "{left:?}");
        // Another core's message over the same link: eight thirds before it, where two fit.
        let (left, done) = queue.send(0, 2, Ready { after: 0, to: 3, handling: 0 });
        assert!(left.abs_diff(handling * 2 / 3) < 10, "{left}");
        assert!(done.abs_diff(handling * 2) < 10, "{done}");
    }

    #[test]
    fn inputs_that_never_meet_may_be_skipped() {
        let sana = table("sanafe-calibrated");
        let draw = |below: u64, k: u64| rng::below(below, 78, k, 0) as u32;
        let (mut skipped, mut simulated) = (0, 0);
        for seed in 0..400 {
            let key = |k: u64| 1_000 * seed + k;
            let cores = 1 + draw(3, key(0));
            let tiles: Vec<(u32, u32)> =
                (0..u64::from(cores)).map(|core| (draw(8, key(1 + core)), draw(4, key(5 + core)))).collect();
            let list = |from: u64, most: u64| -> Vec<(u32, u32)> {
                let messages = u64::from(draw(most, key(10 + 4 * from)));
                (0..messages)
                    .map(|k| (draw(cores.into(), key(11 + 4 * from + k)), draw(60, key(12 + 4 * from + k))))
                    .collect()
            };
            let lists: Vec<Vec<(u32, u32)>> = (0..12).map(|from| list(from, 2 + u64::from(seed % 9 == 0))).collect();
            let inputs: Vec<&[(u32, u32)]> = lists.iter().map(Vec::as_slice).collect();
            let lists: Vec<Vec<(u32, u32)>> = (12..12 + 10 * u64::from(cores)).map(|from| list(from, 3)).collect();
            let spikes: Vec<&[(u32, u32)]> = lists.iter().map(Vec::as_slice).collect();
            let routes = routes(&tiles, &inputs, &spikes);
            let sampled =
                |of: u32, k: u64| (0..of).filter(|&i| draw(3, key(k + u64::from(i))) == 0).collect::<Vec<_>>();
            let step = step(cores as usize, &sampled(12, 500), &sampled(10 * cores, 600));
            let injection = Picoseconds(u64::from(draw(3_000_000, key(700))));
            let most = routes.regions[0].most_spikes(&routes, &step).max(1);
            let mut memory = QueueMemory::default();
            let region = &routes.regions[0];
            let skips =
                Queue::new(&routes, region, &sana, &mut memory).inputs_never_meet(&step, injection.0, most) && most > 1;
            (skipped, simulated) = (skipped + u32::from(skips), simulated + u32::from(!skips));
            let mut time = |skip| Queue::new(&routes, region, &sana, &mut memory).run(&step, injection, most, skip);
            assert_eq!(time(true), time(false), "{seed}");
        }
        assert!(skipped > 50 && simulated > 50, "{skipped} {simulated}");
    }
}
