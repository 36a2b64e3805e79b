//! Run time against error: one network in many forms, on the same samples.
//!
//! Input: a network as it was trained, the converted form of its spike response populations,
//! samples. Output: a [`VariantRow`] for each [`Variant`]: microseconds a timestep on one thread,
//! and the distance of its spikes and potentials from the trained network in doubles. Variants that
//! claim to be exact are also compared with the golden interpreter; for them [`VariantRow::exact`]
//! must be true.
//!
//! A timestep is a step of the sample, also where a variant merges or skips steps. Only runs are
//! timed, not the preparation of a variant.

use std::hint::black_box;
use std::num::NonZeroU32;
use std::time::Duration;

use nsim_agree::classes::ClassTally;
use nsim_agree::metrics::TrainSums;
use nsim_agree::staged::layers;
use nsim_agree::trace::{Comparison, Layer, Trace};
use nsim_compile::Mapping;
use nsim_cost::meter::{MeterSettings, StepMeter};
use nsim_cost::transport::{Timing, Transport};
use nsim_dynamics::{model_thresholds, thresholds};
use nsim_energy::cpu::{MeasuredTime, time_repeats};
use nsim_golden::Golden;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::fixed::{Decay, OutOfRange, Refractory, SignMode, ThresholdMantissa, WeightBits};
use nsim_ir::base::id::{ChannelId, CompartmentId};
use nsim_ir::graph::{Graph, PopulationKind, ProjectionKind};
use nsim_ir::hardware::Target;
use nsim_ir::quantised::{Neuron, Parts, Quantised, Units};
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::{Image, Machine, Settings};
use nsim_quantise::analytic::{self, Fit};
use nsim_quantise::quantise::quantise;
use nsim_reference::{Kernel, Model, Real, Reference};
use nsim_session::decision::{EarlyExit, Rule};
use nsim_session::error::Error;
use nsim_session::observers::StepRange;
use nsim_session::obtain::map_with_defaults;
use nsim_session::priced::MeteredMapping;
use nsim_session::{SampleSettings, Session};

/// A form of the network, and an engine that runs it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variant {
    /// In real numbers.
    Reference {
        /// `f32` instead of `f64`.
        single: bool,
        /// Truncated kernels by convolution instead of exact ones by recursion.
        convolution: bool,
    },
    /// The golden interpreter.
    Golden,
    /// The machine.
    Fast {
        /// Whether idle compartments are skipped.
        skip: bool,
    },
    /// The machine with every step metered, energy and time under this model of the mesh.
    Metered(Transport),
    /// The machine with weights of this many bits; 1: a sign, with one size for a projection.
    WeightBits(u8),
    /// The machine with decays of this many bits.
    DecayBits(u8),
    /// The machine with this many steps merged into one.
    Merged(u32),
    /// The machine, each sample ended by a rule.
    Early(Rule),
}

impl Variant {
    /// All variants of a network; convolution needs spike response neurons.
    pub fn all(srm: bool) -> Vec<Variant> {
        let mut all = Vec::new();
        for single in [false, true] {
            all.push(Variant::Reference { single, convolution: false });
            if srm {
                all.push(Variant::Reference { single, convolution: true });
            }
        }
        all.push(Variant::Golden);
        all.extend([true, false].map(|skip| Variant::Fast { skip }));
        all.extend(Transport::ALL.map(Variant::Metered));
        all.extend([6, 5, 4, 3, 2, 1].map(Variant::WeightBits));
        all.extend([10, 8, 6, 5, 4, 3].map(Variant::DecayBits));
        all.extend([2, 4, 8].map(Variant::Merged));
        all.extend([2, 4, 8, 16].into_iter().filter_map(NonZeroU32::new).map(|m| Variant::Early(Rule::Margin(m))));
        all.push(Variant::Early(Rule::Certain));
        all
    }

    /// Its name in results.
    pub fn name(self) -> String {
        match self {
            Variant::Reference { single, convolution } => {
                let (width, way) =
                    (if single { "f32" } else { "f64" }, if convolution { "convolution" } else { "recursion" });
                format!("reference-{width}-{way}")
            }
            Variant::Golden => "golden".to_string(),
            Variant::Fast { skip: true } => "fast".to_string(),
            Variant::Fast { skip: false } => "fast-no-skip".to_string(),
            Variant::Metered(transport) => format!("metered-{}", transport.name()),
            Variant::WeightBits(bits) => format!("weights-{bits}-bit"),
            Variant::DecayBits(bits) => format!("decays-{bits}-bit"),
            Variant::Merged(steps) => format!("merged-{steps}-steps"),
            Variant::Early(rule) => format!("early-exit-{rule}"),
        }
    }
}

/// Measurements of a variant.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct VariantRow {
    /// The variant.
    #[serde(serialize_with = "by_name")]
    pub variant: Variant,
    /// Median of the repeats, microseconds.
    pub us_per_timestep: f64,
    /// Interquartile range of the repeats.
    pub spread: f64,
    /// Share of samples with the class of the trained network, of those that both decide.
    pub class_agreement: Option<f64>,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// Potentials over all layers in thresholds; none where steps do not correspond.
    pub potential_rmse: Option<f64>,
    /// Whether no other variant is both faster and nearer to the trained network.
    pub on_front: bool,
    /// Share of right classes, when samples have labels.
    pub accuracy: Option<f64>,
    /// For variants that claim it: whether every spike is the golden interpreter's.
    pub exact: Option<bool>,
    /// Number of repeats.
    pub repeats: usize,
}

fn by_name<S: serde::Serializer>(variant: &Variant, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(&variant.name())
}

/// Error of an inconsistent variant.
fn wrong(problem: impl std::fmt::Display) -> Error {
    Diagnostic::new("pareto.variant", problem.to_string()).into()
}

/// A network with the data that its variants share.
pub struct Subject<'a> {
    graph: &'a Graph,
    deployed: Quantised,
    /// The graph whose integers are deployed.
    converted: Graph,
    target: &'a Target,
    samples: Vec<&'a Sample>,
    layers: Vec<Layer>,
    output: Layer,
    trained: Vec<Trace>,
    golden: Vec<Trace>,
    budget: Duration,
}

impl<'a> Subject<'a> {
    /// Prepares a network: runs it as trained and on the golden interpreter.
    ///
    /// # Errors
    /// As [`quantise`].
    pub fn new(
        graph: &'a Graph,
        fits: &[Option<Fit>],
        target: &'a Target,
        samples: Vec<&'a Sample>,
        budget: Duration,
    ) -> Result<Self, Error> {
        let converted = analytic::with_fits(graph, fits);
        let deployed = quantise(&converted)?;
        let layers = layers(&deployed);
        let name = &deployed.populations()[deployed.parts().output].name;
        let output = layers.iter().find(|layer| &layer.name == name).cloned();
        let output = output.ok_or_else(|| wrong("the output has no compartments"))?;
        let mut subject = Subject {
            graph,
            converted,
            target,
            samples,
            layers,
            output,
            trained: Vec::new(),
            golden: Vec::new(),
            budget,
            deployed,
        };
        let model = Model::<f64>::new(graph, nsim_reference::Options { kernel: Kernel::Exact })?;
        subject.trained = subject.real_traces(&model);
        subject.golden = subject.traces(&mut Golden::new(&subject.deployed), &subject.deployed, 1);
        Ok(subject)
    }

    fn real_traces<F: Real>(&self, model: &Model<F>) -> Vec<Trace> {
        let thresholds = model_thresholds(self.graph);
        let mut engine = Reference::new(model);
        let potential = |e: &Reference<'_, F>, c: CompartmentId| e.potential(c) / thresholds[c.0 as usize];
        let recorded = (thresholds.len() as u32, self.deployed.output());
        self.samples.iter().map(|s| Trace::record(&mut engine, s, recorded, potential)).collect()
    }

    /// Traces of an integer engine; with merged steps, spikes at the last step of each group.
    fn traces<E: Engine>(&self, engine: &mut E, network: &Quantised, merged: u32) -> Vec<Trace> {
        let thresholds = thresholds(network);
        let potential = |e: &E, c: CompartmentId| f64::from(e.v(c)) / thresholds[c.0 as usize];
        let recorded = (network.compartments(), network.output());
        let one = |sample: &&Sample| {
            if merged == 1 {
                return Trace::record(engine, sample, recorded, potential);
            }
            let mut trace = Trace::record(engine, &merge(sample, merged), recorded, potential);
            trace.potentials.clear();
            let merged_steps = |step| std::iter::repeat_n(step, merged as usize);
            trace.deciding = trace.deciding.into_iter().flat_map(merged_steps).take(sample.steps() as usize).collect();
            trace.steps = sample.steps();
            let late = |t: &mut u32| *t = (*t * merged + merged - 1).min(sample.steps() - 1);
            trace.trains.iter_mut().flatten().for_each(late);
            trace
        };
        self.samples.iter().map(one).collect()
    }

    /// Compares traces with the trained network's.
    fn row(&self, variant: Variant, traces: &[Trace], times: MeasuredTime) -> VariantRow {
        let integers = !matches!(variant, Variant::Reference { .. });
        let shift = if integers && self.graph.has_srm() { -1 } else { 0 };
        let (mut tally, mut classes, mut right) = (TrainSums::default(), ClassTally::default(), 0usize);
        for ((trained, trace), sample) in self.trained.iter().zip(traces).zip(&self.samples) {
            for layer in &self.layers {
                let mut comparison = Comparison::default();
                comparison.add(0, layer, trained, trace, shift);
                tally.merge(&comparison.tally);
            }
            let class = trace.class(&self.output);
            classes.add(trained.class(&self.output), class);
            right += usize::from(class.is_some() && class == sample.label());
        }
        let claims_exact = matches!(variant, Variant::Golden | Variant::Fast { .. } | Variant::Metered(_));
        let share = |count: usize| count as f64 / self.samples.len().max(1) as f64;
        let labelled = self.samples.iter().all(|sample| sample.label().is_some());
        let trains = |traces: &[Trace]| traces.iter().map(|trace| trace.trains.clone()).collect::<Vec<_>>();
        VariantRow {
            variant,
            us_per_timestep: times.us_per_timestep,
            spread: times.spread,
            repeats: times.repeats,
            class_agreement: classes.agreement(),
            accuracy: labelled.then(|| share(right)),
            coincidence: tally.coincidence(),
            potential_rmse: tally.potential_rmse(),
            exact: claims_exact.then(|| trains(traces) == trains(&self.golden)),
            on_front: false,
        }
    }

    /// Times runs of all samples.
    fn timed(&self, run: impl FnMut()) -> MeasuredTime {
        time_repeats(self.samples.iter().map(|sample| u64::from(sample.steps())).sum(), self.budget, run)
    }

    fn real<F: Real>(&self, variant: Variant, kernel: Kernel) -> Result<VariantRow, Error> {
        let model = Model::<F>::new(self.graph, nsim_reference::Options { kernel })?;
        let mut engine = Reference::new(&model);
        let times = self.timed(|| self.samples.iter().for_each(|sample| drive(&mut engine, sample)));
        Ok(self.row(variant, &self.real_traces(&model), times))
    }

    /// Measures a network on the machine, with `merged` steps of each sample in one.
    fn machine(&self, variant: Variant, network: &Quantised, merged: u32) -> Result<VariantRow, Error> {
        let compiled = map_with_defaults(network.clone(), self.target)?;
        let image = Image::new(&compiled.program, 1).map_err(wrong)?;
        let meter = match variant {
            Variant::Metered(transport) => Some(self.meter(&compiled, transport)?),
            _ => None,
        };
        let early_exit = match variant {
            Variant::Early(rule) => Some(EarlyExit::new(rule, network)?),
            _ => None,
        };
        let skip = variant != Variant::Fast { skip: false };
        let mut session = Session::new(Machine::new(&image, Settings { skip, per_step: meter.is_some() }), 1);
        let merged_samples: Vec<Sample> = self.samples.iter().map(|sample| merge(sample, merged)).collect();
        let alone = meter.is_none() && early_exit.is_none();
        let sample_settings = SampleSettings { early_exit, ..SampleSettings::new(network.output()) };
        let times = self.timed(|| {
            for sample in &merged_samples {
                if alone {
                    drive(session.engine_mut(), sample);
                    continue;
                }
                let mut seen = meter.as_ref().map(StepMeter::fresh);
                let add = |machine: &Machine, passed: StepRange| {
                    if let Some(seen) = &mut seen {
                        seen.add(machine.last_step(), passed.steps, false);
                    }
                };
                black_box(session.run(sample, &sample_settings, add));
                black_box(&seen);
            }
        });
        let mut traces = self.traces(session.engine_mut(), network, merged);
        if sample_settings.early_exit.is_some() {
            for (trace, sample) in traces.iter_mut().zip(&merged_samples) {
                let until = session.run(sample, &sample_settings, ()).steps;
                // Skipped steps have no spikes, and no potentials to compare.
                let steps = trace.steps;
                *trace = Trace { steps, potentials: Vec::new(), ..std::mem::take(trace).until(until) };
            }
        }
        Ok(self.row(variant, &traces, times))
    }

    /// A meter that sees every step.
    fn meter(&self, compiled: &Mapping, transport: Transport) -> Result<StepMeter, Error> {
        let (settings, _) = MeteredMapping::new(compiled).offline(self.target)?;
        let timing = Timing { transport, ..settings.timing };
        Ok(StepMeter::new(MeterSettings { timing, ..settings }))
    }

    /// Measures one variant.
    ///
    /// # Errors
    /// [`Error`] when the variant cannot be made or run.
    pub fn measure(&self, variant: Variant) -> Result<VariantRow, Error> {
        let kernel = |convolution| if convolution { Kernel::Truncated } else { Kernel::Exact };
        match variant {
            Variant::Reference { single: true, convolution } => self.real::<f32>(variant, kernel(convolution)),
            Variant::Reference { single: false, convolution } => self.real::<f64>(variant, kernel(convolution)),
            Variant::Golden => {
                let mut engine = Golden::new(&self.deployed);
                let times = self.timed(|| self.samples.iter().for_each(|sample| drive(&mut engine, sample)));
                Ok(self.row(variant, &self.golden, times))
            }
            Variant::WeightBits(bits) => {
                let network = quantise(&with_weight_bits(&self.converted, bits)?)?;
                self.machine(variant, &network, 1)
            }
            Variant::DecayBits(bits) => {
                let step = f64::from(1 << (12 - u32::from(bits.min(12))));
                // A decay of 0 would never forget.
                let coarse =
                    |d: Decay| Decay::new((f64::from(d.get()) / step).round_ties_even().max(1.0) as i64 * step as i64);
                let decays = |neuron: Neuron| Ok(Neuron { du: coarse(neuron.du)?, dv: coarse(neuron.dv)?, ..neuron });
                self.machine(variant, &with_neurons(&self.deployed, decays)?, 1)
            }
            Variant::Merged(steps) => self.machine(variant, &slower(&self.deployed, steps)?, steps),
            Variant::Fast { .. } | Variant::Metered(_) | Variant::Early(_) => self.machine(variant, &self.deployed, 1),
        }
    }
}

/// Whether each point is on the front: no other is at most as large in both and smaller in one.
pub fn on_front(points: &[(f64, f64)]) -> Vec<bool> {
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].0.total_cmp(&points[b].0).then(points[a].1.total_cmp(&points[b].1)));
    let (mut on, mut last) = (vec![false; points.len()], None);
    for at in order {
        on[at] = last.is_none_or(|last: (f64, f64)| points[at].1 < last.1 || points[at] == last);
        last = if on[at] { Some(points[at]) } else { last };
    }
    on
}

/// Marks the rows on the front of run time and distance, which is 1 minus the coincidence.
pub fn mark_front(rows: &mut [VariantRow]) {
    let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.us_per_timestep, 1.0 - row.coincidence)).collect();
    rows.iter_mut().zip(on_front(&points)).for_each(|(row, on)| row.on_front = on);
}

fn drive<E: Engine>(engine: &mut E, sample: &Sample) {
    engine.begin(sample.steps());
    for step in 0..sample.steps() {
        engine.step(sample.input(step));
        black_box(engine.spikes());
    }
}

/// The sample with `steps` steps in one: a channel that spikes in any of them spikes.
fn merge(sample: &Sample, steps: u32) -> Sample {
    if steps == 1 {
        return sample.clone();
    }
    let events: Vec<(u32, ChannelId)> =
        (0..sample.steps()).flat_map(|t| sample.at(t).iter().map(move |&channel| (t / steps, channel))).collect();
    Sample::new(sample.steps().div_ceil(steps), &events, sample.label()).unwrap_or_else(|_| sample.clone())
}

fn with_weight_bits(graph: &Graph, bits: u8) -> Result<Graph, Error> {
    let format = WeightBits::new(i64::from(bits)).map_err(wrong)?;
    Ok(graph.with_projections(|target, projection| {
        let mut projection = projection.clone();
        let integers = matches!(
            &graph.population(target).kind,
            PopulationKind::Neurons(p) if p.real("vth").is_none()
        ) && projection.weight_scale.is_none();
        let all = weights(&projection.kind);
        let mean = all.iter().map(|w| w.abs()).sum::<f64>() / all.len().max(1) as f64;
        let (low, high) = projection.sign.range(format);
        let step = f64::from(projection.sign.step(format));
        let coarse = |w: f64| {
            if bits == 1 {
                // One bit holds a sign alone; the size is one number for the projection.
                let size = if integers { (mean / 2.0).round_ties_even() * 2.0 } else { mean };
                if w < 0.0 { -size } else { size }
            } else if integers {
                ((w / step).round_ties_even() * step).clamp(low.into(), high.into())
            } else {
                w
            }
        };
        projection.kind = projection.kind.map_weights(|_, weight| coarse(weight));
        if bits > 1 || projection.sign != SignMode::Mixed {
            projection.weight_bits.value = if bits == 1 { 8 } else { bits.into() };
        }
        projection
    }))
}

fn weights(kind: &ProjectionKind) -> Vec<f64> {
    match kind {
        ProjectionKind::Dense { weights } | ProjectionKind::Conv2d { weights, .. } => weights.reals().collect(),
        ProjectionKind::Sparse { synapses } => synapses.iter().map(|synapse| synapse.2).collect(),
        // Their weights are not changed.
        ProjectionKind::SumPool2d { .. } | ProjectionKind::Random { .. } => Vec::new(),
    }
}

/// The network with other neurons.
fn with_neurons(network: &Quantised, f: impl Fn(Neuron) -> Result<Neuron, OutOfRange>) -> Result<Quantised, Error> {
    let mut parts: Parts = network.parts().clone();
    for population in parts.populations.iter_mut() {
        if let Units::Compartments { neurons, .. } = &mut population.units {
            *neurons = neurons.try_map(|_, neuron| f(neuron)).map_err(wrong)?;
        }
    }
    Quantised::new(parts).map_err(wrong)
}

/// The network for steps `steps` times as long: the fraction kept by a step is raised to this
/// power. The threshold is divided, since the current is added once instead of `steps` times.
fn slower(network: &Quantised, steps: u32) -> Result<Quantised, Error> {
    let decay = |d: Decay| {
        let keep = libm::pow(1.0 - f64::from(d.get()) / 4096.0, f64::from(steps));
        Decay::new(libm::rint(4096.0 * (1.0 - keep)) as i64)
    };
    let threshold = |vth: ThresholdMantissa| ThresholdMantissa::new((i64::from(vth.get()) / i64::from(steps)).max(1));
    let refractory = |r: Refractory| Refractory::new(i64::from(u32::from(r.get()).div_ceil(steps)));
    with_neurons(network, |neuron| {
        Ok(Neuron {
            du: decay(neuron.du)?,
            dv: decay(neuron.dv)?,
            vth: threshold(neuron.vth)?,
            refractory: refractory(neuron.refractory)?,
            ..neuron
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(us: f64, coincidence: f64) -> VariantRow {
        VariantRow {
            variant: Variant::Golden,
            us_per_timestep: us,
            spread: 0.0,
            repeats: 1,
            class_agreement: Some(1.0),
            accuracy: None,
            coincidence,
            potential_rmse: None,
            exact: None,
            on_front: false,
        }
    }

    #[test]
    fn the_front_is_what_nothing_beats_in_both() {
        let mut rows = [row(3.0, 1.0), row(1.0, 0.9), row(2.0, 0.8), row(0.5, 0.2), row(1.0, 0.9)];
        mark_front(&mut rows);
        assert_eq!(rows.map(|row| row.on_front), [true, true, false, true, true]);
        // Compared with a search over all pairs, with equal points and equal coordinates.
        let points: Vec<(f64, f64)> =
            (0..400u32).map(|k| (f64::from(k * 7919 % 23), f64::from(k * 104_729 % 31 / 2))).collect();
        let beaten = |own: &(f64, f64)| points.iter().any(|p| p.0 <= own.0 && p.1 <= own.1 && p != own);
        assert_eq!(on_front(&points), points.iter().map(|own| !beaten(own)).collect::<Vec<_>>());
    }

    #[test]
    fn merged_steps_hold_every_channel_that_spiked_in_any() {
        let sample = Sample::new(5, &[(0, ChannelId(1)), (1, ChannelId(1)), (4, ChannelId(0))], None).unwrap();
        let merged = merge(&sample, 2);
        assert_eq!(
            (merged.steps(), merged.at(0), merged.at(1), merged.at(2)),
            (3, &[ChannelId(1)][..], &[][..], &[ChannelId(0)][..])
        );
    }

    #[test]
    fn names_are_all_different() {
        let names: Vec<String> = Variant::all(true).into_iter().map(Variant::name).collect();
        assert!(names.len() >= 20 && names.iter().enumerate().all(|(i, name)| !names[..i].contains(name)), "{names:?}");
    }
}
