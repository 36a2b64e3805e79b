//! Exchange: the spikes of all shards in one list.
//!
//! Input: spikes by shard. Output: all spikes; spikes that reach dense blocks come last, in
//! ascending order. The others are not sorted: only dense blocks need it, and sorting costs time.

use std::ops::Range;

use crate::bits::{UNCHECKED_ONES, write_ones};
use nsim_ir::base::id::{CompartmentId, Id};

/// Moves ids in the upper range after all others and sorts them; payloads, if there are any, move
/// with their ids. Ids are distinct and below the end of the range. A bit set is less work than
/// sorting if the ids outnumber an eighth of the words of marks. `marks` and `by_id` are scratch
/// memory; `marks` is all zeros before and after.
pub(crate) fn sort(
    (ids, payloads): (&mut Vec<CompartmentId>, &mut [i32]),
    range: Range<CompartmentId>,
    marks: &mut Vec<u64>,
    by_id: &mut Vec<i32>,
) {
    let (first, count) = (range.start, range.end.index() - range.start.index());
    // Usually only some ids at the end need sorting.
    let kept = ids.iter().position(|&id| id >= first).unwrap_or(ids.len());
    let mut begin = kept;
    for at in kept..ids.len() {
        if ids[at] < first {
            ids.swap(begin, at);
            if !payloads.is_empty() {
                payloads.swap(begin, at);
            }
            begin += 1;
        }
    }
    let place = |id: CompartmentId| id.index() - first.index();
    by_id.resize(if payloads.is_empty() { 0 } else { count }, 0);
    let (total, words) = (ids.len(), count.div_ceil(64));
    for (&id, &payload) in ids[begin..].iter().zip(payloads.iter().skip(begin)) {
        by_id[place(id)] = payload;
    }
    if (total - begin) * 8 < words {
        ids[begin..].sort_unstable();
    } else {
        marks.resize(words, 0);
        for &id in &ids[begin..] {
            marks[place(id) / 64] |= 1 << (place(id) % 64);
        }
        ids.resize(total + UNCHECKED_ONES, CompartmentId(0));
        let mut end = begin;
        for (first, marks) in (first.0..).step_by(64).zip(marks) {
            end = write_ones(ids, end, std::mem::take(marks), |bit| CompartmentId(first.wrapping_add(bit)));
        }
        ids.truncate(total);
    }
    for (&id, payload) in ids[begin..].iter().zip(payloads.iter_mut().skip(begin)) {
        *payload = by_id[place(id)];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng;

    /// With a bit set and without, with payloads and without.
    #[test]
    fn ids_of_the_range_come_last_and_ascending() {
        const COUNT: usize = 3_000;
        for (seed, every) in [(1, 2), (2, 700)] {
            let mut order: Vec<usize> = (0..COUNT).step_by(every).collect();
            order.sort_by_key(|&id| rng::bits(seed, id as u64, 0));
            for first in [0, 1_000, COUNT] {
                for graded in [false, true] {
                    let mut ids: Vec<CompartmentId> = order.iter().map(|&id| CompartmentId::new(id)).collect();
                    let payload = |id: &CompartmentId| 7 * id.0 as i32 - 100;
                    let mut payloads: Vec<i32> = if graded { ids.iter().map(payload).collect() } else { Vec::new() };
                    let (mut marks, mut by_id) = (Vec::new(), Vec::new());
                    let range = CompartmentId::new(first)..CompartmentId::new(COUNT);
                    sort((&mut ids, &mut payloads), range, &mut marks, &mut by_id);
                    let (before, sorted) = ids.split_at(ids.partition_point(|id| id.index() < first));
                    assert!(sorted.is_sorted() && sorted.iter().all(|id| id.index() >= first));
                    assert!(!graded || payloads.iter().copied().eq(ids.iter().map(payload)));
                    let mut all: Vec<usize> = before.iter().chain(sorted).map(|id| id.index()).collect();
                    all.sort_unstable();
                    assert!(all.into_iter().eq((0..COUNT).step_by(every)));
                    assert!(marks.iter().all(|&word| word == 0));
                }
            }
        }
    }
}
