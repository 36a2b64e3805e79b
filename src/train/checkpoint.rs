//! A training's state as a safetensors file. A training that resumes from it ends as one that was never interrupted.
//!
//! The file holds a fingerprint of plan and samples: a checkpoint of another training is refused.

use std::collections::HashMap;
use std::path::Path;

use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use sha2::{Digest, Sha256};

use super::fit::{EpochRow, Example, Plan, TrainingState};
use super::network::Weights;
use super::optimiser::Moments;
use crate::base::diagnostic::{Diagnostic, Result};
use crate::io::text::{MOST_ARRAY, read_bytes};
use crate::io::write;

/// A digest of a training's plan and samples. The plan is digested as it prints for debugging: names of its types and
/// fields are part of the digest, so renaming one invalidates stored checkpoints.
#[must_use]
pub fn fingerprint(plan: &Plan, examples: &[Example]) -> String {
    let mut hash = Sha256::new();
    hash.update(format!("{plan:?}"));
    for example in examples {
        hash.update(example.label.to_le_bytes());
        for (step, unit) in example.inputs.iter().flat_map(super::raster::Raster::events) {
            hash.update(step.to_le_bytes());
            hash.update(unit.to_le_bytes());
        }
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

const PARTS: [&str; 4] = ["weights", "average", "first", "second"];

/// Writes a state; the file is replaced as a whole.
///
/// # Errors
/// `write.*`.
pub fn save(path: &Path, state: &TrainingState, fingerprint: &str) -> Result<()> {
    let parts = [&state.weights, &state.average, &state.moments.first, &state.moments.second];
    let bytes: Vec<(String, Vec<u8>)> = PARTS
        .iter()
        .zip(parts)
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
    let history = serde_json::to_string(&state.history).map_err(|error| broken(error.to_string()))?;
    let facts = HashMap::from([
        ("epoch".to_string(), state.epoch.to_string()),
        ("steps".to_string(), state.moments.steps.to_string()),
        ("history".to_string(), history),
        ("fingerprint".to_string(), fingerprint.to_string()),
    ]);
    let file = safetensors::serialize(views, Some(facts)).map_err(|error| broken(error.to_string()))?;
    write::file(path, true, |out| out.write_all(&file))
}

/// Reads the state of this training, if the file is there.
///
/// # Errors
/// `train.checkpoint` for a file that is no checkpoint, or one of another training; `io.*`.
pub fn load(path: &Path, plan: &Plan, fingerprint: &str) -> Result<Option<TrainingState>> {
    if !path.exists() {
        return Ok(None);
    }
    let wrong = |why: &str| {
        Diagnostic::new("train.checkpoint", why.to_string())
            .help("remove the file to begin anew, or name another with --checkpoint")
            .in_file(path)
    };
    let bytes = read_bytes(path, MOST_ARRAY)?;
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|_| wrong("this is no checkpoint"))?;
    let fact = |key: &str| header.metadata().as_ref().and_then(|facts| facts.get(key).cloned());
    let number = |key: &str| fact(key).and_then(|text| text.parse::<u64>().ok());
    if fact("fingerprint").as_deref() != Some(fingerprint) {
        return Err(wrong("this checkpoint belongs to a training with other settings or samples"));
    }
    let tensors = SafeTensors::deserialize(&bytes).map_err(|_| wrong("this is no checkpoint"))?;
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
        let history: Vec<EpochRow> = serde_json::from_str(&fact("history")?).ok()?;
        let moments = Moments { first: first?, second: second?, steps: number("steps")? };
        Some(TrainingState { epoch: number("epoch")? as u32, weights: weights?, average: average?, moments, history })
    };
    state().map(Some).ok_or_else(|| wrong("this checkpoint is not whole"))
}
