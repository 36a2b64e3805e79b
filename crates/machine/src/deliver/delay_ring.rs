//! The delay ring: sums of arrivals by step and lane, and the skip blocks with arrivals.

use std::ops::Range;

use crate::bits::ones;
use crate::lanes::kernel::{LANES, Sum};
use crate::layout::lists::ADDRESSED;
use crate::layout::shard::SKIP_BLOCK;
use crate::layout::weight_rows::RowPlace;
use crate::store::Aligned;

/// Arrivals of the coming steps, one slot a step.
#[derive(Debug)]
pub(crate) struct DelayRing<S> {
    /// Number of lanes of the shard, in whole skip blocks.
    pub(super) lanes: usize,
    /// Sums in units of 64, slot by slot.
    pub(super) sums: Aligned<S>,
    /// 1 for a skip block with arrivals, else 0; slot by slot. Bytes, since marks within a word
    /// would depend on each other.
    pub(super) marks: Vec<u8>,
    /// Slots in which every skip block may have arrivals.
    marked: Vec<bool>,
    /// Steps since spikes were last delivered. After as many as there are slots, nothing is marked.
    quiet: usize,
    /// Scratch memory.
    pub(super) queue: Vec<u32>,
    pub(super) rows: Vec<RowPlace>,
}

impl<S: Sum> Clone for DelayRing<S> {
    fn clone(&self) -> Self {
        self.in_type()
    }
}

/// The step in which spikes are delivered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Now {
    /// Slot of its arrivals.
    pub slot: usize,
    /// Number of steps left in the sample, itself included.
    pub left: u32,
}

/// The skip blocks of a slot with arrivals.
pub(crate) struct Arrivals<'a> {
    marks: &'a mut [u8],
    all: bool,
    none: bool,
}

impl Arrivals<'_> {
    /// Takes a word of them, one bit each, and clears it.
    #[inline(always)]
    pub fn take(&mut self, word: usize) -> u64 {
        if self.none {
            return 0;
        }
        let end = self.marks.len().min(64 * word + 64);
        let marks = &mut self.marks[64 * word..end];
        if self.all {
            return ones(marks.len());
        }
        if marks.iter().fold(0, |any, mark| any | mark) == 0 {
            return 0;
        }
        let set = marks.iter().rev().fold(0, |set, &mark| set << 1 | u64::from(mark));
        marks.fill(0);
        set
    }
}

impl<S: Sum> DelayRing<S> {
    /// Returns this ring with sums of type `T`.
    pub fn in_type<T: Sum + From<S>>(&self) -> DelayRing<T> {
        // Pages beyond the slots stay untouched.
        let mut sums = Aligned::new(self.sums.len());
        let all = self.lanes * self.slots();
        sums[..all].iter_mut().zip(&self.sums[..all]).for_each(|(to, &sum)| *to = sum.into());
        let (marks, marked) = (self.marks.clone(), self.marked.clone());
        DelayRing { lanes: self.lanes, sums, marks, marked, quiet: self.quiet, queue: Vec::new(), rows: Vec::new() }
    }

    /// An empty ring of `lanes` lanes and `slots` slots; `compact` if a list of the shard is.
    pub fn new(lanes: usize, compact: bool, slots: usize) -> Self {
        // Pages beyond the slots are untouched, so the OS never commits them. The last chunk of a
        // row may also reach beyond the lanes, where it adds zeros.
        let spare = if compact { ADDRESSED } else { LANES };
        DelayRing {
            lanes,
            sums: Aligned::new(lanes * slots + spare),
            marks: vec![0; lanes / SKIP_BLOCK * slots],
            marked: vec![false; slots],
            quiet: slots,
            queue: Vec::new(),
            rows: Vec::new(),
        }
    }

    /// Number of slots.
    #[inline(always)]
    pub fn slots(&self) -> usize {
        self.marked.len()
    }

    /// Bytes of memory that it holds.
    pub fn bytes(&self) -> usize {
        size_of::<S>() * self.lanes * self.slots()
            + self.marks.len()
            + 4 * self.queue.capacity()
            + size_of::<RowPlace>() * self.rows.capacity()
    }

    /// Empties the ring.
    pub fn clear(&mut self) {
        let end = self.lanes * self.slots();
        self.sums[..end].fill(S::default());
        self.marks.fill(0);
        self.marked.fill(false);
        self.quiet = self.slots();
    }

    /// Whether nothing is in flight.
    pub fn is_empty(&self) -> bool {
        !self.marked.contains(&true) && self.marks.iter().all(|&mark| mark == 0)
    }

    /// Marks all skip blocks as having arrivals, in every slot.
    #[inline(always)]
    pub fn mark_all(&mut self) {
        self.marked.fill(true);
    }

    /// Notes that spikes are delivered, which may mark skip blocks of any slot.
    #[inline(always)]
    pub(super) fn note_spikes<P>(&mut self, spikes: &[P]) {
        if !spikes.is_empty() {
            self.quiet = 0;
        }
    }

    /// Returns the sums of a slot, and takes its arrivals.
    #[inline(always)]
    pub fn take(&mut self, slot: usize) -> (&mut [S], Arrivals<'_>) {
        let all = std::mem::take(&mut self.marked[slot]);
        let none = !all && self.quiet >= self.slots();
        self.quiet = self.quiet.saturating_add(1);
        let blocks = self.lanes / SKIP_BLOCK;
        let marks = &mut self.marks[slot * blocks..(slot + 1) * blocks];
        if all {
            marks.fill(0);
        }
        (&mut self.sums[slot * self.lanes..(slot + 1) * self.lanes], Arrivals { marks, all, none })
    }

    /// The first lane of the slot of a delay.
    #[inline(always)]
    pub(super) fn slot(&self, now: Now, delay: u8) -> usize {
        let slot = now.slot + usize::from(delay);
        self.lanes * if slot >= self.slots() { slot - self.slots() } else { slot }
    }

    /// Marks the skip blocks of these lanes of a slot.
    #[inline(always)]
    pub(super) fn mark(&mut self, slot: usize, lanes: Range<usize>) {
        self.marks[(slot + lanes.start) / SKIP_BLOCK..(slot + lanes.end).div_ceil(SKIP_BLOCK)].fill(1);
    }
}
