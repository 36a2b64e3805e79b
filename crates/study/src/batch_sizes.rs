//! Time and energy of a sample against how many samples are passed together.
//!
//! Input: what passes a batch, or a model of it. Output: a [`BatchRow`] for each hardware and batch
//! size, and at which size one needs less than another ([`crossings`]). A chip passes a sample on
//! each copy of the network and takes as many rounds as it needs; a processor passes samples on all
//! its threads; a GPU passes them beside each other. The time of a batch is that from its first
//! input to its last output: no sample of it is ready sooner.

use std::time::Duration;

use rayon::prelude::*;

use nsim_cost::estimate::FigureSource;
use nsim_energy::baseline::{Baseline, Work};
use nsim_energy::cpu::{Dense, timed};
use nsim_energy::power::PowerMeter;
use nsim_ir::program::Program;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Copies, Sample};
use nsim_session::Keep;
use nsim_session::samples::{Division, Running, fast_on, laid_out};

/// Some hardware and a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchRow {
    /// What passes it.
    pub hardware: String,
    /// Samples of the batch.
    pub batch: u32,
    /// How many of them are passed at once.
    pub together: u32,
    /// From the first input to the last output.
    pub batch_ms: f64,
    /// Of a sample; `None` where nobody knows the power.
    pub energy_uj: Option<f64>,
    /// Where the time comes from.
    pub source: FigureSource,
    /// Where the power comes from.
    pub power_source: FigureSource,
    /// How it was found.
    pub note: String,
}

impl BatchRow {
    /// Of a sample, in the mean.
    #[must_use]
    pub fn sample_ms(&self) -> f64 {
        self.batch_ms / f64::from(self.batch.max(1))
    }

    /// Samples a second.
    #[must_use]
    pub fn throughput(&self) -> f64 {
        1e3 / self.sample_ms().max(f64::MIN_POSITIVE)
    }
}

/// What copies of a network on the chip come to.
#[derive(Debug, Clone, PartialEq)]
pub struct OnChip {
    /// The target.
    pub target: String,
    /// Copies, each of which passes a sample.
    pub copies: u32,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Of a timestep of all copies.
    pub latency_us: f64,
    /// Of a timestep of one copy.
    pub energy_uj: f64,
}

/// A batch on copies of a network. The last round costs as much as a full one.
#[must_use]
pub fn chip(found: &OnChip, batch: u32) -> BatchRow {
    let rounds = batch.div_ceil(found.copies.max(1));
    let passed = f64::from(rounds) * f64::from(found.copies) / f64::from(batch.max(1));
    BatchRow {
        hardware: found.target.clone(),
        batch,
        together: found.copies.min(batch),
        batch_ms: f64::from(rounds) * f64::from(found.steps) * found.latency_us / 1e3,
        energy_uj: Some(found.energy_uj * f64::from(found.steps) * passed),
        source: FigureSource::Modelled,
        power_source: FigureSource::Modelled,
        note: match rounds {
            1 => format!("{} copies", found.copies),
            _ => format!("{rounds} rounds of {} copies: {batch} do not fit together", found.copies),
        },
    }
}

/// A batch on hardware of which a roofline is known.
#[must_use]
pub fn modelled(baseline: &Baseline, work: &Work, steps: u32, batch: u32) -> Option<BatchRow> {
    let figures = baseline.modelled_batch(work, steps, batch)?;
    let energy_uj = (figures.static_mw + figures.dynamic_mw) * figures.latency_us / 1e3 / f64::from(batch.max(1));
    Some(BatchRow {
        hardware: baseline.file().hardware.clone(),
        batch,
        together: batch,
        batch_ms: figures.latency_us / 1e3,
        energy_uj: Some(energy_uj),
        source: figures.source,
        power_source: figures.power_source,
        note: "from its peak rate, bandwidth, overhead a layer and power".to_string(),
    })
}

/// Samples of a batch: those that there are, again and again.
fn batch_of<'s>(samples: &[&'s Sample], batch: u32) -> Vec<&'s Sample> {
    samples.iter().copied().cycle().take(batch as usize).collect()
}

/// Measures a pass of a batch and its power.
fn measured(name: String, batch: u32, budget: Duration, meter: &PowerMeter, pass: impl FnMut()) -> BatchRow {
    let (timed, power) = meter.during(|| timed(u64::from(batch), budget, pass));
    let batch_us = timed.us_per_timestep * f64::from(batch);
    BatchRow {
        hardware: name,
        batch,
        together: batch,
        batch_ms: batch_us / 1e3,
        energy_uj: Some((power.static_mw + power.dynamic_mw) * timed.us_per_timestep / 1e3),
        source: FigureSource::Measured,
        power_source: power.source,
        note: format!(
            "median of {} repeats, fastest {:.3} ms; {}",
            timed.repeats,
            timed.fastest * f64::from(batch) / 1e3,
            meter.source()
        ),
    }
}

/// Threads that a batch keeps busy here.
#[must_use]
pub fn threads_for(batch: u32) -> usize {
    rayon::current_num_threads().min(batch as usize).max(1)
}

fn with_threads(name: &str, together: usize) -> String {
    format!("{name}, {together} {}", if together == 1 { "thread" } else { "threads" })
}

/// A batch on nsim's own machine, on all threads.
///
/// # Errors
/// Why the program cannot run.
pub fn event_driven(
    program: &Program,
    samples: &[&Sample],
    batch: u32,
    budget: Duration,
    meter: &PowerMeter,
) -> Result<BatchRow, String> {
    let samples = batch_of(samples, batch);
    let division = Division::new(program, samples.len());
    let image = laid_out(program, division).map_err(|error| error.to_string())?;
    let keep = Keep { output: program.output(), probes: Vec::new(), early_exit: None };
    let running =
        Running { keep: &keep, copies: Copies::ONE, skip: true, per_step: false, progress: &|| (), ranks: None };
    let together = threads_for(batch);
    let pass = || drop(std::hint::black_box(fast_on(&image, division, &samples, running, || ())));
    let name = with_threads("CPU, event-driven", rayon::current_num_threads());
    Ok(BatchRow { together: together as u32, ..measured(name, batch, budget, meter, pass) })
}

/// A batch as dense products in f32, on all threads.
///
/// # Errors
/// Why the network has no dense form.
pub fn dense(
    network: &Quantised,
    samples: &[&Sample],
    batch: u32,
    budget: Duration,
    meter: &PowerMeter,
) -> Result<BatchRow, String> {
    let (dense, samples) = (Dense::new(network)?, batch_of(samples, batch));
    let pass = || samples.par_iter().for_each(|sample| drop(std::hint::black_box(dense.pass(sample))));
    let name = with_threads("CPU, dense f32", rayon::current_num_threads());
    Ok(BatchRow { together: threads_for(batch) as u32, ..measured(name, batch, budget, meter, pass) })
}

/// A batch on the GPU; its energy is unknown unless the board's power is.
///
/// # Errors
/// Why it cannot be passed.
#[cfg(feature = "gpu")]
pub fn gpu<A: crate::batch::Arithmetic>(
    gpu: &crate::batch::Gpu,
    form: &crate::batch::BatchForm<A>,
    (samples, steps): (&[&Sample], u32),
    batch: u32,
    budget: Duration,
) -> Result<BatchRow, String> {
    let (batches, samples) = (gpu.batches(form, batch, steps)?, batch_of(samples, batch));
    batches.run(&samples)?;
    let mut failed = None;
    let (timed, power_mw) = with_board_power(|| {
        timed(u64::from(batch), budget, || {
            if let Err(error) = batches.run(&samples) {
                failed = Some(error);
            }
        })
    });
    if let Some(error) = failed {
        return Err(error);
    }
    let software = if gpu.is_software() { ", software" } else { "" };
    let power = match &power_mw {
        Ok(mw) => format!("board power {:.1} W by NVML", mw / 1e3),
        Err(why) => format!("power unknown: {why}"),
    };
    Ok(BatchRow {
        hardware: format!("{}{software}, {}", gpu.name(), A::NAME),
        batch,
        together: batch,
        batch_ms: timed.us_per_timestep * f64::from(batch) / 1e3,
        energy_uj: power_mw.ok().map(|mw| mw * timed.us_per_timestep / 1e3),
        source: FigureSource::Measured,
        power_source: FigureSource::Measured,
        note: format!("median of {} repeats; {power}", timed.repeats),
    })
}

/// Runs something while the board's power is read as often as it changes; its mean in mW.
#[cfg(all(feature = "gpu", feature = "nvml"))]
fn with_board_power<T: Send>(run: impl FnOnce() -> T + Send) -> (T, Result<f64, String>) {
    use std::sync::atomic::{AtomicBool, Ordering};
    let done = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let done = &done;
        let watch = scope.spawn(move || {
            nsim_energy::gpu::with_nvml(|_, power| {
                let (mut sum, mut readings) = (0.0, 0u32);
                while !done.load(Ordering::Relaxed) {
                    sum += power()?;
                    readings += 1;
                    std::thread::sleep(Duration::from_millis(20));
                }
                if readings == 0 {
                    Err("the board was not read in time".to_string())
                } else {
                    Ok(sum / f64::from(readings))
                }
            })
            .and_then(|read| read)
        });
        let out = run();
        done.store(true, Ordering::Relaxed);
        (out, watch.join().unwrap_or_else(|_| Err("the board could not be read".to_string())))
    })
}

#[cfg(all(feature = "gpu", not(feature = "nvml")))]
fn with_board_power<T>(run: impl FnOnce() -> T) -> (T, Result<f64, String>) {
    (run(), Err("a build with the feature nvml reads the board".to_string()))
}

/// What is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BatchFigure {
    /// Time of a sample, in the mean.
    Time,
    /// Energy of a sample.
    Energy,
}

impl BatchFigure {
    /// Its name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            BatchFigure::Time => "time",
            BatchFigure::Energy => "energy",
        }
    }

    /// Of a row; none where the row does not know it, or assumes it.
    #[must_use]
    pub fn value_in(self, row: &BatchRow) -> Option<f64> {
        match self {
            BatchFigure::Time => Some(row.sample_ms()),
            BatchFigure::Energy => row.energy_uj.filter(|_| row.power_source != FigureSource::Assumed),
        }
    }
}

/// From which batch on other hardware needs less for a sample than the first.
#[derive(Debug, Clone, PartialEq)]
pub struct Crossing {
    /// The other hardware.
    pub hardware: String,
    /// What it needs less of.
    pub figure: BatchFigure,
    /// The least size from which it needs less at every size; `None` where it does not at the
    /// greatest.
    pub from: Option<u32>,
    /// The greatest size.
    pub last: u32,
}

/// The crossings with the hardware of the first row; hardware whose figure nobody knows has none.
#[must_use]
pub fn crossings(rows: &[BatchRow]) -> Vec<Crossing> {
    let Some(first) = rows.first() else { return Vec::new() };
    let mut others: Vec<&str> = Vec::new();
    for row in rows.iter().filter(|row| row.hardware != first.hardware) {
        if !others.contains(&row.hardware.as_str()) {
            others.push(&row.hardware);
        }
    }
    let mut found = Vec::new();
    for hardware in others {
        for figure in [BatchFigure::Time, BatchFigure::Energy] {
            let at = |name: &str, batch: u32| rows.iter().find(|row| row.hardware == name && row.batch == batch);
            let pairs: Vec<(u32, f64, f64)> = rows
                .iter()
                .filter(|row| row.hardware == first.hardware)
                .filter_map(|row| Some((row.batch, figure.value_in(row)?, figure.value_in(at(hardware, row.batch)?)?)))
                .collect();
            let Some(&(last, ..)) = pairs.last() else { continue };
            let behind = pairs.iter().rposition(|(_, chip, other)| other >= chip);
            let from = behind.map_or(Some(pairs[0].0), |at| pairs.get(at + 1).map(|pair| pair.0));
            found.push(Crossing { hardware: hardware.to_string(), figure, from, last });
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(hardware: &str, batch: u32, batch_ms: f64, energy_uj: f64) -> BatchRow {
        BatchRow {
            hardware: hardware.to_string(),
            batch,
            together: batch,
            batch_ms,
            energy_uj: Some(energy_uj),
            source: FigureSource::Measured,
            power_source: FigureSource::Measured,
            note: String::new(),
        }
    }

    #[test]
    fn a_chip_takes_rounds_and_pays_for_a_full_last_one() {
        let found = OnChip { target: "t".to_string(), copies: 8, steps: 100, latency_us: 10.0, energy_uj: 0.5 };
        let (one, eight, twelve) = (chip(&OnChip { copies: 1, ..found.clone() }, 1), chip(&found, 8), chip(&found, 12));
        assert_eq!((one.batch_ms, one.energy_uj, one.together), (1.0, Some(50.0), 1));
        assert_eq!((eight.batch_ms, eight.sample_ms(), eight.energy_uj), (1.0, 0.125, Some(50.0)));
        assert_eq!((twelve.batch_ms, twelve.together), (2.0, 8));
        assert!((twelve.energy_uj.unwrap() - 50.0 * 16.0 / 12.0).abs() < 1e-9);
        assert!(twelve.note.contains("2 rounds of 8 copies"));
    }

    #[test]
    fn a_crossing_is_where_other_hardware_stays_below() {
        let chip = [1, 8, 64].map(|batch| row("chip", batch, f64::from(batch), 10.0));
        // Ten times slower alone, twice as fast in a batch of 64; never below in energy.
        let other = [(1, 10.0, 90.0), (8, 9.0, 40.0), (64, 32.0, 20.0)].map(|(n, ms, uj)| row("gpu", n, ms, uj));
        let mut rows: Vec<BatchRow> = chip.into_iter().chain(other).collect();
        let found = crossings(&rows);
        assert_eq!(found.len(), 2);
        assert_eq!((found[0].figure, found[0].from, found[0].last), (BatchFigure::Time, Some(64), 64));
        assert_eq!((found[1].figure, found[1].from), (BatchFigure::Energy, None));
        rows[3].energy_uj = Some(5.0);
        assert_eq!(crossings(&rows)[1].from, None, "below at first, above later");
        rows.iter_mut().for_each(|row| row.power_source = FigureSource::Assumed);
        assert!(crossings(&rows).iter().all(|one| one.figure == BatchFigure::Time), "no ratio of assumptions");
        assert!(crossings(&[]).is_empty());
    }
}
