//! Linear maps from one population to another, as far as they can stay what they are: one factor a
//! unit, a matrix, a window, a list of synapses.
//!
//! Input: the arrays of nodes. Output: products and scaled copies; nothing where a product has too
//! many synapses.

use super::context::product;
use crate::foreign::window::{MOST_LISTED, Sliding, each3};

/// The linear map from one population to another over the nodes between them.
#[derive(Clone)]
pub(super) struct Connection {
    /// The shape that arrives.
    pub(super) shape: Vec<usize>,
    pub(super) linear: Linear,
    /// Added to what arrives in each step, one for each unit.
    pub(super) bias: Option<Vec<f64>>,
    /// Delay in steps of each unit of the source, before the linear part; empty for none.
    pub(super) source_delay: Vec<u32>,
    /// Delay in steps of each unit that arrives, behind the linear part; empty for none.
    pub(super) delay: Vec<u32>,
}

/// The linear part of a connection.
#[derive(Clone)]
pub(super) enum Linear {
    /// Each unit, scaled by itself or by one number.
    Diagonal(Vec<f64>),
    /// `[target][source]`.
    Dense(Vec<f64>, usize),
    /// A window from one volume to another.
    Window(Window),
    /// (source, target, weight).
    List(Vec<(u64, u64, f64)>),
}

/// A convolution, or a sum over windows when it has no kernel.
#[derive(Clone)]
pub(super) struct Window {
    pub(super) sliding: Sliding,
    /// `[out][in / groups][kh][kw]`, or one weight for a pool.
    pub(super) kernel: Result<Vec<f64>, f64>,
}

impl Window {
    /// The weight at an index into `[out][in / groups][kh][kw]`.
    fn weight(&self, index: usize) -> f64 {
        self.kernel.as_ref().map_or_else(|&weight| weight, |kernel| kernel[index])
    }

    /// Synapses one by one.
    pub(super) fn list(&self) -> Option<Vec<(u64, u64, f64)>> {
        Some(self.sliding.synapses()?.map(|(from, to, index)| (from, to, self.weight(index))).collect())
    }

    /// This window and, behind it, another, as one: a pool without overlap or remainder before a
    /// convolution.
    pub(super) fn then(&self, next: &Window) -> Option<Window> {
        let weight = *self.kernel.as_ref().err()?;
        let (pool, after) = (&self.sliding, &next.sliding);
        let exact = pool.size == pool.stride && pool.padding == (0, 0) && pool.dilation == (1, 1);
        let whole = pool.source[1] == pool.target[1] * pool.size.0 && pool.source[2] == pool.target[2] * pool.size.1;
        if !exact || !whole || pool.target != after.source {
            return None;
        }
        let (ph, pw) = pool.size;
        let size = ((after.size.0 - 1) * after.dilation.0 * ph + ph, (after.size.1 - 1) * after.dilation.1 * pw + pw);
        let kernels = after.target[0].checked_mul(after.per_group())?;
        let count = [kernels, size.0, size.1].iter().try_fold(1usize, |n, &axis| n.checked_mul(axis))?;
        if count > MOST_LISTED {
            return None;
        }
        let mut kernel = vec![0.0; count];
        for (at, ky, kx) in each3([kernels, after.size.0, after.size.1]) {
            let product = next.weight((at * after.size.0 + ky) * after.size.1 + kx) * weight;
            for (j, i) in (0..ph).flat_map(|j| (0..pw).map(move |i| (j, i))) {
                let (y, x) = (ky * after.dilation.0 * ph + j, kx * after.dilation.1 * pw + i);
                kernel[(at * size.0 + y) * size.1 + x] = product;
            }
        }
        let sliding = Sliding {
            source: pool.source,
            target: after.target,
            size,
            stride: (after.stride.0 * ph, after.stride.1 * pw),
            padding: (after.padding.0 * ph, after.padding.1 * pw),
            dilation: (1, 1),
            groups: after.groups,
        };
        Some(Window { sliding, kernel: Ok(kernel) })
    }
}

/// The sum of two lists of delays, of which one number counts for all and an empty list for
/// nothing.
pub(super) fn sum_of_delays(a: &[u32], b: &[u32]) -> Vec<u32> {
    let get = |list: &[u32], index: usize| list.get(if list.len() == 1 { 0 } else { index }).copied().unwrap_or(0);
    (0..a.len().max(b.len())).map(|index| get(a, index) + get(b, index)).collect()
}

/// One number for all, for each channel or for each unit, as one for all or one for each.
pub(super) fn spread(numbers: Vec<f64>, shape: &[usize]) -> Option<Vec<f64>> {
    let units = product(shape)?;
    match numbers.len() {
        1 => Some(numbers),
        n if n == units => Some(numbers),
        n if n == shape[0] => {
            let each = units / n;
            Some((0..units).map(|unit| numbers[unit / each]).collect())
        }
        _ => None,
    }
}

/// A number of a list that may hold one for all.
pub(super) fn at(numbers: &[f64], index: usize) -> f64 {
    if numbers.len() == 1 { numbers[0] } else { numbers[index] }
}

/// A linear part with each target scaled; nothing when that has too many synapses.
pub(super) fn scaled(linear: Linear, scale: &[f64], shape: &[usize]) -> Option<Linear> {
    if scale.iter().all(|&s| s == 1.0) {
        return Some(linear);
    }
    Some(match linear {
        Linear::Diagonal(old) => {
            let length = old.len().max(scale.len());
            Linear::Diagonal((0..length).map(|i| at(&old, i) * at(scale, i)).collect())
        }
        Linear::Dense(weights, sources) => {
            Linear::Dense(weights.iter().enumerate().map(|(i, w)| w * at(scale, i / sources)).collect(), sources)
        }
        Linear::List(list) => {
            Linear::List(list.into_iter().map(|(from, to, w)| (from, to, w * at(scale, to as usize))).collect())
        }
        Linear::Window(window) => {
            let plane = shape.iter().skip(1).product::<usize>().max(1);
            let channel_wise = scale.len() == 1 || scale.chunks(plane).all(|c| c.iter().all(|s| *s == c[0]));
            if !channel_wise {
                // Scales that differ within a channel: no kernel holds them.
                return scaled(Linear::List(window.list()?), scale, shape);
            }
            let kernel = match window.kernel {
                Err(weight) if scale.len() == 1 => Err(weight * scale[0]),
                Err(weight) => {
                    let places = window.sliding.size.0 * window.sliding.size.1;
                    Ok((0..window.sliding.target[0] * places).map(|i| weight * scale[i / places * plane]).collect())
                }
                Ok(kernel) => {
                    let each = kernel.len() / window.sliding.target[0];
                    Ok(kernel.iter().enumerate().map(|(i, w)| w * at(scale, i / each * plane)).collect())
                }
            };
            Linear::Window(Window { kernel, ..window })
        }
    })
}
