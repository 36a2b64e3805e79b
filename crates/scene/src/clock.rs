//! A clock: an input that encodes how far a sample has progressed.
//!
//! Input: the number of timesteps of a channel, and the length of a sample. Output: the spikes.
//! Channel k spikes in every step of the k-th span; the last channel also spikes in all later
//! steps. A robot that grasps and lifts by a fixed course knows its progress; neurons whose memory
//! is shorter than the course do not. Nothing is random.

use crate::parameter::{parameter, unknown};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::stimulus::SceneArg;

/// The scene's name.
pub const NAME: &str = "clock";

/// The scene's parameters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clock {
    span: u32,
}

impl Clock {
    /// Reads `span`, the timesteps of a channel (1 to 100,000; 1).
    ///
    /// # Errors
    /// A diagnostic for an unknown key or a value out of range.
    pub fn parse(scene: &SceneArg) -> Result<Self> {
        let mut clock = Clock { span: 1 };
        for (key, value) in &scene.parameters {
            match key.as_str() {
                "span" => clock.span = parameter(key, value, 1..=100_000)?,
                _ => return Err(unknown(NAME, key, &["span"])),
            }
        }
        Ok(clock)
    }

    /// (step, channel) of each spike of a sample; none without channels.
    pub fn spikes(self, steps: u32, channels: u32) -> Vec<(u32, u32)> {
        let Some(last) = channels.checked_sub(1) else { return Vec::new() };
        (0..steps).map(|step| (step, (step / self.span).min(last))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_span_has_its_channel_and_the_last_goes_on() {
        let clock = Clock::parse(&SceneArg::parse("clock?span=3").unwrap()).unwrap();
        let channels: Vec<u32> = clock.spikes(8, 2).into_iter().map(|(_, channel)| channel).collect();
        assert_eq!(channels, [0, 0, 0, 1, 1, 1, 1, 1]);
        assert_eq!(clock.spikes(4, 0), []);
        assert!(Clock::parse(&SceneArg::parse("clock?span=0").unwrap()).is_err());
        assert!(Clock::parse(&SceneArg::parse("clock?width=2").unwrap()).is_err());
    }
}
