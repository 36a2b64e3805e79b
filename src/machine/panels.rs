//! Rows of synapses: which of a source's synapses stand lane beside lane, with zeros where there is none, and which are
//! listed one by one.
//!
//! Comes in: what each source reaches over synapses of one delay, source after source, twice. The first time a [`Plan`]
//! chooses; the second time a [`Layout`] writes. Goes out: [`Panels`], and in a [`Draft`] what is left. The choice is by an
//! estimate of what delivery costs, in time and in memory. A chunk of sixteen lanes is added in less time than a synapse from
//! a list, so rows with many zeros still gain; but a chunk takes the memory of ten synapses, so in a network that no cache
//! holds rows with many zeros lose.
//!
//! How many synapses a source has is kept beside its row, for zeros are no synapses.

use crate::machine::kernel::LANES;
use crate::machine::lists::{Draft, PACKED};
use crate::machine::store::Aligned;

/// Consecutive lanes that each source of a panel reaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Row {
    /// The first lane, a multiple of sixteen.
    pub target: u32,
    /// Chunks of sixteen lanes.
    pub chunks: u32,
}

/// Consecutive sources whose synapses are laid out over the same lanes, each with weights of its own: a dense projection
/// makes one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Panel {
    /// The first source.
    pub first: u32,
    /// The first source after it.
    pub end: u32,
    /// The lanes.
    pub rows: Vec<Row>,
    /// The first source's weights, a chunk of sixteen after the other, row by row; then the next source's.
    pub weights: usize,
    /// Chunks of a source.
    pub stride: usize,
    /// Synapses of each source: those of its lanes that are no zeros for want of one.
    pub synapses: Counts,
}

/// A number for each source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Counts {
    /// The same for all.
    Same(u32),
    /// In order.
    Each(Vec<u32>),
}

/// Panels by their sources, which do not overlap.
#[derive(Debug)]
pub(super) struct Panels {
    /// In ascending order.
    pub panels: Vec<Panel>,
    weights: Aligned<i16>,
}

impl Panels {
    /// Weights of all, in units of 64.
    #[inline(always)]
    pub fn weights(&self) -> &[[i16; LANES]] {
        self.weights.as_chunks().0
    }

    /// Bytes of memory that they hold.
    pub fn bytes(&self) -> usize {
        let of = |panel: &Panel| {
            let counts = if let Counts::Each(counts) = &panel.synapses { size_of_val(counts.as_slice()) } else { 0 };
            size_of::<Panel>() + size_of_val(panel.rows.as_slice()) + counts
        };
        self.panels.iter().map(of).sum::<usize>() + size_of_val(&*self.weights)
    }
}

/// A synapse that a source reaches: lane, and weight in units of 64.
pub(super) type Reached = (u32, i16);

/// Bytes of a chunk.
const CHUNK_BYTES: usize = 2 * LANES;
/// The fewest synapses of a chunk that is worth its memory where memory counts: 6.4 bytes a synapse.
const DENSE: u32 = 5;
/// Bytes of weights that may be mostly zeros: half of a core's second-level cache, in which a chunk costs next to nothing.
const CACHED: usize = 1 << 20;
/// What delivery costs, in tenths of a nanosecond: a chunk of a row, by `vtsnn-5pct`.
const CHUNK_COST: usize = 4;
/// A synapse of a list, by `random-32k`.
const SYNAPSE_COST: usize = 6;
/// Looking up a list.
const LIST_COST: usize = 40;
/// Finding a panel.
const PANEL_COST: usize = 50;
/// Beginning a row of it: taking sums into registers and back.
const ROW_COST: usize = 40;
/// Steps in which each source spikes about once: sources of a panel that spike together find it together.
const STEPS: usize = 20;
/// Chunks of zeros for a source, growing, that may be laid out to have a panel less; up to what finding it costs. Those that
/// are alike join before those that are less so.
const ZEROS: [usize; 5] = [1, 3, 6, 12, (PANEL_COST + ROW_COST) / CHUNK_COST];

/// Sources that are to be a panel.
#[derive(Debug)]
struct Planned {
    first: u32,
    end: u32,
    /// Its chunks, ascending.
    chunks: Vec<u32>,
    /// Chunks of its sources, summed: without the zeros that a source has for the others' sake.
    own: usize,
    /// Synapses that they hold.
    synapses: usize,
}

impl Planned {
    fn sources(&self) -> usize {
        (self.end - self.first) as usize
    }

    /// Chunks of all sources.
    fn size(&self) -> usize {
        self.sources() * self.chunks.len()
    }

    /// What it costs when each source spikes once.
    fn cost(&self) -> usize {
        let rows = self.chunks.chunk_by(|a, b| a + 1 == *b).count();
        self.size() * CHUNK_COST + self.sources().min(STEPS) * (PANEL_COST + rows * ROW_COST)
    }

    /// Takes the next in, if that needs few zeros; says how many it took, or gives the next back. Zeros may be half of all,
    /// and as many as are `spare` besides.
    fn join(&mut self, next: Planned, zeros: usize, spare: usize) -> Result<usize, Planned> {
        let sources = (next.end - self.first) as usize;
        let others = || next.chunks.iter().filter(|chunk| self.chunks.binary_search(chunk).is_err());
        let size = (self.chunks.len() + others().count()) * sources;
        let (own, more) = (self.own + next.own, size - self.size() - next.size());
        if more > zeros * self.sources().min(next.sources()).min(STEPS) || (size > 2 * own && more > spare) {
            return Err(next);
        }
        let others: Vec<u32> = others().copied().collect();
        self.chunks.extend(others);
        self.chunks.sort_unstable();
        (self.end, self.own, self.synapses) = (next.end, own, self.synapses + next.synapses);
        Ok(more)
    }
}

/// One way to choose.
#[derive(Debug)]
struct Choice {
    /// The fewest synapses of a chunk that belongs into a row.
    least: u32,
    panels: Vec<Planned>,
    /// Chunks of all panels.
    size: usize,
    /// Synapses that are left.
    listed: usize,
    /// The present source's chunks.
    chunks: Vec<u32>,
}

impl Choice {
    fn new(least: u32) -> Self {
        Choice { least, panels: Vec::new(), size: 0, listed: 0, chunks: Vec::new() }
    }

    fn take(&mut self, source: u32, touched: &[u32], counts: &[u32]) {
        let mut synapses = 0;
        self.chunks.clear();
        for &chunk in touched {
            let count = counts[chunk as usize];
            if count >= self.least {
                self.chunks.push(chunk);
                synapses += count as usize;
            } else {
                self.listed += count as usize;
            }
        }
        if self.chunks.is_empty() {
            return;
        }
        self.chunks.sort_unstable();
        self.size += self.chunks.len();
        if let Some(last) = self.panels.last_mut()
            && last.end == source
            && last.chunks == self.chunks
        {
            (last.end, last.own) = (source + 1, last.own + self.chunks.len());
            last.synapses += synapses;
            return;
        }
        let (chunks, own) = (self.chunks.clone(), self.chunks.len());
        self.panels.push(Planned { first: source, end: source + 1, chunks, own, synapses });
    }

    /// Joins neighbours where zeros cost less than panels.
    fn join(&mut self) {
        for zeros in ZEROS {
            let mut joined: Vec<Planned> = Vec::with_capacity(self.panels.len());
            for mut next in self.panels.drain(..) {
                if let Some(last) = joined.last_mut() {
                    let spare = (CACHED / CHUNK_BYTES).saturating_sub(self.size);
                    match last.join(next, zeros, spare) {
                        Ok(more) => {
                            self.size += more;
                            continue;
                        }
                        Err(back) => next = back,
                    }
                }
                joined.push(next);
            }
            self.panels = joined;
        }
    }

    /// Bytes of all weights in rows.
    fn bytes(&self) -> usize {
        CHUNK_BYTES * self.size
    }

    /// Leaves those panels to the lists that cost more than lists would.
    fn drop_losses(&mut self) {
        let (listed, size) = (&mut self.listed, &mut self.size);
        self.panels.retain(|panel| {
            let keep = panel.cost() <= panel.synapses * SYNAPSE_COST + panel.sources() * LIST_COST;
            *listed += if keep { 0 } else { panel.synapses };
            *size -= if keep { 0 } else { panel.size() };
            keep
        });
    }

    /// What all costs when each source spikes once.
    fn cost(&self, sources: usize) -> usize {
        let lists = if self.listed > 0 { self.listed * SYNAPSE_COST + sources * LIST_COST } else { 0 };
        self.panels.iter().map(Planned::cost).sum::<usize>() + lists
    }
}

/// The choice between rows and lists for what the sources of one kind reach over synapses of one delay.
#[derive(Debug)]
pub(super) struct Plan {
    /// The present source's synapses by chunk; zeros between sources.
    counts: Vec<u32>,
    /// Chunks with any.
    touched: Vec<u32>,
    synapses: usize,
    sources: usize,
    /// Rows alone, as long as it is not too large.
    rows: Option<Choice>,
    /// Rows where they are dense.
    both: Choice,
}

impl Plan {
    /// Nothing yet, of a share with so many lanes.
    pub fn new(lanes: usize) -> Self {
        Plan {
            counts: vec![0; lanes.div_ceil(LANES)],
            touched: Vec::new(),
            synapses: 0,
            sources: 0,
            rows: Some(Choice::new(1)),
            both: Choice::new(DENSE),
        }
    }

    /// Looks at what a source reaches; sources come in ascending order.
    pub fn take(&mut self, source: u32, synapses: &[Reached]) {
        for &(lane, _) in synapses {
            let chunk = lane / LANES as u32;
            let count = &mut self.counts[chunk as usize];
            if *count == 0 {
                self.touched.push(chunk);
            }
            *count += 1;
        }
        self.synapses += synapses.len();
        self.sources += usize::from(!synapses.is_empty());
        self.both.take(source, &self.touched, &self.counts);
        let most = self.most();
        if let Some(rows) = &mut self.rows {
            rows.take(source, &self.touched, &self.counts);
            // Dense rows may follow, but not so many that what came before is few.
            if rows.bytes() > 4 * most {
                self.rows = None;
            }
        }
        for chunk in self.touched.drain(..) {
            self.counts[chunk as usize] = 0;
        }
    }

    /// The most bytes that rows alone may take: what the cache holds, or no more than lists.
    fn most(&self) -> usize {
        CACHED.max(PACKED * self.synapses)
    }

    /// Chooses.
    pub fn layout(mut self) -> Layout {
        self.both.join();
        self.both.drop_losses();
        let (most, whole) = (self.most(), self.both.cost(self.sources));
        let rows = self.rows.take().filter(|rows| rows.bytes() <= most).map(|mut rows| {
            rows.join();
            rows
        });
        let cheaper = |rows: &Choice| rows.bytes() <= most && rows.cost(self.sources) <= whole;
        let chosen = rows.filter(cheaper).unwrap_or(self.both);
        tracing::debug!(
            "{} synapses: {} listed, {} panels of {} bytes",
            self.synapses,
            chosen.listed,
            chosen.panels.len(),
            chosen.bytes()
        );
        let mut places = self.counts;
        places.fill(0);
        Layout {
            planned: chosen.panels.into_iter().peekable(),
            places,
            panels: Vec::new(),
            weights: Vec::new(),
            counts: Vec::new(),
        }
    }
}

/// Panels while their weights are written.
#[derive(Debug)]
pub(super) struct Layout {
    /// What is to come, the present panel first.
    planned: std::iter::Peekable<std::vec::IntoIter<Planned>>,
    /// One more than the place of each chunk in a source's weights of the present panel; 0 where it is in none.
    places: Vec<u32>,
    panels: Vec<Panel>,
    weights: Vec<[i16; LANES]>,
    /// Synapses of the present panel's sources.
    counts: Vec<u32>,
}

impl Layout {
    /// Writes what a source reaches: into its rows, or else into the draft of lists. The same sources as were planned with,
    /// in ascending order.
    pub fn put(&mut self, source: u32, synapses: &[Reached], draft: &mut Draft) {
        while self.planned.peek().is_some_and(|panel| panel.end <= source) {
            self.close();
        }
        let mut own = None;
        if let Some(panel) = self.planned.peek().filter(|panel| panel.first <= source) {
            if self.counts.is_empty() {
                self.counts = vec![0; panel.sources()];
                for (chunk, place) in panel.chunks.iter().zip(1..) {
                    self.places[*chunk as usize] = place;
                }
                self.weights.resize(self.weights.len() + panel.size(), [0; LANES]);
            }
            let at = (source - panel.first) as usize;
            let begin = self.weights.len() - panel.size() + at * panel.chunks.len();
            own = Some((&mut self.weights[begin..begin + panel.chunks.len()], &mut self.counts[at]));
        }
        for &(lane, weight) in synapses {
            let (chunk, offset) = (lane as usize / LANES, lane as usize % LANES);
            let row = own.as_mut().and_then(|(weights, count)| {
                let weight_of_lane = &mut weights[(self.places[chunk] as usize).checked_sub(1)?][offset];
                // Several synapses to one lane add up, as long as 16 bits hold the sum.
                *weight_of_lane = weight_of_lane.checked_add(weight)?;
                **count += 1;
                Some(())
            });
            if row.is_none() {
                draft.push(lane, weight);
            }
        }
    }

    /// Ends the present panel.
    fn close(&mut self) {
        let Some(Planned { first, end, chunks, .. }) = self.planned.next() else { return };
        let mut rows: Vec<Row> = Vec::new();
        for &chunk in &chunks {
            self.places[chunk as usize] = 0;
            match rows.last_mut() {
                Some(row) if row.target / LANES as u32 + row.chunks == chunk => row.chunks += 1,
                _ => rows.push(Row { target: chunk * LANES as u32, chunks: 1 }),
            }
        }
        let counts = std::mem::take(&mut self.counts);
        let stride = chunks.len();
        let weights = self.weights.len() - stride * (end - first) as usize;
        let synapses = match counts.first() {
            Some(&first) if counts.iter().all(|&count| count == first) => Counts::Same(first),
            _ => Counts::Each(counts),
        };
        self.panels.push(Panel { first, end, rows, weights, stride, synapses });
    }

    /// The panels.
    pub fn finish(mut self) -> Panels {
        while self.planned.peek().is_some() {
            self.close();
        }
        self.panels.shrink_to_fit();
        let mut weights = Aligned::new(self.weights.len() * LANES);
        weights.copy_from_slice(self.weights.as_flattened());
        Panels { panels: self.panels, weights }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;
    use crate::machine::lists::{Lists, Part, Synapses};
    use std::collections::BTreeMap;

    /// Lays sources out, and checks that rows and lists together hold each source's weights by lane and its number of synapses.
    /// Returns the panels and the number of synapses in lists.
    fn laid_out(sources: &[Vec<Reached>], lanes: usize) -> (Panels, usize) {
        let mut plan = Plan::new(lanes);
        for (source, synapses) in (0..).zip(sources) {
            plan.take(source, synapses);
        }
        let (mut layout, mut draft) = (plan.layout(), Draft::new(lanes));
        for (source, synapses) in (0..).zip(sources) {
            layout.put(source, synapses, &mut draft);
            draft.close();
        }
        let (panels, table) = (layout.finish(), draft.finish().unwrap());
        assert!(panels.panels.is_sorted_by(|a, b| a.end <= b.first));
        let mut all_listed = 0;
        for (source, synapses) in (0u32..).zip(sources) {
            let (mut expected, mut held) = (BTreeMap::new(), BTreeMap::new());
            for &(lane, weight) in synapses {
                *expected.entry(lane).or_insert(0) += i32::from(weight);
            }
            let mut count = 0;
            let mut hold = |lane: usize, weight: i16| *held.entry(lane as u32).or_insert(0) += i32::from(weight);
            if let Some(table) = &table {
                let place = table.places[source as usize];
                count += place.len();
                all_listed += place.len();
                match &table.synapses {
                    Synapses::Small(lists) => {
                        lists.each(place, Part::Whole, |lane, weight| hold(lane.into(), weight.into()));
                    }
                    Synapses::Packed(lists) => lists.each(place, Part::Whole, &mut hold),
                    Synapses::Apart(lists) => lists.each(place, Part::Whole, &mut hold),
                }
            }
            if let Some(panel) = panels.panels.iter().find(|panel| (panel.first..panel.end).contains(&source)) {
                let at = (source - panel.first) as usize;
                count += match &panel.synapses {
                    Counts::Same(count) => *count as usize,
                    Counts::Each(counts) => counts[at] as usize,
                };
                let mut chunks = panels.weights()[panel.weights + at * panel.stride..].iter();
                for row in &panel.rows {
                    for lane in (row.target as usize..).take(row.chunks as usize * LANES).step_by(LANES) {
                        let weights = chunks.next().unwrap().iter().zip(lane..);
                        weights.filter(|(weight, _)| **weight != 0).for_each(|(&weight, lane)| hold(lane, weight));
                    }
                }
            }
            assert_eq!(count, synapses.len(), "source {source}");
            // Weights of 0, and sums of several that are, are held in lists only.
            held.retain(|_, sum| *sum != 0);
            expected.retain(|_, sum| *sum != 0);
            assert_eq!(held, expected, "source {source}");
        }
        (panels, all_listed)
    }

    /// Sources with a synapse to each of these lanes in so many of 1,000 cases.
    fn some(sources: u64, lanes: std::ops::Range<u32>, per_mille: u64) -> Vec<Vec<Reached>> {
        let of = |source: u64, lane: u32| {
            let weight = rng::below(511, 2, source, lane.into()) as i16 - 255;
            (rng::below(1_000, 1, source, lane.into()) < per_mille).then_some((lane, weight))
        };
        (0..sources).map(|source| lanes.clone().filter_map(|lane| of(source, lane)).collect()).collect()
    }

    #[test]
    fn missing_synapses_break_no_row() {
        for per_mille in [1_000, 900, 600] {
            let mut sources = some(2_000, 0..62, per_mille);
            // Where a channel was pruned, nothing is left of it.
            for source in (100..1_900).filter(|k| per_mille < 1_000 && rng::below(4, 7, *k as u64, 0) == 0) {
                sources[source].clear();
            }
            let (panels, listed) = laid_out(&sources, 64);
            assert_eq!((panels.panels.len(), listed), (1, 0), "{per_mille}");
            assert_eq!(panels.panels[0].rows, [Row { target: 0, chunks: 4 }]);
            assert_eq!(matches!(panels.panels[0].synapses, Counts::Same(62)), per_mille == 1_000);
            assert_eq!(panels.weights().len(), 4 * panels.panels[0].end as usize);
        }
    }

    #[test]
    fn few_synapses_over_many_lanes_are_listed() {
        for (lanes, synapses) in [(20_000, 5), (20_000, 64), (2_000, 5), (2_000, 64)] {
            let lane = |source, index| rng::below(lanes, 1, source, index) as u32;
            let of = |source| (0..synapses).map(|index| (lane(source, index), 1)).collect();
            let (panels, listed) = laid_out(&(0..10_000).map(of).collect::<Vec<_>>(), lanes as usize);
            assert_eq!((panels.panels.len(), listed), (0, 10_000 * synapses as usize), "{synapses} of {lanes}");
        }
    }

    /// In a network that the cache holds, chunks of zeros cost less than lists.
    #[test]
    fn few_synapses_over_few_lanes_stand_in_rows() {
        let (panels, listed) = laid_out(&some(500, 0..500, 100), 512);
        assert_eq!((panels.panels.len(), listed), (1, 0));
    }

    #[test]
    fn dense_targets_stand_in_rows_and_the_others_in_lists() {
        let far = |source| (0..50).map(|index| (1_000 + rng::below(49_000, 3, source, index) as u32, 1)).collect();
        let (near, far) = (some(3_000, 100..300, 950), (0..3_000).map(far).collect::<Vec<Vec<Reached>>>());
        let sources: Vec<Vec<Reached>> = near.into_iter().zip(far).map(|(near, far)| [near, far].concat()).collect();
        let (panels, listed) = laid_out(&sources, 50_000);
        assert_eq!(panels.panels.len(), 1);
        assert_eq!(panels.panels[0].rows, [Row { target: 96, chunks: 13 }]);
        assert_eq!(listed, 50 * 3_000);
    }

    /// Panels of different rows stay apart, broken by pruning or not.
    #[test]
    fn a_wide_panel_beside_a_narrow_one_is_not_made_of_zeros() {
        for per_mille in [1_000, 800] {
            let wide = some(78, 0..50, per_mille);
            let sources: Vec<_> = wide.into_iter().chain(some(3_000, 64..74, per_mille)).collect();
            let (panels, listed) = laid_out(&sources, 128);
            let shapes: Vec<_> = panels.panels.iter().map(|panel| (panel.first, panel.end, panel.stride)).collect();
            assert_eq!((shapes, listed), (vec![(0, 78, 4), (78, 3_078, 1)], 0));
        }
    }

    /// Other targets, another panel; and sources far apart share none.
    #[test]
    fn unlike_sources_share_no_panel() {
        let mut sources = some(400, 0..200, 1_000);
        sources.extend(some(400, 1_000..1_200, 1_000));
        sources.extend(vec![Vec::new(); 5_000]);
        sources.extend(some(400, 1_000..1_200, 1_000));
        let (panels, listed) = laid_out(&sources, 2_000);
        let ranges: Vec<_> = panels.panels.iter().map(|panel| (panel.first, panel.end)).collect();
        assert_eq!((ranges, listed), (vec![(0, 400), (400, 800), (5_800, 6_200)], 0));
        assert_eq!(panels.weights().len(), 1_200 * 13);
    }

    /// Targets that move from source to source, several synapses to one lane, and weights whose sum 16 bits do not hold.
    #[test]
    fn whatever_the_form_nothing_is_lost() {
        for seed in 0..40 {
            let draw = |below, source, index| rng::below(below, 10 + seed, source, index);
            let lanes = [64, 300, 5_000, 70_000][seed as usize % 4];
            let width = [lanes, 40, 200, 3][seed as usize / 4 % 4].min(lanes);
            let many = [3, 30, 300][seed as usize / 16 % 3];
            let of = |source, index| {
                let lane = (source * [0, 1, 7][seed as usize % 3] + draw(width, source, index)) % lanes;
                let weight = draw(1 << 16, source, index + 1_000) as i16 >> [0, 4, 8][seed as usize % 3];
                (lane as u32, weight)
            };
            let sources: Vec<Vec<Reached>> = (0..300)
                .map(|source| (0..draw(many, source, 5_000)).map(|index| of(source, index)).collect())
                .collect();
            laid_out(&sources, lanes as usize);
        }
    }
}
