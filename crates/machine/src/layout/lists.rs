//! Lists of synapses by source.
//!
//! Input: lanes and weights by source ([`ListBuilder`]), by delay. Output: a [`ListTable`] in the
//! narrowest form that fits all. Errors: more synapses than a list position can index.
//!
//! A source has one list for all delays, in ascending order. With a list for each delay, a spike
//! would look up and pad as many lists. A synapse therefore names a *target*: its lane plus the
//! lanes of a slot for each step by which its delay exceeds the shortest.

use std::ops::Range;

use crate::layout::padded_runs;
use crate::layout::padded_runs::{Compact, ListPlace, Packing, PaddedRuns};
use nsim_ir::spikes::Spike;

/// Synapses of the sources of one kind; weights in units of 64.
#[derive(Debug)]
pub(crate) struct ListTable {
    /// The shortest delay field.
    pub shortest: u8,
    /// The longest delay field.
    pub longest: u8,
    /// Place of each source's list.
    pub places: Vec<ListPlace>,
    /// A bit for each source with a list, if few have one: other places are not looked up.
    pub few: Option<Vec<u64>>,
    pub synapses: ListForm,
}

/// Targets and weights.
#[derive(Debug)]
pub(crate) enum ListForm {
    /// Weights of 8 bits and lanes of 16, all of one delay; longer lists have larger runs.
    Fours(PaddedRuns<Compact, 4>),
    Eights(PaddedRuns<Compact, 8>),
    Sixteens(PaddedRuns<Compact, 16>),
    /// Target and weight in one word; longer lists have larger runs.
    Packed(PaddedRuns<Packing, 4>),
    PackedSixteens(PaddedRuns<Packing, 16>),
    /// Lists of at most one synapse.
    Singles(Singles),
    /// Targets and weights in separate arrays.
    Split(Split),
}

/// Number of lanes that 16 bits can address.
pub(crate) const ADDRESSED: usize = 1 << 16;

/// Sources with a list are few if they are fewer than one in this many.
const FEW: usize = 8;

/// Least number of lanes of a shard whose lists are compact. Smaller shards fit the cache anyway,
/// and would need many times their number of sums.
const COMPACT_FROM: usize = 1 << 12;

impl ListForm {
    /// Whether lanes have 16 bits.
    pub fn is_compact(&self) -> bool {
        matches!(self, ListForm::Fours(_) | ListForm::Eights(_) | ListForm::Sixteens(_))
    }
}

/// At most one synapse a source, as in a layer that passes its input on. Neither place nor length
/// of a list is looked up.
#[derive(Debug)]
pub(crate) struct Singles(Vec<Single>);

/// The synapse of a source, if there is one.
#[derive(Debug, Clone, Copy, Default)]
struct Single {
    target: u32,
    weight: i16,
    /// Number of synapses, 0 or 1.
    synapses: u16,
}

impl Singles {
    /// Stores lists of at most one synapse.
    fn new(lists: impl Iterator<Item = Range<usize>>, mut synapses: impl Iterator<Item = (usize, i16)>) -> Self {
        let single = |list: Range<usize>| match list.is_empty() {
            true => Single::default(),
            false => synapses.next().map_or(Single::default(), |(target, weight)| Single {
                target: target as u32,
                weight,
                synapses: 1,
            }),
        };
        Singles(lists.map(single).collect())
    }

    /// [`PaddedRuns::deliver`] for single synapses.
    #[inline(always)]
    pub fn deliver<P: Spike>(&self, spikes: &[P], below: usize, mut add: impl FnMut(usize, i16, P::Payload)) -> u64 {
        let mut events = 0;
        for spike in spikes {
            let Single { target, weight, synapses } = self.0[spike.source()];
            if synapses > 0 && (target as usize) < below {
                events += 1;
                add(target as usize, weight, spike.payload());
            }
        }
        events
    }
}

/// Targets and weights in separate arrays, where they do not fit one word.
#[derive(Debug)]
pub(crate) struct Split {
    targets: Vec<u32>,
    weights: Vec<i16>,
}

impl Split {
    /// [`PaddedRuns::deliver`] for separate arrays.
    #[inline(always)]
    pub fn deliver<P: Spike>(
        &self,
        places: &[ListPlace],
        spikes: &[P],
        below: usize,
        mut add: impl FnMut(usize, i16, P::Payload),
    ) -> u64 {
        let mut events = 0;
        for spike in spikes {
            let elements = places[spike.source()].elements();
            let (targets, weights) = (&self.targets[elements.clone()], &self.weights[elements]);
            let near = targets.iter().zip(weights).take_while(|(target, _)| (**target as usize) < below);
            for (&target, &weight) in near {
                events += 1;
                add(target as usize, weight, spike.payload());
            }
        }
        events
    }
}

impl ListTable {
    /// Joins the lists of these delays, ascending; `None` when there is no synapse. A slot has
    /// `lanes` lanes.
    ///
    /// # Errors
    /// The number of synapses, when positions do not fit.
    pub fn new(delays: Vec<(u8, ListBuilder)>, lanes: usize) -> Result<Option<Self>, usize> {
        let mut non_empty: Vec<(u8, ListBuilder)> = delays.into_iter().filter(|(_, lists)| lists.len() > 0).collect();
        let (Some(&(shortest, _)), Some(&(longest, _))) = (non_empty.first(), non_empty.last()) else {
            return Ok(None);
        };
        let all = match non_empty.len() {
            1 => non_empty.remove(0).1,
            _ => {
                let after = |delay: u8| usize::from(delay - shortest) * lanes;
                let mut all = ListBuilder::new(after(longest) + lanes);
                for source in 0..non_empty[0].1.ends.len() {
                    for (delay, lists) in &non_empty {
                        for (lane, weight) in lists.list(source) {
                            all.push((lane + after(*delay) as u32, weight));
                        }
                    }
                    all.ends.push(all.len());
                }
                all
            }
        };
        let (places, synapses) = all.finish(shortest == longest)?;
        let few = places.iter().filter(|place| place.len() > 0).count() * FEW < places.len();
        let bits =
            |places: &[ListPlace]| places.iter().rev().fold(0, |bits, place| bits << 1 | u64::from(place.len() > 0));
        let few = few.then(|| places.chunks(64).map(bits).collect());
        Ok(Some(ListTable { shortest, longest, places, few, synapses }))
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let synapses = match &self.synapses {
            ListForm::Fours(runs) => runs.bytes(),
            ListForm::Eights(runs) => runs.bytes(),
            ListForm::Sixteens(runs) => runs.bytes(),
            ListForm::Packed(runs) => runs.bytes(),
            ListForm::PackedSixteens(runs) => runs.bytes(),
            ListForm::Singles(singles) => size_of_val(singles.0.as_slice()),
            ListForm::Split(split) => 6 * split.targets.len(),
        };
        size_of_val(self.places.as_slice()) + self.few.as_ref().map_or(0, |few| size_of_val(few.as_slice())) + synapses
    }
}

/// A synapse: lane or target, and weight in units of 64.
pub(crate) type LaneWeight = (u32, i16);

/// Synapses in the order of sources, before their form is chosen.
#[derive(Debug)]
pub(crate) struct ListBuilder {
    lanes: usize,
    packing: Packing,
    /// Number of synapses up to the end of each source.
    ends: Vec<usize>,
    words: Words,
}

/// Lanes and weights, in words while all fit.
#[derive(Debug)]
enum Words {
    Packed(Vec<u32>),
    Split { targets: Vec<u32>, weights: Vec<i16> },
}

impl ListBuilder {
    /// A builder for lanes or targets below `lanes`.
    pub fn new(lanes: usize) -> Self {
        ListBuilder { lanes, packing: Packing::new(lanes), ends: Vec::new(), words: Words::Packed(Vec::new()) }
    }

    fn len(&self) -> usize {
        match &self.words {
            Words::Packed(words) => words.len(),
            Words::Split { targets, .. } => targets.len(),
        }
    }

    /// Appends a synapse; the first synapse that does not fit a word splits all.
    fn push(&mut self, (target, weight): LaneWeight) {
        if let Words::Packed(words) = &mut self.words {
            if let Some(word) = self.packing.pack(target, weight) {
                return words.push(word);
            }
            let packing = self.packing;
            let (targets, weights) = words.iter().map(|&w| packing.unpack(w)).map(|(t, w)| (t as u32, w)).unzip();
            self.words = Words::Split { targets, weights };
        }
        if let Words::Split { targets, weights } = &mut self.words {
            targets.push(target);
            weights.push(weight);
        }
    }

    /// The synapses of a source.
    fn list(&self, source: usize) -> impl Iterator<Item = LaneWeight> {
        let begin = if source == 0 { 0 } else { self.ends[source - 1] };
        (begin..self.ends[source]).map(|at| match &self.words {
            Words::Packed(words) => {
                let (target, weight) = self.packing.unpack(words[at]);
                (target as u32, weight)
            }
            Words::Split { targets, weights } => (targets[at], weights[at]),
        })
    }

    /// Appends the lists of the next sources; `counts` has the length of each.
    pub fn append(&mut self, counts: &[u32], mut synapses: &[LaneWeight]) {
        for &count in counts {
            let list;
            (list, synapses) = synapses.split_at(count as usize);
            list.iter().for_each(|&synapse| self.push(synapse));
            self.ends.push(self.len());
        }
    }

    /// Calls `take` with each source, ascending, and its lanes.
    pub fn each(&self, mut take: impl FnMut(u32, &[u32])) {
        let (mut begin, mut unpacked) = (0, Vec::new());
        for (source, &end) in (0..).zip(&self.ends) {
            let list = begin..end;
            begin = end;
            match &self.words {
                Words::Packed(words) => {
                    unpacked.clear();
                    unpacked.extend(words[list].iter().map(|&word| self.packing.unpack(word).0 as u32));
                    take(source, &unpacked);
                }
                Words::Split { targets, .. } => take(source, &targets[list]),
            }
        }
    }

    /// Removes the synapses for which `keep` is false of source, lane and weight.
    pub fn retain(&mut self, mut keep: impl FnMut(u32, u32, i16) -> bool) {
        let (mut begin, mut kept, mut fit) = (0, 0, true);
        for (source, end) in (0..).zip(&mut self.ends) {
            let list = begin..*end;
            begin = list.end;
            for at in list {
                match &mut self.words {
                    Words::Packed(words) => {
                        let (target, weight) = self.packing.unpack(words[at]);
                        if keep(source, target as u32, weight) {
                            words[kept] = words[at];
                            kept += 1;
                        }
                    }
                    Words::Split { targets, weights } => {
                        let (target, weight) = (targets[at], weights[at]);
                        if keep(source, target, weight) {
                            (targets[kept], weights[kept]) = (target, weight);
                            fit &= self.packing.pack(target, weight).is_some();
                            kept += 1;
                        }
                    }
                }
            }
            *end = kept;
        }
        match &mut self.words {
            Words::Packed(words) => words.truncate(kept),
            Words::Split { targets, weights } => {
                targets.truncate(kept);
                weights.truncate(kept);
                if fit {
                    let all = targets.iter().zip(weights);
                    self.words = Words::Packed(all.filter_map(|(&t, &mut w)| self.packing.pack(t, w)).collect());
                }
            }
        }
    }

    /// The place of each list, and the synapses; `one_delay` if all have one delay.
    ///
    /// # Errors
    /// The number of synapses, when positions do not fit.
    fn finish(self, one_delay: bool) -> Result<(Vec<ListPlace>, ListForm), usize> {
        let ListBuilder { lanes, packing, ends, words } = self;
        let begins = || std::iter::once(0).chain(ends.iter().copied());
        let lists = || begins().zip(&ends).map(|(begin, &end)| begin..end);
        let fits = |&word: &u32| {
            let (target, weight) = packing.unpack(word);
            u16::try_from(target).is_ok() && i8::try_from(weight).is_ok()
        };
        let compact =
            one_delay && lanes >= COMPACT_FROM && matches!(&words, Words::Packed(words) if words.iter().all(fits));
        let lengths = lists().map(|list| list.len());
        // Places of lists that are not padded.
        let places = || lists().map(|list| ListPlace::new(list.start, list.len())).collect::<Option<Vec<_>>>();
        match words {
            Words::Packed(words) if lists().all(|list| list.len() <= 1) => {
                let singles = Singles::new(lists(), words.iter().map(|&word| packing.unpack(word)));
                places().map(|places| (places, ListForm::Singles(singles)))
            }
            Words::Packed(words) => {
                let synapses = words.iter().map(|&word| packing.unpack(word));
                let cost = |size| padded_runs::cost(size, lengths.clone());
                let sizes: &[usize] = if compact { &[4, 8, 16] } else { &[4, 16] };
                match sizes.iter().copied().min_by(|&a, &b| cost(a).total_cmp(&cost(b))) {
                    Some(16) if compact => named(PaddedRuns::new(Compact, lengths, synapses), ListForm::Sixteens),
                    Some(8) => named(PaddedRuns::new(Compact, lengths, synapses), ListForm::Eights),
                    _ if compact => named(PaddedRuns::new(Compact, lengths, synapses), ListForm::Fours),
                    Some(16) => named(PaddedRuns::new(packing, lengths, synapses), ListForm::PackedSixteens),
                    _ => named(PaddedRuns::new(packing, lengths, synapses), ListForm::Packed),
                }
            }
            Words::Split { mut targets, mut weights } => {
                targets.shrink_to_fit();
                weights.shrink_to_fit();
                places().map(|places| (places, ListForm::Split(Split { targets, weights })))
            }
        }
        .ok_or_else(|| ends.last().copied().unwrap_or(0))
    }
}

/// Returns the places, and the runs as a [`ListForm`].
fn named<G>(made: Option<(Vec<ListPlace>, G)>, form: fn(G) -> ListForm) -> Option<(Vec<ListPlace>, ListForm)> {
    made.map(|(places, runs)| (places, form(runs)))
}

#[cfg(test)]
impl ListBuilder {
    /// These lists, one a source.
    pub fn holding(lists: &[Vec<LaneWeight>], lanes: usize) -> Self {
        let mut builder = ListBuilder::new(lanes);
        lists.iter().for_each(|list| builder.append(&[list.len() as u32], list));
        builder
    }
}

#[cfg(test)]
impl ListTable {
    /// Lane and weight of each synapse of a source.
    pub fn list(&self, source: usize) -> Vec<LaneWeight> {
        use nsim_ir::base::id::{ChannelId, Id};
        let (ids, place, mut queue) = ([ChannelId::new(source)], self.places[source], Vec::new());
        let mut list = Vec::new();
        let push = |lane: usize, weight, ()| list.push((lane as u32, weight));
        match &self.synapses {
            ListForm::Fours(runs) => runs.deliver(&self.places, &ids, (usize::MAX, &mut queue), push),
            ListForm::Eights(runs) => runs.deliver(&self.places, &ids, (usize::MAX, &mut queue), push),
            ListForm::Sixteens(runs) => runs.deliver(&self.places, &ids, (usize::MAX, &mut queue), push),
            ListForm::Packed(runs) => runs.deliver(&self.places, &ids, (usize::MAX, &mut queue), push),
            ListForm::PackedSixteens(runs) => runs.deliver(&self.places, &ids, (usize::MAX, &mut queue), push),
            ListForm::Singles(singles) => singles.deliver(&ids, usize::MAX, push),
            ListForm::Split(lists) => lists.deliver(&self.places, &ids, usize::MAX, push),
        };
        // Padding comes last.
        list.truncate(place.len());
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    /// Returns the lists as read from their table, and the table.
    fn read(lists: &[Vec<LaneWeight>], lanes: usize) -> (Vec<Vec<LaneWeight>>, ListTable) {
        let table = ListTable::new(vec![(0, ListBuilder::holding(lists, lanes))], lanes).unwrap().unwrap();
        ((0..lists.len()).map(|source| table.list(source)).collect(), table)
    }

    fn draw(sources: u64, lanes: u64, weight: i64) -> Vec<Vec<(u32, i16)>> {
        let of = |source, index| {
            let weight = rng::below(2 * weight as u64, 2, source, index) as i64 - weight;
            (rng::below(lanes, 1, source, index) as u32, weight as i16)
        };
        (0..sources).map(|source| (0..rng::below(60, 3, source, 0)).map(|index| of(source, index)).collect()).collect()
    }

    /// Lists are stored in the narrowest form that fits, and read back as they were.
    #[test]
    fn tables_hold_what_they_were_given() {
        let compact = draw(200, 65_536, 128);
        let (out, table) = read(&compact, 65_536);
        assert_eq!(out, compact);
        assert!(table.synapses.is_compact());
        for (lanes, weight) in [(65_537, 128), (8_000, 129), (4_000, 128), (1_000_000, 2_000)] {
            let mut packed = draw(200, lanes, weight);
            packed[7].extend([(lanes as u32 - 1, (weight - 1) as i16), (0, -weight as i16)]);
            let (out, table) = read(&packed, lanes as usize);
            assert_eq!(out, packed);
            assert!(matches!(table.synapses, ListForm::PackedSixteens(_)), "{lanes} {weight}");
        }
        let mut apart = draw(200, 1_000_000, 2_000);
        apart[100].push((999_999, i16::MIN));
        let (out, table) = read(&apart, 1_000_000);
        assert_eq!(out, apart);
        assert!(matches!(table.synapses, ListForm::Split(_)));
    }

    #[test]
    fn longer_lists_have_larger_runs() {
        let of = |length: u64| {
            let list = |source| (0..length).map(|k| (rng::below(8_000, 1, source, k) as u32, 1)).collect();
            read(&(0..100).map(list).collect::<Vec<_>>(), 8_000).1.synapses
        };
        assert!(matches!((of(3), of(8), of(64)), (ListForm::Fours(_), ListForm::Eights(_), ListForm::Sixteens(_))));
    }

    /// One list holds the synapses of all delays, shorter delays first.
    #[test]
    fn delays_are_joined() {
        let (lanes, delays) = (300, [3, 4, 20]);
        let lists = delays.map(|delay| draw(50, lanes, 100 + i64::from(delay)));
        let builders =
            delays.iter().zip(&lists).map(|(&delay, lists)| (delay, ListBuilder::holding(lists, lanes as usize)));
        let table = ListTable::new(builders.collect(), lanes as usize).unwrap().unwrap();
        assert_eq!((table.shortest, table.longest), (3, 20));
        for source in 0..50 {
            let after = |delay: u8| u32::from(delay - 3) * lanes as u32;
            let of = delays.iter().zip(&lists).flat_map(|(&delay, lists)| {
                lists[source].iter().map(move |&(lane, weight)| (lane + after(delay), weight))
            });
            assert_eq!(table.list(source), of.collect::<Vec<_>>());
        }
    }

    #[test]
    fn lists_of_one_synapse_are_held_without_places() {
        let lists: Vec<Vec<LaneWeight>> = (0..300u32)
            .map(|source| (0..u32::from(source % 7 > 0)).map(|_| (299 - source, source as i16 - 100)).collect())
            .collect();
        for lanes in [300, 5_000] {
            let (out, table) = read(&lists, lanes);
            assert_eq!(out, lists);
            assert!(matches!(table.synapses, ListForm::Singles(_)));
        }
    }
}
