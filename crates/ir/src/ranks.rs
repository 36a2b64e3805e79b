//! Which process of several holds which cores of a program.
//!
//! Processes are *ranks*, numbered from 0. Input: the rank of each core. True of every
//! [`RankAssignment`]: each core has one rank, below their number.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::id::{CoreId, IdVec};

/// A process among those that run a program together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Share {
    /// Its number.
    pub rank: u32,
    /// Number of ranks.
    pub ranks: u32,
    /// Whether it holds the tables of all cores, although it runs its own only: what prices a run
    /// needs every message.
    pub whole: bool,
}

impl Share {
    /// The only process.
    pub const ALL: Share = Share { rank: 0, ranks: 1, whole: true };
}

/// The cores of a program, assigned to ranks.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RankAssignment {
    /// Number of ranks.
    pub ranks: u32,
    /// The rank of each core.
    pub owners: Arc<IdVec<CoreId, u32>>,
    /// The only rank of whose cores there are tables and to whose cores there are messages; `None`
    /// where there are all.
    pub held: Option<u32>,
}

impl RankAssignment {
    /// Whether this many cores each have a rank.
    pub fn is_of(&self, cores: usize) -> bool {
        self.owners.len() == cores && self.owners.iter().all(|&owner| owner < self.ranks)
    }

    /// Whether the tables of a core are held.
    pub fn holds(&self, core: CoreId) -> bool {
        self.held.is_none_or(|rank| self.owners[core] == rank)
    }
}
