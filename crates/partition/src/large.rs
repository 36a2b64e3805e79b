//! Networks of layers that are too large to be counted synapse by synapse.
//!
//! They are cut into boxes ([`crate::strategy::boxes`]), which are counted from the geometry of
//! kernels. Later stages are common to all networks.

use std::borrow::Cow;

use crate::strategy::lattice::layers;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Limits, OutputAxons};

/// Number of synapses, of all copies, above which a network of layers is cut into boxes. Counting
/// takes eight bytes a synapse, two gigabytes at this number.
pub const MOST_COUNTED: u64 = 1 << 28;

/// Number of synapses, of all copies, above which a network is not run. Its messages and rows of
/// weights take a byte or two a synapse.
pub const MOST_RUN: u64 = 1 << 32;

fn synapses(one: &Quantised, copies: u32) -> u64 {
    one.synapses().saturating_mul(u64::from(copies))
}

/// Whether this number of copies of a network is cut into boxes.
pub fn is_large(one: &Quantised, copies: u32) -> bool {
    synapses(one, copies) > MOST_COUNTED && layers(one).is_some()
}

/// The target with the output axon rule under which boxes are counted. Where sources without places
/// are grouped into population axons, boxes count an output axon for each compartment. Only windows
/// show by their geometry the positions that share a table.
#[must_use]
pub fn counted_in_boxes<'t>(in_boxes: bool, network: &Quantised, target: &'t Target) -> Cow<'t, Target> {
    if !in_boxes || !network.parts().gathers {
        return Cow::Borrowed(target);
    }
    let limits = Limits { output_axons: OutputAxons::PerCompartment, ..target.limits().clone() };
    Cow::Owned(target.clone().with_limits(limits))
}

/// Refuses `what`, which needs every synapse, for a network that is cut into boxes.
///
/// # Errors
/// `map.described`.
pub fn refuse_large(what: &str, one: &Quantised, copies: u32) -> Result<(), Diagnostic> {
    match is_large(one, copies) {
        false => Ok(()),
        true => Err(too_many(&format!("{what} enumerates every synapse"), one, copies, MOST_COUNTED)),
    }
}

/// Refuses to run a network of layers whose program would take too much memory even where its
/// kernels are written once.
///
/// # Errors
/// `map.described`.
pub fn refuse_to_run(one: &Quantised, copies: u32) -> Result<(), Diagnostic> {
    match synapses(one, copies) > MOST_RUN && is_large(one, copies) {
        true => Err(too_many("running it on cores needs a program", one, copies, MOST_RUN)),
        false => Ok(()),
    }
}

fn too_many(what: &str, one: &Quantised, copies: u32, most: u64) -> Diagnostic {
    let synapses = synapses(one, copies);
    let message = format!("{what} of {}: {synapses} synapses, more than {most}", one.parts().name);
    let help = "nsim map maps such a network by its kernels, with --svg, --pareto and -o. nsim run and nsim energy run \
                up to 2^32 synapses, nsim run --engine reference runs one copy in real numbers. Otherwise make the \
                network smaller, or map fewer copies";
    Diagnostic::new("map.described", message).help(help)
}
