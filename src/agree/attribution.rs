//! Which cause takes what share of a disagreement.
//!
//! The ladder is climbed twice: *forward* from the trained network, one cause after the other; and *reversed*, the last
//! cause first. What a cause adds to the disagreement depends on what was switched on before it; the share is the mean of
//! the two, their difference the interaction. Disagreement is 1 minus the coincidence factor of all spikes of all layers
//! against the trained network's.

use rayon::prelude::*;

use super::ladder::{Cause, Ladder, Rung};
use super::metrics::TrainSums;
use super::trace::{Comparison, Layer};
use crate::ir::spikes::Sample;

/// How far a rung is from the trained network.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Distance {
    /// Share of samples with the same class.
    pub class_agreement: f64,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// Potentials over all layers, in thresholds.
    pub potential_rmse: Option<f64>,
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

/// The whole attribution.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribution {
    /// 1 minus the coincidence of the machine with the trained network.
    pub disagreement: f64,
    /// A row for each cause, in the order of the forward ladder.
    pub shares: Vec<Share>,
}

/// Compares rungs with one of them over samples, all rungs of a sample at once.
#[must_use]
pub fn distances(ladder: &Ladder, from: Rung, rungs: &[Rung], output: &Layer, samples: &[&Sample]) -> Vec<Distance> {
    let layers = ladder.layers();
    let of_sample = |sample: &&Sample| {
        let trained = ladder.run(from, sample, true);
        let one = |&rung: &Rung| {
            let trace = ladder.run(rung, sample, true);
            let mut sum = TrainSums::default();
            for layer in &layers {
                let mut comparison = Comparison::default();
                comparison.add(0, layer, &trained, &trace, ladder.shift(rung) - ladder.shift(from));
                sum.merge(&comparison.tally);
            }
            (sum, trained.class(output) == trace.class(output))
        };
        rungs.iter().map(one).collect::<Vec<_>>()
    };
    let each: Vec<Vec<(TrainSums, bool)>> = samples.par_iter().map(of_sample).collect();
    let distance = |rung: usize| {
        let (mut sum, mut same) = (TrainSums::default(), 0usize);
        for sample in &each {
            sum.merge(&sample[rung].0);
            same += usize::from(sample[rung].1);
        }
        Distance {
            class_agreement: same as f64 / samples.len().max(1) as f64,
            coincidence: sum.coincidence(),
            potential_rmse: sum.potential_rmse(),
        }
    };
    (0..rungs.len()).map(distance).collect()
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
    let distances = distances(ladder, trained, &rungs, output, samples);
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
    Attribution { disagreement, shares: causes.iter().enumerate().map(share).collect() }
}
