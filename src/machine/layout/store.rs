//! Memory laid out for the caches: bytes that are read in random order (lists of synapses), and numbers that are read as
//! vectors.
//!
//! Comes in: how many. Goes out: as many, zeros, to be filled once. A list that a spike reaches lies in no cache, so what its
//! place costs is paid for every spike: large stores are asked of the operating system in pages of 2 MiB, of which the
//! processor can remember where all are, and begin where a line of the cache does. Either is a wish: nothing but time depends
//! on it. What it leaves out on purpose: what the bytes mean.

use std::ops::{Deref, DerefMut, Range};

use memmap2::MmapMut;

use crate::machine::deliver::prefetch::LINE;

/// Bytes from which on large pages can be had.
const LARGE: usize = 2 << 20;

/// Bytes, fixed in number.
#[derive(Debug)]
pub(crate) enum Store {
    /// Few of them, or where no map can be had.
    Heap(Vec<u8>),
    /// Whole pages.
    Pages(MmapMut),
}

impl Store {
    /// So many zeros.
    pub fn new(size: usize) -> Self {
        // Miri knows no advice about memory.
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

    /// The bytes.
    #[inline(always)]
    pub fn bytes(&self) -> &[u8] {
        match self {
            Store::Heap(bytes) => bytes,
            Store::Pages(map) => map,
        }
    }

    /// The bytes, to be filled.
    pub fn bytes_mut(&mut self) -> &mut [u8] {
        match self {
            Store::Heap(bytes) => bytes,
            Store::Pages(map) => map,
        }
    }
}

/// Numbers that begin where a line of the cache does: a vector of 64 bytes is then one line and not parts of two.
#[derive(Debug)]
pub(crate) struct Aligned<T> {
    items: Vec<T>,
    range: Range<usize>,
}

impl<T: Copy + Default> Aligned<T> {
    /// So many zeros.
    pub fn new(count: usize) -> Self {
        let spare = LINE / size_of::<T>();
        let items = vec![T::default(); count + spare];
        // As with pages, a wish.
        let from = items.as_ptr().align_offset(LINE).min(spare);
        Aligned { items, range: from..from + count }
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
            // Miri need not place memory where it is wished.
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
