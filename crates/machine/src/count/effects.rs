//! Effects of a message at its target core: events of dense and of sparse synapses.
//!
//! Input: the lists of a class of cores. Output: [`Effect`], 32 bits for each list. Effects stay in
//! the cache, since neighbouring sources select adjacent lists, and few effects are distinct.

use rayon::prelude::*;

use nsim_ir::base::id::{IdVec, RuleId};
use nsim_ir::program::{CoreClass, CoreFormat, Synapse};

/// Whether lists of this format carry no index: their targets are consecutive.
fn is_dense(format: &CoreFormat) -> bool {
    format.index_bits.is_none()
}

/// The formats of a core, and the rules that change delays.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Formats<'a> {
    pub all: &'a [CoreFormat],
    pub moves: &'a IdVec<RuleId, bool>,
}

impl Formats<'_> {
    /// The delay field with which a synapse is counted: 0 where a rule changes it. The machine
    /// subtracts the events that it loses at a sample's end.
    fn delay(self, synapse: &Synapse) -> u8 {
        let rule = self.all[usize::from(synapse.format)].synapse.rule;
        let moves = rule.is_some_and(|rule| self.moves.get(rule).copied().unwrap_or(false));
        if moves { 0 } else { synapse.delay.get() }
    }
}

/// Synaptic events of dense and of sparse synapses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Events {
    pub dense: u64,
    pub sparse: u64,
}

impl Events {
    /// Events of a list whose synapses of a delay field receive `times` spikes each.
    pub fn of_list(list: &[Synapse], formats: Formats<'_>, times: impl Fn(u8) -> u64) -> Self {
        let mut events = Events::default();
        for synapse in list {
            let of_kind = match is_dense(&formats.all[usize::from(synapse.format)]) {
                true => &mut events.dense,
                false => &mut events.sparse,
            };
            *of_kind += times(formats.delay(synapse));
        }
        events
    }
}

/// Effect of a message that selects a list: the numbers of dense and of sparse synapses, and their
/// delay field.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Effect(u32);

impl Effect {
    /// Bits of the number of dense synapses, and bits of the number of sparse synapses.
    const COUNT_BITS: u32 = 13;
    /// Marks synapses of different delay fields; a delay field is at most 62.
    const SEVERAL: u32 = 63;
    /// Marks a list that has to be read, since the bits cannot hold its number of synapses.
    const READ: Self = Effect(u32::MAX);

    /// Returns at most `most` distinct effects of all classes, ascending. The last is
    /// [`Self::READ`], for the lists whose effects are omitted.
    pub fn distinct(of_classes: &[Vec<Self>], most: usize) -> Vec<Self> {
        let of_class = |lists: &Vec<Self>| {
            let mut distinct = lists.clone();
            distinct.sort_unstable();
            distinct.dedup();
            distinct
        };
        let mut distinct: Vec<Self> = of_classes.par_iter().flat_map_iter(of_class).collect();
        distinct.par_sort_unstable();
        distinct.dedup();
        distinct.truncate(most - 1);
        if distinct.last() != Some(&Effect::READ) {
            distinct.push(Effect::READ);
        }
        distinct
    }

    /// Returns the effect of each list of a class.
    pub fn of_class(class: &CoreClass, moves: &IdVec<RuleId, bool>) -> Vec<Self> {
        let formats = Formats { all: &class.formats, moves };
        class.inputs.lists.iter().map(|list| Effect::new(list, formats)).collect()
    }

    fn new(list: &[Synapse], formats: Formats<'_>) -> Self {
        let Events { dense, sparse } = Events::of_list(list, formats, |_| 1);
        if dense.max(sparse) >= (1 << Effect::COUNT_BITS) - 1 {
            return Effect::READ;
        }
        let delay = list.first().map_or(0, |first| formats.delay(first));
        let is_same = list.iter().all(|synapse| formats.delay(synapse) == delay);
        let delay = if is_same { delay.into() } else { Effect::SEVERAL };
        Effect(delay << (2 * Effect::COUNT_BITS) | (dense as u32) << Effect::COUNT_BITS | sparse as u32)
    }

    /// Events of the list, whose synapses of a delay field receive `times` spikes each; with
    /// `always` all receive this number. `None` where the list has to be read.
    #[inline]
    pub fn events(self, always: Option<u64>, times: impl Fn(u8) -> u64) -> Option<Events> {
        let delay = self.0 >> (2 * Effect::COUNT_BITS);
        let times = match always {
            _ if self == Effect::READ => return None,
            Some(always) => always,
            None if delay == Effect::SEVERAL => return None,
            None => times(delay as u8),
        };
        let count = |shift: u32| u64::from(self.0 >> shift & ((1 << Effect::COUNT_BITS) - 1));
        Some(Events { dense: count(Effect::COUNT_BITS) * times, sparse: count(0) * times })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::fixed::{Delay, SignMode, WeightBits, WeightExponent};
    use nsim_ir::base::rng;
    use nsim_ir::neurons::Port;
    use nsim_ir::quantised::connectivity::SynapseFormat;

    #[test]
    fn effects_beyond_a_table_have_to_be_read() {
        let of_classes = [vec![Effect(7), Effect(3), Effect(7)], vec![], vec![Effect(9), Effect(3)]];
        assert_eq!(Effect::distinct(&of_classes, 4), [3, 7, 9, u32::MAX].map(Effect));
        assert_eq!(Effect::distinct(&of_classes, 3), [3, 7, u32::MAX].map(Effect));
        assert_eq!(Effect::distinct(&[vec![Effect::READ; 2]], 2), [Effect::READ]);
        assert_eq!(Effect(7).events(Some(1), |_| 1), Some(Events { dense: 0, sparse: 7 }));
        assert_eq!(Effect::READ.events(Some(1), |_| 1), None);
    }

    /// Lists of every length around the limits, of one delay field or of several.
    #[test]
    fn effects_are_what_lists_hold() {
        let (exponent, bits) = (WeightExponent::new(0).unwrap(), WeightBits::new(8).unwrap());
        let synapse =
            SynapseFormat { exponent, sign: SignMode::Mixed, bits, port: Port::First, apart: None, rule: None };
        let format = |index_bits| CoreFormat { synapse, delay_bits: 6, index_bits, skip_bits: None };
        let formats = [format(None), format(Some(4))];
        let formats = Formats { all: &formats, moves: &IdVec::new() };
        let mut read = 0;
        for (case, length) in [0u64, 1, 2, 3, 60, 8_190, 8_191, 8_192, 20_000].into_iter().cycle().take(200).enumerate()
        {
            let draw = |below, what, index| rng::below(below, case as u64, what, index);
            let (delays, kinds) = (draw(3, 0, 0) + 1, draw(3, 1, 0));
            let list: Vec<Synapse> = (0..length)
                .map(|index| Synapse {
                    slot: 0,
                    weight: 1,
                    format: if kinds == 2 { draw(2, 2, index) } else { kinds } as u8,
                    delay: Delay::new([62, 0, 5][draw(delays, 3, index) as usize]).unwrap(),
                })
                .collect();
            let effect = Effect::new(&list, formats);
            for reach in [0, 1, 6, 63] {
                let times = |delay: u8| if delay < reach { 3 } else { 0 };
                let expected = Events::of_list(&list, formats, times);
                let always = match reach {
                    0 => Some(0),
                    63 => Some(3),
                    _ => None,
                };
                match effect.events(always, times) {
                    Some(events) => assert_eq!(events, expected, "{case} {reach}"),
                    None => read += 1,
                }
            }
        }
        assert!((100..400).contains(&read), "{read} of 800 are read");
    }
}
