//! The energy table as text, JSON (`nsim.energy/1`), CSV, and tables for papers.
//!
//! JSON and CSV hold full precision. The text has the layout of the VT-SNN paper's tables: three
//! digits for nsim's figures, all printed digits for published figures.

use std::fmt::Write;

use serde::Serialize;
use serde_json::{Map, Value, json};

use super::compared::Comparison;
use crate::published::scenario::ScenarioFile;
use nsim_compile::explore::cost_estimate::Score;
use nsim_cost::deployment::Deployment;
use nsim_cost::estimate::{Bound, Convention, EnergyRow, Estimate, FigureSource, StatusShare};
use nsim_cost::job::{Accounting, Mode};
use nsim_cost::quantiles::Spread;
use nsim_cost::{Host, Transport};
use nsim_files::shipped::{CONSTANTS, Shipped};
use nsim_files::table::{count, csv, csv_text, digits, percent, table, three, wrapped};
use nsim_ir::hardware::constants::{Constants, Status, Unit};
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;

/// Maximum number of cores that the text lists.
const SLOWEST_SHOWN: usize = 6;
/// Widths of the columns of the table: name, powers, latency, energy, energy-delay product.
const WIDTHS: [usize; 7] = [16, 7, 8, 8, 11, 10, 9];

/// Savings of a run if samples ended at their decisions: equation (16).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct EarlyExitSavings {
    /// The rule that decides a sample.
    pub rule: Rule,
    /// Samples that were decided before their end.
    pub decided: u64,
    /// Timesteps after the decisions, of all samples.
    pub steps_saved: u64,
    /// Time of these timesteps, us.
    pub time_saved_us: f64,
    /// Energy of these timesteps, uJ, with all power of the `total` row: the chip is then off.
    pub energy_saved_uj: f64,
    /// Share of this in the energy of the whole run; `None` when the whole is zero.
    pub energy_saved_share: Option<f64>,
    /// The share if the chip stays on and idles, which saves none of its constant power.
    pub idle_saved_share: Option<f64>,
    /// Share of the samples whose class is right when decided; `None` unless all have labels.
    pub accuracy: Option<f64>,
    /// Median step of the early decisions, from 0.
    pub median_step: Option<u32>,
    /// Mean energy of one copy until a sample is decided, uJ.
    pub energy_uj: f64,
}

/// A unit of the published job, as computed here and as printed by its source.
#[derive(Debug, Clone, PartialEq)]
pub struct JobPart {
    /// The row by the constants of the report.
    pub here: EnergyRow,
    /// The printed row of this unit.
    pub printed: EnergyRow,
}

impl JobPart {
    /// Ratios of static, dynamic and total power here to the printed ones; `None` if not printed.
    fn ratios(&self) -> [Option<f64>; 3] {
        let powers = |row: &EnergyRow| [row.static_mw, row.dynamic_mw, row.total_mw];
        let (here, printed) = (powers(&self.here), powers(&self.printed));
        std::array::from_fn(|at| Some(here[at]? / printed[at].filter(|mw| *mw > 0.0)?))
    }

    fn json(&self) -> Value {
        let [static_mw, dynamic_mw, total_mw] = self.ratios();
        let ratio = json!({ "static_mw": static_mw, "dynamic_mw": dynamic_mw, "total_mw": total_mw });
        json!({ "unit": self.here.unit, "here": self.here, "printed": self.printed, "ratio": ratio })
    }
}

/// A constant of the report.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ConstantEntry {
    /// Its name; barriers carry their number of tiles.
    pub name: String,
    /// The number.
    pub value: f64,
    /// Its unit.
    pub unit: Unit,
    /// Its source.
    pub source: String,
    /// Its status: published, calibrated, assumed or not given.
    pub status: Status,
    /// The least value that its sources leave open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub low: Option<f64>,
    /// The greatest value that its sources leave open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub high: Option<f64>,
}

/// The constants of a preset, barriers last.
pub fn constant_entries(constants: &Constants) -> Vec<ConstantEntry> {
    let barriers = constants.barrier.iter().map(|entry| {
        let (number, parts) = entry.parts();
        (format!("barrier_time_{number}_{parts}"), &entry.time)
    });
    let singles = constants.listed().map(|(name, constant)| (name.to_string(), constant));
    singles
        .chain(barriers)
        .map(|(name, constant)| ConstantEntry {
            name,
            value: constant.value.value,
            unit: constant.unit,
            source: constant.source.clone(),
            status: constant.status,
            low: constant.bounds.map(|bounds| bounds.0),
            high: constant.bounds.map(|bounds| bounds.1),
        })
        .collect()
}

/// The object of `nsim.energy/1` for a network that did not run.
pub fn empty_result(copies: u32, mode: Mode, convention: Convention) -> Value {
    json!({
        "schema": "nsim.energy/1", "model": null, "target": null, "copies": copies, "deployment": null,
        "mode": mode.name(), "convention": convention.name(), "fits": false, "reasons": [], "seed": null, "rows": [],
        "cores_used": null, "breakdown_pj_per_timestep": null, "per_timestep_uj": null, "early_exit": null,
        "parts": [], "constants": [], "populations": [], "inputs": [], "cores": [], "warnings": [],
    })
}

/// A finished energy report.
#[derive(Debug, Clone)]
pub struct EnergyReport {
    /// The model's name.
    pub model: String,
    /// The target's name.
    pub target: String,
    /// Numbers of cores.
    pub deployment: Deployment,
    /// Offline or real time.
    pub mode: Mode,
    /// Name of the preset of the figures.
    pub preset: String,
    /// The seed of the input, if one was used.
    pub seed: Option<u64>,
    /// Origin of the input samples.
    pub input: Vec<String>,
    /// Samples of the run.
    pub samples: u64,
    /// Timesteps of all samples.
    pub timesteps: u64,
    /// Share of the samples whose class is their label; `None` unless all have labels.
    pub accuracy: Option<f64>,
    /// Number of samples with a label.
    pub labelled: u64,
    /// Rows of the simulated chip, breakdown, spread.
    pub estimate: Estimate,
    /// Rows of other hardware and of published jobs, with their sources.
    pub baselines: Vec<(EnergyRow, String)>,
    /// The job's row with inputs already on the chip, where injection is more than half of a step.
    pub inputs_on_chip: Option<EnergyRow>,
    /// The level of the intervals; `None` where they bound modelled constants.
    pub level: Option<f64>,
    /// The accounting of power.
    pub accounting: Accounting,
    /// The model of the mesh.
    pub transport: Transport,
    /// Comparison with other hardware.
    pub comparison: Comparison,
    /// Savings if samples ended at their decisions.
    pub early_exit: Option<EarlyExitSavings>,
    /// The constants of the preset.
    pub constants: Vec<ConstantEntry>,
    /// Counts by population, input and core, and warnings.
    pub detail: Detail,
    /// Number of samples without a decision.
    pub undecided: usize,
    /// Cost of a mean step that `nsim map` expects at the firing rates of the run.
    pub expected: Option<Score>,
    /// The published job of the model, if there is one.
    pub job: Option<ScenarioFile>,
    /// Energy and energy-delay product as printed for that job and other published hardware.
    pub printed: Vec<[f64; 2]>,
    /// Units of the published job, here and as printed.
    pub parts: Vec<JobPart>,
    /// Number of copies counted in the run.
    pub copies_counted: u32,
    /// Remarks on the constants: their hardware, absent ones, ones without effect, figures without
    /// an interval.
    pub constant_notes: Vec<String>,
}

/// The object of `nsim.energy/1`.
#[derive(Serialize)]
#[serde(tag = "schema", rename = "nsim.energy/1")]
struct EnergyResult<'r> {
    model: &'r str,
    target: &'r str,
    copies: u32,
    deployment: &'r str,
    mode: Mode,
    convention: Convention,
    fits: bool,
    preset: &'r str,
    level: Option<f64>,
    seed: Option<u64>,
    input: &'r [String],
    samples: u64,
    timesteps: u64,
    accuracy: Option<f64>,
    rows: Vec<&'r EnergyRow>,
    #[serde(skip_serializing_if = "Option::is_none")]
    inputs_on_chip: Option<&'r EnergyRow>,
    cores_used: u64,
    tiles_used: u64,
    chips_used: u64,
    x86_cores: u64,
    host: Value,
    job: Job,
    breakdown_pj_per_timestep: Option<Map<String, Value>>,
    per_timestep_uj: Option<Spread>,
    per_timestep_dynamic_uj: Option<Spread>,
    time_us_per_timestep: Option<Map<String, Value>>,
    transport: Transport,
    accounting: Accounting,
    sample: Option<SampleCost>,
    #[serde(flatten)]
    comparison: &'r Comparison,
    early_exit: Option<EarlyExitSavings>,
    parts: Vec<Value>,
    constants: &'r [ConstantEntry],
    expected: Option<Score>,
    notes: &'r [String],
    low: Bound,
    high: Bound,
    share: Option<StatusShare>,
    #[serde(flatten)]
    detail: &'r Detail,
}

/// Cost of a sample of one copy, power times time.
#[derive(Debug, Clone, Copy, Serialize)]
struct SampleCost {
    /// Mean number of its timesteps.
    steps: f64,
    time_us: f64,
    energy_uj: f64,
    /// Energy of the neuron cores alone.
    cores_uj: Option<f64>,
}

#[derive(Serialize)]
struct Job {
    total_mw: Option<f64>,
    share_mw: Option<f64>,
}

/// Name of a row in the table.
fn row_name(row: &EnergyRow, chip: &str) -> String {
    if row.hardware != chip {
        return match (row.source, row.hardware.split_once(", ")) {
            (FigureSource::Simulated, Some((_, job))) => job.replace("in the VT-SNN paper", "in the paper"),
            (FigureSource::Published, Some((work, "printed"))) => work.replace("the VT-SNN paper", "the paper"),
            _ => row.hardware.clone(),
        };
    }
    match row.unit {
        // Of the x86 cores of a copy the row counts all.
        "x86" if row.x86_cores.is_some_and(|cores| cores > 1) => count(row.x86_cores.unwrap_or_default(), "x86 core"),
        "x86" => "x86 core".to_string(),
        "neuron" => "neuron cores".to_string(),
        "boot" => "board, boot".to_string(),
        "idle" => "board, idle".to_string(),
        // Intel's chips as the field writes them; other names as their files do.
        _ => chip.strip_prefix("loihi").map_or(chip.to_string(), |rest| format!("Loihi{rest}")),
    }
}

/// Whether a publication printed the row for the chip.
fn is_printed(row: &EnergyRow) -> bool {
    row.source == FigureSource::Published && row.hardware.ends_with(", printed")
}

/// The text for a figure that is not known.
fn unknown() -> String {
    "unknown".to_string()
}

/// Three digits, with a power of ten below a thousandth.
fn readable(x: f64) -> String {
    if x > 0.0 && x < 1e-3 { format!("{x:.2e}") } else { three(x) }
}

/// An end of an interval: two significant digits, `2.8k` for thousands.
fn brief(x: f64) -> String {
    match x {
        1e6.. => format!("{}M", digits(x / 1e6, 2)),
        1e3.. => format!("{}k", digits(x / 1e3, 2)),
        100.0.. => format!("{x:.0}"),
        0.0..1e-3 if x > 0.0 => format!("{x:.1e}"),
        _ => digits(x, 2),
    }
}

/// A line of the table.
fn line(widths: &[usize; 7], name: &str, cells: &[String; 6], source: &str) -> String {
    let mut out = format!("{name:<width$}", width = widths[0]);
    // A name that is too long takes room from the first column.
    let mut over = out.chars().count().saturating_sub(widths[0]);
    for (at, (cell, width)) in cells.iter().zip(&widths[1..]).enumerate() {
        if at == 5 && cell.chars().count() >= *width {
            out.push(' ');
        }
        let width = width.saturating_sub(over).max(cell.chars().count().min(*width));
        over = 0;
        let _ = write!(out, "{cell:>width$}");
    }
    let text = format!("{out}  {source}");
    format!("{}\n", text.trim_end())
}

impl EnergyReport {
    fn rows(&self) -> impl Iterator<Item = &EnergyRow> {
        self.estimate.rows.iter().chain(self.baselines.iter().map(|(row, _)| row))
    }

    fn convention(&self) -> Convention {
        self.estimate.rows.first().map_or(Convention::Physical, |row| row.convention)
    }

    fn hardware(&self) -> &str {
        self.estimate.rows.first().map_or("chip", |row| &row.hardware)
    }

    fn total(&self) -> Option<&EnergyRow> {
        self.estimate.rows.iter().find(|row| row.unit == "total")
    }

    /// Powers of all copies, and a copy's share, by the report's accounting.
    fn job(&self) -> Job {
        let total_mw = self.estimate.job.total(self.accounting);
        Job { total_mw, share_mw: total_mw.map(|all| all / f64::from(self.deployment.copies.max(1))) }
    }

    /// The object of `nsim.energy/1`.
    pub fn json(&self) -> Value {
        let breakdown = self.estimate.breakdown_pj.as_ref().map(|parts| {
            let parts = parts.iter().map(|&(name, pj)| (name.to_string(), json!(pj)));
            // No core learns yet.
            parts.chain([("learning".to_string(), json!(0.0))]).collect()
        });
        let times = |times: [(&str, f64); 6]| times.map(|(name, us)| (name.replace(' ', "_"), json!(us)));
        let Deployment { x86_cores, x86_chips, host, .. } = self.deployment;
        let injecting = if host == Host::Stream { x86_chips } else { 0 };
        let total = self.total();
        json!(EnergyResult {
            model: &self.model,
            target: &self.target,
            copies: self.deployment.copies,
            deployment: &self.deployment.name,
            mode: self.mode,
            convention: self.convention(),
            fits: true,
            preset: &self.preset,
            level: self.level,
            seed: self.seed,
            input: &self.input,
            samples: self.samples,
            timesteps: self.timesteps,
            accuracy: self.accuracy,
            rows: self.rows().collect(),
            inputs_on_chip: self.inputs_on_chip.as_ref(),
            cores_used: self.deployment.cores_used,
            tiles_used: self.deployment.tiles_used,
            chips_used: self.deployment.chips_used,
            x86_cores,
            host: json!({
                "kind": host, "x86_cores": x86_cores, "chips_injecting": injecting,
                "x86_share": self.estimate.x86_share,
            }),
            job: self.job(),
            breakdown_pj_per_timestep: breakdown,
            per_timestep_uj: self.estimate.per_timestep_uj,
            per_timestep_dynamic_uj: self.estimate.per_timestep_dynamic_uj,
            time_us_per_timestep: self.estimate.time_us.map(|all| times(all).into_iter().collect()),
            transport: self.transport,
            accounting: self.accounting,
            sample: self.sample(),
            comparison: &self.comparison,
            early_exit: self.early_exit,
            parts: self.parts.iter().map(JobPart::json).collect(),
            constants: &self.constants,
            expected: self.expected,
            notes: &self.constant_notes,
            low: total.and_then(|row| row.low).unwrap_or_default(),
            high: total.and_then(|row| row.high).unwrap_or_default(),
            share: total.and_then(|row| row.share),
            detail: &self.detail,
        })
    }

    /// The rows as comma-separated values with a header; unknown figures are empty.
    pub fn csv(&self) -> String {
        let columns = "hardware,unit,convention,static_mw,dynamic_mw,total_mw,latency_us,energy_uj,edp_pjs,\
                       total_mw_low=low.total_mw,latency_us_low=low.latency_us,energy_uj_low=low.energy_uj,\
                       edp_pjs_low=low.edp_pjs,total_mw_high=high.total_mw,latency_us_high=high.latency_us,\
                       energy_uj_high=high.energy_uj,edp_pjs_high=high.edp_pjs,source,power_source,energy_source";
        csv(self.rows(), columns)
    }

    /// Units of the energy and of the energy-delay product, with their factors from uJ and pJ s.
    /// The unit of energy makes the chip's total easy to read; the convention fixes the unit of the
    /// product.
    fn units(&self) -> [(&'static str, f64); 2] {
        if self.convention() == Convention::Published {
            return [("(mW/steps)", 1.0), ("(pJ s)", 1.0)];
        }
        let small = self.total().and_then(|row| row.energy_uj).is_some_and(|uj| uj > 0.0 && uj < 0.1);
        [if small { ("(nJ/step)", 1e3) } else { ("(uJ/step)", 1.0) }, ("(nJ s)", 1e-3)]
    }

    /// The cells of a row: static, dynamic and total power, latency, energy, energy-delay product.
    fn cells(&self, row: &EnergyRow) -> [String; 6] {
        let printed = row.source == FigureSource::Published;
        let computed = row.energy_source == FigureSource::Computed;
        let assumed = row.power_source != row.source && row.power_source == FigureSource::Assumed;
        let cell = |figure: Option<f64>, exact: bool| match figure {
            None => String::new(),
            Some(figure) if exact => format!("{figure}"),
            Some(figure) => readable(figure),
        };
        let mark = if assumed { "?" } else { "" };
        let power = |figure: Option<f64>| cell(figure, printed) + mark;
        let [(_, of_energy), (_, of_edp)] = self.units();
        let product = |figure: Option<f64>| {
            let text = match figure {
                Some(figure) if computed && figure >= 1e3 => format!("{figure:.0}"),
                figure => cell(figure, printed && !computed),
            };
            let mark = if computed { "*" } else { mark };
            if text.is_empty() { text } else { text + mark }
        };
        let is_part = ["x86", "neuron"].contains(&row.unit);
        [
            power(row.static_mw),
            power(row.dynamic_mw),
            power(row.total_mw),
            if is_part { String::new() } else { cell(row.latency_us, printed) },
            if is_part { String::new() } else { product(row.energy_uj.map(|uj| uj * of_energy)) },
            if is_part { String::new() } else { product(row.edp_pjs.map(|pjs| pjs * of_edp)) },
        ]
    }

    /// The interval of a row, where it has one.
    fn interval(&self, row: &EnergyRow) -> Option<[String; 6]> {
        let (low, high) = (row.low?, row.high?);
        let range = |figure: fn(&Bound) -> Option<f64>, unit: f64| match (figure(&low), figure(&high)) {
            (Some(low), Some(high)) => format!("{}-{}", brief(low * unit), brief(high * unit)),
            _ => String::new(),
        };
        let [(_, of_energy), (_, of_edp)] = self.units();
        let [total, latency] = [range(|b| b.total_mw, 1.0), range(|b| b.latency_us, 1.0)];
        let [energy, edp] = [range(|b| b.energy_uj, of_energy), range(|b| b.edp_pjs, of_edp)];
        Some([String::new(), String::new(), total, latency, energy, edp])
    }

    /// Name, cells and source of each line of the table, intervals after their rows.
    fn lines(&self, every_interval: bool) -> Vec<(String, [String; 6], String)> {
        let mut lines = Vec::new();
        for row in self.rows() {
            let own = row.hardware == self.hardware();
            if row.x86_cores == Some(0) {
                continue;
            }
            // The only figure of rails that no published total bounds.
            let at_work = own && row.unit == "x86" && self.accounting == Accounting::Rails;
            let is_part = ["x86", "neuron", "boot", "idle"].contains(&row.unit);
            let source = match row.busy {
                Some(_) => "busy CPUs".to_string(),
                None if own && is_part => String::new(),
                None => row.source.name().to_string(),
            };
            lines.push((row_name(row, self.hardware()), self.cells(row), source));
            if is_printed(row) {
                for JobPart { here, printed } in &self.parts {
                    let name = format!("  {}", row_name(here, &here.hardware));
                    lines.push((name, self.cells(printed), String::new()));
                }
            }
            let of_interval = if self.level.is_some() { "  80 % interval" } else { "  model's bounds" };
            if (row.source == FigureSource::Simulated && (every_interval || !is_part) || at_work)
                && let Some(mut interval) = self.interval(row)
            {
                // Time and energy belong to the whole, not to a part.
                interval[3..].iter_mut().filter(|_| is_part).for_each(String::clear);
                lines.push((of_interval.to_string(), interval, String::new()));
            }
            if let Some(alone) = self.inputs_on_chip.as_ref().filter(|_| own && row.unit == "total") {
                lines.push(("inputs on chip".to_string(), self.cells(alone), alone.source.name().to_string()));
                let interval = self.interval(alone);
                lines.extend(interval.map(|interval| (of_interval.to_string(), interval, String::new())));
            }
        }
        lines
    }

    /// Headings of the six columns.
    fn headings(&self) -> [String; 6] {
        let [(energy, _), (edp, _)] = self.units();
        ["static", "dynamic", "total", "(us/step)", energy, edp].map(str::to_string)
    }

    fn head(&self) -> String {
        let Deployment { copies, cores_used, chips_used, x86_cores, .. } = &self.deployment;
        let (copies, chips) = (count(*copies, "copy"), count(*chips_used, "chip"));
        let cores = count(*cores_used, "neuron core");
        let x86 = if *x86_cores > 0 { count(*x86_cores, "x86 core") } else { "no x86 core".to_string() };
        let mode = self.mode.text();
        let (model, target) = (&self.model, &self.target);
        let mut out = wrapped(&format!("{model} on {target}: {copies} on {chips} ({cores}, {x86}), {mode}"));
        let shown = self.input.first().map_or("", String::as_str);
        // The number of samples and the seed do not describe the scene; its other fields do.
        let (scene, fields) = shown.split_once('?').unwrap_or((shown, ""));
        let says =
            |field: &&str| !field.is_empty() && !["samples=", "seed="].iter().any(|name| field.starts_with(name));
        let fields: Vec<&str> = fields.split('&').filter(says).collect();
        let shown = if fields.is_empty() { scene.to_string() } else { format!("{scene}?{}", fields.join("&")) };
        let shown = if self.input.len() > 1 { format!("{shown} and others") } else { shown };
        let samples = match self.accuracy {
            Some(share) => {
                let right = (share * self.labelled as f64).round();
                let undecided = match self.undecided {
                    0 => String::new(),
                    some => format!(", {some} undecided"),
                };
                format!("{right} of {} right{undecided}", count(self.labelled, "sample"))
            }
            None => count(self.samples, "sample"),
        };
        let power = match self.accounting {
            Accounting::Profiler if self.hardware().starts_with("loihi") => "as Intel's profiler counts it",
            accounting => accounting.power_text(),
        };
        out += &wrapped(&format!("{samples} ({shown}). Power {power}."));
        out
    }

    /// The table with its heading and remarks.
    fn table(&self, every_interval: bool) -> String {
        let mut out = self.head();
        let groups = ["", "power", "(mW)", "latency", "energy", "EDP"].map(str::to_string);
        out.push('\n');
        let lines = self.lines(every_interval);
        let mut widths = WIDTHS;
        let needs = |column: usize| {
            let longest = lines.iter().map(|(_, cells, _)| cells[column].chars().count()).max();
            longest.unwrap_or_default().max(self.headings()[column].len()) + 1
        };
        // The last column of an interval may extend into the column of the source.
        (0..5).for_each(|column| widths[column + 1] = WIDTHS[column + 1].max(needs(column)));
        // Width beyond a terminal's is taken from columns with room.
        let mut over = widths.iter().sum::<usize>().saturating_sub(WIDTHS.iter().sum());
        for column in (0..5).rev() {
            let room = widths[column + 1].saturating_sub(needs(column)).min(over);
            widths[column + 1] -= room;
            over -= room;
        }
        // A name that is then too long takes width from the first column.
        widths[0] -= over.min(2);
        out += &line(&widths, "", &groups, "");
        out += &line(&widths, "", &self.headings(), "");
        for (name, cells, source) in lines {
            out += &line(&widths, &name, &cells, &source);
        }
        for remark in self.table_notes().iter().chain(&self.constant_notes) {
            out += &wrapped(remark);
        }
        out
    }

    /// Remarks below the table, at most seven.
    fn table_notes(&self) -> Vec<String> {
        let Deployment { cores_used, copies, board_chips, chips_used, .. } = &self.deployment;
        if self.accounting == Accounting::Unit {
            let chips = count(*board_chips, "chip");
            let said = format!("The unit's power is of all {chips} with their boards and host; cores add to it.");
            return std::iter::once(said).chain(self.dominant_text()).collect();
        }
        if self.accounting == Accounting::Rails {
            let unused = board_chips - chips_used.min(board_chips);
            let unused = (unused > 0).then(|| {
                let boot = self.estimate.job.boot * unused as f64 / *board_chips as f64;
                format!("{} mW of it belong to chips of the board that are not used ({unused}).", three(boot))
            });
            let packing = "Packing copies on fewer chips saves profiler milliwatts, not board watts.".to_string();
            return unused.into_iter().chain([packing]).chain(self.dominant_text()).collect();
        }
        let each = |total: u64, copies: u32| {
            let cores = total as f64 / f64::from(copies.max(1));
            if cores.fract() == 0.0 { format!("{cores}") } else { three(cores) }
        };
        let mut said = Vec::new();
        let job = self.job.as_ref().filter(|_| self.rows().any(is_printed));
        if *copies > 1 {
            let Job { total_mw, share_mw } = self.job();
            let [all, share] = [total_mw, share_mw].map(|power| power.map_or_else(unknown, three));
            let x86 = if self.deployment.x86_cores > 0 { "one x86 core and " } else { "" };
            said.push(format!("Rows are for {x86}one copy; all copies draw {all} mW, {share} each."));
        }
        if let Some(job) = job.filter(|_| self.deployment.name != "paper") {
            let (own, theirs) = (each(*cores_used, *copies), each(job.deployment.value.cores_used, job.copies.value));
            said.push(format!("Cores of a copy: {own}; in the paper {theirs}. Static power scales with them."));
        }
        said.extend(job.map(|job| self.assumptions_text(job)));
        let mut marks = Vec::new();
        let printed: Vec<String> = self.printed.iter().map(|[energy, edp]| format!("{energy} and {edp}")).collect();
        if !printed.is_empty() {
            marks.push(match self.convention() {
                Convention::Physical => format!("* power x time; printed: {} (power / 150).", printed.join(", ")),
                Convention::Published => {
                    "Energy is power / steps of a sample; the paper prints pJ s as nJ s.".to_string()
                }
            });
        }
        if self.rows().any(|row| row.power_source != row.source && row.power_source == FigureSource::Assumed) {
            marks.push("? assumed power".to_string());
        }
        if self.rows().any(|row| row.busy.is_some()) {
            marks.push("busy: measured while other programs kept this many processors busy".to_string());
        }
        said.extend(Some(marks.join(" ")).filter(|marks| !marks.is_empty()));
        said.extend(self.dominant_text());
        let last = match job {
            Some(_) => "nsim bench published omits the paper's own results, so its intervals are wider.",
            None => "Fewer cores save profiler milliwatts, not board watts (--accounting rails).",
        };
        said.extend((said.len() < 7).then(|| last.to_string()));
        said
    }

    /// Remark on the ratios of units of the published job, and on the assumptions of its figures
    /// here that its source does not state.
    fn assumptions_text(&self, job: &ScenarioFile) -> String {
        let part = |part: &JobPart| {
            let [fixed, dynamic, _] = part.ratios().map(|ratio| ratio.map_or_else(unknown, |x| format!("{x:.2}")));
            format!("{} {fixed}, {dynamic}", row_name(&part.here, &part.here.hardware))
        };
        let parts: Vec<String> = self.parts.iter().map(part).collect();
        let relays = if job.input_relays { "relays; " } else { "" };
        let streams = if self.deployment.streams > 1 { "one stream per copy" } else { "one stream" };
        format!(
            "Static, dynamic over printed: {}. Inferred: a row is an x86 core and a copy; {relays}{streams}; input \
             spikes.",
            parts.join("; ")
        )
    }

    /// Remark on the largest part of a step's time.
    fn dominant_text(&self) -> Option<String> {
        let times = self.estimate.time_us?;
        let all: f64 = times.iter().map(|(_, us)| us).sum();
        let (name, most) = times.into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).filter(|_| all > 0.0)?;
        let what = match name {
            "injection" => &self.injection_text(most),
            "turn" => "the turn of the x86 core",
            "slowest core" => "the slowest core",
            "transport" => "messages on the mesh",
            "barrier" => "the barrier",
            _ => "resetting state",
        };
        let free = if self.mode == Mode::Realtime { "A step's work takes" } else { "A step takes" };
        let share = (100.0 * most / all).floor();
        let without = if self.inputs_on_chip.is_some() { " Inputs on chip: --host none." } else { "" };
        Some(format!("{free} {} us, {share} % of it for {what}.{without}", three(all)))
    }

    /// Text on injection: the input spikes of a step, and the constants' time of one.
    fn injection_text(&self, injection_us: f64) -> String {
        let of_one = self.constants.iter().find(|entry| entry.name == "injection_time").map(|entry| entry.value);
        match of_one {
            Some(us) if us > 0.0 => format!("{} input spikes of {} us", three(injection_us / us), three(us)),
            _ => "injecting input spikes".to_string(),
        }
    }

    /// Cost of a sample of mean length, physical: of the `total` row, and of its neuron cores where
    /// power has such a row. `None` without timesteps.
    fn sample(&self) -> Option<SampleCost> {
        let row = |unit: &str| self.estimate.rows.iter().find(|row| row.unit == unit);
        let steps = (self.samples > 0).then(|| self.timesteps as f64 / self.samples as f64)?;
        let time_us = steps * self.total()?.latency_us?;
        let energy_uj = |row: &EnergyRow| Some(row.total_mw? * time_us / 1e3);
        let cores_uj = row("neuron").and_then(energy_uj);
        Some(SampleCost { steps, time_us, energy_uj: energy_uj(self.total()?)?, cores_uj })
    }

    /// The last line: time and energy of a sample.
    fn sample_text(&self) -> String {
        let Some(SampleCost { steps, time_us, energy_uj, cores_uj }) = self.sample() else { return String::new() };
        let steps = if steps.fract() == 0.0 { format!("{steps}") } else { format!("{} (mean)", three(steps)) };
        let cores = cores_uj.map_or(String::new(), |uj| format!("; of it the neuron cores alone: {} uJ", readable(uj)));
        let steps = if steps == "1" { "1 step".to_string() } else { format!("{steps} steps") };
        wrapped(&format!("A sample of {steps}: {} ms, {} uJ{cores}.", readable(time_us / 1e3), readable(energy_uj)))
    }

    /// The short report: the table of the paper in eighty columns, its remarks, early exit, and the
    /// cost of a sample.
    pub fn headline(&self) -> String {
        let mut out = self.table(false);
        if let Some(saved) = self.early_exit {
            let shares = saved.energy_saved_share.zip(saved.idle_saved_share);
            let share = shares.map_or(String::new(), |(off, idle)| {
                let [off, idle] = [off, idle].map(percent);
                format!(", and {off} of energy if the chip is off after the decision, {idle} if it idles")
            });
            out += &wrapped(&format!(
                "early exit {}: {} of {} samples decided early; saves {} of {} timesteps{share}. {}",
                saved.rule,
                saved.decided,
                self.samples,
                saved.steps_saved,
                self.timesteps,
                self.comparison.decisions(self.accuracy)
            ));
        }
        out + &self.sample_text()
    }

    /// The table as comma-separated values for a paper: its lines with all cells.
    pub fn paper_csv(&self) -> String {
        let physical = self.convention() == Convention::Physical;
        let energy = if physical { "Energy (\u{b5}J)" } else { "Energy (mW / steps)" };
        let edp = if physical { "EDP (nJ s)" } else { "EDP (pJ s)" };
        let header =
            ["Hardware", "Static (mW)", "Dynamic (mW)", "Total (mW)", "Latency (\u{b5}s)", energy, edp, "Source"];
        // A mark needs its footnote in the same row.
        let marked = |cells: &[String; 6], source: String| match cells.iter().any(|cell| cell.ends_with('*')) {
            true => format!("{source}; * from its power x time"),
            false => source,
        };
        // Without indentation, a line names the row to which it belongs.
        let mut above = String::new();
        let row = |(name, cells, source): (String, [String; 6], String)| {
            let name = match name.strip_prefix("  ") {
                Some(part) => format!("{above}: {part}"),
                None => name,
            };
            if !name.contains(": ") {
                above.clone_from(&name);
            }
            std::iter::once(name).chain(cells.clone()).chain([marked(&cells, source)]).collect()
        };
        csv_text(header.map(String::from).to_vec(), self.lines(false).into_iter().map(row))
    }

    /// The whole report for readers, most important parts first.
    pub fn text(&self) -> String {
        let mut out = self.table(true) + &self.sample_text();
        out.push('\n');
        out.push_str(&self.breakdown());
        out.push_str(&self.shares());
        out.push_str(&self.comparison.text(self.accuracy));
        out.push_str(&self.detail.populations_text(self.timesteps));
        out.push_str(&self.detail.slowest_text(SLOWEST_SHOWN));
        if let Some(Score { energy_uj, step_us, .. }) = self.expected {
            out += &wrapped(&format!(
                "At these mean rates, nsim map --profile expects {} uJ for the whole job of {} mapped here, and {} us \
                 per timestep. It assumes that every compartment is active and spikes are spread evenly.",
                three(energy_uj),
                count(self.copies_counted, "copy"),
                three(step_us)
            ));
            out.push('\n');
        }
        if let Some(saved) = self.early_exit {
            out += &wrapped(&format!(
                "Early exit {}: {} of {} samples are decided before their end. Early exit would save {} of the {} \
                 timesteps, {} us and {} uJ{}. The figures above are for whole samples.",
                saved.rule,
                saved.decided,
                self.samples,
                saved.steps_saved,
                self.timesteps,
                three(saved.time_saved_us),
                three(saved.energy_saved_uj),
                saved.energy_saved_share.map_or(String::new(), |share| format!(
                    " ({}) if the chip is off after the decision",
                    percent(share)
                )),
            ));
            out.push('\n');
        }
        for (row, source) in &self.baselines {
            out += &wrapped(&format!("{}: {source}", row_name(row, self.hardware())));
        }
        if let Some(job) = self.job.as_ref().filter(|_| !self.parts.is_empty()) {
            out += &wrapped(&format!("The paper's job: {}. {}", job.source, job.notes));
        }
        out.push_str(&self.sources());
        out
    }

    /// Shares of the `total` row by the status of constants, column by column.
    fn shares(&self) -> String {
        let Some(row) = self.total() else { return String::new() };
        let mut rows = Vec::new();
        let columns = [("static power", row.shares.static_mw), ("dynamic power", row.shares.dynamic_mw)];
        for (name, share) in columns.into_iter().chain([("total power", row.share), ("latency", row.shares.latency_us)])
        {
            let Some(StatusShare { published, fitted, assumed }) = share else { continue };
            let cells = [published, fitted, assumed].map(|share| format!("{:.0} %", (100.0 * share).round() + 0.0));
            rows.push([name.to_string()].into_iter().chain(cells).collect());
        }
        if rows.is_empty() {
            return String::new();
        }
        let spikes = "The number of input spikes is not a constant: it is counted in the samples.";
        table(&["From constants", "published", "calibrated", "assumed"], &rows) + &wrapped(spikes) + "\n"
    }

    fn breakdown(&self) -> String {
        let mut out = String::new();
        let Some(parts) = &self.estimate.breakdown_pj else { return out };
        let total: f64 = parts.iter().map(|(_, pj)| pj).sum();
        let row = |(name, pj): &(_, f64)| {
            let share = if total > 0.0 { format!("{:.1} %", 100.0 * pj / total) } else { unknown() };
            vec![<&str>::to_string(name), three(*pj), share]
        };
        let mut rows: Vec<Vec<String>> = parts.iter().map(row).collect();
        rows.push(vec!["sum".to_string(), three(total), String::new()]);
        let _ = writeln!(out, "{}", table(&["Dynamic energy of the neuron cores", "pJ per timestep", "Share"], &rows));
        if let Some(times) = self.estimate.time_us {
            let listed: Vec<String> = times.iter().map(|(name, us)| format!("{name} {}", three(*us))).collect();
            let overlap = "The cores' part is what remains after injection, during which they work.";
            out += &wrapped(&format!("Work of a timestep, mean in us: {}. {overlap}", listed.join(", ")));
            if let Some(share) = self.estimate.x86_share {
                out += &wrapped(&format!("Time of x86 cores for input: {} of a step.", percent(share)));
            }
        }
        for (what, spread) in [
            ("Energy of a timestep, all power included (uJ, power x time)", self.estimate.per_timestep_uj),
            ("Dynamic energy of the neuron cores in a timestep (uJ)", self.estimate.per_timestep_dynamic_uj),
        ] {
            if let Some(s) = spread {
                let [min, p50, p99, max] = [s.min, s.p50, s.p99, s.max].map(three);
                out += &wrapped(&format!("{what}: least {min}, median {p50}, 99th percentile {p99}, greatest {max}."));
            }
        }
        out.push('\n');
        out
    }

    /// Numbers of published, calibrated and assumed constants, and the assumed ones by name.
    fn sources(&self) -> String {
        let of = |status| self.constants.iter().filter(move |entry| entry.status == status);
        let assumed: Vec<&str> = of(Status::Assumed).map(|entry| entry.name.as_str()).collect();
        let mut out = format!(
            "Constants {}: {} published, {} calibrated, {} assumed",
            self.preset,
            of(Status::Published).count(),
            of(Status::Calibrated).count(),
            assumed.len()
        );
        if !assumed.is_empty() {
            let _ = write!(out, " ({})", assumed.join(", "));
        }
        let absent = of(Status::NotGiven).count();
        if absent > 0 {
            let _ = write!(out, ", {absent} not given");
        }
        match Shipped::find(CONSTANTS, &self.preset) {
            Some(shipped) => {
                let _ = write!(out, ". nsim show {} prints each with its source and findings.", shipped.name);
            }
            None => out.push_str(". --format json lists each with its source."),
        }
        wrapped(&out)
    }
}
