//! Whether a network is mapped synapse by synapse or by its kernels.

use std::borrow::Cow;

use crate::strategy::lattice::layers;
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::hardware::Target;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Limits, OutputAxons};

/// Synapses, of all copies, above which a network of layers is mapped by its kernels: the tables of
/// twice as many take two gigabytes, and building them several more.
pub const MOST_WRITTEN: u64 = 1 << 28;

/// Synapses, of all copies, above which a network that is mapped by its kernels is not run: its
/// messages and rows of weights take a byte or two for each.
pub const MOST_RUN: u64 = 1 << 32;

/// How a network is mapped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// Every synapse is counted and written.
    Written,
    /// Layers are cut into boxes and counted from the geometry of their kernels. Tables are written
    /// once for all boxes of a class (`nsim_compile::emit::boxes`).
    Symbolic,
}

impl Form {
    /// The form of this many copies of a network: symbolic when it has more than [`MOST_WRITTEN`]
    /// synapses and consists of layers, so that it can be.
    pub fn for_network(one: &Quantised, copies: u32) -> Form {
        let synapses = one.synapses().saturating_mul(u64::from(copies));
        match synapses > MOST_WRITTEN && layers(one).is_some() {
            true => Form::Symbolic,
            false => Form::Written,
        }
    }

    /// The target as mappings of this form are counted on it: where sources without places are
    /// gathered in population axons, boxes have an output axon for each compartment, because
    /// geometry tells of windows only which positions share a table.
    #[must_use]
    pub fn counted_on<'t>(self, network: &Quantised, target: &'t Target) -> Cow<'t, Target> {
        if self == Form::Written || !network.parts().gathers {
            return Cow::Borrowed(target);
        }
        let limits = Limits { output_axons: OutputAxons::PerCompartment, ..target.limits().clone() };
        Cow::Owned(target.clone().with_limits(limits))
    }

    /// Refuses `what`, which needs every synapse, for a network that is mapped by its kernels.
    ///
    /// # Errors
    /// `map.described`.
    pub fn require_written(what: &str, one: &Quantised, copies: u32) -> Result<(), Diagnostic> {
        match Form::for_network(one, copies) {
            Form::Written => Ok(()),
            Form::Symbolic => Err(too_many(&format!("{what} needs every synapse"), one, copies, MOST_WRITTEN)),
        }
    }

    /// Refuses to run a network whose program would take too much memory even where its kernels are
    /// written once.
    ///
    /// # Errors
    /// `map.described`.
    pub fn require_program(self, one: &Quantised, copies: u32) -> Result<(), Diagnostic> {
        match self {
            Form::Symbolic if one.synapses().saturating_mul(u64::from(copies)) > MOST_RUN => {
                Err(too_many("running it on cores needs the program", one, copies, MOST_RUN))
            }
            _ => Ok(()),
        }
    }
}

fn too_many(what: &str, one: &Quantised, copies: u32, most: u64) -> Diagnostic {
    let synapses = one.synapses().saturating_mul(u64::from(copies));
    let message = format!("{what} of {} written out: {synapses} synapses, more than {most}", one.parts().name);
    let help = "nsim map maps such a network by its kernels, with --svg, --pareto and -o; nsim run and nsim energy run \
                it up to 2^32 synapses, nsim run --engine reference one copy of it in real numbers; for all else make \
                it smaller, or map fewer copies";
    Diagnostic::new("map.described", message).help(help)
}
