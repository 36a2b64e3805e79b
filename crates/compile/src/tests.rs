//! The compiler as a whole: networks that fit, networks that do not, and the reasons.
//! `tests/engines/mutations` shows that wrong programs are detected.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use crate::emit::route::route;
use crate::emit::testing::proved;
use crate::{
    CompileError, CopyPlacement, DEFAULT_RATE, Effort, Front, Mapping, Options, Reason, compile, explore, place,
};
use nsim_check::equivalence::check_copies;
use nsim_check::verify::{self, Violation, verify};
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{CompartmentId, CoreId, IdVec, PopulationId, ProjectionId};
use nsim_ir::base::rng;
use nsim_ir::firing_rates::Rates;
use nsim_ir::graph::{Shape, Window};
use nsim_ir::learning::{self, Change, LearningSemantics, Rule, RuleText};
use nsim_ir::partition::{CoreUsage, Partition, seats};
use nsim_ir::program::Program;
use nsim_ir::quantised::connectivity::Connectivity;
use nsim_ir::quantised::{Parts, Projection, Quantised};
use nsim_ir::resource::{Limits, OutputAxons, Packing, PerResource, Pool, Resource};
use nsim_partition::options::Strategy;
use nsim_partition::resources::exact::usage;
use nsim_partition::resources::fan_in::FanIn;
use nsim_partition::resources::incremental::{Filling, Newcomer};
use nsim_partition::strategy::tiles;
use nsim_testing::{
    Builder, cases, limits, make_plastic, neurons, plain_format, random_network, slip, sparse, target, with_rules,
    without_classes,
};

fn compiled(network: Quantised, limits: Limits) -> Mapping {
    compile(network, &target(2, 2, limits), &Options::default()).unwrap()
}

fn reasons(network: Quantised, chips: u32, limits: Limits, copies: u32) -> Vec<Reason> {
    let options = Options { copies, ..Options::default() };
    match compile(network, &target(chips, 1, limits), &options) {
        Err(CompileError::DoesNotFit(reasons)) => reasons,
        other => panic!("{:?}", other.map(|c| c.partition.cores())),
    }
}

/// A window that moves by one and stays within its source.
fn window(source: (u32, u32, u32), target: (u32, u32, u32), kernel: (u32, u32)) -> Window {
    Window { source, target, kernel, stride: (1, 1), padding: (0, 0), dilation: (1, 1), groups: 1 }
}

#[test]
fn sources_are_gathered_in_population_axons_where_input_axons_are_too_few() {
    let mapped = |axons_in, channels| {
        let board = target(1, 1, limits().with(Resource::AxonsIn, axons_in));
        let front = Front::from(slip(channels)).relay(&board)?;
        let options = Options::default();
        explore::map(front, &board, &options, &Rates::assumed(DEFAULT_RATE))
    };
    // 6,300 lists of two words; the channels of a core's 10 compartments are 13 population axons.
    let both = mapped(4_096, 6_300).unwrap();
    assert_eq!(both.shifts, 0);
    let used: Vec<_> = both.partition.usage().iter().map(|used| used[Resource::AxonsIn]).collect();
    assert!(used.iter().sum::<u64>() < 400, "{used:?}");
    // Hidden compartments, of which there are 60, are grouped too.
    let all = mapped(40, 3_150).unwrap();
    assert!(all.partition.usage().iter().all(|used| used[Resource::AxonsIn] <= 40));
    // Words do not suffice.
    assert!(matches!(mapped(4_096, 20_000), Err(CompileError::DoesNotFit(_))));
}

#[test]
fn copies_keep_to_their_own_cores_unless_sharing_takes_fewer() {
    let options = Options { copies: 32, placement: CopyPlacement::Packed, ..Options::default() };
    let board = target(2, 2, limits());
    let compiled = compile(slip(3150), &board, &options).unwrap();
    assert_eq!(compiled.partition.cores(), 32);
    let traffic = explore::traffic::of_program(&compiled.program, &Rates::assumed(1.0)).traffic();
    assert_eq!(traffic.cut_spikes_per_step, 32.0 * 3_306.0, "only inputs cross between cores");
    let small = compile(slip(100), &board, &options).unwrap();
    // 316 input axons and 62 compartments a copy: twelve copies share a core.
    assert_eq!(small.partition.cores(), 3);
}

#[test]
fn resources_that_share_a_pool_are_kept_within_it() {
    let costs: BTreeMap<_, _> = [(Resource::SynapseWords, 8), (Resource::AxonsIn, 4)].into();
    let (name, unit) = ("memory".to_string(), "bytes".to_string());
    let pooled = |limit| {
        let pool = Pool { name: name.clone(), unit: unit.clone(), limit, costs: costs.clone() };
        Limits { pools: vec![Arc::new(pool)], ..limits() }
    };
    let network = || {
        let mut builder = Builder::new();
        let (a, b) = (builder.input("a", 100), builder.loihi("b", 80));
        builder.random(a, b, 40, 1);
        builder.build()
    };
    let (own, shared) = (compiled(network(), limits()), compiled(network(), pooled(6_000)));
    assert_eq!(own.partition.cores(), 1);
    assert!(shared.partition.cores() > 1);
    for used in shared.partition.usage() {
        assert!(8 * used[Resource::SynapseWords] + 4 * used[Resource::AxonsIn] <= 6_000, "{used:?}");
    }
    let excess = verify(&own.program, &target(2, 2, pooled(6_000))).unwrap_err();
    assert!(matches!(&excess, Violation::Excess { capacity, .. } if capacity.name() == "memory"), "{excess}");
    let reasons = reasons(network(), 1, pooled(100), 1);
    assert_eq!((reasons[0].code, reasons[0].limit, reasons[0].population.as_deref()), ("map.pool", 100, Some("b")));
    assert!(reasons[0].to_string().contains("bytes of the memory of its core, the limit is 100"), "{}", reasons[0]);
}

#[test]
fn a_kernel_is_stored_once_on_each_core_and_weights_of_zero_are_not() {
    let mut net = Builder::new();
    let image = net.input_shape("image", Shape::Volume(2, 9, 9));
    let layer = net.loihi_with("layer", Shape::Volume(4, 9, 9), neurons());
    let out = net.loihi("out", 3);
    let window = Window { padding: (1, 1), ..window((2, 9, 9), (4, 9, 9), (3, 3)) };
    // Of the 18 weights of a channel every fourth is 0.
    let kernel = (0..72).map(|k| if k % 4 == 0 { 0 } else { 2 * (k % 50) + 2 }).collect();
    net.connect(image, layer, plain_format(), 0, Connectivity::Conv2d { window, kernel });
    net.dense(layer, out, |s, t| if (s + t) % 3 == 0 { 0 } else { 2 });
    let limits = limits().with(Resource::StoredSynapses, 500);
    let compiled = compiled(net.build(), limits.clone());
    let used = verify::used(&compiled.program, &target(2, 2, limits)).unwrap();
    let stored = |used: &CoreUsage| used[Resource::StoredSynapses];
    // 4 channels of 18 weights less 18; 324 sources, of which two thirds have a weight.
    let all: Vec<u64> = used.iter().map(stored).collect();
    assert_eq!(all, compiled.partition.usage().iter().map(stored).collect::<Vec<u64>>());
    let (kernels, dense) = (54, 216);
    let has_kernels = |n: u64| n % dense == kernels;
    assert!(all.iter().all(|&n| has_kernels(n) || n % dense == 0), "{all:?}");
    assert!(all.iter().any(|&n| has_kernels(n)) && all.iter().sum::<u64>() % dense % kernels == 0, "{all:?}");
}

/// Random limits, small enough to split and large enough to be met.
fn drawn_limits(seed: u64) -> Limits {
    let draw = |k, low: u64, high: u64| (low + rng::below(high - low + 1, seed, 99, k)) as u32;
    let of = |resource| match resource {
        Resource::Compartments => draw(0, 1, 40),
        Resource::AxonsIn => draw(1, 60, 200),
        Resource::AxonsOut => draw(2, 150, 800),
        Resource::AxonsOutPerCompartment => draw(3, 100, 200),
        Resource::SynapseWords => draw(4, 150, 800),
        Resource::SynapseWordsPerAxon => draw(5, 12, 40),
        Resource::SynapseFormats => draw(6, 12, 16),
        Resource::CompartmentProfiles => draw(7, 1, 4),
        Resource::ThresholdProfiles => draw(8, 1, 2),
        Resource::Accumulators => draw(9, 8, 100),
        Resource::StoredSynapses if seed.is_multiple_of(2) => draw(11, 150, 800),
        Resource::NeuronWords if seed.is_multiple_of(3) => draw(12, 20, 60),
        Resource::AxonMapWords if seed.is_multiple_of(3) => draw(13, 20, 60),
        Resource::Groups if seed.is_multiple_of(3) => draw(14, 1, 4),
        Resource::RuleWords => draw(15, 3, 8),
        Resource::TraceConfigurations => draw(16, 2, 3),
        Resource::StoredSynapses | Resource::NeuronWords | Resource::AxonMapWords | Resource::Groups => u32::MAX,
    };
    let packing = match draw(10, 0, 2) {
        0 => Packing::Nengo,
        1 => Packing::Nxtf,
        _ => Packing::Kernels { synapse_bits: 12, list_bits: 8 },
    };
    Limits { most: PerResource::from_fn(of), packing, ..limits() }
}

#[test]
fn every_limit_is_kept_on_hundreds_of_random_networks() {
    let (mut fitted, mut split, mut refused, mut learning) = (0, 0, 0, 0);
    let networks = cases(500);
    for seed in 0..networks {
        let limits = drawn_limits(seed);
        // Searching for places takes most of the time and changes no limit but slots off chip.
        let place = seed.is_multiple_of(5);
        let options = Options { copies: 1 + (seed % 3) as u32, place, ..Options::default() };
        // Compiling verifies the tables against the limits and checks them against the network.
        let network = random_network(seed);
        let network = if seed.is_multiple_of(4) { with_rules(network, seed) } else { network };
        match compile(network, &target(2, 2, limits.clone()), &options) {
            Ok(compiled) => {
                fitted += 1;
                learning += u64::from(!compiled.quantised.parts().rules.is_empty());
                split += u64::from(compiled.partition.cores() > 1);
                for (core, used) in compiled.partition.usage().enumerate() {
                    assert_eq!(used.excesses(&limits).next(), None, "seed {seed} {core}");
                }
            }
            Err(CompileError::DoesNotFit(reasons)) => {
                refused += 1;
                assert!(!reasons.is_empty() && reasons.iter().all(|r| r.need > r.limit), "seed {seed}: {reasons:?}");
            }
            Err(other) => panic!("seed {seed}: {other}"),
        }
    }
    assert!(fitted > networks * 3 / 5 && split > networks / 2, "{fitted} fitted, {split} split, {refused} did not fit");
    assert!(learning > networks / 10, "{learning} of them learn");
}

#[test]
fn a_random_network_of_6_4_million_synapses_keeps_every_limit_of_768_chips() {
    let mut builder = Builder::new();
    let (input, all) = (builder.input("in", 100), builder.loihi("all", 100_000));
    builder.random(input, all, 8, 1);
    builder.random(all, all, 64, 2);
    let board = nsim_files::target::load_target("pohoiki-springs").unwrap();
    assert_eq!((board.limits()[Resource::AxonsIn], board.limits()[Resource::AxonsOut]), (4096, 4096));
    let options = Options { place: false, effort: Effort::Work(0), ..Options::default() };
    let compiled = compile(builder.build(), &board, &options).unwrap();
    let most = compiled.partition.usage().iter().map(|used| used[Resource::AxonsOut]).max().unwrap();
    let cores = compiled.partition.cores();
    println!("{cores} cores, {:?}", compiled.seconds);
    // 64 targets on nearly 64 cores, most of them off chip: 4,096 / 128 compartments a core at
    // worst.
    assert!(most <= 4096 && cores <= 3_125, "{cores} cores, {most} slots");
}

/// A convolution of 16 x 14 positions, 8 channels to 8 in a kernel of 3 x 3, and a layer that pools
/// it by 2 x 2.
fn layers() -> Quantised {
    let mut net = Builder::new();
    let of = |channels, height, width| Shape::Volume(channels, height, width);
    let input = net.input_shape("in", of(8, 16, 14));
    let wide = net.loihi_with("wide", of(8, 16, 14), neurons());
    let pooled = net.loihi_with("pooled", of(8, 8, 7), neurons());
    let kernel = (0..8 * 8 * 9).map(|i| (i * 37 % 128) * 2 - 128).collect();
    let once = Window { padding: (1, 1), ..window((8, 16, 14), (8, 16, 14), (3, 3)) };
    net.connect(input, wide, plain_format(), 0, Connectivity::Conv2d { window: once, kernel });
    let halved = Window { stride: (2, 2), ..window((8, 16, 14), (8, 8, 7), (2, 2)) };
    net.connect(wide, pooled, plain_format(), 1, Connectivity::SumPool2d { window: halved, weight: 60 });
    net.build()
}

/// A layer over space whose compartments also reach themselves, as with a reset by subtraction.
/// Synapses with equal weights are stored once for all sources, which decides the number of output
/// axons of a message.
#[test]
fn compartments_over_space_that_reach_themselves_fit_or_do_not() {
    let network = layers();
    let (wide, parts) = (PopulationId(1), network.parts().clone());
    let itself = Projection {
        source: wide,
        target: wide,
        connectivity: sparse((0..8 * 16 * 14).map(|k| vec![(k, -256)])),
        ..parts.projections[ProjectionId(0)].clone()
    };
    let projections = parts.projections.iter().cloned().chain([itself]).collect();
    let network = Quantised::new(Parts { projections, ..parts }).unwrap();
    let mut outcomes = [0, 0];
    for axons in (220..400).step_by(40) {
        let limits = limits().with(Resource::AxonsOut, axons).with(Resource::Compartments, 300);
        match compile(network.clone(), &target(2, 2, limits), &Options::default()) {
            Ok(_) => outcomes[0] += 1,
            Err(CompileError::DoesNotFit(_)) => outcomes[1] += 1,
            Err(error) => panic!("{axons} output axons: {error}"),
        }
    }
    assert!(outcomes[0] > 0, "{outcomes:?}");
}

#[test]
fn a_kernel_is_stored_once() {
    for packing in [Packing::Nengo, Packing::Nxtf] {
        // 7 x 8 positions with their 8 channels are a core: its kernel has 576 weights, its lists 8
        // x 3,380 synapses.
        let limits = Limits { packing, ..limits().with(Resource::Compartments, 512) };
        let compiled = compiled(layers(), limits.clone());
        for core in compiled.program.cores().ids() {
            let class = compiled.program.class_of(core);
            let used = &compiled.partition.usage()[core];
            assert!(!class.inputs.populations.is_empty(), "{packing:?} {core}");
            let stored = class.inputs.lists.items().len() as u64;
            assert!(stored * 3 < class.inputs.count(), "{packing:?} {core}: {stored} of {}", class.inputs.count());
            let axons = used[Resource::AxonsIn];
            assert!(axons * 4 < class.inputs.len() as u64, "{packing:?} {core}: {axons}");
        }
        proved(&compiled, &limits, &format!("{packing:?}"));
    }
}

/// In the order of the file a 5 x 5 convolution takes 32 cores, since none holds the kernels of
/// many channels. Tiles take 9 cores, the busiest of which works five times as long. Injecting
/// 6,400 channels takes most of a step in any case.
#[test]
fn cores_are_saved_where_most_of_a_step_is_not_theirs() {
    let mut net = Builder::new();
    let size = (16, 20, 20);
    let (image, layer) = (Shape::Volume(16, 20, 20), Shape::Volume(16, 20, 20));
    let (image, layer) = (net.input_shape("image", image), net.loihi_with("layer", layer, neurons()));
    let window = Window { padding: (2, 2), ..window(size, size, (5, 5)) };
    let kernel = (0..16 * 16 * 25).map(|k: i32| (k * 37 % 127 - 63) as i16 * 2).collect();
    net.connect(image, layer, plain_format(), 0, Connectivity::Conv2d { window, kernel });
    let network = net.build();
    let cores = |strategy| {
        let options = Options { strategy, ..Options::default() };
        compile(network.clone(), &target(2, 2, limits()), &options).unwrap().partition.cores()
    };
    assert_eq!((cores(Strategy::Sequential), cores(Strategy::Multilevel)), (32, 9));
}

#[test]
fn output_axons_are_counted_by_position_and_the_verifier_counts_the_same() {
    // 16 x 14 positions of 8 channels, which are pooled 2 x 2 channel by channel: the channels of a
    // position go to one core.
    let roomy = limits().with(Resource::Compartments, 512);
    let apart = Limits { output_axons: OutputAxons::PerCompartment, ..roomy.clone() };
    let slots = |of: &Mapping| -> u64 { of.partition.usage().iter().map(|used| used[Resource::AxonsOut]).sum() };
    let (together, alone) = (compiled(layers(), roomy.clone()), compiled(layers(), apart));
    assert!(slots(&together) * 3 < slots(&alone), "{} and {}", slots(&together), slots(&alone));
    for limits in [roomy, Limits { output_axons: OutputAxons::PerPosition { atoms: 4, more_slots: 3 }, ..limits() }] {
        for network in (0..30).map(random_network).chain([layers()]) {
            let Ok(found) = compile(network, &target(2, 2, limits.clone()), &Options::default()) else { continue };
            let most = found.partition.usage().iter().map(|used| used[Resource::AxonsOut]).max().unwrap_or(0) as u32;
            let at = |most: u32| verify(&found.program, &target(2, 2, limits.clone().with(Resource::AxonsOut, most)));
            assert_eq!(at(most), Ok(()));
            assert!(
                most == 0 || matches!(at(most - 1), Err(Violation::Excess { need, .. }) if need == u64::from(most))
            );
        }
    }
}

#[test]
fn more_sources_than_a_program_can_number_take_several_cores() {
    // 128 channels at 20 x 33 positions are 84,480 sources of 18 x 31 compartments, which would fit
    // one core but for the number of sources.
    let mut builder = Builder::new();
    let input = builder.input_shape("in", Shape::Volume(128, 20, 33));
    let out = builder.loihi_with("out", Shape::Volume(1, 18, 31), neurons());
    let window = window((128, 20, 33), (1, 18, 31), (3, 3));
    let kernel = (0..128 * 9).map(|k| (k % 50) as i16 * 2 - 40).collect();
    builder.connect(input, out, plain_format(), 0, Connectivity::Conv2d { window, kernel });
    let compiled = compiled(builder.build(), limits());
    let most = compiled.program.classes().iter().map(|class| class.inputs.len()).max();
    assert!(compiled.partition.cores() > 1 && most.is_some_and(|most| most <= 1 << 16), "{most:?}");
}

#[test]
fn tiles_fill_cores_that_hold_them_only_with_shared_lists() {
    let roomy = limits().with(Resource::Compartments, 512);
    let most = |of: &Mapping| of.partition.usage().iter().map(|used| used[Resource::SynapseWords]).max().unwrap();
    let found = compiled(layers(), roomy.clone());
    let tight = roomy.clone().with(Resource::SynapseWords, most(&found) as u32);
    let same = compiled(layers(), tight.clone());
    assert_eq!((same.partition.cores(), most(&same)), (found.partition.cores(), most(&found)));
    // With a list for each source the words of a core suffice for a fraction of its compartments.
    let (network, mut alone) = (layers(), 0);
    let fan_in = FanIn::new(&network);
    let mut filling = Filling::new(&network, &fan_in, &tight);
    for &id in same.partition.members()[CoreId(0)].iter() {
        if filling.add(&Newcomer::new(&network, id).unwrap()).is_err() {
            break;
        }
        alone += 1;
    }
    assert!(alone * 2 < same.partition.members()[CoreId(0)].len(), "{alone}");
}

#[test]
fn as_many_weights_are_stored_as_nengo_loihi_stores() {
    // (source, filters, kernel, step), then lists, weights in them and axons of nengo-loihi 1.1's
    // `conv2d_loihi_weights` for the convolution without padding, channels last, on one core.
    type Layer = ((u32, u32, u32), u32, (u32, u32), (u32, u32));
    let layers: [(Layer, [usize; 3]); 5] = [
        (((4, 10, 9), 8, (3, 3), (1, 1)), [30, 3_456, 90]),
        (((2, 16, 14), 4, (3, 2), (1, 1)), [21, 480, 224]),
        (((3, 17, 15), 8, (3, 3), (2, 2)), [24, 960, 255]),
        (((8, 14, 14), 4, (5, 5), (1, 1)), [82, 20_640, 196]),
        (((2, 18, 18), 4, (3, 3), (1, 1)), [40, 1_296, 324]),
    ];
    for ((source, filters, kernel, stride), theirs) in layers {
        let size = |source: u32, kernel: u32, stride: u32| (source - kernel) / stride + 1;
        let target = (filters, size(source.1, kernel.0, stride.0), size(source.2, kernel.1, stride.1));
        let mut net = Builder::new();
        let input = net.input_shape("in", Shape::Volume(source.0, source.1, source.2));
        let out = net.loihi_with("out", Shape::Volume(target.0, target.1, target.2), neurons());
        let window = Window { stride, ..window(source, target, kernel) };
        let weights = i64::from(source.0 * filters * kernel.0 * kernel.1);
        let kernel = (0..weights).map(|i| ((i * 37 + i / 128) % 128 * 2) as i16 - 128).collect();
        net.connect(input, out, plain_format(), 0, Connectivity::Conv2d { window, kernel });
        // Position by position, channels last, as in a tile; lists have equal lengths in and
        // outside of tables.
        let (network, board) = (net.build(), nsim_testing::target(1, 1, limits()));
        let order = tiles::cell(target, target, (0, 0, 0), false);
        let members = IdVec::from(vec![order.into_iter().map(CompartmentId).collect::<Vec<_>>()]);
        let seats = seats(network.compartments(), &members).unwrap();
        let used = usage(&network, &members, &seats, &vec![0].into(), board.limits());
        let partition = Partition::new(network.compartments(), members, used, board.limits()).unwrap();
        let program =
            route(&network, &partition, (&place::sequential(1, &board).unwrap(), None), 1, board.limits()).unwrap();
        check_copies(&network, &program, 1).unwrap();
        verify(&program, &board).unwrap();
        let [class] = program.classes().as_slice() else { unreachable!() };
        let tables: BTreeSet<u32> = class.inputs.populations.iter().map(|axon| axon.table).collect();
        let stored = class.inputs.lists.items().len();
        assert_eq!([tables.len(), stored, class.inputs.populations.len()], theirs, "{source:?}");
        assert_eq!(class.inputs.iter_discrete().count(), 0);
    }
}

#[test]
fn no_network_that_fits_is_refused_and_bounds_are_near_what_is_needed() {
    let mut refused = 0;
    let cases = [(600, 20, 200, 1), (600, 20, 60, 1), (2_000, 8, 64, 1), (4_400, 500, 520, 32), (4_400, 500, 4_096, 1)];
    for (size, fan_out, axons, chips) in cases {
        let mut builder = Builder::new();
        let (input, all) = (builder.input("in", 4), builder.loihi("all", size));
        builder.random(input, all, 10, 1);
        builder.random(all, all, fan_out, 2);
        let network = builder.build();
        for axons_out in [4_096, 1_024] {
            let limits = limits().with(Resource::AxonsIn, axons).with(Resource::AxonsOut, axons_out);
            let board = target(chips, 1, Limits { axon_out_slots_off_chip: 1, ..limits });
            let found = nsim_partition::resources::even_draws::reasons(&network, &board, 1, false);
            match compile(network.clone(), &board, &Options { effort: Effort::Work(0), ..Options::default() }) {
                Ok(_) => assert!(found.is_empty(), "{found:?}"),
                Err(CompileError::DoesNotFit(_)) => refused += usize::from(!found.is_empty()),
                Err(other) => panic!("{other}"),
            }
        }
    }
    // 4,400 compartments take a core each, of 4,096.
    assert!(refused > 1, "{refused}");
}

/// A rule that no kind of mutation in `tests/engines/mutations` breaks.
#[test]
fn scattered_synapses_are_found() {
    let mut builder = Builder::new();
    let (x, y) = (builder.input("x", 6), builder.input("y", 5));
    let (a, b) = (builder.loihi("a", 8), builder.loihi("b", 3));
    builder.dense(x, a, |s, t| (s * 8 + t) as i16 * 2 - 60);
    builder.dense(a, b, |s, t| (s * 3 + t) as i16 * 2 - 30);
    builder.random(b, a, 3, 5);
    let weights = (0..15i16).map(|w| w * 2 - 14).collect();
    let format = nsim_testing::format(1, SignMode::Mixed, 8);
    builder.connect(y, b, format, 2, Connectivity::Dense { targets: 3, weights });
    let limits = limits().with(Resource::Compartments, 4);
    let good = compiled(builder.build(), limits.clone());
    assert_eq!(verify(&good.program, &target(2, 2, limits.clone())), Ok(()));
    // Core 0 holds a's first half: its first list is of channel 0, dense over slots 0 to 3.
    let mut parts = good.program.parts().clone();
    let class = parts.class_mut(CoreId(0));
    let other = nsim_ir::program::CoreFormat { index_bits: Some(6), ..class.formats[0] };
    class.inputs.lists.items_mut()[1].format = class.formats.len() as u8;
    class.formats.push(other);
    let scattered = verify(&Program::new(parts).unwrap(), &target(2, 2, limits.clone())).unwrap_err();
    assert!(matches!(scattered, Violation::Scattered { list: 0, .. }), "{scattered}");
}

#[test]
fn copies_are_written_as_each_by_itself_and_proven_from_one_of_each_kind() {
    let (mut proven, mut sharing) = (0, 0);
    for seed in 0..24 {
        let copies = [2, 7, 31][seed as usize % 3];
        let most = 20 + seed as u32 % 60;
        let board = target(3, 3, limits().with(Resource::Compartments, most));
        let options = Options { copies, ..Options::default() };
        let Ok(mapped) = compile(random_network(seed), &board, &options) else { continue };
        let (network, limits) = (&mapped.quantised, board.limits());
        let alone = route(network, &mapped.partition, (&mapped.placement, None), 1, limits).unwrap();
        assert_eq!(without_classes(&mapped.program), without_classes(&alone), "seed {seed}");
        let alone = Program::new(without_classes(&alone)).unwrap();
        assert_eq!(check_copies(network, &alone, copies), Ok(0), "seed {seed}: cores without a class prove nothing");
        proven += check_copies(network, &mapped.program, copies).unwrap();
        let cores = mapped.program.cores();
        let lists: BTreeSet<_> = cores.iter().map(|image| Arc::as_ptr(image.axons_out.lists())).collect();
        sharing += cores.len() - lists.len();
    }
    assert!(proven > 60, "{proven} cores were proven from others");
    assert!(sharing > 60, "{sharing} cores share the messages of others");
}

#[test]
fn what_learns_takes_bits_of_tags_and_delays_a_second_input_axon_microcode_and_traces() {
    let network = |rule: Option<[&str; 3]>, semantics, targets| {
        let mut builder = Builder::new();
        let (a, b) = (builder.input("a", 64), builder.loihi("b", targets));
        builder.dense(a, b, |s, t| (s + t) as i16 % 100 * 2 - 60);
        let mut parts = builder.build().parts().clone();
        if let Some(rule) = rule {
            let changes =
                rule.map(|text| if text.is_empty() { Change::default() } else { learning::parse(text).unwrap() });
            let rule = Rule::new(RuleText { changes, epoch: 1, semantics, ..RuleText::default() }).unwrap();
            make_plastic(&mut parts, ProjectionId(0), rule);
        }
        Quantised::new(parts).unwrap()
    };
    let resources = [
        Resource::AxonsIn,
        Resource::SynapseWords,
        Resource::Accumulators,
        Resource::RuleWords,
        Resource::TraceConfigurations,
    ];
    let (silicon, lava) = (LearningSemantics::Silicon, LearningSemantics::Lava);
    // A list of 8 synapses takes 10 bits and 8 times 8 of weights, 9 of tags, 6 of delays. x1 and
    // x2 have one configuration.
    for (rule, semantics, expected) in [
        (None, silicon, [64, 64 * 2, 8, 0, 0]),
        (Some(["2^-2*x1*y0", "", ""]), silicon, [128, 64 * 2, 8, 1, 1]),
        (Some(["2^-2*x1*y0", "", "x0*y1"]), silicon, [128, 64 * 3, 8, 1, 1]),
        (Some(["u0*t", "", ""]), silicon, [128, 64 * 3, 8, 1, 0]),
        (Some(["", "x0*y1", ""]), silicon, [128, 64 * 2, 512, 1, 0]),
        (Some(["", "x0*y1", "y0*x1"]), silicon, [128, 64 * 4, 512, 1, 1]),
        (Some(["u0*x1*y1 + x0*x2", "", ""]), silicon, [128, 64 * 2, 8, 2, 1]),
        (Some(["u0*d*t", "", ""]), silicon, [128, 64 * 3, 8, 1, 0]),
        (Some(["u0*d*t", "", ""]), lava, [128, 64 * 4, 8, 1, 0]),
        (Some(["", "x0*y1", ""]), lava, [128, 64 * 2, 8, 1, 0]),
    ] {
        let mapped = compiled(network(rule, semantics, 8), limits());
        let used = &mapped.partition.usage()[CoreId(0)];
        assert_eq!(resources.map(|one| used[one]), expected, "{rule:?}");
        // The checker counts as much, so that one less is too few.
        for (resource, used) in resources.into_iter().zip(expected).filter(|(_, used)| *used > 0) {
            let board = |limit: u64| target(2, 2, limits().with(resource, limit as u32));
            assert_eq!(verify(&mapped.program, &board(used)), Ok(()), "{rule:?}: {resource:?}");
            let excess = verify(&mapped.program, &board(used - 1)).unwrap_err();
            assert!(matches!(excess, Violation::Excess { need, .. } if need == used), "{rule:?}: {excess}");
        }
    }
    // 64 accumulators of a core's 8,192 for each compartment.
    let cores = |targets| compiled(network(Some(["", "x0*y1", ""]), silicon, targets), limits()).partition.cores();
    assert_eq!((cores(128), cores(129)), (1, 2));
}
