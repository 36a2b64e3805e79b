//! What a forward pass leaves for the backward pass.

use super::raster::Raster;

/// What a neuron did in a step, as far as credit depends on it.
pub(super) const FREE: u8 = 0;
pub(super) const SPIKED: u8 = 1;
pub(super) const HELD: u8 = 2;

/// What a forward pass records of a layer, for the backward pass.
#[derive(Debug, Clone, Default)]
pub struct Trace {
    /// Potentials before the reset by a spike, `[step][neuron]`; of neurons that never spike, the
    /// register v after the step. Of neurons of Loihi 2 the first word of state.
    pub potential: Vec<f32>,
    /// Imaginary parts of resonators.
    pub(super) imaginary: Vec<f32>,
    /// `FREE`, `SPIKED` or `HELD`, `[step][neuron]`.
    pub(super) state: Vec<u8>,
    /// Spikes.
    pub spikes: Raster,
}
