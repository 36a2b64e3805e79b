//! Mappings of the suite's networks, measured.
//!
//! Input: a network and how to map it. Output: a [`MeasuredMapping`] for each combination of
//! options: its resources, spike traffic at an assumed rate, energy and time of a simulated step.
//! Every mapping has passed the checker. Spikes that differ from the golden interpreter's are an
//! error, not a row. A network that is mapped by its kernels is not run; its cost is expected.

use std::sync::Arc;
use std::time::Instant;

use crate::networks::BenchNetwork;
use crate::suite::{STEPS, SuiteCase};
use nsim_compile::explore::traffic::Traffic;
use nsim_compile::{
    CompileError, CopyPlacement, DEFAULT_RATE, Effort, Front, Mapping, Objective, Options, Partitioned, Strategy,
    explore, is_large,
};
use nsim_cost::{MessageRoutes, MeterSettings, StepMeter};
use nsim_golden::Golden;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Engine, Sample};
use nsim_machine::{Image, Machine, Settings};
use nsim_session::error::Error;
use nsim_session::priced::MeteredMapping;
use nsim_session::ranks::peak_mib;

/// Measurements of a mapping.
#[derive(Debug, Clone)]
pub struct MeasuredMapping {
    /// Name of the mapped network of the suite.
    pub network: &'static str,
    /// Strategy by which compartments were assigned to cores.
    pub strategy: Strategy,
    /// Whether cores were placed by traffic.
    pub placed: bool,
    /// Objective of the mapping.
    pub objective: Objective,
    /// Cores in use.
    pub cores: u32,
    /// Chips in use.
    pub chips: u32,
    /// Expected traffic at [`DEFAULT_RATE`].
    pub traffic: Traffic,
    /// Whether energy and time are of simulated steps; else they are the expected ones.
    pub simulated: bool,
    /// Mean energy of a step: events and static power of powered cores, in microjoules.
    pub energy_uj: f64,
    /// Mean time of a step in microseconds.
    pub step_us: f64,
    /// Seconds of all stages, the network itself not included.
    pub seconds: f64,
    /// The process's peak memory while it was mapped, where the system reports it.
    pub peak_mib: Option<f64>,
}

/// Error in place of a row; it happens to no network of the suite.
fn fault(case: &SuiteCase, strategy: Strategy, problem: impl std::fmt::Display) -> Error {
    Error::Fault(format!("{} {}: {problem}", case.name, strategy.name()))
}

/// Spikes of each step, by the golden interpreter.
fn golden(network: &Quantised, sample: &Sample) -> Vec<Vec<u32>> {
    let mut engine = Golden::new(network);
    engine.begin(STEPS);
    let step = |t| {
        engine.step(sample.input(t));
        engine.ascending_spikes().iter().map(|id| id.0).collect()
    };
    (0..STEPS).map(step).collect()
}

/// Strategies, objectives and placements (by traffic or not) of every network's mappings.
pub const MAPPING_VARIANTS: [(Strategy, Objective, &[bool]); 4] = [
    (Strategy::Sequential, Objective::Cores, &[false, true]),
    (Strategy::Greedy, Objective::Cores, &[false, true]),
    (Strategy::Multilevel, Objective::Cores, &[false, true]),
    (Strategy::Multilevel, Objective::Latency, &[true]),
];

/// Entries of [`MAPPING_VARIANTS`] for networks whose synapses are not listed.
const BOX_VARIANTS: [(Strategy, Objective, &[bool]); 1] = [(Strategy::Multilevel, Objective::Cores, &[false, true])];

/// A case with all that its mappings share.
struct Study<'s> {
    case: &'s SuiteCase,
    network: &'s Quantised,
    target: &'s Target,
    rates: Rates,
    /// Whether synapses are not listed.
    in_boxes: bool,
    /// Spikes of each step of one copy, and the sample of all copies, unless it is not run.
    expected: Option<(Vec<Vec<u32>>, Sample)>,
}

/// Maps a case in all ways; calls `row` with each result as soon as it is ready.
///
/// # Errors
/// [`Error::Fault`], which no network of the suite gives.
pub fn map_all(
    case: &SuiteCase,
    bench: &BenchNetwork,
    target: &Target,
    effort_s: u32,
    mut row: impl FnMut(MeasuredMapping),
) -> Result<(), Error> {
    let (network, in_boxes) = (&bench.network, is_large(&bench.network, case.copies));
    let expected =
        (!in_boxes).then(|| (golden(network, &bench.period), bench.period.copies(case.copies, network.channels())));
    let study = Study { case, network, target, rates: Rates::assumed(DEFAULT_RATE), in_boxes, expected };
    let variants = if in_boxes { &BOX_VARIANTS[..] } else { &MAPPING_VARIANTS[..] };
    for &(strategy, objective, places) in variants {
        let failed = |error: CompileError| fault(case, strategy, error);
        let options = Options {
            copies: case.copies,
            placement: CopyPlacement::Packed,
            strategy,
            objective,
            effort: Effort::Work(effort_s),
            ..Options::default()
        };
        reset_peak();
        let begin = Instant::now();
        let partitioned = match study.shared_partition(&options) {
            // Layers that only fit in tiles have no row for the sequential strategy.
            Err(CompileError::DoesNotFit(_)) if strategy == Strategy::Sequential => continue,
            partitioned => partitioned.map_err(failed)?,
        };
        let partition_s = begin.elapsed().as_secs_f64();
        for &place in places {
            if in_boxes {
                reset_peak();
            }
            let (begin, options) = (Instant::now(), Options { place, ..options });
            let mapping = study.mapping(partitioned.as_ref(), &options).map_err(failed)?;
            let seconds = partition_s + begin.elapsed().as_secs_f64();
            row(study.measured(&mapping, &options, seconds)?);
        }
    }
    Ok(())
}

impl Study<'_> {
    fn front(&self) -> Result<Front, CompileError> {
        let front = Front::from(self.network.clone());
        if self.case.relays { front.relay(self.target) } else { Ok(front) }
    }

    /// The partition of both placements, unless a second copy of it takes gigabytes.
    fn shared_partition(&self, options: &Options) -> Result<Option<Partitioned>, CompileError> {
        if self.in_boxes || options.objective != Objective::Cores {
            return Ok(None);
        }
        self.front()?.partition(self.target, options, &self.rates).map(Some)
    }

    fn mapping(&self, partitioned: Option<&Partitioned>, options: &Options) -> Result<Mapping, CompileError> {
        match partitioned {
            Some(partitioned) => {
                partitioned.clone().place(self.target, options)?.emit(self.target, options)?.check(self.target)
            }
            None => explore::map(self.front()?, self.target, options, &self.rates),
        }
    }

    /// Measurements of a mapping by these options, made in `seconds`.
    fn measured(&self, mapping: &Mapping, options: &Options, seconds: f64) -> Result<MeasuredMapping, Error> {
        let (case, peak_mib) = (self.case, peak_mib());
        let traffic = mapping.traffic();
        let (energy_uj, step_us) = match &self.expected {
            Some((golden, sample)) => self.simulated(mapping, sample, golden)?,
            None => {
                let score = mapping.score(&traffic, self.target);
                let score = score.map_err(|error| fault(case, options.strategy, error))?;
                (score.energy_uj, score.step_us)
            }
        };
        Ok(MeasuredMapping {
            network: case.name,
            strategy: options.strategy,
            placed: options.place,
            objective: options.objective,
            cores: mapping.partition.cores() as u32,
            chips: mapping.placement.chips_used(),
            traffic,
            simulated: self.expected.is_some(),
            energy_uj,
            step_us,
            seconds,
            peak_mib,
        })
    }

    /// Mean energy and time of a step; the network's own spikes must equal golden's.
    fn simulated(&self, compiled: &Mapping, sample: &Sample, golden: &[Vec<u32>]) -> Result<(f64, f64), Error> {
        let (case, strategy, own) = (self.case, compiled.options.strategy, self.network.compartments());
        let (settings, deployment) =
            MeteredMapping::new(compiled).offline(self.target).map_err(|error| fault(case, strategy, error))?;
        // Every core runs, so the routes are the program's.
        let routes = Arc::new(MessageRoutes::of_program(&compiled.program));
        let cores = settings.tables[0].core_static_power.milliwatts() * deployment.cores_used as f64;
        let mut meter = StepMeter::new(MeterSettings { routes, ..settings });
        let image = Image::new(&compiled.program, 1).map_err(|error| fault(case, strategy, error))?;
        let mut machine = Machine::new(&image, Settings { skip: true, per_step: true });
        machine.begin(STEPS);
        let of_copy = compiled.one.compartments();
        for step in 0..STEPS {
            machine.step(sample.input(step));
            let copies = (0..case.copies).flat_map(|k| golden[step as usize].iter().map(move |id| id + k * of_copy));
            // Spikes of relays are skipped: the network has none.
            let spikes = machine.ascending_spikes();
            if !spikes.iter().map(|id| id.0).filter(|id| id % of_copy < own).eq(copies) {
                return Err(fault(case, strategy, format!("step {step} has other spikes than golden")));
            }
            meter.add(machine.last_step(), 1, false);
        }
        let sums = meter.lanes()[0].whole;
        let steps = f64::from(STEPS);
        let time: f64 = sums.time as f64 / 1e6 / steps;
        let dynamic: f64 = sums.energy.microjoules() / steps;
        // Milliwatts times microseconds are nanojoules.
        Ok((dynamic + cores * time * 1e-3, time))
    }
}

/// Resets the peak of memory, where Linux allows it.
fn reset_peak() {
    // Where this fails, the peak includes earlier work and is at worst too large.
    let _ = std::fs::write("/proc/self/clear_refs", "5");
}
