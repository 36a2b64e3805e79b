//! The effect of more copies and more traffic on time and energy: at most the transfers of the
//! chips' hosts, and never a gain.

use std::sync::Arc;

use crate::common::{Builder, neuron, random};
use nsim::compile::{CopyPlacement, Options, compile};
use nsim::cost::CostTable;
use nsim::cost::estimate::RowUnit;
use nsim::cost::model::StepTime;
use nsim::cost::transport::QueueMemory;
use nsim::cost::{Deployment, Host, HostWork, MessageRoutes, MeterSettings, StepMeter, Streams, Transport};
use nsim::files::target::{load_constants, load_target};
use nsim::ir::base::id::ChannelId;
use nsim::ir::base::units::Picoseconds;
use nsim::ir::graph::Shape;
use nsim::ir::hardware::{Chip, Target};
use nsim::ir::quantised::Quantised;
use nsim::ir::resource::Resource;
use nsim::ir::spikes::{Engine, Sample};
use nsim::machine::{Image, Machine, Settings};
use nsim::session::SampleSettings;
use nsim::session::priced::{MeteredMapping, run_priced};
use nsim::session::samples;
use nsim::session::samples::RunSettings;

const CHANNELS: u32 = 16;
const STEPS: u32 = 12;

/// Sixteen channels to eight compartments, some of which spike.
fn network() -> Quantised {
    let mut net = Builder::new();
    let input = net.input("input", CHANNELS);
    let hidden = net.each("hidden", Shape::Line(8), &[neuron(1024, 512, 40, 1); 8], 0);
    let weights: Vec<i64> = (0..8 * i64::from(CHANNELS)).map(|k| 10 + k % 5 * 20).collect();
    net.matrix(input, hidden, 0, &weights);
    net.build()
}

/// A board whose cores have room for one copy each.
fn board() -> Target {
    let target = load_target("pohoiki-springs").unwrap();
    let limits = target.limits().clone().with(Resource::Compartments, 8);
    target.with_limits(limits)
}

/// A sample with `spikes` channels spiking in every step.
fn sample(spikes: u32) -> Sample {
    let events: Vec<(u32, ChannelId)> =
        (0..STEPS).flat_map(|step| (0..spikes).map(move |k| (step, ChannelId((k + step) % CHANNELS)))).collect();
    Sample::new(STEPS, &events, None).unwrap()
}

/// The time of each step of `options.copies` copies of a network, and their deployment.
fn times(target: &Target, options: &Options, spikes: u32, work: HostWork) -> (Vec<StepTime>, Deployment, CostTable) {
    let copies = options.copies;
    let compiled = compile(network(), target, options).unwrap();
    let deployment = Deployment::from_placement("mapped", &compiled.placement, target, copies, work);
    let table = CostTable::new(&target.constants()[0]).unwrap();
    let routes = MessageRoutes::of_program(&compiled.program);
    let image = Image::new(&compiled.program, 1).unwrap();
    let mut machine = Machine::new(&image, Settings { skip: true, per_step: true });
    let shown = sample(spikes).copies(copies, CHANNELS);
    let mut memory = QueueMemory::default();
    machine.begin(STEPS);
    let timing = deployment.timing(Transport::Analytic, copies);
    let of_step = |step| {
        machine.step(shown.input(step));
        routes.step_times(machine.last_step(), std::slice::from_ref(&table), timing, &mut memory).remove(0)
    };
    let steps = (0..STEPS).map(of_step).collect();
    (steps, deployment, table)
}

fn options(copies: u32, placement: CopyPlacement) -> Options {
    Options { copies, placement, ..Options::default() }
}

#[test]
fn one_to_32_copies_a_chip_each_change_a_step_by_the_hops_of_chips_alone() {
    let (target, spikes) = (load_target("nahuku-32").unwrap(), 5);
    let (alone, ..) = times(&target, &options(1, CopyPlacement::Spread), spikes, HostWork::default());
    for copies in [2, 5, 31, 32] {
        let (many, deployment, table) =
            times(&target, &options(copies, CopyPlacement::Spread), spikes, HostWork::default());
        assert_eq!(deployment.chips_used, u64::from(copies));
        for (one, all) in alone.iter().zip(&many) {
            let barrier = Picoseconds(one.barrier.0 + deployment.chip_hops * table.chip_hop_time.0);
            assert_eq!(*all, StepTime { barrier, ..*one }, "{copies} copies");
        }
    }
    let (_, full, _) = times(&target, &options(32, CopyPlacement::Spread), spikes, HostWork::default());
    assert_eq!(full.chip_hops, 10);
}

#[test]
fn twice_the_spikes_of_a_stream_add_their_injection_and_what_cores_and_messages_take() {
    let target = load_target("loihi1-chip").unwrap();
    let one = options(1, CopyPlacement::Spread);
    let (few, _, table) = times(&target, &one, 4, HostWork::default());
    let (many, ..) = times(&target, &one, 8, HostWork::default());
    for (few, many) in few.iter().zip(&many) {
        assert_eq!(many.injection.0, few.injection.0 + 4 * table.injection_time.0);
        assert_eq!((many.turn, many.barrier, many.reset), (few.turn, few.barrier, few.reset));
        let rest = many.slowest_core.0 + many.transport.0 - few.slowest_core.0 - few.transport.0;
        assert_eq!(many.total().0 - few.total().0, 4 * table.injection_time.0 + rest);
    }
}

#[test]
fn a_silent_input_costs_the_barrier_the_slowest_core_and_the_turn() {
    let target = load_target("loihi1-chip").unwrap();
    let (silent, ..) = times(&target, &options(1, CopyPlacement::Spread), 0, HostWork::default());
    for step in silent {
        let none = Picoseconds(0);
        assert_eq!((step.injection, step.transport, step.reset), (none, none, none));
        assert_eq!(step.total().0, step.barrier.0 + step.slowest_core.0 + step.turn.0);
    }
}

#[test]
fn copies_on_a_chip_share_a_stream_unless_each_has_its_own_and_nothing_is_injected_without_a_host() {
    let (target, spikes) = (board(), 5);
    let (alone, ..) = times(&target, &options(1, CopyPlacement::Packed), spikes, HostWork::default());
    for copies in [32u32, 1_024] {
        let packed = options(copies, CopyPlacement::Packed);
        let (shared, deployment, table) = times(&target, &packed, spikes, HostWork::default());
        // A copy takes a core: 1,024 of them fill 8 chips.
        assert_eq!(deployment.chips_used, u64::from(copies).div_ceil(128));
        let own = HostWork { streams: Streams::Copies, ..HostWork::default() };
        let (own, ..) = times(&target, &packed, spikes, own);
        let none = HostWork { host: Host::None, ..HostWork::default() };
        let (none, without, _) = times(&target, &packed, spikes, none);
        assert_eq!((without.x86_cores, without.x86_chips), (0, 0));
        for (((one, shared), own), none) in alone.iter().zip(&shared).zip(&own).zip(&none) {
            assert_eq!(shared.injection, one.injection);
            assert_eq!(own.injection.0, u64::from(copies.min(128)) * one.injection.0);
            assert_eq!((none.injection.0, none.turn.0), (0, 0));
            assert_eq!(shared.slowest_core, one.slowest_core);
            // Inputs of one chip cross its mesh together: one link time each at most.
            let messages = u64::from(spikes * copies.min(128));
            let most = one.transport.0 + messages * table.link_time.0 + 16 * table.hop_ns_time.0;
            assert!((one.transport.0..=most).contains(&shared.transport.0), "{copies}: {one:?} {shared:?}");
        }
    }
}

#[test]
fn more_copies_or_more_traffic_never_cost_less() {
    let target = board();
    let priced = |copies: u32, spikes: u32| {
        let compiled = compile(network(), &target, &options(copies, CopyPlacement::Packed)).unwrap();
        let found = run_priced(&compiled, &target, &[sample(spikes)]).unwrap();
        let total = found.estimate.row(RowUnit::Total).unwrap();
        (total.latency_us.unwrap(), found.estimate.job.profiler().unwrap() * total.latency_us.unwrap())
    };
    let mut last = (0.0, 0.0);
    for copies in [1, 2, 7, 32, 128, 129, 256] {
        let now = priced(copies, 5);
        assert!(now.0 >= last.0 && now.1 > last.1, "{copies} copies: {now:?} after {last:?}");
        last = now;
    }
    for copies in [1, 32] {
        let mut last = (0.0, 0.0);
        for spikes in 0..=CHANNELS {
            let now = priced(copies, spikes);
            assert!(now.0 >= last.0 && now.1 >= last.1, "{spikes} spikes: {now:?} after {last:?}");
            last = now;
        }
    }
}

/// A board of small chips, on which few copies take several.
fn small_chips(seed: u64) -> Target {
    let target = load_target("pohoiki-springs").unwrap();
    let most = [2, 5, 24, 1024][seed as usize % 4];
    let chip = Chip { cores: [8, 64, 128][seed as usize % 3], ..target.chip().clone() };
    let target = target.with_chip(chip);
    let limits = target.limits().clone().with(Resource::Compartments, most);
    target.with_limits(limits)
}

#[test]
fn one_group_of_cores_stands_for_all_that_are_alike() {
    let (mut grouped, mut several_chips, mut one_chip) = (0, 0, 0);
    for seed in 0..160 {
        let (network, target) = (random::network(seed), small_chips(seed));
        let copies = [2, 3, 7, 12][seed as usize / 4 % 4];
        let sample = random::sample(&network, seed);
        let placement = CopyPlacement::ALL[seed as usize % 2];
        let Ok(compiled) = compile(network, &target, &options(copies, placement)) else { continue };
        let work = HostWork::default();
        let deployment = Deployment::from_placement("mapped", &compiled.placement, &target, copies, work);
        let ends = ["vtsnn-calibrated", "davies2018"].map(|name| load_constants(name).unwrap());
        let tables: Vec<CostTable> = target
            .constants()
            .iter()
            .take(1)
            .chain(&ends)
            .map(|constants| CostTable::new(constants).unwrap())
            .collect();
        let (fast, obvious) = (MeteredMapping::new(&compiled), MeteredMapping::every_core(&compiled));
        grouped += u32::from(compiled.core_groups().is_some());
        several_chips += u32::from(deployment.chips_used > 1);
        for transport in [Transport::Analytic, Transport::Queued] {
            let settings = |routes: &Arc<MessageRoutes>| MeterSettings {
                tables: tables.clone(),
                timing: deployment.timing(transport, copies),
                routes: routes.clone(),
                timestep: Picoseconds(1_000_000),
                without_host: None,
                distribution: None,
            };
            let keep = SampleSettings::new(compiled.program.output());
            let run = |metered: &MeteredMapping<'_>| {
                metered.run(settings(&metered.routes), &[&sample], RunSettings::new(&keep)).unwrap()
            };
            let (fast, obvious) = (run(&fast), run(&obvious));
            assert_eq!(fast.activity, obvious.activity, "seed {seed}");
            assert_eq!(fast.meter.lanes(), obvious.meter.lanes(), "seed {seed} {transport:?}");
            assert_eq!(fast.outcomes[0].spikes, obvious.outcomes[0].spikes, "seed {seed}");
            // There are no groups here: the whole program runs on its own cores.
            let routes = Arc::new(MessageRoutes::of_program(&compiled.program));
            let settings = Arc::new(settings(&routes));
            let running = RunSettings { copies, per_step: true, ..RunSettings::new(&keep) };
            let whole =
                samples::fast(&compiled.program, &[&sample], running, || StepMeter::new(settings.clone())).unwrap();
            assert_eq!(fast.activity, whole.activity, "seed {seed}");
            if deployment.chips_used == 1 || transport == Transport::Analytic {
                assert_eq!(fast.meter.lanes(), whole.meter.lanes(), "seed {seed} {transport:?}");
                one_chip += 1;
            }
        }
    }
    assert!(grouped > 60 && several_chips > 30 && one_chip > 100, "{grouped} {several_chips} {one_chip}");
}
