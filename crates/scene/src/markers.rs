//! Onsets by the paper's annotation rule: from markers that cameras track.
//!
//! Input: a grasp's motion. Output: when the arm lifts and when the box turns, by the rule of
//! Taunyazov et al. 2020 (appendix, "Ground-truth Slip detection"). Labels do not come from here:
//! they are the outcome of the simulation.

use super::draw::{Draws, Purpose};
use super::gripper::Motion;

/// Frames a second (OptiTrack; "for 1 second" and 120 frames, section VI and appendix).
const FRAMES_PER_S: f64 = 120.0;
/// Frames without motion, before the recording.
const REST_FRAMES: u32 = 120;
/// Fraction of these frames that a value must exceed.
const EXCEEDED_FRACTION: f64 = 0.98;
/// Standard deviation of a marker's height, mm; assumed, as such trackers promise at 1 to 2 m.
const HEIGHT_MM: f64 = 0.1;
/// Standard deviation of orientation, rad; assumed: the above over 5 cm between markers.
const ORIENTATION_RAD: f64 = 0.002;

/// Times of lift and turn, ms from the start of the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkerOnsets {
    /// The arm lifts.
    pub lift_ms: Option<f64>,
    /// The box turns.
    pub turn_ms: Option<f64>,
}

/// First of `frames` from which on every one exceeds more than 98 % of the frames without motion.
fn onset(rest: &[f64], frames: &[f64]) -> Option<usize> {
    let last_below = frames.iter().rposition(|figure| {
        let below = rest.iter().filter(|at_rest| figure > *at_rest).count();
        below as f64 / rest.len() as f64 <= EXCEEDED_FRACTION
    });
    let first = last_below.map_or(0, |last| last + 1);
    (first < frames.len()).then_some(first)
}

impl MarkerOnsets {
    /// Applies the rule to a motion, whose frames begin at a random time in the first 1/120 s.
    pub fn new(motion: &Motion, draws: Draws) -> Self {
        let states = motion.recorded_states();
        let begin_ms = 1e3 / FRAMES_PER_S * draws.unit(Purpose::Marker, 2, 0);
        let still = states.first().map_or(0.0, |state| state.angle_rad);
        let (mut times_ms, mut heights, mut angles) = (Vec::new(), Vec::new(), Vec::new());
        for frame in 0.. {
            let time_ms = begin_ms + 1e3 / FRAMES_PER_S * f64::from(frame);
            let Some(state) = states.get(time_ms as usize) else { break };
            times_ms.push(time_ms);
            heights.push(height_mm(state.lift_m, draws, REST_FRAMES + frame));
            angles.push(angle_rad(state.angle_rad - still, draws, REST_FRAMES + frame));
        }
        let heights_at_rest: Vec<f64> = (0..REST_FRAMES).map(|frame| height_mm(0.0, draws, frame)).collect();
        let angles_at_rest: Vec<f64> = (0..REST_FRAMES).map(|frame| angle_rad(0.0, draws, frame)).collect();
        MarkerOnsets {
            lift_ms: onset(&heights_at_rest, &heights).map(|frame| times_ms[frame]),
            turn_ms: onset(&angles_at_rest, &angles).map(|frame| times_ms[frame]),
        }
    }
}

/// The measured height in a frame.
fn height_mm(lift_m: f64, draws: Draws, frame: u32) -> f64 {
    1e3 * lift_m + HEIGHT_MM * draws.normal(Purpose::Marker, 0, frame)
}

/// The measured angle in a frame. The angle between two orientations has no sign.
fn angle_rad(turned_rad: f64, draws: Draws, frame: u32) -> f64 {
    (turned_rad + ORIENTATION_RAD * draws.normal(Purpose::Marker, 1, frame)).abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slip::Slip;

    #[test]
    fn an_onset_is_the_first_frame_above_nearly_all_that_were_at_rest_for_good() {
        let rest: Vec<f64> = (0..100).map(f64::from).collect();
        // 98 of 100 are not more than 98 %.
        assert_eq!(onset(&rest, &[0.0, 98.0, 98.5, 200.0]), Some(2));
        assert_eq!(onset(&rest, &[200.0, 0.0, 200.0]), Some(2));
        assert_eq!(onset(&rest, &[200.0]), Some(0));
        assert_eq!(onset(&rest, &[200.0, 3.0]), None);
    }

    #[test]
    fn the_rule_finds_the_lift_and_the_turn_of_each_slip() {
        let slip = Slip { samples: 60, ..Slip::default() };
        let mut after = Vec::new();
        for sample in 0..slip.samples {
            let (grasp, motion) = slip.course(sample);
            let found = MarkerOnsets::new(&motion, Draws::new(slip.seed, sample));
            let lift_ms = found.lift_ms.unwrap();
            // The arm takes some ms to exceed the markers' resolution. Noise may be above 98 % in
            // up to two frames before, 17 ms.
            let since = lift_ms - 1e3 * grasp.lift_s;
            assert!((-17.0..35.0).contains(&since), "sample {sample}: {since}");
            if motion.onset_ms.is_some() {
                after.push(found.turn_ms.unwrap() - lift_ms);
            }
        }
        let mean = after.iter().sum::<f64>() / after.len() as f64;
        assert!(after.len() == 30 && mean > 0.0 && mean < 60.0, "{mean}");
    }
}
