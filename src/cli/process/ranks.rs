//! The processes of a job that was started by `mpirun` or `srun`.
//!
//! Rank 0 prints and writes files, the others are silent. A rank that fails ends the job, with one
//! message. Rank 0 reports an error of all ranks, so the others wait a moment before they report
//! it. Another rank reports its own error and notifies rank 0, which a signal then ends. Without
//! the feature `mpi` every process is alone.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(feature = "mpi")]
use std::time::{Duration, Instant};

use crate::cli::context::refuse_if;
use nsim_ir::program::Program;
use nsim_ir::ranks::RankShare;
use nsim_machine::ranks::transport::Ranks;
use nsim_session::error::Error;
use nsim_session::ranks::RankRow;

/// Wait of a failed rank, per rank number, for the message of another rank.
#[cfg(feature = "mpi")]
const WAIT_PER_RANK: Duration = Duration::from_millis(250);
/// Wait of rank 0, after a signal, for the notice of another rank: `mpirun` soon forwards no more
/// output.
#[cfg(feature = "mpi")]
const SIGNAL_WAIT: Duration = Duration::from_millis(10);
/// From this rank on the wait is constant: a job ends within two seconds.
#[cfg(feature = "mpi")]
const MOST_WAITS: u32 = 4;

/// Job of this process, with one rank or several.
static JOB: OnceLock<Ranks> = OnceLock::new();
/// Whether rank 0 needs the whole program.
static KEEP_WHOLE: AtomicBool = AtomicBool::new(false);

/// Joins the job, if this process belongs to one.
pub fn start() {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = nsim_machine::ranks::mpi::start() {
        nsim_files::write::be_silent(ranks.rank() > 0);
        let _ = JOB.set(ranks);
    }
}

/// The processes of the job, where there are several.
pub fn several() -> Option<&'static Ranks> {
    JOB.get().filter(|ranks| ranks.ranks() > 1)
}

/// Returns a usage error if several processes run `what`.
pub fn refuse_several(what: &str) -> Result<(), Error> {
    let message = format!("{what} runs in one process: start it without mpirun or srun, or with one task");
    refuse_if(several().is_some(), message)
}

/// Makes rank 0 keep the whole program, which it prices.
pub fn price() {
    KEEP_WHOLE.store(true, Ordering::SeqCst);
}

/// Share of a program for this process.
pub fn share() -> RankShare {
    several().map_or(RankShare::ALL, |ranks| {
        let whole = ranks.rank() == 0 && KEEP_WHOLE.load(Ordering::SeqCst);
        RankShare { rank: ranks.rank(), ranks: ranks.ranks(), whole }
    })
}

/// Rows of the processes of a run, also for a job of one process.
pub fn rows(of_run: &[RankRow], program: Option<&Program>) -> Vec<RankRow> {
    match (JOB.get(), program) {
        (Some(_), Some(program)) if of_run.is_empty() => vec![RankRow::for_this_process(program, 0)],
        _ => of_run.to_vec(),
    }
}

/// Ends any process but the first, which has the result, once the first has written it.
pub fn leave_to_first() {
    if several().is_some_and(|ranks| ranks.rank() > 0) {
        finish();
        std::process::exit(0);
    }
}

/// Leaves the job without an error, once every rank does.
pub fn finish() {
    #[cfg(feature = "mpi")]
    if JOB.get().is_some() {
        nsim_machine::ranks::mpi::finish();
    }
}

/// Waits before the message of a failure. If another rank reports first, this rank stays silent;
/// else it notifies the others and may print.
pub fn before_failing() {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = several() {
        use nsim_machine::ranks::mpi::{another_rank_failed, report_failure};
        let until = Instant::now() + WAIT_PER_RANK * ranks.rank().min(MOST_WAITS);
        while Instant::now() < until {
            if another_rank_failed() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        report_failure(ranks);
        nsim_files::write::be_silent(false);
    }
}

/// Whether another rank reports the signal that ends this process.
pub fn is_reported_elsewhere() -> bool {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = several() {
        let until = Instant::now() + SIGNAL_WAIT;
        while ranks.rank() == 0 && Instant::now() < until {
            if nsim_machine::ranks::mpi::another_rank_failed() {
                return true;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        return ranks.rank() > 0;
    }
    false
}
