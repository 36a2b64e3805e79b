//! Synapse memory, word by word, and back.
//!
//! In comes a core's image; out go its 64-bit words as the formats say, and the lists that these words decode to. It is
//! the proof that what was counted can be stored and that what is stored is what was meant: as many words as
//! [`crate::compile::packing`] counts, and every synapse back. The simulator does not need it; `verify` counts words by
//! the formula, and the tests hold the formula to this.
//!
//! An entry: number of the format (4 bits), synapses less one (6 bits), the first slot (as wide as the core's indices; in
//! run-length entries, and with NxTF's counting in dense ones), then the synapses: weight, delay, and run or index. A weight
//! is stored as its number of steps above the least weight of its format. Where a dense entry holds no slot, the input
//! axon's entry of the synapse map does (nengo-loihi's `cx_base`), one for each dense group; it also says where the list
//! begins and ends. Fields stand from the lowest bit on and entries begin at a word.

use crate::base::fixed::{Delay, WeightBits};
use crate::compile::packing::{self, Compression, Group, Widths};
use crate::desc::target::{Limits, Packing};
use crate::ir::program::{CoreFormat, CoreImage, Synapse};

/// An input axon's entry of the synapse map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mapped {
    /// The first word.
    pub first: usize,
    /// Words.
    pub words: usize,
    /// First slots of its dense groups, in order.
    pub bases: Vec<u16>,
}

/// A core's synapse memory.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Memory {
    /// The words.
    pub words: Vec<u64>,
    /// By input axon.
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

fn widths(image: &CoreImage, limits: &Limits) -> Widths {
    let longest = image.synapses.items().iter().map(|s| s.delay).max().unwrap_or(Delay::MIN);
    Widths::of(image.compartments.len() as u32, longest, limits.packing)
}

/// Whether an entry holds its first slot.
fn holds_slot(compression: Compression, limits: &Limits) -> bool {
    match compression {
        Compression::Dense => limits.packing == Packing::Nxtf,
        Compression::RunLength(_) => true,
        Compression::Sparse => false,
    }
}

/// The words of a core's lists.
#[must_use]
pub fn encode(image: &CoreImage, limits: &Limits) -> Memory {
    let widths = widths(image, limits);
    let mut memory = Memory::default();
    for list in image.synapses.iter() {
        let first = memory.words.len();
        let mut bases = Vec::new();
        for group in list.chunk_by(|a, b| a.format == b.format) {
            let number = group[0].format;
            let format = &image.formats[usize::from(number)];
            let how = compression(format);
            if how == Compression::Dense {
                bases.push(group[0].slot);
            }
            for entry in group.chunks(packing::per_entry(limits) as usize) {
                encode_entry(&mut memory.words, number, format, entry, widths, limits);
            }
        }
        let words = memory.words.len() - first;
        memory.map.push(Mapped { first, words, bases });
    }
    memory
}

fn encode_entry(
    words: &mut Vec<u64>,
    number: u8,
    format: &CoreFormat,
    entry: &[Synapse],
    widths: Widths,
    limits: &Limits,
) {
    let (before, how) = (words.len(), compression(format));
    let (least, _) = format.synapse.sign.range(format.synapse.bits);
    let step = format.synapse.sign.step(format.synapse.bits);
    let mut writer = Writer { words, bits: 0 };
    writer.put(number.into(), 4);
    writer.put(entry.len() as u64 - 1, 6);
    if holds_slot(how, limits) {
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
    let group = Group {
        weight_bits: format.synapse.bits,
        synapses: entry.len() as u32,
        delayed: format.delay_bits > 0,
        dense: how == Compression::Dense,
        skip: format.skip_bits,
    };
    let counted = packing::words_as(group, how, widths, limits) as usize;
    words.resize((before + counted).max(words.len()), 0);
}

/// The lists that a core's words say, or `None` when they say nothing sensible.
#[must_use]
pub fn decode(memory: &Memory, image: &CoreImage, limits: &Limits) -> Option<Vec<Vec<Synapse>>> {
    let widths = widths(image, limits);
    memory.map.iter().map(|mapped| decode_list(memory, mapped, &image.formats, widths, limits)).collect()
}

fn decode_list(
    memory: &Memory,
    mapped: &Mapped,
    formats: &[CoreFormat],
    widths: Widths,
    limits: &Limits,
) -> Option<Vec<Synapse>> {
    let mut words = memory.words.get(mapped.first..mapped.first + mapped.words)?;
    let (mut list, mut bases): (Vec<Synapse>, _) = (Vec::new(), mapped.bases.iter());
    let mut last_dense: Option<(u8, u16)> = None;
    while !words.is_empty() {
        let mut reader = Reader { words, bits: 0 };
        let number = reader.take(4)? as u8;
        let count = reader.take(6)? as u32 + 1;
        let format = formats.get(usize::from(number))?;
        let how = compression(format);
        let (least, _) = format.synapse.sign.range(format.synapse.bits);
        let step = format.synapse.sign.step(format.synapse.bits);
        let mut slot = match holds_slot(how, limits) {
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
        let group = Group {
            weight_bits: WeightBits::new(format.synapse.bits.get().into()).ok()?,
            synapses: count,
            delayed: format.delay_bits > 0,
            dense: how == Compression::Dense,
            skip: format.skip_bits,
        };
        words = words.get(packing::words_as(group, how, widths, limits) as usize..)?;
    }
    Some(list)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::testing::{limits, random_network, slip, target};
    use crate::compile::{Compiled, Options, compile_quantised};

    /// Encodes and decodes every core of a program; returns how many of its formats have runs.
    fn proved(compiled: &Compiled, limits: &Limits, what: &str) -> usize {
        for (core, image) in compiled.program.cores().enumerate() {
            let memory = encode(image, limits);
            let counted = compiled.partition.usage()[core].synapse_words;
            assert_eq!(memory.words.len() as u64, counted, "{what} {core}: words");
            let meant: Vec<Vec<Synapse>> = image.synapses.iter().map(<[Synapse]>::to_vec).collect();
            assert_eq!(decode(&memory, image, limits), Some(meant), "{what} {core}");
        }
        let formats = compiled.program.cores().iter().flat_map(|image| &image.formats);
        formats.filter(|format| format.skip_bits.is_some()).count()
    }

    #[test]
    fn what_is_stored_is_what_was_meant() {
        let mut runs = 0;
        for seed in 0..120 {
            let packing = if seed % 2 == 0 { Packing::Nengo } else { Packing::Nxtf };
            let limits = Limits { packing, synapse_words_per_axon: 256, ..limits() };
            let compiled = compile_quantised(random_network(seed), &target(2, 2, limits), &Options::default());
            if let Ok(compiled) = compiled {
                runs += proved(&compiled, &limits, &format!("seed {seed}"));
            }
        }
        assert!(runs > 10, "{runs} formats with runs");
        let compiled = compile_quantised(slip(3150), &target(1, 1, limits()), &Options::default()).unwrap();
        proved(&compiled, &limits(), "slip");
    }

    #[test]
    fn a_changed_word_is_another_synapse() {
        let compiled = compile_quantised(slip(50), &target(1, 1, limits()), &Options::default()).unwrap();
        let image = &compiled.program.cores().as_slice()[0];
        let good = encode(image, &limits());
        let meant = decode(&good, image, &limits());
        for bit in [12, 200, 1_000] {
            let mut bad = good.clone();
            bad.words[bit / 64] ^= 1 << (bit % 64);
            assert_ne!(decode(&bad, image, &limits()), meant, "bit {bit}");
        }
    }
}
