//! Labels of samples, in a file next to their spikes.
//!
//! Input: an array with one axis, a class from 0 on for each sample. Output: samples with labels.
//!
//! Errors: `input.labels` for another shape, a number that is not a class, a number of labels other
//! than the number of samples, and a label that contradicts the source.

use std::path::Path;

use super::population::PopulationSpikes;
use nsim_files::npy;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The labels of a `.npy` file.
///
/// # Errors
/// `input.labels`, `npy.*`, `io.*`.
pub fn read(path: &Path) -> Result<Vec<u32>> {
    from_array(&npy::open(path)?)
}

/// The labels of an array.
///
/// # Errors
/// `input.labels`, `npy.value`.
pub(super) fn from_array(array: &npy::Array) -> Result<Vec<u32>> {
    let wrong = |message: String| Diagnostic::new("input.labels", message).in_file(array.path());
    let length: usize = array.shape().iter().product();
    if !array.shape().contains(&length) {
        let message = format!("labels of shape {:?} are not one number for each sample", array.shape());
        return Err(wrong(message).help(match array.shape() {
            [_, 1] => "make an array of one axis: labels[:, 0]",
            _ => "make an array of one axis; for one-hot rows: labels.argmax(axis=1)",
        }));
    }
    let tensor = array.tensor()?;
    fn class(number: f64) -> Option<u32> {
        (number >= 0.0 && number.fract() == 0.0 && number < 4e9).then_some(number as u32)
    }
    let labels = tensor.reals().enumerate().map(|(sample, number)| {
        class(number)
            .ok_or_else(|| wrong(format!("the label of sample {sample} is {number}, expected a class number from 0")))
    });
    labels.collect()
}

/// Sets the labels of samples.
///
/// # Errors
/// `input.labels`.
pub fn apply(path: &Path, labels: &[u32], samples: &mut [PopulationSpikes]) -> Result<()> {
    let wrong = |message: String| Diagnostic::new("input.labels", message).in_file(path);
    if labels.len() != samples.len() {
        return Err(wrong(format!("there are {} labels and {} samples", labels.len(), samples.len()))
            .help("give a class for each sample of the input, in their order; --samples A..B selects a part of both"));
    }
    for (index, (sample, &label)) in samples.iter_mut().zip(labels).enumerate() {
        if let Some(own) = sample.label.filter(|own| *own != label) {
            return Err(wrong(format!("the label of sample {index} is {label}, but its source has label {own}")));
        }
        sample.label = Some(label);
    }
    Ok(())
}
