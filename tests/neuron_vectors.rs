//! Recorded compartments of three other emulators, bit for bit in spikes, current and voltage: nine regimes of
//! parameters under each of the named semantics (nengo-loihi 1.1.0, lava-nc b6822fb, SLAYER's Loihi kernel).

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use std::path::Path;

use common::drive::Drive;
use common::{Array, Net, biased, data, engines, neuron};
use nsim::base::id::CompartmentId;
use nsim::desc::network::Semantics;
use nsim::ir::graph::Shape;

/// Runs one regime; false when it has no recording under these semantics.
fn matches_recording(folder: &Path, semantics: Semantics, prefix: &str) -> bool {
    let files = ["s", "u", "v"].map(|kind| folder.join(format!("{prefix}_{kind}.npy")));
    if !files.iter().all(|file| file.is_file()) {
        return false;
    }
    let [s, u, v] = files.map(|file| Array::read(&file));
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

    let mut net = Net::with(semantics);
    let drive = Drive::new(&mut net, compartments as u32);
    let target = net.loihi(Shape::Line(compartments as u32), &neurons, 0);
    drive.connect(&mut net, target);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(steps as u32);
        for step in 0..steps {
            engine.step(&drive.spikes(|n| acc.at([n, step])));
            for n in 0..compartments {
                let id = CompartmentId(n as u32);
                // SLAYER's trace shows dv at a spike: it is a read-out, as the chip's (`docs/semantics.md`, probes).
                let voltage = if semantics == Semantics::Slayer { engine.v_register(id) } else { engine.v(id) };
                let got = (i64::from(engine.spikes().contains(&id)), i64::from(engine.u(id)), i64::from(voltage));
                let expected = (s.at([n, step]), u.at([n, step]), v.at([n, step]));
                assert_eq!(got, expected, "{name}, {prefix}, {}, compartment {n}, step {step}", folder.display());
                let membrane = if expected.0 == 1 { 0 } else { expected.2 };
                assert_eq!(i64::from(engine.v(id)), membrane, "{name}: the membrane is 0 at a spike");
            }
        }
    }
    true
}

#[test]
fn every_recorded_regime_matches_bit_for_bit() {
    let Some(folder) = data("neuron") else { return };
    let regimes = [
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
    let mut compared = 0;
    for regime in regimes {
        for (semantics, prefix) in
            [(Semantics::Hardware, "hardware"), (Semantics::Lava, "lava"), (Semantics::Slayer, "slayer")]
        {
            if matches_recording(&folder.join(regime), semantics, prefix) {
                compared += 1;
            } else {
                common::say(&format!("skipped: no data for {regime} under {prefix}"));
            }
        }
    }
    println!("compared {compared} of {} recordings", 3 * regimes.len());
    assert!(compared > 0, "{} holds no recording", folder.display());
}
