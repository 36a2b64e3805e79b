//! Published measurements compared with nsim's predictions.
//!
//! Input: workload files and constants with the findings of each group of authors. Output: a row
//! for each printed figure: predicted by all findings, and without the findings of the work's own
//! group. Omitted on purpose: sums and products of figures of a table (total power, energy-delay
//! product), which would count twice.

pub mod cells;
pub mod network;
pub mod paper;
pub mod predict;

use std::collections::BTreeMap;

use self::network::RateChoice;
use self::predict::predict;
use nsim_cost::CostTable;
use nsim_energy::published::workload::{FigureKind, Quantity, WorkloadFile};
use nsim_ir::hardware::Target;
use nsim_ir::hardware::constants::{Constants, Status, median};
use nsim_session::error::Error;

/// A printed figure and its prediction.
#[derive(Debug, Clone, PartialEq)]
pub struct PublishedRow {
    /// Name of the publication.
    pub work: String,
    /// Name of the workload within it.
    pub workload: String,
    /// The chip's name.
    pub chip: String,
    /// Measured quantity.
    pub quantity: Quantity,
    /// The printed value, in the quantity's unit.
    pub published: f64,
    /// The predicted value, in the quantity's unit.
    pub predicted: f64,
    /// The interval by the class of the figure and assumed rates; `None` without a class.
    pub interval: Option<(f64, f64)>,
    /// Whether the findings of the work's own authors were excluded.
    pub left_out: bool,
    /// Whether it counts in the averages of its chip.
    pub judged: bool,
    /// Whether the figure was read where it was first printed.
    pub first_hand: bool,
    /// Whether firing rates are published.
    pub activity: Status,
    /// Assumptions about the workload.
    pub assumed: Vec<String>,
    /// Source of the published value.
    pub source: String,
    /// Known cause of a large deviation.
    pub cause: Option<String>,
}

impl PublishedRow {
    /// Deviation of the prediction, as a factor of at least 1.
    pub fn factor(&self) -> f64 {
        (self.predicted / self.published).max(self.published / self.predicted)
    }
}

/// Rows of these workloads, in order: each figure by all findings, then without the findings of its
/// authors. The second row judges the model, where activity and layout are known. Figures known
/// second-hand have no second row. The first preset of their target predicts figures of hardware
/// other than the constants'.
///
/// # Errors
/// [`Error`] where a workload cannot be compiled or run.
pub fn rows(
    workloads: &[WorkloadFile],
    constants: &Constants,
    target: impl Fn(&str) -> Result<Target, Error>,
    progress: impl Fn(),
) -> Result<Vec<PublishedRow>, Error> {
    let mut rows = Vec::new();
    for file in workloads {
        let target = target(&file.target.value)?;
        let chip = target.chip();
        let constants = if chip.hardware() == constants.hardware { constants } else { &target.constants()[0] };
        let others = constants.without(&file.group);
        let mut tables = vec![CostTable::new(constants)?, CostTable::new(&others)?];
        for corners in [CostTable::corners(constants)?, CostTable::corners(&others)?] {
            tables.extend(corners.into_iter().flatten());
        }
        let figures = |choice: RateChoice| predict(file, &target, choice, &tables);
        let values = figures(|rate| rate.value)?;
        // A published rate has no range.
        let ends = match file.activity {
            Status::Published => None,
            _ => Some([figures(|rate| rate.low)?, figures(|rate| rate.high)?]),
        };
        let ways = if file.first_hand { 2 } else { 1 };
        for (which, left_out) in [false, true].into_iter().take(ways).enumerate() {
            for (number, figure) in file.figures.iter().enumerate() {
                let predicted = values[which][number];
                let at = |end: usize| ends.as_ref().map_or(predicted, |ends| ends[end][which][number]);
                let class = figure.quantity.class();
                let error = class.and_then(|class| constants.errors.iter().find(|error| error.class == class));
                // A rate and the model are wrong independently: their factors add up in squares.
                let of_rates = error.map(|error| {
                    let model = error.within_80.ln();
                    let reach = |end: f64| model.hypot((end / predicted).ln()).exp();
                    (
                        predicted / reach(at(0).min(at(1)).min(predicted)),
                        predicted * reach(at(0).max(at(1)).max(predicted)),
                    )
                });
                // Figures at the corners of the constants' bounds, at all rates.
                let corners = [2 + 2 * which, 3 + 2 * which].into_iter().filter(|&corner| corner < tables.len());
                let all = std::iter::once(&values).chain(ends.iter().flatten());
                let at_corners = all.flat_map(|values| corners.clone().map(move |corner| values[corner][number]));
                let interval = at_corners.fold(of_rates, |interval: Option<(f64, f64)>, figure| {
                    let (low, high) = interval.unwrap_or((predicted, predicted));
                    Some((low.min(figure), high.max(figure)))
                });
                rows.push(PublishedRow {
                    work: file.work.clone(),
                    workload: file.name.clone(),
                    chip: chip.name.clone(),
                    quantity: figure.quantity,
                    published: figure.published.value,
                    predicted,
                    interval,
                    left_out,
                    judged: left_out && file.judges,
                    first_hand: file.first_hand,
                    activity: file.activity,
                    assumed: file.assumed.clone(),
                    source: figure.source.clone(),
                    cause: figure.cause.clone(),
                });
            }
        }
        progress();
    }
    Ok(rows)
}

/// Median factor of each work on a chip, of time or of other kinds, without its own findings.
pub fn factors_by_work<'r>(rows: &'r [PublishedRow], chip: &str, time: bool) -> BTreeMap<&'r str, f64> {
    let mut by_work: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    let counted = |row: &&PublishedRow| row.judged && row.chip == chip;
    for row in rows.iter().filter(counted).filter(|row| (row.quantity.kind() == FigureKind::Time) == time) {
        by_work.entry(&row.work).or_default().push(row.factor());
    }
    by_work.into_iter().filter_map(|(work, factors)| Some((work, median(factors)?))).collect()
}

/// Geometric mean; `None` without factors.
pub fn geometric_mean(factors: impl ExactSizeIterator<Item = f64>) -> Option<f64> {
    let count = factors.len();
    (count > 0).then(|| (factors.map(f64::ln).sum::<f64>() / count as f64).exp())
}
