//! The energy table as text, JSON (`nsim.energy/1`) and CSV.
//!
//! JSON and CSV hold full precision. In the text, the x86 and neuron rows are rounded and the total is the sum of what is
//! printed, so that a reader can add up the columns; it may differ from the exact total by one in the last digit.

use std::fmt::Write;

use serde::Serialize;
use serde_json::{Value, json};

use super::compared::Comparison;
use super::format::{fixed, plain, short, two_digits, unknown};
use crate::compile::explore::cost_estimate::Score;
use crate::cost::Transport;
use crate::cost::deployment::Deployment;
use crate::cost::estimate::{Convention, EnergyRow, Estimate};
use crate::desc::published::baseline::Mode;
use crate::desc::published::workload::Accounting;
use crate::desc::target::constants::{Constants, Status, Unit};
use crate::drive::decision::Rule;
use crate::report::detail::Detail;
use crate::report::text::{Column, count, csv_of, or_empty, wrapped};

/// Cores that the text lists.
const SLOWEST_SHOWN: usize = 6;

/// What ending samples when they are decided would save of the run: equation (16).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Saved {
    /// What decides a sample.
    #[serde(serialize_with = "spelled")]
    pub rule: Rule,
    /// Samples that were decided before their end.
    pub decided: u64,
    /// Timesteps that were not needed, of all samples.
    pub steps_saved: u64,
    /// Time that they took.
    pub time_saved_us: f64,
    /// Energy of one copy that they cost, all power included.
    pub energy_saved_uj: f64,
    /// That as a part of the energy of the whole run; `None` when that is zero.
    pub energy_saved_share: Option<f64>,
}

fn spelled<S: serde::Serializer>(rule: &Rule, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(rule)
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
    /// Where it comes from.
    pub source: String,
    /// How far it can be trusted.
    pub status: Status,
}

/// The constants of a preset, barriers last.
#[must_use]
pub fn constant_entries(constants: &Constants) -> Vec<ConstantEntry> {
    let barriers = constants.barrier.iter().map(|entry| (format!("barrier_time_{}_tiles", entry.tiles), &entry.time));
    let singles = constants.list().into_iter().map(|(name, constant)| (name.to_string(), constant));
    singles
        .chain(barriers)
        .map(|(name, constant)| ConstantEntry {
            name,
            value: constant.value.value,
            unit: constant.unit,
            source: constant.source.clone(),
            status: constant.status,
        })
        .collect()
}

/// The object of `nsim.energy/1` for what did not run.
#[must_use]
pub fn nothing(copies: u32, mode: Mode, convention: Convention) -> Value {
    json!({
        "schema": "nsim.energy/1", "model": null, "target": null, "copies": copies, "deployment": null,
        "mode": mode.name(), "convention": convention.name(), "fits": false, "reasons": [], "seed": null, "rows": [],
        "cores_powered": null, "cores_used": null, "breakdown_pj_per_timestep": null, "per_timestep_uj": null,
        "early_exit": null, "constants": [], "populations": [], "inputs": [], "cores": [], "warnings": [],
    })
}

/// A finished energy report.
#[derive(Debug, Clone, PartialEq)]
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
    /// What the network was shown.
    pub input: Vec<String>,
    /// Samples of the run.
    pub samples: u64,
    /// Timesteps of all samples.
    pub timesteps: u64,
    /// Rows of the simulated chip, breakdown, spread.
    pub estimate: Estimate,
    /// Rows of other hardware, with their sources.
    pub baselines: Vec<(EnergyRow, String)>,
    /// Which measurements the constants count.
    pub accounting: Accounting,
    /// The model of the mesh.
    pub transport: Transport,
    /// Beside other hardware and other numbers of cores.
    pub comparison: Comparison,
    /// What ending samples when they are decided would save.
    pub early_exit: Option<Saved>,
    /// The constants of the preset.
    pub constants: Vec<ConstantEntry>,
    /// By population, input and core, and what to warn of.
    pub detail: Detail,
    /// What `nsim map` expects of a mean step of this mapping, given how often each source spiked in the run.
    pub expected: Option<Score>,
    /// What is not known and why, for people; also on stderr when the output is for programs.
    pub notes: Vec<String>,
}

impl EnergyReport {
    fn rows(&self) -> impl Iterator<Item = &EnergyRow> {
        self.estimate.rows.iter().chain(self.baselines.iter().map(|(row, _)| row))
    }

    fn convention(&self) -> &'static str {
        self.estimate.rows.first().map_or("physical", |row| row.convention.name())
    }

    /// The object of `nsim.energy/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let breakdown = self.estimate.breakdown_pj.as_ref().map(|parts| {
            parts.iter().map(|&(name, pj)| (name.to_string(), json!(pj))).collect::<serde_json::Map<_, _>>()
        });
        let times = self.estimate.time_us.map(|times| {
            times.iter().map(|&(name, us)| (name.replace(' ', "_"), json!(us))).collect::<serde_json::Map<_, _>>()
        });
        let mut object = json!({
            "schema": "nsim.energy/1",
            "model": self.model,
            "target": self.target,
            "copies": self.deployment.copies,
            "deployment": self.deployment.name,
            "mode": self.mode.name(),
            "convention": self.convention(),
            "fits": true,
            "preset": self.preset,
            "interval": 0.9,
            "seed": self.seed,
            "input": self.input,
            "samples": self.samples,
            "timesteps": self.timesteps,
            "rows": self.rows().collect::<Vec<_>>(),
            "cores_powered": self.deployment.cores_powered,
            "cores_used": self.deployment.cores_used,
            "tiles_used": self.deployment.tiles_used,
            "chips_used": self.deployment.chips_used,
            "x86_cores": self.deployment.x86_cores(),
            "host": self.host_json(),
            "breakdown_pj_per_timestep": breakdown,
            "per_timestep_uj": self.estimate.per_timestep_uj,
            "per_timestep_dynamic_uj": self.estimate.per_timestep_dynamic_uj,
            "time_us_per_timestep": times,
            "transport": self.transport,
            "accounting": self.accounting.name(),
            "ratios": self.comparison.ratios,
            "per_sample": self.comparison.per_sample,
            "per_decision": self.comparison.per_decision,
            "packing": self.comparison.packing,
            "early_exit": self.early_exit,
            "constants": self.constants,
            "expected": self.expected,
            "notes": self.notes,
        });
        self.detail.add_to(&mut object);
        object
    }

    /// The rows as comma-separated values with a header; unknown figures are empty.
    ///
    /// # Errors
    /// When the writer fails, which for one in memory it does not.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let columns: [Column<EnergyRow>; 17] = [
            ("hardware", |row| row.hardware.clone()),
            ("unit", |row| row.unit.to_string()),
            ("convention", |row| row.convention.name().to_string()),
            ("static_mw", |row| or_empty(row.static_mw)),
            ("dynamic_mw", |row| or_empty(row.dynamic_mw)),
            ("total_mw", |row| or_empty(row.total_mw)),
            ("latency_us", |row| or_empty(row.latency_us)),
            ("energy_uj", |row| or_empty(row.energy_uj)),
            ("edp_pjs", |row| or_empty(row.edp_pjs)),
            ("total_mw_low", |row| or_empty(row.low.and_then(|low| low.total_mw))),
            ("latency_us_low", |row| or_empty(row.low.and_then(|low| low.latency_us))),
            ("energy_uj_low", |row| or_empty(row.low.and_then(|low| low.energy_uj))),
            ("total_mw_high", |row| or_empty(row.high.and_then(|high| high.total_mw))),
            ("latency_us_high", |row| or_empty(row.high.and_then(|high| high.latency_us))),
            ("energy_uj_high", |row| or_empty(row.high.and_then(|high| high.energy_uj))),
            ("source", |row| row.source.name().to_string()),
            ("power_source", |row| row.power_source.name().to_string()),
        ];
        csv_of(self.rows(), &columns)
    }

    fn host_json(&self) -> Value {
        let x86_cores = self.deployment.x86_cores();
        json!({ "x86_cores": x86_cores, "chips_injecting": x86_cores.min(self.deployment.chips_used) })
    }

    /// The answer in at most ten lines of eighty columns, figures with the two digits that constants deserve.
    #[must_use]
    pub fn headline(&self) -> String {
        let Deployment { name, copies, cores_used, cores_powered, chips_used, .. } = &self.deployment;
        let cut = |line: String| match line.char_indices().nth(79) {
            Some((end, _)) => format!("{}~\n", &line[..end]),
            None => format!("{line}\n"),
        };
        let of = if *copies == 1 { "1 copy".to_string() } else { format!("one of {copies} copies") };
        let mut out = cut(format!("{} on {}: {of}, {name}, {}", self.model, self.target, self.mode.name()));
        out += &cut(format!(
            "{} ({cores_powered} powered), {}, {}; {} of {}",
            count(*cores_used, "core"),
            count(*chips_used, "chip"),
            count(self.deployment.x86_cores(), "x86 core"),
            count(self.samples, "sample"),
            self.input.join(", ")
        ));
        let convention = self.convention();
        let energy_header = if convention == "physical" { "Energy (uJ)" } else { "Energy (uJ, published)" };
        let mut table = plain(&["A timestep on", "Power (mW)", "Time (us)", energy_header, "Source"]);
        let two = |x: Option<f64>| x.map_or_else(unknown, two_digits);
        let total = self.estimate.rows.iter().find(|row| row.unit == "total");
        if let Some(row) = total {
            let figures = [row.total_mw, row.latency_us, row.energy_uj].map(two);
            let [power, time, energy] = figures;
            table.add_row(["loihi".to_string(), power, time, energy, row.source.name().to_string()]);
            if let (Some(low), Some(high)) = (row.low, row.high) {
                let range = |low: Option<f64>, high: Option<f64>| match (low, high) {
                    (Some(low), Some(high)) => format!("{}..{}", two_digits(low), two_digits(high)),
                    _ => unknown(),
                };
                table.add_row([
                    "  90 % interval".to_string(),
                    range(low.total_mw, high.total_mw),
                    range(low.latency_us, high.latency_us),
                    range(low.energy_uj, high.energy_uj),
                    String::new(),
                ]);
            }
        }
        // What does not fit into ten lines is in the full report.
        let room = if self.early_exit.is_some() { 2 } else { 3 };
        for (row, _) in self.baselines.iter().take(room) {
            let figures = [row.total_mw, row.latency_us, row.energy_uj].map(two);
            let [power, time, energy] = figures;
            table.add_row([row.hardware.clone(), power, time, energy, self.source_of(row)]);
        }
        let _ = writeln!(out, "{}", table.trim_fmt());
        let part = |unit: &str| self.estimate.rows.iter().find(|row| row.unit == unit)?.energy_uj;
        if let (Some(x86), Some(all)) = (part("x86"), part("total"))
            && all > 0.0
        {
            let shares = total.and_then(|row| row.share).map_or(String::new(), |share| {
                let [published, fitted, assumed] =
                    [share.published, share.fitted, share.assumed].map(|share| (100.0 * share).round());
                format!("; {published} % from published, {fitted} % fitted, {assumed} % assumed constants")
            });
            out += &cut(format!("x86 cores take {:.0} %{shares}", 100.0 * x86 / all));
        }
        if let Some(saved) = self.early_exit {
            let share =
                saved.energy_saved_share.map_or(String::new(), |share| format!(", {:.0} % of energy", 100.0 * share));
            out += &cut(format!(
                "early exit {}: {} of {} samples decided early; saves {} of {} timesteps{share}",
                saved.rule, saved.decided, self.samples, saved.steps_saved, self.timesteps
            ));
        }
        let notes = if self.notes.is_empty() { String::new() } else { count(self.notes.len() as u64, "note") + ", " };
        out += &cut(format!("constants {}; {notes}parts, intervals and sources: --full", self.preset));
        out
    }

    /// Where a row's figures are from, in a word or two.
    fn source_of(&self, row: &EnergyRow) -> String {
        match row.power_source == row.source {
            true => row.source.name().to_string(),
            false => format!("{}, {} W", row.source.name(), row.power_source.name()),
        }
    }

    /// The main table as comma-separated values, for a table in a paper.
    ///
    /// # Errors
    /// As [`EnergyReport::csv`].
    pub fn paper_csv(&self) -> Result<String, csv::Error> {
        let columns: [Column<EnergyRow>; 7] = [
            ("Hardware", |row| format!("{} {}", row.hardware, row.unit)),
            ("Static (mW)", |row| or_empty(row.static_mw)),
            ("Dynamic (mW)", |row| or_empty(row.dynamic_mw)),
            ("Total (mW)", |row| or_empty(row.total_mw)),
            ("Latency (us)", |row| or_empty(row.latency_us)),
            ("Energy (uJ)", |row| or_empty(row.energy_uj)),
            ("Source", |row| row.source.name().to_string()),
        ];
        csv_of(self.rows(), &columns)
    }

    /// The whole report for people.
    #[must_use]
    pub fn text(&self) -> String {
        let Deployment { name, copies, cores_used, cores_powered, tiles_used, chips_used, host: _ } = &self.deployment;
        let convention = self.convention();
        let mut out = format!(
            "{} on {}: one of {copies} copies, deployment {name}, {}, constants {}, transport {}\n",
            self.model,
            self.target,
            self.mode.name(),
            self.preset,
            self.transport.name()
        );
        let _ = writeln!(
            out,
            "{} used, {cores_powered} powered, {}, {} on {}; {}, {}",
            count(*cores_used, "neuron core"),
            count(self.deployment.x86_cores(), "x86 core"),
            count(*tiles_used, "tile"),
            count(*chips_used, "chip"),
            count(self.samples, "sample"),
            count(self.timesteps, "timestep")
        );
        out.push_str("power of one copy; latency, energy and energy-delay product (EDP) of a timestep\n\n");
        let energy_header = format!("Energy\n(uJ, {convention})");
        let edp_header = format!("EDP\n(pJ s, {convention})");
        let mut table = plain(&[
            "Hardware",
            "Unit",
            "Static\n(mW)",
            "Dynamic\n(mW)",
            "Total\n(mW)",
            "Latency\n(us)",
            &energy_header,
            &edp_header,
            "Source",
        ]);
        for cells in self.printed_rows() {
            table.add_row(cells);
        }
        let _ = writeln!(out, "{}\n", table.trim_fmt());
        out.push_str(&self.ranges());
        out.push_str(&self.breakdown());
        out.push_str(&self.detail.populations_text(self.timesteps));
        out.push_str(&self.detail.slowest_text(SLOWEST_SHOWN));
        if let Some(Score { energy_uj, step_us, .. }) = self.expected {
            out += &wrapped(&format!(
                "At these mean rates nsim map --profile expects {} uJ of all copies and {} us of a timestep: every \
                 compartment active, spikes spread evenly.",
                short(energy_uj),
                short(step_us)
            ));
            out.push('\n');
        }
        out.push_str(&self.comparison.text(name));
        if let Some(saved) = self.early_exit {
            let _ = writeln!(
                out,
                "Early exit {}: {} of {} samples are decided before their end. That would save {} of the {} timesteps, {} us \
                 and {} uJ a copy{}; the figures above are those of whole samples.\n",
                saved.rule,
                saved.decided,
                self.samples,
                saved.steps_saved,
                self.timesteps,
                short(saved.time_saved_us),
                short(saved.energy_saved_uj),
                saved.energy_saved_share.map_or(String::new(), |share| format!(" ({:.1} %)", 100.0 * share)),
            );
        }
        out.push_str(&wrapped(match convention {
            "published" => {
                "Convention published: energy is total power in mW divided by the timesteps of a sample, as the VT-SNN paper \
                 computes it; it is not power times latency."
            }
            _ => "Convention physical: energy is power times latency, the energy-delay product energy times latency.",
        }));
        for (row, source) in &self.baselines {
            out += &wrapped(&format!("{}: {source}", row.hardware));
        }
        out.push_str(&self.sources());
        for note in &self.notes {
            out += &wrapped(&format!("Note: {note}"));
        }
        out
    }

    /// Cells of the main table. The loihi `total` row is the sum of what is printed above it.
    fn printed_rows(&self) -> Vec<Vec<String>> {
        let columns: [(Figure, usize, bool); 6] = [
            (|row| row.static_mw, 4, true),
            (|row| row.dynamic_mw, 4, true),
            (|row| row.total_mw, 4, true),
            (|row| row.latency_us, 4, false),
            (|row| row.energy_uj, 6, true),
            (|row| row.edp_pjs, 6, true),
        ];
        let parts: Vec<&EnergyRow> = self.estimate.rows.iter().filter(|row| row.unit != "total").collect();
        let rounded = |row: &EnergyRow, column: usize| -> Option<i128> {
            let (figure, digits, _) = columns[column];
            let units = |x: f64| (x * 10f64.powi(digits as i32)).round() as i128;
            match column {
                // Total power is the sum of the two columns to its left.
                2 => Some(units(row.static_mw?) + units(row.dynamic_mw?)),
                _ => figure(row).map(units),
            }
        };
        let mut rows = Vec::new();
        for row in &self.estimate.rows {
            let mut cells = vec![row.hardware.clone(), row.unit.to_string()];
            for (column, &(_, digits, adds_up)) in columns.iter().enumerate() {
                let units = match row.unit {
                    "total" if adds_up => parts.iter().map(|part| rounded(part, column)).sum::<Option<i128>>(),
                    _ => rounded(row, column),
                };
                cells.push(units.map_or_else(unknown, |units| fixed(units, digits)));
            }
            cells.push(row.source.name().to_string());
            rows.push(cells);
        }
        for (row, _) in &self.baselines {
            let mut cells = vec![row.hardware.clone(), row.unit.to_string()];
            cells.extend(columns.iter().map(|(figure, ..)| figure(row).map_or_else(unknown, short)));
            cells.push(self.source_of(row));
            rows.push(cells);
        }
        rows
    }

    fn ranges(&self) -> String {
        let mut table = plain(&["Hardware", "Unit", "Total (mW)", "Latency (us)", "Energy (uJ)"]);
        for row in &self.estimate.rows {
            let (Some(low), Some(high)) = (row.low, row.high) else { continue };
            let range = |low: Option<f64>, high: Option<f64>| match (low, high) {
                (Some(low), Some(high)) => format!("{} to {}", short(low), short(high)),
                _ => unknown(),
            };
            table.add_row([
                row.hardware.clone(),
                row.unit.to_string(),
                range(low.total_mw, high.total_mw),
                range(low.latency_us, high.latency_us),
                range(low.energy_uj, high.energy_uj),
            ]);
        }
        format!("90 % intervals, from what sources say of each constant:\n{}\n\n", table.trim_fmt())
    }

    fn breakdown(&self) -> String {
        let mut out = String::new();
        let Some(parts) = &self.estimate.breakdown_pj else { return out };
        let total: f64 = parts.iter().map(|(_, pj)| pj).sum();
        let mut table = plain(&["Dynamic energy of the neuron cores", "pJ per timestep", "Share"]);
        for &(name, pj) in parts {
            let share = if total > 0.0 { format!("{:.1} %", 100.0 * pj / total) } else { unknown() };
            table.add_row([name.to_string(), short(pj), share]);
        }
        table.add_row(["sum".to_string(), short(total), String::new()]);
        let _ = writeln!(out, "{}\n", table.trim_fmt());
        if let Some(times) = self.estimate.time_us {
            let listed: Vec<String> = times.iter().map(|(name, us)| format!("{name} {}", short(*us))).collect();
            out += &wrapped(&format!("Work of a timestep, mean in us: {}.", listed.join(", ")));
        }
        for (what, spread) in [
            ("Energy of a timestep, all power included (uJ, physical)", self.estimate.per_timestep_uj),
            ("Dynamic energy of the neuron cores in a timestep (uJ)", self.estimate.per_timestep_dynamic_uj),
        ] {
            if let Some(s) = spread {
                let [min, p50, p99, max] = [s.min, s.p50, s.p99, s.max].map(short);
                out += &wrapped(&format!("{what}: least {min}, median {p50}, 99th percentile {p99}, greatest {max}."));
            }
        }
        out.push('\n');
        out
    }

    /// How many constants are published, calibrated and assumed, and the assumed ones by name.
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
        out.push_str(". --format json lists each with its source.");
        wrapped(&out)
    }
}

/// A column of a row.
type Figure = fn(&EnergyRow) -> Option<f64>;
