//! Values of arguments: a switch, a range of samples, a duration.

use std::ops::Range;
use std::time::Duration;

use clap::builder::{PossibleValuesParser, TypedValueParser};

use nsim_study::sweep::variants;

/// On or off.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Switch {
    /// Yes.
    On,
    /// No.
    Off,
}

/// Parses one of a closed set of values by its name.
pub fn one_of<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name_of: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    let value = move |name: String| all.iter().copied().find(|&value| name_of(value) == name).ok_or("no such value");
    PossibleValuesParser::new(all.iter().map(|&value| name_of(value))).try_map(value)
}

/// `A..B` of samples.
pub fn sample_range(text: &str) -> Result<Range<usize>, String> {
    variants::sample_range(text).ok_or_else(|| format!("'{text}' is not a range of samples such as 0..20"))
}

/// Seconds as an argument.
pub fn seconds(text: &str) -> Result<Duration, String> {
    match text.parse::<f64>() {
        Ok(seconds) if (0.0..=3600.0).contains(&seconds) => Ok(Duration::from_secs_f64(seconds)),
        _ => Err("seconds are between 0 and 3600".to_string()),
    }
}

#[cfg(test)]
mod tests {
    use crate::cli::args::values::*;

    #[test]
    fn ranges_of_samples_parse() {
        assert_eq!(sample_range("0..20"), Ok(0..20));
        assert_eq!(sample_range("5.."), Ok(5..usize::MAX));
        for bad in ["", "3", "4..4", "5..2", "a..b"] {
            assert!(sample_range(bad).is_err(), "{bad}");
        }
    }
}
