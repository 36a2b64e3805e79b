//! Messages on stderr. Failed writes are ignored, so a closed stderr loses no result.

use std::io::Write;

use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::prelude::*;

use crate::cli::diagnostics;
use crate::cli::process::progress;

/// Stderr, whose errors are ignored.
struct LossyStderr;

impl Write for LossyStderr {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if !nsim_files::write::is_silent() {
            let _ = progress::without_line(|| std::io::stderr().lock().write_all(bytes));
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Starts the log at the level of `--verbose` and `--quiet`. With `recordings` the default level
/// also has a line for each recording.
pub fn start(verbose: u8, quiet: bool, recordings: bool) {
    let all = |level| Targets::new().with_default(level);
    let level = match (quiet, verbose) {
        (true, _) => all(LevelFilter::ERROR),
        (false, 0) if recordings => all(LevelFilter::WARN).with_target("recording", LevelFilter::INFO),
        (false, 0) => all(LevelFilter::WARN),
        (false, 1) => all(LevelFilter::INFO),
        (false, _) => all(LevelFilter::DEBUG),
    };
    let lines = tracing_subscriber::fmt::layer()
        .with_writer(|| LossyStderr)
        .with_ansi(diagnostics::colour())
        .log_internal_errors(false)
        .without_time()
        .with_target(false);
    tracing_subscriber::registry().with(lines.with_filter(level)).init();
}
