//! Words of a Loihi 2 core and numbers of cores, compared with allocations that Intel's compiler
//! printed (lava-dl d825ac5, notebooks of `netx`).

use crate::{Front, Options, map};
use nsim_check::memory;
use nsim_check::verify::{Violation, confirm};
use nsim_ir::base::id::{CoreId, PopulationId};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::{Shape, Window};
use nsim_ir::hardware::Target;
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::resource::{Limits, Resource};
use nsim_partition::error::CompileError;
use nsim_partition::resources::formats::Lists;
use nsim_testing::{Builder, neurons, plain_format, random_network};

fn board() -> Target {
    nsim_files::target::load_target("oheo-gulch").unwrap()
}

fn mapped(front: impl Into<Front>, board: &Target) -> Result<crate::Mapping, CompileError> {
    map(front.into(), board, &Options::default(), &Rates::assumed(0.01))
}

/// Rows, output channels or targets, weight bits, and words as printed.
const CONVOLUTIONS: [(u64, u64, u32, u64); 5] =
    [(27, 24, 6, 81), (216, 36, 5, 864), (324, 48, 4, 1_620), (432, 64, 5, 2_592), (576, 64, 4, 2_880)];
const DENSE: [(u64, u64, u32, u64); 7] = [
    (2_560, 100, 4, 66_560),
    (100, 50, 6, 1_500),
    (50, 10, 5, 150),
    (10, 1, 4, 10),
    (784, 50, 8, 12_544),
    (128, 64, 8, 2_688),
    (64, 10, 8, 256),
];

#[test]
fn rows_of_synapses_take_the_words_that_intel_s_compiler_prints() {
    let board = board();
    let lists = Lists::new(board.limits());
    for (rows, channels, bits, words) in CONVOLUTIONS {
        assert_eq!(rows * lists.of_row(channels, bits), words, "{rows} rows of {channels} channels");
    }
    for (axons, targets, bits, words) in DENSE {
        assert_eq!(axons * lists.of_axon(targets, bits), words, "{axons} axons of {targets} targets");
    }
    assert!(DENSE[0].3 > u64::from(board.limits()[Resource::SynapseWords]));
}

/// A weight of this many bits, of both signs; each range is used to its end.
fn weight(bits: u32, at: u64) -> i16 {
    let half = 1i64 << (bits - 1);
    let drawn = rng::below(2 * half as u64, 5, bits.into(), at) as i64 - half;
    2 * if at == 0 { -half } else { drawn } as i16
}

fn layers(sizes: &[u32], bits: u32) -> Quantised {
    let mut net = Builder::new();
    let mut source = net.input("in", sizes[0]);
    for (number, &size) in sizes[1..].iter().enumerate() {
        let layer = net.loihi(&format!("h{number}"), size);
        net.dense(source, layer, |s, t| weight(bits, u64::from(s * size + t)));
        source = layer;
    }
    net.build()
}

/// Axons in, synapses, neurons, axon map and all words of a core.
fn words(used: &CoreUsage, limits: &Limits) -> [u64; 5] {
    let of = [Resource::AxonsIn, Resource::SynapseWords, Resource::NeuronWords, Resource::AxonMapWords];
    let [a, b, c, d] = of.map(|resource| used[resource]);
    [a, b, c, d, limits.pools[0].need(&used.of)]
}

#[test]
fn stated_cores_have_the_totals_that_intel_s_compiler_prints() {
    let (board, network) = (board(), layers(&[784, 128, 64, 10], 8));
    let stated = |stated: &[(&str, u32)]| {
        let stated: Vec<(String, u32)> = stated.iter().map(|&(name, each)| (name.to_string(), each)).collect();
        Front::from(network.clone()).with_cores_of(&stated).and_then(|front| mapped(front, &board))
    };
    let found = stated(&[("h0", 50), ("h1", 64), ("h2", 10)]).unwrap();
    let sizes: Vec<usize> = found.partition.members().iter().map(|held| held.len()).collect();
    assert_eq!(sizes, [50, 50, 28, 64, 10]);
    let of = |core: u32| words(&found.partition.usage()[CoreId(core)], board.limits());
    assert_eq!(of(0), [784, 12_544, 50, 50, 13_429]);
    assert_eq!((of(3), of(4)), ([128, 2_688, 64, 64, 2_945], [64, 256, 10, 10, 341]));
    // Populations that are not stated have cores of their own, as few as nsim finds.
    assert_eq!(stated(&[("h0", 50)]).unwrap().partition.cores(), 4);
    assert!(mapped(network.clone(), &board).unwrap().partition.cores() <= 5);
    let Err(CompileError::DoesNotFit(reasons)) = stated(&[("h0", 128)]) else { panic!("128 fit") };
    assert!(reasons[0].core == Some(CoreId(0)) && reasons[0].resource == Resource::SynapseWords, "{}", reasons[0]);
    for (wrong, what) in [(&[("in", 5)][..], "no population"), (&[("h1", 5), ("h1", 6)], "named twice")] {
        let error = stated(wrong).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
}

/// Layers over space of PilotNet: shape, stride and padding of the incoming convolution.
type Spatial = ((u32, u32, u32), (u32, u32), (u32, u32));
const SPATIAL: [Spatial; 6] = [
    ((3, 66, 200), (1, 1), (0, 0)),
    ((24, 32, 99), (2, 2), (0, 0)),
    ((36, 15, 49), (2, 2), (0, 0)),
    ((48, 7, 24), (2, 2), (0, 0)),
    ((64, 4, 22), (2, 1), (1, 0)),
    ((64, 2, 20), (1, 1), (0, 0)),
];

/// PilotNet of five convolutions; bits of the weights by layer.
fn pilotnet(bits: [u32; 10]) -> Quantised {
    let mut net = Builder::new();
    let volume = |(c, h, w)| Shape::Volume(c, h, w);
    let mut source = (SPATIAL[0].0, net.input_shape("frame", volume(SPATIAL[0].0)));
    for (number, &(target, stride, padding)) in SPATIAL.iter().enumerate() {
        let layer = net.loihi_with(&format!("layer{number}"), volume(target), neurons());
        // The first layer receives one channel each; the others a convolution of 3 by 3.
        let (kernel, groups) = if number == 0 { ((1, 1), 3) } else { ((3, 3), 1) };
        let window = Window { source: source.0, target, kernel, stride, padding, dilation: (1, 1), groups };
        let weights = u64::from(target.0 * source.0.0 / groups * kernel.0 * kernel.1);
        let kernel = (0..weights).map(|at| weight(bits[number], at)).collect();
        net.connect(source.1, layer, plain_format(), 0, Connectivity::Conv2d { window, kernel });
        source = (target, layer);
    }
    let mut source = source.1;
    for (units, bits) in [100, 50, 10, 1].into_iter().zip(&bits[6..]) {
        let layer = net.loihi(&format!("dense{units}"), units);
        net.dense(source, layer, |s, t| weight(*bits, u64::from(s * units + t)));
        source = layer;
    }
    net.build()
}

/// nsim cuts anywhere, Intel's compiler into stripes, so nsim takes no more cores than the printed
/// 74 (LIF) and 61 (sigma-delta). Boxes are counted in closed form, and the checker counts again.
#[test]
fn pilotnet_takes_no_more_cores_than_by_intel_s_compiler() {
    let board = board();
    for (bits, printed) in [([8; 10], 74), ([8, 6, 5, 4, 5, 4, 4, 6, 5, 4], 61)] {
        let network = pilotnet(bits);
        for front in [Front::from(network.clone()), Front::from(network.clone()).cut()] {
            let found = mapped(front, &board).unwrap();
            assert!(found.partition.cores() <= printed, "{} cores, {printed} printed", found.partition.cores());
            assert!(found.partition.members().iter().all(|held| held.len() <= 4_096));
        }
    }
    // Every core of a stated layer has its whole kernel, and tiles have a channel's positions.
    let stated = [("layer1".to_string(), 3_072), ("layer4".to_string(), 2_048)];
    let found = mapped(Front::from(pilotnet([8; 10])).with_cores_of(&stated).unwrap(), &board).unwrap();
    let (used, held) = (found.partition.usage(), found.partition.members());
    let of = |core: u32| (held[CoreId(core)].len(), words(&used[CoreId(core)], board.limits()));
    let (first, [_, synapses, neurons, map, _]) = of(0);
    assert_eq!((first, synapses, neurons, map), (3_072, 27 * 5, 3_072, 128));
    let layer4 = (0..held.len() as u32).find(|&core| of(core).0 == 2_048).unwrap();
    assert_eq!(of(layer4).1[1..4], [432 * 9, 2_048, 32]);
}

#[test]
fn words_are_counted_again_by_the_checker_and_differ_where_the_program_does() {
    let board = board();
    let mut limits = board.limits().clone();
    (limits[Resource::CompartmentProfiles], limits[Resource::ThresholdProfiles]) = (1 << 10, 1 << 10);
    let tight = limits.clone().with(Resource::SynapseFormats, 64).with(Resource::NeuronWords, 40);
    let tight = board.clone().with_limits(tight);
    let mut checked = 0;
    for seed in 0..80 {
        // Mapping compares both counts.
        checked += mapped(random_network(seed), &tight).map_or(0, |found| found.partition.cores());
    }
    assert!(checked > 80, "{checked}");
    let network = layers(&[20, 4_097], 8);
    let found = mapped(network.clone(), &board).unwrap();
    assert!(found.partition.cores() >= 2);
    let used = memory::used(&found.program, &network, &board).unwrap();
    assert_eq!(confirm(&found.partition, &used), Ok(()));
    for resource in [Resource::NeuronWords, Resource::SynapseWords, Resource::AxonsIn, Resource::AxonMapWords] {
        let most = used.iter().map(|used| used[resource]).max().unwrap();
        let less = board.clone().with_limits(board.limits().clone().with(resource, most as u32 - 1));
        let refused = memory::used(&found.program, &network, &less).unwrap_err();
        assert!(matches!(&refused, Violation::Excess { capacity, .. } if *capacity == resource), "{refused}");
        // A compiler that counts one word too many or too few is found.
        for (more, less) in [(1, 0), (0, 1)] {
            let mut wrong = found.partition.usage().clone();
            wrong[CoreId(0)][resource] = wrong[CoreId(0)][resource] + more - less;
            let partition =
                Partition::new(network.compartments(), found.partition.to_members(), wrong, &found_limits(&board));
            assert!(confirm(&partition.unwrap(), &used).is_err(), "{resource:?}");
        }
    }
    let mut groups = Builder::new();
    let source = groups.input("in", 3);
    let names: Vec<PopulationId> = (0..9).map(|number| groups.loihi(&format!("p{number}"), 2)).collect();
    names.into_iter().for_each(|layer| groups.dense(source, layer, |_, _| 2));
    assert_eq!(mapped(groups.build(), &board).unwrap().partition.cores(), 2);
}

/// The board's limits, with room for a word more.
fn found_limits(board: &Target) -> Limits {
    let mut limits = board.limits().clone();
    (limits[Resource::NeuronWords], limits[Resource::AxonMapWords]) = (5_000, 20_000);
    limits[Resource::SynapseWords] = 20_000;
    limits.pools.clear();
    limits
}

/// A million compartments are refused by their sizes; a search would take far longer than the test.
#[test]
fn a_network_that_cannot_fit_is_refused_by_its_sizes() {
    let loihi1 = nsim_files::target::load_target("loihi1-chip").unwrap();
    let mut net = Builder::new();
    let shape = (2, 516, 520);
    let mut source = net.input_shape("in", Shape::Volume(2, 516, 520));
    for name in ["a", "b"] {
        let layer = net.loihi_with(name, Shape::Volume(2, 516, 520), neurons());
        let (kernel, stride, dilation, padding) = ((1, 1), (1, 1), (1, 1), (0, 0));
        let window = Window { source: shape, target: shape, kernel, stride, padding, dilation, groups: 1 };
        net.connect(source, layer, plain_format(), 0, Connectivity::Conv2d { window, kernel: vec![2; 4].into() });
        source = layer;
    }
    let network = net.build();
    for board in [board(), loihi1] {
        let Err(CompileError::DoesNotFit(reasons)) = mapped(network.clone(), &board) else { panic!("it fits") };
        assert_eq!((reasons.len(), reasons[0].need), (1, 1_073_280), "{}", reasons[0]);
    }
}
