//! The figures of a published workload, by simulation and constants.
//!
//! Input: a workload, a board, sets of constants. Output: each figure of the workload with the interval that follows from the
//! intervals of constants and rates. A group of constants is moved to its low and to its high end while all others stay; so are
//! the rates where they are assumed, powered cores and reset words where no source says how many. What the groups do to a figure is added up in squares, as for independent errors, on the
//! logarithm of the figure.

use super::network::{COUNTED, RateEnd, WARM_UP, build};
use crate::base::diagnostic::Diagnostic;
use crate::bench::networks::BuildError;
use crate::compile::{CompileError, Effort, Options, Strategy, compile};
use crate::cost::evidence::{ConstantSet, ConstantSets, interval};
use crate::cost::model::{StepTime, step_energy};
use crate::cost::transport::QueueMemory;
use crate::cost::{Host, MessageRoutes, Timing, Transport};
use crate::desc::published::workload::{PublishedFigure, Quantity, WorkloadFile};
use crate::desc::resource::Resource;
use crate::desc::target::Target;
use crate::desc::target::constants::Status;
use crate::ir::spikes::Engine;
use crate::machine::{Image, Machine, Settings};

/// A figure with its interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Predicted {
    /// With constants and rates at their values.
    pub value: f64,
    /// The low end.
    pub low: f64,
    /// The high end.
    pub high: f64,
}

/// Why a workload could not be predicted.
#[derive(Debug, thiserror::Error)]
pub enum PredictError {
    /// A file or a constant cannot be used.
    #[error(transparent)]
    Input(#[from] Diagnostic),
    /// The network could not be built.
    #[error("{0}: {1}")]
    Build(String, BuildError),
    /// It could not be compiled.
    #[error("{0} does not compile")]
    Compile(String, #[source] Box<CompileError>),
    /// Its sums could not be exact.
    #[error("{0}: {1}")]
    Image(String, String),
}

/// Means of a counted step under one set of constants, for one copy.
#[derive(Debug, Clone, Copy, Default)]
struct Means {
    /// Dynamic energy of neuron cores and mesh, nJ.
    event_nj: f64,
    /// Slowest core, transport and barrier, us.
    spiking_us: f64,
    /// Injection and read-out, us.
    injection_us: f64,
}

/// Simulates the workload once and prices it under every set of constants.
fn simulate(
    file: &WorkloadFile,
    target: &Target,
    end: RateEnd,
    sets: &[&ConstantSet],
) -> Result<Vec<Means>, PredictError> {
    let (network, sample) = build(file, end).map_err(|error| PredictError::Build(file.name.clone(), error))?;
    let target = match file.compartments_per_core {
        Some(most) => target.clone().with_limits(target.limits().clone().with(Resource::Compartments, most)),
        None => target.clone(),
    };
    let options = Options { strategy: Strategy::Greedy, effort: Effort::Work(0), ..Options::default() };
    let compiled = compile(network, &target, &options)
        .map_err(|error| PredictError::Compile(file.name.clone(), Box::new(error)))?;
    let routes = MessageRoutes::of_program(&compiled.program);
    // Every chip in use takes part in the barrier, as all of its tiles.
    let tiles = file.deployment.cores_powered.div_ceil(target.chip().cores_per_tile.into());
    // Biases keep every compartment of the network from rest; what that costs is linear in the share of steps in which it is so.
    let share = end.of_range(file.active_share);
    let table = |set: &&ConstantSet| {
        let mut table = set.table.clone();
        table.compartment_active_energy.0 = (table.compartment_active_energy.0 as f64 * share).round() as u128;
        table.compartment_active_time.0 = (table.compartment_active_time.0 as f64 * share).round() as u64;
        table
    };
    let tables: Vec<_> = sets.iter().map(table).collect();
    let image =
        Image::new(&compiled.program, 1).map_err(|error| PredictError::Image(file.name.clone(), error.to_string()))?;
    let mut machine = Machine::new(&image, Settings { skip: true, per_step: true });
    machine.begin(WARM_UP + COUNTED);
    let mut queue = QueueMemory::default();
    let host = Some(Host::even(1, 1));
    let timing = Timing { transport: Transport::Analytic, tiles_used: tiles, host, followed: 1 };
    let mut means = vec![Means::default(); sets.len()];
    for step in 0..WARM_UP + COUNTED {
        machine.step(sample.at(step));
        if step < WARM_UP {
            continue;
        }
        let activity = machine.last_step();
        let times = routes.step_times(activity, &tables, timing, &mut queue);
        for ((means, table), StepTime { injection, readout, slowest_core, transport, barrier }) in
            means.iter_mut().zip(&tables).zip(times)
        {
            let share = 1.0 / f64::from(COUNTED);
            means.event_nj += step_energy(activity, table, 0).total().microjoules() * 1e3 * share;
            means.spiking_us +=
                [slowest_core, transport, barrier].iter().map(|time| time.microseconds()).sum::<f64>() * share;
            // The embedded process has a term of its own.
            let turn = host.map_or(0.0, |host| host.injection(0, table).microseconds());
            means.injection_us += (injection.microseconds() - turn + readout.microseconds()) * share;
        }
    }
    Ok(means)
}

/// What no source prints and no rate follows from.
#[derive(Debug, Clone, Copy)]
struct Scale {
    cores_powered: f64,
    reset_words: f64,
}

impl Scale {
    fn of_workload(file: &WorkloadFile) -> Self {
        Scale {
            cores_powered: file.deployment.cores_powered as f64,
            reset_words: file.host.reset_words_per_inference.value,
        }
    }

    /// Each range at its ends, the other at its value.
    fn ends(self, file: &WorkloadFile) -> [[Scale; 2]; 2] {
        let words = file.host.reset_words_per_inference;
        let cores = match file.deployment.cores_powered_between {
            Some(range) => [range.low as f64, range.high as f64],
            None => [self.cores_powered; 2],
        };
        [
            cores.map(|cores_powered| Scale { cores_powered, ..self }),
            [words.low, words.high].map(|reset_words| Scale { reset_words, ..self }),
        ]
    }
}

/// One figure from the means of a step.
fn figure(file: &WorkloadFile, asked: &PublishedFigure, means: &Means, set: &ConstantSet, scale: Scale) -> f64 {
    let (table, deployment) = (&set.table, &file.deployment);
    let copies = f64::from(deployment.copies);
    let core_nj = copies * means.event_nj + table.core_step_energy.microjoules() * 1e3 * scale.cores_powered;
    let in_turn = f64::from(deployment.copies_per_chip) / f64::from(deployment.x86_cores_per_chip);
    let once_us = set.reset_word_time.microseconds() * scale.reset_words;
    // An x86 core takes its turn in every step, however little of the inputs is its own.
    let turn_us = table.injection_step_time.microseconds() * in_turn.max(1.0);
    let process_us = if file.host.embedded_process { turn_us } else { 0.0 };
    let free_us = means.spiking_us + in_turn * means.injection_us + once_us / f64::from(file.steps) + process_us;
    let step_us = file.paced_us.unwrap_or(free_us);
    let x86_mw = table.x86_busy_power.milliwatts() * deployment.x86_chips.unwrap_or(deployment.x86_cores) as f64;
    let boot_mw = if asked.above_boot { set.x86_boot_power.milliwatts() * deployment.chips_used as f64 } else { 0.0 };
    // 1 nJ in 1 us is 1 mW.
    let core_mw = core_nj / step_us;
    let all = match asked.quantity {
        Quantity::CoreStaticPower => table.core_static_power.milliwatts() * scale.cores_powered,
        Quantity::CoreDynamicPower => core_mw,
        Quantity::X86StaticPower => table.x86_static_power.milliwatts() * deployment.x86_cores as f64,
        Quantity::X86DynamicPower => x86_mw,
        Quantity::DynamicPower => core_mw + x86_mw + boot_mw,
        Quantity::StepTime => return step_us,
        Quantity::SpikingTime => return means.spiking_us,
        Quantity::CoreStepEnergy => core_nj,
        Quantity::InferenceDynamicEnergy => (core_mw + x86_mw) * step_us * f64::from(file.steps) / 1e3,
    };
    let shares = match (asked.per_copy, asked.per_x86_core) {
        (true, _) => copies,
        (false, true) => deployment.x86_cores as f64,
        (false, false) => 1.0,
    };
    all / shares
}

/// The figures of a workload under each collection of constants, in the order of the file.
///
/// # Errors
/// [`PredictError`].
pub fn predict(
    file: &WorkloadFile,
    target: &Target,
    collections: [&ConstantSets; 2],
) -> Result<[Vec<Predicted>; 2], PredictError> {
    let sets: Vec<&ConstantSet> = collections.iter().flat_map(|sets| sets.all()).collect();
    let at_value = simulate(file, target, RateEnd::Value, &sets)?;
    // A published rate has no range.
    let values = collections.map(|sets| &sets.value);
    let ends = match file.activity {
        Status::Published => None,
        _ => Some([simulate(file, target, RateEnd::Low, &values)?, simulate(file, target, RateEnd::High, &values)?]),
    };
    let size = collections[0].all().count();
    Ok([0, 1].map(|which| {
        let own = which * size..which * size + collections[which].all().count();
        let (sets, means) = (&sets[own.clone()], &at_value[own]);
        let one = |asked: &PublishedFigure| {
            let scale = Scale::of_workload(file);
            let value = figure(file, asked, &means[0], sets[0], scale);
            let pairs = means[1..].chunks_exact(2).zip(sets[1..].chunks_exact(2));
            let of_constants =
                pairs.map(|(means, sets)| [0, 1].map(|end| figure(file, asked, &means[end], sets[end], scale)));
            let of_rates =
                ends.iter().map(|ends| [0, 1].map(|end| figure(file, asked, &ends[end][which], sets[0], scale)));
            let of_scale = scale.ends(file).map(|ends| ends.map(|end| figure(file, asked, &means[0], sets[0], end)));
            let (low, high) = interval(value, of_constants.chain(of_rates).chain(of_scale));
            Predicted { value, low, high }
        };
        file.figures.iter().map(one).collect()
    }))
}
