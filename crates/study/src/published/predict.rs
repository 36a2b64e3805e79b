//! The figures of a published workload, by simulation and constants.
//!
//! Input: a workload, its target, tables of constants. Output: each figure of the workload under
//! each table. The workload is a network on the cores that its source gave each layer, with the
//! source's numbers of copies, chips and x86 cores; it is run, metered and priced by the functions
//! that price a user's network.

use std::sync::Arc;

use super::network::{COUNTED, RateChoice, build, warm_up};
use nsim_compile::{CompileError, Front, Mapping, Options};
use nsim_cost::estimate::{EstimateInput, JobPower};
use nsim_cost::job::{DeployedCores, Mode};
use nsim_cost::meter::Lane;
use nsim_cost::transport::Words;
use nsim_cost::{CostTable, Deployment, HostWork, MessageRoutes, MeterSettings, StepMeter, Transport};
use nsim_energy::published::workload::{Between, Per, PublishedFigure, Quantity, WorkloadFile};
use nsim_ir::activity::Activity;
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::firing_rates;
use nsim_ir::graph::Shape;
use nsim_ir::hardware::Target;
use nsim_ir::partition::seats;
use nsim_ir::placement::{Mesh, Site};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Resource;
use nsim_ir::spikes::Engine;
use nsim_machine::{Image, Machine, Settings};
use nsim_session::error::Error;

/// Error of a workload that cannot be predicted.
fn failed(file: &WorkloadFile, problem: impl std::fmt::Display) -> Error {
    Error::Fault(format!("{}: {problem}", file.name))
}

/// Compartments of each core of one copy: a part fills its cores evenly, or as a bound asks.
fn members(file: &WorkloadFile, choice: RateChoice, network: &Quantised) -> IdVec<CoreId, Vec<CompartmentId>> {
    let is_fullest = choice(Between { value: 0.0, low: 0.0, high: 1.0 }) > 0.0;
    let mut cores = Vec::new();
    for part in &file.layout {
        let of_layer = |name: &str| {
            let population = network.populations().iter().find(|population| population.name == name);
            let first =
                population.and_then(nsim_ir::quantised::Population::first_compartment).map_or(0, |first| first.0);
            let shape = population.map_or(Shape::Line(0), |population| population.shape);
            let ordered: Vec<u32> = match shape.volume() {
                Some((channels, rows, columns)) if part.stripes => {
                    let place = |at: u32| (at / channels % rows) * columns + at / channels / rows;
                    (0..shape.len()).map(|at| at % channels * rows * columns + place(at)).collect()
                }
                _ => (0..shape.len()).collect(),
            };
            ordered.into_iter().map(move |index| CompartmentId(first + index))
        };
        let all: Vec<CompartmentId> = part.layers.iter().flat_map(|name| of_layer(&name.value)).collect();
        let (units, count) = (all.len() as u64, u64::from(part.cores).min(all.len() as u64));
        let cut = |core: u64| match part.uneven && is_fullest {
            true => {
                if core == 0 {
                    0
                } else {
                    (units - count + core) as usize
                }
            }
            false => (core * units / count.max(1)) as usize,
        };
        cores.extend((0..count).map(|core| all[cut(core)..cut(core + 1)].to_vec()));
    }
    cores.into()
}

/// Maps one copy onto the cores of its layout, in the order of the file.
fn mapped(file: &WorkloadFile, choice: RateChoice, network: Quantised, target: &Target) -> Result<Mapping, Error> {
    let failed = |error: CompileError| failed(file, format!("does not compile: {error}"));
    let members = members(file, choice, &network);
    let mesh = Mesh::for_target(target);
    let sites: Option<IdVec<CoreId, Site>> = (0..members.len() as u32).map(|core| mesh.site(core)).collect();
    let sites = sites.ok_or_else(|| failed(CompileError::fault("more cores than the target has")))?;
    seats(network.compartments(), &members).map_err(|error| failed(CompileError::fault(error)))?;
    // The published layout fits its cores, regardless of nsim's counts.
    let mut limits = target.limits().clone();
    for resource in Resource::ALL.into_iter().filter(|&resource| target.limits().is_limited(resource)) {
        limits = limits.with(resource, u32::from(u16::MAX));
    }
    limits = limits.with(Resource::AxonsOut, u32::MAX);
    limits.pools.clear();
    let target = &target.clone().with_limits(limits);
    let (options, rates) = (Options::default(), firing_rates::Rates::assumed(nsim_compile::DEFAULT_RATE));
    let placed =
        Front::from(network).place_on(target, &options, &rates, (members, sites), "printed").map_err(failed)?;
    placed.emit(target, &options).and_then(|unchecked| unchecked.check(target)).map_err(failed)
}

/// The numbers of cores that a workload ran on.
fn deployment(file: &WorkloadFile, target: &Target) -> Deployment {
    let of = file.deployment;
    let cores = DeployedCores { cores_used: of.cores_used, chips_used: of.chips_used, x86_cores: of.x86_cores };
    let work = HostWork { host: file.host.host, ..HostWork::default() };
    let words = |count: u64| Words { count, steps: file.steps };
    Deployment {
        board_chips: of.board_chips,
        x86_cores: of.x86_cores,
        x86_chips: of.x86_cores.min(of.chips_used),
        x86_working: of.x86_working.unwrap_or(of.x86_cores),
        reset: words(file.host.reset_words),
        sent: words(file.host.sent_words),
        ..Deployment::from_numbers(&file.name, cores, target, of.copies, work)
    }
}

/// One figure of a job.
fn figure(
    file: &WorkloadFile,
    asked: &PublishedFigure,
    job: &JobPower,
    lane: &Lane,
    deployment: &Deployment,
    paced: bool,
) -> Option<f64> {
    let steps = lane.whole.steps.max(1) as f64;
    let [injection, turn, .., reset] = lane.whole.parts.map(|part| part as f64 / 1e6 / steps);
    let free_us = lane.whole.time as f64 / 1e6 / steps;
    let step_us = if paced { lane.whole.paced_time as f64 / 1e6 / steps } else { free_us };
    let dynamic = job.core_dynamic? + job.x86_dynamic()?;
    let all = match asked.quantity {
        Quantity::CoreStaticPower => job.core_static,
        Quantity::CoreDynamicPower => job.core_dynamic?,
        Quantity::X86StaticPower => job.x86_static,
        Quantity::X86DynamicPower => job.x86_dynamic()?,
        Quantity::DynamicPower => dynamic,
        Quantity::RailsIdle => job.rails_idle(),
        Quantity::RailsStatic => job.rails_idle() - job.x86_clock,
        Quantity::RailsTotal => job.rails_running()?,
        Quantity::RailsEmpty => job.rails_idle() + job.x86_at_work,
        Quantity::AboveLoaded => job.rails_running()? - job.rails_idle(),
        Quantity::AboveBoot => job.rails_running()? - job.boot,
        Quantity::StepTime => step_us,
        Quantity::SpikingTime => free_us - injection - turn - reset,
        Quantity::ManagementTime => turn + reset,
        // Milliwatts times microseconds are nanojoules.
        Quantity::InferenceDynamicEnergy => dynamic * step_us * f64::from(file.steps) / 1e3,
    };
    let parts = match asked.per {
        Per::Job => 1.0,
        Per::Copy => f64::from(deployment.copies),
        Per::X86Core => deployment.x86_cores as f64,
        Per::Chip => deployment.board_chips as f64,
    };
    Some(all / parts.max(1.0))
}

/// The figures of a workload under each table, in the order of the file; unknown ones are NaN.
///
/// # Errors
/// [`Error`] where the network cannot be built, does not fit its layout, or sums are inexact.
pub fn predict(
    file: &WorkloadFile,
    target: &Target,
    choice: RateChoice,
    tables: &[CostTable],
) -> Result<Vec<Vec<f64>>, Error> {
    let (network, sample) = build(file, choice).map_err(|error| failed(file, error))?;
    let compiled = mapped(file, choice, network, target)?;
    let deployment = deployment(file, target);
    let timestep = Picoseconds((file.paced_us.unwrap_or(0.0) * 1e6).round() as u64);
    // Biases keep every compartment active; the cost is linear in the share of active steps.
    let share = choice(file.active_share);
    let table = |table: &CostTable| {
        let mut table = table.clone();
        table.compartment_active_energy.0 = (table.compartment_active_energy.0 as f64 * share).round() as u128;
        table.compartment_active_time.0 = (table.compartment_active_time.0 as f64 * share).round() as u64;
        if file.microcode {
            table.compartment_time = table.microcode_time;
        }
        table
    };
    let timing = deployment.timing(Transport::default(), 1);
    let routes = Arc::new(MessageRoutes::of_program(&compiled.program));
    let settings = MeterSettings::new(tables.iter().map(table).collect(), timing, routes, timestep);
    let (mut meter, mut activity) = (StepMeter::new(settings), Activity::new(compiled.program.cores().len()));
    let image = Image::new(&compiled.program, 1).map_err(|error| failed(file, error))?;
    let mut machine = Machine::new(&image, Settings { skip: true, per_step: true });
    let before = warm_up(file, choice);
    machine.begin(before + COUNTED);
    for step in 0..before + COUNTED {
        machine.step(sample.input(step));
        if step >= before {
            meter.add(machine.last_step(), 1, false);
            activity.add_steps(machine.last_step(), 1);
        }
    }
    let mode = if file.paced_us.is_some() { Mode::Realtime } else { Mode::Offline };
    let priced = |preset: usize| {
        let case =
            EstimateInput { preset, copies_counted: 1, mode, ..EstimateInput::new(&activity, &meter, &deployment) };
        let lane = &meter.lanes()[preset];
        let job = case.job(&meter.tables()[preset], &lane.whole);
        let figures = file.figures.iter();
        let of = |asked| figure(file, asked, &job, lane, &deployment, file.paced_us.is_some()).unwrap_or(f64::NAN);
        figures.map(of).collect()
    };
    Ok((0..tables.len()).map(priced).collect())
}
