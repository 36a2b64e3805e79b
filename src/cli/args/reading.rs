//! `--dt`, `--from`, `--reset`: facts that the file of a model does not state.

use std::path::Path;

use crate::cli::args::values::one_of;
use nsim_files::network::Network;
use nsim_import::foreign::{Reading, ResetMode, Tool};
use nsim_import::{foreign, model};
use nsim_ir::base::diagnostic::Result;

/// Facts on which the file of another tool is read.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct ReadingArgs {
    /// Milliseconds of a timestep, where the file of a model has none
    #[arg(long = "dt", value_name = "MS", value_parser = milliseconds)]
    pub dt_ms: Option<f64>,
    /// Conventions of the tool that wrote the model's file: its timestep, reset, threshold test,
    /// decay and the meaning of r and w_in (NIR); --dt, --reset and others override them
    #[arg(long, value_name = "TOOL", value_parser = one_of(&Tool::ALL, Tool::name))]
    pub from: Option<Tool>,
    /// Reset at a spike, which a NIR file does not state: to zero, as on the chip; or by
    /// subtracting the threshold at the spike, or a step later as in snnTorch, which only some
    /// targets can do
    #[arg(long, value_name = "HOW", value_parser = one_of(&ResetMode::ALL, ResetMode::name))]
    pub reset: Option<ResetMode>,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let known = text.parse().ok().filter(|ms| *ms > 0.0 && *ms <= 1e6);
    known.ok_or_else(|| "a timestep is above 0 and at most 1e6 ms".to_string())
}

impl ReadingArgs {
    /// The given facts.
    pub fn reading(self) -> Reading {
        Reading { dt_ms: self.dt_ms, tool: self.from, reset: self.reset }
    }

    /// Returns another model, to which these facts apply if it is another tool's file.
    pub fn load_other(self, argument: &str) -> Result<Network> {
        match foreign::is_foreign(Path::new(argument)) {
            true => self.load(argument),
            false => model::load_model(argument),
        }
    }

    /// Returns the model of a path or shipped name.
    pub fn load(self, argument: &str) -> Result<Network> {
        model::load_model_with(argument, &self.reading())
    }
}
