//! Columns of a table of timesteps: names and units.

/// What a column counts, and how it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Things.
    Count,
    /// Picoseconds, written as microseconds.
    Microseconds,
    /// Femtojoules, written as picojoules.
    Picojoules,
}

impl Unit {
    /// Of what is counted, how many make a unit of what is written.
    #[must_use]
    pub fn divisor(self) -> u64 {
        match self {
            Unit::Count => 1,
            Unit::Microseconds => 1_000_000,
            Unit::Picojoules => 1_000,
        }
    }
}

/// A column behind `sample` and `timestep`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    /// Its name.
    pub name: String,
    /// What it counts.
    pub unit: Unit,
}
