//! What is in flight: sums by lane and step of arrival, and the delivery of spikes into them.
//!
//! Comes in: who spiked, panels and lists of a [`Share`]. Goes out: sums of weights in units of 64, the granules that they
//! lie in, and over how many synapses they came. What the sums do to a compartment is not its matter (`lanes`).

use crate::base::id::Id;
use crate::machine::image::{GRANULE, Panel, Row, Share};
use crate::machine::kernel::{LANES, Sum};
use crate::machine::lists::{ADDRESSED, Lists, Synapses, Table};
use crate::machine::prefetch::{prefetch, prefetch_range};

/// What arrives in the coming steps, a slot each.
#[derive(Debug)]
pub(super) struct Ring<S> {
    /// Lanes of the share.
    lanes: usize,
    /// Sums in units of 64, by lane; small lists may name more lanes than there are.
    pub sums: Vec<Vec<S>>,
    /// Granules with arrivals, a bit each.
    pub arrivals: Vec<Vec<u64>>,
}

impl<S: Sum> Ring<S> {
    /// Nothing in flight for so many lanes, with so many words of granules and slots; `small` where a table's lists are.
    pub fn new(lanes: usize, small: bool, words: usize, slots: usize) -> Self {
        // What lies beyond the lanes is never written, so it is memory by name only.
        let sums = if small { lanes.max(ADDRESSED) } else { lanes };
        Ring { lanes, sums: vec![vec![S::default(); sums]; slots], arrivals: vec![vec![0; words]; slots] }
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let of = |words: &Vec<u64>| size_of::<S>() * self.lanes + size_of_val(words.as_slice());
        self.arrivals.iter().map(of).sum()
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

    /// Delivers what these sources reach, and notes where; returns the synapses over which it
    /// arrives within `left` steps.
    #[inline(always)]
    pub fn deliver<const NOTE: bool, I: Id>(
        &mut self,
        share: &Share,
        sources: Sources<'_, I>,
        cursor: usize,
        left: u32,
    ) -> u64 {
        let mut events = 0;
        if !share.panels.is_empty() {
            events += self.deliver_panels::<NOTE, I>(share, sources, cursor, left);
        }
        for table in sources.lists {
            let slot = self.slot(cursor, table.delay);
            let synapses = self.deliver_lists::<NOTE, I>(table, sources.ids, slot);
            events += if u32::from(table.delay) < left { synapses } else { 0 };
        }
        events
    }

    #[inline(always)]
    fn deliver_panels<const NOTE: bool, I: Id>(
        &mut self,
        share: &Share,
        sources: Sources<'_, I>,
        cursor: usize,
        left: u32,
    ) -> u64 {
        let (mut events, mut panels, mut rest) = (0, share.panels.as_slice(), sources.ids);
        while let Some(&next) = rest.first() {
            let next = sources.number(next) as u32;
            let passed = first_at_least(panels, |panel| panel.end > next);
            panels = &panels[passed..];
            let Some(panel) = panels.first() else { break };
            rest = &rest[sources.before(rest, panel.first)..];
            let within = sources.before(rest, panel.end);
            let (spiking, after) = rest.split_at(within);
            rest = after;
            if !spiking.is_empty() {
                events +=
                    self.deliver_panel::<NOTE, I>(share, panel, Sources { ids: spiking, ..sources }, cursor, left);
            }
        }
        events
    }

    /// Adds the weights of a panel's sources, a few chunks of lanes at a time, which stay in registers meanwhile: going
    /// through memory for each source would wait for the store before.
    #[inline(always)]
    fn deliver_panel<const NOTE: bool, I: Id>(
        &mut self,
        share: &Share,
        panel: &Panel,
        sources: Sources<'_, I>,
        cursor: usize,
        left: u32,
    ) -> u64 {
        let (mut events, mut chunk) = (0, 0);
        for row in &panel.rows {
            let slot = self.slot(cursor, row.delay);
            if NOTE {
                self.note(slot, row, share.lanes);
            }
            let count = usize::from(row.chunks);
            let target = row.target as usize;
            let (sums, _) = self.sums[slot][target..target + count * LANES].as_chunks_mut::<LANES>();
            let weights = &share.weights[panel.weights + chunk..];
            let first = panel.first as usize;
            let (fours, ones) = sums.as_chunks_mut::<4>();
            for (index, sums) in fours.iter_mut().enumerate() {
                add(sums, weights, sources.numbers().map(|s| (s - first) * panel.stride + 4 * index));
            }
            let left_of = 4 * fours.len();
            for (index, sums) in ones.iter_mut().enumerate() {
                let offset = left_of + index;
                add(
                    std::array::from_mut(sums),
                    weights,
                    sources.numbers().map(|s| (s - first) * panel.stride + offset),
                );
            }
            events += if u32::from(row.delay) < left { u64::from(row.synapses) } else { 0 };
            chunk += count;
        }
        events * sources.ids.len() as u64
    }

    /// Notes that something arrives at a row's granules.
    #[inline(always)]
    fn note(&mut self, slot: usize, row: &Row, lanes: usize) {
        let target = row.target as usize;
        let last = (target + usize::from(row.chunks) * LANES - 1).min(lanes - LANES - 1);
        for granule in target / GRANULE..=last / GRANULE {
            self.arrivals[slot][granule / 64] |= 1 << (granule % 64);
        }
    }

    #[inline(always)]
    fn deliver_lists<const NOTE: bool, I: Id>(&mut self, table: &Table, ids: &[I], slot: usize) -> u64 {
        let (sums, arrivals) = (self.sums[slot].as_mut_slice(), self.arrivals[slot].as_mut_slice());
        let mut note = |target: usize| {
            if NOTE {
                let granule = target / GRANULE;
                arrivals[granule / 64] |= 1 << (granule % 64);
            }
        };
        match &table.synapses {
            Synapses::Small(lists) => {
                // As many sums as a lane of 16 bits can name, so that none has to be looked at.
                let sums: &mut [S; ADDRESSED] =
                    sums.first_chunk_mut().expect("small lists have all sums they can name");
                deliver_each(table, ids, lists, |target: u16, weight: i8| {
                    let target = usize::from(target);
                    sums[target] = sums[target].plus(i16::from(weight));
                    note(target);
                })
            }
            Synapses::Packed(lists) => deliver_each(table, ids, lists, |target: usize, weight: i16| {
                sums[target] = sums[target].plus(weight);
                note(target);
            }),
            Synapses::Apart(lists) => deliver_each(table, ids, lists, |target: usize, weight: i16| {
                sums[target] = sums[target].plus(weight);
                note(target);
            }),
        }
    }
}

/// Calls with every synapse that these sources reach over a table, while the lists of the next are fetched; returns how many.
#[inline(always)]
fn deliver_each<L: Lists, I: Id>(table: &Table, ids: &[I], lists: &L, mut add: impl FnMut(L::Lane, L::Weight)) -> u64 {
    let mut events = 0;
    for (index, id) in ids.iter().enumerate() {
        if let Some(far) = ids.get(index + table.ahead + FAR) {
            prefetch(&table.places, far.index());
        }
        if let Some(near) = ids.get(index + table.ahead) {
            let (bytes, range) = lists.lines(table.places[near.index()]);
            prefetch_range(bytes, range);
        }
        let place = table.places[id.index()];
        events += place.len() as u64;
        lists.each(place, &mut add);
    }
    events
}

/// Sources from one whose list is fetched to one whose place in the table is.
const FAR: usize = 12;

/// Spikes so few that they are counted faster than searched.
const COUNTED: usize = 64;

/// Spikes of one kind, ascending.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sources<'a, I> {
    /// The spikes.
    pub ids: &'a [I],
    /// The number as a source of the kind's first.
    pub first: usize,
    /// Lists of the kind.
    pub lists: &'a [Table],
}

impl<'a, I: Id> Sources<'a, I> {
    #[inline(always)]
    fn number(self, id: I) -> usize {
        self.first + id.index()
    }

    /// How many of these come before a source; often it is none or all.
    #[inline(always)]
    fn before(self, ids: &[I], number: u32) -> usize {
        let is = |id: &I| (self.number(*id) as u32) < number;
        match (ids.first().is_some_and(is), ids.last().is_some_and(is)) {
            (false, _) => 0,
            (true, true) => ids.len(),
            // Counting all of a few needs no decisions.
            (true, false) if ids.len() <= COUNTED => ids.iter().map(|id| usize::from(is(id))).sum(),
            (true, false) => ids.partition_point(is),
        }
    }

    #[inline(always)]
    fn numbers(self) -> impl Iterator<Item = usize> + use<'a, I> {
        self.ids.iter().map(move |&id| self.number(id))
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
        let weights = &weights[place..place + N];
        for chunk in 0..N {
            for lane in 0..LANES {
                kept[chunk][lane] = kept[chunk][lane].plus(weights[chunk][lane]);
            }
        }
    }
    *sums = kept;
}

/// The lowest `count` bits, all 64 from there on.
#[inline(always)]
pub(super) fn ones(count: usize) -> u64 {
    if count >= 64 { u64::MAX } else { (1 << count) - 1 }
}
