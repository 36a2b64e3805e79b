//! The standard networks on which speed is measured, as code: no file can change them unnoticed.
//!
//! Input: a name. Output: the network in integers, its input for a period of steps (repeated for as
//! long as a measurement takes) and the board that it is mapped onto. Results are equal on every
//! machine: all randomness is `base::rng`.
//!
//! - `vtsnn-1pct`, `vtsnn-5pct`: the layers of the shipped `vtsnn-slip`, 156 / 3,150 -> 50 / 10 ->
//!   2, every channel spiking independently in 1 % and 5 % of the steps: about 400 and 2,000
//!   synaptic events a step.
//! - `random-32k`, `random-1m`: 32,768 and 1,000,000 compartments with 64 random synapses each.
//!   Current and voltage decay, so every compartment is active in almost every step and skipping
//!   saves nothing. A *drive* sets the firing rate: an input channel for each compartment, over one
//!   strong synapse. A driven compartment fires immediately. It is refractory until the rest of
//!   that current is too small to fire again. Recurrent weights have both signs and mean 0; they
//!   keep the voltage more than five standard deviations below the threshold (their sum has sd 95
//!   of 1,400). So the rate depends on the input alone and cannot run away. `random-32k` also has
//!   four weak random synapses a channel, for the input events that published runs of such a
//!   network count.
//! - `silent-1m`: the compartments and synapses of `random-1m`, and an input that never fires.
//! - `pilotnet`: lava-dl's PilotNet: 3 @ 33 x 100, 3 x 3 convolutions with stride 2 to 24 @ 16 x
//!   49, 36 @ 7 x 24 and 64 @ 3 x 11, one more to 64 @ 1 x 9, then 200, 100, 50, 10, 1.
//! - `dvs-gesture`: SANA-FE's `snn/dvs.yaml`: 32 x 32, 3 x 3 convolutions to 16 @ 15 x 15 (stride
//!   2), 32 @ 13 x 13, 64 @ 11 x 11 and 11 @ 9 x 9, then 11.
//! - `conv-98k`: 2 @ 128 x 128, 3 x 3 convolutions to 4 @ 128 x 128 and 8 @ 64 x 64 (stride 2):
//!   98,304 compartments.
//! - `conv-10m`: 2 @ 512 x 512, 3 x 3 convolutions to 16 @ 512 x 512, 32 @ 256 x 256 (stride 2), 32
//!   @ 256 x 256, 64 @ 128 x 128 (stride 2), 64 @ 128 x 128, 128 @ 64 x 64 (stride 2), pooled 16 x
//!   16, 11: 11,012,107 compartments, whose 2.2 thousand million synapses are never listed
//!   ([`nsim_compile::is_large`]); a synthetic network.
//! - `delays-32k`: the neurons and the drive of `random-32k`. The 64 synapses of a compartment have
//!   eight delays: eight synapses each with 0, 3, 9, 17, 25, 38, 50 and 62.
//! - `delays-busy`: 32,768 channels, of which 70 % spike in each step, with 64 synapses of the same
//!   delays each to 32,768 compartments that never fire.
//!
//! Channels of the convolutions spike independently: 5 % a step, in `conv-10m` 1 %, in `conv-98k` 8
//! %. `conv-98k` has thirteen times the threshold of PilotNet, so that about 4 % of its
//! compartments fire.

pub(super) mod builder;
pub mod delivery;
pub(super) mod layers;

use crate::networks::builder::Builder;
use crate::networks::layers::Layers;
use nsim_ir::base::fixed::OutOfRange;
use nsim_ir::base::id::{ChannelId, PopulationId};
use nsim_ir::base::names::named_variants;
use nsim_ir::base::rng;
use nsim_ir::graph::PerCompartment;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Inconsistent, Neuron, Quantised};
use nsim_ir::spikes::{Sample, SampleError};

named_variants! {
    /// A standard network. Its names are fixed: stored results carry them.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
    pub enum StandardNetwork {
        /// The visual-tactile network at 1 % input.
        VtSnn1Pct = "vtsnn-1pct",
        /// The visual-tactile network at 5 % input.
        VtSnn5Pct = "vtsnn-5pct",
        /// 32,768 compartments, 64 synapses each, 2.1 % firing.
        Random32k = "random-32k",
        /// 1,000,000 compartments, 64 synapses each, 1 % firing.
        Random1m = "random-1m",
        /// 1,000,000 compartments without input.
        Silent1m = "silent-1m",
        /// The PilotNet of lava-dl.
        PilotNet = "pilotnet",
        /// The gesture network of SANA-FE.
        DvsGesture = "dvs-gesture",
        /// 98,304 compartments in two convolutions.
        Conv98k = "conv-98k",
        /// 11 million compartments in six convolutions.
        Conv10m = "conv-10m",
        /// 32,768 compartments, 64 synapses each over eight delays, 2.1 % firing.
        Delays32k = "delays-32k",
        /// The delays of `delays-32k`, from channels of which 70 % spike in a step.
        DelaysBusy = "delays-busy",
    }
}

/// Error of building a network: a wrong constant of this module.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// A value does not fit its field.
    #[error(transparent)]
    Field(#[from] OutOfRange),
    /// Parts contradict each other.
    #[error(transparent)]
    Parts(#[from] Inconsistent),
    /// Input spikes do not make a sample.
    #[error(transparent)]
    Input(#[from] SampleError),
}

/// A network with its input.
#[derive(Debug, Clone)]
pub struct BenchNetwork {
    /// The network in integers.
    pub network: Quantised,
    /// Its input, to be repeated.
    pub period: Sample,
    /// The shipped target that it is mapped onto.
    pub target: &'static str,
}

impl StandardNetwork {
    /// Whether a step is large enough to gain from several threads.
    pub fn wants_threads(self) -> bool {
        matches!(self, StandardNetwork::Random32k | StandardNetwork::Random1m | StandardNetwork::Conv10m)
    }

    /// The standard network whose program this one shares: only their inputs differ.
    pub fn program_of(self) -> StandardNetwork {
        match self {
            StandardNetwork::VtSnn5Pct => StandardNetwork::VtSnn1Pct,
            StandardNetwork::Silent1m => StandardNetwork::Random1m,
            own => own,
        }
    }

    /// Builds it.
    ///
    /// # Errors
    /// [`BuildError`] never in practice; the tests build all.
    pub fn build(self) -> Result<BenchNetwork, BuildError> {
        let small = |background| Random { compartments: 32_768, background, driven: 714, period: 256 };
        let large = |driven| Random { compartments: 1_000_000, background: 0, driven, period: 64 };
        match self {
            StandardNetwork::VtSnn1Pct => with_spikes(vtsnn(self.name())?, VTSNN_STEPS, 1, 100, "nahuku-32"),
            StandardNetwork::VtSnn5Pct => with_spikes(vtsnn(self.name())?, VTSNN_STEPS, 5, 100, "nahuku-32"),
            StandardNetwork::Random32k => random(self.name(), small(4), &[0]),
            StandardNetwork::Random1m => random(self.name(), large(10_170), &[0]),
            StandardNetwork::Silent1m => random(self.name(), large(0), &[0]),
            StandardNetwork::PilotNet => with_spikes(lava_pilotnet(self.name())?, LAYERS_STEPS, 5, 100, "nahuku-32"),
            StandardNetwork::DvsGesture => with_spikes(dvs_gesture(self.name())?, LAYERS_STEPS, 5, 100, "nahuku-32"),
            StandardNetwork::Conv98k => with_spikes(conv_98k(self.name())?, LAYERS_STEPS, 8, 100, "pohoiki-springs"),
            StandardNetwork::Conv10m => with_spikes(conv_10m(self.name())?, LAYERS_STEPS, 1, 100, "pohoiki-springs"),
            StandardNetwork::Delays32k => random(self.name(), small(0), &DELAYS),
            StandardNetwork::DelaysBusy => events_over(self.name(), 32_768, 22_938, 64, &DELAYS),
        }
    }
}

/// Steps of input of the visual-tactile network: 20 samples of the slip task's 150 steps.
const VTSNN_STEPS: u32 = 20 * 150;

/// The layers of `models/vtsnn-slip.ron`, as code: retraining would change the measurement.
pub(super) fn vtsnn(name: &str) -> Result<Builder, OutOfRange> {
    let mut net = Builder::new(name);
    let (tactile, vision) = (net.input("tactile", 156), net.input("vision", 3150));
    let (touch, sight) = (net.loihi("touch", 50, 80, 1)?, net.loihi("sight", 10, 80, 1)?);
    let out = net.loihi("out", 2, 80, 1)?;
    net.dense((tactile, touch), -16, 16, 1)?;
    net.dense((vision, sight), -4, 4, 2)?;
    net.dense((touch, out), -64, 80, 3)?;
    net.dense((sight, out), -64, 80, 4)?;
    Ok(net)
}

/// A network whose channels spike independently with a probability of `spiking / all` a step.
pub(super) fn with_spikes(
    net: Builder,
    steps: u32,
    spiking: u64,
    all: u64,
    target: &'static str,
) -> Result<BenchNetwork, BuildError> {
    let (network, mut events) = (net.build()?, Vec::new());
    for channel in 0..network.channels() {
        let spikes = (0..steps).filter(|&t| rng::below(all, 5, u64::from(channel), u64::from(t)) < spiking);
        events.extend(spikes.map(|t| (t, ChannelId(channel))));
    }
    Ok(BenchNetwork { network, period: Sample::new(steps, &events, None)?, target })
}

/// Synapses of each compartment of a random network.
const FAN_OUT: u32 = 64;
/// The sizes of a random network.
#[derive(Debug, Clone, Copy)]
pub struct Random {
    /// Number of compartments, and of channels that drive one each.
    pub compartments: u32,
    /// Weak random synapses of a channel besides the driving one.
    pub background: u32,
    /// Channels sampled to spike in a step, with replacement; a channel sampled twice spikes once.
    pub driven: u32,
    /// Steps of input, to be repeated.
    pub period: u32,
}

/// `fan_out` synapses of each source to random targets, with small weights of both signs.
pub(super) fn random_synapses(targets: u32, fan_out: u32, seed: u64) -> Connectivity {
    Connectivity::Random { targets, fan_out, low: -8, high: 8, step: 2, seed, first_source: 0 }
}

/// The delays of `delays-32k`.
const DELAYS: [i64; 8] = [0, 3, 9, 17, 25, 38, 50, 62];

/// Adds random synapses, divided evenly among delays.
fn spread(
    net: &mut Builder,
    ends: (PopulationId, PopulationId),
    targets: u32,
    delays: &[i64],
) -> Result<(), OutOfRange> {
    for (&delay, seed) in delays.iter().zip(2..) {
        let fan_out = FAN_OUT / delays.len().max(1) as u32;
        net.connect(ends.0, ends.1, 0, random_synapses(targets, fan_out, seed))?;
        net.delay_last(delay)?;
    }
    Ok(())
}

/// Steps of input of a network of layers.
const LAYERS_STEPS: u32 = 64;

/// The PilotNet of lava-dl (`tutorials/lava/lib/dl/netx/pilotnet_snn`).
pub(super) fn lava_pilotnet(name: &str) -> Result<Builder, OutOfRange> {
    let mut layers = Layers::new(name, (3, 33, 100));
    layers.convolve(&[(24, 3, 2, 0), (36, 3, 2, 0), (64, 3, 2, 0), (64, 3, 1, 0)])?;
    layers.dense(&[200, 100, 50, 10, 1])?;
    Ok(layers.net)
}

/// The gesture network of SANA-FE.
pub(super) fn dvs_gesture(name: &str) -> Result<Builder, OutOfRange> {
    let mut layers = Layers::new(name, (1, 32, 32));
    layers.convolve(&[(16, 3, 2, 0), (32, 3, 1, 0), (64, 3, 1, 0), (11, 3, 1, 0)])?;
    layers.dense(&[11])?;
    Ok(layers.net)
}

/// Eleven million compartments.
pub(super) fn conv_10m(name: &str) -> Result<Builder, OutOfRange> {
    let mut layers = Layers::new(name, (2, 512, 512));
    layers.threshold = 650;
    layers.convolve(&[(16, 3, 1, 1), (32, 3, 2, 1), (32, 3, 1, 1), (64, 3, 2, 1), (64, 3, 1, 1), (128, 3, 2, 1)])?;
    layers.pool(16)?;
    layers.dense(&[11])?;
    Ok(layers.net)
}

fn conv_98k(name: &str) -> Result<Builder, OutOfRange> {
    let mut layers = Layers::new(name, (2, 128, 128));
    layers.threshold = 800;
    layers.convolve(&[(4, 3, 1, 1), (8, 3, 2, 1)])?;
    Ok(layers.net)
}

/// A random network: see the module.
///
/// The recurrent synapses are divided evenly among these delay fields.
///
/// # Errors
/// [`BuildError`] when there is no compartment, or a delay does not fit its field.
pub fn random(name: &str, sizes: Random, delays: &[i64]) -> Result<BenchNetwork, BuildError> {
    let n = sizes.compartments;
    let (mut net, drive, neurons) = Builder::driven(name, n)?;
    if sizes.background > 0 {
        net.connect(drive, neurons, 0, random_synapses(n, sizes.background, 1))?;
    }
    spread(&mut net, (neurons, neurons), n, delays)?;
    let spikes = |t| {
        let channel = move |k| rng::below(u64::from(n), 3, u64::from(t), u64::from(k)) as u32;
        (0..sizes.driven).map(move |k| (t, ChannelId(channel(k))))
    };
    let events: Vec<_> = (0..sizes.period).flat_map(spikes).collect();
    let period = Sample::new(sizes.period, &events, None)?;
    let target = if n > 100_000 { "pohoiki-springs" } else { "nahuku-32" };
    Ok(BenchNetwork { network: net.build()?, period, target })
}

/// A network whose steps have synaptic events only: channels with 64 random synapses each, onto
/// compartments that never fire; `driven` channels spike in a step.
///
/// # Errors
/// [`BuildError`] when there is no compartment.
pub fn events_only(compartments: u32, driven: u32, period: u32) -> Result<BenchNetwork, BuildError> {
    events_over("events-only", compartments, driven, period, &[0])
}

fn events_over(
    name: &str,
    compartments: u32,
    driven: u32,
    period: u32,
    delays: &[i64],
) -> Result<BenchNetwork, BuildError> {
    let mut net = Builder::new(name);
    let drive = net.input("drive", compartments);
    // Without memory, and with the greatest threshold.
    let neurons = net.compartments("neurons", compartments, PerCompartment::Same(Neuron::PLAIN));
    spread(&mut net, (drive, neurons), compartments, delays)?;
    // A stride coprime to the number of channels visits every channel before it repeats one.
    let stride = (1..).map(|k| 7_919 + 2 * k).find(|&s| gcd(s, u64::from(compartments)) == 1).unwrap_or(1);
    let channel = |k: u64| ChannelId((k * stride % u64::from(compartments)) as u32);
    let events: Vec<_> = (0..u64::from(period) * u64::from(driven))
        .map(|k| ((k / u64::from(driven.max(1))) as u32, channel(k)))
        .collect();
    Ok(BenchNetwork { network: net.build()?, period: Sample::new(period, &events, None)?, target: "nahuku-32" })
}

fn gcd(a: u64, b: u64) -> u64 {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use nsim_energy::measure::{Budget, LEAST_REPEATS, measure, quantile};

    use super::*;
    use nsim_golden::Golden;
    use nsim_ir::activity::Totals;
    use nsim_ir::spikes::Engine;

    /// Mean spikes, events and active updates of a settled network's step, by the interpreter.
    fn settled(bench: &BenchNetwork, steps: u32) -> (f64, f64, f64) {
        let mut engine = Golden::new(&bench.network);
        engine.begin(u32::MAX);
        let mut run = |from: u32, to: u32| -> Totals {
            (from..to).for_each(|t| engine.step(bench.period.input(t % bench.period.steps())));
            engine.totals()
        };
        let (before, after) = (run(0, 40), run(40, 40 + steps));
        let per_step = |count: fn(&Totals) -> u64| (count(&after) - count(&before)) as f64 / f64::from(steps);
        (per_step(|t| t.spikes), per_step(|t| t.synaptic_events), per_step(|t| t.active_updates))
    }

    #[test]
    fn the_visual_tactile_rows_have_about_400_and_2000_events_a_step() {
        for (standard, low, high) in
            [(StandardNetwork::VtSnn1Pct, 370.0, 430.0), (StandardNetwork::VtSnn5Pct, 1900.0, 2100.0)]
        {
            let bench = standard.build().unwrap();
            assert_eq!((bench.network.channels(), bench.network.compartments()), (3306, 62));
            let (spikes, events, _) = settled(&bench, 2000);
            assert!((low..high).contains(&events), "{}: {events} events", standard.name());
            assert!(spikes > 0.1, "{}: {spikes} spikes a step", standard.name());
        }
    }

    #[test]
    fn random_32k_fires_as_it_says_and_every_compartment_moves() {
        let bench = StandardNetwork::Random32k.build().unwrap();
        let (spikes, events, active) = settled(&bench, 60);
        assert!((spikes / 32_768.0 - 0.021).abs() < 0.001, "{spikes} spikes a step");
        assert!((events - 47_500.0).abs() < 1_000.0, "{events} events a step");
        assert!(active > 0.99 * 32_768.0, "{active} compartments not at rest");
    }

    #[test]
    fn a_random_network_of_any_size_fires_as_it_is_driven() {
        // random-1m in small: 1 % firing and 64 synapses give 0.64 recurrent events a compartment.
        let bench =
            random("small", Random { compartments: 10_000, background: 0, driven: 102, period: 64 }, &[0]).unwrap();
        let (spikes, events, _) = settled(&bench, 120);
        assert!((spikes - 100.0).abs() < 3.0, "{spikes} spikes a step");
        assert!((events - 6_500.0).abs() < 200.0, "{events} events a step");
    }

    #[test]
    fn events_only_has_the_events_asked_for_and_no_spike() {
        for driven in [2, 16, 156, 1_562] {
            let bench = events_only(4_096, driven, 16).unwrap();
            let (spikes, events, _) = settled(&bench, 32);
            assert_eq!((spikes, events), (0.0, f64::from(driven * FAN_OUT)));
        }
    }

    #[test]
    fn networks_that_share_a_program_are_equal() {
        for standard in StandardNetwork::ALL {
            let (own, other) = (standard.build().unwrap(), standard.program_of().build().unwrap());
            assert_eq!(own.target, other.target);
            let said = |bench: &BenchNetwork| {
                let parts = bench.network.parts();
                format!("{:?} {:?}", parts.populations, parts.projections)
            };
            // Printing a million one-to-one synapses takes long; seeded ones are the same code.
            if own.network.compartments() < 100_000 {
                assert_eq!(said(&own), said(&other), "{}", standard.name());
            }
        }
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let numbers = [1.0, 2.0, 4.0, 8.0];
        assert_eq!([0.0, 0.5, 0.75, 1.0].map(|q| quantile(&numbers, q)), [1.0, 3.0, 5.0, 8.0]);
        assert_eq!(quantile(&[3.0], 0.25), 3.0);
    }

    #[test]
    fn exactly_the_steps_asked_for_are_counted() {
        let bench = random("small", Random { compartments: 500, background: 0, driven: 5, period: 8 }, &[0]).unwrap();
        let mut engine = Golden::new(&bench.network);
        let measured = measure(&mut engine, &bench.period, Budget::Steps(24));
        assert_eq!((measured.repeats, measured.steps), (1, 24));
        assert_eq!(measured.totals.compartment_updates, 24 * 500);
        assert_eq!(measured.totals.spikes_in, 3 * bench.period.spikes() as u64);
        let timed = measure(&mut engine, &bench.period, Budget::Time(Duration::ZERO));
        assert_eq!(timed.repeats, LEAST_REPEATS);
        assert_eq!(timed.totals.compartment_updates, 500 * timed.steps * timed.repeats as u64);
        assert!(timed.us_per_timestep > 0.0 && timed.spread >= 0.0);
        assert!(timed.fastest <= timed.us_per_timestep);
    }
}
