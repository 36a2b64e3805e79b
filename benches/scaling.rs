//! How the cost of a step grows with its synaptic events, and what skipping saves.
//!
//! - `events/N`: N synaptic events a step and nothing else, from 10^2 to 10^6. Divided by N, the times should be level once
//!   the fixed cost of a step is paid.
//! - `skipping/INPUT/on|off`: whole samples, jumps over empty steps included: a silent network, noise, and the recorded
//!   tactile samples where they are (`NSIM_DATA` or `../shared/data`).

// A bench that cannot go on has failed; criterion's macro makes functions without documentation.
#![allow(clippy::unwrap_used, missing_docs)]

use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nsim::base::id::ChannelId;
use nsim::bench::networks::{Standard, events_only};
use nsim::bench::steps;
use nsim::compile::{Options, compile, compile_quantised};
use nsim::drive::{Keep, run_sample};
use nsim::io;
use nsim::ir::program::Program;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};

fn map(network: Quantised, target: &str) -> Program {
    let target = io::target::load_target(target).unwrap();
    compile_quantised(network, &target, &Options::default()).unwrap().program
}

fn events(c: &mut Criterion) {
    let mut group = c.benchmark_group("events");
    group.sample_size(20).measurement_time(Duration::from_secs(2));
    for driven in [2, 16, 156, 1_562, 15_625] {
        let bench = events_only(16_384, driven, 16).unwrap();
        let program = map(bench.network, bench.target);
        let image = Image::new(&program, 1).unwrap();
        let mut machine = Machine::new(&image, Settings::default());
        machine.begin(u32::MAX);
        let mut at = 0;
        group.throughput(Throughput::Elements(64 * u64::from(driven)));
        group.bench_function(BenchmarkId::from_parameter(64 * driven), |b| {
            b.iter_custom(|count| {
                let begin = Instant::now();
                at = steps(&mut machine, &bench.period, at, count);
                begin.elapsed()
            });
        });
    }
    group.finish();
}

/// Samples of `period.steps()` steps in a row, as `nsim run` runs them.
fn whole_samples(c: &mut Criterion, input: &str, program: &Program, samples: &[Sample]) {
    let mut group = c.benchmark_group(format!("skipping/{input}"));
    group.sample_size(20).measurement_time(Duration::from_secs(2));
    group.throughput(Throughput::Elements(samples.iter().map(|sample| u64::from(sample.steps())).sum()));
    let keep = Keep { output: program.output(), probes: Vec::new(), early_exit: None };
    let image = Image::new(program, 1).unwrap();
    for (name, skip) in [("on", true), ("off", false)] {
        let mut machine = Machine::new(&image, Settings { skip, per_step: false });
        group.bench_function(name, |b| {
            b.iter(|| {
                for sample in samples {
                    black_box(run_sample(&mut machine, sample, &keep, |_, _| ()));
                }
            });
        });
    }
    group.finish();
}

fn skipping(c: &mut Criterion) {
    let vtsnn = Standard::VtSnn1Pct.build().unwrap();
    let program = map(vtsnn.network, vtsnn.target);
    let silence = Sample::new(150, &Vec::new(), None).unwrap();
    whole_samples(c, "silence", &program, std::slice::from_ref(&silence));
    let noise: Vec<Sample> = (0..20)
        .map(|k| {
            let at = |t: u32| vtsnn.period.at(k * 150 + t).iter().map(move |&channel| (t, channel));
            Sample::new(150, &(0..150).flat_map(at).collect::<Vec<_>>(), None).unwrap()
        })
        .collect();
    whole_samples(c, "noise", &program, &noise);
    if let Some((program, samples)) = recordings() {
        whole_samples(c, "tactile", &program, &samples);
    }
}

/// The shipped tactile network and recordings for it.
fn recordings() -> Option<(Program, Vec<Sample>)> {
    let root = std::env::var_os("NSIM_DATA")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data"), PathBuf::from);
    let folder = root.join("ev-containers/test");
    if !folder.is_dir() {
        println!("skipped: no data at {}", folder.display());
        return None;
    }
    let network = io::model::load_model("container-tactile").unwrap();
    let target = io::target::load_target("nahuku-32").unwrap();
    let program = compile(&network, &target, &Options::default()).unwrap().program;
    let read = io::stimulus::read_source(&folder, u64::from(program.channels())).unwrap();
    let sample = |spikes: io::stimulus::PopulationSpikes| {
        let events: Vec<_> = spikes.events.iter().map(|&(step, channel)| (step, ChannelId(channel))).collect();
        Sample::new(spikes.steps, &events, spikes.label).unwrap()
    };
    Some((program, read.into_iter().map(sample).collect()))
}

criterion_group!(benches, events, skipping);
criterion_main!(benches);
