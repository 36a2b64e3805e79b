//! A panic becomes an error: a fault of nsim, with the place in its source.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Mutex;

use crate::cli::diagnostics;
use nsim_session::error::Error;

/// Message and place of the first panic.
static FIRST: Mutex<Option<String>> = Mutex::new(None);

/// Does some work; a panic in it, or in a thread that it waits for, is returned as
/// [`Error::Fault`].
pub fn guarded<T>(work: impl FnOnce() -> Result<T, Error>) -> Result<T, Error> {
    std::panic::set_hook(Box::new(|panic| {
        let payload = panic.payload();
        let message =
            payload.downcast_ref::<&str>().copied().or_else(|| payload.downcast_ref::<String>().map(String::as_str));
        let message = message.unwrap_or("a panic without a message");
        let place = panic.location().map_or(String::new(), |at| format!(" ({}:{})", at.file(), at.line()));
        if let Ok(mut first) = FIRST.lock() {
            // Other threads that stop with the first would hide its trace.
            if first.is_some() {
                return;
            }
            *first = Some(format!("{message}{place}"));
        }
        let trace = std::backtrace::Backtrace::capture();
        if trace.status() == std::backtrace::BacktraceStatus::Captured {
            diagnostics::write_stderr(&format!("{trace}\n"));
        }
    }));
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
        let first = FIRST.lock().ok().and_then(|mut first| first.take());
        Err(Error::Fault(first.unwrap_or_else(|| "a panic".to_string())))
    })
}

#[cfg(test)]
mod tests {
    use crate::cli::process::panics::*;

    #[test]
    fn a_panic_is_a_fault_with_its_place() {
        let error = guarded(|| -> Result<(), Error> { panic!("a panic") }).unwrap_err();
        assert_eq!(error.exit_status(), 4);
        assert!(error.to_string().contains("a panic (src/cli/process/panics.rs:"), "{error}");
    }
}
