//! Values that leave their fields: the smallest cases in which the peers disagree, and the counts
//! of overflow.
//!
//! The expected registers of the first two groups are recordings of nengo-loihi 1.1.0 (hardware),
//! lava-nc b6822fb and SLAYER's Loihi kernel (slayerPytorch 01beeeb), on equal input. The others
//! follow from `docs/semantics.md`.

use std::path::Path;

use crate::common::command::object;
use crate::common::drive::Drive;
use crate::common::{Builder, biased, engines, neuron};
use nsim::ir::activity::Overflow;
use nsim::ir::arithmetic::Semantics;
use nsim::ir::base::fixed::{VmaxExponent, VminExponent};
use nsim::ir::base::id::CompartmentId;
use nsim::ir::graph::Shape;
use nsim::ir::quantised::Neuron;

/// Drives a compartment, and compares the last u, v and the counts of overflow.
fn ends_in(semantics: Semantics, neuron: Neuron, acc: &[i64], (u, v): (i32, i32), expected: Overflow) {
    let mut net = Builder::with(semantics);
    let drive = Drive::new(&mut net, 1);
    let target = net.each("target", Shape::Line(1), &[neuron], 0);
    drive.connect(&mut net, target);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(acc.len() as u32);
        for &acc in acc {
            engine.step((&drive.spikes(|_| acc)).into());
        }
        let what = format!("{name}, {semantics:?}, {acc:?}");
        assert_eq!((engine.u(CompartmentId(0)), engine.v(CompartmentId(0))), (u, v), "{what}");
        assert_eq!(engine.overflow(), expected, "{what}");
    }
}

fn counts(q_wrapped: u64, u_wrapped: u64, v_clipped: u64, step: u32) -> Overflow {
    Overflow { q_wrapped, u_wrapped, v_clipped, first: Some((step, CompartmentId(0))) }
}

const NONE: Overflow = Overflow { q_wrapped: 0, u_wrapped: 0, v_clipped: 0, first: None };

#[test]
fn values_leave_their_fields_as_each_tool_has_it() {
    use Semantics::{Hardware, Lava, Slayer};
    let forgets_slowly = neuron(1, 4096, 131_071, 1);
    let up = [0, 28_672, 28_679, 28_686, 28_693, 16_412];
    let down = up.map(|x| -x);
    // On the chip a current of 2^23 wraps, and takes the voltage below its least value. In lava it
    // stays: the voltage exceeds its greatest value, is clipped, and spikes. In SLAYER it
    // collapses. At the other end lava wraps (`wrapped_curr <= -max_uv_val` in its
    // `proc/lif/models.py`).
    ends_in(Hardware, forgets_slowly, &up, (-8_388_608, -8_388_607), counts(0, 1, 1, 5));
    ends_in(Lava, forgets_slowly, &up, (8_388_608, 0), counts(0, 0, 1, 5));
    ends_in(Slayer, forgets_slowly, &up, (1_050_878, 1_050_878), NONE);
    ends_in(Hardware, forgets_slowly, &down, (-8_388_608, -8_388_607), counts(0, 0, 1, 5));
    ends_in(Lava, forgets_slowly, &down, (8_388_608, 0), counts(0, 1, 1, 5));
    ends_in(Slayer, forgets_slowly, &down, (-1_050_878, -1_050_878), NONE);
    // An accumulator of 2^21 wraps on the chip alone.
    let forgets_all = neuron(4096, 4096, 131_071, 1);
    ends_in(Hardware, forgets_all, &[0, 32_768], (-2_097_152, -2_097_152), counts(1, 0, 0, 1));
    ends_in(Lava, forgets_all, &[0, 32_768], (2_097_152, 2_097_152), NONE);
    ends_in(Slayer, forgets_all, &[0, 32_768], (2_097_152, 2_097_152), NONE);
    // SLAYER's product collapses at 1,082,402 for a decay of 128; the nearest multiples of 64 are
    // on both sides.
    let slow = neuron(128, 4096, 131_071, 1);
    ends_in(Slayer, slow, &[0, 16_912, 0], (1_048_544, 1_048_544), NONE);
    ends_in(Slayer, slow, &[0, 16_913, 0], (30, 30), NONE);
    // Current and bias wrap together on the chip (8,388,352 + 524,160 - 2^24 = -7,864,704) and
    // saturate in lava.
    let keeps_all = biased(neuron(0, 4096, 131_071, 1), 4095, 7);
    ends_in(Hardware, keeps_all, &[32_767; 4], (8_388_352, -7_864_704), counts(0, 1, 0, 3));
    ends_in(Lava, keeps_all, &[32_767; 4], (8_388_352, 0), counts(0, 0, 1, 3));
    // Voltages clip at their exponents on the chip (vmax 2^(9 + 2 * 1) - 1 = 2047, vmin
    // -(2^4 - 1) = -15) and at the register in lava.
    let narrow = Neuron { vmin: VminExponent::new(4).unwrap(), vmax: VmaxExponent::new(1).unwrap(), ..forgets_all };
    ends_in(Hardware, narrow, &[31], (1984, 1984), NONE);
    ends_in(Hardware, narrow, &[32, 33], (2112, 2047), counts(0, 0, 2, 0));
    ends_in(Hardware, narrow, &[0, -1], (-64, -15), counts(0, 0, 1, 1));
    ends_in(Lava, narrow, &[33], (2112, 2112), NONE);
    ends_in(Slayer, narrow, &[0, 33], (2112, 2112), NONE);
    // A clip is not counted while a refractory period holds the voltage. It spikes in step 0 by its
    // bias; inputs of -1 would take v below 0 in every later step, but v changes in steps 3 and 4
    // only.
    let held = Neuron { vmin: VminExponent::new(0).unwrap(), ..biased(neuron(4096, 0, 0, 3), 1, 0) };
    ends_in(Hardware, held, &[0, -1, -1, -1, -1], (-64, 0), counts(0, 0, 2, 3));
}

/// A short form of `benches/overflow.sh`, which runs 1,000 scenes of each model.
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
        let report = object(Path::new("."), &format!("run {model} --engine fast --input {input}"), 0);
        for count in ["q_wrapped", "u_wrapped", "v_clipped"] {
            assert_eq!(report["overflow"][count], 0, "{model}: {}", report["overflow"]);
        }
    }
}
