//! Ranks that are threads of one process, for tests: the exchange is as between processes.

use std::sync::mpsc::{Receiver, Sender, channel};

use super::transport::{Ranks, Transport};

/// A channel from and to each rank.
#[derive(Debug)]
struct Threads {
    rank: u32,
    senders: Vec<Sender<Vec<u32>>>,
    receivers: Vec<Receiver<Vec<u32>>>,
    to: Vec<bool>,
    from: Vec<bool>,
}

/// Returns `count` ranks, one for each thread.
pub fn ranks(count: u32) -> Vec<Ranks> {
    let mut senders: Vec<Vec<Sender<Vec<u32>>>> = (0..count).map(|_| Vec::new()).collect();
    let mut receivers: Vec<Vec<Receiver<Vec<u32>>>> = (0..count).map(|_| Vec::new()).collect();
    for from in &mut senders {
        for to in &mut receivers {
            let (sender, receiver) = channel();
            from.push(sender);
            to.push(receiver);
        }
    }
    let ends = (0..count).zip(senders.into_iter().zip(receivers));
    ends.map(|(rank, (senders, receivers))| {
        Ranks::new(Threads { rank, senders, receivers, to: Vec::new(), from: Vec::new() })
    })
    .collect()
}

impl Threads {
    fn send(&self, to: usize, words: Vec<u32>) {
        // A rank that has ended receives no more words.
        let _ = self.senders[to].send(words);
    }

    /// # Panics
    /// When the other rank has ended without sending; its own panic has the reason.
    fn receive(&self, from: usize) -> Vec<u32> {
        self.receivers[from].recv().unwrap_or_else(|_| panic!("rank {from} has ended"))
    }
}

impl Transport for Threads {
    fn rank(&self) -> u32 {
        self.rank
    }

    fn ranks(&self) -> u32 {
        self.senders.len() as u32
    }

    fn swap(&mut self, words: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
        words.into_iter().enumerate().for_each(|(to, words)| self.send(to, words));
        (0..self.receivers.len()).map(|from| self.receive(from)).collect()
    }

    fn gather(&mut self, bytes: Vec<u8>) -> Vec<Vec<u8>> {
        self.send(0, bytes.into_iter().map(u32::from).collect());
        let others = if self.rank == 0 { self.senders.len() } else { 0 };
        (0..others).map(|from| self.receive(from).into_iter().map(|byte| byte as u8).collect()).collect()
    }

    fn all(&mut self, here: bool) -> bool {
        (0..self.senders.len()).for_each(|to| self.send(to, vec![here.into()]));
        let received: Vec<Vec<u32>> = (0..self.senders.len()).map(|from| self.receive(from)).collect();
        received.iter().all(|words| *words == [1])
    }

    fn prepare(&mut self, to: &[bool], most: &[Option<usize>]) {
        self.to = to.to_vec();
        self.from = most.iter().map(Option::is_some).collect();
    }

    fn post(&mut self, words: &mut [Vec<u32>]) {
        for to in (0..words.len()).filter(|&to| self.to[to]) {
            self.send(to, words[to].clone());
        }
    }

    fn take(&mut self, words: &mut Vec<u32>) {
        for from in (0..self.from.len()).filter(|&from| self.from[from]) {
            words.extend(self.receive(from));
        }
    }
}
