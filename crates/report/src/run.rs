//! The result of `nsim run` as text, JSON and CSV.

use serde_json::{Value, json};

use crate::map::pruned_json;
use crate::origin;
use nsim_files::table::{count, csv_text, or_empty, table, three, wrapped};
use nsim_ir::activity::{Activity, Overflow, Totals};
use nsim_ir::arithmetic::ReadOut;
use nsim_ir::potentials::Potentials;
use nsim_ir::quantised::Quantised;
use nsim_session::decision::Rule;
use nsim_session::detail::Detail;
use nsim_session::neurobench::NeuroBench;
use nsim_session::{Outcome, accuracy, digest, median_decision};

/// Everything that the report says.
#[derive(Debug)]
pub struct RunReport<'a> {
    /// The network that ran.
    pub network: &'a Quantised,
    /// The target it is mapped onto; none for the golden engine.
    pub target: Option<&'a str>,
    /// `fast` or `golden`.
    pub engine: &'static str,
    /// The arguments that say where the input came from.
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
    /// By population, input and core, and what to warn of.
    pub detail: &'a Detail,
    /// The metrics of NeuroBench's harness, where they were asked for.
    pub neurobench: Option<&'a NeuroBench>,
    /// Files that were written.
    pub files: &'a [String],
}

/// The object of `nsim.run/1` for what did not run.
pub fn nothing(engine: &str) -> Value {
    json!({
        "schema": "nsim.run/1", "model": null, "target": null, "engine": engine, "fits": false, "reasons": [],
        "samples": 0, "timesteps": 0, "predicted": [], "decision": null, "undecided": 0, "labels": null, "accuracy": null, "output_counts": [],
        "output_scores": null, "digest": null, "activity": null, "skipped": null, "overflow": null, "decided_at": [], "wall_s": null,
        "us_per_timestep": null, "populations": [], "inputs": [], "cores": [], "warnings": [],
    })
}

/// The object `neurobench`.
pub fn neurobench_json(metrics: &NeuroBench) -> Value {
    json!({
        "footprint_bytes": metrics.footprint_bytes,
        "connection_sparsity": metrics.connection_sparsity,
        "activation_sparsity": metrics.activation_sparsity,
        "synaptic_operations": {
            "effective_macs": metrics.effective_macs, "effective_acs": metrics.effective_acs, "dense": metrics.dense,
        },
        "membrane_updates": metrics.membrane_updates,
        "classification_accuracy": metrics.classification_accuracy,
    })
}

fn neurobench_text(metrics: &NeuroBench) -> String {
    let figures = [
        ("synaptic operations", Some(metrics.dense)),
        ("effective ACs", Some(metrics.effective_acs)),
        ("effective MACs", Some(metrics.effective_macs)),
        ("membrane updates", Some(metrics.membrane_updates)),
        ("activation sparsity", Some(metrics.activation_sparsity)),
        ("connection sparsity", Some(metrics.connection_sparsity)),
        ("footprint, bytes", Some(metrics.footprint_bytes as f64)),
        ("classification accuracy", metrics.classification_accuracy),
    ];
    let row = |(name, figure): (&str, Option<f64>)| Some(vec![name.to_string(), three(figure?)]);
    format!("\n{}", table(&["NeuroBench", "a sample"], &figures.into_iter().filter_map(row).collect::<Vec<_>>()))
}

/// A potential, or a sum of them: whole in integers.
fn score_text(score: f64) -> String {
    if score.fract() == 0.0 { format!("{score:.0}") } else { format!("{score:.4}") }
}

impl RunReport<'_> {
    fn labels(&self) -> Option<Vec<u32>> {
        self.labels.iter().copied().collect::<Option<Vec<u32>>>().filter(|labels| !labels.is_empty())
    }

    fn accuracy(&self) -> Option<f64> {
        accuracy(self.outcomes, self.labels.iter().copied())
    }

    /// Samples without a class.
    fn undecided(&self) -> usize {
        self.outcomes.iter().filter(|outcome| outcome.class().is_none()).count()
    }

    fn timesteps(&self) -> u64 {
        self.outcomes.iter().map(|outcome| u64::from(outcome.steps)).sum()
    }

    fn steps_saved(&self) -> u64 {
        self.outcomes.iter().map(|outcome| u64::from(outcome.steps_saved)).sum()
    }

    /// Number of samples that were decided early, and the least step by which half of those were.
    fn decided(&self) -> (usize, Option<u32>) {
        let decided = self.outcomes.iter().filter(|outcome| outcome.decided_at.is_some());
        (decided.count(), median_decision(self.outcomes))
    }

    fn early_exit_json(&self) -> Value {
        let Some(rule) = self.early_exit else { return Value::Null };
        let (decided, median) = self.decided();
        json!({
            "rule": rule.to_string(), "decided": decided, "median_step": median, "steps_saved": self.steps_saved(),
        })
    }

    fn early_exit_text(&self) -> String {
        let Some(rule) = self.early_exit else { return String::new() };
        let ((decided, median), saved) = (self.decided(), self.steps_saved());
        let share = 100.0 * saved as f64 / (saved + self.timesteps()).max(1) as f64;
        let median = median.map_or(String::new(), |step| format!(", in the median after step {step}"));
        let said = wrapped(&format!(
            "early exit {rule}: {decided} of {} samples decided before their end{median}; {saved} timesteps saved \
             ({share:.1} %)",
            self.outcomes.len()
        ));
        format!("\n{said}")
    }

    fn totals(&self) -> Totals {
        let mut sum = Totals::default();
        for outcome in self.outcomes {
            sum += outcome.totals;
        }
        sum
    }

    fn us_per_timestep(&self) -> f64 {
        self.wall_s * 1e6 / self.timesteps().max(1) as f64
    }

    /// Overflow of all samples, with the first sample that has any.
    fn overflow(&self) -> (Overflow, Option<usize>) {
        let mut sum = Overflow::default();
        let first = self.outcomes.iter().position(|outcome| outcome.overflow.any());
        self.outcomes.iter().for_each(|outcome| sum.merge(&outcome.overflow));
        sum.first = first.and_then(|sample| self.outcomes[sample].overflow.first);
        (sum, first)
    }

    fn overflow_json(&self) -> Value {
        let (overflow, sample) = self.overflow();
        let first = overflow.first.map(|(step, compartment)| {
            let (population, index) = self.network.population_of(compartment);
            let index = self.network.index_shown(population, index);
            json!({
                "population": self.network.populations()[population].name,
                "compartment": index, "sample": sample, "step": step,
            })
        });
        json!({
            "q_wrapped": overflow.q_wrapped, "u_wrapped": overflow.u_wrapped, "v_clipped": overflow.v_clipped,
            "first": first,
        })
    }

    /// `nsim.run/1`.
    pub fn json(&self) -> Value {
        let totals = self.totals();
        let mut object = json!({
            "schema": "nsim.run/1",
            "model": self.network.parts().name,
            "target": self.target,
            "engine": self.engine,
            "fits": self.target.map(|_| true),
            "input": self.input,
            "seed": self.seed,
            "samples": self.outcomes.len(),
            "timesteps": self.timesteps(),
            "drain": self.network.parts().drain,
            "predicted": self.outcomes.iter().map(Outcome::class).collect::<Vec<_>>(),
            "decision": self.network.parts().decision.name(),
            "undecided": self.undecided(),
            "labels": self.labels(),
            "accuracy": self.accuracy(),
            "output_counts": self.outcomes.iter().map(|outcome| &outcome.counts).collect::<Vec<_>>(),
            "output_scores": self.outcomes.iter()
                .map(|outcome| outcome.potentials.as_ref().map(Potentials::scores)).collect::<Option<Vec<_>>>(),
            "digest": digest(self.outcomes),
            "activity": {
                "spikes_in": totals.spikes_in,
                "spikes": totals.spikes,
                "synaptic_events": totals.synaptic_events,
                "compartment_updates": totals.compartment_updates,
                "active_updates": totals.active_updates,
                "messages": self.activity.map(Activity::messages),
                "hops": self.activity.map(|activity| activity.hops().links()),
            },
            "skipped": {
                "timesteps": self.outcomes.iter().map(|outcome| outcome.skipped_steps).sum::<u64>(),
                "compartment_updates": self.skipped_updates,
            },
            "overflow": self.overflow_json(),
            "decided_at": self.outcomes.iter().map(|outcome| outcome.decided_at).collect::<Vec<_>>(),
            "early_exit": self.early_exit_json(),
            "wall_s": self.wall_s,
            "us_per_timestep": self.us_per_timestep(),
            "pruned": pruned_json(self.network.pruned().map_or(&[], |pruned| pruned.rows.as_slice())),
            "notes": self.network.parts().notes.iter()
                .map(|note| format!("{}: {}", note.entity, note.message)).collect::<Vec<_>>(),
            "files": self.files,
        });
        self.detail.add_to(&mut object);
        if let Some(metrics) = self.neurobench {
            object["neurobench"] = neurobench_json(metrics);
        }
        object
    }

    /// One row a sample.
    pub fn csv(&self) -> String {
        let outputs = self.outcomes.first().map_or(0, |outcome| outcome.counts.len());
        let head = ["sample", "label", "predicted", "steps", "decided_at", "spikes_in", "spikes", "synaptic_events"];
        let head = head.map(String::from).into_iter().chain((0..outputs).map(|output| format!("output_{output}")));
        let rows = self.outcomes.iter().zip(self.labels).enumerate().map(|(sample, (outcome, &label))| {
            let mut row = vec![sample.to_string(), or_empty(label), or_empty(outcome.class())];
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

    /// For people.
    pub fn text(&self) -> String {
        let (parts, totals, steps) = (self.network.parts(), self.totals(), self.timesteps());
        let samples = count(self.outcomes.len() as u64, "sample");
        let mut out =
            self.accuracy().map_or(String::new(), |share| format!("accuracy {} over {samples}\n", three(share)));
        out += &wrapped(&match self.target {
            Some(target) => format!("{} simulated on {target}, engine {}", parts.name, self.engine),
            None => format!("{} interpreted without cores, engine {}", parts.name, self.engine),
        });
        out += &wrapped(&format!("input: {}", origin(self.input, self.seed)));
        let drain = match parts.drain {
            0 => String::new(),
            drain => format!(", of each sample {drain} after its last input step (drain)"),
        };
        out += &wrapped(&format!("{samples}, {}{drain}", count(steps, "timestep")));
        const SHOWN: usize = 12;
        const OUTPUTS: usize = 24;
        let scores = match parts.decision {
            ReadOut::Spikes => "spikes of outputs",
            ReadOut::GreatestV => "greatest v of outputs",
            ReadOut::SumOfV => "sum of v of outputs",
            ReadOut::LastV => "last v of outputs",
        };
        let row = |(sample, (outcome, &label)): (usize, (&Outcome, &Option<u32>))| {
            let mut scores: Vec<String> = match &outcome.potentials {
                Some(potentials) => potentials.scores().iter().take(OUTPUTS).map(|score| score_text(*score)).collect(),
                None => outcome.counts.iter().take(OUTPUTS).map(ToString::to_string).collect(),
            };
            scores.extend((outcome.counts.len() > OUTPUTS).then(|| "..".to_string()));
            let label = if label.is_some() { self.class_name(label) } else { "-".to_string() };
            vec![sample.to_string(), label, self.class_name(outcome.class()), scores.join(" ")]
        };
        let rows: Vec<Vec<String>> = self.outcomes.iter().zip(self.labels).enumerate().take(SHOWN).map(row).collect();
        out += &format!("\n{}", table(&["sample", "label", "predicted", scores], &rows));
        if self.outcomes.len() > SHOWN {
            out += &format!("{} more; all of them with --format csv or json\n", self.outcomes.len() - SHOWN);
        }
        if self.undecided() > 0 {
            out += &format!("\nundecided {} of {}\n", self.undecided(), count(self.outcomes.len() as u64, "sample"));
        }
        out += &self.early_exit_text();
        let of_machine =
            self.activity.map(|activity| [("messages", activity.messages()), ("hops", activity.hops().links())]);
        let counts = [
            ("input spikes", totals.spikes_in),
            ("spikes", totals.spikes),
            ("synaptic events", totals.synaptic_events),
            ("compartment updates", totals.compartment_updates),
            ("of them active", totals.active_updates),
        ];
        let row = |(name, count): (&str, u64)| {
            vec![name.to_string(), count.to_string(), three(count as f64 / steps.max(1) as f64)]
        };
        let rows: Vec<Vec<String>> = counts.into_iter().chain(of_machine.into_iter().flatten()).map(row).collect();
        out += &format!("\n{}", table(&["activity", "total", "a timestep"], &rows));
        out += &self.neurobench.map_or(String::new(), neurobench_text);
        out += &format!("\n{}", self.detail.populations_text(steps));
        out += &self.detail.ranks_text();
        out += &format!("{} s, {} us a timestep\n", three(self.wall_s), three(self.us_per_timestep()));
        for file in self.files {
            out += &format!("wrote {file}\n");
        }
        out
    }
}
