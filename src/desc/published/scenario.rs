//! The mirror of scenario files (`mapping/scenarios`): a published job, with the numbers of cores that it ran on.

use serde::{Deserialize, Serialize};

use crate::base::names::named_variants;
use crate::desc::spanned::Spanned;

/// What "energy per timestep" and "energy-delay product" mean.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// Power times time (13).
    #[default]
    Physical,
    /// The VT-SNN paper's arithmetic: the energy of a millisecond divided by the timesteps of a sample (14), (15).
    Published,
}

named_variants!(Convention { Physical = "physical", Published = "published" });

/// What feeds input spikes to a chip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Host {
    /// An x86 core of each chip injects the spikes that a computer sends it.
    #[default]
    Stream,
    /// An x86 core of each chip repeats spikes from its own memory: no time a spike is known.
    Memory,
    /// Nothing: the neuron cores alone.
    None,
}

named_variants!(Host { Stream = "stream", Memory = "memory", None = "none" });

/// How many input streams a chip is fed.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Streams {
    /// One, which all copies on the chip share.
    #[default]
    One,
    /// One for each copy.
    Copies,
}

named_variants!(Streams { One = "one", Copies = "copies" });

/// Numbers of cores of a deployment, all copies together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct DeployedCores {
    /// Neuron cores in use.
    pub cores_used: u64,
    /// Chips with a core in use.
    pub chips_used: u64,
    /// x86 cores in use.
    pub x86_cores: u64,
}

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
