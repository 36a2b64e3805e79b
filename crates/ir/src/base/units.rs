//! Energy, time and power as integers. Units are small enough for every constant, and types wide
//! enough for every sum.
//!
//! One femtojoule is a thousandth of the least published event energy; one picosecond a hundredth
//! of the least published time. Sums are exact, so totals do not depend on the order of addition.
//! [`Unit`] has the units in which a person writes them.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Mul};

use serde::{Deserialize, Serialize};

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

/// The unit of a constant.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[allow(non_camel_case_types, missing_docs)]
pub enum Unit {
    pJ,
    ns,
    us,
    mW,
    messages,
    ratio,
}

/// Units of values on the command line, each with the unit in which such a value is stored, and the
/// factor to that unit.
const UNITS: [(&str, Unit, f64); 11] = [
    ("fJ", Unit::pJ, 1e-3),
    ("pJ", Unit::pJ, 1.0),
    ("nJ", Unit::pJ, 1e3),
    ("uJ", Unit::pJ, 1e6),
    ("ps", Unit::ns, 1e-3),
    ("ns", Unit::ns, 1.0),
    ("us", Unit::ns, 1e3),
    ("ms", Unit::ns, 1e6),
    ("uW", Unit::mW, 1e-3),
    ("mW", Unit::mW, 1.0),
    ("W", Unit::mW, 1e3),
];

impl Unit {
    /// The suffix of a number in this unit.
    pub fn suffix(self) -> &'static str {
        match self {
            Unit::pJ => "pJ",
            Unit::ns => "ns",
            Unit::us => "us",
            Unit::mW => "mW",
            Unit::messages | Unit::ratio => "",
        }
    }

    /// Converts a value such as `0.4us` to this unit. Some constants of time are in ns and others
    /// in us, so a time without its unit is refused.
    ///
    /// # Errors
    /// A sentence for a text that is no number, or is in a unit of another quantity.
    pub fn parsed(self, typed: &str) -> Result<f64, String> {
        let typed = typed.trim();
        let end = typed.len() - typed.chars().rev().take_while(char::is_ascii_alphabetic).count();
        let (number, unit) = (typed[..end].trim(), &typed[end..]);
        let number: f64 = number.parse().map_err(|_| format!("{typed} is not a number"))?;
        let (measured, each) = match self {
            Unit::us => (Unit::ns, 1e3),
            other => (other, 1.0),
        };
        if unit.is_empty() {
            return match measured {
                Unit::ns => Err(format!("{typed} has no unit, but constants of time are in ns or in us")),
                _ => Ok(number),
            };
        }
        match UNITS.iter().find(|(name, of, _)| *name == unit && *of == measured) {
            // Multiplied before it is divided, so that 400 ns is exactly 0.4 us.
            Some((.., factor)) if *factor >= 1.0 => Ok(number * factor / each),
            Some((.., factor)) => Ok(number / (1.0 / factor).round() / each),
            None => Err(format!("{unit} is not a valid unit for a constant in {}", self.suffix())),
        }
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
