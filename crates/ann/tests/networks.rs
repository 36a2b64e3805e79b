//! Networks without spikes: convolutions against their definition, gradients against differences,
//! counts against hand-made ones, and training of both kinds.

// Test helpers may unwrap.
#![allow(clippy::unwrap_used)]

use candle_core::Tensor;
use nsim_ann::layers::{Convolution, Weights, halved, tensor};
use nsim_ann::networks::Ann;
use nsim_ann::{AnnKind, AnnSettings, Senses, trained};
use nsim_ir::base::rng;
use nsim_train::fit::Example;
use nsim_train::raster::Raster;

/// The convolution by its definition, with zeros outside.
fn brute_force(x: &Tensor, layer: &Convolution) -> Vec<f32> {
    let (samples, steps, from, rows, columns) = x.dims5().unwrap();
    let (to, _, kr, kc) = layer.weights.dims4().unwrap();
    let (x, w): (Vec<f32>, Vec<f32>) =
        (x.flatten_all().unwrap().to_vec1().unwrap(), layer.weights.flatten_all().unwrap().to_vec1().unwrap());
    let offset: Vec<f32> = layer.offset.to_vec1().unwrap();
    let mut out = Vec::new();
    for (s, t, o) in (0..samples).flat_map(|s| (0..halved(steps)).flat_map(move |t| (0..to).map(move |o| (s, t, o)))) {
        for (r, c) in (0..halved(rows)).flat_map(|r| (0..halved(columns)).map(move |c| (r, c))) {
            let mut sum = offset[o];
            for (kt, i, a, b) in (0..3).flat_map(|kt| {
                (0..from).flat_map(move |i| (0..kr).flat_map(move |a| (0..kc).map(move |b| (kt, i, a, b))))
            }) {
                let place = |at: usize, tap: usize, kernel: usize| (2 * at + tap).checked_sub(kernel / 2);
                let (Some(t), Some(r), Some(c)) = (place(t, kt, 3), place(r, a, kr), place(c, b, kc)) else {
                    continue;
                };
                if t < steps && r < rows && c < columns {
                    let input = x[(((s * steps + t) * from + i) * rows + r) * columns + c];
                    sum += input * w[((o * 3 * from + kt * from + i) * kr + a) * kc + b];
                }
            }
            out.push(sum);
        }
    }
    out
}

#[test]
fn convolutions_are_sums_over_time_rows_and_columns() {
    for (steps, from, rows, columns) in [(6, 2, 5, 4), (7, 1, 1, 9), (1, 3, 2, 2)] {
        let mut weights = Weights::new(5);
        let layer = Convolution::new(&mut weights, "c", (from, 3), (rows, columns)).unwrap();
        let count = 2 * steps * from * rows * columns;
        let values = (0..count).map(|k| rng::unit(1, 2, k as u64) as f32 - 0.5).collect();
        let x = tensor(values, &[2, steps, from, rows, columns]).unwrap();
        let fast: Vec<f32> = layer.forward(&x).unwrap().flatten_all().unwrap().to_vec1().unwrap();
        let slow = brute_force(&x, &layer);
        assert_eq!(fast.len(), slow.len());
        assert!(fast.iter().zip(&slow).all(|(a, b)| (a - b).abs() < 1e-5), "{steps} {rows} {columns}");
    }
}

/// Compares the gradient of a sum of squares with differences.
#[test]
fn gradients_are_those_of_the_sum() {
    let mut weights = Weights::new(6);
    let layer = Convolution::new(&mut weights, "c", (2, 2), (4, 3)).unwrap();
    let values = (0..5 * 2 * 4 * 3).map(|k| rng::unit(7, 1, k) as f32).collect();
    let x = tensor(values, &[1, 5, 2, 4, 3]).unwrap();
    let loss = |layer: &Convolution| layer.forward(&x).unwrap().sqr().unwrap().sum_all().unwrap();
    let gradient = loss(&layer).backward().unwrap();
    let own: Vec<f32> = gradient.get(&layer.weights).unwrap().flatten_all().unwrap().to_vec1().unwrap();
    let flat: Vec<f32> = layer.weights.flatten_all().unwrap().to_vec1().unwrap();
    for at in [0, 7, flat.len() / 2, flat.len() - 1] {
        let moved = |by: f32| {
            let mut changed = flat.clone();
            changed[at] += by;
            let weights = tensor(changed, layer.weights.dims()).unwrap();
            loss(&Convolution { weights, offset: layer.offset.clone() }).to_scalar::<f32>().unwrap()
        };
        let numeric = (moved(1e-2) - moved(-1e-2)) / 2e-2;
        assert!((numeric - own[at]).abs() < 1e-2 * numeric.abs().max(1.0), "{at}: {numeric} {}", own[at]);
    }
}

#[test]
fn parameters_and_operations_are_those_counted_by_hand() {
    let senses = Senses { shapes: vec![(1, 1, 156)], steps: 150, classes: 2 };
    let gru = Ann::new(AnnKind::MlpGru, &senses, 1).unwrap();
    // 156 x 32 + 32, three gates of 32 x 32 twice with two offsets each, 32 x 2 + 2.
    assert_eq!(gru.parameters(), 5_024 + 6_336 + 66);
    assert_eq!(gru.operations(), 150 * (4_992 + 6_144) + 64);
    let cnn = Ann::new(AnnKind::Cnn3d, &senses, 1).unwrap();
    // Kernels of 3 x 1 x 3; 32 x 156 places become 16 x 78, then 8 x 39.
    assert_eq!(cnn.parameters(), (72 + 8) + (16 * 8 * 9 + 16) + (16 * 8 * 39 * 32 + 32) + 66);
    assert_eq!(cnn.operations(), 16 * 78 * 8 * 9 + 8 * 39 * 16 * 8 * 9 + 16 * 8 * 39 * 32 + 64);
}

/// Samples on 2 x 8 x 8 and on 6 channels; the class is the half of the time with more events.
fn examples(count: u64) -> Vec<Example> {
    let raster = |units: u32, sample: u64, label: u32, stream: u64| {
        let events = (0..60).map(|k| {
            let draw = |below, what| rng::below(below, stream, 100 * sample + k, what) as u32;
            let late = draw(5, 0) > 0;
            let half = if late { label } else { 1 - label };
            (20 * half + draw(20, 1), draw(units.into(), 2))
        });
        Raster::from_events(units as usize, 40, events.collect())
    };
    (0..count)
        .map(|sample| {
            let label = (sample % 2) as u32;
            Example { inputs: vec![raster(128, sample, label, 1), raster(6, sample, label, 2)], label }
        })
        .collect()
}

#[test]
fn each_kind_learns_and_does_so_alike_twice() {
    let all = examples(96);
    let (train, test): (Vec<&Example>, Vec<&Example>) = (all[..64].iter().collect(), all[64..].iter().collect());
    let senses = Senses { shapes: vec![(2, 8, 8), (1, 1, 6)], steps: 40, classes: 2 };
    for kind in AnnKind::ALL {
        let settings = AnnSettings { epochs: 12, batch: 8, rate: 0.01, seed: 3 };
        let run = || trained((kind, &senses), (&train, &test), settings, |_| ()).unwrap();
        let (a, b) = (run(), run());
        assert!(a.accuracy > 0.9 && a.losses[11] < 0.5 * a.losses[0], "{kind:?}: {a:?}");
        assert_eq!((&a.losses, a.accuracy), (&b.losses, b.accuracy));
    }
}
