//! Tables of the neuron kinds: names, parameters, state, and content of their messages.
//!
//! A parameter is an integer of the hardware; some may be given as a real number, under another
//! name. The reader of model files, `quantise`, probes and every list of parameters use
//! [`NeuronKind::table`]. The dynamics of a kind are in `nsim_dynamics` and again in `nsim_golden`.

use std::cmp::Ordering;
use std::collections::BTreeMap;
use std::hash::{Hash, Hasher};
use std::sync::{LazyLock, Mutex, PoisonError};

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::base::diagnostic::Span;
use crate::base::fixed::{
    BiasExponent, BiasMantissa, Decay, Field, Refractory, ThresholdMantissa, UV_BITS, VmaxExponent, VminExponent,
};
use crate::base::names::named_variants;
use crate::locate::locate;
use crate::microcode::{Declaration, Microcode, Problem, UpdatePrice};
use crate::spanned::{parse_at, raw, refuse};

/// A kind of neuron with integer state.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
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
    /// Sends the change of its input, once it is large enough (Loihi 2).
    Delta,
    /// Sums arrivals and sends the sum (Loihi 2).
    Sigma,
    /// Resonate-and-fire: a decaying rotation, which spikes as it passes the real axis (Loihi 2).
    Rf,
    /// [`NeuronKind::Rf`] with a threshold of the imaginary part, and a reset (Loihi 2).
    RfIz,
    /// Decaying current and voltage with two thresholds; sends 1 above and -1 below (Loihi 2).
    TernaryLif,
    /// Decaying current and voltage, which return to zero periodically (Loihi 2).
    LifReset,
    /// Decaying current and voltage; a spike sends the voltage (lava-dl's CUBA with graded spikes).
    GradedLif,
    /// Decaying current and voltage, a threshold that each spike raises, and a refractory state
    /// (Loihi 2, in lava's integers).
    AtrLif,
    /// [`NeuronKind::AtrLif`] in lava-dl's integers.
    Alif,
    /// Resonate-and-fire with the threshold of [`NeuronKind::Alif`] (Loihi 2).
    Adrf,
    /// [`NeuronKind::Adrf`] with the test of [`NeuronKind::RfIz`], without its reset (Loihi 2).
    AdrfIz,
    /// Resonate-and-fire that sends its real part as it passes the real axis (Loihi 2).
    RfZero,
    /// Sends its input, where its magnitude exceeds a threshold (Loihi 2).
    GradedVec,
    /// Sends its input, where it exceeds a threshold (Loihi 2).
    GradedReluVec,
    /// Sends the product of two sums of arrivals (Loihi 2).
    ProdNeuron,
    /// Sends the product of a sum of arrivals and the first sum of the step before (Loihi 2).
    NormVecDelay,
    /// Sends the square of its input (Loihi 2).
    NormSquare,
    /// Sends the inverse square root of its input (Loihi 2).
    InvSqrt,
    /// A kind that a model file declares (Loihi 2).
    Microcode(MicrocodeKind),
}

named_variants!(NeuronKind {
    Loihi, If, SoftReset, SigmaDelta, Delta, Sigma, Rf, RfIz, TernaryLif, LifReset, GradedLif, AtrLif, Alif, Adrf,
    AdrfIz, RfZero, GradedVec, GradedReluVec, ProdNeuron, NormVecDelay, NormSquare, InvSqrt;
    NeuronKind::Microcode(kind) => kind.name()
});

/// Parameters, state and messages of a kind of neuron.
#[derive(Debug)]
pub struct KindTable {
    /// Its parameters, in the order in which they are written.
    pub parameters: &'static [ParameterField],
    /// Words of state, in addition to a refractory counter.
    pub state: &'static [StateWord],
    /// Number of sums of arrivals: 1, or 2 where a projection selects the one that it adds to.
    pub ports: u8,
    /// The content of its messages.
    pub emits: Emits,
    /// Whether its parameters are registers of Loihi 1, rather than a [`ParameterRow`].
    pub registers: bool,
}

/// A word of state.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateWord {
    /// Its name in `docs/semantics.md` and in probes.
    pub name: &'static str,
    /// Bits, the sign included.
    pub bits: u32,
}

/// A sum of arrivals of a compartment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Port {
    /// The only sum, or the real one.
    #[default]
    First,
    /// The imaginary sum, or the second factor.
    Second,
}

impl Port {
    /// Whether it is the first port.
    pub fn is_first(&self) -> bool {
        *self == Port::First
    }

    /// Its number, 0 or 1.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// A parent's use of the voltage that its child pushes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub enum Role {
    /// Adds it to the current that enters its voltage.
    Add,
}

/// Use of the stack, on which the compartments of a neuron pass voltages in a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
pub struct Stack {
    /// The role of its child, if it is a parent.
    pub pops: Option<Role>,
    /// Whether it is a child.
    pub pushes: bool,
}

impl Stack {
    /// The use by a compartment that is a neuron of its own.
    pub const UNUSED: Stack = Stack { pops: None, pushes: false };

    /// Whether the compartment is a neuron of its own.
    #[inline]
    pub fn is_unused(&self) -> bool {
        *self == Stack::UNUSED
    }
}

/// The content of a kind's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Emits {
    /// Spikes, which carry nothing or the payload of their population.
    Spikes,
    /// Integers that it computes.
    Values,
}

/// The place where a core stores a parameter, which limits the number of its values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Storage {
    /// In a compartment profile, with other parameters; the profiles of a core are limited.
    Profile,
    /// In a table of thresholds, of limited size.
    Threshold,
    /// With each compartment.
    Each,
}

/// A parameter of a population; one value for all compartments or one each.
#[derive(Debug, Clone, Copy)]
pub struct ParameterField {
    /// Its name in model files.
    pub name: &'static str,
    /// Its quantity and range.
    pub field: Field,
    /// Its place on a core.
    pub storage: Storage,
    /// Its value where the file gives none.
    pub default: Option<i64>,
    /// The name of a real number that may be given instead, and its conversion to the integer.
    pub real: Option<(&'static str, Conversion)>,
    /// Advice when it is missing.
    pub help: &'static str,
}

/// Conversion of a real number to the integer of a field.
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
/// table; zeros after them.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(from = "Option<[i32; 8]>", into = "Option<[i32; 8]>")]
pub struct ParameterRow(pub [i32; 8]);

impl From<Option<[i32; 8]>> for ParameterRow {
    fn from(row: Option<[i32; 8]>) -> ParameterRow {
        ParameterRow(row.unwrap_or_default())
    }
}

impl From<ParameterRow> for Option<[i32; 8]> {
    fn from(row: ParameterRow) -> Self {
        Some(row.0).filter(|row| *row != [0; 8])
    }
}

impl ParameterRow {
    /// The row of a compartment with registers.
    pub const EMPTY: ParameterRow = ParameterRow([0; 8]);

    /// The parameters that are stored in `place`, zeros for the others.
    #[must_use]
    pub fn stored_in(mut self, kind: NeuronKind, place: Storage) -> ParameterRow {
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

/// Parameters of every Loihi 1 compartment: threshold, bias, refractory period and clips.
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

const U: StateWord = StateWord { name: "u", bits: UV_BITS + 1 };
const V: StateWord = StateWord { name: "v", bits: UV_BITS + 1 };

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

const fn word(name: &'static str) -> StateWord {
    StateWord { name, bits: 32 }
}

const fn sine(low: i64, high: i64, help: &'static str) -> ParameterField {
    required("sin_decay", range("sine of the rotation", low, high), Storage::Profile, help)
}

const fn cosine(low: i64, high: i64, help: &'static str) -> ParameterField {
    required("cos_decay", range("cosine of the rotation", low, high), Storage::Profile, help)
}

/// A threshold in units of the state.
const fn threshold(low: i64, high: i64) -> ParameterField {
    let help = "give the threshold in units of the state";
    required("threshold", range("threshold", low, high), Storage::Threshold, help)
}

/// An effective decay, in 4096ths.
const fn effective(name: &'static str) -> ParameterField {
    required(name, Decay::FIELD, Storage::Profile, "give the effective decay 0..4096")
}

static RESONATOR: KindTable = KindTable {
    parameters: &[
        sine(-32_768, 32_767, "give (1 - alpha) sin(2 pi / period) 2^decay_bits, toward zero"),
        cosine(-32_768, 32_767, "give (1 - alpha) cos(2 pi / period) 2^decay_bits, toward zero"),
        threshold(0, (1 << UV_BITS) - 1),
        STATE_EXP,
        optional("decay_bits", range("bits of the decay", 1, 15), Storage::Profile, 12),
    ],
    state: &[StateWord { name: "re", bits: UV_BITS + 1 }, StateWord { name: "im", bits: UV_BITS + 1 }],
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

/// Current and voltage of lava's neurons.
const IN_24_BITS: [StateWord; 2] = [U, V];
/// A threshold mantissa, in units of 64 of the state.
const MANTISSA: ParameterField =
    required("vth_mant", ThresholdMantissa::FIELD, Storage::Threshold, "give the threshold mantissa");
const BIAS: ParameterField = optional("bias_mant", BiasMantissa::FIELD, Storage::Each, 0);
/// The exponent of a bias; one below 0 rounds the bias down.
const BIAS_SHIFT: ParameterField = optional("bias_exp", range("bias exponent", -8, 7), Storage::Each, 0);
/// The greatest magnitude of an adaptive threshold and of its step. It is below half a word,
/// because a spike adds twice the threshold.
const MOST_ADAPTIVE: i64 = (1 << 30) - 1;
const STEP: ParameterField = required(
    "threshold_step",
    range("step of the threshold", -MOST_ADAPTIVE, MOST_ADAPTIVE),
    Storage::Threshold,
    "give the increase of the threshold per spike, in units of the state",
);
/// The threshold that a message has to exceed.
const LEAST: ParameterField = threshold(0, i32::MAX as i64);

static TERNARY_LIF: KindTable = KindTable {
    parameters: &[
        effective("du"),
        effective("dv"),
        two_sided("vth_hi_mant", "give the mantissa of the upper threshold"),
        two_sided("vth_lo_mant", "give the mantissa of the lower threshold"),
        BIAS,
        BIAS_SHIFT,
    ],
    state: &IN_24_BITS,
    ..SIGMA
};
static LIF_RESET: KindTable = KindTable {
    parameters: &[
        effective("du"),
        effective("dv"),
        MANTISSA,
        BIAS,
        BIAS_SHIFT,
        required("reset_interval", range("reset interval", 1, i32::MAX as i64), Storage::Profile, "give it in steps"),
        optional("reset_offset", range("reset offset", 0, i32::MAX as i64), Storage::Profile, 0),
    ],
    state: &IN_24_BITS,
    emits: Emits::Spikes,
    ..SIGMA
};
static GRADED_LIF: KindTable =
    KindTable { parameters: &[effective("du"), effective("dv"), MANTISSA], state: &[word("u"), word("v")], ..SIGMA };
static ATR_LIF: KindTable = KindTable {
    parameters: &[
        effective("du"),
        effective("dv"),
        effective("dtheta"),
        effective("dr"),
        threshold(0, MOST_ADAPTIVE),
        STEP,
        BIAS,
        BIAS_SHIFT,
    ],
    state: &[U, V, word("theta"), word("r")],
    emits: Emits::Spikes,
    ..SIGMA
};
static ALIF: KindTable = KindTable {
    parameters: &[
        effective("du"),
        effective("dv"),
        effective("dtheta"),
        effective("dr"),
        threshold(0, MOST_ADAPTIVE),
        STEP,
    ],
    state: &[word("u"), word("v"), word("theta"), word("r")],
    emits: Emits::Spikes,
    ..SIGMA
};
static ADAPTIVE_RESONATOR: KindTable = KindTable {
    parameters: &[
        sine(-4096, 4096, "give (1 - alpha) sin(2 pi / period) in 4096ths"),
        cosine(-4096, 4096, "give (1 - alpha) cos(2 pi / period) in 4096ths"),
        effective("dtheta"),
        effective("dr"),
        threshold(0, MOST_ADAPTIVE),
        STEP,
        STATE_EXP,
    ],
    state: &[word("re"), word("im"), word("theta"), word("r")],
    ports: 2,
    emits: Emits::Spikes,
    registers: false,
};
static RF_ZERO: KindTable = KindTable {
    parameters: &[
        sine(-32_768, 32_767, "give the sine of the rotation in 32,768ths, toward zero"),
        cosine(-32_768, 32_767, "give the cosine of the rotation in 32,768ths, toward zero"),
        LEAST,
    ],
    state: &[word("u"), word("v")],
    ports: 2,
    ..SIGMA
};
static GRADED_VEC: KindTable = KindTable { parameters: &[LEAST], state: &[], ..SIGMA };
static PROD_NEURON: KindTable = KindTable {
    parameters: &[LEAST, optional("exp", range("exponent of the product", 0, 31), Storage::Profile, 0)],
    state: &[],
    ports: 2,
    ..SIGMA
};
static NORM_VEC_DELAY: KindTable =
    KindTable { parameters: &[LEAST], state: &[word("v"), word("v2")], ports: 2, ..SIGMA };
static NO_STATE: KindTable = KindTable { state: &[], ..SIGMA };

const fn two_sided(name: &'static str, help: &'static str) -> ParameterField {
    required(name, range("threshold mantissa", -(1 << 23), (1 << 23) - 1), Storage::Threshold, help)
}

impl NeuronKind {
    /// Its parameters, state and messages.
    pub const fn table(self) -> &'static KindTable {
        match self {
            NeuronKind::Loihi => &LOIHI_TABLE,
            NeuronKind::If => &IF,
            NeuronKind::SoftReset => &SOFT_RESET,
            NeuronKind::SigmaDelta => &SIGMA_DELTA,
            NeuronKind::Delta => &DELTA,
            NeuronKind::Sigma => &SIGMA_TABLE,
            NeuronKind::Rf | NeuronKind::RfIz => &RESONATOR,
            NeuronKind::TernaryLif => &TERNARY_LIF,
            NeuronKind::LifReset => &LIF_RESET,
            NeuronKind::GradedLif => &GRADED_LIF,
            NeuronKind::AtrLif => &ATR_LIF,
            NeuronKind::Alif => &ALIF,
            NeuronKind::Adrf | NeuronKind::AdrfIz => &ADAPTIVE_RESONATOR,
            NeuronKind::RfZero => &RF_ZERO,
            NeuronKind::GradedVec | NeuronKind::GradedReluVec => &GRADED_VEC,
            NeuronKind::ProdNeuron => &PROD_NEURON,
            NeuronKind::NormVecDelay => &NORM_VEC_DELAY,
            NeuronKind::NormSquare | NeuronKind::InvSqrt => &NO_STATE,
            NeuronKind::Microcode(kind) => &kind.0.table,
        }
    }

    /// Its entry in the lists of chips.
    #[must_use]
    pub const fn family(self) -> Family {
        match self {
            NeuronKind::Microcode(_) => Family::MICROCODE,
            kind => Family(kind.name()),
        }
    }

    /// Its parameters, in the order in which they are written.
    pub const fn parameters(self) -> &'static [ParameterField] {
        self.table().parameters
    }

    /// The index of the word of state that is the potential: v, else the first. None for a kind
    /// without state.
    pub fn potential(self) -> Option<usize> {
        let state = self.table().state;
        state.iter().position(|word| word.name == "v").or_else(|| (!state.is_empty()).then_some(0))
    }

    /// Every name that a parameter of the kind may be given under, each once.
    pub fn parameter_names(self) -> impl Iterator<Item = &'static str> {
        let parameters = self.parameters();
        let real = parameters.iter().filter(|p| !matches!(p.real, Some((_, Conversion::BiasExponent))));
        parameters.iter().map(|p| p.name).chain(real.filter_map(|p| p.real.map(|(name, _)| name)))
    }
}

/// An entry in a chip's list of kinds: a name, or `Microcode` for all kinds of model files.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Family(&'static str);

impl Family {
    /// All kinds that model files declare.
    pub const MICROCODE: Family = Family("Microcode");

    /// The entry in a chip's list.
    pub fn name(self) -> &'static str {
        self.0
    }
}

static FAMILIES: LazyLock<Vec<&'static str>> =
    LazyLock::new(|| NeuronKind::ALL.map(NeuronKind::name).into_iter().chain([Family::MICROCODE.0]).collect());

impl<'de> Deserialize<'de> for Family {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, _) = raw(deserializer)?;
        let known = FAMILIES.iter().find(|name| **name == text);
        known.map(|name| Family(name)).ok_or_else(|| D::Error::unknown_variant(text, &FAMILIES))
    }
}

impl Serialize for Family {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_unit_variant("Family", 0, self.0)
    }
}

/// Serialised as its name, or as the declaration from a model file.
impl Serialize for NeuronKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            NeuronKind::Microcode(kind) => kind.serialize(serializer),
            kind => serializer.serialize_unit_variant("NeuronKind", 0, kind.name()),
        }
    }
}

impl<'de> Deserialize<'de> for NeuronKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        match NeuronKind::ALL.into_iter().find(|kind| kind.name() == text) {
            Some(kind) => Ok(kind),
            None if text.contains('(') => parse_at(text, span).map(NeuronKind::Microcode),
            None => Err(D::Error::unknown_variant(text, &FAMILIES)),
        }
    }
}

/// A kind that a model file declares.
///
/// Equal declarations are one kind, which is stored until the process ends. So a neuron refers to
/// its kind by 8 bytes, and names of parameters and words are static, as for every other kind.
#[derive(Clone, Copy)]
pub struct MicrocodeKind(&'static MicrocodeTable);

struct MicrocodeTable {
    code: Microcode,
    table: KindTable,
}

/// All kinds so far, by name.
static MICROCODE_KINDS: Mutex<BTreeMap<&'static str, Vec<&'static MicrocodeTable>>> = Mutex::new(BTreeMap::new());

impl MicrocodeKind {
    /// The kind of a declaration.
    ///
    /// # Errors
    /// A [`Problem`] at the first invalid name, width or expression.
    pub fn new(declaration: Declaration) -> Result<Self, Problem> {
        if ["Input", "Srm"].into_iter().chain(FAMILIES.iter().copied()).any(|known| known == declaration.name) {
            let message = format!("'{}' is the name of another kind: choose another one", declaration.name);
            return Err(Problem { path: "name".to_string(), at: 0, message });
        }
        let code = Microcode::new(declaration, ParameterRow::EMPTY.0.len())?;
        let mut kinds = MICROCODE_KINDS.lock().unwrap_or_else(PoisonError::into_inner);
        let of_name = kinds.get(code.name()).map_or(&[][..], Vec::as_slice);
        if let Some(same) = of_name.iter().find(|kind| kind.code == code) {
            return Ok(MicrocodeKind(same));
        }
        let kind: &MicrocodeTable = Box::leak(Box::new(MicrocodeTable { table: table_of(&code), code }));
        kinds.entry(kind.code.name()).or_default().push(kind);
        Ok(MicrocodeKind(kind))
    }

    /// Its rule.
    pub fn code(self) -> &'static Microcode {
        &self.0.code
    }

    /// Its name.
    pub const fn name(self) -> &'static str {
        self.0.code.name()
    }
}

impl NeuronKind {
    /// Cost of an update of a kind that a model declares; `None`: a compartment's.
    pub fn own_price(self) -> Option<UpdatePrice> {
        match self {
            NeuronKind::Microcode(kind) => Some(kind.code().price()),
            _ => None,
        }
    }

    /// Whether a model states the cost of an update.
    pub fn has_stated_price(self) -> bool {
        matches!(self.own_price(), Some(UpdatePrice::Stated { .. }))
    }
}

fn table_of(code: &Microcode) -> KindTable {
    let Declaration { parameters, state, message, .. } = code.declaration();
    let leaked = |name: &String| -> &'static str { name.clone().leak() };
    let parameter = |parameter: &crate::microcode::Parameter| {
        let name = leaked(&parameter.name);
        let field = range(name, parameter.range.0.into(), parameter.range.1.into());
        let default = parameter.default.map(i64::from);
        let help = "give a value, or a default in the kind's parameters";
        ParameterField { default, ..required(name, field, Storage::Each, help) }
    };
    let column = |word: &crate::microcode::Word| StateWord { name: leaked(&word.name), bits: word.bits };
    KindTable {
        parameters: parameters.iter().map(parameter).collect::<Vec<_>>().leak(),
        state: state.iter().map(column).collect::<Vec<_>>().leak(),
        ports: code.ports(),
        emits: if message.is_some() { Emits::Values } else { Emits::Spikes },
        registers: false,
    }
}

impl std::fmt::Debug for MicrocodeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

impl PartialEq for MicrocodeKind {
    fn eq(&self, other: &Self) -> bool {
        std::ptr::eq(self.0, other.0)
    }
}

impl Eq for MicrocodeKind {}

/// Ordered by declarations, so that the order is equal in every run.
impl Ord for MicrocodeKind {
    fn cmp(&self, other: &Self) -> Ordering {
        self.code().declaration().cmp(other.code().declaration())
    }
}

impl PartialOrd for MicrocodeKind {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Hash for MicrocodeKind {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.name().hash(state);
    }
}

impl Serialize for MicrocodeKind {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.code().declaration().serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for MicrocodeKind {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        let declaration = parse_at(text, span)?;
        MicrocodeKind::new(declaration).or_else(|Problem { path, at, message }| {
            let whole = Span { start: 0, end: text.len() };
            let Span { start, end } = locate(text, whole, &path).unwrap_or(whole);
            let value = &text[start..end];
            // The error is at a byte within the quotes, unless there are escapes.
            let inside = value.starts_with('"') && !value.contains('\\') && at + 1 < value.len();
            let found = if inside { Span { start: start + 1 + at, end } } else { Span { start, end } };
            refuse(Span { start: span.start + found.start, end: span.start + found.end }, message)
        })
    }
}
