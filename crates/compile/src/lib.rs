//! From a network in integers to a program for the cores of a target.
//!
//! Input: a network in integers, a [`Target`], [`Options`]. Output: a [`Mapping`], or every reason
//! for which the network does not fit. `nsim_check`, which the stages before do not use, has
//! verified its limits and compared its synapses with the network's. [`map()`] makes one mapping;
//! [`explore::map`] compares several for an objective.

pub mod emit;
pub mod explore;
pub mod groups;
pub mod mapping;
pub mod mapping_file;
#[cfg(test)]
mod pilotnet_tests;
pub mod place;
#[cfg(test)]
mod prune_tests;
pub mod spread;
pub mod stages;
#[cfg(test)]
mod tests;

use crate::spread::spread;
use nsim_ir::firing_rates::Rates;
use nsim_ir::hardware::Target;
use nsim_ir::mapping::MappingFile;
use nsim_partition::error::Result;

pub use mapping::Mapping;
pub use nsim_partition::error::CompileError;
pub use nsim_partition::large::{is_large, refuse_large, refuse_to_run};
pub use nsim_partition::options::{
    CopyPlacement, DEFAULT_EFFORT_S, DEFAULT_RATE, Effort, Objective, Options, Strategy,
};
pub use nsim_partition::reason::{Reason, Tightest};
pub use stages::{AddedRelays, Front, Partitioned, Placed, Unchecked};

/// Returns a mapping by one partition and one placement, for these firing rates of one copy.
///
/// # Errors
/// [`CompileError`].
pub fn map(front: Front, target: &Target, options: &Options, rates: &Rates) -> Result<Mapping> {
    place(front, target, options, rates)?.emit(target, options)?.check(target)
}

/// The stages of [`map()`] up to the placement.
fn place(front: Front, target: &Target, options: &Options, rates: &Rates) -> Result<Placed> {
    let one = |front: Front, options: &Options| {
        let placed = place(front, target, options, rates)?;
        Ok((placed.partitioned.partition.to_members(), placed.placement, placed.name))
    };
    if let Some(spread) = spread(&front, target, options, rates, one)? {
        return Ok(spread);
    }
    front.partition(target, options, rates)?.place(target, options)
}

/// Returns the mapping of a file, checked as any other. The network is pruned as it was for the
/// file, whose number of copies `options` must have.
///
/// # Errors
/// [`CompileError`].
pub fn load(front: impl Into<Front>, target: &Target, options: &Options, file: &MappingFile) -> Result<Mapping> {
    front.into().place_as(target, options, file)?.emit(target, options)?.check(target)
}

/// Maps a network: [`map`] at the default rate.
///
/// # Errors
/// [`CompileError`].
pub fn compile(front: impl Into<Front>, target: &Target, options: &Options) -> Result<Mapping> {
    let front = front.into();
    refuse_to_run(front.quantised(), options.copies)?;
    map(front, target, options, &Rates::assumed(DEFAULT_RATE))
}
