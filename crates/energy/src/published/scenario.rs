//! The mirror of scenario files (`mapping/scenarios`): a published job, with the numbers of cores
//! that it ran on.

use serde::Deserialize;

use nsim_cost::job::DeployedCores;
use nsim_ir::spanned::Spanned;

/// A scenario file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Scenario")]
pub struct ScenarioFile {
    /// The scenario's name.
    pub name: String,
    /// The model that ran.
    pub model: String,
    /// The target that it ran on.
    pub target: String,
    /// Copies of the model on the target.
    pub copies: Spanned<u32>,
    /// Numbers of cores.
    pub deployment: Spanned<DeployedCores>,
    /// Whether each input channel had a compartment of its own that carries its spikes on.
    #[serde(default)]
    pub input_relays: bool,
    /// Compartments of a core at most, where the job put fewer on one than fit.
    #[serde(default)]
    pub compartments_per_core: Option<u32>,
    /// Shipped tables of measurements of this job.
    #[serde(default)]
    pub measured: Vec<Spanned<String>>,
    /// The publication, as a sentence names it.
    pub work: String,
    /// Where the numbers are printed.
    pub source: String,
    /// What is inferred.
    pub notes: String,
}
