//! `--dt`: the timestep of a model whose file has none.

use nsim_files::network::Network;
use nsim_import::model;
use nsim_ir::base::diagnostic::Result;

/// Timestep of a model whose file has none.
#[derive(Debug, Clone, Copy, Default, clap::Args)]
pub struct TimestepArgs {
    /// Milliseconds of a timestep, where the file of a model has none
    #[arg(long = "dt", value_name = "MS", value_parser = milliseconds)]
    pub dt_ms: Option<f64>,
}

fn milliseconds(text: &str) -> Result<f64, String> {
    let known = text.parse().ok().filter(|ms| *ms > 0.0 && *ms <= 1e6);
    known.ok_or_else(|| "a timestep is above 0 and at most 1e6 ms".to_string())
}

impl TimestepArgs {
    /// Returns the model of a path or shipped name.
    pub fn load(self, argument: &str) -> Result<Network> {
        model::load_model_with(argument, self.dt_ms)
    }
}
