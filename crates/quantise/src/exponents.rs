//! The scale of each population with a real threshold, and an exponent for each projection into it.
//!
//! Input: a graph. Output: the graph with an exponent for every projection whose file gives none,
//! and with the scale S (register units a real unit) of its target; `quantise` rounds the weights.
//! A weight w with exponent e has the mantissa `w S / 2^(6 + e)`.
//!
//! - *Scale.* S0 is the greatest scale at which every weight fits with exponent 0. S is S0 doubled
//!   as often as these bounds allow. The sum of all weights of a compartment, or the greatest input
//!   of a calibration, stays within the 21 bits of a step's input; sustained, it keeps the current
//!   within 23 bits. The bias fits its field. The threshold is at most 2^16 register units, which
//!   leaves 128 thresholds below zero before the voltage clips. The largest weights are rounded as
//!   with S0, thresholds and biases more finely, and rounding by the decays counts less.
//! - *Exponents.* Each projection takes the least exponent at which its own weights fit, and at
//!   least the one whose step is 64 register units: below, the chip drops the low six bits.
//! - *Groups.* Where the largest weight is more than [`HEAVY`] times the root mean square of its
//!   projection, one step for all would be large for most weights. Such a projection, and any small
//!   one, is split into up to four by size, each with its own exponent; no synapse is added. A
//!   recurrent NIR network (38 neurons, largest weight 11 times the root mean square) coincides
//!   with its real numbers in 0.77 of its hidden spikes with one exponent for all, 0.89 with one a
//!   projection, 0.97 with groups.
//!
//! Unchanged: populations with an integer threshold, and populations with a projection that gives
//! its `weight_scale`.

use petgraph::graph::{DiGraph, NodeIndex};

use nsim_ir::base::diagnostic::Span;
use nsim_ir::base::fixed::{
    BiasExponent, BiasMantissa, DECAY_ONE, ThresholdMantissa, WEIGHT_SHIFT, WeightBits, WeightExponent,
};
use nsim_ir::graph::{Graph, NeuronParameters, PerCompartment, PopulationKind, Projection, ProjectionKind};

/// The quotient of largest weight and root mean square above which a projection is split.
pub const HEAVY: f64 = 4.0;
/// Most synapses of a projection that is split in any case: a bias that a compartment delivers, a
/// small layer.
const SMALL: usize = 1 << 12;
/// Most synapses of a projection that is split: they are listed one by one.
const MOST_SPLIT: usize = 1 << 16;
/// Most projections that one is split into, and the powers of two that each but the last spans.
const GROUPS: usize = 4;
const SPAN: i64 = 2;
/// Register units of the greatest threshold.
const THRESHOLD: f64 = 65_536.0;

/// Granularity of exponents.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub enum Detail {
    /// Exponent 0 wherever the file gives none, at the scale S0.
    Zero,
    /// One exponent for each projection.
    Projections,
    /// One exponent for each group of weights of similar size.
    Groups,
    /// As `Groups`, with the rounding error of a delayed copy carried to the next
    /// ([`super::carry`]).
    #[default]
    Carried,
}

/// Returns the graph with a choice for every open exponent and scale.
pub fn assigned(graph: &Graph, detail: Detail) -> Graph {
    if detail == Detail::Zero {
        return graph.clone();
    }
    let scales: Vec<Option<f64>> = graph.populations().map(|(node, _)| scale(graph, node)).collect();
    if scales.iter().all(Option::is_none) {
        return graph.clone();
    }
    let mut nodes = DiGraph::new();
    for (_, population) in graph.populations() {
        nodes.add_node(population.clone());
    }
    for (_, source, target, projection) in graph.projections() {
        let sources = graph.population(source).shape.len();
        let chosen = match scales[target.index()] {
            Some(scale) if is_open(projection) => groups(projection, sources, scale, detail),
            _ => vec![projection.clone()],
        };
        for part in chosen {
            nodes.add_edge(source, target, part);
        }
    }
    Graph::new(graph.facts().clone(), nodes, graph.output())
}

/// Whether the file leaves its exponent to nsim.
fn is_open(projection: &Projection) -> bool {
    projection.weight_exp.span == Span::default()
        && projection.weight_exp.value == 0
        && projection.weight_scale.is_none()
}

fn factor(exponent: i64) -> f64 {
    libm::exp2((exponent + i64::from(WEIGHT_SHIFT)) as f64)
}

/// Weights of a projection: (source, target, weight, entry in the declared list). In a kernel, the
/// target is the output channel and all other indices are 0.
fn weights(projection: &Projection, sources: u32) -> Vec<(u32, u32, f64, u32)> {
    match &projection.kind {
        ProjectionKind::Dense { weights } => {
            let columns = weights.shape().get(1).copied().unwrap_or(1);
            let targets = weights.shape().first().copied().unwrap_or(0);
            let first = projection.first_source as usize;
            let all = (0..targets).flat_map(|target| (0..sources as usize).map(move |source| (source, target)));
            let weight = |(source, target): (usize, usize)| weights.real(target * columns + first + source);
            all.map(|at| (at.0 as u32, at.1 as u32, weight(at), at.1 as u32)).collect()
        }
        ProjectionKind::Sparse { synapses } => synapses.clone(),
        ProjectionKind::Conv2d { weights, .. } => {
            let per_channel = (weights.len() / weights.shape().first().copied().unwrap_or(1).max(1)).max(1);
            (0..weights.len()).map(|i| (0, (i / per_channel) as u32, weights.real(i), 0)).collect()
        }
        ProjectionKind::SumPool2d { weight, .. } => vec![(0, 0, weight.value, 0)],
        ProjectionKind::Random { .. } => Vec::new(),
    }
}

/// Greatest sum of excitatory or of inhibitory weights, times payloads, that one spike of every
/// source can add to a compartment.
fn greatest_sum(graph: &Graph, node: NodeIndex) -> f64 {
    let units = graph.population(node).shape.len() as usize;
    let (mut above, mut below) = (vec![0.0f64; units], vec![0.0f64; units]);
    for (source, projection) in graph.incoming(node) {
        let population = graph.population(source);
        let factor = f64::from(population.message.factor().unwrap_or(1).abs());
        let per_channel = |channels: u32| (units / (channels as usize).max(1)).max(1);
        // A window reaches every compartment of a channel with at most its whole kernel.
        let (shared, times) = match &projection.kind {
            ProjectionKind::Conv2d { window, .. } => (per_channel(window.target.0), 1.0),
            ProjectionKind::SumPool2d { window, .. } => (units, f64::from(window.kernel.0 * window.kernel.1)),
            _ => (1, 1.0),
        };
        for (_, target, weight, _) in weights(projection, population.shape.len()) {
            let sums = if weight > 0.0 { &mut above } else { &mut below };
            let first = target as usize * shared;
            sums.iter_mut().skip(first).take(shared).for_each(|sum| *sum += weight.abs() * factor * times);
        }
    }
    above.into_iter().chain(below).fold(0.0, f64::max)
}

fn greatest(of: &PerCompartment<f64>) -> f64 {
    of.values().iter().map(|value| value.abs()).reduce(f64::max).unwrap_or(0.0)
}

/// Least fraction of the current that a step removes, 0..=1.
fn least_decay(parameters: &NeuronParameters, timestep_ms: f64) -> f64 {
    fn least(of: &PerCompartment<f64>, share: &dyn Fn(f64) -> f64) -> f64 {
        of.values().iter().map(|&value| share(value)).reduce(f64::min).unwrap_or(1.0)
    }
    match (parameters.get("du"), parameters.real("tau_u_ms")) {
        (Some(du), _) => least(&du.each, &|du| du / DECAY_ONE as f64),
        (None, Some(tau)) => least(&tau.each, &|tau| -libm::expm1(-timestep_ms / tau)),
        (None, None) => 1.0,
    }
}

/// Register units a real unit of a population; `None` where its scale is not open.
fn scale(graph: &Graph, node: NodeIndex) -> Option<f64> {
    let PopulationKind::Neurons(parameters) = &graph.population(node).kind else { return None };
    let threshold = greatest(&parameters.real("vth")?.each);
    let (mut fits, mut open) = (f64::from(ThresholdMantissa::MAX.get()) * 64.0 / threshold, false);
    // Greatest scale at which every weight fits with its greatest exponent.
    let mut most = f64::INFINITY;
    for (source, projection) in graph.incoming(node) {
        let bits = WeightBits::new(projection.weight_bits.value).ok()?;
        if projection.weight_scale.is_some() || matches!(projection.kind, ProjectionKind::Random { .. }) {
            return None;
        }
        let (low, high) = projection.sign.range(bits);
        for (_, _, weight, _) in weights(projection, graph.population(source).shape.len()) {
            let limit = if weight < 0.0 { f64::from(low) } else { f64::from(high) };
            if weight == 0.0 || limit == 0.0 || !weight.is_finite() {
                continue;
            }
            fits = fits.min(limit / weight * factor(projection.weight_exp.value));
            let greatest = i64::from(WeightExponent::MAX.get());
            let exponent = if is_open(projection) { greatest } else { projection.weight_exp.value };
            most = most.min(limit / weight * factor(exponent));
            open |= is_open(projection);
        }
    }
    if !(open && fits > 0.0 && fits.is_finite()) {
        return None;
    }
    let foreseen = parameters.greatest_input.unwrap_or(f64::INFINITY);
    let sum = greatest_sum(graph, node).min(foreseen).max(f64::MIN_POSITIVE);
    let decay = least_decay(parameters, graph.facts().timestep_ms).max(f64::MIN_POSITIVE);
    let bias = parameters.real("bias").map_or(0.0, |bias| greatest(&bias.each)).max(f64::MIN_POSITIVE);
    let bounds = [
        most,
        libm::exp2(21.0) / sum,
        libm::exp2(23.0) * decay / sum,
        f64::from(BiasMantissa::MAX.get()) * libm::exp2(f64::from(BiasExponent::MAX.get())) / bias,
        THRESHOLD / threshold,
    ];
    let room = bounds.into_iter().fold(f64::INFINITY, f64::min) / fits;
    Some(match parameters.greatest_input {
        // Most weights have the least exponent, so only S makes their steps finer.
        Some(_) => fits * room.max(1.0),
        None => fits * libm::exp2(libm::log2(room).floor().max(0.0)),
    })
}

/// The projection with its exponent, or several projections by the size of its weights.
fn groups(projection: &Projection, sources: u32, scale: f64, detail: Detail) -> Vec<Projection> {
    let Ok(bits) = WeightBits::new(projection.weight_bits.value) else { return vec![projection.clone()] };
    let step = f64::from(projection.sign.step(bits));
    let (low, high) = projection.sign.range(bits);
    let least = -(libm::log2(step) as i64).min(i64::from(WEIGHT_SHIFT));
    let fits = |weight: f64, exponent: i64| {
        let mantissa = (weight * scale / factor(exponent) / step).round_ties_even() * step;
        (f64::from(low)..=f64::from(high)).contains(&mantissa)
    };
    let with = |kind: ProjectionKind, exponent: i64| {
        let mut part = Projection { kind, ..projection.clone() };
        part.weight_exp.value = exponent;
        part.weight_scale = Some((scale / factor(exponent)).into());
        part
    };
    let all = weights(projection, sources);
    let greatest = i64::from(WeightExponent::MAX.get());
    let exponent_of = |weight: f64| (least..=greatest).find(|&e| fits(weight, e)).unwrap_or(greatest);
    let top = all.iter().map(|synapse| exponent_of(synapse.2)).max().unwrap_or(0);
    let used: Vec<&(u32, u32, f64, u32)> = all.iter().filter(|synapse| synapse.2 != 0.0).collect();
    let squares: f64 = used.iter().map(|synapse| synapse.2 * synapse.2).sum();
    let largest = used.iter().fold(0.0, |most: f64, synapse| most.max(synapse.2.abs()));
    let heavy = all.len() <= SMALL || largest > HEAVY * (squares / used.len().max(1) as f64).sqrt();
    // A rule's rows are those of the declaration.
    let splits = projection.kind.has_own_weights() && projection.rule.is_none() && all.len() <= MOST_SPLIT;
    if detail < Detail::Groups || !heavy || !splits || top == least {
        return vec![with(projection.kind.clone(), top)];
    }
    let mut parts: Vec<Vec<(u32, u32, f64, u32)>> = vec![Vec::new(); GROUPS];
    for &synapse in used {
        let below = (top - exponent_of(synapse.2)) / SPAN;
        parts[(below as usize).min(GROUPS - 1)].push(synapse);
    }
    let part = |synapses: Vec<(u32, u32, f64, u32)>| {
        let exponent = synapses.iter().map(|synapse| exponent_of(synapse.2)).max()?;
        let mut part = with(ProjectionKind::Sparse { synapses }, exponent);
        part.first_source = 0;
        part.name = format!("{} (weights of 2^{exponent})", projection.name);
        Some(part)
    };
    parts.into_iter().filter_map(part).collect()
}
