//! Mappings: the suite's against sequential ones and the golden interpreter, for any number of
//! threads, and small ones against the optimum of an exhaustive search.

use std::path::Path;
use std::sync::Arc;

use crate::common::{Builder, format, neuron};
use nsim::compile::explore::traffic::of_program;
use nsim::compile::{CopyPlacement, Effort, Mapping, Objective, Options, Strategy, compile, load};
use nsim::dynamics::synapses::Enumerate;
use nsim::files::mapping::load_mapping;
use nsim::files::target::load_target;
use nsim::import::model::load_model;
use nsim::ir::base::fixed::SignMode;
use nsim::ir::base::rng;
use nsim::ir::firing_rates::Rates;
use nsim::ir::graph::Shape;
use nsim::ir::hardware::Target;
use nsim::ir::placement::Mesh;
use nsim::ir::program::Program;
use nsim::ir::quantised::Quantised;
use nsim::ir::resource::{Limits, Resource};
use nsim::session::front::front;
use nsim::study::mapping::{MeasuredMapping, map_all};
use nsim::study::suite::cases;
use nsim_testing::sparse;

/// Networks of the suite that are fast enough for a test.
const SMALL: [&str; 9] = [
    "vtsnn-slip",
    "container-tactile",
    "vtsnn-slip-x32",
    "lenet",
    "dvs-gesture",
    "mlp-3x1024",
    "random-1k",
    "small-world-1k",
    "scale-free-1k",
];

fn mapped(name: &str) -> Vec<MeasuredMapping> {
    let case = cases().into_iter().find(|case| case.name == name).unwrap();
    let bench = case.build().unwrap();
    let target = load_target(bench.target).unwrap();
    let mut rows = Vec::new();
    // Compiling checks; mapping the suite compares spikes with golden. The perceptron is also
    // compared on small cores, for which a second is too little.
    let effort_s = if name == "mlp-3x1024" { 4 } else { 1 };
    map_all(&case, &bench, &target, effort_s, |row| rows.push(row)).unwrap();
    rows
}

#[test]
fn no_mapping_of_the_suite_has_more_hops_or_cores_or_longer_steps_than_the_sequential_one() {
    for name in SMALL.into_iter().take(nsim_testing::cases(9) as usize) {
        let rows = mapped(name);
        let sequential = rows.iter().find(|row| row.strategy == Strategy::Sequential && !row.placed).unwrap();
        for row in &rows {
            let what = format!("{name} {} placed {} for {}", row.strategy.name(), row.placed, row.objective.name());
            let hops = |row: &MeasuredMapping| row.traffic.hops_multicast_per_step;
            if row.objective == Objective::Cores {
                assert!(row.cores <= sequential.cores, "{what}: {} cores", row.cores);
                if row.placed {
                    assert!(hops(row) <= hops(sequential), "{what}: {} of {} hops", hops(row), hops(sequential));
                }
            } else {
                // Kernels are stored once, so synapses bound the cores of convolutions, not memory
                // words.
                let most = if name == "dvs-gesture" { sequential.step_us / 2.0 } else { sequential.step_us };
                assert!(row.step_us <= most, "{what}: {} of {} us", row.step_us, sequential.step_us);
            }
        }
    }
}

#[test]
fn the_saved_mapping_of_32_copies_passes_the_checker_on_32_cores() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("mapping/results/vtsnn-slip-x32-nahuku-32.ron");
    let file = load_mapping(&path).unwrap();
    let network = load_model("vtsnn-slip").unwrap();
    let options = Options { copies: 32, placement: CopyPlacement::Packed, ..Options::default() };
    let compiled = load(front(&network).unwrap(), &load_target("nahuku-32").unwrap(), &options, &file).unwrap();
    assert_eq!((compiled.partition.cores(), compiled.placement.chips_used(), compiled.placed), (32, 1, "saved"));
}

#[test]
fn the_number_of_threads_changes_no_mapping() {
    let with = |threads: usize, network: &Quantised, target: &Target, options: &Options| -> Arc<Program> {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| compile(network.clone(), target, options).unwrap().program)
    };
    for name in ["lenet", "small-world-1k", "scale-free-1k"] {
        let bench = cases().into_iter().find(|case| case.name == name).unwrap().build().unwrap();
        let target = load_target(bench.target).unwrap();
        // Small cores give many cores, on several chips.
        let limits = Limits { axon_out_slots_off_chip: 1, ..target.limits().clone().with(Resource::Compartments, 10) };
        let options = Options { effort: Effort::Work(1), ..Options::default() };
        for target in [target.clone(), target.with_limits(limits)] {
            let one = with(1, &bench.network, &target, &options);
            for threads in [2, 8] {
                assert!(with(threads, &bench.network, &target, &options) == one, "{name}, {threads} threads");
            }
        }
    }
}

/// A recurrent network of `n` compartments, some with an input, and synapses to a few of the next
/// ones on a ring.
fn small(n: u32, seed: u64) -> Quantised {
    let mut net = Builder::new();
    let input = net.input("input", n);
    let all = net.each("all", Shape::Line(n), &vec![neuron(1024, 128, 80, 1); n as usize], 0);
    let draw = |s: u32, k: u64, m: u64| rng::below(m, seed, u64::from(s), 1_000 + k);
    let listed = |lists: Vec<Vec<u32>>| {
        sparse(lists.into_iter().map(|mut list| {
            list.sort_unstable();
            list.dedup();
            list.into_iter().map(|target| (target, 2)).collect()
        }))
    };
    let inputs = (0..n).map(|s| if draw(s, 0, 3) == 0 { vec![s] } else { Vec::new() }).collect();
    net.connect(input, all, format(SignMode::Mixed, 0), 0, listed(inputs));
    // Numbered across the ring, so the order of the file is not the order in space.
    let at = |place: u32| place * 5 % n;
    let mut near = vec![Vec::new(); n as usize];
    for place in 0..n {
        let source = at(place);
        let targets = (1..=2 + draw(source, 1, 2) as u32).map(|d| at((place + d) % n));
        near[source as usize] = targets.filter(|&t| draw(source, 10 + u64::from(t), 5) > 0).collect();
    }
    net.connect(all, all, format(SignMode::Mixed, 0), 0, listed(near));
    net.build()
}

/// Counts messages between the cores of an assignment, inputs' included.
fn messages(network: &Quantised, core_of: &[usize]) -> u64 {
    let mut sum = 0;
    for projection in network.projections() {
        for source in 0..network.populations()[projection.source].shape.len() {
            let mut cores = Vec::new();
            projection.connectivity.for_each_from(source, |target, _| cores.push(core_of[target as usize]));
            cores.sort_unstable();
            cores.dedup();
            let own = network.populations()[projection.source].first_compartment().map(|_| core_of[source as usize]);
            sum += cores.iter().filter(|&&core| Some(core) != own).count() as u64;
        }
    }
    sum
}

/// Least messages of all assignments of compartments to the fewest cores of `room` each.
fn best_partition(network: &Quantised, n: usize, room: usize) -> u64 {
    fn go(network: &Quantised, core_of: &mut Vec<usize>, used: &mut Vec<usize>, n: usize, room: usize, best: &mut u64) {
        if core_of.len() == n {
            *best = (*best).min(messages(network, core_of));
            return;
        }
        let cores = n.div_ceil(room);
        for core in 0..(used.len() + 1).min(cores) {
            if core == used.len() {
                used.push(0);
            }
            if used[core] < room {
                used[core] += 1;
                core_of.push(core);
                go(network, core_of, used, n, room, best);
                core_of.pop();
                used[core] -= 1;
            }
            if core + 1 == used.len() && used[core] == 0 {
                used.pop();
                break;
            }
        }
    }
    let mut best = u64::MAX;
    go(network, &mut Vec::new(), &mut Vec::new(), n, room, &mut best);
    best
}

#[test]
fn partitions_of_small_networks_are_the_best_or_nearly() {
    let (mut ours, mut best) = (0, 0);
    for seed in 0..12 {
        let network = small(12, seed);
        let target = load_target("nahuku-32").unwrap();
        let target = target.clone().with_limits(target.limits().clone().with(Resource::Compartments, 4));
        let compiled = compile(network.clone(), &target, &Options::default()).unwrap();
        assert_eq!(compiled.partition.cores(), 3);
        let core_of: Vec<usize> = compiled.partition.seats().iter().map(|seat| seat.core.0 as usize).collect();
        let (found, least) = (messages(&network, &core_of), best_partition(&network, 12, 4));
        println!("seed {seed}: {found} messages, the least is {least}");
        (ours, best) = (ours + found, best + least);
    }
    // A network of nine messages is either optimal or more than 5 % off, so the bound is on the sum
    // of all networks.
    println!("{ours} messages, the least is {best}");
    assert!(ours as f64 <= 1.05 * best as f64, "{ours} messages, the least is {best}");
}

/// Source block (none for inputs), reached blocks, and rate.
type Told = (Option<usize>, Vec<usize>, u64);

/// Counts the links of a multicast tree and of all its routes by walking them; a link is a bit.
struct Walker {
    mesh: Mesh,
}

impl Walker {
    fn link(&self, (x, y): (u32, u32), direction: u32) -> u128 {
        1 << ((y * self.mesh.width + x) * 4 + direction)
    }

    fn cost(&self, (source, reached, weight): &Told, places: &[Option<(u32, u32)>]) -> u64 {
        let from = match source {
            Some(source) => match places[*source] {
                Some(place) => place,
                None => return 0,
            },
            None => (0, 0),
        };
        let (mut tree, mut all) = (0u128, 0u64);
        for to in reached.iter().filter_map(|&block| places[block]) {
            let mut at = from;
            while at != to {
                let (next, direction) = match at.0 == to.0 {
                    false if at.0 < to.0 => ((at.0 + 1, at.1), 0),
                    false => ((at.0 - 1, at.1), 1),
                    true if at.1 < to.1 => ((at.0, at.1 + 1), 2),
                    true => ((at.0, at.1 - 1), 3),
                };
                tree |= self.link(at, direction);
                all += 1;
                at = next;
            }
        }
        weight * (2 * u64::from(tree.count_ones()) + all)
    }
}

/// The least cost of any places, by branch and bound: blocks without a place cost nothing, so the
/// cost of the placed blocks is a lower bound.
fn best_places(walker: &Walker, nets: &[Told], blocks: usize, known: u64) -> u64 {
    fn go(walker: &Walker, nets: &[Told], places: &mut Vec<Option<(u32, u32)>>, block: usize, best: &mut u64) {
        let bound: u64 = nets.iter().map(|net| walker.cost(net, places)).sum();
        if bound >= *best {
            return;
        }
        if block == places.len() {
            *best = bound;
            return;
        }
        for y in 0..walker.mesh.height {
            for x in 0..walker.mesh.width {
                if !places.contains(&Some((x, y))) {
                    places[block] = Some((x, y));
                    go(walker, nets, places, block + 1, best);
                    places[block] = None;
                }
            }
        }
    }
    let mut best = known + 1;
    go(walker, nets, &mut vec![None; blocks], 0, &mut best);
    best
}

fn nets_of(compiled: &Mapping) -> Vec<Told> {
    let program = &compiled.program;
    let mut nets = Vec::new();
    for (core, image) in program.cores().enumerate() {
        for messages in image.axons_out.iter().filter(|messages| messages.len() > 0) {
            nets.push((Some(core.0 as usize), messages.map(|m| m.core.0 as usize).collect(), 1));
        }
    }
    for messages in program.parts().channels.iter().filter(|messages| !messages.is_empty()) {
        nets.push((None, messages.iter().map(|m| m.core.0 as usize).collect(), 1));
    }
    nets
}

#[test]
fn places_of_small_networks_are_the_best_or_nearly() {
    for seed in 0..nsim_testing::cases(8) {
        // One core a tile and two compartments a core: eight or nine blocks on a mesh of four by
        // three.
        let network = small(16 + 2 * (seed as u32 % 2), seed);
        let board = load_target("loihi1-chip").unwrap();
        let mut chip = board.chip().clone();
        (chip.width, chip.height, chip.cores_per_tile, chip.cores) = (4, 3, 1, 12);
        chip.limits = board.limits().clone().with(Resource::Compartments, 2);
        let target = board.with_chip(chip);
        let compiled = compile(network, &target, &Options::default()).unwrap();
        let nets = nets_of(&compiled);
        let walker = Walker { mesh: Mesh::for_target(&target) };
        let places: Vec<_> =
            compiled.placement.sites().iter().map(|&site| Some(compiled.placement.mesh().tile(site))).collect();
        let found: u64 = nets.iter().map(|net| walker.cost(net, &places)).sum();
        let said = of_program(&compiled.program, &Rates::assumed(1.0)).traffic();
        assert_eq!(2.0 * said.hops_multicast_per_step + said.hops_per_step, found as f64, "two ways of counting");
        let least = best_places(&walker, &nets, places.len(), found);
        println!("seed {seed}: {} blocks, cost {found}, the least is {least}", places.len());
        assert!(found as f64 <= 1.05 * least as f64, "seed {seed}: cost {found}, the least is {least}");
    }
}
