//! Delivery by rows of weights.
//!
//! Input: spikes, and the rows of their sources. Output: sums of weights, the skip blocks that they
//! lie in, and the number of synaptic events.
//!
//! Spikes of one position in several channels are a *group*: they add rows of equal lengths to
//! equal lanes. Spikes in lane order have their groups together; input spikes are sorted. Where a
//! step has several spikes a group, their sums stay in registers while the weights of all of them
//! are added. Otherwise each row is added separately.

use crate::deliver::accumulate::{Accumulate, add_weights};
use crate::lanes::kernel::LANES;
use crate::layout::shard::SKIP_BLOCK;
use crate::layout::weight_rows::{RowPlace, RowTable, Stencil, UNCHECKED_ROWS};
use crate::prefetch::prefetch;
use nsim_ir::spikes::Spike;

/// Least average number of spikes of a group for which they are added together.
const GROUPED_SPIKES: usize = 2;

/// Delivery of spikes by rows of one delay.
#[derive(Debug)]
pub(crate) struct RowDelivery<'a, S, P> {
    /// Number of lanes of the shard.
    pub lanes: usize,
    /// Sums by lane, and beyond, where the last chunk of a row may add zeros.
    pub sums: &'a mut [S],
    /// 1 for a skip block with arrivals; empty if they are not marked.
    pub marks: &'a mut [u8],
    /// The rows of each source.
    pub table: &'a RowTable,
    pub spikes: &'a [P],
    /// Scratch memory.
    pub queue: &'a mut Vec<RowPlace>,
}

impl<S: Accumulate<P::Payload>, P: Spike> RowDelivery<'_, S, P> {
    /// Adds the rows of weights of each spike; returns the number of their synapses.
    pub fn run(self, arch: pulp::Arch) -> u64 {
        arch.dispatch(Dispatched(self))
    }
}

/// A delivery in the form that `pulp` runs with the processor's vectors. It has a function of its
/// own, so that the compiled step has none of its code.
struct Dispatched<'a, S, P>(RowDelivery<'a, S, P>);

impl<S: Accumulate<P::Payload>, P: Spike> pulp::NullaryFnOnce for Dispatched<'_, S, P> {
    type Output = u64;

    #[inline(always)]
    fn call(self) -> u64 {
        let (Dispatched(mut delivery), mut payloads) = (self, Vec::new());
        let (mut events, mut groups) = (0, [0; AT_A_TIME]);
        let RowDelivery { table, spikes, .. } = delivery;
        let first = &spikes[..spikes.len().min(AT_A_TIME)];
        let by_runs = find_groups(table, first, &mut groups) * GROUPED_SPIKES > first.len();
        let sorted = (by_runs && table.groups * GROUPED_SPIKES <= spikes.len()).then(|| by_group(table, spikes));
        for spikes in sorted.as_deref().unwrap_or(spikes).chunks(AT_A_TIME) {
            let groups = &mut groups[..spikes.len()];
            events += match find_groups(table, spikes, groups) * GROUPED_SPIKES <= spikes.len() {
                true => delivery.deliver_together(spikes, groups),
                false => delivery.deliver_queued(spikes, &mut payloads),
            };
        }
        events
    }
}

impl<S: Accumulate<P::Payload>, P: Spike> RowDelivery<'_, S, P> {
    /// Marks the skip blocks of these lanes.
    #[inline(always)]
    fn mark(&mut self, lanes: std::ops::Range<usize>) {
        if !self.marks.is_empty() {
            // Zeros beyond the last lane may lie in a skip block that does not exist.
            let (first, last) = (lanes.start / SKIP_BLOCK, (lanes.end.min(self.lanes) - 1) / SKIP_BLOCK);
            (self.marks[first], self.marks[last]) = (1, 1);
            // Most rows lie in at most two skip blocks, which need no call.
            if last > first + 1 {
                self.marks[first + 1..last].fill(1);
            }
        }
    }

    /// Adds the rows of each spike separately.
    // A loop over the few rows of each spike would end in a mispredicted branch, so rows of many
    // spikes are queued.
    #[inline(always)]
    fn deliver_queued(&mut self, spikes: &[P], payloads: &mut Vec<P::Payload>) -> u64 {
        let (rows, synapses) = enqueue_rows(self.table, spikes, (self.queue, payloads));
        for (at, &payload) in payloads[..rows].iter().enumerate() {
            self.add_row(self.queue[at], payload);
        }
        synapses
    }

    #[inline(always)]
    fn add_row(&mut self, place: RowPlace, payload: P::Payload) {
        let (lane, weights) = (place.lane(), self.table.rows.weights(place.row()));
        let end = lane + weights.len() * LANES;
        let (sums, _) = self.sums[lane..end].as_chunks_mut::<LANES>();
        for (sums, weights) in sums.iter_mut().zip(weights) {
            add_weights(std::array::from_mut(sums), std::array::from_ref(weights), payload);
        }
        self.mark(lane..end);
    }

    /// Adds the rows of these spikes, at most [`AT_A_TIME`], group by group.
    #[inline(always)]
    fn deliver_together(&mut self, spikes: &[P], groups: &[u32]) -> u64 {
        let (table, mut firsts, mut events) = (self.table, [0; AT_A_TIME], 0);
        for (first, spike) in firsts.iter_mut().zip(spikes) {
            let stencil = table.stencils[table.origins[spike.source()].stencil as usize];
            *first = stencil.first;
            events += u64::from(stencil.synapses);
        }
        let mut first = 0;
        for group in groups.chunk_by(|a, b| a == b) {
            let of_group = first..first + group.len();
            first = of_group.end;
            let origin = table.origins[spikes[of_group.start].source()];
            let spikes = (&firsts[of_group.clone()], &spikes[of_group]);
            let Stencil { first: stencil, rows, .. } = table.stencils[origin.stencil as usize];
            for row in 0..rows as usize {
                let place = table.places[stencil as usize + row];
                let (lane, chunks) = (origin.lane as usize + place.lane(), place.row().range().len());
                for done in (0..chunks).step_by(8) {
                    let at = (lane + done * LANES, row, done);
                    match chunks - done {
                        1 => self.add_together::<1>(spikes, at),
                        2 => self.add_together::<2>(spikes, at),
                        3 => self.add_together::<3>(spikes, at),
                        4 => self.add_together::<4>(spikes, at),
                        5 => self.add_together::<5>(spikes, at),
                        6 => self.add_together::<6>(spikes, at),
                        7 => self.add_together::<7>(spikes, at),
                        _ => self.add_together::<8>(spikes, at),
                    }
                }
                self.mark(lane..lane + chunks * LANES);
            }
        }
        events
    }

    /// Adds N chunks of a row of each of these spikes, from chunk `done` on, to lanes from `lane`.
    #[inline(always)]
    fn add_together<const N: usize>(
        &mut self,
        (firsts, spikes): (&[u32], &[P]),
        (lane, row, done): (usize, usize, usize),
    ) {
        let Some(sums) = self.sums[lane..].as_chunks_mut::<LANES>().0.first_chunk_mut::<N>() else { return };
        let (places, weights) = (&self.table.places[row..], &self.table.rows.all()[done..]);
        let mut kept = *sums;
        for (&first, spike) in firsts.iter().zip(spikes) {
            let row = places[first as usize].row().range();
            let weights = weights[row.start..].first_chunk::<N>().expect("rows of a group are as long");
            add_weights(&mut kept, weights, spike.payload());
        }
        *sums = kept;
    }
}

/// Returns these spikes sorted by group.
#[inline(always)]
fn by_group<P: Spike>(table: &RowTable, spikes: &[P]) -> Vec<P> {
    let group = |spike: &P| table.origins[spike.source()].group as usize;
    let mut places = vec![0u32; table.groups];
    spikes.iter().for_each(|spike| places[group(spike)] += 1);
    let mut end = 0;
    for place in &mut places {
        end += std::mem::replace(place, end);
    }
    let mut sorted = spikes.to_vec();
    for spike in spikes {
        let place = &mut places[group(spike)];
        sorted[*place as usize] = *spike;
        *place += 1;
    }
    sorted
}

/// Finds the group of each of these spikes; returns the number of runs of equal groups.
#[inline(always)]
fn find_groups<P: Spike>(table: &RowTable, spikes: &[P], groups: &mut [u32]) -> usize {
    let (mut count, mut last) = (0, None);
    for (index, (spike, group)) in spikes.iter().zip(groups).enumerate() {
        if let Some(spike) = spikes.get(index + PREFETCH_SPIKES[0]) {
            prefetch(&table.origins, spike.source());
        }
        *group = table.origins[spike.source()].group;
        count += usize::from(Some(*group) != last);
        last = Some(*group);
    }
    count
}

/// Number of spikes whose rows are delivered together.
const AT_A_TIME: usize = 512;

/// Prefetch distances in spikes: of a source's origin, of its stencil, and of the stencil's rows.
/// Each gives the address of the next.
const PREFETCH_SPIKES: [usize; 3] = [24, 16, 8];

/// Queues the rows of these spikes, with their payloads; returns the numbers of rows and of
/// synapses.
#[inline(always)]
fn enqueue_rows<P: Spike>(
    table: &RowTable,
    spikes: &[P],
    (queue, payloads): (&mut Vec<RowPlace>, &mut Vec<P::Payload>),
) -> (usize, u64) {
    let (mut end, mut events) = (0, 0);
    for (index, spike) in spikes.iter().enumerate() {
        let far = PREFETCH_SPIKES.map(|ahead| spikes.get(index + ahead));
        if let Some(spike) = far[0] {
            prefetch(&table.origins, spike.source());
        }
        if let Some(spike) = far[1] {
            table.prefetch_stencil(table.origins[spike.source()]);
        }
        if let Some(spike) = far[2] {
            table.prefetch_rows(table.origins[spike.source()]);
        }
        let origin = table.origins[spike.source()];
        let (stencil, places, rows) = table.stencil(origin);
        events += u64::from(stencil.synapses);
        if queue.len() < end + places.len() {
            queue.resize(2 * (end + places.len()), places[0]);
        }
        if payloads.len() < end + places.len() {
            payloads.resize(2 * (end + places.len()), spike.payload());
        }
        if let (Some(queued), Some(unchecked)) =
            (queue[end..].first_chunk_mut::<UNCHECKED_ROWS>(), places.first_chunk::<UNCHECKED_ROWS>())
        {
            *queued = unchecked.map(|place| place.after(origin.lane));
        }
        if let Some(payloads) = payloads[end..].first_chunk_mut::<UNCHECKED_ROWS>() {
            *payloads = [spike.payload(); UNCHECKED_ROWS];
        }
        if rows > UNCHECKED_ROWS {
            let others = queue[end + UNCHECKED_ROWS..end + rows].iter_mut().zip(&places[UNCHECKED_ROWS..]);
            others.for_each(|(queued, place)| *queued = place.after(origin.lane));
            payloads[end + UNCHECKED_ROWS..end + rows].fill(spike.payload());
        }
        end += rows;
    }
    (end, events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lanes::kernel::Sum;
    use crate::layout::weight_rows::table;
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;
    use nsim_ir::spikes::GradedSpike;

    const POSITIONS: u64 = 30;
    const CHANNELS: u64 = 12;

    /// Sums, marks and numbers of synapses are equal for delivery by groups, by single rows and by
    /// single synapses.
    fn compare<P: Spike, S: Sum + Accumulate<P::Payload>>(spike: impl Fn(usize) -> P) {
        let lanes = 64 * 24;
        // Each channel has its own weights, and its rows begin 33 lanes later at each position.
        // Every fifth channel's second row is shorter, so that it belongs to another group.
        let weight = |row: u64, at| rng::below(255, 1, row, at) as i16 - 127;
        let rows: Vec<Vec<i16>> = (0..2 * CHANNELS)
            .map(|row| {
                let long = if row % 2 == 1 && row % 5 == 0 { 40 } else { 60 + 90 * (row % 2) };
                (0..long).map(|at| weight(row, at)).collect()
            })
            .collect();
        let sources: Vec<Vec<(usize, u32)>> = (0..CHANNELS * POSITIONS)
            .map(|source| {
                let (channel, position) = ((source / POSITIONS) as usize, (source % POSITIONS) as u32);
                let first = 33 * position;
                let all = [(2 * channel, first), (2 * channel + 1, first + 100)];
                all[..if position == 7 { 0 } else { 1 + 2 * channel / CHANNELS as usize }].to_vec()
            })
            .collect();
        let table = table(&rows, &sources);
        let of_positions = |sources: std::ops::Range<u64>| {
            let number = |at| (at % CHANNELS * POSITIONS + at / CHANNELS) as usize;
            sources.map(number).collect::<Vec<usize>>()
        };
        let all = CHANNELS * POSITIONS;
        for (numbers, are_long) in [
            (of_positions(0..all), true),
            (of_positions(all / 2..all), true),
            ((0..all as usize).collect(), false),
            ((0..all as usize).step_by(7).collect(), false),
        ] {
            let spikes: Vec<P> = numbers.iter().map(|&source| spike(source)).collect();
            let mut groups = vec![0; spikes.len()];
            assert_eq!(find_groups(&table, &spikes, &mut groups) * GROUPED_SPIKES <= spikes.len(), are_long);
            let (sorted, mut of_sorted) = (by_group(&table, &spikes), groups.clone());
            assert!(find_groups(&table, &sorted, &mut of_sorted) <= table.groups);
            let mut sums = [(); 4].map(|()| vec![S::default(); lanes + LANES]);
            let mut marks = [(); 4].map(|()| vec![0; lanes / SKIP_BLOCK]);
            let [together, queued, delivered, obvious] = sums.each_mut().map(Vec::as_mut_slice);
            let [of_together, of_queued, of_delivered, _] = marks.each_mut().map(Vec::as_mut_slice);
            let (mut queues, table) = ([(); 3].map(|()| Vec::new()), &table);
            let [queue, of_queue, last] = &mut queues;
            let spikes = spikes.as_slice();
            let delivery = |sums, marks, queue| RowDelivery { lanes, sums, marks, table, spikes, queue };
            let synapses = delivery(delivered, of_delivered, queue).run(pulp::Arch::new());
            assert_eq!(delivery(together, of_together, of_queue).deliver_together(spikes, &groups), synapses);
            assert_eq!(delivery(queued, of_queued, last).deliver_queued(spikes, &mut Vec::new()), synapses);
            let mut count = 0;
            for (spike, &source) in spikes.iter().zip(&numbers) {
                for &(row, lane) in &sources[source] {
                    for (sum, &weight) in obvious[lane as usize..].iter_mut().zip(&rows[row]) {
                        *sum = sum.accumulate(weight, spike.payload());
                        count += 1;
                    }
                }
            }
            assert_eq!(count, synapses);
            let obvious = &sums[3];
            assert!(obvious.iter().any(|sum| *sum != S::default()));
            assert!(sums.iter().all(|sums| sums == obvious));
            assert!(marks[..3].iter().all(|of| *of == marks[0]) && marks[0].contains(&1) && marks[0].contains(&0));
        }
    }

    #[test]
    fn rows_of_groups_are_those_of_each_spike() {
        let graded = |bits: u32| {
            move |source: usize| {
                let payload = rng::below(1 << bits, 3, source as u64, 0) as i32 - (1 << (bits - 1));
                GradedSpike { id: ChannelId::new(source), payload }
            }
        };
        compare::<ChannelId, i32>(ChannelId::new);
        compare::<ChannelId, i16>(ChannelId::new);
        compare::<_, i32>(graded(12));
        compare::<_, i64>(graded(24));
    }
}
