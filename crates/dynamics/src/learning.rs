//! Learning rules compiled for the machine: `docs/learning.md`, equations (L3) to (L7).
//!
//! Input: a rule of the network. Output: [`Compiled`], which computes histories of traces and the
//! change of a synapse from numbers that the machine looks up. The golden interpreter walks the
//! rule itself.

use nsim_ir::base::fixed::SignMode;
use nsim_ir::learning::{
    Dependency, Factor, GREATEST_TRACE, Graded, Impulse, LearningSemantics, Product, Quantity, Rule, TRACES, Trace,
    Variable,
};
use nsim_ir::quantised::connectivity::SynapseFormat;

/// Values of a trace whose decay is tabulated: lava's overwritten traces have 8 bits.
const TABULATED: usize = 256;
/// Time constant of traces that a signal replaces, in steps (lava's `tau` of third factors).
const SIGNAL_TAU: f64 = 65_535.0;

/// Decay of a trace in a step, by its value.
#[derive(Debug, Clone)]
pub struct Decay {
    /// The value without its fraction.
    wholes: [u8; TABULATED],
    /// The fraction, with which 1 is added.
    fractions: [f64; TABULATED],
    /// The numbers of 32 random bits that are below the fraction.
    shares: [u64; TABULATED],
}

impl Decay {
    /// The decay with this factor in a step, from 0 to 1.
    fn new(factor: f64) -> Self {
        let z = |value: usize| factor * value as f64;
        let fractions = std::array::from_fn(|value| z(value) - z(value).floor());
        Decay {
            wholes: std::array::from_fn(|value| z(value).floor() as u8),
            fractions,
            shares: fractions.map(|fraction| (fraction * 2f64.powi(32)).ceil() as u64),
        }
    }

    /// The value of each value after a step, with a random number from 0 to below 1 for all.
    pub fn after_all(&self, draw: f64) -> [u8; TABULATED] {
        std::array::from_fn(|value| self.wholes[value] + u8::from(draw < self.fractions[value]))
    }

    /// The value after a step, with 32 random bits. `before` decides about the fraction: the value
    /// itself, or in (L15) that before the last spike.
    #[inline(always)]
    pub fn after(&self, value: u8, before: u8, bits: u32) -> u8 {
        self.wholes[usize::from(value)] + u8::from(u64::from(bits) < self.shares[usize::from(before)])
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
enum Read {
    /// x0.
    Pre,
    /// y0.
    Post,
    /// A presynaptic trace, 0 or 1.
    X(usize),
    /// A postsynaptic trace, 0 to 2, or 3 for the reward.
    Y(usize),
    Variable(Variable),
}

/// The number of the reward channel after those of postsynaptic traces.
pub const REWARD: usize = 3;
/// The most synapses that are evaluated together, so that a rule is interpreted once for all.
pub const BATCH: usize = 256;

/// Intermediate values of as many synapses.
#[derive(Debug)]
pub struct Scratch([[i32; BATCH]; 3]);

impl Default for Scratch {
    fn default() -> Self {
        Scratch([[0; BATCH]; 3])
    }
}

/// Synapses for which the same dependencies are true. Each function writes one value a synapse;
/// variables are those before this epoch's learning.
pub trait Synapses {
    /// Their number, at most [`BATCH`].
    fn number(&self) -> usize;
    /// A presynaptic trace, 0 or 1, at the time of a dependency.
    fn x(&self, trace: usize, at: Dependency, values: &mut [i32]);
    /// A postsynaptic trace, 0 to 2, or [`REWARD`], at the time of a dependency.
    fn y(&self, trace: usize, at: Dependency, values: &mut [i32]);
    /// A variable.
    fn variable(&self, variable: Variable, values: &mut [i32]);
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
    /// How many there are.
    pub const COUNT: usize = 8;

    /// Every one, by [`Self::index`].
    pub fn all() -> [When; When::COUNT] {
        std::array::from_fn(|index| When { pre: index & 1 > 0, post: index & 2 > 0, epoch: index & 4 > 0 })
    }

    /// Its place among all.
    #[inline]
    pub fn index(self) -> usize {
        usize::from(self.pre) | usize::from(self.post) << 1 | usize::from(self.epoch) << 2
    }

    fn holds(self, dependency: Dependency) -> bool {
        match dependency {
            Dependency::Pre => self.pre,
            Dependency::Post => self.post,
            Dependency::Epoch => self.epoch,
        }
    }
}

/// The change of a variable where some dependencies are true.
#[derive(Debug, Clone)]
pub struct CompiledChange {
    /// The variable.
    pub variable: Variable,
    /// Whether the first product waits: it adds 0, and the sum is clipped.
    clips_first: bool,
    /// The products that count.
    products: Box<[CompiledProduct]>,
}

/// A rule as the machine computes it.
#[derive(Debug, Clone)]
pub struct Compiled {
    rule: Rule,
    /// Decay of each trace; `None` where the trace is always 0.
    decays: [Option<Decay>; TRACES],
    /// By [`When::index`]; none where the synapse is not evaluated.
    changes: [Box<[CompiledChange]>; When::COUNT],
    accumulator: (i32, i32),
}

impl Compiled {
    /// Compiles a rule.
    pub fn new(rule: &Rule) -> Self {
        let decays = Trace::ALL.map(|trace| {
            let settings = rule.trace(trace);
            let overwritten = trace == Trace::X1 && rule.graded() != Graded::Regular;
            // (L14): a reward decays by epochs.
            let steps = if trace == Trace::R1 { rule.epoch() } else { 1 };
            let tau = settings.tau.get() * f64::from(steps);
            let is_brian = rule.semantics() == LearningSemantics::Brian;
            let factor = if is_brian { 1.0 - 1.0 / tau } else { libm::exp(-1.0 / tau) };
            (settings.impulse != Impulse::default() || overwritten).then(|| Decay::new(factor))
        });
        let changes = When::all().map(|when| CompiledChange::all(rule, when));
        Compiled { rule: rule.clone(), decays, changes, accumulator: rule.semantics().accumulator() }
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
        !self.changes[when.index()].is_empty()
    }

    /// Whether the rule reads or changes a variable besides the weight.
    pub fn uses(&self, variable: Variable) -> bool {
        self.rule.changes(variable)
            || self
                .rule
                .all_products()
                .any(|product| product.factors.iter().any(|factor| factor.of == Quantity::Variable(variable)))
    }

    /// The changes of variables where these dependencies are true.
    #[inline(always)]
    pub fn changes(&self, when: When) -> &[CompiledChange] {
        &self.changes[when.index()]
    }

    /// The accumulator of a changed variable of each synapse: (L6) up to rounding. Its caller may
    /// run it with the processor's vectors.
    #[inline(always)]
    pub fn accumulate<'s>(
        &self,
        change: &CompiledChange,
        when: When,
        synapses: &impl Synapses,
        scratch: &'s mut Scratch,
    ) -> &'s [i32] {
        let (low, high) = self.accumulator;
        let [sums, m, read] = scratch.0.each_mut().map(|all| &mut all[..synapses.number()]);
        synapses.variable(change.variable, sums);
        sums.iter_mut().for_each(|sum| *sum <<= 7);
        if change.clips_first {
            sums.iter_mut().for_each(|sum| *sum = (*sum).clamp(low, high));
        }
        for product in &change.products {
            m.fill(product.mantissa);
            for factor in &product.factors {
                factor.read(when, product.when, synapses, read);
                factor.multiply(m, read);
            }
            for (sum, m) in sums.iter_mut().zip(&*m) {
                // At most 2^15 before the shift, and 15 bits of it.
                let added = ((m >> product.down) << product.up).clamp(low, high);
                *sum = (*sum + added).clamp(low, high);
            }
        }
        sums
    }

    /// The accumulator of a variable without products that count: lava's clip of a tag of -257.
    pub fn unchanged(&self, old: i32) -> i32 {
        (old << 7).clamp(self.accumulator.0, self.accumulator.1)
    }

    /// (L16): a weight after learning, from its accumulator: away from zero to an integer, then
    /// toward zero to a step. `None` in other semantics than Brian's.
    #[inline(always)]
    pub fn without_draw(&self, format: SynapseFormat) -> Option<impl Fn(i32, i32) -> i16> {
        let (step, (low, high)) = (i32::from(format.sign.step(format.bits)), self.range(Variable::Weight, format));
        (self.rule.semantics() == LearningSemantics::Brian).then_some(move |old: i32, sum: i32| {
            let change = sum - (old << 7);
            let away = change.signum() * ((change.abs() + 127) >> 7);
            (old + away / step * step).clamp(low, high) as i16
        })
    }

    /// How a variable is rounded.
    pub fn rounding(&self, variable: Variable, format: SynapseFormat) -> Rounding {
        let step = match (variable, self.rule.semantics()) {
            (Variable::Weight, LearningSemantics::Silicon) => i32::from(format.sign.step(format.bits)),
            _ => 1,
        };
        let (low, high) = self.range(variable, format);
        Rounding { step, bits: (step << 7).trailing_zeros(), low, high }
    }

    /// The values of a variable.
    fn range(&self, variable: Variable, format: SynapseFormat) -> (i32, i32) {
        let semantics = self.rule.semantics();
        match (variable, semantics, format.sign) {
            (Variable::Delay, ..) => semantics.delays(),
            (Variable::Tag, ..) => semantics.tags(),
            (Variable::Weight, LearningSemantics::Silicon | LearningSemantics::Nengo, sign) => {
                let (low, high) = sign.range(format.bits);
                (low.into(), high.into())
            }
            (Variable::Weight, LearningSemantics::Brian, SignMode::Mixed) => (-256, 254),
            (Variable::Weight, LearningSemantics::Brian, SignMode::Excitatory) => (0, 255),
            (Variable::Weight, LearningSemantics::Brian, SignMode::Inhibitory) => (-256, 0),
            (Variable::Weight, LearningSemantics::Lava, SignMode::Mixed) => (-256, 255),
            (Variable::Weight, LearningSemantics::Lava, SignMode::Excitatory) => (0, 255),
            (Variable::Weight, LearningSemantics::Lava, SignMode::Inhibitory) => (-255, 0),
        }
    }
}

/// (L6), (L7): from the accumulator of a variable to its new value.
#[derive(Debug, Clone, Copy)]
pub struct Rounding {
    step: i32,
    /// Bits of the accumulator below a step, which is a power of 2: at most 15.
    bits: u32,
    low: i32,
    high: i32,
}

impl Rounding {
    /// A random number from 0 to below 1, as whole units of the accumulator within a step.
    #[inline(always)]
    pub fn share(&self, draw: f64) -> i32 {
        (draw * f64::from(1 << self.bits)) as i32
    }

    /// The random number of which these are the bits after the point.
    #[inline(always)]
    pub fn share_of_bits(&self, bits: u32) -> i32 {
        (bits >> (32 - self.bits)) as i32
    }

    /// The new value: rounded up where the share is below the accumulator's fraction of a step.
    #[inline(always)]
    pub fn rounded(&self, sum: i32, share: i32) -> i16 {
        let (whole, rest) = (sum >> self.bits, sum & ((1 << self.bits) - 1));
        (self.step * (whole + i32::from(share < rest))).clamp(self.low, self.high) as i16
    }
}

impl CompiledFactor {
    #[inline(always)]
    fn read(&self, when: When, at: Dependency, synapses: &impl Synapses, values: &mut [i32]) {
        match self.read {
            Read::Pre => values.fill(when.pre.into()),
            Read::Post => values.fill(when.post.into()),
            Read::X(trace) => synapses.x(trace, at, values),
            Read::Y(trace) => synapses.y(trace, at, values),
            Read::Variable(variable) => synapses.variable(variable, values),
        }
    }

    #[inline(always)]
    fn multiply(&self, m: &mut [i32], read: &[i32]) {
        let (low, high) = self.range;
        let all = m.iter_mut().zip(read);
        match self.sign {
            true => all.for_each(|(m, read)| *m *= (read + self.plus).signum()),
            false => all.for_each(|(m, read)| *m *= (read + self.plus).clamp(low, high)),
        }
    }
}

impl CompiledChange {
    /// The changes of a rule where these dependencies are true; none where nothing is evaluated.
    fn all(rule: &Rule, when: When) -> Box<[Self]> {
        if !rule.all_products().any(|product| when.holds(product.when)) {
            return Box::default();
        }
        let (semantics, mut all) = (rule.semantics(), Vec::new());
        for variable in Variable::ALL.into_iter().filter(|&variable| rule.changes(variable)) {
            let products = rule.products(variable);
            let counts = products.iter().filter(|product| when.holds(product.when));
            all.push(CompiledChange {
                variable,
                clips_first: !when.holds(products[0].when),
                products: counts.map(|product| CompiledProduct::new(product, semantics)).collect(),
            });
        }
        all.into()
    }
}

impl CompiledProduct {
    fn new(product: &Product, semantics: LearningSemantics) -> Self {
        let is_brian = semantics == LearningSemantics::Brian;
        let factor = |&Factor { of, plus, sign }: &Factor| {
            let bits = of.bits();
            let range = if is_brian { (i32::MIN, i32::MAX) } else { (-(1 << bits), (1 << bits) - 1) };
            let read = match of {
                Quantity::Pre => Read::Pre,
                Quantity::Post => Read::Post,
                Quantity::Trace(trace) if trace.is_presynaptic() => Read::X(trace.index()),
                Quantity::Trace(trace) => Read::Y(trace.index() - 2),
                Quantity::Variable(variable) => Read::Variable(variable),
            };
            CompiledFactor { read, plus, sign, range }
        };
        CompiledProduct {
            when: product.when,
            factors: product.factors.iter().map(factor).collect(),
            mantissa: product.mantissa.into(),
            down: if is_brian { 0 } else { (product.bits() + semantics.mantissa_bits()).saturating_sub(15) },
            up: (i32::from(product.exponent) + 7) as u32,
        }
    }
}

/// The greatest magnitude of a weight that a rule may reach.
pub const GREATEST_WEIGHT: i16 = 256;
