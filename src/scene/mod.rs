//! Synthetic stimuli: `scene:NAME?key=value&..`.
//!
//! Comes in: the network's input populations and a scene's parameters. Goes out: samples, the same for the same seed on
//! any machine.

pub mod noise;

use crate::base::diagnostic::Diagnostic;
use crate::desc::stimulus::SceneArg;
use crate::ir::quantised::Quantised;
use crate::ir::spikes::Stimulus;

/// The scenes that ship, by name and what they are.
pub const SCENES: [(&str, &str); 1] =
    [("noise", "independent spikes at a fixed rate (samples, steps, seed, rate, POPULATION=rate)")];

/// Makes a scene for a network.
///
/// # Errors
/// A diagnostic for an unknown scene or parameter, or a value out of range.
pub fn stimulus(network: &Quantised, scene: &SceneArg) -> Result<Stimulus, Diagnostic> {
    match scene.name.as_str() {
        "noise" => noise::stimulus(network, &noise::Noise::parse(network, scene)?),
        other => {
            let known: Vec<&str> = SCENES.iter().map(|(name, _)| *name).collect();
            Err(Diagnostic::new("scene.unknown", format!("there is no scene '{other}'"))
                .help(format!("scenes are: {}", known.join(", "))))
        }
    }
}

/// A parameter's value within a range.
fn parameter<T: std::str::FromStr + PartialOrd + std::fmt::Display>(
    key: &str,
    value: &str,
    range: std::ops::RangeInclusive<T>,
) -> Result<T, Diagnostic> {
    value.parse().ok().filter(|parsed| range.contains(parsed)).ok_or_else(|| {
        Diagnostic::new(
            "scene.parameter",
            format!("scene parameter {key}={value} is not within {}..={}", range.start(), range.end()),
        )
    })
}
