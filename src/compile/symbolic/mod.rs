//! Mapping a layered network without ever writing out its synapses.
//!
//! In comes a network in which every projection is a window (convolution, pooling) or all to all, a target and options; out
//! goes a [`Described`] mapping: compartments on cores, what every core uses, places, traffic and expected cost. Kernels
//! stay kernels: a layer is cut into boxes, a core each ([`boxes`]), and synapses, input axons and words of a box are counted
//! from the geometry of its windows ([`layer`]), destinations from positions ([`sends`]). [`check::check`] then compares one
//! core of each kind with its synapses, one by one. A mapping is kept as a file ([`mod@file`]) and made again from it.
//!
//! What it leaves out: there is no program, so such a mapping cannot be run; cores hold boxes of one layer only; rates are
//! assumed.
pub mod boxes;
pub mod check;
pub mod cost;
pub mod file;
pub mod layer;
pub mod search;
pub mod sends;
#[cfg(test)]
mod tests;

use crate::base::diagnostic::Diagnostic;
use crate::base::id::{CoreId, IdVec};
use crate::compile::explore::cost_estimate::Score;
use crate::compile::explore::search::Found;
use crate::compile::explore::traffic::{DEFAULT_RATE, Links, Traffic};
use crate::compile::mapping_file;
use crate::compile::partition::row_of_chips;
use crate::compile::place::nets::Nets;
use crate::compile::reason::Reason;
use crate::compile::symbolic::boxes::{Boxes, Layered};
use crate::compile::symbolic::cost::{PopulationRates, Whereabouts, everywhere};
use crate::compile::symbolic::file::Outline;
use crate::compile::{
    Clock, CompileError, Layout, Objective, Options, PLACED_PER_SECOND, Strategy, does_not_fit, place,
};
use crate::desc::mapping::MappingFile;
use crate::desc::target::Target;
use crate::ir::firing_rates::Rates;
use crate::ir::partition::Partition;
use crate::ir::placement::Placement;
use crate::ir::quantised::Quantised;

/// Synapses, of all copies, above which a network that can be is described: twice this number takes two gigabytes of
/// tables and several more on the way to them.
pub const MOST_WRITTEN: u64 = 1 << 28;

/// A mapping of a network that stays described.
#[derive(Debug, Clone)]
pub struct Described {
    /// The network, one copy.
    pub one: Quantised,
    /// The network, all copies.
    pub quantised: Quantised,
    /// Compartments on cores; within every limit.
    pub partition: Partition,
    /// Cores on the board.
    pub placement: Placement,
    /// What each core holds and sends; its compartments are in the partition.
    boxes: Boxes,
    /// Seconds of each stage, in order.
    pub seconds: Vec<(&'static str, f64)>,
    /// The target's name.
    pub target: String,
    /// How it was made.
    pub options: Options,
    /// Name of the placement.
    pub placed: &'static str,
    /// Rates of all sources.
    pub rates: Rates,
    of_population: PopulationRates,
}

/// Why something that needs every synapse of so many copies of a network cannot be done.
#[must_use]
pub fn needs_synapses(what: &str, one: &Quantised, copies: u32) -> Diagnostic {
    let synapses = one.synapses().saturating_mul(u64::from(copies));
    let name = &one.parts().name;
    let message = format!("{what} needs every synapse of {name} written out: {synapses}, more than {MOST_WRITTEN}");
    let help = "nsim map maps such a network by its kernels, with --svg, --pareto and -o; nsim run --engine reference \
                simulates one copy of it in real numbers; for all else make it smaller, or map fewer copies";
    Diagnostic::new("map.described", message).help(help)
}

/// Refuses what needs every synapse of a network that [`applies`] to.
///
/// # Errors
/// [`needs_synapses`].
pub fn within_reach(what: &str, one: &Quantised, copies: u32) -> Result<(), Diagnostic> {
    match applies(one, copies) {
        true => Err(needs_synapses(what, one, copies)),
        false => Ok(()),
    }
}

/// Whether so many copies of a network are so large that they are described, and made of layers so that they can be.
#[must_use]
pub fn applies(one: &Quantised, copies: u32) -> bool {
    one.synapses().saturating_mul(u64::from(copies)) > MOST_WRITTEN && layer::layers(one).is_some()
}

/// A mapping of a network of layers, whatever its size.
///
/// # Errors
/// [`CompileError`]; [`CompileError::Input`] when it is not made of layers or the sequential strategy is asked for.
pub fn describe(one: Quantised, target: &Target, options: &Options) -> Result<Described, CompileError> {
    let mut clock = Clock::default();
    not_sequential(options)?;
    let network = clock.stage("copies", || Layered::new(one, target, options))?;
    if options.objective != Objective::Cores {
        let (outline, name) = clock.stage("compare", || search::best(&network, target, options))?;
        return made_again(network, outline, name, target, options, clock);
    }
    let rates = everywhere(&network.all, &Rates::assumed(DEFAULT_RATE));
    let boxes = clock.stage("boxes", || Boxes::fewest(&network, target, options))?;
    let (placement, name) = clock.stage("place", || placed(&boxes, target, options, &rates))?;
    let chips = row_of_chips(boxes.members.len(), target);
    Sited { network, boxes, chips, placement, name, clock }.proved(target, options)
}

/// What mappings in boxes of different sizes are expected to cost, the fewest boxes first.
///
/// # Errors
/// As [`describe`].
pub fn candidates(one: Quantised, target: &Target, options: &Options) -> Result<Vec<Found>, CompileError> {
    not_sequential(options)?;
    search::candidates(&Layered::new(one, target, options)?, target, options)
}

/// The mapping that a file says, made and checked again.
///
/// # Errors
/// [`CompileError::Input`] when the file is of another model, target or number of copies, or says what cannot be
/// ([`file::outline`]); [`CompileError::DoesNotFit`] when a core needs more than it has.
pub fn describe_saved(
    one: Quantised,
    target: &Target,
    options: &Options,
    file: &MappingFile,
) -> Result<Described, CompileError> {
    let mut clock = Clock::default();
    mapping_file::belongs(file, &one, target).map_err(CompileError::Input)?;
    mapping_file::of_copies(file, options.copies).map_err(CompileError::Input)?;
    let network = clock.stage("copies", || Layered::new(one, target, options))?;
    let outline = clock
        .stage("mapping", || file::outline(file, &network.all, &network.layers, target))
        .map_err(CompileError::Input)?;
    made_again(network, outline, place::SAVED, target, options, clock)
}

fn not_sequential(options: &Options) -> Result<(), CompileError> {
    if options.strategy != Strategy::Sequential {
        return Ok(());
    }
    let message = "a network that is described by its kernels is cut into boxes; there is no sequential mapping of it";
    Err(CompileError::Input(Diagnostic::new("map.strategy", message)))
}

/// Places of boxes that stand in a row of chips, and the name of how they were found.
fn placed(
    boxes: &Boxes,
    target: &Target,
    options: &Options,
    rates: &PopulationRates,
) -> Result<(Placement, &'static str), CompileError> {
    let cores = boxes.members.len();
    if !options.place {
        return Ok((place::sequential(cores, target).map_err(does_not_fit)?, place::SEQUENTIAL));
    }
    let told = boxes.flows(rates).map(|(own, to, weight)| (own.map(|own| own.0), weight, to.to_vec()));
    let nets = Nets::of(cores, told);
    let work = u64::from(options.effort_s) * PLACED_PER_SECOND;
    let assumed = Rates::assumed(DEFAULT_RATE);
    let search = place::Search { objective: options.objective, rates: &assumed, seed: options.seed, work };
    place::place_nets(&nets, cores, target, search).map_err(does_not_fit)
}

/// From where boxes are to a mapping that has been checked.
fn made_again(
    network: Layered,
    outline: Outline,
    name: &'static str,
    target: &Target,
    options: &Options,
    mut clock: Clock,
) -> Result<Described, CompileError> {
    let Outline { lattices, placement } = outline;
    let boxes = clock.stage("boxes", || Boxes::of_lattices(&network, &lattices, target.limits()));
    let chips = placement.sites().iter().map(|site| site.chip).collect();
    Sited { network, boxes, chips, placement, name, clock }.proved(target, options)
}

/// Boxes on the cores of the board: all that comes before they are known to be right.
struct Sited {
    network: Layered,
    boxes: Boxes,
    /// The chip of each box.
    chips: IdVec<CoreId, u32>,
    placement: Placement,
    /// Name of the placement.
    name: &'static str,
    clock: Clock,
}

impl Sited {
    /// The mapping once it is within every limit and has been checked.
    fn proved(self, target: &Target, options: &Options) -> Result<Described, CompileError> {
        let Sited { network, mut boxes, chips, placement, name: placed, mut clock } = self;
        let (limits, Layered { one, all, .. }) = (target.limits(), network);
        let usage = clock.stage("usage", || boxes.usage(&all, &chips, limits));
        let excesses =
            usage.enumerate().flat_map(|(core, used)| used.excesses(limits).map(move |excess| (core, excess)));
        let reason = |(core, (resource, need, limit))| Reason::of_core(core, resource, need, limit);
        let reasons: Vec<Reason> = excesses.map(reason).collect();
        if !reasons.is_empty() {
            return Err(CompileError::DoesNotFit(reasons));
        }
        let cores = check::one_of_each(boxes.kinds());
        let members = std::mem::take(&mut boxes.members);
        let partition = clock
            .stage("seats", || Partition::new(all.compartments(), members, usage, limits))
            .map_err(|error| CompileError::Fault(error.to_string()))?;
        clock.stage("check", || check::check(&all, &partition, &cores, &chips, limits)).map_err(CompileError::Fault)?;
        let rates = Rates::assumed(DEFAULT_RATE);
        let of_population = everywhere(&all, &rates);
        Ok(Described {
            one,
            quantised: all,
            partition,
            placement,
            boxes,
            seconds: clock.0,
            target: target.name().to_string(),
            options: *options,
            placed,
            rates,
            of_population,
        })
    }
}

impl Described {
    /// Where everything is.
    #[must_use]
    pub fn layout(&self) -> Layout<'_> {
        Layout {
            one: &self.one,
            quantised: &self.quantised,
            partition: &self.partition,
            placement: &self.placement,
            seconds: &self.seconds,
            options: &self.options,
            placed: self.placed,
            rates: &self.rates,
            written: false,
        }
    }

    fn whereabouts(&self) -> Whereabouts<'_> {
        Whereabouts { network: &self.quantised, boxes: &self.boxes, placement: &self.placement }
    }

    /// The mapping as a file.
    #[must_use]
    pub fn mapping_file(&self) -> MappingFile {
        let outline = Outline { lattices: self.boxes.lattices(), placement: self.placement.clone() };
        MappingFile {
            model: self.quantised.parts().name.clone(),
            target: self.target.clone(),
            copies: self.options.copies,
            strategy: self.options.strategy.name().to_string(),
            seed: self.options.seed,
            pruned: None,
            cores: Vec::new(),
            layers: file::layers_of(&self.quantised, &outline),
        }
    }

    /// The expected traffic.
    #[must_use]
    pub fn traffic(&self) -> Traffic {
        self.whereabouts().traffic(&self.of_population)
    }

    /// The expected messages over each link.
    #[must_use]
    pub fn links(&self) -> Links {
        self.whereabouts().links(&self.of_population)
    }

    /// What a mean step with this traffic is expected to cost.
    ///
    /// # Errors
    /// As [`crate::compile::explore::cost_estimate::score`].
    pub fn score(&self, traffic: &Traffic, target: &Target) -> Result<Score, Diagnostic> {
        self.whereabouts().score_with(&self.of_population, traffic, target, self.options.copies)
    }
}
