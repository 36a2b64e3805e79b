//! Options of learning: random numbers, samples that start anew, and the model that was learned.

use std::path::{Path, PathBuf};

use crate::cli::args::input::InputArgs;
use crate::cli::context::refuse_if;
use crate::cli::process::ranks;
use nsim_files as io;
use nsim_files::network::{Network, NetworkFile};
use nsim_import::draws::{read_draws, write_draws};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::id::{Id, RuleId};
use nsim_ir::base::names::did_you_mean;
use nsim_ir::learning::draws::{Draws, Recorded};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_session::error::{Error, Result};
use nsim_session::learning::{self, LearnedRule};
use nsim_session::outcome::LearningSettings;

/// Options of networks whose rules learn.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Learning")]
pub struct LearningArgs {
    /// Random numbers of the rule of a projection, in place of seeded ones: an archive with the
    /// arrays draw_x_decay, draw_x_impulse, draw_y_decay, draw_y_impulse, draw_round and draw_post
    /// (Lava), or draw_trace and draw_weight (Nengo)
    #[arg(long, value_name = "NAME=FILE.npz", value_parser = named_file)]
    pub draws: Vec<(String, PathBuf)>,
    /// Folder for the random numbers of a run of one sample, NAME.npz for each rule (Lava, Nengo)
    #[arg(long, value_name = "DIR", conflicts_with = "draws")]
    pub record_draws: Option<PathBuf>,
    /// Start each sample from the weights of the model, not from those that were learned
    #[arg(long)]
    pub fresh: bool,
    /// Write the model with the weights, delays and tags after the last sample
    #[arg(long, value_name = "OUT.ron")]
    pub learned: Option<PathBuf>,
    /// Without rules in --learned
    #[arg(long, requires = "learned")]
    pub freeze: bool,
}

/// Parses `NAME=FILE`.
fn named_file(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, file)) if !name.is_empty() && !file.is_empty() => Ok((name.to_string(), file.into())),
        _ => Err("write NAME=FILE.npz, with the name of a projection that learns".to_string()),
    }
}

/// The rule of the projection of this name.
pub fn rule_named(network: &Quantised, option: &str, name: &str) -> Result<RuleId> {
    let rules = &network.parts().rules;
    let names: Vec<&str> = rules.iter().map(|learning| learning.name.as_str()).collect();
    names.iter().position(|known| *known == name).map(RuleId::new).ok_or_else(|| {
        let known = if names.is_empty() { "none".to_string() } else { names.join(", ") };
        let meant = did_you_mean(name, names.iter().copied());
        Error::Usage(format!(
            "{option} {name}: no projection of this name learns: {meant}projections that learn: {known}"
        ))
    })
}

impl LearningArgs {
    /// Checks the options for a network, and the files that they name.
    ///
    /// # Errors
    /// [`Error::Usage`] for options without effect; errors of files; `run.draws`.
    pub fn settings(&self, network: &Quantised, samples: &[&Sample], input: &InputArgs) -> Result<LearningSettings> {
        let rules = &network.parts().rules;
        let named = [
            (!self.draws.is_empty(), "--draws"),
            (self.record_draws.is_some(), "--record-draws"),
            (self.fresh, "--fresh"),
            (self.learned.is_some(), "--learned"),
        ];
        if let Some((_, option)) = named.iter().find(|(given, _)| *given).filter(|_| rules.is_empty()) {
            let message =
                format!("{option}: no projection of the model has a rule; give one learning: Rule(dw: \"..\")");
            return Err(Error::Usage(message));
        }
        if self.learned.is_some() {
            ranks::refuse_several("--learned")?;
        }
        let replays = !self.draws.is_empty() || self.record_draws.is_some();
        let message =
            format!("random numbers are those of one sample, but {} run: choose one with --samples", samples.len());
        refuse_if(replays && samples.len() != 1, message)?;
        let mut recorded: Vec<Option<Recorded>> = vec![None; rules.len()];
        for (name, path) in &self.draws {
            let rule = rule_named(network, "--draws", name)?;
            refuse_if(recorded[rule.index()].is_some(), format!("--draws {name} is given twice"))?;
            let numbers = read_draws(path)?;
            let steps = samples.first().map_or(0, |sample| sample.steps());
            learning::check_recorded(&rules[rule], learning::units(network, rule), &numbers, steps)
                .map_err(|error| error.in_file(path))?;
            recorded[rule.index()] = Some(numbers);
        }
        let draws = Draws { recorded: std::sync::Arc::new(recorded.into()), ..Draws::seeded(input.seed.unwrap_or(0)) };
        Ok(LearningSettings {
            draws,
            fresh: self.fresh,
            rules: rules.len(),
            ..LearningSettings::of_samples(
                samples.len(),
                input.repeat,
                input.samples.as_ref().map_or(0, |range| range.start),
            )
        })
    }

    /// Checks that the files may be written.
    ///
    /// # Errors
    /// `write.*`.
    pub fn check_files(&self, network: &Quantised, force: bool) -> Result<(), Diagnostic> {
        if let Some(path) = &self.learned {
            NetworkFile::check_name(path)?;
            io::write::check_free(path, force)?;
        }
        let rules = network.parts().rules.iter();
        let of = |folder: &Path| rules.map(|learning| draws_file(folder, &learning.name)).collect::<Vec<_>>();
        io::write::check_all_free(self.record_draws.as_deref().map(of).unwrap_or_default(), force)
    }

    /// Writes the random numbers of a run of one sample; returns the files.
    ///
    /// # Errors
    /// `run.draws` for a rule that draws for each synapse; `write.*`.
    pub fn record(
        &self,
        network: &Quantised,
        draws: &Draws,
        steps: u32,
        batch: &mut io::write::Batch,
    ) -> Result<Vec<String>, Diagnostic> {
        let Some(folder) = &self.record_draws else { return Ok(Vec::new()) };
        let mut files = Vec::new();
        for (rule, learning) in network.parts().rules.enumerate() {
            let path = draws_file(folder, &learning.name);
            let units = learning::units(network, rule);
            write_draws(&path, &learning::recorded(draws, rule, learning, units, steps)?, units, batch)?;
            files.push(path.display().to_string());
        }
        Ok(files)
    }

    /// Writes the model with the state of its rules; returns the files.
    ///
    /// # Errors
    /// `model.learned`; `write.*`.
    pub fn write_learned(
        &self,
        file: &Network,
        network: &Quantised,
        rules: &[LearnedRule],
        force: bool,
    ) -> Result<Vec<String>, Diagnostic> {
        let Some(path) = &self.learned else { return Ok(Vec::new()) };
        let states = learning::states(network, rules);
        let (model, arrays) = file.learned(&states, self.freeze, &NetworkFile::arrays_name(path))?;
        let comment = format!("{} after nsim run, with what it learned", network.parts().name);
        model.write_with(arrays, &comment, path, force)
    }
}

/// The file of the random numbers of a projection.
fn draws_file(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("{name}.npz"))
}
