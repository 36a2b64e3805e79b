//! The processes of a job that was started by `mpirun` or `srun`.
//!
//! Rank 0 prints and writes files, the others are silent. A rank that fails ends the job, with one
//! message: an error that all ranks find is rank 0's to say, so the others wait a moment before
//! they say theirs; that of another rank is said by it, and rank 0, which a signal then ends, is
//! notified. Without the feature `mpi` every process is alone.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
#[cfg(feature = "mpi")]
use std::time::{Duration, Instant};

use crate::cli::context::refuse_if;
use nsim_ir::program::Program;
use nsim_ir::ranks::Share;
use nsim_machine::ranks::transport::Ranks;
use nsim_session::error::Error;
use nsim_session::ranks::RankRow;

/// How much longer each rank than the one before it waits for another to say what is wrong.
#[cfg(feature = "mpi")]
const MOMENT: Duration = Duration::from_millis(250);
/// How long rank 0 listens for what another rank has to say, once it is ended: `mpirun` soon passes
/// on nothing more.
#[cfg(feature = "mpi")]
const HEARING: Duration = Duration::from_millis(10);
/// From this rank on all wait as long: a job ends within two seconds.
#[cfg(feature = "mpi")]
const LONGEST: u32 = 4;

/// The job that this process is one rank of, several or not.
static HERE: OnceLock<Ranks> = OnceLock::new();
/// Whether rank 0 needs the whole program.
static WHOLE: AtomicBool = AtomicBool::new(false);

/// Joins the job, if this process is of one.
pub fn start() {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = nsim_machine::ranks::mpi::start() {
        nsim_files::write::be_silent(ranks.rank() > 0);
        let _ = HERE.set(ranks);
    }
}

/// The processes of the job, where there are several.
pub fn several() -> Option<&'static Ranks> {
    HERE.get().filter(|ranks| ranks.ranks() > 1)
}

/// Refuses what runs in one process.
pub fn alone(what: &str) -> Result<(), Error> {
    let message = format!("{what} runs in one process: start it without mpirun or srun, or with one task");
    refuse_if(several().is_some(), message)
}

/// Lets rank 0 hold the whole program, which prices it.
pub fn price() {
    WHOLE.store(true, Ordering::SeqCst);
}

/// What of a program this process is to hold.
pub fn share() -> Share {
    several().map_or(Share::ALL, |ranks| {
        let whole = ranks.rank() == 0 && WHOLE.load(Ordering::SeqCst);
        Share { rank: ranks.rank(), ranks: ranks.ranks(), whole }
    })
}

/// What each process held in a run; also where one is all of a job.
pub fn rows(of_run: &[RankRow], program: Option<&Program>) -> Vec<RankRow> {
    match (HERE.get(), program) {
        (Some(_), Some(program)) if of_run.is_empty() => vec![RankRow::here(program, 0)],
        _ => of_run.to_vec(),
    }
}

/// Ends any process but the first, which has the result; it waits until the first has written it.
pub fn leave_to_first() {
    if several().is_some_and(|ranks| ranks.rank() > 0) {
        finish();
        std::process::exit(0);
    }
}

/// Leaves the job in peace, once every rank does.
pub fn finish() {
    #[cfg(feature = "mpi")]
    if HERE.get().is_some() {
        nsim_machine::ranks::mpi::finish();
    }
}

/// What comes before the message of a failure. What another rank has said already is not said
/// again.
pub fn before_failing() {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = several() {
        use nsim_machine::ranks::mpi::{another_has_failed, tell_failed};
        let until = Instant::now() + MOMENT * ranks.rank().min(LONGEST);
        while Instant::now() < until {
            if another_has_failed() {
                return;
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        tell_failed(ranks);
        nsim_files::write::be_silent(false);
    }
}

/// Whether a signal that ends this process has been said, or is said, by another.
pub fn is_said_elsewhere() -> bool {
    #[cfg(feature = "mpi")]
    if let Some(ranks) = several() {
        let until = Instant::now() + HEARING;
        while ranks.rank() == 0 && Instant::now() < until {
            if nsim_machine::ranks::mpi::another_has_failed() {
                return true;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        return ranks.rank() > 0;
    }
    false
}
