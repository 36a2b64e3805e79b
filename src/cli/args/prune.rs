//! `--prune none|static|INPUT` -> what to leave out of a network before it is mapped.

use nsim_ir::base::id::PopulationId;
use nsim_ir::quantised::Quantised;
use nsim_quantise::prune::Plan;
use nsim_session::error::Error;
use nsim_session::inputs;

/// What may be left out.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct PruneArgs {
    /// Remove what cannot change an output: none; static, for every input; or for an INPUT as in
    /// --input, which also removes channels that never spike in it
    #[arg(help_heading = "Mapping", long, value_name = "none|static|INPUT")]
    pub prune: Vec<String>,
}

impl PruneArgs {
    /// Whether anything is to be pruned.
    #[must_use]
    pub fn asked(&self) -> bool {
        !matches!(self.prune.as_slice(), []) && self.prune != ["none"]
    }

    /// The plan for a network, if anything is to be pruned, with these populations whole.
    ///
    /// # Errors
    /// [`Error`] when a stimulus cannot be read, or `none` or `static` do not stand alone.
    pub fn plan(&self, network: &Quantised, probed: &[PopulationId]) -> Result<Option<Plan>, Error> {
        let plan = match self.prune.as_slice() {
            _ if !self.asked() => return Ok(None),
            [only] if only == "static" => Plan::fixed(),
            several if several.iter().any(|word| word == "none" || word == "static") => {
                return Err(Error::Usage("--prune none and --prune static stand alone".to_string()));
            }
            given => Plan::for_stimulus(network, &inputs::stimulus(network, given, None, None)?),
        };
        Ok(Some(plan.probing(probed.iter().copied())))
    }

    /// Refuses to prune what a saved mapping has pruned or not.
    ///
    /// # Errors
    /// [`Error::Usage`] when both are given.
    pub fn not_with_mapping(&self, mapping: bool) -> Result<(), Error> {
        if mapping && !self.prune.is_empty() {
            return Err(Error::Usage("--prune: a saved mapping says itself what was pruned".to_string()));
        }
        Ok(())
    }
}
