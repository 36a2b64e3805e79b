//! Neurons in real numbers: what a trained model means before anything is an integer.
//!
//! Comes in: a [`Graph`](crate::ir::graph::Graph) with real parameters and the input spikes of each step. Goes out,
//! through [`Engine`](crate::ir::spikes::Engine), the spikes of each step, and beside them the real potentials. Each
//! neuron is held to a direct convolution to 1e-12 by its own tests. The same numbers come out on any machine: every
//! operation is one of IEEE 754, and exponentials are those of the `libm` crate, not of the system.
//!
//! What it leaves out on purpose: cores, weights' bits, anything that rounds or overflows.

pub mod cuba;
pub mod engine;
pub mod kernel;
pub mod srm;
pub mod synapses;

pub use engine::{Model, Options, Reference};
pub use kernel::Kernel;

use std::fmt::Debug;
use std::ops::{Add, AddAssign, Mul, Neg, Sub};

/// `f64`, or `f32` where speed counts for more than digits.
pub trait Real:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Neg<Output = Self>
    + 'static
{
    /// The nearest number of this type.
    fn of(x: f64) -> Self;
    /// The same number.
    fn f64(self) -> f64;
}

impl Real for f64 {
    fn of(x: f64) -> Self {
        x
    }
    fn f64(self) -> f64 {
        self
    }
}

impl Real for f32 {
    fn of(x: f64) -> Self {
        x as f32
    }
    fn f64(self) -> f64 {
        self.into()
    }
}
