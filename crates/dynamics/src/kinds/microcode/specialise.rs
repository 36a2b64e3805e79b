//! Specialisation of instructions to neurons whose parameters are known.
//!
//! Input: the instructions of a kind, and the registers that depend on parameters alone. Output:
//! fewer instructions. Copies (by a condition equal for all neurons, or an operand of 0) and unread
//! results are removed, and some comparisons are merged. Each removed instruction saves a store and
//! a load of a register.

use nsim_ir::microcode::Operation;

use super::super::neuron::CHUNK;
use super::compile::{Action, Code, FIXED, Instruction, NONE, Place, Section};
use super::run::CHUNKS;

/// Whether a register has 64 bits, and its number.
type Register = (bool, Place);

impl Instruction {
    /// The registers that it reads.
    fn reads(&self) -> impl Iterator<Item = Register> {
        // Conditions have 32 bits.
        let wide = match self.action {
            Action::Narrow => [true; 3],
            Action::Widen | Action::Product => [false; 3],
            Action::Select => [false, self.wide, self.wide],
            _ => [self.wide, self.wide, false],
        };
        wide.into_iter().zip(self.operands).filter(|&(_, place)| place != NONE)
    }

    /// The register that it writes, if any.
    fn writes(&self) -> Option<Register> {
        match self.action {
            Action::Report(_) => None,
            Action::Widen | Action::Product => Some((true, self.out)),
            Action::Narrow | Action::Comparison(_) => Some((false, self.out)),
            _ => Some((self.wide, self.out)),
        }
    }

    /// The operand that is only tested for 0, if any.
    fn condition(&mut self) -> Option<&mut Place> {
        let [a, _, c] = &mut self.operands;
        match self.action {
            Action::Select => Some(a),
            action if action.reports() => Some(c).filter(|place| **place != NONE),
            _ => None,
        }
    }

    /// Merges an `Or` of two comparisons of one number with a lower and an upper limit.
    fn outside(&self, before: &[Instruction]) -> Option<Instruction> {
        let compares = |place: Place| {
            let is = |other: &&Instruction| {
                other.writes() == Some((false, place))
                    && other.action == Action::Comparison(Operation::LessOrEqual)
                    && !other.wide
            };
            before.iter().find(is).map(|found| found.operands)
        };
        let Action::Arithmetic(Operation::Or) = self.action else { return None };
        let ([a, b, _], [c, d, _]) = (compares(self.operands[0])?, compares(self.operands[1])?);
        let operands = match (b == c, d == a) {
            (true, _) => [a, b, d],
            (_, true) => [c, d, b],
            _ => return None,
        };
        Some(Instruction { action: Action::Outside, operands, ..*self })
    }

    /// The register of 32 bits that it copies, if it only copies.
    fn copies(&self, value: impl Fn(Place) -> Option<i32>) -> Option<Place> {
        let [a, b, c] = self.operands;
        if self.wide {
            return None;
        }
        match self.action {
            Action::Select => match value(a) {
                Some(0) => Some(c),
                Some(_) => Some(b),
                None => Some(b).filter(|_| b == c),
            },
            // Operands are 0 or 1.
            Action::Arithmetic(Operation::Or) => match (value(a), value(b)) {
                (Some(0), _) | (_, Some(1)) => Some(b),
                (_, Some(0)) | (Some(1), _) => Some(a),
                _ => None,
            },
            Action::Arithmetic(Operation::And) => match (value(a), value(b)) {
                (Some(1), _) | (_, Some(0)) => Some(b),
                (_, Some(1)) | (Some(0), _) => Some(a),
                _ => None,
            },
            // An operand of 0 changes nothing, hence nothing wraps.
            Action::AddWord | Action::Arithmetic(Operation::Add) => match (value(a), value(b)) {
                (_, Some(0)) => Some(a),
                (Some(0), _) => Some(b),
                _ => None,
            },
            Action::SubtractWord
            | Action::ShiftWord
            | Action::Arithmetic(
                Operation::Subtract | Operation::ShiftLeft | Operation::ShiftRight | Operation::TowardZero,
            ) => Some(a).filter(|_| value(b) == Some(0)),
            _ => None,
        }
    }
}

impl Code {
    /// Specialises the code to these values of the registers that depend on parameters alone.
    pub(super) fn specialised(&self, fixed: &[[[i32; CHUNK]; CHUNKS]], lanes: usize) -> Code {
        let value = |place: Place| {
            let register = fixed.get(usize::from(place & !FIXED)).filter(|_| place != NONE && place & FIXED != 0)?;
            let (first, others) = register.as_flattened()[..lanes].split_first()?;
            Some(*first).filter(|first| others.iter().all(|other| other == first))
        };
        // For each register of 32 bits: one that is 0 where it is 0, and one that equals it.
        let mut tested: Vec<Place> = (0..self.step.narrow).collect();
        let mut same: Vec<Place> = (0..self.step.narrow).collect();
        fn found(same: &[Place], place: Place) -> u16 {
            if place & FIXED == 0 { same[usize::from(place)] } else { place }
        }
        let mut instructions: Vec<Instruction> = Vec::new();
        for instruction in &self.step.instructions {
            let mut new = *instruction;
            for ((wide, _), place) in instruction.reads().zip(&mut new.operands) {
                *place = if wide { *place } else { found(&same, *place) };
            }
            if let Some(condition) = new.condition() {
                *condition = found(&tested, *condition);
            }
            if let Some(place) = new.copies(value) {
                same[usize::from(new.out)] = place;
                continue;
            }
            if new.action == Action::Comparison(Operation::NotEqual) && !new.wide && value(new.operands[1]) == Some(0) {
                tested[usize::from(new.out)] = found(&tested, new.operands[0]);
            }
            instructions.push(new.outside(&instructions).unwrap_or(new));
        }
        let message = self.message.map(|place| found(&same, place));
        let sent = found(&tested, found(&same, self.sent));
        let state: Vec<Place> = self.state.iter().map(|&place| found(&same, place)).collect();
        let mut read: Vec<Register> =
            state.iter().copied().chain([sent]).chain(message).map(|at| (false, at)).collect();
        let mut needed = Vec::new();
        for instruction in instructions.into_iter().rev() {
            if instruction.action.reports() || instruction.writes().is_some_and(|register| read.contains(&register)) {
                read.extend(instruction.reads());
                needed.push(instruction);
            }
        }
        needed.reverse();
        let &Code { parameters, words, ports, .. } = self;
        let step = Section { instructions: needed, ..self.step };
        Code { parameters, words, ports, fixed: Section::default(), step, state, sent, message }
    }
}
