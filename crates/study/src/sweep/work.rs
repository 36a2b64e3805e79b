//! Runs many variants on several threads, the largest first.
//!
//! Input: a sweep, and the numbers of the variants to run. Output: their cells, passed on one by
//! one as they are finished, in any order. Each variant has one thread. After the first error no
//! variant starts, and the running ones are finished.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crate::sweep::cache::lock;
use crate::sweep::row::{Cells, Runner};
use crate::sweep::variants::Sweep;
use nsim_session::error::Error;

/// Stack of a thread, bytes: mapping recurses as on the main thread.
const STACK: usize = 16 << 20;

/// Runs these variants; `take` is called by one thread at a time.
///
/// # Errors
/// The first error of a variant or of `take`.
pub fn run(
    sweep: &Sweep,
    mut numbers: Vec<u64>,
    threads: usize,
    take: impl FnMut(u64, Cells) -> Result<(), Error> + Send,
) -> Result<(), Error> {
    let runner = Runner::default();
    if sweep.has_sizes() {
        let sized = |number: u64| Ok((runner.size(&sweep.job(number)?), number));
        let mut sizes = numbers.into_iter().map(sized).collect::<Result<Vec<(u64, u64)>, Error>>()?;
        sizes.sort_by_key(|&(size, _)| std::cmp::Reverse(size));
        numbers = sizes.into_iter().map(|(_, number)| number).collect();
    }
    let (next, ended) = (AtomicUsize::new(0), AtomicBool::new(false));
    let (take, first_error) = (Mutex::new(take), Mutex::new(None));
    let mut first_panic = None;
    let work = || {
        while !ended.load(Ordering::Relaxed) {
            let Some(&number) = numbers.get(next.fetch_add(1, Ordering::Relaxed)) else { return };
            let done = sweep.job(number).map_err(Error::from).and_then(|job| runner.row(&job));
            if let Err(error) = done.and_then(|cells| lock(&take)(number, cells)) {
                ended.store(true, Ordering::Relaxed);
                lock(&first_error).get_or_insert(error);
            }
        }
    };
    let alone = || {
        // Parallel work of a variant stays on its thread.
        match rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build() {
            Ok(pool) => pool.install(work),
            Err(_) => work(),
        }
    };
    std::thread::scope(|scope| {
        let start = |_| std::thread::Builder::new().stack_size(STACK).spawn_scoped(scope, alone);
        // Where the system refuses a thread, the started ones do the work.
        let started = (0..threads.clamp(1, numbers.len().max(1))).map(start).map_while(Result::ok);
        for thread in started.collect::<Vec<_>>() {
            if let Err(panic) = thread.join() {
                ended.store(true, Ordering::Relaxed);
                first_panic.get_or_insert(panic);
            }
        }
    });
    // The payload of a thread, such as that of an interruption.
    if let Some(panic) = first_panic {
        std::panic::resume_unwind(panic);
    }
    let left = next.load(Ordering::Relaxed) < numbers.len();
    if left && !ended.load(Ordering::Relaxed) {
        return Err(Error::Fault("threads cannot be started".to_string()));
    }
    lock(&first_error).take().map_or(Ok(()), Err)
}
