//! The two widths of real numbers that neurons are computed in.

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
    + Into<f64>
    + 'static
{
    /// The nearest number of this type.
    fn from_f64(x: f64) -> Self;
}

impl Real for f64 {
    fn from_f64(x: f64) -> Self {
        x
    }
}

impl Real for f32 {
    fn from_f64(x: f64) -> Self {
        x as f32
    }
}
