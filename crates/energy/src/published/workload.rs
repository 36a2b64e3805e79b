//! Published workloads (`mapping/workloads`): networks measured on the chip, rebuilt as closely as
//! their sources allow, and their printed figures.
//!
//! Input: the name of a shipped workload. Output: a [`WorkloadFile`] whose shapes and rates are
//! possible and whose projections join populations of the file. Errors: `workload.syntax`,
//! `workload.population`, `workload.rate`, `workload.layout`, `workload.figure`.
//!
//! A rate that no source prints is a range and marked assumed; the range enters the interval of
//! every figure that follows from it. A workload has no weights: they only decide which
//! compartments fire, and the rates give the number that fires.

use serde::{Deserialize, Serialize};

use nsim_cost::job::{Accounting, Host};
use nsim_files::shipped;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::base::names::named_variants;
use nsim_ir::hardware::constants::{FigureClass, Status};
use nsim_ir::spanned::{Spanned, parse};

/// Physical kind of a figure.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all(serialize = "lowercase"))]
pub enum FigureKind {
    /// Energy, of a step or of an inference.
    Energy,
    /// Power.
    Power,
    /// Time, of a step or of an inference.
    Time,
}

named_variants! {
    /// A figure that a model of cost can predict.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
    pub enum Quantity {
        /// Static power of the neuron cores in use, mW.
        CoreStaticPower = "core static power",
        /// Dynamic power of the neuron cores and their mesh, mW.
        CoreDynamicPower = "core dynamic power",
        /// Static power of the x86 cores that run, mW.
        X86StaticPower = "x86 static power",
        /// Dynamic power of these x86 cores, mW.
        X86DynamicPower = "x86 dynamic power",
        /// Dynamic power of neuron and x86 cores, mW.
        DynamicPower = "dynamic power",
        /// Power of the whole board once a program is loaded, before it runs, mW.
        RailsIdle = "rails, idle",
        /// Power of the loaded board less the clocks of the x86 cores, mW.
        RailsStatic = "rails, static",
        /// Power of the whole board while it runs, mW.
        RailsTotal = "rails, running",
        /// Power of the running board without the events of neuron cores, mW.
        RailsEmpty = "rails, no events",
        /// Power of the running board less the power of the loaded board, mW.
        AboveLoaded = "rails above idle",
        /// Power of the running board less its power before a program is loaded, mW.
        AboveBoot = "rails above boot",
        /// Time of a step, us.
        StepTime = "step time",
        /// Time of a step without the work of x86 cores, us.
        SpikingTime = "spiking time",
        /// Part of a step's time in which x86 cores take their turn and reset state, us.
        ManagementTime = "management time",
        /// Dynamic energy of neuron and x86 cores in an inference, uJ.
        InferenceDynamicEnergy = "energy of an inference",
    }
}

impl Quantity {
    /// Its physical kind.
    pub fn kind(self) -> FigureKind {
        match self {
            Quantity::StepTime | Quantity::SpikingTime | Quantity::ManagementTime => FigureKind::Time,
            Quantity::InferenceDynamicEnergy => FigureKind::Energy,
            _ => FigureKind::Power,
        }
    }

    /// The unit of its figures.
    pub fn unit(self) -> &'static str {
        match self.kind() {
            FigureKind::Power => "mW",
            FigureKind::Time => "us",
            FigureKind::Energy => "uJ",
        }
    }

    /// The accounting to which it belongs.
    pub fn accounting(self) -> Accounting {
        use Quantity::{AboveBoot, AboveLoaded, RailsEmpty, RailsIdle, RailsStatic, RailsTotal};
        match self {
            RailsIdle | RailsStatic | RailsTotal | RailsEmpty | AboveLoaded | AboveBoot => Accounting::Rails,
            _ => Accounting::Profiler,
        }
    }

    /// The class of its error; `None` for sums and differences, which no class bounds.
    pub fn class(self) -> Option<FigureClass> {
        Some(match self {
            Quantity::CoreStaticPower | Quantity::X86StaticPower => FigureClass::Static,
            Quantity::CoreDynamicPower => FigureClass::CoreDynamic,
            Quantity::X86DynamicPower => FigureClass::X86Dynamic,
            Quantity::RailsIdle | Quantity::RailsStatic | Quantity::RailsTotal | Quantity::RailsEmpty => {
                FigureClass::Rails
            }
            Quantity::StepTime | Quantity::SpikingTime | Quantity::ManagementTime => FigureClass::Time,
            Quantity::DynamicPower | Quantity::AboveLoaded | Quantity::AboveBoot | Quantity::InferenceDynamicEnergy => {
                return None;
            }
        })
    }
}

/// A printed number, or a range for a number that no source prints.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Between {
    /// The value used.
    pub value: f64,
    /// Lower bound; equal to the value where it is published.
    pub low: f64,
    /// Upper bound.
    pub high: f64,
}

/// A population of a workload.
#[derive(Debug, Clone, Deserialize)]
pub enum WorkloadPopulation {
    /// Input channels.
    Input {
        /// Its name.
        name: String,
        /// Channels, height, width; or one number.
        shape: Vec<u32>,
        /// Spikes a channel and step, the mean over channels and steps.
        rate: Between,
    },
    /// Compartments.
    Layer {
        /// Its name.
        name: String,
        /// Channels, height, width; or one number.
        shape: Vec<u32>,
        /// Spikes a compartment and step, the mean over compartments and steps.
        rate: Between,
    },
    /// A compartment for each input unit, which forwards its spikes a step later.
    Relay {
        /// Its name.
        name: String,
        /// The input population.
        of: String,
        /// Its shape, equal to the shape of the input.
        shape: Vec<u32>,
    },
}

/// Synapses of a workload.
#[derive(Debug, Clone, Deserialize)]
pub enum WorkloadProjection {
    /// All to all.
    Dense {
        /// Source.
        from: String,
        /// Target.
        to: String,
    },
    /// A convolution without padding.
    Conv {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Side of the kernel.
        kernel: u32,
        /// Stride.
        stride: u32,
    },
    /// Synapses of each source, spread evenly over `reach` targets around its own position.
    Local {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Number of synapses of a source.
        fan_out: u32,
        /// Number of targets over which they are spread.
        reach: u32,
    },
    /// `fan_out` synapses of each source to random targets.
    Random {
        /// Source.
        from: String,
        /// Target.
        to: String,
        /// Number of synapses of a source.
        fan_out: u32,
    },
}

/// Hardware in use, for all copies together.
#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkloadDeployment {
    /// Copies of the network.
    pub copies: u32,
    /// Neuron cores in use.
    pub cores_used: u64,
    /// Chips in use.
    pub chips_used: u64,
    /// Chips on the board.
    pub board_chips: u64,
    /// x86 cores that run.
    pub x86_cores: u64,
    /// Number of these that inject or reset; all if absent.
    #[serde(default)]
    pub x86_working: Option<u64>,
}

/// Work of the host.
#[derive(Debug, Clone, Copy, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkloadHost {
    /// Source of the input spikes.
    #[serde(default)]
    pub host: Host,
    /// Words of 32 bits that the slowest x86 core sets to zero for each inference.
    #[serde(default)]
    pub reset_words: u64,
    /// Words besides spikes that the host sends to a chip for each inference.
    #[serde(default)]
    pub sent_words: u64,
}

/// Layers that a source placed on separate cores.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LayerCores {
    /// The layers, placed sequentially on these cores.
    pub layers: Vec<Spanned<String>>,
    /// Cores of one copy, filled evenly.
    pub cores: u32,
    /// Whether a core holds whole columns, all rows and channels, not consecutive compartments.
    #[serde(default)]
    pub stripes: bool,
    /// Whether the source does not print the fullest core: an even cut is predicted, and the upper
    /// bound has all compartments but one a core on the first.
    #[serde(default)]
    pub uneven: bool,
}

/// A network of a family: its name after the family's, and what differs.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WorkloadCase {
    /// Its name.
    pub name: String,
    /// Compartments of every layer.
    pub neurons: u32,
    /// Cores in use, and of the first part of the layout.
    pub cores: u32,
    /// Synapses of a source of random projections.
    pub fan_out: u32,
    /// The figures' values, in the order of `figures`.
    pub published: Vec<f64>,
}

/// The unit to which a printed figure refers.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
pub enum Per {
    /// The whole job or board.
    #[default]
    Job,
    /// One copy.
    Copy,
    /// One x86 core.
    X86Core,
    /// One chip of the board.
    Chip,
}

/// A printed figure.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedFigure {
    /// What was published: an energy, a power or a time.
    pub quantity: Quantity,
    /// Its value in the quantity's unit.
    pub published: Spanned<f64>,
    /// The unit to which it refers.
    #[serde(default)]
    pub per: Per,
    /// Place where it is printed, or its derivation from printed figures.
    pub source: String,
    /// Cause of a large error of prediction, where it is known.
    #[serde(default)]
    pub cause: Option<String>,
}

/// A workload file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Workload")]
pub struct WorkloadFile {
    /// Its name.
    pub name: String,
    /// The published work, whose figures are judged together.
    pub work: String,
    /// Its authors, whose findings its prediction omits.
    pub group: String,
    /// Paper and section, or repository and file.
    pub source: String,
    /// Whether the figures were read in their first publication; other figures do not count.
    pub first_hand: bool,
    /// Whether the firing rates are published, or follow the rule for unpublished rates.
    pub activity: Status,
    /// The assumptions.
    pub assumed: Vec<String>,
    /// Name or file of the target on which it ran.
    pub target: Spanned<String>,
    /// The populations.
    pub populations: Vec<WorkloadPopulation>,
    /// The projections.
    pub projections: Vec<WorkloadProjection>,
    /// Share of steps in which a compartment is active; by default all.
    #[serde(default = "always")]
    pub active_share: Between,
    /// Cores of each layer, as the source printed or placed them.
    pub layout: Vec<LayerCores>,
    /// Whether its neurons are programs that the authors wrote.
    #[serde(default)]
    pub microcode: bool,
    /// Whether activity and layout are known well enough to judge the model by its figures.
    #[serde(default = "judges")]
    pub judges: bool,
    /// The networks of a family, each a workload of its own; without any, the file is one.
    #[serde(default)]
    pub cases: Vec<WorkloadCase>,
    /// Hardware in use.
    pub deployment: WorkloadDeployment,
    /// Work of the host.
    pub host: WorkloadHost,
    /// Steps of an inference.
    pub steps: u32,
    /// Fixed time of a step, us, where the source states one.
    #[serde(default)]
    pub paced_us: Option<f64>,
    /// The figures.
    pub figures: Vec<PublishedFigure>,
}

/// Most workloads judge the model.
fn judges() -> bool {
    true
}

/// A share of 1: every step.
fn always() -> Between {
    Between { value: 1.0, low: 1.0, high: 1.0 }
}

impl WorkloadPopulation {
    /// Name, shape and rate; a relay has no rate of its own.
    pub fn parts(&self) -> (&str, &[u32], Option<Between>) {
        match self {
            WorkloadPopulation::Input { name, shape, rate } | WorkloadPopulation::Layer { name, shape, rate } => {
                (name, shape, Some(*rate))
            }
            WorkloadPopulation::Relay { name, shape, .. } => (name, shape, None),
        }
    }
}

impl WorkloadProjection {
    /// Source and target.
    pub fn ends(&self) -> [&str; 2] {
        match self {
            WorkloadProjection::Dense { from, to }
            | WorkloadProjection::Conv { from, to, .. }
            | WorkloadProjection::Local { from, to, .. }
            | WorkloadProjection::Random { from, to, .. } => [from, to],
        }
    }
}

/// Maximum number of units of a population.
const MOST_UNITS: u64 = 1 << 22;

fn is_ordered(range: Between) -> bool {
    0.0 <= range.low && range.low <= range.value && range.value <= range.high
}

/// Returns every shipped workload, in the order of tables.
///
/// # Errors
/// As [`workload`].
pub fn shipped() -> Result<Vec<WorkloadFile>> {
    let families = shipped::WORKLOADS.iter().map(|file| Ok(cases(workload(&file.source())?)));
    Ok(families.collect::<Result<Vec<_>>>()?.concat())
}

/// The networks of a family.
fn cases(family: WorkloadFile) -> Vec<WorkloadFile> {
    if family.cases.is_empty() {
        return vec![family];
    }
    family.cases.iter().map(|case| one_of(&family, case)).collect()
}

/// A network of a family.
fn one_of(family: &WorkloadFile, case: &WorkloadCase) -> WorkloadFile {
    let mut file = WorkloadFile { name: format!("{}-{}", family.name, case.name), ..family.clone() };
    for population in &mut file.populations {
        if let WorkloadPopulation::Layer { shape, .. } = population {
            *shape = vec![case.neurons];
        }
    }
    for projection in &mut file.projections {
        if let WorkloadProjection::Random { fan_out, .. } = projection {
            *fan_out = case.fan_out;
        }
    }
    if let Some(part) = file.layout.first_mut() {
        part.cores = case.cores;
    }
    file.deployment.cores_used = case.cores.into();
    for (figure, published) in file.figures.iter_mut().zip(&case.published) {
        figure.published = (*published).into();
    }
    file
}

/// Parses and checks a workload.
///
/// # Errors
/// A diagnostic where the file is malformed or contradicts itself.
pub fn workload(source: &SourceText) -> Result<WorkloadFile> {
    let file: WorkloadFile = parse(source, "workload.syntax")?;
    let wrong = |code, message: String| Err(Diagnostic::new(code, message).in_file(source.path()));
    for population in &file.populations {
        let (name, shape, rate) = population.parts();
        let units: u64 = shape.iter().map(|&side| u64::from(side)).product();
        if !matches!(shape.len(), 1 | 3) || !(1..=MOST_UNITS).contains(&units) {
            return wrong("workload.population", format!("{name}: a shape is one number or three, at most 2^22 units"));
        }
        if rate.is_some_and(|rate| !is_ordered(rate) || rate.high > 0.5) {
            return wrong("workload.rate", format!("{name}: rates are 0 <= low <= value <= high <= 0.5"));
        }
        if let WorkloadPopulation::Relay { of, .. } = population {
            let is_source = |other: &WorkloadPopulation| {
                let (own, of_shape, _) = other.parts();
                matches!(other, WorkloadPopulation::Input { .. }) && own == of && of_shape == shape
            };
            if !file.populations.iter().any(is_source) {
                return wrong("workload.population", format!("{name}: there is no input population {of} of its shape"));
            }
        }
    }
    for projection in &file.projections {
        for end in projection.ends() {
            if !file.populations.iter().any(|population| population.parts().0 == end) {
                return wrong("workload.population", format!("there is no population {end}"));
            }
        }
    }
    if let Some(case) = file.cases.iter().find(|case| case.published.len() != file.figures.len() || case.neurons == 0) {
        return wrong("workload.figure", format!("{}: a case has neurons, and a value for each figure", case.name));
    }
    if let Some(figure) = file.figures.iter().find(|figure| !figure.published.value.is_finite()) {
        let problem = Diagnostic::new("workload.figure", "a figure is a finite number");
        return Err(problem.at(source, figure.published.span));
    }
    if !is_ordered(file.active_share) || file.active_share.high > 1.0 {
        return wrong("workload.rate", "active_share is 0 <= low <= value <= high <= 1".to_string());
    }
    let mut placed: Vec<&str> = Vec::new();
    for name in file.layout.iter().flat_map(|part| &part.layers) {
        let is_layer = |other: &WorkloadPopulation| {
            !matches!(other, WorkloadPopulation::Input { .. }) && other.parts().0 == name.value
        };
        if placed.contains(&name.value.as_str()) || !file.populations.iter().any(is_layer) {
            let message = format!("{} is not a layer, or is on cores twice", name.value);
            return Err(Diagnostic::new("workload.layout", message).at(source, name.span));
        }
        placed.push(&name.value);
    }
    let layers = file.populations.iter().filter(|one| !matches!(one, WorkloadPopulation::Input { .. })).count();
    if placed.len() != layers || file.layout.iter().any(|part| part.cores == 0) {
        return wrong("workload.layout", "every layer is on one core at least".to_string());
    }
    let WorkloadDeployment { copies, cores_used, chips_used, board_chips, .. } = file.deployment;
    if copies == 0 || file.steps == 0 || cores_used == 0 || chips_used == 0 || chips_used > board_chips {
        let message = "copies, cores, chips and steps are at least 1, chips in use at most the chips of the board";
        return wrong("workload.figure", message.to_string());
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shipped_workloads_are_well_formed_and_say_what_was_assumed() {
        let all = shipped().unwrap();
        let works: std::collections::BTreeSet<&str> =
            all.iter().filter(|file| file.first_hand).map(|file| file.work.as_str()).collect();
        assert!(works.len() >= 10, "{works:?}");
        for file in &all {
            assert!(!file.figures.is_empty() && !file.source.is_empty(), "{}", file.name);
            assert!(file.activity == Status::Published || !file.assumed.is_empty(), "{}", file.name);
            nsim_files::target::load_target(&file.target.value).unwrap();
        }
    }
}
