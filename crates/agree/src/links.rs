//! Synapses of a comparison stage: sources, targets, weights and delays.
//!
//! Input: spikes of a population. Output: weights added to the arrivals of another. Delayed copies
//! between the same two populations are one link. Its weights from one source are contiguous, so a
//! spike reads memory in order.

use std::collections::HashMap;

use nsim_dynamics::arithmetic::scaled;
use nsim_dynamics::synapses::Enumerate;
use nsim_ir::quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_reference::synapses::{SumOrder, Synapses};

/// The synapses from one population to another.
#[derive(Debug)]
pub(super) struct Link {
    /// Source population.
    pub source: usize,
    /// Target population.
    pub target: usize,
    /// Delays in steps; several for delayed copies, whose weights from one source are contiguous.
    pub delays: Vec<u32>,
    /// Whether it represents the voltage that a hard reset takes away.
    pub restores: bool,
    /// Synapses, weights in register units.
    pub synapses: Synapses<f64>,
}

impl Link {
    /// Adds a neuron's spike to the arrivals of its targets; `step` is the arrival without delay.
    pub fn deliver(&self, neuron: u32, step: u32, arrivals: &mut [Vec<f64>]) {
        let slots = arrivals.len();
        match (&self.synapses, self.delays.as_slice()) {
            (synapses, [delay]) => _ = synapses.deliver(neuron, &mut arrivals[(step + delay) as usize % slots]),
            (Synapses::Dense { targets, weights }, delays) => {
                let all = *targets as usize;
                let row = &weights[neuron as usize * all..(neuron as usize + 1) * all];
                for (weights, &delay) in row.chunks(all / delays.len()).zip(delays) {
                    let sums = &mut arrivals[(step + delay) as usize % slots];
                    sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += weight);
                }
            }
            _ => {}
        }
    }

    /// Merges dense links between the same populations, so that a spike reads memory in order.
    pub fn merged(links: Vec<Link>) -> Vec<Link> {
        let mut merged: Vec<Vec<Link>> = Vec::new();
        // The bundle of dense links between two populations.
        let mut bundles: HashMap<(usize, usize, bool), usize> = HashMap::new();
        for link in links {
            let next = merged.len();
            let place = match link.synapses {
                Synapses::Dense { .. } => *bundles.entry((link.source, link.target, link.restores)).or_insert(next),
                _ => next,
            };
            if place == next {
                merged.push(Vec::new());
            }
            merged[place].push(link);
        }
        merged.into_iter().filter_map(Link::bundle).collect()
    }

    fn bundle(mut links: Vec<Link>) -> Option<Link> {
        if links.len() < 2 {
            return links.pop();
        }
        let delays = links.iter().flat_map(|link| link.delays.clone()).collect();
        let (source, target, restores) = (links[0].source, links[0].target, links[0].restores);
        let mut rows = Vec::new();
        let mut width = 0;
        for link in &links {
            if let Synapses::Dense { targets, weights } = &link.synapses {
                rows.push(weights.chunks((*targets as usize).max(1)));
                width += targets;
            }
        }
        let mut weights = Vec::new();
        while let Some(row) = rows.iter_mut().map(Iterator::next).collect::<Option<Vec<&[f64]>>>() {
            row.into_iter().for_each(|part| weights.extend_from_slice(part));
        }
        Some(Link { source, target, delays, restores, synapses: Synapses::Dense { targets: width, weights } })
    }
}

/// A matrix with more than this many places for each synapse is a list.
const MOST_ZEROS: usize = 4;

/// Synapses whose weights are the accumulator's increments times `factor`.
pub(super) fn integer_synapses(
    projection: &quantised::Projection,
    sources: u32,
    order: SumOrder,
    factor: f64,
) -> Synapses<f64> {
    let real = |weight: i16| f64::from(scaled(projection.format, weight)) * factor;
    if let Connectivity::Conv2d { window, kernel } = &projection.connectivity {
        return Synapses::convolution(*window, order, |place| real(kernel[place]));
    }
    if let Connectivity::Dense { targets, weights } = &projection.connectivity
        && weights.iter().filter(|weight| **weight != 0).count() * MOST_ZEROS >= weights.len()
    {
        return Synapses::dense(sources, order, |source, target| real(weights[(source * targets + target) as usize]));
    }
    let mut synapses = Vec::new();
    for source in 0..sources {
        projection.connectivity.for_each_from(source, |target, weight| {
            if weight != 0 {
                synapses.push((source, target, real(weight)));
            }
        });
    }
    Synapses::list(sources, order, synapses)
}
