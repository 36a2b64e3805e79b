//! The result of `nsim convert` as text, JSON and CSV.

use serde_json::{Value, json};

use super::text::{Column, count, csv_of, four, markdown_of, or_empty, table_of};
use crate::agree::attribution::Distance;
use crate::agree::ladder::Ladder;
use crate::convert::fine_tune::{FineTuneRow, FineTuned, TaskScore};
use crate::convert::staged::{Converted, LayerLoss, Left, Measured, StageRow};

/// Integers that were trained further.
#[derive(Debug)]
pub struct Tuned {
    /// The epochs and their scores.
    pub tuned: FineTuned,
    /// Epochs that were asked for.
    pub epochs: u32,
    /// The integers that are kept.
    pub integers: Ladder,
    /// Where the training samples came from.
    pub samples: Vec<String>,
    /// How near the integers still are to the trained network on samples that no stage saw.
    pub held_out: Option<Measured>,
}

/// Everything that the report says.
#[derive(Debug)]
pub struct ConvertReport<'a> {
    /// The network's name.
    pub model: &'a str,
    /// SHA-256 of the model file.
    pub hash: &'a str,
    /// Where the samples came from.
    pub input: &'a [String],
    /// What came out.
    pub converted: &'a Converted,
    /// How near it is on samples that no stage saw.
    pub held_out: Option<&'a Measured>,
    /// What fine-tuning made of it.
    pub tuned: Option<&'a Tuned>,
    /// The files that were written.
    pub files: &'a [String],
    /// Wall-clock seconds of the conversion.
    pub seconds: f64,
}

fn rounded(x: f64) -> f64 {
    // A zero without a sign.
    format!("{x:.6}").parse().unwrap_or(x) + 0.0
}

const STAGES: [Column<StageRow>; 7] = [
    ("stage", |row| row.name.clone()),
    ("kept", |row| if row.kept { "yes" } else { "no" }.to_string()),
    ("classes agree", |row| four(row.distance.class_agreement)),
    ("coincidence", |row| four(row.distance.coincidence)),
    ("gain", |row| or_empty(row.gain.map(four))),
    ("left to gain", |row| or_empty(row.left.map(four))),
    ("potential rmse", |row| or_empty(row.distance.potential_rmse.map(four))),
];

const LEFT: [Column<Left>; 4] = [
    ("real numbers in place of", |left| left.cause.name().to_string()),
    ("classes agree", |left| four(left.without.class_agreement)),
    ("coincidence", |left| four(left.without.coincidence)),
    ("potential rmse", |left| or_empty(left.without.potential_rmse.map(four))),
];

const LAYERS: [Column<LayerLoss>; 4] = [
    ("layer", |layer| layer.name.clone()),
    ("coincidence", |layer| layer.coincidence.map_or("nothing to compare".to_string(), four)),
    ("clipped", |layer| layer.clipped.to_string()),
    ("exponents", |layer| exponents(layer)),
];

const EPOCHS: [Column<FineTuneRow>; 3] = [
    ("epoch", |row| row.epoch.to_string()),
    ("accuracy", |row| four(row.score.accuracy)),
    ("loss", |row| four(row.score.loss)),
];

fn exponents(layer: &LayerLoss) -> String {
    layer.weight_exp.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
}

fn distance(distance: &Distance) -> Value {
    json!({
        "class_agreement": rounded(distance.class_agreement),
        "coincidence": rounded(distance.coincidence),
        "potential_rmse": distance.potential_rmse.map(rounded),
    })
}

fn measured(measured: &Measured) -> Value {
    let layer = |(name, coincidence, _): &(String, Option<f64>, u64)| json!({ "name": name, "coincidence": coincidence.map(rounded) });
    let mut object = distance(&measured.distance);
    object["samples"] = measured.samples.into();
    object["layers"] = measured.layers.iter().map(layer).collect();
    object
}

fn score(score: &TaskScore) -> Value {
    json!({ "accuracy": rounded(score.accuracy), "loss": rounded(score.loss) })
}

impl Tuned {
    /// For a model's provenance.
    #[must_use]
    pub fn sentence(&self) -> String {
        let FineTuned { kept, samples, held_out, seed, fingerprint, .. } = &self.tuned;
        let change = |before: &TaskScore, after: &TaskScore| format!("{:.4} -> {:.4}", before.accuracy, after.accuracy);
        let (before, after) = self.tuned.scores();
        let unseen = held_out.map_or_else(String::new, |held| {
            let change = change(&held.before, &held.after);
            format!(", {change} on {} held-out samples (as trained {:.4})", held.samples, held.trained)
        });
        format!(
            "fine-tuned for {} with seed {seed} on {samples} training samples of {}, SHA-256 of plan and samples {fingerprint}; epoch \
             {kept} is kept; accuracy {} on the training samples{unseen}",
            count(self.epochs, "epoch"),
            self.samples.join(" "),
            change(&before, &after),
        )
    }

    fn json(&self) -> Value {
        let FineTuned { kept, rows, samples, held_out, seed, fingerprint, .. } = &self.tuned;
        let row = |row: &FineTuneRow| {
            let mut object = score(&row.score);
            object["epoch"] = row.epoch.into();
            object
        };
        let unseen = held_out.map(|held| {
            json!({
                "samples": held.samples, "trained_accuracy": rounded(held.trained), "before": score(&held.before),
                "after": score(&held.after),
            })
        });
        let (before, after) = self.tuned.scores();
        json!({
            "epochs": self.epochs,
            "kept": kept,
            "seed": seed,
            "input": self.samples,
            "samples": samples,
            "sha256": fingerprint,
            "before": score(&before),
            "after": score(&after),
            "rows": rows.iter().map(row).collect::<Vec<_>>(),
            "held_out": unseen,
            "agreement": self.held_out.as_ref().map(measured),
        })
    }

    fn text(&self) -> String {
        let mut out = format!("fine-tuning\n{}\n\n{}\n", table_of(&self.tuned.rows, &EPOCHS, 0), self.sentence());
        if let Some(held) = &self.held_out {
            out += &format!("on {} after it: {}\n", count(held.samples as u64, "held-out sample"), sentence(held));
        }
        out
    }

    fn markdown(&self) -> String {
        format!("\nFine-tuning:\n\n{}\nIt was {}.\n", markdown_of(&self.tuned.rows, &EPOCHS), self.sentence())
    }
}

impl ConvertReport<'_> {
    /// `nsim.convert/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let stage = |row: &StageRow| {
            let mut object = distance(&row.distance);
            object["name"] = row.name.as_str().into();
            object["kept"] = row.kept.into();
            object["gain"] = row.gain.map(rounded).into();
            object["left"] = row.left.map(rounded).into();
            object
        };
        let layer = |layer: &LayerLoss| {
            json!({
                "name": layer.name, "coincidence": layer.coincidence.map(rounded), "weight_exp": layer.weight_exp,
                "clipped": layer.clipped, "advice": layer.advice,
            })
        };
        let left = |left: &Left| {
            let mut object = distance(&left.without);
            object["cause"] = left.cause.name().into();
            object
        };
        json!({
            "schema": "nsim.convert/1",
            "model": self.model,
            "model_sha256": self.hash,
            "input": self.input,
            "samples": self.converted.calibration.samples,
            "stages": self.converted.stages.iter().map(stage).collect::<Vec<_>>(),
            "layers": self.converted.layers.iter().map(layer).collect::<Vec<_>>(),
            "left": self.converted.left.iter().map(left).collect::<Vec<_>>(),
            "class_agreement": rounded(self.converted.calibration.distance.class_agreement),
            "calibration": measured(&self.converted.calibration),
            "held_out": self.held_out.map(measured),
            "fine_tune": self.tuned.map(Tuned::json),
            "output": self.files,
            "seconds": rounded(self.seconds),
        })
    }

    /// A row a stage.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        csv_of(&self.converted.stages, &STAGES)
    }

    /// A section of a document.
    #[must_use]
    pub fn markdown(&self) -> String {
        let calibration = &self.converted.calibration;
        let mut out = format!("{}, {}.\n\n", self.model, count(calibration.samples as u64, "calibration sample"));
        out += &markdown_of(&self.converted.stages, &STAGES);
        out += &format!(
            "\nThe most that is left to gain, with real numbers in the place of one kind of integer (with none, on the same samples, \
             {}):\n\n",
            four(self.converted.left_from.coincidence)
        );
        out += &markdown_of(&self.converted.left, &LEFT);
        if let Some(held) = self.held_out {
            out += &format!("\nOn {}: {}.\n", count(held.samples as u64, "held-out sample"), sentence(held));
        }
        if let Some(tuned) = self.tuned {
            out += &tuned.markdown();
        }
        out
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let calibration = &self.converted.calibration;
        let mut out = format!("{}, {}\n\n", self.model, count(calibration.samples as u64, "calibration sample"));
        out += &format!("{}\n\n", table_of(&self.converted.stages, &STAGES, 2));
        out += &format!("{}\n\n", table_of(&self.converted.layers, &LAYERS, 1));
        for layer in &self.converted.layers {
            if let Some(advice) = &layer.advice {
                out += &format!("'{}': {advice}\n", layer.name);
            }
        }
        out += &format!("\nwhat is left to gain\n{}\n\n", table_of(&self.converted.left, &LEFT, 1));
        if let Some(held) = self.held_out {
            out += &format!("on {}: {}\n", count(held.samples as u64, "held-out sample"), sentence(held));
        }
        if let Some(tuned) = self.tuned {
            out += &tuned.text();
        }
        if !self.files.is_empty() {
            out += &format!("written: {}\n", self.files.join(", "));
        }
        out
    }
}

/// How near, in a sentence.
#[must_use]
pub fn sentence(measured: &Measured) -> String {
    let layers = measured.layers.iter().map(|(name, coincidence, _)| match coincidence {
        Some(coincidence) => format!("{name} {coincidence:.3}"),
        None => format!("{name} silent"),
    });
    let layers: Vec<String> = layers.collect();
    format!("classes agree in {:.4}, coincidence {}", measured.distance.class_agreement, layers.join(", "))
}
