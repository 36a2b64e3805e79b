//! The threads of a command.

use nsim_session::error::Error;

/// Most threads: more cost time and memory without gain.
pub const MOST_THREADS: usize = 1024;

/// Starts `asked` threads, one for each core by default, and returns their number. If the system
/// refuses, it starts fewer, which changes no result.
pub fn start(asked: Option<usize>) -> Result<usize, Error> {
    let mut threads = match asked {
        Some(threads) if !(1..=MOST_THREADS).contains(&threads) => {
            return Err(Error::Usage(format!("--threads {threads} is outside 1 to {MOST_THREADS}")));
        }
        Some(threads) => threads,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    loop {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(threads);
        // A single thread is the current one.
        let builder = if threads == 1 { builder.use_current_thread() } else { builder };
        match builder.build_global() {
            Ok(()) => return Ok(threads),
            Err(error) if threads == 1 => return Err(Error::Fault(format!("threads cannot be started: {error}"))),
            Err(error) => {
                tracing::warn!("{threads} threads cannot be started ({error}); trying {}", threads / 2);
                threads /= 2;
            }
        }
    }
}
