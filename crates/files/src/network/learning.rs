//! Learning rules as a model file states them: `learning: Rule(..)`.

use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::learning::{Graded, Impulse, Tau, TraceSettings, Variable};
use nsim_ir::spanned::{parse, parse_at, raw};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::values::{Number, Source, Weights, is_default};

/// First values of tags or delays.
#[derive(Debug, Clone, PartialEq)]
pub enum PerSynapse {
    /// One value for all synapses.
    Same(f64),
    /// One for each synapse: `[target][source]` for `Dense`, else a list.
    Each(Weights),
}

/// A postsynaptic trace.
#[derive(Debug, Clone, PartialEq)]
pub enum PostTrace {
    /// A trace of the target's spikes.
    Spikes(TraceSettings),
    /// The value of a population in each step.
    Signal(String),
}

/// The reward channel: a trace of the spikes of a population.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct RewardDesc {
    /// The population.
    pub from: String,
    /// Added by a spike.
    pub impulse: Impulse,
    /// Time constant of the decay, in epochs.
    pub tau: Tau,
}

/// The learning rule of a projection.
#[derive(Debug, Clone, Default, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields, rename = "Rule")]
pub struct RuleDesc {
    /// Whether it is PES, whose error is `y1`.
    #[serde(skip)]
    pub is_pes: bool,
    /// The change of weights.
    #[serde(skip_serializing_if = "is_default")]
    pub dw: String,
    /// The change of delays.
    #[serde(skip_serializing_if = "is_default")]
    pub dd: String,
    /// The change of tags.
    #[serde(skip_serializing_if = "is_default")]
    pub dt: String,
    /// Steps of an epoch.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub epoch: Option<i64>,
    /// The first presynaptic trace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x1: Option<TraceSettings>,
    /// The second presynaptic trace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub x2: Option<TraceSettings>,
    /// The first postsynaptic trace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y1: Option<PostTrace>,
    /// The second postsynaptic trace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y2: Option<PostTrace>,
    /// The third postsynaptic trace.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub y3: Option<PostTrace>,
    /// The reward channel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub r1: Option<RewardDesc>,
    /// First tags.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tags: Option<PerSynapse>,
    /// First delays, where they do not act.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delays: Option<PerSynapse>,
    /// Use of payloads by x1.
    #[serde(skip_serializing_if = "is_default")]
    pub graded: Graded,
    /// The last step that learns.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub until: Option<u32>,
}

/// The rule PES as a model file states it.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Pes {
    /// The population of its error, which is y1 of the description.
    error: String,
    x1: TraceSettings,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    until: Option<u32>,
}

/// A rule as a model file states it.
#[derive(Serialize)]
#[serde(untagged)]
pub(super) enum Written<'a> {
    Rule(&'a RuleDesc),
    Pes(Pes),
}

/// A rule alone in a text.
#[derive(Deserialize)]
#[serde(transparent)]
struct Stated(#[serde(deserialize_with = "rule")] Option<RuleDesc>);

impl RuleDesc {
    /// The rule of a text, as a model file states it.
    ///
    /// # Errors
    /// `model.learning` at a line and column of the text.
    pub fn from_text(text: &str) -> Result<RuleDesc> {
        let Stated(stated) = parse(&SourceText::new("learning", text), "model.learning")?;
        stated.ok_or_else(|| Diagnostic::new("model.learning", "there is no rule").help("give Rule(..) or Pes(..)"))
    }

    /// The rule, to be written.
    pub(super) fn written(&self) -> Written<'_> {
        match (&self.y1, self.x1) {
            (Some(PostTrace::Signal(error)), Some(x1)) if self.is_pes => {
                Written::Pes(Pes { error: error.clone(), x1, until: self.until })
            }
            _ => Written::Rule(self),
        }
    }

    /// The text of a variable's change; empty without one.
    pub fn change(&self, variable: Variable) -> (&'static str, &str) {
        match variable {
            Variable::Weight => ("dw", &self.dw),
            Variable::Delay => ("dd", &self.dd),
            Variable::Tag => ("dt", &self.dt),
        }
    }

    /// The postsynaptic traces, by name.
    pub fn post_traces(&self) -> [(&'static str, Option<&PostTrace>); 3] {
        [
            (if self.is_pes { "error" } else { "y1" }, self.y1.as_ref()),
            ("y2", self.y2.as_ref()),
            ("y3", self.y3.as_ref()),
        ]
    }

    /// First values of tags and delays that are arrays, by field.
    pub(super) fn arrays_mut(&mut self) -> impl Iterator<Item = (&'static str, &mut Weights)> {
        let arrays = [("tags", &mut self.tags), ("delays", &mut self.delays)];
        arrays.into_iter().filter_map(|(field, values)| match values {
            Some(PerSynapse::Each(values)) => Some((field, values)),
            _ => None,
        })
    }

    /// First values that are elsewhere, by field.
    pub(super) fn sources(&self) -> impl Iterator<Item = (&'static str, &Source)> {
        let arrays = [("tags", &self.tags), ("delays", &self.delays)];
        arrays.into_iter().filter_map(|(field, values)| match values {
            Some(PerSynapse::Each(Weights::From(source))) => Some((field, source)),
            _ => None,
        })
    }
}

/// Reads a rule, and refuses what is known but not supported.
pub(super) fn rule<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<RuleDesc>, D::Error> {
    let (text, span) = raw(deserializer)?;
    if text.starts_with("Pes") {
        let Pes { error, x1, until } = parse_at(text, span)?;
        let y1 = Some(PostTrace::Signal(error));
        return Ok(Some(RuleDesc { is_pes: true, x1: Some(x1), y1, until, ..RuleDesc::default() }));
    }
    parse_at(text, span)
}

impl<'de> Deserialize<'de> for PerSynapse {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        match text.starts_with(|c: char| c == '[' || c.is_ascii_alphabetic()) {
            true => parse_at(text, span).map(PerSynapse::Each),
            false => parse_at(text, span).map(PerSynapse::Same),
        }
    }
}

impl Serialize for PerSynapse {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            PerSynapse::Same(value) => Number(*value).serialize(serializer),
            PerSynapse::Each(values) => values.serialize(serializer),
        }
    }
}

/// The name of a population of values.
#[derive(Deserialize, Serialize)]
#[serde(rename = "Signal")]
struct Signal(String);

impl<'de> Deserialize<'de> for PostTrace {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let (text, span) = raw(deserializer)?;
        match text.starts_with("Signal") {
            true => parse_at(text, span).map(|Signal(name)| PostTrace::Signal(name)),
            false => parse_at(text, span).map(PostTrace::Spikes),
        }
    }
}

impl Serialize for PostTrace {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            PostTrace::Spikes(settings) => settings.serialize(serializer),
            PostTrace::Signal(name) => Signal(name.clone()).serialize(serializer),
        }
    }
}
