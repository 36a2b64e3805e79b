//! All synapses of a network, sorted by the core of their target.
//!
//! Input: a network and the seats of its compartments. Output: for each core, the result of a
//! function of its synapses. They are in the order of its lists: by source, then format, slot,
//! delay and weight. [`crate::resources::exact`] counts them and `nsim_compile::emit::tables`
//! writes them, so both use the same lists.
//!
//! Sources are enumerated in pieces of a fixed size, on any number of threads. Each piece sorts its
//! synapses into ranges of cores, and each range then reads the pieces in order. So results do not
//! depend on threads, no synapse is allocated separately, and memory is accessed in long runs. A
//! synapse takes eight bytes meanwhile. A network with more than `MOST_SYNAPSES` of them is
//! enumerated several times, for some of its cores each time.

use rayon::prelude::*;

use crate::resources::formats::Formats;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId, ProjectionId};
use nsim_ir::partition::Seat;
use nsim_ir::quantised::{Projection, Quantised};

/// The seat of each compartment.
pub type Seats = IdVec<CompartmentId, Seat>;

/// Most synapses in memory simultaneously: two gigabytes of them.
const MOST_SYNAPSES: u64 = 1 << 28;
/// Most keys of a bucket's allocation that is reused for the next piece.
const MOST_REUSED_KEYS: usize = 1 << 16;
/// Bits of a source's number within its piece.
const PIECE_BITS: u32 = 14;
/// Most cores of a range: their numbers within the range take the remaining bits of a key.
const MOST_OF_RANGE: usize = 1 << 14;
/// Cores of a range where there are many, so that a range's synapses stay in a processor's cache
/// while they are sorted.
const OF_RANGE: usize = 128;

const WEIGHT_BITS: u32 = 9;
const DELAY_BITS: u32 = 6;
const SLOT_BITS: u32 = 12;
const FORMAT_BITS: u32 = 9;
/// Bits of everything but the source and the core.
const SYNAPSE_BITS: u32 = WEIGHT_BITS + DELAY_BITS + SLOT_BITS + FORMAT_BITS;
/// Zero of a stored weight: weights -256..=255 are stored from 0, so that keys sort as weights do.
const WEIGHT_ZERO: i16 = 1 << (WEIGHT_BITS - 1);

/// A synapse at its core, in 64 bits that sort as lists are sorted: source (channels first, then
/// compartments), format, slot, delay, weight.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Key(u64);

const fn field(key: u64, above: u32, bits: u32) -> u64 {
    (key >> above) & ((1 << bits) - 1)
}

impl Key {
    /// A synapse; the source is below 2^28, the index of the format below 2^9, the slot below 2^12.
    #[inline]
    pub fn new(source: u32, format: u16, slot: u16, delay: u8, weight: i16) -> Self {
        Key(u64::from(source) << SYNAPSE_BITS | rest(format, slot, delay, weight))
    }

    /// Number of the source: channels first, then compartments.
    #[inline]
    pub fn source(self) -> u32 {
        (self.0 >> SYNAPSE_BITS) as u32
    }

    /// Index of the format among [`Formats`].
    #[inline]
    pub fn format(self) -> u16 {
        field(self.0, SYNAPSE_BITS - FORMAT_BITS, FORMAT_BITS) as u16
    }

    /// The target's slot.
    #[inline]
    pub fn slot(self) -> u16 {
        field(self.0, WEIGHT_BITS + DELAY_BITS, SLOT_BITS) as u16
    }

    /// Delay field.
    #[inline]
    pub fn delay(self) -> u8 {
        field(self.0, WEIGHT_BITS, DELAY_BITS) as u8
    }

    /// The key with an atom in place of the source, and the slot relative to a base at or below it.
    #[inline]
    pub fn relative_to(self, atom: u16, base: u16) -> u64 {
        let rest = field(self.0, 0, SYNAPSE_BITS) - (u64::from(base) << (WEIGHT_BITS + DELAY_BITS));
        u64::from(atom) << SYNAPSE_BITS | rest
    }

    /// Weight mantissa.
    #[inline]
    pub fn weight(self) -> i16 {
        field(self.0, 0, WEIGHT_BITS) as i16 - WEIGHT_ZERO
    }
}

#[inline]
fn rest(format: u16, slot: u16, delay: u8, weight: i16) -> u64 {
    let mut key = u64::from(format);
    key = key << SLOT_BITS | u64::from(slot);
    key = key << DELAY_BITS | u64::from(delay);
    key << WEIGHT_BITS | (weight + WEIGHT_ZERO) as u64
}

/// The lists of a core, one for each source that reaches it, in the order of sources.
pub fn lists(keys: &[Key]) -> impl Iterator<Item = &[Key]> {
    keys.chunk_by(|a, b| a.source() == b.source())
}

/// The groups of a list, in the order of formats.
pub fn groups(list: &[Key]) -> impl Iterator<Item = &[Key]> {
    list.chunk_by(|a, b| a.format() == b.format())
}

/// Consecutive sources of one population.
struct Piece<'a> {
    /// Number of the first source.
    source: u32,
    /// Its index in its population.
    index: u32,
    length: u32,
    outgoing: Vec<(&'a Projection, u16, u32)>,
}

/// Sources of the populations with `counts`, in pieces: channels in order, then compartments.
fn pieces<'a>(network: &'a Quantised, formats: &Formats, counts: impl Fn(PopulationId) -> bool) -> Vec<Piece<'a>> {
    let mut pieces = Vec::new();
    let of = |input: bool| network.populations().enumerate().filter(move |(_, p)| p.first_channel().is_some() == input);
    for (id, population) in of(true).chain(of(false)) {
        let format = |id: ProjectionId| formats.by_projection()[id.index()];
        let outgoing: Vec<_> = network.targets_of(id).map(|(id, p, first)| (p, format(id), first.0)).collect();
        if outgoing.is_empty() || !counts(id) {
            continue;
        }
        let (first, size) = (network.first_source(population), population.shape.len());
        for index in (0..size).step_by(1 << PIECE_BITS) {
            let length = (size - index).min(1 << PIECE_BITS);
            pieces.push(Piece { source: first + index, index, length, outgoing: outgoing.clone() });
        }
    }
    pieces
}

impl Piece<'_> {
    /// Calls `f(source within the piece, seat, rest of the key)` for every synapse to a core that
    /// is wanted.
    #[inline]
    fn for_each(&self, seats: &Seats, wanted: impl Fn(CoreId) -> bool, mut f: impl FnMut(u32, CoreId, u64)) {
        for local in 0..self.length {
            for &(projection, format, first) in &self.outgoing {
                let delay = projection.delay.get();
                let is_wanted = |target: u32| wanted(seats[CompartmentId(first + target)].core);
                projection.connectivity.for_each_wanted(self.index + local, is_wanted, |target, weight| {
                    let seat = seats[CompartmentId(first + target)];
                    f(local, seat.core, rest(format, seat.slot, delay, weight));
                });
            }
        }
    }
}

/// The number within its range of a core in a bucket's key.
fn core_of(key: u64) -> usize {
    (key >> (SYNAPSE_BITS + PIECE_BITS)) as usize
}

/// The keys of each core in a sorted bucket.
fn runs(bucket: &[u64]) -> impl Iterator<Item = &[u64]> {
    bucket.chunk_by(|&a, &b| core_of(a) == core_of(b))
}

/// Returns a bucket sorted by core, then source, then the other fields. Its sources ascend already,
/// so a counting sort by core keeps their order. Only the synapses of one source on one core are
/// compared.
fn sorted(bucket: &[u64], cores: usize) -> Vec<u64> {
    let mut places = vec![0u32; cores];
    bucket.iter().for_each(|&key| places[core_of(key)] += 1);
    let mut sum = 0;
    for place in &mut places {
        sum += std::mem::replace(place, sum);
    }
    let mut sorted = vec![0; bucket.len()];
    for &key in bucket {
        let place = &mut places[core_of(key)];
        sorted[*place as usize] = key;
        *place += 1;
    }
    for list in sorted.chunk_by_mut(|a, b| a >> SYNAPSE_BITS == b >> SYNAPSE_BITS) {
        if !list.is_sorted() {
            list.sort_unstable();
        }
    }
    sorted
}

/// Results of `f` for each core and its synapses from the populations with `counts`. Cores that are
/// not wanted have no synapses.
pub fn by_core<T: Send>(
    network: &Quantised,
    formats: &Formats,
    seats: &Seats,
    cores: usize,
    counts: impl Fn(PopulationId) -> bool,
    wanted: impl Fn(CoreId) -> bool + Sync,
    f: impl Fn(CoreId, &[Key]) -> T + Sync,
) -> Vec<T> {
    let pieces = pieces(network, formats, &counts);
    let from = |(id, p): (ProjectionId, &Projection)| if counts(p.source) { network.synapses_of(id) } else { 0 };
    let synapses: u64 = network.projections().enumerate().map(from).sum();
    let waves = synapses.div_ceil(MOST_SYNAPSES).max(1) as usize;
    let of_wave = cores.div_ceil(waves).max(1);
    let of_range = OF_RANGE.max(of_wave.div_ceil(1 << 12)).min(MOST_OF_RANGE);
    let mut results = Vec::with_capacity(cores);
    for first in (0..cores).step_by(of_wave) {
        let wave = first..(first + of_wave).min(cores);
        let ranges = wave.len().div_ceil(of_range);
        // Every piece's synapses by range, sorted by core, then source.
        let sorted: Vec<Vec<Vec<u64>>> = pieces
            .par_iter()
            .map_init(
                || vec![Vec::new(); ranges],
                |buckets, piece| {
                    let is_wanted = |core: CoreId| core.index().wrapping_sub(wave.start) < wave.len() && wanted(core);
                    piece.for_each(seats, is_wanted, |local, core, rest| {
                        let within = core.index() - wave.start;
                        let key = ((within % of_range) as u64) << PIECE_BITS | u64::from(local);
                        buckets[within / of_range].push(key << SYNAPSE_BITS | rest);
                    });
                    let take = |bucket: &mut Vec<u64>| {
                        let sorted = sorted(bucket, of_range);
                        bucket.clear();
                        bucket.shrink_to(MOST_REUSED_KEYS);
                        sorted
                    };
                    buckets.iter_mut().map(take).collect()
                },
            )
            .collect();
        let made: Vec<Vec<T>> = (0..ranges)
            .into_par_iter()
            .map_init(Vec::new, |keys, range| {
                let held = of_range.min(wave.len() - range * of_range);
                let mut first = vec![0; held + 1];
                let all = sorted.iter().flat_map(|buckets| runs(&buckets[range]));
                all.for_each(|run| first[core_of(run[0]) + 1] += run.len());
                (0..held).for_each(|core| first[core + 1] += first[core]);
                let mut next = first.clone();
                keys.clear();
                keys.resize(first[held], Key(0));
                for (piece, buckets) in pieces.iter().zip(&sorted) {
                    for run in runs(&buckets[range]) {
                        let next = &mut next[core_of(run[0])];
                        for (place, &key) in keys[*next..].iter_mut().zip(run) {
                            let local = field(key, SYNAPSE_BITS, PIECE_BITS) as u32;
                            *place = Key(u64::from(piece.source + local) << SYNAPSE_BITS | field(key, 0, SYNAPSE_BITS));
                        }
                        *next += run.len();
                    }
                }
                let of_core = |core| {
                    let id = CoreId::new(wave.start + range * of_range + core);
                    f(id, &keys[first[core]..first[core + 1]])
                };
                (0..held).map(of_core).collect()
            })
            .collect();
        results.extend(made.into_iter().flatten());
    }
    results
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::random_network;

    #[test]
    fn a_key_holds_what_it_was_given() {
        for (source, format, slot, delay, weight) in
            [(0, 0, 0, 0, -256), ((1 << 28) - 1, 511, 4095, 63, 255), (12_345, 383, 1023, 5, -3)]
        {
            let key = Key::new(source, format, slot, delay, weight);
            assert_eq!(
                (key.source(), key.format(), key.slot(), key.delay(), key.weight()),
                (source, format, slot, delay, weight)
            );
        }
        assert!(Key::new(1, 0, 0, 0, -2) < Key::new(1, 0, 0, 0, 2));
    }

    #[test]
    fn every_synapse_is_gathered_once_at_its_core_in_order() {
        for seed in 0..40 {
            let network = random_network(seed);
            let formats = Formats::for_network(&network);
            let cores = 1 + seed as usize % 5;
            let seat = |i: u32| Seat { core: CoreId::new((i as usize * 7) % cores), slot: (i / cores as u32) as u16 };
            let seats: Seats = (0..network.compartments()).map(seat).collect();
            let mut meant: Vec<Vec<Key>> = vec![Vec::new(); cores];
            for (id, projection) in network.projections().enumerate() {
                let source = &network.populations()[projection.source];
                let first = network.populations()[projection.target].first_compartment().unwrap();
                for s in 0..source.shape.len() {
                    projection.connectivity.for_each_from(s, |target, weight| {
                        let seat = seats[CompartmentId(first.0 + target)];
                        let format = formats.by_projection()[id.index()];
                        let from = network.first_source(source) + s;
                        let key = Key::new(from, format, seat.slot, projection.delay.get(), weight);
                        meant[seat.core.index()].push(key);
                    });
                }
            }
            meant.iter_mut().for_each(|keys| keys.sort_unstable());
            let found = by_core(&network, &formats, &seats, cores, |_| true, |_| true, |_, keys| keys.to_vec());
            assert_eq!(found, meant, "seed {seed}");
        }
    }
}
