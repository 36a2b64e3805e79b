//! Measurements of other works that nothing was fitted to, beside what nsim counts for networks of the sizes that they state.
//!
//! Each network is built, mapped and run; its counts are multiplied with the shipped constants. The result is the table in
//! `docs/energy.md`, written anew with `NSIM_BLESS=1`, and stays within an order of magnitude of what was measured.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeSet;
use std::path::PathBuf;

use common::{Net, biased, neuron};
use nsim::base::id::PopulationId;
use nsim::compile::{Compiled, Options, compile};
use nsim::cost::CostTable;
use nsim::cost::model::{core_time, energy};
use nsim::desc::resource::Resource;
use nsim::drive::{Keep, run_sample};
use nsim::io::target::{load_constants, load_target};
use nsim::ir::graph::Shape;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::Sample;
use nsim::machine::{Image, Machine, Settings};

/// A measurement: what, as published, by the shipped constants, and what was run.
struct Elsewhere {
    what: &'static str,
    published: f64,
    unit: &'static str,
    model: f64,
    run: String,
}

/// Compartments that are never at rest and never spike: of each population so many.
fn busy(populations: u32, compartments: u32) -> Quantised {
    let mut net = Net::new();
    net.input(Shape::Line(1));
    for _ in 0..populations {
        net.loihi(
            Shape::Line(compartments),
            &vec![biased(neuron(4096, 4096, 131_071, 1), 1, 0); compartments as usize],
            0,
        );
    }
    net.build()
}

/// Compartments that are always at rest.
fn resting(compartments: u32) -> Quantised {
    let mut net = Net::new();
    net.input(Shape::Line(1));
    net.loihi(Shape::Line(compartments), &vec![neuron(4096, 4096, 80, 1); compartments as usize], 0);
    net.build()
}

/// Layers of 256, each connected to all of the next, of which 13 (5 %) spike in every step, driven by their bias.
fn layers(count: u32) -> Quantised {
    let mut net = Net::new();
    let quiet = neuron(4096, 4096, 131_071, 1);
    let spiking = biased(neuron(4096, 4096, 1, 1), 4095, 0);
    let neurons: Vec<_> = (0..256).map(|i| if i % 20 == 0 { spiking } else { quiet }).collect();
    let mut before: PopulationId = net.input(Shape::Line(1));
    for layer in 0..count {
        let population = net.loihi(Shape::Line(256), &neurons, 0);
        if layer > 0 {
            net.dense(before, population, 0, &vec![2; 256 * 256]);
        }
        before = population;
    }
    net.build()
}

/// What a run of some steps without input cost: energy of a step, time of its slowest core and barrier, and on what.
struct Cost {
    nj: f64,
    us: f64,
    cores: usize,
    tiles: usize,
}

fn cost(network: Quantised, compartments_per_core: u32, steps: u32) -> Cost {
    let board = load_target("nahuku-32").unwrap();
    let mut limits = board.limits().clone();
    limits[Resource::Compartments] = compartments_per_core;
    let options = Options { place: false, ..Options::default() };
    let Compiled { program, placement, .. } = compile(network, &board.with_limits(limits), &options).unwrap();
    let image = Image::new(&program, 1).unwrap();
    let mut machine = Machine::new(&image, Settings { skip: true, per_step: true });
    // The file, not what is built in: it may just have been written.
    let path = root("mapping/constants/vtsnn-calibrated.ron");
    let table = CostTable::new(&load_constants(path.to_str().unwrap()).unwrap()).unwrap();
    let tiles: BTreeSet<_> = placement.sites().iter().map(|site| (site.chip, site.x, site.y)).collect();
    let mut picoseconds = 0;
    let keep = Keep { output: program.output(), probes: Vec::new(), early_exit: None };
    run_sample(&mut machine, &Sample::new(steps, &[], None).unwrap(), &keep, |machine, times| {
        let slowest = machine.last_step().cores.iter().map(|core| core_time(core, &table).0).max().unwrap();
        picoseconds += (slowest + table.barrier(tiles.len() as u64).0) * u64::from(times);
    });
    // Of powered cores, those that are in use: other works measured boards on which others were off or subtracted.
    let spent = energy(&machine.take_activity(), &table, placement.len() as u64).total();
    let steps = f64::from(steps);
    let (nj, us) = (spent.0 as f64 / 1e6 / steps, picoseconds as f64 / 1e6 / steps);
    Cost { nj, us, cores: placement.len(), tiles: tiles.len() }
}

fn elsewhere() -> Vec<Elsewhere> {
    let row = |what, published, unit, model, run: String| Elsewhere { what, published, unit, model, run };
    let (smnist, quartz, olfaction) =
        (cost(busy(1, 350), 1024, 100), cost(resting(1753), 1, 100), cost(resting(72), 1, 100));
    let braille = cost(busy(3456, 10), 10, 10);
    // The difference of two depths is one branch of ten layers.
    let (deep, shallow) = (cost(layers(20), 1024, 10), cost(layers(10), 1024, 10));
    let described = |of: &Cost, what: &str| format!("{what} (cores: {}, tiles: {})", of.cores, of.tiles);
    vec![
        row(
            "sMNIST LSNN on one core: its dynamic energy a step (1.583 mW * 16.65 us; intel-nrc-ecosystem/models 3dc53bf)",
            1.583 * 16.65,
            "nJ",
            smnist.nj,
            described(&smnist, "350 compartments that are not at rest, no synapses"),
        ),
        row(
            "the same: spiking phase of a step",
            4.67,
            "us",
            smnist.us,
            described(&smnist, "the same: its core and the barrier"),
        ),
        row(
            "Quartz, CIFAR-10: dynamic energy of all cores a step (11.10 mW * 278 us; Quartz-on-Loihi a56d551)",
            11.10 * 278.0,
            "nJ",
            quartz.nj,
            described(&quartz, "a compartment at rest on each core"),
        ),
        row(
            "olfaction: dynamic energy a step (0.12 mJ / 200; Imam and Cleland 2020)",
            0.12e6 / 200.0,
            "nJ",
            olfaction.nj,
            described(&olfaction, "a compartment at rest on each core"),
        ),
        row(
            "Braille RSNN, 64 networks of 53 cores on 32 chips: a step (intel-nrc-ecosystem/models)",
            6.64,
            "us",
            braille.us,
            described(&braille, "10 compartments that are not at rest on each core, and the barrier"),
        ),
        row(
            "keyword spotting: energy of an inference for each further branch of 10 layers of 256 (Blouw et al. 2018, logs)",
            16_700.0,
            "nJ",
            10.0 * (deep.nj - shallow.nj),
            format!(
                "10 steps, 13 of 256 spiking in each (5 % is assumed); {} cores more for 10 layers more",
                deep.cores - shallow.cores
            ),
        ),
    ]
}

fn root(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(path)
}

#[test]
fn networks_of_published_sizes_cost_what_the_page_says_and_about_what_was_measured() {
    let (begin, end) = ("<!-- elsewhere -->\n", "<!-- end of elsewhere -->");
    let path = root("docs/energy.md");
    let page = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = page.split_once(begin).unwrap();
    let (_, after) = rest.split_once(end).unwrap();
    let mut table =
        String::from("| Measurement | Published | Model | Model / published | Run |\n|---|---|---|---|---|\n");
    for Elsewhere { what, published, unit, model, run } in elsewhere() {
        let ratio = model / published;
        table += &format!("| {what} | {published:.4} {unit} | {model:.4} {unit} | {ratio:.2} | {run} |\n");
        assert!((0.1..10.0).contains(&ratio), "{what}: {model} against {published} {unit}");
    }
    let fresh = format!("{before}{begin}{table}{end}{after}");
    if std::env::var_os("NSIM_BLESS").is_some() {
        std::fs::write(&path, fresh).unwrap();
    } else {
        assert!(fresh == page, "run: NSIM_BLESS=1 cargo test --test elsewhere, then the tests again");
    }
}
