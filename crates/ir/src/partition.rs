//! Assignment of compartments to logical cores.
//!
//! Invariants of a [`Partition`]: each compartment has exactly one core and one slot, and each
//! core's use of every resource is within the target's limits.

use std::ops::{Index, IndexMut};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::resource::{Capacity, Limits, PerResource, Resource};

/// Core and slot of a compartment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Seat {
    /// The core.
    pub core: CoreId,
    /// The slot on that core.
    pub slot: u16,
}

/// Resources that a core uses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CoreUsage {
    /// Number of synapses, which has no limit.
    pub synapses: u64,
    /// Amount of each resource.
    pub of: PerResource<u64>,
}

impl CoreUsage {
    /// Returns this usage with another amount of one resource.
    #[must_use]
    pub fn with(mut self, resource: Resource, used: u64) -> Self {
        self.of[resource] = used;
        self
    }

    /// The exceeded capacities, each with need and limit.
    pub fn excesses<'l>(self, limits: &'l Limits) -> impl Iterator<Item = (Capacity, u64, u64)> + use<'l> {
        limits.against(self.of).filter(|(_, need, limit)| need > limit)
    }
}

impl Index<Resource> for CoreUsage {
    type Output = u64;
    #[inline]
    fn index(&self, resource: Resource) -> &u64 {
        &self.of[resource]
    }
}

impl IndexMut<Resource> for CoreUsage {
    #[inline]
    fn index_mut(&mut self, resource: Resource) -> &mut u64 {
        &mut self.of[resource]
    }
}

/// Reason why a list of cores is not a partition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PartitionError {
    /// A compartment has no seat.
    #[error("compartment {0} is on no core")]
    Unassigned(CompartmentId),
    /// A compartment has two seats, or is not in this network.
    #[error("compartment {0} is on more than one core, or does not exist")]
    Misplaced(CompartmentId),
    /// The usage of some core is missing.
    #[error("there are {cores} cores, but usage for {given} of them")]
    Uncounted {
        /// Number of cores.
        cores: usize,
        /// Number of cores whose usage is given.
        given: usize,
    },
    /// A core exceeds a limit.
    #[error("{core} needs {need} {}, the limit is {limit}", capacity.name())]
    Excess {
        /// The core.
        core: CoreId,
        /// The exceeded capacity.
        capacity: Capacity,
        /// Amount that the core needs.
        need: u64,
        /// Amount that the core has.
        limit: u64,
    },
}

/// Assignment of compartments to logical cores, within every limit.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "Text")]
pub struct Partition {
    limits: Limits,
    members: IdVec<CoreId, Arc<Vec<CompartmentId>>>,
    #[serde(skip)]
    seats: Arc<IdVec<CompartmentId, Seat>>,
    usage: IdVec<CoreId, CoreUsage>,
}

/// Serialised form of a [`Partition`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename = "Partition")]
struct Text {
    limits: Limits,
    members: IdVec<CoreId, Vec<CompartmentId>>,
    usage: IdVec<CoreId, CoreUsage>,
}

impl TryFrom<Text> for Partition {
    type Error = PartitionError;

    fn try_from(Text { limits, members, usage }: Text) -> Result<Self, PartitionError> {
        let compartments: usize = members.iter().map(Vec::len).sum();
        Partition::new(compartments as u32, members, usage, &limits)
    }
}

impl Partition {
    /// Builds a partition from the compartments of each core in slot order, and the usage of each
    /// core (from `nsim_partition::resources::exact`).
    ///
    /// # Errors
    /// [`PartitionError`] when a compartment does not have exactly one seat, the usage of a core is
    /// missing, or a core exceeds a limit.
    pub fn new(
        compartments: u32,
        mut members: IdVec<CoreId, Vec<CompartmentId>>,
        usage: IdVec<CoreId, CoreUsage>,
        limits: &Limits,
    ) -> Result<Self, PartitionError> {
        let (cores, given) = (members.len(), usage.len());
        if cores != given {
            return Err(PartitionError::Uncounted { cores, given });
        }
        let seats = Arc::new(seats(compartments, &members)?);
        let members = members.iter_mut().map(|held| Arc::new(std::mem::take(held))).collect();
        Partition { limits: limits.clone(), members, seats, usage }.within(limits)
    }

    /// Returns this partition with other limits.
    ///
    /// # Errors
    /// [`PartitionError::Excess`] when a core exceeds one.
    pub fn within(mut self, limits: &Limits) -> Result<Self, PartitionError> {
        for (core, used) in self.usage.enumerate() {
            if let Some((capacity, need, limit)) = used.excesses(limits).next() {
                return Err(PartitionError::Excess { core, capacity, need, limit });
            }
        }
        self.limits = limits.clone();
        Ok(self)
    }

    /// The limits that every core keeps.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Number of cores.
    pub fn cores(&self) -> usize {
        self.members.len()
    }

    /// Compartments of each core in slot order, shared with the program.
    pub fn members(&self) -> &IdVec<CoreId, Arc<Vec<CompartmentId>>> {
        &self.members
    }

    /// Copies the compartments of each core, to build another partition.
    pub fn to_members(&self) -> IdVec<CoreId, Vec<CompartmentId>> {
        self.members.iter().map(|held| held.to_vec()).collect()
    }

    /// Seat of each compartment, shared with the program.
    pub fn seats(&self) -> &Arc<IdVec<CompartmentId, Seat>> {
        &self.seats
    }

    /// Usage of each core.
    pub fn usage(&self) -> &IdVec<CoreId, CoreUsage> {
        &self.usage
    }
}

/// Seat of each compartment, if each has exactly one.
///
/// # Errors
/// [`PartitionError::Unassigned`] or [`PartitionError::Misplaced`].
pub fn seats(
    compartments: u32,
    members: &IdVec<CoreId, Vec<CompartmentId>>,
) -> Result<IdVec<CompartmentId, Seat>, PartitionError> {
    let mut seats: Vec<Option<Seat>> = vec![None; compartments as usize];
    for (core, held) in members.enumerate() {
        for (slot, &compartment) in held.iter().enumerate() {
            let slot = u16::try_from(slot).map_err(|_| PartitionError::Misplaced(compartment))?;
            match seats.get_mut(compartment.index()) {
                Some(seat @ None) => *seat = Some(Seat { core, slot }),
                _ => return Err(PartitionError::Misplaced(compartment)),
            }
        }
    }
    seats
        .into_iter()
        .enumerate()
        .map(|(i, seat)| seat.ok_or(PartitionError::Unassigned(CompartmentId::new(i))))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_compartment_sits_exactly_once() {
        let n = CompartmentId;
        assert_eq!(seats(2, &vec![vec![n(0)]].into()), Err(PartitionError::Unassigned(n(1))));
        assert_eq!(seats(2, &vec![vec![n(0)], vec![n(1), n(0)]].into()), Err(PartitionError::Misplaced(n(0))));
        assert_eq!(seats(1, &vec![vec![n(0), n(1)]].into()), Err(PartitionError::Misplaced(n(1))));
        let both = seats(2, &vec![vec![n(1)], vec![n(0)]].into()).unwrap();
        assert_eq!(both[n(0)], Seat { core: CoreId(1), slot: 0 });
    }
}
