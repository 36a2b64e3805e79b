//! A published job of a shipped model: mapped as published, priced by equal constants, and compared
//! with the printed figures.
//!
//! Input: a scenario, the network, samples. Output: rows of the energy table.

use super::options::CostOptions;
use super::workload::Workload;
use crate::published::measurement::load_measurements;
use crate::published::scenario::ScenarioFile;
use nsim_compile::Mapping;
use nsim_cost::estimate::{Convention, EnergyRow, EstimateInput, FigureSource, RowUnit, estimate};
use nsim_cost::job::Mode;
use nsim_cost::{CostTable, Deployment, HostWork};
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Resource;
use nsim_quantise::relays::with_input_relays;
use nsim_session::SampleSettings;
use nsim_session::error::Error;
use nsim_session::obtain::map_with_defaults;
use nsim_session::priced::MeteredMapping;
use nsim_session::samples::RunSettings;

/// Maps one copy of the network of a job, by the details that the job's source gives.
///
/// # Errors
/// When it does not compile.
pub fn mapped(one: &Quantised, scenario: &ScenarioFile, target: &Target) -> Result<Mapping, Error> {
    let network = if scenario.input_relays { with_input_relays(one)? } else { one.clone() };
    let target = match scenario.compartments_per_core {
        Some(most) => target.clone().with_limits(target.limits().clone().with(Resource::Compartments, most)),
        None => target.clone(),
    };
    Ok(map_with_defaults(network, &target)?)
}

/// Returns the rows of a job by a target's first constants, on the workload's samples. Rows are one
/// x86 core, the neuron cores of one copy, and their total. `is_mapped` says whether the workload's
/// mapping is the job's.
///
/// # Errors
/// As [`mapped`].
pub fn rows(
    workload: &Workload<'_>,
    is_mapped: bool,
    scenario: &ScenarioFile,
    options: &CostOptions,
    target: &Target,
    work: HostWork,
) -> Result<Vec<EnergyRow>, Error> {
    let own = (!is_mapped).then(|| mapped(&workload.compiled.one, scenario, target)).transpose()?;
    let compiled = own.as_ref().unwrap_or(workload.compiled);
    let deployment = Deployment::from_numbers("paper", scenario.deployment.value, target, scenario.copies.value, work);
    let metered = MeteredMapping::new(compiled);
    let settings = metered.settings(vec![CostTable::new(&target.constants()[0])?], &deployment, options.transport);
    let samples = workload.samples();
    let run = metered.run(settings, &samples, RunSettings::new(&SampleSettings::new(compiled.program.output())))?;
    let case = EstimateInput {
        copies_counted: 1,
        hardware: target.chip().hardware(),
        errors: target.errors(&target.constants()[0]),
        mode: options.mode,
        convention: options.convention,
        steps_per_sample: workload.steps_per_sample(),
        ..EstimateInput::new(&run.activity, &run.meter, &deployment)
    };
    let named = |row: EnergyRow| EnergyRow { hardware: format!("{}, as in {}", row.hardware, scenario.work), ..row };
    Ok(estimate(&case).rows.into_iter().map(named).collect())
}

/// The row of a unit that a job's source printed in this mode. Energy is
/// power times time, or as printed in the published convention.
///
/// # Errors
/// When a table of measurements cannot be read.
pub fn printed(
    scenario: &ScenarioFile,
    unit: RowUnit,
    mode: Mode,
    convention: Convention,
    steps: Option<u32>,
) -> Result<Option<(EnergyRow, String)>, Error> {
    for table in &scenario.measured {
        let table = load_measurements(&table.value)?;
        if table.mode != mode {
            continue;
        }
        let cell = |figure: &str| {
            let printed = table.cells.iter().find(|cell| cell.unit.value == unit.name() && cell.figure.value == figure);
            printed.and_then(crate::published::measurement::MeasuredCell::value).map(|(value, _)| value)
        };
        let powers = (cell("static_mw").unwrap_or(0.0), cell("dynamic_mw"));
        let hardware = format!("{}, printed", scenario.work);
        let latency = cell("latency_us");
        let row = EnergyRow::new(&hardware, unit, convention, powers, latency, FigureSource::Published, steps);
        let total_mw = cell("total_mw").or(row.total_mw);
        let energy_uj = match convention {
            Convention::Physical => total_mw.zip(latency).map(|(power, time)| power * time / 1e3),
            Convention::Published => cell("energy_uj"),
        };
        let (edp_pjs, energy_source) = match convention {
            Convention::Physical => (energy_uj.zip(latency).map(|(energy, time)| energy * time), row.energy_source),
            Convention::Published => (cell("edp_pjs"), FigureSource::Published),
        };
        return Ok(Some((EnergyRow { total_mw, energy_uj, edp_pjs, energy_source, ..row }, table.source)));
    }
    Ok(None)
}
