//! Padded runs: lists of synapses padded to whole runs of one size.
//!
//! Input: lanes and weights by source, and their form. Output: lane and weight of each synapse of
//! some sources. Invariant: padding has weight 0, so it changes no sum.
//!
//! Why: lengths of lists vary, and a loop over each list ends in a mispredicted branch (about 20
//! cycles, as long as adding ten synapses). So the runs of many sources are queued, and one loop of
//! fixed length goes over each run. Lists of rare spikes are in no cache, where a list costs its
//! cache lines; so alignment makes it touch as few as possible.

use std::ops::Range;

use crate::prefetch::{LINE, prefetch};
use crate::store::Store;
use nsim_ir::spikes::Spike;

/// Number of sources whose runs are queued together: few enough for the first-level cache if lists
/// have up to some 16 runs.
const SOURCES: usize = 512;
/// Runs of a list that are queued without testing its length.
const UNCHECKED_RUNS: usize = 8;
/// Synapses delivered between the prefetch of a run and its use.
const PREFETCH_SYNAPSES: usize = 192;
/// Sources between the prefetch of a list's position and its use.
const PREFETCH_SOURCES: usize = 32;
/// Fixed cost of a run, in synapses.
const OVERHEAD: f64 = 1.4;

/// Bytes between the positions at which a list can begin.
pub(crate) const STEP: usize = 4;

/// Place of a source's list.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct ListPlace {
    /// Its beginning, in units of [`STEP`] bytes; in synapses for split lists.
    start: u32,
    /// Number of synapses.
    count: u32,
}

impl ListPlace {
    /// The place of a list of `count` synapses that begins at `start`; `None` if a number does not
    /// fit.
    pub fn new(start: usize, count: usize) -> Option<Self> {
        Some(ListPlace { start: start.try_into().ok()?, count: count.try_into().ok()? })
    }

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

    /// Its indices in arrays of one element a synapse.
    #[inline(always)]
    pub fn elements(self) -> Range<usize> {
        self.start as usize..self.start as usize + self.len()
    }
}

/// Storage format of the synapses of a run.
pub(crate) trait RunForm: Copy {
    /// Bytes of a synapse; a run of four takes whole [`STEP`]s.
    const SYNAPSE: usize;
    /// Writes a synapse, lane and weight, into a run of `N`.
    fn write<const N: usize>(self, run: &mut [u8], index: usize, synapse: (usize, i16));
    /// Reads a synapse, lane and weight, from a run of `N`.
    fn read<const N: usize>(self, run: &[u8], index: usize) -> (usize, i16);
}

/// Lanes of 16 bits, then weights of 8.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Compact;

impl RunForm for Compact {
    const SYNAPSE: usize = 3;

    fn write<const N: usize>(self, run: &mut [u8], index: usize, (lane, weight): (usize, i16)) {
        run.as_chunks_mut().0[index] = (lane as u16).to_le_bytes();
        run[2 * N + index] = weight as u8;
    }

    #[inline(always)]
    fn read<const N: usize>(self, run: &[u8], index: usize) -> (usize, i16) {
        // Indexing single bytes defeats vectorisation.
        let lane = u16::from_le_bytes(run.as_chunks().0[index]);
        (lane.into(), (run[2 * N + index] as i8).into())
    }
}

/// A synapse in a word of 32 bits: the lane in the low bits, as many as the shard's lanes need, the
/// weight in the others. The weight has 16 bits for up to 65,535 lanes, 12 for a million.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Packing {
    target_bits: u32,
}

impl Packing {
    /// The packing of a shard with `lanes` lanes.
    pub fn new(lanes: usize) -> Self {
        Packing { target_bits: (usize::BITS - lanes.leading_zeros()).clamp(1, 31) }
    }

    /// The word of a synapse, if it fits.
    pub fn pack(self, target: u32, weight: i16) -> Option<u32> {
        let packed = (i32::from(weight) << self.target_bits) as u32 | target;
        Some(packed).filter(|&packed| self.unpack(packed) == (target as usize, weight))
    }

    /// The synapse of a word.
    #[inline(always)]
    pub fn unpack(self, word: u32) -> (usize, i16) {
        ((word & ((1 << self.target_bits) - 1)) as usize, (word as i32 >> self.target_bits) as i16)
    }
}

impl RunForm for Packing {
    const SYNAPSE: usize = 4;

    fn write<const N: usize>(self, run: &mut [u8], index: usize, (lane, weight): (usize, i16)) {
        let word = self.pack(lane as u32, weight).expect("the form was chosen because every synapse fits");
        run.as_chunks_mut().0[index] = word.to_le_bytes();
    }

    #[inline(always)]
    fn read<const N: usize>(self, run: &[u8], index: usize) -> (usize, i16) {
        self.unpack(u32::from_le_bytes(run.as_chunks().0[index]))
    }
}

/// Lists padded to runs of `N` synapses.
#[derive(Debug)]
pub(crate) struct PaddedRuns<F, const N: usize> {
    form: F,
    store: Store,
}

/// Estimated cost of delivering each of these lists once in runs of `size`, in synapses.
pub(crate) fn cost(size: usize, lengths: impl Iterator<Item = usize>) -> f64 {
    lengths.map(|length| length.div_ceil(size) as f64 * (size as f64 + OVERHEAD)).sum()
}

impl<F: RunForm, const N: usize> PaddedRuns<F, N> {
    /// Bytes of a run.
    const BYTES: usize = F::SYNAPSE * N;
    /// Runs between the prefetch of a run and its use.
    const AHEAD: usize = PREFETCH_SYNAPSES / N;

    /// Stores lists of these lengths, whose synapses come list by list, and returns their places.
    /// `None` when a place does not fit.
    pub fn new(
        form: F,
        lengths: impl Iterator<Item = usize>,
        mut synapses: impl Iterator<Item = (usize, i16)>,
    ) -> Option<(Vec<ListPlace>, Self)> {
        let (places, size) = lay_out(lengths, |length| length.div_ceil(N) * Self::BYTES)?;
        let mut store = Store::new(size);
        let bytes = store.bytes_mut();
        for place in &places {
            let (mut last, mut left) = (0, place.len());
            let runs = bytes[place.start() * STEP..].chunks_exact_mut(Self::BYTES);
            for run in runs.take(left.div_ceil(N)) {
                for index in 0..N {
                    let synapse = if index < left { synapses.next() } else { None }.unwrap_or((last, 0));
                    form.write::<N>(run, index, synapse);
                    last = synapse.0;
                }
                left = left.saturating_sub(N);
            }
        }
        Some((places, PaddedRuns { form, store }))
    }

    /// Bytes of memory that they take.
    pub fn bytes(&self) -> usize {
        self.store.bytes().len()
    }

    /// Calls `add` with target, weight and payload for every synapse of these spikes, and for
    /// padding; targets stay below `below`, if it is not `usize::MAX`. Returns the number of
    /// synapses. Lists are at `places`, with ascending slots; `queue` is scratch memory.
    #[inline(always)]
    pub fn deliver<P: Spike>(
        &self,
        places: &[ListPlace],
        spikes: &[P],
        (below, queue): (usize, &mut Vec<u32>),
        mut add: impl FnMut(usize, i16, P::Payload),
    ) -> u64 {
        let (bytes, mut events) = (self.store.bytes(), 0);
        let fetch = |run: u32| prefetch(bytes, run as usize * STEP + Self::BYTES - 1);
        if !P::BINARY || below < usize::MAX {
            // A queued run has no spike, and is delivered whole.
            for (index, spike) in spikes.iter().enumerate() {
                if let Some(far) = spikes.get(index + PREFETCH_SOURCES / 4) {
                    fetch(places[far.source()].start() as u32);
                }
                let place = places[spike.source()];
                let run = |run| place.start() * STEP + run * Self::BYTES;
                let read = |at: usize| self.form.read::<N>(&bytes[run(at / N)..][..Self::BYTES], at % N);
                let count = match below {
                    usize::MAX => place.len(),
                    _ => (0..place.len()).take_while(|&at| read(at).0 < below).count(),
                };
                (0..count / N).for_each(|at| self.add_run(run(at), spike.payload(), &mut add));
                for (target, weight) in (count / N * N..count).map(read) {
                    add(target, weight, spike.payload());
                }
                events += count as u64;
            }
            return events;
        }
        for spikes in spikes.chunks(SOURCES) {
            let payload = spikes[0].payload();
            let (count, synapses) = Self::enqueue(places, spikes, queue);
            events += synapses;
            queue[..count.min(Self::AHEAD)].iter().for_each(|&run| fetch(run));
            for (&run, &far) in queue[..count].iter().zip(&queue[Self::AHEAD..]) {
                fetch(far);
                self.add_run(run as usize * STEP, payload, &mut add);
            }
        }
        events
    }

    /// Adds the synapses of the run at this byte. It is a function, since a closure may be compiled
    /// separately, without the processor's widest vectors.
    #[inline(always)]
    fn add_run<Y: Copy>(&self, run: usize, payload: Y, add: &mut impl FnMut(usize, i16, Y)) {
        let run = &self.store.bytes()[run..run + Self::BYTES];
        for index in 0..N {
            let (lane, weight) = self.form.read::<N>(run, index);
            add(lane, weight, payload);
        }
    }

    /// Queues the runs of these spikes; returns the numbers of runs and of synapses. The last run
    /// is repeated, so that every run has another to prefetch.
    #[inline(always)]
    fn enqueue(places: &[ListPlace], spikes: &[impl Spike], queue: &mut Vec<u32>) -> (usize, u64) {
        let each = (Self::BYTES / STEP) as u32;
        let (mut end, mut events) = (0, 0);
        for (index, spike) in spikes.iter().enumerate() {
            if let Some(far) = spikes.get(index + PREFETCH_SOURCES) {
                prefetch(places, far.source());
            }
            let place = places[spike.source()];
            let (first, runs) = (place.start() as u32, place.len().div_ceil(N));
            events += place.len() as u64;
            let room = end + runs.max(UNCHECKED_RUNS) + Self::AHEAD;
            if queue.len() < room {
                queue.resize(2 * room, 0);
            }
            for (run, queued) in (0u32..).zip(&mut queue[end..end + UNCHECKED_RUNS]) {
                *queued = first.wrapping_add(run * each);
            }
            if runs > UNCHECKED_RUNS {
                for (run, queued) in (0u32..).zip(&mut queue[end..end + runs]).skip(UNCHECKED_RUNS) {
                    *queued = first + run * each;
                }
            }
            end += runs;
        }
        if let Some(&last) = queue[..end].last() {
            queue[end..end + Self::AHEAD].fill(last);
        }
        (end, events)
    }
}

/// Places for lists of these lengths, each of `bytes(length)` bytes, and the bytes of all. No list
/// touches more cache lines than its length needs. At most half of the bytes are gaps: a gap is
/// smaller than the list after it. `None` when a place does not fit.
pub(crate) fn lay_out(
    lengths: impl Iterator<Item = usize>,
    bytes: impl Fn(usize) -> usize,
) -> Option<(Vec<ListPlace>, usize)> {
    let mut end = 0usize;
    let place = |count: usize| {
        let size = bytes(count);
        let mut start = end.next_multiple_of(STEP);
        if size > 0 && (start % LINE + size).div_ceil(LINE) > size.div_ceil(LINE) {
            start = start.next_multiple_of(LINE);
        }
        end = start + size;
        u32::try_from(end / STEP).ok()?;
        ListPlace::new(start / STEP, count)
    };
    let places = lengths.map(place).collect::<Option<Vec<_>>>()?;
    Some((places, end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::id::{ChannelId, Id};
    use nsim_ir::base::rng;

    const LANES: u64 = 1_000;

    /// Compares with adding synapse by synapse: sums, the lanes called with, and the number of
    /// synapses.
    fn compare<F: RunForm, const N: usize>(form: F, heaviest: i16, most: u64) {
        let list = |source| -> Vec<(usize, i16)> {
            let of = |index| {
                let draw = |below, what| rng::below(below, what, source, index);
                (draw(LANES, 1) as usize, draw(2 * heaviest as u64, 2) as i16 - heaviest)
            };
            (0..rng::below(most, 3, source, 0)).map(of).collect()
        };
        let lists: Vec<Vec<(usize, i16)>> = (0..1_500).map(list).collect();
        let lengths = lists.iter().map(Vec::len);
        let (places, runs) = PaddedRuns::<F, N>::new(form, lengths, lists.iter().flatten().copied()).unwrap();
        let mut queue = Vec::new();
        for every in [1, 2, 700, 1_500] {
            let ids: Vec<ChannelId> = (0..lists.len()).step_by(every).map(ChannelId::new).collect();
            let mut sums = [(0i64, false); LANES as usize];
            let mut expected = sums;
            let synapses: Vec<(usize, i16)> = ids.iter().flat_map(|id| &lists[id.index()]).copied().collect();
            for &(lane, weight) in &synapses {
                expected[lane] = (expected[lane].0 + i64::from(weight), true);
            }
            let count = runs.deliver(&places, &ids, (usize::MAX, &mut queue), |lane, weight, ()| {
                sums[lane] = (sums[lane].0 + i64::from(weight), true);
            });
            assert_eq!((count, sums), (synapses.len() as u64, expected));
        }
    }

    #[test]
    fn padding_changes_nothing() {
        for most in [2, 9, 40, 200] {
            compare::<_, 4>(Compact, 128, most);
            compare::<_, 8>(Compact, 128, most);
            compare::<_, 16>(Compact, 128, most);
            compare::<_, 4>(Packing::new(LANES as usize), 2_040, most);
            compare::<_, 16>(Packing::new(LANES as usize), 2_040, most);
        }
    }

    #[test]
    fn no_list_touches_a_line_more_than_it_has_to() {
        for run in [1, 3] {
            let bytes = |length: usize| STEP * length.next_multiple_of(run);
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
}
