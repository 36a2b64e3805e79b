//! Learning rules compiled for the machine: `docs/learning.md`, equations (L3) to (L7).
//!
//! Input: a rule of the network. Output: [`Compiled`], which computes histories of traces and the
//! change of a synapse from numbers that the machine looks up. The golden interpreter walks the
//! rule itself.

use nsim_ir::base::fixed::{SignMode, WeightBits};
use nsim_ir::learning::{
    Dependency, Factor, GREATEST_TRACE, Graded, Impulse, LearningSemantics, Product, Quantity, Rule, TRACES, Trace,
    Variable,
};
use nsim_ir::quantised::connectivity::SynapseFormat;

/// Values of a trace whose decay is tabulated: lava's overwritten traces have 8 bits.
const TABULATED: usize = 256;
/// Time constant of traces that a signal replaces, in steps (lava's `tau` of third factors).
const SIGNAL_TAU: f64 = 65_535.0;

/// Decay of a trace in a step, by its value: the whole part, and the fraction that may be added.
#[derive(Debug, Clone)]
pub struct Decay(Box<[(i16, f64); TABULATED]>);

impl Decay {
    fn new(tau: f64) -> Self {
        let factor = libm::exp(-1.0 / tau);
        let mut table = Box::new([(0, 0.0); TABULATED]);
        for (value, entry) in table.iter_mut().enumerate() {
            let z = factor * value as f64;
            *entry = (z.floor() as i16, z - z.floor());
        }
        Decay(table)
    }

    /// The value after a step, with a random number from 0 to below 1.
    #[inline]
    pub fn after(&self, value: i16, draw: impl FnOnce() -> f64) -> i16 {
        let (whole, fraction) = self.0[value as usize % TABULATED];
        if fraction > 0.0 { whole + i16::from(draw() < fraction) } else { whole }
    }
}

/// The value of a trace that a signal replaces, a step later: (L10).
pub fn decayed_signal(value: i32, draw: f64) -> i32 {
    let z = libm::exp(-1.0 / SIGNAL_TAU) * f64::from(value);
    z.floor() as i32 + i32::from(draw < z - z.floor())
}

/// A trace with this impulse added; `draw` decides about the fraction.
#[inline]
pub fn add(value: i16, impulse: Impulse, draw: impl FnOnce() -> u16) -> i16 {
    let fraction = if impulse.fraction > 0 { i16::from(draw() < impulse.fraction) } else { 0 };
    (value + i16::from(impulse.whole) + fraction).clamp(0, GREATEST_TRACE as i16)
}

/// What a factor of a compiled product reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Read {
    /// x0.
    Pre,
    /// y0.
    Post,
    /// A presynaptic trace, 0 or 1.
    X(usize),
    /// A postsynaptic trace, 0 to 2.
    Y(usize),
    /// The weight, the delay or the tag.
    Variable(Variable),
}

#[derive(Debug, Clone, Copy)]
struct CompiledFactor {
    read: Read,
    plus: i32,
    sign: bool,
    /// Least and greatest value that counts.
    range: (i32, i32),
}

/// A product with its shifts.
#[derive(Debug, Clone)]
struct CompiledProduct {
    when: Dependency,
    factors: Box<[CompiledFactor]>,
    mantissa: i32,
    /// Bits that a wide product loses.
    down: u32,
    /// Exponent and the bits of the accumulator's fraction.
    up: u32,
}

/// Which dependencies are true for a synapse in an epoch.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct When {
    /// x0.
    pub pre: bool,
    /// y0.
    pub post: bool,
    /// u.
    pub epoch: bool,
}

impl When {
    #[inline]
    fn holds(self, dependency: Dependency) -> bool {
        match dependency {
            Dependency::Pre => self.pre,
            Dependency::Post => self.post,
            Dependency::Epoch => self.epoch,
        }
    }
}

/// A rule as the machine computes it.
#[derive(Debug, Clone)]
pub struct Compiled {
    rule: Rule,
    /// Decay of each trace; `None` where the trace is always 0.
    decays: [Option<Decay>; TRACES],
    changes: Vec<(Variable, Vec<CompiledProduct>)>,
    accumulator: (i32, i32),
}

impl Compiled {
    /// Compiles a rule.
    pub fn new(rule: &Rule) -> Self {
        let decays = Trace::ALL.map(|trace| {
            let settings = rule.trace(trace);
            let overwritten = trace == Trace::X1 && rule.graded() != Graded::Regular;
            (settings.impulse != Impulse::default() || overwritten).then(|| Decay::new(settings.tau.get()))
        });
        let semantics = rule.semantics();
        let product = |product: &Product| CompiledProduct::new(product, semantics);
        let change = |variable| (variable, rule.products(variable).iter().map(product).collect::<Vec<_>>());
        let changes = Variable::ALL.map(change).into_iter().filter(|(_, products)| !products.is_empty()).collect();
        Compiled { rule: rule.clone(), decays, changes, accumulator: semantics.accumulator() }
    }

    /// The rule.
    pub fn rule(&self) -> &Rule {
        &self.rule
    }

    /// The decay of a trace; `None` where it is always 0.
    pub fn decay(&self, trace: Trace) -> Option<&Decay> {
        self.decays[trace.index()].as_ref()
    }

    /// The impulse of a trace. With a graded x1, spikes add nothing to it.
    pub fn impulse(&self, trace: Trace) -> Impulse {
        match trace == Trace::X1 && self.rule.graded() != Graded::Regular {
            true => Impulse::default(),
            false => self.rule.trace(trace).impulse,
        }
    }

    /// Whether a synapse is evaluated: the dependency of a product is true.
    #[inline]
    pub fn is_evaluated(&self, when: When) -> bool {
        self.changes.iter().flat_map(|(_, products)| products).any(|product| when.holds(product.when))
    }

    /// Whether the rule reads or changes a variable besides the weight.
    pub fn uses(&self, variable: Variable) -> bool {
        self.rule.changes(variable)
            || self
                .rule
                .all_products()
                .any(|product| product.factors.iter().any(|factor| factor.of == Quantity::Variable(variable)))
    }

    /// The accumulators of the changed variables: (L6) up to rounding. `read` gives what a product
    /// of this dependency reads; `old` the variables.
    #[inline]
    pub fn accumulate(
        &self,
        when: When,
        old: impl Fn(Variable) -> i32,
        read: impl Fn(Dependency, Read) -> i32,
        mut change: impl FnMut(Variable, i32),
    ) {
        let (low, high) = self.accumulator;
        for (variable, products) in &self.changes {
            let mut sum = old(*variable) << 7;
            for product in products {
                // A product that waits adds 0, and the sum is clipped.
                if !when.holds(product.when) {
                    sum = sum.clamp(low, high);
                    continue;
                }
                let mut m = 1;
                for factor in &product.factors {
                    let value = factor.plus
                        + match factor.read {
                            Read::Pre => i32::from(when.pre),
                            Read::Post => i32::from(when.post),
                            Read::Variable(variable) => old(variable),
                            trace => read(product.when, trace),
                        };
                    m *= if factor.sign { value.signum() } else { value.clamp(factor.range.0, factor.range.1) };
                }
                m = (m * product.mantissa) >> product.down;
                // At most 2^15 before the shift, and 15 bits of it.
                sum = (sum + (m << product.up).clamp(low, high)).clamp(low, high);
            }
            change(*variable, sum);
        }
    }

    /// The accumulator of a variable without products that count: lava's clip of a tag of -257.
    pub fn unchanged(&self, old: i32) -> i32 {
        (old << 7).clamp(self.accumulator.0, self.accumulator.1)
    }

    /// (L6), (L7): a variable after rounding its accumulator; `draw` is from 0 to below 1.
    #[inline]
    pub fn rounded(&self, variable: Variable, format: SynapseFormat, sum: i32, draw: impl FnOnce() -> f64) -> i16 {
        let step = match (variable, self.rule.semantics()) {
            (Variable::Weight, LearningSemantics::Silicon) => i32::from(format.sign.step(format.bits)),
            _ => 1,
        };
        // Steps are powers of 2.
        let unit = step << 7;
        let (whole, rest) = (sum >> unit.trailing_zeros(), sum & (unit - 1));
        let up = i32::from(rest > 0 && draw() < f64::from(rest) / f64::from(unit));
        let (low, high) = self.range(variable, format);
        (step * (whole + up)).clamp(low, high) as i16
    }

    /// The values of a variable.
    fn range(&self, variable: Variable, format: SynapseFormat) -> (i32, i32) {
        let semantics = self.rule.semantics();
        match (variable, semantics, format.sign) {
            (Variable::Delay, ..) => semantics.delays(),
            (Variable::Tag, ..) => semantics.tags(),
            (Variable::Weight, LearningSemantics::Silicon, sign) => {
                let (low, high) = sign.range(format.bits);
                (low.into(), high.into())
            }
            (Variable::Weight, LearningSemantics::Lava, SignMode::Mixed) => (-256, 255),
            (Variable::Weight, LearningSemantics::Lava, SignMode::Excitatory) => (0, 255),
            (Variable::Weight, LearningSemantics::Lava, SignMode::Inhibitory) => (-255, 0),
        }
    }
}

impl CompiledProduct {
    fn new(product: &Product, semantics: LearningSemantics) -> Self {
        let factor = |&Factor { of, plus, sign }: &Factor| {
            let bits = of.bits();
            let read = match of {
                Quantity::Pre => Read::Pre,
                Quantity::Post => Read::Post,
                Quantity::Trace(trace) if trace.is_presynaptic() => Read::X(trace.index()),
                Quantity::Trace(trace) => Read::Y(trace.index() - 2),
                Quantity::Variable(variable) => Read::Variable(variable),
            };
            CompiledFactor { read, plus, sign, range: (-(1 << bits), (1 << bits) - 1) }
        };
        CompiledProduct {
            when: product.when,
            factors: product.factors.iter().map(factor).collect(),
            mantissa: product.mantissa.into(),
            down: (product.bits() + semantics.mantissa_bits()).saturating_sub(15),
            up: (i32::from(product.exponent) + 7) as u32,
        }
    }
}

/// The greatest magnitude of a weight that a rule may reach in a format.
pub fn greatest_weight(format: SynapseFormat) -> i16 {
    let (low, high) = format.sign.range(WeightBits::MAX);
    low.abs().max(high.abs())
}
