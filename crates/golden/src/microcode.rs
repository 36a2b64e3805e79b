//! Neuron rules that a model file states, interpreted as trees.
//!
//! Numbers have 128 bits, so that a result beyond 64 bits is detected.

use nsim_ir::microcode::{Assignment, Expression, MOST_WORDS, Microcode, Node, Operation, Overflow, Variable};
use nsim_ir::neurons::ParameterRow;

use crate::outcome::Outcome;

/// The values of names in a step.
struct Names<'s> {
    row: &'s ParameterRow,
    arrived: [i64; 2],
    words: &'s mut [i64; MOST_WORDS],
    temporaries: Vec<i128>,
}

fn power(bits: i128) -> i128 {
    2i128.pow(bits as u32)
}

/// Two's complement wrap to `bits` bits, sign included.
fn wrapped(x: i128, bits: u32) -> i128 {
    let half = power(i128::from(bits) - 1);
    (x + half).rem_euclid(2 * half) - half
}

fn clipped(x: i128, bits: u32) -> i128 {
    let most = power(i128::from(bits) - 1) - 1;
    x.clamp(-most, most)
}

impl Names<'_> {
    fn value(&self, expression: &Expression) -> i128 {
        let value = match &expression.node {
            Node::Constant(value) => (*value).into(),
            Node::Read(Variable::Arrived(port)) => self.arrived[*port].into(),
            Node::Read(Variable::Parameter(place)) => self.row.0[*place].into(),
            Node::Read(Variable::State(place)) => self.words[*place].into(),
            Node::Read(Variable::Temporary(place)) => self.temporaries[*place],
            Node::Apply(operation, of) => {
                let of: Vec<i128> = of.iter().map(|operand| self.value(operand)).collect();
                applied(*operation, &of)
            }
        };
        assert!(i64::try_from(value).is_ok(), "the tree was checked: {value} leaves 64 bits");
        value
    }

    fn assign(&mut self, code: &Microcode, assignments: &[Assignment], outcome: &mut Outcome) {
        for Assignment { target, value } in assignments {
            let value = self.value(value);
            let narrowed = match code.width(*target).map(|word| (word.overflow, word.bits)) {
                None => value,
                Some((Overflow::Wrap, bits)) => wrapped(value, bits),
                Some((Overflow::Clip, bits)) => clipped(value, bits),
            };
            match code.width(*target).map(|word| word.overflow) {
                Some(Overflow::Clip) => outcome.v_clipped |= narrowed != value,
                _ => outcome.u_wrapped |= narrowed != value,
            }
            match target {
                Variable::State(place) => self.words[*place] = narrowed as i64,
                Variable::Temporary(place) => self.temporaries[*place] = narrowed,
                Variable::Arrived(_) | Variable::Parameter(_) => unreachable!("they are not assigned"),
            }
        }
    }
}

fn applied(operation: Operation, of: &[i128]) -> i128 {
    let a = of[0];
    match operation {
        Operation::Add => a + of[1],
        Operation::Subtract => a - of[1],
        Operation::Multiply => a * of[1],
        Operation::ShiftLeft => a * power(of[1]),
        Operation::ShiftRight => a.div_euclid(power(of[1])),
        Operation::TowardZero => a / power(of[1]),
        Operation::Less => (a < of[1]).into(),
        Operation::LessOrEqual => (a <= of[1]).into(),
        Operation::Equal => (a == of[1]).into(),
        Operation::NotEqual => (a != of[1]).into(),
        Operation::Minimum => a.min(of[1]),
        Operation::Maximum => a.max(of[1]),
        Operation::And => (a != 0 && of[1] != 0).into(),
        Operation::Or => (a != 0 || of[1] != 0).into(),
        Operation::Not => (a == 0).into(),
        Operation::Absolute => a.abs(),
        Operation::Select => of[if a != 0 { 1 } else { 2 }],
        Operation::Clip(bits) => clipped(a, bits),
        Operation::Wrap(bits) => wrapped(a, bits),
    }
}

/// A step of a neuron.
pub(crate) fn step(code: &Microcode, row: &ParameterRow, words: &mut [i64; MOST_WORDS], arrived: [i64; 2]) -> Outcome {
    let mut outcome = Outcome::default();
    let mut names = Names { row, arrived, words, temporaries: vec![0; code.temporaries()] };
    names.assign(code, code.update(), &mut outcome);
    outcome.spiked = names.value(code.sends()) != 0;
    let message = code.message().map(|message| names.value(message) as i64);
    outcome.value = message.map(|value| if outcome.spiked { value } else { 0 });
    if outcome.spiked {
        names.assign(code, code.reset(), &mut outcome);
    }
    outcome
}

#[cfg(test)]
mod tests {
    use nsim_dynamics::kinds::{Block, CHUNK, updater};
    use nsim_ir::base::rng;
    use nsim_ir::microcode::{Declaration, Parameter, Word};
    use nsim_ir::neurons::{MicrocodeKind, NeuronKind};

    use super::*;

    /// Random texts of expressions.
    struct Texts {
        seed: u64,
        drawn: u64,
        names: Vec<String>,
    }

    impl Texts {
        fn bits(&mut self) -> u64 {
            self.drawn += 1;
            rng::bits(self.seed, 0, self.drawn)
        }

        fn below(&mut self, end: u32) -> u32 {
            (self.bits() % u64::from(end)) as u32
        }

        fn one_of<'t>(&mut self, of: &[&'t str]) -> &'t str {
            of[self.below(of.len() as u32) as usize]
        }

        fn expression(&mut self, depth: u32) -> String {
            if depth == 0 || self.below(6) == 0 {
                return match self.below(4) {
                    0 => self.one_of(&["0", "1", "3", "64", "4096", "1_000_000", "-7", "-2147483648"]).to_string(),
                    _ => {
                        let place = self.below(self.names.len() as u32) as usize;
                        self.names[place].clone()
                    }
                };
            }
            let (a, b) = (self.expression(depth - 1), self.expression(depth - 1));
            match self.below(12) {
                0 | 1 => format!("({a} {} {b})", self.one_of(&["+", "-"])),
                2 => format!("({a} * {b})"),
                3 => format!("({a} {} {})", self.one_of(&["<<", ">>"]), self.one_of(&["0", "1", "5", "k", "33"])),
                4 => format!("tz({a}, {})", self.one_of(&["0", "1", "12", "k", "40"])),
                5 => format!("{}({a}, {b})", self.one_of(&["min", "max"])),
                6 => format!("({a} {} {b})", self.one_of(&["<", "<=", ">", ">=", "==", "!="])),
                7 => format!("({a} {} {b})", self.one_of(&["and", "or"])),
                8 => format!("(not {a})"),
                9 => format!("select({a}, {b}, {})", self.expression(depth - 1)),
                10 => format!("abs({a})"),
                _ => {
                    format!("{}({a}, {})", self.one_of(&["clip", "wrap"]), self.one_of(&["2", "12", "24", "32", "40"]))
                }
            }
        }

        fn declaration(&mut self, number: u32) -> Declaration {
            let word = |name: &str, texts: &mut Texts| Word {
                name: name.to_string(),
                bits: 2 + texts.below(31),
                overflow: if texts.below(2) == 0 { Overflow::Wrap } else { Overflow::Clip },
            };
            let state = ["x", "y", "z"].map(|name| word(name, self)).to_vec();
            let temporaries = vec![word("t", self), Word { bits: 32, overflow: Overflow::Wrap, ..word("w", self) }];
            let parameters = [("k", (0, 9)), ("p", (-500, 500)), ("q", (i32::MIN, i32::MAX))];
            let parameters = parameters.map(|(name, range)| Parameter { name: name.into(), range, default: None });
            self.names = ["x", "y", "z", "k", "p", "q", "in", "in2"].map(str::to_string).to_vec();
            let mut update = Vec::new();
            for target in ["w", "x", "t", "e", "y", "z", "x"] {
                let depth = self.below(4);
                update.push(format!("{target} = {}", self.expression(depth)));
                self.names.push(target.to_string());
            }
            let spikes = (self.below(3) > 0).then(|| self.expression(2));
            let message = (spikes.is_none() || self.below(2) == 0).then(|| format!("wrap({}, 32)", self.expression(2)));
            let reset = vec![format!("y = {}", self.expression(2)), format!("w = {}", self.expression(1))];
            let name = format!("Random{number}");
            let (parameters, time, energy) = (parameters.to_vec(), None, None);
            Declaration { name, state, parameters, temporaries, update, spikes, message, reset, time, energy }
        }
    }

    /// The instructions agree with the tree in words, messages, reports and idleness.
    #[test]
    fn random_trees_are_the_same_as_their_instructions() {
        let (mut compared, mut seen_counts) = (0, [0u32; 5]);
        for number in 0..600 {
            let mut texts = Texts { seed: number.into(), drawn: 0, names: Vec::new() };
            // A tree whose results may need more than 64 bits is refused.
            let Ok(kind) = MicrocodeKind::new(texts.declaration(number)) else { continue };
            let lanes = 1 + texts.below(64) as usize;
            let row = |texts: &mut Texts| {
                let mut row = ParameterRow::EMPTY;
                row.0[0] = texts.below(10) as i32;
                row.0[1] = texts.below(1001) as i32 - 500;
                row.0[2] = texts.bits() as i32 >> texts.below(32);
                row
            };
            let mut rows: Vec<ParameterRow> = (0..lanes).map(|_| row(&mut texts)).collect();
            // Shared parameters, 0 among them, let specialisation remove instructions.
            for place in 0..3 {
                let shared = [None, Some(0), Some(1), Some(rows[0].0[place])][texts.below(4) as usize];
                rows.iter_mut().for_each(|row| row.0[place] = shared.unwrap_or(row.0[place]));
            }
            let fast = updater(NeuronKind::Microcode(kind), &rows).expect("its state is words");
            let chunks = lanes.div_ceil(CHUNK);
            let (mut columns, mut sent) = (vec![[0; CHUNK]; 3 * chunks], vec![[0; CHUNK]; chunks]);
            let mut words = vec![[0i64; MOST_WORDS]; lanes];
            let mut woken = false;
            for step in 0..20 {
                let mut arrived = [vec![[0; CHUNK]; chunks], vec![[0; CHUNK]; chunks]];
                for value in arrived.iter_mut().flatten().flatten() {
                    if step > 0 && texts.below(3) == 0 {
                        *value = texts.bits() as i32 >> texts.below(32);
                    }
                }
                let vectors = pulp::Arch::new();
                let effects = fast.update(&mut Block {
                    columns: &mut columns,
                    arrived: [&arrived[0], &arrived[1]],
                    sent: &mut sent,
                    step,
                    vectors,
                });
                for lane in 0..lanes {
                    let of = |chunks: &[[i32; CHUNK]]| chunks[lane / CHUNK][lane % CHUNK];
                    let arrived = [of(&arrived[0]), of(&arrived[1])].map(i64::from);
                    let mut idle = words[lane];
                    let quiet = super::step(kind.code(), &rows[lane], &mut idle, [0; 2]);
                    let idle = idle == words[lane] && !quiet.spiked && !quiet.u_wrapped && !quiet.v_clipped;
                    let reads = &arrived[..kind.code().ports().into()];
                    let active = !idle || reads.iter().any(|arrived| *arrived != 0);
                    woken |= step == 0 && active;
                    let outcome = super::step(kind.code(), &rows[lane], &mut words[lane], arrived);
                    let is_in = |set: u64| set >> lane & 1 == 1;
                    let expected = [outcome.spiked, outcome.u_wrapped, outcome.v_clipped, active];
                    let found = [effects.emitted, effects.wrapped, effects.clipped, effects.active].map(is_in);
                    let context = || format!("{:#?}, lane {lane}, step {step}", kind.code().declaration());
                    assert_eq!(expected, found, "{}", context());
                    let column = |word: usize| i64::from(columns[lane / CHUNK * 3 + word][lane % CHUNK]);
                    assert_eq!(words[lane][..3], [column(0), column(1), column(2)], "{}", context());
                    if let (Some(value), true) = (outcome.value, outcome.spiked) {
                        assert_eq!(value, of(&sent).into(), "{}", context());
                        seen_counts[4] += 1;
                    }
                    expected.iter().zip(&mut seen_counts).for_each(|(meant, seen)| *seen += u32::from(*meant));
                    compared += 1;
                }
                if step == 0 {
                    assert_eq!(fast.wakes(), woken);
                }
            }
        }
        assert!(compared > 100_000 && seen_counts.iter().all(|seen| *seen > 1_000), "{compared}, {seen_counts:?}");
    }
}
