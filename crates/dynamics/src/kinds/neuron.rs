//! What a kind of neuron is: its state, its parameters and the update of one compartment, in a form
//! without branches that becomes vectors.

use std::fmt::Debug;

use nsim_ir::neurons::Row;

/// Compartments whose state lies side by side: a vector of words.
pub const CHUNK: usize = 16;

/// What arrives at a compartment in a step, by port.
pub type Arrived = [i32; 2];

/// What an update sends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Emission {
    /// All ones where there is a message, 0 where there is none.
    pub(super) sends: i32,
    /// What it carries.
    pub(super) value: i32,
}

impl Emission {
    /// A message that carries nothing of its own, or none.
    #[inline(always)]
    pub fn spike(spikes: bool) -> Emission {
        Emission { sends: mask(spikes), value: 0 }
    }

    /// A message with an integer, none with 0.
    #[inline(always)]
    pub fn value(value: i32) -> Emission {
        Emission { sends: mask(value != 0), value }
    }
}

/// Whether words left their bits, in a form without branches: then a number is negative.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Left {
    wrapped: i32,
    clipped: i32,
}

impl Left {
    /// The sum, wrapped.
    #[inline(always)]
    pub fn add(&mut self, a: i32, b: i32) -> i32 {
        let sum = a.wrapping_add(b);
        self.wrapped |= (a ^ sum) & (b ^ sum);
        sum
    }

    /// The difference, wrapped.
    #[inline(always)]
    pub fn subtract(&mut self, a: i32, b: i32) -> i32 {
        let difference = a.wrapping_sub(b);
        self.wrapped |= (a ^ b) & (a ^ difference);
        difference
    }

    /// The number as a word of 32 bits, wrapped.
    #[inline(always)]
    pub fn word(&mut self, x: i64) -> i32 {
        let word = x as i32;
        self.wrapped |= mask(i64::from(word) != x);
        word
    }

    /// Notes that a word wrapped, where it did.
    #[inline(always)]
    pub fn note_wrap(&mut self, wrapped: bool) {
        self.wrapped |= mask(wrapped);
    }

    /// Notes that a word was clipped, where it was.
    #[inline(always)]
    pub fn note_clip(&mut self, clipped: bool) {
        self.clipped |= mask(clipped);
    }

    /// Whether any wrapped.
    #[inline(always)]
    pub fn any_wrapped(self) -> bool {
        self.wrapped < 0
    }

    /// Whether any was clipped.
    #[inline(always)]
    pub fn any_clipped(self) -> bool {
        self.clipped < 0
    }

    /// Whether any left its bits.
    #[inline(always)]
    pub fn any(self) -> bool {
        self.wrapped | self.clipped < 0
    }
}

/// Equation (3): what a decay leaves of a word, rounded toward zero; `keep` is in 4096ths.
#[inline(always)]
pub(super) fn decay(x: i32, keep: i32) -> i64 {
    let kept = ((u64::from(x.unsigned_abs()) * u64::from(keep as u32)) >> 12) as i64;
    if x < 0 { -kept } else { kept }
}

/// All ones where something holds, 0 where not.
#[inline(always)]
pub(super) fn mask(holds: bool) -> i32 {
    -i32::from(holds)
}

/// A choice without a branch.
#[inline(always)]
pub(super) fn choice(mask: i32, then: i32, otherwise: i32) -> i32 {
    then & mask | otherwise & !mask
}

/// Numbers of a compartment, which lie in columns: a struct of words.
pub trait Columns: Copy + Default + PartialEq {
    /// Number of words.
    const COUNT: usize;
    /// Those of a lane, from as many columns.
    fn load(columns: &[[i32; CHUNK]], lane: usize) -> Self;
    /// Writes them back.
    fn store(self, columns: &mut [[i32; CHUNK]], lane: usize);
}

impl Columns for () {
    const COUNT: usize = 0;

    #[inline(always)]
    fn load(_: &[[i32; CHUNK]], _: usize) -> Self {}

    #[inline(always)]
    fn store(self, _: &mut [[i32; CHUNK]], _: usize) {}
}

/// Defines a struct of words and how they lie in columns.
macro_rules! columns {
    ($(#[$doc:meta])* $name:ident { $($word:ident = $place:literal),+ }) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq)]
        pub(super) struct $name { $(pub $word: i32),+ }

        impl $crate::kinds::neuron::Columns for $name {
            const COUNT: usize = [$($place),+].len();

            #[inline(always)]
            fn load(columns: &[[i32; $crate::kinds::neuron::CHUNK]], lane: usize) -> Self {
                $name { $($word: columns[$place][lane]),+ }
            }

            #[inline(always)]
            fn store(self, columns: &mut [[i32; $crate::kinds::neuron::CHUNK]], lane: usize) {
                $(columns[$place][lane] = self.$word;)+
            }
        }
    };
}
pub(super) use columns;

/// A kind of neuron.
pub trait Neuron: Debug + Send + Sync + 'static {
    /// What it carries from step to step, in the order of its table's columns.
    type State: Columns;
    /// Its parameters in the form that updates use.
    type Parameters: Columns;

    /// Whether its messages carry what it computes, rather than what its population says.
    const VALUES: bool = true;

    /// Whether [`Neuron::restart`] does anything.
    const RESTARTS: bool = false;

    /// The parameters from a row of its table.
    fn prepare(row: &Row) -> Self::Parameters;

    /// The state before the first step.
    #[inline(always)]
    fn first(_: &Self::Parameters) -> Self::State {
        Self::State::default()
    }

    /// What happens before the update of a step, in some steps only: nothing, unless a kind resets
    /// itself.
    #[inline(always)]
    fn restart(_: &Self::Parameters, _: &mut Self::State, _step: u32) {}

    /// One update; `left` notes words that left their bits. Without branches it becomes vectors.
    fn update(p: &Self::Parameters, s: &mut Self::State, arrived: Arrived, left: &mut Left) -> Emission;

    /// Whether an update without arrivals would change nothing, send nothing and report nothing, in
    /// any step.
    #[inline(always)]
    fn idle(p: &Self::Parameters, s: &Self::State) -> bool {
        let (mut after, mut left) = (*s, Left::default());
        let Emission { sends, .. } = Self::update(p, &mut after, [0; 2], &mut left);
        (sends == 0) & (after == *s) & !left.any()
    }
}
