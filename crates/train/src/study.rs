//! Many trainings of one file: every combination of the values that fields are given, seeds and
//! folds.
//!
//! Input: a training file, fields, seeds, folds, a folder. Output: a [`Finished`] for each
//! training; its result, model and weights are files in the folder, so that a study that was broken
//! off goes on where it was. Errors: `train.*`, `write.*`. Left out on purpose: choosing the best,
//! which is the reader's.

use std::ops::Range;
use std::path::{Path, PathBuf};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::checkpoint;
use crate::fit::{Example, Plan, TrainingState};
use crate::job::{Data, Job, cross_validate, with_fields};
use nsim_files as io;
use nsim_files::write::checksum;
use nsim_ir::base::diagnostic::SourceText;
use nsim_session::error::Result;

/// The most bytes of a run of a study.
const MOST_RUN: u64 = 1 << 26;

/// One training of a study, as kept in its folder.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StudyRun {
    /// The fields that were set.
    pub setting: String,
    /// Number of the combination of fields.
    #[serde(skip)]
    pub number: usize,
    /// The seed.
    pub seed: u64,
    /// The fold that was left out and tested on; none: the test samples.
    pub fold: Option<u32>,
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
    /// The samples that were left out and tested on; none: the test samples.
    pub tested: Option<Vec<usize>>,
}

/// What is trained.
#[derive(Debug)]
pub struct Study<'a> {
    /// The training file.
    pub source: &'a SourceText,
    /// Fields and their values; a field may be there several times.
    pub fields: &'a [(&'a str, &'a str)],
    /// Epochs, instead of the file's.
    pub epochs: Option<u32>,
    /// Seeds.
    pub seeds: Range<usize>,
    /// Folds of the training samples; none: the test samples are scored on.
    pub folds: Option<u32>,
    /// Where results are kept.
    pub folder: &'a Path,
}

/// Every combination of the values that fields are given.
fn combinations<'a>(fields: &[(&'a str, &'a str)]) -> Vec<Vec<(&'a str, &'a str)>> {
    let mut keys: Vec<&str> = Vec::new();
    for (key, _) in fields {
        if !keys.contains(key) {
            keys.push(key);
        }
    }
    let mut all = vec![Vec::new()];
    for key in keys {
        let values: Vec<_> = fields.iter().filter(|field| field.0 == key).collect();
        let with = |combination: &Vec<_>| {
            values.iter().map(|&&value| combination.iter().copied().chain([value]).collect()).collect::<Vec<Vec<_>>>()
        };
        all = all.iter().flat_map(with).collect();
    }
    all
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
    /// Trains what the folder does not have yet; `read` gives the samples, `train` trains on some
    /// of them to the end, `after` sees each training when it is in the folder.
    ///
    /// # Errors
    /// `train.*` for a file that cannot be used, `write.*` for a folder; those of `read` and
    /// `train`.
    pub fn run(
        &self,
        read: impl Fn(&Job) -> Result<Data>,
        mut train: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
        mut after: impl FnMut(&Finished),
    ) -> Result<Vec<Finished>> {
        let mut all = Vec::new();
        let mut samples: Option<Data> = None;
        for (number, setting) in combinations(self.fields).iter().enumerate() {
            let mut job = Job::new(with_fields(self.source, setting)?, None, self.epochs)?;
            let data = match &mut samples {
                Some(data) => data,
                none => none.insert(read(&job)?),
            };
            let folds = self.folds.map_or_else(Vec::new, |k| Job::folds(&data.train, k));
            let name = setting.iter().map(|(key, value)| format!("{key}={value}")).collect::<Vec<_>>().join(" ");
            for seed in self.seeds.clone() {
                job.plan.seed = seed as u64;
                let parts = if folds.is_empty() { vec![None] } else { folds.iter().map(Some).collect::<Vec<_>>() };
                for (part, fold) in parts.into_iter().enumerate() {
                    let part = fold.map(|fold| (part as u32, fold.as_slice()));
                    let finished = self.finished(&job, (&name, number), part, data, &mut train)?;
                    after(&finished);
                    all.push(finished);
                }
            }
        }
        Ok(all)
    }

    /// One training, from the folder when it is there.
    fn finished(
        &self,
        job: &Job,
        (setting, number): (&str, usize),
        fold: Option<(u32, &[usize])>,
        data: &Data,
        mut train: impl FnMut(&Plan, &[Example]) -> Result<TrainingState>,
    ) -> Result<Finished> {
        let (plan, name) = (&job.plan, &job.file.name);
        let print = checkpoint::fingerprint(plan, &data.train);
        let kind = fold.map_or("test".to_string(), |(part, _)| format!("fold{part}"));
        let path = self.folder.join(format!("{name}-{}-{}-{kind}.json", &print[..12], plan.seed));
        let model = path.with_extension("ron");
        let tested = fold.map(|(_, fold)| fold.to_vec());
        if let Some(run) = kept(&path, &print)? {
            return Ok(Finished { run: StudyRun { number, ..run }, model, tested });
        }
        let begin = Instant::now();
        let (accuracy, weights) = match fold {
            Some((_, fold)) => cross_validate(plan, &data.train, fold, train)?,
            None => {
                let state = train(plan, &data.train)?;
                let weights = plan.result(&state).clone();
                (plan.score(&weights, &data.test).accuracy, weights)
            }
        };
        let said = format!("{setting} seed {}, {kind}, of a study: accuracy {accuracy:.4}", plan.seed);
        job.write((&model, true), &weights, "", &said)?;
        let seconds = begin.elapsed().as_micros() as f64 / 1e6;
        let fold = fold.map(|(part, _)| part);
        let run = StudyRun { setting: setting.to_string(), number, seed: plan.seed, fold, accuracy, seconds };
        let mut value = serde_json::json!(run);
        value["fingerprint"] = print.into();
        value["name"] = name.clone().into();
        value["tested"] = tested.clone().into();
        io::write::text(&path, true, &format!("{:#}\n", checksum::with(value)))?;
        Ok(Finished { run, model, tested })
    }
}
