//! Compartments of each core, before and after their limits are checked.

use crate::error::CompileError;
use crate::reason::Reason;
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Limits;

/// Compartments of each core, in slot order.
pub type Members = IdVec<CoreId, Vec<CompartmentId>>;

/// The chip of each core when cores are placed chip by chip.
pub fn row_of_chips(cores: usize, target: &Target) -> IdVec<CoreId, u32> {
    (0..cores as u32).map(|core| core / target.chip().cores).collect()
}

/// Returns a partition of given members, with their resource use.
///
/// # Errors
/// [`CompileError::DoesNotFit`] with a reason for each limit that a core exceeds;
/// [`CompileError::Fault`] when a compartment is not on exactly one core.
pub fn partition_of(
    network: &Quantised,
    members: Members,
    usage: IdVec<CoreId, CoreUsage>,
    limits: &Limits,
) -> Result<Partition, CompileError> {
    let excesses = usage.enumerate().flat_map(|(core, used)| used.excesses(limits).map(move |excess| (core, excess)));
    let reason = |(core, (resource, need, limit))| Reason::of_core(core, resource, need, limit);
    let reasons: Vec<Reason> = excesses.map(reason).collect();
    if !reasons.is_empty() {
        return Err(CompileError::DoesNotFit(reasons));
    }
    Partition::new(network.compartments(), members, usage, limits).map_err(CompileError::fault)
}
