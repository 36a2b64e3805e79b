//! Learning rules as data: what changes the weights, delays and tags of plastic synapses.
//!
//! A [`Rule`] is a sum of [`Product`]s for each of three [`Variable`]s of a synapse. Time is divided
//! into epochs of E steps. Spikes are noted during an epoch; variables and traces change at its
//! end.

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use crate::base::id::{PopulationId, RuleId};
use crate::base::names::named_variants;

/// The most steps of an epoch: 6 bits (Davies et al. 2018).
pub const LONGEST_EPOCH: u8 = 63;
/// Steps of an epoch of PES.
pub const PES_EPOCH: u8 = 4;
/// Steps after which traces of PES change.
pub const PES_TRACE_EPOCH: u32 = 2;
/// The greatest magnitude of an error of PES.
pub const GREATEST_ERROR: i32 = 127;
/// The most that the products of a change may add up to in Brian, which clips none of them.
pub const MOST_CHANGE: f64 = 4_194_304.0;
/// The greatest k of a dependency u_k.
pub const SLOWEST: u8 = 9;
/// Mantissas of products: 4 bits.
pub const MANTISSAS: std::ops::RangeInclusive<i64> = -8..=7;
/// Exponents of products: 4 bits.
pub const EXPONENTS: std::ops::RangeInclusive<i64> = -7..=8;
/// The greatest sum of a product's widths, with 4 bits of its mantissa, that 32-bit products hold.
pub const WIDEST: u32 = 31;
/// Greatest value of a trace: 7 bits.
pub const GREATEST_TRACE: i32 = 127;
/// The most traces of a rule.
pub const TRACES: usize = 6;

named_variants! {
    /// A variable of a plastic synapse.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
    pub enum Variable {
        /// The weight mantissa, w.
        Weight = "weight",
        /// The delay, d.
        Delay = "delay",
        /// The tag, t.
        Tag = "tag",
    }
}

named_variants! {
    /// A trace of the spikes of a synapse's source (x) or target (y), or of a reward (r).
    #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
    pub enum Trace {
        /// The first presynaptic trace.
        X1 = "x1",
        /// The second presynaptic trace.
        X2 = "x2",
        /// The first postsynaptic trace.
        Y1 = "y1",
        /// The second postsynaptic trace.
        Y2 = "y2",
        /// The third postsynaptic trace.
        Y3 = "y3",
        /// The reward channel, a trace of the spikes of a population that all synapses share.
        R1 = "r1",
    }
}

impl Trace {
    /// Its place among a rule's traces.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Whether it belongs to the source.
    pub const fn is_presynaptic(self) -> bool {
        matches!(self, Trace::X1 | Trace::X2)
    }
}

/// What a product waits for: it counts in the epochs in which this is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Dependency {
    /// x0: a spike of the source was noted.
    Pre,
    /// y0: a spike of the target was noted.
    Post,
    /// u_k: every 2^k-th epoch, for the k of the rule.
    Epoch,
}

/// What a factor reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Quantity {
    /// 1 in an epoch with a noted spike of the source, else 0.
    Pre,
    /// 1 in an epoch with a noted spike of the target, else 0.
    Post,
    /// A trace, at the time of the product's dependency.
    Trace(Trace),
    /// A variable of the synapse, before this epoch's learning.
    Variable(Variable),
}

impl Quantity {
    /// Its width in bits.
    pub const fn bits(self) -> u32 {
        match self {
            Quantity::Pre | Quantity::Post => 1,
            Quantity::Trace(_) => 7,
            Quantity::Variable(_) => 9,
        }
    }
}

/// A factor: a quantity plus a constant, or the sign of that sum.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Factor {
    /// What it reads.
    pub of: Quantity,
    /// Added to it.
    pub plus: i32,
    /// Whether only the sign counts: -1, 0 or 1.
    pub sign: bool,
}

/// A product of a rule: mantissa * 2^exponent * factors, where its dependency is true.
#[derive(Debug, Clone, PartialEq, Eq, Hash)]
pub struct Product {
    /// When it counts.
    pub when: Dependency,
    /// One of [`MANTISSAS`].
    pub mantissa: i8,
    /// One of [`EXPONENTS`].
    pub exponent: i8,
    /// The factors, in the order in which they are multiplied.
    pub factors: Vec<Factor>,
}

impl Product {
    /// Sum of its factors' widths, in bits.
    pub fn bits(&self) -> u32 {
        self.factors.iter().map(|factor| factor.of.bits()).sum()
    }

    /// A bound on its magnitude, where factors are not clipped.
    fn most(&self) -> f64 {
        fn greatest(factor: &Factor) -> f64 {
            match factor.sign {
                true => 1.0,
                false => f64::from(1 << factor.of.bits()) + f64::from(factor.plus).abs(),
            }
        }
        let factors: f64 = self.factors.iter().map(greatest).product();
        f64::from(self.mantissa).abs() * 2f64.powi(self.exponent.into()) * factors
    }
}

/// The change of one variable: products in the order in which they are added, with one k of u.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Change {
    pub(super) products: Vec<Product>,
    pub(super) slow: Option<u8>,
}

impl Change {
    /// The products.
    pub fn products(&self) -> &[Product] {
        &self.products
    }
}

named_variants! {
    /// Arithmetic of learning (`docs/learning.md`).
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
    pub enum LearningSemantics {
        /// What is known of the chip, on lava's arithmetic.
        #[default]
        Silicon = "Silicon",
        /// lava-nc's, exactly.
        Lava = "Lava",
        /// nengo-loihi's rule PES, exactly. Weights learn from an error, which is a signal.
        Nengo = "Nengo",
        /// brian2-loihi's, in distribution. Weights learn in each step.
        Brian = "Brian",
    }
}

impl LearningSemantics {
    /// Bits of a product's mantissa, as its width counts them.
    pub const fn mantissa_bits(self) -> u32 {
        match self {
            LearningSemantics::Lava => 4,
            _ => 3,
        }
    }

    /// The values of a tag.
    pub const fn tags(self) -> (i32, i32) {
        match self {
            LearningSemantics::Lava => (-257, 255),
            LearningSemantics::Silicon => (-256, 255),
            LearningSemantics::Nengo | LearningSemantics::Brian => (0, 0),
        }
    }

    /// The values of a delay that a rule learns: a number of the synapse in lava.
    pub const fn delays(self) -> (i32, i32) {
        match self {
            LearningSemantics::Lava => (0, 255),
            LearningSemantics::Silicon => (0, 62),
            LearningSemantics::Nengo | LearningSemantics::Brian => (0, 0),
        }
    }

    /// The values of an accumulator. Those of Brian exceed what its rules reach.
    pub const fn accumulator(self) -> (i32, i32) {
        match self {
            LearningSemantics::Lava => (-32_769, 32_767),
            LearningSemantics::Brian => (-(MOST_CHANGE as i32) << 8, (MOST_CHANGE as i32) << 8),
            LearningSemantics::Silicon | LearningSemantics::Nengo => (-32_768, 32_767),
        }
    }

    /// Whether a synapse's delay is the d of its rule, which acts on arrivals and on the noting of
    /// presynaptic spikes.
    pub const fn delays_act(self) -> bool {
        matches!(self, LearningSemantics::Silicon)
    }
}

/// A time constant in steps, finite and not negative.
#[derive(Debug, Clone, Copy, Default, Deserialize, Serialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Tau(f64);

impl Tau {
    /// The time constant.
    pub fn get(self) -> f64 {
        self.0
    }
}

impl PartialEq for Tau {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Eq for Tau {}

impl From<Tau> for f64 {
    fn from(tau: Tau) -> f64 {
        tau.0
    }
}

impl TryFrom<f64> for Tau {
    type Error = String;

    fn try_from(tau: f64) -> Result<Self, String> {
        match tau >= 0.0 && tau.is_finite() {
            true => Ok(Tau(tau.abs())),
            false => Err(format!("a tau of {tau} steps is not from 0 to any finite number")),
        }
    }
}

/// The impulse of a trace: a whole number, and a fraction in 256ths.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct Impulse {
    /// The whole part, at most [`GREATEST_TRACE`].
    pub whole: u8,
    /// The rest, rounded to 256ths, 0 to 256.
    pub fraction: u16,
}

impl From<Impulse> for f64 {
    fn from(impulse: Impulse) -> f64 {
        f64::from(impulse.whole) + f64::from(impulse.fraction) / 256.0
    }
}

impl TryFrom<f64> for Impulse {
    type Error = String;

    fn try_from(impulse: f64) -> Result<Self, String> {
        if !(0.0..128.0).contains(&impulse) {
            return Err(format!("an impulse of {impulse} is not from 0 to below 128"));
        }
        let whole = impulse.floor();
        Ok(Impulse { whole: whole as u8, fraction: ((impulse - whole) * 256.0).round_ties_even() as u16 })
    }
}

/// What a spike adds to a trace, and how the trace decays.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "Trace")]
pub struct TraceSettings {
    /// Added by a spike.
    pub impulse: Impulse,
    /// Time constant of the decay, in steps.
    pub tau: Tau,
}

named_variants! {
    /// Use of a graded spike's payload by the trace x1 (lava's `GradedSpikeCfg`).
    #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
    pub enum Graded {
        /// None: a graded spike is a spike.
        #[default]
        Regular = "Regular",
        /// Half the payload replaces the trace.
        Overwrite = "Overwrite",
        /// Half the payload is added, at most to 127.
        AddSaturating = "AddSaturating",
        /// Half the payload is added; beyond 127 the trace starts again, and a spike is noted.
        AddWithoutSaturation = "AddWithoutSaturation",
    }
}

/// A checked rule: what changes at the end of its epochs.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields, try_from = "RuleText", into = "RuleText")]
pub struct Rule {
    changes: [Change; 3],
    slow: u8,
    epoch: u8,
    traces: [TraceSettings; TRACES],
    semantics: LearningSemantics,
    graded: Graded,
    until: Option<u32>,
}

/// The fields of a [`Rule`], unchecked.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields, rename = "Rule")]
pub struct RuleText {
    /// Changes of weight, delay and tag.
    pub changes: [Change; 3],
    /// Steps of an epoch.
    pub epoch: u8,
    /// Traces, in the order of [`Trace`].
    pub traces: [TraceSettings; TRACES],
    /// Its arithmetic.
    pub semantics: LearningSemantics,
    /// Use of payloads by x1.
    pub graded: Graded,
    /// The last step that may learn; `None` where learning never ends.
    pub until: Option<u32>,
}

impl From<Rule> for RuleText {
    fn from(rule: Rule) -> Self {
        let Rule { changes, epoch, traces, semantics, graded, until, .. } = rule;
        RuleText { changes, epoch, traces, semantics, graded, until }
    }
}

impl TryFrom<RuleText> for Rule {
    type Error = String;

    fn try_from(text: RuleText) -> Result<Self, String> {
        Rule::new(text).map_err(|problem| problem.to_string())
    }
}

/// Reason why fields make no rule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {message}: {help}")]
pub struct RuleProblem {
    /// The field, or none for the rule as a whole.
    pub field: &'static str,
    /// A sentence.
    pub message: String,
    /// The remedy.
    pub help: &'static str,
}

fn refused<T>(field: &'static str, message: impl Into<String>, help: &'static str) -> Result<T, RuleProblem> {
    Err(RuleProblem { field, message: message.into(), help })
}

impl RuleText {
    /// Refuses what the semantics lack.
    fn check_semantics(&self) -> Result<(), RuleProblem> {
        let semantics = self.semantics;
        let products = || self.changes.iter().flat_map(|change| &change.products);
        let reads = |quantity| products().flat_map(|product| &product.factors).any(|factor| factor.of == quantity);
        if semantics == LearningSemantics::Nengo && (self.epoch != PES_EPOCH || products().next().is_some()) {
            return refused("", format!("PES has an epoch of {PES_EPOCH} and no products"), "remove them");
        }
        let rewards = self.traces[Trace::R1.index()] != TraceSettings::default();
        if semantics != LearningSemantics::Silicon && (rewards || reads(Quantity::Trace(Trace::R1))) {
            let field = if rewards { "r1" } else { "" };
            let message = format!("learning semantics {semantics:?} lack the reward channel r1");
            return refused(field, message, "write y2: Signal(\"..\"), or learning_semantics: Silicon");
        }
        if semantics != LearningSemantics::Brian {
            return Ok(());
        }
        let remedy = "remove it, or write learning_semantics: Silicon";
        for (variable, field) in [(Variable::Delay, "dd"), (Variable::Tag, "dt")] {
            let changes = !self.changes[variable as usize].products.is_empty();
            if changes || reads(Quantity::Variable(variable)) {
                let what = variable.name();
                let message = format!("learning semantics Brian lack the variable {what}");
                return refused(if changes { field } else { "dw" }, message, remedy);
            }
        }
        if self.epoch != 1 || self.graded != Graded::Regular {
            let field = if self.epoch != 1 { "epoch" } else { "graded" };
            return refused(field, "in learning semantics Brian spikes have no payload, and each step learns", remedy);
        }
        for (trace, settings) in Trace::ALL.into_iter().zip(self.traces) {
            let (tau, Impulse { whole, fraction }) = (settings.tau.get(), settings.impulse);
            if fraction != 0 || whole > 0 && (tau < 1.0 || tau.fract() != 0.0) {
                let message =
                    format!("learning semantics Brian have whole impulses, and whole taus from 1; tau is {tau}");
                return refused(trace.name(), message, "round them");
            }
        }
        let most: f64 = products().map(Product::most).sum();
        if most > MOST_CHANGE {
            let message = format!("the products may add up to {most}, the limit is {MOST_CHANGE}");
            return refused("dw", message, "use fewer factors, or smaller numbers");
        }
        Ok(())
    }
}

impl Rule {
    /// A rule from its fields. One without changes is allowed: its weights change by writing.
    ///
    /// # Errors
    /// A [`RuleProblem`]: the epoch is not 1 to [`LONGEST_EPOCH`], two changes have different k of
    /// u, or the semantics lack what a field states.
    pub fn new(text: RuleText) -> Result<Self, RuleProblem> {
        if !(1..=LONGEST_EPOCH).contains(&text.epoch) {
            let message = format!("an epoch of {} steps is not 1 to {LONGEST_EPOCH}", text.epoch);
            return refused("epoch", message, "give the number of steps after which synapses learn");
        }
        text.check_semantics()?;
        let RuleText { changes, epoch, traces, semantics, graded, until } = text;
        let mut slow = changes.iter().filter_map(|change| change.slow);
        let first = slow.next();
        if let Some(other) = slow.find(|k| Some(*k) != first) {
            let message =
                format!("a rule has one u for all its changes, but u{} and u{other} are used", first.unwrap_or(0));
            return refused("", message, "use one of them");
        }
        Ok(Rule { changes, slow: first.unwrap_or(0), epoch, traces, semantics, graded, until })
    }

    /// A rule that changes nothing: weights change only by writing them.
    pub fn written() -> Self {
        Rule { epoch: 1, ..Rule::default() }
    }

    /// PES, with the trace of its sources.
    pub fn pes(x1: TraceSettings, until: Option<u32>) -> Self {
        let semantics = LearningSemantics::Nengo;
        let mut rule = Rule { epoch: PES_EPOCH, semantics, until, ..Rule::default() };
        rule.traces[Trace::X1.index()] = x1;
        rule
    }

    /// Whether it is PES, which has no products.
    pub fn is_pes(&self) -> bool {
        self.semantics == LearningSemantics::Nengo
    }

    /// Whether it changes synapses by itself: by its products, or as PES.
    pub fn is_active(&self) -> bool {
        self.learns() || self.is_pes()
    }

    /// Steps after which an engine learns from a spike that it has delivered in a step.
    pub fn lag(&self) -> u32 {
        u32::from(!self.is_pes())
    }

    /// The products that change a variable, in order; none where the rule leaves it.
    pub fn products(&self, variable: Variable) -> &[Product] {
        &self.change(variable).products
    }

    /// The change of a variable, which is written as text.
    pub fn change(&self, variable: Variable) -> &Change {
        &self.changes[variable as usize]
    }

    /// Whether the rule changes a variable.
    pub fn changes(&self, variable: Variable) -> bool {
        !self.products(variable).is_empty()
    }

    /// Every product.
    pub fn all_products(&self) -> impl Iterator<Item = &Product> {
        self.changes.iter().flat_map(|change| &change.products)
    }

    /// Whether its products change anything.
    pub fn learns(&self) -> bool {
        self.all_products().next().is_some()
    }

    /// Whether a product waits for this dependency.
    pub fn waits_for(&self, dependency: Dependency) -> bool {
        self.all_products().any(|product| product.when == dependency)
    }

    /// Steps of an epoch, 1 to [`LONGEST_EPOCH`].
    pub fn epoch(&self) -> u32 {
        self.epoch.into()
    }

    /// k of the dependency u_k, which is true in every 2^k-th epoch.
    pub fn slow(&self) -> u8 {
        self.slow
    }

    /// The settings of a trace.
    pub fn trace(&self, trace: Trace) -> TraceSettings {
        self.traces[trace.index()]
    }

    /// Its arithmetic.
    pub fn semantics(&self) -> LearningSemantics {
        self.semantics
    }

    /// Use of payloads by x1.
    pub fn graded(&self) -> Graded {
        self.graded
    }

    /// The last step that may learn.
    pub fn until(&self) -> Option<u32> {
        self.until
    }

    /// Whether spikes of a step are noted: its epoch does not end after `until`.
    pub fn notes(&self, step: u32) -> bool {
        let end = u64::from(step / self.epoch() + 1) * u64::from(self.epoch()) - 1;
        self.until.is_none_or(|until| end <= until.into())
    }

    /// Whether the rule learns after a step: the last of an epoch whose spikes are noted.
    pub fn learns_after(&self, step: u32) -> bool {
        (u64::from(step) + 1).is_multiple_of(self.epoch.into()) && self.notes(step)
    }
}

/// A rule of a network, with its name.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Learning {
    /// The name of the projection that it changes, unique in its network.
    pub name: String,
    /// The rule.
    pub rule: Rule,
}

/// The plastic synapses of a projection, source by source in the order of their numbers.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Plastic {
    /// The rule that changes them.
    pub rule: RuleId,
    /// Index of the projection's first source among the sources of the rule.
    pub first_source: u32,
    /// Row of each synapse among those of the rule, in the order of the model file; each row once.
    pub rows: Arc<[u32]>,
    /// First tag of each synapse; empty where all are 0.
    pub tags: Arc<[i16]>,
    /// First delay of each synapse where delays do not act; empty where all are 0.
    pub delays: Arc<[i16]>,
    /// The input populations whose values replace y1, y2 and y3: one for each target, or one for
    /// all of them. The first of PES is its error, with a value for each pair of targets.
    pub signals: [Option<PopulationId>; 3],
    /// The population whose spikes r1 is a trace of.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reward: Option<PopulationId>,
}

impl Plastic {
    /// The first tag of a synapse.
    pub fn tag(&self, number: usize) -> i16 {
        self.tags.get(number).copied().unwrap_or(0)
    }

    /// The first delay of a synapse where delays do not act.
    pub fn delay(&self, number: usize) -> i16 {
        self.delays.get(number).copied().unwrap_or(0)
    }
}

/// A column of a rule's state, read after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Column {
    /// A variable of each synapse, by row.
    Variable(Variable),
    /// A trace of each source or target.
    Trace(Trace),
}
