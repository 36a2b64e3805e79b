//! The table of neuron kinds: names, parameters, state, and what their messages carry.
//!
//! A parameter is an integer of the hardware; some may be given as a real number instead, under
//! another name. The reader of model files, `quantise`, probes and every list of parameters go by
//! [`NeuronKind::table`]; what a kind does is in `nsim_dynamics` and again in `nsim_golden`.

use serde::{Deserialize, Serialize};

use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Field, Refractory, ThresholdMantissa, UV_BITS, VmaxExponent, VminExponent,
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
    /// Sums arrivals and sends the change of the sum, once it is large enough (Loihi 2).
    SigmaDelta,
    /// Sends the change of what arrives, once it is large enough (Loihi 2).
    Delta,
    /// Sums arrivals and sends the sum (Loihi 2).
    Sigma,
    /// Resonate-and-fire: a decaying rotation, which spikes as it passes the real axis (Loihi 2).
    Rf,
    /// The same, but it spikes above a threshold of the imaginary part, and is reset (Loihi 2).
    RfIz,
}

named_variants!(NeuronKind {
    Loihi = "Loihi",
    If = "If",
    SoftReset = "SoftReset",
    SigmaDelta = "SigmaDelta",
    Delta = "Delta",
    Sigma = "Sigma",
    Rf = "Rf",
    RfIz = "RfIz",
});

/// What a kind of neuron consists of.
#[derive(Debug)]
pub struct KindTable {
    /// Its parameters, in the order in which they are written.
    pub parameters: &'static [ParameterField],
    /// What it carries from one step to the next, beside a refractory counter.
    pub state: &'static [Column],
    /// How many sums of arrivals it has: 1, or 2 where a projection says which one it adds to.
    pub ports: u8,
    /// What it sends.
    pub emits: Emits,
    /// Whether its compartments are registers of Loihi 1, rather than a [`Row`].
    pub registers: bool,
}

/// A word of state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Column {
    /// Its name in `docs/semantics.md` and in probes.
    pub name: &'static str,
    /// Bits, the sign included.
    pub bits: u32,
}

/// A sum of arrivals of a compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Port {
    /// The only one, or the real one.
    #[default]
    First,
    /// The imaginary one.
    Second,
}

impl Port {
    /// Whether it is the first.
    #[must_use]
    pub fn is_first(&self) -> bool {
        *self == Port::First
    }

    /// Its number.
    #[must_use]
    pub fn index(self) -> usize {
        self as usize
    }
}

/// What a kind sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emits {
    /// Spikes, which carry nothing or the payload of their population.
    Spikes,
    /// Integers that it computes.
    Values,
}

/// Where a core stores a parameter, and what limits how many values there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// With others in a profile of compartments; a core has this many profiles.
    Profile,
    /// In a table of thresholds; a core has this many.
    Threshold,
    /// With each compartment.
    Each,
}

/// A parameter of a population; one value for all compartments or one each.
#[derive(Debug, Clone, Copy)]
pub struct ParameterField {
    /// Its name in model files.
    pub name: &'static str,
    /// What it holds, and its range.
    pub field: Field,
    /// Where a core stores it.
    pub storage: Storage,
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

/// The parameters of a compartment of a kind without the registers of Loihi 1, in the order of its
/// table; zeros behind them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(from = "Option<[i32; 7]>", into = "Option<[i32; 7]>")]
pub struct Row(pub [i32; 7]);

impl From<Option<[i32; 7]>> for Row {
    fn from(row: Option<[i32; 7]>) -> Row {
        Row(row.unwrap_or_default())
    }
}

impl From<Row> for Option<[i32; 7]> {
    fn from(row: Row) -> Self {
        Some(row.0).filter(|row| *row != [0; 7])
    }
}

impl Row {
    /// That of a compartment with registers.
    pub const EMPTY: Row = Row([0; 7]);

    /// The parameters that are stored in this place; zeros for the others.
    #[must_use]
    pub fn stored_in(mut self, kind: NeuronKind, place: Storage) -> Row {
        let table = kind.table();
        if !table.registers {
            let others = table.parameters.iter().zip(&mut self.0).filter(|(parameter, _)| parameter.storage != place);
            others.for_each(|(_, value)| *value = 0);
        }
        self
    }
}

/// A parameter that has a default and no other form.
const fn optional(name: &'static str, field: Field, storage: Storage, default: i64) -> ParameterField {
    ParameterField { name, field, storage, default: Some(default), real: None, help: "" }
}

/// A parameter that has to be given.
const fn required(name: &'static str, field: Field, storage: Storage, help: &'static str) -> ParameterField {
    ParameterField { name, field, storage, default: None, real: None, help }
}

const fn range(what: &'static str, low: i64, high: i64) -> Field {
    Field { what, low, high }
}

const fn decay(name: &'static str, time_constant: &'static str) -> ParameterField {
    ParameterField {
        real: Some((time_constant, Conversion::TimeConstant)),
        ..required(name, Decay::FIELD, Storage::Profile, "give the effective decay 0..4096, or a time constant in ms")
    }
}

/// Threshold, bias, refractory period and clips: what every compartment of Loihi 1 has.
const THRESHOLD: ParameterField = ParameterField {
    real: Some(("vth", Conversion::Threshold)),
    ..required(
        "vth_mant",
        ThresholdMantissa::FIELD,
        Storage::Threshold,
        "give the threshold mantissa, or a real threshold vth",
    )
};
const BIAS_MANTISSA: ParameterField = ParameterField {
    real: Some(("bias", Conversion::BiasMantissa)),
    ..optional("bias_mant", BiasMantissa::FIELD, Storage::Each, 0)
};
const BIAS_EXPONENT: ParameterField = ParameterField {
    real: Some(("bias", Conversion::BiasExponent)),
    ..optional("bias_exp", BiasExponent::FIELD, Storage::Each, 0)
};
const REFRACTORY: ParameterField = optional("refractory", Refractory::FIELD, Storage::Profile, 1);
const VMIN: ParameterField = optional("vmin_exp", VminExponent::FIELD, Storage::Each, 23);
const VMAX: ParameterField = optional("vmax_exp", VmaxExponent::FIELD, Storage::Each, 7);

const U: Column = Column { name: "u", bits: UV_BITS + 1 };
const V: Column = Column { name: "v", bits: UV_BITS + 1 };

const LOIHI: KindTable = KindTable {
    parameters: &[
        decay("du", "tau_u_ms"),
        decay("dv", "tau_v_ms"),
        THRESHOLD,
        BIAS_MANTISSA,
        BIAS_EXPONENT,
        REFRACTORY,
        VMIN,
        VMAX,
    ],
    state: &[U, V],
    ports: 1,
    emits: Emits::Spikes,
    registers: true,
};

/// The threshold of a change, in units of `2^(spike_exp + state_exp)`.
const CHANGE: ParameterField = required(
    "vth_mant",
    range("threshold of a change", 0, (1 << 17) - 1),
    Storage::Threshold,
    "give the least change that is sent",
);
const SPIKE_EXP: ParameterField = optional("spike_exp", range("spike exponent", 0, 7), Storage::Profile, 0);
const STATE_EXP: ParameterField = optional("state_exp", range("state exponent", 0, 7), Storage::Profile, 0);
const CUM_ERROR: ParameterField = optional("cum_error", range("cumulated error (0 or 1)", 0, 1), Storage::Profile, 0);

const fn word(name: &'static str) -> Column {
    Column { name, bits: 32 }
}

static RESONATOR: KindTable = KindTable {
    parameters: &[
        required(
            "sin_decay",
            range("sine of the rotation", -32_768, 32_767),
            Storage::Profile,
            "give (1 - alpha) sin(2 pi / period) 2^decay_bits, toward zero",
        ),
        required(
            "cos_decay",
            range("cosine of the rotation", -32_768, 32_767),
            Storage::Profile,
            "give (1 - alpha) cos(2 pi / period) 2^decay_bits, toward zero",
        ),
        required(
            "threshold",
            range("threshold", 0, (1 << UV_BITS) - 1),
            Storage::Threshold,
            "give the threshold in units of the state",
        ),
        STATE_EXP,
        optional("decay_bits", range("bits of the decay", 1, 15), Storage::Profile, 12),
    ],
    state: &[Column { name: "re", bits: UV_BITS + 1 }, Column { name: "im", bits: UV_BITS + 1 }],
    ports: 2,
    emits: Emits::Spikes,
    registers: false,
};

static LOIHI_TABLE: KindTable = LOIHI;
static IF: KindTable =
    KindTable { parameters: &[THRESHOLD, BIAS_MANTISSA, BIAS_EXPONENT, REFRACTORY, VMIN, VMAX], ..LOIHI };
static SOFT_RESET: KindTable = KindTable {
    parameters: &[
        decay("du", "tau_u_ms"),
        decay("dv", "tau_v_ms"),
        THRESHOLD,
        BIAS_MANTISSA,
        BIAS_EXPONENT,
        VMIN,
        VMAX,
    ],
    ..LOIHI
};
static SIGMA_DELTA: KindTable = KindTable {
    parameters: &[
        CHANGE,
        optional("bias_mant", range("bias", -(1 << 17), (1 << 17) - 1), Storage::Each, 0),
        SPIKE_EXP,
        STATE_EXP,
        optional("relu", range("rectification (0 or 1)", 0, 1), Storage::Profile, 0),
        CUM_ERROR,
        optional("corrected", range("correction (0 or 1)", 0, 1), Storage::Profile, 0),
    ],
    state: &[word("sigma"), word("act"), word("residue"), word("error")],
    ..SIGMA
};
static DELTA: KindTable = KindTable {
    parameters: &[CHANGE, SPIKE_EXP, STATE_EXP, CUM_ERROR],
    state: &[word("act"), word("residue"), word("error")],
    ..SIGMA
};
const SIGMA: KindTable =
    KindTable { parameters: &[], state: &[word("sigma")], ports: 1, emits: Emits::Values, registers: false };
static SIGMA_TABLE: KindTable = SIGMA;

impl NeuronKind {
    /// What the kind consists of.
    #[must_use]
    pub const fn table(self) -> &'static KindTable {
        match self {
            NeuronKind::Loihi => &LOIHI_TABLE,
            NeuronKind::If => &IF,
            NeuronKind::SoftReset => &SOFT_RESET,
            NeuronKind::SigmaDelta => &SIGMA_DELTA,
            NeuronKind::Delta => &DELTA,
            NeuronKind::Sigma => &SIGMA_TABLE,
            NeuronKind::Rf | NeuronKind::RfIz => &RESONATOR,
        }
    }

    /// Its parameters, in the order in which they are written.
    #[must_use]
    pub const fn parameters(self) -> &'static [ParameterField] {
        self.table().parameters
    }

    /// Every name that a parameter of the kind may be given under, each once.
    pub fn parameter_names(self) -> impl Iterator<Item = &'static str> {
        let parameters = self.parameters();
        let real = parameters.iter().filter(|p| !matches!(p.real, Some((_, Conversion::BiasExponent))));
        parameters.iter().map(|p| p.name).chain(real.filter_map(|p| p.real.map(|(name, _)| name)))
    }
}
