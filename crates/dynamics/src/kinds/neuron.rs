//! A neuron kind: its state, its parameters and the update of one compartment. Updates have no
//! branches, so that compilers vectorise them.

use std::fmt::Debug;

use nsim_ir::neurons::ParameterRow;

/// Number of compartments whose words are adjacent in memory, as one vector.
pub const CHUNK: usize = 16;

/// Sums of arrivals of a compartment in a step, by port: a(t) of equation (19) in `docs/loihi2.md`.
pub type Arrived = [i32; 2];

/// Message of an update.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Emission {
    /// All ones where there is a message, 0 where there is none.
    pub(super) sends: i32,
    /// Value of the message.
    pub(super) value: i32,
}

impl Emission {
    /// Returns a message without a value, or none.
    #[inline(always)]
    pub fn spike(spikes: bool) -> Emission {
        Emission { sends: mask(spikes), value: 0 }
    }

    /// Returns a message with an integer; 0 sends none.
    #[inline(always)]
    pub fn value(value: i32) -> Emission {
        Emission { sends: mask(value != 0), value }
    }
}

/// Overflows of words, in a form without branches: a negative number marks an overflow.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct OverflowFlags {
    wrapped: i32,
    clipped: i32,
}

impl OverflowFlags {
    /// Returns the sum, wrapped.
    #[inline(always)]
    pub fn add(&mut self, a: i32, b: i32) -> i32 {
        let sum = a.wrapping_add(b);
        self.wrapped |= (a ^ sum) & (b ^ sum);
        sum
    }

    /// Returns the difference, wrapped.
    #[inline(always)]
    pub fn subtract(&mut self, a: i32, b: i32) -> i32 {
        let difference = a.wrapping_sub(b);
        self.wrapped |= (a ^ b) & (a ^ difference);
        difference
    }

    /// Returns the number as a word of 32 bits, wrapped.
    #[inline(always)]
    pub fn word(&mut self, x: i64) -> i32 {
        let word = x as i32;
        self.wrapped |= mask(i64::from(word) != x);
        word
    }

    /// Records a wrapped word where `wrapped`.
    #[inline(always)]
    pub fn note_wrap(&mut self, wrapped: bool) {
        self.wrapped |= mask(wrapped);
    }

    /// Records a clipped word where `clipped`.
    #[inline(always)]
    pub fn note_clip(&mut self, clipped: bool) {
        self.clipped |= mask(clipped);
    }

    /// Whether any word wrapped.
    #[inline(always)]
    pub fn any_wrapped(self) -> bool {
        self.wrapped < 0
    }

    /// Whether any word was clipped.
    #[inline(always)]
    pub fn any_clipped(self) -> bool {
        self.clipped < 0
    }

    /// Whether any word overflowed.
    #[inline(always)]
    pub fn any(self) -> bool {
        self.wrapped | self.clipped < 0
    }
}

/// Equation (3): a word after decay, rounded toward zero; `keep` is in 4096ths.
#[inline(always)]
pub(super) fn decay(x: i32, keep: i32) -> i64 {
    let decayed = ((u64::from(x.unsigned_abs()) * u64::from(keep as u32)) >> 12) as i64;
    if x < 0 { -decayed } else { decayed }
}

/// Returns all ones where the condition holds, else 0.
#[inline(always)]
pub(super) fn mask(holds: bool) -> i32 {
    -i32::from(holds)
}

/// Returns `then` where the mask is all ones, `otherwise` where it is 0, without a branch.
#[inline(always)]
pub(super) fn choice(mask: i32, then: i32, otherwise: i32) -> i32 {
    then & mask | otherwise & !mask
}

/// Words of a compartment, as a struct that is stored in columns.
pub trait Columns: Copy + Default + PartialEq {
    /// Number of words.
    const COUNT: usize;
    /// Loads the words of a lane from `COUNT` columns.
    fn load(columns: &[[i32; CHUNK]], lane: usize) -> Self;
    /// Stores the words of a lane.
    fn store(self, columns: &mut [[i32; CHUNK]], lane: usize);
}

impl Columns for () {
    const COUNT: usize = 0;

    #[inline(always)]
    fn load(_: &[[i32; CHUNK]], _: usize) -> Self {}

    #[inline(always)]
    fn store(self, _: &mut [[i32; CHUNK]], _: usize) {}
}

/// Defines a struct of words and their order in columns.
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
    /// State between steps, in the order of its table's columns.
    type State: Columns;
    /// Its parameters in the form that updates use.
    type Parameters: Columns;

    /// Whether its messages carry a computed value, rather than its population's payload.
    const VALUES: bool = true;

    /// Whether [`Neuron::restart`] does anything.
    const RESTARTS: bool = false;

    /// The parameters from a row of its table.
    fn prepare(row: &ParameterRow) -> Self::Parameters;

    /// The state before the first step.
    #[inline(always)]
    fn first(_: &Self::Parameters) -> Self::State {
        Self::State::default()
    }

    /// Resets the state before the update of some steps. Only kinds with a reset of their own have
    /// one.
    #[inline(always)]
    fn restart(_: &Self::Parameters, _: &mut Self::State, _step: u32) {}

    /// Computes one update without branches; `overflows` records overflows.
    fn update(p: &Self::Parameters, s: &mut Self::State, arrived: Arrived, overflows: &mut OverflowFlags) -> Emission;

    /// Whether an update without arrivals would change nothing, send nothing and report nothing, in
    /// any step.
    #[inline(always)]
    fn idle(p: &Self::Parameters, s: &Self::State) -> bool {
        let (mut after, mut overflows) = (*s, OverflowFlags::default());
        let Emission { sends, .. } = Self::update(p, &mut after, [0; 2], &mut overflows);
        (sends == 0) & (after == *s) & !overflows.any()
    }
}
