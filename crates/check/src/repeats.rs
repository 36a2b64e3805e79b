//! Which copies of a program are another copy's over again: the rule *Copies* of
//! [`crate::equivalence`].
//!
//! Input: a network of equal copies and a program for it. Output: for each copy whether it is
//! proven from one before it, which is not itself proven from another. Nothing is assumed of how
//! either was made: the network's copies are compared too.

use std::collections::HashMap;
use std::sync::Arc;

use nsim_ir::base::id::{ChannelId, CompartmentId, CoreId, IdVec, PopulationId, ProjectionId};
use nsim_ir::partition::Seat;
use nsim_ir::program::{AxonTarget, CoreImage, Program};
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Population, Projection, Quantised, Units};

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
        // Copies alike sit on cores alike, so the seat of the first compartment says which copy to
        // compare with.
        let core = program.seats()[CompartmentId(copy * compartments)].core;
        let (first, later) = cores.of[core];
        let Some(like) = copy.checked_sub(later).filter(|_| first != core) else { continue };
        let same =
            same_network(network, like, copy, sizes) && same_messages(network, program, &cores, like, copy, sizes);
        proven[copy as usize] = same && !proven[like as usize];
    }
    proven
}

/// For each core the first that it repeats, and how many copies later; itself where it repeats
/// none.
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

/// Whether a core has the lists, formats and parameters of another and its compartments so many
/// numbers later, at their seats.
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
    units && one.shape == other.shape && one.message == other.message
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
