//! `nsim bench batch`: what passing samples together saves, on the chip and beside it.

use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::cli::args::input::InputArgs;
use crate::cli::args::jobs;
use crate::cli::args::jobs::{Job, JobArgs, Prepared, Wanted};
use crate::cli::args::timestep::TimestepArgs;
use crate::cli::args::values;
use crate::cli::context::{Answer, Context};
use crate::cli::energy::workload::{simulate, workload};
use crate::cli::output;
use nsim_cost::estimate::{Case, estimate};
use nsim_cost::{CostTable, Deployment, HostWork, MeterSettings, Transport};
use nsim_energy::baseline::{Baseline, SHIPPED, Work};
use nsim_energy::options::Watts;
use nsim_energy::power::{POWERCAP, PackagePower, PowerMeter};
use nsim_report::bench::batch::BatchReport;
use nsim_session::error::Error;
use nsim_study::batch_sizes;
use nsim_study::batch_sizes::{BatchRow, OnChip};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim bench batch                                       batches of 1 to 512 of the shipped network: chip, processor, GPU
  nsim bench batch model.ron --input s.npy --sizes 1,2,4 --plot batches.svg
  nsim bench batch --cpu-watts 20,45 --format csv";

/// How long the counters are watched at idle.
const IDLE: Duration = Duration::from_millis(300);

/// Time and energy of a sample against how many are passed together: on copies of the network on
/// the chip, on all threads of this processor, on a GPU as published figures model it, and, with
/// the feature gpu, on the one that is here
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct BatchArgs {
    /// A model file or the name of a shipped model
    #[arg(value_name = "MODEL", default_value = "vtsnn-slip")]
    model: String,
    #[command(flatten)]
    timestep: TimestepArgs,
    /// Input spikes: SOURCE, or POPULATION=SOURCE when the model has several input populations
    /// [default: the model's scene]
    #[arg(long, value_name = "SOURCE")]
    input: Vec<String>,
    /// A target file or the name of a shipped target
    #[arg(long, default_value = "nahuku-32")]
    target: String,
    /// Samples of a batch, for each row
    #[arg(
        long, value_name = "N", value_delimiter = ',', default_values_t = [1, 8, 64, 512],
        value_parser = clap::value_parser!(u32).range(1..=4096)
    )]
    sizes: Vec<u32>,
    /// Power of this machine's processor at idle and busy, where its counters cannot be read or are
    /// not to be
    #[arg(long, value_name = "IDLE,BUSY")]
    cpu_watts: Option<Watts>,
    /// Seconds of measurement a row, at least five repeats
    #[arg(long, value_name = "S", default_value = "0.3", value_parser = values::seconds)]
    seconds: Duration,
    /// Write a chart of the energy of a sample over the batch size
    #[arg(long, value_name = "FILE.svg|png|pdf")]
    plot: Option<PathBuf>,
}

impl BatchArgs {
    fn on_target(&self) -> JobArgs {
        JobArgs { target: self.target.clone(), timestep: self.timestep, ..JobArgs::for_model(&self.model) }
    }

    fn job(&self, copies: u32) -> Result<Prepared, Error> {
        let needs_scene = self.input.is_empty();
        jobs::prepare(&JobArgs { needs_scene, ..self.on_target() }, Wanted::Mapped, copies)
    }

    fn input(&self) -> InputArgs {
        InputArgs::from_sources(&self.input)
    }
}

/// What so many copies come to.
fn on_chip(args: &BatchArgs, job: &Job, context: Context) -> Result<OnChip, Error> {
    let workload = workload(job, &args.input())?;
    let steps = whole(workload.steps_per_sample())?;
    let copies = workload.compiled.options.copies;
    let table = CostTable::new(&workload.target.constants()[0])?;
    let (placement, target) = (&workload.compiled.placement, workload.target);
    let deployment = Deployment::from_placement("mapped", placement, target, copies, HostWork::for_target(target));
    let settings: MeterSettings = workload.metered(vec![table], &deployment, Transport::default());
    let run = simulate(&workload, settings, None, true, context)?;
    let timestep_ms = workload.compiled.one.parts().timestep_ms;
    let found = estimate(&Case {
        steps_per_sample: Some(steps),
        ..Case::new(&run.activity, &run.meter, &deployment, timestep_ms)
    });
    let total = found.rows.iter().find(|row| row.unit == "total");
    let figures = total.and_then(|row| Some((row.latency_us?, row.energy_uj?)));
    let (latency_us, energy_uj) = figures.ok_or_else(|| {
        let name = workload.target.name();
        Error::Usage(format!("--target {name}: its constants give no time and energy of a timestep"))
    })?;
    Ok(OnChip { target: workload.target.name().to_string(), copies, steps, latency_us, energy_uj })
}

fn whole(steps: Option<u32>) -> Result<u32, Error> {
    steps.ok_or_else(|| Error::Usage("batches need samples of one length".to_string()))
}

/// Runs the command.
///
/// # Errors
/// [`Error`] when a model or an input cannot be used.
pub fn run(args: &BatchArgs, context: Context) -> Result<Answer, Error> {
    let taken = output::check_files(None, &args.plot, context)?;
    let mut sizes = args.sizes.clone();
    sizes.sort_unstable();
    sizes.dedup();
    let one = match args.job(1)? {
        Prepared::Ready(job) => job,
        Prepared::DoesNotFit(refusal) => {
            refusal.say(serde_json::json!({ "schema": "nsim.bench/1", "name": "batch", "rows": [] }), context)?;
            return Ok(Answer::No);
        }
    };
    let quiet = Context { progress: false, ..context };
    let (mut rows, mut notes) = (Vec::new(), Vec::new());
    output::with_progress(context, sizes.len(), "batch sizes on the chip", |done| {
        let mut fits: Option<OnChip> = None;
        let mut full = false;
        for &size in &sizes {
            // What does not fit is halved: half as many pass in twice as many rounds.
            let mut copies = size;
            while !full && fits.as_ref().is_none_or(|fits| fits.copies < copies) {
                match args.job(copies)? {
                    Prepared::Ready(job) => fits = Some(on_chip(args, &job, quiet)?),
                    Prepared::DoesNotFit(_) => copies /= 2,
                }
            }
            full |= copies < size;
            let found = match &fits {
                Some(found) => found,
                None => fits.insert(on_chip(args, &one, quiet)?),
            };
            rows.push(batch_sizes::chip(found, size));
            done();
        }
        Ok::<_, Error>(())
    })?;
    let workload = workload(&one, &args.input())?;
    let steps = whole(workload.steps_per_sample())?;
    let network = &workload.compiled.one;
    let samples = workload.samples();
    let work = Work::of_network(network);
    for (name, _) in SHIPPED {
        let baseline = Baseline::shipped(name)?;
        rows.extend(sizes.iter().filter_map(|&size| batch_sizes::modelled(&baseline, &work, steps, size)));
    }
    let mut note = |result: Result<BatchRow, String>, name: &str| match result {
        Ok(row) => Some(row),
        Err(reason) => {
            let text = format!("no row for {name}: {reason}");
            if !notes.contains(&text) {
                notes.push(text);
            }
            None
        }
    };
    let stated = args.cpu_watts.map(|Watts(idle, busy)| (idle, busy));
    output::with_progress(context, 2 * sizes.len(), "measurements", |done| {
        let meters: Vec<PowerMeter> = sizes
            .iter()
            .map(|&size| {
                let package = PackagePower::assumed(batch_sizes::threads_for(size));
                PowerMeter::new(Path::new(POWERCAP), stated, package, IDLE)
            })
            .collect();
        for (&size, meter) in sizes.iter().zip(&meters) {
            let row = batch_sizes::event_driven(&workload.compiled.program, &samples, size, args.seconds, meter);
            rows.extend(note(row, "CPU, event-driven"));
            done();
        }
        for (&size, meter) in sizes.iter().zip(&meters) {
            rows.extend(note(batch_sizes::dense(network, &samples, size, args.seconds, meter), "CPU, dense f32"));
            done();
        }
        Ok::<_, Error>(())
    })?;
    #[cfg(feature = "gpu")]
    on_gpu(args, network, (&samples, steps), &sizes, |result| rows.extend(note(result, "the GPU")))?;
    #[cfg(not(feature = "gpu"))]
    notes.push("no row for a GPU: a build with the feature gpu measures one".to_string());
    let report = BatchReport { model: &network.parts().name, steps, rows: &rows, notes: &notes };
    if let Some(path) = &args.plot {
        output::write_picture(path, &report.svg(), context)?;
    }
    if !taken {
        output::print(context.format, || report.text(), || report.json(), || report.csv())?;
    }
    Ok(Answer::Yes)
}

/// The rows of the GPU that is here, in integers and in f32, or why there are none.
#[cfg(feature = "gpu")]
fn on_gpu(
    args: &BatchArgs,
    network: &nsim_ir::quantised::Quantised,
    samples: (&[&nsim_ir::spikes::Sample], u32),
    sizes: &[u32],
    mut take: impl FnMut(Result<BatchRow, String>),
) -> Result<(), Error> {
    use nsim_study::batch::{BatchForm, Gpu};
    let gpu = match Gpu::open() {
        Ok(gpu) => gpu,
        Err(reason) => {
            take(Err(reason));
            return Ok(());
        }
    };
    match BatchForm::new(network) {
        Err(reason) => take(Err(reason)),
        Ok(form) => sizes.iter().for_each(|&size| take(batch_sizes::gpu(&gpu, &form, samples, size, args.seconds))),
    }
    let real = jobs::prepare(&args.on_target(), Wanted::Real, 1)?;
    if let Prepared::Ready(Job::Real(graph, ..)) = &real {
        match BatchForm::real(graph) {
            Err(reason) => take(Err(reason)),
            Ok(form) => sizes.iter().for_each(|&size| take(batch_sizes::gpu(&gpu, &form, samples, size, args.seconds))),
        }
    }
    Ok(())
}
