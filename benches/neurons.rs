//! Update time of a neuron, for each kind of Loihi 2 and for this kind stated as expressions in a
//! model file.
//!
//! Skipping is off, so 16,384 neurons are updated in each step, without arrivals: no update has a
//! branch. Prints ns a neuron and the ratio of both forms.

// A bench that cannot continue has failed.
#![allow(clippy::unwrap_used)]

use std::time::Duration;

use nsim::compile::{Options, compile};
use nsim::dynamics;
use nsim::energy::measure::{Budget, measure};
use nsim::files::target::load_target;
use nsim::ir::base::fixed::MessageBits;
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::{PerCompartment, Shape};
use nsim::ir::neurons::{Emits, NeuronKind};
use nsim::ir::quantised::{Parts, Population, Quantised, Units};
use nsim::ir::spikes::{Message, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim_testing::kinds::{own, stated};

const NEURONS: u32 = 16_384;

fn network(kind: NeuronKind, row: &[i64]) -> Quantised {
    let neurons = PerCompartment::Same(dynamics::neuron(kind, row).unwrap());
    let message = match kind.table().emits {
        Emits::Values => Message::Value(MessageBits::MAX),
        Emits::Spikes => Message::Spike,
    };
    let cells = Units::Compartments { first: CompartmentId(0), neurons, start_step: 0 };
    let populations = vec![Population { name: "cells".into(), shape: Shape::Line(NEURONS), units: cells, message }];
    Quantised::new(Parts { populations: populations.into_iter().collect(), ..Parts::default() }).unwrap()
}

fn main() {
    println!("| kind | ns a neuron | stated | ratio |\n|---|---|---|---|");
    for (kind, row) in [
        (NeuronKind::SigmaDelta, &[13, 4, 6, 6, 1, 0, 0][..]),
        (NeuronKind::Delta, &[13, 6, 6, 0]),
        (NeuronKind::Sigma, &[]),
        (NeuronKind::Rf, &[2103, 3273, 1600, 6, 12]),
        (NeuronKind::RfIz, &[3042, 2426, 70, 6, 12]),
        (NeuronKind::Alif, &[1024, 410, 205, 819, 4096, 2048]),
    ] {
        let like = if kind == NeuronKind::Alif { own("AlifAbove").unwrap() } else { stated(kind) };
        let [built_in, other] = [kind, like].map(|kind| {
            let target = load_target("oheo-gulch").unwrap();
            let program = compile(network(kind, row), &target, &Options::default()).unwrap().program;
            let image = Image::new(&program, 1).unwrap();
            let mut machine = Machine::new(&image, Settings { skip: false, ..Settings::default() });
            let sample = Sample::new(64, &[], None).unwrap();
            let timing = measure(&mut machine, &sample, Budget::Time(Duration::from_secs(2)));
            1e3 * timing.us_per_timestep / f64::from(NEURONS)
        });
        println!("| {} | {built_in:.2} | {other:.2} | {:.2} |", kind.name(), other / built_in);
    }
}
