//! Networks of other tools, through import, map and the fast engine, compared with the recordings
//! of those tools.

use crate::common;
use crate::tree::{int, ints, typed};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use nsim::compile::{Options as MapOptions, compile};
use nsim::files::network::Network;
use nsim::files::npy;
use nsim::files::target::load_target;
use nsim::import::foreign;
use nsim::import::foreign::Options;
use nsim::import::hdf5;
use nsim::import::hdf5::{Group, Item, Numbers};
use nsim::import::model::load_model;
use nsim::ir::arithmetic::{ReadOut, ThresholdTest};
use nsim::ir::base::id::ChannelId;
use nsim::ir::quantised::Output;
use nsim::ir::spikes::Sample;
use nsim::ir::tensor::Tensor;
use nsim::machine::{Image, Machine, Settings};
use nsim::session::front::front;
use nsim::session::{Probe, Quantity, SampleSettings, Session};

/// (step, unit) of each spike.
type Spikes = BTreeSet<(u32, u32)>;

/// The spikes of a population on the fast engine, mapped onto the shipped board.
fn spikes(network: &Network, population: &str, steps: u32, inputs: impl IntoIterator<Item = (u32, u32)>) -> Spikes {
    let compiled =
        compile(front(network).unwrap(), &load_target("nahuku-32").unwrap(), &MapOptions::default()).unwrap();
    let quantised = &compiled.quantised;
    let population = &quantised.populations()[quantised.population_named(population).unwrap()];
    let (first, count) = (population.first_compartment().unwrap(), population.shape.len());
    let output = Output { first, count, decision: ReadOut::Spikes, start_step: 0 };
    let image = Image::new(&compiled.program, 1).unwrap();
    let mut session = Session::new(Machine::new(&image, Settings { skip: true, per_step: false }), 1);
    let events: Vec<_> =
        inputs.into_iter().filter(|event| event.0 < steps).map(|(step, c)| (step, ChannelId(c))).collect();
    let sample = Sample::new(steps, &events, None).unwrap();
    let probes = vec![Probe { first, count, quantity: Quantity::Spikes }];
    let outcome = session.run(&sample, &SampleSettings { probes, ..SampleSettings::new(output) }, ());
    outcome.spikes.into_iter().collect()
}

/// The network of a foreign file that is written and read again. Reading it directly gives an equal
/// text, apart from the name of the file with the arrays.
fn import(path: &Path, options: &Options) -> Network {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.ron");
    let imported = foreign::read(path, options).unwrap();
    imported.model.write(&model, false).unwrap();
    let direct = foreign::network(path, options).unwrap();
    let written = load_model(model.to_str().unwrap()).unwrap();
    assert_eq!(direct.source().text().replace("\"arrays\"", "\"model.safetensors\""), **written.source().text());
    written
}

/// Spikes of an array `[1, units.., T]` or `[units.., T]`, `later` steps later.
fn of_array(path: &Path, later: u32) -> Spikes {
    let tensor = npy::read(path).unwrap();
    let steps = *tensor.shape().last().unwrap();
    let on = (0..tensor.len()).filter(|&at| tensor.real(at) != 0.0);
    on.map(|at| ((at % steps) as u32 + later, (at / steps) as u32)).collect()
}

/// Spikes of rows of (unit, .., time), time rounded to even steps.
fn of_rows(tensor: &Tensor, unit: usize, time: usize, later: u32) -> Spikes {
    let columns = tensor.shape()[1];
    let row = |row: usize, column: usize| tensor.real(row * columns + column);
    (0..tensor.shape()[0]).map(|r| (row(r, time).round_ties_even() as u32 + later, row(r, unit) as u32)).collect()
}

#[test]
fn the_oxford_network_of_lava_dl_gives_its_recorded_spikes() {
    let Some(data) = common::data("netx") else { return };
    let data = data.join("oxford");
    let input = of_rows(&npy::read(&data.join("input.npy")).unwrap(), 0, 2, 0);
    let recorded = of_rows(&npy::read(&data.join("ground_truth.npy")).unwrap(), 0, 2, 0);
    assert_eq!(recorded.len(), 10_178);
    // Recorded after the delay of the output layer.
    let run = |options: &Options| -> Spikes {
        let network = import(&data.join("network.net"), options);
        spikes(&network, "layer1", 2000, input.clone()).into_iter().map(|(step, unit)| (step + 1, unit)).collect()
    };
    assert_eq!(run(&Options { threshold: Some(ThresholdTest::Inclusive), ..Options::default() }), recorded);
    // The chip's comparison gives another network, so a wrong convention would be noticed.
    assert_eq!(run(&Options::default()).symmetric_difference(&recorded).count(), 3014);
}

#[test]
fn the_tiny_network_of_lava_dl_gives_its_recorded_spikes() {
    let Some(data) = common::data("netx") else { return };
    let data = data.join("tiny");
    let network = import(&data.join("network.net"), &Options::default());
    let input = of_array(&data.join("input.npy"), 0);
    assert_eq!(spikes(&network, "layer1", 16, input.clone()), of_array(&data.join("layer1.npy"), 0));
    // Layer 2 receives layer 1 a step later than in SLAYER's time.
    assert_eq!(spikes(&network, "layer2", 17, input), of_array(&data.join("output.npy"), 1));
}

#[test]
fn an_image_drives_the_input_layer_as_recorded() {
    let Some(data) = common::data("netx") else { return };
    let data = data.join("tiny");
    // The recorded drive is [width, height, channels] and, for an image x, 2 * 36 x - 36 + 34.
    let drive = npy::read(&data.join("input_bias.npy")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("image.npy");
    let pixel = |y: usize, x: usize, c: usize| (drive.real((x * 16 + y) * 3 + c) + 2.0 + 0.25) / 72.0;
    let places = (0..16).flat_map(|y| (0..16).flat_map(move |x| (0..3).map(move |c| (y, x, c))));
    let pixels = places.map(|(y, x, c)| pixel(y, x, c));
    npy::write(std::fs::File::create(&path).unwrap(), &[16, 16, 3], pixels).unwrap();
    let network = import(&data.join("network.net"), &Options { image: Some(path), ..Options::default() });
    assert_eq!(spikes(&network, "input", 16, []), of_array(&data.join("input.npy"), 0));
    assert_eq!(spikes(&network, "layer1", 17, []), of_array(&data.join("layer1.npy"), 1));
    assert_eq!(spikes(&network, "layer2", 18, []), of_array(&data.join("output.npy"), 2));
}

fn yaml(folder: &Path) -> PathBuf {
    let path = folder.join("loihi.yml");
    let text = "simulation:\n  Ts: 1.0\n  tSample: 150\nneuron:\n  type: LOIHI\n  vThMant: 80\n  vDecay: 128\n  \
                iDecay: 1024\n  refDelay: 1\n  wgtExp: 0\n";
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn the_oxford_checkpoint_of_slayer_gives_its_recorded_spikes() {
    let Some(data) = common::data("oxford-slayer") else { return };
    let folder = tempfile::tempdir().unwrap();
    let options = Options { neuron: Some(yaml(folder.path())), ..Options::default() };
    let network = import(&data.join("oxfordNet.pt"), &options);
    let input = of_rows(&npy::read(&data.join("input_events.npy")).unwrap(), 0, 1, 0);
    let recorded = of_rows(&npy::read(&data.join("output_events.npy")).unwrap(), 0, 1, 0);
    assert_eq!(recorded.len(), 10_456);
    let spikes: Spikes =
        spikes(&network, "fc2", 1900, input).into_iter().map(|(step, unit)| (step + 1, unit)).collect();
    assert_eq!(spikes.symmetric_difference(&recorded).count(), 0);
    // Its quantised weights equal the published ones.
    for (layer, file) in [("fc1", "weights_1.npy"), ("fc2", "weights_2.npy")] {
        let theirs = npy::read(&data.join(file)).unwrap();
        let imported = foreign::read(&data.join("oxfordNet.pt"), &options).unwrap();
        let ours = imported.model.projections.iter().find(|projection| projection.to == layer).unwrap();
        assert_eq!(
            ours.kind,
            nsim::files::network::ProjectionKind::Dense(nsim::files::network::Weights::InPlace(theirs))
        );
    }
}

#[test]
fn a_set_of_weights_of_vtsnn_gives_what_three_emulators_gave() {
    let Some(data) = common::data("vtsnn-random") else { return };
    let folder = tempfile::tempdir().unwrap();
    for (ours, theirs) in [("tact", "weights_tactile"), ("vis", "weights_vision"), ("combi", "weights_output")] {
        std::fs::copy(data.join(format!("{theirs}.npy")), folder.path().join(format!("100-{ours}.npy"))).unwrap();
    }
    let options = Options { neuron: Some(yaml(folder.path())), ..Options::default() };
    let network = import(&folder.path().join("100-vis.npy"), &options);
    let (tactile, vision) =
        (npy::read(&data.join("tactile.npy")).unwrap(), npy::read(&data.join("vision.npy")).unwrap());
    let output = npy::read(&data.join("output_spikes.npy")).unwrap();
    let of = |tensor: &Tensor, sample: usize, first: u32| -> Spikes {
        let (units, steps) = (tensor.shape()[1], tensor.shape()[2]);
        let all = (0..units).flat_map(|unit| (0..steps).map(move |step| (unit, step)));
        let on = all.filter(|(unit, step)| tensor.real((sample * units + unit) * steps + step) != 0.0);
        on.map(|(unit, step)| (step as u32, unit as u32 + first)).collect()
    };
    for sample in [0, 9] {
        let input = of(&tactile, sample, 0).into_iter().chain(of(&vision, sample, 156));
        assert_eq!(spikes(&network, "combi", 150, input), of(&output, sample, 0), "sample {sample}");
    }
}

fn floats(shape: &[usize], x: &[i64]) -> Numbers {
    Numbers::f32(shape, &x.iter().map(|&x| x as f32).collect::<Vec<_>>())
}

fn cuba(du: i64, dv: i64, vth: i64) -> Group {
    let decays = typed("CUBA").with("iDecay", int(du)).with("vDecay", int(dv));
    decays.with("vThMant", int(vth)).with("refDelay", int(1))
}

/// A layer whose type is an array of one text, a form that h5py writes.
fn layer(kind: &str) -> Group {
    Group::default().with("type", Item::Texts(vec![1], vec![kind.to_string()]))
}

/// Small pseudo-random even numbers.
fn noise(count: usize, seed: u64, amplitude: i64) -> Vec<i64> {
    (0..count as u64)
        .map(|i| 2 * (nsim::ir::base::rng::below(2 * amplitude as u64 + 1, seed, i, 0) as i64 - amplitude))
        .collect()
}

/// A layer of the network of [`presented`], for the file and for the sums.
struct Layer {
    shape: [usize; 3],
    /// `[out][in][kh][kw]`.
    kernel: Vec<i64>,
    size: usize,
    stride: usize,
    padding: usize,
    bias: Vec<i64>,
}

/// Spikes of a network in SLAYER's time, with all layers in one step, for one presentation of an
/// image. They are computed from the equations, without any code of nsim.
fn presented(image: &[i64], input: [usize; 3], layers: &[Layer], steps: usize) -> Vec<Vec<Vec<bool>>> {
    let decay = |x: i64, d: i64| x * (4096 - d) / 4096;
    let mut v: Vec<Vec<i64>> = std::iter::once(vec![0; image.len()])
        .chain(layers.iter().map(|layer| vec![0; layer.shape.iter().product()]))
        .collect();
    let mut u = v.clone();
    let mut spikes = Vec::new();
    for _ in 0..steps {
        let mut now: Vec<Vec<bool>> = Vec::new();
        for level in 0..=layers.len() {
            let mut sums = vec![0i64; v[level].len()];
            if level > 0 {
                let layer = &layers[level - 1];
                let from = if level == 1 { input } else { layers[level - 2].shape };
                let [out, height, width] = layer.shape;
                for (o, y, x) in
                    (0..out).flat_map(|o| (0..height).flat_map(move |y| (0..width).map(move |x| (o, y, x))))
                {
                    let mut sum = 0;
                    for (c, ky, kx) in (0..from[0])
                        .flat_map(|c| (0..layer.size).flat_map(move |ky| (0..layer.size).map(move |kx| (c, ky, kx))))
                    {
                        let (sy, sx) = (y * layer.stride + ky, x * layer.stride + kx);
                        let (Some(sy), Some(sx)) = (sy.checked_sub(layer.padding), sx.checked_sub(layer.padding))
                        else {
                            continue;
                        };
                        if sy < from[1] && sx < from[2] && now[level - 1][(c * from[1] + sy) * from[2] + sx] {
                            sum += layer.kernel[((o * from[0] + c) * layer.size + ky) * layer.size + kx];
                        }
                    }
                    sums[(o * height + y) * width + x] = sum;
                }
            }
            let row = (0..sums.len())
                .map(|i| {
                    let per_channel = |layer: &Layer| layer.bias[i / (layer.shape[1] * layer.shape[2])];
                    let bias = if level == 0 { image[i] } else { per_channel(&layers[level - 1]) };
                    u[level][i] = decay(u[level][i], 2048) + 64 * sums[i];
                    v[level][i] = decay(v[level][i], 512) + u[level][i] + 64 * bias;
                    let spike = v[level][i] > 64 * 40;
                    if spike {
                        v[level][i] = 0;
                    }
                    spike
                })
                .collect();
            now.push(row);
        }
        spikes.push(now);
    }
    spikes
}

#[test]
fn numbers_that_netx_changes_are_told_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("net.net");
    let assumed = |weights: [f64; 2], bias: f64| {
        let input = layer("input").with("shape", ints(&[2]));
        let dense = layer("dense").with("shape", ints(&[1])).with("neuron", cuba(2048, 512, 40));
        let dense = dense.with("weight", Numbers::f64(&[1, 2], &weights)).with("bias", Numbers::f64(&[1], &[bias]));
        let file = Group::default().with("layer", Group::default().with("0", input).with("1", dense));
        std::fs::write(&path, hdf5::write(&file).unwrap()).unwrap();
        load_model(path.to_str().unwrap()).unwrap().conventions().warnings.first().map(ToString::to_string)
    };
    assert_eq!(assumed([20.0, -6.0], 2.0), None);
    assert!(assumed([20.0, -6.5], 2.0).unwrap().contains("1 numbers of 'weight' are not whole"));
    assert!(assumed([20.0, -7.0], 2.5).unwrap().contains("1 biases are not whole"));
    assert!(assumed([513.0, -7.0], 2.0).unwrap().contains("of 2 numbers of 'weight' do not fit into one synapse"));
}

#[test]
fn a_deep_network_with_an_image_and_resets_gives_what_its_equations_give() {
    let input = [2, 8, 6];
    let mut layers = Vec::new();
    let mut from = input;
    // Thirteen layers with the input: a listing by name has 10 before 2.
    for k in 0..11u64 {
        let (out, stride) = (3 + (k as usize % 2), if k == 0 { 2 } else { 1 });
        let side = |n: usize| (n + 2 - 3) / stride + 1;
        let shape = [out, side(from[1]), side(from[2])];
        layers.push(Layer {
            shape,
            kernel: noise(out * from[0] * 9, k, 9),
            size: 3,
            stride,
            padding: 1,
            bias: noise(out, 100 + k, 6),
        });
        from = shape;
    }
    // The last layer is dense, with a 1-D shape and 1-D weights.
    assert_eq!([from[1], from[2]], [4, 3]);
    let dense = noise(5 * from[0] * 12, 50, 12);
    let first = layer("input")
        .with("shape", ints(&input.map(|axis| axis as i64)))
        .with("neuron", cuba(2048, 512, 40))
        .with("weight", int(20))
        .with("bias", Numbers::f64(&[1], &[22.0]));
    let mut file = Group::default().with("0", first);
    for (k, one) in layers.iter().enumerate() {
        let inner = if k == 0 { input[0] } else { layers[k - 1].shape[0] };
        let pair = |x: usize| ints(&[x as i64, x as i64]);
        let conv = layer("conv")
            .with("shape", ints(&one.shape.map(|axis| axis as i64)))
            .with("inChannels", int(inner as i64))
            .with("outChannels", int(one.shape[0] as i64))
            .with("kernelSize", pair(3))
            .with("stride", pair(one.stride))
            .with("padding", pair(1))
            .with("dilation", pair(1))
            .with("groups", int(1))
            .with("weight", floats(&[one.shape[0], inner, 3, 3], &one.kernel))
            .with("bias", floats(&[one.shape[0]], &one.bias))
            .with("neuron", cuba(2048, 512, 40));
        file.insert(&(k + 1).to_string(), conv);
    }
    file.insert("12", layer("flatten").with("shape", ints(&[(from[0] * 12) as i64])));
    let last = layer("dense")
        .with("shape", ints(&[5]))
        .with("inFeatures", int((from[0] * 12) as i64))
        .with("outFeatures", int(5))
        .with("weight", floats(&[dense.len()], &dense))
        .with("neuron", cuba(2048, 512, 40));
    file.insert("13", last);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep.net");
    std::fs::write(&path, hdf5::write(&Group::default().with("layer", file)).unwrap()).unwrap();

    // An image of bytes, [height, width, channels].
    let pixels: Vec<u8> = (0..96).map(|i| nsim::ir::base::rng::below(256, 7, i, 0) as u8).collect();
    let image = folder.path().join("image.npy");
    npy::write(std::fs::File::create(&image).unwrap(), &[8, 6, 2], pixels.iter().copied()).unwrap();
    let drive: Vec<i64> = (0..96)
        .map(|i| {
            let (c, y, x) = (i / 48, i / 6 % 8, i % 6);
            (2.0 * 20.0 * (f64::from(pixels[(y * 6 + x) * 2 + c]) / 255.0) - 20.0 + 22.0).trunc() as i64
        })
        .collect();
    let interval = 20;
    let options = Options { image: Some(image), reset_interval: Some(interval), ..Options::default() };
    let network = import(&path, &options);
    let names: Vec<&str> = network.file().populations.iter().map(|p| p.name.as_str()).collect();
    assert_eq!((names.len(), names[2], names[10], names[12]), (13, "layer2", "layer10", "layer13"));

    let expected = presented(&drive, input, &layers, interval as usize);
    let presentations = 3;
    let steps = presentations * interval + 14;
    for level in [0usize, 1, 5, 11] {
        let mut wanted = Spikes::new();
        for (again, step) in (0..presentations).flat_map(|again| (0..interval).map(move |step| (again, step))) {
            let row = &expected[step as usize][level];
            let on = (0..row.len()).filter(|&i| row[i]);
            wanted.extend(on.map(|i| (1 + level as u32 + again * interval + step, i as u32)));
        }
        let name = if level == 0 { "input".to_string() } else { format!("layer{level}") };
        let end = 1 + level as u32 + presentations * interval;
        let found: Spikes = spikes(&network, &name, steps, []).into_iter().filter(|spike| spike.0 < end).collect();
        assert!(wanted.len() > 20, "layer {level} has {} spikes", wanted.len());
        assert_eq!(found, wanted, "layer {level}");
    }
    // The dense layer receives the last convolution in the order C, H, W.
    let flat = |step: usize| expected[step][11].iter().enumerate().filter(|(_, on)| **on).map(|(i, _)| i);
    let (mut u, mut v, mut wanted) = (vec![0i64; 5], vec![0i64; 5], Spikes::new());
    for step in 0..interval as usize {
        for o in 0..5 {
            let sum: i64 = flat(step).map(|i| dense[o * from[0] * 12 + i]).sum();
            u[o] = u[o] * 2048 / 4096 + 64 * sum;
            v[o] = v[o] * (4096 - 512) / 4096 + u[o];
            if v[o] > 64 * 40 {
                v[o] = 0;
                wanted.insert((13 + step as u32, o as u32));
            }
        }
    }
    let found: Spikes = spikes(&network, "layer13", steps, []).into_iter().filter(|s| s.0 < 13 + interval).collect();
    assert!(!wanted.is_empty());
    assert_eq!(found, wanted);
}
