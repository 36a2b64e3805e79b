//! The network in integers that fit their hardware fields, before it is mapped to cores.
//!
//! `nsim_quantise::quantise` makes a [`Quantised`]. Invariants: each weight is a multiple of its
//! format's least step within the format's range, each parameter fits its field. Compartments and
//! channels are numbered without gaps in the order of the populations. Synapses may be stored as a
//! kernel or a seed, and are enumerated source by source.

pub mod connectivity;

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::connectivity::{Connectivity, SeparateSum, SynapseFormat};
use crate::arithmetic::{ReadOut, Semantics, ThresholdTest};
use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Delay, Refractory, ThresholdMantissa, VmaxExponent, VminExponent, WeightExponent,
};
use crate::base::id::{ChannelId, CompartmentId, Id, IdVec, PopulationId, ProjectionId, RuleId};
use crate::base::warning::Warning;
use crate::graph::{PerCompartment, Shape};
use crate::learning::{Learning, LearningSemantics, Plastic, Variable};
use crate::neurons::{Emits, NeuronKind, ParameterRow, Role, Stack, Storage};
use crate::pruned;
use crate::spikes::Message;

/// Parameters of one compartment: its kind, and the contents of its registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Neuron {
    /// The kind, which sets the rule of its updates.
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
    /// Bits by which lava shifts the arrivals of a step; 0 under other semantics, and for kinds
    /// without these registers.
    pub shift: u8,
    /// Its use of the stack of its neuron; [`Quantised::new`] sets it from [`Parts::children`].
    #[serde(skip_serializing_if = "Stack::is_unused")]
    pub stack: Stack,
    /// The parameters of a kind without these registers.
    pub row: ParameterRow,
}

impl Neuron {
    /// The default parameters: a Loihi compartment without memory and bias, with the greatest
    /// threshold and the widest clips.
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
        shift: 0,
        stack: Stack::UNUSED,
        row: ParameterRow::EMPTY,
    };

    /// The parameter of this name in model files, 0 where the kind has none.
    pub fn parameter(&self, name: &str) -> i64 {
        if !self.kind.table().registers {
            let place = self.kind.parameters().iter().position(|parameter| parameter.name == name);
            return place.map_or(0, |place| self.row.0[place].into());
        }
        match name {
            "du" => self.du.into(),
            "dv" => self.dv.into(),
            "vth_mant" => self.vth.into(),
            "bias_mant" => self.bias_mant.into(),
            "bias_exp" => self.bias_exp.into(),
            "refractory" => self.refractory.into(),
            "vmin_exp" => self.vmin.into(),
            "vmax_exp" => self.vmax.into(),
            _ => 0,
        }
    }

    /// The parameters of its compartment profile, of which a core has a limited number.
    pub fn profile(&self) -> (Decay, Decay, Refractory, Stack, ParameterRow) {
        (self.du, self.dv, self.refractory, self.stack, self.row.stored_in(self.kind, Storage::Profile))
    }

    /// The parameters of its threshold profile, of which a core has a limited number.
    pub fn threshold(&self) -> (ThresholdMantissa, ParameterRow) {
        (self.vth, self.row.stored_in(self.kind, Storage::Threshold))
    }
}

/// A text takes the fields that it omits from [`Neuron::PLAIN`].
impl Default for Neuron {
    fn default() -> Self {
        Neuron::PLAIN
    }
}

/// The parameters of a population's compartments.
pub type Neurons = PerCompartment<Neuron>;

/// The units of a population.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum Units {
    /// Input channels from this channel on.
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
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Population {
    /// Its name.
    pub name: String,
    /// Its shape.
    pub shape: Shape,
    /// Its units.
    pub units: Units,
    /// The content of its messages.
    #[serde(default)]
    pub message: Message,
}

impl Population {
    /// The first compartment, when it has compartments.
    pub fn first_compartment(&self) -> Option<CompartmentId> {
        match self.units {
            Units::Input(_) => None,
            Units::Compartments { first, .. } => Some(first),
        }
    }

    /// Its compartments, in order.
    fn compartments(&self) -> impl Iterator<Item = CompartmentId> + use<> {
        let all = self.first_compartment().map(|first| first.0..first.0 + self.shape.len());
        all.into_iter().flatten().map(CompartmentId)
    }

    /// The first channel, when it is an input.
    pub fn first_channel(&self) -> Option<ChannelId> {
        match self.units {
            Units::Input(first) => Some(first),
            Units::Compartments { .. } => None,
        }
    }

    /// The parameters of its compartments, when it has compartments.
    pub fn neurons(&self) -> Option<&Neurons> {
        match &self.units {
            Units::Input(_) => None,
            Units::Compartments { neurons, .. } => Some(neurons),
        }
    }

    /// The parameters of each compartment, in order.
    pub fn each_neuron(&self) -> impl Iterator<Item = Neuron> {
        let units = 0..self.shape.len();
        self.neurons().into_iter().flat_map(move |neurons| units.clone().map(move |index| neurons.get(index)))
    }

    /// The longest refractory period of its compartments; 0 for inputs.
    pub fn longest_refractory(&self) -> u8 {
        let periods = self.neurons().into_iter().flat_map(PerCompartment::values);
        periods.map(|neuron| neuron.refractory.get()).max().unwrap_or(0)
    }

    /// The kind of its neurons; `None` for inputs.
    pub fn neuron_kind(&self) -> Option<NeuronKind> {
        self.neurons()?.values().first().map(|neuron| neuron.kind)
    }

    /// The use of the stack by its compartments.
    pub fn stack(&self) -> Stack {
        self.neurons().and_then(|neurons| neurons.values().first()).map_or(Stack::UNUSED, |neuron| neuron.stack)
    }

    /// The kind of its neurons, a compartment of Loihi 1 for inputs.
    pub fn kind(&self) -> NeuronKind {
        self.neurons().and_then(|neurons| neurons.values().first()).map_or(NeuronKind::Loihi, |neuron| neuron.kind)
    }

    /// Whether `is_so` is true of any compartment.
    pub fn any_neuron(&self, is_so: impl Fn(&Neuron) -> bool) -> bool {
        self.neurons().is_some_and(|neurons| neurons.any(is_so))
    }
}

/// A population of child compartments: compartment i and compartment i of the parent are one
/// neuron.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Child {
    /// The population of the children.
    pub population: PopulationId,
    /// The population of their parents, which comes later in the network.
    pub parent: PopulationId,
    /// The parents' use of the voltages that the children push.
    pub role: Role,
}

/// The most compartments of a neuron: no public code uses more.
pub const MOST_COMPARTMENTS: usize = 4;

/// A projection in integers.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Projection {
    /// `source -> target`.
    pub name: String,
    /// Source population.
    pub source: PopulationId,
    /// Target population.
    pub target: PopulationId,
    /// Storage format of its synapses.
    pub format: SynapseFormat,
    /// Delay field of every synapse, at first where its rule changes delays.
    pub delay: Delay,
    /// Its synapses.
    pub connectivity: Connectivity,
    /// The state of its synapses besides weights and delays, where a rule changes them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plastic: Option<Arc<Plastic>>,
}

/// A change or loss by quantisation, reported to the user.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct Note {
    /// The population or projection.
    pub entity: String,
    /// The change.
    pub message: String,
    /// The rounding, if weights were rounded.
    pub rounded: Option<Rounded>,
}

/// Rounding of the weights of a projection.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
pub struct Rounded {
    /// Whether the weights were real numbers, not mantissas.
    pub real: bool,
    /// Number of changed weights.
    pub changed: u64,
    /// Number of all weights.
    pub weights: u64,
    /// The greatest change, as a share of the greatest weight.
    pub worst_share: f64,
}

/// The periodic reset of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub struct Reset {
    /// Timesteps between two resets, at least 1.
    pub interval: u32,
    /// Timesteps from each population's start step to the first reset.
    pub offset: u32,
}

/// The compartments that decide a sample, and the score by which they do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Output {
    /// The first compartment.
    pub first: CompartmentId,
    /// Number of compartments.
    pub count: u32,
    /// The score that decides.
    pub decision: ReadOut,
    /// The step before which they are held at zero, and do not decide.
    pub start_step: u32,
}

/// Parts of a [`Quantised`] network.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct Parts {
    /// The network's name.
    pub name: String,
    /// Milliseconds that a timestep represents.
    pub timestep_ms: f64,
    /// Populations in the order of the file.
    pub populations: IdVec<PopulationId, Population>,
    /// Projections in the order of the file.
    pub projections: IdVec<ProjectionId, Projection>,
    /// Populations whose compartments are children in the neurons of another, by parent.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub children: Vec<Child>,
    /// Learning rules of the plastic projections.
    #[serde(skip_serializing_if = "IdVec::is_empty")]
    pub rules: IdVec<RuleId, Learning>,
    /// The output population.
    pub output: PopulationId,
    /// The score that decides.
    pub decision: ReadOut,
    /// Steps of a sample after its last input step.
    pub drain: u32,
    /// Names of classes; may be empty.
    pub classes: Vec<String>,
    /// The arithmetic.
    pub semantics: Semantics,
    /// The threshold test.
    pub threshold: ThresholdTest,
    /// Periodic reset.
    pub reset: Option<Reset>,
    /// Changes by quantisation.
    pub notes: Vec<Note>,
    /// Assumptions and losses of the reader, and changes of what the model states.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub warnings: Vec<Warning>,
    /// Whether sources may be grouped into population axons where a compartment has more of them
    /// than a core has input axons.
    pub gathers: bool,
}

/// No populations, in the chip's semantics, with timesteps of 1 ms.
impl Default for Parts {
    fn default() -> Self {
        Parts {
            name: String::new(),
            timestep_ms: 1.0,
            populations: Default::default(),
            projections: Default::default(),
            children: Vec::new(),
            rules: IdVec::new(),
            output: PopulationId(0),
            decision: ReadOut::Spikes,
            drain: 0,
            classes: Vec::new(),
            semantics: Semantics::Hardware,
            threshold: ThresholdTest::Strict,
            reset: None,
            notes: Vec::new(),
            warnings: Vec::new(),
            gathers: false,
        }
    }
}

/// The network in integers.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(try_from = "Text")]
pub struct Quantised {
    parts: Parts,
    #[serde(skip)]
    channels: u32,
    #[serde(skip)]
    compartments: u32,
    #[serde(skip)]
    outgoing: IdVec<PopulationId, Vec<ProjectionId>>,
    #[serde(skip)]
    incoming: IdVec<PopulationId, Vec<ProjectionId>>,
    /// The populations of compartments with their first compartments, ascending.
    #[serde(skip)]
    firsts: Vec<(u32, PopulationId)>,
    pruned: Option<Arc<Pruned>>,
}

/// Serialised form of a [`Quantised`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename = "Quantised")]
struct Text {
    parts: Parts,
    #[serde(default)]
    pruned: Option<Arc<Pruned>>,
}

impl TryFrom<Text> for Quantised {
    type Error = Inconsistent;

    fn try_from(Text { parts, pruned }: Text) -> Result<Self, Inconsistent> {
        Quantised::new(parts)?.with_record(pruned)
    }
}

/// The pruned parts of a network, and its sizes before pruning.
///
/// A pruned network is an ordinary network, smaller and renumbered, so every later stage takes it
/// unchanged. By this record users still see the populations, shapes and numbers of their model
/// file. Input populations always keep their channels. A population that lost compartments keeps
/// its name and place, even when it is empty.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub struct Pruned {
    /// Sizes of the network before pruning; sizes of one copy where there are several.
    pub before: pruned::Sizes,
    /// For each population that lost compartments, the indices of those that remain, ascending.
    pub kept: IdVec<PopulationId, Option<Vec<u32>>>,
    /// Populations that stayed whole because they are probed.
    pub probed: Vec<PopulationId>,
    /// Origin of the stimulus that it was pruned for; `None` when it was pruned for every stimulus.
    pub stimulus: Option<Vec<String>>,
    /// Channels that the stimulus never fires, ascending.
    pub dead: Vec<ChannelId>,
    /// The pruned parts, a row for each kind that was searched for.
    pub rows: Vec<pruned::Row>,
}

impl Pruned {
    /// Number of pruned parts of a kind.
    pub fn count(&self, kind: pruned::Kind) -> u64 {
        self.rows.iter().filter(|row| row.kind == kind).map(|row| row.count).sum()
    }
}

/// A source of spikes: an input channel or a compartment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SpikeSource {
    /// An input channel.
    Channel(ChannelId),
    /// A compartment.
    Compartment(CompartmentId),
}

/// Error of parts that contradict each other.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct Inconsistent(pub String);

impl Quantised {
    /// A network from its parts.
    ///
    /// # Errors
    /// [`Inconsistent`] when units are not numbered in order, an array has another size than its
    /// populations, or a weight has another format. Also when an endpoint does not exist, a target
    /// is an input, a projection cannot be plastic or a population cannot be the child of another.
    pub fn new(mut parts: Parts) -> Result<Self, Inconsistent> {
        let (mut channels, mut compartments) = (0u32, 0u32);
        for population in &parts.populations {
            let wrong = |what: &str| Err(Inconsistent(format!("population {} {what}", population.name)));
            let (first, counter) = match &population.units {
                Units::Input(first) => (first.0, &mut channels),
                Units::Compartments { first, .. } => (first.0, &mut compartments),
            };
            if first != *counter {
                return wrong("does not start where the last ended");
            }
            let Some(end) = population.shape.checked_len().and_then(|units| first.checked_add(units)) else {
                return wrong("has more units than can be numbered");
            };
            if let Units::Compartments { neurons, .. } = &population.units {
                if matches!(neurons, PerCompartment::Each(each) if each.len() != population.shape.len() as usize) {
                    return wrong("has not the parameters of one neuron for each compartment");
                }
                let values = matches!(population.message, Message::Value(_));
                fn computes(neuron: &Neuron) -> bool {
                    neuron.kind.table().emits == Emits::Values
                }
                if population.message != Message::Spike && neurons.any(|neuron| computes(neuron) != values) {
                    return wrong("sends messages that its neurons do not have");
                }
            }
            *counter = end;
        }
        if parts.reset.is_some_and(|reset| reset.interval == 0) {
            return Err(Inconsistent("the periodic reset has no interval".to_string()));
        }
        join_children(&mut parts)?;
        let none = || parts.populations.iter().map(|_| Vec::new()).collect();
        let (mut outgoing, mut incoming): (IdVec<_, Vec<_>>, IdVec<_, Vec<_>>) = (none(), none());
        let mut plastic = BTreeSet::new();
        for (id, projection) in parts.projections.enumerate() {
            check_projection(&parts, projection)?;
            let Projection { name, source, target, format, delay, .. } = projection;
            if format.is_plastic() && !plastic.insert((*source, *target, *format, *delay)) {
                let what = "another plastic projection has its ends, format and delay, so that synapses of the two \
                            could not be identified; make them one, or give one another delay";
                return Err(Inconsistent(format!("projection {name}: {what}")));
            }
            outgoing[projection.source].push(id);
            incoming[projection.target].push(id);
        }
        let firsts = parts.populations.enumerate().filter_map(|(id, p)| Some((p.first_compartment()?.0, id))).collect();
        if parts.populations.get(parts.output).and_then(Population::first_compartment).is_none() {
            return Err(Inconsistent("the output is not a population of compartments".to_string()));
        }
        Ok(Quantised { parts, channels, compartments, outgoing, incoming, firsts, pruned: None })
    }

    /// Adds the record of the pruning of this network, or of one of its equal copies.
    ///
    /// # Errors
    /// [`Inconsistent`] when the record's compartments are not the compartments of this network.
    pub fn with_record(mut self, pruned: Option<Arc<Pruned>>) -> Result<Self, Inconsistent> {
        if let Some(pruned) = &pruned {
            let before = &pruned.before.units;
            let copies = self.parts.populations.len() / before.len().max(1);
            let repeated = (0..copies).flat_map(|_| before.iter().zip(pruned.kept.iter()));
            let sizes = repeated.map(|(&units, kept)| kept.as_ref().map_or(units as usize, Vec::len));
            let mut ends = pruned.before.projections.iter().flat_map(|size| [size.source, size.target]);
            let closed = pruned.kept.len() == before.len() && ends.all(|end| end.index() < before.len());
            if !closed || !sizes.eq(self.parts.populations.iter().map(|population| population.shape.len() as usize)) {
                return Err(Inconsistent("the record of pruning is of another network".to_string()));
            }
        }
        self.pruned = pruned;
        Ok(self)
    }

    /// Returns this network, marked as the result of a search over integers, which chose its
    /// rounding.
    #[must_use]
    pub fn with_chosen_rounding(mut self) -> Self {
        self.parts.notes.iter_mut().for_each(|note| note.rounded = None);
        self
    }

    /// Returns this network with another warning.
    #[must_use]
    pub fn warned(mut self, warning: Warning) -> Self {
        self.parts.warnings.push(warning);
        self
    }

    /// The populations of the neurons of `root`, a population without parents: children first,
    /// `root` last.
    pub fn neuron(&self, root: PopulationId) -> Vec<PopulationId> {
        let child = |&id: &PopulationId| child_of(&self.parts.children, id).map(|child| child.population);
        let mut neuron: Vec<PopulationId> = std::iter::successors(Some(root), child).collect();
        neuron.reverse();
        neuron
    }

    /// Every compartment that is a child, its parent, and its role.
    pub fn children(&self) -> impl Iterator<Item = (CompartmentId, CompartmentId, Role)> {
        self.parts.children.iter().flat_map(|&Child { population, parent, role }| {
            let [children, parents] = [population, parent].map(|id| self.parts.populations[id].compartments());
            children.zip(parents).map(move |(child, parent)| (child, parent, role))
        })
    }

    /// Returns this network without projections.
    #[must_use]
    pub fn without_projections(mut self) -> Self {
        self.parts.projections = IdVec::default();
        self.outgoing.iter_mut().chain(self.incoming.iter_mut()).for_each(Vec::clear);
        self
    }

    /// The record of pruning; `None` when the network was not pruned.
    pub fn pruned(&self) -> Option<&Arc<Pruned>> {
        self.pruned.as_ref()
    }

    /// Sizes of the network before pruning; sizes of one copy where there are several.
    pub fn sizes_before(&self) -> Cow<'_, pruned::Sizes> {
        self.pruned.as_ref().map_or_else(|| Cow::Owned(self.sizes()), |pruned| Cow::Borrowed(&pruned.before))
    }

    /// Sizes of the network as it is.
    pub fn sizes(&self) -> pruned::Sizes {
        let projections = self.parts.projections.enumerate().map(|(id, projection)| pruned::ProjectionSize {
            source: projection.source,
            target: projection.target,
            synapses: self.synapses_of(id),
            dense: matches!(projection.connectivity, Connectivity::Dense { .. }),
        });
        pruned::Sizes {
            units: self.parts.populations.iter().map(|population| population.shape.len()).collect(),
            projections: projections.collect(),
        }
    }

    /// The indices that a population's compartments had before pruning, ascending; `None` when it
    /// lost none.
    pub fn kept_units(&self, population: PopulationId) -> Option<&[u32]> {
        let pruned = self.pruned.as_ref()?;
        let of_copy = PopulationId(population.0 % pruned.kept.len() as u32);
        pruned.kept[of_copy].as_deref()
    }

    /// The number of units that a population had before pruning.
    pub fn units_before_pruning(&self, population: PopulationId) -> u32 {
        let Some(pruned) = &self.pruned else { return self.parts.populations[population].shape.len() };
        pruned.before.units[PopulationId(population.0 % pruned.kept.len() as u32)]
    }

    /// The index by which users know a compartment in its population: its index before pruning.
    pub fn index_before_pruning(&self, population: PopulationId, index: u32) -> u32 {
        self.kept_units(population).map_or(index, |kept| kept[index as usize])
    }

    /// The inverse of [`Quantised::index_before_pruning`]; `None` for a pruned or absent one.
    pub fn index_after_pruning(&self, population: PopulationId, before: u32) -> Option<u32> {
        match self.kept_units(population) {
            Some(kept) => kept.binary_search(&before).ok().map(|index| index as u32),
            None => (before < self.units_before_pruning(population)).then_some(before),
        }
    }

    /// The parts.
    pub fn parts(&self) -> &Parts {
        &self.parts
    }

    /// The output compartments.
    ///
    /// # Panics
    /// Never: the constructor has checked that the output has compartments.
    pub fn output(&self) -> Output {
        let (output, decision) = (&self.parts.populations[self.parts.output], self.parts.decision);
        let Units::Compartments { first, start_step, .. } = output.units else {
            unreachable!("checked by the constructor")
        };
        // SLAYER's loop starts at step 1.
        let least = u32::from(self.parts.semantics == Semantics::Slayer);
        Output { first, count: output.shape.len(), decision, start_step: start_step.max(least) }
    }

    /// Whether the output decides a class: values that it sends do not, unless the model names
    /// classes.
    pub fn decides(&self) -> bool {
        let output = &self.parts.populations[self.parts.output];
        self.parts.decision != ReadOut::Spikes || output.message.bits() == 0 || !self.parts.classes.is_empty()
    }

    /// Populations in the order of the file.
    pub fn populations(&self) -> &IdVec<PopulationId, Population> {
        &self.parts.populations
    }

    /// Projections in the order of the file.
    pub fn projections(&self) -> &IdVec<ProjectionId, Projection> {
        &self.parts.projections
    }

    /// Number of channels of all input populations.
    pub fn channels(&self) -> u32 {
        self.channels
    }

    /// Number of compartments of all populations.
    pub fn compartments(&self) -> u32 {
        self.compartments
    }

    /// Projections whose weights a run may change, in the order of the file.
    pub fn plastic(&self) -> impl Iterator<Item = (ProjectionId, &Projection)> {
        self.parts.projections.enumerate().filter(|(_, projection)| projection.format.is_plastic())
    }

    /// Projections that leave a population, in the order of the file.
    pub fn outgoing(&self, population: PopulationId) -> &[ProjectionId] {
        &self.outgoing[population]
    }

    /// Projections into a population, in the order of the file.
    pub fn incoming(&self, population: PopulationId) -> impl Iterator<Item = (ProjectionId, &Projection)> + Clone {
        self.incoming[population].iter().map(|&id| (id, &self.parts.projections[id]))
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
    pub fn population_named(&self, name: &str) -> Option<PopulationId> {
        self.parts.populations.enumerate().find(|(_, p)| p.name == name).map(|(id, _)| id)
    }

    /// The number of a population's first unit as a source of spikes: channels are numbered first,
    /// then compartments.
    pub fn first_source(&self, population: &Population) -> u32 {
        match &population.units {
            Units::Input(first) => first.0,
            Units::Compartments { first, .. } => self.channels + first.0,
        }
    }

    /// The population of a compartment, and the compartment's index in it.
    ///
    /// # Panics
    /// When the compartment is not of this network.
    pub fn population_of(&self, compartment: CompartmentId) -> (PopulationId, u32) {
        // Of populations that begin at one compartment, all but the last are empty.
        let after = self.firsts.partition_point(|&(first, _)| first <= compartment.0);
        let (first, id) = self.firsts[after - 1];
        assert!(compartment.0 < self.compartments, "compartments are numbered over the populations");
        (id, compartment.0 - first)
    }

    /// The number of synapses.
    pub fn synapses(&self) -> u64 {
        self.parts.projections.ids().map(|id| self.synapses_of(id)).sum()
    }

    /// The number of synapses of a projection.
    pub fn synapses_of(&self, projection: ProjectionId) -> u64 {
        let projection = &self.parts.projections[projection];
        projection.connectivity.count(self.parts.populations[projection.source].shape.len().into())
    }
}

/// The child of a parent, if any; `children` are ordered by parent.
fn child_of(children: &[Child], parent: PopulationId) -> Option<&Child> {
    children.binary_search_by_key(&parent, |child| child.parent).ok().map(|at| &children[at])
}

/// Checks children and their parents, and sets each compartment's use of the stack.
fn join_children(parts: &mut Parts) -> Result<(), Inconsistent> {
    parts.children.sort_unstable_by_key(|child| child.parent);
    if !parts.children.is_empty() && (parts.semantics, parts.threshold) != (Semantics::Hardware, ThresholdTest::Strict)
    {
        let what = "neurons of several compartments need the chip's semantics and a strict threshold";
        return Err(Inconsistent(what.to_string()));
    }
    let (children, mut pushing, mut sizes) = (&parts.children, BTreeSet::new(), BTreeMap::new());
    for (at, &Child { population: id, parent, .. }) in children.iter().enumerate() {
        let (Some(child), Some(above)) = (parts.populations.get(id), parts.populations.get(parent)) else {
            return Err(Inconsistent("a child or its parent does not exist".to_string()));
        };
        let wrong =
            |what: &str| Err(Inconsistent(format!("population {} as a child of {}: {what}", child.name, above.name)));
        let (
            Units::Compartments { neurons: pushes, start_step: begins, .. },
            Units::Compartments { neurons: pops, start_step, .. },
        ) = (&child.units, &above.units)
        else {
            return wrong("inputs have no compartments");
        };
        if id >= parent {
            return wrong("a child stands before its parent, so that there is no circle");
        }
        if !pushing.insert(id) {
            return wrong("it has another parent");
        }
        if at > 0 && children[at - 1].parent == parent {
            return wrong("its parent has another child");
        }
        if (child.shape, begins) != (above.shape, start_step) {
            return wrong("their shapes or start steps differ");
        }
        let mut kinds = pushes.values().iter().chain(pops.values()).map(|neuron| neuron.kind);
        if let Some(kind) = kinds.find(|kind| *kind != NeuronKind::Loihi) {
            return wrong(&format!("{} neurons neither push nor add", kind.name()));
        }
        if pushes.any(|neuron| neuron.refractory > Refractory::ONE) {
            return wrong("the value that it pushes is not known with a refractory period above 1");
        }
        // Parents ascend, so the compartments below a child have been counted.
        let size = 1 + sizes.get(&id).copied().unwrap_or(1);
        if size > MOST_COMPARTMENTS {
            return wrong(&format!("a neuron has {MOST_COMPARTMENTS} compartments at most"));
        }
        sizes.insert(parent, size);
    }
    for id in parts.populations.ids() {
        let pops = child_of(&parts.children, id).map(|child| child.role);
        let stack = Stack { pops, pushes: pushing.contains(&id) };
        let population = &mut parts.populations[id];
        if population.stack() != stack
            && let Units::Compartments { neurons, .. } = &mut population.units
        {
            *neurons = neurons.try_map(|_, neuron| Ok::<_, Inconsistent>(Neuron { stack, ..neuron }))?;
        }
    }
    Ok(())
}

fn check_projection(parts: &Parts, projection: &Projection) -> Result<(), Inconsistent> {
    let wrong = |what: &str| Inconsistent(format!("projection {}: {what}", projection.name));
    let (Some(source), Some(target)) =
        (parts.populations.get(projection.source), parts.populations.get(projection.target))
    else {
        return Err(wrong("an endpoint does not exist"));
    };
    let neurons = target.neurons().ok_or_else(|| wrong("the target is an input"))?;
    if neurons.any(|neuron| projection.format.port.index() >= usize::from(neuron.kind.table().ports)) {
        return Err(wrong("its targets have no such port"));
    }
    let (exponent, apart) = (projection.format.exponent, projection.format.apart);
    if apart.is_some_and(|apart| usize::from(apart.number) >= SeparateSum::MOST)
        || apart.is_some() && neurons.any(|neuron| neuron.kind.table().registers)
    {
        return Err(wrong("its targets have no such sum"));
    }
    if exponent < WeightExponent::ZERO
        && apart.is_none()
        && neurons.any(|neuron| !neuron.kind.table().registers)
        && (projection.format.is_plastic() || !projection.connectivity.all_multiples_of(exponent.lost()))
    {
        return Err(wrong("weights lose bits on their way to neurons that sum them as they are"));
    }
    if projection.format.is_plastic() && projection.connectivity.window().is_some() {
        return Err(wrong(
            "a plastic weight of a kernel would belong to several synapses; list the synapses one by one",
        ));
    }
    projection.connectivity.check(projection.format, source.shape, target.shape).map_err(wrong)?;
    check_plastic(parts, projection).map_err(wrong)
}

/// Checks the plastic state of a projection, whose synapses are closed.
fn check_plastic(parts: &Parts, projection: &Projection) -> Result<(), &'static str> {
    let plastic = match (projection.format.rule, &projection.plastic) {
        (None, None) => return Ok(()),
        (Some(rule), Some(plastic)) if plastic.rule == rule => plastic,
        _ => return Err("its format and its plastic state name different rules"),
    };
    let Some(learning) = parts.rules.get(plastic.rule) else { return Err("its rule does not exist") };
    let (source, target) = (&parts.populations[projection.source], &parts.populations[projection.target]);
    let synapses = projection.connectivity.count(source.shape.len().into()) as usize;
    let fills = |values: &[i16]| values.is_empty() || values.len() == synapses;
    if plastic.rows.len() != synapses || !fills(&plastic.tags) || !fills(&plastic.delays) {
        return Err("its plastic state has not one value for each synapse");
    }
    let semantics = learning.rule.semantics();
    if semantics.delays_act() && !plastic.delays.is_empty() {
        return Err("its delays act, so they are the delays of its synapses");
    }
    if semantics.delays_act() && learning.rule.changes(Variable::Delay) && projection.format.apart.is_some() {
        return Err("its rule changes delays, by which its target sums arrivals separately");
    }
    fn within(values: &[i16], (low, high): (i32, i32)) -> bool {
        values.iter().all(|&v| (low..=high).contains(&v.into()))
    }
    if !within(&plastic.tags, semantics.tags()) || !within(&plastic.delays, semantics.delays()) {
        return Err("a first tag or delay is out of range");
    }
    if plastic.reward.is_some_and(|reward| parts.populations.get(reward).is_none()) {
        return Err("the population of its reward does not exist");
    }
    if learning.rule.is_pes() {
        let error = plastic.signals[0].and_then(|signal| parts.populations.get(signal));
        let pairs = |error: &Population| 2 * u64::from(error.shape.len()) == u64::from(target.shape.len());
        return match error.filter(|error| matches!(error.units, Units::Input(_)) && pairs(error)) {
            Some(_) if plastic.signals[1..] == [None, None] => Ok(()),
            _ => Err("its error is no input population of one value for each pair of targets"),
        };
    }
    if semantics == LearningSemantics::Brian && plastic.signals != [None; 3] {
        return Err("its semantics lack signals");
    }
    for signal in plastic.signals.into_iter().flatten() {
        let one_or_each = |population: &Population| [1, target.shape.len()].contains(&population.shape.len());
        if !parts.populations.get(signal).is_some_and(|p| matches!(p.units, Units::Input(_)) && one_or_each(p)) {
            return Err("a signal is no input population of one value, or of one for each target");
        }
    }
    Ok(())
}
