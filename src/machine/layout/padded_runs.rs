//! Lists of synapses in groups of one size, so that nothing has to be decided list by list.
//!
//! Comes in: lanes and weights, source after source, and the form in which they are held. Goes out: lane and weight of each
//! that some sources reach. How long a list is cannot be foretold, and each loop over one ends with a wrong guess of some 20
//! cycles, as many as it takes to add ten synapses. So lists are filled up to whole groups with synapses of weight 0, which
//! change no sum; the groups of many sources are queued, and one loop goes over all of them.

use crate::base::id::Id;
use crate::machine::deliver::prefetch::prefetch;
use crate::machine::layout::lists::{Place, STEP, lay_out};
use crate::machine::layout::store::Store;

/// Sources whose groups are queued at a time: enough to be worth it, few enough for the first-level cache where lists have up to
/// some 16 groups.
const SOURCES: usize = 512;
/// Groups of a list that are queued whether they are or not.
const FORESEEN: usize = 8;
/// Synapses delivered while a group is fetched.
const MEANWHILE: usize = 192;
/// Sources ahead whose place is fetched.
const FAR: usize = 32;
/// What a group costs beside its synapses, in synapses.
const OVERHEAD: f64 = 1.4;

/// How a group of synapses is held.
pub(crate) trait Form: Copy {
    /// Bytes of a synapse; a group of four takes whole [`STEP`]s.
    const SYNAPSE: usize;
    /// Writes a synapse, lane and weight, into a group of `N`.
    fn write<const N: usize>(self, group: &mut [u8], index: usize, synapse: (usize, i16));
    /// Reads it.
    fn read<const N: usize>(self, group: &[u8], index: usize) -> (usize, i16);
}

/// Lanes of 16 bits, then weights of 8.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Small;

impl Form for Small {
    const SYNAPSE: usize = 3;

    fn write<const N: usize>(self, group: &mut [u8], index: usize, (lane, weight): (usize, i16)) {
        group.as_chunks_mut().0[index] = (lane as u16).to_le_bytes();
        group[2 * N + index] = weight as u8;
    }

    #[inline(always)]
    fn read<const N: usize>(self, group: &[u8], index: usize) -> (usize, i16) {
        // Bytes named one by one would be read one by one.
        let lane = u16::from_le_bytes(group.as_chunks().0[index]);
        (lane.into(), (group[2 * N + index] as i8).into())
    }
}

/// A synapse in a word of 32 bits: the lane in as many low bits as the share's lanes need, the weight in the others. A share
/// of 65,536 lanes leaves the weight all of its 16 bits, one of a million twelve: any of exponents 0 to 3.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Packing {
    target_bits: u32,
}

impl Packing {
    /// Of a share with so many lanes.
    pub fn new(lanes: usize) -> Self {
        Packing { target_bits: (usize::BITS - lanes.leading_zeros()).clamp(1, 31) }
    }

    /// The word of a synapse, if it fits.
    pub fn pack(self, target: u32, weight: i16) -> Option<u32> {
        let packed = (i32::from(weight) << self.target_bits) as u32 | target;
        Some(packed).filter(|&packed| self.unpack(packed) == (target as usize, weight))
    }

    /// Takes a word apart.
    #[inline(always)]
    pub fn unpack(self, word: u32) -> (usize, i16) {
        ((word & ((1 << self.target_bits) - 1)) as usize, (word as i32 >> self.target_bits) as i16)
    }
}

impl Form for Packing {
    const SYNAPSE: usize = 4;

    fn write<const N: usize>(self, group: &mut [u8], index: usize, (lane, weight): (usize, i16)) {
        let word = self.pack(lane as u32, weight).expect("the form was chosen because every synapse fits");
        group.as_chunks_mut().0[index] = word.to_le_bytes();
    }

    #[inline(always)]
    fn read<const N: usize>(self, group: &[u8], index: usize) -> (usize, i16) {
        self.unpack(u32::from_le_bytes(group.as_chunks().0[index]))
    }
}

/// Lists in groups of `N` synapses.
#[derive(Debug)]
pub(crate) struct Groups<F, const N: usize> {
    form: F,
    store: Store,
}

/// About what it costs to deliver each of these lists once in groups of this size, in synapses.
pub(crate) fn cost(size: usize, lengths: impl Iterator<Item = usize>) -> f64 {
    lengths.map(|length| length.div_ceil(size) as f64 * (size as f64 + OVERHEAD)).sum()
}

impl<F: Form, const N: usize> Groups<F, N> {
    /// Bytes of a group.
    const BYTES: usize = F::SYNAPSE * N;
    /// Groups from one to that which is fetched meanwhile.
    const AHEAD: usize = MEANWHILE / N;

    /// Lists of so many synapses, which come one after the other, and where each is; `None` when a place has no number.
    pub fn new(
        form: F,
        lengths: impl Iterator<Item = usize>,
        mut synapses: impl Iterator<Item = (usize, i16)>,
    ) -> Option<(Vec<Place>, Self)> {
        let (places, size) = lay_out(lengths, |length| length.div_ceil(N) * Self::BYTES)?;
        let mut store = Store::new(size);
        let bytes = store.bytes_mut();
        for place in &places {
            let (mut last, mut left) = (0, place.len());
            let groups = bytes[place.start() * STEP..].chunks_exact_mut(Self::BYTES);
            for group in groups.take(left.div_ceil(N)) {
                for index in 0..N {
                    let synapse = if index < left { synapses.next() } else { None }.unwrap_or((last, 0));
                    form.write::<N>(group, index, synapse);
                    last = synapse.0;
                }
                left = left.saturating_sub(N);
            }
        }
        Some((places, Groups { form, store }))
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> usize {
        self.store.bytes().len()
    }

    /// Calls with lane and weight of every synapse that these sources reach, and perhaps again with lanes among them and no
    /// weight; returns how many synapses there are. Lists are at `places`; `queue` is memory to work in.
    #[inline(always)]
    pub fn deliver<I: Id>(
        &self,
        places: &[Place],
        ids: &[I],
        queue: &mut Vec<u32>,
        mut add: impl FnMut(usize, i16),
    ) -> u64 {
        let (bytes, mut events) = (self.store.bytes(), 0);
        let fetch = |group: u32| prefetch(bytes, group as usize * STEP + Self::BYTES - 1);
        for ids in ids.chunks(SOURCES) {
            let (count, synapses) = Self::plan(places, ids, queue);
            events += synapses;
            queue[..count.min(Self::AHEAD)].iter().for_each(|&group| fetch(group));
            for (&group, &far) in queue[..count].iter().zip(&queue[Self::AHEAD..]) {
                fetch(far);
                let group = group as usize * STEP;
                let group = &bytes[group..group + Self::BYTES];
                for index in 0..N {
                    let (lane, weight) = self.form.read::<N>(group, index);
                    add(lane, weight);
                }
            }
        }
        events
    }

    /// Queues the groups of these sources; returns how many there are, and how many synapses are in them. After them the last
    /// stands some more times, so that every group has one that can be fetched meanwhile.
    #[inline(always)]
    fn plan<I: Id>(places: &[Place], ids: &[I], queue: &mut Vec<u32>) -> (usize, u64) {
        let each = (Self::BYTES / STEP) as u32;
        let (mut end, mut events) = (0, 0);
        for (index, id) in ids.iter().enumerate() {
            if let Some(far) = ids.get(index + FAR) {
                prefetch(places, far.index());
            }
            let place = places[id.index()];
            let (first, groups) = (place.start() as u32, place.len().div_ceil(N));
            events += place.len() as u64;
            let room = end + groups.max(FORESEEN) + Self::AHEAD;
            if queue.len() < room {
                queue.resize(2 * room, 0);
            }
            for (group, queued) in (0u32..).zip(&mut queue[end..end + FORESEEN]) {
                *queued = first.wrapping_add(group * each);
            }
            if groups > FORESEEN {
                for (group, queued) in (0u32..).zip(&mut queue[end..end + groups]).skip(FORESEEN) {
                    *queued = first + group * each;
                }
            }
            end += groups;
        }
        if let Some(&last) = queue[..end].last() {
            queue[end..end + Self::AHEAD].fill(last);
        }
        (end, events)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::id::ChannelId;
    use crate::base::rng;

    const LANES: u64 = 1_000;

    /// Against adding one synapse after the other: sums, the lanes called with, and the number of synapses.
    fn compare<F: Form, const N: usize>(form: F, heaviest: i16, most: u64) {
        let list = |source| -> Vec<(usize, i16)> {
            let of = |index| {
                let draw = |below, what| rng::below(below, what, source, index);
                (draw(LANES, 1) as usize, draw(2 * heaviest as u64, 2) as i16 - heaviest)
            };
            (0..rng::below(most, 3, source, 0)).map(of).collect()
        };
        let lists: Vec<Vec<(usize, i16)>> = (0..1_500).map(list).collect();
        let lengths = lists.iter().map(Vec::len);
        let (places, groups) = Groups::<F, N>::new(form, lengths, lists.iter().flatten().copied()).unwrap();
        let mut queue = Vec::new();
        for every in [1, 2, 700, 1_500] {
            let ids: Vec<ChannelId> = (0..lists.len()).step_by(every).map(ChannelId::new).collect();
            let mut sums = [(0i64, false); LANES as usize];
            let mut expected = sums;
            let synapses: Vec<(usize, i16)> = ids.iter().flat_map(|id| &lists[id.index()]).copied().collect();
            for &(lane, weight) in &synapses {
                expected[lane] = (expected[lane].0 + i64::from(weight), true);
            }
            let count = groups.deliver(&places, &ids, &mut queue, |lane, weight| {
                sums[lane] = (sums[lane].0 + i64::from(weight), true);
            });
            assert_eq!((count, sums), (synapses.len() as u64, expected));
        }
    }

    #[test]
    fn filling_up_changes_nothing() {
        for most in [2, 9, 40, 200] {
            compare::<_, 4>(Small, 128, most);
            compare::<_, 8>(Small, 128, most);
            compare::<_, 16>(Small, 128, most);
            compare::<_, 4>(Packing::new(LANES as usize), 2_040, most);
        }
    }
}
