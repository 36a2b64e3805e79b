//! Recursive-descent parser of expressions and assignments.
//!
//! Input: a text and the names that it may use. Output: a tree whose results fit 64 bits, or a
//! [`Problem`] at a byte of the text. Depth and length are bounded, so no text overflows the stack.
//!
//! ```text
//! assignment := name '=' expression
//! expression := operands and operators of BINARY, the first level binding least; 'not' binds less
//!               than comparisons
//! operand    := '-' operand | number | name | function '(' expression, .. ')' | '(' expression ')'
//! ```

use super::interval::result;
use super::tree::{Assignment, Expression, Interval, MOST_TEMPORARIES, Node, Operation, Problem, Variable, is_name};
use crate::base::names::did_you_mean;

/// The longest text, in bytes.
const LONGEST: usize = 2000;
/// The deepest nesting of brackets and signs.
const DEEPEST: u32 = 40;

/// Operators with their precedence, 0 binding least; `true` swaps the operands.
const BINARY: [(&str, u8, Operation, bool); 13] = [
    ("or", 0, Operation::Or, false),
    ("and", 1, Operation::And, false),
    ("<", COMPARISON, Operation::Less, false),
    ("<=", COMPARISON, Operation::LessOrEqual, false),
    (">", COMPARISON, Operation::Less, true),
    (">=", COMPARISON, Operation::LessOrEqual, true),
    ("==", COMPARISON, Operation::Equal, false),
    ("!=", COMPARISON, Operation::NotEqual, false),
    ("<<", 4, Operation::ShiftLeft, false),
    (">>", 4, Operation::ShiftRight, false),
    ("+", 5, Operation::Add, false),
    ("-", 5, Operation::Subtract, false),
    ("*", LAST, Operation::Multiply, false),
];
const NOT: u8 = 2;
const COMPARISON: u8 = 3;
const LAST: u8 = 6;

/// Functions and their numbers of operands. The last operand of `clip` and `wrap` is a number.
const FUNCTIONS: [(&str, usize, Operation); 7] = [
    ("tz", 2, Operation::TowardZero),
    ("min", 2, Operation::Minimum),
    ("max", 2, Operation::Maximum),
    ("abs", 1, Operation::Absolute),
    ("select", 3, Operation::Select),
    ("clip", 2, Operation::Clip(0)),
    ("wrap", 2, Operation::Wrap(0)),
];

/// Reserved names, with a meaning in expressions, model files or probes.
const RESERVED: [&str; 13] = [
    "in",
    "in2",
    "and",
    "or",
    "not",
    "name",
    "shape",
    "start_step",
    "payload",
    "message_bits",
    "spikes",
    "message",
    "relays",
];

/// The names that a text may use.
#[derive(Debug)]
pub(super) struct Scope {
    /// Each name with its variable and interval; `None` before a temporary is assigned.
    names: Vec<(String, Variable, Option<Interval>)>,
    /// Intervals of the words of state, and of temporaries with a width.
    pub(super) widths: [Vec<Interval>; 2],
    /// Number of sums of arrivals read so far, at least 1.
    pub(super) ports: u8,
}

impl Scope {
    pub(super) fn new() -> Scope {
        let arrived =
            |(port, name): (usize, &str)| (name.to_string(), Variable::Arrived(port), Some(Interval::of_bits(32)));
        let names = ["in", "in2"].into_iter().enumerate().map(arrived).collect();
        Scope { names, widths: Default::default(), ports: 1 }
    }

    /// Adds a name that is declared at `path`.
    pub(super) fn declare(
        &mut self,
        name: &str,
        variable: Variable,
        values: Option<Interval>,
        path: &str,
    ) -> Result<(), Problem> {
        let why = match () {
            () if !is_name(name) => "use letters, digits and '_', not a digit first",
            () if RESERVED.contains(&name) || FUNCTIONS.iter().any(|(known, ..)| *known == name) => {
                "it already has a meaning: choose another name"
            }
            () if self.names.iter().any(|(known, ..)| known == name) => "it is declared twice: choose another name",
            () => {
                self.names.push((name.to_string(), variable, values));
                return Ok(());
            }
        };
        Err(Problem::new(path, format!("'{name}' cannot be a name here: {why}")))
    }

    /// Number of temporaries.
    pub(super) fn temporaries(&self) -> usize {
        self.names.iter().filter(|(_, variable, _)| matches!(variable, Variable::Temporary(_))).count()
    }
}

/// A text, and the byte from which it is read.
pub(super) struct Parser<'t> {
    path: String,
    text: &'t str,
    /// Byte where the next token begins.
    at: usize,
    depth: u32,
    scope: &'t mut Scope,
}

impl<'t> Parser<'t> {
    pub(super) fn new(path: &str, text: &'t str, scope: &'t mut Scope) -> Self {
        Parser { path: path.to_string(), text, at: 0, depth: 0, scope }
    }

    fn wrong<T>(&self, at: usize, message: impl Into<String>) -> Result<T, Problem> {
        Err(Problem { path: self.path.clone(), at, message: message.into() })
    }

    /// The next token: a number, a name, or one or two other characters; empty at the end.
    fn peek(&mut self) -> &'t str {
        let rest = self.text[self.at..].trim_start();
        self.at = self.text.len() - rest.len();
        fn part(c: char) -> bool {
            c.is_ascii_alphanumeric() || c == '_'
        }
        let length = match rest.chars().next() {
            Some(c) if part(c) => rest.find(|c: char| !part(c)).unwrap_or(rest.len()),
            Some(_) if ["<<", ">>", "<=", ">=", "==", "!="].iter().any(|two| rest.starts_with(two)) => 2,
            other => other.map_or(0, char::len_utf8),
        };
        &rest[..length]
    }

    /// Skips a token if it is next; returns whether it was.
    fn take(&mut self, token: &str) -> bool {
        let comes = self.peek() == token;
        self.at += if comes { token.len() } else { 0 };
        comes
    }

    fn expect(&mut self, token: &str) -> Result<(), Problem> {
        if self.take(token) {
            return Ok(());
        }
        let help = match self.peek() {
            "=" => "; == compares, and an assignment stands alone",
            "." => "; numbers are integers",
            "/" => "; a >> k and tz(a, k) divide by 2^k",
            "&" | "|" | "!" | "&&" | "||" => "; write and, or, not",
            _ => "",
        };
        fn shown(token: &str) -> String {
            if token.is_empty() { "the end".to_string() } else { format!("'{token}'") }
        }
        let found = shown(self.peek());
        self.wrong(self.at, format!("expected {} but found {found}{help}", shown(token)))
    }

    /// Parses an assignment, which sets the target's interval to the expression's or to its width.
    pub(super) fn assignment(&mut self) -> Result<Assignment, Problem> {
        let name = self.peek();
        let at = self.at;
        let known = self.scope.names.iter().position(|(known, ..)| known == name);
        match known.map(|place| self.scope.names[place].1) {
            Some(Variable::Arrived(_) | Variable::Parameter(_)) => {
                return self.wrong(at, format!("'{name}' is an input or a parameter: assign to another name"));
            }
            None if !is_name(name) => return self.wrong(at, "expected a name to assign to, as in v = v + in"),
            _ => self.at += name.len(),
        }
        self.expect("=")?;
        let value = self.whole()?;
        let place = match known {
            Some(place) => place,
            None => {
                let next = self.scope.temporaries();
                if next == MOST_TEMPORARIES {
                    return self.wrong(at, format!("more than {MOST_TEMPORARIES} temporaries"));
                }
                self.scope.declare(name, Variable::Temporary(next), None, &self.path)?;
                self.scope.names.len() - 1
            }
        };
        let Scope { names, widths: [state, temporaries], .. } = self.scope;
        let (_, target, values) = &mut names[place];
        let width = match target {
            Variable::State(word) => state.get(*word),
            Variable::Temporary(word) => temporaries.get(*word),
            Variable::Arrived(_) | Variable::Parameter(_) => None,
        };
        *values = Some(width.copied().filter(|width| !width.contains(value.interval)).unwrap_or(value.interval));
        Ok(Assignment { target: *target, value })
    }

    /// Parses an expression that ends with the text.
    pub(super) fn whole(&mut self) -> Result<Expression, Problem> {
        if self.text.len() > LONGEST {
            let message = format!("{} bytes are more than {LONGEST}: split it by a temporary", self.text.len());
            return self.wrong(0, message);
        }
        let found = self.binary(0)?;
        self.expect("")?;
        Ok(found)
    }

    /// Parses operands and operators of this level and of higher precedence.
    fn binary(&mut self, level: u8) -> Result<Expression, Problem> {
        if level > LAST {
            return self.operand();
        }
        if level == NOT && self.peek() == "not" {
            let at = self.at;
            self.at += "not".len();
            let of = self.nested(at, |parser| parser.binary(NOT))?;
            return self.apply(Operation::Not, vec![of], at);
        }
        let (mut found, mut compared) = (self.binary(level + 1)?, false);
        loop {
            let token = self.peek();
            let at = self.at;
            let Some((_, _, operation, swapped)) = BINARY.iter().find(|(name, of, ..)| *of == level && *name == token)
            else {
                return Ok(found);
            };
            if level == COMPARISON && std::mem::replace(&mut compared, true) {
                return self.wrong(at, "comparisons do not chain: write a < b and b < c");
            }
            self.at += token.len();
            let other = self.binary(level + 1)?;
            let of = if *swapped { vec![other, found] } else { vec![found, other] };
            found = self.apply(*operation, of, at)?;
        }
    }

    fn nested<T>(&mut self, at: usize, read: impl FnOnce(&mut Self) -> Result<T, Problem>) -> Result<T, Problem> {
        if self.depth == DEEPEST {
            return self.wrong(at, format!("nested more than {DEEPEST} deep: split it by a temporary"));
        }
        self.depth += 1;
        let found = read(self);
        self.depth -= 1;
        found
    }

    fn operand(&mut self) -> Result<Expression, Problem> {
        let token = self.peek();
        let at = self.at;
        self.at += token.len();
        if token == "-" {
            let of = self.nested(at, Self::operand)?;
            return self.apply(Operation::Subtract, vec![constant(0), of], at);
        }
        if token == "(" {
            let found = self.nested(at, |parser| parser.binary(0))?;
            self.expect(")")?;
            return Ok(found);
        }
        if token.starts_with(|c: char| c.is_ascii_digit()) {
            return match token.replace('_', "").parse() {
                Ok(value) => Ok(constant(value)),
                Err(_) => self.wrong(at, format!("'{token}' is not an integer of 64 bits")),
            };
        }
        if let Some(&(name, count, operation)) = FUNCTIONS.iter().find(|(name, ..)| *name == token) {
            return self.nested(at, |parser| parser.call(name, count, operation, at));
        }
        if !is_name(token) || BINARY.iter().any(|(name, ..)| *name == token) {
            self.at = at;
            let found = if token.is_empty() { "the end".to_string() } else { format!("'{token}'") };
            return self.wrong(at, format!("expected a number, a name or a bracket but found {found}"));
        }
        match self.scope.names.iter().find(|(name, ..)| name == token) {
            Some((_, variable, Some(interval))) => {
                if let Variable::Arrived(port) = variable {
                    self.scope.ports = self.scope.ports.max(*port as u8 + 1);
                }
                Ok(Expression { node: Node::Read(*variable), interval: *interval })
            }
            Some(_) => self.wrong(at, format!("'{token}' is read before it is assigned")),
            None => {
                let known: Vec<&str> = self.scope.names.iter().map(|(name, ..)| name.as_str()).collect();
                let functions = FUNCTIONS.iter().map(|(name, ..)| *name);
                let meant = did_you_mean(token, known.iter().copied().chain(functions));
                self.wrong(at, format!("'{token}' is not defined: {meant}names are {}", known.join(", ")))
            }
        }
    }

    /// Parses the operands of a function, after its name.
    fn call(&mut self, name: &str, count: usize, operation: Operation, at: usize) -> Result<Expression, Problem> {
        self.expect("(")?;
        let mut of = Vec::new();
        while of.len() < count {
            if !of.is_empty() {
                self.expect(",")?;
            }
            of.push(self.binary(0)?);
        }
        self.expect(")")?;
        let with_bits: fn(u32) -> Operation = match operation {
            Operation::Clip(_) => Operation::Clip,
            Operation::Wrap(_) => Operation::Wrap,
            _ => return self.apply(operation, of, at),
        };
        match of.pop().map(|bits| bits.node) {
            Some(Node::Constant(bits @ 2..=63)) => self.apply(with_bits(bits as u32), of, at),
            _ => self.wrong(at, format!("{name}(x, bits) takes a number of 2 to 63 bits")),
        }
    }

    fn apply(&self, operation: Operation, of: Vec<Expression>, at: usize) -> Result<Expression, Problem> {
        let intervals: Vec<Interval> = of.iter().map(|operand| operand.interval).collect();
        match result(operation, &intervals) {
            Ok(interval) => Ok(Expression { node: Node::Apply(operation, of), interval }),
            Err(message) => self.wrong(at, message),
        }
    }
}

fn constant(value: i64) -> Expression {
    Expression { node: Node::Constant(value), interval: Interval::one(value) }
}
