//! Synthetic stimuli: `scene:NAME?key=value&..`.
//!
//! Input: the network's input populations and a scene's parameters. Output: samples. Invariant: the
//! same seed gives the same samples on every machine and at any number of threads. `docs/scenes.md`
//! has the equations, the sources of the parameters and statistics of the recordings.

pub mod camera;
pub mod clock;
pub mod container;
pub mod draw;
pub mod gripper;
pub mod markers;
pub mod noise;
mod parameter;
mod recording;
pub mod slip;
pub mod touch;
pub mod wire;

use rayon::prelude::*;

pub use self::recording::{MOST_SAMPLES, Recording, Senses, TOUCH, VISION, VISION_PLANES};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::base::id::ChannelId;
use nsim_ir::quantised::Quantised;
use nsim_ir::spikes::{Sample, Stimulus};
use nsim_ir::stimulus::SceneArg;

/// The names of the scenes that ship.
pub const SCENES: [&str; 4] = [clock::NAME, "container", "noise", "slip"];

/// Makes a scene for a network.
///
/// # Errors
/// A diagnostic for an unknown scene or parameter, or a value out of range.
pub fn stimulus(network: &Quantised, scene: &SceneArg) -> Result<Stimulus> {
    stimulus_with_progress(network, scene, &|| ())
}

/// As [`stimulus`]; calls `progress` before each sample, from any thread: where it panics, those
/// that are left take no time. Errors are those of [`stimulus`].
pub fn stimulus_with_progress(network: &Quantised, scene: &SceneArg, progress: &(dyn Fn() + Sync)) -> Result<Stimulus> {
    match scene.name.as_str() {
        "noise" => noise::stimulus(network, &noise::Noise::parse(network, scene)?, progress),
        _ => recorded_stimulus(network, &RecordedScene::parse(scene)?, progress),
    }
}

/// A scene that fingers and a camera record, with its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedScene {
    /// The scene's name.
    pub name: &'static str,
    /// Number of requested samples.
    pub samples: u32,
    /// The seed.
    pub seed: u64,
    /// Timesteps of a sample.
    pub steps: u32,
    /// Milliseconds of a timestep.
    pub timestep_ms: f64,
    /// Names of the classes, by label.
    pub classes: Vec<String>,
    scene: Scene,
}

#[derive(Debug, Clone, PartialEq)]
enum Scene {
    /// A box that rotates or does not.
    Slip(slip::Slip),
    /// Containers with a fill level.
    Container(container::Containers),
}

impl RecordedScene {
    /// Reads `scene:NAME?..`.
    ///
    /// # Errors
    /// `scene.unknown`, `scene.parameter`.
    pub fn parse(scene: &SceneArg) -> Result<Self> {
        match scene.name.as_str() {
            "slip" => {
                let set = slip::Slip::parse(scene)?;
                Ok(RecordedScene {
                    name: "slip",
                    samples: set.samples,
                    seed: set.seed,
                    steps: slip::STEPS,
                    timestep_ms: 1.0,
                    classes: slip::CLASSES.map(String::from).to_vec(),
                    scene: Scene::Slip(set),
                })
            }
            "container" => {
                let set = container::Containers::parse(scene)?;
                Ok(RecordedScene {
                    name: "container",
                    samples: set.samples,
                    seed: set.seed,
                    steps: container::STEPS,
                    timestep_ms: f64::from(container::BIN_MS),
                    classes: container::classes(),
                    scene: Scene::Container(set),
                })
            }
            "noise" => Err(unknown(
                "scene noise depends on the model, so it cannot be recorded",
                "give it to a run: nsim run MODEL --input scene:noise",
            )),
            clock::NAME => Err(unknown(
                "a clock is combined with recordings, for a population of its own",
                "nsim run MODEL --input touch=recordings --input phase=scene:clock?span=13",
            )),
            other => {
                let known = SCENES.join(", ");
                Err(unknown(&format!("there is no scene '{other}'"), &format!("scenes are: {known}")))
            }
        }
    }

    /// Recording of a sample by the given senses: a function of parameters, seed and the number of
    /// the sample.
    pub fn recording(&self, sample: u32, senses: Senses) -> Recording {
        match &self.scene {
            Scene::Slip(slip) => slip.recording(sample, senses),
            Scene::Container(set) => set.recording(sample, senses),
        }
    }
}

fn unknown(message: &str, help: &str) -> Diagnostic {
    Diagnostic::new("scene.unknown", message).help(help)
}

/// The recordings of a scene on the channels of a network's input populations.
fn recorded_stimulus(network: &Quantised, scene: &RecordedScene, progress: &(dyn Fn() + Sync)) -> Result<Stimulus> {
    let name = scene.name;
    // First channel of touch and of vision, where the network has them.
    let senses = [TOUCH, VISION, VISION_PLANES];
    let mut first = [None; 3];
    for (_, population) in network.inputs() {
        let units = population.shape.len();
        let Some(sense) = senses.iter().position(|sense| *sense == (population.name.as_str(), units)) else {
            let message =
                format!("scene {name} does not drive input population '{}' of {units} channels", population.name);
            let help = format!(
                "it is recorded for '{}' ({}) and '{}' ({}, or {} with a plane for each polarity)",
                TOUCH.0, TOUCH.1, VISION.0, VISION.1, VISION_PLANES.1
            );
            return Err(Diagnostic::new("scene.population", message).help(help));
        };
        first[sense] = population.first_channel().map(|channel| channel.0);
    }
    let wanted = Senses { touch: first[0].is_some(), vision: first[1].or(first[2]).is_some() };
    let samples = (0..scene.samples)
        .into_par_iter()
        .map(|sample| {
            progress();
            let recording = scene.recording(sample, wanted);
            let mut events = Vec::with_capacity(recording.touch.len() + recording.vision.len());
            let recorded = [&recording.touch, &recording.vision, &recording.vision_planes];
            for (first, sense) in first.iter().zip(recorded) {
                if let &Some(first) = first {
                    events.extend(sense.iter().map(|&(step, channel)| (step, ChannelId(first + channel))));
                }
            }
            Sample::new(recording.steps, &events, Some(recording.label))
        })
        .collect::<Result<_, _>>()
        .map_err(|error| Diagnostic::new("scene.too-large", error.to_string()))?;
    Ok(Stimulus { samples, origin: vec![format!("scene:{name}")], seed: Some(scene.seed), ..Stimulus::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sense_records_the_same_where_the_other_is_not_read() {
        for scene in ["slip?seed=4", "container?seed=4"] {
            let scene = RecordedScene::parse(&SceneArg::parse(scene).unwrap()).unwrap();
            for sample in 0..3 {
                let both = scene.recording(sample, Senses::BOTH);
                let touch = scene.recording(sample, Senses { vision: false, ..Senses::BOTH });
                let vision = scene.recording(sample, Senses { touch: false, ..Senses::BOTH });
                assert!(vision.touch.is_empty() && touch.vision.is_empty() && touch.vision_planes.is_empty());
                let Recording { vision, vision_planes, .. } = vision;
                assert_eq!(both, Recording { vision, vision_planes, ..touch });
            }
        }
    }
}
