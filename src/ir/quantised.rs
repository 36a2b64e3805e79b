//! The network in integers that fit their hardware fields: what the chip would be told, before any core.
//!
//! Made by `compile::frontend::quantise`. True of every [`Quantised`]: each weight is a multiple of its format's least step within
//! the format's range, each parameter fits its field, compartments and channels are numbered without gaps in the order
//! of the populations. Synapses stay described (a kernel, a seed) and are enumerated source by source.

use std::sync::Arc;

use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, Payload, Refractory, SignMode, ThresholdMantissa, VmaxExponent,
    VminExponent, WeightBits, WeightExponent, scaled_weight,
};
use crate::base::id::{ChannelId, CompartmentId, IdVec, PopulationId, ProjectionId};
use crate::base::rng;
use crate::desc::network::{Semantics, ThresholdTest};
use crate::desc::neurons::NeuronKind;
use crate::ir::graph::{PerCompartment, Shape, Window};
use crate::ir::pruned;

/// One compartment: its kind, and what its registers are set to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Neuron {
    /// Which rule its updates follow.
    pub kind: NeuronKind,
    /// Effective decay of the current.
    pub du: Decay,
    /// Effective decay of the voltage.
    pub dv: Decay,
    /// Threshold mantissa.
    pub vth: ThresholdMantissa,
    /// Bias mantissa.
    pub bias_mant: BiasMantissa,
    /// Bias exponent.
    pub bias_exp: BiasExponent,
    /// Refractory period.
    pub refractory: Refractory,
    /// Exponent of the lower clip.
    pub vmin: VminExponent,
    /// Exponent of the upper clip.
    pub vmax: VmaxExponent,
}

impl Neuron {
    /// The least that a compartment can be, for others to start from: a Loihi compartment without memory and bias, with the
    /// greatest threshold and the widest clips.
    pub const PLAIN: Neuron = Neuron {
        kind: NeuronKind::Loihi,
        du: Decay::MAX,
        dv: Decay::MAX,
        vth: ThresholdMantissa::MAX,
        bias_mant: BiasMantissa::ZERO,
        bias_exp: BiasExponent::MIN,
        refractory: Refractory::ONE,
        vmin: VminExponent::MAX,
        vmax: VmaxExponent::MAX,
    };
}

/// The parameters of a population's compartments.
pub type Neurons = PerCompartment<Neuron>;

/// What a population is made of.
#[derive(Debug, Clone)]
pub enum Units {
    /// Input channels from this one on.
    Input(ChannelId),
    /// Compartments from `first` on.
    Compartments {
        /// The first compartment.
        first: CompartmentId,
        /// Their parameters.
        neurons: Neurons,
        /// The step before which they are held at zero.
        start_step: u32,
    },
}

/// A population in integers.
#[derive(Debug, Clone)]
pub struct Population {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: Shape,
    /// What it is made of.
    pub units: Units,
    /// The integer that each of its spikes carries; `None` for binary spikes.
    pub payload: Option<Payload>,
}

impl Population {
    /// The first compartment, when it has compartments.
    #[must_use]
    pub fn first_compartment(&self) -> Option<CompartmentId> {
        match self.units {
            Units::Input(_) => None,
            Units::Compartments { first, .. } => Some(first),
        }
    }

    /// What each of its spikes multiplies the weights of its synapses by: its payload, 1 for binary spikes.
    #[must_use]
    pub fn spike_factor(&self) -> i32 {
        self.payload.map_or(1, Payload::get)
    }

    /// The first channel, when it is an input.
    #[must_use]
    pub fn first_channel(&self) -> Option<ChannelId> {
        match self.units {
            Units::Input(first) => Some(first),
            Units::Compartments { .. } => None,
        }
    }
}

/// The format that the synapses of a projection are stored in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SynapseFormat {
    /// Weight exponent.
    pub exponent: WeightExponent,
    /// Sign mode.
    pub sign: SignMode,
    /// Bits of a weight.
    pub bits: WeightBits,
}

impl SynapseFormat {
    /// Equation (1): what a spike over a weight of this format adds to the accumulator.
    #[inline]
    #[must_use]
    pub fn scaled(self, weight: i16) -> i32 {
        scaled_weight(weight, self.exponent)
    }
}

/// How the sources of a projection reach its targets, with integer weights.
#[derive(Debug, Clone, PartialEq)]
pub enum Connectivity {
    /// All to all; row-major `[source][target]`, so that a spike walks one row.
    Dense {
        /// Number of targets.
        targets: u32,
        /// The weights.
        weights: Arc<[i16]>,
    },
    /// Listed synapses: those of source s are `first[s]..first[s + 1]`.
    Sparse {
        /// One more than sources.
        first: Arc<[u64]>,
        /// Target of each synapse; ascending within a source.
        targets: Arc<[u32]>,
        /// Weight of each synapse.
        weights: Arc<[i16]>,
    },
    /// Cross-correlation; kernel `[C'][C / groups][kh][kw]`.
    Conv2d {
        /// Geometry.
        window: Window,
        /// The kernel.
        kernel: Arc<[i16]>,
    },
    /// The same weight from each position of a window, channel by channel.
    SumPool2d {
        /// Geometry.
        window: Window,
        /// The weight.
        weight: i16,
    },
    /// Seeded random synapses: synapse k of source s has target `below(targets, seed, first_source + s, 2 k)` and weight
    /// `low + step * below(1 + (high - low) / step, seed, first_source + s, 2 k + 1)`.
    Random {
        /// Number of targets.
        targets: u32,
        /// Synapses of each source.
        fan_out: u32,
        /// The least weight.
        low: i16,
        /// The greatest weight.
        high: i16,
        /// Distance of neighbouring weights.
        step: i16,
        /// The seed.
        seed: u64,
        /// Index of the first source among the concatenated sources of its declaration.
        first_source: u32,
    },
}

/// A projection in integers.
#[derive(Debug, Clone, PartialEq)]
pub struct Projection {
    /// `source -> target`.
    pub name: String,
    /// Where spikes come from.
    pub source: PopulationId,
    /// Where they go.
    pub target: PopulationId,
    /// How its synapses are stored.
    pub format: SynapseFormat,
    /// Delay field of every synapse.
    pub delay: Delay,
    /// Its synapses.
    pub connectivity: Connectivity,
}

impl Connectivity {
    /// Calls `f(target, weight)` for every synapse of a source, in ascending order of targets except for `Random`.
    /// Indices are within the populations.
    #[inline]
    pub fn for_each_from(&self, source: u32, mut f: impl FnMut(u32, i16)) {
        match self {
            Connectivity::Dense { targets, weights } => {
                let row = source as usize * *targets as usize;
                for (target, &weight) in weights[row..row + *targets as usize].iter().enumerate() {
                    f(target as u32, weight);
                }
            }
            Connectivity::Sparse { first, targets, weights } => {
                let range = first[source as usize] as usize..first[source as usize + 1] as usize;
                for (&target, &weight) in targets[range.clone()].iter().zip(&weights[range]) {
                    f(target, weight);
                }
            }
            Connectivity::Conv2d { window, kernel } => {
                let (_, kh, kw) = (0, window.kernel.0, window.kernel.1);
                let per_group_in = window.source.0 / window.groups;
                let per_group_out = window.target.0 / window.groups;
                let channel = source / (window.source.1 * window.source.2);
                let group = channel / per_group_in;
                for out in group * per_group_out..(group + 1) * per_group_out {
                    let base = (out * per_group_in + channel % per_group_in) * kh * kw;
                    window.for_each_position(source, |y, x, ky, kx| {
                        let target = (out * window.target.1 + y) * window.target.2 + x;
                        f(target, kernel[(base + ky * kw + kx) as usize]);
                    });
                }
            }
            Connectivity::SumPool2d { window, weight } => {
                let channel = source / (window.source.1 * window.source.2);
                window.for_each_position(source, |y, x, _, _| {
                    f((channel * window.target.1 + y) * window.target.2 + x, *weight);
                });
            }
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    let target = drawn_target(*targets, *seed, entity, k);
                    f(target, drawn_weight((*low, *high, *step), *seed, entity, k));
                }
            }
        }
    }

    /// Calls `f(target, weight)` for every synapse of a source whose target is wanted, in the order of
    /// [`Connectivity::for_each_from`].
    #[inline]
    pub fn for_each_wanted(&self, source: u32, wanted: impl Fn(u32) -> bool, mut f: impl FnMut(u32, i16)) {
        match self {
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
                // Weights of the others, half of their work, are not drawn.
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    let target = drawn_target(*targets, *seed, entity, k);
                    if wanted(target) {
                        f(target, drawn_weight((*low, *high, *step), *seed, entity, k));
                    }
                }
            }
            connectivity => connectivity.for_each_from(source, |target, weight| {
                if wanted(target) {
                    f(target, weight);
                }
            }),
        }
    }

    /// Calls `f(target)` for every synapse of a source, in the order of [`Connectivity::for_each_from`].
    #[inline]
    pub fn for_each_target(&self, source: u32, mut f: impl FnMut(u32)) {
        match self {
            Connectivity::Random { targets, fan_out, seed, first_source, .. } => {
                // The weights, half of the work, are not drawn.
                let entity = u64::from(*first_source) + u64::from(source);
                for k in 0..u64::from(*fan_out) {
                    f(drawn_target(*targets, *seed, entity, k));
                }
            }
            connectivity => connectivity.for_each_from(source, |target, _| f(target)),
        }
    }

    /// Number of synapses of a source.
    #[must_use]
    pub fn count_from(&self, source: u32) -> u64 {
        match self {
            Connectivity::Dense { targets, .. } => u64::from(*targets),
            Connectivity::Sparse { first, .. } => first[source as usize + 1] - first[source as usize],
            Connectivity::Random { fan_out, .. } => u64::from(*fan_out),
            Connectivity::Conv2d { .. } | Connectivity::SumPool2d { .. } => {
                let mut count = 0;
                self.for_each_from(source, |_, _| count += 1);
                count
            }
        }
    }
}

impl Window {
    /// Pairs of a source position and an output position whose window covers it: the synapses of one pair of channels.
    #[must_use]
    pub fn positions(&self) -> u64 {
        let of_axis = |axis: fn((u32, u32)) -> u32, source: u32, target: u32| -> u64 {
            let (stride, padding, dilation) = (axis(self.stride), axis(self.padding), axis(self.dilation));
            let covered = |at: u32, k: u32| {
                let s = (u64::from(at) * u64::from(stride) + u64::from(k) * u64::from(dilation))
                    .checked_sub(u64::from(padding));
                s.is_some_and(|s| s < u64::from(source))
            };
            (0..target).map(|at| (0..axis(self.kernel)).filter(|&k| covered(at, k)).count() as u64).sum()
        };
        of_axis(|p| p.0, self.source.1, self.target.1) * of_axis(|p| p.1, self.source.2, self.target.2)
    }

    /// Calls `f(y, x, ky, kx)` for every output position whose window covers this source, and its place in the window.
    pub fn for_each_position(&self, source: u32, mut f: impl FnMut(u32, u32, u32, u32)) {
        let within = source % (self.source.1 * self.source.2);
        let (sy, sx) = (within / self.source.2, within % self.source.2);
        let reach = |s: u32, axis: fn((u32, u32)) -> u32, size: u32| {
            let (stride, padding, dilation) = (axis(self.stride), axis(self.padding), axis(self.dilation));
            // Output o covers s at k when o * stride - padding + k * dilation = s.
            let kernel = axis(self.kernel);
            (0..kernel).rev().filter_map(move |k| {
                let at = (s + padding).checked_sub(k * dilation)?;
                (at % stride == 0 && at / stride < size).then_some((at / stride, k))
            })
        };
        for (y, ky) in reach(sy, |p| p.0, self.target.1) {
            for (x, kx) in reach(sx, |p| p.1, self.target.2) {
                f(y, x, ky, kx);
            }
        }
    }
}

/// Something that quantisation changed or left behind, for the user to know.
#[derive(Debug, Clone, PartialEq)]
pub struct Note {
    /// The population or projection.
    pub entity: String,
    /// What was done to it.
    pub message: String,
    /// When it is of rounded weights, how they were rounded.
    pub rounded: Option<Rounded>,
}

/// What rounding did to the weights of a projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rounded {
    /// Whether the weights were real numbers, not mantissas.
    pub real: bool,
    /// Weights that were changed.
    pub changed: u64,
    /// All weights.
    pub weights: u64,
    /// The greatest change, as a share of the greatest weight.
    pub worst_share: f64,
}

/// The periodic reset of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reset {
    /// Timesteps between two resets, at least 1.
    pub interval: u32,
    /// The first, counted from each population's start step.
    pub offset: u32,
}

impl Reset {
    /// Whether a population with this start step returns to zero before the update of `step`.
    #[inline]
    #[must_use]
    pub fn falls_on(self, step: u32, start_step: u32) -> bool {
        match step.checked_sub(start_step.saturating_add(self.offset)) {
            Some(since) => since % self.interval == 0,
            None => false,
        }
    }
}

/// What the parts of a [`Quantised`] network are made from.
#[derive(Debug, Clone)]
pub struct Parts {
    /// The network's name.
    pub name: String,
    /// Milliseconds that a timestep stands for.
    pub timestep_ms: f64,
    /// Populations in the order of the file.
    pub populations: IdVec<PopulationId, Population>,
    /// Projections in the order of the file.
    pub projections: IdVec<ProjectionId, Projection>,
    /// The population whose spikes decide.
    pub output: PopulationId,
    /// Names of classes, or none.
    pub classes: Vec<String>,
    /// Which arithmetic.
    pub semantics: Semantics,
    /// When a compartment spikes.
    pub threshold: ThresholdTest,
    /// Periodic reset.
    pub reset: Option<Reset>,
    /// What quantisation changed.
    pub notes: Vec<Note>,
    /// Whether sources may be gathered in population axons where a compartment has more of them than a core has input axons.
    pub gathers: bool,
}

impl Parts {
    /// A network of this name without populations, in the chip's semantics, with timesteps of 1 ms.
    #[must_use]
    pub fn empty(name: &str) -> Self {
        Parts {
            name: name.to_string(),
            timestep_ms: 1.0,
            populations: Default::default(),
            projections: Default::default(),
            output: PopulationId(0),
            classes: Vec::new(),
            semantics: Semantics::Hardware,
            threshold: ThresholdTest::Strict,
            reset: None,
            notes: Vec::new(),
            gathers: false,
        }
    }
}

/// The network in integers.
#[derive(Debug, Clone)]
pub struct Quantised {
    parts: Parts,
    channels: u32,
    compartments: u32,
    outgoing: IdVec<PopulationId, Vec<ProjectionId>>,
    pruned: Option<Arc<Pruned>>,
}

/// What a pruned network was before, and what was left out.
///
/// A pruned network is a network like any other, smaller and renumbered, so every stage after it takes it as it is. With
/// this record people still see the populations, shapes and numbers of their model file. Input populations always keep
/// their channels; a population of compartments that lost some keeps its name and place, even when nothing is left of it.
#[derive(Debug, Clone)]
pub struct Pruned {
    /// The network before; of several copies, one.
    pub original: Quantised,
    /// For each population that lost compartments, the indices of those it kept, ascending.
    pub kept: IdVec<PopulationId, Option<Vec<u32>>>,
    /// Populations that were to stay whole because they are probed.
    pub probed: Vec<PopulationId>,
    /// Where the stimulus that it was pruned for came from; `None` when it was pruned for every stimulus.
    pub stimulus: Option<Vec<String>>,
    /// Channels that the stimulus never fires, ascending.
    pub dead: Vec<ChannelId>,
    /// What was left out, a row for each kind that was looked for.
    pub rows: Vec<pruned::Row>,
}

impl Pruned {
    /// How many of a kind were left out.
    #[must_use]
    pub fn count(&self, kind: pruned::Kind) -> u64 {
        self.rows.iter().filter(|row| row.kind == kind).map(|row| row.count).sum()
    }
}

/// Where spikes come from: an input channel or a compartment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SpikeSource {
    /// An input channel.
    Channel(ChannelId),
    /// A compartment.
    Compartment(CompartmentId),
}

/// A part that contradicts another.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Inconsistent(pub String);

impl Quantised {
    /// A network from its parts.
    ///
    /// # Errors
    /// [`Inconsistent`] when units are not numbered in order, an array has another size than its populations, a weight is
    /// not in its format, an endpoint does not exist or a target is an input.
    pub fn new(parts: Parts) -> Result<Self, Inconsistent> {
        let (mut channels, mut compartments) = (0u32, 0u32);
        for population in &parts.populations {
            let (first, counter) = match &population.units {
                Units::Input(first) => (first.0, &mut channels),
                Units::Compartments { first, .. } => (first.0, &mut compartments),
            };
            if first != *counter {
                return Err(Inconsistent(format!(
                    "population {} does not start where the last ended",
                    population.name
                )));
            }
            *counter += population.shape.len();
        }
        let mut outgoing: IdVec<PopulationId, Vec<ProjectionId>> = parts.populations.iter().map(|_| vec![]).collect();
        for (id, projection) in parts.projections.enumerate() {
            check_projection(&parts, projection)?;
            outgoing[projection.source].push(id);
        }
        match parts.populations.get(parts.output).map(|p| &p.units) {
            Some(Units::Compartments { .. }) => {}
            _ => return Err(Inconsistent("the output is not a population of compartments".to_string())),
        }
        Ok(Quantised { parts, channels, compartments, outgoing, pruned: None })
    }

    /// The network with the record of what was left out of it: of itself, or of one of its equal copies.
    ///
    /// # Errors
    /// [`Inconsistent`] when what the record says was kept is not what is there.
    pub fn with_record(mut self, pruned: Option<Arc<Pruned>>) -> Result<Self, Inconsistent> {
        if let Some(pruned) = &pruned {
            let before = pruned.original.populations();
            let copies = self.parts.populations.len() / before.len().max(1);
            let repeated = (0..copies).flat_map(|_| before.enumerate());
            let sizes = repeated.map(|(id, population)| match &pruned.kept[id] {
                Some(kept) => kept.len(),
                None => population.shape.len() as usize,
            });
            if !sizes.eq(self.parts.populations.iter().map(|population| population.shape.len() as usize)) {
                return Err(Inconsistent("the record of pruning is of another network".to_string()));
            }
        }
        self.pruned = pruned;
        Ok(self)
    }

    /// The same network as the result of a search over integers, whose rounding was chosen.
    #[must_use]
    pub fn with_chosen_rounding(mut self) -> Self {
        self.parts.notes.iter_mut().for_each(|note| note.rounded = None);
        self
    }

    /// The same populations without projections.
    #[must_use]
    pub fn without_projections(mut self) -> Self {
        self.parts.projections = IdVec::default();
        self.outgoing = self.parts.populations.iter().map(|_| Vec::new()).collect();
        self
    }

    /// What was left out, when the network was pruned.
    #[must_use]
    pub fn pruned(&self) -> Option<&Arc<Pruned>> {
        self.pruned.as_ref()
    }

    /// The network as it was before it was pruned: itself, unless it was; of several copies, one.
    #[must_use]
    pub fn original(&self) -> &Quantised {
        self.pruned.as_ref().map_or(self, |pruned| &pruned.original)
    }

    /// The indices that a population's compartments had before pruning, ascending; `None` when it lost none.
    #[must_use]
    pub fn kept(&self, population: PopulationId) -> Option<&[u32]> {
        let pruned = self.pruned.as_ref()?;
        let of_copy = PopulationId(population.0 % pruned.kept.len() as u32);
        pruned.kept[of_copy].as_deref()
    }

    /// The number of units that a population had before pruning.
    #[must_use]
    pub fn units_shown(&self, population: PopulationId) -> u32 {
        let original = self.original().populations();
        original[PopulationId(population.0 % original.len() as u32)].shape.len()
    }

    /// The index in its population by which people know a compartment: the one before pruning.
    #[must_use]
    pub fn index_shown(&self, population: PopulationId, index: u32) -> u32 {
        self.kept(population).map_or(index, |kept| kept[index as usize])
    }

    /// The inverse of [`Quantised::index_shown`]; `None` for a compartment that was pruned or never was.
    #[must_use]
    pub fn index_of_shown(&self, population: PopulationId, shown: u32) -> Option<u32> {
        match self.kept(population) {
            Some(kept) => kept.binary_search(&shown).ok().map(|index| index as u32),
            None => (shown < self.units_shown(population)).then_some(shown),
        }
    }

    /// The parts.
    #[must_use]
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// Populations in the order of the file.
    #[must_use]
    pub fn populations(&self) -> &IdVec<PopulationId, Population> {
        &self.parts.populations
    }

    /// Projections in the order of the file.
    #[must_use]
    pub fn projections(&self) -> &IdVec<ProjectionId, Projection> {
        &self.parts.projections
    }

    /// Input channels of all input populations.
    #[must_use]
    pub fn channels(&self) -> u32 {
        self.channels
    }

    /// Compartments of all populations.
    #[must_use]
    pub fn compartments(&self) -> u32 {
        self.compartments
    }

    /// Projections that leave a population, in the order of the file.
    #[must_use]
    pub fn outgoing(&self, population: PopulationId) -> &[ProjectionId] {
        &self.outgoing[population]
    }

    /// Projections that leave a population, each with the first compartment of its target.
    pub fn targets_of(
        &self,
        population: PopulationId,
    ) -> impl Iterator<Item = (ProjectionId, &Projection, CompartmentId)> {
        self.outgoing[population].iter().filter_map(|&id| {
            let projection = &self.parts.projections[id];
            Some((id, projection, self.parts.populations[projection.target].first_compartment()?))
        })
    }

    /// Input populations in order.
    pub fn inputs(&self) -> impl Iterator<Item = (PopulationId, &Population)> {
        self.parts.populations.enumerate().filter(|(_, p)| matches!(p.units, Units::Input(_)))
    }

    /// A population by name.
    #[must_use]
    pub fn population_named(&self, name: &str) -> Option<PopulationId> {
        self.parts.populations.enumerate().find(|(_, p)| p.name == name).map(|(id, _)| id)
    }

    /// The population of a compartment, and the compartment's index in it.
    ///
    /// # Panics
    /// When the compartment is not of this network.
    #[must_use]
    pub fn population_of(&self, compartment: CompartmentId) -> (PopulationId, u32) {
        self.parts
            .populations
            .enumerate()
            .filter_map(|(id, p)| Some((id, compartment.0.checked_sub(p.first_compartment()?.0)?, p.shape.len())))
            .find(|&(_, index, len)| index < len)
            .map(|(id, index, _)| (id, index))
            .expect("compartments are numbered over the populations")
    }

    /// Every source of spikes: channels, then compartments.
    pub fn sources(&self) -> impl Iterator<Item = SpikeSource> + use<> {
        let channels = (0..self.channels).map(|c| SpikeSource::Channel(ChannelId(c)));
        channels.chain((0..self.compartments).map(|c| SpikeSource::Compartment(CompartmentId(c))))
    }

    /// The number of synapses.
    #[must_use]
    pub fn synapses(&self) -> u64 {
        self.parts.projections.ids().map(|id| self.synapses_of(id)).sum()
    }

    /// The number of synapses of a projection.
    #[must_use]
    pub fn synapses_of(&self, projection: ProjectionId) -> u64 {
        let projection = &self.parts.projections[projection];
        let sources = u64::from(self.parts.populations[projection.source].shape.len());
        match &projection.connectivity {
            // What is the same for every source, or listed, need not be counted one by one.
            Connectivity::Dense { targets: each, .. } | Connectivity::Random { fan_out: each, .. } => {
                u64::from(*each) * sources
            }
            Connectivity::Sparse { targets, .. } => targets.len() as u64,
            Connectivity::Conv2d { window, .. } => {
                window.positions() * u64::from(window.target.0) * u64::from(window.source.0 / window.groups)
            }
            Connectivity::SumPool2d { window, .. } => window.positions() * u64::from(window.source.0),
        }
    }
}

/// The target of synapse k of a source whose synapses are drawn.
#[inline]
fn drawn_target(targets: u32, seed: u64, source: u64, k: u64) -> u32 {
    rng::below(u64::from(targets), seed, source, 2 * k) as u32
}

/// Its weight, one of low, low + step, .. up to high.
#[inline]
fn drawn_weight((low, high, step): (i16, i16, i16), seed: u64, source: u64, k: u64) -> i16 {
    let levels = ((i32::from(high) - i32::from(low)) / i32::from(step) + 1) as u64;
    low + step * rng::below(levels, seed, source, 2 * k + 1) as i16
}

fn check_projection(parts: &Parts, projection: &Projection) -> Result<(), Inconsistent> {
    let wrong = |what: &str| Err(Inconsistent(format!("projection {}: {what}", projection.name)));
    let (Some(source), Some(target)) =
        (parts.populations.get(projection.source), parts.populations.get(projection.target))
    else {
        return wrong("an endpoint does not exist");
    };
    if matches!(target.units, Units::Input(_)) {
        return wrong("the target is an input");
    }
    if projection.format.bits.get() == 7 {
        return wrong("weights of 7 bits cannot be stored");
    }
    let (sources, targets) = (source.shape.len() as usize, target.shape.len());
    let (low, high) = projection.format.sign.range(projection.format.bits);
    let step = projection.format.sign.step(projection.format.bits);
    let fits = |w: i16| (low..=high).contains(&w) && w % step == 0;
    match &projection.connectivity {
        Connectivity::Dense { targets: n, weights } => {
            if *n != targets || weights.len() != sources * targets as usize {
                return wrong("the weights do not fill sources x targets");
            }
            if !weights.iter().all(|&w| fits(w)) {
                return wrong("a weight is not in its format");
            }
        }
        Connectivity::Sparse { first, targets: to, weights } => {
            let ordered =
                first.len() == sources + 1 && first.windows(2).all(|w| w[0] <= w[1]) && first.first() == Some(&0);
            if !ordered || first.last() != Some(&(to.len() as u64)) || to.len() != weights.len() {
                return wrong("the synapse list is not closed");
            }
            if to.iter().any(|&t| t >= targets) || !weights.iter().all(|&w| fits(w)) {
                return wrong("a synapse leaves its population or its format");
            }
        }
        Connectivity::Conv2d { window, kernel } => {
            let per_group = window.source.0 / window.groups.max(1);
            let size = (window.target.0 * per_group * window.kernel.0 * window.kernel.1) as usize;
            if !window_fits(window, source.shape, target.shape) || kernel.len() != size {
                return wrong("the window does not fit its populations");
            }
            if !kernel.iter().all(|&w| fits(w)) {
                return wrong("a weight is not in its format");
            }
        }
        Connectivity::SumPool2d { window, weight } => {
            if !window_fits(window, source.shape, target.shape) || window.source.0 != window.target.0 || !fits(*weight)
            {
                return wrong("the window does not fit its populations");
            }
        }
        Connectivity::Random { targets: n, low: l, high: h, step: s, .. } => {
            if *n != targets || !fits(*l) || !fits(*h) || l > h || *s != step {
                return wrong("the range of weights is not in its format");
            }
        }
    }
    Ok(())
}

fn window_fits(window: &Window, source: Shape, target: Shape) -> bool {
    source.volume() == Some(window.source)
        && target.volume() == Some(window.target)
        && window.groups > 0
        && window.stride.0 > 0
        && window.stride.1 > 0
        && window.dilation.0 > 0
        && window.dilation.1 > 0
        && window.source.0.is_multiple_of(window.groups)
        && window.target.0.is_multiple_of(window.groups)
}
