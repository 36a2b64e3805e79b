//! Nodes of an expression tree, and errors of a declaration.

/// All integers from `low` to `high`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interval {
    /// The least integer.
    pub low: i64,
    /// The greatest integer.
    pub high: i64,
}

impl Interval {
    /// The two's complement numbers of this many bits, 1 to 64.
    pub fn of_bits(bits: u32) -> Interval {
        Interval { low: i64::MIN >> (64 - bits), high: i64::MAX >> (64 - bits) }
    }

    /// The two's complement numbers of this many bits, without the least.
    pub fn symmetric(bits: u32) -> Interval {
        let high = Interval::of_bits(bits).high;
        Interval { low: -high, high }
    }

    /// The interval of a single value.
    pub fn one(value: i64) -> Interval {
        Interval { low: value, high: value }
    }

    /// Whether this interval contains another one.
    pub fn contains(self, other: Interval) -> bool {
        self.low <= other.low && other.high <= self.high
    }

    /// Bits that every value fits in, the sign included.
    pub fn bits(self) -> u32 {
        bits(self.low.into(), self.high.into())
    }
}

/// Bits that both values fit in, in two's complement.
pub(super) fn bits(low: i128, high: i128) -> u32 {
    let of = |x: i128| 129 - (if x < 0 { !x } else { x }).leading_zeros();
    of(low).max(of(high))
}

/// An error in a declaration, and its place.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct Problem {
    /// The path of a value in the declaration, such as `update.[2]`.
    pub path: String,
    /// Byte offset in the text of this value.
    pub at: usize,
    /// The error, and its remedy.
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
    /// The sum of arrivals at a port, 0 or 1.
    Arrived(usize),
    /// A parameter, by its index.
    Parameter(usize),
    /// A word of state, by its index.
    State(usize),
    /// A temporary, by its index.
    Temporary(usize),
}

/// An operation on integers. Comparisons and logical operations give 1 or 0; only 0 is false.
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
    /// The lesser operand.
    Minimum,
    /// The greater operand.
    Maximum,
    /// Whether both operands are true.
    And,
    /// Whether an operand is true.
    Or,
    /// Whether `a` is not true.
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

/// An expression tree, or a part of one.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Expression {
    /// Its root.
    pub node: Node,
    /// Interval of its values.
    pub interval: Interval,
}

/// The root of an expression.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Node {
    /// A number.
    Constant(i64),
    /// The value of a variable.
    Read(Variable),
    /// An operation and its operands.
    Apply(Operation, Vec<Expression>),
}

impl Expression {
    /// Number of operations in the tree.
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
    /// The assigned variable: a word of state or a temporary.
    pub target: Variable,
    /// Its new value, before it is narrowed to the target's width.
    pub value: Expression,
}

/// The most temporaries, declared or not.
pub(super) const MOST_TEMPORARIES: usize = 64;

/// Whether a text is a letter or `_`, then letters, digits and `_`, at most 64 in all.
pub(super) fn is_name(text: &str) -> bool {
    fn part(c: char) -> bool {
        c.is_ascii_alphanumeric() || c == '_'
    }
    text.len() <= 64 && text.starts_with(|c: char| part(c) && !c.is_ascii_digit()) && text.chars().all(part)
}
