//! What the first rank tells each other one of a mapping that it has made.
//!
//! Input: a network on its places, dealt out. Output: for each rank words ([`Parcel`]) from which
//! it makes what it holds of the program: the network with the synapses that end on its
//! compartments ([`mod@network`]), the compartments of every core, what each core uses, its site
//! and its rank. A rank writes the tables of its own cores from them, verifies and checks them as
//! any other.
//!
//! Invariants: the part that a rank makes is that of the whole program. No rank but the first reads
//! weights, partitions, places or deals, or holds synapses that end elsewhere, but for seeds,
//! kernels, and weights of all to all where these are shorter.
//!
//! Why the first rank reads everything: the scale of weights, their exponents and what is said of
//! their rounding are of whole projections, and where a compartment goes depends on all that
//! reaches it.
//!
//! Errors: [`CompileError::Fault`] for words that are no parcel; [`CompileError::DoesNotFit`] where
//! the first rank has said so.

pub mod network;
pub mod words;

use crate::mapping::Compiled;
use crate::parcel::network::Wanted;
use crate::parcel::words::{Damaged, Reader, Writer};
use crate::place;
use crate::stages::{Placed, PlacedPart};
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec};
use nsim_ir::dealt::{Dealt, Share};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::placement::{Mesh, Placement, Site};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{PerResource, Resource};
use nsim_partition::error::{CompileError, Result};
use nsim_partition::form::Form;
use nsim_partition::options::Options;
use nsim_partition::strategy::members::Members;
use nsim_quantise::copies::copies;

/// Begins every parcel; another layout of the words begins otherwise.
const MAGIC: u32 = 0x6e73_0001;
const PLACEMENTS: [&str; 3] = [place::SEQUENTIAL, place::ANNEALED, place::SAVED];
const FORMS: [Form; 2] = [Form::Written, Form::Symbolic];
/// Compartments that follow each other from which on a core's are told as runs.
const RUN: usize = 3;

/// What a rank is told where there is no mapping, because the network does not fit.
#[must_use]
pub fn refusal() -> Vec<u32> {
    vec![MAGIC, 0]
}

/// What ranks are told of a mapping.
#[derive(Debug)]
pub struct Parcel<'a> {
    placed: &'a Placed,
    form: Form,
    dealt: &'a Dealt,
    /// What all of them are told alike: how copies are made, and where compartments are.
    common: Vec<u32>,
}

impl<'a> Parcel<'a> {
    /// Of a network of so many copies on its places, dealt out; `note` is passed on.
    #[must_use]
    pub fn new(placed: &'a Placed, copies: u32, dealt: &'a Dealt, note: Option<&str>) -> Self {
        let mut words = Writer::default();
        if let Some(note) = words.is_some(note) {
            words.text(note);
        }
        let form = placed.form();
        words.put(FORMS.iter().position(|one| *one == form).unwrap_or(FORMS.len()) as u32);
        words.put(PLACEMENTS.iter().position(|name| *name == placed.name).unwrap_or(PLACEMENTS.len()) as u32);
        words.put(copies);
        let partition = &placed.partitioned.partition;
        words.wide(partition.cores() as u64);
        for (core, held) in partition.members().enumerate() {
            let Site { chip, x, y, core: on_tile } = placed.placement.site(core);
            words.list(&[chip, x, y, on_tile, dealt.owners[core]]);
            let used = partition.usage()[core];
            words.wide(used.synapses);
            Resource::ALL.iter().for_each(|&resource| words.wide(used[resource]));
            members(held, &mut words);
        }
        Parcel { placed, form, dealt, common: words.into_words() }
    }

    /// What a rank is told.
    #[must_use]
    pub fn of_rank(&self, rank: u32) -> Vec<u32> {
        let Placed { partitioned, .. } = self.placed;
        let one = partitioned.one();
        let mut own = vec![false; one.compartments() as usize];
        for (core, held) in partitioned.partition.members().enumerate() {
            if self.dealt.owners[core] == rank {
                held.iter().for_each(|id| own[(id.0 % one.compartments()) as usize] = true);
            }
        }
        let mut words = Writer::default();
        words.put(MAGIC);
        words.put(1);
        words.list(&self.common);
        // Kernels, which networks mapped by them consist of, are short.
        let wanted = if self.form == Form::Written { Wanted::To(&own) } else { Wanted::All };
        network::write(one, wanted, &mut words);
        words.into_words()
    }
}

/// Writes a core's compartments, as runs where most follow each other.
fn members(held: &[CompartmentId], words: &mut Writer) {
    let runs = || held.chunk_by(|a, b| a.0 + 1 == b.0);
    let in_runs = runs().count() * RUN <= held.len();
    words.put(in_runs.into());
    match in_runs {
        true => words.list(&runs().flat_map(|run| [run[0].0, run.len() as u32]).collect::<Vec<_>>()),
        false => words.list(&held.iter().map(|id| id.0).collect::<Vec<_>>()),
    }
}

/// Reads a core's compartments, of so many that there are.
fn read_members(words: &mut Reader<'_>, compartments: u32) -> Result<Vec<CompartmentId>, Damaged> {
    if !words.is_some()? {
        return Ok(words.list()?.iter().copied().map(CompartmentId).collect());
    }
    let mut held = Vec::new();
    for run in words.list()?.chunks(2) {
        let [first, length] = *run else { return Err(Damaged) };
        let end = first.checked_add(length).filter(|&end| end <= compartments).ok_or(Damaged)?;
        held.extend((first..end).map(CompartmentId));
        if held.len() > compartments as usize {
            return Err(Damaged);
        }
    }
    Ok(held)
}

/// What another rank than the first has made of its parcel.
#[derive(Debug)]
pub struct Opened {
    /// Its part of the program; the network with it has no projections.
    pub compiled: Compiled,
    /// What was passed on.
    pub note: Option<String>,
}

/// The part of a program that a rank has been told of, verified and checked.
///
/// # Errors
/// [`CompileError::DoesNotFit`], without reasons, where the first rank has found that;
/// [`CompileError::Fault`].
pub fn open(words: Vec<u32>, target: &Target, options: &Options) -> Result<Opened> {
    let (part, note) = read(&words, target, options.share)?;
    // Writing tables is what takes most memory.
    drop(words);
    let options = &Options { copies: part.copies(), ..*options };
    let target = &*part.form.counted_on(&part.one, target);
    Ok(Opened { compiled: part.compiled(target, options)?, note })
}

/// What a rank has been told of.
fn read(words: &[u32], target: &Target, share: Share) -> Result<(PlacedPart, Option<String>)> {
    let mut words = Reader::new(words);
    if words.take()? != MAGIC {
        return Err(Damaged.into());
    }
    if !words.is_some()? {
        return Err(CompileError::DoesNotFit(Vec::new()));
    }
    let (common, one) = (words.list()?, network::read(&mut words)?);
    words.end()?;
    let mut words = Reader::new(common);
    let note = if words.is_some()? { Some(words.text()?) } else { None };
    let (form, name, number) = (words.one_of(&FORMS)?, words.one_of(&PLACEMENTS)?, words.take()?);
    let target = &*form.counted_on(&one, target);
    let all = copies(&one, number).map_err(CompileError::fault)?;
    let (partition, placement, dealt) = read_places(&mut words, &all, target, share)?;
    words.end()?;
    Ok((PlacedPart { one, all, partition, placement, dealt, name, form }, note))
}

/// Compartments on cores, cores on the board, and the rank of each.
fn read_places(
    words: &mut Reader<'_>,
    all: &Quantised,
    target: &Target,
    share: Share,
) -> Result<(Partition, Placement, Dealt)> {
    let mut members: Members = IdVec::new();
    let mut usage: IdVec<CoreId, CoreUsage> = IdVec::new();
    let mut sites: IdVec<CoreId, Site> = IdVec::new();
    let mut owners: IdVec<CoreId, u32> = IdVec::new();
    for _ in 0..words.length()? {
        let [chip, x, y, core, owner] = *words.list()? else { return Err(Damaged.into()) };
        sites.push(Site { chip, x, y, core });
        owners.push(owner);
        let mut used = CoreUsage { synapses: words.wide()?, of: PerResource::from_fn(|_| 0) };
        for resource in Resource::ALL {
            used[resource] = words.wide()?;
        }
        usage.push(used);
        members.push(read_members(words, all.compartments())?);
    }
    let cores = members.len();
    let partition = Partition::new(all.compartments(), members, usage, target.limits()).map_err(CompileError::fault)?;
    let placement = Placement::new(Mesh::for_target(target), sites).map_err(CompileError::fault)?;
    let dealt = Dealt { ranks: share.ranks, owners: owners.into(), held: Some(share.rank) };
    if !dealt.is_of(cores) {
        return Err(Damaged.into());
    }
    Ok((partition, placement, dealt))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{DEFAULT_RATE, Front, place};
    use nsim_ir::base::rng;
    use nsim_ir::firing_rates::Rates;
    use nsim_ir::quantised::Parts;
    use nsim_testing::{limits, random_network, target};

    fn placed(seed: u64, copies: u32) -> (Placed, Target, Options) {
        let board = target(4, 2, limits().with(Resource::Compartments, 6 + seed as u32 % 40));
        let share = Share { rank: 0, ranks: 2 + seed as u32 % 3, whole: seed.is_multiple_of(2) };
        let options = Options { copies, share, ..Options::default() };
        let front = Front::from(random_network(seed));
        let placed = place(front, &board, &options, &Rates::assumed(DEFAULT_RATE), Form::Written).unwrap();
        (placed, board, options)
    }

    #[test]
    fn a_rank_makes_of_its_parcel_what_it_holds_of_the_program() {
        let (mut fewer, mut of_several) = (0, 0);
        for seed in 0..60 {
            let (placed, board, options) = placed(seed, 1 + seed as u32 % 4 / 3 * 2);
            let whole = Share { whole: true, ..options.share };
            let dealt = placed.dealt(whole).unwrap();
            let parcel = Parcel::new(&placed, options.copies, &dealt, Some("note"));
            let of_options = Options { share: whole, ..options };
            let compiled = placed.clone().compiled(&board, &of_options, Some(dealt.clone())).unwrap();
            for rank in 1..options.share.ranks {
                let words = parcel.of_rank(rank);
                let share = Share { rank, whole: false, ..options.share };
                let own = Options { share, ..Options::default() };
                let opened = open(words.clone(), &board, &own).unwrap();
                assert_eq!(*opened.compiled.program, compiled.program.part(rank).unwrap(), "seed {seed}, rank {rank}");
                assert_eq!(opened.note.as_deref(), Some("note"));
                assert_eq!(opened.compiled.options.copies, options.copies);
                assert_eq!(opened.compiled.quantised.compartments(), compiled.quantised.compartments());
                let mut all = Writer::default();
                network::write(&compiled.one, Wanted::All, &mut all);
                fewer += usize::from(words.len() - parcel.common.len() < all.into_words().len());
                for at in 0..6 {
                    let mut damaged = words.clone();
                    let word = rng::below(words.len() as u64, seed, u64::from(rank), at) as usize;
                    match at % 2 {
                        0 => damaged.truncate(word),
                        _ => damaged.push(0),
                    }
                    assert!(open(damaged, &board, &own).is_err(), "seed {seed}: {at}");
                }
                of_several += 1;
            }
        }
        assert!(fewer > of_several / 3, "{fewer} of {of_several} parcels are shorter than the network");
        let refused = open(refusal(), &target(1, 1, limits()), &Options::default());
        assert!(matches!(refused, Err(CompileError::DoesNotFit(reasons)) if reasons.is_empty()));
    }

    #[test]
    fn networks_are_written_and_read_whole() {
        for seed in 0..60 {
            let network = random_network(seed);
            let mut words = Writer::default();
            network::write(&network, Wanted::All, &mut words);
            let words = words.into_words();
            let read = network::read(&mut Reader::new(&words)).unwrap();
            assert_eq!(read.projections(), network.projections(), "seed {seed}");
            assert_eq!(format!("{:?}", read.populations()), format!("{:?}", network.populations()), "seed {seed}");
            let frame = |network: &Quantised| {
                let parts = network.parts();
                let Parts { output, decision, drain, semantics, threshold, reset, gathers, timestep_ms, .. } = *parts;
                (output, decision, drain, semantics, threshold, reset, gathers, timestep_ms)
            };
            assert_eq!(frame(&read), frame(&network));
            // Whatever words say, reading them ends and allocates no more than there is.
            for at in 0..20 {
                let mut damaged = words.clone();
                let word = rng::below(words.len() as u64, seed, at, 1) as usize;
                damaged[word] ^= 1 << (at % 32);
                let _ = network::read(&mut Reader::new(&damaged));
            }
        }
    }
}
