//! Update rules of neurons from model files: expressions of integers over words of state.
//!
//! Input: a [`Declaration`], as `docs/loihi2.md` describes it. Output: [`Microcode`], a checked
//! expression tree, or a [`Problem`] with its place. Module `tree` has the parts of a tree, `text`
//! the grammar, `interval` the intervals of results.
//!
//! Invariants of a checked tree:
//!
//! - every name is known, a temporary is written before it is read;
//! - every result fits 64 bits, for any words, parameters and arrivals;
//! - every amount of a shift is within 0..=62, and a message fits 32 bits.
//!
//! The second follows from interval arithmetic: intervals of words and parameters are declared, and
//! each operation maps intervals to an interval. So engines compute in 64 bits without checks.
//! `nsim_dynamics` defines the evaluation of a tree, and `nsim_golden` defines it again.

mod interval;
mod text;
mod tree;

use serde::{Deserialize, Serialize};

pub use tree::{Assignment, Expression, Interval, Node, Operation, Problem, Variable};

use crate::base::units::Unit;
use text::{Parser, Scope};
use tree::{MOST_TEMPORARIES, is_name};

/// The most words of state of a neuron.
pub const MOST_WORDS: usize = 8;
/// The most assignments of an update, or of a reset.
const MOST_ASSIGNMENTS: usize = 128;
/// Most instructions of a kind. A bound of this program: registers of compiled kinds have 15 bits,
/// and an instruction writes at most twelve.
const MOST_INSTRUCTIONS: u32 = 2048;

/// Treatment of a value that does not fit its word. Both are reported by rule (14) of
/// `docs/semantics.md`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
pub enum Overflow {
    /// It keeps the low bits, in two's complement.
    Wrap,
    /// It keeps the nearest value of `-(2^(bits - 1) - 1)..=2^(bits - 1) - 1`, as Loihi's voltage.
    Clip,
}

/// A word with a width.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Word {
    /// Its name.
    pub name: String,
    /// Bits, the sign included: 2 to 32.
    pub bits: u32,
    /// Treatment of a value that needs more bits.
    pub overflow: Overflow,
}

impl Word {
    /// The interval of its values.
    pub fn interval(&self) -> Interval {
        match self.overflow {
            Overflow::Wrap => Interval::of_bits(self.bits),
            Overflow::Clip => Interval::symmetric(self.bits),
        }
    }
}

/// A parameter that populations set for their neurons.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Parameter {
    /// Its name.
    pub name: String,
    /// The least and the greatest value.
    pub range: (i32, i32),
    /// Its value where a population gives none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub default: Option<i32>,
}

/// A kind of neuron as a model file declares it.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(deny_unknown_fields, rename = "Kind")]
pub struct Declaration {
    /// Its name, by which populations refer to it.
    pub name: String,
    /// Words of state, which last between steps; up to [`MOST_WORDS`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub state: Vec<Word>,
    /// Parameters that populations set.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parameters: Vec<Parameter>,
    /// Temporaries with a width. Any other assigned name is a temporary without a width.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub temporaries: Vec<Word>,
    /// Assignments of an update, in order.
    pub update: Vec<String>,
    /// Condition after the update for sending. Without one, a message other than 0 is sent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spikes: Option<String>,
    /// The integer to send; `None` for spikes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub message: Option<String>,
    /// Assignments after sending, in order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub reset: Vec<String>,
    /// Time of an update of a neuron, such as `5ns`; with `energy`, or by its instructions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time: Option<String>,
    /// Energy of an update of a neuron, such as `12pJ`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy: Option<String>,
}

/// Cost of an update of a neuron, idle or not.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpdatePrice {
    /// As the declaration states it, in place of the constants of a compartment.
    Stated {
        /// Energy in fJ.
        energy: u64,
        /// Time in ps.
        time: u64,
    },
    /// The constants of a visited compartment, by this number of instructions over
    /// [`COMPARTMENT_INSTRUCTIONS`].
    Instructions(u32),
}

/// Instructions of a compartment of Loihi 1, stated as a kind: two decays, three sums, a threshold,
/// a reset and the sending.
pub const COMPARTMENT_INSTRUCTIONS: u32 = 12;
/// The greatest stated energy in pJ and time in ns: sums over a run fit 64 bits.
const MOST_PRICE: f64 = 1e5;

/// The checked rule of a neuron kind.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Microcode {
    declaration: Declaration,
    temporaries: usize,
    ports: u8,
    update: Vec<Assignment>,
    sends: Expression,
    message: Option<Expression>,
    reset: Vec<Assignment>,
    stated: Option<UpdatePrice>,
}

impl Microcode {
    /// Checks a declaration; `parameters` is the greatest number of parameters of a neuron.
    ///
    /// # Errors
    /// A [`Problem`] at the first invalid name, width or expression.
    pub fn new(declaration: Declaration, parameters: usize) -> Result<Microcode, Problem> {
        if !is_name(&declaration.name) {
            let message = format!("'{}' cannot be the name of a kind: use letters, digits and '_'", declaration.name);
            return Err(Problem::new("name", message));
        }
        let lengths = [
            ("state", declaration.state.len(), MOST_WORDS),
            ("parameters", declaration.parameters.len(), parameters),
            ("temporaries", declaration.temporaries.len(), MOST_TEMPORARIES),
            ("update", declaration.update.len(), MOST_ASSIGNMENTS),
            ("reset", declaration.reset.len(), MOST_ASSIGNMENTS),
        ];
        if let Some((path, length, most)) = lengths.into_iter().find(|(_, length, most)| length > most) {
            return Err(Problem::new(path, format!("{length} {path} are more than the {most} that a kind can have")));
        }
        let mut scope = Scope::new();
        for (place, Parameter { name, range: (low, high), default }) in declaration.parameters.iter().enumerate() {
            let path = format!("parameters.[{place}]");
            let range = Interval { low: (*low).into(), high: (*high).into() };
            if low > high || default.is_some_and(|default| !(*low..=*high).contains(&default)) {
                let value = default.map_or(String::new(), |default| format!(" with the default {default}"));
                return Err(Problem::new(
                    path,
                    format!(
                        "the range {low} to {high}{value} is not valid: low is at most high, and the \
                         default is between them"
                    ),
                ));
            }
            scope.declare(name, Variable::Parameter(place), Some(range), &path)?;
        }
        let words = [("state", &declaration.state), ("temporaries", &declaration.temporaries)];
        for (list, words) in words {
            for (place, word) in words.iter().enumerate() {
                let path = format!("{list}.[{place}]");
                if !(2..=32).contains(&word.bits) {
                    return Err(Problem::new(path, format!("{} bits are outside 2..=32: narrow the word", word.bits)));
                }
                match list {
                    "state" => scope.declare(&word.name, Variable::State(place), Some(word.interval()), &path)?,
                    _ => scope.declare(&word.name, Variable::Temporary(place), None, &path)?,
                }
            }
        }
        scope.widths = words.map(|(_, words)| words.iter().map(Word::interval).collect());
        let update = assignments("update", &declaration.update, &mut scope)?;
        let mut read = |path: &str, text: &String| Parser::new(path, text, &mut scope).whole();
        let spikes = declaration.spikes.as_ref().map(|text| read("spikes", text)).transpose()?;
        let message = declaration.message.as_ref().map(|text| read("message", text)).transpose()?;
        if let Some(needs) = message.as_ref().map(|message| message.interval.bits()).filter(|bits| *bits > 32) {
            let problem = format!("a message of {needs} bits does not fit 32: clip(.., 32) or wrap(.., 32) it");
            return Err(Problem::new("message", problem));
        }
        let Some(sends) = spikes.or_else(|| message.clone()) else {
            return Err(Problem::new("", "it sends nothing: give spikes (a condition) or message (an integer)"));
        };
        let reset = assignments("reset", &declaration.reset, &mut scope)?;
        let (temporaries, ports) = (scope.temporaries(), scope.ports);
        let stated = stated_price(&declaration)?;
        let code = Microcode { declaration, temporaries, ports, update, sends, message, reset, stated };
        match code.instructions() {
            0..=MOST_INSTRUCTIONS => Ok(code),
            count => {
                let problem = format!("{count} instructions, more than {MOST_INSTRUCTIONS}: shorten its expressions");
                Err(Problem::new("", problem))
            }
        }
    }

    /// Its declaration.
    pub fn declaration(&self) -> &Declaration {
        &self.declaration
    }

    /// Its name.
    pub const fn name(&self) -> &str {
        self.declaration.name.as_str()
    }

    /// Number of temporaries; temporaries with a width come first.
    pub fn temporaries(&self) -> usize {
        self.temporaries
    }

    /// Number of sums of arrivals that it reads, at least 1.
    pub fn ports(&self) -> u8 {
        self.ports
    }

    /// The word of a state or of a temporary with a width; `None` for other variables.
    pub fn width(&self, target: Variable) -> Option<&Word> {
        match target {
            Variable::State(place) => self.declaration.state.get(place),
            Variable::Temporary(place) => self.declaration.temporaries.get(place),
            Variable::Arrived(_) | Variable::Parameter(_) => None,
        }
    }

    /// Assignments of every step.
    pub fn update(&self) -> &[Assignment] {
        &self.update
    }

    /// The condition for sending, true unless 0: the test, or the message where there is no test.
    pub fn sends(&self) -> &Expression {
        &self.sends
    }

    /// The integer to send; `None` for spikes.
    pub fn message(&self) -> Option<&Expression> {
        self.message.as_ref()
    }

    /// Assignments after sending.
    pub fn reset(&self) -> &[Assignment] {
        &self.reset
    }

    /// Cost of an update: stated, or by its instructions.
    pub fn price(&self) -> UpdatePrice {
        self.stated.unwrap_or(UpdatePrice::Instructions(self.instructions()))
    }

    /// Number of instructions: operations, assignments of a number or a name, and one for sending.
    pub fn instructions(&self) -> u32 {
        let assigned = self.update.iter().chain(&self.reset).map(|assignment| assignment.value.operations().max(1));
        let message = self.declaration.spikes.as_ref().and(self.message.as_ref());
        assigned.sum::<u32>() + self.sends.operations() + message.map_or(0, Expression::operations) + 1
    }
}

/// The price that a declaration states.
fn stated_price(declaration: &Declaration) -> Result<Option<UpdatePrice>, Problem> {
    fn thousandths(path: &str, typed: &str, unit: Unit) -> Result<u64, Problem> {
        let wrong = |message: String| Problem::new(path, message);
        let value = unit.parsed(typed).map_err(wrong)?;
        if !(0.0..=MOST_PRICE).contains(&value) {
            return Err(wrong(format!("{typed} is outside 0..={MOST_PRICE} {}", unit.suffix())));
        }
        Ok((value * 1e3).round() as u64)
    }
    match (&declaration.time, &declaration.energy) {
        (Some(time), Some(energy)) => Ok(Some(UpdatePrice::Stated {
            energy: thousandths("energy", energy, Unit::pJ)?,
            time: thousandths("time", time, Unit::ns)?,
        })),
        (None, None) => Ok(None),
        (Some(_), None) => Err(Problem::new("time", "an update has a time and no energy: add energy: \"12pJ\"")),
        (None, Some(_)) => Err(Problem::new("energy", "an update has an energy and no time: add time: \"5ns\"")),
    }
}

fn assignments(list: &str, texts: &[String], scope: &mut Scope) -> Result<Vec<Assignment>, Problem> {
    let parsed = |(place, text): (usize, &String)| Parser::new(&format!("{list}.[{place}]"), text, scope).assignment();
    texts.iter().enumerate().map(parsed).collect()
}

#[cfg(test)]
mod tests;
