//! The threads of a command.

use nsim_session::error::Error;

/// The most threads that are started: more cost time and memory and gain nothing.
pub const MOST_THREADS: usize = 1024;

/// Starts the threads that `--threads` asks for, one for each core without it. Where the system
/// allows fewer, those that it allows: their number changes no result. Returns how many there are.
pub fn start(asked: Option<usize>) -> Result<usize, Error> {
    let mut threads = match asked {
        Some(threads) if !(1..=MOST_THREADS).contains(&threads) => {
            return Err(Error::Usage(format!("--threads {threads}: 1 to {MOST_THREADS} threads can be asked for")));
        }
        Some(threads) => threads,
        None => std::thread::available_parallelism().map_or(1, usize::from),
    };
    loop {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(threads);
        // One thread is this one.
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
