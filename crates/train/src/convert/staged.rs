//! Conversion by stages: gain of each stage, remaining loss by cause, and possible remedies.
//!
//! Input: a network with real numbers and calibration samples. Output: the network in integers, its
//! distance after each stage, and the loss of each layer. Spike response networks go through
//! [`super::search`], all others through the choice of exponents (`nsim_quantise::exponents`). If
//! the target cannot reset by subtraction, a first stage replaces this by a reset to zero. The cost
//! of each kind of integer is found by replacing it with its real numbers, while all other integers
//! stay (`agree::staged`).

use crate::convert::resets;
use crate::convert::search::{self, Conversion, SearchResult};
use nsim_agree::attribution::{self, Attribution, Distance, Share};
use nsim_agree::causes::{Cause, ComparisonStage};
use nsim_agree::compare::output_layer;
use nsim_agree::staged::StagedNetwork;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::graph::{Graph, PopulationKind};
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;
use nsim_quantise::analytic::{self, Fit};
use nsim_quantise::exponents::Detail;
use nsim_session::SampleSettings;
use nsim_session::populations::CountsByPopulation;
use nsim_session::samples::golden;
use nsim_session::warnings::clipping_advice;

/// Samples on which the slow interpreter counts overflows.
const OVERFLOW_SAMPLES: usize = 4;

/// Calibration samples on which the loss is attributed to kinds of integers.
const ATTRIBUTION_SAMPLES: usize = 20;

/// A stage and the network's distance after it.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct StageRow {
    /// Distance on the calibration samples.
    #[serde(flatten)]
    pub distance: Distance,
    /// Description of the stage.
    pub name: String,
    /// Whether the result includes it.
    pub kept: bool,
    /// Coincidence gained over the previous stage; none for the first.
    pub gain: Option<f64>,
    /// Coincidence that real numbers would add in place of its integers; none for the start.
    pub left: Option<f64>,
}

/// A layer of the integers.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct LayerRow {
    /// Name of the population.
    pub name: String,
    /// Coincidence factor; none where neither network spikes.
    pub coincidence: Option<f64>,
    /// Exponent of each projection into it.
    pub weight_exp: Vec<i64>,
    /// Voltages clipped at the upper end without a reset (`OverflowCounts::cut`), on a few samples.
    pub clipped: u64,
    /// A fault of the layer, or the reason for which it cannot be compared.
    pub problem: Option<String>,
}

/// Distance of integers from the network that they represent.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredDistance {
    /// Distance over all layers.
    pub distance: Distance,
    /// Name of each layer, coincidence (none where nothing spikes), spikes of the integers.
    pub layers: Vec<(String, Option<f64>, u64)>,
    /// Samples on which the distance was measured.
    pub samples: usize,
    /// Fractions of right classes of that network and of the integers, if all samples have labels.
    pub accuracy: Option<(f64, f64)>,
}

/// A network in integers and the record of its conversion.
#[derive(Debug)]
pub struct Converted {
    /// The integers.
    pub network: Quantised,
    /// The converted form of each spike response population.
    pub fits: Vec<Option<Fit>>,
    /// Every stage tried.
    pub stages: Vec<StageRow>,
    /// Each layer of the integers.
    pub layers: Vec<LayerRow>,
    /// Remaining cost of each kind of integer, on some of the calibration samples.
    pub left: Vec<Share>,
    /// Loss of coincidence by cause and layer, on these samples.
    pub attribution: Attribution,
    /// Measures on the calibration samples.
    pub calibration: MeasuredDistance,
    /// The comparison stages between the network and its integers.
    pub staged: StagedNetwork,
    /// The network as its tool runs it.
    pub trained: ComparisonStage,
    /// Detail at which exponents and weights were chosen.
    pub detail: Detail,
}

/// Whether a network has real numbers that become integers.
pub fn is_real(graph: &Graph) -> bool {
    fn real(kind: &PopulationKind) -> bool {
        match kind {
            PopulationKind::Input => false,
            PopulationKind::Srm(_) => true,
            PopulationKind::Neurons(parameters) => {
                ["vth", "tau_u_ms", "tau_v_ms"].iter().any(|name| parameters.real(name).is_some())
            }
        }
    }
    graph.populations().any(|(_, population)| real(&population.kind))
        || graph.projections().any(|(_, _, _, projection)| projection.weight_scale.is_some())
}

fn by_layer(staged: &StagedNetwork, measured: attribution::StageComparison, samples: usize) -> MeasuredDistance {
    let rows = staged.layers().into_iter().zip(measured.layers).map(|(layer, sum)| {
        let silent = sum.spikes_a + sum.spikes_b == 0;
        (layer.name, (!silent).then(|| sum.coincidence()), sum.spikes_b)
    });
    MeasuredDistance { distance: measured.distance, layers: rows.collect(), samples, accuracy: measured.accuracy }
}

impl Converted {
    /// Distance of these integers, or others of these populations, from the trained network.
    pub fn measure(&self, integers: &StagedNetwork, samples: &[&Sample]) -> MeasuredDistance {
        let from = (&self.staged, self.trained);
        let output = output_layer(self.staged.deployed());
        let on = attribution::compare_stages(from, &[(integers, ComparisonStage::MACHINE)], &output, samples).remove(0);
        by_layer(&self.staged, on, samples.len())
    }
}

/// Limits of a conversion.
#[derive(Debug, Clone, Copy)]
pub struct ConversionLimits {
    /// Most taps of a population's input.
    pub most_taps: usize,
    /// Whether compartments can reset by subtraction.
    pub soft_reset: bool,
}

/// Converts a network, and measures each stage.
///
/// # Errors
/// As `nsim_quantise::quantise`.
pub fn convert(
    given: &Graph,
    samples: &[&Sample],
    choices: ConversionLimits,
    progress: impl FnMut(&str),
) -> Result<Converted> {
    let replaced = (resets::has_soft_reset(given) && !choices.soft_reset).then(|| resets::to_zero(given));
    let graph = replaced.as_ref().unwrap_or(given);
    let most = choices.most_taps;
    let UnmeasuredConversion { fits, detail, mut stages, mut staged } = match graph.has_srm() {
        true => convert_by_search(graph, samples, most, progress)?,
        false => convert_by_exponents(graph)?,
    };
    if replaced.is_some() {
        staged = staged.from_subtraction(given);
        if let Some(first) = stages.first_mut() {
            first.name = format!("reset to zero; {}", first.name);
        }
        let name = "reset by subtraction, which the target does not have".to_string();
        let as_given = StagedNetwork::with_exponents(given, &analytic::starts(given), Detail::Zero)?;
        stages.insert(0, StageIntegers { name, kept: false, staged: Some(as_given), decides: &[] });
    }
    let output = output_layer(staged.deployed());
    let trained = attribution::as_trained(&staged, &output, samples);
    let mut stage_pairs: Vec<(&StagedNetwork, ComparisonStage)> = vec![(&staged, ComparisonStage::MACHINE)];
    stage_pairs.extend(stages.iter().filter_map(|stage| Some((stage.staged.as_ref()?, ComparisonStage::MACHINE))));
    let mut all = attribution::compare_stages((&staged, trained), &stage_pairs, &output, samples).into_iter();
    let none = || attribution::StageComparison::new(0, std::iter::empty());
    let calibration = by_layer(&staged, all.next().unwrap_or_else(none), samples.len());
    let distances_of_stages: Vec<Distance> = stages
        .iter()
        .map(|stage| stage.staged.as_ref().and_then(|_| all.next()).map_or(calibration.distance, |own| own.distance))
        .collect();
    let some: Vec<&Sample> =
        samples.iter().step_by(samples.len().div_ceil(ATTRIBUTION_SAMPLES).max(1)).copied().collect();
    let attribution = attribution::attribute_from(&staged, trained, &output, &some);
    let left_from = attribution.machine;
    let left: Vec<Share> = attribution.shares.iter().filter(|share| share.cause != Cause::Kernel).copied().collect();
    let row = |(place, stage): (usize, StageIntegers)| {
        let distance = distances_of_stages[place];
        let before = place.checked_sub(1).map(|before| distances_of_stages[before]);
        let own = left.iter().filter(|left| stage.decides.contains(&left.cause));
        let added = own.map(|left| left.without.coincidence - left_from.coincidence);
        StageRow {
            name: stage.name,
            distance,
            kept: stage.kept,
            gain: before.map(|before| distance.coincidence - before.coincidence),
            left: added.reduce(f64::max).map(|added| added.max(0.0)),
        }
    };
    let stages: Vec<StageRow> = stages.into_iter().enumerate().map(row).collect();
    let network = staged.deployed().clone();
    let layers = rows(&network, &calibration, samples);
    Ok(Converted { network, fits, stages, layers, left, attribution, calibration, staged, trained, detail })
}

/// A conversion before it is measured.
struct UnmeasuredConversion {
    fits: Vec<Option<Fit>>,
    detail: Detail,
    stages: Vec<StageIntegers>,
    staged: StagedNetwork,
}

/// A stage before it is measured.
struct StageIntegers {
    name: String,
    /// Whether the result includes it.
    kept: bool,
    /// Its integers; none where they are the result.
    staged: Option<StagedNetwork>,
    /// The kinds of integers that it chooses.
    decides: &'static [Cause],
}

fn convert_by_search(
    graph: &Graph,
    samples: &[&Sample],
    most: usize,
    progress: impl FnMut(&str),
) -> Result<UnmeasuredConversion> {
    let SearchResult { conversion, stages, .. } = search::search(graph, samples, most, progress)?;
    let last = stages.iter().position(|(_, of_stage)| *of_stage == conversion).unwrap_or(0);
    let row = |(place, (stage, of_stage)): (usize, &(search::Stage, Conversion))| {
        let staged = if place == last { None } else { Some(of_stage.staged(graph)?) };
        let decides: &[Cause] = match stage {
            search::Stage::Start => &[],
            search::Stage::Shape => &[Cause::HardReset, Cause::Decays, Cause::Calibration],
            search::Stage::Rounding => &[Cause::Weights],
        };
        Ok(StageIntegers { name: stage.name().to_string(), kept: place <= last, staged, decides })
    };
    let stages = stages.iter().enumerate().map(row).collect::<Result<_>>()?;
    let staged = conversion.staged(graph)?;
    Ok(UnmeasuredConversion { fits: conversion.fits, detail: conversion.detail, stages, staged })
}

fn convert_by_exponents(graph: &Graph) -> Result<UnmeasuredConversion> {
    let fits = analytic::starts(graph);
    let row = |(name, detail): (&str, Detail)| {
        let staged =
            if detail == Detail::Groups { None } else { Some(StagedNetwork::with_exponents(graph, &fits, detail)?) };
        let decides: &[Cause] = if detail == Detail::Zero { &[] } else { &[Cause::Weights] };
        Ok(StageIntegers { name: name.to_string(), kept: true, staged, decides })
    };
    let stages = [
        ("analytic start", Detail::Zero),
        ("a scale a population, an exponent a projection", Detail::Projections),
        ("an exponent for weights of like size", Detail::Groups),
    ];
    let stages = stages.into_iter().map(row).collect::<Result<_>>()?;
    let staged = StagedNetwork::new(graph, &fits)?;
    Ok(UnmeasuredConversion { fits, detail: Detail::default(), stages, staged })
}

/// Each layer of the integers, with its problem.
fn rows(network: &Quantised, measured: &MeasuredDistance, samples: &[&Sample]) -> Vec<LayerRow> {
    let some = &samples[..samples.len().min(OVERFLOW_SAMPLES)];
    let sums =
        CountsByPopulation::new(network, &golden(network, some, &SampleSettings::new(network.output()), &|| ()).counts);
    let rows = measured.layers.iter().map(|(name, coincidence, spikes)| {
        let target = network.population_named(name);
        let into = target.into_iter().flat_map(|target| network.incoming(target));
        let clipped = sums.populations.iter().find(|row| row.name == *name).map_or(0, |row| row.cut);
        let problem = match (spikes, coincidence, clipped) {
            (0, None, _) => {
                Some("it never fires, so there is nothing to compare; give input that drives it".to_string())
            }
            (0, Some(_), _) => Some("with integers it never fires, but the trained layer does".to_string()),
            (_, _, 1..) => target.map(|target| format!("its voltages clip: {}", clipping_advice(network, target))),
            _ => None,
        };
        let weight_exp = into.map(|(_, projection)| projection.format.exponent.get().into()).collect();
        LayerRow { name: name.clone(), coincidence: *coincidence, weight_exp, clipped, problem }
    });
    rows.collect()
}
