//! Compartments of each core, before and after their limits are checked.

use crate::error::{CompileError, Result};
use crate::reason::Reason;
use crate::resources::exact::Usages;
use crate::resources::fan_out::ChipOf;
pub use crate::resources::fan_out::Members;
use nsim_ir::hardware::Target;
use nsim_ir::partition::Partition;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::Limits;

/// The chip of each core when cores are placed chip by chip.
pub fn row_of_chips(cores: usize, target: &Target) -> ChipOf {
    (0..cores as u32).map(|core| core / target.chip().cores).collect()
}

/// Returns a partition of given members, with their resource use.
///
/// # Errors
/// [`CompileError::DoesNotFit`] with a reason for each limit that a core exceeds;
/// [`CompileError::Fault`] when a compartment is not on exactly one core.
pub fn partition_of(network: &Quantised, members: Members, usage: Usages, limits: &Limits) -> Result<Partition> {
    let excesses = usage.enumerate().flat_map(|(core, used)| used.excesses(limits).map(move |excess| (core, excess)));
    let reasons: Vec<Reason> =
        excesses.map(|(core, (resource, need, limit))| Reason::of_core(core, resource, need, limit)).collect();
    if !reasons.is_empty() {
        return Err(CompileError::DoesNotFit(reasons));
    }
    Partition::new(network.compartments(), members, usage, limits).map_err(CompileError::fault)
}
