//! A layer of a file: its arrays, shape and window.
//!
//! Input: the group of a layer. Output: finite numbers, pairs, shapes, the geometry of a window;
//! errors that name the layer.

use super::reader::wrong;
use crate::foreign::imported::wrong_option;
use crate::foreign::window::Step;
use crate::hdf5::{Group, Numbers};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

pub(super) struct Layer<'a> {
    pub(super) number: u32,
    pub(super) kind: String,
    pub(super) group: &'a Group,
}

impl Layer<'_> {
    pub(super) fn wrong(&self, message: impl std::fmt::Display) -> Diagnostic {
        wrong(format!("layer {} ({}): {message}", self.number, self.kind))
    }

    pub(super) fn unsupported(&self, message: impl std::fmt::Display, help: &str) -> Diagnostic {
        Diagnostic::new("import.unsupported", format!("layer {} ({}): {message}", self.number, self.kind)).help(help)
    }

    pub(super) fn is_complex(&self) -> bool {
        self.group.group("weight").is_some()
    }

    pub(super) fn numbers(&self, key: &str) -> Result<&Numbers> {
        self.group.numbers(key).ok_or_else(|| self.wrong(format!("it has no array '{key}'")))
    }

    /// The array `key`, whose numbers have to be finite.
    pub(super) fn reals(&self, key: &str) -> Result<Vec<f64>> {
        let reals: Vec<f64> = self.numbers(key)?.reals().collect();
        match reals.iter().find(|x| !x.is_finite()) {
            Some(x) => Err(self.wrong(format!("'{key}' has a number that is {x}"))),
            None => Ok(reals),
        }
    }

    /// One number, or its default.
    pub(super) fn scalar(&self, key: &str, default: f64) -> Result<f64> {
        match self.group.get(key) {
            None => Ok(default),
            Some(_) => self.group.number(key).ok_or_else(|| self.wrong(format!("'{key}' is not one number"))),
        }
    }

    /// A pair (y, x): two numbers, or one for both, from `least` to 65,535.
    pub(super) fn pair(&self, key: &str, default: (u64, u64), least: u64) -> Result<(u64, u64)> {
        if self.group.get(key).is_none() {
            return Ok(default);
        }
        let numbers = self.reals(key)?;
        let is_whole = numbers.iter().all(|x| x.fract() == 0.0 && (least as f64..=65_535.0).contains(x));
        match numbers.as_slice() {
            [both] if is_whole => Ok((*both as u64, *both as u64)),
            [y, x] if is_whole => Ok((*y as u64, *x as u64)),
            _ => Err(self.wrong(format!("'{key}' is {numbers:?}, not two whole numbers from {least}"))),
        }
    }

    /// The shape of the layer's units: `[n]` or `[channels, height, width]`.
    pub(super) fn shape(&self) -> Result<Vec<u64>> {
        let mut shape = Vec::new();
        for x in self.reals("shape")? {
            if !(x.fract() == 0.0 && (1.0..=134_217_728.0).contains(&x)) {
                return Err(self.wrong(format!("a shape with {x}")));
            }
            shape.push(x as u64);
        }
        match shape.len() {
            1 | 3 => Ok(shape),
            // Channels and width; the height is 1.
            2 => Ok(vec![shape[0], 1, shape[1]]),
            axes => Err(self.wrong(format!("its shape {shape:?} has {axes} axes"))),
        }
    }

    /// The name of its recurrent weights: lava-dl and spytorch2loihi write two.
    pub(super) fn recurrent_key(&self) -> Result<&'static str> {
        match ["weight_rec", "recWeight"].map(|key| self.group.get(key).is_some()) {
            [true, true] => Err(self
                .wrong("'weight_rec' and 'recWeight' are both recurrent weights")
                .help("remove the one that the network does not use")),
            [false, true] => Ok("recWeight"),
            _ => Ok("weight_rec"),
        }
    }

    /// The axes of an array, without trailing axes of length 1 beyond the first `axes`.
    pub(super) fn axes(&self, key: &str, axes: usize) -> Result<Vec<u64>> {
        let mut shape: Vec<u64> = self.numbers(key)?.shape().iter().map(|&axis| axis as u64).collect();
        while shape.len() > axes && shape.last() == Some(&1) {
            shape.pop();
        }
        Ok(shape)
    }
}

/// The layer's shape as channels, height, width.
pub(super) fn volume(layer: &Layer<'_>) -> Result<Vec<u64>> {
    let shape = layer.shape()?;
    if shape.len() == 3 { Ok(shape) } else { Err(layer.wrong(format!("a shape {shape:?} without height and width"))) }
}

/// The geometry of a layer's window; `stride` is the default.
pub(super) fn geometry(layer: &Layer<'_>, stride: (u64, u64)) -> Result<Step> {
    Ok([layer.pair("stride", stride, 1)?, layer.pair("padding", (0, 0), 0)?, layer.pair("dilation", (1, 1), 1)?])
}

/// The input shape of a first layer with a window: given, or implied by a stride of 1.
pub(super) fn input_of_window(
    layer: &Layer<'_>,
    given: Option<Vec<u64>>,
    channels: u64,
    shape: &[u64],
    kernel: (u64, u64),
    [stride, padding, dilation]: Step,
) -> Result<Vec<u64>> {
    if let Some(given) = given {
        return Ok(given);
    }
    fn side(out: u64, kernel: u64, padding: u64, dilation: u64) -> Option<u64> {
        (out + dilation * (kernel - 1)).checked_sub(2 * padding).filter(|&side| side > 0)
    }
    let height = side(shape[1], kernel.0.max(1), padding.0, dilation.0);
    let width = side(shape[2], kernel.1.max(1), padding.1, dilation.1);
    match (stride, height, width) {
        ((1, 1), Some(height), Some(width)) => Ok(vec![channels, height, width]),
        _ => Err(wrong_option(format!(
            "layer {} ({}) is the first, and the size of its input is missing from the file",
            layer.number, layer.kind
        ))
        .help("give it with --input-shape CHANNELS,HEIGHT,WIDTH")),
    }
}
