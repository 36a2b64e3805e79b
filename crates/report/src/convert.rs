//! The result of `nsim convert` as text, JSON and CSV.

use serde_json::{Value, json};

use super::agree::{blame, lost_json, next_json};
use nsim_agree::attribution::Share;
use nsim_files::table::{
    Column, count, csv_of, four, markdown_of, or_empty, rounded, table, table_of, three, with_rounded, wrapped,
};
use nsim_train::convert::fine_tune::{FineTuneRow, FineTuned, TunedIntegers};
use nsim_train::convert::job::{ConversionRun, Job, distance_text};
use nsim_train::convert::next::Suggestion;
use nsim_train::convert::staged::{LayerRow, MeasuredDistance, StageRow};

/// Data of the report.
#[derive(Debug)]
pub struct ConvertReport<'a> {
    /// The conversion job.
    pub job: &'a Job,
    /// Its result.
    pub done: &'a ConversionRun,
    /// Sources of the samples.
    pub input: &'a [String],
    /// Result of fine-tuning, if any.
    pub tuned: Option<&'a TunedIntegers>,
    /// The files that were written.
    pub files: &'a [String],
    /// The suggested next command.
    pub next: Option<&'a Suggestion>,
}

const STAGES: [Column<StageRow>; 7] = [
    ("stage", |row| row.name.clone()),
    ("kept", |row| if row.kept { "yes" } else { "no" }.to_string()),
    ("classes agree", |row| or_empty(row.distance.class_agreement.map(four))),
    ("coincidence", |row| four(row.distance.coincidence)),
    ("gain", |row| or_empty(row.gain.map(four))),
    ("left to gain", |row| or_empty(row.left.map(four))),
    ("potential rmse", |row| or_empty(row.distance.potential_rmse.map(four))),
];

const REMAINING: [Column<Share>; 4] = [
    ("real numbers in place of", |left| left.cause.name().to_string()),
    ("classes agree", |left| or_empty(left.without.class_agreement.map(four))),
    ("coincidence", |left| four(left.without.coincidence)),
    ("potential rmse", |left| or_empty(left.without.potential_rmse.map(four))),
];

const LAYERS: [Column<LayerRow>; 4] = [
    ("layer", |layer| layer.name.clone()),
    ("coincidence", |layer| layer.coincidence.map_or("nothing to compare".to_string(), four)),
    ("clipped", |layer| layer.clipped.to_string()),
    ("exponents", |layer| layer.weight_exp.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")),
];

const EPOCHS: [Column<FineTuneRow>; 3] = [
    ("epoch", |row| row.epoch.to_string()),
    ("accuracy", |row| four(row.score.accuracy)),
    ("loss", |row| four(row.score.loss)),
];

fn measured(measured: &MeasuredDistance) -> Value {
    let layer =
        |(name, coincidence, _): &(String, Option<f64>, u64)| json!({ "name": name, "coincidence": coincidence });
    let mut object = json!(measured.distance);
    object["samples"] = measured.samples.into();
    object["accuracy_trained"] = measured.accuracy.map(|(trained, _)| trained).into();
    object["accuracy"] = measured.accuracy.map(|(_, integers)| integers).into();
    object["layers"] = measured.layers.iter().map(layer).collect();
    object
}

fn tuned_json(tuned: &TunedIntegers) -> Value {
    let FineTuned { kept, rows, samples, held_out, seed, fingerprint, .. } = &tuned.tuned;
    let (before, after) = tuned.tuned.scores();
    json!({
        "epochs": tuned.epochs, "kept": kept, "seed": seed, "input": tuned.samples, "samples": samples,
        "sha256": fingerprint, "before": before, "after": after, "rows": rows, "held_out": held_out,
        "agreement": tuned.held_out.as_ref().map(measured),
    })
}

fn tuned_text(tuned: &TunedIntegers) -> String {
    let mut out =
        format!("fine-tuning\n{}\n{}", table_of(&tuned.tuned.rows, &EPOCHS), wrapped(&tuned.provenance_text()));
    if let Some(held) = &tuned.held_out {
        out += &format!("on {} after it: {}\n", count(held.samples as u64, "held-out sample"), distance_text(held));
    }
    out
}

impl ConvertReport<'_> {
    /// Name of the network, and the number of calibration samples.
    fn summary_text(&self) -> String {
        let samples = self.done.converted.calibration.samples;
        format!("{}, {}", self.job.graph.facts().name, count(samples as u64, "calibration sample"))
    }

    /// `nsim.convert/1`.
    pub fn json(&self) -> Value {
        fn left(left: &Share) -> Value {
            let mut object = json!(left.without);
            object["cause"] = left.cause.name().into();
            object
        }
        let converted = &self.done.converted;
        let object = json!({
            "schema": "nsim.convert/1", "model": self.job.graph.facts().name, "model_sha256": self.job.hash,
            "input": self.input, "samples": converted.calibration.samples, "stages": converted.stages,
            "layers": converted.layers, "lost": converted.attribution.layers.iter().map(lost_json).collect::<Vec<_>>(),
            "left": converted.left.iter().map(left).collect::<Vec<_>>(), "next": self.next.map(next_json),
            "class_agreement": converted.calibration.distance.class_agreement,
            "calibration": measured(&converted.calibration), "held_out": self.done.held_out.as_ref().map(measured),
            "fine_tune": self.tuned.map(tuned_json), "output": self.files, "seconds": self.done.seconds,
        });
        with_rounded(object, rounded)
    }

    /// CSV with a row for each stage.
    pub fn csv(&self) -> String {
        csv_of(&self.done.converted.stages, &STAGES)
    }

    /// A section of a Markdown document.
    pub fn markdown(&self) -> String {
        let converted = &self.done.converted;
        let mut out = format!("{}.\n\n{}", self.summary_text(), markdown_of(&converted.stages, &STAGES));
        out += &format!(
            "\nLargest remaining gain, with real numbers instead of one kind of integer (with integers only, on the \
             same samples, {}):\n\n",
            four(converted.attribution.machine.coincidence)
        );
        out += &markdown_of(&converted.left, &REMAINING);
        if let Some(held) = self.done.held_out.as_ref() {
            out += &format!("\nOn {}: {}.\n", count(held.samples as u64, "held-out sample"), distance_text(held));
        }
        if let Some(tuned) = self.tuned {
            let epochs = markdown_of(&tuned.tuned.rows, &EPOCHS);
            out += &format!("\nFine-tuning:\n\n{epochs}\nIt was {}.\n", tuned.provenance_text());
        }
        out
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let converted = &self.done.converted;
        let mut out = format!("{}\n", self.summary_text());
        if let Some(held) = self.done.held_out.as_ref() {
            out += &wrapped(&format!("on {}: {}", count(held.samples as u64, "held-out sample"), distance_text(held)));
        }
        let judged = self.done.held_out.as_ref().unwrap_or(&converted.calibration);
        if let Some((trained, integers)) = judged.accuracy {
            let attribution = &converted.attribution;
            let blamed = attribution.worst_of_classes().map(|(cause, _)| cause).or_else(|| attribution.worst());
            let blamed = blamed.filter(|_| integers < trained);
            out += &wrapped(&format!(
                "accuracy {} as trained, {} converted, on {}{}",
                three(trained),
                three(integers),
                count(judged.samples as u64, "sample"),
                blamed.map_or(String::new(), |cause| format!("; the largest loss is due to {}", cause.loss_text()))
            ));
        }
        // Stages are numbered and named after the table, since their names are too long for it.
        let stages = &converted.stages;
        let cells = |(number, stage): (usize, &StageRow)| {
            let others = STAGES[1..].iter().map(|(_, cell)| cell(stage));
            std::iter::once(number.to_string()).chain(others).collect()
        };
        let rows: Vec<Vec<String>> = (1..).zip(stages).map(cells).collect();
        let calibrated = count(converted.calibration.samples as u64, "calibration sample");
        let stages_table = table(&STAGES.map(|(heading, _)| heading), &rows);
        out += &format!("\nstages, on {calibrated}\n{stages_table}\n");
        (1..).zip(stages).for_each(|(number, stage)| out += &wrapped(&format!("{number}: {}", stage.name)));
        out += &format!("\n{}\n", table_of(&converted.layers, &LAYERS));
        for layer in &converted.layers {
            if let Some(problem) = &layer.problem {
                out += &wrapped(&format!("'{}': {problem}", layer.name));
            }
        }
        out += &blame(&converted.attribution, self.next);
        if self.job.resets_are_replaced() {
            out += &wrapped(
                "Train with a reset to zero (snnTorch: reset_mechanism='zero') to avoid the loss by the replaced \
                 reset; a target whose neurons subtract runs the network unchanged.",
            );
        }
        out += &format!("\nremaining gain, on {calibrated}\n{}\n", table_of(&converted.left, &REMAINING));
        if let Some(tuned) = self.tuned {
            out += &tuned_text(tuned);
        }
        if !self.files.is_empty() {
            out += &wrapped(&format!("written: {}", self.files.join(", ")));
        }
        out
    }
}
