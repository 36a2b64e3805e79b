//! A timestep of the standard networks, one thread and two; set-up outside the timing.
//! `nsim bench step` measures the same and prints one object; this keeps criterion's history. The
//! networks of a million compartments map for a minute.

// A bench that cannot go on has failed; criterion's macro makes functions without documentation.
#![allow(clippy::unwrap_used, missing_docs)]

use std::sync::Arc;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use nsim::compile::{Options, compile};
use nsim::energy::measure::steps;
use nsim::files::target::load_target;
use nsim::ir::program::Program;
use nsim::ir::spikes::Engine;
use nsim::machine::{Image, Machine, Settings};
use nsim::study::networks::StandardNetwork;

/// Steps after which the input's rate is the network's.
const SETTLING: u64 = 40;

fn step(c: &mut Criterion) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let mut group = c.benchmark_group("step");
    group.sample_size(20).measurement_time(Duration::from_secs(3));
    let mut mapped: Option<(StandardNetwork, Arc<Program>)> = None;
    for standard in StandardNetwork::ALL {
        let bench = standard.build().unwrap();
        let program = match mapped.take() {
            Some((of, program)) if of == standard.program_of() => program,
            _ => {
                let target = load_target(bench.target).unwrap();
                compile(bench.network, &target, &Options::default()).unwrap().program
            }
        };
        for shares in if standard.wants_threads() && cores > 1 { vec![1, 2] } else { vec![1] } {
            let image = Image::new(&program, shares).unwrap();
            let mut machine = Machine::new(&image, Settings::default());
            machine.begin(u32::MAX);
            let mut at = steps(&mut machine, &bench.period, 0, SETTLING);
            group.bench_function(format!("{}/{shares}", standard.name()), |b| {
                b.iter_custom(|count| {
                    let begin = Instant::now();
                    at = match shares {
                        1 => steps(&mut machine, &bench.period, at, count),
                        _ => rayon::scope(|_| steps(&mut machine, &bench.period, at, count)),
                    };
                    begin.elapsed()
                });
            });
        }
        mapped = Some((standard.program_of(), program));
    }
    group.finish();
}

criterion_group!(benches, step);
criterion_main!(benches);
