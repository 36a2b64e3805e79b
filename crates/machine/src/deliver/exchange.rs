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

/// Sorts distinct ids below `count` and what the spike of each carries; `by_id` is scratch memory.
pub(crate) fn sort_graded(
    (ids, payloads): (&mut Vec<CompartmentId>, &mut [i32]),
    marks: &mut Vec<u64>,
    by_id: &mut Vec<i32>,
    count: usize,
) {
    by_id.resize(count, 0);
    for (id, &payload) in ids.iter().zip(&*payloads) {
        by_id[id.index()] = payload;
    }
    sort(ids, marks, count);
    for (id, payload) in ids.iter().zip(payloads) {
        *payload = by_id[id.index()];
    }
}
