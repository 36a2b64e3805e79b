//! A network on this machine's processor: dense over the window, and event by event.
//!
//! Input: a network, its samples, a time budget. Output: microseconds a timestep with the spread of
//! the repeats. *Dense* computes a window of binned spikes like a framework on a CPU or GPU. It
//! takes one f32 matrix product for each projection and whole sample, then the neurons step by
//! step, without the chip's truncation. *Event-driven* is nsim's own machine, one copy, one thread,
//! which is exact and skips idle compartments.
//!
//! One thread and one sample at a time (batch 1), as a robot's controller would run it.

use std::hint::black_box;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ndarray::{Array1, Array2, s};

use crate::measure::median_least_and_spread;
use nsim_dynamics::RealForm;
use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::base::depths::depths;
use nsim_ir::base::id::{Id, PopulationId};
use nsim_ir::program::Program;
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::spikes::Sample;
use nsim_machine::{Image, Machine, Settings};
use nsim_session::{SampleSettings, Session};

/// Maximum number of weights of dense matrices: 256 MiB.
const MOST_WEIGHTS: u64 = 1 << 26;
/// Minimum number of repeats for a meaningful spread.
const LEAST_REPEATS: usize = 5;
/// Maximum number of repeats; more would only cost time.
const MOST_REPEATS: usize = 101;

/// Measured times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredTime {
    /// Microseconds of a timestep: the median of the repeats.
    pub us_per_timestep: f64,
    /// Microseconds of a timestep in the fastest repeat.
    pub fastest: f64,
    /// Microseconds between the first and the third quartile.
    pub spread: f64,
    /// Number of repeats.
    pub repeats: usize,
    /// Number of timesteps of a repeat.
    pub timesteps: u64,
}

/// Times repeats of `pass`, each of `timesteps` timesteps, for about `budget`.
pub fn time_repeats(timesteps: u64, budget: Duration, mut pass: impl FnMut()) -> MeasuredTime {
    let once = |pass: &mut dyn FnMut()| {
        let begin = Instant::now();
        pass();
        begin.elapsed().max(Duration::from_nanos(1))
    };
    // The first pass warms caches and predictors up, and gives the number of passes that fit.
    let first = once(&mut pass);
    let repeats = (budget.as_secs_f64() / first.as_secs_f64()) as usize;
    let repeats = repeats.clamp(LEAST_REPEATS, MOST_REPEATS);
    let steps = timesteps.max(1) as f64;
    let each = (0..repeats).map(|_| once(&mut pass).as_secs_f64() * 1e6 / steps).collect();
    let [us_per_timestep, fastest, spread] = median_least_and_spread(each);
    MeasuredTime { us_per_timestep, fastest, spread, repeats, timesteps }
}

/// Returns the first samples with about `timesteps` timesteps in total.
pub fn first_samples<'a>(samples: &'a [&'a Sample], timesteps: u64) -> &'a [&'a Sample] {
    let mut sum = 0;
    let until = samples.iter().position(|sample| {
        sum += u64::from(sample.steps());
        sum >= timesteps
    });
    &samples[..until.map_or(samples.len(), |at| at + 1)]
}

/// A projection as a matrix.
#[derive(Debug)]
struct Incoming {
    source: usize,
    /// `[source][target]`, in the chip's units of current.
    weights: Array2<f32>,
    /// Steps between a source's spike and its arrival.
    later: usize,
}

/// A population of compartments.
#[derive(Debug)]
struct Layer {
    population: usize,
    incoming: Vec<Incoming>,
    keeps_u: Array1<f32>,
    keeps_v: Array1<f32>,
    bias: Array1<f32>,
    threshold: Array1<f32>,
    refractory: Vec<u16>,
    start_step: u32,
}

/// A feed-forward network as dense matrices.
#[derive(Debug)]
pub struct Dense {
    /// Layers, each after its sources.
    layers: Vec<Layer>,
    /// First channel and size of each input population, by population.
    inputs: Vec<Option<(u32, usize)>>,
    output: usize,
}

impl Dense {
    /// Returns the matrices of a network.
    ///
    /// # Errors
    /// The reason for none: a recurrent network, resets, neurons without this form, or its size.
    pub fn new(network: &Quantised) -> Result<Self, String> {
        if network.parts().reset.is_some() {
            return Err("it is reset within a sample".to_string());
        }
        let size = |population: PopulationId| network.populations()[population].shape.len();
        let weights: u64 =
            network.projections().iter().map(|p| u64::from(size(p.source)) * u64::from(size(p.target))).sum();
        if weights > MOST_WEIGHTS {
            return Err(format!("its matrices would have {weights} weights, more than {MOST_WEIGHTS}"));
        }
        let order = order(network).ok_or(
            "a population projects to itself, or to an earlier one, so a window cannot be computed layer by layer",
        )?;
        let mut inputs = vec![None; network.populations().len()];
        for (id, population) in network.inputs() {
            inputs[id.index()] = population.first_channel().map(|first| (first.0, population.shape.len() as usize));
        }
        let mut layers = Vec::new();
        for target in order {
            let population = &network.populations()[target];
            let Units::Compartments { neurons, start_step, .. } = &population.units else { continue };
            if neurons.any(|neuron| !neuron.kind.table().registers || !neuron.stack.is_unused()) {
                return Err(format!("'{}' cannot be run in real numbers", population.name));
            }
            let real = |neuron| RealForm::of_neuron(&neuron, network.parts().semantics);
            let units: Vec<RealForm> = population.each_neuron().map(real).collect();
            if units.iter().any(|unit| unit.subtracts) {
                return Err(format!("'{}' resets by subtraction", population.name));
            }
            let each = |of: fn(&RealForm) -> f64| units.iter().map(|unit| of(unit) as f32).collect();
            let mut incoming = Vec::new();
            for (_, projection) in network.incoming(target) {
                let mut weights = Array2::zeros((size(projection.source) as usize, size(target) as usize));
                let factor = network.populations()[projection.source].message.factor().unwrap_or(1) as f32;
                for from in 0..size(projection.source) {
                    projection.connectivity.for_each_from(from, |to, weight| {
                        weights[[from as usize, to as usize]] += scaled(projection.format, weight) as f32 * factor;
                    });
                }
                let input = network.populations()[projection.source].first_compartment().is_none();
                let later = projection.delay.get() as usize + usize::from(!input);
                incoming.push(Incoming { source: projection.source.index(), weights, later });
            }
            layers.push(Layer {
                population: target.index(),
                incoming,
                keeps_u: each(|n| n.keep_u),
                keeps_v: each(|n| n.keep_v),
                bias: each(|n| n.bias),
                threshold: each(|n| n.threshold),
                refractory: units.iter().map(|n| u16::try_from(n.refractory).unwrap_or(u16::MAX)).collect(),
                start_step: *start_step,
            });
        }
        Ok(Dense { layers, inputs, output: network.parts().output.index() })
    }

    /// Passes one sample through, layer by layer; returns the spikes of each output.
    pub fn pass(&self, sample: &Sample) -> Vec<u32> {
        let steps = sample.steps() as usize;
        // `[step][unit]`.
        let mut spikes: Vec<Option<Array2<f32>>> = self
            .inputs
            .iter()
            .map(|input| {
                let (first, size) = (*input)?;
                let mut train = Array2::zeros((steps, size));
                for step in 0..steps {
                    let channels = sample.at(step as u32).iter();
                    for channel in channels.filter_map(|c| c.0.checked_sub(first)).filter(|&c| (c as usize) < size) {
                        train[[step, channel as usize]] = 1.0;
                    }
                }
                Some(train)
            })
            .collect();
        for layer in &self.layers {
            let fired = layer.pass(steps, &spikes);
            spikes[layer.population] = Some(fired);
        }
        let output = spikes[self.output].as_ref();
        output.map_or_else(Vec::new, |train| train.sum_axis(ndarray::Axis(0)).iter().map(|&sum| sum as u32).collect())
    }
}

impl Layer {
    fn pass(&self, steps: usize, spikes: &[Option<Array2<f32>>]) -> Array2<f32> {
        let size = self.threshold.len();
        let mut current: Array2<f32> = Array2::zeros((steps, size));
        for Incoming { source, weights, later } in &self.incoming {
            let Some(train) = &spikes[*source] else { continue };
            let arriving = steps.saturating_sub(*later);
            let product = train.slice(s![..arriving, ..]).dot(weights);
            let mut then = current.slice_mut(s![steps - arriving.., ..]);
            then += &product;
        }
        let mut fired = Array2::zeros((steps, size));
        let (mut u, mut v) = (Array1::<f32>::zeros(size), Array1::<f32>::zeros(size));
        let mut hold = vec![0u16; size];
        for step in (self.start_step as usize).min(steps)..steps {
            let (arrived, mut out) = (current.row(step), fired.row_mut(step));
            for i in 0..size {
                u[i] = u[i] * self.keeps_u[i] + arrived[i];
                if hold[i] > 0 {
                    hold[i] -= 1;
                    if hold[i] > 0 {
                        continue;
                    }
                }
                v[i] = v[i] * self.keeps_v[i] + u[i] + self.bias[i];
                if v[i] > self.threshold[i] {
                    (v[i], out[i], hold[i]) = (0.0, 1.0, self.refractory[i]);
                }
            }
        }
        fired
    }
}

/// Returns the populations, each after its sources; `None` for a recurrent network.
fn order(network: &Quantised) -> Option<Vec<PopulationId>> {
    let ids = || network.populations().ids();
    let sources: Vec<Vec<usize>> =
        ids().map(|id| network.incoming(id).map(|(_, projection)| projection.source.index()).collect()).collect();
    let (depths, loops) = depths(&sources, |_| false);
    let mut order: Vec<PopulationId> = ids().collect();
    order.sort_by_key(|id| depths[id.index()]);
    loops.is_empty().then_some(order)
}

/// Times the dense window over these samples.
///
/// # Errors
/// As [`Dense::new`].
pub fn dense(network: &Quantised, samples: &[&Sample], budget: Duration) -> Result<MeasuredTime, String> {
    let dense = Dense::new(network)?;
    let timesteps = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    Ok(time_repeats(timesteps, budget, || {
        samples.iter().for_each(|sample| drop(black_box(dense.pass(black_box(sample)))));
    }))
}

/// Times the machine over these samples.
///
/// # Errors
/// The reason why the program cannot run.
pub fn event_driven(program: &Arc<Program>, samples: &[&Sample], budget: Duration) -> Result<MeasuredTime, String> {
    let image = Image::new(program, 1).map_err(|error| error.to_string())?;
    let mut session = Session::new(Machine::new(&image, Settings { skip: true, per_step: false }), 1);
    let sample_settings = SampleSettings::new(program.output());
    let timesteps = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    Ok(time_repeats(timesteps, budget, || {
        for sample in samples {
            black_box(session.run(black_box(sample), &sample_settings, ()));
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_golden::Golden;
    use nsim_ir::base::diagnostic::SourceText;
    use nsim_ir::base::id::ChannelId;

    fn network(populations: &str, projections: &str) -> Quantised {
        let text = format!(
            "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"a\", shape: [3]), Input(name: \"b\", \
             shape: [2]), \
             {populations}], projections: [{projections}], output: \"out\")"
        );
        let network =
            nsim_import::model::network(SourceText::new("n.ron", text), nsim_files::shipped::Origin::File).unwrap();
        nsim_session::front::front(&network).unwrap().into_quantised()
    }

    fn sample(steps: u32, seed: u64) -> Sample {
        let draw = |t: u32, c: u32| nsim_ir::base::rng::unit(seed, c.into(), t.into()) < 0.4;
        let events = (0..steps).flat_map(|t| (0..5).filter(move |&c| draw(t, c)).map(move |c| (t, ChannelId(c))));
        Sample::new(steps, &events.collect::<Vec<_>>(), None).unwrap()
    }

    fn golden(network: &Quantised, sample: &Sample) -> Vec<u32> {
        let sample_settings = SampleSettings::new(network.output());
        Session::new(Golden::new(network), 1).run(sample, &sample_settings, ()).counts
    }

    #[test]
    fn without_decays_to_truncate_the_window_fires_as_the_chip_does() {
        // Without memory of current and without leak, every number is an integer in both.
        let network = network(
            "Loihi(name: \"hidden\", shape: [4], du: 4096, dv: 0, vth_mant: 10, refractory: 3, bias_mant: 5, \
             bias_exp: 2), \
             Loihi(name: \"out\", shape: [2], du: 4096, dv: 0, vth_mant: 12, refractory: 1, start_step: 4)",
            "Dense(from: [\"a\"], to: \"hidden\", weights: [[20, 0, 4], [2, 30, 6], [0, 8, 40], [12, -6, 2]]), \
             Dense(from: [\"b\"], to: \"hidden\", weights: [[2, 2], [4, -8], [6, 2], [-2, 8]], delay: 2), \
             Dense(from: [\"hidden\"], to: \"out\", weights: [[8, 0, 6, 2], [0, 10, -4, 8]], delay: 1)",
        );
        let dense = Dense::new(&network).unwrap();
        let mut fired = 0;
        for seed in 0..20 {
            let sample = sample(60, seed);
            let counts = golden(&network, &sample);
            assert_eq!(dense.pass(&sample), counts, "seed {seed}");
            fired += counts.iter().sum::<u32>();
        }
        assert!(fired > 200, "{fired}");
    }

    #[test]
    fn a_circle_has_no_window() {
        let network = network(
            "Loihi(name: \"out\", shape: [2], du: 4096, dv: 0, vth_mant: 12)",
            "Dense(from: [\"a\"], to: \"out\", weights: [[2, 2, 2], [2, 2, 2]]), \
             Dense(from: [\"out\"], to: \"out\", weights: [[0, 2], [2, 0]])",
        );
        assert!(Dense::new(&network).unwrap_err().contains("projects to itself"));
    }

    #[test]
    fn a_measurement_repeats_and_says_how_often() {
        let mut passes = 0;
        let timed = time_repeats(10, Duration::ZERO, || passes += 1);
        assert_eq!((timed.repeats, passes, timed.timesteps), (LEAST_REPEATS, LEAST_REPEATS + 1, 10));
        assert!(timed.fastest <= timed.us_per_timestep && timed.spread >= 0.0);
        let samples: Vec<Sample> = (0..5).map(|seed| sample(100, seed)).collect();
        let samples: Vec<&Sample> = samples.iter().collect();
        assert_eq!(
            (
                first_samples(&samples, 250).len(),
                first_samples(&samples, 1).len(),
                first_samples(&samples, 9_999).len()
            ),
            (3, 1, 5)
        );
    }
}
