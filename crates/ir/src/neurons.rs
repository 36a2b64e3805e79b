//! Neuron kinds as model files name them, and the parameters that each takes.
//!
//! A parameter is an integer of the hardware; some may be given as a real number instead, under
//! another name. The reader, `compile::frontend` and every table of parameters go by
//! [`NeuronKind::parameters`]; what a kind does is in `nsim_dynamics`.

use serde::{Deserialize, Serialize};

use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Field, Refractory, ThresholdMantissa, VmaxExponent, VminExponent,
};
use crate::base::names::named_variants;

/// A kind of neuron with integer state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum NeuronKind {
    /// A compartment of Loihi 1: decaying current and voltage.
    #[default]
    Loihi,
    /// Integrate-and-fire: no memory in the current, no leak of the voltage.
    If,
    /// Decaying current and voltage; a spike subtracts the threshold from the voltage instead of
    /// clearing it.
    SoftReset,
}

/// A parameter of a population; one value for all compartments or one each.
#[derive(Debug)]
pub struct ParameterField {
    /// Its name in model files.
    pub name: &'static str,
    /// What it holds, and its range.
    pub field: Field,
    /// Its value where the file gives none.
    pub default: Option<i64>,
    /// The name of a real number that stands for it, and how that becomes the integer.
    pub real: Option<(&'static str, Conversion)>,
    /// What to give when it is missing.
    pub help: &'static str,
}

/// How a real number becomes the integer of a field.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conversion {
    /// A time constant in ms: `4096 (1 - exp(-dt / tau))`.
    TimeConstant,
    /// A threshold in the units of real incoming weights.
    Threshold,
    /// The mantissa of a bias in the same units.
    BiasMantissa,
    /// The exponent of such a bias.
    BiasExponent,
}

/// A parameter that has a default and no other form.
const fn optional(name: &'static str, field: Field, default: i64) -> ParameterField {
    ParameterField { name, field, default: Some(default), real: None, help: "" }
}

const fn decay(name: &'static str, time_constant: &'static str) -> ParameterField {
    ParameterField {
        name,
        field: Decay::FIELD,
        default: None,
        real: Some((time_constant, Conversion::TimeConstant)),
        help: "give the effective decay 0..4096, or a time constant in ms",
    }
}

/// Threshold, bias, refractory period and clips: what every compartment of Loihi 1 has.
const THRESHOLD: ParameterField = ParameterField {
    name: "vth_mant",
    field: ThresholdMantissa::FIELD,
    default: None,
    real: Some(("vth", Conversion::Threshold)),
    help: "give the threshold mantissa, or a real threshold vth",
};
const BIAS_MANTISSA: ParameterField =
    ParameterField { real: Some(("bias", Conversion::BiasMantissa)), ..optional("bias_mant", BiasMantissa::FIELD, 0) };
const BIAS_EXPONENT: ParameterField =
    ParameterField { real: Some(("bias", Conversion::BiasExponent)), ..optional("bias_exp", BiasExponent::FIELD, 0) };
const REFRACTORY: ParameterField = optional("refractory", Refractory::FIELD, 1);
const VMIN: ParameterField = optional("vmin_exp", VminExponent::FIELD, 23);
const VMAX: ParameterField = optional("vmax_exp", VmaxExponent::FIELD, 7);

named_variants!(NeuronKind { Loihi = "Loihi", If = "If", SoftReset = "SoftReset" });

impl NeuronKind {
    /// Its parameters, in the order in which they are written.
    #[must_use]
    pub const fn parameters(self) -> &'static [ParameterField] {
        match self {
            NeuronKind::Loihi => {
                const {
                    &[
                        decay("du", "tau_u_ms"),
                        decay("dv", "tau_v_ms"),
                        THRESHOLD,
                        BIAS_MANTISSA,
                        BIAS_EXPONENT,
                        REFRACTORY,
                        VMIN,
                        VMAX,
                    ]
                }
            }
            NeuronKind::If => const { &[THRESHOLD, BIAS_MANTISSA, BIAS_EXPONENT, REFRACTORY, VMIN, VMAX] },
            NeuronKind::SoftReset => {
                const {
                    &[
                        decay("du", "tau_u_ms"),
                        decay("dv", "tau_v_ms"),
                        THRESHOLD,
                        BIAS_MANTISSA,
                        BIAS_EXPONENT,
                        VMIN,
                        VMAX,
                    ]
                }
            }
        }
    }

    /// Every name that a parameter of the kind may be given under, each once.
    pub fn parameter_names(self) -> impl Iterator<Item = &'static str> {
        let parameters = self.parameters();
        let real = parameters.iter().filter(|p| !matches!(p.real, Some((_, Conversion::BiasExponent))));
        parameters.iter().map(|p| p.name).chain(real.filter_map(|p| p.real.map(|(name, _)| name)))
    }
}
