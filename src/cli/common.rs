//! What several subcommands share: printing, ranges, progress.

use std::ops::Range;
use std::str::FromStr;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::cli::{Context, Format};
use crate::error::Error;
use crate::io::write;

/// Prints a result in the format that is asked for.
///
/// # Errors
/// When stdout cannot be written; a reader that went away is no error.
pub fn print(
    format: Format,
    text: impl FnOnce() -> String,
    json: impl FnOnce() -> serde_json::Value,
    csv: impl FnOnce() -> Result<String, csv::Error>,
) -> Result<(), Error> {
    let out = match format {
        Format::Text => text(),
        Format::Json => format!("{:#}\n", json()),
        Format::Csv => csv().map_err(|error| Error::Fault(format!("csv: {error}")))?,
    };
    Ok(write::stdout(&out)?)
}

/// `A..B` of samples.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SampleRange(pub Range<usize>);

impl FromStr for SampleRange {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("'{text}' is not a range of samples such as 0..20");
        let (from, to) = text.split_once("..").ok_or_else(wrong)?;
        let from = if from.is_empty() { 0 } else { from.parse().map_err(|_| wrong())? };
        let to = if to.is_empty() { usize::MAX } else { to.parse().map_err(|_| wrong())? };
        if from >= to { Err(wrong()) } else { Ok(SampleRange(from..to)) }
    }
}

/// A progress bar on stderr that appears after a second, or none.
#[must_use]
pub fn progress(context: Context, length: u64, what: &'static str) -> ProgressBar {
    if !context.progress {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {eta}")
        .unwrap_or_else(|_| ProgressStyle::default_bar());
    let bar =
        ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden()).with_style(style).with_message(what);
    let shown = bar.clone();
    std::thread::spawn(move || {
        std::thread::sleep(std::time::Duration::from_secs(1));
        if !shown.is_finished() {
            shown.set_draw_target(ProgressDrawTarget::stderr());
        }
    });
    bar
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_of_samples_parse() {
        assert_eq!("0..20".parse(), Ok(SampleRange(0..20)));
        assert_eq!("5..".parse(), Ok(SampleRange(5..usize::MAX)));
        for bad in ["", "3", "4..4", "5..2", "a..b"] {
            assert!(bad.parse::<SampleRange>().is_err(), "{bad}");
        }
    }
}
