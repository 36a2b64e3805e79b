//! Delivery by rows of weights.
//!
//! Input: spikes, and the rows of their sources. Output: sums of weights, the skip blocks that they
//! lie in, and the number of synaptic events.
//!
//! Spikes of one position, from channel to channel, add rows of the same lengths to the same lanes.
//! Where a step has several spikes a position, their sums stay in registers while the weights of
//! all of them are added; else each row is added for itself.

use crate::deliver::accumulate::{Accumulate, add_weights};
use crate::deliver::prefetch::prefetch;
use crate::layout::shard::SKIP_BLOCK;
use crate::layout::weight_rows::{Origin, RowPlace, RowTable, Stencil, UNCHECKED};
use crate::update::kernel::{LANES, Sum};
use nsim_ir::spikes::Spike;

/// Scratch memory.
#[derive(Debug, Default)]
pub(crate) struct RowScratch {
    queue: Vec<RowPlace>,
    groups: Groups,
}

impl RowScratch {
    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let Groups { counts, found, members } = &self.groups;
        let groups = 4 * (counts.capacity() + found.capacity()) + size_of::<Member>() * members.capacity();
        size_of::<RowPlace>() * self.queue.capacity() + groups
    }
}

/// Spikes by the group of their source.
#[derive(Debug, Default)]
struct Groups {
    /// By group, its spikes; all 0 between deliveries.
    counts: Vec<u32>,
    /// Groups with spikes.
    found: Vec<u32>,
    /// Spikes, group by group.
    members: Vec<Member>,
}

/// A spike of a group.
#[derive(Debug, Clone, Copy, Default)]
struct Member {
    /// The place of its first row.
    row: u32,
    /// Its number.
    spike: u32,
}

/// Spikes a group on average from which on they are added together.
const TOGETHER: usize = 3;

impl Groups {
    /// Finds the groups of these spikes, and sorts the spikes by group if that pays. Returns
    /// whether, and the number of their synapses.
    #[inline(always)]
    fn find<P: Spike>(&mut self, table: &RowTable, spikes: &[P]) -> Option<u64> {
        let Groups { counts, found, members } = self;
        if counts.len() < table.groups {
            counts.resize(table.groups, 0);
        }
        found.clear();
        for spike in spikes {
            let group = table.origins[spike.source()].group;
            let count = &mut counts[group as usize];
            if *count == 0 {
                found.push(group);
            }
            *count += 1;
        }
        if found.len() * TOGETHER > spikes.len() {
            found.iter().for_each(|&group| counts[group as usize] = 0);
            return None;
        }
        // Where the next spike of each group comes.
        let mut end = 0;
        for &group in found.iter() {
            let count = &mut counts[group as usize];
            end += std::mem::replace(count, end);
        }
        members.resize(spikes.len(), Member::default());
        let mut synapses = 0;
        for (spike, number) in spikes.iter().zip(0..) {
            let Origin { stencil, group, .. } = table.origins[spike.source()];
            let stencil = table.stencils[stencil as usize];
            let next = &mut counts[group as usize];
            members[*next as usize] = Member { row: stencil.first, spike: number };
            *next += 1;
            synapses += u64::from(stencil.synapses);
        }
        Some(synapses)
    }
}

/// The sums and marked skip blocks that rows of one delay add to.
#[derive(Debug)]
pub(crate) struct RowSums<'r, S> {
    /// Lanes of the shard.
    pub lanes: usize,
    /// By lane, and beyond: the last chunk of a row may reach there, where it adds zeros.
    pub sums: &'r mut [S],
    /// By skip block: 1 with arrivals.
    pub marks: &'r mut [u8],
}

impl<S: Sum> RowSums<'_, S> {
    /// Marks the skip blocks of these lanes.
    #[inline(always)]
    fn mark(&mut self, lanes: std::ops::Range<usize>) {
        // Zeros beyond the last lane may lie in a skip block that does not exist.
        self.marks[lanes.start / SKIP_BLOCK..lanes.end.min(self.lanes).div_ceil(SKIP_BLOCK)].fill(1);
    }

    /// Adds the rows of weights of each spike.
    #[inline(always)]
    pub fn deliver<const MARK: bool, P: Spike>(
        &mut self,
        table: &RowTable,
        spikes: &[P],
        scratch: &mut RowScratch,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        // Adding few binary spikes takes less time than finding their groups.
        if P::BINARY && spikes.len() < TOGETHER * table.groups {
            return self.deliver_queued::<MARK, P>(table, spikes, &mut scratch.queue);
        }
        match scratch.groups.find(table, spikes) {
            Some(synapses) => {
                self.deliver_together::<MARK, P>(table, spikes, &mut scratch.groups);
                synapses
            }
            None => self.deliver_queued::<MARK, P>(table, spikes, &mut scratch.queue),
        }
    }

    /// Adds the rows of spikes group by group.
    #[inline(always)]
    fn deliver_together<const MARK: bool, P: Spike>(&mut self, table: &RowTable, spikes: &[P], groups: &mut Groups)
    where
        S: Accumulate<P::Payload>,
    {
        let Groups { counts, found, members } = groups;
        let mut first = 0;
        for &group in found.iter() {
            let end = std::mem::take(&mut counts[group as usize]) as usize;
            let members = &members[std::mem::replace(&mut first, end)..end];
            let origin = table.origins[spikes[members[0].spike as usize].source()];
            let Stencil { first: stencil, rows, .. } = table.stencils[origin.stencil as usize];
            for row in 0..rows {
                let place = table.places[(stencil + row) as usize];
                let (lane, chunks) = (origin.lane as usize + place.lane(), place.row().chunks());
                for done in (0..chunks).step_by(8) {
                    let of_row = (row, done);
                    match chunks - done {
                        1 => self.add_members::<P, 1>(table, (spikes, members), of_row, lane),
                        2 => self.add_members::<P, 2>(table, (spikes, members), of_row, lane),
                        3 => self.add_members::<P, 3>(table, (spikes, members), of_row, lane),
                        4 => self.add_members::<P, 4>(table, (spikes, members), of_row, lane),
                        5 => self.add_members::<P, 5>(table, (spikes, members), of_row, lane),
                        6 => self.add_members::<P, 6>(table, (spikes, members), of_row, lane),
                        7 => self.add_members::<P, 7>(table, (spikes, members), of_row, lane),
                        _ => self.add_members::<P, 8>(table, (spikes, members), of_row, lane),
                    }
                }
                if MARK {
                    self.mark(lane..lane + chunks * LANES);
                }
            }
        }
    }

    /// Adds chunks of a row of each of these stencils.
    #[inline(always)]
    fn add_members<P: Spike, const N: usize>(
        &mut self,
        table: &RowTable,
        (spikes, members): (&[P], &[Member]),
        (row, done): (u32, usize),
        lane: usize,
    ) where
        S: Accumulate<P::Payload>,
    {
        let (sums, _) = self.sums[lane + done * LANES..].as_chunks_mut::<LANES>();
        let Some(sums) = sums.first_chunk_mut::<N>() else { return };
        let mut kept = *sums;
        for member in members {
            let payload = spikes[member.spike as usize].payload();
            add_weights(&mut kept, table.weights::<N>((member.row + row) as usize, done), payload);
        }
        *sums = kept;
    }

    /// Adds the rows of each spike for itself.
    #[inline(always)]
    fn deliver_queued<const MARK: bool, P: Spike>(
        &mut self,
        table: &RowTable,
        spikes: &[P],
        queue: &mut Vec<RowPlace>,
    ) -> u64
    where
        S: Accumulate<P::Payload>,
    {
        let (mut payloads, mut events) = (Vec::new(), 0);
        // A loop over the few rows of each spike would end in a mispredicted branch, so rows of
        // many spikes are queued.
        for spikes in spikes.chunks(QUEUED_SPIKES) {
            let (rows, synapses) = enqueue_rows(table, spikes, (queue, &mut payloads));
            events += synapses;
            for (place, payload) in queue[..rows].iter().zip(&payloads) {
                self.add_row::<MARK, P>(table, *place, *payload);
            }
        }
        events
    }

    #[inline(always)]
    fn add_row<const MARK: bool, P: Spike>(&mut self, table: &RowTable, place: RowPlace, payload: P::Payload)
    where
        S: Accumulate<P::Payload>,
    {
        let (lane, weights) = (place.lane(), table.rows.weights(place.row()));
        let end = lane + weights.len() * LANES;
        let (sums, _) = self.sums[lane..end].as_chunks_mut::<LANES>();
        for (sums, weights) in sums.iter_mut().zip(weights) {
            add_weights(std::array::from_mut(sums), std::array::from_ref(weights), payload);
        }
        if MARK {
            self.mark(lane..end);
        }
    }
}

/// Spikes whose rows are queued at a time.
const QUEUED_SPIKES: usize = 512;

/// Spikes between the prefetch of a source's origin, of its stencil, of the stencil's rows, and
/// their use: each tells where the next is.
const PREFETCH_SPIKES: [usize; 3] = [24, 16, 8];

/// Queues the rows of these spikes and what each carries; returns their number and that of the
/// synapses in them.
#[inline(always)]
fn enqueue_rows<P: Spike>(
    table: &RowTable,
    spikes: &[P],
    (queue, payloads): (&mut Vec<RowPlace>, &mut Vec<P::Payload>),
) -> (usize, u64) {
    let (mut end, mut events) = (0, 0);
    payloads.resize(queue.len(), spikes[0].payload());
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
            payloads.resize(queue.len(), spike.payload());
        }
        if let (Some(queued), Some(unchecked)) =
            (queue[end..].first_chunk_mut::<UNCHECKED>(), places.first_chunk::<UNCHECKED>())
        {
            *queued = unchecked.map(|place| place.after(origin.lane));
        }
        if let Some(payloads) = payloads[end..].first_chunk_mut::<UNCHECKED>() {
            *payloads = [spike.payload(); UNCHECKED];
        }
        if rows > UNCHECKED {
            let others = queue[end + UNCHECKED..end + rows].iter_mut().zip(&places[UNCHECKED..]);
            others.for_each(|(queued, place)| *queued = place.after(origin.lane));
            payloads[end + UNCHECKED..end + rows].fill(spike.payload());
        }
        end += rows;
    }
    (end, events)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layout::weight_rows::table;
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;
    use nsim_ir::spikes::GradedSpike;

    const POSITIONS: u64 = 30;
    const CHANNELS: u64 = 12;

    /// Sums, marks and synapses of spikes in groups are those of each row for itself, and of every
    /// synapse for itself.
    fn compare<P: Spike, S: Sum + Accumulate<P::Payload>>(spike: impl Fn(usize) -> P) {
        let lanes = 64 * 24;
        // A channel's rows have its own weights, and begin two chunks later at each position. Every
        // fifth channel's second row is shorter, so that it is of another group.
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
                all[..if position == 7 { 0 } else { 1 + channel % 2 }].to_vec()
            })
            .collect();
        let table = table(&rows, &sources);
        for every in [1, 2, 7] {
            let numbers: Vec<usize> = (0..sources.len()).step_by(every).collect();
            let spikes: Vec<P> = numbers.iter().map(|&source| spike(source)).collect();
            let mut sums = [(); 3].map(|()| vec![S::default(); lanes + LANES]);
            let mut marks = [(); 3].map(|()| vec![0; lanes / SKIP_BLOCK]);
            let [mut together, mut queued, obvious] =
                sums.each_mut().map(|sums| RowSums { lanes, sums, marks: &mut [] });
            let [of_together, of_queued, _] = &mut marks;
            (together.marks, queued.marks) = (of_together, of_queued);
            let (mut groups, mut queue) = (Groups::default(), Vec::new());
            let found = groups.find(&table, &spikes);
            assert_eq!(found.is_some(), every < 7, "every {every}");
            if found.is_some() {
                together.deliver_together::<true, P>(&table, &spikes, &mut groups);
            } else {
                together.deliver_queued::<true, P>(&table, &spikes, &mut queue);
            }
            assert!(groups.counts.iter().all(|&count| count == 0));
            let synapses = queued.deliver_queued::<true, P>(&table, &spikes, &mut queue);
            assert_eq!(found.unwrap_or(synapses), synapses);
            let mut count = 0;
            for (spike, &source) in spikes.iter().zip(&numbers) {
                for &(row, lane) in &sources[source] {
                    for (sum, &weight) in obvious.sums[lane as usize..].iter_mut().zip(&rows[row]) {
                        *sum = sum.accumulate(weight, spike.payload());
                        count += 1;
                    }
                }
            }
            assert_eq!(count, synapses);
            let [together, queued, obvious] = sums;
            assert!(obvious.iter().any(|sum| *sum != S::default()));
            assert!(together == obvious && queued == obvious);
            assert!(marks[0] == marks[1] && marks[0].contains(&1) && marks[0].contains(&0));
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
