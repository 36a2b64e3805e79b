//! An encoder and a decoder of synapse memory, for tests.
//!
//! Input: a core's class. Output: its 64-bit words as the formats say, and the lists that these
//! words decode to. They show that what was counted can be stored: as many words as
//! [`nsim_partition::resources::packing`] counts, and every synapse back. `verify` counts words by
//! the formula; the tests hold the formula to this.
//!
//! An entry: number of the format (4 bits), synapses less one (6 bits), the first slot (as wide as
//! the core's indices; in run-length entries, and with NxTF's counting in dense ones), then the
//! synapses: weight, delay, and run or index. A weight is stored as its number of steps above the
//! least weight of its format. Where a dense entry holds no slot, the input axon's entry of the
//! synapse map does (nengo-loihi's `cx_base`), one for each dense group; it also says where the
//! list begins and ends. Fields stand from the lowest bit on and entries begin at a word.
//!
//! The table of population axons is stored once, its lists at equal distances; the synapse map's
//! entry of each population axon says where it begins, that distance and the base. Dense entries of
//! a table hold their slots, counted from the base.

use std::collections::BTreeMap;

use nsim_ir::base::fixed::Delay;
use nsim_ir::program::{CoreClass, CoreFormat, InputAxon, Synapse};
use nsim_ir::resource::{Limits, Packing};
use nsim_partition::resources::packing;
use nsim_partition::resources::packing::{Compression, Group, Widths};

/// An entry of the synapse map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Mapped {
    /// Of a discrete axon.
    Discrete {
        /// The first word.
        first: usize,
        /// Words.
        words: usize,
        /// First slots of its dense groups, in order.
        bases: Vec<u16>,
    },
    /// Of a population axon.
    Population {
        /// The first word of atom 0.
        first: usize,
        /// Words of each atom.
        words: usize,
        /// Added to every slot.
        base: u16,
    },
}

/// A core's synapse memory.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Memory {
    /// The words.
    pub words: Vec<u64>,
    /// Entries of population axons, then of discrete ones in order.
    pub map: Vec<Mapped>,
}

/// Bits into words.
struct Writer<'a> {
    words: &'a mut Vec<u64>,
    /// Bits of the entry so far.
    bits: u32,
}

impl Writer<'_> {
    fn put(&mut self, value: u64, width: u8) {
        let width = u32::from(width);
        if width == 0 {
            return;
        }
        let at = self.bits % 64;
        if at == 0 {
            self.words.push(0);
        }
        if let Some(word) = self.words.last_mut() {
            *word |= value << at;
        }
        if at + width > 64 {
            self.words.push(value >> (64 - at));
        }
        self.bits += width;
    }
}

/// Bits out of words.
struct Reader<'a> {
    words: &'a [u64],
    bits: usize,
}

impl Reader<'_> {
    fn take(&mut self, width: u8) -> Option<u64> {
        let width = usize::from(width);
        if width == 0 {
            return Some(0);
        }
        let (word, at) = (self.bits / 64, self.bits % 64);
        let mut value = self.words.get(word)? >> at;
        if at + width > 64 {
            value |= self.words.get(word + 1)? << (64 - at);
        }
        self.bits += width;
        Some(value & ((1 << width) - 1))
    }
}

fn compression(format: &CoreFormat) -> Compression {
    match (format.index_bits, format.skip_bits) {
        (None, _) => Compression::Dense,
        (Some(_), Some(bits)) => Compression::RunLength(bits),
        (Some(_), None) => Compression::Sparse,
    }
}

fn widths(class: &CoreClass, limits: &Limits) -> Widths {
    let longest = class.inputs.lists.items().iter().map(|s| s.delay).max().unwrap_or(Delay::MIN);
    Widths::for_core(class.compartments.len() as u32, longest, limits.packing)
}

/// Whether an entry holds its first slot.
fn holds_slot(compression: Compression, in_table: bool, limits: &Limits) -> bool {
    match compression {
        Compression::Dense => in_table || limits.packing == Packing::Nxtf,
        Compression::RunLength(_) => true,
        Compression::Sparse => false,
    }
}

/// The words of a core's lists.
#[must_use]
pub fn encode(class: &CoreClass, limits: &Limits) -> Memory {
    let (widths, inputs) = (widths(class, limits), &class.inputs);
    let mut memory = Memory::default();
    let mut tables: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for axon in &inputs.populations {
        let (first, words) = *tables.entry(axon.table).or_insert_with(|| {
            let first = memory.words.len();
            let lists = axon.table as usize..axon.table as usize + usize::from(axon.atoms);
            let mut of_lists: Vec<Vec<u64>> = Vec::new();
            for list in lists {
                let mut words = Vec::new();
                encode_list(&mut words, inputs.lists.get(list), class, true, widths, limits);
                of_lists.push(words);
            }
            let words = of_lists.iter().map(Vec::len).max().unwrap_or(0);
            for mut list in of_lists {
                list.resize(words, 0);
                memory.words.append(&mut list);
            }
            (first, words)
        });
        memory.map.push(Mapped::Population { first, words, base: axon.base });
    }
    for list in inputs.iter_discrete() {
        let first = memory.words.len();
        let bases = encode_list(&mut memory.words, inputs.lists.get(list), class, false, widths, limits);
        let words = memory.words.len() - first;
        memory.map.push(Mapped::Discrete { first, words, bases });
    }
    memory
}

/// Appends the words of a list; returns the first slots of its dense groups.
fn encode_list(
    words: &mut Vec<u64>,
    list: &[Synapse],
    class: &CoreClass,
    in_table: bool,
    widths: Widths,
    limits: &Limits,
) -> Vec<u16> {
    let mut bases = Vec::new();
    for group in list.chunk_by(|a, b| a.format == b.format) {
        let number = group[0].format;
        let format = &class.formats[usize::from(number)];
        if compression(format) == Compression::Dense {
            bases.push(group[0].slot);
        }
        for entry in group.chunks(packing::per_entry(limits) as usize) {
            encode_entry(words, (number, format), entry, in_table, widths, limits);
        }
    }
    bases
}

/// Words of an entry, counted.
fn words_of(format: &CoreFormat, synapses: u32, in_table: bool, widths: Widths, limits: &Limits) -> usize {
    let how = compression(format);
    let group = Group {
        weight_bits: format.synapse.bits,
        synapses,
        delayed: format.delay_bits > 0,
        dense: how == Compression::Dense,
        skip: format.skip_bits,
    };
    let words = if in_table { packing::words_in_table } else { packing::words_as };
    words(group, how, widths, limits) as usize
}

fn encode_entry(
    words: &mut Vec<u64>,
    (number, format): (u8, &CoreFormat),
    entry: &[Synapse],
    in_table: bool,
    widths: Widths,
    limits: &Limits,
) {
    let (before, how) = (words.len(), compression(format));
    let (least, _) = format.synapse.sign.range(format.synapse.bits);
    let step = format.synapse.sign.step(format.synapse.bits);
    let mut writer = Writer { words, bits: 0 };
    writer.put(number.into(), 4);
    writer.put(entry.len() as u64 - 1, 6);
    if holds_slot(how, in_table, limits) {
        writer.put(entry[0].slot.into(), widths.index);
    }
    let mut last = None;
    for synapse in entry {
        writer.put(((synapse.weight - least) / step) as u64, format.synapse.bits.get());
        writer.put(synapse.delay.get().into(), format.delay_bits);
        match how {
            Compression::Dense => {}
            Compression::RunLength(bits) => {
                let left_out = last.map_or(0, |last: u16| synapse.slot - last - 1);
                writer.put(left_out.into(), bits);
            }
            Compression::Sparse => writer.put(synapse.slot.into(), widths.index),
        }
        last = Some(synapse.slot);
    }
    // NxTF takes one word more where the last one is nearly full.
    let counted = words_of(format, entry.len() as u32, in_table, widths, limits);
    words.resize((before + counted).max(words.len()), 0);
}

/// The lists that a core's input axons select, as its words say them, with the slots that they lead
/// to; or `None` when the words say nothing sensible.
#[must_use]
pub fn decode(memory: &Memory, class: &CoreClass, limits: &Limits) -> Option<Vec<Vec<Synapse>>> {
    let (widths, inputs) = (widths(class, limits), &class.inputs);
    let mut discrete = memory.map.iter().skip(inputs.populations.len());
    let axons = (0..inputs.len()).map(|axon| inputs.axon(axon));
    axons
        .map(|axon| match axon {
            InputAxon::Discrete { .. } => {
                let Mapped::Discrete { first, words, bases } = discrete.next()? else { return None };
                let words = memory.words.get(*first..first + words)?;
                decode_list(words, Some(bases), &class.formats, widths, limits)
            }
            InputAxon::Member { axon, atom } => {
                let Mapped::Population { first, words, base } = memory.map.get(usize::from(axon))? else { return None };
                let first = first + words * usize::from(atom);
                let stored = memory.words.get(first..first + words)?;
                let mut list = decode_list(stored, None, &class.formats, widths, limits)?;
                list.iter_mut().for_each(|synapse| synapse.slot += base);
                Some(list)
            }
        })
        .collect()
}

/// A list; `bases` has the first slots of its dense groups where entries do not.
fn decode_list(
    mut words: &[u64],
    bases: Option<&[u16]>,
    formats: &[CoreFormat],
    widths: Widths,
    limits: &Limits,
) -> Option<Vec<Synapse>> {
    let in_table = bases.is_none();
    let (mut list, mut bases): (Vec<Synapse>, _) = (Vec::new(), bases.unwrap_or_default().iter());
    let mut last_dense: Option<(u8, u16)> = None;
    while !words.is_empty() {
        let mut reader = Reader { words, bits: 0 };
        let number = reader.take(4)? as u8;
        let count = reader.take(6)? as u32 + 1;
        let format = formats.get(usize::from(number))?;
        let how = compression(format);
        let (least, _) = format.synapse.sign.range(format.synapse.bits);
        let step = format.synapse.sign.step(format.synapse.bits);
        let mut slot = match holds_slot(how, in_table, limits) {
            true => reader.take(widths.index)? as u16,
            // A group that goes on in another entry goes on where it stopped.
            false if how == Compression::Dense => match last_dense.filter(|&(of, _)| of == number) {
                Some((_, last)) => last + 1,
                None => *bases.next()?,
            },
            false => 0,
        };
        for at in 0..count {
            let weight = least + step * reader.take(format.synapse.bits.get())? as i16;
            let delay = Delay::new(reader.take(format.delay_bits)? as i64).ok()?;
            slot = match how {
                Compression::Dense if at > 0 => slot + 1,
                Compression::Dense => slot,
                Compression::RunLength(bits) => {
                    let left_out = reader.take(bits)? as u16;
                    if at > 0 { slot + 1 + left_out } else { slot }
                }
                Compression::Sparse => reader.take(widths.index)? as u16,
            };
            list.push(Synapse { slot, weight, format: number, delay });
        }
        last_dense = (how == Compression::Dense).then_some((number, slot));
        words = words.get(words_of(format, count, in_table, widths, limits)..)?;
    }
    Some(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Compiled, Options, compile};
    use nsim_ir::base::id::CoreId;
    use nsim_ir::resource::Resource;
    use nsim_testing::{limits, random_network, slip, target};

    /// Encodes and decodes every core of a program; returns how many of its formats have runs.
    fn proved(compiled: &Compiled, limits: &Limits, what: &str) -> usize {
        for core in compiled.program.cores().ids() {
            let class = compiled.program.class_of(core);
            let memory = encode(class, limits);
            let counted = compiled.partition.usage()[core][Resource::SynapseWords];
            assert_eq!(memory.words.len() as u64, counted, "{what} {core}: words");
            let meant: Vec<Vec<Synapse>> = class.inputs.iter().map(|list| list.synapses().collect()).collect();
            assert_eq!(decode(&memory, class, limits), Some(meant), "{what} {core}");
        }
        let formats = compiled.program.classes().iter().flat_map(|class| &class.formats);
        formats.filter(|format| format.skip_bits.is_some()).count()
    }

    #[test]
    fn what_is_stored_is_what_was_meant() {
        let mut runs = 0;
        for seed in 0..120 {
            let packing = if seed % 2 == 0 { Packing::Nengo } else { Packing::Nxtf };
            let limits = Limits { packing, ..limits().with(Resource::SynapseWordsPerAxon, 256) };
            let compiled = compile(random_network(seed), &target(2, 2, limits.clone()), &Options::default());
            if let Ok(compiled) = compiled {
                runs += proved(&compiled, &limits, &format!("seed {seed}"));
            }
        }
        assert!(runs > 10, "{runs} formats with runs");
        let compiled = compile(slip(3150), &target(1, 1, limits()), &Options::default()).unwrap();
        proved(&compiled, &limits(), "slip");
    }

    #[test]
    fn a_changed_word_is_another_synapse() {
        let compiled = compile(slip(50), &target(1, 1, limits()), &Options::default()).unwrap();
        let class = compiled.program.class_of(CoreId(0));
        let good = encode(class, &limits());
        let meant = decode(&good, class, &limits());
        for bit in [12, 200, 1_000] {
            let mut bad = good.clone();
            bad.words[bit / 64] ^= 1 << (bit % 64);
            assert_ne!(decode(&bad, class, &limits()), meant, "bit {bit}");
        }
    }
}
