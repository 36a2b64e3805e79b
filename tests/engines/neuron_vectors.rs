//! Recorded compartments of three other emulators, bit for bit in spikes, current and voltage: nine
//! regimes of parameters under each of the named semantics (nengo-loihi 1.1.0, lava-nc b6822fb,
//! SLAYER's Loihi kernel).

use std::collections::BTreeSet;
use std::path::Path;

use crate::common::drive::Drive;
use crate::common::{Array, Builder, biased, data, engines, neuron};
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::Shape;

/// The regimes that were recorded, each under all three.
const REGIMES: [&str; 9] = [
    "base",
    "bias",
    "decay_edges",
    "first_step_input",
    "q0_overflow21",
    "refractory_1_63",
    "u_overflow23",
    "v_equals_threshold",
    "v_saturate23",
];
const SEMANTICS: [(Semantics, &str); 3] =
    [(Semantics::Hardware, "hardware"), (Semantics::Lava, "lava"), (Semantics::Slayer, "slayer")];

/// Runs one regime under one of the named semantics.
fn matches_recording(folder: &Path, semantics: Semantics, prefix: &str) {
    let [s, u, v] = ["s", "u", "v"].map(|kind| Array::read(&folder.join(format!("{prefix}_{kind}.npy"))));
    let read = |name: &str| Array::read(&folder.join(name).with_extension("npy"));
    let acc = read("acc");
    let (compartments, steps) = (acc.shape[0], acc.shape[1]);
    assert_eq!((&s.shape, &u.shape, &v.shape), (&acc.shape, &acc.shape, &acc.shape));
    let [du, dv, vth, refractory, bias_mant, bias_exp] =
        ["du", "dv", "vth_mant", "refractory", "bias_mant", "bias_exp"].map(read);
    let neurons: Vec<_> = (0..compartments)
        .map(|n| {
            let at = |array: &Array| array.at([n]);
            biased(neuron(at(&du), at(&dv), at(&vth), at(&refractory)), at(&bias_mant), at(&bias_exp))
        })
        .collect();

    let mut net = Builder::with(semantics);
    let drive = Drive::new(&mut net, compartments as u32);
    let target = net.each("target", Shape::Line(compartments as u32), &neurons, 0);
    drive.connect(&mut net, target);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(steps as u32);
        for step in 0..steps {
            engine.step((&drive.spikes(|n| acc.at([n, step]))).into());
            for n in 0..compartments {
                let id = CompartmentId(n as u32);
                // SLAYER's trace shows dv at a spike: a read-out like the chip's
                // (`docs/semantics.md`, probes).
                let voltage = if semantics == Semantics::Slayer { engine.v_register(id) } else { engine.v(id) };
                let got = (i64::from(engine.spikes().contains(&id)), i64::from(engine.u(id)), i64::from(voltage));
                let expected = (s.at([n, step]), u.at([n, step]), v.at([n, step]));
                assert_eq!(got, expected, "{name}, {prefix}, {}, compartment {n}, step {step}", folder.display());
                let membrane = if expected.0 == 1 { 0 } else { expected.2 };
                assert_eq!(i64::from(engine.v(id)), membrane, "{name}: the membrane is 0 at a spike");
            }
        }
    }
}

#[test]
fn every_recorded_regime_matches_bit_for_bit() {
    let Some(folder) = data("neuron") else { return };
    for regime in REGIMES {
        for (semantics, prefix) in SEMANTICS {
            matches_recording(&folder.join(regime), semantics, prefix);
        }
    }
}

/// A folder that lacks a recording, or has one that no regime names, was not compared.
#[test]
fn every_recording_is_there_and_no_other() {
    let Some(folder) = data("neuron") else { return };
    let mut expected = BTreeSet::new();
    for regime in REGIMES {
        for (_, prefix) in SEMANTICS {
            expected.extend(["s", "u", "v"].map(|kind| format!("{regime}/{prefix}_{kind}.npy")));
        }
    }
    let mut found = BTreeSet::new();
    for regime in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap()).filter(|entry| entry.path().is_dir())
    {
        for file in std::fs::read_dir(regime.path()).unwrap() {
            let name = file.unwrap().file_name().into_string().unwrap();
            if ["_s.npy", "_u.npy", "_v.npy"].iter().any(|kind| name.ends_with(kind)) {
                found.insert(format!("{}/{name}", regime.file_name().to_str().unwrap()));
            }
        }
    }
    assert_eq!(found, expected, "{}", folder.display());
    assert_eq!(expected.len(), 9 * 3 * 3);
}
