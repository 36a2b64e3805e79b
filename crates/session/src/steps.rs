//! Runs with a row for each timestep: spikes by population, events, messages, hops, time and energy
//! by part.
//!
//! Input: a mapping, samples, settings of the meter. Output: the run, and its rows in the order of
//! the samples in a [`StepWriter`]. Invariant: rows sum exactly to the totals of the run, since the
//! columns are integers (ps and fJ).
//!
//! Memory is bounded: samples run in parallel in groups of at most [`CELLS`] numbers in total. A
//! longer sample runs alone, and its rows are written during the run. Samples of a network that
//! learns are one group.

use std::sync::{Arc, Mutex, PoisonError};

use super::learning::learns;
use super::observers::StepRange;
use super::priced::MeteredMapping;
use super::samples::{Meter, Run, RunSettings};
use nsim_cost::model::{Breakdown, StepTime, energy_of_counts};
use nsim_cost::{MeterSettings, StepMeter};
use nsim_files::steps::{Column, StepWriter, Unit};
use nsim_ir::activity::StepActivity;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::Id;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::Sample;

/// Maximum number of values of a group of samples, 8 bytes each.
pub const CELLS: usize = 1 << 22;
/// Number of rows of a long sample that are written in one call.
const ROWS_TOGETHER: usize = 1 << 10;

/// The columns of a row, and the population of each channel and compartment.
#[derive(Debug, Clone)]
pub struct StepLayout {
    columns: Vec<Column>,
    /// Population of each channel of one copy; then population of each compartment.
    pub(super) channels: Vec<u32>,
    pub(super) compartments: Vec<u32>,
    populations: usize,
}

impl StepLayout {
    /// Returns the columns for a network; rows are sums over its copies.
    pub fn new(network: &Quantised) -> Self {
        let (mut channels, mut compartments, mut columns) = (Vec::new(), Vec::new(), Vec::new());
        let mut add = |name: String, unit| columns.push(Column { name, unit });
        for (number, population) in (0..).zip(network.populations()) {
            let units = if population.first_channel().is_some() { &mut channels } else { &mut compartments };
            units.extend((0..population.shape.len()).map(|_| number));
            add(format!("spikes.{}", population.name), Unit::Count);
        }
        for name in ["synaptic_events", "messages", "hops"] {
            add(name.to_string(), Unit::Count);
        }
        for (name, _) in StepTime::default().parts() {
            add(format!("time_us.{}", name.replace(' ', "_")), Unit::Microseconds);
        }
        let learns = learns(&network.parts().rules);
        for (name, _) in Breakdown::default().parts().into_iter().filter(|(name, _)| learns || *name != "learning") {
            add(format!("energy_pj.{name}"), Unit::Picojoules);
        }
        StepLayout { columns, channels, compartments, populations: network.populations().len() }
    }

    /// The columns.
    pub fn columns(&self) -> &[Column] {
        &self.columns
    }
}

/// A meter that stores the rows of its sample, or writes them.
pub(super) struct Recorder<'r, 'w> {
    meter: StepMeter,
    pub(super) layout: &'r StepLayout,
    /// Number of copies that run, and number of all copies.
    copies: (u64, u64),
    /// Concatenated rows that are not written yet.
    pub(super) cells: Vec<u64>,
    /// Writer of rows during the run; `None` where rows are stored.
    direct: Option<&'r Mutex<StepWriter<'w>>>,
}

impl<'r> Recorder<'r, '_> {
    /// Returns a recorder that stores rows over all copies of a mapping.
    pub(super) fn storing(metered: &MeteredMapping<'_>, settings: Arc<MeterSettings>, layout: &'r StepLayout) -> Self {
        let copies = (metered.copies_run().into(), metered.copies().into());
        Recorder { meter: StepMeter::new(settings), layout, copies, cells: Vec::new(), direct: None }
    }

    fn add_row(&mut self, step: &StepActivity) {
        let layout = self.layout;
        let start = self.cells.len();
        self.cells.resize(start + layout.populations, 0);
        let row = &mut self.cells[start..];
        for channel in &step.channels {
            row[layout.channels[channel.index() % layout.channels.len()] as usize] += 1;
        }
        for compartment in &step.fired {
            row[layout.compartments[compartment.index() % layout.compartments.len()] as usize] += 1;
        }
        let (run, all) = self.copies;
        row.iter_mut().for_each(|spikes| *spikes = *spikes / run.max(1) * all);
        let routes = &self.meter.settings().routes;
        let (sum, hops) = (routes.sum_of_cores(step), routes.hops(step));
        self.cells.extend([sum.synaptic_events(), sum.messages_in, hops.total_links()]);
        self.cells.extend(self.meter.last_time().parts().map(|(_, part)| part.0));
        // The meter of a recorder has at least one preset.
        let energy = self.meter.tables().first().map(|table| energy_of_counts(sum, hops, table));
        let parts = energy.unwrap_or_default().parts();
        self.cells.extend(parts.map(|(_, part)| u64::try_from(part.0).unwrap_or(u64::MAX)));
        // The last part, learning, has a column in networks that learn.
        self.cells.truncate(start + layout.columns.len());
    }

    fn flush(&mut self) {
        if let Some(direct) = self.direct {
            let mut out = direct.lock().unwrap_or_else(PoisonError::into_inner);
            self.cells.chunks(self.layout.columns.len()).for_each(|row| out.row(row));
            self.cells.clear();
        }
    }
}

impl Meter for Recorder<'_, '_> {
    fn observe(&mut self, step: &StepActivity, range: StepRange) {
        self.meter.observe(step, range);
        let start = self.cells.len();
        self.add_row(step);
        let width = self.layout.columns.len();
        for _ in 1..range.steps {
            if self.direct.is_some() && self.cells.len() > ROWS_TOGETHER * width {
                let row = self.cells[self.cells.len() - width..].to_vec();
                self.cells.truncate(self.cells.len() - width);
                self.flush();
                self.cells.extend(row);
            }
            let from = self.cells.len() - width;
            self.cells.extend_from_within(from..);
        }
        debug_assert!(self.direct.is_some() || self.cells.len() == start + range.steps as usize * width);
        if self.cells.len() >= ROWS_TOGETHER * width {
            self.flush();
        }
    }

    fn merge(&mut self, other: Self) {
        self.meter.merge(&other.meter);
        // Samples are merged in run order.
        self.cells.extend(other.cells);
    }
}

/// Runs samples on a mapping, meters each step and writes a row for it.
///
/// # Errors
/// As [`MeteredMapping::run`]. The second result has the error of writing rows; later
/// samples do not run.
pub fn run_recorded(
    metered: &MeteredMapping<'_>,
    settings: MeterSettings,
    samples: &[&Sample],
    run_settings: RunSettings<'_>,
    layout: &StepLayout,
    out: StepWriter<'_>,
) -> Result<(Run<StepMeter>, std::io::Result<()>)> {
    let (settings, out) = (Arc::new(settings), Mutex::new(out));
    let mut whole: Option<Run<StepMeter>> = None;
    // What was learned stays from sample to sample.
    let learns = learns(&metered.program().parts().learning.rules);
    for group in groups(samples, if learns { 0 } else { layout.columns.len() }) {
        let steps: usize = group.iter().map(|sample| sample.steps() as usize).sum();
        let direct = (steps * layout.columns.len() > CELLS && group.len() == 1).then_some(&out);
        let mut run = metered.run_with(group, run_settings, || Recorder {
            direct,
            ..Recorder::storing(metered, settings.clone(), layout)
        })?;
        run.meter.flush();
        let mut writer = out.lock().unwrap_or_else(PoisonError::into_inner);
        let mut cells = run.meter.cells.chunks(layout.columns.len());
        for outcome in &run.outcomes {
            cells.by_ref().take(outcome.steps as usize).for_each(|row| writer.row(row));
            writer.end_sample();
        }
        let run = run.map_meter(|rows| rows.meter);
        match &mut whole {
            None => whole = Some(run),
            Some(whole) => whole.append(run),
        }
        if !writer.is_sound() {
            break;
        }
    }
    let whole = match whole {
        Some(whole) => whole,
        None => metered.run_with(&[], run_settings, || StepMeter::new(settings.clone()))?,
    };
    let written = out.into_inner().unwrap_or_else(PoisonError::into_inner).finish();
    Ok((metered.extend_to_all_copies(whole), written))
}

/// Returns groups of consecutive samples with at most [`CELLS`] numbers in total, or of one longer
/// sample.
pub(super) fn groups<'g, 's>(samples: &'g [&'s Sample], columns: usize) -> Vec<&'g [&'s Sample]> {
    let (mut groups, mut start, mut cells) = (Vec::new(), 0, 0);
    for (index, sample) in samples.iter().enumerate() {
        let more = sample.steps() as usize * columns;
        if index > start && cells + more > CELLS {
            groups.push(&samples[start..index]);
            (start, cells) = (index, 0);
        }
        cells += more;
    }
    if start < samples.len() {
        groups.push(&samples[start..]);
    }
    groups
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_hold_all_samples_in_order_and_few_numbers() {
        let sample = |steps: usize| Sample::new(steps as u32, &[], None).unwrap();
        let (short, long) = (sample(CELLS / 8), sample(CELLS));
        let samples = [&short, &short, &long, &short, &short, &short, &short, &short];
        let sizes: Vec<usize> = groups(&samples, 2).iter().map(|group| group.len()).collect();
        assert_eq!(sizes, [2, 1, 4, 1]);
        assert!(groups(&[], 2).is_empty());
    }
}
