//! The fast machine against the golden interpreter, bit for bit, on random networks: under three
//! partitions, with skipping and without, in 1, 2 and 8 shards run by as many threads.

use std::sync::LazyLock;

use crate::common::compare::{Trace, assert_on_machine, roomy, trace};
use crate::common::{Builder, format, neuron, random, unsearched};
use nsim::compile::{DEFAULT_RATE, Front, Mapping, Options, compile, is_large, load};
use nsim::files::target::load_target;
use nsim::golden::Golden;
use nsim::import::model::load_model;
use nsim::ir::activity::Activity;
use nsim::ir::base::fixed::SignMode;
use nsim::ir::base::id::ChannelId;
use nsim::ir::base::rng;
use nsim::ir::firing_rates::Rates;
use nsim::ir::graph::{Shape, Window};
use nsim::ir::hardware::Target;
use nsim::ir::placement::Mesh;
use nsim::ir::quantised::Quantised;
use nsim::ir::quantised::connectivity::Connectivity;
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::ir::stimulus::SceneArg;
use nsim::machine::{Image, Machine, Settings};
use nsim::quantise::prune::{Plan, prune};
use nsim::session::front::front;
use nsim::study::networks::{Random, random as random_network};
use nsim_testing::cases;
use rayon::prelude::*;

static CHIP: LazyLock<Target> = LazyLock::new(|| roomy("loihi1-chip"));

/// Three partitions: on as few cores as possible, with at most `few` compartments a core, and at
/// random.
fn partitions(network: &Quantised, few: u32, seed: u64) -> Vec<(&'static str, Mapping)> {
    // The search for places takes most of the time and does not matter here; the random mapping
    // places cores anywhere.
    let options = Options { place: seed.is_multiple_of(8), ..unsearched() };
    let few = CHIP.limits().clone().with(Resource::Compartments, few);
    let mut compiled = vec![
        ("sequential", compile(network.clone(), &CHIP, &options)),
        ("small cores", compile(network.clone(), &CHIP.clone().with_limits(few), &options)),
    ];
    // A random mapping might assign more to one core than its limit.
    if network.compartments() <= CHIP.limits()[Resource::Compartments] {
        let mapping = random::mapping(network, &Mesh::for_target(&CHIP), seed);
        compiled.push(("distributed", load(network.clone(), &CHIP, &options, &mapping)));
    }
    compiled.into_iter().map(|(name, result)| (name, result.unwrap_or_else(|e| panic!("{seed} {name}: {e}")))).collect()
}

/// Compares one network on every partition and setting; returns its number of spikes.
fn compare(seed: u64) -> u64 {
    let network = random::network(seed);
    let sample = random::sample(&network, seed);
    let golden = trace(&mut Golden::new(&network), &network, &sample);
    compare_on(&golden, &network, &sample, partitions(&network, 5, seed), seed);
    golden.totals.spikes
}

/// Compares a golden trace with the machine's on every mapping and setting. Returns the number of
/// chunks of shared weights that it added.
fn compare_on(golden: &Trace, network: &Quantised, sample: &Sample, mapped: Vec<(&str, Mapping)>, seed: u64) -> usize {
    let compared = |(name, compiled): (&str, Mapping)| {
        assert_on_machine(network, &compiled.program, sample, golden, &format!("network {seed}, {name}")).1
    };
    mapped.into_iter().map(compared).sum()
}

/// Convolutions in rows of shared weights: as few cores as possible, small cores of tiles, a random
/// mapping, and the program written box by box, where kernels stay kernels.
#[test]
fn random_convolutions_are_the_same_in_both_engines() {
    let board = load_target("nahuku-32").unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
    let compare = |seed: u64| {
        let network = random::convolutional(seed);
        let sample = random::sample(&network, seed);
        let golden = trace(&mut Golden::new(&network), &network, &sample);
        let (mut mapped, mut boxes) = (partitions(&network, 32, seed), 0);
        let limits = board.limits().clone().with(Resource::Compartments, 30);
        let small = unsearched();
        for (name, target) in [("boxes", board.clone()), ("small boxes", board.clone().with_limits(limits))] {
            let rates = Rates::assumed(DEFAULT_RATE);
            let front = Front::from(network.clone()).cut();
            if let Ok(by_kernels) = nsim::compile::map(front, &target, &small, &rates) {
                mapped.push((name, by_kernels));
                boxes += 1;
            }
        }
        (golden.totals.spikes, compare_on(&golden, &network, &sample, mapped, seed), boxes)
    };
    let networks = cases(500);
    let found: Vec<_> = pool.install(|| (0..networks).into_par_iter().map(compare).collect());
    let (spiking, shared) = (found.iter().filter(|found| found.0 > 0), found.iter().filter(|found| found.1 > 0));
    let (spiking, shared, boxes) = (spiking.count(), shared.count(), found.iter().map(|found| found.2).sum::<u64>());
    let all = networks as usize;
    assert!(
        2 * spiking > all && 10 * shared > 7 * all && 5 * boxes > 9 * networks,
        "{spiking} spike, {shared} share, {boxes} in boxes"
    );
}

#[test]
fn random_networks_are_the_same_in_both_engines() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(8).build().unwrap();
    let networks = cases(1_000);
    let spikes: Vec<u64> = pool.install(|| (0..networks).into_par_iter().map(compare).collect());
    let silent = spikes.iter().filter(|&&spikes| spikes == 0).count();
    assert!(silent < networks as usize / 3, "{silent} of {networks} networks never spike: they test too little");
}

/// Events lost near the ends of samples are summed by source over all samples.
#[test]
fn counts_taken_after_many_samples_are_those_taken_after_each() {
    let mut shortened = 0;
    for seed in 0..40 {
        let network = random::network(seed);
        let (_, compiled) = partitions(&network, 5, seed).swap_remove(1);
        let image = Image::new(&compiled.program, 2).unwrap();
        let machine = || Machine::new(&image, Settings::default());
        let (mut once, mut each, mut golden) = (machine(), machine(), Golden::new(&network));
        let mut sum: Option<Activity> = None;
        let mut events = 0;
        for k in 0..4 {
            let whole = random::sample(&network, 7 * seed + k);
            let sample = whole.beginning(whole.steps() / (1 + k as u32));
            let expected = trace(&mut golden, &network, &sample);
            events += expected.totals.synaptic_events;
            shortened += u64::from(sample.steps() < 20);
            for engine in [&mut once, &mut each] {
                expected.assert_same(&trace(engine, &network, &sample), &format!("network {seed}, sample {k}"));
            }
            let activity = each.take_activity();
            match &mut sum {
                Some(sum) => sum.merge(&activity),
                None => sum = Some(activity),
            }
        }
        let sum = sum.unwrap();
        assert_eq!(sum.totals().synaptic_events, events, "network {seed}");
        assert_eq!(once.take_activity(), sum, "network {seed}");
    }
    assert!(shortened > 10, "{shortened} short samples");
}

/// Lists of synapses of three bytes each, and shards whose lists have another form.
#[test]
fn a_large_random_network_is_the_same_in_both_engines() {
    let sizes = Random { compartments: 4_500, background: 4, driven: 100, period: 30 };
    let bench = random_network("large", sizes, &[0]).unwrap();
    let network = bench.network;
    let golden = trace(&mut Golden::new(&network), &network, &bench.period);
    assert!(golden.totals.spikes > 1_000 && golden.totals.synaptic_events > 64_000);
    let compiled = compile(network.clone(), &load_target(bench.target).unwrap(), &Options::default()).unwrap();
    assert_on_machine(&network, &compiled.program, &bench.period, &golden, "large");
}

/// Channels with rows may have different numbers of synapses. Steps then count by a mean, and the
/// error is corrected from the spike counts of the channels: whenever the counts are read or reset.
#[test]
fn events_of_uneven_rows_are_right_after_every_step() {
    let network = front(&load_model("vtsnn-slip").unwrap()).unwrap().into_quantised();
    let samples = nsim::scene::stimulus(&network, &SceneArg::parse("slip?samples=2&seed=3").unwrap()).unwrap().samples;
    let pruned = prune(&network, &Plan::fixed()).unwrap();
    let compiled = compile(pruned.clone(), &load_target("nahuku-32").unwrap(), &Options::default()).unwrap();
    let mut golden = Golden::new(&pruned);
    for shares in [1, 2] {
        let image = Image::new(&compiled.program, shares).unwrap();
        let mut machine = Machine::new(&image, Settings::default());
        for sample in &samples {
            golden.begin(sample.steps());
            machine.begin(sample.steps());
            let mut events = 0;
            for step in 0..sample.steps() {
                golden.step(sample.input(step));
                machine.step(sample.input(step));
                if step % 40 == 7 {
                    events += machine.take_activity().totals().synaptic_events;
                }
                assert_eq!(machine.totals(), golden.totals(), "{shares} shares, step {step}");
            }
            events += machine.take_activity().totals().synaptic_events;
            assert_eq!(events, golden.totals().synaptic_events, "{shares} shares");
        }
    }
}

/// One 3 x 3 convolution without a border, of 64 channels to 64, over a square of inputs.
fn wide_convolution(side: u32) -> Quantised {
    let (from, to) = ((64, side, side), (64, side - 2, side - 2));
    let mut net = Builder::new();
    let input = net.input_shape("input", Shape::Volume(from.0, from.1, from.2));
    let neurons = vec![neuron(1024, 128, 300, 2); (to.0 * to.1 * to.2) as usize];
    let out = net.each("out", Shape::Volume(to.0, to.1, to.2), &neurons, 0);
    let once = (1, 1);
    let window =
        Window { source: from, target: to, kernel: (3, 3), stride: once, padding: (0, 0), dilation: once, groups: 1 };
    let kernel = (0..64 * 64 * 9).map(|k| rng::below(101, 7, k, 0) as i16 * 2 - 90).collect();
    net.connect(input, out, format(SignMode::Mixed, 0), 0, Connectivity::Conv2d { window, kernel });
    net.build()
}

/// The machine runs a network with too many synapses to write out; golden runs regions of it alone.
#[test]
fn regions_of_a_network_too_large_to_write_out_spike_as_they_do_alone() {
    const SIDE: u32 = 88;
    const PART: u32 = 14;
    let whole = wide_convolution(SIDE);
    assert!(is_large(&whole, 1));
    let spikes = |t: u32| (0..whole.channels()).filter(move |&c| rng::below(100, 9, c.into(), t.into()) < 4);
    let events: Vec<_> = (0..12).flat_map(|t| spikes(t).map(move |channel| (t, ChannelId(channel)))).collect();
    let sample = Sample::new(12, &events, None).unwrap();
    let board = load_target("pohoiki-springs").unwrap();
    let options = unsearched();
    let compiled = compile(whole.clone(), &board, &options).unwrap();
    let image = Image::new(&compiled.program, 2).unwrap();
    assert!(image.shared_chunks() > 0);
    let mut machine = Machine::new(&image, Settings::default());
    let golden = wide_convolution(PART);
    let mut compared = 0;
    for (top, left) in [(0, 0), (37, 51), (SIDE - PART, SIDE - PART)] {
        // The unit of the whole that is this unit of the part.
        let place = |unit: u32, part: u32, side: u32| {
            (unit / (part * part) * side + unit / part % part + top) * side + unit % part + left
        };
        let seen: std::collections::HashMap<u32, u32> =
            (0..golden.channels()).map(|channel| (place(channel, PART, SIDE), channel)).collect();
        let own = events.iter().filter_map(|&(t, channel)| Some((t, ChannelId(*seen.get(&channel.0)?))));
        let own = Sample::new(12, &own.collect::<Vec<_>>(), None).unwrap();
        let inside: std::collections::HashSet<u32> =
            (0..golden.compartments()).map(|unit| place(unit, PART - 2, SIDE - 2)).collect();
        let mut alone = Golden::new(&golden);
        alone.begin(12);
        machine.begin(12);
        for t in 0..12 {
            alone.step(own.input(t));
            machine.step(sample.input(t));
            let mut expected: Vec<u32> =
                alone.spikes().iter().map(|spike| place(spike.0, PART - 2, SIDE - 2)).collect();
            expected.sort_unstable();
            let spiked: Vec<u32> =
                machine.ascending_spikes().iter().map(|spike| spike.0).filter(|spike| inside.contains(spike)).collect();
            assert_eq!(spiked, expected, "step {t} at {top}, {left}");
            compared += spiked.len();
        }
    }
    assert!(compared > 5_000, "{compared} spikes");
}
