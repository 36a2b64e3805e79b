//! Zeroed buffers, aligned for the caches.
//!
//! Input: a size. Output: a zeroed buffer. [`Store`] is for bytes that are read in random order
//! (lists of synapses): large ones are mapped in pages of 2 MiB, so that the TLB holds them all.
//! [`Aligned`] is for numbers that are read as vectors. Both begin at a cache line. Alignment and
//! page size are best effort: only time depends on them.

use std::ops::{Deref, DerefMut, Range};

use memmap2::MmapMut;

use crate::prefetch::LINE;

/// Size of a large page.
const LARGE: usize = 2 << 20;

/// A buffer of bytes.
#[derive(Debug)]
pub(crate) enum Store {
    /// A small buffer, or no mapping was possible.
    Heap(Vec<u8>),
    /// A mapping of whole pages.
    Pages(MmapMut),
}

impl Store {
    /// A buffer of zeros.
    pub fn new(size: usize) -> Self {
        // Miri does not support madvise.
        if size < LARGE || cfg!(miri) {
            return Store::Heap(vec![0; size]);
        }
        match MmapMut::map_anon(size) {
            Ok(map) => {
                #[cfg(target_os = "linux")]
                if let Err(refused) = map.advise(memmap2::Advice::HugePage) {
                    tracing::debug!("no large pages: {refused}");
                }
                Store::Pages(map)
            }
            Err(refused) => {
                tracing::debug!("no map of {size} bytes: {refused}");
                Store::Heap(vec![0; size])
            }
        }
    }

    #[inline(always)]
    pub fn bytes(&self) -> &[u8] {
        match self {
            Store::Heap(bytes) => bytes,
            Store::Pages(map) => map,
        }
    }

    /// The bytes, mutable.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Store::Heap(bytes) => bytes,
            Store::Pages(map) => map,
        }
    }
}

/// Numbers that begin at a cache line, so that a vector of 64 bytes is one line and not parts of
/// two.
#[derive(Debug, Default)]
pub(crate) struct Aligned<T> {
    items: Vec<T>,
    range: Range<usize>,
}

impl<T: Copy + Default> Aligned<T> {
    /// A buffer of `count` zeros.
    pub fn new(count: usize) -> Self {
        let spare = LINE / size_of::<T>();
        let items = vec![T::default(); count + spare];
        let from = items.as_ptr().align_offset(LINE).min(spare);
        Aligned { items, range: from..from + count }
    }
}

impl<T: Copy + Default> Clone for Aligned<T> {
    fn clone(&self) -> Self {
        // The copy is at another address, and is aligned anew.
        let mut copy = Aligned::new(self.len());
        copy.copy_from_slice(self);
        copy
    }
}

impl<T> Deref for Aligned<T> {
    type Target = [T];

    #[inline(always)]
    fn deref(&self) -> &[T] {
        &self.items[self.range.clone()]
    }
}

impl<T> DerefMut for Aligned<T> {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [T] {
        &mut self.items[self.range.clone()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_begin_at_a_line() {
        for count in [0, 1, 16, 1_000, 1 << 20] {
            let mut numbers = Aligned::<i32>::new(count);
            assert_eq!(numbers.len(), count);
            numbers.iter_mut().for_each(|number| *number = 7);
            assert!(numbers.iter().all(|&number| number == 7));
            // Miri need not align.
            assert!(cfg!(miri) || numbers.as_ptr().addr().is_multiple_of(LINE));
        }
    }

    #[test]
    fn few_and_many_bytes_are_zeros_to_be_filled() {
        for size in [0, 1, LARGE - 1, LARGE, LARGE + 4097] {
            let mut store = Store::new(size);
            assert_eq!(store.bytes().len(), size);
            assert!(store.bytes().iter().all(|&byte| byte == 0));
            if let Some(last) = store.bytes_mut().last_mut() {
                *last = 7;
            }
            assert_eq!(store.bytes().last().copied(), (size > 0).then_some(7));
        }
    }
}
