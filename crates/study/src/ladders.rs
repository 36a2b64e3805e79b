//! Ladders: run time of a synaptic event along one property of a network or a run, to find cliffs.
//!
//! Input: a seed, which determines the fixed properties of a ladder. Output: for each rung the time
//! of an event, the goal, and whether it is a *cliff*. The goal is the sum of the goals of the
//! class and of the updates between two events. A cliff takes more than [`CLIFF`] times as long as
//! a neighbour; a goal longer than the neighbour's raises this limit in proportion. Times include
//! all of a user's run, also sums of counts. On several threads a time is the total of all threads.
//! Errors: a network that does not map, an internal error.

use nsim_compile::{Options, Strategy, compile};
use nsim_files::target::load_target;
use nsim_ir::base::fixed::{BiasMantissa, OutOfRange};
use nsim_ir::base::id::ChannelId;
use nsim_ir::base::rng;
use nsim_ir::graph::PerCompartment;
use nsim_ir::quantised::{Neuron, Quantised};
use nsim_ir::spikes::Sample;
use nsim_session::SampleSettings;
use nsim_session::error::Error;
use nsim_session::samples::{Division, RunSettings, fast_on_image, lay_out};

use crate::networks::builder::Builder;
use crate::networks::delivery::{NEVER, silent};
use crate::networks::layers::Layers;
use crate::networks::{BuildError, random_synapses};

/// Ratio of a cliff's time to a neighbour's, at least.
pub const CLIFF: f64 = 2.5;
/// The goal of a compartment's update, in nanoseconds: a million compartments in 0.57 ms, as
/// `nsim bench step` measured `silent-1m` without skipping (AVX-512, `docs/benchmarks.md`).
const UPDATE_NS: f64 = 0.6;
/// The goal of the update of a compartment that its own bias drives, in nanoseconds.
const BIASED_UPDATE_NS: f64 = 6.0;
/// Runs of a rung, of which the fastest counts: other programs only make runs longer.
const REPEATS: usize = 15;
/// Approximate number of synaptic events of a run.
const EVENTS: u64 = 12_000_000;
/// The longest delay of a ladder.
const LONGEST: u32 = 60;
/// The target that everything is mapped to.
const TARGET: &str = "pohoiki-springs";

/// A kind of connections, which has a goal of its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Class {
    /// Random synapses, over this number of delays.
    Lists { fan_out: u32, delays: u32 },
    /// Dense synapses.
    Dense,
    /// A square kernel of this side, to all channels or each to its own.
    Convolution { kernel: u32, depthwise: bool },
}

impl Class {
    /// Name, and goal in nanoseconds an event on one thread of a server's processor.
    fn goal(self) -> (&'static str, f64) {
        match self {
            Class::Lists { delays: 1, fan_out: 64.. } => ("lists", 1.6),
            Class::Lists { delays: 1, .. } => ("short lists", 4.0),
            Class::Lists { .. } => ("delays", 4.0),
            Class::Dense => ("dense", 0.06),
            Class::Convolution { depthwise: false, .. } => ("convolution", 0.15),
            Class::Convolution { depthwise: true, .. } => ("depthwise", 0.3),
        }
    }
}

/// A rung of a ladder: a network and the settings of its run.
#[derive(Debug, Clone)]
pub struct LadderCase {
    /// Property that differs along the ladder.
    pub ladder: &'static str,
    /// Its value here.
    pub at: String,
    class: Class,
    /// Compartments of a random or dense network; channels of a convolution.
    size: u32,
    populations: u32,
    /// Number of different biases that drive the compartments; 0 for none.
    biases: u32,
    /// Sources in 1,000 that spike in a step.
    per_mille: u64,
    /// Steps of a sample.
    steps: u32,
    strategy: Strategy,
    threads: usize,
    seed: u64,
}

/// Measurements of a rung.
#[derive(Debug, Clone, serde::Serialize)]
pub struct LadderRow {
    /// Property that differs along the ladder.
    pub ladder: &'static str,
    /// Its value here.
    pub at: String,
    /// The class of its connections.
    pub class: &'static str,
    /// Synaptic events of a run.
    #[serde(rename = "synaptic_events")]
    pub events: u64,
    /// Thread time of an event, nanoseconds.
    pub ns_an_event: f64,
    /// Goal in nanoseconds: of the class, plus the compartment updates of an event.
    #[serde(rename = "goal_ns")]
    pub goal: f64,
    /// Whether it takes too long compared with its neighbours.
    #[serde(rename = "cliff")]
    pub is_cliff: bool,
}

/// The rungs of all ladders, generated from `seed`, for up to `threads` threads.
pub fn ladder_cases(seed: u64, threads: usize) -> Vec<LadderCase> {
    let mut cases = Vec::new();
    let base = |ladder: u64| {
        let draw = |what, least: u64, most: u64| least + rng::below(most - least + 1, seed, ladder, what);
        LadderCase {
            ladder: "",
            at: String::new(),
            class: Class::Lists { fan_out: draw(0, 32, 128) as u32, delays: 1 },
            size: draw(1, 4_096, 16_384) as u32,
            populations: 1,
            biases: 0,
            per_mille: draw(2, 10, 50),
            steps: draw(3, 200, 400) as u32,
            strategy: Strategy::default(),
            threads: 1,
            seed: rng::bits(seed, ladder, 4),
        }
    };
    let layer = |ladder| LadderCase { size: 8 * (2 + rng::below(7, seed, ladder, 5) as u32), ..base(ladder) };
    let mut add = |ladder, at: &dyn std::fmt::Display, case: LadderCase| {
        cases.push(LadderCase { ladder, at: at.to_string(), ..case });
    };
    for fan_out in [8, 32, 128, 512] {
        let one = base(0);
        let per_mille = (one.per_mille * 64 / u64::from(fan_out)).clamp(2, 200);
        add("fan-out", &fan_out, LadderCase { class: Class::Lists { fan_out, delays: 1 }, per_mille, ..one });
    }
    for delays in [1, 2, 4, 8, 16, 32, 60] {
        add("delays", &delays, LadderCase { class: Class::Lists { fan_out: 60, delays }, ..base(1) });
    }
    for steps in [2, 8, 32, 128, 512] {
        let class = Class::Lists { fan_out: 64, delays: 2 };
        add("steps of a sample", &steps, LadderCase { class, steps, ..base(2) });
    }
    for per_mille in [5, 20, 80, 320] {
        add("spikes in 1,000", &per_mille, LadderCase { per_mille, ..base(3) });
    }
    for populations in [1, 2, 4, 8, 16, 32, 64] {
        add("populations", &populations, LadderCase { populations, ..base(4) });
    }
    for biases in [2, 16, 256, 4_096] {
        add("biases", &biases, LadderCase { biases, ..base(10) });
    }
    for kernel in [1, 3, 5, 7] {
        add("kernel", &kernel, LadderCase { class: Class::Convolution { kernel, depthwise: false }, ..layer(5) });
    }
    for kernel in [3, 5, 7] {
        let class = Class::Convolution { kernel, depthwise: true };
        add("depthwise kernel", &kernel, LadderCase { class, ..layer(6) });
    }
    for size in [512, 1_024, 2_048, 4_096] {
        add("dense", &size, LadderCase { class: Class::Dense, size, ..base(7) });
    }
    for strategy in Strategy::ALL {
        let class = Class::Convolution { kernel: 3, depthwise: false };
        add("strategy", &strategy.name(), LadderCase { class, strategy, ..layer(8) });
    }
    for count in std::iter::successors(Some(1), |count| Some(2 * count)).take_while(|&count| count <= threads) {
        let class = Class::Convolution { kernel: 3, depthwise: false };
        add("threads", &count, LadderCase { class, threads: count, ..layer(9) });
    }
    cases
}

impl LadderCase {
    fn build(&self) -> Result<Quantised, BuildError> {
        let LadderCase { class, size, populations, biases, seed, .. } = *self;
        if let Class::Convolution { kernel, depthwise } = class {
            let mut layers = Layers::new("ladder", (size, 20, 20));
            layers.threshold = NEVER;
            match depthwise {
                true => layers.convolve_each(kernel, kernel / 2)?,
                false => layers.convolve(&[(size, kernel, 1, kernel / 2)])?,
            }
            layers.net.neurons_of_last(Neuron::PLAIN);
            return Ok(layers.net.build()?);
        }
        let (mut net, size) = (Builder::new("ladder"), size / populations);
        for population in 0..populations {
            let (source, name) = (net.input(&format!("in{population}"), size), format!("out{population}"));
            let target = match biases {
                0 => silent(&mut net, &name, size),
                _ => {
                    let own =
                        |i: u32| Ok(Neuron { bias_mant: BiasMantissa::new((i % biases).into())?, ..Neuron::PLAIN });
                    let neurons = (1..=size).map(own).collect::<Result<_, OutOfRange>>()?;
                    net.compartments(&name, size, PerCompartment::Each(neurons))
                }
            };
            let ends = (source, target);
            match class {
                Class::Lists { fan_out, delays } => {
                    for place in 0..delays {
                        let synapses = random_synapses(size, fan_out / delays, seed + u64::from(place));
                        net.connect(ends.0, ends.1, 0, synapses)?;
                        net.delay_last((place * LONGEST / delays.max(2)).into())?;
                    }
                }
                _ => net.dense(ends, -120, 120, seed)?,
            }
        }
        Ok(net.build()?)
    }

    /// Samples with about [`EVENTS`] synaptic events, for a network of `channels` channels.
    fn samples(&self, channels: u32, synapses: u64) -> Result<Vec<Sample>, BuildError> {
        let spikes = (u64::from(channels) * self.per_mille / 1_000).max(1);
        let events_a_step = spikes * (synapses / u64::from(channels)).max(1);
        let samples = (EVENTS / (events_a_step * u64::from(self.steps))).max(2 * self.threads as u64);
        let sample = |sample: u64| {
            let spike = |index| {
                let channel = rng::below(channels.into(), self.seed, sample, index) as u32;
                ((index / spikes) as u32, ChannelId(channel))
            };
            let events: Vec<_> = (0..spikes * u64::from(self.steps)).map(spike).collect();
            Sample::new(self.steps, &events, None)
        };
        Ok((0..samples).map(sample).collect::<Result<_, _>>()?)
    }

    /// Maps and runs it.
    ///
    /// # Errors
    /// [`Error::Fault`], an internal error, since every rung fits its target.
    pub fn measure(&self) -> Result<LadderRow, Error> {
        let fault = |error: &dyn std::fmt::Display| Error::Fault(format!("{} {}: {error}", self.ladder, self.at));
        let network = self.build().map_err(|error| fault(&error))?;
        let samples = self.samples(network.channels(), network.synapses()).map_err(|error| fault(&error))?;
        let sample_settings = SampleSettings::new(network.output());
        let options = Options { strategy: self.strategy, ..Options::default() };
        let compiled = compile(network, &load_target(TARGET)?, &options).map_err(|error| fault(&error))?;
        let pool = rayon::ThreadPoolBuilder::new().num_threads(self.threads).build().map_err(|error| fault(&error))?;
        let samples: Vec<&Sample> = samples.iter().collect();
        let runs = pool.install(|| {
            let division = Division::new(&compiled.program, samples.len());
            let image = lay_out(&compiled.program, division)?;
            let run = |_| fast_on_image(&image, division, &samples, RunSettings::new(&sample_settings), || ());
            Ok::<_, Error>((0..REPEATS).map(run).map(|run| (run.wall_s, run.activity)).collect::<Vec<_>>())
        })?;
        let events = runs[0].1.sum().synaptic_events();
        let seconds = runs.iter().map(|run| run.0).fold(f64::INFINITY, f64::min);
        let ns_an_event = seconds * 1e9 * self.threads as f64 / events.max(1) as f64;
        // With the sequential strategy a core has a part of one channel, which becomes a list.
        let class = match (self.class, self.strategy) {
            (Class::Convolution { .. }, Strategy::Sequential) => Class::Lists { fan_out: 1, delays: 1 },
            (class, _) => class,
        };
        let ((class, goal), at) = (class.goal(), self.at.clone());
        let updates = u64::from(compiled.program.compartments()) * u64::from(self.steps) * samples.len() as u64;
        let update = if self.biases > 0 { BIASED_UPDATE_NS } else { UPDATE_NS };
        let goal = goal + update * updates as f64 / events.max(1) as f64;
        Ok(LadderRow { ladder: self.ladder, at, class, events, ns_an_event, goal, is_cliff: false })
    }
}

/// Marks the cliffs among rows in the order of [`ladder_cases`].
pub fn mark_cliffs(rows: &mut [LadderRow]) {
    for of_ladder in rows.chunk_by_mut(|a, b| a.ladder == b.ladder) {
        let times: Vec<(f64, f64)> = of_ladder.iter().map(|row| (row.ns_an_event, row.goal)).collect();
        for (place, row) in of_ladder.iter_mut().enumerate() {
            let neighbours = times[place.saturating_sub(1)..times.len().min(place + 2)].iter();
            let most = neighbours.map(|(time, goal)| CLIFF * time * (row.goal / goal).max(1.0));
            row.is_cliff = most.fold(f64::INFINITY, f64::min) < row.ns_an_event;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rung_can_be_built_and_seeds_differ() {
        for case in ladder_cases(1, 2) {
            let network = case.build().unwrap();
            let samples = case.samples(network.channels(), network.synapses()).unwrap();
            assert!(samples.len() >= 2 && samples.iter().all(|sample| sample.steps() == case.steps), "{case:?}");
        }
        let names = |seed| ladder_cases(seed, 4).iter().map(|case| (case.ladder, case.at.clone())).collect::<Vec<_>>();
        let drawn = |seed| ladder_cases(seed, 4).iter().map(|case| (case.size, case.per_mille)).collect::<Vec<_>>();
        assert_eq!((names(1), drawn(1)), (names(2), drawn(1)));
        assert_ne!(drawn(1), drawn(2));
    }

    #[test]
    fn a_cliff_takes_longer_than_a_neighbour_of_its_ladder() {
        let row = |(ladder, ns_an_event, goal)| LadderRow {
            ladder,
            at: String::new(),
            class: "lists",
            events: 1,
            ns_an_event,
            goal,
            is_cliff: false,
        };
        let of_a = [1.0, 2.4, 2.6, 7.0, 1.0].map(|time| ("a", time, 1.0));
        // A longer goal allows as many times more, a shorter one no less.
        let others =
            [("b", 8.0, 1.0), ("b", 59.0, 3.0), ("c", 8.0, 1.0), ("c", 59.0, 0.5), ("d", 8.0, 1.0), ("d", 61.0, 3.0)];
        let mut rows: Vec<LadderRow> = of_a.into_iter().chain(others).map(row).collect();
        mark_cliffs(&mut rows);
        let marked: Vec<_> = rows.iter().filter(|row| row.is_cliff).map(|row| (row.ladder, row.ns_an_event)).collect();
        assert_eq!(marked, [("a", 7.0), ("c", 59.0), ("d", 61.0)]);
    }
}
