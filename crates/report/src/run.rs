//! The result of `nsim run` as text, JSON and CSV.

use serde::Serialize;
use serde_json::{Value, json};

use crate::map::pruned_kinds;
use crate::origin;
use nsim_files::table::{count, csv_text, or_empty, table, three, wrapped};
use nsim_ir::activity::{Activity, Overflow, Totals};
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::Quantised;
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;
use nsim_session::learning::LearningRow;
use nsim_session::neurobench::NeuroBench;
use nsim_session::{Outcome, accuracy, digest, median_decision};

/// Data of the report.
#[derive(Debug)]
pub struct RunReport<'a> {
    /// The network that ran.
    pub network: &'a Quantised,
    /// The target onto which it is mapped; none for the golden engine.
    pub target: Option<&'a str>,
    /// `fast` or `golden`.
    pub engine: &'static str,
    /// The arguments that name the sources of the input.
    pub input: &'a [String],
    /// The seed of the input, when it had one.
    pub seed: Option<u64>,
    /// Samples, in run order.
    pub outcomes: &'a [Outcome],
    /// Their classes, when known.
    pub labels: &'a [Option<u32>],
    /// Counts of the mapped program; none for the golden engine.
    pub activity: Option<&'a Activity>,
    /// Compartment updates that were skipped.
    pub skipped_updates: u64,
    /// The rule by which samples ended before their last step.
    pub early_exit: Option<Rule>,
    /// Seconds spent simulating.
    pub wall_s: f64,
    /// Counts by population, input and core, and warnings.
    pub detail: &'a Detail,
    /// The metrics of NeuroBench's harness, if requested.
    pub neurobench: Option<&'a NeuroBench>,
    /// What each rule did.
    pub learning: &'a [LearningRow],
    /// Files that were written.
    pub files: &'a [String],
}

/// The object of `nsim.run/1` for a network that did not run.
pub fn empty_result(engine: &str) -> Value {
    json!({
        "schema": "nsim.run/1", "model": null, "target": null, "engine": engine, "fits": false, "reasons": [],
        "samples": 0, "timesteps": 0, "predicted": [], "decision": null, "undecided": 0, "labels": null, "accuracy": null, "output_counts": [],
        "output_scores": null, "digest": null, "activity": null, "skipped": null, "overflow": null, "decided_at": [], "wall_s": null,
        "us_per_timestep": null, "populations": [], "inputs": [], "cores": [], "warnings": [],
    })
}

fn neurobench_text(metrics: &NeuroBench) -> String {
    let figures = [
        ("synaptic operations", Some(metrics.synaptic_operations.dense)),
        ("effective ACs", Some(metrics.synaptic_operations.effective_acs)),
        ("effective MACs", Some(metrics.synaptic_operations.effective_macs)),
        ("membrane updates", Some(metrics.membrane_updates)),
        ("activation sparsity", Some(metrics.activation_sparsity)),
        ("connection sparsity", Some(metrics.connection_sparsity)),
        ("footprint, bytes", Some(metrics.footprint_bytes as f64)),
        ("classification accuracy", metrics.classification_accuracy),
    ];
    let row = |(name, figure): (&str, Option<f64>)| Some(vec![name.to_string(), three(figure?)]);
    format!("\n{}", table(&["NeuroBench", "a sample"], &figures.into_iter().filter_map(row).collect::<Vec<_>>()))
}

/// Text of a potential, or of a sum of them; whole numbers have no fraction.
fn score_text(score: f64) -> String {
    if score.fract() == 0.0 { format!("{score:.0}") } else { format!("{score:.4}") }
}

#[derive(Serialize)]
struct Events {
    #[serde(flatten)]
    totals: Totals,
    /// Synapses whose rule was evaluated; `None` without rules.
    #[serde(skip_serializing_if = "Option::is_none")]
    synaptic_updates: Option<u64>,
    messages: Option<u64>,
    hops: Option<u64>,
}

#[derive(Serialize)]
struct EarlyExit {
    rule: Rule,
    /// Number of samples that were decided early; `median_step` is the median of their steps.
    decided: usize,
    median_step: Option<u32>,
    steps_saved: u64,
}

impl RunReport<'_> {
    /// Overflow of all samples, with the first sample that has any.
    fn overflow_json(&self) -> Value {
        let mut sum = Overflow::default();
        self.outcomes.iter().for_each(|outcome| sum.merge(&outcome.overflow));
        let sample = self.outcomes.iter().position(|outcome| outcome.overflow.any());
        let first = sample.and_then(|sample| {
            let (step, compartment) = self.outcomes[sample].overflow.first?;
            let (population, index) = self.network.population_of(compartment);
            let index = self.network.index_before_pruning(population, index);
            let name = &self.network.populations()[population].name;
            Some(json!({ "population": name, "compartment": index, "sample": sample, "step": step }))
        });
        let Overflow { q_wrapped, u_wrapped, v_clipped, .. } = sum;
        json!({ "q_wrapped": q_wrapped, "u_wrapped": u_wrapped, "v_clipped": v_clipped, "first": first })
    }

    fn timesteps(&self) -> u64 {
        self.outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum()
    }

    fn us_per_timestep(&self) -> f64 {
        self.wall_s * 1e6 / self.timesteps().max(1) as f64
    }

    fn accuracy(&self) -> Option<f64> {
        accuracy(self.outcomes, self.labels.iter().copied())
    }

    fn predicted(&self) -> Vec<Option<u32>> {
        self.outcomes.iter().map(|outcome| outcome.class().filter(|_| self.network.decides())).collect()
    }

    fn undecided(&self) -> usize {
        self.predicted().iter().filter(|class| class.is_none()).count() * usize::from(self.network.decides())
    }

    fn output_scores(&self) -> Option<Vec<&[f64]>> {
        self.outcomes.iter().map(|one| one.potentials.as_ref().map(Potentials::scores)).collect()
    }

    fn events(&self) -> Events {
        let mut totals = Totals::default();
        self.outcomes.iter().for_each(|outcome| totals += outcome.totals);
        let hops = self.activity.map(|activity| activity.hops().total_links());
        let updates = self.outcomes.iter().map(|outcome| outcome.synaptic_updates).sum();
        let synaptic_updates = Some(updates).filter(|_| !self.learning.is_empty());
        Events { totals, synaptic_updates, messages: self.activity.map(Activity::messages), hops }
    }

    fn early_exit(&self) -> Option<EarlyExit> {
        self.early_exit.map(|rule| EarlyExit {
            rule,
            decided: self.outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count(),
            median_step: median_decision(self.outcomes),
            steps_saved: self.outcomes.iter().map(|outcome| u64::from(outcome.steps_saved)).sum(),
        })
    }

    fn early_exit_text(&self) -> String {
        let Some(EarlyExit { rule, decided, median_step, steps_saved }) = self.early_exit() else {
            return String::new();
        };
        let share = 100.0 * steps_saved as f64 / (steps_saved + self.timesteps()).max(1) as f64;
        let median = median_step.map_or(String::new(), |step| format!(", in the median after step {step}"));
        let saved = wrapped(&format!(
            "early exit {rule}: {decided} of {} samples decided before their end{median}; {steps_saved} timesteps \
             saved ({share:.1} %)",
            self.outcomes.len()
        ));
        format!("\n{saved}")
    }

    /// A line for each rule.
    fn learning_text(&self) -> String {
        fn line(row: &LearningRow) -> String {
            let LearningRow { name, epochs, weight_min, weight_max, at_bounds, changed, .. } = row;
            wrapped(&format!(
                "{name} learned over {}: {}, from {weight_min} to {weight_max}, {at_bounds} at their bounds",
                count(*epochs, "epoch"),
                count(*changed, "changed weight")
            ))
        }
        let lines: String = self.learning.iter().map(line).collect();
        if lines.is_empty() { lines } else { format!("\n{lines}") }
    }

    /// `nsim.run/1`.
    pub fn json(&self) -> Value {
        let (parts, outcomes) = (self.network.parts(), self.outcomes);
        let skipped: u64 = outcomes.iter().map(|outcome| outcome.skipped_steps).sum();
        let labels = self.labels.iter().copied().collect::<Option<Vec<u32>>>().filter(|labels| !labels.is_empty());
        let notes = parts.notes.iter().map(|note| format!("{}: {}", note.entity, note.message));
        let mut result = json!({
            "schema": "nsim.run/1", "model": parts.name, "target": self.target, "engine": self.engine,
            "fits": self.target.map(|_| true), "input": self.input, "seed": self.seed, "samples": outcomes.len(),
            "timesteps": self.timesteps(), "drain": parts.drain, "predicted": self.predicted(),
            "decision": parts.decision.name(), "undecided": self.undecided(), "labels": labels,
            "accuracy": self.accuracy(),
            "output_counts": outcomes.iter().map(|outcome| &outcome.counts).collect::<Vec<_>>(),
            "output_scores": self.output_scores(), "digest": digest(outcomes), "activity": self.events(),
            "skipped": { "timesteps": skipped, "compartment_updates": self.skipped_updates },
            "overflow": self.overflow_json(),
            "decided_at": outcomes.iter().map(|outcome| outcome.decided_at).collect::<Vec<_>>(),
            "early_exit": self.early_exit(), "wall_s": self.wall_s, "us_per_timestep": self.us_per_timestep(),
            "pruned": pruned_kinds(self.network.pruned().map_or(&[], |pruned| pruned.rows.as_slice())),
            "notes": notes.collect::<Vec<_>>(), "files": self.files,
        });
        if let (Value::Object(fields), Value::Object(detail)) = (&mut result, json!(self.detail)) {
            fields.extend(detail);
            if !self.learning.is_empty() {
                fields.insert("learning".to_string(), json!(self.learning));
            }
            fields.extend(self.neurobench.map(|metrics| ("neurobench".to_string(), json!(metrics))));
        }
        result
    }

    /// CSV with a row for each sample.
    pub fn csv(&self) -> String {
        let (predicted, outputs) = (self.predicted(), self.outcomes.first().map_or(0, |one| one.counts.len()));
        let head = ["sample", "label", "predicted", "steps", "decided_at", "spikes_in", "spikes", "synaptic_events"];
        let head = head.map(String::from).into_iter().chain((0..outputs).map(|output| format!("output_{output}")));
        let rows = self.outcomes.iter().zip(self.labels).enumerate().map(|(sample, (outcome, &label))| {
            let mut row = vec![sample.to_string(), or_empty(label), or_empty(predicted[sample])];
            row.extend([outcome.steps.to_string(), or_empty(outcome.decided_at)]);
            let totals = outcome.totals;
            row.extend([totals.spikes_in, totals.spikes, totals.synaptic_events].map(|count| count.to_string()));
            row.extend(outcome.counts.iter().map(ToString::to_string));
            row
        });
        csv_text(head.collect(), rows)
    }

    fn class_name(&self, class: Option<u32>) -> String {
        let Some(class) = class else { return "none".to_string() };
        self.network.parts().classes.get(class as usize).cloned().unwrap_or_else(|| class.to_string())
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let (model, engine, steps) = (&self.network.parts().name, self.engine, self.timesteps());
        let samples = count(self.outcomes.len() as u64, "sample");
        let accuracy = self.accuracy();
        let mut out = accuracy.map_or(String::new(), |share| format!("accuracy {} over {samples}\n", three(share)));
        out += &wrapped(&match self.target {
            Some(target) => format!("{model} simulated on {target}, engine {engine}"),
            None => format!("{model} interpreted without cores, engine {engine}"),
        });
        out += &wrapped(&format!("input: {}", origin(self.input, self.seed)));
        let drain = match self.network.parts().drain {
            0 => String::new(),
            drain => format!(", of each sample {drain} after its last input step (drain)"),
        };
        out += &wrapped(&format!("{samples}, {}{drain}", count(steps, "timestep")));
        const SHOWN: usize = 12;
        const OUTPUTS: usize = 24;
        let scores = match self.network.parts().decision {
            ReadOut::Spikes if !self.network.decides() => "messages of outputs",
            ReadOut::Spikes => "spikes of outputs",
            ReadOut::GreatestV => "greatest v of outputs",
            ReadOut::SumOfV => "sum of v of outputs",
            ReadOut::LastV => "last v of outputs",
        };
        let (predicted, output_scores) = (self.predicted(), self.output_scores());
        let row = |(sample, (&class, &label)): (usize, (&Option<u32>, &Option<u32>))| {
            let counts = &self.outcomes[sample].counts;
            let mut scores: Vec<String> = match &output_scores {
                Some(scores) => scores[sample].iter().take(OUTPUTS).map(|score| score_text(*score)).collect(),
                None => counts.iter().take(OUTPUTS).map(ToString::to_string).collect(),
            };
            scores.extend((counts.len() > OUTPUTS).then(|| "..".to_string()));
            let label = if label.is_some() { self.class_name(label) } else { "-".to_string() };
            vec![sample.to_string(), label, self.class_name(class), scores.join(" ")]
        };
        let rows: Vec<Vec<String>> = predicted.iter().zip(self.labels).enumerate().take(SHOWN).map(row).collect();
        out += &format!("\n{}", table(&["sample", "label", "predicted", scores], &rows));
        if self.outcomes.len() > SHOWN {
            out += &format!("{} more; all of them with --format csv or json\n", self.outcomes.len() - SHOWN);
        }
        if !self.network.decides() {
            let name = &self.network.populations()[self.network.parts().output].name;
            out += &wrapped(&format!("'{name}' sends values: --probe {name} -o FOLDER stores them."));
        }
        let undecided = self.undecided();
        if undecided > 0 {
            out += &format!("\nundecided {undecided} of {samples}\n");
        }
        out += &self.early_exit_text();
        out += &self.learning_text();
        let Events { totals, synaptic_updates, messages, hops } = self.events();
        let counts = [
            ("input spikes", Some(totals.spikes_in)),
            ("spikes", Some(totals.spikes)),
            ("synaptic events", Some(totals.synaptic_events)),
            ("compartment updates", Some(totals.compartment_updates)),
            ("of them active", Some(totals.active_updates)),
            ("synaptic updates", synaptic_updates),
            ("messages", messages),
            ("hops", hops),
        ];
        let row = |(name, count): (&str, Option<u64>)| {
            let count = count?;
            Some(vec![name.to_string(), count.to_string(), three(count as f64 / steps.max(1) as f64)])
        };
        let rows: Vec<Vec<String>> = counts.into_iter().filter_map(row).collect();
        out += &format!("\n{}", table(&["activity", "total", "a timestep"], &rows));
        out += &self.neurobench.map_or(String::new(), neurobench_text);
        out += &format!("\n{}", self.detail.populations_text(steps));
        out += &self.detail.ranks_text();
        out += &format!("simulated in {} s, {} us a timestep\n", three(self.wall_s), three(self.us_per_timestep()));
        for file in self.files {
            out += &format!("wrote {file}\n");
        }
        out
    }
}
