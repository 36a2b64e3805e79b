//! Neurons in real numbers: the meaning of a trained model before quantisation.
//!
//! Input: a [`Graph`](nsim_ir::graph::Graph) with real parameters and the input spikes of each
//! step. Output, through [`Engine`](nsim_ir::spikes::Engine): the spikes of each step, and the real
//! potentials. Tests compare each neuron with a direct convolution, within 1e-12. Results are equal
//! on every machine: all operations are of IEEE 754, and exponentials come from the `libm` crate,
//! not from the system. Cores, widths of weights, rounding and overflow do not exist here.

pub mod cuba;
pub mod engine;
pub mod kernel;
mod real;
pub mod srm;
pub mod synapses;

pub use engine::{Model, Options, Reference};
pub use kernel::Kernel;
pub use real::Real;
