//! The result of `nsim convert` as text, JSON and CSV.

use serde_json::{Value, json};

use super::text::{Column, count, csv_of, four, markdown_of, or_empty, table_of};
use crate::agree::attribution::Distance;
use crate::convert::staged::{Converted, LayerLoss, Left, Measured, StageRow};

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
