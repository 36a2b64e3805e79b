//! Asking for memory before it is needed.
//!
//! Sources of spikes lie anywhere in tables that no cache holds, so a step would wait for each of their lists in turn.
//! What it does is invisible but for the time: it reads nothing and writes nothing.

/// Bytes of a line of the cache, on every processor this is built for that knows the instruction below.
pub(crate) const LINE: usize = 64;

/// Asks for the line that holds an element; any index will do.
#[inline(always)]
pub(crate) fn prefetch<T>(slice: &[T], index: usize) {
    #[cfg(all(target_arch = "x86_64", not(miri)))]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let at = slice.as_ptr().wrapping_add(index);
        // SAFETY: PREFETCHT0 is a hint: it accesses no memory as far as the program can tell, and does nothing for an address
        // that is not mapped (Intel SDM vol. 2B, PREFETCHh). The address is computed without `add`, so it need not be within
        // the slice. The instruction belongs to SSE, which every x86-64 has.
        #[expect(unsafe_code, reason = "there is no safe way to ask for a line")]
        unsafe {
            _mm_prefetch::<_MM_HINT_T0>(at.cast());
        }
    }
    #[cfg(not(all(target_arch = "x86_64", not(miri))))]
    let _ = (slice, index);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_index_will_do() {
        let data = vec![1u32; 100];
        for index in [0, 99, 100, usize::MAX / 8, usize::MAX] {
            prefetch(&data, index);
        }
        assert_eq!(data, [1; 100]);
    }
}
