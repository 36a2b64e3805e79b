//! Sliding windows over a volume as lists of synapses.
//!
//! Input: the checked geometry of a convolution or a pool. Output: pairs of source and target with
//! their place in the kernel, in the order of the targets. An output `o` receives the input `o *
//! stride + k * dilation - padding` over the kernel's place `k` (torch, `Conv2d`); places outside
//! the volume are silent. A transposed convolution is the window with source and target exchanged.
//! The module also lists the synapses of any projection, and splits them by delay.

use std::collections::BTreeMap;

use nsim_files::network::{ProjectionDesc, ProjectionKind, padding_after};

/// The most synapses in lists of a whole model.
pub const MOST_LISTED: usize = 1 << 20;

/// Stride, padding before and dilation of a window, each as (vertical, horizontal).
pub type Step = [(u64, u64); 3];

/// A window from one volume to another; pairs are (vertical, horizontal), volumes
/// `[channels, height, width]`.
#[derive(Debug, Clone, Copy)]
pub struct Sliding {
    /// The volume that it slides over.
    pub source: [usize; 3],
    /// The target volume.
    pub target: [usize; 3],
    /// Height and width.
    pub size: (usize, usize),
    /// Step from one output to the next.
    pub stride: (usize, usize),
    /// Silent rows and columns before the first.
    pub padding: (usize, usize),
    /// Distance of the window's places.
    pub dilation: (usize, usize),
    /// Number of groups of channels without connections between them; divides the channels of both
    /// volumes.
    pub groups: usize,
}

/// A list of (source unit, target unit, weight).
pub type Synapses = Vec<(u64, u64, f64)>;

impl Sliding {
    /// A window between two volumes; `None` for a shape without exactly three axes.
    pub fn new(
        (source, target): (&[u64], &[u64]),
        size: (u64, u64),
        [stride, padding, dilation]: Step,
        groups: u64,
    ) -> Option<Self> {
        let volume = |shape: &[u64]| Some(<[u64; 3]>::try_from(shape).ok()?.map(|axis| axis as usize));
        let pair = |(y, x): (u64, u64)| (y as usize, x as usize);
        Some(Sliding {
            source: volume(source)?,
            target: volume(target)?,
            size: pair(size),
            stride: pair(stride),
            padding: pair(padding),
            dilation: pair(dilation),
            groups: groups as usize,
        })
    }

    /// Number of source channels of an output.
    pub fn per_group(&self) -> usize {
        self.source[0] / self.groups
    }

    /// Silent rows and columns after the last.
    pub fn padding_after(&self) -> (u64, u64) {
        let after = |source: usize, target: usize, size: usize, stride: usize, before: usize, dilation: usize| {
            let reach = dilation * (size - 1) + 1;
            padding_after(source as u64, target as u64, reach as u64, stride as u64, before as u64)
        };
        let Sliding { source, target, size, stride, padding, dilation, .. } = *self;
        (
            after(source[1], target[1], size.0, stride.0, padding.0, dilation.0),
            after(source[2], target[2], size.1, stride.1, padding.1, dilation.1),
        )
    }

    /// Every synapse as (source unit, target unit, index into a kernel `[out][in /
    /// groups][kh][kw]`); `None` where there may be more than [`MOST_LISTED`].
    pub fn synapses(self) -> Option<impl Iterator<Item = (u64, u64, usize)>> {
        let (window, per_in) = (self, self.per_group());
        let per_out = (self.target[0] / self.groups).max(1);
        let places = [per_in, self.size.0, self.size.1];
        let many = self.target.iter().chain(&places).try_fold(1usize, |product, &axis| product.checked_mul(axis))?;
        fn place(o: usize, stride: usize, k: usize, dilation: usize, padding: usize, side: usize) -> Option<usize> {
            (o * stride + k * dilation).checked_sub(padding).filter(|&i| i < side)
        }
        (many <= MOST_LISTED).then(|| {
            each3(window.target).flat_map(move |(o, y, x)| {
                each3(places).filter_map(move |(within, ky, kx)| {
                    let Sliding { source, target, size, stride, padding, dilation, .. } = window;
                    let sy = place(y, stride.0, ky, dilation.0, padding.0, source[1])?;
                    let sx = place(x, stride.1, kx, dilation.1, padding.1, source[2])?;
                    let from = ((o / per_out * per_in + within) * source[1] + sy) * source[2] + sx;
                    let to = (o * target[1] + y) * target[2] + x;
                    Some((from as u64, to as u64, ((o * per_in + within) * size.0 + ky) * size.1 + kx))
                })
            })
        })
    }
}

/// The synapses of a projection between two shapes; `None` where they may be more than
/// [`MOST_LISTED`], or are not in place.
pub fn synapse_list(kind: ProjectionKind, source: &[u64], target: &[u64]) -> Option<Synapses> {
    match kind {
        ProjectionKind::Sparse(synapses) => Some(synapses),
        ProjectionKind::Dense(weights) => {
            let (weights, sources) = (weights.tensor(), source.iter().product::<u64>());
            let all = weights.reals().zip(0..).map(|(weight, at)| (at % sources, at / sources, weight));
            (weights.len() <= MOST_LISTED).then(|| all.collect())
        }
        ProjectionKind::Conv2d { weights, stride, padding, dilation, groups, .. } => {
            let weights = weights.tensor();
            let &[_, _, height, width] = weights.shape() else { return None };
            let size = (height as u64, width as u64);
            let window = Sliding::new((source, target), size, [stride, padding, dilation], groups)?;
            Some(window.synapses()?.map(|(from, to, at)| (from, to, weights.real(at))).collect())
        }
        ProjectionKind::SumPool2d { kernel, stride, padding, weight, .. } => {
            let window = Sliding::new((source, target), kernel, [stride, padding, (1, 1)], *source.first()?)?;
            Some(window.synapses()?.map(|(from, to, _)| (from, to, weight)).collect())
        }
        ProjectionKind::Arrays(_) | ProjectionKind::Random { .. } => None,
    }
}

/// Splits synapses into a copy of `like` for each delay, in steps, that `delay_of` gives for a
/// source and a target.
pub fn by_delay(
    like: &ProjectionDesc,
    synapses: Synapses,
    delay_of: impl Fn(u64, u64) -> u32,
) -> impl Iterator<Item = ProjectionDesc> {
    let mut by_delay: BTreeMap<u32, Synapses> = BTreeMap::new();
    for synapse in synapses {
        by_delay.entry(delay_of(synapse.0, synapse.1)).or_default().push(synapse);
    }
    by_delay.into_iter().map(move |(delay, synapses)| ProjectionDesc {
        delay,
        kind: ProjectionKind::Sparse(synapses),
        ..like.clone()
    })
}

/// The indices of a block; the last axis varies fastest.
pub fn each3([a, b, c]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..a).flat_map(move |a| (0..b).flat_map(move |b| (0..c).map(move |c| (a, b, c))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Compares a window of 2 x 2 over 2 channels of 3 x 3, with padding 1 and 2 groups, with
    /// explicit lists.
    #[test]
    fn each_output_receives_its_window() {
        let step = [(2, 2), (1, 1), (1, 1)];
        let sliding = Sliding::new((&[2, 3, 3], &[2, 2, 2]), (2, 2), step, 2).unwrap();
        let of = |target: u64| -> Vec<(u64, usize)> {
            let all = sliding.synapses().unwrap();
            all.filter(|synapse| synapse.1 == target).map(|(from, _, kernel)| (from, kernel)).collect()
        };
        assert_eq!(of(0), [(0, 3)]);
        assert_eq!(of(3), [(4, 0), (5, 1), (7, 2), (8, 3)]);
        assert_eq!(of(4), [(9, 7)]);
        assert_eq!(sliding.synapses().unwrap().count(), 2 * 9);
    }

    /// A list that would be too large is not begun.
    #[test]
    fn too_many_are_not_listed() {
        let (shape, step) = ([1, 1 << 20, 1 << 20], [(1, 1), (0, 0), (1, 1)]);
        let window = Sliding::new((&shape, &shape), (1, 1), step, 1).unwrap();
        assert!(window.synapses().is_none());
    }
}
