//! Windows that slide over a volume, synapse by synapse.
//!
//! Input: the geometry of a convolution or a pool, as checked numbers. Output: pairs of source and
//! target with their place in the kernel, in the order of the targets. An output `o` receives the
//! input `o * stride + k * dilation - padding` over the kernel's place `k` (torch, `Conv2d`; what
//! lies outside of the volume is silent).
//!
//! Left out on purpose: transposed convolutions, which only one format knows.

use nsim_files::network::padding_after;

/// The most synapses that are listed one by one, for a whole model.
pub const MOST_LISTED: usize = 1 << 20;

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
    /// Groups of channels that are connected among themselves only; divides the channels of both
    /// volumes.
    pub groups: usize,
}

impl Sliding {
    /// Source channels of an output.
    #[must_use]
    pub fn per_group(&self) -> usize {
        self.source[0] / self.groups
    }

    /// Silent rows and columns behind the last.
    #[must_use]
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

    /// Every synapse as (source unit, target unit, index into a kernel
    /// `[out][in / groups][kh][kw]`); nothing where there may be more than [`MOST_LISTED`].
    #[must_use]
    pub fn synapses(&self) -> Option<impl Iterator<Item = (u64, u64, usize)>> {
        let (window, per_in) = (*self, self.per_group());
        let per_out = (self.target[0] / self.groups).max(1);
        let places = [per_in, self.size.0, self.size.1];
        let many = self.target.iter().chain(&places).try_fold(1usize, |product, &axis| product.checked_mul(axis))?;
        let place = |o: usize, stride: usize, k: usize, dilation: usize, padding: usize, side: usize| {
            (o * stride + k * dilation).checked_sub(padding).filter(|&i| i < side)
        };
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

/// The places of a block, the last axis fastest.
pub fn each3([a, b, c]: [usize; 3]) -> impl Iterator<Item = (usize, usize, usize)> {
    (0..a).flat_map(move |a| (0..b).flat_map(move |b| (0..c).map(move |c| (a, b, c))))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A window of 2 x 2 over 2 channels of 3 x 3 with a border of 1, in 2 groups, against sums
    /// written out.
    #[test]
    fn each_output_receives_its_window() {
        let sliding = Sliding {
            source: [2, 3, 3],
            target: [2, 2, 2],
            size: (2, 2),
            stride: (2, 2),
            padding: (1, 1),
            dilation: (1, 1),
            groups: 2,
        };
        let of = |target: u64| -> Vec<(u64, usize)> {
            let all = sliding.synapses().unwrap();
            all.filter(|synapse| synapse.1 == target).map(|(from, _, kernel)| (from, kernel)).collect()
        };
        assert_eq!(of(0), [(0, 3)]);
        assert_eq!(of(3), [(4, 0), (5, 1), (7, 2), (8, 3)]);
        assert_eq!(of(4), [(9, 7)]);
        assert_eq!(sliding.synapses().unwrap().count(), 2 * 9);
    }

    /// What is too large to list is not begun.
    #[test]
    fn too_many_are_not_listed() {
        let window = Sliding {
            source: [1, 1 << 20, 1 << 20],
            target: [1, 1 << 20, 1 << 20],
            size: (1, 1),
            stride: (1, 1),
            padding: (0, 0),
            dilation: (1, 1),
            groups: 1,
        };
        assert!(window.synapses().is_none());
    }
}
