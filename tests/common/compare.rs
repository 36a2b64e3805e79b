//! Compares engines: all their observable values, step by step, and the machine in all its settings
//! with the interpreter.

use std::sync::Arc;

use nsim::files::target::load_target;
use nsim::ir::activity::{Activity, Overflow, Totals};
use nsim::ir::base::id::CompartmentId;
use nsim::ir::hardware::Target;
use nsim::ir::neurons::NeuronKind;
use nsim::ir::program::Program;
use nsim::ir::quantised::{Neuron, Population, Quantised, Units};
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};

/// A target whose cores accept any mix of parameters, formats, delays and sources.
pub fn roomy(name: &str) -> Target {
    let target = load_target(name).unwrap();
    let mut limits = target.limits().clone();
    (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles], limits[Resource::SynapseFormats]) =
        (1024, 1024, 64);
    (limits[Resource::Accumulators], limits[Resource::AxonsIn]) = (1 << 16, 1 << 16);
    (limits[Resource::RuleWords], limits[Resource::TraceConfigurations]) = (1 << 16, 1 << 16);
    target.with_limits(limits)
}

/// A target without other limits, of this many compartments a core.
pub fn small_cores(name: &str, compartments: u32) -> Target {
    let target = roomy(name);
    let limits = target.limits().clone().with(Resource::Compartments, compartments);
    target.with_limits(limits)
}

/// The network with its compartments changed.
pub fn with_neurons(network: &Quantised, change: impl Fn(Neuron) -> Neuron) -> Quantised {
    let mut parts = network.parts().clone();
    for population in parts.populations.iter_mut() {
        if let Units::Compartments { neurons, .. } = &mut population.units {
            *neurons = neurons.try_map(|_, neuron| Ok::<_, ()>(change(neuron))).unwrap();
        }
    }
    Quantised::new(parts).unwrap()
}

/// Observable values after a step: messages by source with payloads, and all words of state.
pub type Shown = (Vec<(CompartmentId, i32)>, Vec<i32>);

/// Observable values of an engine over a sample.
#[derive(Debug, PartialEq)]
pub struct Trace {
    pub steps: Vec<Shown>,
    pub totals: Totals,
    pub overflow: Overflow,
}

impl Trace {
    /// Panics at the first step that differs, without printing both traces.
    pub fn assert_same(&self, other: &Trace, what: &str) {
        for (step, (meant, found)) in self.steps.iter().zip(&other.steps).enumerate() {
            assert_eq!(meant.0, found.0, "{what}: messages of step {step}");
            let place = meant.1.iter().zip(&found.1).position(|(meant, found)| meant != found);
            assert!(place.is_none(), "{what}: step {step}, word {place:?} of {:?} and {:?}", meant.1, found.1);
        }
        assert_eq!(self.steps.len(), other.steps.len(), "{what}: steps");
        assert_eq!((self.totals, self.overflow), (other.totals, other.overflow), "{what}: counts");
    }
}

/// Runs a sample; silence is skipped if the engine can, in one call or by single steps.
pub fn trace(engine: &mut dyn Engine, network: &Quantised, sample: &Sample) -> Trace {
    let neurons = network.populations().iter().flat_map(Population::each_neuron);
    let kinds: Vec<NeuronKind> = neurons.map(|neuron| neuron.kind).collect();
    engine.begin(sample.steps());
    let mut steps = Vec::new();
    while steps.len() < sample.steps() as usize {
        let step = steps.len() as u32;
        let silent = sample.next_spike(step) - step;
        let rested = [silent, u32::from(step.is_multiple_of(3))]
            .into_iter()
            .find(|&n| (1..=silent).contains(&n) && engine.skip_idle(n));
        if rested.is_none() {
            engine.step(sample.input(step));
        }
        (0..rested.unwrap_or(1)).for_each(|_| steps.push(shown(engine, &kinds)));
    }
    Trace { steps, totals: engine.totals(), overflow: engine.overflow() }
}

/// Observable values of an engine after a step; `kinds` are the kinds of its compartments.
pub fn shown(engine: &dyn Engine, kinds: &[NeuronKind]) -> Shown {
    assert!(engine.payloads().is_empty() || engine.payloads().len() == engine.spikes().len());
    let payloads = engine.payloads().iter().copied().chain(std::iter::repeat(1));
    let mut sent: Vec<_> = engine.spikes().iter().copied().zip(payloads).collect();
    sent.sort_unstable();
    let mut words = Vec::new();
    for (id, kind) in (0..).map(CompartmentId).zip(kinds) {
        match kind.table() {
            table if table.registers => words.extend([engine.u(id), engine.v(id), engine.v_register(id)]),
            table => words.extend((0..table.state.len()).map(|column| engine.state(id, column))),
        }
    }
    (sent, words)
}

/// Runs a program on the machine, in 1, 2 and 8 shards, with skipping and without, and compares all
/// observable values with `expected`. Returns its counts by core, which are equal in every setting,
/// and the number of chunks of shared weights.
pub fn assert_on_machine(
    network: &Quantised,
    program: &Arc<Program>,
    sample: &Sample,
    expected: &Trace,
    what: &str,
) -> (Activity, usize) {
    let (mut counts, mut shared): (Option<Activity>, _) = (None, 0);
    for shares in [1, 2, 8] {
        let image = Image::new(program, shares).unwrap();
        shared += image.shared_chunks();
        for (skip, per_step) in [(true, false), (false, true)] {
            let what = format!("{what}, {shares} shares, skip {skip}");
            let mut machine = Machine::new(&image, Settings { skip, per_step });
            expected.assert_same(&trace(&mut machine, network, sample), &what);
            let activity = machine.take_activity();
            assert_eq!(activity.totals(), expected.totals, "{what}: counts by core add up");
            assert_eq!(*counts.get_or_insert_with(|| activity.clone()), activity, "{what}: counts by core");
        }
    }
    (counts.unwrap(), shared)
}
