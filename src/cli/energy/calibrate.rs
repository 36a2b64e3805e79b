//! `nsim energy --calibrate TABLE`: named constants fitted to a table, or a table only compared.

use crate::base::diagnostic::Diagnostic;
use crate::cli::args::jobs::{self, JobArgs, Prepared, Wanted};
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::args::EnergyArgs;
use crate::cli::energy::options::DeploymentSource;
use crate::cli::energy::workload::Workload;
use crate::cli::output;
use crate::compile::Compiled;
use crate::cost::calibrate::{Cell, Unknown, fit};
use crate::cost::estimate::{Case, Convention, EnergyRow, estimate};
use crate::cost::{CostTable, Deployment};
use crate::desc::published::measurement::{FittedConstant, MeasurementsFile};
use crate::desc::target::{Constants, Residual, Status, Unit};
use crate::error::Error;
use crate::io;
use crate::report::energy::calibration::{CalibrationReport, Fitted};

/// Figures that are fitted; energy and its product with delay follow from them.
const MEASURED: [&str; 4] = ["static_mw", "dynamic_mw", "total_mw", "latency_us"];

/// The table's workload with everything that the constants are fitted under.
struct Bench<'a> {
    args: &'a EnergyArgs,
    table: &'a MeasurementsFile,
    workload: &'a Workload<'a>,
    deployment: Deployment,
    convention: Convention,
    context: Context,
}

impl Bench<'_> {
    /// The rows that each of these presets predicts, in the convention of the table.
    fn rows(&self, presets: &[Constants]) -> Result<Vec<Vec<EnergyRow>>, Error> {
        let tables = presets.iter().map(CostTable::new).collect::<Result<Vec<_>, _>>()?;
        let metered = self.workload.metered(tables, &self.deployment, self.args.transport);
        let skip = self.args.skip == Switch::On;
        let run = self.workload.simulate(metered, None, skip, self.context)?;
        let timestep_ms = self.workload.compiled.one.parts().timestep_ms;
        let case = |preset| Case {
            preset,
            mode: self.table.mode,
            convention: self.convention,
            steps_per_sample: Some(self.table.steps_per_sample),
            ..Case::new(&run.activity, &run.meter, &self.deployment, timestep_ms)
        };
        Ok((0..presets.len()).map(|preset| estimate(&case(preset)).rows).collect())
    }
}

/// A cell's figure in predicted rows.
fn figure(rows: &[EnergyRow], unit: &str, figure: &str) -> Result<f64, Error> {
    rows.iter().find(|row| row.unit == unit).and_then(|row| row.figure(figure)).ok_or_else(|| {
        Diagnostic::new("calibrate.unknown", format!("the run predicts no {figure} of {unit}: it has no timesteps"))
            .into()
    })
}

/// The least step of a constant that its integer unit can hold.
fn step(unit: Unit) -> f64 {
    match unit {
        Unit::pJ | Unit::ns => 1e-3,
        Unit::us | Unit::mW => 1e-6,
        Unit::messages => 1.0,
    }
}

/// A preset with these values of the fitted constants.
fn with(start: &Constants, fitted: &[FittedConstant], values: &[f64]) -> Constants {
    let mut preset = start.clone();
    for (constants, &value) in fitted.iter().zip(values) {
        for name in std::iter::once(&constants.constant).chain(&constants.equal) {
            if let Some(constant) = preset.get_mut(&name.value) {
                constant.value = value.into();
            }
        }
    }
    preset
}

fn fitted(bench: &Bench<'_>, start: &Constants) -> Result<(Constants, Vec<String>), Error> {
    let table = bench.table;
    let listed = start.list();
    let unknowns: Vec<Unknown> = table
        .fit
        .iter()
        .filter_map(|fitted| listed.iter().find(|(name, _)| *name == fitted.constant.value))
        .map(|(name, constant)| Unknown {
            name: (*name).to_string(),
            start: constant.value.value,
            step: step(constant.unit),
        })
        .collect();
    let cells: Vec<_> = table.cells.iter().filter(|cell| MEASURED.contains(&cell.figure.value.as_str())).collect();
    let measured: Vec<Cell> =
        cells.iter().filter_map(|cell| cell.value()).map(|(value, half)| Cell { value, half }).collect();
    let found = fit(&unknowns, &measured, |lists: &[Vec<f64>]| {
        let presets: Vec<Constants> = lists.iter().map(|values| with(start, &table.fit, values)).collect();
        let rows = bench.rows(&presets)?;
        rows.iter()
            .map(|rows| cells.iter().map(|cell| figure(rows, &cell.unit.value, &cell.figure.value)).collect())
            .collect::<Result<Vec<Vec<f64>>, Error>>()
    })?;
    let found = found.map_err(|problem| {
        Diagnostic::new("calibrate.no-fit", format!("{}: {problem}", table.name))
            .help("let it fit fewer constants, or give it more cells")
    })?;
    let zero = |i: usize| {
        let name = &unknowns[i].name;
        format!("{name} would be negative and is 0: the simulated activity explains more than was measured")
    };
    let mut preset = with(start, &table.fit, &found.values);
    preset.name = table.preset.clone().unwrap_or_else(|| format!("{}-fitted", table.name));
    for fitted in &table.fit {
        for name in std::iter::once(&fitted.constant).chain(&fitted.equal) {
            if let Some(constant) = preset.get_mut(&name.value) {
                constant.status = Status::Calibrated;
                constant.source = format!("fitted to {}: {}", table.source, fitted.because);
            }
        }
    }
    Ok((preset, found.at_zero.into_iter().map(zero).collect()))
}

fn residuals(table: &MeasurementsFile, rows: &[EnergyRow]) -> Result<Vec<Residual>, Error> {
    let residual = |cell: &crate::desc::published::measurement::MeasuredCell| {
        let model = figure(rows, &cell.unit.value, &cell.figure.value)?;
        let value = cell.value().map_or(f64::NAN, |(value, _)| value);
        let short = |x: f64, digits: i32| {
            let scale = 10f64.powi(digits);
            (x * scale).round() / scale
        };
        Ok(Residual {
            cell: format!("{} {}", cell.unit.value, cell.figure.value),
            printed: cell.printed.value.clone(),
            model: short(model, 6),
            percent: short(100.0 * (model / value - 1.0), 3),
        })
    };
    table.cells.iter().map(residual).collect()
}

/// The command.
///
/// # Errors
/// [`Error`] when the table, its model or its target cannot be used, or the constants cannot be fitted.
pub fn run(args: &EnergyArgs, table: &str, context: Context) -> Result<Answer, Error> {
    io::write::check_all_free(&args.output, context.force)?;
    let table = io::published::measurement::load_measurements(table)?;
    let asked = JobArgs { model: table.model.clone(), target: table.target.clone(), ..args.job.clone() };
    let job = match jobs::prepare(&asked, Wanted::Mapped, table.copies)? {
        Prepared::Ready(job) => job,
        Prepared::DoesNotFit(refusal) => return refusal.say(CalibrationReport::nothing(&table.name), context),
    };
    let workload = Workload::new(&job, table.copies, &args.input)?;
    let start = args.constants.as_deref().unwrap_or(&table.start.value);
    let mut start = io::target::load_constants(start)?;
    if args.constants.is_none() {
        for given in &table.given {
            if let Some(constant) = start.get_mut(&given.constant.value) {
                *constant = given.is.clone();
            }
        }
    }
    let scenario = io::published::scenario::shipped_for(&table.model)?;
    let source = DeploymentSource::load(&table.deployment.as_str().into(), &table.model, scenario.as_ref())?;
    let Compiled { one, placement, .. } = workload.compiled;
    let deployment = source.deployment(&one.parts().name, table.copies, placement, workload.target)?;
    let convention = scenario.map_or(Convention::Published, |scenario| scenario.convention);
    let bench = Bench { args, table: &table, workload: &workload, deployment, convention, context };
    let (mut preset, notes) = match table.fit.is_empty() {
        true => (start.clone(), Vec::new()),
        false => fitted(&bench, &start)?,
    };
    let rows = bench.rows(std::slice::from_ref(&preset))?;
    preset.residuals = residuals(&table, &rows[0])?;
    let samples = workload.samples();
    let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let spikes: u64 = samples.iter().map(|sample| sample.spikes() as u64).sum();
    let activity = format!(
        "{} shown {} ({} samples, {steps} steps, {:.3} input spikes a step and copy)",
        table.model,
        workload.origin.join(", "),
        samples.len(),
        spikes as f64 / steps.max(1) as f64
    );
    let names = table.fit.iter().flat_map(|fit| std::iter::once(&fit.constant).chain(&fit.equal));
    let names: Vec<&str> = names.map(|name| name.value.as_str()).collect();
    preset.notes = format!(
        "Fitted to {} on the activity of {activity}, by least squares over its cells of power and latency, each weighed by its \
         rounding: {}. Everything else is from {}.",
        table.source,
        names.join(", "),
        start.name
    );
    let listed = preset.list();
    let fitted = names.iter().filter_map(|name| listed.iter().find(|(listed, _)| listed == name));
    let fitted = fitted.map(|(name, constant)| Fitted { name, value: constant.value.value, unit: constant.unit });
    let report = CalibrationReport {
        table: &table,
        start: &start.name,
        preset: &preset.name,
        activity: &activity,
        seed: workload.seed,
        fitted: fitted.collect(),
        residuals: &preset.residuals,
        notes: &notes,
    };
    if let Some(output) = &args.output {
        let remark = format!("Written by: nsim energy --calibrate {}", table.name);
        io::write::text(output, context.force, &io::target::constants_text(&preset, &remark))?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}
