//! The mirror of a sweep file (`docs/sweep.md` describes each field).

use std::fmt;

use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer};

use nsim_ir::spanned::Spanned;

/// A value in the syntax of `--set PATH=VALUE`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ValueText(pub String);

impl<'de> Deserialize<'de> for ValueText {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Any;
        impl Visitor<'_> for Any {
            type Value = ValueText;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, true, false, or a text, as after --set")
            }

            fn visit_bool<E>(self, value: bool) -> Result<ValueText, E> {
                Ok(ValueText(value.to_string()))
            }

            fn visit_i64<E>(self, value: i64) -> Result<ValueText, E> {
                Ok(ValueText(value.to_string()))
            }

            fn visit_u64<E>(self, value: u64) -> Result<ValueText, E> {
                Ok(ValueText(value.to_string()))
            }

            fn visit_f64<E>(self, value: f64) -> Result<ValueText, E> {
                Ok(ValueText(format!("{value:?}")))
            }

            fn visit_str<E>(self, value: &str) -> Result<ValueText, E> {
                Ok(ValueText(value.to_string()))
            }
        }
        deserializer.deserialize_any(Any)
    }
}

/// Values by path, in the order of the file.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Values(pub Vec<(String, ValueText)>);

impl<'de> Deserialize<'de> for Values {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Values;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("values by path, such as {\"populations.out.vth_mant\": 900}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Values, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Values(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

/// Paths that take the same value, and their values.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisDesc {
    /// The column's name; the path when there is one.
    #[serde(default)]
    pub name: Option<String>,
    /// Changed paths.
    pub paths: Vec<String>,
    /// The values.
    #[serde(default)]
    pub values: Vec<ValueText>,
    /// The first value, in place of `values`.
    #[serde(default)]
    pub from: Option<f64>,
    /// The last value.
    #[serde(default)]
    pub to: Option<f64>,
    /// The distance of neighbouring values.
    #[serde(default)]
    pub step: Option<f64>,
}

fn one() -> u32 {
    1
}

/// A sweep.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Sweep")]
pub struct SweepFile {
    /// A model file or the name of a shipped model; `vtsnn-slip` where nothing is trained.
    #[serde(default)]
    pub model: Option<String>,
    /// A training file or the name of a shipped one, instead of a model.
    #[serde(default)]
    pub train: Option<String>,
    /// A target file or the name of a shipped target; else the model's own, or the usual one.
    #[serde(default)]
    pub target: Option<String>,
    /// Sources of spikes, as `--input`; the model's scene when omitted.
    #[serde(default)]
    pub input: Vec<String>,
    /// Range of samples, such as `0..20`; all when omitted.
    #[serde(default)]
    pub samples: Option<String>,
    /// Seed of a scene.
    #[serde(default)]
    pub seed: Option<u64>,
    /// Copies of the model.
    #[serde(default = "one")]
    pub copies: u32,
    /// Values of all variants.
    #[serde(default)]
    pub set: Values,
    /// Every combination of these, the last one changing fastest.
    #[serde(default)]
    pub grid: Vec<Spanned<AxisDesc>>,
    /// Variants one by one; with a grid, each with every combination of it.
    #[serde(default)]
    pub list: Vec<Values>,
}
