//! What options of `nsim energy` stand for: deployments, presets, baselines.

use std::path::PathBuf;

use crate::base::diagnostic::Diagnostic;
use crate::base::names::did_you_mean;
use crate::base::names::named_variants;
use crate::compile::mapping_file;
use crate::cost::baseline::{Baseline, SHIPPED};
use crate::cost::evidence;
use crate::cost::{CostTable, Deployment};
use crate::desc::mapping::MappingFile;
use crate::desc::published::scenario::ScenarioFile;
use crate::desc::published::workload::Accounting;
use crate::desc::spanned::{parse, root_name};
use crate::desc::target::Target;
use crate::error::{Error, Result};
use crate::io;
use crate::ir::placement::{Mesh, Placement};

/// `--deployment`
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum DeploymentArg {
    /// The mapping's own cores.
    Packed,
    /// Those of the scenario that ships for the model.
    Paper,
    /// Those of a saved mapping or of a scenario.
    File(PathBuf),
}

/// `--host`
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HostArg {
    /// An x86 core on each chip in use, as on the boards.
    Board,
    /// None: the chips alone.
    None,
}

named_variants!(HostArg { Board = "board", None = "none" });

impl From<&str> for DeploymentArg {
    fn from(text: &str) -> Self {
        match text {
            "packed" => DeploymentArg::Packed,
            "paper" => DeploymentArg::Paper,
            path => DeploymentArg::File(path.into()),
        }
    }
}

/// The target with the preset that is asked for in front, and that preset in integers, and behind it, for each group of constants that are wrong together, the preset with
/// that group at the low and at the high end of its intervals.
///
/// # Errors
/// [`Error::Usage`] for a preset that the target does not name, [`Error::Input`] for a constant that no integer holds.
pub fn tables(target: Target, preset: Option<&str>) -> Result<(Target, Vec<CostTable>)> {
    let presets = target.constants();
    let chosen = match preset {
        None => &presets[0],
        Some(name) => presets.iter().find(|preset| preset.name == name).ok_or_else(|| {
            let names: Vec<&str> = presets.iter().map(|preset| preset.name.as_str()).collect();
            let meant = did_you_mean(name, names.iter().copied());
            Error::Usage(format!("{} has no constants {name}; {meant}it has {}", target.name(), names.join(", ")))
        })?,
    };
    let chosen = chosen.clone();
    let ends = evidence::ends(&io::published::evidence::shipped()?, &chosen);
    let tables = std::iter::once(&chosen).chain(&ends).map(CostTable::new).collect::<Result<Vec<_>, _>>()?;
    Ok((target.with_preset(chosen), tables))
}

/// The target with the preset that is asked for, which may be a file, or with that of the published job whose deployment it is;
/// returns the preset's name.
///
/// # Errors
/// [`Error::Input`] when the file cannot be used, [`Error::Usage`] for the board's accounting of another preset than the evidence's.
pub fn with_preset(
    target: Target,
    asked: Option<&str>,
    scenario: Option<&ScenarioFile>,
    accounting: Accounting,
) -> Result<(Target, Option<String>)> {
    let of_job = scenario.and_then(|scenario| scenario.constants.as_ref()).filter(|_| asked.is_none());
    if let Some(name) = of_job {
        let preset = io::target::load_constants(&name.value)?;
        return Ok((target.with_preset(preset), Some(name.value.clone())));
    }
    if accounting == Accounting::Board {
        let evidence = io::published::evidence::shipped()?;
        let base = io::target::load_constants(&evidence.base.value)?;
        let default = target.constants().first().map(|preset| preset.name.clone());
        if asked.map(str::to_string).or(default) != Some(evidence::preset(&evidence, &base, Accounting::Profiler).name)
        {
            let advice = "--accounting board chooses among the findings of the evidence: leave out --constants, or name that preset";
            return Err(Error::Usage(advice.to_string()));
        }
        let preset = evidence::preset(&evidence, &base, accounting);
        let name = preset.name.clone();
        return Ok((target.with_preset(preset), Some(name)));
    }
    match asked {
        Some(path) if io::shipped::is_path(path) => {
            let preset = io::target::load_constants(path)?;
            let name = preset.name.clone();
            Ok((target.with_preset(preset), Some(name)))
        }
        other => Ok((target, other.map(str::to_string))),
    }
}

/// `--deployment` with what it names.
#[derive(Debug)]
pub enum DeploymentSource {
    /// The mapping's own cores.
    Packed,
    /// A published job.
    Scenario(String, Box<ScenarioFile>),
    /// A saved mapping.
    Mapping(PathBuf, Box<MappingFile>),
}

impl DeploymentSource {
    /// Loads what is named.
    ///
    /// # Errors
    /// [`Error::Usage`] when the paper's deployment is asked for and no scenario ships for the model, [`Error::Input`]
    /// when a file cannot be used.
    pub fn load(arg: &DeploymentArg, model: &str, shipped: Option<&ScenarioFile>) -> Result<Self> {
        let path = match (arg, shipped) {
            (DeploymentArg::Packed, _) => return Ok(DeploymentSource::Packed),
            (DeploymentArg::Paper, Some(scenario)) => {
                return Ok(DeploymentSource::Scenario("paper".to_string(), Box::new(scenario.clone())));
            }
            (DeploymentArg::Paper, None) => {
                return Err(Error::Usage(format!(
                    "--deployment paper: no scenario ships for {model}; use --deployment packed, or the file of a scenario or \
                     of a saved mapping"
                )));
            }
            (DeploymentArg::File(path), _) => path,
        };
        let source = io::text::read_text(path)?;
        if root_name(source.text()) == "Scenario" {
            let scenario = io::published::scenario::scenario(&source)?;
            return Ok(DeploymentSource::Scenario(path.display().to_string(), Box::new(scenario)));
        }
        let mapping = parse(&source, "mapping.syntax").map_err(|error| match error.help {
            None => error.help("--deployment is packed, paper, a scenario, or a mapping saved by nsim map -o"),
            Some(_) => error,
        })?;
        Ok(DeploymentSource::Mapping(path.clone(), Box::new(mapping)))
    }

    /// The numbers of cores for the report. The placement holds all copies.
    ///
    /// # Errors
    /// [`Error::Usage`] when a scenario is of another model, or it or a saved mapping of another number of copies or
    /// another target; [`Error::Input`] when a saved mapping places cores where the target has none.
    pub fn deployment(&self, model: &str, copies: u32, placement: &Placement, target: &Target) -> Result<Deployment> {
        match self {
            DeploymentSource::Packed => Ok(Deployment::from_placement("packed", placement, target.chip(), copies)),
            DeploymentSource::Scenario(name, scenario) => {
                if scenario.copies.value != copies {
                    return Err(Error::Usage(format!(
                        "--deployment {name} is of {0} copies, not {copies}: ask for {0} or use --deployment packed",
                        scenario.copies.value
                    )));
                }
                if scenario.model != model {
                    return Err(Error::Usage(format!("--deployment {name} is of {}, not {model}", scenario.model)));
                }
                Ok(Deployment::from_scenario(name, scenario))
            }
            DeploymentSource::Mapping(path, mapping) => {
                if mapping.copies != copies || mapping.target != target.name() {
                    return Err(Error::Usage(format!(
                        "{} holds {} copies on {}, not {copies} on {}",
                        path.display(),
                        mapping.copies,
                        mapping.target,
                        target.name()
                    )));
                }
                let placement =
                    mapping_file::placement(mapping, Mesh::for_target(target)).map_err(|error| error.in_file(path))?;
                let name = path.display().to_string();
                Ok(Deployment::from_placement(name, &placement, target.chip(), copies))
            }
        }
    }
}

/// The baselines that are asked for.
#[derive(Debug)]
pub struct BaselineSelection {
    /// From files.
    pub files: Vec<Baseline>,
    /// Whether this machine's processor is measured.
    pub cpu: bool,
}

/// The baselines asked for: all when none is named.
///
/// # Errors
/// A diagnostic for a name that does not exist.
pub fn baselines(names: Option<&[String]>) -> Result<BaselineSelection, Diagnostic> {
    let Some(names) = names else {
        let files = SHIPPED.iter().map(|(name, _)| Baseline::shipped(name)).collect::<Result<_, _>>()?;
        return Ok(BaselineSelection { files, cpu: true });
    };
    let files = names.iter().filter(|name| *name != CPU).map(|name| Baseline::shipped(name));
    let files = files.collect::<Result<_, _>>().map_err(|problem: Diagnostic| {
        let known: Vec<&str> = SHIPPED.iter().map(|&(name, _)| name).chain([CPU]).collect();
        problem.help(format!("baselines are {}", known.join(", ")))
    })?;
    Ok(BaselineSelection { files, cpu: names.iter().any(|name| name == CPU) })
}

/// The name of the baseline that is measured on this machine.
pub const CPU: &str = "cpu";

/// `--cpu-watts`: at idle and busy, in mW.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Watts(pub f64, pub f64);

impl std::str::FromStr for Watts {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not IDLE,BUSY in watts, such as 10,65");
        let (idle, busy) = text.split_once(',').ok_or_else(wrong)?;
        let watts = |text: &str| text.trim().parse::<f64>().ok().filter(|w| (0.0..=1e6).contains(w));
        let (idle, busy) = (watts(idle).ok_or_else(wrong)?, watts(busy).ok_or_else(wrong)?);
        if idle <= busy { Ok(Watts(1e3 * idle, 1e3 * busy)) } else { Err(wrong()) }
    }
}
