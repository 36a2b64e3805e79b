//! Stored forms of synapses: the distinct formats of a network, and the number of synapses that a
//! core stores where kernels are shared ([`Resource::StoredSynapses`]).
//!
//! The rule, for a core that holds some compartments of a population:
//!
//! - of a convolution or a pool, the weights of each channel of targets that has a compartment on
//!   the core, once, regardless of the number of its positions there;
//! - of every other projection, the synapses into each compartment;
//! - nothing for a weight of 0.
//!
//! The number is never less than the checker's count from the tables of the core.
//!
//! The words of a core, as Intel's compiler for Loihi 2 counts them ([`Packing::Kernels`]), are
//! [`CoreWords`]:
//!
//! - synapses, where a weight has w bits ([`weight_bits`]): an input axon has a list of its n
//!   targets on the core, of `ceil((n (w + synapse_bits) + list_bits) / 64)` words. A convolution
//!   has a row for each position of its kernel and each input channel. A row has a block for each
//!   power of two of the n channels on the core, of `ceil((p w + list_bits) / 64)` words. Rows are
//!   stored once;
//! - input axons: one for each source, and one for each source position of a convolution;
//! - neurons: by kind ([`NeuronSizes`]);
//! - axon map: one for each position of a convolution, one for any other compartment;
//! - groups: one for each population.
//!
//! A channel can save words, as one block of four channels may take fewer words than blocks of two
//! and of one. `nsim_check::memory` counts again, source by source.
//!
//! [`NeuronSizes`]: nsim_ir::resource::NeuronSizes
//! [`Resource::StoredSynapses`]: nsim_ir::resource::Resource::StoredSynapses

use std::collections::{BTreeMap, HashMap, HashSet};

use crate::resources::receptive_field::WindowAxis;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::fixed::{Delay, SignMode, WeightBits};
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId, ProjectionId};
use nsim_ir::graph::Window;
use nsim_ir::learning::{Learning, Product, Quantity, Rule, Trace, TraceSettings, Variable};
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::quantised::{Population, Projection, Quantised};
use nsim_ir::resource::{Limits, Packing, Resource};

/// The distinct synapse formats of a network, ascending.
#[derive(Debug, Clone)]
pub struct Formats {
    distinct: Vec<SynapseFormat>,
    tag_bits: Vec<u8>,
    moves: Vec<bool>,
    rules: Vec<RuleSize>,
    of_projection: Vec<u16>,
}

/// What the rule of a format takes on a core.
#[derive(Debug, Clone)]
struct RuleSize {
    format: u16,
    /// Words of its microcode.
    words: u32,
    /// Number of the first rule with equal products.
    program: usize,
    /// Settings of the presynaptic traces that it reads.
    traces: Vec<TraceSettings>,
}

impl Formats {
    /// The formats of a network.
    pub fn for_network(network: &Quantised) -> Self {
        let mut distinct: Vec<SynapseFormat> = network.projections().iter().map(|p| p.format).collect();
        distinct.sort_unstable();
        distinct.dedup();
        let find = |format: &SynapseFormat| distinct.partition_point(|f| f < format) as u16;
        let of_projection = network.projections().iter().map(|p| find(&p.format)).collect();
        let tag_bits = distinct.iter().map(|format| tag_bits(network, *format)).collect();
        let moves = distinct.iter().map(|format| moves_delays(network, *format)).collect();
        let rules = (0..).zip(&distinct).filter_map(|(index, format)| rule_size(network, index, *format)).collect();
        Formats { distinct, tag_bits, moves, rules, of_projection }
    }

    /// Words of microcode, and presynaptic trace configurations, of a core with these formats.
    pub fn of_rules(&self, is_used: impl Fn(u16) -> bool) -> (u32, u32) {
        let (mut programs, mut traces) = (BTreeMap::new(), Vec::new());
        for rule in self.rules.iter().filter(|rule| is_used(rule.format)) {
            programs.insert(rule.program, rule.words);
            for settings in &rule.traces {
                if !traces.contains(settings) {
                    traces.push(*settings);
                }
            }
        }
        (programs.values().sum(), traces.len() as u32)
    }

    /// Whether a rule changes the delays of a format.
    #[inline]
    pub fn moves_delays(&self, index: u16) -> bool {
        self.moves[usize::from(index)]
    }

    /// Bits of the tags of a format.
    #[inline]
    pub fn tag_bits(&self, index: u16) -> u8 {
        self.tag_bits[usize::from(index)]
    }

    /// A format by its index.
    #[inline]
    pub fn get(&self, index: u16) -> SynapseFormat {
        self.distinct[usize::from(index)]
    }

    /// The index of each projection's format.
    pub fn by_projection(&self) -> &[u16] {
        &self.of_projection
    }

    /// Number of distinct formats.
    pub fn len(&self) -> usize {
        self.distinct.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.distinct.is_empty()
    }
}

/// Stored weights of a population.
#[derive(Debug, Default)]
struct Weights {
    /// Positions of a channel, at least 1.
    positions: u32,
    /// Weights of all kernels of a channel.
    by_channel: Vec<u64>,
    /// Weights of the other synapses into each compartment.
    by_compartment: Vec<u64>,
}

/// Channels of which a core stores the kernels already.
pub type Kernels = HashSet<(PopulationId, u32)>;

/// Stored weights of a network's compartments.
#[derive(Debug)]
pub struct StoredSynapses(IdVec<PopulationId, Weights>);

/// Weights of the kernels of each channel of a projection's targets; empty without a kernel.
pub fn by_channel(projection: &Projection) -> Vec<u64> {
    let stored = |weights: &[i16]| weights.iter().filter(|&&weight| weight != 0).count() as u64;
    match &projection.connectivity {
        Connectivity::Conv2d { window, kernel } => {
            kernel.chunks(kernel.len() / window.target.0.max(1) as usize).map(stored).collect()
        }
        Connectivity::SumPool2d { window, weight } => {
            let each = u64::from(window.kernel.0) * u64::from(window.kernel.1) * stored(&[*weight]);
            vec![each; window.target.0 as usize]
        }
        Connectivity::Dense { .. } | Connectivity::Sparse { .. } | Connectivity::Random { .. } => Vec::new(),
    }
}

impl StoredSynapses {
    /// Counts the stored weights of a network.
    pub fn for_network(network: &Quantised) -> Self {
        let weights = |(id, population): (PopulationId, &Population)| {
            let size = population.shape.len() as usize;
            let positions = population.shape.positions().max(1);
            let mut weights =
                Weights { positions, by_channel: vec![0; size / positions as usize], by_compartment: vec![0; size] };
            for (_, projection) in network.incoming(id) {
                let kernels = by_channel(projection);
                weights.by_channel.iter_mut().zip(&kernels).for_each(|(sum, kernel)| *sum += kernel);
                if kernels.is_empty() {
                    for source in 0..network.populations()[projection.source].shape.len() {
                        projection.connectivity.for_each_from(source, |target, weight| {
                            weights.by_compartment[target as usize] += u64::from(weight != 0);
                        });
                    }
                }
            }
            weights
        };
        StoredSynapses(network.populations().enumerate().map(weights).collect())
    }

    /// Number of weights that a core stores in addition once it holds this compartment too.
    pub fn added(&self, population: PopulationId, index: u32, kernels: &mut Kernels) -> u64 {
        let weights = &self.0[population];
        let channel = index / weights.positions;
        let kernel = if kernels.insert((population, channel)) { weights.by_channel[channel as usize] } else { 0 };
        weights.by_compartment[index as usize] + kernel
    }

    /// Number of weights that a core of these compartments stores.
    pub fn of_core(&self, network: &Quantised, members: &[CompartmentId]) -> u64 {
        let mut kernels = Kernels::new();
        let added = |&id: &CompartmentId| {
            let (population, index) = network.population_of(id);
            self.added(population, index, &mut kernels)
        };
        members.iter().map(added).sum()
    }
}

/// Bits of a word.
const WORD: u64 = 64;

/// Bits of a tag.
const TAG: u8 = 9;
/// Bits of a delay that does not act.
const DELAY: u8 = 6;

/// Whether a rule changes or reads a variable.
fn uses(rule: &Rule, variable: Variable) -> bool {
    let reads = |product: &Product| product.factors.iter().any(|factor| factor.of == Quantity::Variable(variable));
    rule.changes(variable) || rule.all_products().any(reads)
}

/// Bits of a synapse's tag, and of a delay that does not act: none unless the format's rule uses
/// it.
pub fn tag_bits(network: &Quantised, format: SynapseFormat) -> u8 {
    let Some(rule) = format.rule.map(|rule| &network.parts().rules[rule].rule) else { return 0 };
    let number = !rule.semantics().delays_act() && uses(rule, Variable::Delay);
    TAG * u8::from(uses(rule, Variable::Tag)) + DELAY * u8::from(number)
}

/// Size of a format's rule. A pair rule takes one word (Davies et al. 2018), and so does a product
/// of two traces (nengo-loihi `hardware/builder.py`).
fn rule_size(network: &Quantised, format: u16, of: SynapseFormat) -> Option<RuleSize> {
    let rules = &network.parts().rules;
    let rule = &rules[of.rule?].rule;
    let halves: u32 = rule.all_products().map(|product| if product.factors.len() > 1 { 2 } else { 1 }).sum();
    let equal = |other: &Learning| Variable::ALL.iter().all(|&z| other.rule.products(z) == rule.products(z));
    let reads = |trace: &Trace| {
        let mut factors = rule.all_products().flat_map(|product| &product.factors);
        factors.any(|factor| factor.of == Quantity::Trace(*trace))
    };
    let traces = [Trace::X1, Trace::X2].into_iter().filter(reads).map(|trace| rule.trace(trace)).collect();
    Some(RuleSize { format, words: halves.div_ceil(2), program: rules.iter().position(equal)?, traces })
}

/// Whether the rule of a format changes delays that act.
fn moves_delays(network: &Quantised, format: SynapseFormat) -> bool {
    let rule = format.rule.map(|rule| &network.parts().rules[rule].rule);
    rule.is_some_and(|rule| rule.changes(Variable::Delay) && rule.semantics().delays_act())
}

/// The delay for which a core has room: the longest one where a rule changes it.
pub fn stored_delay(network: &Quantised, projection: &Projection) -> Delay {
    if moves_delays(network, projection.format) { Delay::MAX } else { projection.delay }
}

/// Fewest bits that hold every weight of a projection as its format stores it, with its tag.
pub fn weight_bits(network: &Quantised, projection: &Projection) -> u32 {
    let format = projection.format;
    let widest = u32::from(format.bits.get());
    let (low, high) = match &projection.connectivity {
        _ if format.is_plastic() => return widest + u32::from(tag_bits(network, format)),
        Connectivity::Dense { weights, .. } | Connectivity::Sparse { weights, .. } => range(weights),
        Connectivity::Conv2d { kernel, .. } => range(kernel),
        Connectivity::SumPool2d { weight, .. } => range(&[*weight]),
        Connectivity::Random { low, high, .. } => (*low, *high),
    };
    let step = WeightBits::new(8).map_or(1, |bits| format.sign.step(bits));
    let magnitude = |value: i16| u16::BITS - value.unsigned_abs().leading_zeros();
    let bits = match format.sign {
        // A negative number has as many bits as its complement.
        SignMode::Mixed => 1 + magnitude((high / step).max(0)).max(magnitude((low / step).min(0) + i16::from(low < 0))),
        SignMode::Excitatory | SignMode::Inhibitory => magnitude(low).max(magnitude(high)),
    };
    bits.clamp(1, widest)
}

fn range(weights: &[i16]) -> (i16, i16) {
    weights.iter().fold((0, 0), |(low, high), &weight| (low.min(weight), high.max(weight)))
}

/// The sizes of lists.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lists {
    synapse_bits: u64,
    list_bits: u64,
}

impl Lists {
    /// The sizes by these limits.
    pub fn new(limits: &Limits) -> Self {
        match limits.packing {
            Packing::Kernels { synapse_bits, list_bits } => {
                Lists { synapse_bits: synapse_bits.into(), list_bits: list_bits.into() }
            }
            Packing::Nengo | Packing::Nxtf => Lists { synapse_bits: 0, list_bits: 0 },
        }
    }

    /// Words of the list of an input axon with `targets` targets.
    pub fn of_axon(self, targets: u64, weight_bits: u32) -> u64 {
        match targets {
            0 => 0,
            _ => (targets * (u64::from(weight_bits) + self.synapse_bits) + self.list_bits).div_ceil(WORD),
        }
    }

    /// Words of a row of a kernel for `channels` output channels.
    pub fn of_row(self, channels: u64, weight_bits: u32) -> u64 {
        let of_block = |power: u32| match channels >> power & 1 {
            0 => 0,
            _ => ((u64::from(weight_bits) << power) + self.list_bits).div_ceil(WORD),
        };
        (0..u64::BITS - channels.leading_zeros()).map(of_block).sum()
    }
}

/// A projection, as a core stores it.
#[derive(Debug)]
struct Incoming {
    source: PopulationId,
    sources: u64,
    weight_bits: u32,
    stored: Stored,
}

#[derive(Debug)]
enum Stored {
    /// Each source has a list of all targets.
    Dense,
    /// Rows of a kernel.
    Kernel(Window),
    /// Each source has a list of its targets.
    Listed,
}

#[derive(Debug)]
struct OfPopulation {
    /// Positions of a channel.
    positions: u32,
    neuron_words: u64,
    /// Whether it is a convolution, whose channels share entries of the axon map.
    by_position: bool,
    incoming: Vec<(ProjectionId, Incoming)>,
}

/// A network, as cores store it.
#[derive(Debug)]
pub struct NetworkWords {
    lists: Lists,
    populations: IdVec<PopulationId, OfPopulation>,
    /// Whether any projection is listed.
    any_listed: bool,
}

/// Whether words of a core are counted; few chips limit any.
pub fn are_counted(limits: &Limits) -> bool {
    let counted = [Resource::NeuronWords, Resource::AxonMapWords, Resource::Groups];
    limits.counts_kernels() || counted.into_iter().any(|resource| limits.is_limited(resource))
}

impl NetworkWords {
    /// A network by these limits; `None` where they count no words.
    pub fn new(network: &Quantised, limits: &Limits) -> Option<Self> {
        if !are_counted(limits) {
            return None;
        }
        let mut any_listed = false;
        let of_projection = |projection: &Projection| {
            let sources = network.populations()[projection.source].shape.len().into();
            let stored = match (&projection.connectivity, projection.connectivity.window()) {
                (_, Some(window)) => Stored::Kernel(window),
                (Connectivity::Dense { .. }, None) => Stored::Dense,
                _ => Stored::Listed,
            };
            Incoming { source: projection.source, sources, weight_bits: weight_bits(network, projection), stored }
        };
        let mut populations = IdVec::new();
        for (id, population) in network.populations().enumerate() {
            let incoming: Vec<_> = network.incoming(id).map(|(id, p)| (id, of_projection(p))).collect();
            any_listed |= incoming.iter().any(|(_, incoming)| matches!(incoming.stored, Stored::Listed));
            populations.push(OfPopulation {
                positions: population.shape.positions().max(1),
                neuron_words: population.neuron_kind().map_or(0, |kind| limits.neuron_sizes.words_of(kind).into()),
                by_position: incoming.iter().any(|(_, incoming)| matches!(incoming.stored, Stored::Kernel(_))),
                incoming,
            });
        }
        Some(NetworkWords { lists: Lists::new(limits), populations, any_listed })
    }

    /// Whether any projection is listed, so that its synapses are added one by one.
    pub fn any_listed(&self) -> bool {
        self.any_listed
    }
}

/// Words that a core uses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct CoreWords {
    /// Input axons.
    pub axons_in: u64,
    /// Synapses.
    pub synapses: u64,
    /// Neurons.
    pub neurons: u64,
    /// Entries of the axon map.
    pub axon_map: u64,
    /// Groups of neurons.
    pub groups: u64,
}

/// The compartments of a population on a core.
#[derive(Debug, Default)]
struct Held {
    compartments: u64,
    positions: HashSet<u32>,
    channels: HashSet<u32>,
    /// Channels of each group of a convolution, by projection.
    of_group: HashMap<(ProjectionId, u32), u64>,
}

/// Sources of a population that reach a core.
#[derive(Debug, Default)]
struct Reaching {
    /// All of them, by a dense projection.
    all: Option<u64>,
    listed: HashSet<u32>,
    positions: HashSet<u32>,
}

impl Reaching {
    fn axons(&self) -> u64 {
        self.all.unwrap_or(self.listed.len() as u64) + self.positions.len() as u64
    }
}

/// The words of a core while compartments are added.
#[derive(Debug, Default)]
pub struct HeldWords {
    /// Words so far.
    pub words: CoreWords,
    held: HashMap<PopulationId, Held>,
    reaching: HashMap<PopulationId, Reaching>,
    listed: HashMap<(ProjectionId, u32), u64>,
}

impl HeldWords {
    /// Adds a compartment, but for its listed synapses.
    pub fn add(&mut self, network: &NetworkWords, population: PopulationId, index: u32) {
        let HeldWords { words, held, reaching, .. } = self;
        let (of, lists) = (&network.populations[population], network.lists);
        let held = held.entry(population).or_insert_with(|| {
            words.groups += 1;
            Held::default()
        });
        let (channel, position) = (index / of.positions, index % of.positions);
        held.compartments += 1;
        let new_position = of.by_position && held.positions.insert(position);
        let new_channel = of.by_position && held.channels.insert(channel);
        words.neurons += of.neuron_words;
        words.axon_map += u64::from(new_position || !of.by_position);
        for &(id, Incoming { source, sources, weight_bits, ref stored }) in &of.incoming {
            let mut reach = |change: &mut dyn FnMut(&mut Reaching)| {
                let reaching = reaching.entry(source).or_default();
                words.axons_in -= reaching.axons();
                change(reaching);
                words.axons_in += reaching.axons();
            };
            match stored {
                Stored::Dense => {
                    if held.compartments == 1 {
                        reach(&mut |reaching| reaching.all = Some(sources));
                    }
                    let [before, now] = [held.compartments - 1, held.compartments]
                        .map(|targets| sources * lists.of_axon(targets, weight_bits));
                    words.synapses = words.synapses + now - before;
                }
                Stored::Kernel(window) => {
                    if new_channel {
                        let group = channel / (window.target.0 / window.groups);
                        let count = held.of_group.entry((id, group)).or_default();
                        *count += 1;
                        let rows = rows(window);
                        let [before, now] = [*count - 1, *count].map(|n| rows * lists.of_row(n, weight_bits));
                        words.synapses = words.synapses + now - before;
                    }
                    if new_position {
                        let (rows, columns) = (WindowAxis::rows(window), WindowAxis::columns(window));
                        let (y, x) = (position / window.target.2, position % window.target.2);
                        reach(&mut |reaching| {
                            for row in rows.covered(y).map(|row| row * window.source.2) {
                                reaching.positions.extend(columns.covered(x).map(|column| row + column));
                            }
                        });
                    }
                }
                Stored::Listed => {}
            }
        }
    }

    /// Adds a synapse into a population from this source, if its projection is listed.
    pub fn add_listed(&mut self, network: &NetworkWords, to: (PopulationId, ProjectionId), source: u32) {
        if !network.any_listed {
            return;
        }
        let incoming = network.populations[to.0].incoming.iter().find(|(id, _)| *id == to.1);
        let Some((id, Incoming { source: from, weight_bits, stored: Stored::Listed, .. })) = incoming else { return };
        let targets = self.listed.entry((*id, source)).or_default();
        *targets += 1;
        let [before, now] = [*targets - 1, *targets].map(|targets| network.lists.of_axon(targets, *weight_bits));
        self.words.synapses = self.words.synapses + now - before;
        let reaching = self.reaching.entry(*from).or_default();
        self.words.axons_in -= reaching.axons();
        reaching.listed.insert(source);
        self.words.axons_in += reaching.axons();
    }
}

/// Rows of a kernel that reach an output channel.
pub fn rows(window: &Window) -> u64 {
    u64::from(window.source.0 / window.groups) * u64::from(window.kernel.0) * u64::from(window.kernel.1)
}
