//! Behaviour of a Loihi chip, bit for bit: a recorded network, and two published traces of the
//! voltage register.

use crate::common::drive::Drive;
use crate::common::{Array, Builder, data, engines, neuron};
use nsim::ir::base::id::{ChannelId, CompartmentId};
use nsim::ir::graph::Shape;

/// One compartment (du 1024, dv 128) that receives one spike over a weight of 2 in step 1, and its
/// register after each step. The figures are from slayerPytorch 01beeeb,
/// `test/test_files/Loihi/LoihiData/LoihiVth05.txt`.
fn register_trace(vth_mant: i64, refractory: i64, expected: &[i32]) {
    let mut net = Builder::new();
    let input = net.input("input", 1);
    let target = net.each("target", Shape::Line(1), &[neuron(1024, 128, vth_mant, refractory)], 0);
    net.matrix(input, target, 0, &[2]);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(expected.len() as u32);
        for (step, &register) in expected.iter().enumerate() {
            let spikes = [ChannelId(0)];
            engine.step((&spikes[..usize::from(step == 1)]).into());
            assert_eq!(engine.v_register(CompartmentId(0)), register, "{name}, step {step}");
            let membrane = if (640..645).contains(&register) { 0 } else { register };
            assert_eq!(engine.v(CompartmentId(0)), membrane, "{name}, step {step}");
            assert_eq!(engine.spikes().len(), usize::from(register == 640), "{name}, step {step}");
        }
    }
}

#[test]
fn a_spike_and_five_refractory_steps_read_as_on_the_chip() {
    let expected = [0, 128, 220, 285, 640, 641, 642, 643, 644, 12, 20, 25, 28, 30, 31, 31, 30, 29, 28];
    register_trace(5, 5, &expected);
}

#[test]
fn a_voltage_below_its_threshold_decays_as_on_the_chip() {
    let expected = [
        0, 128, 220, 285, 330, 359, 377, 387, 390, 389, 385, 378, 370, 361, 351, 341, 330, 319, 309, 299, 289, 279,
        270, 261, 252, 244, 236, 228, 220, 213, 206, 199, 192, 186, 180, 174, 168, 162, 156, 151, 146, 141, 136, 131,
        126, 122, 118, 114, 110,
    ];
    // 7 * 64 = 448: the least threshold that the trace does not reach is one above 390.
    register_trace(7, 5, &expected);
}

/// Marks the spikes of an engine's compartments in a step.
fn mark(spikes: &mut [Vec<bool>], engine: &dyn nsim::ir::spikes::Engine, step: usize) {
    for id in engine.spikes() {
        spikes[id.0 as usize][step] = true;
    }
}

#[test]
fn the_recorded_network_equals_the_chip() {
    let Some(folder) = data("silicon") else { return };
    let read = |name: &str| Array::read(&folder.join(name));
    let input = read("input.npy");
    let hidden = read("hidden_spikes.npy");
    let output = read("output_spikes.npy");
    let voltage = read("hidden_24_voltage.npy");
    // The recording ends with step 498.
    let steps = 499;
    assert_eq!((input.shape[0], hidden.shape[0], output.shape[0], voltage.shape[0]), (250, 25, 1, steps));

    let mut net = Builder::new();
    let source = net.input("source", 250);
    let first = net.each("first", Shape::Line(25), &[neuron(1024, 128, 80, 1); 25], 0);
    let second = net.each("second", Shape::Line(1), &[neuron(1024, 128, 80, 1)], 0);
    net.matrix(source, first, 0, &read("weights_1.npy").values);
    net.matrix(first, second, 0, &read("weights_2.npy").values);

    for (name, mut engine) in engines(&net.build()) {
        let mut spikes = vec![vec![false; steps]; 26];
        engine.begin(steps as u32);
        for step in 0..steps {
            let channels: Vec<_> =
                (0..250).filter(|&c| input.at([c, step]) != 0).map(|c| ChannelId(c as u32)).collect();
            engine.step((&channels).into());
            mark(&mut spikes, engine.as_ref(), step);
            assert_eq!(i64::from(engine.v_register(CompartmentId(24))), voltage.at([step]), "{name}, step {step}");
        }
        for (n, row) in spikes.iter().enumerate() {
            for (step, &spiked) in row.iter().enumerate() {
                let recorded = if n < 25 { hidden.at([n, step]) } else { output.at([0, step]) };
                assert_eq!(i64::from(spiked), recorded, "{name}, compartment {n}, step {step}");
            }
        }
        let count = |rows: &[Vec<bool>]| rows.iter().flatten().filter(|&&s| s).count();
        assert_eq!((count(&spikes[..25]), count(&spikes[25..])), (639, 2), "{name}");
        assert!(!engine.overflow().any(), "{name}");
    }
}

#[test]
fn a_number_that_is_driven_is_the_number_that_arrives() {
    // The other tests rely on `Drive`. With du and dv 4096 the current equals the arrivals, so here
    // it is tested itself.
    let numbers = [0, 1, -1, 127, 128, -129, 16_383, 16_384, -16_385, 32_767, -32_768];
    let mut net = Builder::new();
    let drive = Drive::new(&mut net, 1);
    let target = net.each("target", Shape::Line(1), &[neuron(4096, 4096, 131_071, 1)], 0);
    drive.connect(&mut net, target);
    for (name, mut engine) in engines(&net.build()) {
        engine.begin(numbers.len() as u32);
        for number in numbers {
            engine.step((&drive.spikes(|_| number)).into());
            assert_eq!(i64::from(engine.u(CompartmentId(0))), 64 * number, "{name}");
        }
    }
}
