//! Prefetching of cache lines.
//!
//! Spikes read lists all over tables that exceed the caches: without prefetch a step waits for each
//! of them. Only time depends on it.

/// Bytes of a cache line, on every processor with the instruction below.
pub(crate) const LINE: usize = 64;

/// Prefetches the line that holds an element; any index is allowed.
#[inline(always)]
pub(crate) fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let at = slice.as_ptr().wrapping_add(index);
        // SAFETY: PREFETCHT0 is a hint: it accesses no memory as far as the program can tell, and
        // does nothing for an address that is not mapped (Intel SDM vol. 2B, PREFETCHh). The
        // address is computed without `add`, so it need not be within the slice. The instruction
        // belongs to SSE, which every x86-64 has.
        #[expect(unsafe_code, reason = "there is no safe prefetch")]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(at.cast());
        }
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (slice, index);
}

/// Prefetches the lines that hold these elements.
#[inline]
pub(crate) fn prefetch_range<T>(slice: &[T], range: std::ops::Range<usize>) {
    range.step_by(LINE / size_of::<T>()).for_each(|index| prefetch(slice, index));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_index_is_allowed() {
        let data = vec![1u32; 100];
        for index in [0, 99, 100, usize::MAX / 8, usize::MAX] {
            prefetch(&data, index);
        }
        assert_eq!(data, [1; 100]);
    }
}
