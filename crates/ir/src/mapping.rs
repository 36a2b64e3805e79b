//! The contents of a saved mapping (`nsim map -o`): the core and the chip of each compartment.
//!
//! It is small and readable: runs and strides of compartments by population, or boxes of layers,
//! without synapses. Loading compiles the model again with this partition and placement, so that
//! nothing in it has to be trusted.

use crate::base::diagnostic::Diagnostic;
use serde::{Deserialize, Serialize};

/// A run of compartments of one population, in slot order, or of channels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// The population.
    pub population: String,
    /// The first compartment or channel, as numbered in the model file.
    pub first: u32,
    /// Number of consecutive compartments or channels.
    pub count: u32,
}

impl Run {
    /// Adds a compartment or channel to runs: to the last run where it follows it, else as a new
    /// run.
    pub fn add(runs: &mut Vec<Run>, population: &str, index: u32) {
        match runs.last_mut() {
            Some(run) if run.population == population && run.first.checked_add(run.count) == Some(index) => {
                run.count += 1;
            }
            _ => runs.push(Run { population: population.to_string(), first: index, count: 1 }),
        }
    }
}

/// One core in use.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappedCore {
    /// Chip number on the board.
    pub chip: u32,
    /// Column of the tile on the chip.
    pub x: u32,
    /// Row of the tile on the chip.
    pub y: u32,
    /// Core within the tile.
    pub core: u32,
    /// Its compartments, in slot order.
    #[serde(with = "strides")]
    pub holds: Vec<Run>,
}

/// Serialised form of runs. One run of a population has `first` and `count`. Several have `at`: `5`
/// is a compartment, `5+3` three from 5 on, `5+3*4` three at a distance of 4.
mod strides {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Run;

    /// The most compartments of a stride, and of a core.
    const MOST: u32 = 1 << 16;

    #[derive(Serialize, Deserialize)]
    #[serde(deny_unknown_fields, rename = "Run")]
    struct Written {
        population: String,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        first: Option<u32>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        count: Option<u32>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        at: Option<String>,
    }

    pub(super) fn serialize<S: Serializer>(runs: &[Run], serializer: S) -> Result<S::Ok, S::Error> {
        let written = runs.chunk_by(|a, b| a.population == b.population).map(|runs| {
            let population = runs[0].population.clone();
            match runs {
                [Run { first, count, .. }] => {
                    Written { population, first: Some(*first), count: Some(*count), at: None }
                }
                _ => Written { population, first: None, count: None, at: Some(text(runs)) },
            }
        });
        serializer.collect_seq(written)
    }

    fn text(runs: &[Run]) -> String {
        let ids: Vec<u32> = runs.iter().flat_map(|run| run.first..run.first.saturating_add(run.count)).collect();
        let (mut words, mut at) = (Vec::new(), 0);
        while at < ids.len() {
            let step = ids.get(at + 1).and_then(|next| next.checked_sub(ids[at])).filter(|&step| step > 0);
            let follows =
                |step: u32| ids[at..].windows(2).take_while(|pair| pair[0].checked_add(step) == Some(pair[1])).count();
            let (word, count) = match step.map(|step| (step, 1 + follows(step))) {
                Some((1, count)) => (format!("{}+{count}", ids[at]), count),
                Some((step, count)) if count > 2 => (format!("{}+{count}*{step}", ids[at]), count),
                _ => (ids[at].to_string(), 1),
            };
            words.push(word);
            at += count;
        }
        words.join(" ")
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Run>, D::Error> {
        let mut runs: Vec<Run> = Vec::new();
        for Written { population, first, count, at } in Vec::<Written>::deserialize(deserializer)? {
            match (first, count, at) {
                (Some(first), Some(count), None) => runs.push(Run { population, first, count }),
                (None, None, Some(at)) => {
                    for word in at.split_whitespace() {
                        let wrong = || {
                            D::Error::custom(format!(
                                "{word} is not a compartment, run or stride, such as 5, 5+3 or 5+3*4"
                            ))
                        };
                        let (first, count, step) = stride(word).ok_or_else(wrong)?;
                        add(&mut runs, &population, first, count, step).ok_or_else(wrong)?;
                    }
                }
                _ => {
                    return Err(D::Error::custom(
                        "a core lists compartments of a population either with first and count, or with at",
                    ));
                }
            }
        }
        Ok(runs)
    }

    /// First, count and step of a word.
    fn stride(word: &str) -> Option<(u32, u32, u32)> {
        let Some((first, rest)) = word.split_once('+') else { return Some((word.parse().ok()?, 1, 1)) };
        let (count, step) = rest.split_once('*').unwrap_or((rest, "1"));
        let (count, step) = (count.parse().ok()?, step.parse().ok()?);
        Some((first.parse().ok()?, count, step)).filter(|_| (1..=MOST).contains(&count) && step > 0)
    }

    fn add(runs: &mut Vec<Run>, population: &str, first: u32, count: u32, step: u32) -> Option<()> {
        for k in 0..count {
            let id = first.checked_add(k.checked_mul(step)?)?;
            Run::add(runs, population, id);
        }
        Some(())
    }
}

/// Some cores of one chip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnChip {
    /// Chip number on the board.
    pub chip: u32,
    /// Numbers of the cores, counted by row of tiles, then tile.
    pub cores: Vec<u32>,
}

/// A layer that is divided into boxes, one for each core.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappedLayer {
    /// The population.
    pub population: String,
    /// Channels, rows and columns of a box; boxes at the end of the layer may be smaller.
    pub size: (u32, u32, u32),
    /// The cores of its boxes. Boxes of different channels at one position are consecutive.
    /// Positions go from west to east in the first row of boxes, from east to west in the next row,
    /// and so on.
    pub places: Vec<OnChip>,
}

/// The pruning of the model before it was mapped. With the model it determines the compartments and
/// synapses to map.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename = "Pruned")]
pub struct PrunedFile {
    /// Origin of the stimulus; `None` when the model was pruned for every stimulus.
    pub stimulus: Option<Vec<String>>,
    /// Runs of channels that the stimulus never fires.
    #[serde(default)]
    pub dead: Vec<Run>,
    /// Populations that stayed whole because they were probed.
    #[serde(default)]
    pub probed: Vec<String>,
}

/// A saved mapping.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename = "Mapping")]
pub struct MappingFile {
    /// The model it was made for.
    pub model: String,
    /// The target it was made for.
    pub target: String,
    /// Number of copies of the model.
    pub copies: u32,
    /// The strategy that made it.
    pub strategy: String,
    /// The seed of the strategy.
    pub seed: u64,
    /// The pruning of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pruned: Option<PrunedFile>,
    /// The cores in use, with their compartments.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cores: Vec<MappedCore>,
    /// Layers in boxes, instead of `cores`, if the network is mapped by its kernels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<MappedLayer>,
    /// SHA-256 of the other fields; absent in a file that was written by hand. After reading it is
    /// present only if it does not match the other fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub checksum: Option<String>,
}

impl MappingFile {
    /// Chip, and number on the chip, of each core of the layers.
    pub fn places(&self) -> impl Iterator<Item = (u32, u32)> {
        self.layers.iter().flat_map(MappedLayer::places)
    }
}

impl MappedLayer {
    /// Chip, and number on the chip, of the core of each box.
    pub fn places(&self) -> impl Iterator<Item = (u32, u32)> {
        self.places.iter().flat_map(|on| on.cores.iter().map(move |&core| (on.chip, core)))
    }
}

/// Refuses a mapping that was changed after it was saved. Other errors are more specific, so this
/// is checked last.
///
/// # Errors
/// `mapping.checksum`.
pub fn check_unchanged(mapping: &MappingFile) -> Result<(), Diagnostic> {
    if mapping.checksum.is_none() {
        return Ok(());
    }
    let message = "the mapping was changed or damaged after it was saved: its checksum does not match";
    Err(Diagnostic::new("mapping.checksum", message)
        .help("make it again: nsim map MODEL -o FILE; if you changed it on purpose, remove the line of its checksum"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::base::rng;
    use crate::spanned::options;

    fn core(holds: Vec<Run>) -> MappedCore {
        MappedCore { chip: 0, x: 1, y: 2, core: 3, holds }
    }

    fn run(population: &str, first: u32, count: u32) -> Run {
        Run { population: population.to_string(), first, count }
    }

    fn text(core: &MappedCore) -> String {
        options().to_string(core).unwrap()
    }

    fn read(text: &str) -> Result<MappedCore, String> {
        options().from_str(text).map_err(|error| error.to_string())
    }

    #[test]
    fn runs_are_written_as_strides_and_read_again() {
        let one =
            core(vec![run("a", 5, 3), run("b", 1, 1), run("b", 5, 1), run("b", 9, 1), run("b", 20, 2), run("a", 0, 1)]);
        let written = text(&one);
        assert!(written.contains("\"1+3*4 20+2\"") && written.contains("first:5,count:3"), "{written}");
        assert_eq!(read(&written).unwrap(), one);
        for seed in 0..200 {
            let mut holds: Vec<Run> = Vec::new();
            for k in 0..1 + rng::below(40, seed, 0, 0) {
                let name = ["a", "b"][rng::below(8, seed, k, 1) as usize / 7];
                let first = (rng::below(30, seed, k, 2) * [1, 1, 3][(seed % 3) as usize]) as u32;
                Run::add(&mut holds, name, first);
            }
            let one = core(holds);
            assert_eq!(read(&text(&one)).unwrap(), one, "seed {seed}");
        }
    }

    #[test]
    fn what_is_no_stride_is_refused() {
        let held = |holds: &str| read(&format!("(chip: 0, x: 0, y: 0, core: 0, holds: [{holds}])"));
        assert_eq!(held("(population: \"a\", first: 4, count: 2)").unwrap().holds, [run("a", 4, 2)]);
        for wrong in ["x", "1+", "1+0", "1+2*0", "1+70000", "-1", "4294967295+2", "1+3*4294967295", "1..3"] {
            let said = held(&format!("(population: \"a\", at: \"{wrong}\")")).unwrap_err();
            assert!(said.contains("not a compartment, run or stride"), "{wrong}: {said}");
        }
        for wrong in ["first: 1", "count: 1", "first: 1, count: 1, at: \"1\"", "steps: 2"] {
            assert!(held(&format!("(population: \"a\", {wrong})")).is_err(), "{wrong}");
        }
    }
}
