//! `nsim energy`: what was typed, and from a finished run to its report.
//!
//! The run itself (compile, machine) is the caller's; [`report`] is the whole of what follows it, and [`deployment`] and
//! [`tables`] are what must be known before it.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::cli::jobs::{self, JobArgs, Prepared, Wanted};
use crate::cli::run::{InputArgs, Switch, check_pruned, select};
use crate::cli::{Answer, Context, Format, common, inputs, simulate};

use crate::base::diagnostic::Diagnostic;
use crate::base::units::Picoseconds;
use crate::cost::baseline::{Baseline, NetworkShape, SHIPPED};
use crate::cost::estimate::{Case, Convention, estimate, spent};
use crate::cost::{CostTable, Deployment, StepMeter};
use crate::desc::baseline::Mode;
use crate::desc::target::Target;
use crate::drive::decision::{EarlyExit, Rule};
use crate::drive::{Keep, Outcome};
use crate::error::Error;
use crate::io;
use crate::ir::activity::{Activity, StepActivity};
use crate::ir::placement::{Mesh, Placement, Site};
use crate::ir::spikes::Sample;
use crate::report::energy::{EnergyReport, Saved, constant_entries};

const EXAMPLES: &str = "\
EXAMPLES:
  nsim energy                                     the default model, 32 copies packed on nahuku-32
  nsim energy --deployment paper --mode realtime  with the published numbers of cores, held to 1 ms steps
  nsim energy --convention published              energy as the VT-SNN paper computes it (power / timesteps)
  nsim energy --early-exit certain                what ending decided samples would save
  nsim energy --constants davies2018 --baseline   the other preset, and no baseline
  nsim energy slip-tactile --input tactile=recording.npy --format json";

/// Options of `nsim energy`.
#[derive(Debug, Clone, Args)]
#[command(after_help = EXAMPLES)]
pub struct EnergyArgs {
    /// The network and the hardware.
    #[command(flatten)]
    /// Model, target and engine.
    pub job: JobArgs,
    /// The spikes.
    #[command(flatten)]
    /// What the network is shown.
    pub input: InputArgs,
    /// Copies of the model on the target; figures are of one
    #[arg(long, value_name = "N", default_value_t = 32, value_parser = clap::value_parser!(u32).range(1..))]
    pub copies: u32,
    /// Numbers of cores used and powered: of this mapping, of the VT-SNN paper, or of a saved mapping
    #[arg(long, value_name = "packed|paper|FILE", default_value = "packed")]
    pub deployment: DeploymentArg,
    /// As fast as possible, or held to the model's timestep
    #[arg(long, default_value = "offline")]
    pub mode: ModeArg,
    /// Energy as power x latency, or as the VT-SNN paper computes it
    #[arg(long, default_value = "physical")]
    pub convention: ConventionArg,
    /// Other hardware to show beside; all that come with nsim when left out, none when given without a name
    #[arg(long, value_name = "NAME", num_args = 0.., value_delimiter = ',')]
    pub baseline: Option<Vec<String>>,
    /// Preset of constants, of those that the target names; its first when left out
    #[arg(long, value_name = "PRESET")]
    pub constants: Option<String>,
    /// Whether the simulator skips work that cannot change anything; no figure depends on it
    #[arg(long, default_value = "on")]
    pub skip: Switch,
    /// Say what ending a sample would save when an output leads by so many spikes, or when no other can overtake it
    #[arg(long, value_name = "MARGIN|certain")]
    pub early_exit: Option<Rule>,
}

/// `--deployment`
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeploymentArg {
    /// The mapping's own cores.
    Packed,
    /// The VT-SNN paper's numbers.
    Paper,
    /// Those of a saved mapping.
    File(PathBuf),
}

impl From<&str> for DeploymentArg {
    fn from(text: &str) -> Self {
        match text {
            "packed" => DeploymentArg::Packed,
            "paper" => DeploymentArg::Paper,
            path => DeploymentArg::File(path.into()),
        }
    }
}

/// `--mode`
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ModeArg {
    /// As fast as possible.
    Offline,
    /// A step lasts at least as long as the model's timestep.
    Realtime,
}

impl From<ModeArg> for Mode {
    fn from(arg: ModeArg) -> Self {
        match arg {
            ModeArg::Offline => Mode::Offline,
            ModeArg::Realtime => Mode::Realtime,
        }
    }
}

/// `--convention`
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum ConventionArg {
    /// Power times latency.
    Physical,
    /// Power divided by the timesteps of a sample.
    Published,
}

impl From<ConventionArg> for Convention {
    fn from(arg: ConventionArg) -> Self {
        match arg {
            ConventionArg::Physical => Convention::Physical,
            ConventionArg::Published => Convention::Published,
        }
    }
}

/// The target's presets in integers, and which of them is asked for.
///
/// # Errors
/// [`Error::Usage`] for a preset that the target does not name, [`Error::Input`] for a constant that no integer holds.
pub fn tables(target: &Target, preset: Option<&str>) -> Result<(Vec<CostTable>, usize), Error> {
    let tables = target.constants().iter().map(CostTable::new).collect::<Result<Vec<_>, _>>()?;
    let chosen = match preset {
        None => 0,
        Some(name) => tables.iter().position(|table| table.name() == name).ok_or_else(|| {
            let names: Vec<&str> = tables.iter().map(CostTable::name).collect();
            Error::Usage(format!("{} has no constants {name}; it has {}", target.name(), names.join(", ")))
        })?,
    };
    Ok((tables, chosen))
}

/// The numbers of cores for the report. The placement holds all copies.
///
/// # Errors
/// [`Error::Usage`] when the paper's deployment is asked for other than 32 copies, or a saved mapping is of another number
/// of copies or another target; [`Error::Input`] when the file cannot be read or places cores where the target has none.
pub fn deployment(
    arg: &DeploymentArg,
    copies: u32,
    placement: &Placement,
    target: &Target,
) -> Result<Deployment, Error> {
    match arg {
        DeploymentArg::Packed => Ok(Deployment::of("packed", placement, target.chip(), copies)),
        DeploymentArg::Paper => {
            let paper = Deployment::paper();
            if paper.copies != copies {
                return Err(Error::Usage(format!(
                    "--deployment paper is of {} copies, not {copies}: leave --copies out or use --deployment packed",
                    paper.copies
                )));
            }
            Ok(paper)
        }
        DeploymentArg::File(path) => {
            let mapping = io::mapping::load_mapping(path).map_err(|error| match error.help {
                None => error.help("--deployment is packed, paper, or a mapping saved by nsim map -o"),
                Some(_) => error,
            })?;
            if mapping.copies != copies || mapping.target != target.name() {
                return Err(Error::Usage(format!(
                    "{} holds {} copies on {}, not {copies} on {}",
                    path.display(),
                    mapping.copies,
                    mapping.target,
                    target.name()
                )));
            }
            let sites = mapping.cores.iter().map(|at| Site { chip: at.chip, x: at.x, y: at.y, core: at.core });
            let placement = Placement::new(Mesh::of(target), sites.collect())
                .map_err(|error| Diagnostic::new("deployment.placement", error.to_string()).in_file(path))?;
            Ok(Deployment::of(path.display().to_string(), &placement, target.chip(), copies))
        }
    }
}

/// The baselines asked for: all that are shipped when none is named.
///
/// # Errors
/// A diagnostic for a name that does not exist.
pub fn baselines(names: Option<&[String]>) -> Result<Vec<Baseline>, Diagnostic> {
    match names {
        Some(names) => names.iter().map(|name| Baseline::shipped(name)).collect(),
        None => SHIPPED.iter().map(|(name, _)| Baseline::shipped(name)).collect(),
    }
}

/// A finished run and what is asked about it.
#[derive(Debug, Clone, Copy)]
pub struct EnergyJob<'a> {
    /// The model's name.
    pub model: &'a str,
    /// Where it ran.
    pub target: &'a Target,
    /// Sizes of one copy, to find out which baselines hold.
    pub shape: &'a NetworkShape,
    /// The preset of the figures, an index into the target's (from [`tables`]).
    pub preset: usize,
    /// Counts of the run.
    pub activity: &'a Activity,
    /// Its steps, under all of the target's presets and with the deployment's tiles in the barrier.
    pub meter: &'a StepMeter,
    /// Copies whose activity was counted: 1 when one stands for all.
    pub copies_counted: u32,
    /// Where all copies are.
    pub deployment: &'a Deployment,
    /// Offline or real time.
    pub mode: Mode,
    /// What energy means.
    pub convention: Convention,
    /// Length of the model's timestep.
    pub timestep: Picoseconds,
    /// Timesteps of a sample; `None` when samples differ.
    pub steps_per_sample: Option<u32>,
    /// Samples that were run, repeats included.
    pub samples: u64,
    /// Seed of the input, if it was made from one.
    pub seed: Option<u64>,
    /// Hardware to show beside.
    pub baselines: &'a [Baseline],
    /// What ending samples when they are decided would save.
    pub early_exit: Option<Saved>,
}

impl<'a> EnergyJob<'a> {
    fn case(&self) -> Case<'a> {
        Case {
            activity: self.activity,
            meter: self.meter,
            preset: self.preset,
            copies_counted: self.copies_counted,
            deployment: self.deployment,
            mode: self.mode,
            timestep: self.timestep,
            convention: self.convention,
            steps_per_sample: self.steps_per_sample,
        }
    }
}

/// The command.
///
/// # Errors
/// [`Error`] when an input cannot be used.
pub fn run(args: &EnergyArgs, context: Context) -> Result<Answer, Error> {
    let baselines = baselines(args.baseline.as_deref())?;
    let Prepared::Ready(job) = jobs::prepare(&args.job, Wanted::Mapped, args.copies, context)? else {
        return Ok(Answer::No);
    };
    let Some((compiled, target)) = job.mapped() else {
        return Err(Error::Fault("energy needs a mapped job".to_string()));
    };
    let (tables, preset) = tables(target, args.constants.as_deref())?;
    let deployment = deployment(&args.deployment, args.copies, &compiled.placement, target)?;
    let stimulus = inputs::stimulus(&compiled.one, &args.input.input, job.scene(), args.input.seed)?;
    let samples = select(&stimulus.samples, &args.input)?;
    check_pruned(&compiled.one, &samples, &args.input)?;
    // Copies share nothing, input channels included: each sees the whole sample.
    let copied: Vec<Sample> =
        samples.iter().map(|sample| sample.copies(args.copies, compiled.one.channels())).collect();
    let copied: Vec<&Sample> = copied.iter().collect();
    let prototype = StepMeter::new(tables, deployment.tiles_used);
    let skip = args.skip == Switch::On;
    let add = |meter: &mut StepMeter, step: &StepActivity, times: u32| (0..times).for_each(|_| meter.add(step));
    let simulated = |early_exit: Option<EarlyExit>| {
        let keep = Keep { output: compiled.program.output(), probes: Vec::new(), early_exit };
        let run = simulate::fast(&compiled.program, &copied, &keep, (skip, true), context, || prototype.fresh(), add)?;
        let mut meter = prototype.fresh();
        run.meters.iter().for_each(|sample| meter.merge(sample));
        Ok::<_, Error>((run, meter))
    };
    let (run, meter) = simulated(None)?;
    let same = samples.windows(2).all(|pair| pair[0].steps() == pair[1].steps());
    let whole = EnergyJob {
        model: &compiled.one.parts().name,
        target,
        shape: &NetworkShape::of(&compiled.one),
        preset,
        activity: &run.activity,
        meter: &meter,
        copies_counted: args.copies,
        deployment: &deployment,
        mode: args.mode.into(),
        convention: args.convention.into(),
        timestep: Picoseconds((compiled.one.parts().timestep_ms * 1e9).round() as u64),
        steps_per_sample: samples.first().filter(|_| same).map(|sample| sample.steps()),
        samples: samples.len() as u64,
        seed: stimulus.seed,
        baselines: &baselines,
        early_exit: None,
    };
    let early_exit = match args.early_exit {
        None => None,
        Some(rule) => {
            // Copies see the same samples and decide alike; the outputs that are watched are those of the first.
            let (run, meter) = simulated(Some(EarlyExit::new(rule, &compiled.one)))?;
            let early = EnergyJob { activity: &run.activity, meter: &meter, ..whole };
            Some(saved(rule, &whole, &run.outcomes, &early))
        }
    };
    let energy = report(&EnergyJob { early_exit, ..whole });
    common::print(context.format, || energy.text(), || energy.json(), || energy.csv())?;
    if context.format != Format::Text {
        energy.notes.iter().for_each(|note| tracing::warn!("{note}"));
    }
    Ok(Answer::Yes)
}

/// What a run spends less than the whole one: equation (16).
fn saved(rule: Rule, whole: &EnergyJob<'_>, outcomes: &[Outcome], early: &EnergyJob<'_>) -> Saved {
    let (whole, early) = (spent(&whole.case()), spent(&early.case()));
    let energy_saved_uj = whole.energy_uj - early.energy_uj;
    Saved {
        rule,
        decided: outcomes.iter().filter(|outcome| outcome.decided_at.is_some()).count() as u64,
        steps_saved: outcomes.iter().map(|outcome| u64::from(outcome.steps_saved)).sum(),
        time_saved_us: whole.time_us - early.time_us,
        energy_saved_uj,
        energy_saved_share: (whole.energy_uj > 0.0).then(|| energy_saved_uj / whole.energy_uj),
    }
}

/// From a finished run to its report. Its notes belong on stderr when the output is for programs.
#[must_use]
pub fn report(job: &EnergyJob<'_>) -> EnergyReport {
    let estimate = estimate(&job.case());
    let mut notes = estimate.notes.clone();
    let mut rows = Vec::new();
    for baseline in job.baselines {
        match baseline.row(job.shape, job.steps_per_sample, job.timestep, job.mode, job.convention) {
            Ok(row) => rows.push((row, baseline.source())),
            Err(reason) => notes.push(reason),
        }
    }
    let tables = job.meter.tables();
    if tables[job.preset].injection.0 == 0 && job.mode == Mode::Offline {
        notes.push(
            "these constants give no time for injecting a spike, which bounds offline runs on the board: the latency is that \
             of the neuron cores alone"
                .to_string(),
        );
    }
    if job.deployment.name == "paper" {
        notes.push("numbers of cores are the VT-SNN paper's; activity is this mapping's".to_string());
    }
    EnergyReport {
        model: job.model.to_string(),
        target: job.target.name().to_string(),
        deployment: job.deployment.clone(),
        mode: job.mode,
        preset: tables[job.preset].name().to_string(),
        presets: tables.iter().map(|table| table.name().to_string()).collect(),
        seed: job.seed,
        samples: job.samples,
        timesteps: job.activity.steps(),
        estimate,
        baselines: rows,
        early_exit: job.early_exit,
        constants: constant_entries(&job.target.constants()[job.preset]),
        notes,
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::base::diagnostic::SourceText;
    use crate::cli::common::SampleRange;
    use crate::cost::baseline::tests::vtsnn;
    use crate::cost::estimate::tests::{MS, run};
    use crate::desc::spanned::parse;
    use crate::desc::target::{Chip, Constants, TargetFile};
    use crate::ir::activity::{CoreCounts, StepActivity};

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
        let mesh = Mesh::of(target);
        Placement::new(mesh, (0..cores).map(|n| mesh.site(n).unwrap()).collect()).unwrap()
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
        let target = nahuku();
        let (tables, preset) = tables(&target, None).unwrap();
        let (activity, meter) = run(&steps(), tables, deployment.tiles_used);
        f(report(&EnergyJob {
            model: "vtsnn-slip",
            target: &target,
            shape: &vtsnn(),
            preset,
            activity: &activity,
            meter: &meter,
            copies_counted: 1,
            deployment,
            mode,
            convention,
            timestep: MS,
            steps_per_sample: Some(150),
            samples: 1,
            seed: Some(7),
            baselines: &baselines(None).unwrap(),
            early_exit: None,
        }))
    }

    #[test]
    fn defaults_are_those_of_the_contract() {
        let args = args(&[]).unwrap();
        assert_eq!(
            (args.job.model.as_str(), args.job.target.as_str(), args.copies, args.input.repeat),
            ("vtsnn-slip", "nahuku-32", 32, 1)
        );
        assert_eq!(
            (args.deployment, args.mode, args.convention),
            (DeploymentArg::Packed, ModeArg::Offline, ConventionArg::Physical)
        );
    }

    #[test]
    fn arguments_parse_or_are_refused() {
        let given = args(&["m.ron", "--samples", "3..5", "--deployment", "saved.ron", "--baseline", "a,b"]).unwrap();
        assert_eq!(
            (given.input.samples, given.deployment),
            (Some(SampleRange(3..5)), DeploymentArg::File("saved.ron".into()))
        );
        assert_eq!(given.baseline, Some(vec!["a".to_string(), "b".to_string()]));
        assert_eq!(args(&["--baseline"]).unwrap().baseline, Some(vec![]));
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
        let packed = deployment(&DeploymentArg::Packed, 32, &placement, &target).unwrap();
        assert_eq!((packed.cores_used, packed.cores_powered, packed.tiles_used, packed.x86_cores), (32, 32, 8, 1));
        let paper = deployment(&DeploymentArg::Paper, 32, &placement, &target).unwrap();
        assert_eq!((paper.cores_used, paper.cores_powered, paper.x86_cores), (594, 624, 5));
        let error = deployment(&DeploymentArg::Paper, 8, &placement, &target).unwrap_err();
        assert_eq!(error.exit_status(), 2);
        let static_mw = |deployment: &Deployment| {
            with_report(deployment, Mode::Offline, Convention::Physical, |r| r.estimate.rows[1].static_mw.unwrap())
        };
        assert!((static_mw(&paper) - 11.7).abs() < 1e-9);
        assert!(static_mw(&packed) < 11.7 / 5.0);
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
            deployment(&DeploymentArg::File(path.clone()), 2, &sequential(&target, 1), &target)
        };
        let core = |chip: u32, x: u32| format!("(chip: {chip}, x: {x}, y: 0, core: 1, holds: []),");
        let found = write(&(core(0, 0) + &core(0, 7) + &core(3, 0)), 2).unwrap();
        assert_eq!((found.cores_used, found.cores_powered, found.tiles_used, found.chips_used), (3, 12, 3, 2));
        assert_eq!(write(&core(0, 0), 3).unwrap_err().exit_status(), 2);
        assert_eq!(write(&core(0, 8), 2).unwrap_err().exit_status(), 3);
        assert_eq!(write(&(core(0, 1) + &core(0, 1)), 2).unwrap_err().exit_status(), 3);
        assert_eq!(write("oops", 2).unwrap_err().exit_status(), 3);
        let missing = DeploymentArg::File(folder.path().join("none.ron"));
        assert_eq!(deployment(&missing, 2, &sequential(&target, 1), &target).unwrap_err().exit_status(), 3);
    }

    #[test]
    fn a_preset_that_the_target_does_not_name_is_a_mistake_of_usage() {
        let target = nahuku();
        assert_eq!(tables(&target, Some("davies2018")).unwrap().1, 1);
        assert_eq!(tables(&target, Some("davies")).unwrap_err().exit_status(), 2);
    }

    #[test]
    fn what_the_text_prints_adds_up_in_both_directions() {
        for (mode, convention) in [
            (Mode::Offline, Convention::Physical),
            (Mode::Realtime, Convention::Physical),
            (Mode::Offline, Convention::Published),
        ] {
            for deployment in [Deployment::paper(), Deployment { copies: 31, ..Deployment::paper() }] {
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
        let report = with_report(&Deployment::paper(), Mode::Realtime, Convention::Published, |r| r);
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
        assert_eq!(json["constants"].as_array().unwrap().len(), 28 + 6);
        assert_eq!(json["constants"][0]["status"], "calibrated");
        assert_eq!(json["constants"][0]["unit"], "pJ");
    }

    #[test]
    fn csv_has_a_header_and_a_record_for_each_row() {
        let csv = with_report(&Deployment::paper(), Mode::Offline, Convention::Physical, |r| r.csv().unwrap());
        let mut reader = csv::Reader::from_reader(csv.as_bytes());
        assert_eq!(reader.headers().unwrap().len(), 16);
        let records: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
        assert_eq!(records.len(), 4);
        assert_eq!((&records[3][8], &records[3][9], &records[3][15]), ("26411.49", "", "published"));
    }
}
