//! The execution of instructions, 64 lanes at a time.
//!
//! Loops over a register have no branches and no other names for what they write, so that
//! compilers turn them into vectors. Lanes behind the last neuron hold anything; nothing panics on
//! them.

use nsim_ir::microcode::{Operation, Overflow};

use super::super::block::{Effects, Flags, MOST_LANES};
use super::super::neuron::{CHUNK, mask};
use super::compile::{Action, Code, FIXED, Instruction, NONE, Place, Section, WORDS};

/// Chunks of a register.
pub(super) const CHUNKS: usize = MOST_LANES / CHUNK;

/// A value for each lane.
type Register<T> = [[T; CHUNK]; CHUNKS];

/// Registers of 32 and of 64 bits.
#[derive(Debug, Default)]
pub(super) struct Registers {
    pub narrow: Vec<Register<i32>>,
    pub wide: Vec<Register<i64>>,
}

impl Registers {
    /// Holds at least the registers of a section.
    pub(super) fn make_room(&mut self, section: &Section) {
        let grow = |length: usize, to: Place| length.max(to.into());
        self.narrow.resize(grow(self.narrow.len(), section.narrow), Default::default());
        self.wide.resize(grow(self.wide.len(), section.wide), Default::default());
    }
}

/// The arithmetic of a lane. Results fit; what is in no lane of a neuron wraps.
trait Lane: Copy + Ord {
    fn plus(self, other: Self) -> Self;
    fn minus(self, other: Self) -> Self;
    fn times(self, other: Self) -> Self;
    fn shifted_left(self, by: Self) -> Self;
    fn shifted_right(self, by: Self) -> Self;
    fn toward_zero(self, by: Self) -> Self;
    fn intersected(self, other: Self) -> Self;
    fn united(self, other: Self) -> Self;
    fn magnitude(self) -> Self;
    fn wrapped(self, bits: u32) -> Self;
    fn clipped(self, bits: u32) -> Self;
}

macro_rules! lane {
    ($type:ty) => {
        impl Lane for $type {
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self.wrapping_add(other)
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self.wrapping_sub(other)
            }
            #[inline(always)]
            fn times(self, other: Self) -> Self {
                self.wrapping_mul(other)
            }
            #[inline(always)]
            fn shifted_left(self, by: Self) -> Self {
                self.wrapping_shl(by as u32)
            }
            #[inline(always)]
            fn shifted_right(self, by: Self) -> Self {
                self.wrapping_shr(by as u32)
            }
            #[inline(always)]
            fn toward_zero(self, by: Self) -> Self {
                // Below zero as much is added as rounding down would take too much.
                let low = (1 as Self).wrapping_shl(by as u32).wrapping_sub(1);
                self.wrapping_add(self.wrapping_shr(Self::BITS - 1) & low).wrapping_shr(by as u32)
            }
            #[inline(always)]
            fn intersected(self, other: Self) -> Self {
                self & other
            }
            #[inline(always)]
            fn united(self, other: Self) -> Self {
                self | other
            }
            #[inline(always)]
            fn magnitude(self) -> Self {
                self.wrapping_abs()
            }
            #[inline(always)]
            fn wrapped(self, bits: u32) -> Self {
                let above = Self::BITS.saturating_sub(bits);
                self.wrapping_shl(above).wrapping_shr(above)
            }
            #[inline(always)]
            fn clipped(self, bits: u32) -> Self {
                let most = Self::MAX.wrapping_shr(Self::BITS.saturating_sub(bits));
                self.max(-most).min(most)
            }
        }
    };
}
lane!(i32);
lane!(i64);

/// A register, of those that are fixed or of the others.
#[inline(always)]
fn at<'r, T>(fixed: &'r [Register<T>], others: &'r [Register<T>], place: Place) -> &'r Register<T> {
    match place & FIXED {
        0 => &others[usize::from(place)],
        _ => &fixed[usize::from(place & !FIXED)],
    }
}

/// The registers before one, and that one.
#[inline(always)]
fn split<T>(registers: &mut [Register<T>], out: Place) -> (&[Register<T>], &mut Register<T>) {
    let (before, from) = registers.split_at_mut(out.into());
    (before, &mut from[0])
}

#[inline(always)]
fn each<T: Copy, U>(out: &mut Register<U>, a: &Register<T>, chunks: usize, f: impl Fn(T) -> U) {
    for (out, a) in out.iter_mut().zip(a).take(chunks) {
        for lane in 0..CHUNK {
            out[lane] = f(a[lane]);
        }
    }
}

#[inline(always)]
fn both<T: Copy, U>(out: &mut Register<U>, a: &Register<T>, b: &Register<T>, chunks: usize, f: impl Fn(T, T) -> U) {
    for ((out, a), b) in out.iter_mut().zip(a).zip(b).take(chunks) {
        for lane in 0..CHUNK {
            out[lane] = f(a[lane], b[lane]);
        }
    }
}

/// Marks lanes by the sign of what `f` says of their values, where a guard holds.
#[inline(always)]
fn report<T: Copy>(
    left: &mut Register<i32>,
    [a, b]: [&Register<T>; 2],
    guard: Option<&Register<i32>>,
    chunks: usize,
    f: impl Fn(T, T) -> i32,
) {
    for chunk in 0..chunks {
        let (left, a, b) = (&mut left[chunk], &a[chunk], &b[chunk]);
        match guard.map(|guard| &guard[chunk]) {
            Some(guard) => (0..CHUNK).for_each(|lane| left[lane] |= f(a[lane], b[lane]) & mask(guard[lane] != 0)),
            None => (0..CHUNK).for_each(|lane| left[lane] |= f(a[lane], b[lane])),
        }
    }
}

/// An operation whose result is as wide as its operands.
#[inline(always)]
fn arithmetic<T: Lane>(
    operation: Operation,
    fixed: &[Register<T>],
    registers: &mut [Register<T>],
    Instruction { operands: [a, b, _], out, .. }: &Instruction,
    chunks: usize,
) {
    let (before, out) = split(registers, *out);
    let a = at(fixed, before, *a);
    match operation {
        Operation::Absolute => return each(out, a, chunks, T::magnitude),
        Operation::Clip(bits) => return each(out, a, chunks, |x| x.clipped(bits)),
        Operation::Wrap(bits) => return each(out, a, chunks, |x| x.wrapped(bits)),
        _ => {}
    }
    let b = at(fixed, before, *b);
    match operation {
        Operation::Add => both(out, a, b, chunks, T::plus),
        Operation::Subtract => both(out, a, b, chunks, T::minus),
        Operation::Multiply => both(out, a, b, chunks, T::times),
        Operation::ShiftLeft => both(out, a, b, chunks, T::shifted_left),
        Operation::ShiftRight => both(out, a, b, chunks, T::shifted_right),
        Operation::TowardZero => both(out, a, b, chunks, T::toward_zero),
        Operation::Minimum => both(out, a, b, chunks, T::min),
        Operation::Maximum => both(out, a, b, chunks, T::max),
        // Of 0 and 1.
        Operation::And => both(out, a, b, chunks, T::intersected),
        Operation::Or => both(out, a, b, chunks, T::united),
        _ => unreachable!("it has an action of its own"),
    }
}

/// An operation whose result is 0 or 1.
#[inline(always)]
fn comparison<T: Lane>(operation: Operation, out: &mut Register<i32>, a: &Register<T>, b: &Register<T>, chunks: usize) {
    match operation {
        Operation::Less => both(out, a, b, chunks, |a, b| i32::from(a < b)),
        Operation::LessOrEqual => both(out, a, b, chunks, |a, b| i32::from(a <= b)),
        Operation::Equal => both(out, a, b, chunks, |a, b| i32::from(a == b)),
        Operation::NotEqual => both(out, a, b, chunks, |a, b| i32::from(a != b)),
        _ => unreachable!("it has an action of its own"),
    }
}

#[inline(always)]
fn select<T: Copy>(out: &mut Register<T>, condition: &Register<i32>, [a, b]: [&Register<T>; 2], chunks: usize) {
    for chunk in 0..chunks {
        let (out, condition, a, b) = (&mut out[chunk], &condition[chunk], &a[chunk], &b[chunk]);
        for lane in 0..CHUNK {
            out[lane] = if condition[lane] != 0 { a[lane] } else { b[lane] };
        }
    }
}

/// Executes instructions; lanes whose words wrap or are clipped get a sign in `left`.
#[inline(always)]
fn execute(
    instructions: &[Instruction],
    fixed: &Registers,
    registers: &mut Registers,
    left: &mut [Register<i32>; 2],
    chunks: usize,
) {
    let Registers { narrow, wide } = registers;
    for instruction in instructions {
        let &Instruction { action, wide: of_64, operands: [a, b, c], out } = instruction;
        let index = usize::from(out);
        match (action, of_64) {
            (Action::Constant(value), false) => narrow[index] = [[value as i32; CHUNK]; CHUNKS],
            (Action::Constant(value), true) => wide[index] = [[value; CHUNK]; CHUNKS],
            (Action::Widen, _) => each(&mut wide[index], at(&fixed.narrow, narrow, a), chunks, i64::from),
            (Action::Narrow, _) => each(&mut narrow[index], at(&fixed.wide, wide, a), chunks, |x| x as i32),
            (Action::Product, _) => {
                let (a, b) = (at(&fixed.narrow, narrow, a), at(&fixed.narrow, narrow, b));
                both(&mut wide[index], a, b, chunks, |a, b| i64::from(a) * i64::from(b));
            }
            (Action::Arithmetic(operation), false) => {
                arithmetic(operation, &fixed.narrow, narrow, instruction, chunks);
            }
            (Action::Arithmetic(operation), true) => arithmetic(operation, &fixed.wide, wide, instruction, chunks),
            (Action::Comparison(operation), false) => {
                let (before, out) = split(narrow, out);
                comparison(operation, out, at(&fixed.narrow, before, a), at(&fixed.narrow, before, b), chunks);
            }
            (Action::Comparison(operation), true) => {
                let (a, b) = (at(&fixed.wide, wide, a), at(&fixed.wide, wide, b));
                comparison(operation, &mut narrow[index], a, b, chunks);
            }
            (Action::Select, false) => {
                let (before, out) = split(narrow, out);
                let [a, b, c] = [a, b, c].map(|place| at(&fixed.narrow, before, place));
                select(out, a, [b, c], chunks);
            }
            (Action::Select, true) => {
                let (before, out) = split(wide, out);
                let of = [b, c].map(|place| at(&fixed.wide, before, place));
                select(out, at(&fixed.narrow, narrow, a), of, chunks);
            }
            (Action::AddWord | Action::SubtractWord, _) => {
                let (before, out) = split(narrow, out);
                let [a, b] = [a, b].map(|place| at(&fixed.narrow, before, place));
                let guard = (c != NONE).then(|| at(&fixed.narrow, before, c));
                if action == Action::AddWord {
                    both(out, a, b, chunks, i32::wrapping_add);
                    report(&mut left[0], [a, b], guard, chunks, |a, b| {
                        let sum = a.wrapping_add(b);
                        (a ^ sum) & (b ^ sum)
                    });
                } else {
                    both(out, a, b, chunks, i32::wrapping_sub);
                    report(&mut left[0], [a, b], guard, chunks, |a, b| (a ^ b) & (a ^ a.wrapping_sub(b)));
                }
            }
            (Action::Report(overflow), of_64) => {
                let left = &mut left[usize::from(overflow == Overflow::Clip)];
                let guard = (c != NONE).then(|| at(&fixed.narrow, narrow, c));
                match of_64 {
                    false => {
                        let of = [a, b].map(|place| at(&fixed.narrow, narrow, place));
                        report(left, of, guard, chunks, |a, b| mask(a != b));
                    }
                    true => {
                        let of = [a, b].map(|place| at(&fixed.wide, wide, place));
                        report(left, of, guard, chunks, |a, b| mask(a != b));
                    }
                }
            }
        }
    }
}

/// Computes what depends on parameters alone, which are the first registers.
pub(super) fn fix(code: &Code, registers: &mut Registers) {
    let mut left = Default::default();
    execute(&code.fixed.instructions, &Registers::default(), registers, &mut left, CHUNKS);
}

/// A step of a block, in the form in which `pulp` runs it with the processor's vectors.
pub(super) struct Step<'s> {
    pub code: &'s Code,
    pub lanes: usize,
    pub fixed: &'s Registers,
    pub registers: &'s mut Registers,
    pub columns: &'s mut [[i32; CHUNK]],
    pub arrived: [&'s [[i32; CHUNK]]; 2],
    pub sent: &'s mut [[i32; CHUNK]],
}

impl pulp::NullaryFnOnce for Step<'_> {
    type Output = Effects;

    #[inline(always)]
    fn call(self) -> Effects {
        let Step { code, lanes, fixed, registers, columns, arrived, sent } = self;
        let (chunks, words) = (sent.len(), code.words);
        for (register, arrived) in registers.narrow.iter_mut().zip(arrived).take(code.ports) {
            register[..chunks].copy_from_slice(&arrived[..chunks]);
        }
        for (word, register) in registers.narrow[WORDS..WORDS + words].iter_mut().enumerate() {
            for chunk in 0..chunks {
                register[chunk] = columns[chunk * words + word];
            }
        }
        let mut left: [Register<i32>; 2] = Default::default();
        execute(&code.step.instructions, fixed, registers, &mut left, chunks);
        let register = |place: Place| at(&fixed.narrow, &registers.narrow, place);
        let mut flags = Flags::default();
        for (chunk, values) in sent.iter_mut().enumerate() {
            let sends = register(code.sent)[chunk];
            let [wrapped, clipped] = [left[0][chunk], left[1][chunk]];
            let mut moved = sends;
            for arrived in &registers.narrow[..code.ports] {
                (0..CHUNK).for_each(|lane| moved[lane] |= arrived[chunk][lane]);
            }
            for (word, place) in code.state.iter().enumerate() {
                let (before, after) = (registers.narrow[WORDS + word][chunk], register(*place)[chunk]);
                (0..CHUNK).for_each(|lane| moved[lane] |= before[lane] ^ after[lane]);
                columns[chunk * words + word] = after;
            }
            if let Some(message) = code.message {
                let message = register(message)[chunk];
                for lane in 0..CHUNK {
                    values[lane] = if sends[lane] != 0 { message[lane] } else { values[lane] };
                }
            }
            let mut of_chunk = [0; CHUNK];
            for lane in 0..CHUNK {
                let (wraps, clips) = (wrapped[lane] < 0, clipped[lane] < 0);
                let active = (moved[lane] != 0) | wraps | clips;
                of_chunk[lane] =
                    sends[lane] as u32 | u32::from(active) << 1 | u32::from(wraps) << 2 | u32::from(clips) << 3;
            }
            for (byte, flags) in flags[chunk].iter_mut().zip(of_chunk) {
                *byte = flags as u8;
            }
        }
        let effects = Effects::new(lanes, &flags);
        // What moved may move again; the next update shows.
        Effects { busy: effects.active, ..effects }
    }
}
