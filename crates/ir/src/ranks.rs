//! Assignment of a program's cores to processes.
//!
//! Processes are *ranks*, numbered from 0. Input: the rank of each core. Invariant, which
//! [`RankAssignment::is_of`] checks: each core has a rank below the number of ranks.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::id::{CoreId, IdVec};

/// One of the processes that run a program together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RankShare {
    /// Number of this process, below `ranks`.
    pub rank: u32,
    /// Number of ranks.
    pub ranks: u32,
    /// Whether it stores the tables of all cores, although it runs only its own. An energy estimate
    /// needs every message.
    pub whole: bool,
}

impl RankShare {
    /// The share of a single process.
    pub const ALL: RankShare = RankShare { rank: 0, ranks: 1, whole: true };
}

/// The cores of a program, assigned to ranks.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RankAssignment {
    /// Number of ranks.
    pub ranks: u32,
    /// The rank of each core.
    pub owners: Arc<IdVec<CoreId, u32>>,
    /// The only rank whose tables and incoming messages are stored here; `None` where all are.
    pub held: Option<u32>,
}

impl RankAssignment {
    /// Whether each of `cores` cores has a rank below the number of ranks.
    pub fn is_of(&self, cores: usize) -> bool {
        self.owners.len() == cores && self.owners.iter().all(|&owner| owner < self.ranks)
    }

    /// Whether the tables of a core are stored here.
    pub fn is_local(&self, core: CoreId) -> bool {
        self.held.is_none_or(|rank| self.owners[core] == rank)
    }
}
