//! Modes, conventions, hosts and accounting of a job.

use serde::{Deserialize, Serialize};

use nsim_ir::base::names::named_variants;

/// Whether samples are passed as fast as possible or at the pace of their timesteps.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Mode {
    /// As fast as possible.
    #[default]
    Offline,
    /// A step lasts at least as long as its time bin.
    Realtime,
}

named_variants!(Mode { Offline = "offline", Realtime = "realtime" });

impl Mode {
    /// The mode in words.
    pub const fn text(self) -> &'static str {
        match self {
            Mode::Offline => "offline",
            Mode::Realtime => "real time",
        }
    }
}

/// Definition of "energy per timestep" and "energy-delay product".
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// Power times time (13).
    #[default]
    Physical,
    /// The VT-SNN paper's: energy of a millisecond over the timesteps of a sample (14), (15).
    Published,
}

named_variants!(Convention { Physical = "physical", Published = "published" });

/// Source of the input spikes of a chip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Host {
    /// An x86 core of each chip injects the spikes that a computer sends it.
    #[default]
    Stream,
    /// An x86 core of each chip repeats spikes from its own memory; the time of a spike is unknown.
    Memory,
    /// No host: the neuron cores alone.
    None,
}

named_variants!(Host { Stream = "stream", Memory = "memory", None = "none" });

/// Number of input streams that feed a chip.
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

/// Power that a measurement attributes to the chip.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all(serialize = "lowercase"))]
pub enum Accounting {
    /// Power that NxSDK's profiler attributes to neuron cores and x86 cores.
    #[default]
    Profiler,
    /// Power of the rails of the whole board, as a power meter shows it.
    Rails,
    /// Power of the whole unit: its board or boards, and the computer that feeds them.
    Unit,
}

named_variants!(Accounting { Profiler = "profiler", Rails = "rails", Unit = "unit" });

impl Accounting {
    /// What power counts, after "power".
    pub const fn power_text(self) -> &'static str {
        match self {
            Accounting::Profiler => "of the cores and chips in use",
            Accounting::Rails => "of the board, as a meter shows it",
            Accounting::Unit => "of the whole unit, its host side included",
        }
    }
}
