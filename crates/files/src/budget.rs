//! Limits of reading: file sizes, lengths of recordings, and the memory that a file may claim.
//!
//! Input: the size of a file, then each claim of bytes and items. Output: nothing, or [`Exceeded`].
//! A claim bears no relation to the size of its file: a file may refer to one byte many times,
//! compress bytes, or name a far index. So each claim is subtracted from the budget before memory
//! is allocated, and never returned.

/// The most bytes of a RON file. While a flat list of one-digit numbers is read, it takes twenty
/// times its text, since each entry stores its place for messages. The largest file stays well
/// below a gibibyte. Larger arrays belong in files of their own.
pub const MOST_TEXT: u64 = 32 << 20;
/// The most bytes of an event list in text.
pub const MOST_EVENT_TEXT: u64 = 256 << 20;
/// The most bytes of an array file.
pub const MOST_ARRAY: u64 = 1 << 30;

/// The most timesteps of a sample: engines store a number for each.
pub const MOST_STEPS: u32 = 1 << 24;
/// The most timesteps of all samples of a run.
pub const MOST_STEPS_TOGETHER: u64 = 1 << 27;
/// The most spikes of a sample: each takes eight bytes.
pub const MOST_EVENTS: usize = 1 << 27;

/// Bytes that a file of any size may claim.
pub const MOST_FIXED: u64 = 64 << 20;
/// Bytes that a file may claim in addition, for each byte of its size.
pub const MOST_RATIO: u64 = 12;

/// Bytes that packets may decompress to, plus [`PACKETS_RATIO`] for each byte that was read. An
/// event has 16 bytes, of which 8 hardly change, so no compression shrinks it a hundredfold.
const PACKETS_FIXED: u64 = 32 << 20;
const PACKETS_RATIO: u64 = 64;

/// Bytes of a sample without a spike, and of a timestep without one, in a run.
const SAMPLE: u64 = 256;
const STEP: u64 = 4;

/// A claim beyond the budget of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Exceeded {
    /// Bytes.
    #[error("its content would take more than {} MiB and {ratio} times the file's size", fixed >> 20)]
    Bytes {
        /// Bytes that a file of any size may claim.
        fixed: u64,
        /// Bytes that it may claim in addition, for each byte of its size.
        ratio: u64,
    },
    /// Items.
    #[error("it has more than {0} items")]
    Items(usize),
    /// Depth.
    #[error("its items are nested deeper than {0}")]
    Depth(usize),
}

/// Bytes and items that may still be claimed.
#[derive(Debug, Clone)]
pub struct Budget {
    fixed: u64,
    ratio: u64,
    bytes: u64,
    items: usize,
    most_items: usize,
    deepest: usize,
}

impl Budget {
    /// The budget of a file of `bytes` bytes, at most `most_items` items and `deepest` levels.
    pub fn for_file(bytes: u64, most_items: usize, deepest: usize) -> Budget {
        let (fixed, ratio) = (MOST_FIXED, MOST_RATIO);
        let mut budget = Budget { fixed, ratio, bytes: fixed, items: most_items, most_items, deepest };
        budget.grow(bytes);
        budget
    }

    /// The budget of a stream of packets of which nothing has been read.
    pub fn for_packets() -> Budget {
        let (fixed, ratio) = (PACKETS_FIXED, PACKETS_RATIO);
        Budget { fixed, ratio, bytes: fixed, items: usize::MAX, most_items: usize::MAX, deepest: 0 }
    }

    /// Adds the claim of `bytes` more bytes that have been read.
    pub fn grow(&mut self, bytes: u64) {
        self.bytes = self.bytes.saturating_add(self.ratio.saturating_mul(bytes));
    }

    /// Subtracts `count` samples of `steps` timesteps, without their spikes.
    ///
    /// # Errors
    /// [`Exceeded::Bytes`].
    pub fn samples(&mut self, count: u64, steps: u64) -> Result<(), Exceeded> {
        self.bytes(count.saturating_mul(STEP.saturating_mul(steps).saturating_add(SAMPLE)))
    }

    /// Subtracts `count` numbers that are stored in `width` bytes each and become reals.
    ///
    /// # Errors
    /// [`Exceeded::Bytes`].
    pub fn numbers(&mut self, count: u64, width: u64) -> Result<(), Exceeded> {
        self.bytes(count.saturating_mul(width.saturating_add(8)))
    }

    /// Subtracts `bytes` bytes.
    ///
    /// # Errors
    /// [`Exceeded::Bytes`].
    pub fn bytes(&mut self, bytes: u64) -> Result<(), Exceeded> {
        self.bytes = self.bytes.checked_sub(bytes).ok_or(Exceeded::Bytes { fixed: self.fixed, ratio: self.ratio })?;
        Ok(())
    }

    /// Subtracts an item at `depth`.
    ///
    /// # Errors
    /// [`Exceeded::Items`], [`Exceeded::Depth`].
    pub fn item(&mut self, depth: usize) -> Result<(), Exceeded> {
        if depth > self.deepest {
            return Err(Exceeded::Depth(self.deepest));
        }
        self.items = self.items.checked_sub(1).ok_or(Exceeded::Items(self.most_items))?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_taken_is_gone() {
        let exceeded = Err(Exceeded::Bytes { fixed: MOST_FIXED, ratio: MOST_RATIO });
        let mut budget = Budget::for_file(1000, 2, 3);
        assert_eq!(budget.numbers(u64::MAX, 8), exceeded);
        assert_eq!(budget.bytes(MOST_FIXED), Ok(()));
        assert_eq!(budget.numbers(750, 8), Ok(()));
        assert_eq!(budget.bytes(1), exceeded);
        assert_eq!(budget.item(4), Err(Exceeded::Depth(3)));
        assert_eq!((budget.item(3), budget.item(0), budget.item(0)), (Ok(()), Ok(()), Err(Exceeded::Items(2))));
    }

    #[test]
    fn packets_earn_what_they_may_take() {
        let mut budget = Budget::for_packets();
        assert!(budget.bytes(PACKETS_FIXED).is_ok() && budget.bytes(1).is_err());
        budget.grow(1);
        assert!(budget.bytes(PACKETS_RATIO).is_ok() && budget.bytes(1).is_err());
    }

    #[test]
    fn a_recording_may_be_as_long_as_a_sample_may() {
        assert!(Budget::for_file(100, 1, 1).samples(1, MOST_STEPS.into()).is_ok());
        assert!(Budget::for_file(100, 1, 1).samples(2, MOST_STEPS.into()).is_err());
        assert!(Budget::for_file(100, 1, 1).samples(1 << 20, 1).is_err());
    }
}
