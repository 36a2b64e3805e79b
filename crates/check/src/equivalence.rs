//! Proof that a program equals its network.
//!
//! The rule, for a network N and a program P with the same numbers of channels and compartments:
//!
//! 1. *Parameters.* For every compartment n, with (c, s) = seat(n): `P.cores[c].ids[s] = n`, and
//!    the neuron's fields and start step at (c, s) equal the ones of n in N. The parent of n has
//!    the seat (c, s + 1).
//! 2. *Synapses.* For every source s, let R(s) be the multiset of (target, format, weight, delay)
//!    over all synapses of all projections from s in N, and D(s) the multiset of (`ids[slot]`,
//!    format, weight, delay) over all synapses of all lists that the messages of s select in P,
//!    where a compartment has the messages of its seat. Then R(s) = D(s). The format includes
//!    exponent, sign mode and bits, so the scaled weights are equal too.
//! 3. *Nothing else.* Every input axon of P is the end of exactly one message. (`Program::new`
//!    enforces this. With 2 it follows that no source outside N reaches a synapse of P.)
//! 4. *Payloads.* A spike of a source has equal payloads in P and N.
//! 5. *Frame.* First compartments and sizes of populations, output population, semantics, threshold
//!    test and reset agree.
//!
//! *Parts.* P may be the part of one of several processes that run a program together. Then N is
//! limited to its synapses to compartments of local cores, and each process proves its own part.
//!
//! *Classes.* Cores of one class have equal tables. Let f be the first core of a class and m
//! another core of it. m is a *shift* of f when a map h of compartments and channels takes, slot by
//! slot, the compartments of f to the ones of m, and axon by axon the sources of f to the ones of
//! m, and
//!
//! - h adds a number of copies, where N is several equal copies that share nothing; or
//! - the compartments of f are of one population. To each of them h adds a number of rows and
//!   columns; to each source, these times the stride of every projection from its population, all
//!   of which are windows. Then h adds a number of copies.
//!
//! In both cases the synapses of N between h(s) and h(n) equal its synapses between s and n. So if
//! 2 holds for the synapses of f, each synapse of m is one of N. Shifts are therefore not compared.
//! If all compared cores are equal, and P has as many synapses as N, then P has all synapses of N.
//! Otherwise all cores are compared, which finds the first source that differs.
//!
//! The checker decodes the program's tables and enumerates the network's synapses; it calls no code
//! of the compiler's stages. Sources are compared in pieces of `synapses_of_piece` synapses on
//! average; each thread needs memory for one piece.

use std::collections::BTreeSet;
use std::ops::Range;

use rayon::prelude::*;

use crate::shifts::compared;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::fixed::Delay;
use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, Id};
use nsim_ir::program::{Compartment, Compartments, Program, ProgramLearning};
use nsim_ir::quantised::connectivity::SynapseFormat;
use nsim_ir::quantised::{Population, Projection, Quantised, Units};
use nsim_ir::spikes::Message;

/// Maximum number of sources of a piece: their numbers within a piece have 16 bits.
const MOST_SOURCES: u64 = 1 << 16;

/// Average number of synapses of a piece. It is large enough to read the loaded parts of each
/// core's tables in full, and small enough for a processor's cache.
fn synapses_of_piece(cores: usize) -> u64 {
    (64 * cores as u64).clamp(1 << 16, 1 << 19)
}

/// A difference between a program and its network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Difference {
    /// A property of the whole program.
    #[error("the {0} of the program differs from the network's")]
    Frame(&'static str),
    /// A compartment with other parameters, or in the seat of another one.
    #[error("the parameters of compartment {0} differ between program and network")]
    Parameters(CompartmentId),
    /// A child that is not in the slot before its parent.
    #[error("compartment {0} of the program is not in the slot before its parent")]
    Neuron(CompartmentId),
    /// A source that reaches other synapses.
    #[error("{source_name} reaches {decoded} synapses in the program, but {meant} or different ones in the network")]
    Synapses {
        /// The source.
        source_name: String,
        /// Number of its synapses in the program.
        decoded: usize,
        /// Number of its synapses in the network.
        meant: usize,
    },
}

/// One synapse as both sides encode it, in one number, so that sorting is quick: format (21 bits),
/// target (27), delay (6), weight (10).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct SynapseCode(u64);

impl SynapseCode {
    /// Returns the bits that synapses of a format have in common: its place among the `formats` of
    /// the network, ascending. A format that the network lacks has the place after the last.
    fn of_format(format: SynapseFormat, formats: &[SynapseFormat]) -> Self {
        SynapseCode((formats.binary_search(&format).unwrap_or(formats.len()) as u64) << 43)
    }

    /// Returns the code of a synapse of this format.
    #[inline]
    fn with(self, target: CompartmentId, weight: i16, delay: Delay) -> Self {
        let weight = u64::from((weight + 512) as u16 & 1023);
        SynapseCode(self.0 | u64::from(target.0) << 16 | u64::from(delay.get()) << 10 | weight)
    }
}

/// Checks that a program equals its network of `copies` equal copies; returns the number of cores
/// proven from the first of their class.
///
/// # Errors
/// The first [`Difference`]: the frame, then parameters, then synapses by source.
pub fn check_copies(network: &Quantised, program: &Program, copies: u32) -> Result<u32, Difference> {
    check_frame(network, program)?;
    check_parameters(network, program)?;
    // A part lacks some messages of cores that are not local.
    if program.local_rank().is_none() {
        let compared = compared(network, program, copies);
        let shifts = compared.iter().filter(|&&compared| !compared).count() as u32;
        let complete = || program.synapses_of(|_| true) == network.synapses();
        if shifts > 0 && complete() && check_synapses(network, program, |core| compared[core]).is_ok() {
            return Ok(shifts);
        }
        return check_synapses(network, program, |_| true).map(|()| 0);
    }
    check_synapses(network, program, |core| program.is_local(core)).map(|()| 0)
}

/// Checks the synapses of the cores that are to be compared.
fn check_synapses(
    network: &Quantised,
    program: &Program,
    compared: impl Fn(CoreId) -> bool + Sync + Copy,
) -> Result<(), Difference> {
    let formats: BTreeSet<SynapseFormat> = network.projections().iter().map(|projection| projection.format).collect();
    let formats: &[SynapseFormat] = &formats.into_iter().collect::<Vec<_>>();
    for (id, population) in network.populations().enumerate() {
        let outgoing: Vec<_> = network.targets_of(id).map(|(_, projection, first)| (projection, first)).collect();
        let synapses: u64 = network.outgoing(id).iter().map(|&projection| network.synapses_of(projection)).sum();
        let size = population.shape.len();
        let of_piece = synapses_of_piece(program.cores().len());
        let first = network.first_source(population);
        let piece = (u64::from(size) * of_piece / synapses.max(1)).clamp(1, MOST_SOURCES) as u32;
        let failed = (0..size.div_ceil(piece))
            .into_par_iter()
            .map_init(
                || Decoder { of_network: formats, ..Decoder::default() },
                |decoder, number| {
                    let sources = number * piece..((number + 1) * piece).min(size);
                    if sources.clone().all(|index| is_skipped(program, first + index, compared)) {
                        return Ok(());
                    }
                    decoder.enumerate(&outgoing, first, sources.clone(), program, compared);
                    decoder.decode(program, first + sources.start..first + sources.end, compared);
                    match decoder.first_that_differs() {
                        None => Ok(()),
                        Some((source, meant)) => {
                            let index = sources.start + source;
                            let source_name = name_of(&population.units, index);
                            let decoded = program.messages(first + index).map(|message| {
                                program.class_of(message.core).inputs.get(usize::from(message.axon)).synapses().len()
                            });
                            let decoded = decoded.sum();
                            Err(Difference::Synapses { source_name, decoded, meant })
                        }
                    }
                },
            )
            .find_map_first(Result::err);
        if let Some(difference) = failed {
            return Err(difference);
        }
    }
    Ok(())
}

/// Whether all messages of a source go to cores that are not compared. The total count reveals
/// synapses without a message.
fn is_skipped(program: &Program, source: u32, compared: impl Fn(CoreId) -> bool) -> bool {
    let mut messages = program.messages(source);
    messages.len() > 0 && messages.all(|message| !compared(message.core))
}

fn check_frame(network: &Quantised, program: &Program) -> Result<(), Difference> {
    let (expected, actual) = (network.parts(), program.parts());
    let populations = network.populations().iter().map(Compartments::in_population);
    let rules = [
        (program.channels() == network.channels(), "number of input channels"),
        (program.compartments() == network.compartments(), "number of compartments"),
        (actual.populations.iter().copied().eq(populations), "list of populations"),
        (network.populations().iter().all(|p| has_equal_messages(network, p, program)), "payload of a population"),
        (actual.output == expected.output, "output population"),
        (program.output() == network.output(), "decision"),
        (actual.semantics == expected.semantics, "semantics"),
        (actual.threshold == expected.threshold, "threshold test"),
        (actual.reset == expected.reset, "reset"),
        (actual.learning == ProgramLearning::in_network(network), "learning rules"),
    ];
    rules.into_iter().find(|(holds, _)| !holds).map_or(Ok(()), |(_, what)| Err(Difference::Frame(what)))
}

fn has_equal_messages(network: &Quantised, population: &Population, program: &Program) -> bool {
    let (first, graded) = (network.first_source(population), &program.parts().graded);
    let mut source = first;
    // Up to the next begin or end of a payload, all sources send messages of one kind.
    while source < first + population.shape.len() {
        let here = graded.iter().find(|graded| graded.sources.contains(&source));
        if here.map_or(Message::Spike, |graded| graded.message) != population.message {
            return false;
        }
        let next = graded.iter().map(|graded| graded.sources.start).filter(|&start| start > source).min();
        source = here.map_or(next.unwrap_or(u32::MAX), |graded| graded.sources.end);
    }
    true
}

fn check_parameters(network: &Quantised, program: &Program) -> Result<(), Difference> {
    for population in network.populations() {
        let Units::Compartments { first, neurons, start_step } = &population.units else { continue };
        let differs = |id: &CompartmentId| {
            let expected = Compartment { neuron: neurons.get(id.0 - first.0), start_step: *start_step };
            let seat = program.seats()[*id];
            let found = program.cores().get(seat.core).and_then(|image| {
                let slot = usize::from(seat.slot);
                (image.ids.get(slot) == Some(id)).then(|| program.classes()[image.class].compartments.get(slot))?
            });
            found != Some(&expected)
        };
        let ids = (first.0..first.0 + population.shape.len()).into_par_iter().map(CompartmentId);
        if let Some(id) = ids.find_first(differs) {
            return Err(Difference::Parameters(id));
        }
    }
    let seat = |id: CompartmentId| (program.seats()[id].core, usize::from(program.seats()[id].slot));
    let follows = |child, parent| seat(parent) == (seat(child).0, seat(child).1 + 1);
    match network.children().find(|&(child, parent, _)| !follows(child, parent)) {
        Some((child, ..)) => Err(Difference::Neuron(child)),
        None => Ok(()),
    }
}

fn name_of(units: &Units, index: u32) -> String {
    match units {
        Units::Input(first) => format!("input channel {}", ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => format!("compartment {}", CompartmentId(first.0 + index)),
    }
}

/// Compares two lists as multisets, by the count of each number in a table with open addressing.
#[derive(Default)]
struct Tally {
    /// Number, the comparison that wrote it, and its count. The length is a power of two.
    slots: Vec<(u64, u32, u32)>,
    comparison: u32,
}

impl Tally {
    fn is_equal(&mut self, a: &[SynapseCode], b: &[SynapseCode]) -> bool {
        if a.len() != b.len() {
            return false;
        }
        // At most half of the slots are in use, so that a search ends.
        let slots = (2 * a.len()).next_power_of_two().max(2);
        if self.slots.len() < slots || self.comparison == u32::MAX {
            (self.slots, self.comparison) = (vec![(0, 0, 0); slots.max(self.slots.len())], 0);
        }
        self.comparison += 1;
        let (slots, comparison) = (&mut self.slots[..slots], self.comparison);
        for code in a {
            let slot = Self::slot_of(slots, *code, comparison);
            if slot.1 != comparison {
                *slot = (code.0, comparison, 0);
            }
            slot.2 += 1;
        }
        b.iter().all(|code| {
            let slot = Self::slot_of(slots, *code, comparison);
            let occurs = slot.1 == comparison && slot.2 > 0;
            slot.2 = slot.2.wrapping_sub(u32::from(occurs));
            occurs
        })
    }

    /// Returns the slot of a number, or the free slot for it.
    fn slot_of(slots: &mut [(u64, u32, u32)], code: SynapseCode, comparison: u32) -> &mut (u64, u32, u32) {
        let mask = slots.len() - 1;
        // The upper bits of the product depend on all bits of the number.
        let mut at = (code.0.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> (u64::BITS - slots.len().ilog2())) as usize;
        while slots[at].1 == comparison && slots[at].0 != code.0 {
            at = (at + 1) & mask;
        }
        &mut slots[at]
    }
}

/// R(s) and D(s) of consecutive sources. Their messages are decoded core by core: the lists of all
/// sources are scattered over tens of thousands of cores, but the lists of a piece are close
/// together on each core.
#[derive(Default)]
struct Decoder<'f> {
    /// Formats of the network, ascending.
    of_network: &'f [SynapseFormat],
    /// End of the messages to each core.
    ends: Vec<u32>,
    /// (axon, source within the piece), by core.
    messages: Vec<(u16, u16)>,
    /// Begin of each source's synapses in `meant`, and the end of the last.
    first: Vec<usize>,
    expected: Vec<SynapseCode>,
    /// Codes of the formats of a core.
    formats: Vec<SynapseCode>,
    /// Index in `decoded` of the next synapse of each source; `decoded` has the length of `meant`.
    next: Vec<usize>,
    decoded: Vec<SynapseCode>,
    tally: Tally,
}

impl Decoder<'_> {
    /// R(s): the network's synapses to the cores that are compared; `outgoing` has projections with
    /// their first targets.
    fn enumerate(
        &mut self,
        outgoing: &[(&Projection, CompartmentId)],
        first_source: u32,
        indices: Range<u32>,
        program: &Program,
        compared: impl Fn(CoreId) -> bool,
    ) {
        self.expected.clear();
        self.first.clear();
        for index in indices {
            self.first.push(self.expected.len());
            if is_skipped(program, first_source + index, &compared) {
                continue;
            }
            for &(projection, first) in outgoing {
                let wanted = |target| compared(program.seats()[CompartmentId(first.0 + target)].core);
                let code = SynapseCode::of_format(projection.format, self.of_network);
                projection.connectivity.for_each_wanted(index, wanted, |target, weight| {
                    self.expected.push(code.with(CompartmentId(first.0 + target), weight, projection.delay));
                });
            }
        }
        self.first.push(self.expected.len());
    }

    /// D(s), up to the number of synapses of R(s).
    fn decode(&mut self, program: &Program, sources: Range<u32>, compared: impl Fn(CoreId) -> bool) {
        let messages = |source| program.messages(source).filter(|message| compared(message.core));
        let all = || (0..=u16::MAX).zip(sources.clone()).map(|(number, source)| (number, messages(source)));
        self.ends.clear();
        self.ends.resize(program.cores().len() + 1, 0);
        all().flat_map(|(_, messages)| messages).for_each(|message| self.ends[message.core.index() + 1] += 1);
        (0..program.cores().len()).for_each(|core| self.ends[core + 1] += self.ends[core]);
        self.messages.clear();
        self.messages.resize(self.ends.last().map_or(0, |&end| end as usize), (0, 0));
        for (source, messages) in all() {
            for message in messages {
                // Each begin advances to its end.
                let place = &mut self.ends[message.core.index()];
                self.messages[*place as usize] = (message.axon, source);
                *place += 1;
            }
        }
        self.decoded.clear();
        self.decoded.resize(self.expected.len(), SynapseCode(0));
        self.next.clear();
        self.next.extend_from_slice(&self.first[..sources.len()]);
        let mut begin = 0;
        for (image, &end) in program.cores().iter().zip(&self.ends) {
            let of_core = &self.messages[begin as usize..end as usize];
            begin = end;
            self.formats.clear();
            let class = &program.classes()[image.class];
            self.formats
                .extend(class.formats.iter().map(|format| SynapseCode::of_format(format.synapse, self.of_network)));
            for &(axon, source) in of_core {
                let (next, end) = (&mut self.next[usize::from(source)], self.first[usize::from(source) + 1]);
                for synapse in class.inputs.get(usize::from(axon)).synapses() {
                    if *next < end {
                        let target = image.ids[usize::from(synapse.slot)];
                        let format = self.formats[usize::from(synapse.format)];
                        self.decoded[*next] = format.with(target, synapse.weight, synapse.delay);
                    }
                    *next += 1;
                }
            }
        }
    }

    /// Returns the first source of the piece with R(s) != D(s), and its number of synapses in the
    /// network.
    fn first_that_differs(&mut self) -> Option<(u32, usize)> {
        for (source, &next) in self.next.iter().enumerate() {
            let range = self.first[source]..self.first[source + 1];
            let (expected, decoded) = (&self.expected[range.clone()], &self.decoded[range.clone()]);
            if next != range.end || !self.tally.is_equal(expected, decoded) {
                return Some((source as u32, expected.len()));
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    #[test]
    fn a_tally_finds_what_sorting_finds() {
        let mut tally = Tally::default();
        for seed in 0..2_000 {
            let size = rng::below(200, 1, seed, 0);
            // Few numbers, so that they occur several times.
            let a: Vec<SynapseCode> = (1..=size).map(|k| SynapseCode(rng::below(size, 2, seed, k))).collect();
            let mut b = a.clone();
            b.reverse();
            if seed % 2 == 1 && !b.is_empty() {
                let at = rng::below(size, 3, seed, 0) as usize;
                b[at] = SynapseCode(rng::below(size + 2, 4, seed, 0));
            }
            let sorted = |list: &[SynapseCode]| {
                let mut list = list.to_vec();
                list.sort_unstable();
                list
            };
            assert_eq!(tally.is_equal(&a, &b), sorted(&a) == sorted(&b), "{seed}");
            assert!(a.is_empty() || !tally.is_equal(&a, &b[1..]), "{seed}, one fewer");
        }
    }
}
