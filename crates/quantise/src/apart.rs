//! Sums that lava narrows before it adds them to others.
//!
//! Input: a network in integers. Output: the network with [`SeparateSum`] set on each projection
//! whose sum must be narrowed separately. Errors: a population with more sums than a compartment
//! has.
//!
//! - lava's convolutions wrap their sums to 24 bits, its dense and sparse connections do not
//!   (lava-nc b6822fb, `proc/conv/models.py`). A kernel whose weights are in several formats is
//!   several projections here; projections with equal source, window, delay and port are one sum. A
//!   sum that cannot reach 2^23, for any payload of its messages, is unchanged.
//! - A negative exponent shifts the sum of each delay separately (`proc/dense/models.py`), over all
//!   sources of a declaration.

use std::collections::{BTreeMap, BTreeSet};

use petgraph::graph::NodeIndex;

use nsim_ir::base::fixed::{UV_BITS, WeightExponent};
use nsim_ir::base::id::{Id, IdVec, PopulationId, ProjectionId};
use nsim_ir::graph::Graph;
use nsim_ir::neurons::Port;
use nsim_ir::quantised::connectivity::{Connectivity, SeparateSum};
use nsim_ir::quantised::{Population, Projection};
use nsim_ir::spikes::Message;

/// Populations of a network in integers, before it is checked.
pub(crate) type Populations = IdVec<PopulationId, Population>;
/// Its projections.
pub(crate) type Projections = IdVec<ProjectionId, Projection>;

/// Projections into one population, by the sum that they share.
type Groups = Vec<Vec<ProjectionId>>;

/// Number of sums of a population, more than [`SeparateSum::MOST`].
pub(crate) struct TooMany(pub usize);

/// Whether a negative exponent takes bits of a weight of this projection, now or once it learned.
pub(crate) fn loses_bits(projection: &Projection) -> bool {
    let exponent = projection.format.exponent;
    exponent < WeightExponent::ZERO
        && (projection.format.is_plastic() || !projection.connectivity.all_multiples_of(exponent.lost()))
}

/// Assigns separate sums to those of the projections `into` a population that need them; returns
/// the number of shifted sums, `None` where no projection needs one.
///
/// # Errors
/// When a compartment would have more than [`SeparateSum::MOST`] sums.
pub(crate) fn assign(
    graph: &Graph,
    populations: &Populations,
    projections: &mut Projections,
    into: &[ProjectionId],
) -> Result<Option<usize>, TooMany> {
    let convolutions = wrapping(populations, projections, into);
    let wrapped: BTreeSet<ProjectionId> = convolutions.iter().flatten().copied().collect();
    let mut shifted = declared(graph, projections, into);
    shifted.iter_mut().for_each(|group| group.retain(|id| !wrapped.contains(id)));
    shifted.retain(|group| !group.is_empty());
    if convolutions.is_empty() && one_shift_does(projections, into) {
        return Ok(None);
    }
    let wraps = convolutions.len();
    let groups: Groups = convolutions.into_iter().chain(shifted).collect();
    let members = groups.iter().enumerate().flat_map(|(number, group)| group.iter().map(move |&id| (id, number)));
    let own: BTreeMap<ProjectionId, usize> = members.collect();
    let sums = into.iter().map(|&id| {
        let (projection, number) = (&projections[id], own.get(&id));
        (projection.format.port, number, number.map(|_| projection.delay))
    });
    let sums = sums.collect::<BTreeSet<_>>().len();
    if sums > SeparateSum::MOST {
        return Err(TooMany(sums));
    }
    for (number, group) in groups.iter().enumerate() {
        for &id in group {
            projections[id].format.apart = Some(SeparateSum { number: number as u8, wraps: number < wraps });
        }
    }
    Ok(Some(groups.len() - wraps))
}

/// Convolutions into a population whose sums may leave 24 bits.
fn wrapping(populations: &Populations, projections: &Projections, into: &[ProjectionId]) -> Groups {
    let mut groups: Vec<(_, Vec<ProjectionId>, Vec<u64>)> = Vec::new();
    for (id, projection) in into.iter().map(|&id| (id, &projections[id])) {
        let Connectivity::Conv2d { window, kernel } = &projection.connectivity else { continue };
        let (format, most) = (projection.format, greatest(populations[projection.source].message));
        let exponent = format.exponent.get();
        let key = (projection.source, window, projection.delay, format.port, exponent.min(0));
        let found = groups.iter().position(|group| group.0 == key).unwrap_or_else(|| {
            groups.push((key, Vec::new(), vec![0; window.target.0 as usize]));
            groups.len() - 1
        });
        let (_, members, sums) = &mut groups[found];
        members.push(id);
        let per_channel = (kernel.len() / sums.len().max(1)).max(1);
        for (sum, weights) in sums.iter_mut().zip(kernel.chunks(per_channel)) {
            let all: u64 = weights.iter().map(|weight| u64::from(weight.unsigned_abs())).sum();
            *sum = sum.saturating_add((all << exponent.max(0)).saturating_mul(most));
        }
    }
    fn may_wrap(sums: &[u64]) -> bool {
        sums.iter().any(|&sum| sum >= 1 << UV_BITS)
    }
    groups.into_iter().filter(|(_, _, sums)| may_wrap(sums)).map(|(_, members, _)| members).collect()
}

/// Greatest magnitude of a payload; 2^31 for a value, which may exceed its declared width.
fn greatest(message: Message) -> u64 {
    message.factor().map_or(1 << 31, |factor| factor.unsigned_abs().into())
}

/// Projections into a population whose weights lose bits, grouped by declaration and delay.
fn declared(graph: &Graph, projections: &Projections, into: &[ProjectionId]) -> Groups {
    let mut groups = Groups::new();
    let Some(target) = into.first().map(|&id| NodeIndex::new(projections[id].target.index())) else { return groups };
    let mut last = None;
    for (&id, (_, declared)) in into.iter().zip(graph.incoming(target)) {
        // Sources of a declaration are consecutive, the first at 0; they have one target.
        if declared.first_source == 0 {
            last = None;
        }
        if loses_bits(&projections[id]) {
            let place = *last.get_or_insert_with(|| {
                groups.push(Vec::new());
                groups.len() - 1
            });
            groups[place].push(id);
        }
    }
    groups
}

/// Whether one shift of each sum of a population suffices for all its projections: at most one
/// loses bits at each port, and the exponents of all can be raised by as much.
pub(crate) fn one_shift_does(projections: &Projections, into: &[ProjectionId]) -> bool {
    let formats = || into.iter().map(|&id| &projections[id]);
    let lossy: Vec<_> = formats().filter(|projection| loses_bits(projection)).map(|p| p.format).collect();
    let least = lossy.iter().map(|format| format.exponent.get()).min().unwrap_or(0);
    let ports: BTreeSet<Port> = lossy.iter().map(|format| format.port).collect();
    let greatest = formats().map(|projection| projection.format.exponent.get()).max().unwrap_or(least);
    ports.len() == lossy.len() && i64::from(greatest) - i64::from(least) <= WeightExponent::MAX.get().into()
}
