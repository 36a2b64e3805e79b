//! One wire for all taxels: events as overlapping pulse signatures, decoded by correlation.
//!
//! This is the read-out of the NeuTouch finger (ACES; Taunyazov et al. 2020, section III): every
//! taxel sends its own pattern of pulses asynchronously, patterns add on the wire, and a decoder
//! correlates the signal with each pattern. Input: events by millisecond and channel. Output: the
//! events that the decoder reports, and the numbers of missed and of false ones. Not modelled: the
//! shape of a pulse and delays along the wire.
//!
//! A slot is 1 us. A signature has ten pulses in 1,000 slots, one in each 100, at places that the
//! device is built with (assumed; the seed of a scene does not change them). An event starts
//! anywhere in its millisecond, and each pulse is off by up to the jitter. In every slot the wire
//! carries the number of pulses plus noise; half a pulse is the threshold. A channel is reported
//! where nine of its ten pulses at least are within the jitter of their places, at most once in
//! 1,000 slots.

use super::draw::{Draws, Purpose};
use super::touch::TAXELS;

/// Channels of touch: falls and rises of the taxels of two fingers.
const CHANNELS: u32 = 4 * TAXELS as u32;
/// Pulses of a signature.
const PULSES: usize = 10;
/// Slots of a signature, and of a millisecond.
const SLOTS: usize = 1000;
/// Greatest jitter, in slots: with it about half of all slots match a pulse of a signature.
pub const MOST_JITTER: u32 = 25;

/// The wire that all taxels share.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Wire {
    /// Standard deviation of the noise in a slot, in amplitudes of a pulse.
    pub noise: f64,
    /// Greatest deviation of a pulse in either direction, us.
    pub jitter_us: u32,
}

/// Counts of sent, missed and false events.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WireCounts {
    /// Sent events.
    pub sent: u64,
    /// Sent events that were not reported within a millisecond.
    pub missed: u64,
    /// Reports without an event.
    pub added: u64,
}

impl std::ops::AddAssign for WireCounts {
    fn add_assign(&mut self, other: WireCounts) {
        self.sent += other.sent;
        self.missed += other.missed;
        self.added += other.added;
    }
}

/// Places of a channel's pulses.
fn signature(channel: u32) -> [usize; PULSES] {
    let cell = SLOTS / PULSES;
    std::array::from_fn(|p| cell * p + (Draws::DEVICE.bits(Purpose::Wire, channel, p as u32) % cell as u64) as usize)
}

impl Default for Wire {
    fn default() -> Self {
        Wire { noise: 0.1, jitter_us: 1 }
    }
}

impl Wire {
    /// Touch events, (ms, channel), after the wire; without a wire, the given events.
    pub fn transmit_over(
        wire: Option<Wire>,
        events: Vec<(u32, u32)>,
        end_ms: u32,
        draws: Draws,
    ) -> (Vec<(u32, u32)>, Option<WireCounts>) {
        let Some(wire) = wire else { return (events, None) };
        let (decoded, carried) = wire.transmit(&events, end_ms, draws);
        (decoded, Some(carried))
    }

    /// Sends events, (ms, channel), in `end_ms` milliseconds; returns the decoded ones, sorted.
    pub fn transmit(&self, events: &[(u32, u32)], end_ms: u32, draws: Draws) -> (Vec<(u32, u32)>, WireCounts) {
        let seen = self.pulse_slots(events, end_ms, draws);
        let mut reported = Vec::new();
        for channel in 0..CHANNELS {
            // The first and last slot of each run of matches.
            let mut runs: Vec<(usize, usize)> = Vec::new();
            for (word, mut matching) in matches(&seen, &signature(channel)) {
                while matching != 0 {
                    let slot = 64 * word + matching.trailing_zeros() as usize;
                    matching &= matching - 1;
                    match runs.last_mut() {
                        Some((_, last)) if *last + 1 == slot => *last = slot,
                        _ => runs.push((slot, slot)),
                    }
                }
            }
            let mut free = 0;
            for (first, last) in runs {
                let middle = usize::midpoint(first, last);
                if middle >= free {
                    reported.push((((middle / SLOTS) as u32).min(end_ms.saturating_sub(1)), channel));
                    free = middle + SLOTS;
                }
            }
        }
        reported.sort_unstable();
        let carried = count_errors(events, &reported);
        (reported, carried)
    }

    /// Bit mask of the slots that have a pulse within the jitter.
    fn pulse_slots(&self, events: &[(u32, u32)], end_ms: u32, draws: Draws) -> Vec<u64> {
        let jitter = self.jitter_us as usize;
        // The last events begin in the last millisecond and take one more.
        let slots = (end_ms as usize + 2) * SLOTS + 2 * jitter;
        let mut pulses = vec![0u8; slots];
        for &(ms, channel) in events {
            let begin = ms as usize * SLOTS + (draws.bits(Purpose::Wire, channel, ms) % SLOTS as u64) as usize;
            for (p, place) in signature(channel).into_iter().enumerate() {
                let drawn = draws.bits(Purpose::Wire, channel + (1 + p as u32) * 4096, ms);
                let off = (drawn % (2 * jitter as u64 + 1)) as usize;
                let at = (begin + place + off).saturating_sub(jitter);
                if let Some(pulse) = pulses.get_mut(at) {
                    *pulse = pulse.saturating_add(1);
                }
            }
        }
        let mut seen = vec![0u64; slots.div_ceil(64) + SLOTS / 64 + 2];
        for (slot, &pulses) in pulses.iter().enumerate() {
            let noise = match self.noise {
                0.0 => 0.0,
                noise => noise * draws.normal(Purpose::Wire, 1 << 20, slot as u32),
            };
            if f64::from(pulses) + noise > 0.5 {
                for near in slot.saturating_sub(jitter)..=(slot + jitter).min(slots - 1) {
                    seen[near / 64] |= 1 << (near % 64);
                }
            }
        }
        seen
    }
}

/// Slots, as words of bits, at which nine pulses of a signature at least are seen.
fn matches<'a>(seen: &'a [u64], signature: &'a [usize; PULSES]) -> impl Iterator<Item = (usize, u64)> + 'a {
    let words = seen.len().saturating_sub(SLOTS / 64 + 2);
    (0..words).map(move |word| {
        let (mut all, mut but_one) = (u64::MAX, 0);
        for &place in signature {
            let (skip, shift) = (word + place / 64, place % 64);
            let high = if shift == 0 { 0 } else { seen[skip + 1] << (64 - shift) };
            let there = seen[skip] >> shift | high;
            but_one = but_one & there | all & !there;
            all &= there;
        }
        (word, all | but_one)
    })
}

/// The times of each channel's events, in order.
fn times_by_channel(events: &[(u32, u32)]) -> Vec<Vec<u32>> {
    let mut times = vec![Vec::new(); CHANNELS as usize];
    for &(ms, channel) in events {
        times[channel as usize].push(ms);
    }
    times.iter_mut().for_each(|times| times.sort_unstable());
    times
}

/// Matches each report with the first unmatched event of its channel within a millisecond.
fn count_errors(sent: &[(u32, u32)], reported: &[(u32, u32)]) -> WireCounts {
    let mut carried = WireCounts { sent: sent.len() as u64, ..WireCounts::default() };
    for (sent, reported) in times_by_channel(sent).into_iter().zip(times_by_channel(reported)) {
        let mut sent = sent.into_iter().peekable();
        for report in reported {
            while sent.next_if(|&ms| ms + 1 < report).is_some() {
                carried.missed += 1;
            }
            if sent.next_if(|&ms| ms <= report + 1).is_none() {
                carried.added += 1;
            }
        }
        carried.missed += sent.count() as u64;
    }
    carried
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Events at a rate, each channel resting for four milliseconds after one.
    fn events(channels: u32, end_ms: u32, rate: f64) -> Vec<(u32, u32)> {
        let draws = Draws::new(9, 9);
        let mut rests = vec![0; channels as usize];
        let all = (0..end_ms).flat_map(|ms| (0..channels).map(move |channel| (ms, channel)));
        all.filter(|&(ms, channel)| {
            let sent = ms >= rests[channel as usize] && draws.unit(Purpose::Look, channel, ms) < rate;
            if sent {
                rests[channel as usize] = ms + 4;
            }
            sent
        })
        .collect()
    }

    #[test]
    fn sparse_events_on_a_quiet_wire_all_arrive_once() {
        let sent = events(156, 60, 0.01);
        assert!(sent.len() > 50);
        let (reported, carried) = Wire { noise: 0.0, jitter_us: 0 }.transmit(&sent, 60, Draws::new(1, 0));
        assert_eq!(
            (reported, carried),
            (sent.clone(), WireCounts { sent: sent.len() as u64, ..WireCounts::default() })
        );
        let (_, jittered) = Wire { noise: 0.1, jitter_us: 1 }.transmit(&sent, 60, Draws::new(1, 0));
        assert_eq!((jittered.missed, jittered.added), (0, 0));
        assert_eq!(Wire { noise: 0.0, jitter_us: 0 }.transmit(&[], 60, Draws::new(1, 0)).0, []);
    }

    /// The decoder's words of bits against counting every pulse of every signature at every slot.
    #[test]
    fn words_of_bits_find_what_counting_finds() {
        let wire = Wire { noise: 0.2, jitter_us: 2 };
        let sent = events(40, 12, 0.15);
        let seen = wire.pulse_slots(&sent, 12, Draws::new(2, 3));
        let bit = |slot: usize| seen[slot / 64] >> (slot % 64) & 1 == 1;
        let mut found = 0;
        for channel in 0..40 {
            let places = signature(channel);
            for (word, bits) in matches(&seen, &places) {
                for k in 0..64 {
                    let slot = 64 * word + k;
                    let pulses = places.iter().filter(|&&place| bit(slot + place)).count();
                    assert_eq!(bits >> k & 1 == 1, pulses >= 9, "channel {channel}, slot {slot}");
                    found += usize::from(pulses >= 9);
                }
            }
        }
        assert!(found > sent.len());
    }

    #[test]
    fn noise_and_crowds_cost_events() {
        let carried = |noise: f64, rate: f64| {
            Wire { noise, jitter_us: 1 }.transmit(&events(156, 40, rate), 40, Draws::new(1, 0)).1
        };
        let errors = |carried: WireCounts| (carried.missed + carried.added) as f64 / carried.sent as f64;
        let (quiet, noisy, crowded) = (carried(0.1, 0.02), carried(0.4, 0.02), carried(0.1, 0.9));
        assert!(
            errors(quiet) < 0.01 && errors(noisy) > 0.1 && errors(crowded) > errors(quiet),
            "{quiet:?} {noisy:?} {crowded:?}"
        );
    }
}
