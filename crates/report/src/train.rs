//! The result of `nsim train` as text, JSON and CSV, and what a model file says of its own making.

use std::path::Path;

use serde_json::{Value, json};

use nsim_files::table::{Column, csv_of, right_from};
use nsim_ir::base::stats::mean_sd;
use nsim_train::fit::EpochRow;
use nsim_train::job::{Job, Trained};
use nsim_train::study::StudyRun;

/// Everything that the report of one training says.
#[derive(Debug)]
pub struct TrainReport<'a> {
    /// The training file.
    pub job: &'a Job,
    /// What it came to.
    pub trained: &'a Trained,
    /// Where the model was written.
    pub model: Option<&'a Path>,
}

fn rounded(x: f64) -> f64 {
    (x * 1e6).round() / 1e6
}

impl TrainReport<'_> {
    /// `nsim.train/1`.
    #[must_use]
    pub fn json(&self) -> Value {
        let Trained { state, train_accuracy, test_accuracy, digest, folds, samples, seconds } = self.trained;
        json!({
            "schema": "nsim.train/1",
            "name": self.job.file.name,
            "epochs": state.epoch,
            "seed": self.job.plan.seed,
            "seconds": rounded(*seconds),
            "samples": samples.0,
            "test_samples": samples.1,
            "loss": state.history.last().map(|row| rounded(row.loss)),
            "train_accuracy": rounded(*train_accuracy),
            "test_accuracy": test_accuracy.map(rounded),
            "folds": folds.iter().copied().map(rounded).collect::<Vec<_>>(),
            "digest": digest,
            "model": self.model.map(|path| path.display().to_string()),
        })
    }

    /// One row.
    ///
    /// # Errors
    /// Never in practice: the row is built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let Trained { state, train_accuracy, test_accuracy, seconds, .. } = self.trained;
        let test = test_accuracy.map_or(String::new(), |accuracy| accuracy.to_string());
        let (name, seed, epochs) = (&self.job.file.name, self.job.plan.seed, state.epoch);
        let columns = "name,seed,epochs,seconds,train_accuracy,test_accuracy";
        Ok(format!("{columns}\n{name},{seed},{epochs},{seconds},{train_accuracy},{test}\n"))
    }

    /// One line: accuracy on what.
    #[must_use]
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
            "trained by nsim train, seed {}, {} epochs over {} samples, of which {train_accuracy:.4} are \
             right{test}{folds}",
            self.job.plan.seed, state.epoch, samples.0
        )
    }

    /// What the model file says before the network: the summary and the training file.
    #[must_use]
    pub fn provenance(&self, set: &[String]) -> String {
        let source = &self.job.source;
        let file = source.path().file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let set = set.iter().map(|set| format!(" --set '{set}'")).collect::<String>();
        let summary: String = nsim_files::table::wrapped(&self.summary());
        format!(
            "{}\n\n{summary}\nnsim train {file}{set} --seed {}, the training file being:\n\n{}",
            self.job.file.name,
            self.job.plan.seed,
            source.text()
        )
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut out = format!("{}: {}", self.job.file.name, nsim_files::table::wrapped(&self.summary()));
        out += &format!("{:.1} s\n", self.trained.seconds);
        if let Some(model) = self.model {
            out += &format!("written: {}\n", model.display());
        }
        out
    }
}

/// Loss and accuracy of each epoch, a row each.
#[must_use]
pub fn history_csv(history: &[EpochRow]) -> String {
    let rows = history.iter().map(|row| format!("{},{},{}\n", row.epoch, row.loss, row.accuracy));
    std::iter::once("epoch,loss,accuracy\n".to_string()).chain(rows).collect()
}

/// Everything that the report of a study says.
#[derive(Debug)]
pub struct StudyReport<'a> {
    /// The training file.
    pub name: &'a str,
    /// Its runs, settings together.
    pub runs: &'a [StudyRun],
}

impl StudyReport<'_> {
    fn settings(&self) -> impl Iterator<Item = (&str, Vec<&StudyRun>)> {
        self.runs.chunk_by(|a, b| a.number == b.number).map(|runs| (runs[0].setting.as_str(), runs.iter().collect()))
    }

    /// `nsim.train/1` with a row each setting.
    #[must_use]
    pub fn json(&self) -> Value {
        let setting = |(name, runs): (&str, Vec<&StudyRun>)| {
            let (mean, sd) = mean_sd(&runs.iter().map(|run| run.accuracy).collect::<Vec<_>>());
            json!({
                "setting": name, "mean": rounded(mean), "sd": rounded(sd),
                "runs": runs,
            })
        };
        json!({
            "schema": "nsim.train/1",
            "name": self.name,
            "settings": self.settings().map(setting).collect::<Vec<_>>(),
        })
    }

    /// A row a run.
    ///
    /// # Errors
    /// Never in practice: the rows are built in memory.
    pub fn csv(&self) -> Result<String, csv::Error> {
        let columns: [Column<StudyRun>; 5] = [
            ("setting", |run| run.setting.clone()),
            ("seed", |run| run.seed.to_string()),
            ("fold", |run| run.fold.map_or("test".to_string(), |fold| fold.to_string())),
            ("accuracy", |run| run.accuracy.to_string()),
            ("seconds", |run| rounded(run.seconds).to_string()),
        ];
        csv_of(self.runs, &columns)
    }

    /// For people.
    #[must_use]
    pub fn text(&self) -> String {
        let mut table = nsim_files::table::table(["setting", "runs", "mean", "sd", "least", "most", "s a run"]);
        for (name, runs) in self.settings() {
            let accuracies: Vec<f64> = runs.iter().map(|run| run.accuracy).collect();
            let (mean, sd) = mean_sd(&accuracies);
            let seconds = runs.iter().map(|run| run.seconds).sum::<f64>() / runs.len() as f64;
            let least = accuracies.iter().copied().fold(f64::MAX, f64::min);
            let most = accuracies.iter().copied().fold(f64::MIN, f64::max);
            let shown = if name.is_empty() { "as the file says" } else { name };
            table.add_row([
                shown.to_string(),
                runs.len().to_string(),
                format!("{mean:.4}"),
                format!("{sd:.4}"),
                format!("{least:.4}"),
                format!("{most:.4}"),
                format!("{seconds:.1}"),
            ]);
        }
        right_from(&mut table, 1);
        format!("{}\n\n{table}\n", self.name)
    }
}
