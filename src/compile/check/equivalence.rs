//! Proof that a program equals its network.
//!
//! The rule, for a network N and a program P with the same numbers of channels and compartments:
//!
//! 1. *Parameters.* For every compartment n, with (c, s) = seat(n): `P.cores[c].ids[s] = n`, and the neuron's fields and
//!    start step at (c, s) are those that N gives n.
//! 2. *Synapses.* For every source s, let R(s) be the multiset of (target, format, weight, delay) over all synapses of all
//!    projections from s in N, and D(s) the multiset of (`ids[slot]`, format, weight, delay) over all synapses of all lists
//!    that the messages of s lead to in P, where the messages of a compartment are those of its seat. Then R(s) = D(s).
//!    The format is exponent, sign mode and bits; so the scaled weights are equal too.
//! 3. *Nothing else.* Every input axon of P is the end of exactly one message. (`Program::new` holds programs to it; with
//!    2 it follows that no synapse of P is reached by a source that N does not have.)
//! 4. *Payloads.* A spike of a source carries in P what it carries in N.
//! 5. *Frame.* First compartments and sizes of populations, output population, semantics, threshold test and reset agree.
//!
//! *Parts.* P may be held in part, by one of several processes that run it together. Then N stands for its synapses to compartments
//! whose cores are held, and the parts of all processes together are proven by each proving its own.
//!
//! *Copies.* N may be so many equal copies that share nothing, copy after copy. Copy k is proven from copy j < k, which 1 and 2
//! have been checked for, when
//!
//! a. the populations and projections of k in N are those of j, their units numbered k - j copies later;
//! b. each source of k sends as many messages as that of j, to the same axons of cores each of which is that of j *later*: it holds the
//!    same lists, equal formats and parameters, and the compartments k - j copies later, slot by slot, at their seats.
//!
//! By b., D of a source of k is D of that of j with targets k - j copies later, by a. so is R, and parameters are equal.
//!
//! The checker decodes the program's tables and enumerates the network's synapses; it calls nothing of the stages between.
//! Sources are compared a piece at a time, `PIECE_SYNAPSES` of the network on average; memory is that of a piece for each
//! thread.

use std::ops::Range;

use rayon::prelude::*;

use crate::base::fixed::{Delay, SignMode};
use crate::base::id::{ChannelId, CompartmentId, Id, PopulationId};
use crate::compile::check::repeats::{self, messages_of};
use crate::ir::program::{AxonTarget, Compartment, Compartments, Program};
use crate::ir::quantised::{Population, Projection, Quantised, SynapseFormat, Units};

/// Synapses of the sources that are decoded together, on average: they should stay in a processor's cache.
const PIECE_SYNAPSES: u64 = 1 << 18;
/// Sources that are decoded together at most.
const MOST_SOURCES: u16 = 1 << 13;
/// Cores whose lists are read together.
const NEIGHBOURS: usize = 64;

/// A difference between a program and its network.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Difference {
    /// Something that is said once for the whole program.
    #[error("the program's {0} is not the network's")]
    Frame(&'static str),
    /// A compartment with other parameters, or in another's seat.
    #[error("compartment {0} of the program has other parameters than the network's")]
    Parameters(CompartmentId),
    /// A source that reaches something else.
    #[error("{source_name} reaches {decoded} synapses in the program and {meant} in the network, or other ones")]
    Synapses {
        /// The source.
        source_name: String,
        /// Synapses that the program gives it.
        decoded: usize,
        /// Synapses that the network gives it.
        meant: usize,
    },
}

/// One synapse as both sides encode it, in one number, so that sorting is quick: target (27 bits), exponent (5), sign mode
/// (2), bits (4), delay (6), weight (10).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct SynapseCode(u64);

impl SynapseCode {
    pub(super) fn new(target: CompartmentId, format: SynapseFormat, weight: i16, delay: Delay) -> Self {
        let sign = match format.sign {
            SignMode::Mixed => 0,
            SignMode::Excitatory => 1,
            SignMode::Inhibitory => 2,
        };
        let mut code = u64::from(target.0);
        code = code << 5 | u64::from((format.exponent.get() + 16) as u8);
        code = code << 2 | sign;
        code = code << 4 | u64::from(format.bits.get());
        code = code << 6 | u64::from(delay.get());
        SynapseCode(code << 10 | u64::from((weight + 512) as u16 & 1023))
    }
}

/// Checks that a program equals its network.
///
/// # Errors
/// The first [`Difference`]: the frame, then parameters, then synapses by source.
pub fn check(network: &Quantised, program: &Program) -> Result<(), Difference> {
    check_copies(network, program, 1).map(|_| ())
}

/// Checks all but synapses, of a program whose synapses have been checked.
///
/// # Errors
/// The first [`Difference`]: the frame, then parameters.
pub fn check_neurons(network: &Quantised, program: &Program) -> Result<(), Difference> {
    check_frame(network, program)?;
    check_parameters(network, program)
}

/// The same of so many equal copies; how many of them were proven from another.
///
/// # Errors
/// As [`check`].
pub fn check_copies(network: &Quantised, program: &Program, copies: u32) -> Result<u32, Difference> {
    check_frame(network, program)?;
    check_parameters(network, program)?;
    // A part has the messages of no copy whole.
    let proven = match program.held_rank() {
        None => repeats::proven(network, program, copies),
        Some(_) => vec![false; copies.max(1) as usize],
    };
    let of_copy = (network.populations().len() as u32 / copies.max(1)).max(1);
    let left = |id: PopulationId| !proven.get((id.0 / of_copy) as usize).copied().unwrap_or(false);
    for (id, population) in network.populations().enumerate().filter(|&(id, _)| left(id)) {
        let outgoing: Vec<&Projection> = network.projections().iter().filter(|p| p.source == id).collect();
        let synapses: u64 = network.outgoing(id).iter().map(|&projection| network.synapses_of(projection)).sum();
        let size = population.shape.len();
        let piece = (u64::from(size) * PIECE_SYNAPSES / synapses.max(1)).clamp(1, MOST_SOURCES.into()) as u32;
        let failed = (0..size.div_ceil(piece))
            .into_par_iter()
            .map_init(Decoder::default, |decoder, number| {
                let sources = number * piece..((number + 1) * piece).min(size);
                decoder.decode(program, &population.units, sources.clone());
                for index in sources.clone() {
                    let decoded = decoder.of_source(index - sources.start);
                    mean(network, &outgoing, (index, program), &mut decoder.meant);
                    if decoder.meant != decoder.decoded[decoded.clone()] {
                        let source_name = name_of(&population.units, index);
                        let (decoded, meant) = (decoded.len(), decoder.meant.len());
                        return Err(Difference::Synapses { source_name, decoded, meant });
                    }
                }
                Ok(())
            })
            .find_map_first(Result::err);
        if let Some(difference) = failed {
            return Err(difference);
        }
    }
    Ok(proven.into_iter().filter(|&proven| proven).count() as u32)
}

fn check_frame(network: &Quantised, program: &Program) -> Result<(), Difference> {
    let (meant, found) = (network.parts(), program.parts());
    let populations = network.populations().iter().map(Compartments::in_population);
    let rules = [
        (program.channels() == network.channels(), "number of input channels"),
        (program.compartments() == network.compartments(), "number of compartments"),
        (found.populations.iter().copied().eq(populations), "list of populations"),
        (network.populations().iter().all(|p| carries_the_same(network, p, program)), "payload of a population"),
        (found.output == meant.output, "output population"),
        (found.semantics == meant.semantics, "semantics"),
        (found.threshold == meant.threshold, "threshold test"),
        (found.reset == meant.reset, "reset"),
    ];
    match rules.into_iter().find(|(holds, _)| !holds) {
        Some((_, what)) => Err(Difference::Frame(what)),
        None => Ok(()),
    }
}

fn carries_the_same(network: &Quantised, population: &Population, program: &Program) -> bool {
    let first = match population.units {
        Units::Input(first) => first.0,
        Units::Compartments { first, .. } => network.channels() + first.0,
    };
    (first..first + population.shape.len()).all(|source| {
        let graded = program.parts().graded.iter().find(|graded| graded.sources.contains(&source));
        graded.map(|graded| graded.payload) == population.payload
    })
}

fn check_parameters(network: &Quantised, program: &Program) -> Result<(), Difference> {
    for population in network.populations() {
        let Units::Compartments { first, neurons, start_step } = &population.units else { continue };
        for index in 0..population.shape.len() {
            let id = CompartmentId(first.0 + index);
            let meant = Compartment { neuron: neurons.get(index), start_step: *start_step };
            let seat = program.seats()[id];
            let found = program.cores().get(seat.core).and_then(|image| {
                let slot = usize::from(seat.slot);
                (image.ids.get(slot) == Some(&id)).then(|| image.compartments.get(slot))?
            });
            if found != Some(&meant) {
                return Err(Difference::Parameters(id));
            }
        }
    }
    Ok(())
}

fn name_of(units: &Units, index: u32) -> String {
    match units {
        Units::Input(first) => format!("input channel {}", ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => format!("compartment {}", CompartmentId(first.0 + index)),
    }
}

/// D(s) of consecutive sources. Their messages are followed for some neighbouring cores at a time: the lists of a million
/// sources lie all over the memory of tens of thousands of cores.
#[derive(Default)]
struct Decoder {
    /// (core, axon, source within the piece) by range of cores.
    messages: Vec<Vec<(AxonTarget, u16)>>,
    /// Every synapse with its source.
    synapses: Vec<(u16, SynapseCode)>,
    /// Where each source's synapses begin among the decoded, and one more.
    first: Vec<usize>,
    decoded: Vec<SynapseCode>,
    /// R(s) of one source.
    meant: Vec<SynapseCode>,
}

impl Decoder {
    fn decode(&mut self, program: &Program, units: &Units, sources: Range<u32>) {
        self.messages.resize_with(program.cores().len().div_ceil(NEIGHBOURS), Vec::new);
        for (source, index) in (0u16..).zip(sources.clone()) {
            for message in messages_of(program, units, index) {
                self.messages[message.core.index() / NEIGHBOURS].push((*message, source));
            }
        }
        self.synapses.clear();
        self.first.clear();
        self.first.resize(sources.len() + 1, 0);
        for (message, source) in self.messages.iter_mut().flat_map(|messages| messages.drain(..)) {
            let image = &program.cores()[message.core];
            let list = image.inputs.get(usize::from(message.axon)).synapses();
            self.first[usize::from(source) + 1] += list.len();
            self.synapses.extend(list.map(|synapse| {
                let format = image.formats[usize::from(synapse.format)].synapse;
                (source, SynapseCode::new(image.ids[usize::from(synapse.slot)], format, synapse.weight, synapse.delay))
            }));
        }
        for source in 0..sources.len() {
            self.first[source + 1] += self.first[source];
        }
        self.decoded.clear();
        self.decoded.resize(self.synapses.len(), SynapseCode(0));
        for &(source, code) in self.synapses.iter().rev() {
            // Ends move to beginnings.
            let place = &mut self.first[usize::from(source) + 1];
            *place -= 1;
            self.decoded[*place] = code;
        }
        self.first.push(self.synapses.len());
        self.first.remove(0);
        for source in 0..sources.len() as u32 {
            let range = self.of_source(source);
            self.decoded[range].sort_unstable();
        }
    }

    /// Where the synapses of a source of the piece are among the decoded.
    fn of_source(&self, source: u32) -> Range<usize> {
        self.first[source as usize]..self.first[source as usize + 1]
    }
}

/// R(s): the network's synapses, of a part those to what it holds.
fn mean(
    network: &Quantised,
    outgoing: &[&Projection],
    (index, program): (u32, &Program),
    meant: &mut Vec<SynapseCode>,
) {
    let part = program.held_rank().is_some();
    meant.clear();
    for projection in outgoing {
        let Some(first) = network.populations()[projection.target].first_compartment() else { continue };
        let wanted = |target| !part || program.holds(program.seats()[CompartmentId(first.0 + target)].core);
        projection.connectivity.for_each_wanted(index, wanted, |target, weight| {
            let target = CompartmentId(first.0 + target);
            meant.push(SynapseCode::new(target, projection.format, weight, projection.delay));
        });
    }
    meant.sort_unstable();
}
