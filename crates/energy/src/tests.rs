//! Deployments, and the report of a priced run.

use std::sync::Arc;

use nsim_compile::{CopyPlacement, Mapping, Options, compile};
use nsim_cost::estimate::EstimateInput;
use nsim_cost::job::{Convention, DeployedCores, Mode};
use nsim_cost::transport::Words;
use nsim_cost::{CostTable, Deployment, HostWork, MessageRoutes, MeterSettings, StepMeter, Timing, Transport};
use nsim_files as io;
use nsim_ir::activity::{Activity, CoreCounts, StepActivity};
use nsim_ir::base::units::Picoseconds;
use nsim_ir::hardware::Target;
use nsim_session::error::Error;

use crate::baseline::tests::vtsnn;
use crate::baseline::{Baseline, RowConditions};
use crate::job;
use crate::options::{DeploymentSource, select_constants};
use crate::report::result::EnergyReport;

const MS: Picoseconds = Picoseconds(1_000_000_000);

fn nahuku() -> Target {
    io::target::load_target("nahuku-32").unwrap()
}

/// The published deployment of the shipped model.
fn paper() -> Deployment {
    let cores = DeployedCores { cores_used: 594, chips_used: 5, x86_cores: 5 };
    Deployment::from_numbers("paper", cores, &nahuku(), 32, HostWork::default())
}

/// Counts of these steps, and their meter.
fn run(steps: &[StepActivity], tables: Vec<CostTable>, tiles_used: u64, compiled: &Mapping) -> (Activity, StepMeter) {
    let (transport, reset, sent) = (Transport::Analytic, Words::NONE, Words::NONE);
    let timing =
        Timing { transport, tiles_used, chip_cores: 1, chip_hops: 0, turn: true, streams: 1, copies: 1, reset, sent };
    let routes = Arc::new(MessageRoutes::of_program(&compiled.program));
    let (mut activity, mut meter) = (Activity::new(1), StepMeter::new(MeterSettings::new(tables, timing, routes, MS)));
    for step in steps {
        activity.add_steps(step, 1);
        meter.add(step, 1, false);
    }
    (activity, meter)
}

fn mapped(copies: u32, placement: CopyPlacement) -> Mapping {
    let options = Options { copies, placement, ..Options::default() };
    compile(nsim_testing::slip(100), &nahuku(), &options).unwrap()
}

fn deployed(model: &str, arg: &str, compiled: &Mapping, copies: u32) -> Result<Deployment, Error> {
    let source = DeploymentSource::load(arg, model)?;
    source.deployment(compiled, &nahuku(), copies, HostWork::default())
}

fn steps() -> Vec<StepActivity> {
    let step = |n: u64| {
        let mut step = StepActivity::new(1);
        step.cores.as_mut_slice()[0] = CoreCounts {
            messages_in: 3 * n,
            events_dense: 137 * n,
            events_sparse: 11 * n,
            visited: 62,
            active: n.min(62),
            spikes: n.min(7),
            messages_out: 3 * n,
            ..CoreCounts::default()
        };
        step.hops.local = 3 * n;
        step
    };
    (0..150).map(step).collect()
}

#[test]
fn copies_are_spread_or_packed_and_the_paper_s_job_says_where_its_are() {
    let numbers = |deployment: &Deployment| {
        (deployment.copies, deployment.cores_used, deployment.chips_used, deployment.x86_cores)
    };
    let (spread, packed) = (mapped(32, CopyPlacement::Spread), mapped(32, CopyPlacement::Packed));
    let found = deployed("vtsnn-slip", "spread", &spread, 32).unwrap();
    assert_eq!((numbers(&found), found.name.as_str()), ((32, 32, 32, 32), "spread"));
    let found = deployed("vtsnn-slip", "packed", &packed, 32).unwrap();
    assert_eq!((numbers(&found).2, numbers(&found).3, found.name.as_str()), (1, 1, "packed"));
    let one = mapped(1, CopyPlacement::Spread);
    let named = |model: &str| {
        let mut parts = one.one.parts().clone();
        parts.name = model.to_string();
        Mapping { one: nsim_ir::quantised::Quantised::new(parts).unwrap(), ..one.clone() }
    };
    let found = deployed("vtsnn-slip", "paper", &named("vtsnn-slip"), 32).unwrap();
    assert_eq!(numbers(&found), (32, 594, 5, 5));
    // A network of other inputs is refused, one of the paper's inputs not, whatever its name.
    let refused = deployed("vtsnn-slip", "paper", &named("other"), 32).unwrap_err();
    let says = "paper is for networks with inputs of 156 and 3150 channels, as vtsnn-slip, not other with inputs of";
    assert!(refused.exit_status() == 2 && refused.to_string().contains(says), "{refused}");
    let own = compile(nsim_testing::slip(3150), &nahuku(), &Options::default()).unwrap();
    assert_eq!(numbers(&deployed("own.ron", "paper", &own, 32).unwrap()), (32, 594, 5, 5));
    // Numbers as given.
    assert_eq!(numbers(&deployed("own", "594,5,5", &one, 32).unwrap()), (32, 594, 5, 5));
    for (wrong, says) in [
        ("0,1,1", "at least one core on each chip"),
        ("1,2,1", "at least one core on each chip"),
        ("100,33,33", "33 chips, and nahuku-32 has 32"),
        ("129,1,1", "129 neuron cores, and nahuku-32 has 128 on each of 1 chips"),
        ("10,2,7", "7 x86 cores, and nahuku-32 has 3 on each of 2 chips"),
        ("594,32,5", "32 chips share 5 x86 cores"),
    ] {
        let refused = deployed("own", wrong, &one, 1).unwrap_err();
        assert_eq!(refused.exit_status(), 2, "{wrong}");
        assert!(refused.to_string().contains(says), "{wrong}: {refused}");
    }
    // The paper's job is of its copies on its board, unchanged.
    let paper = named("vtsnn-slip");
    let refused = deployed("vtsnn-slip", "paper", &paper, 33).unwrap_err();
    assert!(refused.to_string().contains("paper has 32 copies"), "{refused}");
    let source = DeploymentSource::load("paper", "vtsnn-slip").unwrap();
    for other in [io::target::load_target("oheo-gulch").unwrap(), nahuku().changed()] {
        let refused = source.deployment(&paper, &other, 32, HostWork::default()).unwrap_err();
        assert!(refused.to_string().contains("is for target nahuku-32, not "), "{refused}");
    }
}

#[test]
fn a_saved_mapping_gives_its_own_numbers_of_cores_if_it_could_be_run() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("saved.ron");
    let packed = mapped(2, CopyPlacement::Packed);
    let text = io::mapping::pretty(&packed.clone().mapping_file(), 2).unwrap();
    let with = |text: &str| {
        std::fs::write(&path, text).unwrap();
        deployed("m", path.to_str().unwrap(), &packed, 2)
    };
    let found = with(&text).unwrap();
    assert_eq!((found.cores_used, found.chips_used), (packed.placement.len() as u64, 1));
    assert_eq!(with(&text.replace("copies: 2", "copies: 3")).unwrap_err().exit_status(), 3);
    assert_eq!(with("oops").unwrap_err().exit_status(), 3);
    // A mapping without cores, and a missing file.
    let cut = format!("{}cores: [])", text.split("cores: [").next().unwrap());
    assert_eq!(with(&cut).unwrap_err().exit_status(), 3, "{cut}");
    std::fs::remove_file(&path).unwrap();
    assert_eq!(deployed("m", path.to_str().unwrap(), &packed, 2).unwrap_err().exit_status(), 3);
}

#[test]
fn the_text_is_eighty_columns_wide_and_says_every_figure_of_its_rows() {
    for (mode, convention) in [
        (Mode::Offline, Convention::Physical),
        (Mode::Realtime, Convention::Physical),
        (Mode::Offline, Convention::Published),
    ] {
        for deployment in [paper(), Deployment { copies: 31, ..paper() }] {
            let report = report(&deployment, mode, convention);
            let (text, full) = (report.headline(), report.text());
            for line in text.lines().chain(full.lines()) {
                assert!(line.chars().count() <= 80, "{line}");
            }
            assert!(text.lines().count() <= 30, "{text}");
            for name in ["x86 core", "neuron cores", "Loihi", "RTX 2080 Ti", "static", "dynamic", "EDP"] {
                assert!(text.contains(name), "{name}: {text}");
            }
        }
    }
}

#[test]
fn json_has_every_row_and_constant_and_nothing_unknown_is_zero() {
    let json = report(&paper(), Mode::Realtime, Convention::Published).json();
    assert_eq!(json["early_exit"], serde_json::Value::Null);
    assert_eq!(json["seed"], 7);
    let rows = json["rows"].as_array().unwrap();
    let units: Vec<_> =
        rows.iter().map(|row| (row["hardware"].as_str().unwrap(), row["unit"].as_str().unwrap())).collect();
    assert_eq!(units, [("loihi", "x86"), ("loihi", "neuron"), ("loihi", "total"), ("RTX 2080 Ti", "total")]);
    assert_eq!((&rows[3]["energy_uj"], &rows[3]["energy_source"]), (&412.9.into(), &"published".into()));
    assert_eq!(rows[3]["low"], serde_json::Value::Null);
    let parts: Vec<&String> = json["breakdown_pj_per_timestep"].as_object().unwrap().keys().collect();
    assert_eq!(parts, ["synapse", "dendrite", "compartment", "spike", "axon_out", "axon_in", "hop", "learning"]);
    assert_eq!(json["constants"].as_array().unwrap().len(), 39 + 4);
    assert_eq!(json["constants"][0]["status"], "calibrated");
    assert_eq!(json["constants"][0]["unit"], "pJ");
}

#[test]
fn csv_has_a_header_and_a_record_for_each_row() {
    let csv = report(&paper(), Mode::Offline, Convention::Physical).csv();
    let mut reader = csv::Reader::from_reader(csv.as_bytes());
    assert_eq!(reader.headers().unwrap().len(), 20);
    let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    assert_eq!(records.len(), 4);
    let gpu = [8, 9, 17, 19].map(|at| &records[3][at]);
    assert_eq!(gpu, ["26411.49", "", "published", "computed"]);
}

fn report(deployment: &Deployment, mode: Mode, convention: Convention) -> EnergyReport {
    let (target, table) = select_constants(nahuku(), Some("vtsnn-calibrated")).unwrap();
    let compiled = mapped(1, CopyPlacement::Spread);
    let (activity, meter) = run(&steps(), vec![table], deployment.tiles_used, &compiled);
    let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
    let row = gpu.row(&vtsnn(), RowConditions { steps: Some(150), timestep: MS, mode, convention }).unwrap();
    let case = EstimateInput {
        copies_counted: 1,
        hardware: "loihi",
        mode,
        convention,
        steps_per_sample: Some(150),
        ..EstimateInput::new(&activity, &meter, deployment)
    };
    let report = job::report("vtsnn-slip", &target, &case, 1, vec![(row, gpu.source())]);
    EnergyReport { seed: Some(7), input: vec!["scene".to_string()], ..report }
}
