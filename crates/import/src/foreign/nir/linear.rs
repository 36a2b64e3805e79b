//! Linear maps between populations in their most compact form: a factor per unit, a matrix, a
//! window, or a list of synapses.
//!
//! Input: the arrays of nodes. Output: products and scaled maps; `None` where a product has too
//! many synapses.

use super::filter::Filter;
use super::state::product;
use crate::foreign::window::{MOST_LISTED, Sliding, Synapses, each3};

/// The linear map from one population to another over the nodes between them.
#[derive(Clone)]
pub(super) struct Connection {
    /// The shape that arrives.
    pub(super) shape: Vec<usize>,
    pub(super) linear: Linear,
    /// Number that is added to each unit's arrivals in each step.
    pub(super) bias: Option<Vec<f64>>,
    /// The integrator on the way, whose potential is sent.
    pub(super) filter: Option<Filter>,
    /// Delay in steps of each unit of the source, before the linear part; empty without delays.
    pub(super) source_delay: Vec<u32>,
    /// Delay in steps of each unit that arrives, after the linear part; empty without delays.
    pub(super) delay: Vec<u32>,
}

/// The linear part of a connection.
#[derive(Clone)]
pub(super) enum Linear {
    /// A factor for each unit, or one for all.
    Diagonal(Vec<f64>),
    /// Weights `[target][source]`, and the number of sources.
    Dense(Vec<f64>, usize),
    /// A window from one volume to another.
    Window(Window),
    List(Synapses),
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

    /// Its list of synapses; `None` for too many.
    pub(super) fn list(&self) -> Option<Synapses> {
        Some(self.sliding.synapses()?.map(|(from, to, index)| (from, to, self.weight(index))).collect())
    }

    /// This window and a next one as a single window: a pool without overlap or remainder before a
    /// convolution, or a convolution before a pool without padding.
    pub(super) fn then(&self, next: &Window) -> Option<Window> {
        let Err(weight) = self.kernel else { return self.pooled(next) };
        let (pool, after) = (&self.sliding, &next.sliding);
        let exact = pool.size == pool.stride && pool.padding == (0, 0) && pool.dilation == (1, 1);
        let whole = pool.source[1] == pool.target[1] * pool.size.0 && pool.source[2] == pool.target[2] * pool.size.1;
        if !exact || !whole || pool.target != after.source {
            return None;
        }
        let (ph, pw) = pool.size;
        let size = ((after.size.0 - 1) * after.dilation.0 * ph + ph, (after.size.1 - 1) * after.dilation.1 * pw + pw);
        let kernels = after.target[0].checked_mul(after.per_group())?;
        let count = product(&[kernels, size.0, size.1]).filter(|&count| count <= MOST_LISTED)?;
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

    /// This convolution and a pool after it as one convolution: an output sums the kernel at all
    /// places of the pool, which are `stride` apart.
    fn pooled(&self, pool: &Window) -> Option<Window> {
        let (kernel, weight) = (self.kernel.as_ref().ok()?, *pool.kernel.as_ref().err()?);
        let (conv, behind) = (&self.sliding, &pool.sliding);
        if behind.padding != (0, 0) || behind.dilation != (1, 1) || behind.source != conv.target {
            return None;
        }
        // (places, dilation, distance of the kernel's places, distance of the pool's) of an axis.
        fn axis(size: usize, dilation: usize, stride: usize, pool: usize) -> (usize, usize, usize, usize) {
            let step = if pool > 1 { gcd(dilation, stride) } else { dilation };
            ((size - 1) * (dilation / step) + (pool - 1) * (stride / step) + 1, step, dilation / step, stride / step)
        }
        let (height, dy, ky, py) = axis(conv.size.0, conv.dilation.0, conv.stride.0, behind.size.0);
        let (width, dx, kx, px) = axis(conv.size.1, conv.dilation.1, conv.stride.1, behind.size.1);
        let kernels = conv.target[0] * conv.per_group();
        let count = product(&[kernels, height, width]).filter(|&count| count <= MOST_LISTED)?;
        let mut sums = vec![0.0; count];
        for ((at, y, x), own) in each3([kernels, conv.size.0, conv.size.1]).zip(kernel) {
            for (_, j, i) in each3([1, behind.size.0, behind.size.1]) {
                sums[(at * height + y * ky + j * py) * width + x * kx + i * px] += own * weight;
            }
        }
        let sliding = Sliding {
            target: behind.target,
            size: (height, width),
            stride: (conv.stride.0 * behind.stride.0, conv.stride.1 * behind.stride.1),
            dilation: (dy, dx),
            ..*conv
        };
        Some(Window { sliding, kernel: Ok(sums) })
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

/// The delay at an index: a single entry applies to all units, an empty list is 0.
pub(super) fn delay_at(delays: &[u32], index: usize) -> u32 {
    delays.get(if delays.len() == 1 { 0 } else { index }).copied().unwrap_or(0)
}

pub(super) fn all_equal(delays: &[u32]) -> bool {
    delays.windows(2).all(|pair| pair[0] == pair[1])
}

/// The sum of two lists of delays.
pub(super) fn sum_of_delays(a: &[u32], b: &[u32]) -> Vec<u32> {
    (0..a.len().max(b.len())).map(|index| delay_at(a, index) + delay_at(b, index)).collect()
}

/// Expands numbers per channel to one per unit; one for all and one per unit are unchanged.
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

/// The number at an index; a single entry applies to all units.
pub(super) fn at(numbers: &[f64], index: usize) -> f64 {
    if numbers.len() == 1 { numbers[0] } else { numbers[index] }
}

/// A linear part with each target scaled; `None` for too many synapses.
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
                // No kernel represents scales that differ within a channel.
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    fn side(n: usize, reach: usize, stride: usize) -> usize {
        (n - reach) / stride + 1
    }

    /// Compares a convolution joined with a pool with the product of their synapses.
    #[test]
    fn a_convolution_and_its_pool_are_one_convolution() {
        let mut joined = 0;
        for (k, dilation, stride, padding) in [(3, 1, 1, 0), (2, 2, 1, 1), (3, 2, 2, 1), (2, 3, 2, 2), (1, 2, 3, 0)] {
            for (p, step, groups) in [(2, 2, 1), (3, 2, 2), (1, 2, 1), (2, 1, 2), (2, 3, 1)] {
                let reach = (dilation * (k - 1) + 1, dilation * k + 1);
                let (h, w) = (side(11 + 2 * padding, reach.0, stride), side(12 + 2 * padding, reach.1, stride));
                let conv = Sliding {
                    source: [2, 11, 12],
                    target: [4, h, w],
                    size: (k, k + 1),
                    stride: (stride, stride),
                    padding: (padding, padding),
                    dilation: (dilation, dilation),
                    groups,
                };
                let kernel = (0..4 * (2 / groups) * k * (k + 1)).map(|i| (i * 7 % 23) as f64 - 11.0).collect();
                let first = Window { sliding: conv, kernel: Ok(kernel) };
                let pool = Sliding {
                    source: conv.target,
                    target: [4, side(h, p, step), side(w, p, step)],
                    size: (p, p),
                    stride: (step, step),
                    padding: (0, 0),
                    dilation: (1, 1),
                    groups: 4,
                };
                let pool = Window { sliding: pool, kernel: Err(0.25) };
                let mut right: BTreeMap<(u64, u64), f64> = BTreeMap::new();
                let second = pool.list().unwrap();
                for (from, via, weight) in first.list().unwrap() {
                    for (_, to, next) in second.iter().filter(|synapse| synapse.0 == via) {
                        *right.entry((from, *to)).or_default() += weight * next;
                    }
                }
                let whole = first.then(&pool).unwrap();
                let mut made: BTreeMap<(u64, u64), f64> = BTreeMap::new();
                whole.list().unwrap().into_iter().for_each(|(from, to, weight)| {
                    assert!(made.insert((from, to), weight).is_none());
                });
                right.retain(|_, weight| *weight != 0.0);
                made.retain(|_, weight| *weight != 0.0);
                assert_eq!(made, right, "{k} {dilation} {stride} {padding}, pool {p} {step}");
                joined += made.len();
                // The zeros of a padded pool are not outputs of the convolution.
                let padded = Sliding { padding: (1, 1), ..pool.sliding };
                assert!(first.then(&Window { sliding: padded, ..pool }).is_none());
            }
        }
        assert!(joined > 10_000, "{joined}");
    }
}
