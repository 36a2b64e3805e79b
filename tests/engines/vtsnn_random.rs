//! The two-modality network of the VT-SNN paper with random weights: every spike of ten samples
//! equals nengo-loihi's, lava's and brian2-loihi's.

use crate::common::{Array, Builder, data, engines, neuron};
use nsim::ir::base::id::ChannelId;
use nsim::ir::graph::Shape;

#[test]
fn every_spike_equals_that_of_three_other_emulators() {
    let Some(folder) = data("vtsnn-random") else { return };
    let read = |name: &str| Array::read(&folder.join(name));
    let (tactile, vision) = (read("tactile.npy"), read("vision.npy"));
    let (hidden, output) = (read("hidden_spikes.npy"), read("output_spikes.npy"));
    let counts = read("output_counts.npy");
    let (samples, steps) = (hidden.shape[0], hidden.shape[2]);
    assert_eq!((tactile.shape[1], vision.shape[1], hidden.shape[1], output.shape[1]), (156, 3150, 60, 2));

    let cuba = neuron(1024, 128, 80, 1);
    let mut net = Builder::new();
    let touch = net.input("touch", 156);
    let sight = net.input("sight", 3150);
    let touched = net.each("touched", Shape::Line(50), &[cuba; 50], 0);
    let seen = net.each("seen", Shape::Line(10), &[cuba; 10], 0);
    let decision = net.each("decision", Shape::Line(2), &[cuba; 2], 0);
    net.matrix(touch, touched, 0, &read("weights_tactile.npy").values);
    net.matrix(sight, seen, 0, &read("weights_vision.npy").values);
    // The output's sources are both hidden populations, the tactile one first.
    let weights = read("weights_output.npy");
    let columns = |from: std::ops::Range<usize>| -> Vec<i64> {
        (0..2).flat_map(|t| from.clone().map(move |s| (t, s))).map(|(t, s)| weights.at([t, s])).collect()
    };
    net.matrix(touched, decision, 0, &columns(0..50));
    net.matrix(seen, decision, 0, &columns(50..60));

    for (name, mut engine) in engines(&net.build()) {
        for sample in 0..samples {
            engine.begin(steps as u32);
            let mut decided = [0, 0];
            for step in 0..steps {
                let touches = (0..156).filter(|&c| tactile.at([sample, c, step]) != 0);
                let sights = (0..3150).filter(|&c| vision.at([sample, c, step]) != 0).map(|c| 156 + c);
                let channels: Vec<_> = touches.chain(sights).map(|c| ChannelId(c as u32)).collect();
                engine.step((&channels).into());
                let spikes: Vec<_> = engine.ascending_spikes().iter().map(|id| id.0 as usize).collect();
                let recorded: Vec<_> = (0..62)
                    .filter(|&n| match n {
                        0..60 => hidden.at([sample, n, step]) != 0,
                        _ => output.at([sample, n - 60, step]) != 0,
                    })
                    .collect();
                assert_eq!(spikes, recorded, "{name}, sample {sample}, step {step}");
                for n in spikes.into_iter().filter(|&n| n >= 60) {
                    decided[n - 60] += 1;
                }
            }
            assert_eq!(decided, [counts.at([sample, 0]), counts.at([sample, 1])], "{name}, sample {sample}");
        }
    }
}
