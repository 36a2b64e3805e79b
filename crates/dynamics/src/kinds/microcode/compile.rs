//! Compilation of a microcode tree to instructions.
//!
//! Input: a checked tree. Output: two lists of instructions, for values that depend on parameters
//! alone and for every step. Each instruction writes its own register and reads registers before
//! it. Equal instructions are merged. A register has 32 bits where the interval of its value fits.

use nsim_ir::microcode::{Assignment, Expression, Interval, Microcode, Node, Operation, Overflow, Variable, Word};

/// Operation of an instruction on its operands a, b and c.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Action {
    /// A number.
    Constant(i64),
    /// a, extended from 32 to 64 bits.
    Widen,
    /// The low 32 bits of a, which has 64.
    Narrow,
    /// The product of two operands of 32 bits, in 64 bits.
    Product,
    /// An operation whose result is as wide as its operands.
    Arithmetic(Operation),
    /// An operation whose result is 0 or 1.
    Comparison(Operation),
    /// 1 where a is at most b or b is at most c, else 0.
    Outside,
    /// b where a is not 0, else c.
    Select,
    /// `a + b` in 32 bits, reported where it wraps and the guard c, if any, is not 0.
    AddWord,
    /// `a - b` in 32 bits, reported likewise.
    SubtractWord,
    /// `a << b` in 32 bits, reported likewise; b is at most 31.
    ShiftWord,
    /// Reports where a is not b and the guard c, if any, is not 0; it writes nothing.
    Report(Overflow),
}

impl Action {
    /// Whether it reports overflows of a word.
    pub(super) fn reports(self) -> bool {
        matches!(self, Action::AddWord | Action::SubtractWord | Action::ShiftWord | Action::Report(_))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Instruction {
    pub action: Action,
    /// Whether its operands have 64 bits; conditions and guards always have 32.
    pub wide: bool,
    pub operands: [Place; 3],
    /// The register that it writes.
    pub out: Place,
}

/// Number of a register of 32 or 64 bits. A register with the bit [`FIXED`] depends on parameters
/// alone.
pub(super) type Place = u16;
/// Marks registers that depend on parameters alone.
pub(super) const FIXED: Place = 0x8000;
/// An absent operand.
pub(super) const NONE: Place = Place::MAX;

/// A sequence of instructions, and the numbers of registers that they need.
#[derive(Debug, Default)]
pub(super) struct Section {
    pub instructions: Vec<Instruction>,
    pub narrow: Place,
    pub wide: Place,
}

/// The instructions of a kind.
#[derive(Debug)]
pub(super) struct Code {
    /// Number of parameters, which are the first registers of `fixed`.
    pub parameters: usize,
    /// Number of words of state, which are the registers of `step` from [`WORDS`] on.
    pub words: usize,
    /// Number of sums of arrivals, which are the first registers of `step`.
    pub ports: usize,
    /// Instructions for values that depend on parameters alone.
    pub fixed: Section,
    /// Instructions of every step.
    pub step: Section,
    /// Registers of the next words of state.
    pub state: Vec<Place>,
    /// Register that is not 0 where a message is sent.
    pub sent: Place,
    /// Register of the integer that a message carries.
    pub message: Option<Place>,
}

/// The register of the first word of state.
pub(super) const WORDS: usize = 2;

/// A value in a register.
#[derive(Debug, Clone, Copy)]
struct Value {
    register: Place,
    wide: bool,
    fixed: bool,
    interval: Interval,
}

impl Value {
    fn place(self) -> Place {
        self.register | if self.fixed { FIXED } else { 0 }
    }
}

fn is_narrow(interval: Interval) -> bool {
    interval.bits() <= 32
}

/// The tree under compilation, and the registers of its variables.
struct Compiler<'c> {
    code: &'c Microcode,
    fixed: Section,
    step: Section,
    arrived: Vec<Value>,
    parameters: Vec<Value>,
    state: Vec<Value>,
    temporaries: Vec<Option<Value>>,
}

impl Code {
    /// Compiles a tree.
    pub(super) fn new(code: &Microcode) -> Code {
        let declaration = code.declaration();
        let given = |fixed: bool| {
            move |(register, interval): (usize, Interval)| Value {
                register: register as Place,
                wide: false,
                fixed,
                interval,
            }
        };
        let range = |&(low, high): &(i32, i32)| Interval { low: low.into(), high: high.into() };
        let parameters: Vec<_> = declaration.parameters.iter().map(|parameter| range(&parameter.range)).collect();
        let words = declaration.state.iter().map(Word::interval);
        let mut compiler = Compiler {
            code,
            fixed: Section { narrow: parameters.len() as Place, ..Section::default() },
            step: Section { narrow: (WORDS + declaration.state.len()) as Place, ..Section::default() },
            arrived: (0..WORDS).map(|port| (port, Interval::of_bits(32))).map(given(false)).collect(),
            parameters: parameters.into_iter().enumerate().map(given(true)).collect(),
            state: (WORDS..).zip(words).map(given(false)).collect(),
            temporaries: vec![None; code.temporaries()],
        };
        code.update().iter().for_each(|assignment| compiler.assign(assignment, None));
        let sends = compiler.value(code.sends());
        let sent = compiler.truth(sends);
        let message = code.message().map(|message| compiler.value(message).place());
        code.reset().iter().for_each(|assignment| compiler.assign(assignment, Some(sent)));
        let Compiler { fixed, step, parameters, state, .. } = compiler;
        Code {
            parameters: parameters.len(),
            words: state.len(),
            ports: code.ports().into(),
            fixed,
            step,
            state: state.into_iter().map(Value::place).collect(),
            sent: sent.place(),
            message,
        }
    }
}

impl Compiler<'_> {
    /// Adds an instruction unless an equal one exists; returns its result.
    fn emit(&mut self, action: Action, wide: bool, operands: &[Value], interval: Interval) -> Value {
        let fixed = !action.reports() && operands.iter().all(|operand| operand.fixed);
        let mut places = [NONE; 3];
        for (place, operand) in places.iter_mut().zip(operands) {
            *place = if fixed { operand.register } else { operand.place() };
        }
        let to_wide = match action {
            Action::Widen | Action::Product => true,
            Action::Narrow | Action::Comparison(_) => false,
            _ => wide,
        };
        let section = if fixed { &mut self.fixed } else { &mut self.step };
        let same = |known: &&Instruction| (known.action, known.wide, known.operands) == (action, wide, places);
        let out = match section.instructions.iter().find(same) {
            Some(known) => known.out,
            None => {
                let next = if to_wide { &mut section.wide } else { &mut section.narrow };
                let out = *next;
                assert!(out < FIXED - 1, "a kind's bound on instructions keeps registers below the mark");
                *next += 1;
                section.instructions.push(Instruction { action, wide, operands: places, out });
                out
            }
        };
        Value { register: out, wide: to_wide, fixed, interval }
    }

    fn constant(&mut self, value: i64) -> Value {
        let interval = Interval::one(value);
        self.emit(Action::Constant(value), !is_narrow(interval), &[], interval)
    }

    fn widened(&mut self, value: Value) -> Value {
        if value.wide { value } else { self.emit(Action::Widen, false, &[value], value.interval) }
    }

    fn narrowed(&mut self, value: Value) -> Value {
        match value.wide && is_narrow(value.interval) {
            true => self.emit(Action::Narrow, true, &[value], value.interval),
            false => value,
        }
    }

    /// Returns 1 where a value is not 0, else 0.
    fn truth(&mut self, value: Value) -> Value {
        if value.interval.low >= 0 && value.interval.high <= 1 {
            return value;
        }
        let zero = self.constant(0);
        self.comparison(Operation::NotEqual, [value, zero])
    }

    fn comparison(&mut self, operation: Operation, mut operands: [Value; 2]) -> Value {
        let wide = operands.iter().any(|operand| operand.wide);
        if wide {
            operands = operands.map(|operand| self.widened(operand));
        }
        self.emit(Action::Comparison(operation), wide, &operands, Interval { low: 0, high: 1 })
    }

    fn value(&mut self, expression: &Expression) -> Value {
        let (operation, of) = match &expression.node {
            Node::Constant(value) => return self.constant(*value),
            Node::Read(Variable::Arrived(port)) => return self.arrived[*port],
            Node::Read(Variable::Parameter(place)) => return self.parameters[*place],
            Node::Read(Variable::State(place)) => return self.state[*place],
            Node::Read(Variable::Temporary(place)) => {
                return self.temporaries[*place].expect("a temporary is written before it is read");
            }
            Node::Apply(operation, of) => (*operation, of),
        };
        let interval = expression.interval;
        // A clip or wrap that changes no value needs no instruction.
        match operation {
            Operation::Clip(bits) if Interval::symmetric(bits).contains(of[0].interval) => return self.value(&of[0]),
            Operation::Wrap(bits) if Interval::of_bits(bits).contains(of[0].interval) => return self.value(&of[0]),
            _ => {}
        }
        if let Operation::Wrap(bits @ ..=32) = operation {
            let low = self.low_bits(&of[0]);
            return match bits {
                32 => Value { interval, ..low },
                _ => self.emit(Action::Arithmetic(operation), false, &[low], interval),
            };
        }
        let mut operands: Vec<Value> = of.iter().map(|operand| self.value(operand)).collect();
        match operation {
            Operation::And | Operation::Or => {
                let operands = [operands[0], operands[1]].map(|operand| self.truth(operand));
                self.emit(Action::Arithmetic(operation), false, &operands, interval)
            }
            Operation::Not => {
                let zero = self.constant(0);
                self.comparison(Operation::Equal, [operands[0], zero])
            }
            Operation::Less | Operation::LessOrEqual | Operation::Equal | Operation::NotEqual => {
                self.comparison(operation, [operands[0], operands[1]])
            }
            Operation::Select => {
                let condition = self.truth(operands[0]);
                self.select(condition, [operands[1], operands[2]], interval)
            }
            Operation::Multiply if !is_narrow(interval) && operands.iter().all(|operand| !operand.wide) => {
                self.emit(Action::Product, false, &operands, interval)
            }
            _ => {
                let is_shift =
                    matches!(operation, Operation::ShiftLeft | Operation::ShiftRight | Operation::TowardZero);
                let far = is_shift && operands[1].interval.high > 31;
                let wide = far || !is_narrow(interval) || operands.iter().any(|operand| operand.wide);
                if wide {
                    operands = operands.into_iter().map(|operand| self.widened(operand)).collect();
                }
                let found = self.emit(Action::Arithmetic(operation), wide, &operands, interval);
                self.narrowed(found)
            }
        }
    }

    /// Returns the low 32 bits of a value. For sums, products and left shifts they follow from the
    /// low bits of the operands.
    fn low_bits(&mut self, expression: &Expression) -> Value {
        let all = Interval::of_bits(32);
        match &expression.node {
            _ if is_narrow(expression.interval) => self.value(expression),
            Node::Apply(operation @ (Operation::Add | Operation::Subtract | Operation::Multiply), of) => {
                let operands = [self.low_bits(&of[0]), self.low_bits(&of[1])];
                self.emit(Action::Arithmetic(*operation), false, &operands, all)
            }
            Node::Apply(Operation::ShiftLeft, of) if of[1].interval.high <= 31 => {
                let operands = [self.low_bits(&of[0]), self.value(&of[1])];
                self.emit(Action::Arithmetic(Operation::ShiftLeft), false, &operands, all)
            }
            _ => {
                let whole = self.value(expression);
                self.emit(Action::Narrow, true, &[whole], all)
            }
        }
    }

    fn select(&mut self, condition: Value, mut of: [Value; 2], interval: Interval) -> Value {
        let wide = of.iter().any(|operand| operand.wide);
        if wide {
            of = of.map(|operand| self.widened(operand));
        }
        self.emit(Action::Select, wide, &[condition, of[0], of[1]], interval)
    }

    /// Compiles an assignment. Lanes whose guard is 0 keep their state and report nothing.
    fn assign(&mut self, Assignment { target, value }: &Assignment, guard: Option<Value>) {
        let mut found = match self.code.width(*target).filter(|word| !word.interval().contains(value.interval)) {
            Some(word) => self.stored(value, word, guard),
            None => self.value(value),
        };
        match *target {
            Variable::State(place) => {
                if let Some(guard) = guard {
                    let union = Interval::of_bits(32);
                    found = self.select(guard, [found, self.state[place]], union);
                }
                self.state[place] = found;
            }
            Variable::Temporary(place) => self.temporaries[place] = Some(found),
            Variable::Arrived(_) | Variable::Parameter(_) => unreachable!("they are not assigned"),
        }
    }

    /// Compiles the wrap or clip of a value that may overflow its word, and its report.
    fn stored(&mut self, value: &Expression, word: &Word, guard: Option<Value>) -> Value {
        let action = match &value.node {
            Node::Apply(Operation::Add, of) => Some((Action::AddWord, of)),
            Node::Apply(Operation::Subtract, of) => Some((Action::SubtractWord, of)),
            Node::Apply(Operation::ShiftLeft, of) if of[1].interval.high <= 31 => Some((Action::ShiftWord, of)),
            _ => None,
        };
        if let Some((action, of)) = action.filter(|_| word.bits == 32 && word.overflow == Overflow::Wrap)
            && of.iter().all(|operand| is_narrow(operand.interval))
        {
            let operands: Vec<Value> = of.iter().map(|operand| self.value(operand)).chain(guard).collect();
            return self.emit(action, false, &operands, word.interval());
        }
        let whole = self.value(value);
        let operation = match word.overflow {
            Overflow::Wrap => Operation::Wrap(word.bits),
            Overflow::Clip => Operation::Clip(word.bits),
        };
        let kept = self.emit(Action::Arithmetic(operation), whole.wide, &[whole], word.interval());
        let compared: Vec<Value> = [whole, kept].into_iter().chain(guard).collect();
        self.emit(Action::Report(word.overflow), whole.wide, &compared, word.interval());
        self.narrowed(kept)
    }
}
