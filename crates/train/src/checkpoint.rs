//! A training's state as a safetensors file. A training resumed from it ends as an uninterrupted
//! one.
//!
//! The file has a fingerprint of plan and samples: a checkpoint of another training is refused. It
//! has a checksum: a damaged one is refused. A file of a version without checksums is read only
//! when its training is finished and both its copies of the weights are equal.

use std::collections::HashMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use super::cells::Cells;
use super::fit::{EpochRow, Example, Plan, TrainingState};
use super::loss::Form;
use super::network::{Layer, Source, Weights};
use super::optimiser::{Moments, Rule};
use nsim_dynamics::Fields;
use nsim_files::budget::MOST_ARRAY;
use nsim_files::text::{read_bytes, sha256};
use nsim_files::training::CreditDesc;
use nsim_files::write::{self, checksum};
use nsim_ir::arithmetic::Semantics;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// A digest of a training's plan and samples. The plan is written out field by field under stable
/// names, so renaming a type invalidates no stored checkpoint.
pub fn fingerprint(plan: &Plan, examples: &[Example]) -> String {
    let mut hash = Sha256::new();
    hash.update(described(plan).to_string());
    for example in examples {
        hash.update(example.label.to_le_bytes());
        for (step, unit) in example.inputs.iter().flat_map(super::raster::Raster::events) {
            hash.update(step.to_le_bytes());
            hash.update(unit.to_le_bytes());
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A plan as an object whose keys do not depend on names in the source.
fn described(plan: &Plan) -> Value {
    let Plan { topology, loss, optimiser, rates, last_rate, batch, epochs, augment, dropout, averaging, initial, seed } =
        plan;
    let form = match &loss.form {
        Form::SpikeCount => json!(["spike-count"]),
        Form::Weighted { beta, gamma } => json!(["weighted", beta, gamma]),
        Form::NumSpikes { kernel } => json!(["num-spikes", kernel]),
        Form::CrossEntropy { scale } => json!(["cross-entropy", scale]),
        Form::Potential { decision, unit, temperature } => json!(["potential", decision, unit, temperature]),
    };
    let rule = match optimiser.rule {
        Rule::Adam => "adam",
        Rule::RmsProp => "rmsprop",
    };
    let mut object = json!({
        "inputs": topology.inputs, "layers": topology.layers.iter().map(layer).collect::<Vec<_>>(),
        "loss": {"form": form, "right": loss.right, "wrong": loss.wrong},
        "optimiser": {"rule": rule, "weight_decay": optimiser.weight_decay, "decoupled": optimiser.decoupled},
        "rates": rates, "last_rate": last_rate, "batch": batch, "epochs": epochs,
        "augment": [
            f64::from(augment.shift), f64::from(augment.jitter), augment.stretch, augment.drop_channel,
            augment.drop_spike, augment.noise,
        ],
        "averaging": averaging, "initial": initial, "seed": seed,
    });
    // A value of 0 has no key, so that older checkpoints keep their fingerprints.
    for (key, value) in [("l1", optimiser.l1), ("dropout", *dropout)] {
        if value > 0.0 {
            object[key] = json!(value);
        }
    }
    object
}

fn layer(layer: &Layer) -> Value {
    fn source(source: &Source) -> Value {
        match source {
            Source::Input(index) => json!(["input", index]),
            Source::Layer(index) => json!(["layer", index]),
        }
    }
    let cells = match &layer.cells {
        Cells::Srm(srm) => json!({
            "kind": "srm", "theta": srm.theta, "response": srm.response, "refractory": srm.refractory,
            "truncated": srm.truncated,
        }),
        Cells::Loihi(loihi) => json!({
            "kind": "loihi", "fields": loihi.fields.iter().map(fields).collect::<Vec<_>>(), "leaves": loihi.leaves,
            "theta": loihi.theta, "weight_unit": loihi.weight_unit, "credit": match loihi.credit {
                CreditDesc::Slayer => "slayer",
                CreditDesc::UpToReset => "up-to-reset",
            },
        }),
        Cells::Loihi2(loihi2) => json!({
            "kind": loihi2.kind.name(), "rows": loihi2.rows, "turns": loihi2.turns, "theta": loihi2.theta,
            "weight_unit": loihi2.weight_unit, "unit": loihi2.unit,
        }),
    };
    json!({
        "name": layer.name, "sources": layer.sources.iter().map(source).collect::<Vec<_>>(), "fan_in": layer.fan_in,
        "cells": cells, "mantissas": layer.mantissas.map(|mantissas| (mantissas.scale, mantissas.exponent.get())),
        "surrogate": layer.surrogate.numbers(),
    })
}

/// The numbers of a compartment.
fn fields(fields: &Fields) -> Value {
    let neuron = &fields.neuron;
    let semantics = match fields.semantics {
        Semantics::Hardware => "hardware",
        Semantics::Lava => "lava",
        Semantics::Slayer => "slayer",
    };
    json!([
        neuron.kind.name(),
        neuron.du.get(),
        neuron.dv.get(),
        semantics,
        fields.bias,
        fields.fires_from,
        fields.vmin,
        fields.vmax,
        fields.refractory,
        fields.start_step,
        fields.resets_from,
    ])
}

/// Name of the entry in the file's metadata.
const FACTS: &str = "nsim_training";
const PARTS: [&str; 4] = ["weights", "average", "first", "second"];

fn parts(state: &TrainingState) -> [&Weights; 4] {
    [&state.weights, &state.average, &state.moments.first, &state.moments.second]
}

/// SHA-256 of all numbers of a state.
fn digest(state: &TrainingState) -> String {
    let bytes: Vec<u8> = parts(state).into_iter().flatten().flatten().flat_map(|x| x.to_le_bytes()).collect();
    sha256(&bytes)
}

/// Writes a state; the file is replaced as a whole.
///
/// # Errors
/// `write.*`.
pub fn save(path: &Path, state: &TrainingState, fingerprint: &str) -> Result<()> {
    let bytes: Vec<(String, Vec<u8>)> = PARTS
        .iter()
        .zip(parts(state))
        .flat_map(|(part, weights)| {
            weights.iter().enumerate().map(move |(layer, numbers)| {
                (format!("{part}.{layer}"), numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())
            })
        })
        .collect();
    let views = bytes.iter().map(|(name, bytes)| {
        TensorView::new(Dtype::F32, vec![bytes.len() / 4], bytes).map(|view| (name.as_str(), view))
    });
    let broken = |error: String| Diagnostic::new("write.failed", error).in_file(path);
    let views = views.collect::<Result<Vec<_>, _>>().map_err(|error| broken(error.to_string()))?;
    // One entry: the order of several would change from run to run.
    let facts = checksum::with(json!({
        "epoch": state.epoch, "steps": state.moments.steps, "history": state.history, "fingerprint": fingerprint,
        "numbers": digest(state),
    }));
    let facts = HashMap::from([(FACTS.to_string(), facts.to_string())]);
    let file = safetensors::serialize(views, Some(facts)).map_err(|error| broken(error.to_string()))?;
    write::file(path, true, |out| out.write_all(&file))
}

/// Reads the state of this training, if the file exists.
///
/// # Errors
/// `train.checkpoint` for a file that is no checkpoint, or is of another training; `io.*`.
pub fn load(path: &Path, plan: &Plan, fingerprint: &str) -> Result<Option<TrainingState>> {
    let wrong = |why: &str| {
        Diagnostic::new("train.checkpoint", why.to_string())
            .help("remove the file to start again, or name another with --checkpoint")
            .in_file(path)
    };
    let bytes = match read_bytes(path, MOST_ARRAY) {
        Err(absent) if absent.code == "io.missing" => return Ok(None),
        read => read?,
    };
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|_| wrong("this is not a checkpoint"))?;
    let facts = header.metadata().as_ref().and_then(|facts| serde_json::from_str::<Value>(facts.get(FACTS)?).ok());
    let facts = facts.unwrap_or(Value::Null);
    let fact = |key: &str| facts[key].clone();
    if fact("fingerprint").as_str() != Some(fingerprint) {
        return Err(wrong("this checkpoint belongs to a training with different settings or samples"));
    }
    let tensors = SafeTensors::deserialize(&bytes).map_err(|_| wrong("this is not a checkpoint"))?;
    let read = |part: &str| -> Option<Weights> {
        let layer = |(layer, like): (usize, &Vec<f32>)| {
            let tensor = tensors.tensor(&format!("{part}.{layer}")).ok()?;
            let (whole, rest) = tensor.data().as_chunks::<4>();
            let right = tensor.dtype() == Dtype::F32 && whole.len() == like.len() && rest.is_empty();
            right.then(|| whole.iter().map(|&x| f32::from_le_bytes(x)).collect())
        };
        plan.topology.zeros().iter().enumerate().map(layer).collect()
    };
    let state = || {
        let [weights, average, first, second] = PARTS.map(read);
        let history: Vec<EpochRow> = serde_json::from_value(fact("history")).ok()?;
        let moments = Moments { first: first?, second: second?, steps: fact("steps").as_u64()? };
        Some(TrainingState {
            epoch: u32::try_from(fact("epoch").as_u64()?).ok()?,
            weights: weights?,
            average: average?,
            moments,
            history,
        })
    };
    let state = state().ok_or_else(|| wrong("this checkpoint is incomplete"))?;
    if !parts(&state).into_iter().flatten().flatten().all(|x| x.is_finite()) {
        return Err(wrong("this checkpoint is damaged: a number in it is NaN or infinite"));
    }
    match checksum::holds(&facts) {
        Some(sound) if !sound || fact("numbers") != digest(&state) => {
            Err(wrong("this checkpoint is damaged: its checksum does not match"))
        }
        Some(_) => Ok(Some(state)),
        // Without averaging, average and weights are equal; a finished training needs nothing else.
        None if state.epoch == plan.epochs && plan.averaging == 0.0 => match state.average == state.weights {
            true => Ok(Some(state)),
            false => Err(wrong("this checkpoint is damaged: its two copies of the weights differ")),
        },
        None => Err(wrong("this checkpoint has no checksum, so it may be damaged: an older nsim wrote it")),
    }
}
