//! Assignment of compartments to logical cores.
//!
//! Input: a quantised network. Output: a [`Partition`] in which every core keeps every limit, or
//! every reason for which there is none. Every strategy fills cores in an order of compartments
//! ([`order`]), so that limits hold exactly and cores are full. Strategies differ in that order and
//! in later steps:
//!
//! - `Sequential`: the order of the model file, as the public tools assign cores (nengo-loihi,
//!   NxTF).
//! - `Greedy`: populations over space in tiles ([`tiles`]); all others by growth, each compartment
//!   next to compartments that it is connected to ([`levels::grown`]).
//! - `Greedy` and `Multilevel`: where every synapse is listed, compartments that share sources on
//!   one core ([`sharing`]).
//! - `Multilevel`: tiles; all others in the order of a hierarchy of groups ([`levels`]), and then
//!   groups of every size, the largest first, are moved between cores while that saves messages
//!   ([`refine`]).
//!
//! A strategy also tries the ones above it and keeps the best: fewest cores, then fewest messages.
//! `Multilevel` skips mappings whose steps are too long for the cores that they save. Otherwise no
//! strategy is worse than the one above. Where neurons have several compartments, all use the order
//! of the file, neuron by neuron. Copies of a network are one copy's partition repeated, so that no
//! copy shares a core with another, unless filling all of them together takes fewer cores.
//!
//! A user may state the compartments of a core ([`Search::stated`]).

pub mod box_fan_out;
pub mod boxes;
pub mod copies;
pub mod hyper;
pub mod lattice;
pub mod levels;
pub mod members;
pub mod order;
pub mod refine;
pub mod sharing;
pub mod structure;
pub mod tiles;

use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::time::Instant;

use crate::error::{CompileError, Result};
use crate::options::{Objective, Options, Strategy, is_over};
use crate::reason::{Reason, Tightest};
use crate::resources::axon_sharing::Places;
use crate::resources::even_draws;
use crate::resources::exact::{Usages, usage, uses, with_fan_out};
use crate::resources::fan_out::{cores_of, messages, slots_of_core};
use crate::resources::incremental::Filling;
use crate::resources::packing::MOST_SLOTS;
use crate::resources::receptive_field::WindowAxis;
use crate::strategy::copies::CopyGroups;
use crate::strategy::hyper::{Groups, Hypergraph, State};
use crate::strategy::levels::Levels;
use crate::strategy::members::{Members, row_of_chips};
use crate::strategy::order::{Chips, FilledCores, Filler, Indices, Segment, file_order};
use crate::strategy::tiles::{Rank, cell, is_spatial, to_and_fro};
use nsim_cost::constants::CostTable;
use nsim_cost::model::core_time;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::activity::CoreCounts;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{CompartmentId, CoreId, Id, IdVec, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::{RATE_STEPS, Rates};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{Partition, PartitionError, seats};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{Capacity, Limits, Resource};

/// Whether each population is over space.
type Spatial = IdVec<PopulationId, bool>;

/// Options of the search for a partition.
#[derive(Debug, Clone, Copy)]
pub struct Search<'a> {
    /// Strategy that groups compartments into cores.
    pub strategy: Strategy,
    /// Firing rates of the sources of one copy.
    pub rates: &'a Rates,
    /// Effort in units of work, about 5 ns each; for an effort in seconds, equal on every machine.
    pub work: u64,
    /// Time at which the search ends in any case.
    pub end: Option<Instant>,
    /// Number of copies to be mapped.
    pub copies: u32,
    /// Most synapses of a core, respected by tiles.
    pub most_synapses: Option<u64>,
    /// Whether to warn that cores were saved at the price of longer steps.
    pub explains: bool,
    /// Compartments of a core that the user states, by population; empty where nsim decides.
    pub stated: &'a [(PopulationId, u32)],
}

impl<'a> Search<'a> {
    /// Returns the search for these options, with these firing rates.
    pub fn new(options: &Options, rates: &'a Rates) -> Self {
        let (work, end) = (options.effort.work(WORK_PER_SECOND), options.effort.end());
        let explains = options.objective == Objective::Cores && work > 0;
        let Options { strategy, copies, most_synapses, .. } = *options;
        Search { strategy, rates, work, end, copies, most_synapses, explains, stated: &[] }
    }
}

/// Approximate units of work in a second; fixed, so that an effort is the same on every machine.
const WORK_PER_SECOND: u64 = 200_000_000;
/// Units of work a synapse when a hypergraph is built and coarsened, level after level.
const WORK_PER_SYNAPSE: u64 = 60;
/// Number of synapses from which a network with uniform connectivity is not grouped by levels.
const EVEN_SYNAPSES: u64 = 1 << 18;
/// The order of the file is given up at this multiple of the cores of tiles: it is no alternative
/// then, and its output axons take many rounds.
const MOST_TIMES_TILES: usize = 8;
/// Longest step relative to the order of the file, to be multiplied by the ratio of cores saved.
const MOST_LONGER: f64 = 1.1;
/// Most synapses of a network whose tiles are also tried with fewer words.
const FEW_SYNAPSES: u64 = 1 << 23;
/// Most compartments of a network of which a copy is mapped to find all reasons against it.
const FEW_COMPARTMENTS: u64 = 1 << 17;
/// Spikes of a busy step, relative to the mean, at which networks over space are compared too.
const BURST: u64 = 10;
/// Most rounds that make tiles smaller because their output axons do not fit.
const TILE_ROUNDS: usize = 6;
/// Percentages of the synapse words that refinement may use, in the order of trial: words are
/// estimates there.
const WORD_MARGINS: [i64; 2] = [100, 85];
/// A network of n synapses is refined from perturbed members this number / n times more.
const SHAKEN_SYNAPSES: u64 = 2_000;
/// Most refinements from perturbed members.
const MOST_SHAKES: u64 = 16;
/// Seed of the perturbations.
const SHAKE_SEED: u64 = 0x5ba4e;

/// Refuses a network that cannot fit by its sizes alone, before anything large is built; adds the
/// reasons of a single copy, if any.
///
/// # Errors
/// [`CompileError::DoesNotFit`].
pub fn within_bounds(one: &Quantised, target: &Target, copies: u32, in_boxes: bool, search: Search<'_>) -> Result<()> {
    let (limits, compartments) = (target.limits(), u64::from(one.compartments()));
    let (all, room) =
        (compartments * u64::from(copies), u64::from(target.cores()) * u64::from(limits[Resource::Compartments]));
    let few = compartments <= FEW_COMPARTMENTS;
    let too_many = (all > room).then(|| Reason::of_compartments(target, limits, copies, all));
    let bound = too_many.or_else(|| {
        let cores = least_cores(one, copies, limits);
        // A single copy that is mapped quickly gives better reasons than a bound.
        (cores > u64::from(target.cores()) && (copies > 1 || !few)).then(|| Reason::of_cores(target, copies, cores))
    });
    if in_boxes {
        return bound.map_or(Ok(()), |reason| Err(reason.into()));
    }
    // The needs of a compartment are found by mapping one copy, unless that would take long.
    let quick = few && (one.synapses() <= FEW_SYNAPSES || bound.is_some() && compartments <= room);
    let mut reasons = bound.map_or_else(|| even_draws::reasons(one, target, copies, false), |bound| vec![bound]);
    if reasons.is_empty() {
        return Ok(());
    }
    let search = Search { work: 0, explains: false, ..search };
    if quick && let Err(CompileError::DoesNotFit(more)) = partition(one, one, target, search) {
        let more = more.into_iter().filter(|reason| reason.resource != Capacity::Cores);
        let same = |a: &Reason, b: &Reason| (&a.population, &a.resource) == (&b.population, &b.resource);
        for reason in more {
            if !reasons.iter().any(|known| same(known, &reason)) {
                reasons.push(reason);
            }
        }
    }
    Err(CompileError::DoesNotFit(reasons))
}

/// Returns a partition of a network of equal copies; `one` is a single copy and `all` is all of
/// them, copy after copy.
///
/// # Errors
/// [`CompileError`].
pub fn partition(one: &Quantised, all: &Quantised, target: &Target, search: Search<'_>) -> Result<Partition> {
    let copies = (all.compartments() / one.compartments().max(1)).max(1);
    let filler = Filler::new(one, target);
    let filled = match search.stated {
        [] => searched(&filler, search, Chips::Row)?,
        stated => stated_cores(&filler, stated)?,
    };
    if copies > 1 {
        return partition_copies(&filler, filled.members, all, copies, search);
    }
    if filled.members.len() as u64 > u64::from(target.cores()) {
        let cores = filled.members.len() as u64;
        let uses = |all: &Partition| Tightest::of_each(one, target, all.usage().iter().zip(all.members().iter()));
        let of_each = counted(all, filled, target).map_or_else(|_| BTreeMap::new(), |all| uses(&all));
        return Err(Reason::of_mapping(target, copies, cores, of_each).into());
    }
    counted(all, filled, target).map_err(|error| unfit(error, search))
}

/// The cores of a network, of which these populations have stated numbers of compartments. A core
/// has compartments of one stated population, and the last core takes the rest. Populations over
/// space are cut position by position with all their channels: into the fewest equal rectangles of
/// this number of compartments, else into runs of positions. All others have cores of their own.
///
/// # Errors
/// [`DoesNotFit`](crate::error::CompileError::DoesNotFit) when a core has no slots for them, or
/// another population does not fit; [`Input`](crate::error::CompileError::Input) when neurons have
/// several compartments.
fn stated_cores(filler: &Filler<'_>, stated: &[(PopulationId, u32)]) -> Result<FilledCores> {
    let (network, limits) = (filler.network, filler.target.limits());
    if !network.parts().children.is_empty() {
        let message = "--cores-of cannot cut neurons of several compartments";
        return Err(Diagnostic::new("map.cores-of", message).help("remove --cores-of").into());
    }
    let mut members = Members::new();
    for (id, population) in network.populations().enumerate() {
        let (Some(first), Some(&(_, each))) =
            (population.first_compartment(), stated.iter().find(|(stated, _)| *stated == id))
        else {
            continue;
        };
        for held in stated_cut(network, id, each) {
            let most = limits[Resource::Compartments].min(MOST_SLOTS);
            if held.len() as u64 > u64::from(most) {
                let core = CoreId::new(members.len());
                return Err(Reason::of_core(core, Resource::Compartments.into(), held.len() as u64, most.into()).into());
            }
            members.push(held.into_iter().map(|index| CompartmentId(first.0 + index)).collect());
        }
    }
    let is_stated = |id: PopulationId| stated.iter().any(|(stated, _)| *stated == id);
    let spatial: Spatial = network.populations().ids().map(|id| is_spatial(network, id) && !is_stated(id)).collect();
    let tiles =
        if spatial.iter().any(|&is| is) { cut_into_tiles(filler, &spatial, Chips::Row, None) } else { Vec::new() };
    let others = file_order(network).into_iter().filter(|one| !is_stated(one.population) && !spatial[one.population]);
    let order: Vec<_> = tiles.into_iter().chain(others).collect();
    if !order.is_empty() {
        filler.fill_members(&order, true)?.iter().cloned().for_each(|held| _ = members.push(held));
    }
    Ok(uncounted(members))
}

/// Indices of a population's compartments, core by core.
fn stated_cut(network: &Quantised, id: PopulationId, each: u32) -> Vec<Vec<u32>> {
    let shape = network.populations()[id].shape;
    let in_runs = |indices: &[u32], each: u32| -> Vec<Vec<u32>> {
        indices.chunks(each.max(1) as usize).map(<[u32]>::to_vec).collect()
    };
    let Some((channels, height, width)) = shape.volume().filter(|_| is_spatial(network, id)) else {
        return in_runs(&(0..shape.len()).collect::<Vec<_>>(), each);
    };
    let positions = each / channels.max(1);
    let parts = |rows: u32| (height.div_ceil(rows), width.div_ceil(positions / rows));
    let fits = |rows: &u32| positions.is_multiple_of(*rows) && positions / rows <= width;
    let rows = (1..=height.min(positions)).filter(fits).min_by_key(|&rows| parts(rows).0 * parts(rows).1);
    match rows.filter(|_| each.is_multiple_of(channels)) {
        Some(rows) => {
            let (size, (of_rows, of_columns)) = ((channels, rows, positions / rows), parts(rows));
            to_and_fro(1, of_rows, of_columns).map(|at| cell((channels, height, width), size, at, false)).collect()
        }
        None => in_runs(&cell((channels, height, width), (channels, height, width), (0, 0, 0), false), each),
    }
}

/// The reason for which stated cores exceed a limit; cores that nsim filled never do.
fn unfit(error: PartitionError, search: Search<'_>) -> CompileError {
    match error {
        PartitionError::Excess { core, capacity, need, limit } if !search.stated.is_empty() => {
            Reason::of_core(core, capacity, need, limit).into()
        }
        error => CompileError::fault(error),
    }
}

/// Returns a partition of copies of a network, where `members` are the cores of one copy.
fn partition_copies(
    filler: &Filler<'_>,
    members: Members,
    all: &Quantised,
    copies: u32,
    search: Search<'_>,
) -> Result<Partition> {
    let (one, target, limits) = (filler.network, filler.target, filler.target.limits());
    let counted_once = |groups: &CopyGroups| {
        groups.usage(target).ok_or_else(|| CompileError::fault("a group of copies has no seat for each compartment"))
    };
    let fits = |usage: &Usages| usage.iter().all(|used| used.excesses(limits).next().is_none());
    let mut groups = CopyGroups::repeated(one, members, copies);
    let mut usage = counted_once(&groups)?;
    let is_free = search.stated.is_empty();
    if is_free && !fits(&usage) {
        groups = CopyGroups::repeated(one, searched(filler, search, Chips::Apart)?.members, copies);
        usage = counted_once(&groups)?;
    }
    if is_free && groups.cores() as u64 > least_cores(one, copies, limits) {
        let filled = [true, false].map(|keep_whole| CopyGroups::filled(one, copies, target, keep_whole));
        let fewer = filled.into_iter().flatten().min_by_key(|filled| filled.cores);
        if let Some(fewer) = fewer.filter(|fewer| fewer.cores < groups.cores()) {
            let counted_fewer = fewer.groups.map(|fewer| counted_once(&fewer).map(|used| (fewer, used))).transpose()?;
            if let Some(found) = counted_fewer.filter(|(_, used)| fits(used)) {
                (groups, usage) = found;
            } else if let Ok(together) = Filler::new(all, target).fewest_cores(&file_order(all), Chips::Row)
                && together.members.len() < groups.cores()
            {
                // Either output axons do not fit, which depend on the chips of all copies, or cores
                // do not repeat copy by copy.
                let together = counted(all, together, target).map_err(CompileError::fault)?;
                on_board(one, copies, together.members(), together.usage(), target)?;
                return Ok(together);
            }
        }
    }
    let members = groups.members();
    on_board(one, copies, &members, &usage, target)?;
    Partition::new(all.compartments(), members, usage, limits).map_err(|error| unfit(error, search))
}

/// Refuses copies that take more cores than the target has.
fn on_board<M: Borrow<Vec<CompartmentId>>>(
    one: &Quantised,
    copies: u32,
    members: &IdVec<CoreId, M>,
    usage: &Usages,
    target: &Target,
) -> Result<()> {
    let cores = members.len() as u64;
    if cores > u64::from(target.cores()) {
        let of_each = Tightest::of_each(one, target, usage.iter().zip(members));
        return Err(Reason::of_mapping(target, copies, cores, of_each).into());
    }
    Ok(())
}

/// A partition of these members, counted exactly with cores placed chip by chip.
fn counted(network: &Quantised, filled: FilledCores, target: &Target) -> Result<Partition, PartitionError> {
    let FilledCores { members, fan_out, usage: exact_usage } = filled;
    let (seats, limits) = (seats(network.compartments(), &members)?, target.limits());
    let usage = match (fan_out, exact_usage) {
        (None, Some(exact)) => exact,
        (Some(fan_out), Some(exact_usage)) => with_fan_out(exact_usage.iter().copied(), &members, &fan_out),
        (Some(fan_out), None) if fan_out.together.is_empty() => {
            let uses = uses(network, &members, &seats, limits, &Places::for_network(network, limits), |_| true);
            with_fan_out(uses.into_iter().map(|core| core.usage), &members, &fan_out)
        }
        _ => usage(network, &members, &seats, &row_of_chips(members.len(), target), limits),
    };
    Partition::new(network.compartments(), members, usage, limits)
}

/// Input of all candidates: one copy, and what is known of it.
struct CopySearch<'a> {
    filler: &'a Filler<'a>,
    search: Search<'a>,
    chips: Chips,
    /// Whether a population is over space, and so in tiles.
    spatial: Spatial,
    /// Whether a compartment is in a tile.
    fixed: Vec<bool>,
    tile_segments: Vec<Segment>,
    /// Whether every synapse is listed.
    is_listed: bool,
    /// Whether large listed connectivity is sampled uniformly, and so has no groups to find.
    is_uniform: bool,
    /// Number of synapses into populations without tiles.
    free_synapses: u64,
    /// Connectivity of compartments without tiles, where groups may be found within the effort.
    graph: Option<Hypergraph>,
}

/// Output of the candidates.
struct Mappings {
    /// All, beginning with the order of the file where it fits and was not given up.
    all: Vec<FilledCores>,
    /// The mapping in tiles, until it is its turn.
    mapping_in_tiles: Option<Result<FilledCores>>,
    /// Whether the first is in the order of the file.
    has_file_order: bool,
    /// The error of the first that does not fit.
    failure: Option<CompileError>,
    /// Groups of which one mapping has the order, to be refined.
    levels: Option<Levels>,
}

impl Mappings {
    fn keep(&mut self, mapping: Result<FilledCores>) {
        match mapping {
            Ok(mapping) => self.all.push(mapping),
            Err(error) => self.failure = Some(self.failure.take().unwrap_or(error)),
        }
    }

    fn in_file_order(&self) -> Option<&FilledCores> {
        self.all.first().filter(|_| self.has_file_order)
    }
}

/// Adds mappings of one kind, unless they cannot be the best or would take too long.
type Candidate = fn(&CopySearch<'_>, &mut Mappings);

/// What is tried besides the order of the file, with the reason for which it may be the best. Of
/// mappings with equal cores and messages the first is taken, so this order decides ties. Each adds
/// nothing where its reason does not hold or the effort is too small; levels, and so moves, are of
/// [`Strategy::Multilevel`] alone.
const CANDIDATES: [(&str, Candidate); 5] = [
    ("a source that reaches a core already costs no further input axon or message", by_shared_sources),
    ("neighbours over space share most of their sources", in_tiles),
    ("memory that tiles leave free may save a core of later populations", in_tiles_of_fewer_words),
    ("connected compartments on one core send fewer messages", in_groups),
    ("groups that move from the best mapping so far, or from a perturbed one, save messages", with_moved_groups),
];

/// The cores of one copy by a strategy, and by those above it: of all candidates the one with the
/// fewest cores, then the fewest messages. A network on one core and neurons of several
/// compartments are in the order of the file. `chips` is [`Chips::Apart`] where copies follow whose
/// chips are not known; counts are dropped then.
///
/// # Errors
/// [`CompileError::DoesNotFit`] of the first candidate, where none fits.
fn searched(filler: &Filler<'_>, search: Search<'_>, chips: Chips) -> Result<FilledCores> {
    let network = filler.network;
    if search.strategy == Strategy::Sequential || !network.parts().children.is_empty() {
        return filler.fewest_cores(&file_order(network), chips);
    }
    let spatial: Spatial = network.populations().ids().map(|id| is_spatial(network, id)).collect();
    let any_spatial = spatial.iter().any(|&spatial| spatial);
    let tile_segments =
        if any_spatial { cut_into_tiles(filler, &spatial, chips, search.most_synapses) } else { Vec::new() };
    // Filled first, since it bounds the order of the file; it is compared second.
    let mapping_in_tiles = (!tile_segments.is_empty()).then(|| {
        let order: Vec<Segment> = tile_segments.iter().cloned().chain(without_tiles(network, &spatial)).collect();
        filler.fewest_cores(&order, chips)
    });
    let most_cores = match &mapping_in_tiles {
        Some(Ok(mapping)) => mapping.members.len() * MOST_TIMES_TILES,
        _ => usize::MAX,
    };
    let in_file_order = match filler.at_most(most_cores, &file_order(network), chips) {
        Ok(Some(only)) if only.members.len() == 1 => return Ok(only),
        in_file_order => in_file_order,
    };
    let has_file_order = matches!(in_file_order, Ok(Some(_)));
    let copy = CopySearch::new(filler, search, chips, spatial, tile_segments);
    let mut mappings = Mappings { all: Vec::new(), mapping_in_tiles, has_file_order, failure: None, levels: None };
    match in_file_order {
        Ok(given_up_or_filled) => mappings.all.extend(given_up_or_filled),
        Err(error) => mappings.failure = Some(error),
    }
    for (reason, add) in CANDIDATES {
        add(&copy, &mut mappings);
        tracing::trace!(reason, mappings = mappings.all.len(), "candidates");
    }
    if mappings.has_file_order && search.strategy == Strategy::Multilevel {
        no_slower(filler, &mut mappings.all, search, any_spatial);
    }
    let Some(best) = fewest(filler, &mappings.all, search.rates) else {
        return Err(mappings.failure.unwrap_or_else(|| CompileError::fault("no strategy had an answer")));
    };
    let best = mappings.all.swap_remove(best);
    // Compartments in the order of the file make lists denser; refined cores take newcomers at
    // their end.
    let in_order = sort_members(&best.members, &copy.fixed);
    let recounted = if in_order == best.members { None } else { within_limits(network, in_order, filler.target) };
    let best = recounted.unwrap_or(best);
    // Chips that are assumed to be separate are not final, so their counts are dropped.
    Ok(if chips == Chips::Row { best } else { uncounted(best.members) })
}

impl<'a> CopySearch<'a> {
    fn new(
        filler: &'a Filler<'a>,
        search: Search<'a>,
        chips: Chips,
        spatial: Spatial,
        tile_segments: Vec<Segment>,
    ) -> Self {
        let network = filler.network;
        let mut fixed = vec![false; network.compartments() as usize];
        for (_, population) in network.populations().enumerate().filter(|&(id, _)| spatial[id]) {
            let Some(first) = population.first_compartment() else { continue };
            fixed[first.index()..first.index() + population.shape.len() as usize].fill(true);
        }
        let free = network.projections().enumerate().filter(|(_, projection)| !spatial[projection.target]);
        let free_synapses: u64 = free.map(|(id, _)| network.synapses_of(id)).sum();
        let is_listed = !spatial.iter().any(|&spatial| spatial) && sharing::is_listed(network);
        let is_uniform = is_listed && free_synapses >= EVEN_SYNAPSES && structure::is_uniform(network);
        // An effort in seconds is spent even where groups are unlikely.
        let promising = search.end.is_some() || !is_uniform;
        let affordable = promising && free_synapses.saturating_mul(WORK_PER_SYNAPSE) <= search.work;
        let graph = (affordable && fixed.contains(&false)).then(|| Hypergraph::new(network, search.rates, &fixed));
        CopySearch { filler, search, chips, spatial, fixed, tile_segments, is_listed, is_uniform, free_synapses, graph }
    }
}

fn by_shared_sources(copy: &CopySearch<'_>, mappings: &mut Mappings) {
    let &CopySearch { filler, search, chips, is_listed, is_uniform, .. } = copy;
    if let Some(sequential) = mappings.in_file_order().filter(|_| is_listed && search.work > 0) {
        let shared = sharing::shared_outputs(filler, sequential, chips, is_uniform, search.work);
        mappings.all.extend(shared);
    }
}

fn in_tiles(_: &CopySearch<'_>, mappings: &mut Mappings) {
    if let Some(mapping) = mappings.mapping_in_tiles.take() {
        mappings.keep(mapping);
    }
}

/// Tiles with fewer words, for one population at a time.
fn in_tiles_of_fewer_words(copy: &CopySearch<'_>, mappings: &mut Mappings) {
    let (network, limits) = (copy.filler.network, copy.filler.target.limits());
    if copy.search.work == 0 || copy.tile_segments.is_empty() || network.synapses() > FEW_SYNAPSES {
        return;
    }
    let mut filling = Filling::new(network, &copy.filler.fan_in, limits);
    let most = limits[Resource::Compartments];
    for population in network.populations().ids().filter(|&id| copy.spatial[id]) {
        let Some(fewer) = tiles::tiles(network, population, &mut filling, limits, most, Rank::Words) else { continue };
        let mut fewer = Some(fewer);
        let mut order: Vec<Segment> = Vec::new();
        for segment in &copy.tile_segments {
            match segment.population == population {
                true => order.extend(fewer.take().into_iter().flatten()),
                false => order.push(segment.clone()),
            }
        }
        order.extend(without_tiles(network, &copy.spatial));
        mappings.keep(copy.filler.fewest_cores(&order, copy.chips));
    }
}

/// Compartments without tiles, each next to compartments that it is connected to; and in the order
/// of levels of groups.
fn in_groups(copy: &CopySearch<'_>, mappings: &mut Mappings) {
    let &CopySearch { filler, search, ref graph, ref fixed, .. } = copy;
    let Some(graph) = graph else { return };
    let typical =
        mappings.in_file_order().map_or(1, |one| filler.network.compartments() as usize / one.members.len().max(1));
    let filled = |ids: &[u32]| filler.fewest_cores(&with_ids(filler.network, &copy.tile_segments, ids), copy.chips);
    let grown = || filled(&levels::grown(graph, fixed, typical.max(1), search.end));
    let in_levels = || {
        let levels = (search.strategy == Strategy::Multilevel).then(|| Levels::new(graph, fixed, search.end))?;
        let members = filled(&levels.order());
        Some((levels, members))
    };
    let (grown, in_levels) = rayon::join(grown, in_levels);
    mappings.keep(grown);
    if let Some((levels, members)) = in_levels {
        mappings.keep(members);
        mappings.levels = Some(levels);
    }
}

/// Groups of the best mapping so far moved between cores, also from perturbed starts.
fn with_moved_groups(copy: &CopySearch<'_>, mappings: &mut Mappings) {
    let (Some(graph), Some(levels)) = (&copy.graph, mappings.levels.take()) else { return };
    let (filler, rates, all) = (copy.filler, copy.search.rates, &mut mappings.all);
    let (network, target) = (filler.network, filler.target);
    // Making the levels has used a part of the effort.
    let work = copy.search.work.saturating_sub(copy.free_synapses.saturating_mul(WORK_PER_SYNAPSE));
    let mut refiner = Refiner { graph, levels: &levels, target, work, end: copy.search.end };
    if let Some(best) = fewest(filler, all, rates) {
        for percent in WORD_MARGINS {
            let refined = refiner.refined(&all[best].members, percent);
            if let Some(refined) = within_limits(network, refined, target) {
                all.push(refined);
                break;
            }
        }
    }
    for attempt in 0..(SHAKEN_SYNAPSES / copy.free_synapses.max(1)).min(MOST_SHAKES) {
        let Some(best) = fewest(filler, all, rates) else { break };
        let shaken = shaken(&all[best].members, &copy.fixed, attempt);
        let refined = refiner.refined(&shaken, WORD_MARGINS[0]);
        all.extend(within_limits(network, refined, target));
    }
}

/// Removes members whose steps are too long for the cores that they save, compared with the first,
/// the order of the file; where the first fits at all. The length of a step is the time of the
/// busiest core, plus injection of inputs, turn and barrier, which are equal for all members.
fn no_slower(filler: &Filler<'_>, mappings: &mut Vec<FilledCores>, search: Search<'_>, over_space: bool) {
    let first = mappings[0].members.len() as u64;
    let worth_comparing = mappings.iter().any(|one| (one.members.len() as u64) < first);
    if !worth_comparing || first * u64::from(search.copies) > u64::from(filler.target.cores()) {
        return;
    }
    let Some(table) = filler.target.constants().first().and_then(|constants| CostTable::new(constants).ok()) else {
        return;
    };
    let events = filler.fan_in.events_into(filler.network, search.rates);
    let inputs: u64 = (0..filler.network.channels()).map(|channel| search.rates.rate_of(channel)).sum();
    let steps = RATE_STEPS as u64;
    let others_us = (table.turn_time.microseconds() + table.barrier(1, 1).microseconds()) * steps as f64;
    let injection_us = table.injection_time.microseconds() * inputs as f64;
    let length = |members: &Members, times: u64| {
        let of_core = |held: &Vec<CompartmentId>| {
            let events_sparse = held.iter().map(|id| events[id.index()]).sum::<u64>() * times;
            let visited = held.len() as u64 * steps;
            core_time(&CoreCounts { events_sparse, visited, active: visited, ..CoreCounts::default() }, &table)
        };
        let busiest = members.iter().map(of_core).max().unwrap_or_default();
        busiest.microseconds() + injection_us * times as f64 + others_us
    };
    // Tiles group the compartments with the most synapses, which shows in steps of many spikes.
    let bursts = if over_space { &[1, BURST][..] } else { &[1] };
    let least: Vec<f64> = bursts.iter().map(|&times| length(&mappings[0].members, times)).collect();
    let mut longest: f64 = 1.0;
    mappings.retain(|one| {
        let longer = |(&times, least): (&u64, &f64)| length(&one.members, times) / least.max(f64::MIN_POSITIVE);
        let longer = bursts.iter().zip(&least).map(longer).fold(0.0, f64::max);
        let saved = first as f64 / one.members.len().max(1) as f64;
        let is_accepted = longer <= MOST_LONGER * saved.max(1.0);
        longest = if is_accepted { longest.max(longer) } else { longest };
        is_accepted
    });
    if search.explains && longest > MOST_LONGER {
        tracing::warn!(
            "this mapping has fewer cores than the order of the file, but a step may take up to {longest:.2} times as \
             long: nsim map --strategy sequential -o FILE makes a mapping with shorter steps, and --mapping FILE uses \
             it"
        );
    }
}

/// Index of the members with the fewest cores, then the fewest messages; the first of equals.
fn fewest(filler: &Filler<'_>, mappings: &[FilledCores], rates: &Rates) -> Option<usize> {
    let compartments = filler.network.compartments();
    let cores = mappings.iter().map(|one| one.members.len()).min()?;
    let mut of_these = (0..mappings.len()).filter(|&one| mappings[one].members.len() == cores);
    if mappings.len() == 1 {
        return of_these.next();
    }
    of_these.min_by_key(|&one| messages(filler.network, &cores_of(compartments, &mappings[one].members), cores, rates))
}

/// Members with the exact resource use of each core, with cores placed chip by chip; none where a
/// core exceeds a limit.
fn within_limits(network: &Quantised, members: Members, target: &Target) -> Option<FilledCores> {
    let partition = counted(network, uncounted(members.clone()), target).ok()?;
    Some(FilledCores { members, fan_out: None, usage: Some(partition.usage().clone()) })
}

/// Members without counts.
fn uncounted(members: Members) -> FilledCores {
    FilledCores { members, fan_out: None, usage: None }
}

/// Members after random swaps of compartments between cores, as another start of refinement.
fn shaken(members: &Members, fixed: &[bool], attempt: u64) -> Members {
    let mut shaken = members.clone();
    let all: usize = members.iter().map(Vec::len).sum();
    for change in 0..(all as u64 / 6).max(2) {
        let draw = |k: u64, n: usize| rng::below(n.max(1) as u64, SHAKE_SEED ^ attempt, change, k) as usize;
        let (a, b) = (CoreId::new(draw(0, members.len())), CoreId::new(draw(1, members.len())));
        let (i, j) = (draw(2, shaken[a].len()), draw(3, shaken[b].len()));
        let (Some(&one), Some(&other)) = (shaken[a].get(i), shaken[b].get(j)) else { continue };
        if a != b && !fixed[one.index()] && !fixed[other.index()] {
            (shaken[a][i], shaken[b][j]) = (other, one);
        }
    }
    shaken
}

/// Members in the order of the file, on cores that hold no tile.
fn sort_members(members: &Members, fixed: &[bool]) -> Members {
    let sort = |held: &Vec<CompartmentId>| {
        let mut held = held.clone();
        if !held.iter().any(|id| fixed[id.index()]) {
            held.sort_unstable();
        }
        held
    };
    members.iter().map(sort).collect()
}

/// Populations over space as tiles, smaller where their output axons would not fit.
fn cut_into_tiles(filler: &Filler<'_>, spatial: &Spatial, chips: Chips, most_synapses: Option<u64>) -> Vec<Segment> {
    let (network, limits) = (filler.network, filler.target.limits());
    let mut filling = Filling::new(network, &filler.fan_in, limits);
    let mut most = tiles::most_compartments(network, limits, most_synapses);
    let mut cut: IdVec<PopulationId, Option<Vec<Segment>>> = vec![None; spatial.len()].into();
    let mut segments = Vec::new();
    for _ in 0..TILE_ROUNDS {
        segments.clear();
        for population in network.populations().ids().filter(|&id| spatial[id]) {
            if cut[population].is_none() {
                let all = Indices::All(network.populations()[population].shape.len());
                let most = most[population];
                let tiles = tiles::tiles(network, population, &mut filling, limits, most, Rank::Messages);
                cut[population] = Some(tiles.unwrap_or_else(|| vec![Segment { population, indices: all }]));
            }
            segments.extend(cut[population].iter().flatten().cloned());
        }
        let order: Vec<Segment> = segments.iter().cloned().chain(without_tiles(network, spatial)).collect();
        let Ok(members) = filler.fill_members(&order, true) else { break };
        let (fan_out, _) = filler.fan_out(&members, chips);
        let mut again = false;
        for held in &members {
            let slots = slots_of_core(held, &fan_out);
            if slots <= u64::from(limits[Resource::AxonsOut]) || held.len() < 2 {
                continue;
            }
            let (population, _) = network.population_of(held[0]);
            if spatial[population] {
                let fitting = (held.len() as u64 * u64::from(limits[Resource::AxonsOut]) / slots).max(1) as u32;
                if fitting < most[population] {
                    (most[population], cut[population], again) = (fitting, None, true);
                }
            }
        }
        if !again {
            break;
        }
    }
    segments
}

/// Populations that are not over space, whole.
fn without_tiles(network: &Quantised, spatial: &Spatial) -> impl Iterator<Item = Segment> {
    file_order(network).into_iter().filter(|segment| !spatial[segment.population])
}

/// Tiles, then compartments one by one in this order.
fn with_ids(network: &Quantised, tiled: &[Segment], ids: &[u32]) -> Vec<Segment> {
    let mut order = tiled.to_vec();
    let mut last: Option<(PopulationId, u32, u32)> = None;
    for &id in ids {
        let inside = last.filter(|&(_, first, size)| id >= first && id - first < size);
        let (population, first, size) = inside.unwrap_or_else(|| {
            let (population, index) = network.population_of(CompartmentId(id));
            (population, id - index, network.populations()[population].shape.len())
        });
        last = Some((population, first, size));
        match order.last_mut() {
            Some(Segment { population: p, indices: Indices::Listed(indices) })
                if *p == population && inside.is_some() =>
            {
                indices.push(id - first);
            }
            _ => order.push(Segment { population, indices: Indices::Listed(vec![id - first]) }),
        }
    }
    order
}

/// Moves groups of compartments between cores.
struct Refiner<'a> {
    graph: &'a Hypergraph,
    levels: &'a Levels,
    target: &'a Target,
    /// Effort that is left.
    work: u64,
    end: Option<Instant>,
}

impl Refiner<'_> {
    /// Members after groups of every level have been moved, the largest first, while there is work
    /// left.
    fn refined(&mut self, members: &Members, percent: i64) -> Members {
        let graph = self.graph;
        let mut state = State::new(graph, members, self.target, percent);
        let core_size = graph.own.len() / members.len().max(1);
        for labels in self.levels.labels.iter().rev() {
            if self.work == 0 || is_over(self.end) {
                break;
            }
            let groups = Groups::new(graph, &within_cores(labels, &state.core_of));
            // Groups of half a core and more have no room to move.
            if groups.len() * 2 < members.len() * 3 || groups.len() * core_size < graph.own.len() * 2 {
                continue;
            }
            refine::refine(&mut state, &groups, &mut self.work, self.end);
        }
        state.members(members)
    }
}

/// Labels such that no group is on two cores.
fn within_cores(labels: &[Option<u32>], core_of: &[u32]) -> Vec<Option<u32>> {
    let mut known: std::collections::HashMap<(u32, u32), u32> = std::collections::HashMap::new();
    let of = |(label, &core): (&Option<u32>, &u32)| {
        let next = known.len() as u32;
        label.map(|label| *known.entry((label, core)).or_insert(next))
    };
    labels.iter().zip(core_of).map(of).collect()
}

/// Whether each source of a population has a synapse.
fn active_sources(one: &Quantised, id: PopulationId) -> Vec<bool> {
    let shape = one.populations()[id].shape;
    let mut active = vec![false; shape.len() as usize];
    for projection in one.outgoing(id).iter().map(|&p| &one.projections()[p]) {
        match (&projection.connectivity, projection.connectivity.window()) {
            (_, Some(window)) => {
                let along = |axis: WindowAxis, length: u32| -> Vec<bool> {
                    (0..length).map(|source| axis.reached(source).next().is_some()).collect()
                };
                let rows = along(WindowAxis::rows(&window), window.source.1);
                let columns = along(WindowAxis::columns(&window), window.source.2);
                let positions = rows.iter().flat_map(|row| columns.iter().map(move |column| *row && *column));
                active.iter_mut().zip(positions.collect::<Vec<_>>().iter().cycle()).for_each(|(all, one)| *all |= one);
            }
            (Connectivity::Random { fan_out: 0, .. }, None) => {}
            (connectivity @ Connectivity::Sparse { .. }, None) => {
                active.iter_mut().zip(0..).for_each(|(active, source)| *active |= connectivity.count_from(source) > 0);
            }
            _ => active.fill(projection.connectivity.count(1) > 0),
        }
    }
    active
}

/// Lower bound on the cores of any partition, from the resources that copies cannot share.
fn least_cores(one: &Quantised, copies: u32, limits: &Limits) -> u64 {
    let places = Places::for_network(one, limits);
    let (mut sources, mut neuron_words, mut synapse_bits) = (0, 0, 0);
    for (id, population) in one.populations().enumerate() {
        // Sources at one place may share an input axon.
        let positions = places.positions(one, id).unwrap_or(population.shape.len());
        let active = active_sources(one, id).into_iter().filter(|&active| active).count();
        sources += active.min(positions as usize) as u64;
        let words = population.neuron_kind().map_or(0, |kind| limits.neuron_sizes.words_of(kind));
        neuron_words += u64::from(population.shape.len()) * u64::from(words);
        // Lists of sources that have places, and kernels, may be shared.
        for &id in one.outgoing(id).iter().filter(|_| !places.contain(one, id)) {
            let bits = u64::from(one.projections()[id].format.bits.get());
            synapse_bits += if limits.counts_kernels() { 0 } else { one.synapses_of(id) * bits };
        }
    }
    let words = synapse_bits / u64::from(u64::BITS);
    let needs = [
        (Resource::Compartments, u64::from(one.compartments())),
        (Resource::AxonsIn, sources),
        (Resource::NeuronWords, neuron_words),
        (Resource::SynapseWords, words),
    ];
    let cores = |(resource, need): (Resource, u64)| {
        need.saturating_mul(copies.into()).div_ceil(u64::from(limits[resource]).max(1))
    };
    needs.into_iter().map(cores).max().unwrap_or(0)
}
