//! Published measurements beside what nsim predicts for them.
//!
//! Input: workload files and the evidence for constants. Output: a row for each printed figure: predicted by all evidence, and
//! by the evidence that is left without the work itself. Each workload is compiled, simulated and priced like a user's network.
//!
//! Left out on purpose: sums and products of figures of a table (total power, energy-delay product), which would count what is
//! already counted again.

pub mod cells;
pub mod network;
pub mod paper;
pub mod predict;

use std::collections::BTreeSet;

use self::predict::{PredictError, Predicted, predict};
use crate::cost::evidence::ConstantSets;
use crate::desc::published::evidence::{EvidenceFile, Jobs};
use crate::desc::published::workload::{Accounting, FigureKind, Quantity, WorkloadFile};
use crate::desc::target::Target;
use crate::desc::target::constants::{Constants, Status};

/// A printed figure and its prediction.
#[derive(Debug, Clone, PartialEq)]
pub struct PublishedRow {
    /// The work.
    pub work: String,
    /// The workload.
    pub workload: String,
    /// What was measured.
    pub quantity: Quantity,
    /// The printed value, in the quantity's unit.
    pub published: f64,
    /// What nsim says.
    pub predicted: Predicted,
    /// Whether the evidence that comes from the work was left out.
    pub left_out: bool,
    /// Whether the figure was read where it was first printed.
    pub first_hand: bool,
    /// What the figure attributes to the chip.
    pub accounting: Accounting,
    /// Whether firing rates are published.
    pub activity: Status,
    /// Where it is printed.
    pub source: String,
    /// Why the prediction is far off, where that is known.
    pub cause: Option<String>,
}

impl PublishedRow {
    /// Predicted by published.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        self.predicted.value / self.published
    }
}

/// The nominal coverage of the intervals.
const COVERAGE: f64 = 0.9;

/// The rows of these workloads, in their order: each figure by all evidence, then without its work.
///
/// # Errors
/// [`PredictError`] where a workload cannot be compiled or run.
pub fn rows(
    workloads: &[WorkloadFile],
    evidence: &EvidenceFile,
    base: &Constants,
    target: impl Fn(&str) -> Result<Target, PredictError>,
    progress: impl Fn(),
) -> Result<Vec<PublishedRow>, PredictError> {
    let mut rows = Vec::new();
    let of_all = |jobs| ConstantSets::new(evidence, base, None, jobs);
    let (one_chip, several) = (of_all(Jobs::OneChip)?, of_all(Jobs::SeveralChips)?);
    for file in workloads {
        let jobs = Jobs::on_chips(file.deployment.chips_used);
        let shipped = match jobs {
            Jobs::OneChip => &one_chip,
            Jobs::SeveralChips => &several,
        };
        let without = ConstantSets::new(evidence, base, Some(&file.work), jobs)?;
        let predictions = predict(file, &target(&file.target.value)?, [shipped, &without])?;
        for (predictions, left_out) in predictions.into_iter().zip([false, true]) {
            for (figure, predicted) in file.figures.iter().zip(predictions) {
                rows.push(PublishedRow {
                    work: file.work.clone(),
                    workload: file.name.clone(),
                    quantity: figure.quantity,
                    published: figure.published.value,
                    predicted,
                    left_out,
                    first_hand: file.first_hand,
                    accounting: figure.accounting,
                    activity: file.activity,
                    source: figure.source.clone(),
                    cause: figure.cause.clone(),
                });
            }
        }
        progress();
    }
    widen(&mut rows);
    Ok(rows)
}

/// Works that must have printed figures of a group before they are judged by themselves, the predicted work not counted.
const LEAST_WORKS: usize = 3;

/// Quantities that the same constants and assumptions make wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum QuantityGroup {
    CoreStatic,
    CoreDynamic,
    X86Static,
    X86Dynamic,
    Dynamic,
    Time,
}

fn group(quantity: Quantity) -> QuantityGroup {
    match quantity {
        Quantity::CoreStaticPower => QuantityGroup::CoreStatic,
        Quantity::CoreDynamicPower | Quantity::CoreStepEnergy => QuantityGroup::CoreDynamic,
        Quantity::X86StaticPower => QuantityGroup::X86Static,
        Quantity::X86DynamicPower => QuantityGroup::X86Dynamic,
        Quantity::DynamicPower | Quantity::InferenceDynamicEnergy => QuantityGroup::Dynamic,
        Quantity::StepTime | Quantity::SpikingTime => QuantityGroup::Time,
    }
}

/// Widens the interval of each row by how far the model missed figures of other works: constants and rates are not all that
/// can be wrong. The factor is the least by which nine in ten of the first-hand figures left out of other works, of the same group, lie
/// within; of all energies and powers where fewer than [`LEAST_WORKS`] others have printed one of the group (split conformal prediction
/// with works as groups, by categories, without the correction for few figures: Vovk, Gammerman and Shafer 2005, chapter 4; what the
/// intervals then hold is counted by [`held`]). Without categories the power of an x86 core, on which five
/// works agree to a quarter, would have the interval of the static power of cores, on which they differ eleven-fold.
fn widen(rows: &mut [PublishedRow]) {
    let is_time = |row: &PublishedRow| row.quantity.kind() == FigureKind::Time;
    // By how much more an interval would have to reach out to hold its figure.
    let missing = |row: &PublishedRow| {
        let Predicted { low, high, .. } = row.predicted;
        (row.published / high).max(low / row.published).max(1.0)
    };
    let factors: Vec<f64> = rows
        .iter()
        .map(|row| {
            let counts = |other: &&PublishedRow| other.left_out && other.first_hand && other.work != row.work;
            let others: Vec<&PublishedRow> =
                rows.iter().filter(counts).filter(|other| is_time(other) == is_time(row)).collect();
            let own: Vec<&PublishedRow> =
                others.iter().copied().filter(|other| group(other.quantity) == group(row.quantity)).collect();
            let works: BTreeSet<&str> = own.iter().map(|other| other.work.as_str()).collect();
            let judged = if works.len() < LEAST_WORKS { others } else { own };
            let mut missed: Vec<f64> = judged.into_iter().map(missing).collect();
            missed.sort_by(f64::total_cmp);
            let held = (COVERAGE * missed.len() as f64).ceil() as usize;
            missed.get(held.saturating_sub(1)).copied().unwrap_or(1.0)
        })
        .collect();
    for (row, factor) in rows.iter_mut().zip(factors) {
        row.predicted.low /= factor;
        row.predicted.high *= factor;
    }
}

/// How well predictions held.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// Figures counted.
    pub figures: usize,
    /// Their works.
    pub works: usize,
    /// Median of |ratio - 1| of energies and powers.
    pub energy_error: Option<f64>,
    /// Of times.
    pub time_error: Option<f64>,
    /// Share of figures inside their intervals.
    pub inside: f64,
    /// Median of how far an interval reaches to its farther side, as a factor.
    pub width: f64,
    /// Figures that are off by more than 2.5 times.
    pub far: usize,
}

/// How well predictions held of first-hand figures, with their works left out or by all evidence; `None` without any.
#[must_use]
pub fn held(rows: &[PublishedRow], left_out: bool) -> Option<Held> {
    let counted: Vec<&PublishedRow> = rows.iter().filter(|row| row.left_out == left_out && row.first_hand).collect();
    let error = |time: bool| {
        let own = counted.iter().filter(|row| (row.quantity.kind() == FigureKind::Time) == time);
        median(own.map(|row| (row.ratio() - 1.0).abs()).collect())
    };
    let within = |row: &&&PublishedRow| (row.predicted.low..=row.predicted.high).contains(&row.published);
    let width =
        |row: &&PublishedRow| (row.predicted.high / row.predicted.value).max(row.predicted.value / row.predicted.low);
    Some(Held {
        figures: counted.len(),
        works: counted.iter().map(|row| &row.work).collect::<BTreeSet<_>>().len(),
        energy_error: error(false),
        time_error: error(true),
        inside: counted.iter().filter(within).count() as f64 / counted.len().max(1) as f64,
        width: median(counted.iter().map(width).collect())?,
        far: counted.iter().filter(|row| !(0.4..=2.5).contains(&row.ratio())).count(),
    })
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        1 => Some(values[middle]),
        _ => Some((values.get(middle.checked_sub(1)?)? + values.get(middle)?) / 2.0),
    }
}
