//! Work without the interpreter's lock, which Ctrl-C ends.
//!
//! Python's signal handlers run in the main thread alone. Long work therefore has a thread of its own, while the calling thread looks for
//! signals; after one, the work ends with the sample that it is at. Short work stays in the calling thread: starting another would take
//! longer than the work.

use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use nsim::drive::samples::Progress;
use pyo3::prelude::*;

use crate::error::raised;

/// How often signals are looked for.
const LOOK: Duration = Duration::from_millis(50);

/// Unwinds work that a signal ends.
struct Interrupted;

/// Does the work; `long` says whether it may take more than the blink of an eye.
pub fn work<T: Send>(
    py: Python<'_>,
    long: bool,
    job: impl FnOnce(Progress<'_>) -> Result<T, nsim::Error> + Send,
) -> PyResult<T> {
    if !long {
        return py.detach(|| job(&|| ())).map_err(|error| raised(py, error));
    }
    let done = py.detach(|| watched(job))?;
    done.map_err(|error| raised(py, error))
}

fn watched<T: Send>(
    job: impl FnOnce(Progress<'_>) -> Result<T, nsim::Error> + Send,
) -> PyResult<Result<T, nsim::Error>> {
    let stop = AtomicBool::new(false);
    let after_sample = || {
        if stop.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Interrupted));
        }
    };
    std::thread::scope(|scope| {
        // Whatever ends the worker closes the channel.
        let (open, closed) = channel::<()>();
        let after_sample = &after_sample;
        let worker = scope.spawn(move || {
            let _open = open;
            job(after_sample)
        });
        let mut signal = None;
        while let Err(RecvTimeoutError::Timeout) = closed.recv_timeout(LOOK) {
            if let Err(error) = Python::attach(|py| py.check_signals()) {
                stop.store(true, Ordering::Relaxed);
                signal = Some(error);
            }
        }
        match (worker.join(), signal) {
            (_, Some(signal)) => Err(signal),
            (Ok(result), None) => Ok(result),
            (Err(panic), None) => resume_unwind(panic),
        }
    })
}
