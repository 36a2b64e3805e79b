//! Rules that a finished program keeps, checked on its own tables.
//!
//! In come a [`Program`] and a target; out goes nothing, or the first [`Violation`]. Nothing is taken from the stages that
//! made the program: every count is made again from what the machine would read. `Program::new` has checked that tables
//! are closed; beyond that, of every core (each bullet is a variant of [`Violation`]):
//!
//! - the mesh is the target's (`Mesh`);
//! - an output axon table names each destination core once, in ascending order (`Multicast`);
//! - an input axon's list is not empty (`EmptyAxon`);
//! - formats are distinct, each is used, and its fields can be stored: weights not of 7 bits, the core's index and delay
//!   widths or none (`Format`);
//! - in a list the synapses of one format stand together, and two groups do not differ in density or delay alone
//!   (`Scattered`);
//! - the slots of a dense group follow each other; those of a sparse group ascend and fit its index, and a
//!   group with runs leaves out no more slots than they hold (`Slots`);
//! - a group with delay bits has a delay, and each delay fits (`Delay`);
//! - weights are multiples of their format's least step, in its range (`Weight`);
//! - every resource of [`CoreUsage`] is within its limit (`Excess`).
//!
//! Whether the program says what its network says is for [`crate::compile::check`].

use std::collections::BTreeSet;

use rayon::prelude::*;

use crate::base::fixed::Delay;
use crate::base::id::{CoreId, Id};
use crate::compile::packing::{self, Compression, Group, SKIP_BITS, Widths};
use crate::compile::usage::profiles;
use crate::desc::target::{Limits, Target};
use crate::ir::partition::{CoreUsage, Resource};
use crate::ir::placement::Mesh;
use crate::ir::program::{AxonTarget, CoreFormat, CoreImage, Program, Synapse};

/// A rule that is broken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Violation {
    /// The program is for another board.
    #[error("the program's mesh is not the target's")]
    Mesh,
    /// Messages of one source are not one for each core, ascending.
    #[error("{0} does not name each destination core once, in ascending order")]
    Multicast(String),
    /// A list without synapses.
    #[error("{core}: input axon {axon} has no synapse")]
    EmptyAxon {
        /// The core.
        core: CoreId,
        /// The input axon.
        axon: usize,
    },
    /// A format that cannot be stored, is not used, or is there twice.
    #[error("{core}: synapse format {format} {what}")]
    Format {
        /// The core.
        core: CoreId,
        /// The format's number.
        format: usize,
        /// What is wrong with it.
        what: &'static str,
    },
    /// Synapses of one format that do not stand together.
    #[error("{core}: input axon {axon} has its synapses of one format in several places")]
    Scattered {
        /// The core.
        core: CoreId,
        /// The input axon.
        axon: usize,
    },
    /// Slots that do not suit the format.
    #[error("{core}: input axon {axon}: the slots of a group do not suit its format")]
    Slots {
        /// The core.
        core: CoreId,
        /// The input axon.
        axon: usize,
    },
    /// Delays that do not suit the format.
    #[error("{core}: input axon {axon}: the delays of a group do not suit its format")]
    Delay {
        /// The core.
        core: CoreId,
        /// The input axon.
        axon: usize,
    },
    /// A weight that its format does not have.
    #[error("{core}: input axon {axon}: weight {weight} is not in its format")]
    Weight {
        /// The core.
        core: CoreId,
        /// The input axon.
        axon: usize,
        /// The weight.
        weight: i16,
    },
    /// More of a resource than there is.
    #[error("{core} uses {need} {}, the limit is {limit}", resource.name())]
    Excess {
        /// The core.
        core: CoreId,
        /// The resource.
        resource: Resource,
        /// What it uses.
        need: u64,
        /// What there is.
        limit: u64,
    },
}

/// Checks every rule.
///
/// # Errors
/// The first [`Violation`], by core.
pub fn verify(program: &Program, target: &Target) -> Result<(), Violation> {
    let limits = target.limits();
    if *program.mesh() != Mesh::of(target) {
        return Err(Violation::Mesh);
    }
    for (channel, messages) in program.parts().channels.iter().enumerate() {
        if !ascends(messages) {
            return Err(Violation::Multicast(format!("input channel {channel}")));
        }
    }
    // Threads may finish in any order; the violation of the lowest core is told.
    let found: Vec<Violation> = program
        .cores()
        .as_slice()
        .par_iter()
        .enumerate()
        .filter_map(|(index, image)| verify_core(program, CoreId::new(index), image, limits).err())
        .collect();
    found.into_iter().next().map_or(Ok(()), Err)
}

fn ascends(messages: &[AxonTarget]) -> bool {
    messages.windows(2).all(|pair| pair[0].core < pair[1].core)
}

fn verify_core(program: &Program, core: CoreId, image: &CoreImage, limits: &Limits) -> Result<(), Violation> {
    for (slot, messages) in image.axons_out.iter().enumerate() {
        if !ascends(messages) {
            return Err(Violation::Multicast(format!("compartment {} of {core}", image.ids[slot])));
        }
    }
    let longest = image.synapses.items().iter().map(|s| s.delay).max().unwrap_or(Delay::MIN);
    let widths = Widths::of(image.compartments.len() as u32, longest, limits.packing);
    verify_formats(core, image, widths)?;
    let (mut words, mut widest, mut used) = (0u64, 0u32, BTreeSet::new());
    for (axon, list) in image.synapses.iter().enumerate() {
        if list.is_empty() {
            return Err(Violation::EmptyAxon { core, axon });
        }
        let mut axon_words = 0;
        let mut kinds = BTreeSet::new();
        for group in list.chunk_by(|a, b| a.format == b.format) {
            let format = image.formats[usize::from(group[0].format)];
            used.insert(group[0].format);
            if !kinds.insert(format.synapse) {
                return Err(Violation::Scattered { core, axon });
            }
            verify_group(core, axon, group, format)?;
            let group = Group {
                weight_bits: format.synapse.bits,
                synapses: group.len() as u32,
                delayed: format.delay_bits > 0,
                dense: format.index_bits.is_none(),
                skip: format.skip_bits,
            };
            let compression = match (format.index_bits, format.skip_bits) {
                (None, _) => Compression::Dense,
                (Some(_), Some(bits)) => Compression::RunLength(bits),
                (Some(_), None) => Compression::Sparse,
            };
            axon_words += packing::words_as(group, compression, widths, limits);
        }
        words += u64::from(axon_words);
        widest = widest.max(axon_words);
    }
    if let Some(format) = (0..image.formats.len()).find(|&f| !used.contains(&(f as u8))) {
        return Err(Violation::Format { core, format, what: "is not used" });
    }
    let usage = usage_of(program, image, limits, longest, (words, widest));
    match usage.excesses(limits).next() {
        Some((resource, need, limit)) => Err(Violation::Excess { core, resource, need, limit }),
        None => Ok(()),
    }
}

fn verify_formats(core: CoreId, image: &CoreImage, widths: Widths) -> Result<(), Violation> {
    let mut distinct = BTreeSet::new();
    for (number, format) in image.formats.iter().enumerate() {
        let wrong = |what| Err(Violation::Format { core, format: number, what });
        if !distinct.insert(format) {
            return wrong("is there twice");
        }
        if format.synapse.bits.get() == 7 {
            return wrong("has weights of 7 bits");
        }
        if format.delay_bits != 0 && format.delay_bits != widths.delay {
            return wrong("has delays of another width than its core");
        }
        if format.index_bits.is_some_and(|bits| bits != widths.index) {
            return wrong("has indices of another width than its core");
        }
        if format.skip_bits.is_some_and(|bits| format.index_bits.is_none() || !SKIP_BITS.contains(&bits)) {
            return wrong("has runs of a width that cannot be stored");
        }
    }
    Ok(())
}

fn verify_group(core: CoreId, axon: usize, group: &[Synapse], format: CoreFormat) -> Result<(), Violation> {
    let in_order = match format.index_bits {
        None => group.windows(2).all(|pair| u32::from(pair[1].slot) == u32::from(pair[0].slot) + 1),
        Some(bits) => {
            group.windows(2).all(|pair| pair[0].slot <= pair[1].slot)
                && group.iter().all(|s| u32::from(s.slot) < 1 << bits)
        }
    };
    // A run holds the slots left out, so no slot stands twice and no gap is wider than it can say.
    let holds = |bits: u8| {
        group.windows(2).all(|pair| {
            u32::from(pair[1].slot).checked_sub(u32::from(pair[0].slot) + 1).is_some_and(|gap| gap < 1 << bits)
        })
    };
    if !in_order || !format.skip_bits.is_none_or(holds) {
        return Err(Violation::Slots { core, axon });
    }
    let longest = group.iter().map(|s| s.delay.get()).max().unwrap_or(0);
    if (longest > 0) != (format.delay_bits > 0) || u32::from(longest) >= 1 << format.delay_bits {
        return Err(Violation::Delay { core, axon });
    }
    let (low, high) = format.synapse.sign.range(format.synapse.bits);
    let step = format.synapse.sign.step(format.synapse.bits);
    match group.iter().find(|s| !(low..=high).contains(&s.weight) || s.weight % step != 0) {
        Some(synapse) => Err(Violation::Weight { core, axon, weight: synapse.weight }),
        None => Ok(()),
    }
}

fn usage_of(
    program: &Program,
    image: &CoreImage,
    limits: &Limits,
    longest: Delay,
    (words, widest): (u64, u32),
) -> CoreUsage {
    let compartments = image.compartments.len() as u32;
    let slots = |message: &AxonTarget| {
        if program.cores()[message.core].site.chip == image.site.chip {
            limits.axon_out_slots
        } else {
            limits.axon_out_slots_off_chip
        }
    };
    let distinct = image.compartments.iter().map(|c| profiles(&c.neuron));
    let (profiles, thresholds): (BTreeSet<_>, BTreeSet<_>) = distinct.unzip();
    CoreUsage {
        compartments,
        axons_in: image.synapses.len() as u32,
        axons_out: image.axons_out.items().iter().map(slots).sum(),
        axons_out_per_compartment: image.axons_out.iter().map(|list| list.len() as u32).max().unwrap_or(0),
        synapses: image.synapses.items().len() as u64,
        synapse_words: words,
        synapse_words_per_axon: widest,
        synapse_formats: image.formats.len() as u32,
        compartment_profiles: profiles.len() as u32,
        threshold_profiles: thresholds.len() as u32,
        accumulators: compartments.saturating_mul(packing::delay_slots(longest)),
    }
}
