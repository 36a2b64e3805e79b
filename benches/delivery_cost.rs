//! Measures the times of the parts of a delivery, and prints them next to the machine's cost table
//! for forms of synapses (`crates/machine/src/layout/delivery_cost.rs`):
//! `cargo bench --bench delivery_cost`, on a quiet machine.

// A bench that cannot continue has failed.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use nsim::compile::{Options, compile};
use nsim::energy::measure::{Budget, measure};
use nsim::files::target::load_target;
use nsim::ir::base::id::ChannelId;
use nsim::ir::spikes::Sample;
use nsim::machine::layout::delivery_cost::{DELIVERY_COST, DeliveryParts};
use nsim::machine::{Image, Machine, Settings};
use nsim::study::networks::delivery::{DeliveryNetwork, delivery_networks, lists_beyond_caches};

/// Time for which each step is measured.
const BUDGET: Budget = Budget::Time(Duration::from_millis(400));

/// Rounds of the fit, which converges much earlier.
const ROUNDS: usize = 100_000;

/// Numbers of the parts that the second half of the spikes adds, and its time in ns.
fn measured(one: DeliveryNetwork) -> (String, [f64; 7], f64) {
    let target = load_target("nahuku-32").unwrap();
    let program = compile(one.network, &target, &Options::default()).unwrap().program;
    let image = Image::new(&program, 1).unwrap();
    let half = &one.spikes[..one.spikes.len() / 2];
    let of = |spikes: &[ChannelId]| {
        let at = |step| spikes.iter().map(move |spike| (step, ChannelId(spike.0 + step)));
        let events: Vec<_> = (0..one.period).flat_map(at).collect();
        let period = Sample::new(one.period, &events, None).unwrap();
        // Idle compartments are updated too: the update does not depend on the spikes.
        let mut machine = Machine::new(&image, Settings { skip: false, per_step: false });
        1e3 * measure(&mut machine, &period, BUDGET).fastest
    };
    let (all, fewer) = (of(&one.spikes), of(half));
    let (parts, before) = (image.delivery_parts(&one.spikes).numbers(), image.delivery_parts(half).numbers());
    (one.name, std::array::from_fn(|part| parts[part] as f64 - before[part] as f64), all - fewer)
}

fn main() {
    let rows: Vec<_> = delivery_networks().unwrap().into_iter().map(measured).collect();
    let table = DELIVERY_COST.numbers().map(|tenths| tenths as f64 / 10.0);
    let time = |parts: &[f64; 7], each: &[f64; 7]| parts.iter().zip(each).map(|(number, ns)| number * ns).sum::<f64>();
    // Non-negative least squares of relative errors, part by part until none changes.
    let mut fitted = table;
    for _ in 0..ROUNDS {
        for part in 0..fitted.len() {
            let terms = rows.iter().map(|(_, parts, ns)| {
                let weight = parts[part] / (ns * ns);
                (weight * (ns - time(parts, &fitted)), weight * parts[part])
            });
            let (slope, curve) = terms.fold((0.0, 0.0), |sum, term| (sum.0 + term.0, sum.1 + term.1));
            fitted[part] = if curve > 0.0 { (fitted[part] + slope / curve).max(0.0) } else { fitted[part] };
        }
    }
    println!("{:>28} {:>10} {:>10} {:>10}", "ns of a step's spikes", "measured", "table", "fitted");
    let beyond = measured(lists_beyond_caches().unwrap());
    for (name, parts, ns) in rows.iter().chain([&beyond]) {
        println!("{name:>28} {ns:>10.0} {:>10.0} {:>10.0}", time(parts, &table), time(parts, &fitted));
    }
    println!("\n{:>28} {:>10} {:>10}", "ns of a part", "table", "fitted");
    for ((name, table), fitted) in DeliveryParts::NAMES.iter().zip(table).zip(fitted) {
        println!("{name:>28} {table:>10.2} {fitted:>10.2}");
    }
}
