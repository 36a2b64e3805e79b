//! `nsim energy --calibrate TABLE..`: constants that tables name, fitted to all their cells, or tables only compared.

use crate::base::diagnostic::Diagnostic;
use crate::cli::args::jobs::{self, JobArgs, Prepared, Wanted};
use crate::cli::args::values::Switch;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::args::EnergyArgs;
use crate::cli::energy::workload::{simulate, workload};
use crate::cli::output;
use crate::compile::Compiled;
use crate::cost::calibrate::{Cell, Unknown, fit};
use crate::cost::estimate::{Case, Convention, EnergyRow, estimate};
use crate::cost::{CostTable, Deployment};
use crate::desc::published::measurement::{FittedConstant, MeasurementsFile};
use crate::desc::target::constants::{Constants, Residual, Status, Unit};
use crate::energy::options::DeploymentSource;
use crate::energy::workload::Workload;
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

impl<'a> Bench<'a> {
    fn new(
        args: &'a EnergyArgs,
        table: &'a MeasurementsFile,
        workload: &'a Workload<'a>,
        context: Context,
    ) -> Result<Self, Error> {
        let scenario = io::published::scenario::shipped_for(&table.model)?;
        let source = DeploymentSource::load(&table.deployment.as_str().into(), &table.model, scenario.as_ref())?;
        let Compiled { one, placement, .. } = workload.compiled;
        let deployment = source.deployment(&one.parts().name, table.copies, placement, workload.target)?;
        let convention = scenario.map_or(Convention::Published, |scenario| scenario.convention);
        Ok(Bench { args, table, workload, deployment, convention, context })
    }

    /// What the figures are the activity of, in words.
    fn activity(&self) -> String {
        let samples = self.workload.samples();
        let steps: u64 = samples.iter().map(|sample| u64::from(sample.steps())).sum();
        let spikes: u64 = samples.iter().map(|sample| sample.spikes() as u64).sum();
        format!(
            "{} shown {} ({} samples, {steps} steps, {:.3} input spikes a step and copy)",
            self.table.model,
            self.workload.origin.join(", "),
            samples.len(),
            spikes as f64 / steps.max(1) as f64
        )
    }

    /// The rows that each of these presets predicts, in the convention of the table.
    fn rows(&self, presets: &[Constants]) -> Result<Vec<Vec<EnergyRow>>, Error> {
        let tables = presets.iter().map(CostTable::new).collect::<Result<Vec<_>, _>>()?;
        let mut metered = self.workload.metered(tables, &self.deployment, self.args.cost.transport);
        metered.timing.followed = presets.len();
        let skip = self.args.cost.skip == Switch::On;
        let run = simulate(self.workload, metered, None, skip, self.context)?;
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
fn with(start: &Constants, fitted: &[&FittedConstant], values: &[f64]) -> Constants {
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

/// What the tables fit, each constant once.
fn asked<'t>(benches: &[Bench<'t>]) -> Vec<&'t FittedConstant> {
    let mut asked: Vec<&FittedConstant> = Vec::new();
    for fitted in benches.iter().flat_map(|bench| &bench.table.fit) {
        if !asked.iter().any(|known| known.constant.value == fitted.constant.value) {
            asked.push(fitted);
        }
    }
    asked
}

fn fitted(benches: &[Bench<'_>], start: &Constants) -> Result<(Constants, Vec<String>), Error> {
    let asked = asked(benches);
    let listed = start.list();
    let unknowns: Vec<Unknown> = asked
        .iter()
        .filter_map(|fitted| listed.iter().find(|(name, _)| *name == fitted.constant.value))
        .map(|(name, constant)| Unknown {
            name: (*name).to_string(),
            start: constant.value.value,
            step: step(constant.unit),
        })
        .collect();
    let cells = |bench: &Bench<'_>| -> Vec<_> {
        bench.table.cells.iter().filter(|cell| MEASURED.contains(&cell.figure.value.as_str())).cloned().collect()
    };
    let measured: Vec<Cell> = benches
        .iter()
        .flat_map(cells)
        .filter_map(|cell| cell.value())
        .map(|(value, half)| Cell { value, half })
        .collect();
    let found = fit(&unknowns, &measured, |lists: &[Vec<f64>]| {
        let presets: Vec<Constants> = lists.iter().map(|values| with(start, &asked, values)).collect();
        let mut predicted = vec![Vec::new(); presets.len()];
        for bench in benches {
            let cells = cells(bench);
            for (predicted, rows) in predicted.iter_mut().zip(bench.rows(&presets)?) {
                for cell in &cells {
                    predicted.push(figure(&rows, &cell.unit.value, &cell.figure.value)?);
                }
            }
        }
        Ok::<_, Error>(predicted)
    })?;
    let names: Vec<&str> = benches.iter().map(|bench| bench.table.name.as_str()).collect();
    let found = found.map_err(|problem| {
        Diagnostic::new("calibrate.no-fit", format!("{}: {problem}", names.join(", ")))
            .help("let it fit fewer constants, or give it more cells")
    })?;
    let zero = |i: usize| {
        let name = &unknowns[i].name;
        format!("{name} would be negative and is 0: the simulated activity explains more than was measured")
    };
    let mut preset = with(start, &asked, &found.values);
    preset.name = match benches {
        [bench] => bench.table.preset.clone().unwrap_or_else(|| format!("{}-fitted", bench.table.name)),
        _ => format!("{}-fitted", names.join("-")),
    };
    for fitted in &asked {
        let sources: Vec<&str> = benches
            .iter()
            .filter(|bench| bench.table.fit.iter().any(|own| own.constant.value == fitted.constant.value))
            .map(|bench| bench.table.source.as_str())
            .collect();
        for name in std::iter::once(&fitted.constant).chain(&fitted.equal) {
            if let Some(constant) = preset.get_mut(&name.value) {
                constant.status = Status::Calibrated;
                constant.source = format!("fitted to {}: {}", sources.join("; "), fitted.because);
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
/// [`Error`] when a table, its model or its target cannot be used, or the constants cannot be fitted.
pub fn run(args: &EnergyArgs, context: Context) -> Result<Answer, Error> {
    io::write::check_all_free(&args.output, context.force)?;
    let load = |name: &String| io::published::measurement::load_measurements(name);
    let tables = args.calibrate.iter().map(load).collect::<Result<Vec<_>, _>>()?;
    let mut jobs = Vec::with_capacity(tables.len());
    for table in &tables {
        let asked = JobArgs { model: table.model.clone(), target: table.target.clone(), ..args.cost.job.clone() };
        match jobs::prepare(&asked, Wanted::Mapped, table.copies)? {
            Prepared::Ready(job) => jobs.push(job),
            Prepared::DoesNotFit(refusal) => return refusal.say(CalibrationReport::nothing(&table.name), context),
        }
    }
    let workloads = jobs.iter().map(|job| workload(job, &args.cost.input));
    let workloads = workloads.collect::<Result<Vec<_>, _>>()?;
    let start = start(args, &tables)?;
    let bench = |(table, workload)| Bench::new(args, table, workload, context);
    let benches = tables.iter().zip(&workloads).map(bench).collect::<Result<Vec<_>, _>>()?;
    let (mut preset, notes) = match asked(&benches).is_empty() {
        true => (start.clone(), Vec::new()),
        false => fitted(&benches, &start)?,
    };
    let mut all = Vec::new();
    for bench in &benches {
        let rows = bench.rows(std::slice::from_ref(&preset))?;
        let mut own = residuals(bench.table, &rows[0])?;
        if benches.len() > 1 {
            own.iter_mut().for_each(|residual| residual.cell = format!("{} {}", bench.table.name, residual.cell));
        }
        all.append(&mut own);
    }
    preset.residuals = all;
    let activities: Vec<String> = benches.iter().map(Bench::activity).collect();
    let names = asked(&benches).into_iter().flat_map(|fit| std::iter::once(&fit.constant).chain(&fit.equal));
    let names: Vec<&str> = names.map(|name| name.value.as_str()).collect();
    let sources: Vec<&str> = tables.iter().map(|table| table.source.as_str()).collect();
    preset.notes = format!(
        "Fitted to {} on the activity of {}, by least squares over its cells of power and latency, each weighed by its \
         rounding: {}. Everything else is from {}.",
        sources.join("; "),
        activities.join("; "),
        names.join(", "),
        start.name
    );
    let listed = preset.list();
    let fitted = names.iter().filter_map(|name| listed.iter().find(|(listed, _)| listed == name));
    let fitted = fitted.map(|(name, constant)| Fitted { name, value: constant.value.value, unit: constant.unit });
    let report = CalibrationReport {
        tables: &tables,
        start: &start.name,
        preset: &preset.name,
        activity: &activities.join("; "),
        seed: workloads.first().and_then(|workload| workload.seed),
        fitted: fitted.collect(),
        residuals: &preset.residuals,
        notes: &notes,
    };
    if let Some(output) = &args.output {
        let remark = format!("Written by: nsim energy --calibrate {}", args.calibrate.join(" "));
        io::write::text(output, context.force, &io::target::constants_text(&preset, &remark))?;
    }
    output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    Ok(Answer::Yes)
}

/// Where the fit starts: the preset that is asked for, else the first table's with what all tables give.
fn start(args: &EnergyArgs, tables: &[MeasurementsFile]) -> Result<Constants, Error> {
    if let Some(asked) = &args.cost.constants {
        return Ok(io::target::load_constants(asked)?);
    }
    let name = tables.first().map_or("", |table| table.start.value.as_str());
    let mut start = io::target::load_constants(name)?;
    for given in tables.iter().flat_map(|table| &table.given) {
        if let Some(constant) = start.get_mut(&given.constant.value) {
            *constant = given.is.clone();
        }
    }
    Ok(start)
}
