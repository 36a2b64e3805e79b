//! Compartments on logical cores.
//!
//! True of every [`Partition`]: each compartment sits on exactly one core in exactly one slot, and each core's use of
//! every resource is within the target's limits.

use serde::Serialize;

use crate::base::id::{CompartmentId, CoreId, Id, IdVec};
use crate::desc::target::Limits;

/// Where a compartment sits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Seat {
    /// The core.
    pub core: CoreId,
    /// The slot on that core.
    pub slot: u16,
}

/// What a core uses of each resource.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct CoreUsage {
    /// Compartments.
    pub compartments: u32,
    /// Input axons.
    pub axons_in: u32,
    /// Output axon slots.
    pub axons_out: u32,
    /// The most output axons of one of its compartments.
    pub axons_out_per_compartment: u32,
    /// Synapses.
    pub synapses: u64,
    /// 64-bit words of synapse memory.
    pub synapse_words: u64,
    /// The most words of one input axon.
    pub synapse_words_per_axon: u32,
    /// Distinct synapse formats.
    pub synapse_formats: u32,
    /// Distinct compartment profiles.
    pub compartment_profiles: u32,
    /// Distinct threshold mantissas.
    pub threshold_profiles: u32,
    /// Dendritic accumulators: compartments times delay slots.
    pub accumulators: u32,
}

/// A resource of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)]
pub enum Resource {
    Compartments,
    AxonsIn,
    AxonsOut,
    AxonsOutPerCompartment,
    SynapseWords,
    SynapseWordsPerAxon,
    SynapseFormats,
    CompartmentProfiles,
    ThresholdProfiles,
    Accumulators,
    /// Cores of the whole target; not a resource of one core.
    Cores,
}

impl Resource {
    /// The name in JSON and in messages.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Resource::Compartments => "compartments",
            Resource::AxonsIn => "axons_in",
            Resource::AxonsOut => "axons_out",
            Resource::AxonsOutPerCompartment => "axons_out_per_compartment",
            Resource::SynapseWords => "synapse_words",
            Resource::SynapseWordsPerAxon => "synapse_words_per_axon",
            Resource::SynapseFormats => "synapse_formats",
            Resource::CompartmentProfiles => "compartment_profiles",
            Resource::ThresholdProfiles => "threshold_profiles",
            Resource::Accumulators => "accumulators",
            Resource::Cores => "cores",
        }
    }
}

impl CoreUsage {
    /// Need and limit of every resource, in a fixed order.
    #[must_use]
    pub fn against(&self, limits: &Limits) -> [(Resource, u64, u64); 10] {
        let pair = |resource, need: u32, limit: u32| (resource, u64::from(need), u64::from(limit));
        [
            pair(Resource::Compartments, self.compartments, limits.compartments),
            pair(Resource::AxonsIn, self.axons_in, limits.axons_in),
            pair(Resource::AxonsOut, self.axons_out, limits.axons_out),
            pair(Resource::AxonsOutPerCompartment, self.axons_out_per_compartment, limits.axons_out_per_compartment),
            (Resource::SynapseWords, self.synapse_words, u64::from(limits.synapse_words)),
            pair(Resource::SynapseWordsPerAxon, self.synapse_words_per_axon, limits.synapse_words_per_axon),
            pair(Resource::SynapseFormats, self.synapse_formats, limits.synapse_formats),
            pair(Resource::CompartmentProfiles, self.compartment_profiles, limits.compartment_profiles),
            pair(Resource::ThresholdProfiles, self.threshold_profiles, limits.threshold_profiles),
            pair(Resource::Accumulators, self.accumulators, limits.accumulators),
        ]
    }

    /// The resources that are used beyond their limits.
    pub fn excesses(&self, limits: &Limits) -> impl Iterator<Item = (Resource, u64, u64)> + use<> {
        self.against(limits).into_iter().filter(|(_, need, limit)| need > limit)
    }
}

/// Why a list of cores is not a partition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PartitionError {
    /// A compartment has no seat.
    #[error("compartment {0} sits on no core")]
    Homeless(CompartmentId),
    /// A compartment has two seats, or is not of this network.
    #[error("compartment {0} sits on more than one core, or does not exist")]
    Misplaced(CompartmentId),
    /// A core needs more than it has.
    #[error("{core} needs {need} {}, the limit is {limit}", resource.name())]
    Excess {
        /// The core.
        core: CoreId,
        /// The resource.
        resource: Resource,
        /// What it needs.
        need: u64,
        /// What it has.
        limit: u64,
    },
}

/// Compartments on logical cores, within every limit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Partition {
    members: IdVec<CoreId, Vec<CompartmentId>>,
    seats: IdVec<CompartmentId, Seat>,
    usage: IdVec<CoreId, CoreUsage>,
}

impl Partition {
    /// Cores with their compartments in slot order, and what each core uses (from `compile::resources::exact`).
    ///
    /// # Errors
    /// [`PartitionError`] when a compartment has not exactly one seat or a core exceeds a limit.
    ///
    /// # Panics
    /// When there are not as many usages as cores: a mistake of the caller.
    pub fn new(
        compartments: u32,
        members: IdVec<CoreId, Vec<CompartmentId>>,
        usage: IdVec<CoreId, CoreUsage>,
        limits: &Limits,
    ) -> Result<Self, PartitionError> {
        assert_eq!(members.len(), usage.len(), "one usage for each core");
        let seats = seats(compartments, &members)?;
        Partition { members, seats, usage }.within(limits)
    }

    /// The same within other limits.
    ///
    /// # Errors
    /// [`PartitionError::Excess`] when a core exceeds one.
    pub fn within(self, limits: &Limits) -> Result<Self, PartitionError> {
        for (core, used) in self.usage.enumerate() {
            if let Some((resource, need, limit)) = used.excesses(limits).next() {
                return Err(PartitionError::Excess { core, resource, need, limit });
            }
        }
        Ok(self)
    }

    /// Number of cores.
    #[must_use]
    pub fn cores(&self) -> usize {
        self.members.len()
    }

    /// Compartments of each core in slot order.
    #[must_use]
    pub fn members(&self) -> &IdVec<CoreId, Vec<CompartmentId>> {
        &self.members
    }

    /// Where each compartment sits.
    #[must_use]
    pub fn seats(&self) -> &IdVec<CompartmentId, Seat> {
        &self.seats
    }

    /// What each core uses.
    #[must_use]
    pub fn usage(&self) -> &IdVec<CoreId, CoreUsage> {
        &self.usage
    }
}

/// Where each compartment sits, if each sits exactly once.
///
/// # Errors
/// [`PartitionError::Homeless`] or [`PartitionError::Misplaced`].
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
    seats.into_iter().enumerate().map(|(i, seat)| seat.ok_or(PartitionError::Homeless(CompartmentId::new(i)))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_compartment_sits_exactly_once() {
        let n = CompartmentId;
        assert_eq!(seats(2, &vec![vec![n(0)]].into()), Err(PartitionError::Homeless(n(1))));
        assert_eq!(seats(2, &vec![vec![n(0)], vec![n(1), n(0)]].into()), Err(PartitionError::Misplaced(n(0))));
        assert_eq!(seats(1, &vec![vec![n(0), n(1)]].into()), Err(PartitionError::Misplaced(n(1))));
        let both = seats(2, &vec![vec![n(1)], vec![n(0)]].into()).unwrap();
        assert_eq!(both[n(0)], Seat { core: CoreId(1), slot: 0 });
    }
}
