//! Which cause takes what share of a disagreement.
//!
//! The ladder is climbed twice: *forward* from the trained network, one cause after the other; and *reversed*, the last
//! cause first. What a cause adds to the disagreement depends on what was switched on before it; the share is the mean of
//! the two, their difference the interaction. Disagreement is 1 minus the coincidence factor of all spikes of all layers
//! against the trained network's.

use rayon::prelude::*;

use super::causes::{Cause, Rung};
use super::classes::ClassTally;
use super::ladder::Ladder;
use super::metrics::TrainSums;
use super::trace::{Comparison, Layer};
use crate::ir::spikes::Sample;

/// How far a rung is from the trained network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// Share of samples with the same class, of those that both decide; `None` when there are none.
    pub class_agreement: Option<f64>,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// Potentials over all layers, in thresholds.
    pub potential_rmse: Option<f64>,
}

impl Distance {
    /// Of a network from itself.
    pub const EQUAL: Distance = Distance { class_agreement: Some(1.0), coincidence: 1.0, potential_rmse: Some(0.0) };
}

/// A row of the attribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// The cause.
    pub cause: Cause,
    /// The forward ladder once it is switched on.
    pub rung: Distance,
    /// The disagreement that it adds forward.
    pub forward: f64,
    /// The disagreement that it adds reversed.
    pub reversed: f64,
    /// Mean of the two, relative to the whole disagreement; 0 when there is none.
    pub share: f64,
}

impl Share {
    /// How much the order matters.
    #[must_use]
    pub fn interaction(&self) -> f64 {
        self.forward - self.reversed
    }
}

/// What a layer loses to the causes.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerLoss {
    /// The population.
    pub name: String,
    /// Spikes of the trained network and of the machine.
    pub spikes: (u64, u64),
    /// 1 minus the coincidence of the machine's layer with the trained one's.
    pub disagreement: f64,
    /// What each cause adds to that, the mean of climbing forward and reversed, in the order of the forward ladder.
    pub causes: Vec<(Cause, f64)>,
}

impl LayerLoss {
    /// The cause that adds most.
    #[must_use]
    pub fn worst(&self) -> Option<(Cause, f64)> {
        let adds = self.causes.iter().copied().filter(|(_, added)| *added > 0.0);
        adds.reduce(|most, next| if next.1 > most.1 { next } else { most })
    }
}

/// The whole attribution.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribution {
    /// 1 minus the coincidence of the machine with the trained network.
    pub disagreement: f64,
    /// A row for each cause, in the order of the forward ladder.
    pub shares: Vec<Share>,
    /// What each layer loses, in the order of the ladder's layers.
    pub layers: Vec<LayerLoss>,
}

/// How far a rung is from the trained network, in all and layer by layer.
#[derive(Debug, Clone, PartialEq)]
pub struct Measured {
    /// Over all layers.
    pub distance: Distance,
    /// In the order of the ladder's layers.
    pub layers: Vec<TrainSums>,
}

/// The class of a sample by the trained network and by a rung.
type Classes = (Option<u32>, Option<u32>);

/// Compares rungs with one of them over samples, all rungs of a sample at once.
#[must_use]
pub fn distances(ladder: &Ladder, from: Rung, rungs: &[Rung], output: &Layer, samples: &[&Sample]) -> Vec<Distance> {
    let to: Vec<(&Ladder, Rung)> = rungs.iter().map(|&rung| (ladder, rung)).collect();
    measured((ladder, from), &to, output, samples).into_iter().map(|measured| measured.distance).collect()
}

/// Compares rungs, perhaps of several ladders of one network, with one of them over samples.
#[must_use]
pub fn measured(
    (first, from): (&Ladder, Rung),
    to: &[(&Ladder, Rung)],
    output: &Layer,
    samples: &[&Sample],
) -> Vec<Measured> {
    let layers = first.layers();
    let of_sample = |sample: &&Sample| {
        let trained = first.run(from, sample, true);
        let one = |&(ladder, rung): &(&Ladder, Rung)| {
            let trace = ladder.run(rung, sample, true);
            let sums = layers.iter().map(|layer| {
                let mut comparison = Comparison::default();
                comparison.add(0, layer, &trained, &trace, ladder.shift(rung) - first.shift(from));
                comparison.tally
            });
            (sums.collect(), (trained.class(output), trace.class(output)))
        };
        to.iter().map(one).collect::<Vec<(Vec<TrainSums>, Classes)>>()
    };
    let each: Vec<Vec<(Vec<TrainSums>, Classes)>> = samples.par_iter().map(of_sample).collect();
    let of_rung = |rung: usize| {
        let mut by_layer = vec![TrainSums::default(); layers.len()];
        for sample in &each {
            by_layer.iter_mut().zip(&sample[rung].0).for_each(|(sum, tally)| sum.merge(tally));
        }
        let mut sum = TrainSums::default();
        by_layer.iter().for_each(|tally| sum.merge(tally));
        let distance = Distance {
            class_agreement: ClassTally::new(each.iter().map(|sample| sample[rung].1)).agreement(),
            coincidence: sum.coincidence(),
            potential_rmse: sum.potential_rmse(),
        };
        Measured { distance, layers: by_layer }
    };
    (0..to.len()).map(of_rung).collect()
}

/// Climbs the ladder both ways.
#[must_use]
pub fn attribute(ladder: &Ladder, output: &Layer, samples: &[&Sample]) -> Attribution {
    let (causes, trained) = (ladder.causes(), ladder.trained());
    let climb = |causes: &[Cause]| {
        let mut rung = trained;
        let up = causes.iter().map(|&cause| {
            rung = rung.with(cause);
            rung
        });
        up.collect::<Vec<Rung>>()
    };
    let backward: Vec<Cause> = causes.iter().rev().copied().collect();
    let mut rungs = climb(causes);
    rungs.extend(climb(&backward));
    let to: Vec<(&Ladder, Rung)> = rungs.iter().map(|&rung| (ladder, rung)).collect();
    let found = measured((ladder, trained), &to, output, samples);
    let of_ladder = ladder.layers();
    let layers = of_ladder.iter().enumerate().map(|(layer, Layer { name, .. })| {
        let lost = |place: Option<usize>| place.map_or(0.0, |place| 1.0 - found[place].layers[layer].coincidence());
        let added = |first: usize, place: usize| {
            lost(Some(first + place)) - lost(place.checked_sub(1).map(|below| first + below))
        };
        let each = causes.iter().enumerate().map(|(place, &cause)| {
            let (up, down) = (added(0, place), added(causes.len(), causes.len() - 1 - place));
            (cause, (up + down) / 2.0)
        });
        let machine = causes.len().checked_sub(1);
        let tally = machine.map(|last| found[last].layers[layer]).unwrap_or_default();
        LayerLoss {
            name: name.clone(),
            spikes: (tally.spikes_a, tally.spikes_b),
            disagreement: lost(machine).max(0.0),
            causes: each.collect(),
        }
    });
    let layers: Vec<LayerLoss> = layers.collect();
    let distances: Vec<Distance> = found.iter().map(|measured| measured.distance).collect();
    let (forward, reversed) = distances.split_at(causes.len());
    let added = |ladder: &[Distance], place: usize| {
        let below = if place == 0 { 0.0 } else { 1.0 - ladder[place - 1].coincidence };
        1.0 - ladder[place].coincidence - below
    };
    let disagreement = forward.last().map_or(0.0, |last| (1.0 - last.coincidence).max(0.0));
    let share = |(place, &cause): (usize, &Cause)| {
        let (up, down) = (added(forward, place), added(reversed, causes.len() - 1 - place));
        let share = if disagreement.abs() < 1e-12 { 0.0 } else { (up + down) / 2.0 / disagreement };
        Share { cause, rung: forward[place], forward: up, reversed: down, share }
    };
    Attribution { disagreement, shares: causes.iter().enumerate().map(share).collect(), layers }
}
