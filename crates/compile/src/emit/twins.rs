//! Cores that hold the same compartments of other copies.
//!
//! Input: the compartments of each core, how many copies there are and of how many compartments.
//! Output: for each core the first whose compartments, slot by slot, are the same ones so many
//! copies earlier. As copies are equal and share nothing, what such a core stores is what the first
//! stores, and its sources are the same ones so many copies later.

use std::collections::HashMap;

use nsim_ir::base::id::{CompartmentId, CoreId, IdVec};

/// The first of equal cores.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Twin {
    /// The first.
    pub first: CoreId,
    /// How many copies later this one is.
    pub later: u32,
}

/// The first of the cores that are equal to each, which may be itself.
#[must_use]
pub fn twins(members: &IdVec<CoreId, Vec<CompartmentId>>, of_copy: u32) -> IdVec<CoreId, Twin> {
    let mut known: HashMap<Vec<u32>, (CoreId, u32)> = HashMap::new();
    let twin = |(core, held): (CoreId, &Vec<CompartmentId>)| {
        let copy = held.iter().map(|id| id.0 / of_copy.max(1)).min().unwrap_or(0);
        let relative = held.iter().map(|id| id.0 - copy * of_copy).collect();
        let &mut (first, copy_of_first) = known.entry(relative).or_insert((core, copy));
        // What comes first in order need not be of an earlier copy.
        match copy.checked_sub(copy_of_first) {
            Some(later) => Twin { first, later },
            None => Twin { first: core, later: 0 },
        }
    };
    members.enumerate().map(twin).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_cores_of_later_copies_are_found() {
        let core = |ids: &[u32]| ids.iter().map(|&id| CompartmentId(id)).collect::<Vec<_>>();
        // Copies of 3: two copies on cores {0 1}, {2 3}, {4 5}, then the same two copies later,
        // then another order.
        let members: IdVec<CoreId, _> =
            vec![core(&[0, 1]), core(&[2, 3]), core(&[4, 5]), core(&[6, 7]), core(&[8, 9]), core(&[11, 10])].into();
        let found: Vec<(u32, u32)> = twins(&members, 3).iter().map(|twin| (twin.first.0, twin.later)).collect();
        assert_eq!(found, [(0, 0), (1, 0), (2, 0), (0, 2), (1, 2), (5, 0)]);
    }
}
