//! `nsim energy`: what was typed -> a simulated run -> its report, or constants fitted to a table.
//!
//! [`workload`] runs, [`mod@evaluate`] prices through `crate::energy`, [`calibrate`] fits.

pub mod args;
pub mod calibrate;
pub mod evaluate;
pub mod workload;

use std::path::PathBuf;

use self::args::EnergyArgs;
use self::evaluate::evaluate;
use crate::cli::args::steps;
use crate::cli::context::{Answer, Context, Format};
use crate::cli::output;
use crate::cli::process::ranks;
use crate::energy::evaluate::Evaluated;
use crate::energy::workload::Workload;
use crate::error::Error;
use crate::io;
use crate::ir::spikes::Copies;
use crate::report::sanafe::Export;

/// The command.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &EnergyArgs, context: Context) -> Result<Answer, Error> {
    if !args.calibrate.is_empty() {
        ranks::alone("--calibrate")?;
        return calibrate::run(args, context);
    }
    let taken = output::check_files(None, &args.plot, context)?;
    io::write::check_all_free(args.export_sanafe.iter().flat_map(|folder| sanafe_files(folder)), context.force)?;
    args.steps.iter().try_for_each(|path| steps::check(path, context.force))?;
    let reported = |workload: &Workload<'_>, evaluated: Evaluated| {
        let Evaluated { energy, run, deployment } = evaluated;
        if let (Some(path), Some(svg)) = (&args.plot, energy.svg()) {
            output::write_picture(path, &svg, context)?;
        }
        if let Some(folder) = &args.export_sanafe {
            let Copies { copies, channels } = workload.shown();
            let (table, sample) = (&run.meter.tables()[0], workload.samples()[0].copies(copies, channels));
            let tiles_used = deployment.tiles_used;
            let export = Export { compiled: workload.compiled, table, sample: &sample, tiles_used };
            let mut batch = io::write::Batch::new(context.force);
            for (path, text) in sanafe_files(folder).iter().zip(export.files()?) {
                batch.add(path, |out| out.write_all(text.as_bytes()))?;
            }
            batch.commit()?;
        }
        if !taken {
            let csv = || if context.format == Format::Csv { energy.csv() } else { energy.paper_csv() };
            let text = || if args.full { energy.text() } else { energy.headline() };
            output::print(context.format, text, || energy.json(), csv)?;
        }
        if context.format != Format::Text {
            energy.notes.iter().for_each(|note| tracing::warn!("{note}"));
        }
        Ok(Answer::Yes)
    };
    evaluate(&args.cost, args.steps.as_deref(), context, reported)
}

/// The files of an export.
fn sanafe_files(folder: &std::path::Path) -> [PathBuf; 2] {
    ["arch.yaml", "snn.yaml"].map(|name| folder.join(name))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::base::diagnostic::SourceText;
    use crate::cli::args::values::SampleRange;
    use crate::cost::Deployment;
    use crate::cost::baseline::{Baseline, tests::vtsnn};
    use crate::cost::deployment::tests::paper;
    use crate::cost::estimate::Case;
    use crate::cost::estimate::tests::{MS, run};
    use crate::desc::published::baseline::Mode;
    use crate::desc::published::scenario::Convention;
    use crate::desc::published::workload::Accounting;
    use crate::desc::spanned::parse;
    use crate::desc::target::Target;
    use crate::desc::target::constants::Constants;
    use crate::desc::target::{Chip, TargetFile};
    use crate::energy::job::{self, EnergyJob};
    use crate::energy::options::{DeploymentArg, DeploymentSource, tables};
    use crate::ir::activity::{CoreCounts, StepActivity};
    use crate::ir::placement::{Mesh, Placement};
    use crate::report::energy::table::EnergyReport;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        args: EnergyArgs,
    }

    fn args(line: &[&str]) -> Result<EnergyArgs, clap::Error> {
        Line::try_parse_from([&["energy"], line].concat()).map(|line| line.args)
    }

    fn read<T: serde::de::DeserializeOwned>(path: &str) -> T {
        let text = std::fs::read_to_string(format!("{}/mapping/{path}.ron", env!("CARGO_MANIFEST_DIR"))).unwrap();
        parse(&SourceText::new(path, text), "target.syntax").unwrap()
    }

    fn nahuku() -> Target {
        let file: TargetFile = read("targets/nahuku-32");
        let chip: Chip = read("chips/loihi1");
        let constants: Vec<Constants> =
            file.constants.iter().map(|p| read(&format!("constants/{}", p.value))).collect();
        Target::new(&file, &SourceText::new("nahuku-32", ""), chip, constants).unwrap()
    }

    fn sequential(target: &Target, cores: u32) -> Placement {
        let mesh = Mesh::for_target(target);
        Placement::new(mesh, (0..cores).map(|n| mesh.site(n).unwrap()).collect()).unwrap()
    }

    fn deployed(
        model: &str,
        arg: &DeploymentArg,
        copies: u32,
        placement: &Placement,
        target: &Target,
    ) -> Result<Deployment, Error> {
        let shipped = io::published::scenario::shipped_for(model)?;
        DeploymentSource::load(arg, model, shipped.as_ref())?.deployment(model, copies, placement, target)
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
            };
            step.hops.local = 3 * n;
            step
        };
        (0..150).map(step).collect()
    }

    fn with_report<T>(deployment: &Deployment, mode: Mode, convention: Convention, f: impl Fn(EnergyReport) -> T) -> T {
        let (target, tables) = tables(nahuku(), Some("vtsnn-calibrated")).unwrap();
        let ends = tables.len() - 1;
        let (activity, meter) = run(&steps(), tables, deployment.tiles_used);
        let gpu = Baseline::shipped("rtx-2080-ti").unwrap();
        let row = gpu.row(&vtsnn(), Some(150), MS, mode, convention).unwrap();
        f(job::report(&EnergyJob {
            model: "vtsnn-slip",
            target: &target,
            case: Case {
                ends,
                copies_counted: 1,
                mode,
                convention,
                steps_per_sample: Some(150),
                ..Case::new(&activity, &meter, deployment, 1.0)
            },
            samples: 1,
            seed: Some(7),
            input: &["scene".to_string()],
            baselines: &[(row, gpu.source())],
            per_decision: None,
            other: None,
            scenario: None,
            accounting: Accounting::Profiler,
            early_exit: None,
        }))
    }

    #[test]
    fn defaults_are_those_of_the_contract() {
        let args = args(&[]).unwrap().cost;
        let scenario = io::published::scenario::shipped_for(&args.job.model).unwrap().unwrap();
        assert_eq!((scenario.copies.value, scenario.target), (32, args.job.target.clone()));
        assert_eq!(
            (args.job.model.as_str(), args.job.target.as_str(), args.copies, args.input.repeat),
            ("vtsnn-slip", "nahuku-32", None, 1)
        );
        assert_eq!(
            (args.deployment, args.mode, args.convention),
            (DeploymentArg::Packed, Mode::Offline, Convention::Physical)
        );
    }

    #[test]
    fn arguments_parse_or_are_refused() {
        let given =
            args(&["m.ron", "--samples", "3..5", "--deployment", "saved.ron", "--baseline", "a,b"]).unwrap().cost;
        assert_eq!(
            (given.input.samples, given.deployment),
            (Some(SampleRange(3..5)), DeploymentArg::File("saved.ron".into()))
        );
        assert_eq!(given.baseline, Some(vec!["a".to_string(), "b".to_string()]));
        assert_eq!(args(&["--baseline"]).unwrap().cost.baseline, Some(vec![]));
        for wrong in
            [["--samples", "5..3"], ["--samples", "5"], ["--copies", "0"], ["--repeat", "0"], ["--mode", "fast"]]
        {
            assert!(args(&wrong).is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn packing_saves_static_power_and_the_paper_s_numbers_are_pinned() {
        let target = nahuku();
        let placement = sequential(&target, 32);
        let packed = deployed("vtsnn-slip", &DeploymentArg::Packed, 32, &placement, &target).unwrap();
        assert_eq!((packed.cores_used, packed.cores_powered, packed.tiles_used, packed.x86_cores()), (32, 32, 8, 1));
        let paper = deployed("vtsnn-slip", &DeploymentArg::Paper, 32, &placement, &target).unwrap();
        assert_eq!((paper.cores_used, paper.cores_powered, paper.x86_cores()), (594, 624, 5));
        let error = deployed("vtsnn-slip", &DeploymentArg::Paper, 8, &placement, &target).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        let static_mw = |deployment: &Deployment| {
            with_report(deployment, Mode::Offline, Convention::Physical, |r| r.estimate.rows[1].static_mw.unwrap())
        };
        assert!((static_mw(&paper) / 11.7 - 1.0).abs() < 0.02);
        assert!(static_mw(&packed) < 11.7 / 5.0);
    }

    #[test]
    fn only_a_model_with_a_scenario_has_the_paper_s_deployment_and_a_file_gives_its_own() {
        let target = nahuku();
        let placement = sequential(&target, 2);
        let error = deployed("slip-tactile", &DeploymentArg::Paper, 1, &placement, &target).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("own.ron");
        let cores = "(cores_used: 7, cores_powered: 9, tiles_used: 4, chips_used: 2, x86_cores: 3)";
        let text = format!(
            "// mine\nScenario(name: \"s\", model: \"own\", target: \"nahuku-32\", copies: 2, deployment: {cores}, \
             convention: physical, work: \"w\", source: \"s\", notes: \"n\")"
        );
        std::fs::write(&path, text).unwrap();
        let file = DeploymentArg::File(path);
        let own = deployed("own", &file, 2, &placement, &target).unwrap();
        assert_eq!((own.copies, own.cores_used, own.cores_powered, own.x86_cores()), (2, 7, 9, 3));
        assert_eq!(deployed("own", &file, 3, &placement, &target).unwrap_err().exit_status(), 2);
        assert_eq!(deployed("other", &file, 2, &placement, &target).unwrap_err().exit_status(), 2);
    }

    #[test]
    fn a_saved_mapping_gives_its_own_numbers_of_cores() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("saved.ron");
        let target = nahuku();
        let write = |cores: &str, copies: u32| {
            let text = format!(
                "Mapping(model: \"m\", target: \"nahuku-32\", copies: {copies}, strategy: \"s\", seed: 0, cores: [{cores}])"
            );
            std::fs::write(&path, text).unwrap();
            deployed("m", &DeploymentArg::File(path.clone()), 2, &sequential(&target, 1), &target)
        };
        let core = |chip: u32, x: u32| format!("(chip: {chip}, x: {x}, y: 0, core: 1, holds: []),");
        let found = write(&(core(0, 0) + &core(0, 7) + &core(3, 0)), 2).unwrap();
        assert_eq!((found.cores_used, found.cores_powered, found.tiles_used, found.chips_used), (3, 12, 3, 2));
        assert_eq!(write(&core(0, 0), 3).unwrap_err().exit_status(), 2);
        assert_eq!(write(&core(0, 8), 2).unwrap_err().exit_status(), 3);
        assert_eq!(write(&(core(0, 1) + &core(0, 1)), 2).unwrap_err().exit_status(), 3);
        assert_eq!(write("oops", 2).unwrap_err().exit_status(), 3);
        let missing = DeploymentArg::File(folder.path().join("none.ron"));
        assert_eq!(deployed("m", &missing, 2, &sequential(&target, 1), &target).unwrap_err().exit_status(), 3);
    }

    #[test]
    fn a_preset_that_the_target_does_not_name_is_a_mistake_of_usage() {
        let target = nahuku();
        assert_eq!(tables(target.clone(), Some("davies2018")).unwrap().1[0].name(), "davies2018");
        assert_eq!(tables(target, Some("davies")).unwrap_err().exit_status(), 2);
    }

    #[test]
    fn what_the_text_prints_adds_up_in_both_directions() {
        for (mode, convention) in [
            (Mode::Offline, Convention::Physical),
            (Mode::Realtime, Convention::Physical),
            (Mode::Offline, Convention::Published),
        ] {
            for deployment in [paper(), Deployment { copies: 31, ..paper() }] {
                let text = with_report(&deployment, mode, convention, |r| r.text());
                let row = |unit: &str| -> Vec<f64> {
                    let line = text.lines().find(|l| l.contains("loihi") && l.contains(unit)).unwrap();
                    line.split(['|', ' ']).filter_map(|cell| cell.parse().ok()).collect()
                };
                let (x86, neuron, total) = (row("x86"), row("neuron"), row("total"));
                assert_eq!(total.len(), 6, "{text}");
                // Printed decimals: whatever is left is binary rounding of what was parsed here.
                for column in [0, 1, 2, 4, 5] {
                    assert!((x86[column] + neuron[column] - total[column]).abs() < 1e-9, "{column}: {text}");
                }
                for row in [&x86, &neuron, &total] {
                    assert!((row[0] + row[1] - row[2]).abs() < 1e-9, "{text}");
                }
                assert!(text.contains(&format!("uJ, {}", convention.name())));
            }
        }
    }

    #[test]
    fn json_has_the_keys_of_the_contract_and_nothing_unknown_is_zero() {
        let report = with_report(&paper(), Mode::Realtime, Convention::Published, |r| r);
        let json = report.json();
        for key in [
            "model",
            "target",
            "copies",
            "deployment",
            "mode",
            "convention",
            "seed",
            "rows",
            "cores_powered",
            "cores_used",
            "breakdown_pj_per_timestep",
            "per_timestep_uj",
            "early_exit",
            "constants",
        ] {
            assert!(json.get(key).is_some(), "{key}");
        }
        assert_eq!(json["schema"], "nsim.energy/1");
        assert_eq!(json["early_exit"], serde_json::Value::Null);
        assert_eq!(json["seed"], 7);
        let rows = json["rows"].as_array().unwrap();
        let units: Vec<_> =
            rows.iter().map(|row| (row["hardware"].as_str().unwrap(), row["unit"].as_str().unwrap())).collect();
        assert_eq!(units, [("loihi", "x86"), ("loihi", "neuron"), ("loihi", "total"), ("RTX 2080 Ti", "total")]);
        for key in [
            "static_mw",
            "dynamic_mw",
            "total_mw",
            "latency_us",
            "energy_uj",
            "edp_pjs",
            "low",
            "high",
            "source",
            "convention",
        ] {
            assert!(rows.iter().all(|row| row.get(key).is_some()), "{key}");
        }
        assert_eq!(rows[3]["energy_uj"], 412.9);
        assert_eq!(rows[3]["low"], serde_json::Value::Null);
        let parts: Vec<&String> = json["breakdown_pj_per_timestep"].as_object().unwrap().keys().collect();
        assert_eq!(parts, ["synapse", "dendrite", "compartment", "spike", "axon_out", "axon_in", "hop", "core_step"]);
        assert_eq!(json["constants"].as_array().unwrap().len(), 33 + 6);
        assert_eq!(json["constants"][0]["status"], "calibrated");
        assert_eq!(json["constants"][0]["unit"], "pJ");
    }

    #[test]
    fn csv_has_a_header_and_a_record_for_each_row() {
        let csv = with_report(&paper(), Mode::Offline, Convention::Physical, |r| r.csv().unwrap());
        let mut reader = csv::Reader::from_reader(csv.as_bytes());
        assert_eq!(reader.headers().unwrap().len(), 17);
        let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), 4);
        assert_eq!((&records[3][8], &records[3][9], &records[3][15]), ("26411.49", "", "published"));
    }
}
