//! What is typed behind `nsim energy`: deployments, modes, presets, and what they stand for.

use std::path::PathBuf;

use clap::ValueEnum;

use crate::base::diagnostic::Diagnostic;
use crate::cost::baseline::{Baseline, SHIPPED};
use crate::cost::estimate::Convention;
use crate::cost::{CostTable, Deployment, Transport};
use crate::desc::baseline::Mode;
use crate::desc::target::Target;
use crate::error::Error;
use crate::io;
use crate::ir::placement::{Mesh, Placement, Site};

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
    let presets = target.constants();
    let chosen = match preset {
        None => 0,
        Some(name) => presets.iter().position(|preset| preset.name == name).ok_or_else(|| {
            let names: Vec<&str> = presets.iter().map(|preset| preset.name.as_str()).collect();
            Error::Usage(format!("{} has no constants {name}; it has {}", target.name(), names.join(", ")))
        })?,
    };
    // The others show how far sources disagree; what a source does not give is no disagreement.
    let tables = presets.iter().enumerate().map(|(i, preset)| match i == chosen {
        true => CostTable::new(preset),
        false => CostTable::new(&preset.completed_by(&presets[chosen])),
    });
    Ok((tables.collect::<Result<Vec<_>, _>>()?, chosen))
}

/// The target with the preset that is asked for, which may be a file; returns the preset's name.
///
/// # Errors
/// [`Error::Input`] when the file cannot be used.
pub fn with_preset(target: Target, asked: Option<&str>) -> Result<(Target, Option<String>), Error> {
    match asked {
        Some(path) if io::shipped::is_path(path) => {
            let preset = io::target::load_constants(path)?;
            let name = preset.name.clone();
            Ok((target.with_preset(preset), Some(name)))
        }
        other => Ok((target, other.map(str::to_string))),
    }
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

/// `--transport`
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum TransportArg {
    /// The longest way, and the wait at the busiest link.
    Analytic,
    /// Every message through finite buffers, links and receivers one after the other.
    Queued,
}

impl From<TransportArg> for Transport {
    fn from(arg: TransportArg) -> Self {
        match arg {
            TransportArg::Analytic => Transport::Analytic,
            TransportArg::Queued => Transport::Queued,
        }
    }
}
