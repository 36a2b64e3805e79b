//! What every reader of a foreign format shares: its options, its result and limits of a core.

use std::fmt;
use std::path::PathBuf;

use nsim_files::network::{NetworkFile, Parameter};
use nsim_ir::arithmetic::{ReadOut, ThresholdTest};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::fixed::{Delay, ThresholdMantissa};
use nsim_ir::base::names::named_variants;

/// The greatest threshold mantissa: what a compartment gets that should not spike.
pub(super) const NEVER: f64 = ThresholdMantissa::MAX.get() as f64;
/// The greatest delay field.
pub(super) const LONGEST_DELAY: f64 = Delay::MAX.get() as f64;

/// What a file does not say, and its user may.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Milliseconds that a timestep represents.
    pub dt_ms: Option<f64>,
    /// A file with the neuron's parameters (SLAYER's YAML).
    pub neuron: Option<PathBuf>,
    /// What a neuron does to its voltage when it spikes (NIR).
    pub reset: Option<ResetMode>,
    /// What a step leaves of a state with a time constant (NIR), if not as Euler's rule has it.
    pub decay: Option<DecayRule>,
    /// When a compartment spikes, if not strictly above its threshold.
    pub threshold: Option<ThresholdTest>,
    /// What of the output decides, if not what suits its neurons.
    pub decision: Option<ReadOut>,
    /// An image to drive the input layer's bias.
    pub image: Option<PathBuf>,
    /// The step at which layer 0 starts, layer k starting k steps later.
    pub first_step: Option<u32>,
    /// Timesteps between two resets of every layer.
    pub reset_interval: Option<u32>,
    /// The first reset, counted from a layer's start.
    pub reset_offset: u32,
    /// Channels, height, width of the input of a network that begins with a convolution.
    pub input_shape: Option<Vec<u64>>,
    /// Bits of the fraction of a message of sigma-delta neurons (netx), 6 if not given.
    pub spike_exp: Option<u8>,
    /// Bits of the fraction of their state below that (netx), 6 if not given.
    pub state_exp: Option<u8>,
}

/// The problem of an option that is lacking, or that a file contradicts.
pub(super) fn wrong_option(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.option", message)
}

impl Options {
    /// Refuses the options that a kind of file has no use for: all that are given but these.
    pub(super) fn refuse_unused(&self, file: &str, used: &[&str]) -> Result<()> {
        let given = [
            ("--neuron", self.neuron.is_some()),
            ("--reset", self.reset.is_some()),
            ("--decay", self.decay.is_some()),
            ("--image", self.image.is_some()),
            ("--first-step", self.first_step.is_some()),
            ("--reset-interval", self.reset_interval.is_some()),
            ("--input-shape", self.input_shape.is_some()),
            ("--spike-exp", self.spike_exp.is_some()),
            ("--state-exp", self.state_exp.is_some()),
        ];
        match given.into_iter().find(|(name, given)| *given && !used.contains(name)) {
            None => Ok(()),
            Some((name, _)) => Err(wrong_option(format!("{name} says nothing of {file}")).help("leave it out")),
        }
    }
}

/// What a step of dt leaves of a state with the time constant tau.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DecayRule {
    /// 1 - dt / tau (snnTorch, Norse).
    Euler,
    /// exp(-dt / tau) (sinabs, Rockpool).
    Exponential,
}

nsim_ir::named_variants!(DecayRule { Euler = "euler", Exponential = "exponential" });

/// What a neuron does to its voltage when it spikes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ResetMode {
    /// It returns to zero, as on the chip.
    Zero,
    /// The threshold is subtracted.
    Subtract,
    /// The threshold is subtracted in the step after the spike, once the voltage has decayed
    /// (snnTorch).
    SubtractLater,
}

named_variants!(ResetMode { Zero = "zero", Subtract = "subtract", SubtractLater = "subtract-later" });

/// A model that was read from a foreign file.
#[derive(Debug, Clone)]
pub struct Imported {
    /// What the file is, in words.
    pub kind: &'static str,
    /// The model.
    pub model: NetworkFile,
    /// By which conventions it was read, and what was changed.
    pub notes: Vec<String>,
    /// Of these notes, what a user sees unasked: what the file may contradict, or what is lost.
    pub assumed: Option<String>,
    /// What a spike does to v, as the file or an option says; `None` where the format leaves no
    /// choice.
    pub reset: Option<ResetMode>,
    /// What became of the weights of each layer, for files whose weights are rounded.
    pub layers: Vec<LayerWeights>,
}

/// What became of the weights of a layer.
#[derive(Debug, Clone, PartialEq)]
pub struct LayerWeights {
    /// The layer.
    pub name: String,
    /// `[target, source]`.
    pub shape: Vec<usize>,
    /// What a weight of 1 of the file counts in the model.
    pub scale: f64,
    /// Share of the weights other than 0 that became 0.
    pub zeroed: f64,
    /// The greatest difference between a weight of the file and that of the model, in the file's
    /// units.
    pub greatest_error: f64,
    /// Sum of the squares of these differences, as a share of that of the weights.
    lost: f64,
}

impl LayerWeights {
    /// Compares the weights of a file with those of the model, which are `scale` times as large but
    /// for rounding.
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

    /// Whether rounding leaves too little of the layer: most weights became 0, and not just small
    /// ones next to large ones.
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

/// Compartments that sum and never spike.
pub(super) fn integrator(du: f64, dv: f64) -> Vec<(&'static str, Parameter)> {
    vec![("du", Parameter::Same(du)), ("dv", Parameter::Same(dv)), ("vth_mant", Parameter::Same(NEVER))]
}

/// The parameters of a compartment that spikes in every step.
pub(super) fn every_step() -> Vec<(&'static str, Parameter)> {
    let parameters = [("du", 4096.0), ("dv", 4096.0), ("vth_mant", 1.0), ("bias_mant", 65.0), ("bias_exp", 0.0)];
    parameters.map(|(key, value)| (key, Parameter::Same(value))).to_vec()
}

/// A number of single precision as the shortest decimal that it represents, where it has more than
/// 16 significant bits: 0.8, not 0.800000012.
///
/// Sums in single precision round that excess away; sums in double precision do not. So a voltage
/// of 1 in the tool stays at its threshold of 1 here.
pub(super) fn decimal(single: f64) -> f64 {
    let narrow = single as f32;
    let short = narrow.to_bits().trailing_zeros() >= 8;
    if short { single } else { narrow.to_string().parse().unwrap_or(single) }
}

impl Imported {
    /// The import with populations of snnTorch 1.0.0 whose reset to zero takes away the input of
    /// the next step too, as that of Leaky alone does not (`_base_zero`).
    #[must_use]
    pub(super) fn held(mut self, names: &[String]) -> Self {
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
        self.model.provenance = Some(format!("imported from snnTorch; {}", self.notes.join("; ")));
        self
    }

    /// The import, decided as an option says; else by potentials where the output never spikes: by
    /// their sum where they forget everything in a step, by the last where they forget nothing,
    /// else by the greatest.
    #[must_use]
    pub(super) fn read_out(mut self, option: Option<ReadOut>) -> Self {
        let output = self.model.population(&self.model.output).and_then(|output| output.loihi.clone());
        let parameter = |key: &str| output.as_ref()?.iter().find(|(given, _)| *given == key).map(|(_, value)| value);
        let never = parameter("vth_mant") == Some(&Parameter::Same(NEVER));
        if let Some(decision) = option {
            self.model.decision = decision;
            if !never && decision != ReadOut::Spikes {
                let note = format!(
                    "'{}' spikes, and its potential that decides ({decision:?}) is what each reset leaves of it: a \
                     tool that compares the potential before its reset decides otherwise; a threshold above every potential \
                     makes both the same",
                    self.model.output
                );
                self.notes.push(note.clone());
                self.assumed.get_or_insert(note);
            }
        }
        if option.is_some() || !never {
            return self;
        }
        let both = |value: f64| [parameter("du"), parameter("dv")].map(|own| own == Some(&Parameter::Same(value)));
        self.model.decision = match (both(4096.0), both(0.0)) {
            ([true, true], _) => ReadOut::SumOfV,
            (_, [true, _] | [_, true]) => ReadOut::LastV,
            _ => ReadOut::GreatestV,
        };
        self.notes.push(format!(
            "'{}' never spikes, so its potential decides: {:?} (--decision says otherwise)",
            self.model.output, self.model.decision
        ));
        self
    }
}

/// Names for messages.
pub(super) fn listed(names: &[&str]) -> String {
    if names.is_empty() { "no members".to_string() } else { names.join(", ") }
}

/// A name that a population may have.
pub(super) fn population_name(name: &str) -> String {
    name.chars().map(|c| if c.is_alphanumeric() || c == '_' || c == '-' { c } else { '_' }).collect()
}
