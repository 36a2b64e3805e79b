//! What every reader of a foreign format shares: its options, its result and limits of a core.

use std::path::PathBuf;

use crate::base::fixed::{Delay, ThresholdMantissa};
use crate::desc::network::ThresholdTest;
use crate::io::model_builder::ModelBuilder;

/// The greatest threshold mantissa: what a compartment gets that should not spike.
pub(super) const NEVER: f64 = ThresholdMantissa::MAX.get() as f64;
/// The greatest delay field.
pub(super) const LONGEST_DELAY: f64 = Delay::MAX.get() as f64;

/// What a file does not say, and its user may.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Milliseconds that a timestep stands for.
    pub dt_ms: Option<f64>,
    /// A file with the neuron's parameters (SLAYER's YAML).
    pub neuron: Option<PathBuf>,
    /// What a neuron does to its voltage when it spikes (NIR).
    pub reset: Option<ResetMode>,
    /// When a compartment spikes, if not strictly above its threshold.
    pub threshold: Option<ThresholdTest>,
    /// An image to drive the input layer's bias.
    pub image: Option<PathBuf>,
    /// The step at which layer 0 starts, layer k starting k steps later.
    pub first_step: Option<u32>,
    /// Timesteps between two resets of every layer.
    pub reset_interval: Option<u32>,
    /// The first reset, counted from a layer's start.
    pub reset_offset: u32,
    /// Channels, height, width of the input of a network that begins with a convolution.
    pub input_shape: Option<Vec<u64>>,
}

/// What a neuron does to its voltage when it spikes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetMode {
    /// It returns to zero, as on the chip.
    Zero,
    /// The threshold is subtracted.
    Subtract,
}

/// A model that was read from a foreign file.
#[derive(Debug, Clone)]
pub struct Imported {
    /// What the file is, in words.
    pub kind: &'static str,
    /// The model.
    pub model: ModelBuilder,
    /// By which conventions it was read, and what was changed.
    pub notes: Vec<String>,
}

/// Names for messages.
pub(super) fn listed(names: &[&str]) -> String {
    if names.is_empty() { "no members".to_string() } else { names.join(", ") }
}

/// A name that a population may have.
pub(super) fn population_name(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || c == '_' || c == '-' { c } else { '_' }).collect()
}
