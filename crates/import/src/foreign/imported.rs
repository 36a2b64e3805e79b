//! Shared by all readers of foreign formats: options, result and limits of a core.

use std::fmt;
use std::path::PathBuf;

use super::conventions::{DecayRule, GainRule, Reading, ResetMode, Tool};
use nsim_files::network::{NetworkFile, Parameter};
use nsim_ir::arithmetic::{ReadOut, ThresholdTest};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::fixed::{Delay, ThresholdMantissa};
use nsim_ir::base::names::named_variants;
use nsim_ir::base::warning::{Warning, WarningCode};

/// The greatest threshold mantissa, for compartments that should not spike.
pub(super) const MAX_THRESHOLD: f64 = ThresholdMantissa::MAX.get() as f64;
pub(super) const LONGEST_DELAY: f64 = Delay::MAX.get() as f64;

/// Options for facts that a file does not contain.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Timestep, tool and reset.
    pub reading: Reading,
    /// Whether every convention is known, so that none is a question: nodes in memory.
    pub known: bool,
    /// A file with the neuron's parameters (SLAYER's YAML).
    pub neuron: Option<PathBuf>,
    /// Decay rule of states with a time constant (NIR), the tool's or Euler's by default.
    pub decay: Option<DecayRule>,
    /// Threshold test of compartments, the tool's or strict by default.
    pub threshold: Option<ThresholdTest>,
    /// The score by which the output decides; by default the one that suits its neurons.
    pub decision: Option<ReadOut>,
    /// An image to drive the input layer's bias.
    pub image: Option<PathBuf>,
    /// The step at which layer 0 starts; layer k starts k steps later.
    pub first_step: Option<u32>,
    /// Timesteps between two resets of every layer.
    pub reset_interval: Option<u32>,
    /// The first reset, counted from a layer's start.
    pub reset_offset: u32,
    /// Channels, height, width of the input of a network that begins with a convolution.
    pub input_shape: Option<Vec<u64>>,
    /// Fractional bits of the messages of sigma-delta neurons (netx), 6 by default.
    pub spike_exp: Option<u8>,
    /// Additional fractional bits of their state (netx), 6 by default.
    pub state_exp: Option<u8>,
}

/// The diagnostic for an option that is missing, or that the file contradicts.
pub(super) fn wrong_option(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.option", message)
}

impl Options {
    /// The threshold test: of the option, or of the tool.
    pub(super) fn threshold(&self) -> ThresholdTest {
        self.threshold.or(self.reading.row().map(|row| row.threshold)).unwrap_or_default()
    }

    /// The decay rule: of the option, or of the tool.
    pub(super) fn decay(&self) -> DecayRule {
        self.decay.or(self.reading.row().map(|row| row.decay)).unwrap_or(DecayRule::Euler)
    }

    /// The reset of a node of this type: of the option, or of the tool.
    pub(super) fn reset_of(&self, kind: &str) -> ResetMode {
        self.reading.reset.or(self.reading.row().map(|row| row.reset_of(kind))).unwrap_or(ResetMode::Zero)
    }

    /// What a weight counts.
    pub(super) fn gain(&self) -> GainRule {
        self.reading.row().map_or(GainRule::Equations, |row| row.gain)
    }

    /// Refuses options that a format lacks, and a tool that does not write it.
    pub(super) fn check(&self, format: Format) -> Result<()> {
        let file = format.name();
        if let Some(option) = ImportOption::ALL.into_iter().find(|&option| self.has(option) && !format.has(option)) {
            let message = format!("{} does not apply to {file}", option.name());
            return Err(wrong_option(message).help("leave it out"));
        }
        match self.reading.row().filter(|row| !format.writers().contains(&row.tool)) {
            None => Ok(()),
            Some(row) => {
                let message =
                    format!("--from {} does not apply to {file}, which {} does not write", row.tool.name(), row.title);
                Err(wrong_option(message).help("leave it out"))
            }
        }
    }

    /// Whether an option is given.
    fn has(&self, option: ImportOption) -> bool {
        match option {
            ImportOption::Neuron => self.neuron.is_some(),
            ImportOption::From => self.reading.tool.is_some(),
            ImportOption::Reset => self.reading.reset.is_some(),
            ImportOption::Decay => self.decay.is_some(),
            ImportOption::Image => self.image.is_some(),
            ImportOption::FirstStep => self.first_step.is_some(),
            ImportOption::ResetInterval => self.reset_interval.is_some(),
            ImportOption::InputShape => self.input_shape.is_some(),
            ImportOption::SpikeExp => self.spike_exp.is_some(),
            ImportOption::StateExp => self.state_exp.is_some(),
        }
    }
}

named_variants! {
    /// An option that some formats lack.
    #[derive(Clone, Copy, PartialEq)]
    pub enum ImportOption {
        /// [`Options::neuron`].
        Neuron = "--neuron",
        /// The tool of [`Options::reading`].
        From = "--from",
        /// The reset of [`Options::reading`].
        Reset = "--reset",
        /// [`Options::decay`].
        Decay = "--decay",
        /// [`Options::image`].
        Image = "--image",
        /// [`Options::first_step`].
        FirstStep = "--first-step",
        /// [`Options::reset_interval`].
        ResetInterval = "--reset-interval",
        /// [`Options::input_shape`].
        InputShape = "--input-shape",
        /// [`Options::spike_exp`].
        SpikeExp = "--spike-exp",
        /// [`Options::state_exp`].
        StateExp = "--state-exp",
    }
}

named_variants! {
    /// A foreign format, named as in messages.
    #[derive(Clone, Copy, PartialEq)]
    pub enum Format {
        /// A NIR graph.
        Nir = "a NIR graph",
        /// lava-dl's netx.
        Netx = "a network of lava-dl's netx",
        /// A state dictionary.
        Layers = "layers of SLAYER and lava-dl",
        /// The arrays of VT_SNN.
        VtSnn = "weights of VT_SNN",
        /// A model of nsim in a netx file.
        Nsim = "a model of nsim, restored unchanged",
    }
}

impl Format {
    /// Whether an option applies to the format.
    fn has(self, option: ImportOption) -> bool {
        use ImportOption::{
            Decay, FirstStep, From, Image, InputShape, Neuron, Reset, ResetInterval, SpikeExp, StateExp,
        };
        match self {
            Format::Nir => matches!(option, From | Reset | Decay),
            Format::Netx => {
                matches!(option, From | Image | FirstStep | ResetInterval | InputShape | SpikeExp | StateExp)
            }
            Format::Layers | Format::VtSnn => matches!(option, From | Neuron | InputShape),
            Format::Nsim => false,
        }
    }

    /// The tools that write the format.
    fn writers(self) -> &'static [Tool] {
        match self {
            Format::Nir => &Tool::ALL,
            Format::Netx => &[Tool::LavaDl],
            Format::Layers => &[Tool::Slayer, Tool::LavaDl],
            Format::VtSnn => &[Tool::Slayer],
            Format::Nsim => &[],
        }
    }
}

/// A model that was read from a foreign file.
#[derive(Debug, Clone)]
pub struct Imported {
    /// Name of the file's format.
    pub kind: &'static str,
    /// The network as a model file of nsim.
    pub model: NetworkFile,
    /// The conventions by which it was read, and the changes.
    pub notes: Vec<String>,
    /// Assumptions that may be wrong, and losses; they are among the notes, too.
    pub warnings: Vec<Warning>,
    /// Reset of v by a spike, from the file or an option; `None` where the format leaves no choice.
    pub reset: Option<ResetMode>,
    /// Rounding of the weights of each layer, for files whose weights are rounded.
    pub layers: Vec<LayerWeights>,
}

/// Rounding of the weights of a layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerWeights {
    /// Name of the layer.
    pub name: String,
    /// `[target, source]`.
    pub shape: Vec<usize>,
    /// The file's weight of 1 in units of the model.
    pub scale: f64,
    /// Share of the non-zero weights that became 0, 0..=1.
    pub zeroed: f64,
    /// The greatest difference between a weight of the file and of the model, in the file's units.
    pub greatest_error: f64,
    /// Sum of the squares of these differences, relative to the sum of the squared weights.
    lost: f64,
}

impl LayerWeights {
    /// Compares the weights `given` in a file with the weights `made`, which are `scale` times as
    /// large up to rounding.
    pub(super) fn new(name: &str, shape: &[usize], scale: f64, given: &[f64], made: &[f64]) -> LayerWeights {
        let (mut used, mut zeroed, mut greatest_error, mut squares, mut errors) = (0usize, 0usize, 0.0f64, 0.0, 0.0);
        for (given, made) in given.iter().zip(made) {
            let error = (given - made / scale).abs();
            used += usize::from(*given != 0.0);
            zeroed += usize::from(*given != 0.0 && *made == 0.0);
            greatest_error = greatest_error.max(error);
            squares += given * given;
            errors += error * error;
        }
        let zeroed = zeroed as f64 / used.max(1) as f64;
        let lost = if squares > 0.0 { errors / squares } else { 0.0 };
        LayerWeights { name: name.to_string(), shape: shape.to_vec(), scale, zeroed, greatest_error, lost }
    }

    /// Whether rounding destroys the layer: most weights became 0, not only small weights next to
    /// large ones.
    pub(super) fn is_lost(&self) -> bool {
        self.zeroed > 0.5 && self.lost > 0.1
    }
}

impl fmt::Display for LayerWeights {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} {:?}: a weight of 1 counts {}, {:.1} % of the weights became 0, the largest rounding error is {:.4}",
            self.name,
            self.shape,
            self.scale,
            100.0 * self.zeroed,
            self.greatest_error
        )
    }
}

/// Parameters of compartments that sum and never spike.
pub(super) fn integrator(du: f64, dv: f64) -> Vec<(&'static str, Parameter)> {
    vec![("du", Parameter::Same(du)), ("dv", Parameter::Same(dv)), ("vth_mant", Parameter::Same(MAX_THRESHOLD))]
}

/// The parameters of a compartment that spikes in every step.
pub(super) fn always_spiking() -> Vec<(&'static str, Parameter)> {
    let parameters = [("du", 4096.0), ("dv", 4096.0), ("vth_mant", 1.0), ("bias_mant", 65.0), ("bias_exp", 0.0)];
    parameters.map(|(key, value)| (key, Parameter::Same(value))).to_vec()
}

/// A number of single precision as its shortest decimal, where it has more than 16 significant
/// bits: 0.8, not 0.800000012.
///
/// Sums in single precision round that excess away; sums in double precision do not. So a voltage
/// that equals its threshold in the tool equals it here.
pub(super) fn shortest_decimal(single: f64) -> f64 {
    let narrow = single as f32;
    let short = narrow.to_bits().trailing_zeros() >= 8;
    if short { single } else { narrow.to_string().parse().unwrap_or(single) }
}

impl Imported {
    /// An import without warnings.
    pub(super) fn new(kind: &'static str, model: NetworkFile, notes: Vec<String>) -> Imported {
        Imported { kind, model, notes, warnings: Vec::new(), reset: None, layers: Vec::new() }
    }

    /// The import whose model states its source, and the notes so far.
    #[must_use]
    pub(super) fn with_provenance(mut self, source: &str) -> Self {
        self.model.provenance = Some(format!("imported from {source}; {}", self.notes.join("; ")));
        self
    }

    /// The import with warnings, which are notes, too.
    #[must_use]
    pub(super) fn with_warnings(mut self, warnings: Vec<Warning>) -> Self {
        warnings.into_iter().for_each(|warning| self.warn(warning));
        self
    }

    /// The import with a refractory period of 2 in the populations `names`. The reset to zero of
    /// snnTorch 1.0.0 also removes the input of the next step, except in Leaky (`_base_zero`).
    #[must_use]
    pub(super) fn with_refractory(mut self, names: &[String]) -> Self {
        if names.is_empty() {
            return self;
        }
        for name in names {
            let population = self.model.populations.iter_mut().find(|population| population.name == *name);
            if let Some(parameters) = population.and_then(|population| population.loihi.as_mut()) {
                parameters.push(("refractory", Parameter::Same(2.0)));
            }
        }
        self.notes.push(format!(
            "{}: v stays 0 in the step after a spike (refractory 2), as snnTorch's reset to zero takes the input of \
             that step",
            names.join(", ")
        ));
        self.with_provenance("snnTorch")
    }

    /// Adds a warning, which is a note, too.
    pub(super) fn warn(&mut self, warning: Warning) {
        self.notes.push(warning.to_string());
        self.warnings.push(warning);
    }

    /// The import with the decision of the option. Without one, an output that never spikes decides
    /// by potential. The score is the sum of v where u and v decay fully in a step, the last v
    /// where u or v never decays, else the greatest v.
    #[must_use]
    pub(super) fn with_decision(mut self, option: Option<ReadOut>) -> Self {
        let output = self.model.population(&self.model.output).and_then(|output| output.loihi.clone());
        let [du, dv, threshold] = ["du", "dv", "vth_mant"]
            .map(|key| output.iter().flatten().find(|(given, _)| *given == key).map(|(_, value)| value));
        let never = threshold == Some(&Parameter::Same(MAX_THRESHOLD));
        if let Some(decision) = option {
            self.model.decision = decision;
            if !never && decision != ReadOut::Spikes {
                let note = format!(
                    "'{}' spikes, and its potential after each reset decides the class ({decision:?}). A tool that \
                     compares potentials before the reset may decide otherwise; a threshold above every potential \
                     makes both identical",
                    self.model.output
                );
                self.warn(Warning::of_network(WarningCode::DecisionByPotential, note));
            }
        }
        if option.is_some() || !never {
            return self;
        }
        self.model.decision = match (du, dv) {
            (Some(Parameter::Same(4096.0)), Some(Parameter::Same(4096.0))) => ReadOut::SumOfV,
            (Some(Parameter::Same(0.0)), _) | (_, Some(Parameter::Same(0.0))) => ReadOut::LastV,
            _ => ReadOut::GreatestV,
        };
        self.notes.push(format!(
            "'{}' never spikes, so its potential decides: {:?} (--decision says otherwise)",
            self.model.output, self.model.decision
        ));
        self
    }
}

pub(super) fn name_list(names: &[&str]) -> String {
    if names.is_empty() { "no members".to_string() } else { names.join(", ") }
}

/// A valid population name: other characters become `_`.
pub(super) fn population_name(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || c == '_' || c == '-' { c } else { '_' }).collect()
}
