//! Meanings of options of `nsim energy`: deployments, presets, baselines.

use std::path::{Path, PathBuf};

use crate::baseline::Baseline;
use crate::published::scenario::{ScenarioFile, paper_for, scenario};
use nsim_compile as compile;
use nsim_compile::place::SAVED;
use nsim_compile::{CopyPlacement, Mapping, Options, mapping_file};
use nsim_cost::estimate::Convention;
use nsim_cost::job::{Accounting, DeployedCores, Mode};
use nsim_cost::{CostTable, Deployment, Host, HostWork, Streams, Transport};
use nsim_files as io;
use nsim_files::shipped::{BASELINES, CONSTANTS, Shipped};
use nsim_ir::base::diagnostic::Diagnostic;
use nsim_ir::base::names::did_you_mean;
use nsim_ir::hardware::Target;
use nsim_ir::hardware::constants::Status;
use nsim_ir::locate::root_name;
use nsim_ir::mapping::MappingFile;
use nsim_ir::quantised::Quantised;
use nsim_session::decision::Rule;
use nsim_session::error::{Error, Result};

/// Options of the cost of a run, and of its comparison.
#[derive(Debug, Default)]
pub struct CostOptions {
    /// Source of the input spikes; by default an x86 core of each chip that has one.
    pub host: Option<Host>,
    /// Input streams of a chip.
    pub streams: Streams,
    /// Words of a core that are reset after each sample; 0: no reset.
    pub reset_words: u64,
    /// As fast as possible, or paced by the model's timestep.
    pub mode: Mode,
    /// The convention of energy.
    pub convention: Convention,
    /// Other hardware to compare with.
    pub baselines: BaselineSelection,
    /// Power of this machine's processor, idle and busy.
    pub cpu_watts: Option<Watts>,
    /// A command that passes the same samples through a GPU.
    #[cfg(feature = "nvml")]
    pub gpu_command: Option<String>,
    /// A preset of the target, by name, or a file; its first when omitted.
    pub constants: Option<String>,
    /// The accounting of power.
    pub accounting: Accounting,
    /// The model of message transport.
    pub transport: Transport,
    /// Rule of early exit whose savings are reported.
    pub early_exit: Option<Rule>,
}

impl CostOptions {
    /// The defaults of `nsim energy`, compared with these baselines: all when `None`.
    ///
    /// # Errors
    /// A name that no baseline has.
    pub fn with_baselines(names: Option<&[String]>) -> Result<Self, Diagnostic> {
        Ok(CostOptions { baselines: baselines(names)?, ..CostOptions::default() })
    }

    /// Checks that a deployment has the x86 cores that the options require.
    ///
    /// # Errors
    /// [`Error::Usage`] for a host or a reset without an x86 core.
    pub(super) fn check_x86(&self, deployment: &Deployment, target: &Target) -> Result<(), Error> {
        let host = self.host.filter(|host| *host != Host::None).map(|host| format!("--host {}", host.name()));
        let resets = (self.reset_words > 0).then(|| "--reset-words".to_string());
        match host.or(resets).filter(|_| deployment.x86_cores == 0) {
            None => Ok(()),
            Some(option) => {
                let chip = if target.chip().x86_cores > 0 { ", or give x86 cores, CORES,CHIPS,X86" } else { "" };
                let name = &deployment.name;
                let message =
                    format!("{option} needs an x86 core, and deployment {name} has none: remove {option}{chip}");
                Err(Error::Usage(message))
            }
        }
    }

    /// Checks that a target has the power that the accounting reports.
    ///
    /// # Errors
    /// [`Error::Usage`] for the whole unit of a board of which no source prints it.
    pub(super) fn check_accounting(&self, target: &Target) -> Result<(), Error> {
        let preset = &target.constants()[0];
        if self.accounting != Accounting::Unit || preset.unit_power.status != Status::NotGiven {
            return Ok(());
        }
        Err(Error::Usage(format!(
            "--accounting unit: constants {} have no unit_power, the power of a whole {}; use rails or profiler",
            preset.name,
            target.name()
        )))
    }

    /// Returns the work of the x86 cores of a target.
    ///
    /// # Errors
    /// [`Error::Usage`] for a host on a chip without x86 cores.
    pub(super) fn host_work(&self, target: &Target, steps_per_sample: u32) -> Result<HostWork, Error> {
        let work = HostWork::fed_by(self.host, target)
            .map_err(|problem| Error::Usage(format!("--host {problem}; remove --host")))?;
        Ok(HostWork { streams: self.streams, reset_words: self.reset_words, steps_per_sample, ..work })
    }
}

/// Returns the target with the requested preset first, and that preset in integers. `asked` may be
/// a file, or a shipped preset that the target does not name; `None` is the target's first preset.
///
/// # Errors
/// [`Error::Usage`] for an unknown preset, [`Error::Input`] for a file or a constant out of range.
pub fn select_constants(target: Target, asked: Option<&str>) -> Result<(Target, CostTable)> {
    let presets = target.constants();
    let chosen = match asked {
        None => presets[0].clone(),
        Some(path) if io::shipped::is_path(path) => io::target::load_constants(path)?,
        Some(name) => match presets.iter().find(|preset| preset.name == name) {
            Some(preset) => preset.clone(),
            None if Shipped::find(CONSTANTS, name).is_some() => io::target::load_constants(name)?,
            None => {
                let names: Vec<&str> = presets.iter().map(|preset| preset.name.as_str()).collect();
                let (meant, names) = (did_you_mean(name, names.iter().copied()), names.join(", "));
                return Err(Error::Usage(format!(
                    "{} has no constants {name}; {meant}its constants are {names}",
                    target.name()
                )));
            }
        },
    };
    let table = CostTable::new(&chosen)?;
    Ok((target.with_preset(chosen), table))
}

/// Deployments that a message offers in place of a published job.
const OTHER_DEPLOYMENTS: &str = "use spread, packed, CORES,CHIPS,X86, or the file of a scenario or of a saved mapping";

/// `--deployment` with its loaded files.
#[derive(Debug)]
pub enum DeploymentSource {
    /// The mapping's own cores: copies on as many chips as there are, or on as few as they fill.
    Mapped(CopyPlacement),
    /// A published job: the shipped scenario of the model, or a file.
    Scenario(String, Box<ScenarioFile>),
    /// A saved mapping.
    Mapping(PathBuf, Box<MappingFile>),
    /// Cores, chips and x86 cores as given.
    Numbers(DeployedCores),
}

impl DeploymentSource {
    /// Loads a named deployment.
    ///
    /// # Errors
    /// [`Error::Usage`] when the paper's deployment is requested and no scenario ships for the
    /// model, [`Error::Input`] when a file cannot be used.
    pub fn load(named: &str, model: &str) -> Result<Self> {
        if let Some(&copies) = CopyPlacement::ALL.iter().find(|copies| copies.name() == named) {
            return Ok(DeploymentSource::Mapped(copies));
        }
        let numbers: Option<Vec<u64>> = named.split(',').map(|part| part.trim().parse().ok()).collect();
        if let Some(&[cores_used, chips_used, x86_cores]) = numbers.as_deref() {
            if [cores_used, chips_used].contains(&0) || cores_used < chips_used {
                let message = "--deployment CORES,CHIPS,X86: at least one core on each chip, such as 100,2,2";
                return Err(Error::Usage(message.to_string()));
            }
            return Ok(DeploymentSource::Numbers(DeployedCores { cores_used, chips_used, x86_cores }));
        }
        if named == "paper" {
            let scenario = paper_for(model)?.ok_or_else(|| {
                Error::Usage(format!("--deployment paper: no scenario ships for {model}; {OTHER_DEPLOYMENTS}"))
            })?;
            return Ok(DeploymentSource::Scenario("paper".to_string(), Box::new(scenario)));
        }
        const CHOICES: &str =
            "--deployment is spread, packed, paper, CORES,CHIPS,X86, a scenario, or a mapping saved by nsim map -o";
        let source = io::text::read_text(Path::new(named));
        let source = source.map_err(|error| if error.code == "io.missing" { error.help(CHOICES) } else { error })?;
        if root_name(source.text()) == "Scenario" {
            let scenario = scenario(&source)?;
            return Ok(DeploymentSource::Scenario(named.to_string(), Box::new(scenario)));
        }
        let mapping = io::mapping::mapping(&source).map_err(|error| match error.help {
            None => error.help(CHOICES),
            Some(_) => error,
        })?;
        Ok(DeploymentSource::Mapping(named.into(), Box::new(mapping)))
    }

    /// Checks that a scenario is of this network.
    ///
    /// # Errors
    /// [`Error::Usage`] with the inputs of both.
    pub(super) fn check_network(&self, network: &Quantised) -> Result<()> {
        let DeploymentSource::Scenario(name, scenario) = self else { return Ok(()) };
        if scenario.serves(network) {
            return Ok(());
        }
        fn sizes(sizes: &[u32]) -> String {
            sizes.iter().map(u32::to_string).collect::<Vec<_>>().join(" and ")
        }
        let own = sizes(&network.inputs().map(|(_, population)| population.shape.len()).collect::<Vec<_>>());
        let wanted = match scenario.inputs.as_slice() {
            [] => format!("model {}", scenario.model),
            inputs => format!("networks with inputs of {} channels, as {}", sizes(inputs), scenario.model),
        };
        let model = &network.parts().name;
        Err(Error::Usage(format!(
            "--deployment {name} is for {wanted}, not {model} with inputs of {own}; {OTHER_DEPLOYMENTS}"
        )))
    }

    /// The numbers of cores of `copies` copies of a mapped network.
    ///
    /// # Errors
    /// [`Error::Usage`] when a scenario is of another model; [`Error::Input`] when a saved mapping
    /// is not one of `copies` copies of this network on this target.
    pub fn deployment(&self, compiled: &Mapping, target: &Target, copies: u32, work: HostWork) -> Result<Deployment> {
        self.check_network(&compiled.one)?;
        match self {
            DeploymentSource::Mapped(_) => {
                // Copies that do not fit on separate chips are packed.
                let spread = compiled.placement.chips_used() >= copies.min(target.chips());
                let name = match compiled.options.placement {
                    _ if compiled.placed == SAVED => "saved mapping",
                    CopyPlacement::Spread if spread => CopyPlacement::Spread.name(),
                    _ => CopyPlacement::Packed.name(),
                };
                Ok(Deployment::from_placement(name, &compiled.placement, target, copies, work))
            }
            DeploymentSource::Scenario(name, scenario) => {
                let (own, of) = (&scenario.target, scenario.copies.value);
                if !scenario.is_on(target) {
                    let changed = if own == target.name() { " with --set" } else { "" };
                    let message = format!("--deployment {name} is for target {own}, not {}{changed}", target.name());
                    return Err(Error::Usage(format!("{message}; use --target {own}, spread or packed")));
                }
                if copies != of {
                    return Err(Error::Usage(format!("--deployment {name} has {of} copies; remove --copies {copies}")));
                }
                let cores = scenario.deployment.value;
                check_numbers(name, cores, target)?;
                Ok(Deployment::from_numbers(name, cores, target, copies, work))
            }
            DeploymentSource::Numbers(cores) => {
                let DeployedCores { cores_used, chips_used, x86_cores } = *cores;
                check_numbers(&format!("{cores_used},{chips_used},{x86_cores}"), *cores, target)?;
                Ok(Deployment::from_numbers("as given", *cores, target, copies, work))
            }
            DeploymentSource::Mapping(path, mapping) => {
                // A mapping that could not be run is no deployment either.
                let options = Options { copies, ..Options::default() };
                let loaded = compile::load(compiled.one.clone(), target, &options, mapping)
                    .map_err(|error| mapping_file::explained(error, path, "MODEL"))?;
                if loaded.placement.is_empty() {
                    let message = "the mapping has no core, so it has no cost";
                    return Err(Diagnostic::new("mapping.missing", message).in_file(path).into());
                }
                let name = path.display().to_string();
                Ok(Deployment::from_placement(name, &loaded.placement, target, copies, work))
            }
        }
    }
}

/// Checks that a target has these numbers of cores.
///
/// # Errors
/// [`Error::Usage`] that names the first number that the target lacks.
fn check_numbers(named: &str, cores: DeployedCores, target: &Target) -> Result<()> {
    let DeployedCores { cores_used, chips_used, x86_cores } = cores;
    let (chip, chips) = (target.chip(), u64::from(target.chips()));
    let most = |of_chip: u32| (chips_used * u64::from(of_chip), format!("{of_chip} on each of {chips_used} chips"));
    let (most_cores, of_cores) = most(chip.cores);
    let (most_x86, of_x86) = most(chip.x86_cores);
    let what = match () {
        () if chips_used > chips => format!("{chips_used} chips, and {} has {chips}", target.name()),
        () if cores_used > most_cores => format!("{cores_used} neuron cores, and {} has {of_cores}", target.name()),
        () if x86_cores > most_x86 => format!("{x86_cores} x86 cores, and {} has {of_x86}", target.name()),
        () if x86_cores > 0 && x86_cores < chips_used => {
            format!("{chips_used} chips share {x86_cores} x86 cores, but each chip in use needs its own")
        }
        () => return Ok(()),
    };
    Err(Error::Usage(format!("--deployment {named}: {what}; numbers are CORES,CHIPS,X86")))
}

/// The requested baselines.
#[derive(Debug, Default)]
pub struct BaselineSelection {
    /// Baselines from files.
    pub files: Vec<Baseline>,
    /// Whether this machine's processor is measured.
    pub cpu: bool,
    /// Whether a GPU that was not measured for the network is modelled by its roofline.
    pub roofline: bool,
}

/// Returns the requested baselines; all files and this machine's processor when `names` is `None`.
///
/// # Errors
/// A diagnostic for a name that does not exist.
pub fn baselines(names: Option<&[String]>) -> Result<BaselineSelection, Diagnostic> {
    let all = || BASELINES.iter().map(|shipped| Baseline::shipped(shipped.name)).collect::<Result<Vec<_>, _>>();
    let Some(names) = names else {
        return Ok(BaselineSelection { files: all()?, cpu: true, roofline: false });
    };
    let roofline = names.iter().any(|name| name == ROOFLINE);
    let mut files = Vec::new();
    for name in names.iter().filter(|name| ![CPU, ROOFLINE].contains(&name.as_str())) {
        files.push(Baseline::shipped(name).map_err(|problem: Diagnostic| {
            let known: Vec<&str> = BASELINES.iter().map(|shipped| shipped.name).chain([CPU, ROOFLINE]).collect();
            problem.help(format!("baselines are {}; --baseline without a name hides all", known.join(", ")))
        })?);
    }
    if roofline && files.is_empty() {
        files = all()?;
    }
    Ok(BaselineSelection { files, cpu: names.iter().any(|name| name == CPU), roofline })
}

/// The name of the baseline that is measured on this machine.
pub const CPU: &str = "cpu";
/// The name of the baseline that models a GPU from its peak rates.
pub const ROOFLINE: &str = "gpu-roofline";

/// `--cpu-watts`: at idle and busy, in mW.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watts(pub f64, pub f64);

impl std::str::FromStr for Watts {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not IDLE,BUSY in watts, such as 10,65");
        let (idle, busy) = text.split_once(',').ok_or_else(wrong)?;
        fn watts(text: &str) -> Option<f64> {
            text.trim().parse::<f64>().ok().filter(|w| (0.0..=1e6).contains(w))
        }
        let (idle, busy) = (watts(idle).ok_or_else(wrong)?, watts(busy).ok_or_else(wrong)?);
        if idle <= busy { Ok(Watts(1e3 * idle, 1e3 * busy)) } else { Err(wrong()) }
    }
}
