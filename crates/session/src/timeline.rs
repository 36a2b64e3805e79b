//! One sample, step by step: rows of all copies in the columns of [`StepLayout`], spikes and traces
//! of the first copy.
//!
//! Input: a mapping, a sample, settings of the meter, a quantity and the compartments to trace.
//! Output: a [`Timeline`]. Memory is bounded for any sample and network. It stores the first
//! [`MOST_STEPS`] steps and, of each population, at most [`MOST_UNITS`] equally spaced units and
//! [`MOST_SPIKES`] spikes. Fields report the omissions.

use std::sync::Arc;

use super::observers::StepRange;
use super::priced::MeteredMapping;
use super::samples::{Meter, RunSettings};
use super::steps::{Recorder, StepLayout};
use super::{Probe, Quantity, SampleSettings};
use nsim_cost::MeterSettings;
use nsim_ir::activity::StepActivity;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::id::{CompartmentId, Id};
use nsim_ir::quantised::{Quantised, Units};
use nsim_ir::spikes::Sample;

/// Maximum number of stored steps.
pub const MOST_STEPS: u32 = 1 << 15;
/// Maximum number of units of a population whose spikes are stored.
pub const MOST_UNITS: u32 = 400;
/// Maximum number of stored spikes of a population.
pub const MOST_SPIKES: usize = 40_000;

/// Spikes of some units of a population.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Raster {
    /// The population, by its index in the network.
    pub population: usize,
    /// Number of units of the population.
    pub units: u32,
    /// One unit in `every` is stored.
    pub every: u32,
    /// (step, unit), ascending by step.
    pub spikes: Vec<(u32, u32)>,
    /// Whether there were more spikes than are stored.
    pub cut: bool,
}

/// Rows, spikes and traces of the steps of a sample.
#[derive(Debug, Clone)]
pub struct Timeline {
    /// Number of stored steps, and of steps of the sample.
    pub steps: (u32, u32),
    /// Columns of a row.
    pub layout: StepLayout,
    /// A row for each stored step, in the integers of its columns' units.
    pub rows: Vec<u64>,
    /// Spikes by population, in the network's order.
    pub rasters: Vec<Raster>,
    /// The quantity of the traced compartments, `[compartments][steps]`.
    pub traces: Vec<Vec<i32>>,
}

/// A meter that stores rows and spikes of a sample.
struct TimelineMeter<'w> {
    recorder: Recorder<'w, 'w>,
    /// The first channel or compartment of each population.
    firsts: &'w [u32],
    rasters: Vec<Raster>,
    steps: u32,
}

impl TimelineMeter<'_> {
    /// Stores a spike; `populations` has the population of each source of the first copy only.
    fn keep(&mut self, populations: &[u32], source: usize) {
        let Some(&population) = populations.get(source) else { return };
        let (unit, raster) = (source as u32 - self.firsts[population as usize], &mut self.rasters[population as usize]);
        if unit % raster.every == 0 {
            match raster.spikes.len() < MOST_SPIKES {
                true => raster.spikes.push((self.steps, unit)),
                false => raster.cut = true,
            }
        }
    }
}

impl Meter for TimelineMeter<'_> {
    fn observe(&mut self, step: &StepActivity, range: StepRange) {
        self.recorder.observe(step, range);
        let layout = self.recorder.layout;
        step.channels.iter().for_each(|id| self.keep(&layout.channels, id.index()));
        step.fired.iter().for_each(|id| self.keep(&layout.compartments, id.index()));
        self.steps += range.steps;
    }

    /// There is one sample, so `self` is an empty meter.
    fn merge(&mut self, other: Self) {
        self.recorder.merge(other.recorder);
        (self.rasters, self.steps) = (other.rasters, other.steps);
    }
}

impl Timeline {
    /// Runs a sample on a mapping. Errors are those of [`MeteredMapping::run`].
    pub fn new(
        metered: &MeteredMapping<'_>,
        network: &Quantised,
        settings: MeterSettings,
        sample: &Sample,
        (traced, quantity): (&[CompartmentId], Quantity),
    ) -> Result<Self> {
        let (all, sample) = (sample.steps(), &sample.beginning(MOST_STEPS));
        let layout = StepLayout::new(network);
        let settings = Arc::new(settings);
        let firsts = network.populations().iter().map(|population| match population.units {
            Units::Input(first) => first.0,
            Units::Compartments { first, .. } => first.0,
        });
        let firsts: Vec<u32> = firsts.collect();
        let rasters = network.populations().iter().enumerate();
        let rasters: Vec<Raster> = rasters
            .map(|(population, of)| {
                let units = of.shape.len();
                Raster { population, units, every: units.div_ceil(MOST_UNITS).max(1), spikes: Vec::new(), cut: false }
            })
            .collect();
        let probes = traced.iter().map(|&first| Probe { first, count: 1, quantity }).collect();
        let sample_settings = SampleSettings { probes, ..SampleSettings::new(network.output()) };
        let run = metered.run_with(&[sample], RunSettings::new(&sample_settings), || TimelineMeter {
            recorder: Recorder::storing(metered, settings.clone(), &layout),
            firsts: &firsts,
            rasters: rasters.clone(),
            steps: 0,
        })?;
        let TimelineMeter { recorder, rasters, .. } = run.meter;
        let rows = recorder.cells;
        let outcome = run.outcomes.into_iter().next().unwrap_or_default();
        Ok(Timeline { steps: (sample.steps(), all), layout, rows, rasters, traces: outcome.probes })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_compile::{Options, compile};
    use nsim_golden::Golden;
    use nsim_ir::base::id::ChannelId;
    use nsim_ir::base::rng;
    use nsim_ir::quantised::Population;
    use nsim_ir::spikes::Engine;
    use nsim_testing::{limits, random_network, target};

    #[test]
    fn spikes_potentials_and_rows_are_those_of_the_interpreter() {
        for (seed, copies) in (0..12).zip([1, 1, 3].into_iter().cycle()) {
            let board = target(2, 2, limits());
            let compiled = compile(random_network(seed), &board, &Options { copies, ..Options::default() }).unwrap();
            let network = &compiled.one;
            let events: Vec<(u32, ChannelId)> = (0..40)
                .flat_map(|step| (0..network.channels()).map(move |channel| (step, ChannelId(channel))))
                .filter(|&(step, channel)| rng::below(4, seed, u64::from(step), channel.0.into()) == 0)
                .collect();
            let sample = Sample::new(60, &events, None).unwrap();
            let metered = MeteredMapping::new(&compiled);
            let (settings, _) = metered.offline(&board).unwrap();
            let watched: Vec<CompartmentId> = (0..network.compartments().min(5)).map(CompartmentId).collect();
            let found = Timeline::new(&metered, network, settings, &sample, (&watched, Quantity::Potential)).unwrap();
            let mut golden = Golden::new(network);
            golden.begin(60);
            let width = found.layout.columns().len();
            let mut meant: Vec<Vec<(u32, u32)>> = vec![Vec::new(); network.populations().len()];
            for step in 0..60 {
                golden.step(sample.input(step));
                for (&id, trace) in watched.iter().zip(&found.traces) {
                    assert_eq!(trace[step as usize], golden.v(id), "seed {seed}, step {step}, {id}");
                }
                let mut counts = vec![0u64; meant.len()];
                let mut spiked = |population: usize, unit: u32| {
                    meant[population].push((step, unit));
                    counts[population] += u64::from(copies);
                };
                for channel in sample.at(step) {
                    let unit = |population: &Population| {
                        let unit = channel.0.checked_sub(population.first_channel()?.0)?;
                        (unit < population.shape.len()).then_some(unit)
                    };
                    let (place, unit) =
                        network.populations().iter().enumerate().find_map(|(i, p)| Some((i, unit(p)?))).unwrap();
                    spiked(place, unit);
                }
                let mut fired = golden.spikes().to_vec();
                fired.sort_unstable();
                for id in fired {
                    let (population, unit) = network.population_of(id);
                    spiked(population.index(), unit);
                }
                assert_eq!(found.rows[step as usize * width..][..counts.len()], counts, "seed {seed}, step {step}");
            }
            for (raster, mut meant) in found.rasters.iter().zip(meant) {
                let mut spikes = raster.spikes.clone();
                spikes.sort_unstable();
                meant.sort_unstable();
                assert_eq!((spikes, raster.cut, raster.every), (meant, false, 1), "seed {seed}");
            }
            assert_eq!(found.rows.len(), 60 * width);
        }
    }
}
