//! The warnings that a process has logged, which the shell's JSON repeats.
//!
//! Input: warnings of a reader, of the quantiser, of a run. Output: a line of the log for each, and
//! the list of all. One list feeds both, so that no warning is in the text alone.

use std::sync::{Mutex, MutexGuard, PoisonError};

use nsim_ir::base::warning::Warning;
use tracing::subscriber::NoSubscriber;

/// Logged warnings with their files, in order.
static SHOWN: Mutex<Vec<(String, Warning)>> = Mutex::new(Vec::new());

fn shown_so_far() -> MutexGuard<'static, Vec<(String, Warning)>> {
    SHOWN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Logs each warning once a process, after the name of the file that it is about, if any. Without a
/// log, as in Python, nothing happens.
pub fn show(file: &str, warnings: &[Warning]) {
    if tracing::dispatcher::get_default(tracing::Dispatch::is::<NoSubscriber>) {
        return;
    }
    let mut shown = shown_so_far();
    for warning in warnings {
        // The reader of a file has logged its warnings, which the results of its network have, too.
        if shown.iter().any(|(of, known)| known == warning && (file.is_empty() || of == file)) {
            continue;
        }
        match file {
            "" => tracing::warn!("{warning}"),
            _ => tracing::warn!("{file}: {warning}"),
        }
        shown.push((file.to_string(), warning.clone()));
    }
}

/// All logged warnings, each once.
pub fn shown() -> Vec<Warning> {
    let mut all: Vec<Warning> = Vec::new();
    for (_, warning) in shown_so_far().iter() {
        if !all.contains(warning) {
            all.push(warning.clone());
        }
    }
    all
}
