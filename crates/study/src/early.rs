//! How soon, and for how much energy, a network decides as it will in the end.
//!
//! Input: outcomes of labelled samples, the energy of each step. Output: accuracy and energy after
//! each step.

use std::path::Path;

use serde_json::Value;

use nsim_files as io;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::spikes::Sample;
use nsim_session::Outcome;
use nsim_session::error::Error;
use nsim_train::loss::class_of;

/// One model on its samples.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Share of the commonest class of the samples, which naming it always reaches.
    pub chance: f64,
    /// Share of the samples that are right on the spikes up to each step.
    pub accuracy: Vec<f64>,
    /// Mean energy that one copy has spent up to the end of each step.
    pub energy_uj: Vec<f64>,
    /// For each sample when it was right for good; `None` where it never is.
    pub decided_ms: Vec<Option<f64>>,
}

/// What one model did with samples of one length.
#[derive(Debug, Clone, Copy)]
pub struct TrialRun<'a> {
    /// The samples, with labels.
    pub samples: &'a [&'a Sample],
    /// Of each sample.
    pub outcomes: &'a [Outcome],
    /// Timesteps of a sample.
    pub steps: usize,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Mean energy of each step over the samples.
    pub spent_uj: &'a [f64],
}

impl Trial {
    /// Accuracy and energy over the samples.
    ///
    /// # Errors
    /// [`Error::Usage`] for a sample without a label.
    pub fn new(run: TrialRun<'_>) -> Result<Trial, Error> {
        let TrialRun { samples, outcomes, steps, timestep_ms, spent_uj } = run;
        let so_far = |energy: &mut f64, step: &f64| {
            *energy += step;
            Some(*energy)
        };
        let energy_uj = spent_uj.iter().scan(0.0, so_far).collect();
        let chance = commonest(samples);
        let mut trial = Trial { timestep_ms, chance, accuracy: vec![0.0; steps], energy_uj, decided_ms: Vec::new() };
        let share = 1.0 / samples.len().max(1) as f64;
        for (index, (outcome, sample)) in outcomes.iter().zip(samples).enumerate() {
            if outcome.potentials.is_some() {
                let message = "accuracy over time is that of the spikes so far, and potentials decide this model";
                return Err(Error::Usage(message.to_string()));
            }
            let Some(label) = sample.label() else {
                return Err(Error::Usage(format!("sample {index} of those tested has no label")));
            };
            let mut counts = vec![0.0f32; outcome.counts.len()];
            let mut spikes = outcome.spikes.iter().peekable();
            let mut right_since = None;
            for step in 0..steps {
                while let Some(&(_, output)) = spikes.next_if(|spike| spike.0 as usize == step) {
                    counts[output as usize] += 1.0;
                }
                if class_of(&counts) == Some(label) {
                    trial.accuracy[step] += share;
                    right_since.get_or_insert(step);
                } else {
                    right_since = None;
                }
            }
            trial.decided_ms.push(right_since.map(|step| (step + 1) as f64 * timestep_ms));
        }
        Ok(trial)
    }
}

/// The share of the commonest label.
fn commonest(samples: &[&Sample]) -> f64 {
    let mut labels: Vec<u32> = samples.iter().filter_map(|sample| sample.label()).collect();
    labels.sort_unstable();
    let most = labels.chunk_by(|a, b| a == b).map(<[u32]>::len).max().unwrap_or(0);
    most as f64 / labels.len().max(1) as f64
}

/// Models of one kind: the folds of a cross-validation, or a single one.
#[derive(Debug, Clone, PartialEq)]
pub struct TrialGroup {
    /// What they have in common.
    pub name: String,
    /// Each of them.
    pub trials: Vec<Trial>,
}

/// A model of a study and what it is tested on.
#[derive(Debug)]
pub struct StudyModel {
    /// Its training and setting.
    pub group: String,
    /// The model file.
    pub model: String,
    /// Samples that its training left out; `None` for all.
    pub tested: Option<Vec<usize>>,
}

/// The models that `nsim bench paper --train` left in a folder, by group and name.
///
/// # Errors
/// `study.run` when the folder cannot be read or holds anything else in its `.json` files.
pub fn study_models(folder: &Path) -> Result<Vec<StudyModel>, Diagnostic> {
    let unreadable = |path: &Path, why: String| Diagnostic::new("study.run", why).in_file(path);
    let mut models = Vec::new();
    for path in io::disk::list(folder).map_err(|error| unreadable(folder, error.to_string()))? {
        if path.extension().is_none_or(|extension| extension != "json") {
            continue;
        }
        let bytes = io::text::read_bytes(&path, 1 << 26)?;
        let run: Value = serde_json::from_slice(&bytes).map_err(|error| unreadable(&path, error.to_string()))?;
        if io::write::checksum::holds(&run) == Some(false) {
            return Err(unreadable(&path, "the file is damaged: its checksum is another".to_string()));
        }
        let text = |key: &str| run[key].as_str().map(str::to_string);
        let (Some(name), Some(setting)) = (text("name"), text("setting")) else {
            return Err(unreadable(&path, "this is no run of a study".to_string()));
        };
        let group = if setting.is_empty() { name } else { format!("{name} {setting}") };
        let indices = |list: &Vec<Value>| list.iter().filter_map(|index| Some(index.as_u64()? as usize)).collect();
        let model = path.with_extension("ron").display().to_string();
        models.push(StudyModel { group, model, tested: run["tested"].as_array().map(indices) });
    }
    models.sort_by(|a, b| (&a.group, &a.model).cmp(&(&b.group, &b.model)));
    match models.is_empty() {
        true => Err(unreadable(folder, "there is no run of a study in this folder".to_string())),
        false => Ok(models),
    }
}
