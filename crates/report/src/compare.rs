//! The result of `nsim compare` as text, JSON (`nsim.compare/1`) and CSV.
//!
//! Input: a row for each target: cores, time, energy and power of one copy, or the reasons why the
//! target cannot hold the network. Output: strings. Figures of JSON and CSV have full precision,
//! those of the text three digits.

use serde_json::{Value, json};

use nsim_compile::Reason;
use nsim_cost::estimate::{Bound, EnergyRow};
use nsim_files::table::{csv, table, three, wrapped};

/// What a target makes of the network.
#[derive(Debug, Clone)]
pub struct ComparedTarget {
    /// The target's name.
    pub target: String,
    /// What its rows of energy are called.
    pub hardware: String,
    /// The preset of constants.
    pub constants: String,
    /// What it costs, or why it cannot be held.
    pub found: Result<Priced, Vec<Refused>>,
}

/// A network on a target.
#[derive(Debug, Clone)]
pub struct Priced {
    /// Chips in use.
    pub chips_used: u64,
    /// Neuron cores in use.
    pub cores_used: u64,
    /// The row `total` of its energy.
    pub row: EnergyRow,
    /// Where its intervals come from: the errors of published works, or the bounds of modelled
    /// constants; `None` without intervals.
    pub intervals: Option<Intervals>,
    /// What to know of its constants, as `nsim energy` says it.
    pub of_constants: Vec<String>,
    /// The share of a step in which x86 cores feed it; `None` without them.
    pub x86_share: Option<f64>,
}

/// Where intervals come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Intervals {
    /// 80 % of published works are within them.
    Works,
    /// What the sources of modelled constants leave open.
    Constants,
}

/// Why a target cannot hold a network.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Refused {
    /// A stable name for scripts.
    pub code: String,
    /// What is wrong, and what to change.
    pub message: String,
}

impl From<&Reason> for Refused {
    fn from(reason: &Reason) -> Self {
        Refused { code: reason.code.to_string(), message: reason.to_string() }
    }
}

/// What was compared.
#[derive(Debug, Clone)]
pub struct Comparison {
    /// The model's name.
    pub model: String,
    /// What the network was shown.
    pub input: Vec<String>,
    /// The seed of the input, if one was used.
    pub seed: Option<u64>,
    /// Fields of targets and constants that `--set` gives all of them.
    pub set: Vec<String>,
    /// A row a target, in the order of the command.
    pub targets: Vec<ComparedTarget>,
}

/// A figure and its key, its heading, and how it is read from a row and from an end of its
/// interval.
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
        "chips_used": null, "cores_used": null, "intervals": null, "reasons": [],
    });
    let found = row.found.as_ref();
    for (key, _, figure, end) in FIGURES {
        let of = |bound: fn(&EnergyRow) -> Option<Bound>| found.ok().and_then(|one| end(&bound(&one.row)?));
        object[key] = json!(found.ok().and_then(|one| figure(&one.row)));
        object[format!("{key}_low")] = json!(of(|row| row.low));
        object[format!("{key}_high")] = json!(of(|row| row.high));
    }
    match found {
        Ok(priced) => {
            object["chips_used"] = priced.chips_used.into();
            object["cores_used"] = priced.cores_used.into();
            object["intervals"] = json!(priced.intervals);
        }
        Err(reasons) => object["reasons"] = json!(reasons),
    }
    object
}

/// `nsim.compare/1`.
pub fn json(found: &Comparison) -> Value {
    let Comparison { model, input, seed, targets, .. } = found;
    let rows: Vec<Value> = targets.iter().map(row_json).collect();
    json!({ "schema": "nsim.compare/1", "model": model, "input": input, "seed": seed, "targets": rows })
}

/// A row a target.
pub fn csv_rows(found: &Comparison) -> String {
    let row = |row: &ComparedTarget| {
        let mut object = row_json(row);
        let reasons = row.found.as_ref().err().map_or(&[][..], Vec::as_slice);
        let said: Vec<&str> = reasons.iter().map(|reason| reason.message.as_str()).collect();
        object["reasons"] = said.join("; ").into();
        object
    };
    csv(found.targets.iter().map(row), KEYS)
}

/// For people.
pub fn text(found: &Comparison) -> String {
    // The unit in which every energy is read easily.
    let energies: Vec<f64> = found.targets.iter().filter_map(|one| one.found.as_ref().ok()?.row.energy_uj).collect();
    let nano = !energies.is_empty() && energies.iter().all(|uj| *uj < 0.1);
    let scale = |key: &str| if nano && key == "energy_uj" { 1e3 } else { 1.0 };
    let heads = FIGURES.map(|(key, heading, ..)| if scale(key) > 1.0 { "nJ a step" } else { heading });
    let header = [&["target", "chips", "cores"][..], &heads].concat();
    let (mut lines, mut said, mut kinds) = (Vec::new(), String::new(), Vec::new());
    for ComparedTarget { target, constants, found, .. } in &found.targets {
        match found {
            Ok(priced) => {
                said.extend(priced.of_constants.iter().map(|why| wrapped(&format!("{target}: {why}"))));
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
                    said += &wrapped(&format!("{target} cannot hold it: {}", reason.message));
                }
            }
        }
    }
    let shown = if found.input.is_empty() { "its scene".to_string() } else { found.input.join(" ") };
    let mut out = wrapped(&format!("{}, one copy, shown {shown}", found.model));
    out += &format!("\n{}\n{said}", table(&header, &lines));
    if !found.set.is_empty() {
        out += &wrapped(&format!("--set changes every row: {}", found.set.join(", ")));
    }
    let of_x86 = found.targets.iter().filter_map(|one| Some((&one.target, one.found.as_ref().ok()?.x86_share)));
    let shares: Vec<(&String, Option<f64>)> = of_x86.collect();
    if shares.iter().any(|(_, share)| share.is_some()) {
        let said = |(target, share): &(&String, Option<f64>)| match share {
            Some(share) => format!("{:.0} % of a step on {target}", 100.0 * share),
            None => format!("none on {target}"),
        };
        let said = shares.iter().map(said).collect::<Vec<_>>().join(", ");
        out += &wrapped(&format!("x86 cores that feed input take {said}: --host none omits them"));
    }
    kinds.dedup();
    for (constants, intervals) in kinds {
        out += &wrapped(&match intervals {
            Intervals::Works => format!("{constants}: ranges hold 80 % of published works"),
            Intervals::Constants => format!("{constants}: modelled; ranges are what its sources leave open"),
        });
    }
    out
}
