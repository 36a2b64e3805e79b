//! `nsim convert --fine-tune`: its samples, its progress bar, and the file after a signal.
//!
//! Input: a converted network and its training file. Output: the integers of the best epoch. A
//! signal writes the integers of the best epoch so far to the file of `-o`. Errors: a training file
//! of another network, samples without labels.

use std::path::Path;
use std::sync::{Arc, Mutex};

use crate::cli::context::Context;
use crate::cli::process::progress;
use crate::cli::process::signals;
use nsim_files::shipped;
use nsim_ir::graph::Graph;
use nsim_ir::spikes::Sample;
use nsim_session::error::Error;
use nsim_train::convert::fine_tune::{BestEpoch, Task, TunedIntegers, trainable};
use nsim_train::convert::job::{ConversionRun, FineTuning, Job};
use nsim_train::convert::model_file;

/// Options of fine-tuning.
#[derive(Debug, Clone, clap::Args)]
pub struct FineTuneArgs {
    /// Then train for this many epochs with the integers in the forward pass, on training samples
    /// alone
    #[arg(long, value_name = "EPOCHS", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    fine_tune: Option<u32>,
    /// The training file: loss, optimiser, seed, samples; a file or the name of a shipped model
    /// [default: the model's name]
    #[arg(long, value_name = "TRAINING.ron", requires = "fine_tune")]
    training: Option<String>,
    /// Training samples, as --input takes them [default: what the training file names]
    #[arg(long, value_name = "SOURCE", requires = "fine_tune")]
    train: Vec<String>,
}

impl FineTuneArgs {
    /// Checks before the conversion that the network can be fine-tuned, if `--fine-tune` is given.
    pub fn check(&self, job: &Job) -> Result<(), Error> {
        if self.fine_tune.is_some() {
            trainable(&job.graph)?;
        }
        Ok(())
    }

    /// Fine-tunes, if `--fine-tune` is given; `output` is the file to write and its provenance.
    pub fn tune(
        &self,
        job: &Job,
        done: &ConversionRun,
        held_out: &[&Sample],
        output: Option<(&Path, &str)>,
        context: Context,
    ) -> Result<Option<TunedIntegers>, Error> {
        let Some(epochs) = self.fine_tune else { return Ok(None) };
        let named = self.training.as_deref().unwrap_or(&job.graph.facts().name);
        let (source, _) = shipped::path_or_shipped_text(named, shipped::TRAININGS, "training file", "convert.training")
            .map_err(|error| error.help("--training names the training file of the model"))?;
        let converted = &done.converted;
        let tuning = FineTuning::new(job, converted, &source, &self.train, held_out, epochs)?;
        let best: Arc<Mutex<Option<BestEpoch>>> = Arc::default();
        let _ending = output.map(|(path, provenance)| {
            let (task, best, graph) = (Arc::clone(&tuning.task), Arc::clone(&best), job.graph.clone());
            let (path, provenance, force) = (path.to_path_buf(), provenance.to_string(), context.force);
            signals::at_end(move || save_at_signal(&task, &best, &graph, &path, &provenance, force))
        });
        let bar = progress::bar(context, tuning.work(), "fine-tuning");
        let tuned = tuning.run(converted, held_out, &|| bar.add(1), |epoch| {
            if let Ok(mut best) = best.lock() {
                *best = Some(epoch.clone());
            }
        })?;
        drop(bar);
        Ok(Some(tuned))
    }
}

/// Writes the integers of the best epoch so far; returns a message.
fn save_at_signal(
    task: &Task,
    best: &Mutex<Option<BestEpoch>>,
    graph: &Graph,
    path: &Path,
    provenance: &str,
    force: bool,
) -> Option<String> {
    let best = best.lock().ok()?.take()?;
    let provenance = format!("{provenance}; fine-tuning was interrupted, epoch {} is kept", best.epoch);
    let written = task
        .integers(&best.weights)
        .and_then(|integers| model_file::model(graph, integers.deployed(), provenance))
        .and_then(|model| model.write(path, force));
    Some(match written {
        Ok(files) => format!("epoch {}, the best so far, is stored in {}", best.epoch, files.join(", ")),
        Err(error) => format!("epoch {}, the best so far, could not be stored: {error}", best.epoch),
    })
}
