//! Energy, time and power as integers. Units are small enough for every constant, and types wide
//! enough for every sum.
//!
//! One femtojoule is a thousandth of the least published event energy; one picosecond a hundredth
//! of the least published time. Sums are exact, so totals do not depend on the order of addition.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Mul};

macro_rules! quantity {
    ($(#[$doc:meta])* $name:ident($repr:ty)) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub $repr);
        impl From<u64> for $name {
            fn from(count: u64) -> $name {
                $name(count.into())
            }
        }
        impl Add for $name {
            type Output = $name;
            fn add(self, other: $name) -> $name {
                $name(self.0 + other.0)
            }
        }
        impl AddAssign for $name {
            fn add_assign(&mut self, other: $name) {
                self.0 += other.0;
            }
        }
        impl Mul<u64> for $name {
            type Output = $name;
            fn mul(self, count: u64) -> $name {
                $name(self.0 * <$repr>::from(count))
            }
        }
        impl Sum for $name {
            fn sum<I: Iterator<Item = $name>>(items: I) -> $name {
                items.fold($name::default(), Add::add)
            }
        }
    };
}

quantity!(
    /// Energy in femtojoules.
    Femtojoules(u128)
);
quantity!(
    /// Time in picoseconds.
    Picoseconds(u64)
);
quantity!(
    /// Power in nanowatts.
    Nanowatts(u64)
);

impl Femtojoules {
    /// The energy in microjoules.
    pub fn microjoules(self) -> f64 {
        self.0 as f64 / 1e9
    }
}

impl Picoseconds {
    /// Converts a time in milliseconds, rounded to the nearest picosecond.
    pub fn from_milliseconds(milliseconds: f64) -> Self {
        Picoseconds((milliseconds * 1e9).round() as u64)
    }

    /// The time in microseconds.
    pub fn microseconds(self) -> f64 {
        self.0 as f64 / 1e6
    }
}

impl Nanowatts {
    /// The power in milliwatts.
    pub fn milliwatts(self) -> f64 {
        self.0 as f64 / 1e6
    }

    /// The energy of this power over a time, rounded down to a femtojoule (1 nW for 1 ps is 10^-6
    /// fJ).
    #[must_use]
    pub fn during(self, time: Picoseconds) -> Femtojoules {
        Femtojoules(u128::from(self.0) * u128::from(time.0) / 1_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_milliwatt_for_a_microsecond_is_a_nanojoule() {
        assert_eq!(Nanowatts(1_000_000).during(Picoseconds(1_000_000)), Femtojoules(1_000_000));
        assert!((Femtojoules(1_000_000).microjoules() - 1e-3).abs() < 1e-15);
    }
}
