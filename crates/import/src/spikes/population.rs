//! The spikes of one sample on one population.

use nsim_files::budget::MOST_EVENTS;
use nsim_ir::base::diagnostic::Diagnostic;

/// The spikes of one sample on the channels of one population.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct PopulationSpikes {
    /// Number of channels of the source, if it states it.
    pub units: Option<u64>,
    /// Number of timesteps.
    pub steps: u32,
    /// The class of the sample, when known.
    pub label: Option<u32>,
    /// (step, channel) of each spike, in the order of the source.
    pub events: Vec<(u32, u32)>,
    /// The value of each spike's message; empty for a source without values.
    pub values: Vec<i32>,
    /// The file, for messages.
    pub name: String,
    /// The changes of a recording whose events were dropped or moved.
    pub changes: Option<String>,
}

impl PopulationSpikes {
    /// `samples` samples of `units` channels without a spike.
    pub fn silent(samples: usize, units: u64, steps: u32, name: String) -> Vec<Self> {
        vec![PopulationSpikes { units: Some(units), steps, name, ..Self::default() }; samples]
    }
}

/// Requirements of the model's input population on a recording.
#[derive(Debug, Clone, Copy)]
pub struct InputSpec {
    /// Channels.
    pub units: u64,
    /// Channels, height and width, when it has a shape.
    pub volume: Option<(u32, u32, u32)>,
    /// Length of a timestep in ms.
    pub dt_ms: f64,
    /// Whether the numbers of an array are the values of messages.
    pub values: bool,
}

/// The diagnostic for a sample with more than [`MOST_EVENTS`] spikes.
pub(super) fn too_many() -> Diagnostic {
    Diagnostic::new("input.too-many", format!("a sample has more than {MOST_EVENTS} spikes"))
}
