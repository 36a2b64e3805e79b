//! Synapses one by one, listed by source.
//!
//! Comes in: lanes and weights, source after source ([`Draft`]). Goes out: a [`Table`] of them in the narrowest form that
//! holds all. Where spikes are rare their lists come from far away in memory, and what a synapse costs is the lines of the
//! cache that it lies in; so a list is laid where it touches as few as its length allows. What it leaves out on purpose:
//! lanes beside each other, which are rows of `panels`.

use std::ops::Range;

use crate::machine::prefetch::{LINE, prefetch_range};
use crate::machine::store::Store;

/// Bytes from one place where a list can begin to the next.
const STEP: usize = 4;
/// Bytes of a synapse whose weight fits 8 bits and whose lane 16.
const SMALL: usize = 3;
/// Bytes of one whose weight fits beside its lane.
pub(super) const PACKED: usize = 4;

/// Synapses from the sources of one kind; weights in units of 64.
#[derive(Debug)]
pub(super) struct Table {
    /// Where each source's list is.
    pub places: Vec<Place>,
    /// The synapses.
    pub synapses: Synapses,
    /// Sources ahead whose list is fetched: as many as have enough synapses to be busy with meanwhile.
    pub ahead: usize,
}

/// Synapses delivered while a list is fetched.
const MEANWHILE: usize = 192;
/// Least and most sources ahead: each that waits holds a buffer for every line.
const AHEAD: (usize, usize) = (3, 10);

/// Where a source's list is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Place {
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

    /// Where they are when each takes so many bytes.
    #[inline(always)]
    fn bytes(self, each: usize) -> Range<usize> {
        let start = self.start as usize * STEP;
        start..start + each * self.len()
    }

    /// Where they are in arrays of one element each.
    #[inline(always)]
    fn elements(self) -> Range<usize> {
        self.start as usize..self.start as usize + self.len()
    }
}

/// Lanes and weights.
#[derive(Debug)]
pub(super) enum Synapses {
    /// Weights of 8 bits, lanes of 16.
    Small(Small),
    /// Weights that fit beside their lanes.
    Packed(Packed),
    /// Any.
    Apart(Apart),
}

/// Lanes that 16 bits name.
pub(super) const ADDRESSED: usize = 1 << 16;

/// Lanes of a share from which on its lists may be small: below, they are in reach as they are, and all sums that 16 bits name
/// would be many times those that there are.
const SMALL_FROM: usize = 1 << 12;

/// Synapses of a list written together, so that what a loop over them needs is known to the compiler.
const TOGETHER: usize = 8;

/// Lists of synapses.
pub(super) trait Lists {
    /// What names a lane.
    type Lane;
    /// What holds a weight.
    type Weight;
    /// Asks for a list.
    fn fetch(&self, place: Place);
    /// Calls with lane and weight of each synapse of a list.
    fn each(&self, place: Place, add: impl FnMut(Self::Lane, Self::Weight));
}

/// All lanes of a list, 16 bits each, then all its weights, 8 bits each.
#[derive(Debug)]
pub(super) struct Small(Store);

impl Lists for Small {
    type Lane = u16;
    type Weight = i8;

    #[inline(always)]
    fn fetch(&self, place: Place) {
        prefetch_range(self.0.bytes(), place.bytes(SMALL));
    }

    #[inline(always)]
    fn each(&self, place: Place, mut add: impl FnMut(u16, i8)) {
        let (lanes, weights) = self.0.bytes()[place.bytes(SMALL)].split_at(2 * place.len());
        let (lanes, last_lanes) = lanes.as_chunks::<2>().0.as_chunks::<TOGETHER>();
        let (weights, last_weights) = weights.as_chunks::<TOGETHER>();
        for (lanes, weights) in lanes.iter().zip(weights) {
            for (&lane, &weight) in lanes.iter().zip(weights) {
                add(u16::from_le_bytes(lane), weight as i8);
            }
        }
        for (&lane, &weight) in last_lanes.iter().zip(last_weights) {
            add(u16::from_le_bytes(lane), weight as i8);
        }
    }
}

/// Each synapse in a word of 32 bits.
#[derive(Debug)]
pub(super) struct Packed(Packing, Store);

impl Lists for Packed {
    type Lane = usize;
    type Weight = i16;

    #[inline(always)]
    fn fetch(&self, place: Place) {
        prefetch_range(self.1.bytes(), place.bytes(PACKED));
    }

    #[inline(always)]
    fn each(&self, place: Place, mut add: impl FnMut(usize, i16)) {
        let packing = self.0;
        for &word in self.1.bytes()[place.bytes(PACKED)].as_chunks::<PACKED>().0 {
            let (lane, weight) = packing.unpack(u32::from_le_bytes(word));
            add(lane, weight);
        }
    }
}

/// Lanes and weights apart, where a weight does not fit beside its lane.
#[derive(Debug)]
pub(super) struct Apart {
    targets: Vec<u32>,
    weights: Vec<i16>,
}

impl Lists for Apart {
    type Lane = usize;
    type Weight = i16;

    #[inline(always)]
    fn fetch(&self, _: Place) {}

    #[inline(always)]
    fn each(&self, place: Place, mut add: impl FnMut(usize, i16)) {
        let (targets, weights) = (&self.targets[place.elements()], &self.weights[place.elements()]);
        for (&lane, &weight) in targets.iter().zip(weights) {
            add(lane as usize, weight);
        }
    }
}

/// How a synapse is packed: the lane in as many low bits as the share's lanes need, the weight in the others. A share of
/// 65,536 lanes leaves the weight all of its 16 bits, one of a million twelve: any of exponents 0 to 3.
#[derive(Debug, Clone, Copy)]
pub(super) struct Packing {
    target_bits: u32,
}

impl Packing {
    fn new(lanes: usize) -> Self {
        Packing { target_bits: (usize::BITS - lanes.leading_zeros()).clamp(1, 31) }
    }

    /// The word of a synapse, if it fits.
    fn pack(self, target: u32, weight: i16) -> Option<u32> {
        let packed = (i32::from(weight) << self.target_bits) as u32 | target;
        Some(packed).filter(|&packed| self.unpack(packed) == (target as usize, weight))
    }

    /// Takes a word apart.
    #[inline(always)]
    fn unpack(self, word: u32) -> (usize, i16) {
        ((word & ((1 << self.target_bits) - 1)) as usize, (word as i32 >> self.target_bits) as i16)
    }
}

impl Table {
    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        let synapses = match &self.synapses {
            Synapses::Small(Small(store)) | Synapses::Packed(Packed(_, store)) => store.bytes().len(),
            Synapses::Apart(apart) => 6 * apart.targets.len(),
        };
        size_of_val(self.places.as_slice()) + synapses
    }
}

/// A synapse that a source reaches: lane, and weight in units of 64.
pub(super) type Reached = (u32, i16);

/// A table while it is written: lanes and weights as they come.
#[derive(Debug)]
pub(super) struct Draft {
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
        let each = if small { SMALL } else { PACKED };
        let ahead = (MEANWHILE * ends.len()).div_ceil(total).clamp(AHEAD.0, AHEAD.1);
        let (places, synapses) = match words {
            Words::Packed(words) => {
                let (places, size) = lay_out(lists().map(|list| list.len()), each).ok_or(total)?;
                let mut store = Store::new(size);
                let bytes = store.bytes_mut();
                for (list, place) in lists().zip(&places) {
                    let (list, bytes) = (&words[list], &mut bytes[place.bytes(each)]);
                    if small {
                        let (lanes, weights) = bytes.split_at_mut(2 * list.len());
                        for ((&word, lane), place) in list.iter().zip(lanes.as_chunks_mut::<2>().0).zip(weights) {
                            let (target, weight) = packing.unpack(word);
                            (*lane, *place) = ((target as u16).to_le_bytes(), weight as u8);
                        }
                    } else {
                        for (word, place) in list.iter().zip(bytes.as_chunks_mut::<PACKED>().0) {
                            *place = word.to_le_bytes();
                        }
                    }
                }
                (places, if small { Synapses::Small(Small(store)) } else { Synapses::Packed(Packed(packing, store)) })
            }
            Words::Apart { mut targets, mut weights } => {
                let place =
                    |list: Range<usize>| Some(Place { start: list.start.try_into().ok()?, count: list.len() as u32 });
                targets.shrink_to_fit();
                weights.shrink_to_fit();
                (lists().map(place).collect::<Option<_>>().ok_or(total)?, Synapses::Apart(Apart { targets, weights }))
            }
        };
        Ok(Some(Table { places, synapses, ahead }))
    }
}

/// Places for lists of so many synapses, one after the other but that none touches more lines of the cache than its length
/// needs, and the bytes that all take. At most half of these are gaps: a gap is smaller than the list after it. `None` when
/// a place has no number.
fn lay_out(lengths: impl Iterator<Item = usize>, each: usize) -> Option<(Vec<Place>, usize)> {
    let mut end = 0usize;
    let place = |count: usize| {
        let size = count * each;
        let mut start = end.next_multiple_of(STEP);
        if (start % LINE + size).div_ceil(LINE) > size.div_ceil(LINE) {
            start = start.next_multiple_of(LINE);
        }
        end = start + size;
        Some(Place { start: (start / STEP).try_into().ok()?, count: count.try_into().ok()? })
    };
    let places = lengths.map(place).collect::<Option<Vec<_>>>()?;
    Some((places, end))
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
        let list = |&place: &Place| {
            let mut list = Vec::new();
            let mut push = |target: usize, weight| list.push((target as u32, weight));
            match &table.synapses {
                Synapses::Small(lists) => {
                    lists.each(place, |lane, weight| push(lane.into(), weight.into()));
                }
                Synapses::Packed(lists) => lists.each(place, push),
                Synapses::Apart(lists) => lists.each(place, push),
            }
            list
        };
        (table.places.iter().map(list).collect(), table)
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
        assert!(matches!(table.synapses, Synapses::Small(_)));
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
    fn no_list_touches_a_line_more_than_it_has_to() {
        for each in [SMALL, PACKED] {
            let lengths: Vec<usize> = (0..3_000).map(|k| rng::below(90, 5, k, 0) as usize).collect();
            let (places, size) = lay_out(lengths.iter().copied(), each).unwrap();
            let mut end = 0;
            for (place, &length) in places.iter().zip(&lengths) {
                let bytes = place.bytes(each);
                assert_eq!(bytes.len(), length * each);
                assert!(bytes.start >= end, "lists do not overlap");
                end = bytes.end;
                let lines = (bytes.end.div_ceil(LINE) - bytes.start / LINE) * usize::from(length > 0);
                assert_eq!(lines, bytes.len().div_ceil(LINE));
            }
            assert_eq!(size, end);
        }
    }

    #[test]
    fn an_empty_table_is_none() {
        let mut draft = Draft::new(100);
        draft.append(&[0], &[]);
        assert!(draft.finish().unwrap().is_none());
    }
}
