//! Enumeration of the synapses of a source.
//!
//! Input: a connectivity and the index of a source within its population. Output: its synapses as
//! (target within its population, weight mantissa). The golden interpreter has its own enumeration,
//! and tests compare the two.

use nsim_ir::base::rng;
use nsim_ir::graph::Window;
use nsim_ir::quantised::connectivity::Connectivity;

/// The synapses of a source.
pub trait Enumerate {
    /// Calls `f(target, weight)` for every synapse of a source, in ascending order of targets
    /// except for `Random`. Indices are within the populations.
    #[inline]
    fn for_each_from(&self, source: u32, f: impl FnMut(u32, i16)) {
        self.for_each_wanted(source, |_| true, f);
    }

    /// Calls `f(target)` for every synapse of a source, in the order of
    /// [`Enumerate::for_each_from`].
    #[inline]
    fn for_each_target(&self, source: u32, mut f: impl FnMut(u32)) {
        let see = |target| {
            f(target);
            false
        };
        self.for_each_wanted(source, see, |_, _| {});
    }

    /// Calls `f(target, weight)` for every synapse of a source whose target is wanted, in the order
    /// of [`Enumerate::for_each_from`].
    fn for_each_wanted(&self, source: u32, wanted: impl FnMut(u32) -> bool, f: impl FnMut(u32, i16));

    /// Number of synapses of a source.
    fn count_from(&self, source: u32) -> u64;
}

impl Enumerate for Connectivity {
    #[inline]
    fn for_each_wanted(&self, source: u32, mut wanted: impl FnMut(u32) -> bool, mut f: impl FnMut(u32, i16)) {
        let mut see = |target: u32, weight: i16| {
            if wanted(target) {
                f(target, weight);
            }
        };
        match self {
            Connectivity::Dense { targets, weights } => {
                let row = source as usize * *targets as usize;
                for (target, &weight) in weights[row..row + *targets as usize].iter().enumerate() {
                    see(target as u32, weight);
                }
            }
            Connectivity::Sparse { first, targets, weights } => {
                let range = first[source as usize] as usize..first[source as usize + 1] as usize;
                for (&target, &weight) in targets[range.clone()].iter().zip(&weights[range]) {
                    see(target, weight);
                }
            }
            Connectivity::Conv2d { window, kernel } => {
                for_each_of_kernel(window, source, |target, place| see(target, kernel[place]));
            }
            Connectivity::SumPool2d { window, weight } => {
                for_each_of_pool(window, source, |target| see(target, *weight));
            }
            Connectivity::Random { targets, fan_out, low, high, step, seed, first_source } => {
                let entity = u64::from(*first_source) + u64::from(source);
                // A weight is one of low, low + step, .. up to high.
                let levels = ((i32::from(*high) - i32::from(*low)) / i32::from(*step) + 1) as u64;
                for k in 0..u64::from(*fan_out) {
                    let target = rng::below(u64::from(*targets), *seed, entity, 2 * k) as u32;
                    // Skipping the weights of unwanted targets saves half of their work.
                    if wanted(target) {
                        f(target, low + step * rng::below(levels, *seed, entity, 2 * k + 1) as i16);
                    }
                }
            }
        }
    }

    fn count_from(&self, source: u32) -> u64 {
        match self {
            Connectivity::Dense { targets, .. } => u64::from(*targets),
            Connectivity::Sparse { first, .. } => first[source as usize + 1] - first[source as usize],
            Connectivity::Random { fan_out, .. } => u64::from(*fan_out),
            Connectivity::Conv2d { .. } | Connectivity::SumPool2d { .. } => {
                let mut count = 0;
                self.for_each_from(source, |_, _| count += 1);
                count
            }
        }
    }
}

/// Calls `f(target, place in the kernel)` for every synapse of a source over a convolution.
#[inline]
pub fn for_each_of_kernel(window: &Window, source: u32, mut f: impl FnMut(u32, usize)) {
    let (kh, kw) = window.kernel;
    let per_group_in = window.source.0 / window.groups;
    let per_group_out = window.target.0 / window.groups;
    let channel = source / (window.source.1 * window.source.2);
    let group = channel / per_group_in;
    // All channels share these positions.
    let mut positions = Vec::new();
    for_each_position(window, source, |y, x, ky, kx| positions.push((y * window.target.2 + x, ky * kw + kx)));
    for out in group * per_group_out..(group + 1) * per_group_out {
        let base = (out * per_group_in + channel % per_group_in) * kh * kw;
        let plane = out * window.target.1 * window.target.2;
        positions.iter().for_each(|(position, place)| f(plane + position, (base + place) as usize));
    }
}

/// Calls `f(target)` for every synapse of a source over a pool, which keeps its channel.
#[inline]
pub fn for_each_of_pool(window: &Window, source: u32, mut f: impl FnMut(u32)) {
    let channel = source / (window.source.1 * window.source.2);
    for_each_position(window, source, |y, x, _, _| f((channel * window.target.1 + y) * window.target.2 + x));
}

/// Calls `f(y, x, ky, kx)` for every output position whose window covers this source, and its place
/// in the window.
pub fn for_each_position(window: &Window, source: u32, mut f: impl FnMut(u32, u32, u32, u32)) {
    let within = source % (window.source.1 * window.source.2);
    let (sy, sx) = (within / window.source.2, within % window.source.2);
    let reach = |s: u32, axis: fn((u32, u32)) -> u32, size: u32| {
        let (stride, padding, dilation) = (axis(window.stride), axis(window.padding), axis(window.dilation));
        // Output o covers s at k when o * stride - padding + k * dilation = s.
        let kernel = axis(window.kernel);
        (0..kernel).rev().filter_map(move |k| {
            let at = (s + padding).checked_sub(k * dilation)?;
            (at % stride == 0 && at / stride < size).then_some((at / stride, k))
        })
    };
    for (y, ky) in reach(sy, |p| p.0, window.target.1) {
        for (x, kx) in reach(sx, |p| p.1, window.target.2) {
            f(y, x, ky, kx);
        }
    }
}
