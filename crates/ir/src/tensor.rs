//! An array of numbers from a file: shape, and integers or reals in C order.

use serde::{Deserialize, Serialize};

/// A reference to an array outside the model file, relative to it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum ArrayRef {
    /// A NumPy file.
    Npy(String),
    /// A tensor of a safetensors file: file, key.
    Safetensors(String, String),
}

/// Numbers of one type.
#[derive(Debug, Clone, PartialEq)]
pub enum Numbers {
    /// From an integer array.
    Integers(Vec<i32>),
    /// From a floating-point array, or a list in a model file.
    Reals(Vec<f64>),
}

/// An array in C order.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    shape: Vec<usize>,
    numbers: Numbers,
}

impl Tensor {
    /// An array; `None` where the number of elements does not match the shape.
    pub fn new(shape: Vec<usize>, numbers: Numbers) -> Option<Self> {
        let length = match &numbers {
            Numbers::Integers(x) => x.len(),
            Numbers::Reals(x) => x.len(),
        };
        let product = shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis))?;
        (product == length).then_some(Tensor { shape, numbers })
    }

    /// Lengths of the axes.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether there is no element.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The numbers.
    pub fn numbers(&self) -> &Numbers {
        &self.numbers
    }

    /// One number as a real, exact for every integer of a tensor.
    ///
    /// # Panics
    /// When `index` is not below `len`.
    pub fn real(&self, index: usize) -> f64 {
        match &self.numbers {
            Numbers::Integers(x) => f64::from(x[index]),
            Numbers::Reals(x) => x[index],
        }
    }

    /// Its numbers as reals.
    pub fn reals(&self) -> impl Iterator<Item = f64> {
        (0..self.len()).map(|index| self.real(index))
    }
}
