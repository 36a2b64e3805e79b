//! Networks mapped by their kernels, compared with these mappings written synapse by synapse.

use crate::emit::classes::CoreClasses;
use crate::emit::route::{route, route_classes};
use crate::explore::box_costs::PlacedBoxes;
use crate::explore::bursts::bursts;
use crate::mapping_file::one_copy;
use crate::*;
use nsim_check::equivalence::check_copies;
use nsim_check::verify;
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::id::{CoreId, Id, IdVec};
use nsim_ir::base::rng;
use nsim_ir::graph::{PerCompartment, Shape, Window};
use nsim_ir::mapping::{MappedCore, MappedLayer, OnChip};
use nsim_ir::partition::{CoreUsage, Partition};
use nsim_ir::quantised::Quantised;
use nsim_ir::quantised::connectivity::{Connectivity, SynapseFormat};
use nsim_ir::resource::{Limits, OutputAxons, Packing, Resource};
use nsim_partition::strategy::box_fan_out::{everywhere, only};
use nsim_partition::strategy::lattice;
use nsim_partition::strategy::members::row_of_chips;
use nsim_testing::{Builder, cases, format, neurons, plain_format, target, without_classes};

/// Limits with which output axons are counted by compartment.
fn limits() -> Limits {
    Limits { output_axons: OutputAxons::PerCompartment, ..nsim_testing::limits() }
}

/// A network of any size, to be mapped by its kernels.
fn front(network: Quantised) -> Front {
    Front::from(network).cut()
}

fn by_kernels(network: Quantised, board: &Target, options: &Options) -> Result<Mapping, CompileError> {
    explore::map(front(network), board, options, &Rates::assumed(DEFAULT_RATE))
}

/// A weight of a format. Neighbours differ: kernels with repeated parts would share more tables
/// than geometry shows.
fn weight(format: SynapseFormat, seed: u64, layer: u64, at: u64) -> i16 {
    let (low, high) = format.sign.range(format.bits);
    let step = format.sign.step(format.bits);
    let levels = ((high - low) / step + 1) as u64;
    low + step * ((rng::below(levels, seed, layer, at / levels) + at) * 37 % levels) as i16
}

/// An input of two channels, layers of windows, some with one channel as input or recurrent, and a
/// dense layer at the end.
fn layered(seed: u64) -> Quantised {
    let draw = |n: u64, k: u64| rng::below(n, seed, 9, k) as u32;
    let mut net = Builder::new();
    let side = |k: u64| 5 + draw(14, k);
    let (h, w) = (side(0), side(1));
    let volume = |c, h, w| Shape::Volume(c, h, w);
    let mut all = vec![(net.input_shape("in", volume(2, h, w)), (2, h, w))];
    for layer in 0..3u64 {
        let k = 100 * (layer + 1);
        let (from, source) = all[all.len() - 1];
        let (kernel, stride) = ((1 + draw(3, k), 1 + draw(3, k + 1)), (1 + draw(2, k + 2), 1 + draw(2, k + 3)));
        let (padding, dilation) = ((draw(2, k + 4), draw(2, k + 5)), (1 + draw(2, k + 6), 1));
        let own = draw(3, k + 7) == 0;
        let groups = if own { source.0 } else { [1, 2][draw(2, k + 8) as usize] };
        let channels = if own { source.0 } else { 2 * (1 + draw(4, k + 9)) };
        let reach = |size: u32, kernel: u32, stride: u32, padding: u32, dilation: u32| {
            (size + 2 * padding).saturating_sub(dilation * (kernel - 1) + 1) / stride + 1
        };
        let shape = (
            channels,
            reach(source.1, kernel.0, stride.0, padding.0, dilation.0),
            reach(source.2, kernel.1, stride.1, padding.1, dilation.1),
        );
        let window = Window { source, target: shape, kernel, stride, padding, dilation, groups };
        let mut own_neurons = neurons();
        if draw(2, k + 10) == 0 {
            let n = shape.0 * shape.1 * shape.2;
            let du = |i: u32| nsim_ir::base::fixed::Decay::new(i64::from(i % 3) * 100).unwrap();
            let neuron = |i| nsim_ir::quantised::Neuron { du: du(i), ..neurons().get(i) };
            own_neurons = PerCompartment::Each((0..n).map(neuron).collect());
        }
        let to = net.loihi_with(&format!("layer{layer}"), volume(shape.0, shape.1, shape.2), own_neurons);
        let sign = [SignMode::Mixed, SignMode::Excitatory][draw(2, k + 11) as usize];
        let kind = format(0, sign, [8, 6][draw(2, k + 12) as usize]);
        let delay = i64::from([0, 0, 2][draw(3, k + 13) as usize]);
        if own && draw(2, k + 14) == 0 {
            net.connect(from, to, kind, delay, Connectivity::SumPool2d { window, weight: 8 });
        } else {
            let weights = (shape.0 * source.0 / groups * kernel.0 * kernel.1) as usize;
            let kernel = (0..weights).map(|i| weight(kind, seed, k, i as u64)).collect();
            net.connect(from, to, kind, delay, Connectivity::Conv2d { window, kernel });
        }
        // A recurrent convolution.
        if draw(3, k + 15) == 0 {
            let (source, target, kernel, stride, padding, dilation) = (shape, shape, (3, 1), (1, 1), (1, 0), (1, 1));
            let once = Window { source, target, kernel, stride, padding, dilation, groups: 1 };
            let own = format(0, SignMode::Mixed, 8);
            let weights = u64::from(shape.0 * shape.0 * 3);
            let kernel = (0..weights).map(|i| weight(own, seed, k + 1, i)).collect();
            net.connect(to, to, own, 0, Connectivity::Conv2d { window: once, kernel });
        }
        all.push((to, shape));
    }
    let out = net.loihi("out", 11);
    let plain = plain_format();
    net.dense(all[3].0, out, |s, t| weight(plain, seed, 1, u64::from(s * 11 + t)));
    if draw(2, 50) == 0 {
        net.dense(all[2].0, out, |s, t| weight(plain, seed, 2, u64::from(s * 11 + t)));
    }
    net.build()
}

fn small(seed: u64) -> Limits {
    let packing = if seed.is_multiple_of(2) { Packing::Nengo } else { Packing::Nxtf };
    // Every third seed counts output axons by position.
    let all = if seed.is_multiple_of(3) { nsim_testing::limits() } else { limits() };
    Limits { packing, ..all.with(Resource::Compartments, 24 + (seed % 40) as u32).with(Resource::SynapseWords, 2_000) }
}

#[test]
fn counts_and_costs_of_boxes_are_those_of_the_program() {
    let (mut several, mut fewer) = (0, 0);
    for seed in 0..90 {
        let board = target(8, 4, small(seed));
        let (copies, place, effort) = (1 + (seed % 3) as u32, seed % 4 > 0, Effort::Work(0));
        let options = Options { copies, place, effort, ..Options::default() };
        let partitioned = front(layered(seed)).partition(&board, &options, &Rates::assumed(DEFAULT_RATE));
        let partitioned = partitioned.unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        let boxes = partitioned.boxes.clone().unwrap();
        let placed = partitioned.place(&board, &options).unwrap();
        let made = placed.emit(&board, &options).unwrap().check(&board).unwrap();
        let (network, placement) = (&made.quantised, &made.placement);
        let chips = row_of_chips(made.partition.cores(), &board);
        let (members, seats) = (&made.partition.to_members(), made.partition.seats());
        let exact = nsim_partition::resources::exact::usage(network, members, seats, &chips, board.limits());
        let each = Limits { output_axons: OutputAxons::PerCompartment, ..board.limits().clone() };
        let each = nsim_partition::resources::exact::usage(network, members, seats, &chips, &each);
        assert_eq!(made.partition.usage().as_slice(), exact.as_slice(), "seed {seed}");
        let slots = exact.iter().map(|used| used[Resource::AxonsOut]);
        fewer += slots.zip(&each).filter(|(slots, each)| *slots < each[Resource::AxonsOut]).count();
        // At the rates that it was made for, and in a step in which all sources of one population
        // spike.
        let ids: Vec<_> = network.populations().ids().collect();
        let id = ids[seed as usize % ids.len()];
        let at_places = PlacedBoxes { network, boxes: &boxes, placement };
        let burst = Mapping { rates: bursts(network).swap_remove(1 + id.index()), ..made.clone() };
        let of_burst = only(network, id, &Rates::assumed(1.0));
        for (mapping, rates) in [(&made, everywhere(network, &made.rates)), (&burst, of_burst)] {
            let traffic = mapping.traffic();
            assert_eq!(at_places.traffic(&rates), traffic, "seed {seed}");
            let score = at_places.score(&rates, &traffic, &board, options.copies).unwrap();
            assert_eq!(score, mapping.score(&traffic, &board).unwrap(), "seed {seed} {id}");
        }
        several += usize::from(made.partition.cores() > 8);
    }
    assert!(several > 30, "{several} networks take several cores");
    assert!(fewer > 100, "{fewer} cores have fewer output axons by position");
}

#[test]
fn output_axons_make_boxes_smaller() {
    let few = small(1).with(Resource::AxonsOut, 24);
    let options = Options { effort: Effort::Work(0), ..Options::default() };
    let (many, plain) = (target(8, 8, few.clone()), target(8, 8, few.clone().with(Resource::AxonsOut, 4096)));
    let cores = |board: &Target| by_kernels(layered(3), board, &options).unwrap().partition.cores();
    assert!(cores(&many) > cores(&plain), "{} and {}", cores(&many), cores(&plain));
    let none = few.clone().with(Resource::AxonsOut, 1);
    let Err(CompileError::DoesNotFit(reasons)) = by_kernels(layered(3), &target(8, 8, none), &options) else {
        panic!("it fits")
    };
    assert!(reasons.iter().all(|reason| reason.resource == Resource::AxonsOut), "{reasons:?}");
}

#[test]
fn what_cannot_be_mapped_by_kernels_is_refused() {
    let board = target(1, 1, limits());
    let mut net = Builder::new();
    let (a, b) = (net.input("a", 20), net.loihi("b", 5));
    net.random(a, b, 2, 1);
    assert!(lattice::layers(&net.build()).is_none());
    let sequential = Options { strategy: Strategy::Sequential, ..Options::default() };
    let said = by_kernels(layered(1), &board, &sequential).unwrap_err().to_string();
    assert!(said.contains("no sequential mapping"), "{said}");
    assert!(!is_large(&layered(1), 1) && is_large(&layered(1), u32::MAX));
}

#[test]
fn a_wrong_count_is_found() {
    for seed in [2, 3] {
        let board = target(8, 4, small(seed));
        let options = Options { effort: Effort::Work(0), ..Options::default() };
        let made = by_kernels(layered(seed), &board, &options).unwrap();
        let used = verify::used(&made.program, &board).unwrap();
        let confirmed = |change: &dyn Fn(&mut IdVec<CoreId, CoreUsage>)| {
            let (network, members, mut usage) =
                (&made.quantised, made.partition.to_members(), made.partition.usage().clone());
            change(&mut usage);
            verify::confirm(&Partition::new(network.compartments(), members, usage, board.limits()).unwrap(), &used)
        };
        confirmed(&|_| {}).unwrap();
        for change in [
            |used: &mut CoreUsage| used.synapses -= 1,
            |used: &mut CoreUsage| used[Resource::SynapseWords] -= 1,
            |used: &mut CoreUsage| used[Resource::AxonsIn] -= 1,
        ] {
            assert!(confirmed(&|usage| change(&mut usage[CoreId(1)])).is_err());
        }
        let slots = |used: &mut CoreUsage| used[Resource::AxonsOut] = used[Resource::AxonsOut].saturating_sub(1);
        assert!(confirmed(&|usage| usage.as_mut_slice().iter_mut().for_each(slots)).is_err());
    }
}

/// A mapping in boxes, its board and its options.
fn saved(seed: u64, copies: u32) -> (Mapping, Target, Options) {
    let board = target(8, 4, small(seed));
    let options = Options { copies, place: !seed.is_multiple_of(4), effort: Effort::Work(0), ..Options::default() };
    (by_kernels(layered(seed), &board, &options).unwrap(), board, options)
}

#[test]
fn a_saved_mapping_is_made_again_and_also_written_out() {
    for seed in 0..24 {
        let (made, board, options) = saved(seed, 1 + (seed % 3) as u32);
        let file: MappingFile = ron::from_str(&ron::to_string(&made.mapping_file()).unwrap()).unwrap();
        let again = load(front(layered(seed)), &board, &options, &file).unwrap();
        assert_eq!(again.partition, made.partition, "seed {seed}");
        assert_eq!((&again.placement, again.placed), (&made.placement, place::SAVED), "seed {seed}");
        assert_eq!(again.mapping_file(), file, "seed {seed}");
        let traffic = made.traffic();
        assert_eq!(again.traffic(), traffic, "seed {seed}");
        assert_eq!(again.score(&traffic, &board).unwrap(), made.score(&traffic, &board).unwrap(), "seed {seed}");
        // A network that can be written out takes the same file.
        let written = load(layered(seed), &board, &options, &file).unwrap();
        assert_eq!((&written.partition, &written.placement), (&made.partition, &made.placement), "seed {seed}");
        let one = Options { copies: 1, ..options };
        let first = load(layered(seed), &board, &one, &one_copy(&file)).unwrap();
        let of_first = written.placement.sites().as_slice();
        assert_eq!(first.placement.sites().as_slice(), &of_first[..first.partition.cores()], "seed {seed}");
    }
}

#[test]
fn files_that_say_what_cannot_be_are_refused() {
    let (made, board, options) = saved(2, 2);
    let good = made.mapping_file();
    let load = |file: &MappingFile| load(front(layered(2)), &board, &options, file);
    load(&good).unwrap();
    let refused = |change: &dyn Fn(&mut MappingFile), code: &str, word: &str| {
        let mut file = good.clone();
        change(&mut file);
        match load(&file) {
            Err(CompileError::Input(diagnostic)) => {
                assert_eq!(diagnostic.code, code, "{diagnostic}");
                assert!(diagnostic.message.contains(word), "{diagnostic}");
            }
            other => panic!("{code}: {:?}", other.map(|made| made.partition.cores())),
        }
    };
    refused(&|f| f.model = "other".into(), "mapping.model", "other");
    refused(&|f| f.target = "tiny".into(), "mapping.target", "tiny");
    refused(&|f| f.copies = 3, "mapping.copies", "3 copies");
    refused(&|f| f.layers[0].population = "ghost".into(), "mapping.population", "ghost");
    refused(&|f| f.layers[0].population = "in".into(), "mapping.population", "in");
    refused(&|f| f.layers[1].population = "layer0".into(), "mapping.twice", "layer0");
    refused(&|f| f.layers[0].size.1 = 0, "mapping.box", "layer0");
    refused(&|f| f.layers[0].size.2 = u32::MAX, "mapping.box", "layer0");
    refused(&|f| f.layers[0].places[0].cores.push(0), "mapping.places", "layer0");
    refused(&|f| f.layers[0].places.clear(), "mapping.places", "places for 0");
    refused(&|f| drop(f.layers.pop()), "mapping.missing", "out@1");
    refused(&|f| f.layers[0].places[0].chip = u32::MAX, "mapping.site", "chip");
    refused(&|f| f.layers[0].places[0].cores[0] = u32::MAX, "mapping.site", "core");
    let taken = |f: &mut MappingFile| f.layers[1].places[0] = f.layers[0].places[0].clone();
    refused(&|f| f.layers.iter_mut().take(2).for_each(|of| of.size = (1, 1, 1)), "mapping.places", "boxes");
    let one = |at: u32| vec![OnChip { chip: 0, cores: vec![at] }];
    let whole = |population: &str, size, at| MappedLayer { population: population.into(), size, places: one(at) };
    let shape = lattice::layers(&layered(2)).unwrap().as_slice()[1].shape;
    // All of a layer on one core: more than it holds, though every number is legal.
    let mut file = good.clone();
    file.layers[0] = whole("layer0", shape, good.layers[0].places[0].cores[0]);
    match load(&file) {
        Err(CompileError::DoesNotFit(reasons)) => {
            assert!(reasons.iter().any(|reason| reason.resource == Resource::Compartments), "{reasons:?}");
        }
        other => panic!("{:?}", other.map(|made| made.partition.cores())),
    }
    if good.layers[0].places[0].cores.len() == good.layers[1].places[0].cores.len() {
        refused(&taken, "mapping.site", "same physical core");
    }
    refused(&|f| f.layers[1].places[0].cores[0] = f.layers[0].places[0].cores[0], "mapping.site", "same physical core");
    let listed = || MappedCore { chip: 0, x: 0, y: 0, core: 0, holds: Vec::new() };
    refused(&|f| f.cores.push(listed()), "mapping.layers", "by core");
}

#[test]
fn no_file_makes_it_contradict_itself() {
    let (made, board, options) = saved(3, 1);
    let good = made.mapping_file();
    let mut loaded = 0;
    for seed in 0..300u64 {
        let draw = |n: u64, k: u64| rng::below(n, seed, 77, k);
        let mut file = good.clone();
        for k in 0..1 + draw(3, 0) {
            let k = 10 * (k + 1);
            let value = [0, 1, 2, 3, 7, 64, 1 << 16, u32::MAX][draw(8, k) as usize];
            let layers = file.layers.len() as u64;
            let of = &mut file.layers[draw(layers, k + 1) as usize];
            let places = of.places.len() as u64;
            match draw(6, k + 2) {
                0 => of.size.0 = value,
                1 => of.size.1 = value,
                2 => of.size.2 = value,
                3 if places > 0 => of.places[draw(places, k + 3) as usize].chip = value,
                4 if places > 0 => of.places[draw(places, k + 3) as usize].cores.push(value),
                _ if places > 0 => of.places[draw(places, k + 3) as usize].cores.iter_mut().for_each(|c| *c ^= value),
                _ => {}
            }
        }
        for result in [
            load(front(layered(3)), &board, &options, &file).map(drop),
            load(layered(3), &board, &options, &file).map(drop),
        ] {
            match result {
                Ok(()) => loaded += 1,
                Err(CompileError::Fault(message)) => panic!("seed {seed}: {message}"),
                Err(CompileError::Input(_) | CompileError::DoesNotFit(_)) => {}
            }
        }
    }
    assert!(loaded > 0, "some changes are harmless");
}

#[test]
fn objectives_take_the_best_candidate_and_never_a_worse_one() {
    let mut changed = [0, 0];
    for seed in 0..8 {
        // The cores of a real chip, and no placement: only the sizes of boxes differ.
        let board = target(8, 8, limits());
        let options = Options { effort: Effort::Work(1), place: false, ..Options::default() };
        let (front, rates) = (front(layered(seed)), Rates::assumed(DEFAULT_RATE));
        let found = explore::candidates(&front, &board, &options, &rates).unwrap();
        assert!(found.len() > 2 && !found[0].candidate.placed && found[0].candidate.divisor == 1, "seed {seed}");
        for (which, objective) in [Objective::Energy, Objective::Latency].into_iter().enumerate() {
            let options = Options { objective, ..options };
            let found = explore::candidates(&front, &board, &options, &rates).unwrap();
            let made = by_kernels(layered(seed), &board, &options).unwrap();
            let score = made.score(&made.traffic(), &board).unwrap();
            assert!(found.iter().any(|one| one.score == score), "seed {seed}: the mapping is one of the candidates");
            let plain = found[0].score;
            if objective == Objective::Energy {
                let least = found.iter().map(|one| one.score.energy_uj).fold(f64::INFINITY, f64::min);
                assert_eq!(score.energy_uj, least, "seed {seed}");
            } else {
                assert!(score.step_us <= plain.step_us, "seed {seed}");
                let all = Rates::assumed(1.0);
                let burst = made.score_at(&all, &board).unwrap().step_us;
                let options = Options { place: false, objective: Objective::Cores, ..options };
                let unplaced = by_kernels(layered(seed), &board, &options).unwrap();
                let unplaced = unplaced.score_at(&all, &board).unwrap().step_us;
                assert!(burst <= unplaced, "seed {seed}: {burst} and {unplaced} when all spike");
            }
            changed[which] += usize::from(score.cores > plain.cores);
        }
    }
    assert!(changed[1] > 2, "smaller boxes are faster: {changed:?}");
}

#[test]
fn profiles_make_boxes_smaller() {
    // Some populations have three different decays.
    let few = small(1).with(Resource::CompartmentProfiles, 2);
    let options = Options { effort: Effort::Work(0), ..Options::default() };
    let several = (0..20).filter(|&seed| {
        let plain = by_kernels(layered(seed), &target(8, 8, small(1)), &options).unwrap();
        plain.partition.usage().iter().any(|used| used[Resource::CompartmentProfiles] > 2)
    });
    let mut seen = 0;
    for seed in several.collect::<Vec<_>>() {
        let made = by_kernels(layered(seed), &target(16, 16, few.clone()), &options).unwrap();
        assert!(made.partition.usage().iter().all(|used| used[Resource::CompartmentProfiles] <= 2), "seed {seed}");
        seen += 1;
    }
    assert!(seen > 3, "{seen} networks have several profiles");
}

/// Tables written once for all boxes of a pattern equal the tables of each box, and their sources
/// are right.
#[test]
fn programs_of_boxes_are_those_written_synapse_by_synapse() {
    let (mut alike, mut cores) = (0, 0);
    let networks = cases(120);
    for seed in 0..networks {
        let network = layered(seed);
        let most = [12, 40, 1024][seed as usize % 3];
        let counted = if seed.is_multiple_of(2) { nsim_testing::limits() } else { limits() };
        let board = target(8, 8, counted.with(Resource::Compartments, most));
        let copies = 1 + (seed % 4) as u32 / 2;
        let options = Options { copies, ..Options::default() };
        let Ok(mapping) = by_kernels(network, &board, &options) else { continue };
        let Mapping { quantised: all, partition, placement, .. } = &mapping;
        let apart = CoreClasses::apart(all, partition);
        let meant = route_classes(all, partition, placement, None, &apart, board.limits()).unwrap();
        let written = route(all, partition, (placement, None), copies, board.limits()).unwrap();
        assert!(without_classes(&written) == without_classes(&meant), "seed {seed}");
        // Every core is the first of its class or a shift of it.
        let proven = check_copies(all, &written, copies).unwrap();
        assert_eq!(proven as usize, written.cores().len() - written.classes().len(), "seed {seed}");
        (alike, cores) = (alike + proven as usize, cores + partition.cores());
        assert!(*mapping.program == written, "seed {seed}");
    }
    assert!(
        alike as u64 > 8 * networks && cores as u64 > 16 * networks,
        "{alike} of {cores} cores are written as others"
    );
}
