//! Binning of events in time and space; bins become spikes.
//!
//! Input: a stream of events. Output: the spikes of a sample. Only occupied bins are stored, each
//! with its number of events; new events are merged in batches.

use super::event::{Counts, Event, Sink, wrong};
use super::text::unit_unknown;
use crate::spikes::options::{EventOptions, Origin, Polarity};
use crate::spikes::population::{InputSpec, PopulationSpikes, too_many};
use nsim_files::budget::{MOST_EVENTS, MOST_STEPS};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The least number of events of a batch.
const BATCH: usize = 1 << 16;

/// The used part of the sensor, and its pooled columns and rows.
#[derive(Debug, Clone, Copy)]
struct Grid {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
    pool: (u32, u32),
    columns: u32,
    rows: u32,
}

/// The bins of a recording, within a window in space and time.
pub struct Bins {
    options: EventOptions,
    bin_us: f64,
    start: Origin,
    /// The default size of the format's sensor.
    assumed: Option<(u32, u32)>,
    /// Whether the polarities of a place are adjacent channels instead of separate planes.
    interleaved: bool,
    expected: InputSpec,
    sensor: Option<(u32, u32)>,
    grid: Option<Grid>,
    start_us: Option<i64>,
    last_step: u32,
    counts: Counts,
    /// New events: the step in the high 32 bits, the channel in the low 32 bits.
    recent: Vec<u64>,
    /// Occupied bins, sorted, each with its number of events.
    settled: Vec<(u64, u32)>,
}

impl Bins {
    /// Empty bins for a population.
    pub fn new(
        expected: &InputSpec,
        options: &EventOptions,
        assumed: Option<(u32, u32)>,
        interleaved: bool,
        start: Origin,
    ) -> Result<Self> {
        let bin_us = options.bin_us.unwrap_or(expected.dt_ms * 1e3);
        if !(bin_us > 0.0 && bin_us.is_finite()) {
            return Err(Diagnostic::new("input.option", format!("a timestep of {bin_us} us")));
        }
        Ok(Bins {
            options: options.clone(),
            bin_us,
            start: options.start.unwrap_or(start),
            assumed,
            interleaved,
            expected: *expected,
            sensor: None,
            grid: None,
            start_us: None,
            last_step: 0,
            counts: Counts::default(),
            recent: Vec::new(),
            settled: Vec::new(),
        })
    }

    /// The grid, from the options, the file, the population or the format's usual sensor, by
    /// priority.
    fn grid(&mut self) -> Result<Grid> {
        if let Some(grid) = self.grid {
            return Ok(grid);
        }
        let Bins { options, expected, assumed, .. } = &*self;
        let pool = options.pool.unwrap_or((1, 1));
        let planes = if options.polarity == Polarity::Both { 2 } else { 1 };
        let of_population = expected
            .volume
            .filter(|volume| volume.0 == planes)
            .map(|(_, h, w)| (w.saturating_mul(pool.0), h.saturating_mul(pool.1)));
        let size = match (options.crop, options.size, self.sensor) {
            (Some(crop), _, _) => (crop.2, crop.3),
            (None, Some(size), _) | (None, None, Some(size)) => size,
            (None, None, None) => of_population
                .or(*assumed)
                .or_else(|| u32::try_from(expected.units / u64::from(planes)).ok().map(|n| (n, 1)))
                .ok_or_else(|| wrong("the size of the sensor is missing").help("add size=W,H to the source"))?,
        };
        let (left, top) = options.crop.map_or((0, 0), |crop| (crop.0, crop.1));
        let (columns, rows) = (size.0.div_ceil(pool.0), size.1.div_ceil(pool.1));
        let channels = u64::from(columns) * u64::from(rows) * u64::from(planes);
        if channels != expected.units {
            let message = format!(
                "{} x {} pixels pooled by {} x {} and {} make {channels} channels, the population has {}",
                size.0,
                size.1,
                pool.0,
                pool.1,
                if planes == 2 { "two polarities" } else { "one polarity" },
                expected.units
            );
            return Err(Diagnostic::new("input.shape", message).help(
                "add size=W,H, crop=X,Y,W,H, pool=N or polarity=merge to the source: FILE?pool=4&polarity=merge",
            ));
        }
        let grid = Grid { left, top, width: size.0, height: size.1, pool, columns, rows };
        self.grid = Some(grid);
        Ok(grid)
    }

    fn merge_recent(&mut self) -> Result<()> {
        self.recent.sort_unstable();
        self.settled.reserve_exact(self.recent.len());
        self.settled.extend(self.recent.drain(..).map(|key| (key, 1)));
        // Two ascending runs, which a stable sort merges in linear time.
        self.settled.sort_by_key(|(key, _)| *key);
        self.settled.dedup_by(|next, kept| {
            let same = next.0 == kept.0;
            kept.1 = kept.1.saturating_add(if same { next.1 } else { 0 });
            same
        });
        self.settled.shrink_to_fit();
        if self.settled.len() > MOST_EVENTS {
            return Err(too_many());
        }
        Ok(())
    }

    /// The step of a time; `None` before the start or after the end.
    fn step(&mut self, t_us: i64) -> Result<Option<u32>> {
        let start = *self.start_us.get_or_insert(match self.start {
            Origin::First => t_us,
            Origin::At(start) => start,
        });
        let bins = t_us.saturating_sub(start) as f64 / self.bin_us;
        let step = if self.options.nearest { bins.round_ties_even() } else { bins.floor() };
        if step < 0.0 {
            return Ok(None);
        }
        match self.options.steps {
            Some(steps) => Ok((step < f64::from(steps)).then_some(step as u32)),
            None if step < f64::from(MOST_STEPS) => Ok(Some(step as u32)),
            None => Err(Diagnostic::new(
                "input.too-long",
                format!("an event at {t_us} us falls into step {step}, beyond {MOST_STEPS}"),
            )
            .help(
                "give the number of timesteps (steps=N), a longer bin (bin_ms=T), or start at the first event \
                (start=first)",
            )),
        }
    }

    /// Refuses times without a unit that are implausible as microseconds. A camera has from one
    /// event per second to a thousand per microsecond. A recording is longer than a timestep.
    fn check_unit(&self) -> Result<()> {
        let Counts { events, span_us: Some((first, last)), unit_assumed: true, .. } = self.counts else {
            return Ok(());
        };
        let span = last.saturating_sub(first) as f64;
        let (gaps, step) = (events as f64 - 1.0, self.bin_us);
        let short = span < step && events > 2 && span > 0.0;
        if short || span > gaps * 1e6 || gaps > span * 1e3 && span > 0.0 {
            let message = format!(
                "the unit of the times is missing, and microseconds are implausible: {events} events in {} ms",
                span / 1e3
            );
            return Err(unit_unknown(message));
        }
        Ok(())
    }

    /// The sample, and the counts.
    pub fn finish(mut self, name: &str) -> Result<(PopulationSpikes, Counts)> {
        self.grid()?;
        self.merge_recent()?;
        self.check_unit()?;
        let least = self.options.least.unwrap_or(1.0);
        let steps = match self.options.steps {
            Some(steps) => steps,
            None if self.settled.is_empty() => {
                return Err(Diagnostic::new("input.empty", "no event falls into the window")
                    .help("give the number of steps of a silent recording: steps=N"));
            }
            None => self.last_step + 1,
        };
        let events: Vec<(u32, u32)> = self
            .settled
            .iter()
            .filter(|(_, count)| f64::from(*count) >= least)
            .map(|(key, _)| ((key >> 32) as u32, *key as u32))
            .collect();
        self.counts.faint = (self.settled.len() - events.len()) as u64;
        self.counts.merged = self.counts.events - self.counts.dropped - self.settled.len() as u64;
        let (units, name) = (Some(self.expected.units), name.to_string());
        Ok((PopulationSpikes { units, steps, events, name, ..Default::default() }, self.counts))
    }
}

impl Sink for Bins {
    fn size(&mut self, columns: u32, rows: u32) {
        if columns > 0 && rows > 0 {
            self.sensor.get_or_insert((columns, rows));
        }
    }

    fn counts(&mut self) -> &mut Counts {
        &mut self.counts
    }

    fn event(&mut self, event: Event) -> Result<()> {
        let grid = self.grid()?;
        self.counts.event(event.t_us);
        let step = self.step(event.t_us)?;
        let plane = match self.options.polarity {
            Polarity::Both => Some(u32::from(event.on)),
            Polarity::Merge => Some(0),
            Polarity::On => event.on.then_some(0),
            Polarity::Off => (!event.on).then_some(0),
        };
        let x = event.x.checked_sub(grid.left).filter(|&x| x < grid.width);
        let y = event.y.checked_sub(grid.top).filter(|&y| y < grid.height);
        let (Some(step), Some(plane), Some(x), Some(y)) = (step, plane, x, y) else {
            self.counts.dropped += 1;
            return Ok(());
        };
        let (row, column) = (y / grid.pool.1, x / grid.pool.0);
        let channel = match (self.interleaved, self.options.polarity) {
            (true, Polarity::Both) => (row * grid.columns + column) * 2 + plane,
            _ => (plane * grid.rows + row) * grid.columns + column,
        };
        self.last_step = self.last_step.max(step);
        self.recent.push(u64::from(step) << 32 | u64::from(channel));
        // Batches that grow with the table keep the total work near the cost of a single sort.
        if self.recent.len() >= BATCH.max(self.settled.len()) {
            self.merge_recent()?;
        }
        Ok(())
    }
}
