//! Record of a forward pass, for the backward pass.

use super::raster::Raster;

/// State of a neuron in a step: without spike, with a spike, or held after one.
pub(super) const FREE: u8 = 0;
pub(super) const SPIKED: u8 = 1;
pub(super) const HELD: u8 = 2;

/// Record of a layer's forward pass, for the backward pass.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Potentials before the reset by a spike, `[step][neuron]`. Neurons that never spike have the
    /// register v after the step, neurons of Loihi 2 the first word of state.
    pub potential: Vec<f32>,
    /// Imaginary parts of resonators.
    pub(super) imaginary: Vec<f32>,
    /// `FREE`, `SPIKED` or `HELD`, `[step][neuron]`.
    pub(super) state: Vec<u8>,
    /// Spikes.
    pub spikes: Raster,
}
