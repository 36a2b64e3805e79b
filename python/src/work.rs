//! Work without the interpreter's lock, which Ctrl-C ends.
//!
//! Python's signal handlers run in the main thread alone. Long work therefore has a thread of its
//! own, while the calling thread checks for signals. After a signal the work ends with its current
//! sample. Short work stays in the calling thread: starting a thread would take longer.
//!
//! A forked process has none of its parent's threads, so work for them would never end: a child has
//! threads of its own.

use std::panic::resume_unwind;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicPtr, Ordering};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use nsim::session::samples::Progress;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::exception;

/// Interval of checks for signals.
const LOOK: Duration = Duration::from_millis(50);

/// Unwinds work that a signal ends.
struct Interrupted;

/// The process that loaded the module, whose threads are rayon's global ones.
static FIRST: OnceLock<u32> = OnceLock::new();
/// The threads of a forked process. The threads of its parent are never dropped, since they cannot
/// be joined.
static OWN: AtomicPtr<(u32, ThreadPool)> = AtomicPtr::new(std::ptr::null_mut());

/// Stores the id of this process, when the module is loaded.
pub fn loaded() {
    FIRST.get_or_init(std::process::id);
}

/// Runs a job on threads of this process. No lock is taken: a lock may have been held during the
/// fork.
pub fn on_own_threads<T: Send>(job: impl FnOnce() -> T + Send) -> T {
    let process = std::process::id();
    if FIRST.get() == Some(&process) {
        return job();
    }
    // SAFETY: the stored pointer came from `Box::into_raw` and is never freed.
    let known = unsafe { OWN.load(Ordering::Acquire).as_ref() };
    if let Some((_, pool)) = known.filter(|(owner, _)| *owner == process) {
        return pool.install(job);
    }
    match ThreadPoolBuilder::new().build() {
        Ok(pool) => {
            let made = Box::into_raw(Box::new((process, pool)));
            OWN.store(made, Ordering::Release);
            // SAFETY: as above.
            unsafe { &(*made).1 }.install(job)
        }
        // If the system refuses threads, the calling thread does all work.
        Err(_) => match ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() {
            Ok(pool) => pool.install(job),
            Err(_) => job(),
        },
    }
}

/// Runs short work of the library without the interpreter's lock.
pub fn run_detached<T: Send>(py: Python<'_>, job: impl FnOnce() -> T + Send) -> T {
    py.detach(|| on_own_threads(job))
}

/// Runs short work of the library that may fail.
pub fn try_detached<T: Send, E: Into<nsim::Error> + Send>(
    py: Python<'_>,
    job: impl FnOnce() -> Result<T, E> + Send,
) -> PyResult<T> {
    run_detached(py, job).map_err(|problem| exception(py, problem))
}

/// Runs work; `long` says whether it may take noticeable time.
pub fn work<T: Send>(
    py: Python<'_>,
    long: bool,
    job: impl FnOnce(Progress<'_>) -> Result<T, nsim::Error> + Send,
) -> PyResult<T> {
    if !long {
        return try_detached(py, || job(&|| ()));
    }
    let done = py.detach(|| watched(job))?;
    done.map_err(|error| exception(py, error))
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
        // The end of the worker, also by a panic, closes the channel.
        let (open, closed) = channel::<()>();
        let after_sample = &after_sample;
        let worker = scope.spawn(move || {
            let _open = open;
            on_own_threads(|| job(after_sample))
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
