//! Rows of synapses: those of a source's that stand lane beside lane, with zeros where there is none.
//!
//! Comes in: which sources are to be panels (`plan`), and their synapses. Goes out: [`Panels`]. What is in no row remains for
//! the lists. How many synapses a source has is kept beside its row, for zeros are no synapses.

use crate::base::id::Id;
use crate::machine::layout::planner::Planned;
use crate::machine::layout::store::Aligned;
use crate::machine::update::kernel::LANES;

/// Consecutive lanes that each source of a panel reaches.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Row {
    /// The first lane, a multiple of sixteen.
    pub target: u32,
    /// Chunks of sixteen lanes.
    pub chunks: u32,
}

/// Consecutive sources whose synapses are laid out over the same lanes, each with weights of its own: a dense projection
/// makes one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Panel {
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

/// Chunks of a row whose sums can stay in registers.
const NARROW: u32 = 4;

impl Panel {
    /// Its row, where it has but one that is narrow.
    #[inline(always)]
    pub fn narrow(&self) -> Option<&Row> {
        match self.rows.as_slice() {
            [row @ Row { chunks: 1..=NARROW, .. }] => Some(row),
            _ => None,
        }
    }

    /// Synapses of these sources, which are all the panel's.
    #[inline(always)]
    pub fn synapses<I: Id>(&self, ids: &[I]) -> u64 {
        match &self.synapses {
            Counts::Same(count) => u64::from(*count) * ids.len() as u64,
            Counts::Each(counts) => ids.iter().map(|id| u64::from(counts[id.index() - self.first as usize])).sum(),
        }
    }

    /// Makes the mean number of synapses that of every source; adds to `excess`, by source, by how much it was missed.
    pub fn even_out(&mut self, excess: &mut [i32]) {
        let Counts::Each(counts) = &self.synapses else { return };
        let sum: u64 = counts.iter().map(|&count| u64::from(count)).sum();
        // No count of a row's lanes comes near 31 bits, nor does their mean.
        let mean = (sum / counts.len().max(1) as u64) as u32;
        for (&count, excess) in counts.iter().zip(&mut excess[self.first as usize..]) {
            *excess += count as i32 - mean as i32;
        }
        self.synapses = Counts::Same(mean);
    }
}

/// A number for each source.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Counts {
    /// The same for all.
    Same(u32),
    /// In order.
    Each(Vec<u32>),
}

/// Panels by their sources, which do not overlap.
#[derive(Debug)]
pub(crate) struct Panels {
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

/// Panels while their weights are written.
#[derive(Debug)]
pub(crate) struct Layout {
    /// What is to come, the present panel first.
    planned: std::iter::Peekable<std::vec::IntoIter<Planned>>,
    /// One more than the place of each chunk in a source's weights of the present panel; 0 where it is in none.
    places: Vec<u32>,
    panels: Vec<Panel>,
    weights: Aligned<i16>,
    /// Chunks of weights up to the end of the present panel.
    end: usize,
    /// Synapses of the present panel's sources.
    counts: Vec<u32>,
}

impl Layout {
    /// Of these panels, ascending, of a share with so many lanes.
    pub fn new(planned: Vec<Planned>, lanes: usize) -> Self {
        let size: usize = planned.iter().map(Planned::size).sum();
        Layout {
            planned: planned.into_iter().peekable(),
            places: vec![0; lanes.div_ceil(LANES)],
            panels: Vec::new(),
            weights: Aligned::new(size * LANES),
            end: 0,
            counts: Vec::new(),
        }
    }

    /// Whether no panel is to come.
    pub fn is_empty(&mut self) -> bool {
        self.planned.peek().is_none()
    }

    /// Writes a synapse into its source's rows; says whether it has one. Sources come in ascending order.
    #[inline]
    pub fn put(&mut self, source: u32, lane: u32, weight: i16) -> bool {
        while self.planned.peek().is_some_and(|panel| panel.end <= source) {
            self.close();
        }
        let Some(panel) = self.planned.peek().filter(|panel| panel.first <= source) else { return false };
        if self.counts.is_empty() {
            self.counts = vec![0; panel.sources()];
            for (chunk, place) in panel.chunks.iter().zip(1..) {
                self.places[*chunk as usize] = place;
            }
            self.end += panel.size();
        }
        let (chunk, offset) = (lane as usize / LANES, lane as usize % LANES);
        let Some(place) = (self.places[chunk] as usize).checked_sub(1) else { return false };
        let at = (source - panel.first) as usize;
        let begin = self.end - panel.size() + at * panel.chunks.len();
        let weight_of_lane = &mut self.weights[(begin + place) * LANES + offset];
        // Several synapses to one lane add up, as long as 16 bits hold the sum.
        let Some(sum) = weight_of_lane.checked_add(weight) else { return false };
        *weight_of_lane = sum;
        self.counts[at] += 1;
        true
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
        let weights = self.end - stride * (end - first) as usize;
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
        Panels { panels: self.panels, weights: self.weights }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;
    use crate::machine::layout::image::Reach;
    use crate::machine::layout::lists::{Draft, Reached};
    use std::collections::BTreeMap;

    /// Lays sources out, and checks that rows and lists together hold each source's weights by lane and its number of synapses.
    /// Returns the panels and the number of synapses in lists.
    fn laid_out(sources: &[Vec<Reached>], lanes: usize) -> (Panels, usize) {
        let mut draft = Draft::new(lanes);
        for synapses in sources {
            draft.append(&[synapses.len() as u32], synapses);
        }
        let Some(Reach { panels, table, .. }) = Reach::new(0, draft, lanes).unwrap() else { panic!("no synapses") };
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
                table.list(source as usize).into_iter().for_each(|(lane, weight)| hold(lane as usize, weight));
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
