//! The folds of a training, each a network in a folder of its own files.
//!
//! Input: a training file, fields, a number of folds, a folder. Output: a [`Finished`] for each
//! fold; its result, model and weights are files in the folder, so that training that was broken
//! off goes on where it was. Errors: `train.*`, `write.*`.

use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::checkpoint;
use crate::fit::{Example, Plan, TrainingState};
use crate::job::{Job, cross_validate, with_fields};
use nsim_files as io;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::SourceText;
use nsim_session::error::Result;

/// The most bytes of the result of a fold.
const MOST_RUN: u64 = 1 << 26;

/// The training of a fold, as its file has it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StudyRun {
    /// The fields that were set.
    pub setting: String,
    /// The seed.
    pub seed: u64,
    /// The fold that was left out and tested on.
    pub fold: u32,
    /// Share of the tested samples that is right.
    pub accuracy: f64,
    /// Seconds that it took, to the microsecond.
    pub seconds: f64,
}

/// A training that is in the folder.
#[derive(Debug, Clone, PartialEq)]
pub struct Finished {
    /// What it came to.
    pub run: StudyRun,
    /// The model file.
    pub model: PathBuf,
    /// The samples that were left out and tested on.
    pub tested: Vec<usize>,
}

/// What is trained.
#[derive(Debug)]
pub struct Study<'a> {
    /// The training file.
    pub source: &'a SourceText,
    /// Fields and their values.
    pub fields: &'a [(&'a str, &'a str)],
    /// Epochs, instead of the file's.
    pub epochs: Option<u32>,
    /// Folds of the training samples.
    pub folds: u32,
    /// Where results are kept.
    pub folder: &'a Path,
}

/// A run of a study from its file, when it is there, whole and of the same training. What is not is
/// trained again.
fn kept(path: &Path, print: &str) -> Result<Option<StudyRun>> {
    let bytes = match io::text::read_bytes(path, MOST_RUN) {
        Err(absent) if absent.code == "io.missing" => return Ok(None),
        read => read?,
    };
    let is_whole = |value: &Value| value["fingerprint"] == print && checksum::holds(value) == Some(true);
    let value = serde_json::from_slice(&bytes).ok().filter(is_whole);
    Ok(value.and_then(|value| serde_json::from_value(value).ok()))
}

impl Study<'_> {
    /// Trains the folds of `examples` that the folder does not have yet; `train` trains on some of
    /// them to the end, `after` sees each training when it is in the folder.
    ///
    /// # Errors
    /// `train.*` for a file that cannot be used, `write.*` for a folder; those of `train`.
    pub fn run(
        &self,
        examples: &[Example],
        mut train: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
        mut after: impl FnMut(&Finished),
    ) -> Result<Vec<Finished>> {
        let job = Job::new(with_fields(self.source, self.fields)?, None, self.epochs)?;
        let mut all = Vec::new();
        for (part, fold) in Job::folds(examples, self.folds).into_iter().enumerate() {
            let finished = self.finished(&job, (part as u32, fold), examples, &mut train)?;
            after(&finished);
            all.push(finished);
        }
        Ok(all)
    }

    /// One training, from the folder when it is there.
    fn finished(
        &self,
        job: &Job,
        (fold, tested): (u32, Vec<usize>),
        examples: &[Example],
        train: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
    ) -> Result<Finished> {
        let (plan, name) = (&job.plan, &job.file.name);
        let print = checkpoint::fingerprint(plan, examples);
        let path = self.folder.join(format!("{name}-{}-{}-fold{fold}.json", &print[..12], plan.seed));
        let model = path.with_extension("ron");
        if let Some(run) = kept(&path, &print)? {
            return Ok(Finished { run, model, tested });
        }
        let begin = Instant::now();
        let (accuracy, weights) = cross_validate(plan, examples, &tested, train)?;
        let setting = self.fields.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ");
        let said = format!("{setting} seed {}, fold {fold}: accuracy {accuracy:.4}", plan.seed);
        job.write((&model, true), &weights, "", &said)?;
        let seconds = begin.elapsed().as_micros() as f64 / 1e6;
        let run = StudyRun { setting, seed: plan.seed, fold, accuracy, seconds };
        let mut value = serde_json::json!(run);
        value["fingerprint"] = print.into();
        value["name"] = name.clone().into();
        value["tested"] = tested.clone().into();
        io::write::text(&path, true, &format!("{:#}\n", checksum::with(value)))?;
        Ok(Finished { run, model, tested })
    }
}
