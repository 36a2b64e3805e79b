//! The mirror of a saved mapping (`nsim map -o`): which compartments sit on which core of which chip.
//!
//! It is small and for people to read: runs of compartments by population, or boxes of layers; no synapses. Loading one
//! compiles the model again with this partition and placement, so nothing in it needs to be believed.

use serde::{Deserialize, Serialize};

/// A run of compartments of one population, in slot order, or of channels.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Run {
    /// The population.
    pub population: String,
    /// The first of them, as the model file counts.
    pub first: u32,
    /// How many follow each other.
    pub count: u32,
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
    /// What sits on it, in slot order.
    pub holds: Vec<Run>,
}

/// Cores of one chip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnChip {
    /// Chip number on the board.
    pub chip: u32,
    /// Numbers of its cores, row of tiles by row, tile by tile.
    pub cores: Vec<u32>,
}

/// A layer that is cut into boxes, a core each.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappedLayer {
    /// The population.
    pub population: String,
    /// Channels, rows and columns of a box; boxes at the end of the layer may be smaller.
    pub size: (u32, u32, u32),
    /// The cores of its boxes: channels of a place after each other, places of a row of boxes from west to east, then those
    /// of the next row from east to west, and so on to and fro.
    pub places: Vec<OnChip>,
}

/// What was left out of the model before it was mapped. Together with the model it says which compartments and synapses
/// there are to map.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename = "Pruned")]
pub struct PrunedFile {
    /// Where the stimulus came from; nothing when the model was pruned for every stimulus.
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
    /// How many copies of the model.
    pub copies: u32,
    /// The strategy that made it.
    pub strategy: String,
    /// The seed of the strategy.
    pub seed: u64,
    /// What was left out of the model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pruned: Option<PrunedFile>,
    /// The cores in use, with what sits on them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub cores: Vec<MappedCore>,
    /// Instead of cores: layers in boxes, of a network that is mapped by its kernels.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub layers: Vec<MappedLayer>,
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
