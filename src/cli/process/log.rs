//! Messages on stderr. That nobody can read them is no reason to lose a result: failed writes are
//! ignored.

use std::io::Write;

use crate::cli::diagnostics;

/// Stderr, whose errors are ignored.
struct Unheard;

impl Write for Unheard {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        if !nsim_files::write::is_silent() {
            let _ = std::io::stderr().lock().write_all(bytes);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

/// Starts the log at the level that `--verbose` and `--quiet` ask for; by default with a line for
/// each recording where `recordings` asks for them.
pub fn start(verbose: u8, quiet: bool, recordings: bool) {
    let level = match (quiet, verbose) {
        (true, _) => "error",
        (false, 0) if recordings => "warn,recording=info",
        (false, 0) => "warn",
        (false, 1) => "info",
        (false, _) => "debug",
    };
    tracing_subscriber::fmt()
        .with_env_filter(tracing_subscriber::EnvFilter::new(level))
        .with_writer(|| Unheard)
        .with_ansi(diagnostics::colour())
        .log_internal_errors(false)
        .without_time()
        .with_target(false)
        .init();
}
