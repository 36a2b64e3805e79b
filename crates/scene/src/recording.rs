//! Recording of a scene: one sample of touch and vision.

use super::camera::{POOLED, Polarities};
use super::markers::MarkerOnsets;
use super::touch::TAXELS;
use super::wire::WireCounts;

/// The most samples of a scene.
pub const MOST_SAMPLES: u32 = 100_000;

/// Recorded senses of a sample. The events of one sense do not depend on whether the other is
/// recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Senses {
    /// Two fingers.
    pub touch: bool,
    /// A camera; it takes nine tenths of the time.
    pub vision: bool,
}

impl Senses {
    /// Touch and vision.
    pub const BOTH: Senses = Senses { touch: true, vision: true };
}

/// Spikes of two fingers and a camera in one sample; a sense that was not recorded is empty.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Timesteps.
    pub steps: u32,
    /// The class.
    pub label: u32,
    /// Time of sliding or of contact, ms; none when it does not happen.
    pub onset_ms: Option<f64>,
    /// Times of lift and turn by the paper's marker rule, if markers are tracked.
    pub marker_onsets: Option<MarkerOnsets>,
    /// (step, channel) of touch; channel = (39 finger + taxel) 2 + polarity, polarity 1 for a rise.
    pub touch: Vec<(u32, u32)>,
    /// (step, channel) of vision; channel = row 50 + column of 63 rows and 50 columns.
    pub vision: Vec<(u32, u32)>,
    /// By polarity: channel = 3,150 polarity + row 50 + column, polarity 1 for a rise.
    pub vision_planes: Vec<(u32, u32)>,
    /// Counts of touch events on the taxels' common wire, if there is one.
    pub wire: Option<WireCounts>,
}

/// Name of the touch population, and its number of channels.
pub const TOUCH: (&str, u32) = ("tactile", 4 * TAXELS as u32);
/// Name of the vision population, and its number of channels.
pub const VISION: (&str, u32) = ("vision", POOLED as u32);
/// The vision population with a plane of channels for each polarity.
pub const VISION_PLANES: (&str, u32) = ("vision", 2 * POOLED as u32);

/// Spikes of a camera, with both polarities merged and in planes.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct CameraSpikes {
    /// (step, unit), ascending within a step.
    pub units: Vec<(u32, u32)>,
    /// (step, channel of its plane).
    pub planes: Vec<(u32, u32)>,
}

impl CameraSpikes {
    /// Adds a unit's spike in a step.
    pub fn add(&mut self, step: u32, unit: u32, polarities: Polarities) {
        self.units.push((step, unit));
        self.planes.extend(polarities.planes().map(|plane| (step, plane * VISION.1 + unit)));
    }
}
