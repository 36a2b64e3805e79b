//! Which copies of a program are another copy's over again: the rule *Copies* of [`crate::compile::check::equivalence`].
//!
//! Input: a network of equal copies and a program for it. Output: for each copy whether it is proven from one before it, which is not
//! itself proven from another. Nothing is assumed of how either was made: the network's copies are compared too.

use std::collections::HashMap;
use std::sync::Arc;

use crate::base::id::{ChannelId, CompartmentId, CoreId, IdVec, PopulationId, ProjectionId};
use crate::ir::partition::Seat;
use crate::ir::program::{AxonTarget, CoreImage, Program};
use crate::ir::quantised::connectivity::Connectivity;
use crate::ir::quantised::{Population, Projection, Quantised, Units};

/// Sizes of one copy.
#[derive(Debug, Clone, Copy)]
struct Sizes {
    populations: u32,
    projections: u32,
    channels: u32,
    compartments: u32,
}

/// Whether each copy is proven from one before it.
#[must_use]
pub fn proven(network: &Quantised, program: &Program, copies: u32) -> Vec<bool> {
    let counts = [
        network.populations().len() as u32,
        network.projections().len() as u32,
        network.channels(),
        network.compartments(),
    ];
    let mut proven = vec![false; copies.max(1) as usize];
    if copies < 2 || counts.iter().any(|count| count % copies != 0) {
        return proven;
    }
    let [populations, projections, channels, compartments] = counts.map(|count| count / copies);
    let sizes = Sizes { populations, projections, channels, compartments };
    if compartments == 0 {
        return proven;
    }
    let cores = Cores::new(program, sizes);
    for copy in 1..copies {
        // Copies alike sit on cores alike, so the seat of the first compartment says which copy to compare with.
        let core = program.seats()[CompartmentId(copy * compartments)].core;
        let (first, later) = cores.of[core];
        let Some(like) = copy.checked_sub(later).filter(|_| first != core) else { continue };
        let same =
            same_network(network, like, copy, sizes) && same_messages(network, program, &cores, like, copy, sizes);
        proven[copy as usize] = same && !proven[like as usize];
    }
    proven
}

/// For each core the first that it repeats, and how many copies later; itself where it repeats none.
struct Cores {
    of: IdVec<CoreId, (CoreId, u32)>,
}

impl Cores {
    fn new(program: &Program, sizes: Sizes) -> Self {
        // Many cores hold the same lists where several kinds of cores are alike in them.
        let mut known: HashMap<(usize, u32), CoreId> = HashMap::new();
        let copy_of = |image: &CoreImage| image.ids.iter().map(|id| id.0 / sizes.compartments).min().unwrap_or(0);
        let of = |(core, image): (CoreId, &CoreImage)| {
            let copy = copy_of(image);
            let within = image.ids.first().map_or(0, |id| id.0 - copy * sizes.compartments);
            let first = *known.entry((image.inputs.address(), within)).or_insert(core);
            let of_first = &program.cores()[first];
            match copy.checked_sub(copy_of(of_first)) {
                Some(later) if is_later(program, (core, image), of_first, later * sizes.compartments) => (first, later),
                _ => (core, 0),
            }
        };
        Cores { of: program.cores().enumerate().map(of).collect() }
    }

    /// Whether a core is another so many copies later.
    fn repeats(&self, core: CoreId, like: CoreId, later: u32) -> bool {
        let ((first, at), (first_of_like, at_of_like)) = (self.of[core], self.of[like]);
        first == first_of_like && at == at_of_like + later
    }
}

/// Whether a core has the lists, formats and parameters of another and its compartments so many numbers later, at their seats.
fn is_later(program: &Program, (core, image): (CoreId, &CoreImage), like: &CoreImage, more: u32) -> bool {
    let seat = |slot: usize, id: &CompartmentId| program.seats()[*id] == Seat { core, slot: slot as u16 };
    image.inputs.is_same(&like.inputs)
        && image.formats == like.formats
        && image.compartments == like.compartments
        && image.ids.len() == like.ids.len()
        && image.ids.iter().zip(&like.ids).all(|(id, like)| id.0 == like.0 + more)
        && image.ids.iter().enumerate().all(|(slot, id)| seat(slot, id))
}

/// Whether a copy of the network is another, its units numbered later.
fn same_network(network: &Quantised, like: u32, copy: u32, sizes: Sizes) -> bool {
    let later = copy - like;
    let population = |n: u32| {
        let [one, other] = [like, copy].map(|k| &network.populations()[PopulationId(k * sizes.populations + n)]);
        same_population(one, other, later, sizes)
    };
    let projection = |n: u32| {
        let [one, other] = [like, copy].map(|k| &network.projections()[ProjectionId(k * sizes.projections + n)]);
        let of_copy = |id: PopulationId| id.0 / sizes.populations == like;
        of_copy(one.source) && of_copy(one.target) && same_projection(one, other, later * sizes.populations)
    };
    (0..sizes.populations).all(population) && (0..sizes.projections).all(projection)
}

fn same_population(one: &Population, other: &Population, later: u32, sizes: Sizes) -> bool {
    let units = match (&one.units, &other.units) {
        (Units::Input(one), Units::Input(other)) => other.0 == one.0 + later * sizes.channels,
        (Units::Compartments { first: one, .. }, Units::Compartments { first: other, .. }) => {
            // Parameters have been compared with the program's, compartment by compartment.
            other.0 == one.0 + later * sizes.compartments
        }
        _ => false,
    };
    units && one.shape == other.shape && one.payload == other.payload
}

fn same_projection(one: &Projection, other: &Projection, later: u32) -> bool {
    other.source.0 == one.source.0 + later
        && other.target.0 == one.target.0 + later
        && one.format == other.format
        && one.delay == other.delay
        && same_connectivity(&one.connectivity, &other.connectivity)
}

/// Whether two lists are the same one, or equal.
fn same<T: PartialEq>(one: &Arc<[T]>, other: &Arc<[T]>) -> bool {
    Arc::ptr_eq(one, other) || one == other
}

fn same_connectivity(one: &Connectivity, other: &Connectivity) -> bool {
    use Connectivity::{Conv2d, Dense, Random, Sparse, SumPool2d};
    match (one, other) {
        (Dense { targets, weights }, Dense { targets: n, weights: w }) => targets == n && same(weights, w),
        (Sparse { first, targets, weights }, Sparse { first: f, targets: t, weights: w }) => {
            same(first, f) && same(targets, t) && same(weights, w)
        }
        (Conv2d { window, kernel }, Conv2d { window: w, kernel: k }) => window == w && same(kernel, k),
        (SumPool2d { window, weight }, SumPool2d { window: w, weight: v }) => window == w && weight == v,
        (
            &Random { targets, fan_out, low, high, step, seed, first_source },
            &Random { targets: t, fan_out: f, low: l, high: h, step: s, seed: d, first_source: o },
        ) => (targets, fan_out, low, high, step, seed, first_source) == (t, f, l, h, s, d, o),
        _ => false,
    }
}

/// The messages of a source's spike.
pub(super) fn messages_of<'a>(program: &'a Program, units: &Units, index: u32) -> &'a [AxonTarget] {
    match units {
        Units::Input(first) => program.channel(ChannelId(first.0 + index)),
        Units::Compartments { first, .. } => {
            let seat = program.seats()[CompartmentId(first.0 + index)];
            program.cores()[seat.core].axons_out.get(usize::from(seat.slot))
        }
    }
}

/// Whether the sources of a copy send what those of another do, to cores that many copies later.
fn same_messages(network: &Quantised, program: &Program, cores: &Cores, like: u32, copy: u32, sizes: Sizes) -> bool {
    let repeats = |(one, other): (&AxonTarget, &AxonTarget)| {
        other.axon == one.axon && cores.repeats(other.core, one.core, copy - like)
    };
    (0..sizes.populations).all(|n| {
        let [one, other] = [like, copy].map(|k| &network.populations()[PopulationId(k * sizes.populations + n)]);
        (0..one.shape.len()).all(|index| {
            let (one, other) = (messages_of(program, &one.units, index), messages_of(program, &other.units, index));
            one.len() == other.len() && one.iter().zip(other).all(repeats)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compile::check::equivalence::{check, check_copies};
    use crate::compile::emit::route::route;
    use crate::compile::testing::{limits, random_network, target};
    use crate::compile::{Options, compile};
    use crate::desc::resource::Resource;
    use crate::ir::program::Parts;

    #[test]
    fn copies_are_written_as_each_by_itself_and_proven_from_one_of_each_kind() {
        let mut proven = 0;
        for seed in 0..24 {
            let copies = [2, 7, 31][seed as usize % 3];
            let most = 20 + seed as u32 % 60;
            let board = target(3, 3, limits().with(Resource::Compartments, most));
            let options = Options { copies, ..Options::default() };
            let Ok(mapped) = compile(random_network(seed), &board, &options) else { continue };
            let (network, limits) = (&mapped.quantised, board.limits());
            let alone = route(network, &mapped.partition, &mapped.placement, (1, None), limits).unwrap();
            assert_eq!(mapped.program, alone, "seed {seed}");
            assert_eq!(
                check_copies(network, &alone, copies),
                Ok(0),
                "seed {seed}: lists that are not shared prove nothing"
            );
            proven += check_copies(network, &mapped.program, copies).unwrap();
        }
        assert!(proven > 60, "{proven} copies were proven from others");
    }

    #[test]
    fn a_change_of_one_copy_is_found() {
        let board = target(3, 3, limits());
        for seed in 0..12 {
            let Ok(mapped) = compile(random_network(seed), &board, &Options { copies: 9, ..Options::default() }) else {
                continue;
            };
            let network = &mapped.quantised;
            let seat = mapped.program.seats()[CompartmentId(5 * mapped.one.compartments())];
            let mut changes: Vec<Parts> = Vec::new();
            let mut change = |f: &dyn Fn(&mut Parts) -> Option<()>| {
                let mut parts = mapped.program.clone().into_parts();
                if f(&mut parts).is_some() {
                    changes.push(parts);
                }
            };
            change(&|parts| {
                let weight = &mut parts.cores[seat.core].inputs.lists.items_mut().first_mut()?.weight;
                *weight += if *weight > 0 { -2 } else { 2 };
                Some(())
            });
            change(&|parts| {
                parts.cores[seat.core].compartments[usize::from(seat.slot)].start_step += 1;
                Some(())
            });
            change(&|parts| {
                // Two messages of the sixth copy's channels to the same core change places.
                let of_copy = parts.channels.len() / 9;
                let messages: Vec<usize> =
                    (5 * of_copy..6 * of_copy).filter(|&channel| !parts.channels.get(channel).is_empty()).collect();
                let (&a, &b) = (messages.first()?, messages.get(1)?);
                let (one, other) = (parts.channels.get(a)[0], parts.channels.get(b)[0]);
                (parts.channels.get_mut(a)[0], parts.channels.get_mut(b)[0]) = (other, one);
                (network_differs(network, a as u32, b as u32)).then_some(())
            });
            for parts in changes {
                let Ok(program) = Program::new(parts) else { continue };
                assert!(check(network, &program).is_err(), "seed {seed}");
                assert!(check_copies(network, &program, 9).is_err(), "seed {seed}");
            }
        }
    }

    /// Whether two channels reach other synapses.
    fn network_differs(network: &Quantised, a: u32, b: u32) -> bool {
        let synapses = |channel: u32| {
            let mut found = Vec::new();
            for (id, population) in network.populations().enumerate() {
                let Units::Input(first) = population.units else { continue };
                let Some(index) = channel.checked_sub(first.0).filter(|&i| i < population.shape.len()) else {
                    continue;
                };
                for (_, projection, target) in network.targets_of(id) {
                    projection.connectivity.for_each_from(index, |t, weight| {
                        found.push((target.0 + t, weight, projection.delay, projection.format.bits));
                    });
                }
            }
            found.sort_unstable();
            found
        };
        synapses(a) != synapses(b)
    }
}
