//! How the cost of a step grows with its synaptic events, from 10^2 to 10^6 a step.
//!
//! - `grown`: on networks that grow with the events, an eighth as many compartments (128 at least).
//!   The time per event should be constant.
//! - `fixed`: on one network of 16,384 compartments: the time is a constant for the size and a
//!   constant per event.

// A bench that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use nsim::compile::{Options, compile};
use nsim::energy::measure::{Budget, measure};
use nsim::files::target::load_target;
use nsim::machine::{Image, Machine, Settings};
use nsim::study::networks::events_only;

/// Synapses of a channel.
const FAN_OUT: u32 = 64;
/// Compartments of the network of fixed size.
const FIXED: u32 = 16_384;

fn main() {
    println!("{:>9} {:>8} {:>12} {:>9} {:>8}", "events", "network", "us a step", "spread", "ns each");
    for driven in [2, 16, 156, 1_562, 15_625] {
        let events = FAN_OUT * driven;
        for (name, compartments) in [("fixed", FIXED), ("grown", (events / 8).max(128))] {
            let bench = events_only(compartments, driven, 8).unwrap();
            let target = load_target(bench.target).unwrap();
            let program = compile(bench.network, &target, &Options::default()).unwrap().program;
            let image = Image::new(&program, 1).unwrap();
            let mut machine = Machine::new(&image, Settings::default());
            let timing = measure(&mut machine, &bench.period, Budget::Time(Duration::from_secs(2)));
            let (us, spread) = (timing.us_per_timestep, timing.spread);
            println!("{events:>9} {name:>8} {us:>12.3} {spread:>9.3} {:>8.2}", 1e3 * us / f64::from(events));
        }
    }
}
