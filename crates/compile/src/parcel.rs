//! What the first rank sends each other one of a mapping that it has made.
//!
//! Input: a network on its places, assigned to ranks. Output: for each rank bytes (a [`Parcel`])
//! from which it makes what it holds of the program: the network with the synapses that end on its
//! compartments, the compartments of every core, what each core uses, its site and its rank. A rank
//! writes the tables of its own cores from them, verifies and checks them as any other.
//!
//! What is sent of a projection:
//!
//! | | |
//! |---|---|
//! | kernel, seed | all of it: a few numbers |
//! | list of synapses | those that end on the compartments |
//! | all to all | as such, or as the list of those that end on the compartments, if shorter |
//!
//! Invariants: the part that a rank makes is that of the whole program. No rank but the first reads
//! weights, partitions, places or assigns cores.
//!
//! Why the first rank reads everything: the scale of weights, their exponents and what is said of
//! their rounding are of whole projections, and where a compartment goes depends on all that
//! reaches it.
//!
//! Errors: [`CompileError::Fault`] for bytes that are no parcel; [`CompileError::DoesNotFit`] where
//! the first rank has said so.

use crate::mapping::Mapping;
use crate::place;
use crate::stages::{Partitioned, Placed};
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::id::{CoreId, IdVec};
use nsim_ir::dealt::{Dealt, Share};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Parts, Pruned, Quantised, Units};
use nsim_partition::error::{CompileError, Result};
use nsim_partition::form::Form;
use nsim_partition::options::Options;
use nsim_partition::strategy::boxes::Lattices;
use nsim_partition::strategy::members::Members;
use nsim_quantise::copies::copies;
use serde::Serialize;

/// Begins every parcel; another layout of the bytes begins otherwise.
const MAGIC: u32 = 0x6e73_0003;
const PLACEMENTS: [&str; 3] = [place::SEQUENTIAL, place::ANNEALED, place::SAVED];

/// Where a synapse of a list takes as much as two weights of an all-to-all projection and more, the
/// part of the targets from which on the latter is shorter.
const LISTED_COSTS: usize = 3;

/// What a parcel says besides the network: a note, where layers are cut, which of [`PLACEMENTS`],
/// the number of copies; by core its compartments, what it uses, its site and its rank.
type Places = (
    Option<String>,
    Option<Lattices>,
    u32,
    u32,
    Members,
    IdVec<CoreId, CoreUsage>,
    IdVec<CoreId, Site>,
    IdVec<CoreId, u32>,
);

fn bytes(parcel: &impl Serialize) -> Result<Vec<u8>> {
    postcard::to_stdvec(parcel).map_err(CompileError::fault)
}

/// The parcel where there is no mapping, because the network does not fit.
///
/// # Errors
/// None that is known.
pub fn refusal() -> Result<Vec<u8>> {
    bytes(&(MAGIC, None::<()>))
}

/// A mapping to be sent to other ranks.
#[derive(Debug)]
pub struct Parcel<'a> {
    /// The network on its places.
    pub placed: &'a Placed,
    /// Copies of the network.
    pub copies: u32,
    /// Which rank runs which cores.
    pub dealt: &'a Dealt,
    /// What is passed on with it.
    pub note: Option<&'a str>,
}

impl Parcel<'_> {
    /// What is sent to a rank.
    ///
    /// # Errors
    /// None that is known.
    pub fn of_rank(&self, rank: u32) -> Result<Vec<u8>> {
        let Placed { partitioned, placement, .. } = self.placed;
        let (one, partition) = (partitioned.one(), &partitioned.partition);
        let mut own = vec![false; one.compartments() as usize];
        for (core, members) in partition.members().enumerate() {
            if self.dealt.owners[core] == rank {
                members.iter().for_each(|id| own[(id.0 % one.compartments()) as usize] = true);
            }
        }
        let lattices = &partitioned.lattices;
        let name = PLACEMENTS.iter().position(|name| *name == self.placed.name).unwrap_or(PLACEMENTS.len()) as u32;
        let (members, usage) = (partition.members(), partition.usage());
        let places = (self.note, lattices, name, self.copies, members, usage, placement.sites(), &*self.dealt.owners);
        // Kernels, which networks mapped by them consist of, are short.
        bytes(&(MAGIC, Some((places, sent(one, lattices.is_none().then_some(&own))))))
    }
}

/// What is sent of a network, as its text form has it: with the synapses that end on these
/// compartments, or all.
fn sent(network: &Quantised, own: Option<&Vec<bool>>) -> (Parts, Option<Pruned>) {
    let mut parts = network.parts().clone();
    parts.notes.clear();
    let Parts { populations, projections, gathers, .. } = &mut parts;
    for projection in projections.iter_mut() {
        let target = &populations[projection.target];
        if let (Some(own), Units::Compartments { first, .. }) = (own, &target.units) {
            let own = &own[first.0 as usize..(first.0 + target.shape.len()) as usize];
            let some = own.iter().filter(|own| **own).count();
            let listed = match &projection.connectivity {
                Connectivity::Sparse { .. } => some < own.len(),
                // Which projections are all to all decides which sources are gathered.
                Connectivity::Dense { .. } => !*gathers && some * LISTED_COSTS < own.len(),
                _ => false,
            };
            if listed {
                let sources = populations[projection.source].shape.len();
                projection.connectivity = list(&projection.connectivity, sources, own);
            }
        }
    }
    let record = network.pruned().map(|pruned| {
        let mut record = Pruned::clone(pruned);
        record.original = record.original.without_projections();
        record.rows.clear();
        record
    });
    (parts, record)
}

/// The synapses to some compartments, one by one.
fn list(connectivity: &Connectivity, sources: u32, own: &[bool]) -> Connectivity {
    let (mut first, mut targets, mut weights) = (vec![0], Vec::new(), Vec::new());
    for source in 0..sources {
        connectivity.for_each_from(source, |target, weight| {
            if own[target as usize] {
                targets.push(target);
                weights.push(weight);
            }
        });
        first.push(targets.len() as u64);
    }
    Connectivity::Sparse { first: first.into(), targets: targets.into(), weights: weights.into() }
}

/// What another rank than the first has made of its parcel.
#[derive(Debug)]
pub struct Opened {
    /// Its part of the program; the network with it has no projections.
    pub compiled: Mapping,
    /// What was passed on.
    pub note: Option<String>,
}

/// The part of a program that a rank has been sent, verified and checked.
///
/// # Errors
/// [`CompileError::DoesNotFit`], without reasons, where the first rank has found that;
/// [`CompileError::Fault`].
pub fn open(parcel: Vec<u8>, target: &Target, options: &Options) -> Result<Opened> {
    let (placed, dealt, note) = read(&parcel, target, options.share)?;
    // Writing tables is what takes most memory.
    drop(parcel);
    let Partitioned { all, .. } = &placed.partitioned;
    let copies = (all.populations().len() / placed.partitioned.one().populations().len().max(1)) as u32;
    let mapping = placed.emit_dealt(target, &Options { copies, ..*options }, Some(dealt))?.check(target)?;
    let (one, quantised) = (mapping.one.without_projections(), mapping.quantised.without_projections());
    Ok(Opened { compiled: Mapping { one, quantised, ..mapping }, note })
}

/// What a rank has been sent.
fn read(parcel: &[u8], target: &Target, share: Share) -> Result<(Placed, Dealt, Option<String>)> {
    let damaged = || CompileError::fault("what another rank sent is damaged");
    let (magic, rest) = postcard::take_from_bytes::<u32>(parcel).map_err(|_| damaged())?;
    if magic != MAGIC {
        return Err(damaged());
    }
    let read = postcard::take_from_bytes::<Option<(Places, Quantised)>>(rest);
    let (sent, []) = read.map_err(CompileError::fault)? else { return Err(damaged()) };
    let (places, one) = sent.ok_or_else(|| CompileError::DoesNotFit(Vec::new()))?;
    let (note, lattices, name, number, members, usage, sites, owners) = places;
    let name = PLACEMENTS.get(name as usize).copied().ok_or_else(damaged)?;
    let form = if lattices.is_some() { Form::Symbolic } else { Form::Written };
    let target = &*form.counted_on(&one, target);
    let all = copies(&one, number).map_err(CompileError::fault)?;
    let partition = Partition::new(all.compartments(), members, usage, target.limits()).map_err(CompileError::fault)?;
    let placement = Placement::new(Mesh::for_target(target), sites).map_err(CompileError::fault)?;
    let dealt = Dealt { ranks: share.ranks, owners: owners.into(), held: Some(share.rank) };
    if placement.len() != partition.cores() || !dealt.is_of(partition.cores()) {
        return Err(damaged());
    }
    Ok((Partitioned::placed((one, all), lattices, (partition, placement), name), dealt, note))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEFAULT_RATE, Front, place};
    use nsim_ir::base::rng;
    use nsim_ir::firing_rates::Rates;
    use nsim_ir::resource::Resource;
    use nsim_testing::{limits, random_network, target};

    fn placed(seed: u64, copies: u32) -> (Placed, Target, Options) {
        let board = target(4, 2, limits().with(Resource::Compartments, 6 + seed as u32 % 40));
        let share = Share { rank: 0, ranks: 2 + seed as u32 % 3, whole: seed.is_multiple_of(2) };
        let options = Options { copies, share, ..Options::default() };
        let front = Front::from(random_network(seed));
        let placed = place(front, &board, &options, &Rates::assumed(DEFAULT_RATE)).unwrap();
        (placed, board, options)
    }

    #[test]
    fn a_rank_makes_of_its_parcel_what_it_holds_of_the_program() {
        let (mut fewer, mut of_several) = (0, 0);
        for seed in 0..60 {
            let (placed, board, options) = placed(seed, 1 + seed as u32 % 4 / 3 * 2);
            let whole = Share { whole: true, ..options.share };
            let dealt = placed.dealt(whole).unwrap();
            let parcel = Parcel { placed: &placed, copies: options.copies, dealt: &dealt, note: Some("note") };
            let of_options = Options { share: whole, ..options };
            let compiled = placed.clone().emit_dealt(&board, &of_options, Some(dealt.clone())).unwrap();
            let compiled = compiled.check(&board).unwrap();
            let everything = bytes(&sent(&compiled.one, None)).unwrap().len();
            for rank in 1..options.share.ranks {
                let sent = parcel.of_rank(rank).unwrap();
                let share = Share { rank, whole: false, ..options.share };
                let own = Options { share, ..Options::default() };
                let opened = open(sent.clone(), &board, &own).unwrap();
                assert_eq!(*opened.compiled.program, compiled.program.part(rank).unwrap(), "seed {seed}, rank {rank}");
                assert_eq!(opened.note.as_deref(), Some("note"));
                assert_eq!(opened.compiled.options.copies, options.copies);
                assert_eq!(opened.compiled.quantised.compartments(), compiled.quantised.compartments());
                let (part, ..) = read(&sent, &board, share).unwrap();
                fewer += usize::from(bytes(part.partitioned.one()).unwrap().len() < everything);
                // Reading any bytes ends, and allocates no more than there are.
                for at in 0..20 {
                    let mut damaged = sent.clone();
                    let byte = rng::below(sent.len() as u64, seed, u64::from(rank), at) as usize;
                    match at {
                        0..6 if at % 2 == 0 => damaged.truncate(byte),
                        0..6 => damaged.push(0),
                        _ => damaged[byte] ^= 1 << (at % 8),
                    }
                    let read = read(&damaged, &board, share);
                    assert!(at >= 6 || read.is_err(), "seed {seed}: {at}");
                }
                of_several += 1;
            }
        }
        assert!(fewer > of_several / 3, "{fewer} of {of_several} parcels are shorter than the network");
        let refused = open(refusal().unwrap(), &target(1, 1, limits()), &Options::default());
        assert!(matches!(refused, Err(CompileError::DoesNotFit(reasons)) if reasons.is_empty()));
    }

    #[test]
    fn networks_are_sent_whole() {
        for seed in 0..60 {
            let network = random_network(seed);
            let read: Quantised = postcard::from_bytes(&bytes(&sent(&network, None)).unwrap()).unwrap();
            assert_eq!(read, network, "seed {seed}");
        }
    }
}
