//! Synapses one by one, listed by source.
//!
//! Comes in: lanes and weights, source after source ([`Draft`]). Goes out: a [`Table`] of them in the narrowest form that
//! holds all. Where spikes are rare their lists come from far away in memory, and what a synapse costs is the lines of the
//! cache that it lies in; so a list is laid where it touches as few as its length allows. What it leaves out on purpose:
//! lanes beside each other, which are rows of `panels`, and how lists are written and read (`groups`).

use std::ops::Range;

use crate::base::id::Id;
use crate::machine::deliver::prefetch::LINE;
use crate::machine::layout::padded_runs::{self, Groups, Packing, Small};

/// Bytes from one place where a list can begin to the next.
pub(crate) const STEP: usize = 4;

/// Synapses from the sources of one kind; weights in units of 64.
#[derive(Debug)]
pub(crate) struct Table {
    /// Where each source's list is.
    pub places: Vec<Place>,
    /// The synapses.
    pub synapses: Synapses,
}

/// Where a source's list is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Place {
    /// Its beginning, in units of [`STEP`] bytes; in synapses where they are apart.
    start: u32,
    /// How many synapses.
    count: u32,
}

impl Place {
    /// Number of synapses.
    #[inline(always)]
    pub fn len(self) -> usize {
        self.count as usize
    }

    /// Its beginning, in units of [`STEP`] bytes.
    #[inline(always)]
    pub fn start(self) -> usize {
        self.start as usize
    }

    /// Where they are in arrays of one element each.
    #[inline(always)]
    fn elements(self) -> Range<usize> {
        self.start as usize..self.start as usize + self.len()
    }
}

/// Lanes and weights.
#[derive(Debug)]
pub(crate) enum Synapses {
    /// Weights of 8 bits and lanes of 16; the longer lists are, the larger are groups.
    Fours(Groups<Small, 4>),
    /// The same.
    Eights(Groups<Small, 8>),
    /// The same.
    Sixteens(Groups<Small, 16>),
    /// Weights that fit beside their lanes.
    Packed(Groups<Packing, 4>),
    /// Any.
    Apart(Apart),
}

/// Lanes that 16 bits name.
pub(crate) const ADDRESSED: usize = 1 << 16;

/// Lanes of a share from which on its lists may be small: below, they are in reach as they are, and all sums that 16 bits name
/// would be many times those that there are.
const SMALL_FROM: usize = 1 << 12;

impl Synapses {
    /// Whether they name lanes by 16 bits whatever the number of lanes.
    pub fn small(&self) -> bool {
        matches!(self, Synapses::Fours(_) | Synapses::Eights(_) | Synapses::Sixteens(_))
    }
}

/// Lanes and weights apart, where a weight does not fit beside its lane.
#[derive(Debug)]
pub(crate) struct Apart {
    targets: Vec<u32>,
    weights: Vec<i16>,
}

impl Apart {
    /// Calls with lane and weight of every synapse that these sources reach; returns how many there are.
    #[inline(always)]
    pub fn deliver<I: Id>(&self, places: &[Place], ids: &[I], mut add: impl FnMut(usize, i16)) -> u64 {
        let mut events = 0;
        for place in ids.iter().map(|id| places[id.index()]) {
            events += place.len() as u64;
            let (targets, weights) = (&self.targets[place.elements()], &self.weights[place.elements()]);
            targets.iter().zip(weights).for_each(|(&target, &weight)| add(target as usize, weight));
        }
        events
    }
}

impl Table {
    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let synapses = match &self.synapses {
            Synapses::Fours(groups) => groups.bytes(),
            Synapses::Eights(groups) => groups.bytes(),
            Synapses::Sixteens(groups) => groups.bytes(),
            Synapses::Packed(groups) => groups.bytes(),
            Synapses::Apart(apart) => 6 * apart.targets.len(),
        };
        size_of_val(self.places.as_slice()) + synapses
    }
}

/// A synapse that a source reaches: lane, and weight in units of 64.
pub(crate) type Reached = (u32, i16);

/// A table while it is written: lanes and weights as they come.
#[derive(Debug)]
pub(crate) struct Draft {
    lanes: usize,
    packing: Packing,
    /// Synapses up to the end of each source.
    ends: Vec<usize>,
    words: Words,
}

/// Synapses in the order of sources, without gaps.
#[derive(Debug)]
enum Words {
    Packed(Vec<u32>),
    Apart { targets: Vec<u32>, weights: Vec<i16> },
}

impl Draft {
    /// Nothing yet, of a share with so many lanes.
    pub fn new(lanes: usize) -> Self {
        Draft { lanes, packing: Packing::new(lanes), ends: Vec::new(), words: Words::Packed(Vec::new()) }
    }

    fn len(&self) -> usize {
        match &self.words {
            Words::Packed(words) => words.len(),
            Words::Apart { targets, .. } => targets.len(),
        }
    }

    /// Appends a synapse; the first that does not fit a word takes all apart.
    fn push(&mut self, (target, weight): Reached) {
        if let Words::Packed(words) = &mut self.words {
            if let Some(word) = self.packing.pack(target, weight) {
                return words.push(word);
            }
            let packing = self.packing;
            let (targets, weights) = words.iter().map(|&w| packing.unpack(w)).map(|(t, w)| (t as u32, w)).unzip();
            self.words = Words::Apart { targets, weights };
        }
        if let Words::Apart { targets, weights } = &mut self.words {
            targets.push(target);
            weights.push(weight);
        }
    }

    /// Appends the lists of sources, which have so many synapses each.
    pub fn append(&mut self, counts: &[u32], mut synapses: &[Reached]) {
        for &count in counts {
            let list;
            (list, synapses) = synapses.split_at(count as usize);
            list.iter().for_each(|&synapse| self.push(synapse));
            self.ends.push(self.len());
        }
    }

    /// Calls with each source, ascending, and the lanes that it reaches.
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
                Words::Apart { targets, .. } => take(source, &targets[list]),
            }
        }
    }

    /// Leaves those synapses out for which `keep` is false of source, lane and weight.
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
                    Words::Apart { targets, weights } => {
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
            Words::Apart { targets, weights } => {
                targets.truncate(kept);
                weights.truncate(kept);
                if fit {
                    let all = targets.iter().zip(weights);
                    self.words = Words::Packed(all.filter_map(|(&t, &mut w)| self.packing.pack(t, w)).collect());
                }
            }
        }
    }

    /// The table, `None` when it is empty.
    ///
    /// # Errors
    /// The number of synapses when there are too many to say where each list is.
    pub fn finish(self) -> Result<Option<Table>, usize> {
        let Draft { lanes, packing, ends, words } = self;
        let begins = || std::iter::once(0).chain(ends.iter().copied());
        let lists = || begins().zip(&ends).map(|(begin, &end)| begin..end);
        let total = ends.last().copied().unwrap_or(0);
        if total == 0 {
            return Ok(None);
        }
        let fits = |&word: &u32| {
            let (target, weight) = packing.unpack(word);
            u16::try_from(target).is_ok() && i8::try_from(weight).is_ok()
        };
        // Every lane fits 16 bits and every weight 8, and lanes are enough to be worth it.
        let small = lanes >= SMALL_FROM && matches!(&words, Words::Packed(words) if words.iter().all(fits));
        let lengths = lists().map(|list| list.len());
        let (places, synapses) = match words {
            Words::Packed(words) => {
                let synapses = words.iter().map(|&word| packing.unpack(word));
                let size = [4, 8, 16].into_iter().min_by(|&a, &b| {
                    let cost = |size| padded_runs::cost(size, lengths.clone());
                    cost(a).total_cmp(&cost(b))
                });
                match size.filter(|_| small) {
                    Some(4) => named(Groups::new(Small, lengths, synapses), Synapses::Fours),
                    Some(8) => named(Groups::new(Small, lengths, synapses), Synapses::Eights),
                    Some(_) => named(Groups::new(Small, lengths, synapses), Synapses::Sixteens),
                    None => named(Groups::new(packing, lengths, synapses), Synapses::Packed),
                }
                .ok_or(total)?
            }
            Words::Apart { mut targets, mut weights } => {
                let place =
                    |list: Range<usize>| Some(Place { start: list.start.try_into().ok()?, count: list.len() as u32 });
                targets.shrink_to_fit();
                weights.shrink_to_fit();
                (lists().map(place).collect::<Option<_>>().ok_or(total)?, Synapses::Apart(Apart { targets, weights }))
            }
        };
        Ok(Some(Table { places, synapses }))
    }
}

/// Places, and groups under the name of their form.
fn named<G>(made: Option<(Vec<Place>, G)>, form: fn(G) -> Synapses) -> Option<(Vec<Place>, Synapses)> {
    made.map(|(places, groups)| (places, form(groups)))
}

/// Places for lists of so many synapses, which take so many bytes, one after the other but that none touches more lines of the
/// cache than its length needs, and the bytes that all take. At most half of these are gaps: a gap is smaller than the list
/// after it. `None` when a place in a list has no number.
pub(crate) fn lay_out(
    lengths: impl Iterator<Item = usize>,
    bytes: impl Fn(usize) -> usize,
) -> Option<(Vec<Place>, usize)> {
    let mut end = 0usize;
    let place = |count: usize| {
        let size = bytes(count);
        let mut start = end.next_multiple_of(STEP);
        if size > 0 && (start % LINE + size).div_ceil(LINE) > size.div_ceil(LINE) {
            start = start.next_multiple_of(LINE);
        }
        end = start + size;
        u32::try_from(end / STEP).ok()?;
        Some(Place { start: (start / STEP).try_into().ok()?, count: count.try_into().ok()? })
    };
    let places = lengths.map(place).collect::<Option<Vec<_>>>()?;
    Some((places, end))
}

#[cfg(test)]
impl Table {
    /// Lane and weight of each synapse of a source.
    pub fn list(&self, source: usize) -> Vec<Reached> {
        use crate::base::id::ChannelId;
        let (ids, place, mut queue) = ([ChannelId::new(source)], self.places[source], Vec::new());
        let mut list = Vec::new();
        let push = |lane: usize, weight| list.push((lane as u32, weight));
        match &self.synapses {
            Synapses::Fours(groups) => groups.deliver(&self.places, &ids, &mut queue, push),
            Synapses::Eights(groups) => groups.deliver(&self.places, &ids, &mut queue, push),
            Synapses::Sixteens(groups) => groups.deliver(&self.places, &ids, &mut queue, push),
            Synapses::Packed(groups) => groups.deliver(&self.places, &ids, &mut queue, push),
            Synapses::Apart(lists) => lists.deliver(&self.places, &ids, push),
        };
        // What fills the last group up comes after all others.
        list.truncate(place.len());
        list
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;

    /// What the table of these lists says.
    fn read(lists: &[Vec<(u32, i16)>], lanes: usize) -> (Vec<Vec<(u32, i16)>>, Table) {
        let mut draft = Draft::new(lanes);
        lists.iter().for_each(|list| draft.append(&[list.len() as u32], list));
        let table = draft.finish().unwrap().unwrap();
        ((0..lists.len()).map(|source| table.list(source)).collect(), table)
    }

    fn draw(sources: u64, lanes: u64, weight: i64) -> Vec<Vec<(u32, i16)>> {
        let of = |source, index| {
            let weight = rng::below(2 * weight as u64, 2, source, index) as i64 - weight;
            (rng::below(lanes, 1, source, index) as u32, weight as i16)
        };
        (0..sources).map(|source| (0..rng::below(60, 3, source, 0)).map(|index| of(source, index)).collect()).collect()
    }

    /// The narrowest form that holds all, and what was put in comes out.
    #[test]
    fn tables_hold_what_they_were_given() {
        let small = draw(200, 65_536, 128);
        let (out, table) = read(&small, 65_536);
        assert_eq!(out, small);
        assert!(table.synapses.small());
        for (lanes, weight) in [(65_537, 128), (8_000, 129), (4_000, 128), (1_000_000, 2_000)] {
            let mut packed = draw(200, lanes, weight);
            packed[7].extend([(lanes as u32 - 1, (weight - 1) as i16), (0, -weight as i16)]);
            let (out, table) = read(&packed, lanes as usize);
            assert_eq!(out, packed);
            assert!(matches!(table.synapses, Synapses::Packed(_)), "{lanes} {weight}");
        }
        let mut apart = draw(200, 1_000_000, 2_000);
        apart[100].push((999_999, i16::MIN));
        let (out, table) = read(&apart, 1_000_000);
        assert_eq!(out, apart);
        assert!(matches!(table.synapses, Synapses::Apart(_)));
    }

    #[test]
    fn longer_lists_are_in_larger_groups() {
        let of = |length: u64| {
            let list = |source| (0..length).map(|k| (rng::below(8_000, 1, source, k) as u32, 1)).collect();
            read(&(0..100).map(list).collect::<Vec<_>>(), 8_000).1.synapses
        };
        assert!(matches!((of(3), of(8), of(64)), (Synapses::Fours(_), Synapses::Eights(_), Synapses::Sixteens(_))));
    }

    #[test]
    fn no_list_touches_a_line_more_than_it_has_to() {
        for group in [1, 3] {
            let bytes = |length: usize| STEP * length.next_multiple_of(group);
            let length = |k| rng::below(90, 5, k, 0) * rng::below(2, 5, k, 1);
            let lengths: Vec<usize> = (0..3_000).map(|k| length(k) as usize).collect();
            let (places, size) = lay_out(lengths.iter().copied(), bytes).unwrap();
            let (mut end, mut gaps) = (0, 0);
            for (place, &length) in places.iter().zip(&lengths) {
                let (begin, size) = (place.start() * STEP, bytes(length));
                assert!(begin >= end, "lists do not overlap");
                gaps += begin - end;
                end = begin + size;
                let lines = (end.div_ceil(LINE) - begin / LINE) * usize::from(length > 0);
                assert_eq!((place.len(), lines), (length, size.div_ceil(LINE)));
            }
            assert_eq!(size, end);
            assert!(2 * gaps <= size, "{gaps} of {size} bytes are gaps");
        }
    }

    #[test]
    fn an_empty_table_is_none() {
        let mut draft = Draft::new(100);
        draft.append(&[0], &[]);
        assert!(draft.finish().unwrap().is_none());
    }
}
