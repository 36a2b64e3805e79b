//! A step on many ranks, from what it takes on one and what its messages take.
//!
//! Input: the costs of a rank (measured), a network between ranks (given), a job. Output: time of a
//! step by part, and memory. With N compartments that fire at a rate f and have F synapses each, on
//! R ranks, of which a share L of the synapses stays on the rank:
//!
//! ```text
//! compute  = c N / R                         c: time of a compartment and its events on one rank
//! reached  = (R - 1) (1 - (1 - 1 / (R - 1))^(F (1 - L)))       other ranks that a spike goes to, targets drawn evenly
//! words    = f N / R * reached               sent by a rank in a step, and received
//! messages = neighbours of the rank, at most R - 1
//! exchange = latency + messages * overhead + 4 bytes * words / bandwidth + words * per id
//! memory   = a N + b N F / R                 a: what every rank holds of each compartment, b: a synapse
//! ```
//!
//! A message is sent to each neighbour in each step, empty or not. Nothing is assumed to overlap,
//! so steps are no shorter than said; nothing is assumed to wait, so they may be longer: a rank
//! that is late holds its neighbours up.

/// What ranks and the network between them cost.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Costs {
    /// Time of a compartment and its events in a step, on one rank.
    pub compartment_ns: f64,
    /// Time to write, sort out and read an id.
    pub id_ns: f64,
    /// Time from rank to rank.
    pub latency_us: f64,
    /// Time that a rank spends on each message.
    pub overhead_us: f64,
    /// Bytes that a rank sends or receives, in gigabytes a second.
    pub bandwidth_gb_s: f64,
    /// What every rank holds of each compartment of the network.
    pub replicated_bytes: f64,
    /// What the rank of a synapse holds of it.
    pub synapse_bytes: f64,
}

/// A network to be run.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ScaleJob {
    /// Compartments.
    pub compartments: f64,
    /// Synapses of each.
    pub fan_out: f64,
    /// Spikes of a compartment in a step.
    pub rate: f64,
    /// The share of synapses that stay on the rank.
    pub local: f64,
    /// The most ranks that a rank exchanges spikes with; all others when there is no bound.
    pub neighbours: Option<u32>,
}

/// A step on so many ranks.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct ModelledStep {
    /// Ranks.
    pub ranks: u32,
    /// Delivery and update.
    pub compute_us: f64,
    /// Exchange.
    pub exchange_us: f64,
    /// Both.
    pub step_us: f64,
    /// The time on one rank, divided by that on all and their number.
    pub efficiency: f64,
    /// Memory of a rank.
    pub memory_gib: f64,
    /// What is replicated, of that.
    pub replicated_gib: f64,
    /// Messages that a rank sends in a step.
    pub messages: f64,
}

impl Costs {
    /// A job on so many ranks.
    #[must_use]
    pub fn step(&self, job: &ScaleJob, ranks: u32) -> ModelledStep {
        let ScaleJob { compartments, fan_out, rate, local, neighbours } = *job;
        let of_rank = compartments / f64::from(ranks.max(1));
        let others = f64::from(ranks.saturating_sub(1).min(neighbours.unwrap_or(u32::MAX)));
        let away = fan_out * (1.0 - local);
        let reached = if others > 0.0 { others * (1.0 - (1.0 - 1.0 / others).powf(away)) } else { 0.0 };
        let words = rate * of_rank * reached;
        let compute_us = self.compartment_ns * of_rank * 1e-3;
        let exchange_us = match others > 0.0 {
            true => {
                let carried = 4.0 * words / (self.bandwidth_gb_s * 1e3);
                self.latency_us + others * self.overhead_us + carried + words * self.id_ns * 1e-3
            }
            false => 0.0,
        };
        let step_us = compute_us + exchange_us;
        let gib = |bytes: f64| bytes / f64::from(1u32 << 30);
        ModelledStep {
            ranks,
            compute_us,
            exchange_us,
            step_us,
            efficiency: compute_us / step_us,
            memory_gib: gib(self.replicated_bytes * compartments + self.synapse_bytes * of_rank * fan_out),
            replicated_gib: gib(self.replicated_bytes * compartments),
            messages: others,
        }
    }
}

/// What somebody else has published of a simulation on many processors.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct PublishedScale {
    /// The work.
    pub work: &'static str,
    /// The machine.
    pub machine: &'static str,
    /// Processors.
    pub processors: f64,
    /// Neurons.
    pub neurons: f64,
    /// Synapses.
    pub synapses: f64,
    /// Spikes of a neuron in a second.
    pub rate_hz: f64,
    /// Microseconds of a step of 1 ms.
    pub step_us: f64,
    /// Memory of the machine for each processor.
    pub memory_gib: f64,
    /// Where it says so.
    pub source: &'static str,
}

/// Compass, which simulates TrueNorth cores. A step of 1 ms took 388 ms.
pub const COMPASS: PublishedScale = PublishedScale {
    work: "Compass (2012)",
    machine: "Blue Gene/Q, 16 racks",
    processors: 262_144.0,
    neurons: 65e9,
    synapses: 16e12,
    rate_hz: 8.1,
    step_us: 388e3,
    memory_gib: 1.0,
    source: "Preissl et al., SC 2012, abstract: 262144 CPUs, 256 TB, 388 times slower than real time",
};

#[cfg(test)]
mod tests {
    use super::*;

    const COSTS: Costs = Costs {
        compartment_ns: 10.0,
        id_ns: 1.0,
        latency_us: 2.0,
        overhead_us: 0.5,
        bandwidth_gb_s: 10.0,
        replicated_bytes: 20.0,
        synapse_bytes: 5.0,
    };
    const JOB: ScaleJob = ScaleJob { compartments: 1e6, fan_out: 64.0, rate: 0.01, local: 0.0, neighbours: None };

    #[test]
    fn one_rank_exchanges_nothing_and_two_exchange_all_spikes() {
        let one = COSTS.step(&JOB, 1);
        assert_eq!((one.compute_us, one.exchange_us, one.efficiency), (10_000.0, 0.0, 1.0));
        let two = COSTS.step(&JOB, 2);
        // 5,000 ids: 2 us, 0.5 us for the message, 2 us for 20 kB, 5 us for the ids.
        assert!((two.exchange_us - 9.5).abs() < 1e-9, "{two:?}");
        assert_eq!(two.compute_us, 5_000.0);
        let bytes = 20.0 * 1e6 + 5.0 * 64.0 * 5e5;
        assert!((two.memory_gib * f64::from(1u32 << 30) - bytes).abs() < 1.0);
    }

    #[test]
    fn a_spike_goes_to_no_more_ranks_than_it_has_targets() {
        let many = COSTS.step(&JOB, 100_000);
        let words = 10.0 * 0.01 * 64.0;
        let expected = 2.0 + 99_999.0 * 0.5 + words * (4.0 / 10e3 + 1e-3);
        assert!((many.exchange_us - expected).abs() < 1e-3, "{} {expected}", many.exchange_us);
        let near = COSTS.step(&ScaleJob { local: 0.9, neighbours: Some(8), ..JOB }, 100_000);
        assert!(near.messages == 8.0 && near.exchange_us < 7.0 && near.efficiency > many.efficiency);
    }

    #[test]
    fn what_is_published_is_by_processor_as_the_paper_says() {
        assert!((COMPASS.neurons / COMPASS.processors - 247_955.0).abs() < 1.0);
        assert!((COMPASS.synapses / COMPASS.neurons - 246.0).abs() < 1.0);
    }
}
