//! The command that `nsim agree` and `nsim convert` suggest as the next one.
//!
//! Input: the command line, the network, and the causes of its losses. Output: a command that
//! changes something about the costliest cause, or that looks closer if nothing can be changed. A
//! change of the model is tried on the samples, and printed only if the integers come nearer.

use crate::convert::deployed::Conversion;
use crate::convert::taps;
use nsim_agree::attribution::{Attribution, Distance, LayerLoss, compare_stages};
use nsim_agree::causes::{Cause, ComparisonStage};
use nsim_agree::compare::output_layer;
use nsim_agree::staged::StagedNetwork;
use nsim_files::changes::{Change, with_changes};
use nsim_files::lower::lower;
use nsim_import::model::load_model;
use nsim_ir::base::fixed::ThresholdMantissa;
use nsim_ir::graph::{Graph, NeuronParameters, PerCompartment, PopulationKind};
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic;

/// Coincidence or classes that a change has to gain.
const LEAST_GAIN: f64 = 0.005;
/// Most doublings of the thresholds.
const DOUBLINGS: i64 = 3;

/// The suggested command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Suggestion {
    /// The cause that it reduces; none if it looks closer.
    pub cause: Option<Cause>,
    /// Its effect.
    pub what: String,
    /// The command.
    pub command: String,
}

/// Command-line arguments.
#[derive(Debug, Clone)]
pub struct CommandWords<'a> {
    /// The words after `nsim`.
    pub words: Vec<String>,
    /// The model among them.
    pub model: &'a str,
    /// How a spike response network becomes integers, and the number of taps.
    pub conversion: (Conversion, usize),
    /// The words after `nsim` of a command that looks closer.
    pub closer: Option<Vec<String>>,
}

fn quoted(word: &str) -> String {
    fn plain(c: char) -> bool {
        c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c)
    }
    if !word.is_empty() && word.chars().all(plain) {
        word.to_string()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// A line for a shell.
fn command(words: &[String]) -> String {
    let words = words.iter().map(|word| quoted(word));
    std::iter::once("nsim".to_string()).chain(words).collect::<Vec<_>>().join(" ")
}

impl CommandWords<'_> {
    /// The command line with options replaced or added. Files that it wrote are replaced.
    fn with_options(&self, options: &[(&str, &str)]) -> String {
        let mut words = self.words.clone();
        for &(name, value) in options {
            let place = words.iter().position(|word| word == name || word.starts_with(&format!("{name}=")));
            match place.filter(|_| name != "--set") {
                Some(at) => {
                    let both = if words[at] == name { at..(at + 2).min(words.len()) } else { at..at + 1 };
                    words.splice(both, [name.to_string(), value.to_string()]);
                }
                None => words.extend([name.to_string(), value.to_string()]),
            }
        }
        let writes = ["-o", "--output", "--plot", "--plot-causes", "--svg"];
        if words.iter().any(|word| writes.contains(&word.as_str())) && !words.iter().any(|word| word == "--force") {
            words.push("--force".to_string());
        }
        command(&words)
    }
}

/// Changes of the model's file that may reduce a cause, with their effects.
fn candidates(cause: Cause, graph: &Graph) -> Vec<(&'static str, Vec<String>)> {
    let greater = "makes thresholds and weights greater, so that rounding loses less";
    let all = (1..=DOUBLINGS).filter_map(|times| Some((greater, doubled(graph, times)?)));
    let narrow = graph.projections().zip(graph.declared_places()).filter(|((.., p), _)| p.weight_bits.value < 8);
    let mut wider: Vec<String> = narrow.map(|(_, place)| format!("projections.{place}.weight_bits=8")).collect();
    wider.dedup();
    match cause {
        Cause::State => all.collect(),
        Cause::Weights if wider.is_empty() => all.collect(),
        Cause::Weights => all.chain([("stores weights in all bits", wider)]).collect(),
        _ => Vec::new(),
    }
}

/// Thresholds, biases and weights of populations in the chip's integers, doubled `times` times. The
/// rounding of current and voltage then weighs less. `None` if a field cannot represent a value.
fn doubled(graph: &Graph, times: i64) -> Option<Vec<String>> {
    fn same(p: &NeuronParameters, name: &str) -> Option<i64> {
        match p.get(name).map(|values| &values.each) {
            None => Some(p.value(name, 0) as i64),
            Some(PerCompartment::Same(value)) => Some(*value as i64),
            Some(PerCompartment::Each(_)) => None,
        }
    }
    // A population with the greatest threshold is read out by its potential.
    let never = f64::from(ThresholdMantissa::MAX.get());
    let in_integers = |kind: &PopulationKind| match kind {
        PopulationKind::Neurons(p) => {
            p.kind.table().registers && p.get("vth_mant").is_some() && p.value("vth_mant", 0) < never
        }
        _ => false,
    };
    let mut changes = Vec::new();
    for (_, population) in graph.populations() {
        let PopulationKind::Neurons(p) = &population.kind else { continue };
        if !in_integers(&population.kind) {
            continue;
        }
        let threshold = same(p, "vth_mant")? << times;
        ThresholdMantissa::new(threshold).ok()?;
        changes.push(format!("populations.{}.vth_mant={threshold}", population.name));
        if p.get("bias_mant").is_some() {
            let exponent = same(p, "bias_exp")? + times;
            (exponent <= 7).then_some(())?;
            changes.push(format!("populations.{}.bias_exp={exponent}", population.name));
        }
    }
    for ((_, _, target, projection), place) in graph.projections().zip(graph.declared_places()) {
        if in_integers(&graph.population(target).kind) {
            let exponent = projection.weight_exp.value + times;
            (exponent <= 7).then_some(())?;
            changes.push(format!("projections.{place}.weight_exp={exponent}"));
        }
    }
    changes.dedup();
    (!changes.is_empty()).then_some(changes)
}

/// The model with changes, where it can be read and quantised.
fn changed(model: &str, changes: &[String]) -> Option<StagedNetwork> {
    let changes: Vec<Change> = changes.iter().map(|change| Change::parse(change)).collect::<Result<_, _>>().ok()?;
    let graph = lower(&with_changes(&changes, || load_model(model)).ok()?).ok()?;
    StagedNetwork::new(&graph, &analytic::starts(&graph)).ok()
}

fn distance_text(distance: &Distance) -> String {
    let classes = distance.class_agreement.map_or(String::new(), |share| format!("classes agree in {share:.3}, "));
    format!("{classes}coincidence {:.3}", distance.coincidence)
}

/// The next command; `None` if almost nothing is lost, or nothing is left to try.
pub fn suggest(
    typed: &CommandWords<'_>,
    graph: &Graph,
    staged: &StagedNetwork,
    attribution: &Attribution,
    samples: &[&Sample],
) -> Option<Suggestion> {
    let worst = attribution.worst();
    let lossy = attribution.layers.iter().any(LayerLoss::is_lossy);
    let changed = worst.and_then(|cause| remedy(typed, graph, staged, cause, attribution, samples));
    let searched = changed.or_else(|| {
        let (what, command) = search(typed).filter(|_| lossy && graph.has_srm())?;
        Some(Suggestion { cause: worst, what: what.to_string(), command })
    });
    searched.or_else(|| {
        let words = typed.closer.as_ref().filter(|_| lossy)?;
        let what = "draws both potentials around the first spike that differs".to_string();
        Some(Suggestion { cause: None, what, command: command(words) })
    })
}

/// The next call in Python, for a target of this name; `None` if almost nothing is lost.
pub fn suggest_in_python(attribution: &Attribution, target: Option<&str>) -> Option<Suggestion> {
    attribution.worst().filter(|_| attribution.layers.iter().any(LayerLoss::is_lossy))?;
    let target = target.map_or(String::new(), |target| format!(", target='{target}'"));
    Some(Suggestion {
        cause: None,
        what: "draws both potentials around the first spike that differs".to_string(),
        command: format!("network.agree(spikes{target}, plot='first.svg')"),
    })
}

fn remedy(
    typed: &CommandWords<'_>,
    graph: &Graph,
    staged: &StagedNetwork,
    cause: Cause,
    attribution: &Attribution,
    samples: &[&Sample],
) -> Option<Suggestion> {
    let spelled = |changes: &[String], what: String| {
        let options: Vec<(&str, &str)> = changes.iter().map(|change| ("--set", change.as_str())).collect();
        Some(Suggestion { cause: Some(cause), what, command: typed.with_options(&options) })
    };
    let before = &attribution.machine;
    if cause == Cause::Pipeline {
        let changes = staged.pipeline()?.changes(graph)?;
        let without = attribution.shares.iter().find(|share| share.cause == cause)?.without;
        let what = format!(
            "starts each layer at the step of its depth, and extends samples until the output answers: {} (now {})",
            distance_text(&without),
            distance_text(before)
        );
        return spelled(&changes, what);
    }
    fn total(distance: &Distance) -> f64 {
        distance.class_agreement.unwrap_or(1.0) + distance.coincidence
    }
    let mut best: Option<(&str, Vec<String>, Distance)> = None;
    // A model that is read again has the resets of its file.
    let replaced = !graph.has_srm() && staged.causes().contains(&Cause::HardReset);
    let candidates = if replaced { Vec::new() } else { candidates(cause, graph) };
    let networks = candidates
        .into_iter()
        .filter_map(|(what, changes)| changed(typed.model, &changes).map(|network| (what, changes, network)));
    let networks: Vec<(&str, Vec<String>, StagedNetwork)> = networks.collect();
    let stages: Vec<(&StagedNetwork, ComparisonStage)> =
        networks.iter().map(|(.., network)| (network, ComparisonStage::MACHINE)).collect();
    let output = output_layer(staged.deployed());
    let compared = compare_stages((staged, attribution.trained), &stages, &output, samples);
    for ((what, changes, _), compared) in networks.into_iter().zip(compared) {
        let after = compared.distance;
        let least = best.as_ref().map_or(total(before), |(.., best)| total(best)) + LEAST_GAIN;
        if total(&after) > least && after.coincidence > before.coincidence + LEAST_GAIN {
            best = Some((what, changes, after));
        }
    }
    let (what, changes, after) = best?;
    spelled(&changes, format!("{what}: {} (now {})", distance_text(&after), distance_text(before)))
}

/// A better search for the integers of a spike response network, unless this one was full.
fn search(typed: &CommandWords<'_>) -> Option<(&'static str, String)> {
    let (conversion, most_taps) = typed.conversion;
    match conversion {
        Conversion::Analytic => {
            Some(("searches for better integers", typed.with_options(&[("--conversion", Conversion::Search.name())])))
        }
        Conversion::Search => (most_taps < taps::DEFAULT_TAPS).then(|| {
            let most = taps::DEFAULT_TAPS.to_string();
            ("gives the search more delayed copies of the input", typed.with_options(&[("--delayed-copies", &most)]))
        }),
    }
}
