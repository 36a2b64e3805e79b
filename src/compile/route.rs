//! From seats and sites to tables: the program.
//!
//! In come a network, its partition and placement; out goes a [`Program`]. Each source sends one message to each core that
//! holds a target of it, the own core included; there an input axon of its own leads to the list of its synapses.
//! Input axons of a core are numbered by source: channels in order, then compartments in order. A list is sorted by
//! format, then slot, delay and weight; formats are numbered as they first appear. Widths are those of
//! [`crate::compile::packing`].

use crate::base::fixed::Delay;
use crate::base::id::{CompartmentId, CoreId, IdVec};
use crate::compile::fanout::{self, Formats};
use crate::compile::packing::Widths;
use crate::compile::usage::longest_delays;
use crate::desc::target::Limits;
use crate::ir::partition::Partition;
use crate::ir::placement::{Placement, Site};
use crate::ir::program::{AxonTarget, Compartment, CoreFormat, CoreImage, Lists, Parts, Program, Synapse};
use crate::ir::quantised::{Quantised, SpikeSource, Units};

/// A core's image while lists are appended to it.
struct Growing {
    image: CoreImage,
    widths: Widths,
}

/// The program of a network on its places.
///
/// # Errors
/// A sentence when the tables contradict each other or a core has more formats than can be numbered: a fault of the
/// stages before, whose limits exclude it.
pub fn route(
    network: &Quantised,
    partition: &Partition,
    placement: &Placement,
    limits: &Limits,
) -> Result<Program, String> {
    if partition.cores() != placement.len() {
        return Err("the partition and the placement have different numbers of cores".to_string());
    }
    let mut cores = images(network, partition, placement, limits);
    let formats = Formats::of(network);
    let mut channels = Lists::default();
    let mut messages: Lists<AxonTarget> = Lists::default();
    let (mut reaches, mut targets) = (Vec::new(), Vec::new());
    for (source, place) in fanout::sources(network) {
        fanout::collect(network, &formats, partition.seats(), place, &mut reaches);
        targets.clear();
        for axon in reaches.chunk_by(|a, b| a.core == b.core) {
            let core = axon[0].core;
            let Growing { image, widths } = &mut cores[core];
            let number = u16::try_from(image.synapses.len()).map_err(|_| format!("{core} has too many input axons"))?;
            targets.push(AxonTarget { core, axon: number });
            // A list is pushed group by group into a small buffer first, because each group has its own format.
            let mut list = Vec::with_capacity(axon.len());
            for group in fanout::groups(axon) {
                let format = number_of(&mut image.formats, format_of(group, &formats, *widths))
                    .ok_or_else(|| format!("{core} has too many synapse formats"))?;
                for reach in group {
                    let delay = Delay::new(reach.delay.into()).map_err(|e| e.to_string())?;
                    list.push(Synapse { slot: reach.slot, weight: reach.weight, format, delay });
                }
            }
            image.synapses.push(list);
        }
        match source {
            SpikeSource::Channel(_) => channels.push(targets.iter().copied()),
            SpikeSource::Compartment(_) => messages.push(targets.iter().copied()),
        }
    }
    let cores = cores
        .as_mut_slice()
        .iter_mut()
        .map(|growing| {
            // Compartments sit in slots in any order; their messages move to their slots.
            let image = &mut growing.image;
            for id in &image.ids {
                image.axons_out.push(messages.get(id.0 as usize).iter().copied());
            }
            image.synapses.shrink_to_fit();
            image.axons_out.shrink_to_fit();
            std::mem::replace(image, empty(image.site))
        })
        .collect();
    let populations = network
        .populations()
        .iter()
        .map(|population| population.first_compartment().map(|first| (first, population.shape.len())))
        .collect();
    let parts = network.parts();
    Program::new(Parts {
        mesh: *placement.mesh(),
        cores,
        channels,
        seats: partition.seats().clone(),
        populations,
        output: parts.output,
        semantics: parts.semantics,
        threshold: parts.threshold,
        reset: parts.reset,
    })
    .map_err(|error| error.to_string())
}

fn empty(site: Site) -> CoreImage {
    CoreImage {
        site,
        compartments: Vec::new(),
        ids: Vec::new(),
        formats: Vec::new(),
        synapses: Lists::default(),
        axons_out: Lists::default(),
    }
}

/// Images with their compartments, and the widths of their synapses.
fn images(
    network: &Quantised,
    partition: &Partition,
    placement: &Placement,
    limits: &Limits,
) -> IdVec<CoreId, Growing> {
    let mut parameters: IdVec<CompartmentId, Option<Compartment>> = vec![None; network.compartments() as usize].into();
    for population in network.populations() {
        let Units::Loihi { first, neurons, start_step } = &population.units else { continue };
        for index in 0..population.shape.len() {
            let compartment = Compartment { neuron: neurons.get(index), start_step: *start_step };
            parameters[CompartmentId(first.0 + index)] = Some(compartment);
        }
    }
    let longest = longest_delays(network, partition.seats(), partition.cores());
    partition
        .members()
        .enumerate()
        .map(|(core, held)| Growing {
            widths: Widths::of(held.len() as u32, longest[core], limits.packing),
            image: CoreImage {
                ids: held.clone(),
                compartments: held.iter().filter_map(|&id| parameters[id]).collect(),
                ..empty(placement.site(core))
            },
        })
        .collect()
}

/// The format that a group is stored in.
fn format_of(group: &[fanout::Reach], formats: &Formats, widths: Widths) -> CoreFormat {
    let delayed = group.iter().any(|reach| reach.delay > 0);
    CoreFormat {
        synapse: formats.get(group[0].format),
        delay_bits: if delayed { widths.delay } else { 0 },
        index_bits: (!fanout::is_dense(group)).then_some(widths.index),
    }
}

/// The number of a format on its core, which is new when the core has not had it yet.
fn number_of(formats: &mut Vec<CoreFormat>, format: CoreFormat) -> Option<u8> {
    let known = formats.iter().position(|&f| f == format);
    let number = known.unwrap_or_else(|| {
        formats.push(format);
        formats.len() - 1
    });
    u8::try_from(number).ok()
}
