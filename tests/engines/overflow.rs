//! Where values leave their fields: the least cases in which the peers disagree, and what is
//! counted.
//!
//! The registers of the first two tests are those of nengo-loihi 1.1.0 (hardware), lava-nc b6822fb
//! and SLAYER's Loihi kernel (slayerPytorch 01beeeb) on the same input; the rest follows from
//! `docs/semantics.md`.

use crate::common::drive::Drive;
use crate::common::{Net, biased, engines, neuron};
use assert_cmd::Command;
use nsim::ir::activity::Overflow;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::fixed::{VmaxExponent, VminExponent};
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::Shape;
use nsim::ir::quantised::Neuron;

/// Drives compartments, all with the same numbers, and holds the last u, v and the counts of
/// overflow to what is expected.
fn ends_in(semantics: Semantics, neurons: &[Neuron], acc: &[i64], (u, v): (i32, i32), expected: Overflow) {
    let mut net = Net::with(semantics);
    let drive = Drive::new(&mut net, neurons.len() as u32);
    let target = net.loihi(Shape::Line(neurons.len() as u32), neurons, 0);
    drive.connect(&mut net, target);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(acc.len() as u32);
        for &acc in acc {
            engine.step((&drive.spikes(|_| acc)).into());
        }
        for n in 0..neurons.len() {
            let id = CompartmentId(n as u32);
            assert_eq!((engine.u(id), engine.v(id)), (u, v), "{name}, {semantics:?}, {id}");
        }
        assert_eq!(engine.overflow(), expected, "{name}, {semantics:?}");
    }
}

fn counts(q_wrapped: u64, u_wrapped: u64, v_clipped: u64, step: u32) -> Overflow {
    Overflow { q_wrapped, u_wrapped, v_clipped, first: Some((step, CompartmentId(0))) }
}

const NONE: Overflow = Overflow { q_wrapped: 0, u_wrapped: 0, v_clipped: 0, first: None };

#[test]
fn a_current_of_two_to_the_23_wraps_on_the_chip_stays_in_lava_and_collapses_in_slayer() {
    let acc = [0, 28_672, 28_679, 28_686, 28_693, 16_412];
    let forgets_slowly = [neuron(1, 4096, 131_071, 1)];
    // On the chip the wrapped current then takes the voltage below its least value; in lava the
    // voltage is above its greatest, is clipped, and spikes.
    ends_in(Semantics::Hardware, &forgets_slowly, &acc, (-8_388_608, -8_388_607), counts(0, 1, 1, 5));
    ends_in(Semantics::Lava, &forgets_slowly, &acc, (8_388_608, 0), counts(0, 0, 1, 5));
    ends_in(Semantics::Slayer, &forgets_slowly, &acc, (1_050_878, 1_050_878), NONE);
    // At the other end it is lava that wraps (`wrapped_curr <= -max_uv_val` in its
    // `proc/lif/models.py`).
    let acc = acc.map(|x| -x);
    ends_in(Semantics::Hardware, &forgets_slowly, &acc, (-8_388_608, -8_388_607), counts(0, 0, 1, 5));
    ends_in(Semantics::Lava, &forgets_slowly, &acc, (8_388_608, 0), counts(0, 1, 1, 5));
    ends_in(Semantics::Slayer, &forgets_slowly, &acc, (-1_050_878, -1_050_878), NONE);
}

#[test]
fn an_accumulator_of_two_to_the_21_wraps_on_the_chip_alone() {
    let acc = [0, 32_768];
    let forgets_all = [neuron(4096, 4096, 131_071, 1); 2];
    ends_in(Semantics::Hardware, &forgets_all, &acc, (-2_097_152, -2_097_152), counts(2, 0, 0, 1));
    ends_in(Semantics::Lava, &forgets_all, &acc, (2_097_152, 2_097_152), NONE);
    ends_in(Semantics::Slayer, &forgets_all, &acc, (2_097_152, 2_097_152), NONE);
}

#[test]
fn slayer_s_product_collapses_at_1_082_402_for_a_decay_of_128() {
    // 1,082,402 is no multiple of 64; the nearest multiples on both sides are.
    for (last, expected) in [(16_912, 1_048_544), (16_913, 30)] {
        let acc = [0, last, 0];
        let slow = [neuron(128, 4096, 131_071, 1)];
        ends_in(Semantics::Slayer, &slow, &acc, (expected, expected), NONE);
    }
}

#[test]
fn current_and_bias_wrap_together_on_the_chip_and_saturate_in_lava() {
    let keeps_all = [biased(neuron(0, 4096, 131_071, 1), 4095, 7)];
    let acc = [32_767, 32_767, 32_767, 32_767];
    // 8,388,352 + 524,160 - 2^24 = -7,864,704.
    ends_in(Semantics::Hardware, &keeps_all, &acc, (8_388_352, -7_864_704), counts(0, 1, 0, 3));
    ends_in(Semantics::Lava, &keeps_all, &acc, (8_388_352, 0), counts(0, 0, 1, 3));
}

#[test]
fn voltages_clip_at_their_exponents_on_the_chip_and_at_the_register_in_lava() {
    // vmax 2^(9 + 2 * 1) - 1 = 2047, vmin -(2^4 - 1) = -15.
    let narrow = Neuron {
        vmin: VminExponent::new(4).unwrap(),
        vmax: VmaxExponent::new(1).unwrap(),
        ..neuron(4096, 4096, 131_071, 1)
    };
    ends_in(Semantics::Hardware, &[narrow], &[31], (1984, 1984), NONE);
    ends_in(Semantics::Hardware, &[narrow], &[32, 33], (2112, 2047), counts(0, 0, 2, 0));
    ends_in(Semantics::Hardware, &[narrow], &[0, -1], (-64, -15), counts(0, 0, 1, 1));
    ends_in(Semantics::Lava, &[narrow], &[33], (2112, 2112), NONE);
    ends_in(Semantics::Slayer, &[narrow], &[0, 33], (2112, 2112), NONE);
}

#[test]
fn a_clip_is_not_counted_while_a_refractory_period_holds_the_voltage() {
    let narrow = Neuron { vmin: VminExponent::new(0).unwrap(), ..biased(neuron(4096, 0, 0, 3), 1, 0) };
    // Spikes in step 0 by its bias; inputs of -1 would take v below 0 in every step after it, but v
    // moves in steps 3 and 4 only.
    ends_in(Semantics::Hardware, &[narrow], &[0, -1, -1, -1, -1], (-64, 0), counts(0, 0, 2, 3));
}

/// The same on 1,000 scenes of each model: `benches/overflow.sh`.
#[test]
fn shipped_models_and_converted_ones_neither_wrap_nor_clip() {
    let slip = "scene:slip?samples=10&seed=31";
    let noise = "scene:noise?samples=10&steps=325&rate=0.1&seed=31";
    for (model, input) in [
        ("vtsnn-slip", slip),
        ("slip-tactile", slip),
        ("slip-vision", slip),
        ("vtsnn-container", "scene:container?samples=10&seed=31"),
        ("container-tactile", noise),
        ("vtsnn-slip-srm", slip),
        ("container-tactile-srm", noise),
    ] {
        let mut command = Command::cargo_bin("nsim").unwrap();
        let out =
            command.args(["run", model, "--engine", "fast", "--input", input, "--format", "json"]).output().unwrap();
        assert!(out.status.success(), "{model}: {}", String::from_utf8_lossy(&out.stderr));
        let report: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
        for count in ["q_wrapped", "u_wrapped", "v_clipped"] {
            assert_eq!(report["overflow"][count], 0, "{model}: {}", report["overflow"]);
        }
    }
}
