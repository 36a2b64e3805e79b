//! Resources that a network needs by its shapes alone: refuses a network that no mapping fits,
//! before it is generated or expanded.
//!
//! Input: a model as written, a target. Output: the reasons for which it cannot fit, if any. A
//! dense or random projection takes at least the bits of its weights in the synapse memory of its
//! target cores. At least one compartment of a population needs the mean over the population, or
//! more. Later stages check everything else, and report errors of the model.

use std::collections::HashMap;

use nsim_compile::{CompileError, Reason};
use nsim_files::network::{Network, ProjectionKind};
use nsim_ir::graph::MOST_UNITS;
use nsim_ir::hardware::Target;
use nsim_ir::resource::Resource;

/// Bits of a synapse word.
const WORD: u128 = 64;
/// Networks of fewer synapses are mapped in about a second, and mapping gives every reason.
const SMALL: u128 = 1 << 24;

/// Refuses a large network if a compartment needs more synapse memory than a core has, or all
/// synapses need more cores than the target has.
///
/// # Errors
/// [`CompileError::DoesNotFit`].
pub fn check(network: &Network, target: &Target, copies: u32) -> Result<(), CompileError> {
    let file = network.file();
    let limit = u64::from(target.limits()[Resource::SynapseWords]);
    let sizes = file.populations.iter().filter_map(|population| {
        let units = population.shape.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))?;
        Some((population.name.as_str(), units))
    });
    let sizes: HashMap<&str, u64> = sizes.collect();
    // Lowering refuses a population that is too large for any network.
    if sizes.len() < file.populations.len() || sizes.values().any(|&size| size > MOST_UNITS) {
        return Ok(());
    }
    let mut bits: HashMap<&str, u128> = HashMap::new();
    let mut all = 0u128;
    for projection in &file.projections {
        let sources: u128 =
            projection.from.iter().filter_map(|name| sizes.get(name.as_str())).map(|&n| u128::from(n)).sum();
        let Some(&targets) = sizes.get(projection.to.as_str()) else { continue };
        let synapses = match &projection.kind {
            ProjectionKind::Dense(_) => sources.saturating_mul(targets.into()),
            ProjectionKind::Random { fan_out, .. } => sources.saturating_mul((*fan_out).into()),
            _ => 0,
        };
        let width = u128::try_from(projection.weight_bits).unwrap_or(1).clamp(1, 8);
        all = all.saturating_add(synapses);
        let sum = bits.entry(projection.to.as_str()).or_default();
        *sum = sum.saturating_add(synapses.saturating_mul(width));
    }
    if all < SMALL {
        return Ok(());
    }
    let mut reasons = Vec::new();
    let words = bits.values().fold(0u128, |sum, &bits| sum.saturating_add(bits)) / WORD * u128::from(copies);
    let cores = u64::try_from(words.div_ceil(u128::from(limit.max(1)))).unwrap_or(u64::MAX);
    if cores > u64::from(target.cores()) {
        reasons.push(Reason::of_cores(target, copies, cores));
    }
    for population in &file.populations {
        let name = population.name.as_str();
        let (Some(&bits), Some(&size)) = (bits.get(name), sizes.get(name).filter(|&&size| size > 0)) else { continue };
        let need = u64::try_from((bits / u128::from(size)).div_ceil(WORD)).unwrap_or(u64::MAX);
        if need > limit {
            reasons.push(Reason::of_named(name, Resource::SynapseWords, need, limit));
        }
    }
    if reasons.is_empty() { Ok(()) } else { Err(CompileError::DoesNotFit(reasons)) }
}
