//! The result of `nsim compare` as text, JSON (`nsim.compare/1`) and CSV.
//!
//! Input: a row for each target: cores, time, energy and power of one copy, or the reasons for
//! which the network does not fit. Output: strings. JSON and CSV have full precision.

use serde_json::{Value, json};

use nsim_compile::Reason;
use nsim_cost::estimate::{Bound, EnergyRow};
use nsim_cost::job::{Accounting, Mode};
use nsim_files::table::{count, csv, percent, table, three, wrapped};

/// Result of the network on one target.
#[derive(Debug, Clone)]
pub struct ComparedTarget {
    /// The target's name.
    pub target: String,
    /// Name of the hardware in its rows of energy.
    pub hardware: String,
    /// The preset of constants.
    pub constants: String,
    /// Its cost, or the reasons for which it does not fit.
    pub found: Result<TargetCost, Vec<RefusalReason>>,
}

/// A network on a target.
#[derive(Debug, Clone)]
pub struct TargetCost {
    /// Chips in use.
    pub chips_used: u64,
    /// Neuron cores in use.
    pub cores_used: u64,
    /// The row `total` of its energy.
    pub row: EnergyRow,
    /// Origin of its intervals: errors of published works, or bounds of modelled constants.
    pub intervals: Option<Intervals>,
    /// Notes on its constants, as `nsim energy` prints them.
    pub constant_notes: Vec<String>,
    /// Share of a step in which x86 cores inject, take their turn and reset; `None` without them.
    pub x86_share: Option<f64>,
}

/// Origin of intervals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Intervals {
    /// 80 % of published works are within them.
    Works,
    /// They span the range that the sources of modelled constants leave open.
    Constants,
}

/// A reason for which a network does not fit its target.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct RefusalReason {
    /// A stable name for scripts.
    pub code: String,
    /// The problem and its remedy.
    pub message: String,
}

impl From<&Reason> for RefusalReason {
    fn from(reason: &Reason) -> Self {
        RefusalReason { code: reason.code.to_string(), message: reason.to_string() }
    }
}

/// A network on several targets.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// The model's name.
    pub model: String,
    /// Sources of the network's input.
    pub input: Vec<String>,
    /// Number of its samples.
    pub samples: u64,
    /// Pace of the steps.
    pub mode: Mode,
    /// What power counts.
    pub accounting: Accounting,
    /// The seed of the input, if one was used.
    pub seed: Option<u64>,
    /// Fields of all targets and constants that `--set` changes.
    pub set: Vec<String>,
    /// A row a target, in the order of the command.
    pub targets: Vec<ComparedTarget>,
}

/// A figure: its key, its heading, and its readers from a row and from an end of its interval.
type Figure = (&'static str, &'static str, fn(&EnergyRow) -> Option<f64>, fn(&Bound) -> Option<f64>);

const FIGURES: [Figure; 3] = [
    ("latency_us", "us a step", |row| row.latency_us, |bound| bound.latency_us),
    ("energy_uj", "uJ a step", |row| row.energy_uj, |bound| bound.energy_uj),
    ("total_mw", "mW", |row| row.total_mw, |bound| bound.total_mw),
];

/// The columns of CSV.
const KEYS: &str = "target,hardware,constants,fits,chips_used,cores_used,latency_us,latency_us_low,latency_us_high,\
                    energy_uj,energy_uj_low,energy_uj_high,total_mw,total_mw_low,total_mw_high,intervals,reasons";

fn row_json(row: &ComparedTarget) -> Value {
    let mut object = json!({
        "target": row.target, "hardware": row.hardware, "constants": row.constants, "fits": row.found.is_ok(),
        "chips_used": null, "cores_used": null, "intervals": null, "x86_share": null, "reasons": [],
    });
    let cost = row.found.as_ref();
    for (key, _, figure, end) in FIGURES {
        let of = |bound: fn(&EnergyRow) -> Option<Bound>| cost.ok().and_then(|one| end(&bound(&one.row)?));
        object[key] = json!(cost.ok().and_then(|one| figure(&one.row)));
        object[format!("{key}_low")] = json!(of(|row| row.low));
        object[format!("{key}_high")] = json!(of(|row| row.high));
    }
    match cost {
        Ok(priced) => {
            object["chips_used"] = priced.chips_used.into();
            object["cores_used"] = priced.cores_used.into();
            object["intervals"] = json!(priced.intervals);
            object["x86_share"] = json!(priced.x86_share);
        }
        Err(reasons) => object["reasons"] = json!(reasons),
    }
    object
}

/// `nsim.compare/1`.
pub fn json(found: &Comparison) -> Value {
    let Comparison { model, input, samples, mode, accounting, seed, targets, .. } = found;
    let rows: Vec<Value> = targets.iter().map(row_json).collect();
    json!({ "schema": "nsim.compare/1", "model": model, "input": input, "samples": samples, "mode": mode,
        "accounting": accounting, "seed": seed, "targets": rows })
}

/// CSV with a row for each target.
pub fn csv_rows(found: &Comparison) -> String {
    fn row(row: &ComparedTarget) -> Value {
        let mut object = row_json(row);
        let reasons = row.found.as_ref().err().map_or(&[][..], Vec::as_slice);
        let said: Vec<&str> = reasons.iter().map(|reason| reason.message.as_str()).collect();
        object["reasons"] = said.join("; ").into();
        object
    }
    csv(found.targets.iter().map(row), KEYS)
}

/// The result as text.
pub fn text(found: &Comparison) -> String {
    // The unit of all energies: nanojoules if each is below 0.1 uJ.
    let energies: Vec<f64> = found.targets.iter().filter_map(|one| one.found.as_ref().ok()?.row.energy_uj).collect();
    let nano = !energies.is_empty() && energies.iter().all(|uj| *uj < 0.1);
    let scale = |key: &str| if nano && key == "energy_uj" { 1e3 } else { 1.0 };
    let heads = FIGURES.map(|(key, heading, ..)| if scale(key) > 1.0 { "nJ a step" } else { heading });
    let header = [&["target", "chips", "cores"][..], &heads].concat();
    let (mut lines, mut said, mut kinds) = (Vec::new(), String::new(), Vec::new());
    for ComparedTarget { target, constants, found, .. } in &found.targets {
        match found {
            Ok(priced) => {
                said.extend(priced.constant_notes.iter().map(|why| wrapped(&format!("{target}: {why}"))));
                let figure = |(key, _, figure, _): &Figure| {
                    figure(&priced.row).map_or("-".to_string(), |x| three(x * scale(key)))
                };
                let counts = [target.clone(), priced.chips_used.to_string(), priced.cores_used.to_string()];
                lines.push(counts.into_iter().chain(FIGURES.iter().map(figure)).collect());
                if let (Some(low), Some(high), Some(intervals)) = (priced.row.low, priced.row.high, priced.intervals) {
                    let range = |(key, .., end): &Figure| match (end(&low), end(&high)) {
                        (Some(low), Some(high)) => format!("{}..{}", three(low * scale(key)), three(high * scale(key))),
                        _ => String::new(),
                    };
                    let empty = [String::new(), String::new(), String::new()];
                    lines.push(empty.into_iter().chain(FIGURES.iter().map(range)).collect());
                    kinds.push((constants, intervals));
                }
            }
            Err(reasons) => {
                lines.push([&[target.as_str()][..], &["-"; 5]].concat().into_iter().map(str::to_string).collect());
                for reason in reasons {
                    said += &wrapped(&format!("it does not fit {target}: {}", reason.message));
                }
            }
        }
    }
    let shown = if found.input.is_empty() { "its scene".to_string() } else { found.input.join(" ") };
    let (samples, power) = (count(found.samples, "sample"), found.accounting.power_text());
    let pace = found.mode.text();
    let mut out = wrapped(&format!("{}, one copy, {pace}, {samples} of {shown}. Power {power}.", found.model));
    out += &format!("\n{}\n{said}", table(&header, &lines));
    if !found.set.is_empty() {
        out += &wrapped(&format!("--set changes every row: {}", found.set.join(", ")));
    }
    let of_x86 = found.targets.iter().filter_map(|one| Some((&one.target, one.found.as_ref().ok()?.x86_share)));
    let shares: Vec<(&String, Option<f64>)> = of_x86.collect();
    if shares.iter().any(|(_, share)| share.is_some()) {
        let said = |(target, share): &(&String, Option<f64>)| match share {
            Some(share) => format!("{} of a step on {target}", percent(*share)),
            None => format!("none on {target}"),
        };
        let said = shares.iter().map(said).collect::<Vec<_>>().join(", ");
        out += &wrapped(&format!("time of x86 cores for input: {said}; --host none omits them"));
    }
    kinds.dedup();
    for (constants, intervals) in kinds {
        out += &wrapped(&match intervals {
            Intervals::Works => format!("{constants}: ranges contain 80 % of published works"),
            Intervals::Constants => format!("{constants}: modelled; ranges follow from its sources"),
        });
    }
    out
}
