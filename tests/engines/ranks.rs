//! One network on several ranks against one rank: spikes, counts, probes, times and energies are
//! equal bit for bit, and each rank stores its part only. Here ranks are threads;
//! `tests/cli/jobs.rs` starts them as processes.

use crate::common::compare::small_cores;
use crate::common::random;
use crate::common::unsearched;
use nsim::compile::{Mapping, Options, compile};
use nsim::cost::{CostTable, Deployment, HostWork, MeterSettings, StepMeter, Transport};
use nsim::files::target::load_target;
use nsim::ir::arithmetic::ReadOut;
use nsim::ir::base::units::Picoseconds;
use nsim::ir::hardware::Target;
use nsim::ir::quantised::{Output, Parts, Quantised};
use nsim::ir::ranks::RankShare;
use nsim::ir::spikes::Sample;
use nsim::machine::ranks::threads::ranks;
use nsim::machine::ranks::transport::Ranks;
use nsim::session::decision::{EarlyExit, Rule};
use nsim::session::priced::MeteredMapping;
use nsim::session::samples::{Run, RunSettings, fast};
use nsim::session::{Outcome, Probe, Quantity, SampleSettings};
use rayon::prelude::*;

const NETWORKS: u64 = 240;
const MOST_RANKS: u32 = 4;

/// The share of one rank among several, or everything for a single rank.
pub fn share(rank: u32, ranks: u32, whole: bool) -> RankShare {
    if ranks > 1 { RankShare { rank, ranks, whole } } else { RankShare::ALL }
}

/// Runs each rank on its own thread; returns the first rank's result.
pub fn on_ranks<T: Send>(count: u32, run: impl Fn(u32, Option<&Ranks>) -> T + Sync) -> T {
    if count == 1 {
        return run(0, None);
    }
    let all: Vec<T> = std::thread::scope(|scope| {
        let run = &run;
        // Each rank has its own pool: threads of one pool would wait for each other.
        let pool = || rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let start = |ranks: Ranks| scope.spawn(move || pool().install(|| run(ranks.rank(), Some(&ranks))));
        let threads: Vec<_> = ranks(count).into_iter().map(start).collect();
        threads.into_iter().map(|thread| thread.join().unwrap()).collect()
    });
    all.into_iter().next().unwrap()
}

/// A network with its input and its recorded quantities.
struct Case {
    network: Quantised,
    target: Target,
    samples: Vec<Sample>,
    copies: u32,
    skip: bool,
    what: String,
}

impl Case {
    fn new(seed: u64) -> Case {
        let (network, target) = match seed % 4 {
            _ if seed >= 200 => (random::joined(seed), small_cores("nahuku-32", 4)),
            0 => (random::convolutional(seed), small_cores("nahuku-32", 40)),
            3 => (random::mixed(seed), small_cores("oheo-gulch", 7)),
            _ => (random::network(seed), small_cores("nahuku-32", 4)),
        };
        let decision = if seed % 4 == 3 { network.parts().decision } else { ReadOut::ALL[seed as usize / 4 % 4] };
        let network = Quantised::new(Parts { decision, ..network.parts().clone() }).unwrap();
        let samples = (0..2).map(|k| random::sample(&network, seed + 1_000 * k)).collect();
        let copies = if seed % 5 == 4 { 3 } else { 1 };
        let what = format!("network {seed}");
        Case { network, target, samples, copies, skip: !seed.is_multiple_of(7), what }
    }

    fn compiled(&self, share: RankShare) -> Mapping {
        let options = Options { copies: self.copies, share, ..unsearched() };
        compile(self.network.clone(), &self.target, &options).unwrap_or_else(|e| panic!("{}: {e}", self.what))
    }

    /// Runs with probes, on parts that were written as parts.
    fn plain(&self, count: u32) -> Run<()> {
        let samples: Vec<&Sample> = self.samples.iter().collect();
        on_ranks(count, |rank, ranks| {
            let compiled = self.compiled(share(rank, count, false));
            let program = &compiled.program;
            if count > 1 {
                let whole = self.compiled(share(rank, count, true));
                assert_eq!(whole.program.part(rank).unwrap(), **program, "{}: part {rank} of {count}", self.what);
                assert_eq!(program.synapses_of(|core| !program.is_local(core)), 0, "{}", self.what);
            }
            let Output { first, count, .. } = program.output();
            let probe = |quantity| Probe { first, count, quantity };
            let probes = Quantity::ALL.iter().map(|(quantity, _)| probe(*quantity)).collect();
            let keep = SampleSettings { probes, ..SampleSettings::new(program.output()) };
            let running = RunSettings { copies: self.copies, skip: self.skip, ranks, ..RunSettings::new(&keep) };
            fast(program, &samples, running, || ()).unwrap()
        })
    }

    /// Runs metered, with early exit; rank 0 has the whole program.
    fn metered(&self, count: u32, rule: Option<Rule>) -> Run<StepMeter> {
        let samples: Vec<&Sample> = self.samples.iter().collect();
        on_ranks(count, |rank, ranks| {
            let compiled = self.compiled(share(rank, count, rank == 0));
            let metered = MeteredMapping::new(&compiled);
            let deployment = Deployment::from_placement(
                "mapped",
                &compiled.placement,
                &self.target,
                self.copies,
                HostWork::default(),
            );
            let settings = MeterSettings {
                tables: vec![CostTable::new(&self.target.constants()[0]).unwrap()],
                routes: metered.routes.clone(),
                timing: deployment.timing(Transport::Queued, self.copies),
                timestep: Picoseconds::from_milliseconds(1.0),
                without_host: None,
                distribution: None,
            };
            let early_exit = Some(match rule {
                Some(rule) => EarlyExit { ends: true, ..EarlyExit::recording_only(rule, &compiled.one) },
                None => EarlyExit::recording_only(Rule::Certain, &compiled.one),
            });
            let keep = SampleSettings { early_exit, ..SampleSettings::new(compiled.program.output()) };
            let running = RunSettings { skip: self.skip, ranks, ..RunSettings::new(&keep) };
            metered.run(settings, &samples, running).unwrap()
        })
    }
}

fn assert_same<M>(one: &Run<M>, several: &Run<M>, ranks: u32, what: &str) {
    let what = format!("{what} on {ranks} ranks");
    for (one, several) in one.outcomes.iter().zip(&several.outcomes) {
        assert_eq!((one.totals, one.overflow), (several.totals, several.overflow), "{what}: totals");
        assert_eq!((&one.spikes, &one.counts), (&several.spikes, &several.counts), "{what}: outputs");
        // The number of skipped steps depends on the layout of compartments in memory.
        let alike = Outcome { skipped_steps: one.skipped_steps, ..several.clone() };
        assert!(*one == alike, "{what}: probes, or when a sample was decided");
    }
    assert_eq!(one.outcomes.len(), several.outcomes.len());
    assert_eq!(one.activity, several.activity, "{what}: activity");
    assert_eq!(one.counts, several.counts, "{what}: counts by source");
    let parts = &several.ranks;
    assert_eq!(parts.iter().map(|row| row.rank).collect::<Vec<_>>(), (0..ranks).collect::<Vec<_>>());
}

#[test]
fn random_networks_do_the_same_on_any_number_of_ranks() {
    let tried: Vec<(u64, usize)> = (0..NETWORKS)
        .into_par_iter()
        .map(|seed| {
            let case = Case::new(seed);
            let (one, priced) = (case.plain(1), case.metered(1, None));
            let by_spikes = case.network.parts().decision == ReadOut::Spikes;
            let rule =
                if seed % 2 == 0 || !by_spikes { Rule::Certain } else { Rule::Margin(std::num::NonZeroU32::MIN) };
            let decided = case.metered(1, Some(rule));
            let mut parts = 0;
            for ranks in 2..=MOST_RANKS {
                let several = case.plain(ranks);
                assert_same(&one, &several, ranks, &case.what);
                let (compartments, synapses) =
                    several.ranks.iter().fold((0, 0), |sum, row| (sum.0 + row.compartments, sum.1 + row.synapses));
                let copies = u64::from(case.copies);
                assert_eq!(compartments, copies * u64::from(case.network.compartments()), "{}", case.what);
                assert_eq!(synapses, copies * case.network.synapses(), "{}", case.what);
                parts += usize::from(several.ranks.iter().all(|row| row.compartments > 0));
                for (one, rule, how) in [(&priced, None, "metered"), (&decided, Some(rule), "decided early")] {
                    let several = case.metered(ranks, rule);
                    assert_same(one, &several, ranks, &format!("{}, {how}", case.what));
                    assert_eq!(one.meter.lanes(), several.meter.lanes(), "{}, {how}: energy and time", case.what);
                    assert_eq!(one.meter.slowest_steps(), several.meter.slowest_steps(), "{}, {how}", case.what);
                }
            }
            (one.activity.totals().spikes, parts)
        })
        .collect();
    let (spikes, parts) = tried.iter().fold((0, 0), |sum, tried| (sum.0 + tried.0, sum.1 + tried.1));
    assert!(spikes > 10_000 && parts > 300, "{spikes} spikes, {parts} runs in which every rank had a part");
}

/// Threads of a rank share its cores; the network has enough synapses for a pool of three.
#[test]
fn threads_of_a_rank_change_nothing() {
    use nsim::study::networks::{Random, random as driven};
    let bench =
        driven("small", Random { compartments: 6_000, background: 2, driven: 100, period: 32 }, &[0, 5]).unwrap();
    let target = load_target("nahuku-32").unwrap();
    let samples = [&bench.period];
    let run = |count, threads| {
        let pool = |_| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        on_ranks(count, |rank, ranks| {
            pool(rank).install(|| {
                let options = Options { share: share(rank, count, false), ..unsearched() };
                let compiled = compile(bench.network.clone(), &target, &options).unwrap();
                let keep = SampleSettings::new(compiled.program.output());
                fast(&compiled.program, &samples, RunSettings { ranks, ..RunSettings::new(&keep) }, || ()).unwrap()
            })
        })
    };
    let one = run(1, 1);
    for (count, threads) in [(2, 1), (2, 3), (3, 2)] {
        let several = run(count, threads);
        assert_same(&one, &several, count, "driven");
        let (most, all) =
            several.ranks.iter().fold((0, 0), |(most, all), row| (row.synapses.max(most), all + row.synapses));
        assert!(most * u64::from(count) <= all * 12 / 10, "{most} of {all} synapses on one of {count} ranks");
    }
}
