//! Words of synapse memory that lists take, counted again from the layout of an entry.
//!
//! Input: a core's size, longest delay and limits, then the format and size of each group of
//! synapses. Output: words of 64 bits. This is a second count, entry by entry, of the words that
//! the compiler's packing has in closed form. The two share no code, so each finds mistakes in the
//! other.
//!
//! An entry has a header of 4 bits for the format and 6 for the count (nengo-loihi e564f66
//! `builder/validate.py`, `bits_per_axon`). Then come optionally the index of its first slot, then
//! its synapses, up to a maximum. A synapse has its weight, its tag where its rule uses tags, its
//! delay where its group has one, and its slot. The slot has no bits if slots are consecutive, the
//! number of skipped slots for runs, an index otherwise. NxTF (`nxsdk_modules_ncl/dnn`) stores at
//! most 60 synapses an entry, a first slot wherever there is no index, and one more word where the
//! last word has 0 or at least 59 bits.

use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{IdVec, RuleId};
use nsim_ir::learning::{Learning, Quantity, Variable};
use nsim_ir::program::CoreFormat;
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::resource::{Limits, Packing};

/// Bits of a word.
const WORD: u32 = 64;
/// Bits of a format's number and of a count of synapses.
const HEADER: u32 = 4 + 6;
/// Widths of a run, the number of slots skipped before a synapse, in bits.
pub(crate) const RUNS: std::ops::RangeInclusive<u8> = 2..=5;
/// The narrowest and the widest index of a slot.
const INDEX: (u8, u8) = (6, 12);

/// The layout of a core's entries.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Layout {
    /// Bits of the index of a slot.
    pub index: u8,
    /// Bits of a delay, where there is one.
    pub delay: u8,
    per_entry: u32,
    nxtf: bool,
}

impl Layout {
    /// Returns the layout of a core with `compartments` compartments and this longest delay.
    pub fn of_core(compartments: u32, longest: Delay, limits: &Limits) -> Self {
        let nxtf = limits.packing == Packing::Nxtf;
        let mut index = INDEX.0;
        while index < INDEX.1 && compartments > 1 << index {
            index += 1;
        }
        let mut delay = 0;
        while u32::from(longest.get()) >= 1 << delay {
            delay += 1;
        }
        if nxtf && delay > 0 {
            delay = delay.max(3);
        }
        let per_entry = limits.synapses_per_entry.min(if nxtf { 60 } else { u32::MAX });
        Layout { index, delay, per_entry, nxtf }
    }

    /// Words of a group of `synapses` synapses of a format with tags of `tag` bits, in the list of
    /// a discrete axon or in a table of a population axon.
    pub fn words(&self, format: CoreFormat, tag: u32, synapses: u32, in_table: bool) -> u32 {
        let slot = match (format.index_bits, format.skip_bits) {
            (None, _) => 0,
            (Some(_), Some(run)) => run,
            (Some(_), None) => self.index,
        };
        let delay = if format.delay_bits > 0 { self.delay } else { 0 };
        let each = u32::from(format.synapse.bits.get()) + tag + u32::from(delay) + u32::from(slot);
        // The first slot is stored for runs, and for synapses without slots in a table or in NxTF.
        let first = if format.index_bits.is_none() { in_table || self.nxtf } else { format.skip_bits.is_some() };
        let begin = HEADER + if first { u32::from(self.index) } else { 0 };
        let (mut words, mut left) = (0, synapses);
        while left > 0 {
            let of_entry = left.min(self.per_entry.max(1));
            let bits = begin + of_entry * each;
            words += bits.div_ceil(WORD);
            if self.nxtf && (bits.is_multiple_of(WORD) || bits % WORD >= 59) {
                words += 1;
            }
            left -= of_entry;
        }
        words
    }
}

/// Bits of a synapse's tag, and of a delay that does not act, where its rule has them in a change
/// or a factor.
pub(crate) fn bits_of_tag(rules: &IdVec<RuleId, Learning>, format: SynapseFormat) -> u32 {
    let Some(Learning { rule, .. }) = format.rule.and_then(|rule| rules.get(rule)) else { return 0 };
    let mut bits = [0, 0];
    for (variable, bits) in [Variable::Tag, Variable::Delay].into_iter().zip(&mut bits) {
        let factors = rule.all_products().flat_map(|product| &product.factors);
        let is_read = factors.into_iter().any(|factor| factor.of == Quantity::Variable(variable));
        if is_read || !rule.products(variable).is_empty() {
            *bits = if variable == Variable::Tag { 9 } else { 6 };
        }
    }
    if rule.semantics().delays_act() { bits[0] } else { bits[0] + bits[1] }
}

/// Words of microcode of a core's distinct rules, two products of at most one factor in a word, and
/// the distinct settings of the presynaptic traces that they read.
pub(crate) fn of_rules(rules: &IdVec<RuleId, Learning>, formats: &[CoreFormat]) -> (u64, u64) {
    let (mut programs, mut settings) = (Vec::new(), Vec::new());
    let mut words = 0;
    for Learning { rule, .. } in formats.iter().filter_map(|format| rules.get(format.synapse.rule?)) {
        let program = Variable::ALL.map(|variable| rule.products(variable));
        for factor in rule.all_products().flat_map(|product| &product.factors) {
            match factor.of {
                Quantity::Trace(trace) if trace.is_presynaptic() && !settings.contains(&rule.trace(trace)) => {
                    settings.push(rule.trace(trace));
                }
                _ => {}
            }
        }
        if !programs.contains(&program) {
            let short = rule.all_products().filter(|product| product.factors.len() < 2).count();
            words += rule.all_products().count() - short + short.div_ceil(2);
            programs.push(program);
        }
    }
    (words as u64, settings.len() as u64)
}

/// Whether a core keeps room for every delay of these synapses, as a rule changes them.
pub(crate) fn has_all_delays(rules: &IdVec<RuleId, Learning>, format: SynapseFormat) -> bool {
    let learning = format.rule.and_then(|rule| rules.get(rule)).map(|learning| &learning.rule);
    learning.is_some_and(|rule| rule.semantics().delays_act() && !rule.products(Variable::Delay).is_empty())
}

/// Slots of a core's accumulators: a power of two above the longest delay.
pub(crate) fn delay_slots(longest: Delay) -> u32 {
    let mut slots = 1;
    while slots <= u32::from(longest.get()) {
        slots *= 2;
    }
    slots
}
