//! One axis of a window: its targets by source, and its sources by target.
//!
//! Input: a window (convolution or pooling). Output, for its rows or its columns alone: the targets
//! of a source, and the receptive fields of the sources that reach a part of the targets. A window
//! reaches rows and columns independently, so counting takes the length of an axis instead of the
//! area.

use std::collections::BTreeMap;
use std::ops::Range;

use nsim_ir::graph::Window;

/// One axis of a window.
#[derive(Debug, Clone, Copy)]
pub struct WindowAxis {
    kernel: u64,
    stride: u64,
    padding: u64,
    dilation: u64,
    source: u32,
    target: u32,
    uniform: bool,
}

/// Targets that a source reaches in a part of an axis, ascending, each with its place in the
/// kernel.
pub type ReceptiveField = Vec<(u16, u32)>;

impl WindowAxis {
    /// Returns the axis of rows, from north to south.
    pub fn rows(window: &Window) -> Self {
        WindowAxis::along(window, |pair| pair.0, window.source.1, window.target.1)
    }

    /// Sets whether every place of the kernel has the same weight.
    #[must_use]
    pub fn uniform(self, uniform: bool) -> Self {
        WindowAxis { uniform, ..self }
    }

    /// Returns the axis of columns, from west to east.
    pub fn columns(window: &Window) -> Self {
        WindowAxis::along(window, |pair| pair.1, window.source.2, window.target.2)
    }

    fn along(window: &Window, side: fn((u32, u32)) -> u32, source: u32, target: u32) -> Self {
        let of = |pair| u64::from(side(pair));
        let (kernel, stride) = (of(window.kernel), of(window.stride));
        let (padding, dilation) = (of(window.padding), of(window.dilation));
        WindowAxis { kernel, stride, padding, dilation, source, target, uniform: false }
    }

    /// Target positions, ascending, whose windows cover a source position.
    pub fn reached(self, source: u32) -> impl Iterator<Item = u32> {
        self.reached_by(source).map(|(at, _)| at)
    }

    /// Target positions, ascending, whose windows cover a source position, and their places in the
    /// kernel; place 0 for all where the kernel has one weight.
    fn reached_by(self, source: u32) -> impl Iterator<Item = (u32, u32)> {
        // Output o covers s at k when o stride - padding + k dilation = s.
        (0..self.kernel).rev().filter_map(move |k| {
            let at = (u64::from(source) + self.padding).checked_sub(k * self.dilation)?;
            let inside = at % self.stride == 0 && at / self.stride < u64::from(self.target);
            inside.then_some(((at / self.stride) as u32, if self.uniform { 0 } else { k as u32 }))
        })
    }

    /// Source positions that the window of a target position covers, ascending.
    pub fn covered(self, target: u32) -> impl Iterator<Item = u32> {
        let at = move |k: u64| (u64::from(target) * self.stride + k * self.dilation).checked_sub(self.padding);
        let sources = (0..self.kernel).filter_map(at);
        sources.filter(move |&source| source < u64::from(self.source)).map(|source| source as u32)
    }

    /// Source positions that may reach a part of the targets.
    fn under(self, part: &Range<u32>) -> Range<u32> {
        let first = (u64::from(part.start) * self.stride).saturating_sub(self.padding);
        let last = (u64::from(part.end) - 1) * self.stride + self.kernel.saturating_sub(1) * self.dilation;
        let end = (last + 1).saturating_sub(self.padding).min(u64::from(self.source));
        first.min(end) as u32..end as u32
    }

    /// Targets of a source within a part of the axis, relative to the start of the part.
    #[must_use]
    pub fn field(self, source: u32, part: &Range<u32>) -> ReceptiveField {
        let inside = self.reached_by(source).filter(|(at, _)| part.contains(at));
        inside.map(|(at, k)| ((at - part.start) as u16, k)).collect()
    }

    /// Sources that reach a part of the targets, ascending, and the field of each.
    fn reaching(self, part: &Range<u32>) -> impl Iterator<Item = (u32, ReceptiveField)> {
        self.under(part).map(move |source| (source, self.field(source, part))).filter(|(_, field)| !field.is_empty())
    }

    /// The first source that reaches a part of the targets, and the field of each source, by its
    /// distance from the first. Parts with equal patterns differ by a shift of all sources.
    pub fn pattern(self, part: &Range<u32>) -> (u32, Vec<(u32, ReceptiveField)>) {
        let mut pattern: Vec<(u32, ReceptiveField)> = self.reaching(part).collect();
        let first = pattern.first().map_or(0, |&(source, _)| source);
        pattern.iter_mut().for_each(|(source, _)| *source -= first);
        (first, pattern)
    }

    /// Distinct fields of a part of the targets, ascending, and the number of sources with each.
    pub fn fields(self, part: &Range<u32>) -> Vec<(ReceptiveField, u64)> {
        let mut fields: BTreeMap<ReceptiveField, u64> = BTreeMap::new();
        for (_, field) in self.reaching(part) {
            *fields.entry(field).or_default() += 1;
        }
        fields.into_iter().collect()
    }
}

/// Targets of a source relative to the first of them, each with its place in the kernel.
pub fn relative(field: &ReceptiveField) -> ReceptiveField {
    let first = field.first().map_or(0, |&(at, _)| at);
    field.iter().map(|&(at, k)| (at - first, k)).collect()
}
