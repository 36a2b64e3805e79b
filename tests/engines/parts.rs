//! The parts of a run add up to its totals, exactly: populations, inputs, cores and timesteps of
//! random networks, on the machine with 1, 2 and 8 threads and on the golden interpreter.

use crate::common::compare::small_cores;
use crate::common::random;
use crate::common::unsearched;
use nsim::compile::{Mapping, Options, compile};
use nsim::cost::model::{core_time, energy};
use nsim::cost::{CostTable, Deployment, HostWork, MeterSettings, StepMeter, Transport};
use nsim::files::steps::{StepFormat, StepWriter};
use nsim::ir::activity::{Overflow, Totals};
use nsim::ir::base::id::ChannelId;
use nsim::ir::base::units::{Femtojoules, Picoseconds};
use nsim::ir::hardware::Target;
use nsim::ir::quantised::Quantised;
use nsim::ir::spikes::Sample;
use nsim::session::cores::core_rows;
use nsim::session::populations::CountsByPopulation;
use nsim::session::priced::MeteredMapping;
use nsim::session::samples::{Run, RunSettings, golden};
use nsim::session::steps::{CELLS, StepLayout, run_recorded};
use nsim::session::{Outcome, SampleSettings};
use rayon::ThreadPoolBuilder;

fn target() -> Target {
    small_cores("loihi1-chip", 5)
}

fn totals(outcomes: &[Outcome]) -> (Totals, Overflow) {
    let (mut totals, mut overflow) = (Totals::default(), Overflow::default());
    for outcome in outcomes {
        totals += outcome.totals;
        overflow.q_wrapped += outcome.overflow.q_wrapped;
        overflow.u_wrapped += outcome.overflow.u_wrapped;
        overflow.v_clipped += outcome.overflow.v_clipped;
    }
    (totals, overflow)
}

/// Rows of populations and inputs add up to the totals of the samples.
fn assert_adds_up(rows: &CountsByPopulation, network: &Quantised, outcomes: &[Outcome], what: &str) {
    let (totals, overflow) = totals(outcomes);
    let sum = |f: fn(&nsim::session::populations::PopulationCounts) -> u64| rows.populations.iter().map(f).sum::<u64>();
    assert_eq!(sum(|row| row.spikes), totals.spikes, "{what}: spikes");
    assert_eq!(sum(|row| row.clipped), overflow.v_clipped, "{what}: clipped");
    assert_eq!(sum(|row| row.wrapped), overflow.q_wrapped + overflow.u_wrapped, "{what}: wrapped");
    assert_eq!(sum(|row| row.compartments), u64::from(network.compartments()), "{what}: compartments");
    assert_eq!(rows.inputs.iter().map(|row| row.spikes).sum::<u64>(), totals.spikes_in, "{what}: input spikes");
    for row in &rows.populations {
        assert!(row.silent <= row.compartments && row.compartments - row.silent <= row.spikes, "{what}: {row:?}");
    }
}

#[test]
fn populations_and_cores_sum_to_the_totals() {
    let target = target();
    let pools: Vec<_> = [1, 2, 8].map(|n| ThreadPoolBuilder::new().num_threads(n).build().unwrap()).into();
    let (mut wrapped, mut clipped, mut spikes) = (0, 0, 0);
    for seed in 0..240 {
        let network = if seed < 200 { random::network(seed) } else { random::joined(seed) };
        let given: Vec<Sample> = (0..5).map(|k| random::sample(&network, seed + 1_000 * k)).collect();
        let samples: Vec<&Sample> = given.iter().collect();
        let compiled = compile(network.clone(), &target, &unsearched()).unwrap();
        let keep = SampleSettings::new(compiled.program.output());
        let expected = pools[1].install(|| golden(&network, &samples, &keep, &|| ()));
        let rows = CountsByPopulation::new(&network, &expected.counts);
        assert_adds_up(&rows, &network, &expected.outcomes, &format!("network {seed}, golden"));
        wrapped += rows.populations.iter().map(|row| row.wrapped).sum::<u64>();
        clipped += rows.populations.iter().map(|row| row.clipped).sum::<u64>();
        spikes += rows.populations.iter().map(|row| row.spikes).sum::<u64>();
        for pool in &pools {
            let what = format!("network {seed}, {} threads", pool.current_num_threads());
            pool.install(|| compare(&compiled, &target, &samples, &rows, &what));
        }
    }
    assert!(wrapped > 100 && clipped > 100 && spikes > 10_000, "{wrapped} wrapped, {clipped} clipped, {spikes} spikes");
}

/// Compares metered runs on the machine with the expected counts.
fn compare(compiled: &Mapping, target: &Target, samples: &[&Sample], expected: &CountsByPopulation, what: &str) {
    let program = &compiled.program;
    let table = CostTable::new(&target.constants()[0]).unwrap();
    let deployment =
        Deployment::from_placement("mapped", &compiled.placement, target, compiled.options.copies, HostWork::default());
    let timing = deployment.timing(Transport::Analytic, compiled.options.copies);
    let metered = MeteredMapping::new(compiled);
    let settings = MeterSettings {
        tables: vec![table],
        routes: metered.routes.clone(),
        timing,
        timestep: Picoseconds::from_milliseconds(1.0),
        without_host: None,
        distribution: None,
    };
    let run = metered.run(settings, samples, RunSettings::new(&SampleSettings::new(program.output()))).unwrap();
    let rows = CountsByPopulation::for_copies(&compiled.one, &run.counts, compiled.options.copies);
    assert_eq!(&rows, expected, "{what}: as the golden interpreter counts");

    let table = &run.meter.tables()[0];
    let cores = core_rows(program, &run.activity, Some(&run.meter));
    let sum = |f: fn(&nsim::ir::activity::CoreCounts) -> u64| cores.iter().map(|row| f(&row.counts)).sum::<u64>();
    let totals = run.activity.totals();
    let spikes: u64 = rows.populations.iter().map(|row| row.spikes).sum();
    assert_eq!((sum(|core| core.spikes), spikes), (totals.spikes, totals.spikes), "{what}: spikes");
    assert_eq!(sum(nsim::ir::activity::CoreCounts::synaptic_events), totals.synaptic_events, "{what}: events");
    assert_eq!(sum(|core| core.messages_in), run.activity.messages(), "{what}: messages");
    let whole = energy(&run.activity, table);
    let spent: Femtojoules = cores.iter().map(|row| row.spent.unwrap().energy.total()).sum();
    assert_eq!(spent.0 + whole.hop.0, whole.total().0, "{what}: energy");
    assert_eq!(run.meter.lanes()[0].whole.energy, energy(&run.activity, table).total(), "{what}: energy of steps");
    let slowest: u64 = cores.iter().map(|row| row.spent.unwrap().slowest_steps).sum();
    assert_eq!(slowest, run.activity.steps(), "{what}: each step has a slowest core");
    for row in &cores {
        assert_eq!(row.spent.unwrap().busy, core_time(&row.counts, table), "{what}: {}", row.core);
    }
}

/// Copies of a network run the samples; a row counts all copies, even if one represents them all.
#[test]
fn copies_count_together() {
    let network = random::network(3);
    let sample = random::sample(&network, 3);
    let samples = [&sample, &sample];
    let target = target();
    let rows = |copies: u32| {
        let options = Options { copies, ..unsearched() };
        let compiled = compile(network.clone(), &target, &options).unwrap();
        let keep = SampleSettings::new(compiled.program.output());
        let running = RunSettings { copies, ..RunSettings::new(&keep) };
        let run = nsim::session::samples::fast(&compiled.program, &samples, running, || ()).unwrap();
        let rows = CountsByPopulation::new(&compiled.one, &run.counts);
        compare(&compiled, &target, &samples, &rows, &format!("{copies} copies"));
        rows
    };
    let (one, three) = (rows(1), rows(3));
    assert_eq!(one.populations.len(), three.populations.len());
    for (one, three) in one.populations.iter().zip(&three.populations) {
        assert_eq!(
            (one.spikes * 3, one.silent * 3, one.compartments * 3),
            (three.spikes, three.silent, three.compartments)
        );
    }
    assert!(one.inputs.iter().zip(&three.inputs).all(|(one, three)| one.spikes * 3 == three.spikes));
}

/// A metered run with a row for each step, and its file.
fn recorded(
    compiled: &Mapping,
    target: &Target,
    samples: &[&Sample],
    format: StepFormat,
) -> (Run<StepMeter>, StepLayout, Vec<u8>) {
    let metered = MeteredMapping::new(compiled);
    let (settings, _) = metered.offline(target).unwrap();
    let layout = StepLayout::new(&compiled.one);
    let keep = SampleSettings::new(compiled.program.output());
    let rows = samples.iter().map(|sample| u64::from(sample.steps())).sum();
    let mut file = Vec::new();
    let table = StepWriter::new(&mut file, format, layout.columns(), Some(rows)).unwrap();
    let (run, written) = run_recorded(&metered, settings, samples, RunSettings::new(&keep), &layout, table).unwrap();
    written.unwrap();
    (run, layout, file)
}

/// Rows add up to the run, column by column.
fn assert_rows_add_up(compiled: &Mapping, target: &Target, samples: &[&Sample], what: &str) {
    let (run, layout, file) = recorded(compiled, target, samples, StepFormat::Csv);
    let mut reader = csv::Reader::from_reader(&file[..]);
    let header: Vec<String> = reader.headers().unwrap().iter().map(str::to_string).collect();
    assert_eq!(header[..2], ["sample", "timestep"], "{what}");
    let mut sums = vec![0u64; header.len()];
    let mut places =
        samples.iter().zip(0u64..).flat_map(|(sample, n)| (0..u64::from(sample.steps())).map(move |t| (n, t)));
    for record in reader.records() {
        // Every figure is an integer of its finest unit: the number of decimals is fixed.
        let cells: Vec<u64> = record.unwrap().iter().map(|cell| cell.replace('.', "").parse().unwrap()).collect();
        assert_eq!(places.next(), Some((cells[0], cells[1])), "{what}: rows are in run order");
        sums.iter_mut().zip(cells).for_each(|(sum, cell)| *sum += cell);
    }
    assert_eq!(places.next(), None, "{what}: a row for each step");
    let sum = |name: &str| sums[header.iter().position(|column| column == name).unwrap()];
    let rows = CountsByPopulation::for_copies(&compiled.one, &run.counts, compiled.options.copies);
    for row in &rows.populations {
        assert_eq!(sum(&format!("spikes.{}", row.name)), row.spikes, "{what}: {}", row.name);
    }
    for row in &rows.inputs {
        assert_eq!(sum(&format!("spikes.{}", row.name)), row.spikes, "{what}: {}", row.name);
    }
    let activity = &run.activity;
    assert_eq!(sum("synaptic_events"), activity.totals().synaptic_events, "{what}");
    assert_eq!((sum("messages"), sum("hops")), (activity.messages(), activity.hops().total_links()), "{what}");
    for (name, part) in
        energy(activity, &run.meter.tables()[0]).parts().into_iter().filter(|(name, _)| *name != "learning")
    {
        assert_eq!(u128::from(sum(&format!("energy_pj.{name}"))), part.0, "{what}: {name}");
    }
    let time: u64 = header.iter().zip(&sums).filter(|(name, _)| name.starts_with("time_us.")).map(|(_, sum)| sum).sum();
    assert_eq!(u128::from(time), run.meter.lanes()[0].whole.time, "{what}: time");
    let (_, _, array) = recorded(compiled, target, samples, StepFormat::Npy);
    let width = 8 + 8 * layout.columns().len();
    let steps: usize = samples.iter().map(|sample| sample.steps() as usize).sum();
    assert_eq!((array.len() - steps * width) % 64, 0, "{what}: a record for each step");
}

#[test]
fn rows_of_steps_sum_to_the_totals() {
    let target = target();
    let pools: Vec<_> = [1, 8].map(|n| ThreadPoolBuilder::new().num_threads(n).build().unwrap()).into();
    for seed in 0..60 {
        let network = random::network(seed);
        let given: Vec<Sample> = (0..4).map(|k| random::sample(&network, seed + 1_000 * k)).collect();
        let samples: Vec<&Sample> = given.iter().collect();
        let copies = [1, 1, 3][seed as usize % 3];
        let options = Options { copies, ..unsearched() };
        let compiled = compile(network, &target, &options).unwrap();
        let files = pools.iter().map(|pool| {
            pool.install(|| {
                assert_rows_add_up(&compiled, &target, &samples, &format!("network {seed}, {copies} copies"));
                recorded(&compiled, &target, &samples, StepFormat::Csv).2
            })
        });
        let files: Vec<Vec<u8>> = files.collect();
        assert!(files[0] == files[1], "network {seed}: the number of threads changes no row");
    }
}

/// A sample with too many numbers to store writes its rows as they are produced.
#[test]
fn rows_of_a_long_sample_sum_to_its_totals() {
    let network = random::network(5);
    let steps = (CELLS / 16) as u32;
    let events: Vec<_> = (0..network.channels()).map(|channel| (channel * 7_919 % steps, ChannelId(channel))).collect();
    let late = [(steps - 1, ChannelId(0))];
    let long = Sample::new(steps, &[&events[..], &late].concat(), None).unwrap();
    let short = random::sample(&network, 5);
    let target = target();
    let compiled = compile(network, &target, &unsearched()).unwrap();
    assert_rows_add_up(&compiled, &target, &[&short, &long, &short], "a long sample between short ones");
}
