//! Number of 64-bit words of synapse memory that an input axon's list takes.
//!
//! Input: the make-up of a list. Output: a number of words. The synapses that one spike source
//! sends to one core are one list. Its synapses of one
//! [`SynapseFormat`](nsim_ir::quantised::connectivity::SynapseFormat) form a *group*, and a list
//! takes the sum of its groups. A group is stored
//!
//! - *dense*, without target indices, when its slots follow each other without gap or repetition; a
//!   single synapse is dense;
//! - *run-length*, with the number of slots skipped before each synapse in 2 to 5 bits (the widths
//!   that NxTF uses), and the index of the first slot once an entry; for ascending slots with gaps
//!   of at most 31;
//! - *sparse*, with an index for each synapse.
//!
//! Of the last two, the form with fewer words is taken ([`stored`]), sparse on a tie. Each width of
//! runs is a separate format, and a core has few formats. A core on which runs would not fit, or
//! save nothing, stores none at all.
//!
//! A core's groups share widths, so that it needs few distinct formats. The index of a sparse
//! synapse has the fewest legal bits that hold every slot of the core ([`index_bits`]). A group
//! with a delayed synapse has the fewest legal bits that hold the longest delay of the core
//! ([`delay_bits`]), any other group none.
//!
//! Two counting rules ([`Packing`]):
//!
//! - `Nengo` (nengo-loihi `builder/validate.py`, `bits_per_axon`): a group of n synapses is cut
//!   into entries of at most `synapses_per_entry`; an entry of g synapses takes
//!   `ceil((g b + 4 + 6) / 64)` words, where b is weight, delay and index bits, 4 the bits of the
//!   format number and 6 the bits of the count. nengo-loihi has no run-length lists; here they
//!   include the index of the first slot, as in NxTF.
//! - `Nxtf` (Intel's NxTF, `nxsdk_modules_ncl/dnn`): at most 60 synapses an entry; an entry that is
//!   not sparse also holds the index of its first slot; one more word when the bits of an entry's
//!   last word are 0 or at least 59. NxTF also pads the axons that share one output axon to the
//!   longest of them; axons here are discrete, so there is nothing to pad.
//!
//! A synapse with a rule also has its tag ([`Group::tag_bits`]).

use nsim_ir::base::fixed::{Delay, WeightBits};
use nsim_ir::resource::{Limits, Packing};

/// Legal widths of a slot index, in bits (nengo-loihi `SynapseConfig`, `INDEX_BITS_MAP`).
pub const INDEX_BITS: [u8; 7] = [6, 7, 8, 9, 10, 11, 12];
/// Slots that the widest index can distinguish: no core of any target can hold more compartments.
pub const MOST_SLOTS: u32 = 1 << 12;
/// Legal widths of a run, in bits (NxTF, run-length skip).
pub const SKIP_BITS: [u8; 4] = [2, 3, 4, 5];
/// Bits of an entry's header: 4 for the number of the format, 6 for the count of synapses
/// (nengo-loihi `validate.py`).
const HEADER_BITS: u64 = 4 + 6;
/// Most synapses of an entry in NxTF (NxTF `ExclusionCriteria`).
const NXTF_PER_ENTRY: u32 = 60;
/// Least width of a stored delay in NxTF, in bits.
const NXTF_DELAY_BITS: u8 = 3;

/// Number of forms of a core's lists: without runs and with runs.
pub const LISTS: usize = 2;

/// The fewest legal index bits that hold every slot of a core with `compartments` compartments;
/// `None` above [`MOST_SLOTS`].
pub fn index_bits(compartments: u32) -> Option<u8> {
    INDEX_BITS.into_iter().find(|&bits| compartments <= 1 << bits)
}

/// The fewest legal bits that hold a core's longest delay: 0 for none, otherwise 1 to 6 (a delay is
/// below 64), and at least 3 in NxTF.
pub fn delay_bits(longest: Delay, packing: Packing) -> u8 {
    let bits = (u8::BITS - longest.get().leading_zeros()) as u8;
    if packing == Packing::Nxtf && bits > 0 { bits.max(NXTF_DELAY_BITS) } else { bits }
}

/// Slots of a core's delay ring: the next power of two above its longest delay, at least one. A
/// compartment has one accumulator in each (D18: 8 slots for 1,024 compartments, more when fewer
/// compartments are mapped).
pub fn delay_slots(longest: Delay) -> u32 {
    (u32::from(longest.get()) + 1).next_power_of_two()
}

/// Most synapses of an entry.
pub fn per_entry(limits: &Limits) -> u32 {
    match limits.packing {
        Packing::Nengo | Packing::Kernels { .. } => limits.synapses_per_entry,
        Packing::Nxtf => limits.synapses_per_entry.min(NXTF_PER_ENTRY),
    }
}

/// Widths that a core's groups share.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Widths {
    /// Bits of a slot index.
    pub index: u8,
    /// Bits of a delay, where there is one.
    pub delay: u8,
}

impl Widths {
    /// The widths of a core with this number of compartments and this longest delay. Above
    /// [`MOST_SLOTS`] the index stays at its widest; such a core fits no target.
    pub fn for_core(compartments: u32, longest: Delay, packing: Packing) -> Self {
        Widths { index: index_bits(compartments).unwrap_or(12), delay: delay_bits(longest, packing) }
    }
}

/// The synapses of one format in one list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Group {
    /// Bits of a weight as they are stored.
    pub weight_bits: WeightBits,
    /// Bits of a tag; 0 without a rule that uses tags.
    pub tag_bits: u8,
    /// Number of synapses.
    pub synapses: u32,
    /// Whether any of them has a delay.
    pub delayed: bool,
    /// Whether their slots follow each other.
    pub dense: bool,
    /// The fewest bits that hold the gaps between their slots; `None` when no legal width does.
    pub skip: Option<u8>,
}

/// Encoding of the targets of a group's synapses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Compression {
    /// By their place in the list.
    Dense,
    /// By the slots skipped before each, in this number of bits.
    RunLength(u8),
    /// By an index each.
    Sparse,
}

/// The fewest bits of a run that hold a gap of `gap` slots; `None` beyond the widest.
#[inline]
pub fn skip_bits(gap: u16) -> Option<u8> {
    SKIP_BITS.into_iter().find(|&bits| gap < 1 << bits)
}

/// Words of one group without runs: dense where its slots follow each other, sparse otherwise.
#[inline]
pub fn words(group: Group, widths: Widths, limits: &Limits) -> u32 {
    stored(group, widths, limits)[0].1
}

/// Compression and words of a group of a discrete axon, without and with runs.
#[inline]
pub fn stored(group: Group, widths: Widths, limits: &Limits) -> [(Compression, u32); LISTS] {
    let form = |compression| (compression, words_as(group, compression, false, widths, limits));
    if group.dense {
        return [form(Compression::Dense); LISTS];
    }
    let plain = form(Compression::Sparse);
    let runs = group.skip.map(|bits| form(Compression::RunLength(bits)));
    [plain, runs.filter(|runs| runs.1 < plain.1).unwrap_or(plain)]
}

/// Words of one group in this compression, in the list of a discrete axon or in the table of a
/// population axon. In a table a dense group begins with its first slot, under both rules.
#[inline]
pub fn words_as(group: Group, compression: Compression, in_table: bool, widths: Widths, limits: &Limits) -> u32 {
    let nxtf = limits.packing == Packing::Nxtf;
    let delay = if group.delayed { widths.delay } else { 0 };
    let (target, first) = match compression {
        Compression::Dense => (0, in_table || nxtf),
        Compression::RunLength(bits) => (bits, true),
        Compression::Sparse => (widths.index, false),
    };
    let bits = u64::from(group.weight_bits.get() + group.tag_bits) + u64::from(delay) + u64::from(target);
    let header = HEADER_BITS + if first { u64::from(widths.index) } else { 0 };
    let most = per_entry(limits);
    let entry = |synapses: u32| {
        let used = u64::from(synapses) * bits + header;
        let rest = used % 64;
        (used.div_ceil(64) + u64::from(nxtf && (rest == 0 || rest >= 59))) as u32
    };
    if group.synapses <= most {
        return if group.synapses > 0 { entry(group.synapses) } else { 0 };
    }
    let (full, rest) = (group.synapses / most, group.synapses % most);
    full * entry(most) + if rest > 0 { entry(rest) } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_testing::limits;

    fn dense(synapses: u32) -> Group {
        Group {
            weight_bits: WeightBits::new(8).unwrap(),
            tag_bits: 0,
            synapses,
            delayed: false,
            dense: true,
            skip: Some(2),
        }
    }

    const WIDTHS: Widths = Widths { index: 10, delay: 3 };

    #[test]
    fn the_worked_examples_of_nengo_s_formula() {
        // nengo-loihi e564f66 `bits_per_axon`, worked by hand: ceil(522 / 64), ceil(1162 / 64).
        let limits = limits();
        assert_eq!(words(dense(64), WIDTHS, &limits), 9);
        assert_eq!(words(Group { dense: false, ..dense(64) }, WIDTHS, &limits), 19);
        assert_eq!(1024 * words(dense(128), WIDTHS, &limits), 18_432);
        assert_eq!(1024 * words(dense(112), WIDTHS, &limits), 16_384);
        // The VT-SNN slip network on one core: 156 -> 50, 3150 -> 10, 60 -> 2.
        let of = |n| words(dense(n), Widths { index: 6, delay: 0 }, &limits);
        assert_eq!(156 * of(50) + 3150 * of(10) + 60 * of(2), 7_452);
        // One synapse more than an entry begins another: 9 words and ceil((8 + 10) / 64).
        assert_eq!(words(dense(65), WIDTHS, &limits), 10);
        assert_eq!(words(dense(0), WIDTHS, &limits), 0);
        // 8 bits of weight and 9 of tag: ceil(1098 / 64).
        assert_eq!(words(Group { tag_bits: 9, ..dense(64) }, WIDTHS, &limits), 18);
        // 8 bits of weight and 3 of delay: ceil(714 / 64).
        assert_eq!(words(Group { delayed: true, ..dense(64) }, WIDTHS, &limits), 12);
    }

    #[test]
    fn nxtf_counts_a_prefix_a_shorter_entry_and_an_extra_word_near_the_end_of_one() {
        let limits = Limits { packing: Packing::Nxtf, ..limits() };
        // 60 x 8 + 20 = 500 bits: 8 words, remainder 52.
        assert_eq!(words(dense(60), WIDTHS, &limits), 8);
        // 13 x 8 + 20 = 124 bits: 2 words, remainder 60, one more.
        assert_eq!(words(dense(13), WIDTHS, &limits), 3);
        // Sparse: 18 x 3 + 10 = 64 bits: 1 word, remainder 0, one more.
        assert_eq!(words(Group { dense: false, ..dense(3) }, WIDTHS, &limits), 2);
        // 61 synapses: an entry of 60 and one of 1 (8 + 20 = 28 bits).
        assert_eq!(words(dense(61), WIDTHS, &limits), 9);
    }

    #[test]
    fn runs_are_taken_where_they_are_smaller() {
        let limits = limits();
        let gaps = |synapses, skip| Group { dense: false, skip, ..dense(synapses) };
        let with_runs = |group| stored(group, WIDTHS, &limits)[1];
        // 9 x (8 + 4) + 10 + 10 bits are two words, 9 x 18 + 10 are three.
        assert_eq!(with_runs(gaps(9, Some(4))), (Compression::RunLength(4), 2));
        // 3 x 12 + 20 and 3 x 18 + 10 bits are one word each.
        assert_eq!(with_runs(gaps(3, Some(4))), (Compression::Sparse, 1));
        assert_eq!(with_runs(gaps(9, None)), (Compression::Sparse, 3));
        assert_eq!(with_runs(dense(9)), (Compression::Dense, 2));
        assert_eq!([0, 3, 4, 15, 16, 31].map(skip_bits), [Some(2), Some(2), Some(3), Some(4), Some(5), Some(5)]);
        assert_eq!(skip_bits(32), None);
        // NxTF: 58 bits and the rest of a word below six make one word more.
        let nxtf = Limits { packing: Packing::Nxtf, ..limits.clone() };
        assert_eq!(words_as(gaps(4, Some(2)), Compression::RunLength(2), false, WIDTHS, &nxtf), 2);
    }

    #[test]
    fn widths_are_the_least_legal_ones() {
        assert_eq!(
            [1, 64, 65, 1024, 4096, 4097].map(index_bits),
            [Some(6), Some(6), Some(7), Some(10), Some(12), None]
        );
        let bits = |d, packing| delay_bits(Delay::new(d).unwrap(), packing);
        assert_eq!([0, 1, 3, 4, 62].map(|d| bits(d, Packing::Nengo)), [0, 1, 2, 3, 6]);
        assert_eq!([0, 1, 3, 8, 62].map(|d| bits(d, Packing::Nxtf)), [0, 3, 3, 4, 6]);
        assert_eq!([0, 1, 3, 4, 62].map(|d| delay_slots(Delay::new(d).unwrap())), [1, 2, 4, 8, 64]);
    }

    #[test]
    fn more_synapses_never_take_fewer_words() {
        // The partitioner relies on it: a core that is too full stays so with more compartments.
        for packing in [Packing::Nengo, Packing::Nxtf] {
            let limits = Limits { packing, ..limits() };
            for (is_dense, delayed) in [(true, false), (false, false), (true, true), (false, true)] {
                let mut before = 0;
                for n in 0..400 {
                    let now = words(Group { dense: is_dense, delayed, ..dense(n) }, WIDTHS, &limits);
                    assert!(now >= before, "{packing:?} {n}");
                    before = now;
                }
            }
        }
    }
}
