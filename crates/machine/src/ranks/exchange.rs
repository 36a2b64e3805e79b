//! The exchange of spikes between the ranks that run the parts of a program.
//!
//! Input: this rank's part of the program, and the spikes of its compartments, step by step.
//! Output: the spikes of other ranks for which this rank has axons. Before the first step each rank
//! sends the others the numbers of their compartments for which it has axons. Then each step sends
//! each neighbour one message: the numbers of its wanted compartments that spiked. It is sent in
//! every step, empty or not: its arrival is the barrier. Where neurons compute the values of
//! messages, each number is followed by its value. Otherwise the source determines the payload.

use crate::ranks::transport::Ranks;
use nsim_ir::activity::StepActivity;
use nsim_ir::base::id::CompartmentId;
use nsim_ir::program::Program;
use nsim_ir::spikes::Message;

/// This rank's compartments whose spikes another rank receives.
#[derive(Debug, Clone)]
enum Wanted {
    None,
    All,
    /// One bit for each compartment.
    Some(Vec<u64>),
}

/// The exchange of one rank.
#[derive(Debug, Clone)]
pub(crate) struct Exchange {
    ranks: Ranks,
    /// By receiving rank.
    wanted: Vec<Wanted>,
    /// Whether each number is followed by the value of the spike.
    values: bool,
    /// Words for each rank, reused.
    posted: Vec<Vec<u32>>,
    /// Words of others, reused.
    taken: Vec<u32>,
    /// Whether a round has begun and not ended.
    pending: bool,
    /// The output population, if its spikes are reported to every rank.
    pub observed: Option<(CompartmentId, u32)>,
    /// Whether rounds end in the step in which they begin, because the results of each step are
    /// read.
    pub immediately: bool,
}

/// A hash that distinguishes mappings.
fn checksum(program: &Program) -> u64 {
    let mut sum = 0xcbf2_9ce4_8422_2325u64;
    let mut add = |word: u64| sum = (sum ^ word).wrapping_mul(0x0000_0100_0000_01b3).rotate_left(17);
    for seat in program.seats() {
        add(u64::from(seat.core.0) << 16 | u64::from(seat.slot));
    }
    for image in program.cores() {
        add(u64::from(image.site.chip));
        add(u64::from(image.site.x) << 40 | u64::from(image.site.y) << 8 | u64::from(image.site.core));
    }
    if let Some(assignment) = &program.parts().assignment {
        assignment.owners.iter().for_each(|&owner| add(owner.into()));
    }
    sum
}

impl Exchange {
    /// Exchanges with the other ranks the compartments whose spikes each of them wants.
    ///
    /// # Panics
    /// When the program is no part, or the ranks have made different mappings: errors of the caller
    /// and of the compiler.
    pub fn new(program: &Program, ranks: &Ranks, observed: Option<(CompartmentId, u32)>, immediately: bool) -> Self {
        let assignment = program.parts().assignment.as_ref().expect("a program of several ranks is distributed");
        assert_eq!(
            (assignment.held, assignment.ranks),
            (Some(ranks.rank()), ranks.ranks()),
            "the part of another rank"
        );
        let count = ranks.ranks() as usize;
        let sum = checksum(program);
        let mut requested: Vec<Vec<u32>> = vec![vec![sum as u32, (sum >> 32) as u32]; count];
        let mut own = 0;
        // Rewards act without axons.
        let projections = program.parts().learning.projections.iter();
        let rewards: Vec<_> = projections.filter_map(|projection| projection.reward.clone()).collect();
        for (id, seat) in program.seats().enumerate() {
            let owner = assignment.owners[seat.core];
            let is_observed = observed.is_some_and(|(first, size)| id.0.wrapping_sub(first.0) < size);
            if owner == ranks.rank() {
                own += 1;
            } else if is_observed
                || program.messages(program.channels() + id.0).len() > 0
                || rewards.iter().any(|reward| reward.contains(&(program.channels() + id.0)))
            {
                requested[owner as usize].push(id.0);
            }
        }
        let values = program.parts().graded.iter().any(|graded| matches!(graded.message, Message::Value(_)));
        let each = 1 + usize::from(values);
        let most = requested.iter().map(|ids| Some(each * (ids.len() - 2)).filter(|&most| most > 0));
        let most: Vec<Option<usize>> = most.collect();
        let mut transport = ranks.transport();
        let received = transport.swap(requested.clone());
        let wanted = received.into_iter().enumerate().map(|(rank, ids)| {
            assert_eq!(ids.get(..2), Some(&requested[rank][..2]), "rank {rank} has made another mapping");
            match ids.len() - 2 {
                0 => Wanted::None,
                all if all == own => Wanted::All,
                _ => {
                    let mut bits = vec![0; program.seats().len().div_ceil(64)];
                    ids[2..].iter().for_each(|&id| bits[id as usize / 64] |= 1 << (id % 64));
                    Wanted::Some(bits)
                }
            }
        });
        let wanted: Vec<Wanted> = wanted.collect();
        let to: Vec<bool> = wanted.iter().map(|wanted| !matches!(wanted, Wanted::None)).collect();
        transport.prepare(&to, &most);
        drop(transport);
        let posted = vec![Vec::new(); count];
        Exchange {
            ranks: ranks.clone(),
            wanted,
            values,
            posted,
            taken: Vec::new(),
            pending: false,
            observed,
            immediately,
        }
    }

    /// Sends this rank's spikes of a step, with their values where neurons compute these.
    pub fn post(&mut self, spikes: &[CompartmentId], payloads: &[i32]) {
        for (wanted, words) in self.wanted.iter().zip(&mut self.posted) {
            words.clear();
            let is_wanted = |id: u32| match wanted {
                Wanted::None => false,
                Wanted::All => true,
                Wanted::Some(bits) => bits[id as usize / 64] >> (id % 64) & 1 == 1,
            };
            if self.values {
                let pairs = spikes.iter().zip(payloads).filter(|(spike, _)| is_wanted(spike.0));
                words.extend(pairs.flat_map(|(spike, &payload)| [spike.0, payload as u32]));
            } else {
                words.extend(spikes.iter().map(|spike| spike.0).filter(|&id| is_wanted(id)));
            }
        }
        self.ranks.transport().post(&mut self.posted);
        self.pending = true;
    }

    /// Takes the other ranks' spikes of the last posted step, with their values where neurons
    /// compute these; false where they have been taken already.
    pub fn take(&mut self, spikes: &mut Vec<CompartmentId>, payloads: &mut Vec<i32>) -> bool {
        if !std::mem::take(&mut self.pending) {
            return false;
        }
        self.taken.clear();
        self.ranks.transport().take(&mut self.taken);
        spikes.clear();
        payloads.clear();
        match self.values {
            true => self.taken.as_chunks().0.iter().for_each(|&[id, payload]| {
                spikes.push(CompartmentId(id));
                payloads.push(payload as i32);
            }),
            false => spikes.extend(self.taken.iter().map(|&id| CompartmentId(id))),
        }
        true
    }

    /// Whether `here` is true on every rank.
    pub fn all(&self, here: bool) -> bool {
        self.ranks.transport().all(here)
    }

    /// Adds the other ranks' activity of the step, on rank 0.
    pub fn merge(&self, step: &mut StepActivity) {
        for other in self.ranks.gather::<_, StepActivity>(step) {
            step.merge(&other);
            step.fired.extend(other.fired);
        }
    }
}
