//! Cost of a step by its synaptic events: N events a step, from 10^2 to 10^6.
//!
//! - `events/grown/N`: on networks that grow with N, with one compartment for each eight events
//!   (128 at least). The time per event should be constant.
//! - `events/fixed/N`: on one network of 16,384 compartments. The time is a constant for the size
//!   and a constant per event.

// A bench that cannot continue has failed; criterion's macro makes undocumented functions.
#![allow(clippy::unwrap_used, missing_docs)]

use std::time::{Duration, Instant};

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nsim::compile::{Options, compile};
use nsim::energy::measure::steps;
use nsim::files::target::load_target;
use nsim::ir::spikes::Engine;
use nsim::machine::{Image, Machine, Settings};
use nsim::study::networks::events_only;

/// Synapses from one channel.
const FAN_OUT: u32 = 64;
/// Compartments of the network of fixed size.
const FIXED: u32 = 16_384;

fn events(c: &mut Criterion) {
    let mut group = c.benchmark_group("events");
    group.sample_size(20).measurement_time(Duration::from_secs(2));
    let rows = [2, 16, 156, 1_562, 15_625]
        .into_iter()
        .flat_map(|driven| [("grown", (driven * FAN_OUT / 8).max(128), driven), ("fixed", FIXED, driven)]);
    for (name, compartments, driven) in rows {
        let bench = events_only(compartments, driven, 8).unwrap();
        let target = load_target(bench.target).unwrap();
        let program = compile(bench.network, &target, &Options::default()).unwrap().program;
        let image = Image::new(&program, 1).unwrap();
        let mut machine = Machine::new(&image, Settings::default());
        machine.begin(u32::MAX);
        let mut at = steps(&mut machine, &bench.period, 0, 40);
        group.throughput(Throughput::Elements(u64::from(FAN_OUT * driven)));
        group.bench_function(BenchmarkId::new(name, FAN_OUT * driven), |b| {
            b.iter_custom(|count| {
                let begin = Instant::now();
                at = steps(&mut machine, &bench.period, at, count);
                begin.elapsed()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, events);
criterion_main!(benches);
