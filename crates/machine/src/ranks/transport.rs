//! What processes that run a program together say to each other.
//!
//! Input: words for others. Output: the words of others. All calls but [`Transport::post`] and
//! [`Transport::take`] are made by every rank, in the same order, and return when every rank that
//! matters has made its own. A rank that ends without its part takes the job down with it, so that
//! nothing here returns an error.

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

    /// To each rank its words, and from each rank those for this one, by rank.
    fn swap(&mut self, words: Vec<Vec<u32>>) -> Vec<Vec<u32>>;

    /// The bytes of every rank, by rank, on rank 0; nothing on the others.
    fn gather(&mut self, bytes: Vec<u8>) -> Vec<Vec<u8>>;

    /// Whether it is so on every rank.
    fn all(&mut self, here: bool) -> bool;

    /// Prepares rounds: by rank, whether words go to it, and the most words that come from it,
    /// where any do.
    fn prepare(&mut self, to: &[bool], most: &[Option<usize>]);

    /// Begins a round with these words for each rank, and returns immediately.
    fn post(&mut self, words: &mut [Vec<u32>]);

    /// Ends the round: adds the words of others, rank after rank.
    fn take(&mut self, words: &mut Vec<u32>);
}

/// The ranks of a job, as this process is one of them.
#[derive(Debug, Clone)]
pub struct Ranks {
    rank: u32,
    ranks: u32,
    transport: Arc<Mutex<dyn Transport>>,
}

impl Ranks {
    /// This process among others.
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

    /// The number that rank 0 proposes.
    pub fn agreed(&self, number: u64) -> u64 {
        let words = vec![vec![number as u32, (number >> 32) as u32]; self.ranks as usize];
        let heard = self.transport().swap(words);
        u64::from(heard[0][0]) | u64::from(heard[0][1]) << 32
    }

    /// On rank 0 what every other rank has found, by rank; nothing on the others. All write the
    /// same type.
    ///
    /// # Panics
    /// When they do not: a mistake of the caller.
    pub fn gathered<S: Serialize, T: DeserializeOwned>(&self, found: &S) -> Vec<T> {
        let written = |found| postcard::to_stdvec(found).expect("values without maps and unknown lengths");
        let own = if self.rank == 0 { Vec::new() } else { written(found) };
        let all = self.transport().gather(own);
        all.iter().skip(1).map(|bytes| postcard::from_bytes(bytes).expect("ranks write the same form")).collect()
    }

    /// What carries words.
    pub fn transport(&self) -> MutexGuard<'_, dyn Transport + 'static> {
        self.transport.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
