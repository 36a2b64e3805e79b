//! Shares of the causes in a disagreement.
//!
//! The stages begin at the network as its tool runs it ([`as_trained`]) and run twice: *forward*,
//! with the causes switched on in order, and *reversed*, from the last cause to the first. The
//! disagreement added by a cause depends on the causes before it. Its share is the mean of both
//! orders; their difference is the interaction. Where causes undo losses of others, means are
//! negative or above the whole, and there are no shares. *Alone* is the gain of the machine with
//! real numbers in place of one cause. It decides which cause is blamed, since one change can gain
//! as much. Disagreement is 1 minus the coincidence factor of all spikes of all layers with the
//! trained network's.

use rayon::prelude::*;

use super::causes::{Cause, ComparisonStage};
use super::classes::ClassTally;
use super::metrics::TrainSums;
use super::staged::StagedNetwork;
use super::trace::{Comparison, Layer, Trace};
use nsim_ir::spikes::Sample;

/// Distance of a stage from the trained network.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Distance {
    /// Share of samples with the same class, of those that both decide; `None` when there are none.
    pub class_agreement: Option<f64>,
    /// Coincidence factor over all layers.
    pub coincidence: f64,
    /// Potentials over all layers, in thresholds.
    pub potential_rmse: Option<f64>,
}

impl Distance {
    /// Distance of a network from itself.
    pub const EQUAL: Distance = Distance { class_agreement: Some(1.0), coincidence: 1.0, potential_rmse: Some(0.0) };

    /// Classes and coincidence together, 2 for equal networks.
    fn agreement(&self) -> f64 {
        self.class_agreement.unwrap_or(1.0) + self.coincidence
    }
}

/// A row of the attribution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Share {
    /// The cause.
    pub cause: Cause,
    /// The forward stage that switches it on.
    pub stage: Distance,
    /// The disagreement that it adds forward.
    pub forward: f64,
    /// The disagreement that it adds reversed.
    pub reversed: f64,
    /// Mean of the two, relative to the whole disagreement, 0 when there is none; `None` where
    /// causes undo losses of others.
    pub share: Option<f64>,
    /// The machine without this cause.
    pub without: Distance,
}

impl Share {
    /// Effect of the order: forward minus reversed disagreement.
    pub fn interaction(&self) -> f64 {
        self.forward - self.reversed
    }
}

/// Loss of a layer, by cause.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerLoss {
    /// The population.
    pub name: String,
    /// Spikes of the trained network and of the machine.
    pub spikes: (u64, u64),
    /// 1 minus the coincidence of the machine's layer with the trained one's.
    pub disagreement: f64,
    /// Disagreement that each cause adds: the mean of forward and reversed, in forward order.
    pub causes: Vec<(Cause, f64)>,
    /// Coincidence that the machine's layer would gain without each cause.
    pub alone: Vec<(Cause, f64)>,
}

/// A loss of coincidence or of classes below this is not worth a change.
const LITTLE: f64 = 0.005;
/// A cause is blamed where it alone brings back at least this share of a loss.
const BLAMED: f64 = 0.1;
/// Means below zero by less than this share of the whole are noise.
const NOISE: f64 = 0.02;

/// The cause that brings back most of a loss; `None` where the loss or each regain is small.
fn worst(lost: f64, alone: impl Iterator<Item = (Cause, f64)>) -> Option<(Cause, f64)> {
    let enough = alone.filter(|&(_, back)| lost >= LITTLE && back >= (BLAMED * lost).max(LITTLE));
    enough.reduce(|most, next| if next.1 > most.1 { next } else { most })
}

/// Means as shares of their sum; `None` where some are below zero.
fn shares(means: &[f64]) -> Option<Vec<f64>> {
    let whole: f64 = means.iter().sum();
    if whole.abs() < 1e-12 && means.iter().all(|mean| mean.abs() < 1e-12) {
        return Some(vec![0.0; means.len()]);
    }
    let least = means.iter().copied().fold(0.0, f64::min);
    let positive: f64 = means.iter().map(|mean| mean.max(0.0)).sum();
    (least >= -NOISE * whole).then(|| means.iter().map(|mean| mean.max(0.0) / positive).collect())
}

impl LayerLoss {
    /// Whether the loss is large enough to report.
    pub fn is_lossy(&self) -> bool {
        self.disagreement >= LITTLE
    }

    /// The cause without which the layer would gain most, and the gain.
    pub fn worst(&self) -> Option<(Cause, f64)> {
        worst(self.disagreement, self.alone.iter().copied())
    }
}

/// The whole attribution.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribution {
    /// The stage that is compared with: the network as its tool runs it.
    pub trained: ComparisonStage,
    /// 1 minus the coincidence of the machine with the trained network.
    pub disagreement: f64,
    /// Number of compared samples.
    pub samples: usize,
    /// Distance of the machine from the trained network.
    pub machine: Distance,
    /// A row for each cause, in the order of the forward stages.
    pub shares: Vec<Share>,
    /// The loss of each layer, in the order of the network's layers.
    pub layers: Vec<LayerLoss>,
}

impl Attribution {
    /// The cause without which most classes would agree again, and the regained share of samples.
    pub fn worst_of_classes(&self) -> Option<(Cause, f64)> {
        let now = self.machine.class_agreement?;
        worst(
            1.0 - now,
            self.shares.iter().filter_map(|share| Some((share.cause, share.without.class_agreement? - now))),
        )
    }

    /// The cause without which the network would gain most, classes and coincidence together.
    pub fn worst(&self) -> Option<Cause> {
        let now = self.machine.agreement();
        let regained = self.shares.iter().map(|share| (share.cause, share.without.agreement() - now));
        worst(2.0 - now, regained).map(|(cause, _)| cause)
    }
}

/// Distance of a stage from the trained network, in total and by layer.
#[derive(Debug, Clone, PartialEq)]
pub struct StageComparison {
    /// Over all layers.
    pub distance: Distance,
    /// Sums of each layer, in the order of the network.
    pub layers: Vec<TrainSums>,
    /// The classes of the samples.
    pub classes: ClassTally,
    /// Shares of right classes of the two, where all samples have labels.
    pub accuracy: Option<(f64, f64)>,
}

/// Comparison of one sample: the sums of each layer, and the class by each network.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedSample {
    layers: Vec<TrainSums>,
    classes: (Option<u32>, Option<u32>),
}

impl ComparedSample {
    /// Compares the traces of a sample, of which the second answers `shift` steps later.
    pub fn new(layers: &[Layer], output: &Layer, (a, b): (&Trace, &Trace), shift: i32) -> Self {
        let sums = layers.iter().map(|layer| {
            let mut comparison = Comparison::default();
            comparison.add(0, layer, a, b, shift);
            comparison.tally
        });
        ComparedSample { layers: sums.collect(), classes: (a.class(output), b.class(output)) }
    }
}

impl StageComparison {
    /// Merges samples of a network with this number of layers.
    pub fn new<'s>(layers: usize, samples: impl Iterator<Item = &'s ComparedSample>) -> Self {
        let (mut by_layer, mut all) = (vec![TrainSums::default(); layers], TrainSums::default());
        let mut classes = ClassTally::default();
        for sample in samples {
            by_layer.iter_mut().zip(&sample.layers).for_each(|(sum, tally)| sum.merge(tally));
            classes.add(sample.classes.0, sample.classes.1);
        }
        by_layer.iter().for_each(|tally| all.merge(tally));
        let distance = Distance {
            class_agreement: classes.agreement(),
            coincidence: all.coincidence(),
            potential_rmse: all.potential_rmse(),
        };
        StageComparison { distance, layers: by_layer, classes, accuracy: None }
    }
}

/// Compares stages, of one or more `StagedNetwork`s of a network, with one of them over samples.
pub fn compare_stages(
    (first, from): (&StagedNetwork, ComparisonStage),
    to: &[(&StagedNetwork, ComparisonStage)],
    output: &Layer,
    samples: &[&Sample],
) -> Vec<StageComparison> {
    let layers = first.layers();
    // By sample, then by stage.
    let compared = samples.par_iter().map(|sample| {
        let trained = first.run(from, sample, true);
        let stages = to.iter().map(|&(staged, stage)| {
            if std::ptr::eq(staged, first) && stage == from {
                return ComparedSample::new(&layers, output, (&trained, &trained), 0);
            }
            // Steps after the end of a shorter trace count as silent.
            let trace = staged.run(stage, sample, true).silent_until(trained.steps);
            ComparedSample::new(&layers, output, (&trained, &trace), staged.shift(stage) - first.shift(from))
        });
        stages.collect()
    });
    let compared: Vec<Vec<ComparedSample>> = compared.collect();
    let labels: Option<Vec<u32>> = samples.iter().map(|sample| sample.label()).collect();
    let labels = labels.filter(|labels| !labels.is_empty());
    let stages = (0..to.len()).map(|stage| {
        let of_stage = compared.iter().map(|sample| &sample[stage]);
        let accuracy = labels.as_ref().map(|labels| {
            let (first, second): (Vec<_>, Vec<_>) = of_stage.clone().map(|sample| sample.classes).unzip();
            (share_right(&first, labels), share_right(&second, labels))
        });
        StageComparison { accuracy, ..StageComparison::new(layers.len(), of_stage) }
    });
    stages.collect()
}

/// Share of the classes that are right.
fn share_right(classes: &[Option<u32>], labels: &[u32]) -> f64 {
    let right = classes.iter().zip(labels).filter(|(class, label)| **class == Some(**label)).count();
    right as f64 / labels.len() as f64
}

/// Stage of the network as its tool runs it. Kernels are infinite, as in the reference engine.
/// Layers answer every step of the input where this changes a class.
pub fn as_trained(staged: &StagedNetwork, output: &Layer, samples: &[&Sample]) -> ComparisonStage {
    let in_step = staged.trained().with(Cause::Untruncated);
    let as_it_is = in_step.with(Cause::Pipeline);
    let matters = staged.pipeline().is_some()
        && samples.par_iter().any(|sample| {
            let [first, second] = [in_step, as_it_is].map(|stage| staged.run(stage, sample, false).class(output));
            first != second
        });
    if matters { in_step } else { as_it_is }
}

/// Runs the stages in both orders, and the machine without each single cause.
pub fn attribute(staged: &StagedNetwork, output: &Layer, samples: &[&Sample]) -> Attribution {
    attribute_from(staged, as_trained(staged, output, samples), output, samples)
}

/// The attribution from a given trained stage.
pub fn attribute_from(
    staged: &StagedNetwork,
    trained: ComparisonStage,
    output: &Layer,
    samples: &[&Sample],
) -> Attribution {
    let causes: Vec<Cause> = staged.causes().iter().copied().filter(|&cause| !trained.has(cause)).collect();
    let count = causes.len();
    let mut stages = Vec::new();
    for order in [causes.clone(), causes.iter().rev().copied().collect()] {
        let mut stage = trained;
        for cause in order {
            stage = stage.with(cause);
            stages.push(stage);
        }
    }
    stages.extend(causes.iter().map(|&cause| ComparisonStage::MACHINE.without(cause)));
    // Both orders end at the machine, and a single cause is both its first and its last.
    let mut distinct: Vec<ComparisonStage> = Vec::new();
    let places: Vec<usize> = stages.iter().map(|&stage| place_of(&mut distinct, stage)).collect();
    let to: Vec<(&StagedNetwork, ComparisonStage)> = distinct.iter().map(|&stage| (staged, stage)).collect();
    let of_distinct = compare_stages((staged, trained), &to, output, samples);
    let compared: Vec<&StageComparison> = places.iter().map(|&place| &of_distinct[place]).collect();
    let last = count.checked_sub(1).map(|last| compared[last]);
    let mut layers = Vec::new();
    for (layer, Layer { name, .. }) in staged.layers().iter().enumerate() {
        let lost: Vec<f64> = compared.iter().map(|stage| 1.0 - stage.layers[layer].coincidence()).collect();
        let machine = count.checked_sub(1).map_or(0.0, |last| lost[last]);
        let tally = last.map(|last| last.layers[layer]).unwrap_or_default();
        let means = added(&lost, count).into_iter().map(|added| added.mean());
        layers.push(LayerLoss {
            name: name.clone(),
            spikes: (tally.spikes_a, tally.spikes_b),
            disagreement: machine.max(0.0),
            causes: causes.iter().copied().zip(means).collect(),
            alone: causes.iter().zip(&lost[2 * count..]).map(|(&cause, lost)| (cause, machine - lost)).collect(),
        });
    }
    let lost: Vec<f64> = compared.iter().map(|stage| 1.0 - stage.distance.coincidence).collect();
    let added = added(&lost, count);
    let of_causes = shares(&added.iter().map(Added::mean).collect::<Vec<f64>>());
    let shares = causes.iter().zip(&added).enumerate().map(|(place, (&cause, added))| Share {
        cause,
        stage: compared[place].distance,
        forward: added.forward,
        reversed: added.reversed,
        share: of_causes.as_ref().map(|shares| shares[place]),
        without: compared[2 * count + place].distance,
    });
    Attribution {
        trained,
        samples: samples.len(),
        disagreement: count.checked_sub(1).map_or(0.0, |last| lost[last]).max(0.0),
        machine: last.map_or(Distance::EQUAL, |last| last.distance),
        shares: shares.collect(),
        layers,
    }
}

/// The place of a stage in a list; it is added where the list does not have it.
fn place_of(stages: &mut Vec<ComparisonStage>, stage: ComparisonStage) -> usize {
    stages.iter().position(|other| *other == stage).unwrap_or_else(|| {
        stages.push(stage);
        stages.len() - 1
    })
}

/// The loss that a cause adds in both orders.
struct Added {
    forward: f64,
    reversed: f64,
}

impl Added {
    fn mean(&self) -> f64 {
        (self.forward + self.reversed) / 2.0
    }
}

/// The loss that each of `count` causes adds, from the losses of the forward stages, then of the
/// reversed ones. The first stage of an order is relative to 0.
fn added(lost: &[f64], count: usize) -> Vec<Added> {
    let (forward, reversed) = (&lost[..count], &lost[count..2 * count]);
    let steps =
        (0..count).map(|place| Added { forward: step(forward, place), reversed: step(reversed, count - 1 - place) });
    steps.collect()
}

fn step(lost: &[f64], place: usize) -> f64 {
    lost[place] - place.checked_sub(1).map_or(0.0, |below| lost[below])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_of_the_whole_or_there_are_none() {
        assert_eq!(shares(&[0.0, 0.0]), Some(vec![0.0, 0.0]));
        assert_eq!(shares(&[0.375, 0.125]), Some(vec![0.75, 0.25]));
        assert_eq!(shares(&[0.2, -0.001]), Some(vec![1.0, 0.0]));
        assert_eq!(shares(&[0.5, -0.3]), None, "250 % and -150 %");
        assert_eq!(shares(&[0.3, -0.3]), None);
    }
}
