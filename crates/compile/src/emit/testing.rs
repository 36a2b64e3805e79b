//! An encoder and a decoder of synapse memory, for tests.
//!
//! Input: a core's class. Output: its lists in the bits of its formats, and the lists decoded from
//! these bits. They show that the counted memory suffices: as many 64-bit words as
//! [`nsim_partition::resources::packing`] counts, and every synapse decoded. `verify` counts words
//! by the formula; the tests compare the formula with this.
//!
//! An entry: number of the format (4 bits), synapses less one (6 bits), the first slot (as wide as
//! the core's indices; in run-length entries, and with NxTF's counting in dense ones), then the
//! synapses: weight, delay, and run or index. A weight is stored as its number of steps above the
//! least weight of its format. Where a dense entry holds no slot, the input axon's entry of the
//! synapse map does (nengo-loihi's `cx_base`), one for each dense group; it also has begin and end
//! of the list. Fields start at the lowest bit, and entries begin at a word.
//!
//! The table of population axons is stored once, with its lists at equal distances. The synapse
//! map's entry of each population axon has its begin, that distance and the base. Dense entries of
//! a table hold their slots, relative to the base.

use std::collections::BTreeMap;

use nsim_ir::base::fixed::Delay;
use nsim_ir::program::{CoreClass, CoreFormat, InputAxon, Synapse};
use nsim_ir::resource::{Limits, Packing, Resource};
use nsim_partition::resources::packing::{self, Compression, Group, Widths};
use nsim_testing::{limits, random_network, slip, target};

use crate::{Mapping, Options, compile};

/// Bits of a word.
const WORD: usize = 64;

/// An entry of the synapse map.
struct Mapped {
    /// Its first bit.
    first: usize,
    /// Bits of the list, or of each atom of a population axon.
    size: usize,
    /// First slots of a discrete axon's dense groups, in order; a population axon's base.
    slots: Vec<u16>,
}

/// A core's synapse memory.
#[derive(Default)]
struct Memory {
    bits: Vec<bool>,
    /// Entries of population axons, then of discrete ones in order.
    map: Vec<Mapped>,
}

fn put(bits: &mut Vec<bool>, value: u64, width: u8) {
    bits.extend((0..width).map(|bit| value >> bit & 1 == 1));
}

fn take(bits: &mut &[bool], width: u8) -> Option<u64> {
    let (field, rest) = bits.split_at_checked(width.into())?;
    *bits = rest;
    Some(field.iter().rev().fold(0, |value, &bit| value << 1 | u64::from(bit)))
}

/// Parameters that the entries of a core have in common.
struct Layout<'a> {
    class: &'a CoreClass,
    limits: &'a Limits,
    widths: Widths,
}

impl<'a> Layout<'a> {
    fn new(class: &'a CoreClass, limits: &'a Limits) -> Self {
        let longest = class.inputs.lists.items().iter().map(|s| s.delay).max().unwrap_or(Delay::MIN);
        let widths = Widths::for_core(class.compartments.len() as u32, longest, limits.packing);
        Layout { class, limits, widths }
    }

    /// Whether an entry holds its first slot.
    fn holds_slot(&self, compression: Compression, in_table: bool) -> bool {
        match compression {
            Compression::Dense => in_table || self.limits.packing == Packing::Nxtf,
            Compression::RunLength(_) => true,
            Compression::Sparse => false,
        }
    }

    /// Counted bits of an entry.
    fn counted(&self, format: &CoreFormat, synapses: u32, in_table: bool) -> usize {
        let how = compression(format);
        let (delayed, dense) = (format.delay_bits > 0, how == Compression::Dense);
        let group =
            Group { weight_bits: format.synapse.bits, tag_bits: 0, synapses, delayed, dense, skip: format.skip_bits };
        packing::words_as(group, how, in_table, self.widths, self.limits) as usize * WORD
    }

    /// The bits of a list, and the first slots of its dense groups.
    fn encoded(&self, list: &[Synapse], in_table: bool) -> (Vec<bool>, Vec<u16>) {
        let (mut bits, mut slots) = (Vec::new(), Vec::new());
        for group in list.chunk_by(|a, b| a.format == b.format) {
            if compression(&self.class.formats[usize::from(group[0].format)]) == Compression::Dense {
                slots.push(group[0].slot);
            }
            for entry in group.chunks(packing::per_entry(self.limits) as usize) {
                self.encode_entry(&mut bits, entry, in_table);
            }
        }
        (bits, slots)
    }

    fn encode_entry(&self, bits: &mut Vec<bool>, entry: &[Synapse], in_table: bool) {
        let (before, number) = (bits.len(), entry[0].format);
        let format = &self.class.formats[usize::from(number)];
        let (how, least, step) = fields(format);
        put(bits, number.into(), 4);
        put(bits, entry.len() as u64 - 1, 6);
        if self.holds_slot(how, in_table) {
            put(bits, entry[0].slot.into(), self.widths.index);
        }
        let mut next = entry[0].slot;
        for synapse in entry {
            put(bits, ((synapse.weight - least) / step) as u64, format.synapse.bits.get());
            put(bits, synapse.delay.get().into(), format.delay_bits);
            match how {
                Compression::Dense => {}
                Compression::RunLength(width) => put(bits, (synapse.slot - next).into(), width),
                Compression::Sparse => put(bits, synapse.slot.into(), self.widths.index),
            }
            next = synapse.slot + 1;
        }
        // NxTF takes one word more where the last one is nearly full.
        let counted = self.counted(format, entry.len() as u32, in_table);
        let needed = (bits.len() - before).next_multiple_of(WORD);
        bits.resize(before + counted.max(needed), false);
    }

    /// Decodes a list; `slots` has the first slots of its dense groups where entries do not.
    fn decoded(&self, mut bits: &[bool], slots: Option<&[u16]>) -> Option<Vec<Synapse>> {
        let (in_table, mut slots) = (slots.is_none(), slots.unwrap_or_default().iter());
        let (mut list, mut last_dense): (Vec<Synapse>, Option<(u8, u16)>) = (Vec::new(), None);
        while !bits.is_empty() {
            let mut entry = bits;
            let number = take(&mut entry, 4)? as u8;
            let count = take(&mut entry, 6)? as u32 + 1;
            let format = self.class.formats.get(usize::from(number))?;
            let (how, least, step) = fields(format);
            let mut next = match self.holds_slot(how, in_table) {
                true => take(&mut entry, self.widths.index)? as u16,
                // A group that continues in another entry continues at its next slot.
                false if how == Compression::Dense => match last_dense.filter(|&(of, _)| of == number) {
                    Some((_, next)) => next,
                    None => *slots.next()?,
                },
                false => 0,
            };
            for _ in 0..count {
                let weight = least + step * take(&mut entry, format.synapse.bits.get())? as i16;
                let delay = Delay::new(take(&mut entry, format.delay_bits)? as i64).ok()?;
                let slot = match how {
                    Compression::Dense => next,
                    Compression::RunLength(width) => next + take(&mut entry, width)? as u16,
                    Compression::Sparse => take(&mut entry, self.widths.index)? as u16,
                };
                list.push(Synapse { slot, weight, format: number, delay });
                next = slot + 1;
            }
            last_dense = (how == Compression::Dense).then_some((number, next));
            bits = bits.get(self.counted(format, count, in_table)..)?;
        }
        Some(list)
    }
}

fn compression(format: &CoreFormat) -> Compression {
    match (format.index_bits, format.skip_bits) {
        (None, _) => Compression::Dense,
        (Some(_), Some(bits)) => Compression::RunLength(bits),
        (Some(_), None) => Compression::Sparse,
    }
}

/// Compression of a format, its least weight, and the step between weights.
fn fields(format: &CoreFormat) -> (Compression, i16, i16) {
    let synapse = format.synapse;
    (compression(format), synapse.sign.range(synapse.bits).0, synapse.sign.step(synapse.bits))
}

/// Encodes a core's lists into its memory.
fn encode(class: &CoreClass, limits: &Limits) -> Memory {
    let (layout, inputs) = (Layout::new(class, limits), &class.inputs);
    let mut memory = Memory::default();
    let mut tables: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
    for axon in &inputs.populations {
        let (first, size) = *tables.entry(axon.table).or_insert_with(|| {
            let lists = axon.table as usize..axon.table as usize + usize::from(axon.atoms);
            let lists: Vec<_> = lists.map(|list| layout.encoded(inputs.lists.get(list), true).0).collect();
            let (first, size) = (memory.bits.len(), lists.iter().map(Vec::len).max().unwrap_or(0));
            for mut list in lists {
                list.resize(size, false);
                memory.bits.append(&mut list);
            }
            (first, size)
        });
        memory.map.push(Mapped { first, size, slots: vec![axon.base] });
    }
    for list in inputs.iter_discrete() {
        let (mut bits, slots) = layout.encoded(inputs.lists.get(list), false);
        memory.map.push(Mapped { first: memory.bits.len(), size: bits.len(), slots });
        memory.bits.append(&mut bits);
    }
    memory
}

/// Decodes the lists that a core's input axons select, with their target slots; `None` for invalid
/// memory.
fn decode(memory: &Memory, class: &CoreClass, limits: &Limits) -> Option<Vec<Vec<Synapse>>> {
    let (layout, inputs) = (Layout::new(class, limits), &class.inputs);
    let mut discrete = memory.map.iter().skip(inputs.populations.len());
    let list = |axon| match axon {
        InputAxon::Discrete { .. } => {
            let Mapped { first, size, slots } = discrete.next()?;
            layout.decoded(memory.bits.get(*first..first + size)?, Some(slots))
        }
        InputAxon::Member { axon, atom } => {
            let Mapped { first, size, slots } = memory.map.get(usize::from(axon))?;
            let first = first + size * usize::from(atom);
            let mut list = layout.decoded(memory.bits.get(first..first + size)?, None)?;
            list.iter_mut().for_each(|synapse| synapse.slot += slots[0]);
            Some(list)
        }
    };
    (0..inputs.len()).map(|axon| inputs.axon(axon)).map(list).collect()
}

/// Encodes and decodes every core of a program; returns the number of its formats with runs.
pub fn proved(compiled: &Mapping, limits: &Limits, what: &str) -> usize {
    for core in compiled.program.cores().ids() {
        let class = compiled.program.class_of(core);
        let memory = encode(class, limits);
        let words = compiled.partition.usage()[core][Resource::SynapseWords];
        assert_eq!((memory.bits.len() / WORD) as u64, words, "{what} {core}: words");
        let expected: Vec<Vec<Synapse>> = class.inputs.iter().map(|list| list.synapses().collect()).collect();
        assert_eq!(decode(&memory, class, limits), Some(expected), "{what} {core}");
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
