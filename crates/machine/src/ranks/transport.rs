//! Messages between the processes that run a program together.
//!
//! Input: words for other ranks. Output: the words of other ranks. Every rank makes all calls but
//! [`Transport::post`] and [`Transport::take`], in one order. They return when all ranks involved
//! have made theirs. A rank that ends early ends the job, so no call returns an error.

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Carries words between ranks.
pub trait Transport: fmt::Debug + Send {
    /// The number of this rank.
    fn rank(&self) -> u32;

    /// Number of ranks.
    fn ranks(&self) -> u32;

    /// Sends each rank its words; returns the words of each rank for this one, by rank.
    fn swap(&mut self, words: Vec<Vec<u32>>) -> Vec<Vec<u32>>;

    /// Returns the bytes of every rank, by rank, on rank 0; nothing on the others.
    fn gather(&mut self, bytes: Vec<u8>) -> Vec<Vec<u8>>;

    /// Whether `here` is true on every rank.
    fn all(&mut self, here: bool) -> bool;

    /// Prepares rounds: by rank, whether it receives words from this one, and the maximum number of
    /// words that it sends, if it sends any.
    fn prepare(&mut self, to: &[bool], most: &[Option<usize>]);

    /// Begins a round with these words for each rank, and returns immediately.
    fn post(&mut self, words: &mut [Vec<u32>]);

    /// Ends the round: appends the words of the others, rank by rank.
    fn take(&mut self, words: &mut Vec<u32>);
}

/// The ranks of a job, from the view of this one.
#[derive(Debug, Clone)]
pub struct Ranks {
    rank: u32,
    ranks: u32,
    transport: Arc<Mutex<dyn Transport>>,
}

impl Ranks {
    /// This rank of a job, from its transport.
    pub fn new(transport: impl Transport + 'static) -> Self {
        Ranks { rank: transport.rank(), ranks: transport.ranks(), transport: Arc::new(Mutex::new(transport)) }
    }

    /// The number of this rank.
    pub fn rank(&self) -> u32 {
        self.rank
    }

    /// Number of ranks.
    pub fn ranks(&self) -> u32 {
        self.ranks
    }

    /// Returns the number of rank 0, on every rank.
    pub fn agreed(&self, number: u64) -> u64 {
        let words = vec![vec![number as u32, (number >> 32) as u32]; self.ranks as usize];
        let received = self.transport().swap(words);
        u64::from(received[0][0]) | u64::from(received[0][1]) << 32
    }

    /// Returns on rank 0 the value `found` of every other rank, by rank; nothing on the others. All
    /// ranks serialise one type.
    ///
    /// # Panics
    /// When the types differ: an error of the caller.
    pub fn gather<S: Serialize, T: DeserializeOwned>(&self, found: &S) -> Vec<T> {
        let written = |found| postcard::to_stdvec(found).expect("values without maps and unknown lengths");
        let own = if self.rank == 0 { Vec::new() } else { written(found) };
        let all = self.transport().gather(own);
        all.iter().skip(1).map(|bytes| postcard::from_bytes(bytes).expect("ranks write the same form")).collect()
    }

    /// The carrier of words.
    pub fn transport(&self) -> MutexGuard<'_, dyn Transport + 'static> {
        self.transport.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
