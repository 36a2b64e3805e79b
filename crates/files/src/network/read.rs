//! Populations and projections of a model file, read by serde.

use std::collections::HashMap;
use std::fmt;
use std::sync::{LazyLock, Mutex, PoisonError};

use serde::de::{DeserializeSeed, EnumAccess, Error, MapAccess, VariantAccess, Visitor};
use serde::{Deserialize, Deserializer};

use super::kinds::{stated_kind, stated_names};
use super::learning::{RuleDesc, rule};
use super::{Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, Source, Weights};
use crate::numbers;
use crate::synapses::SynapseArrays;
use nsim_ir::base::fixed::SignMode;
use nsim_ir::base::names::did_you_mean;
use nsim_ir::neurons::{Emits, MicrocodeKind, NeuronKind, Port};
use nsim_ir::spanned::{parse_at, raw, refuse};

impl<'de> Deserialize<'de> for Weights {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        match text.as_bytes().first() {
            Some(b'[') => numbers::list_at(text, span).map(Weights::InPlace),
            Some(byte) if byte.is_ascii_alphabetic() => parse_at::<Source, _>(text, span).map(Weights::From),
            _ => refuse(span, "weights are a list of rows or a source such as Npy(\"file.npy\")"),
        }
    }
}

impl<'de> Deserialize<'de> for Parameter {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        match text.chars().next() {
            Some('[') => Ok(Parameter::Each(numbers::list_at::<D::Error>(text, span)?.reals().collect())),
            Some(c) if c.is_ascii_digit() || matches!(c, '+' | '-' | '.') => parse_at(text, span).map(Parameter::Same),
            Some(c) if c.is_ascii_alphabetic() && !text.starts_with("inf") && !text.starts_with("NaN") => {
                parse_at(text, span).map(Parameter::From)
            }
            _ => refuse(span, "expected a number, a list, or a source such as Npy(\"file.npy\")"),
        }
    }
}

/// The names of spike response neurons' parameters.
const SRM: [&str; 4] = ["tau_sr_ms", "tau_ref_ms", "scale_ref", "theta"];

/// The fields of a population of neurons.
fn fields_of(kind: NeuronKind) -> Vec<&'static str> {
    let message = if kind.table().emits == Emits::Values { "message_bits" } else { "payload" };
    ["name", "shape", "start_step", message].into_iter().chain(kind.parameter_names()).collect()
}

/// The names of population kinds, each with the names of its fields.
static FIELDS: LazyLock<Vec<(&'static str, Vec<&'static str>)>> = LazyLock::new(|| {
    let neurons = NeuronKind::ALL.map(|kind| (kind.name(), fields_of(kind)));
    let srm = ("Srm", ["name", "shape"].into_iter().chain(SRM).collect());
    let inputs = [("Input", vec!["name", "shape", "payload", "message_bits"]), ("Signal", vec!["name", "shape"])];
    inputs.into_iter().chain([srm]).chain(neurons).collect()
});
static POPULATIONS: LazyLock<Vec<&'static str>> = LazyLock::new(|| FIELDS.iter().map(|(name, _)| *name).collect());

/// Fields of the declared kinds' populations; leaked, since a kind lasts as long as the process.
static STATED: LazyLock<Mutex<HashMap<MicrocodeKind, &'static [&'static str]>>> = LazyLock::new(Mutex::default);

/// A declared kind by its name, and the fields of its populations.
fn stated(name: &str) -> Option<(MicrocodeKind, &'static [&'static str])> {
    let kind = stated_kind(name)?;
    let mut known = STATED.lock().unwrap_or_else(PoisonError::into_inner);
    Some((kind, *known.entry(kind).or_insert_with(|| fields_of(NeuronKind::Microcode(kind)).leak())))
}

/// The error for a population of an unknown kind.
fn unknown<E: Error>(name: &str) -> E {
    let stated = stated_names();
    if stated.is_empty() {
        return E::unknown_variant(name, &POPULATIONS);
    }
    let known: Vec<&str> = POPULATIONS.iter().copied().chain(stated).collect();
    E::custom(format!(
        "there is no kind '{name}': {}kinds are {}",
        did_you_mean(name, known.iter().copied()),
        known.join(", ")
    ))
}

/// The name of a field or a variant.
struct Identifier(String);

impl<'de> Deserialize<'de> for Identifier {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl Visitor<'_> for Read {
            type Value = Identifier;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a name")
            }
            fn visit_str<E: Error>(self, name: &str) -> Result<Identifier, E> {
                Ok(Identifier(name.to_string()))
            }
        }
        deserializer.deserialize_identifier(Read)
    }
}

impl<'de> Deserialize<'de> for PopulationDesc {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Read;
        impl<'de> Visitor<'de> for Read {
            type Value = PopulationDesc;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("enum Population")
            }
            fn visit_enum<A: EnumAccess<'de>>(self, data: A) -> Result<PopulationDesc, A::Error> {
                let (Identifier(name), variant) = data.variant()?;
                let own = FIELDS.iter().find(|(known, _)| *known == name);
                let value = match (own, stated(&name)) {
                    (Some((name, fields)), _) => {
                        let kind = NeuronKind::ALL.into_iter().find(|kind| kind.name() == *name);
                        Fields { name, kind, fields }
                    }
                    (None, Some((kind, fields))) => {
                        Fields { name: kind.name(), kind: Some(NeuronKind::Microcode(kind)), fields }
                    }
                    (None, None) => return Err(unknown(&name)),
                };
                variant.newtype_variant_seed(value)
            }
        }
        deserializer.deserialize_enum("Population", &POPULATIONS, Read)
    }
}

/// The fields of a population of this name.
struct Fields {
    name: &'static str,
    /// The kind of its neurons; none for `Input`, `Signal` and `Srm`.
    kind: Option<NeuronKind>,
    fields: &'static [&'static str],
}

impl<'de> DeserializeSeed<'de> for Fields {
    type Value = PopulationDesc;
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        deserializer.deserialize_struct(self.name, self.fields, self)
    }
}

impl<'de> Visitor<'de> for Fields {
    type Value = PopulationDesc;
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "struct {}", self.name)
    }
    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Self::Value, A::Error> {
        let (mut name, mut shape) = (None, None);
        let mut built = PopulationDesc::default();
        let mut numbers = [None; SRM.len()];
        let mut values: Vec<Option<Parameter>> = vec![None; self.fields.len()];
        let mut given = Vec::new();
        while let Some(Identifier(key)) = map.next_key()? {
            let Some(place) = self.fields.iter().position(|field| *field == key) else {
                return Err(A::Error::unknown_field(&key, self.fields));
            };
            if given.contains(&place) {
                return Err(A::Error::duplicate_field(self.fields[place]));
            }
            given.push(place);
            let of_srm = self.kind.is_none().then(|| SRM.iter().position(|known| *known == key));
            match (key.as_str(), of_srm.flatten()) {
                ("name", _) => name = Some(map.next_value()?),
                ("shape", _) => shape = Some(map.next_value()?),
                ("start_step", _) => built.start_step = map.next_value::<Option<u32>>()?.unwrap_or(0),
                ("payload", _) => built.payload = map.next_value()?,
                ("message_bits", _) => built.message_bits = map.next_value()?,
                (_, Some(index)) => numbers[index] = Some(map.next_value()?),
                _ => values[place] = map.next_value()?,
            }
        }
        built.name = name.ok_or_else(|| A::Error::missing_field("name"))?;
        built.shape = shape.ok_or_else(|| A::Error::missing_field("shape"))?;
        if let Some(kind) = self.kind {
            let given = self.fields.iter().zip(values).filter_map(|(field, value)| Some((*field, value?)));
            (built.kind, built.loihi) = (kind, Some(given.collect()));
        } else if self.name == "Srm" {
            let mut srm = SRM.map(|name| (name, 0.0));
            for ((name, value), number) in srm.iter_mut().zip(numbers) {
                *value = number.ok_or_else(|| A::Error::missing_field(name))?;
            }
            built.srm = Some(srm);
        }
        built.signal = self.name == "Signal";
        Ok(built)
    }
}

fn synapses<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<(u64, u64, f64)>, D::Error> {
    Vec::deserialize(deserializer).map_err(|error| {
        Error::custom(format!(
            "{error}; a synapse is (source, target, weight), with source and target whole numbers from 0"
        ))
    })
}

/// A projection kind in a file: the fields of all kinds, and its own. (RON has no `serde(flatten)`
/// for structs.)
macro_rules! written {
    ($name:ident { $($(#[$attribute:meta])* $field:ident: $type:ty),* } => $kind:expr) => {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct $name {
            name: Option<String>,
            from: Vec<String>,
            to: String,
            weight_exp: Option<i64>,
            sign: Option<SignMode>,
            weight_bits: Option<i64>,
            delay: Option<u32>,
            weight_scale: Option<f64>,
            port: Option<Port>,
            #[serde(default, deserialize_with = "rule")]
            learning: Option<RuleDesc>,
            $($(#[$attribute])* $field: $type,)*
        }
        impl TryFrom<$name> for ProjectionDesc {
            type Error = &'static str;
            fn try_from(written: $name) -> Result<Self, Self::Error> {
                let $name {
                    name, from, to, weight_exp, sign, weight_bits, delay, weight_scale, port, learning, $($field),*
                } = written;
                let usual = ProjectionDesc::new("", &to, $kind);
                Ok(ProjectionDesc {
                    name,
                    learning,
                    from,
                    weight_exp,
                    sign,
                    weight_bits: weight_bits.unwrap_or(usual.weight_bits),
                    delay: delay.unwrap_or(usual.delay),
                    weight_scale,
                    port: port.unwrap_or_default(),
                    ..usual
                })
            }
        }
    };
}

type Pair = Option<(u64, u64)>;

written!(Dense { weights: Weights } => ProjectionKind::Dense(weights));
written!(Sparse {
    #[serde(default, deserialize_with = "synapses")]
    synapses: Vec<(u64, u64, f64)>,
    arrays: Option<SynapseArrays>
} => match arrays {
    Some(_) if !synapses.is_empty() => return Err("both synapses and arrays are given"),
    Some(arrays) => ProjectionKind::Arrays(arrays),
    None => ProjectionKind::Sparse(synapses),
});
written!(Conv2d {
    weights: Weights,
    stride: Pair,
    padding: Pair,
    padding_after: Pair,
    dilation: Pair,
    groups: Option<u64>
} => {
    let padding = padding.unwrap_or((0, 0));
    ProjectionKind::Conv2d {
        weights,
        stride: stride.unwrap_or((1, 1)),
        padding,
        padding_after: padding_after.unwrap_or(padding),
        dilation: dilation.unwrap_or((1, 1)),
        groups: groups.unwrap_or(1),
    }
});
written!(SumPool2d {
    kernel: (u64, u64),
    stride: Pair,
    padding: Pair,
    padding_after: Pair,
    weight: f64
} => {
    let (stride, padding) = (stride.unwrap_or(kernel), padding.unwrap_or((0, 0)));
    ProjectionKind::SumPool2d { kernel, stride, padding, padding_after: padding_after.unwrap_or(padding), weight }
});
written!(Random { fan_out: u64, low: i64, high: i64, seed: u64 } => {
    ProjectionKind::Random { fan_out, low, high, seed }
});

#[derive(Deserialize)]
#[serde(rename = "Projection")]
enum Written {
    Dense(Dense),
    Sparse(Sparse),
    Conv2d(Conv2d),
    SumPool2d(SumPool2d),
    Random(Random),
}

impl<'de> Deserialize<'de> for ProjectionDesc {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let built = match Written::deserialize(deserializer)? {
            Written::Dense(written) => written.try_into(),
            Written::Sparse(written) => written.try_into(),
            Written::Conv2d(written) => written.try_into(),
            Written::SumPool2d(written) => written.try_into(),
            Written::Random(written) => written.try_into(),
        };
        built.map_err(D::Error::custom)
    }
}
