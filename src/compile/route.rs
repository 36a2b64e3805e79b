//! From seats and sites to tables: the program.
//!
//! In come a network, its partition and placement; out goes a [`Program`]. Each source sends one message to each core that
//! holds a target of it, the own core included; there an input axon of its own leads to the list of its synapses.
//! Input axons of a core are numbered by source: channels in order, then compartments in order. A list is sorted by
//! format, then slot, delay and weight; formats are numbered as they first appear. Widths are those of
//! [`crate::compile::packing`].
//!
//! Cores are written down in parallel, from their own synapses alone; then messages are sorted from cores to sources, a
//! range of sources each.

use rayon::prelude::*;

use crate::base::fixed::Delay;
use crate::base::id::{CompartmentId, CoreId, Id};
use crate::compile::formats::Formats;
use crate::compile::gather::{self, Key};
use crate::compile::packing::{self, Compression, Widths};
use crate::compile::usage::{Tallies, group_of, longest_delays};
use crate::desc::target::Limits;
use crate::ir::partition::Partition;
use crate::ir::placement::Placement;
use crate::ir::program::{AxonTarget, Compartment, CoreFormat, CoreImage, Lists, Parts, Program, Synapse};
use crate::ir::quantised::{Quantised, Units};

/// Sources whose messages are sorted by one task.
const PIECE: u32 = 1 << 14;

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
    let formats = Formats::of(network);
    let longest = longest_delays(network, partition.seats(), partition.cores());
    let written = gather::by_core(network, &formats, partition.seats(), partition.cores(), |core, keys| {
        let held = &partition.members()[core];
        let widths = Widths::of(held.len() as u32, longest[core], limits.packing);
        let runs = Tallies::of(keys, &formats, widths, limits).runs(limits);
        let (formats, synapses, sources) = write_lists(core, keys, &formats, widths, runs.then_some(limits))?;
        let image = CoreImage {
            site: placement.site(core),
            compartments: compartments(network, held),
            ids: held.clone(),
            formats,
            synapses,
            axons_out: Lists::default(),
        };
        Ok::<_, String>((image, sources))
    });
    let (mut cores, mut sources) = (Vec::with_capacity(written.len()), Vec::with_capacity(written.len()));
    for core in written {
        let (image, of_core) = core?;
        cores.push(image);
        sources.push(of_core);
    }
    let (channels, compartments) = (network.channels(), network.compartments());
    let messages = messages(&sources, channels, compartments);
    drop(sources);
    cores.par_iter_mut().for_each(|image| {
        let of = |id: &CompartmentId| messages.compartments[(id.0 / PIECE) as usize].get((id.0 % PIECE) as usize);
        for id in &image.ids {
            image.axons_out.push(of(id).iter().copied());
        }
        image.axons_out.shrink_to_fit();
    });
    let populations = network
        .populations()
        .iter()
        .map(|population| population.first_compartment().map(|first| (first, population.shape.len())))
        .collect();
    let parts = network.parts();
    Program::new(Parts {
        mesh: *placement.mesh(),
        cores: cores.into(),
        channels: messages.channels,
        seats: partition.seats().clone(),
        populations,
        output: parts.output,
        semantics: parts.semantics,
        threshold: parts.threshold,
        reset: parts.reset,
    })
    .map_err(|error| error.to_string())
}

/// Parameters of compartments in slot order.
fn compartments(network: &Quantised, held: &[CompartmentId]) -> Vec<Compartment> {
    let mut known = None;
    held.iter()
        .filter_map(|&id| {
            // Neighbours mostly are of one population.
            let inside = |population: &crate::base::id::PopulationId| {
                let population = &network.populations()[*population];
                population
                    .first_compartment()
                    .is_some_and(|first| id.0.checked_sub(first.0).is_some_and(|index| index < population.shape.len()))
            };
            let population = known.filter(inside).unwrap_or_else(|| network.population_of(id).0);
            known = Some(population);
            let Units::Loihi { first, neurons, start_step } = &network.populations()[population].units else {
                return None;
            };
            Some(Compartment { neuron: neurons.get(id.0 - first.0), start_step: *start_step })
        })
        .collect()
}

/// The formats of a core, its lists by input axon, and the source of each input axon.
type Written = (Vec<CoreFormat>, Lists<Synapse>, Vec<u32>);

/// What a core keeps of its synapses; with run-length lists where that takes fewer words, if limits are given.
fn write_lists(
    core: CoreId,
    keys: &[Key],
    formats: &Formats,
    widths: Widths,
    runs: Option<&Limits>,
) -> Result<Written, String> {
    let (mut known, mut sources): (Vec<CoreFormat>, Vec<u32>) = (Vec::new(), Vec::new());
    let mut synapses = Lists::with_capacity(0, keys.len());
    for list in gather::lists(keys) {
        if sources.len() > usize::from(u16::MAX) {
            return Err(format!("{core} has too many input axons"));
        }
        sources.push(list[0].source());
        for group in gather::groups(list) {
            let (format, made) = group_of(group, formats);
            let format = CoreFormat {
                synapse: formats.get(format),
                delay_bits: if made.delayed { widths.delay } else { 0 },
                index_bits: (!made.dense).then_some(widths.index),
                skip_bits: match runs.map(|limits| packing::best(made, widths, limits).0) {
                    Some(Compression::RunLength(bits)) => Some(bits),
                    _ => None,
                },
            };
            let number = number_of(&mut known, format).ok_or_else(|| format!("{core} has too many synapse formats"))?;
            for key in group {
                let delay = Delay::new(key.delay().into()).map_err(|e| e.to_string())?;
                let synapse = Synapse { slot: key.slot(), weight: key.weight(), format: number, delay };
                synapses.extend_last([synapse]);
            }
        }
        synapses.end();
    }
    synapses.shrink_to_fit();
    Ok((known, synapses, sources))
}

/// Messages by source.
struct Messages {
    channels: Lists<AxonTarget>,
    /// In pieces of [`PIECE`] compartments.
    compartments: Vec<Lists<AxonTarget>>,
}

/// Sorts what cores know, the sources of their input axons, by source.
fn messages(sources: &[Vec<u32>], channels: u32, compartments: u32) -> Messages {
    let of_range = |from: u32, to: u32| {
        let mut counts = vec![0u32; (to - from) as usize];
        let part = |of_core: &Vec<u32>| {
            (of_core.partition_point(|&source| source < from), of_core.partition_point(|&source| source < to))
        };
        let parts: Vec<(usize, usize)> = sources.iter().map(part).collect();
        for (of_core, &(low, high)) in sources.iter().zip(&parts) {
            of_core[low..high].iter().for_each(|source| counts[(source - from) as usize] += 1);
        }
        let mut lists = Lists::from_counts(&counts, AxonTarget { core: CoreId(0), axon: 0 });
        for (core, (of_core, &(low, high))) in sources.iter().zip(&parts).enumerate() {
            for (axon, &source) in (low..high).zip(&of_core[low..high]) {
                // Counts now say how many are still to come; cores ascend, so lists do.
                let source = (source - from) as usize;
                let place = lists.get(source).len() - counts[source] as usize;
                lists.get_mut(source)[place] = AxonTarget { core: CoreId::new(core), axon: axon as u16 };
                counts[source] -= 1;
            }
        }
        lists
    };
    let pieces = |from: u32, count: u32| {
        let of = move |piece: u32| (from + piece * PIECE, from + ((piece + 1) * PIECE).min(count));
        (0..count.div_ceil(PIECE)).into_par_iter().map(of)
    };
    let of_channels: Vec<Lists<AxonTarget>> = pieces(0, channels).map(|(from, to)| of_range(from, to)).collect();
    let mut all = Lists::default();
    of_channels.iter().flat_map(Lists::iter).for_each(|list| all.push(list.iter().copied()));
    all.shrink_to_fit();
    let of_compartments = pieces(channels, compartments).map(|(from, to)| of_range(from, to)).collect();
    Messages { channels: all, compartments: of_compartments }
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
