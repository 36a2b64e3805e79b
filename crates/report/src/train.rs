//! The result of `nsim train` as text, JSON and CSV, and the provenance of a model file.

use std::path::Path;

use serde_json::{Value, json};

use nsim_files::table::{count, csv, rounded, wrapped};
use nsim_ir::base::stats::mean_sd;
use nsim_train::fit::EpochRow;
use nsim_train::job::{Job, Trained};

/// Data of the report of one training.
#[derive(Debug)]
pub struct TrainReport<'a> {
    /// The training file.
    pub job: &'a Job,
    /// Its result.
    pub trained: &'a Trained,
    /// Path of the written model.
    pub model: Option<&'a Path>,
}

impl TrainReport<'_> {
    /// `nsim.train/1`.
    pub fn json(&self) -> Value {
        let Trained { state, train_accuracy, test_accuracy, digest, folds, samples, seconds } = self.trained;
        json!({
            "schema": "nsim.train/1", "name": self.job.file.name, "epochs": state.epoch, "seed": self.job.plan.seed,
            "seconds": rounded(*seconds), "samples": samples.0, "test_samples": samples.1,
            "loss": state.history.last().map(|row| rounded(row.loss)), "train_accuracy": rounded(*train_accuracy),
            "test_accuracy": test_accuracy.map(rounded),
            "folds": folds.iter().copied().map(rounded).collect::<Vec<_>>(), "digest": digest,
            "model": self.model.map(|path| path.display().to_string()),
        })
    }

    /// One row.
    pub fn csv(&self) -> String {
        csv([self.json()], "name,seed,epochs,seconds,train_accuracy,test_accuracy")
    }

    /// One line with the accuracies and their numbers of samples.
    pub fn summary(&self) -> String {
        let Trained { state, train_accuracy, test_accuracy, folds, samples, .. } = self.trained;
        let test = test_accuracy
            .map_or(String::new(), |accuracy| format!("; accuracy {accuracy:.4} on {} test samples", samples.1));
        let folds = match folds.as_slice() {
            [] => String::new(),
            folds => {
                let each: Vec<String> = folds.iter().map(|fold| format!("{fold:.3}")).collect();
                let (mean, sd) = mean_sd(folds);
                format!(
                    "; {} folds of the training samples: {}, mean {mean:.3}, sd {sd:.3}",
                    folds.len(),
                    each.join(" ")
                )
            }
        };
        format!(
            "trained by nsim train, seed {}, {} over {} samples, of which {train_accuracy:.4} are right{test}{folds}",
            self.job.plan.seed,
            count(state.epoch, "epoch"),
            samples.0
        )
    }

    /// Text before the network of the model file: the summary and the training file.
    pub fn provenance(&self, set: &[String]) -> String {
        let source = &self.job.source;
        let file = source.path().file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let set = set.iter().map(|set| format!(" --set '{set}'")).collect::<String>();
        let summary = wrapped(&self.summary());
        format!(
            "{}\n\n{summary}\nnsim train {file}{set} --seed {}, the training file being:\n\n{}",
            self.job.file.name,
            self.job.plan.seed,
            source.text()
        )
    }

    /// The result as text.
    pub fn text(&self) -> String {
        let mut out = format!("{}: {}", self.job.file.name, wrapped(&self.summary()));
        out += &format!("{:.1} s of training\n", self.trained.seconds);
        if let Some(model) = self.model {
            out += &format!("written: {}\n", model.display());
        }
        out
    }
}

/// Loss and accuracy of each epoch, a row each.
pub fn history_csv(history: &[EpochRow]) -> String {
    csv(history, "epoch,loss,accuracy")
}
