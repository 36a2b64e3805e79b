//! Exchange: the spikes of all shards in one list.
//!
//! Input: spikes by shard. Output: all spikes, ascending if asked for. Why not always ascending:
//! sorting costs time, and only dense blocks need the order.

use crate::bits::{UNCHECKED, write_ones};
use nsim_ir::base::id::{CompartmentId, Id};

/// Sorts distinct ids below `count`. With more than an eighth as many ids as words of marks, a bit
/// set is less work than sorting. `marks` is scratch memory, all zeros before and after.
pub(crate) fn sort(ids: &mut Vec<CompartmentId>, marks: &mut Vec<u64>, count: usize) {
    let words = count.div_ceil(64);
    if ids.len() * 8 < words {
        ids.sort_unstable();
        return;
    }
    marks.resize(words, 0);
    for id in ids.iter() {
        marks[id.index() / 64] |= 1 << (id.0 % 64);
    }
    let (total, mut end) = (ids.len(), 0);
    ids.resize(total + UNCHECKED, CompartmentId(0));
    for (first, marks) in (0u32..).step_by(64).zip(marks) {
        end = write_ones(ids, end, std::mem::take(marks), |bit| CompartmentId(first.wrapping_add(bit)));
    }
    ids.truncate(total);
}

/// Sorts distinct ids and what the spike of each carries.
pub(crate) fn sort_graded(ids: &mut [CompartmentId], payloads: &mut [i32]) {
    let mut pairs: Vec<(CompartmentId, i32)> = ids.iter().copied().zip(payloads.iter().copied()).collect();
    pairs.sort_unstable_by_key(|pair| pair.0);
    for ((id, payload), pair) in ids.iter_mut().zip(payloads).zip(pairs) {
        (*id, *payload) = pair;
    }
}
