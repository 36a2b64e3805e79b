//! The parts of a tree, and what can be wrong with a text of one.

/// All integers from the least to the greatest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    /// The least.
    pub low: i64,
    /// The greatest.
    pub high: i64,
}

impl Interval {
    /// The values of this many bits in two's complement, 1 to 64.
    pub fn of_bits(bits: u32) -> Interval {
        Interval { low: i64::MIN >> (64 - bits), high: i64::MAX >> (64 - bits) }
    }

    /// The same values without the least.
    pub fn symmetric(bits: u32) -> Interval {
        let high = Interval::of_bits(bits).high;
        Interval { low: -high, high }
    }

    /// One value.
    pub fn one(value: i64) -> Interval {
        Interval { low: value, high: value }
    }

    /// Whether all of another interval is in this one.
    pub fn holds(self, other: Interval) -> bool {
        self.low <= other.low && other.high <= self.high
    }

    /// Bits that each value fits, the sign included.
    pub fn bits(self) -> u32 {
        bits(self.low.into(), self.high.into())
    }
}

/// Bits that both fit in two's complement.
pub(super) fn bits(low: i128, high: i128) -> u32 {
    let of = |x: i128| 129 - (if x < 0 { !x } else { x }).leading_zeros();
    of(low).max(of(high))
}

/// What is wrong with a declaration, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Problem {
    /// The path of a value in the declaration, such as `update.[2]`.
    pub path: String,
    /// The byte of that text.
    pub at: usize,
    /// What is wrong there, and what to do.
    pub message: String,
}

impl Problem {
    pub(super) fn new(path: impl Into<String>, message: impl Into<String>) -> Problem {
        Problem { path: path.into(), at: 0, message: message.into() }
    }
}

/// A variable that a name refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Variable {
    /// The sum of arrivals at a port: 0 or 1.
    Arrived(usize),
    /// A parameter, by its place.
    Parameter(usize),
    /// A word of state, by its place.
    State(usize),
    /// A temporary, by its place.
    Temporary(usize),
}

/// An operation on integers. Comparisons and logical operations give 1 or 0; what is not 0 is true.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Operation {
    /// `a + b`.
    Add,
    /// `a - b`.
    Subtract,
    /// `a * b`.
    Multiply,
    /// `a * 2^b`.
    ShiftLeft,
    /// `a / 2^b`, rounded down.
    ShiftRight,
    /// `a / 2^b`, rounded toward zero.
    TowardZero,
    /// `a < b`.
    Less,
    /// `a <= b`.
    LessOrEqual,
    /// `a == b`.
    Equal,
    /// `a != b`.
    NotEqual,
    /// The lesser one.
    Minimum,
    /// The greater one.
    Maximum,
    /// Both are true.
    And,
    /// One is true.
    Or,
    /// `a` is not true.
    Not,
    /// The magnitude.
    Absolute,
    /// `b` where `a` is true, else `c`.
    Select,
    /// The nearest value of `-(2^(bits - 1) - 1)..=2^(bits - 1) - 1`, not reported.
    Clip(u32),
    /// The low bits in two's complement, not reported.
    Wrap(u32),
}

/// A tree, or a part of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Expression {
    /// What it is.
    pub node: Node,
    /// The values that it can have.
    pub interval: Interval,
}

/// What an expression is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Node {
    /// A number.
    Constant(i64),
    /// The value of a variable.
    Read(Variable),
    /// An operation on as many expressions as it takes.
    Apply(Operation, Vec<Expression>),
}

impl Expression {
    /// Operations of the tree.
    pub fn operations(&self) -> u32 {
        match &self.node {
            Node::Apply(_, of) => 1 + of.iter().map(Expression::operations).sum::<u32>(),
            _ => 0,
        }
    }
}

/// An assignment.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Assignment {
    /// What is written: a word of state or a temporary.
    pub target: Variable,
    /// Its new value, before it is narrowed to the target's width.
    pub value: Expression,
}

/// The most temporaries, declared or not.
pub(super) const MOST_TEMPORARIES: usize = 64;

/// Whether a text is a letter or `_`, then letters, digits and `_`.
pub(super) fn is_name(text: &str) -> bool {
    let part = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.len() <= 64 && text.starts_with(|c: char| part(c) && !c.is_ascii_digit()) && text.chars().all(part)
}
