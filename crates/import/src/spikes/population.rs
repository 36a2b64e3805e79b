//! The spikes of one sample on one population.

use nsim_files::budget::MOST_EVENTS;
use nsim_ir::base::diagnostic::Diagnostic;

/// The spikes of one sample on the channels of one population.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PopulationSpikes {
    /// Number of channels of the source, if it says so.
    pub units: Option<u64>,
    /// Timesteps.
    pub steps: u32,
    /// The class that the sample shows, when known.
    pub label: Option<u32>,
    /// (step, channel) of each spike, in the order of the source.
    pub events: Vec<(u32, u32)>,
    /// What each carries; empty where the source says nothing but that they spike.
    pub values: Vec<i32>,
    /// The file, for messages.
    pub name: String,
}

impl PopulationSpikes {
    /// This many samples of `units` channels without a spike.
    pub fn silent(samples: usize, units: u64, steps: u32, name: String) -> Vec<Self> {
        vec![PopulationSpikes { units: Some(units), steps, name, ..Self::default() }; samples]
    }
}

/// What the model's input population expects of a recording.
#[derive(Debug, Clone, Copy)]
pub struct Expected {
    /// Channels.
    pub units: u64,
    /// Channels, height and width, when it has a shape.
    pub volume: Option<(u32, u32, u32)>,
    /// Milliseconds of a timestep.
    pub dt_ms: f64,
    /// Whether the numbers of an array are what messages carry.
    pub values: bool,
}

/// The problem of a sample with more than [`MOST_EVENTS`] spikes.
pub(super) fn too_many() -> Diagnostic {
    Diagnostic::new("input.too-many", format!("a sample has more than {MOST_EVENTS} spikes"))
}
