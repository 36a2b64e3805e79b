//! The one command that `nsim agree` and `nsim convert` print: what to type next.
//!
//! Input: what was typed, the network, and to what causes it loses. Output: a command that changes
//! what can be changed about the cause that costs most, or that looks closer where nothing can. A
//! change of the model is tried on the samples, and printed only where the integers come nearer.

use crate::convert::copies;
use crate::convert::deployed::Conversion;
use nsim_agree::attribution::{Attribution, Distance, LayerLoss, as_trained, measured};
use nsim_agree::causes::{Cause, Rung};
use nsim_agree::compare::output_layer;
use nsim_agree::ladder::Ladder;
use nsim_files::changes::{Change, within};
use nsim_files::lower::lower;
use nsim_import::model::load_model;
use nsim_ir::base::fixed::ThresholdMantissa;
use nsim_ir::graph::{Graph, NeuronParameters, PerCompartment, PopulationKind};
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic;

/// Coincidence or classes that a change has to gain.
const WORTH: f64 = 0.005;
/// Thresholds are doubled at most so often.
const DOUBLINGS: i64 = 3;

/// What to type next.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Next {
    /// The cause that it changes; none where it looks closer.
    pub cause: Option<Cause>,
    /// What it does.
    pub what: String,
    /// The command.
    pub command: String,
}

/// What was typed.
#[derive(Debug, Clone)]
pub struct Typed<'a> {
    /// The words after `nsim`.
    pub words: Vec<String>,
    /// Among them the model.
    pub model: &'a str,
    /// How a spike response network becomes integers, and the number of delayed copies.
    pub conversion: (Conversion, usize),
    /// The words after `nsim` that look closer.
    pub closer: Option<Vec<String>>,
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@%".contains(c);
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

impl Typed<'_> {
    /// What was typed with an option of one value. Files that it wrote are replaced.
    fn with(&self, options: &[(&str, &str)]) -> String {
        let mut words = self.words.clone();
        for &(name, value) in options {
            let given = words.iter().position(|word| word == name || word.starts_with(&format!("{name}=")));
            match given.filter(|_| name != "--set") {
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

/// Changes of the model's file that may make a cause cost less, with what they do.
fn candidates(cause: Cause, graph: &Graph) -> Vec<(&'static str, Vec<String>)> {
    let greater = "makes thresholds and weights greater, so that what rounds away weighs less";
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

/// Thresholds, biases and weights of populations in the chip's integers, doubled so often: what
/// rounds away of current and voltage then weighs less. `None` where a field does not hold them.
fn doubled(graph: &Graph, times: i64) -> Option<Vec<String>> {
    let same = |p: &NeuronParameters, name: &str| match p.get(name).map(|values| &values.each) {
        None => Some(p.value(name, 0) as i64),
        Some(PerCompartment::Same(value)) => Some(*value as i64),
        Some(PerCompartment::Each(_)) => None,
    };
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

/// How near the integers of the model are to the network as its tool runs it once it is changed.
fn tried(model: &str, changes: &[String], samples: &[&Sample]) -> Option<Distance> {
    let changes: Vec<Change> = changes.iter().map(|change| Change::parse(change)).collect::<Result<_, _>>().ok()?;
    let graph = lower(&within(&changes, || load_model(model)).ok()?).ok()?;
    let ladder = Ladder::new(&graph, &analytic::starts(&graph)).ok()?;
    let output = output_layer(ladder.deployed());
    let trained = as_trained(&ladder, &output, samples);
    Some(measured((&ladder, trained), &[(&ladder, Rung::MACHINE)], &output, samples).first()?.distance)
}

fn figures(distance: &Distance) -> String {
    let classes = distance.class_agreement.map_or(String::new(), |share| format!("classes agree in {share:.3}, "));
    format!("{classes}coincidence {:.3}", distance.coincidence)
}

/// What to type next; `None` where next to nothing is lost, or nothing is left to try.
pub fn next(
    typed: &Typed<'_>,
    (graph, ladder): (&Graph, &Ladder),
    attribution: &Attribution,
    samples: &[&Sample],
) -> Option<Next> {
    let worst = attribution.worst();
    let lossy = attribution.layers.iter().any(LayerLoss::is_lossy);
    let found = worst.and_then(|cause| remedy(typed, (graph, ladder), cause, attribution, samples));
    let found = found.or_else(|| {
        let (what, command) = search(typed).filter(|_| lossy && graph.has_srm())?;
        Some(Next { cause: worst, what: what.to_string(), command })
    });
    found.or_else(|| {
        let words = typed.closer.as_ref().filter(|_| lossy)?;
        let what = "draws both potentials around the first spike in which they part".to_string();
        Some(Next { cause: None, what, command: command(words) })
    })
}

/// What to call next in Python, where a change of the model's file is no answer; `None` where next
/// to nothing is lost. `target` is the one to name.
pub fn in_python(attribution: &Attribution, target: Option<&str>) -> Option<Next> {
    attribution.worst().filter(|_| attribution.layers.iter().any(LayerLoss::is_lossy))?;
    let target = target.map_or(String::new(), |target| format!(", target='{target}'"));
    Some(Next {
        cause: None,
        what: "draws both potentials around the first spike in which they part".to_string(),
        command: format!("network.agree(spikes{target}, plot='first.svg')"),
    })
}

fn remedy(
    typed: &Typed<'_>,
    (graph, ladder): (&Graph, &Ladder),
    cause: Cause,
    attribution: &Attribution,
    samples: &[&Sample],
) -> Option<Next> {
    let spelled = |changes: &[String], what: String| {
        let options: Vec<(&str, &str)> = changes.iter().map(|change| ("--set", change.as_str())).collect();
        Some(Next { cause: Some(cause), what, command: typed.with(&options) })
    };
    let before = &attribution.machine;
    if cause == Cause::Pipeline {
        let changes = ladder.pipeline()?.changes(graph)?;
        let without = attribution.shares.iter().find(|share| share.cause == cause)?.without;
        let what = format!(
            "lets each layer start at the step of its depth, and samples last until the output has answered: {} (now \
             {})",
            figures(&without),
            figures(before)
        );
        return spelled(&changes, what);
    }
    let total = |distance: &Distance| distance.class_agreement.unwrap_or(1.0) + distance.coincidence;
    let mut best: Option<(&str, Vec<String>, Distance)> = None;
    // A model that is read again has the resets of its file.
    let replaced = !graph.has_srm() && ladder.causes().contains(&Cause::HardReset);
    for (what, changes) in candidates(cause, graph).into_iter().filter(|_| !replaced) {
        let Some(after) = tried(typed.model, &changes, samples) else { continue };
        let least = best.as_ref().map_or(total(before), |(.., best)| total(best)) + WORTH;
        if total(&after) > least && after.coincidence > before.coincidence + WORTH {
            best = Some((what, changes, after));
        }
    }
    let (what, changes, after) = best?;
    spelled(&changes, format!("{what}: {} (now {})", figures(&after), figures(before)))
}

/// A search for better integers of a spike response network, where less of one was asked for.
fn search(typed: &Typed<'_>) -> Option<(&'static str, String)> {
    let (conversion, most_copies) = typed.conversion;
    match conversion {
        Conversion::Analytic => {
            Some(("searches for better integers", typed.with(&[("--conversion", Conversion::Search.name())])))
        }
        Conversion::Search => (most_copies < copies::USUAL).then(|| {
            let most = copies::USUAL.to_string();
            ("gives the search more delayed copies of what comes in", typed.with(&[("--delayed-copies", &most)]))
        }),
    }
}
