//! What is in flight: sums by lane and step of arrival, and the delivery of spikes into them.
//!
//! Comes in: who spiked, panels and lists of what they reach. Goes out: sums of weights in units of 64, the granules that they
//! lie in, and over how many synapses they came. What the sums do to a compartment is not its matter (`lanes`).

use crate::base::id::Id;
use crate::machine::bits::ones;
use crate::machine::layout::dense_blocks::{Panel, Panels, Row};
use crate::machine::layout::image::{GRANULE, Reach};
use crate::machine::layout::lists::{ADDRESSED, Synapses, Table};
use crate::machine::layout::store::Aligned;
use crate::machine::update::kernel::{LANES, Sum};

/// What arrives in the coming steps, a slot each.
#[derive(Debug)]
pub(crate) struct Ring<S> {
    /// Lanes of the share.
    lanes: usize,
    /// Sums in units of 64, by lane; small lists may name more lanes than there are.
    pub sums: Vec<Aligned<S>>,
    /// Granules with arrivals, a bit each.
    pub arrivals: Vec<Vec<u64>>,
    /// Memory to work in.
    queue: Vec<u32>,
}

impl<S: Sum> Ring<S> {
    /// Nothing in flight for so many lanes, with so many words of granules and slots; `small` where a table's lists are.
    pub fn new(lanes: usize, small: bool, words: usize, slots: usize) -> Self {
        // What lies beyond the lanes is never written, so it is memory by name only.
        let sums = if small { lanes.max(ADDRESSED) } else { lanes };
        let sums = (0..slots).map(|_| Aligned::new(sums)).collect();
        Ring { lanes, sums, arrivals: vec![vec![0; words]; slots], queue: Vec::new() }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let of = |words: &Vec<u64>| size_of::<S>() * self.lanes + size_of_val(words.as_slice());
        self.arrivals.iter().map(of).sum::<usize>() + 4 * self.queue.capacity()
    }

    /// Nothing in flight.
    pub fn clear(&mut self) {
        for (sums, arrivals) in self.sums.iter_mut().zip(&mut self.arrivals) {
            sums[..self.lanes].fill(S::default());
            arrivals.fill(0);
        }
    }

    /// Notes arrivals at the first `granules` in every slot.
    pub fn note_all(&mut self, granules: usize) {
        for words in &mut self.arrivals {
            for (index, word) in words.iter_mut().enumerate() {
                *word = ones(granules.saturating_sub(index * 64));
            }
        }
    }

    /// The slot of a delay.
    #[inline(always)]
    fn slot(&self, cursor: usize, delay: u8) -> usize {
        let slot = cursor + usize::from(delay);
        if slot >= self.sums.len() { slot - self.sums.len() } else { slot }
    }

    /// Delivers what spikes of one kind, ascending where there are rows, reach, and notes where; returns the synapses over which
    /// it arrives within `left` steps. Spikes that reach narrow rows are counted in `heard` by source, unless that is empty.
    #[inline(always)]
    pub fn deliver<const NOTE: bool, I: Id>(
        &mut self,
        reached: &[Reach],
        (ids, heard): (&[I], &mut [u32]),
        cursor: usize,
        left: u32,
    ) -> u64 {
        let mut events = 0;
        for reach in reached {
            let slot = self.slot(cursor, reach.delay);
            let mut synapses = 0;
            if !reach.panels.panels.is_empty() {
                synapses += self.deliver_panels::<NOTE, I>(&reach.panels, (ids, &mut *heard), slot);
            }
            if let Some(table) = &reach.table {
                synapses += self.deliver_lists::<NOTE, I>(table, ids, slot);
            }
            events += if u32::from(reach.delay) < left { synapses } else { 0 };
        }
        events
    }

    #[inline(always)]
    fn deliver_panels<const NOTE: bool, I: Id>(
        &mut self,
        panels: &Panels,
        (ids, heard): (&[I], &mut [u32]),
        slot: usize,
    ) -> u64 {
        let weights = panels.weights();
        let (mut events, mut panels, mut rest) = (0, panels.panels.as_slice(), ids);
        while let Some(next) = rest.first() {
            let passed = first_at_least(panels, |panel| panel.end as usize > next.index());
            panels = &panels[passed..];
            let Some(panel) = panels.first() else { break };
            rest = &rest[before(rest, panel.first)..];
            if let Some(row) = panel.narrow() {
                let spikes = (rest, heard.get_mut(panel.first as usize..panel.end as usize).unwrap_or_default());
                let passed = match row.chunks {
                    1 => self.pass::<I, 1>(panel, row, weights, spikes, slot),
                    2 => self.pass::<I, 2>(panel, row, weights, spikes, slot),
                    3 => self.pass::<I, 3>(panel, row, weights, spikes, slot),
                    _ => self.pass::<I, 4>(panel, row, weights, spikes, slot),
                };
                let (spiking, after) = rest.split_at(passed);
                rest = after;
                if NOTE && !spiking.is_empty() {
                    self.note(slot, row);
                }
                events += panel.synapses(spiking);
                continue;
            }
            let (spiking, after) = rest.split_at(before(rest, panel.end));
            rest = after;
            if !spiking.is_empty() {
                events += self.deliver_panel::<NOTE, I>(panel, weights, spiking, slot);
            }
        }
        events
    }

    /// Adds the weights of a panel's sources, a few chunks of lanes at a time, which stay in registers meanwhile: going
    /// through memory for each source would wait for the store before.
    #[inline(always)]
    fn deliver_panel<const NOTE: bool, I: Id>(
        &mut self,
        panel: &Panel,
        weights: &[[i16; LANES]],
        ids: &[I],
        slot: usize,
    ) -> u64 {
        let sources = || ids.iter().map(|id| id.index() - panel.first as usize);
        let mut chunk = panel.weights;
        for row in &panel.rows {
            if NOTE {
                self.note(slot, row);
            }
            let count = row.chunks as usize;
            let target = row.target as usize;
            let (sums, _) = self.sums[slot][target..target + count * LANES].as_chunks_mut::<LANES>();
            let weights = &weights[chunk..];
            let (fours, ones) = sums.as_chunks_mut::<4>();
            for (index, sums) in fours.iter_mut().enumerate() {
                add(sums, weights, sources().map(|s| s * panel.stride + 4 * index));
            }
            let left_of = 4 * fours.len();
            for (index, sums) in ones.iter_mut().enumerate() {
                add(std::array::from_mut(sums), weights, sources().map(|s| s * panel.stride + left_of + index));
            }
            chunk += count;
        }
        panel.synapses(ids)
    }

    /// Adds the weights of a panel's sources that has one row of so many chunks, as long as sources are the panel's; returns
    /// how many were. None is looked for beforehand: where they end is seen as each is looked up. Each is counted in `heard`,
    /// unless that is empty.
    #[inline(always)]
    fn pass<I: Id, const N: usize>(
        &mut self,
        panel: &Panel,
        row: &Row,
        weights: &[[i16; LANES]],
        (ids, heard): (&[I], &mut [u32]),
        slot: usize,
    ) -> usize {
        let sources = (panel.end - panel.first) as usize;
        let weights = weights[panel.weights..panel.weights + sources * N].as_chunks::<N>().0;
        let (sums, _) = self.sums[slot][row.target as usize..].as_chunks_mut::<LANES>();
        let Some(sums) = sums.first_chunk_mut::<N>() else { return 0 };
        let (mut kept, mut passed) = (*sums, 0);
        for id in ids {
            let source = id.index() - panel.first as usize;
            let Some(weights) = weights.get(source) else { break };
            plus(&mut kept, weights);
            if let Some(count) = heard.get_mut(source) {
                *count += 1;
            }
            passed += 1;
        }
        *sums = kept;
        passed
    }

    /// Notes that something arrives at a row's granules.
    #[inline(always)]
    fn note(&mut self, slot: usize, row: &Row) {
        let target = row.target as usize;
        let last = target + row.chunks as usize * LANES - 1;
        for granule in target / GRANULE..=last / GRANULE {
            self.arrivals[slot][granule / 64] |= 1 << (granule % 64);
        }
    }

    #[inline(always)]
    fn deliver_lists<const NOTE: bool, I: Id>(&mut self, table: &Table, ids: &[I], slot: usize) -> u64 {
        let Ring { sums, arrivals, queue, .. } = self;
        let (sums, arrivals) = (&mut *sums[slot], arrivals[slot].as_mut_slice());
        match &table.synapses {
            Synapses::Fours(groups) => groups.deliver(&table.places, ids, queue, add_small::<NOTE, S>(sums, arrivals)),
            Synapses::Eights(groups) => groups.deliver(&table.places, ids, queue, add_small::<NOTE, S>(sums, arrivals)),
            Synapses::Sixteens(groups) => {
                groups.deliver(&table.places, ids, queue, add_small::<NOTE, S>(sums, arrivals))
            }
            Synapses::Packed(groups) => groups.deliver(&table.places, ids, queue, add_to::<NOTE, S>(sums, arrivals)),
            Synapses::Apart(lists) => lists.deliver(&table.places, ids, add_to::<NOTE, S>(sums, arrivals)),
        }
    }
}

/// Adds to sums, and notes where.
#[inline(always)]
fn add_to<const NOTE: bool, S: Sum>(sums: &mut [S], arrivals: &mut [u64]) -> impl FnMut(usize, i16) {
    |target, weight| {
        sums[target] = sums[target].plus(weight);
        note::<NOTE>(arrivals, target);
    }
}

/// The same for lanes of 16 bits: there are as many sums as these can name, so that none has to be looked at.
#[inline(always)]
fn add_small<const NOTE: bool, S: Sum>(sums: &mut [S], arrivals: &mut [u64]) -> impl FnMut(usize, i16) {
    let sums: &mut [S; ADDRESSED] = sums.first_chunk_mut().expect("small lists have all sums they can name");
    move |target, weight| {
        sums[target] = sums[target].plus(weight);
        note::<NOTE>(arrivals, target);
    }
}

/// Notes that something arrives at a lane's granule, if that is wanted.
#[inline(always)]
fn note<const NOTE: bool>(arrivals: &mut [u64], target: usize) {
    if NOTE {
        let granule = target / GRANULE;
        arrivals[granule / 64] |= 1 << (granule % 64);
    }
}

/// Spikes so few that they are counted faster than searched.
const COUNTED: usize = 64;

/// How many of these, ascending, come before a source; often it is none or all.
#[inline(always)]
fn before<I: Id>(ids: &[I], source: u32) -> usize {
    let is = |id: &I| (id.index() as u32) < source;
    match (ids.first().is_some_and(is), ids.last().is_some_and(is)) {
        (false, _) => 0,
        (true, true) => ids.len(),
        // Counting all of a few needs no decisions.
        (true, false) if ids.len() <= COUNTED => ids.iter().map(|id| usize::from(is(id))).sum(),
        (true, false) => ids.partition_point(is),
    }
}

/// How many do not yet hold what all from some place on do; near places are looked at first.
#[inline(always)]
fn first_at_least<T>(items: &[T], holds: impl Fn(&T) -> bool) -> usize {
    match items.iter().take(4).position(&holds) {
        Some(near) => near,
        None => items.partition_point(|item| !holds(item)),
    }
}

/// Adds the chunks of weights that begin at each place to as many chunks of sums.
#[inline(always)]
fn add<S: Sum, const N: usize>(
    sums: &mut [[S; LANES]; N],
    weights: &[[i16; LANES]],
    places: impl Iterator<Item = usize>,
) {
    let mut kept = *sums;
    for place in places {
        if let Some(weights) = weights[place..].first_chunk() {
            plus(&mut kept, weights);
        }
    }
    *sums = kept;
}

/// Adds chunks of weights to as many chunks of sums.
#[inline(always)]
fn plus<S: Sum, const N: usize>(sums: &mut [[S; LANES]; N], weights: &[[i16; LANES]; N]) {
    for chunk in 0..N {
        for lane in 0..LANES {
            sums[chunk][lane] = sums[chunk][lane].plus(weights[chunk][lane]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::id::ChannelId;
    use crate::base::rng;
    use crate::machine::layout::lists::{Draft, Reached};

    fn flattened(sources: &[Vec<Reached>], lanes: usize) -> Reach {
        let mut draft = Draft::new(lanes);
        sources.iter().for_each(|synapses| draft.append(&[synapses.len() as u32], synapses));
        Reach::new(1, draft, lanes).unwrap().unwrap()
    }

    /// Sums, noted granules and numbers of synapses are those of adding one synapse after the other.
    fn compare<S: Sum>(lanes: usize, synapses: u64, width: u64) -> Reach {
        let of = |source: u64, index| {
            let lane = (source * 17 + rng::below(width, 1, source, index)) % lanes as u64;
            (lane as u32, rng::below(255, 2, source, index) as i16 - 127)
        };
        let sources: Vec<Vec<Reached>> =
            (0..300).map(|source| (0..synapses).map(|index| of(source, index)).collect()).collect();
        let reach = flattened(&sources, lanes);
        let small = reach.table.as_ref().is_some_and(|table| table.synapses.small());
        for every in [1, 3, 50] {
            let ids: Vec<ChannelId> = (0..300).step_by(every).map(ChannelId::new).collect();
            let (mut sums, mut noted) = (vec![0; lanes], vec![0u64; lanes.div_ceil(64 * GRANULE)]);
            for &(lane, weight) in ids.iter().flat_map(|id| &sources[id.index()]) {
                sums[lane as usize] += i32::from(weight);
                noted[lane as usize / GRANULE / 64] |= 1 << (lane as usize / GRANULE % 64);
            }
            let mut rings = [(); 2].map(|()| Ring::<S>::new(lanes, small, noted.len(), 2));
            let [quiet, noting] = &mut rings;
            let reach = std::slice::from_ref(&reach);
            let events = ids.len() as u64 * synapses;
            let mut heard = vec![0; 300];
            assert_eq!(quiet.deliver::<false, _>(reach, (&ids, &mut heard), 1, 2), events);
            let is_counted = |source: usize| {
                let holds = |panel: &Panel| panel.first as usize <= source && source < panel.end as usize;
                source.is_multiple_of(every)
                    && reach[0].panels.panels.iter().any(|panel| holds(panel) && panel.narrow().is_some())
            };
            assert!(heard.iter().enumerate().all(|(source, &count)| count == u32::from(is_counted(source))));
            // What arrives after the last step is no event.
            assert_eq!(noting.deliver::<true, _>(reach, (&ids, &mut []), 1, 1), 0);
            for ring in &rings {
                assert!(ring.sums[0][..lanes].iter().map(|sum| sum.value()).eq(sums.iter().copied()));
                assert!(ring.sums[1].iter().all(|sum| sum.value() == 0));
            }
            // A row notes all of its lanes.
            let missed = noted.iter().zip(&rings[1].arrivals[0]).any(|(&expected, &noted)| expected & !noted != 0);
            assert!(!missed && (rings[1].arrivals[0] == noted || reach[0].table.is_none()));
        }
        reach
    }

    #[test]
    fn whatever_the_form_all_arrives() {
        let rows = compare::<i32>(1_024, 64, 100);
        assert!(rows.table.is_none() && !rows.panels.panels.is_empty());
        let whole = compare::<i16>(8_192, 70, 8_192);
        assert!(whole.panels.panels.is_empty() && whole.table.is_some());
        for wide in [compare::<i32>(16_384, 70, 16_384), compare::<i32>(70_016, 70, 70_000)] {
            assert!(wide.table.is_some());
        }
        // Rows of one chunk to four, and one that is no longer narrow.
        for chunks in 1..=5 {
            let lanes = chunks * LANES as u32;
            let rows = compare::<i16>(lanes as usize, 30, lanes.into());
            assert!(rows.table.is_none());
            assert!(rows.panels.panels.iter().all(|panel| panel.rows == [Row { target: 0, chunks }]));
        }
    }
}
