//! Ranks of an MPI job. All calls into MPI are in this file.
//!
//! Input: the environment that `mpirun` or `srun` sets. Output: [`Ranks`]. Rounds are nonblocking:
//! receives begin before sends, so that words arrive in their buffers directly, and one wait ends
//! both. Errors of MPI end the job, as is its default; so does a rank that ends without [`finish`].
//!
//! Why MPI's own calls: a round begins in one call and ends in another. Requests of the crate that
//! binds MPI cannot outlive the call in which they begin.

use std::ffi::{c_int, c_void};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use mpi::environment::Universe;
use mpi::ffi;
use mpi::{Threading, initialize_with_threading};

use super::transport::{Ranks, Transport};

/// Environment variables of which a launcher sets one.
const LAUNCHED: [&str; 4] = ["OMPI_COMM_WORLD_SIZE", "PMIX_RANK", "PMI_RANK", "PMI_SIZE"];
/// Tags of the message of a round, and of the message of a rank that failed and printed why.
const ROUND: c_int = 1;
const FAILED: c_int = 2;
/// Time limit of sending the message of a failure.
const SENDING: Duration = Duration::from_millis(100);

/// The job, stored until its end: dropping it waits for all other ranks.
static JOB: Mutex<Option<Universe>> = Mutex::new(None);

/// Joins the job that this process was started for; `None` where it was started alone.
pub fn start() -> Option<Ranks> {
    if LAUNCHED.iter().all(|name| std::env::var_os(name).is_none()) {
        return None;
    }
    // Signals are handled by a separate thread.
    let (universe, _) = initialize_with_threading(Threading::Multiple)?;
    JOB.lock().ok()?.replace(universe);
    let (mut rank, mut size) = (0, 0);
    #[expect(unsafe_code, reason = "MPI is a C library; the numbers are written to live integers")]
    unsafe {
        ffi::MPI_Comm_rank(ffi::RSMPI_COMM_WORLD, &raw mut rank);
        ffi::MPI_Comm_size(ffi::RSMPI_COMM_WORLD, &raw mut size);
    }
    Some(Ranks::new(Mpi {
        rank: rank as u32,
        sends: vec![Vec::new(); size as usize],
        receives: vec![Vec::new(); size as usize],
        to: Vec::new(),
        from: Vec::new(),
        requests: Vec::new(),
    }))
}

/// Leaves the job, which waits until every rank does. Without it, the end of this process ends the
/// job.
pub fn finish() {
    let job = JOB.lock().ok().and_then(|mut job| job.take());
    drop(job);
}

/// Informs the other ranks that this one has failed and prints why, so that they print nothing when
/// they are ended for it.
pub fn report_failure(ranks: &Ranks) {
    let mut requests = Vec::new();
    for to in (0..ranks.ranks()).filter(|&to| to != ranks.rank()) {
        #[expect(unsafe_code, reason = "MPI is a C library; no bytes are sent")]
        unsafe {
            let (nothing, mut request) = (std::ptr::null(), ffi::RSMPI_REQUEST_NULL);
            let (byte, world) = (ffi::RSMPI_UINT8_T, ffi::RSMPI_COMM_WORLD);
            ffi::MPI_Isend(nothing, 0, byte, to as c_int, FAILED, world, &raw mut request);
            requests.push(request);
        }
    }
    // A message leaves only during calls of MPI; ranks that do not answer are not waited for.
    let begin = Instant::now();
    let mut sent = 0;
    while sent == 0 && begin.elapsed() < SENDING {
        #[expect(unsafe_code, reason = "MPI is a C library; the answer is written to a live integer")]
        unsafe {
            let (count, statuses) = (length(requests.len()), ffi::RSMPI_STATUSES_IGNORE);
            ffi::MPI_Testall(count, requests.as_mut_ptr(), &raw mut sent, statuses);
        }
    }
}

/// Whether another rank has reported that it failed.
pub fn another_rank_failed() -> bool {
    let mut found = 0;
    #[expect(unsafe_code, reason = "MPI is a C library; the answer is written to a live integer")]
    unsafe {
        let status = ffi::RSMPI_STATUS_IGNORE;
        ffi::MPI_Iprobe(ffi::RSMPI_ANY_SOURCE, FAILED, ffi::RSMPI_COMM_WORLD, &raw mut found, status);
    }
    found != 0
}

/// This rank.
#[derive(Debug)]
struct Mpi {
    rank: u32,
    /// Words in transit to each rank; not touched while there are requests.
    sends: Vec<Vec<u32>>,
    /// Buffer for the words from each rank.
    receives: Vec<Vec<u32>>,
    to: Vec<usize>,
    from: Vec<usize>,
    /// Requests of a round that has begun: receives, then sends.
    requests: Vec<ffi::MPI_Request>,
}

#[expect(unsafe_code, reason = "a request is a handle that any thread may use: the job asks for threads at any time")]
unsafe impl Send for Mpi {}

/// A length in the type of MPI.
///
/// # Panics
/// When it is 2^31 words or more, which no rank sends.
fn length(words: usize) -> c_int {
    c_int::try_from(words).expect("a message of 2^31 words")
}

/// Beginning of each part in their concatenation, and the length of all.
fn starts(lengths: &[c_int]) -> (Vec<c_int>, usize) {
    let mut sum = 0usize;
    let starts = lengths.iter().map(|&part| {
        sum += part as usize;
        length(sum) - part
    });
    (starts.collect(), sum)
}

/// A list cut into parts of these lengths.
fn parts<T: Clone>(words: &[T], lengths: &[c_int]) -> Vec<Vec<T>> {
    let mut rest = words;
    let part = |&length: &c_int| {
        let (part, others) = rest.split_at(length as usize);
        rest = others;
        part.to_vec()
    };
    lengths.iter().map(part).collect()
}

impl Transport for Mpi {
    fn rank(&self) -> u32 {
        self.rank
    }

    fn ranks(&self) -> u32 {
        self.sends.len() as u32
    }

    fn swap(&mut self, words: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
        let to: Vec<c_int> = words.iter().map(|words| length(words.len())).collect();
        let mut from: Vec<c_int> = vec![0; to.len()];
        #[expect(unsafe_code, reason = "MPI is a C library; both lists have a number for each rank")]
        unsafe {
            let (int, world) = (ffi::RSMPI_INT32_T, ffi::RSMPI_COMM_WORLD);
            ffi::MPI_Alltoall(to.as_ptr().cast(), 1, int, from.as_mut_ptr().cast(), 1, int, world);
        }
        let ((to_starts, _), (from_starts, all)) = (starts(&to), starts(&from));
        let sent: Vec<u32> = words.concat();
        let mut received = vec![0u32; all];
        #[expect(unsafe_code, reason = "MPI is a C library; the lists are as long as the lengths say, on all ranks")]
        unsafe {
            let (word, world) = (ffi::RSMPI_UINT32_T, ffi::RSMPI_COMM_WORLD);
            let (sent, received) = (sent.as_ptr().cast::<c_void>(), received.as_mut_ptr().cast::<c_void>());
            let (to_starts, from_starts) = (to_starts.as_ptr(), from_starts.as_ptr());
            ffi::MPI_Alltoallv(sent, to.as_ptr(), to_starts, word, received, from.as_ptr(), from_starts, word, world);
        }
        parts(&received, &from)
    }

    fn gather(&mut self, bytes: Vec<u8>) -> Vec<Vec<u8>> {
        let own = length(bytes.len());
        let all = if self.rank == 0 { self.sends.len() } else { 0 };
        let mut lengths: Vec<c_int> = vec![0; all];
        #[expect(unsafe_code, reason = "MPI is a C library; rank 0 has room for a number of each rank")]
        unsafe {
            let (int, world) = (ffi::RSMPI_INT32_T, ffi::RSMPI_COMM_WORLD);
            ffi::MPI_Gather((&raw const own).cast(), 1, int, lengths.as_mut_ptr().cast(), 1, int, 0, world);
        }
        let (from, sum) = starts(&lengths);
        let mut received = vec![0u8; sum];
        #[expect(unsafe_code, reason = "MPI is a C library; rank 0 has room for what each rank has said that it sends")]
        unsafe {
            let (byte, world) = (ffi::RSMPI_UINT8_T, ffi::RSMPI_COMM_WORLD);
            let (sent, received) = (bytes.as_ptr().cast::<c_void>(), received.as_mut_ptr().cast::<c_void>());
            ffi::MPI_Gatherv(sent, own, byte, received, lengths.as_ptr(), from.as_ptr(), byte, 0, world);
        }
        parts(&received, &lengths)
    }

    fn all(&mut self, here: bool) -> bool {
        let (here, mut all) = (c_int::from(here), 0);
        #[expect(unsafe_code, reason = "MPI is a C library; the answer is written to a live integer")]
        unsafe {
            let (from, to) = ((&raw const here).cast::<c_void>(), (&raw mut all).cast::<c_void>());
            ffi::MPI_Allreduce(from, to, 1, ffi::RSMPI_INT32_T, ffi::RSMPI_LAND, ffi::RSMPI_COMM_WORLD);
        }
        all != 0
    }

    fn prepare(&mut self, to: &[bool], most: &[Option<usize>]) {
        assert!(self.requests.is_empty(), "a round has not ended");
        self.to = (0..to.len()).filter(|&rank| to[rank]).collect();
        self.from = (0..most.len()).filter(|&rank| most[rank].is_some()).collect();
        for (room, most) in self.receives.iter_mut().zip(most) {
            *room = vec![0; most.unwrap_or(0)];
        }
    }

    fn post(&mut self, words: &mut [Vec<u32>]) {
        assert!(self.requests.is_empty(), "a round has not ended");
        for &from in &self.from {
            let room = &mut self.receives[from];
            let (place, most) = (room.as_mut_ptr().cast::<c_void>(), length(room.len()));
            #[expect(unsafe_code, reason = "MPI is a C library; the room is not touched until the wait")]
            unsafe {
                let mut request = ffi::RSMPI_REQUEST_NULL;
                let world = ffi::RSMPI_COMM_WORLD;
                ffi::MPI_Irecv(place, most, ffi::RSMPI_UINT32_T, from as c_int, ROUND, world, &raw mut request);
                self.requests.push(request);
            }
        }
        for &to in &self.to {
            std::mem::swap(&mut self.sends[to], &mut words[to]);
            let (place, count) = (self.sends[to].as_ptr().cast::<c_void>(), length(self.sends[to].len()));
            #[expect(unsafe_code, reason = "MPI is a C library; the words are not touched until the wait")]
            unsafe {
                let mut request = ffi::RSMPI_REQUEST_NULL;
                let world = ffi::RSMPI_COMM_WORLD;
                ffi::MPI_Isend(place, count, ffi::RSMPI_UINT32_T, to as c_int, ROUND, world, &raw mut request);
                self.requests.push(request);
            }
        }
    }

    fn take(&mut self, words: &mut Vec<u32>) {
        let mut statuses: Vec<ffi::MPI_Status> = Vec::with_capacity(self.requests.len());
        let mut counts = vec![0; self.from.len()];
        #[expect(unsafe_code, reason = "MPI is a C library; the wait writes a status for each request")]
        unsafe {
            ffi::MPI_Waitall(length(self.requests.len()), self.requests.as_mut_ptr(), statuses.as_mut_ptr());
            statuses.set_len(self.requests.len());
            for (count, status) in counts.iter_mut().zip(&statuses) {
                ffi::MPI_Get_count(status, ffi::RSMPI_UINT32_T, count);
            }
        }
        self.requests.clear();
        for (&from, &count) in self.from.iter().zip(&counts) {
            words.extend_from_slice(&self.receives[from][..count as usize]);
        }
    }
}

impl Drop for Mpi {
    fn drop(&mut self) {
        if !self.requests.is_empty() {
            // MPI may still write to these buffers.
            std::mem::take(&mut self.sends).into_iter().for_each(std::mem::forget);
            std::mem::take(&mut self.receives).into_iter().for_each(std::mem::forget);
        }
    }
}
