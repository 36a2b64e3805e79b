//! Numbers of a model: in its file, or elsewhere.

use serde::ser::Serializer;
use serde::{Deserialize, Serialize};

use nsim_ir::tensor::{ArrayRef, Numbers, Tensor};

/// Numbers that are not in the model file.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename(deserialize = "source of numbers"))]
pub enum Source {
    /// A NumPy file.
    Npy(String),
    /// A tensor of a safetensors file: file, key.
    Safetensors(String, String),
    /// Seeded uniform numbers in `low..=high`, for untrained networks and benches: `low`,
    /// `low + step`, .. with a `step`, any real number without.
    Uniform {
        /// The least value.
        low: f64,
        /// The greatest value.
        high: f64,
        /// Distance of neighbouring numbers.
        step: Option<f64>,
        /// The seed.
        seed: u64,
    },
}

impl Source {
    /// The reference to its array in a file; `None` for seeded numbers.
    pub fn array(&self) -> Option<ArrayRef> {
        match self {
            Source::Npy(file) => Some(ArrayRef::Npy(file.clone())),
            Source::Safetensors(file, key) => Some(ArrayRef::Safetensors(file.clone(), key.clone())),
            Source::Uniform { .. } => None,
        }
    }
}

/// Weights of a projection.
#[derive(Debug, Clone, PartialEq)]
pub enum Weights {
    /// Numbers in the model.
    InPlace(Tensor),
    /// Numbers elsewhere.
    From(Source),
}

impl Weights {
    /// The numbers of a model whose arrays are in place, as `Network::resolved` makes them.
    ///
    /// # Panics
    /// When they are elsewhere, an error of the caller.
    pub fn tensor(&self) -> &Tensor {
        match self {
            Weights::InPlace(tensor) => tensor,
            Weights::From(source) => panic!("{source:?} is not loaded"),
        }
    }
}

/// Weights in place: integers when all numbers are 32-bit integers.
///
/// # Panics
/// When the numbers do not fill the shape, an error of the caller.
pub fn tensor(shape: Vec<usize>, numbers: Vec<f64>) -> Weights {
    let whole = numbers.iter().all(|&x| f64::from(x as i32).to_bits() == x.to_bits());
    let numbers = match whole {
        true => Numbers::Integers(numbers.iter().map(|&x| x as i32).collect()),
        false => Numbers::Reals(numbers),
    };
    Weights::InPlace(Tensor::new(shape, numbers).expect("the numbers fill the shape"))
}

/// A number, written without a point when whole; its bits are preserved when read back.
pub(super) struct Number(pub f64);

impl Serialize for Number {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let Number(x) = *self;
        match x.fract() == 0.0 && x.abs() < 9e15 && x.to_bits() != (-0.0f64).to_bits() {
            true => serializer.serialize_i64(x as i64),
            false => serializer.serialize_f64(x),
        }
    }
}

/// Whether a value is its type's default, which files omit.
pub(super) fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}
