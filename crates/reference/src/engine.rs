//! A network of real-valued neurons, step by step.
//!
//! [`Model`] is the prepared network, shared by all samples; [`Reference`] is the state of one run
//! over it. Channels and compartments are numbered over the populations in the order of the file.
//! Spikes travel as in the machine (`docs/semantics.md`, 1 and 2): input spikes of step t arrive in
//! the update of step t + d, compartments' spikes in the update of step t + 1 + d. Spikes of an
//! input reach spike response neurons a step later, from step t + 1 + d on, as SLAYER's kernels are
//! 0 at t = 0.

use petgraph::graph::NodeIndex;

use super::cuba::Cuba;
use super::kernel::Kernel;
use super::real::Real;
use super::srm::{self, Srm};
use super::synapses::{SumOrder, Synapses};
use nsim_dynamics as neuron;
use nsim_dynamics::RealForm;
use nsim_dynamics::arithmetic::falls_on;
use nsim_ir::activity::{Overflow, Totals};
use nsim_ir::arithmetic::{Semantics, ThresholdTest};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::graph::{Graph, PopulationKind, SrmParameters};
use nsim_ir::quantised::Reset;
use nsim_ir::spikes::{Engine, Spikes};

/// Options of a run.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Options {
    /// Method by which spike response kernels are applied.
    pub kernel: Kernel,
}

/// Neurons of a population.
#[derive(Debug, Clone)]
enum Kind {
    Input,
    Srm(srm::Parameters),
    Cuba(Vec<RealForm>),
}

#[derive(Debug, Clone)]
struct Population {
    kind: Kind,
    /// First channel or compartment, and number of units.
    first: u32,
    count: u32,
    order: SumOrder,
    /// Number of steps before the first update, in which neurons are held at zero.
    start_step: u32,
    /// Step from which resets are counted.
    resets_from: u32,
}

#[derive(Debug)]
struct Projection<F> {
    target: usize,
    /// Latency in steps from a spike to its arrival, at least 1 for a compartment's spike.
    latency: u32,
    synapses: Synapses<F>,
}

/// A network of real-valued neurons.
#[derive(Debug)]
pub struct Model<F> {
    populations: Vec<Population>,
    /// Indices of the populations without and with compartments.
    inputs: Vec<usize>,
    layers: Vec<usize>,
    /// Projections by source population.
    projections: Vec<Vec<Projection<F>>>,
    channels: u32,
    compartments: u32,
    options: Options,
    test: ThresholdTest,
    reset: Option<Reset>,
    /// Number of arrival slots.
    slots: usize,
}

impl<F: Real> Model<F> {
    /// Prepares a network.
    ///
    /// # Errors
    /// `model.no-real-form` for neurons without a real form.
    pub fn new(graph: &Graph, options: Options) -> Result<Self, Diagnostic> {
        graph.has_real_form()?;
        let facts = graph.facts();
        let (mut channels, mut compartments) = (0, 0);
        let mut populations = Vec::new();
        for (node, population) in graph.populations() {
            let count = population.shape.len();
            let counter =
                if matches!(population.kind, PopulationKind::Input) { &mut channels } else { &mut compartments };
            let (kind, resets_from) = match &population.kind {
                PopulationKind::Input => (Kind::Input, 0),
                PopulationKind::Srm(srm) => (Kind::Srm(in_steps(srm, facts.timestep_ms)), 0),
                PopulationKind::Neurons(p) => {
                    let neurons = (0..count).map(|i| neuron::model(p, i, facts.timestep_ms, facts.semantics)).collect();
                    (Kind::Cuba(neurons), p.start_step)
                }
            };
            // SLAYER's loop starts at step 1; its resets are counted from the declared step.
            let skipped = matches!(kind, Kind::Cuba(_)) && facts.semantics == Semantics::Slayer;
            let start_step = resets_from.max(u32::from(skipped));
            debug_assert_eq!(node.index(), populations.len());
            let incoming = graph.projections().filter(|(_, _, target, _)| *target == node).map(|(.., p)| p);
            let order = SumOrder::for_projections(count, incoming);
            populations.push(Population { kind, first: *counter, count, order, start_step, resets_from });
            *counter += count;
        }
        let mut projections: Vec<Vec<Projection<F>>> = populations.iter().map(|_| Vec::new()).collect();
        let mut slots = 1;
        for (_, source, target, projection) in graph.projections() {
            let from_compartment = u32::from(projection.delay.get()) + 1;
            let input = matches!(populations[source.index()].kind, Kind::Input);
            let srm = matches!(populations[target.index()].kind, Kind::Srm(_));
            slots = slots.max(from_compartment as usize + 1);
            projections[source.index()].push(Projection {
                target: target.index(),
                latency: from_compartment - u32::from(input && !srm),
                synapses: Synapses::new(
                    projection,
                    populations[source.index()].count,
                    populations[target.index()].order,
                    weight_unit(graph, target, projection)
                        * f64::from(graph.population(source).message.factor().unwrap_or(1)),
                ),
            });
        }
        let reset = facts.reset.map(|reset| Reset { interval: reset.interval as u32, offset: reset.offset as u32 });
        let is_input = |&index: &usize| matches!(populations[index].kind, Kind::Input);
        let (inputs, layers) = (0..populations.len()).partition(is_input);
        Ok(Model {
            populations,
            inputs,
            layers,
            projections,
            channels,
            compartments,
            options,
            test: facts.threshold,
            reset,
            slots,
        })
    }

    /// Number of input channels.
    pub fn channels(&self) -> u32 {
        self.channels
    }

    fn at(&self, compartment: CompartmentId) -> (usize, usize) {
        let (index, within) =
            self.unit(&self.layers, compartment.0).expect("compartments are numbered over the populations");
        (index, within as usize)
    }

    /// The population among some, in the order of their units, that has a unit; its index there.
    fn unit(&self, among: &[usize], number: u32) -> Option<(usize, u32)> {
        let after = among.partition_point(|&index| self.populations[index].first <= number);
        let index = among[after.checked_sub(1)?];
        let Population { first, count, .. } = self.populations[index];
        (number - first < count).then_some((index, number - first))
    }
}

/// The parameters of spike response neurons in timesteps of `timestep_ms`.
pub fn in_steps(srm: &SrmParameters, timestep_ms: f64) -> srm::Parameters {
    srm::Parameters {
        tau_sr: srm.tau_sr_ms / timestep_ms,
        tau_ref: srm.tau_ref_ms / timestep_ms,
        scale_ref: srm.scale_ref,
        theta: srm.theta,
    }
}

/// Contribution of a weight of 1 to the current of its target, in register units if the target's
/// threshold is in these.
fn weight_unit(graph: &Graph, target: NodeIndex, projection: &nsim_ir::graph::Projection) -> f64 {
    let PopulationKind::Neurons(parameters) = &graph.population(target).kind else { return 1.0 };
    match parameters.real("vth") {
        Some(_) => 1.0,
        None => {
            let scale = projection.weight_scale.as_ref().map_or(1.0, |scale| scale.value);
            scale * libm::exp2(6.0 + projection.weight_exp.value as f64)
        }
    }
}

#[derive(Debug)]
enum Units<F> {
    Input,
    Srm(Srm<F>),
    Cuba(Cuba<F>),
}

impl<F: Real> Units<F> {
    /// Returns all neurons to their resting state.
    fn clear(&mut self) {
        match self {
            Units::Input => {}
            Units::Srm(srm) => srm.clear(),
            Units::Cuba(cuba) => cuba.clear(),
        }
    }
}

/// The state of a run over a [`Model`].
#[derive(Debug)]
pub struct Reference<'m, F> {
    model: &'m Model<F>,
    units: Vec<Units<F>>,
    /// `[population][slot][place in its order]`: sums of arrivals in the coming steps.
    arrivals: Vec<Vec<Vec<F>>>,
    /// Sums of a population in the order of its units.
    by_unit: Vec<F>,
    spikes: Vec<CompartmentId>,
    step: u32,
    steps: u32,
    totals: Totals,
}

impl<'m, F: Real> Reference<'m, F> {
    /// A run before its first step.
    pub fn new(model: &'m Model<F>) -> Self {
        let units = model.populations.iter().map(|population| match &population.kind {
            Kind::Input => Units::Input,
            Kind::Srm(parameters) => Units::Srm(Srm::new(parameters, model.options.kernel, population.count as usize)),
            Kind::Cuba(neurons) => Units::Cuba(Cuba::new(neurons, model.test)),
        });
        let arrivals = model.populations.iter().map(|population| {
            let count = if matches!(population.kind, Kind::Input) { 0 } else { population.count as usize };
            vec![vec![F::default(); count]; model.slots]
        });
        Reference {
            model,
            units: units.collect(),
            arrivals: arrivals.collect(),
            by_unit: Vec::new(),
            spikes: Vec::new(),
            step: 0,
            steps: 0,
            totals: Totals::default(),
        }
    }

    /// The synaptic current after the last step; the potential u of a spike response neuron, which
    /// has no current.
    pub fn current(&self, compartment: CompartmentId) -> f64 {
        let (population, index) = self.model.at(compartment);
        match &self.units[population] {
            Units::Cuba(cuba) => cuba.current()[index].into(),
            Units::Input | Units::Srm(_) => self.potential(compartment),
        }
    }

    /// Sends a spike of this step over every projection that leaves its population.
    fn send(&mut self, population: usize, index: u32) {
        for &Projection { target, latency, ref synapses } in &self.model.projections[population] {
            let slot = (self.step as usize + latency as usize) % self.model.slots;
            let events = synapses.deliver(index, &mut self.arrivals[target][slot]);
            if u64::from(self.step) + u64::from(latency) < u64::from(self.steps) {
                self.totals.synaptic_events += events;
            }
        }
    }
}

impl<F: Real> Engine for Reference<'_, F> {
    fn channels(&self) -> u32 {
        self.model.populations.iter().filter(|p| matches!(p.kind, Kind::Input)).map(|p| p.count).sum()
    }

    fn begin(&mut self, steps: u32) {
        self.units.iter_mut().for_each(Units::clear);
        self.arrivals.iter_mut().flatten().for_each(|sums| sums.fill(F::default()));
        self.spikes.clear();
        (self.step, self.steps) = (0, steps);
        self.totals = Totals::default();
    }

    fn step(&mut self, input: Spikes<'_>) {
        let model = self.model;
        let mut channels: Vec<(usize, u32)> = input.ids.iter().filter_map(|c| model.unit(&model.inputs, c.0)).collect();
        // Sums of real numbers depend on the order.
        channels.sort_by_key(|(population, _)| *population);
        channels.into_iter().for_each(|(population, index)| self.send(population, index));
        self.spikes.clear();
        let slot = self.step as usize % model.slots;
        for (index, population) in model.populations.iter().enumerate() {
            let sums = &mut self.arrivals[index][slot];
            let spikes = &mut self.spikes;
            let spike = |neuron: u32| spikes.push(CompartmentId(population.first + neuron));
            let is_before_start = self.step < population.start_step;
            if model.reset.is_some_and(|reset| falls_on(reset, self.step, population.resets_from)) {
                self.units[index].clear();
            }
            let by_unit = population.order.by_unit(sums, &mut self.by_unit);
            match &mut self.units[index] {
                Units::Srm(srm) => srm.step(by_unit, spike),
                Units::Cuba(cuba) if !is_before_start => cuba.step(by_unit, spike),
                Units::Input | Units::Cuba(_) => {}
            }
            sums.fill(F::default());
        }
        let spikes = std::mem::take(&mut self.spikes);
        for &spike in &spikes {
            let (population, index) = model.at(spike);
            self.send(population, index as u32);
        }
        self.spikes = spikes;
        self.totals.spikes_in += input.ids.len() as u64;
        self.totals.spikes += self.spikes.len() as u64;
        self.totals.compartment_updates += u64::from(model.compartments);
        // Real numbers decay for ever, so no update can be skipped.
        self.totals.active_updates += u64::from(model.compartments);
        self.step += 1;
    }

    fn spikes(&self) -> &[CompartmentId] {
        &self.spikes
    }

    /// Rounded from [`Reference::current`].
    fn u(&self, compartment: CompartmentId) -> i32 {
        self.current(compartment).round() as i32
    }

    /// Rounded from [`Engine::potential`].
    fn v(&self, compartment: CompartmentId) -> i32 {
        self.potential(compartment).round() as i32
    }

    /// u of a spike response neuron, v of a current-based one.
    fn potential(&self, compartment: CompartmentId) -> f64 {
        let (population, index) = self.model.at(compartment);
        match &self.units[population] {
            Units::Input => 0.0,
            Units::Srm(srm) => srm.potential()[index].into(),
            Units::Cuba(cuba) => cuba.voltage()[index].into(),
        }
    }

    /// Equals `v`, as there is no register.
    fn v_register(&self, compartment: CompartmentId) -> i32 {
        self.v(compartment)
    }

    fn totals(&self) -> Totals {
        self.totals
    }

    /// Nothing overflows.
    fn overflow(&self) -> Overflow {
        Overflow::default()
    }
}
