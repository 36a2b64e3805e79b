//! What reading a file may cost, decided by the file's size.
//!
//! Input: the size, then each claim of bytes and items before they are made. Output: nothing, or [`Exceeded`]. Files name
//! the same bytes many times, and compress them: what they claim bears no relation to what they are. A budget is taken from
//! before anything of a claimed size is allocated, and never given back.

/// Bytes that any file may cost.
pub const MOST_FIXED: u64 = 64 << 20;
/// Bytes that a file may cost in addition, for each byte of its own.
pub const MOST_RATIO: u64 = 12;

/// What a file claims beyond its budget.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Exceeded {
    /// Bytes.
    #[error("its arrays would take more than {} MiB and {MOST_RATIO} times the file's size", MOST_FIXED >> 20)]
    Bytes,
    /// Items.
    #[error("it has more than {0} items")]
    Items(usize),
    /// Depth.
    #[error("its items are nested deeper than {0}")]
    Depth(usize),
}

/// What may still be taken.
#[derive(Debug, Clone)]
pub struct Budget {
    bytes: u64,
    items: usize,
    most_items: usize,
    deepest: usize,
}

impl Budget {
    /// The budget of a file of so many bytes, items and depth.
    #[must_use]
    pub fn for_file(bytes: u64, most_items: usize, deepest: usize) -> Budget {
        Budget {
            bytes: MOST_FIXED.saturating_add(MOST_RATIO.saturating_mul(bytes)),
            items: most_items,
            most_items,
            deepest,
        }
    }

    /// Takes so many numbers that are stored in `width` bytes each and become reals.
    ///
    /// # Errors
    /// [`Exceeded::Bytes`].
    pub fn numbers(&mut self, count: u64, width: u64) -> Result<(), Exceeded> {
        self.bytes(count.saturating_mul(width.saturating_add(8)))
    }

    /// Takes so many bytes.
    ///
    /// # Errors
    /// [`Exceeded::Bytes`].
    pub fn bytes(&mut self, bytes: u64) -> Result<(), Exceeded> {
        self.bytes = self.bytes.checked_sub(bytes).ok_or(Exceeded::Bytes)?;
        Ok(())
    }

    /// Takes an item at a depth.
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
        let mut budget = Budget::for_file(1000, 2, 3);
        assert_eq!(budget.numbers(u64::MAX, 8), Err(Exceeded::Bytes));
        assert_eq!(budget.bytes(MOST_FIXED), Ok(()));
        assert_eq!(budget.numbers(750, 8), Ok(()));
        assert_eq!(budget.bytes(1), Err(Exceeded::Bytes));
        assert_eq!(budget.item(4), Err(Exceeded::Depth(3)));
        assert_eq!((budget.item(3), budget.item(0), budget.item(0)), (Ok(()), Ok(()), Err(Exceeded::Items(2))));
    }
}
