//! The contents of target files: boards (`mapping/targets`) and their chips (`mapping/chips`).
//!
//! A [`Target`] is a board with its chip and presets of constants ([`Constants`]) resolved and all
//! numbers checked; `nsim_files::target` makes it.

pub mod constants;

use std::collections::BTreeMap;

use serde::Deserialize;

use self::constants::{ClassError, Constant, Constants, Status};
use super::neurons::{Family, NeuronKind};
use super::resource::{LimitChanges, Limits, Resource};
use super::spanned::Spanned;
use crate::base::diagnostic::{Diagnostic, Result, SourceText};

/// The neuron kinds of every Loihi 1.
fn neurons_of_loihi() -> Vec<Family> {
    vec![NeuronKind::Loihi.family(), NeuronKind::If.family()]
}

/// Every Loihi learns.
fn learns_unless_stated() -> bool {
    true
}

/// Six bits (nengo-loihi `block.py`: 1 to 63).
fn refractory_of_loihi() -> u8 {
    63
}

/// Sizes and limits of a chip and its cores.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Chip")]
pub struct Chip {
    /// The chip's name.
    pub name: String,
    /// Its name in energy tables; its own name unless given.
    #[serde(default)]
    pub hardware: Option<String>,
    /// Sources of the limits, and where they disagree.
    pub notes: String,
    /// Number of tiles from west to east.
    pub width: u32,
    /// Number of tiles from north to south.
    pub height: u32,
    /// Number of cores of a tile.
    pub cores_per_tile: u32,
    /// Number of usable cores of the chip, at most `width * height * cores_per_tile`.
    pub cores: u32,
    /// Number of embedded x86 cores.
    pub x86_cores: u32,
    /// Number of busy x86 cores of a chip in use.
    pub x86_cores_in_use: u32,
    /// The neuron kinds of its compartments.
    #[serde(default = "neurons_of_loihi")]
    pub neuron_kinds: Vec<Family>,
    /// The widest integer that a message carries, in bits; 0 where messages carry none.
    #[serde(default)]
    pub message_bits: u32,
    /// Whether its synapses can learn.
    #[serde(default = "learns_unless_stated")]
    pub learning: bool,
    /// The longest refractory period of its compartments, in timesteps.
    #[serde(default = "refractory_of_loihi")]
    pub refractory: u8,
    /// The limits of a core.
    pub limits: Limits,
    /// Sources of the limits.
    #[serde(default)]
    pub limit_sources: Vec<LimitSource>,
    /// Limits by other sources, for the record.
    #[serde(default)]
    pub alternatives: Vec<AlternativeLimit>,
    /// By the name of a limit that this chip's file does not state: the chip whose file states it.
    #[serde(skip)]
    pub stated_in: BTreeMap<&'static str, String>,
    /// Hardware from which this chip differs only in limits of a core, so that events cost the
    /// same.
    #[serde(skip)]
    pub measured_as: Option<String>,
}

/// The source of a limit.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LimitSource {
    /// Name of the limit in [`Limits`].
    pub limit: Spanned<String>,
    /// Paper and table, or repository and file.
    pub source: String,
    /// Confidence in it.
    pub status: Status,
}

/// A limit by another source.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AlternativeLimit {
    /// Name of the limit in [`Limits`].
    pub limit: Spanned<String>,
    /// The other value.
    pub value: u32,
    /// Paper and table, or repository and file.
    pub source: String,
}

impl Chip {
    /// Its name in energy tables.
    pub fn hardware(&self) -> &str {
        self.hardware.as_deref().unwrap_or(&self.name)
    }

    /// Number of places for cores on its tiles.
    pub fn places(&self) -> u32 {
        self.width.saturating_mul(self.height).saturating_mul(self.cores_per_tile)
    }

    /// Checks the ranges of its sizes and limits.
    fn check_sizes(&self) -> Result<()> {
        let wrong = |message: String| Diagnostic::new("target.size", format!("chip {}: {message}", self.name));
        let sizes = [
            ("width", self.width, 64),
            ("height", self.height, 64),
            ("cores_per_tile", self.cores_per_tile, 64),
            ("limits.compartments", self.limits[Resource::Compartments], 65_536),
            ("limits.axons_in", self.limits[Resource::AxonsIn], 65_536),
            ("limits.synapses_per_entry", self.limits.synapses_per_entry, 64),
        ];
        for (what, value, most) in sizes {
            if value == 0 || value > most {
                return Err(wrong(format!("{what} {value} is outside 1..={most}")));
            }
        }
        let Chip { width, height, cores_per_tile, cores, .. } = self;
        if *cores == 0 || *cores > self.places() {
            let places = format!("{width} x {height} tiles of {cores_per_tile} have {} places", self.places());
            return Err(wrong(format!("cores {cores} is outside 1..={}: {places}", self.places()))
                .help("also set width, height or cores_per_tile"));
        }
        Ok(())
    }

    /// Checks sizes, limits and their sources, beyond the types of the fields.
    ///
    /// # Errors
    /// A diagnostic when a size or limit is out of range, or more x86 cores are in use than the
    /// chip has. Also when an output axon takes no slot, or fewer off its chip than on it, or a
    /// source names no limit.
    pub fn check(&self, source: &SourceText) -> Result<()> {
        self.check_sizes().map_err(|problem| problem.in_file(source.path()))?;
        let wrong = |message: String| Diagnostic::new("target.chip", format!("chip {}: {message}", self.name));
        if self.x86_cores_in_use > self.x86_cores {
            return Err(wrong(format!(
                "x86_cores_in_use {} is more than x86_cores {}",
                self.x86_cores_in_use, self.x86_cores
            ))
            .in_file(source.path()));
        }
        let limits = &self.limits;
        if limits.axon_out_slots == 0 || limits.axon_out_slots_off_chip < limits.axon_out_slots {
            return Err(wrong(format!(
                "an output axon takes {} slots on its chip and {} between chips; the first must be at least 1, the \
                second at least the first",
                limits.axon_out_slots, limits.axon_out_slots_off_chip
            ))
            .in_file(source.path()));
        }
        let named = self.limit_sources.iter().map(|entry| &entry.limit);
        for limit in named.chain(self.alternatives.iter().map(|entry| &entry.limit)) {
            let is_pool = limits.pools.iter().any(|pool| pool.name == limit.value);
            if !is_pool && !Limits::NAMES.contains(&limit.value.as_str()) {
                return Err(wrong(format!("there is no limit {}", limit.value))
                    .help(format!("limits are {}", Limits::NAMES.join(", ")))
                    .at(source, limit.span));
            }
        }
        Ok(())
    }
}

/// A target file: chips on a board.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Target")]
pub struct TargetFile {
    /// The target's name.
    pub name: String,
    /// A description, with the source.
    pub notes: String,
    /// Name of the chip.
    pub chip: Spanned<String>,
    /// Number of chips from west to east.
    pub chips_x: Spanned<u32>,
    /// Number of chips from north to south.
    pub chips_y: Spanned<u32>,
    /// Presets of constants; the first is the default.
    pub constants: Vec<Spanned<String>>,
    /// [`Constants::unit_power`] of this board, in place of the presets'.
    #[serde(default)]
    pub unit_power: Option<Constant>,
}

/// A target file that states only differences from a base target.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields, rename = "Target")]
pub struct TargetChanges {
    /// The base target: a shipped one, or a file next to this one.
    pub base: Spanned<String>,
    /// The target's name; the name of its file unless given.
    pub name: Option<String>,
    /// A description.
    pub notes: Option<String>,
    /// Number of chips from west to east.
    pub chips_x: Option<Spanned<u32>>,
    /// Number of chips from north to south.
    pub chips_y: Option<Spanned<u32>>,
    /// Number of tiles of a chip from west to east.
    pub width: Option<u32>,
    /// Number of tiles of a chip from north to south.
    pub height: Option<u32>,
    /// Number of cores of a tile; increased to fit `cores_per_chip` where it alone is given.
    pub cores_per_tile: Option<u32>,
    /// Number of cores of a chip; all places of its tiles when their number or size is given.
    pub cores_per_chip: Option<u32>,
    /// Number of embedded x86 cores.
    pub x86_cores: Option<u32>,
    /// Number of busy x86 cores of a chip in use.
    pub x86_cores_in_use: Option<u32>,
    /// The neuron kinds of its compartments.
    pub neuron_kinds: Option<Vec<Family>>,
    /// The widest integer that a message carries, in bits; 0 where messages carry none.
    pub message_bits: Option<u32>,
    /// Whether its synapses can learn.
    pub learning: Option<bool>,
    /// The longest refractory period of its compartments, in timesteps.
    pub refractory: Option<u8>,
    /// Limits of a core.
    #[serde(default)]
    pub limits: LimitChanges,
    /// Sources of limits, in place of the base's.
    #[serde(default)]
    pub limit_sources: Vec<LimitSource>,
    /// Presets of constants, in place of the base's.
    pub constants: Option<Vec<Spanned<String>>>,
}

impl TargetChanges {
    /// A chip with the changes, named `name` if there are any. It loses the sources of changed
    /// limits.
    pub fn chip(&self, mut chip: Chip, name: &str) -> Chip {
        let sizes = [self.width, self.height, self.cores_per_tile, self.cores_per_chip];
        let x86 = [self.x86_cores, self.x86_cores_in_use];
        let programmed = self.neuron_kinds.is_some() || self.message_bits.is_some();
        for limit in Limits::NAMES {
            match self.limits.changes(limit) {
                true => chip.stated_in.remove(limit),
                false => chip.stated_in.insert(limit, chip.stated_in.get(limit).unwrap_or(&chip.name).clone()),
            };
        }
        let other = programmed
            || self.learning.is_some()
            || self.refractory.is_some()
            || self.limits != LimitChanges::default();
        if other || sizes.iter().chain(&x86).any(Option::is_some) {
            let of_limits = !programmed && sizes.iter().chain(&x86).all(Option::is_none);
            let measured = chip.measured_as.unwrap_or_else(|| chip.hardware.unwrap_or(chip.name));
            chip.measured_as = of_limits.then_some(measured);
            (chip.name, chip.hardware) = (name.to_string(), None);
        }
        chip.x86_cores = self.x86_cores.unwrap_or(chip.x86_cores);
        chip.x86_cores_in_use = self.x86_cores_in_use.unwrap_or(chip.x86_cores_in_use.min(chip.x86_cores));
        chip.width = self.width.unwrap_or(chip.width);
        chip.height = self.height.unwrap_or(chip.height);
        let resized = self.width.is_some() || self.height.is_some() || self.cores_per_tile.is_some();
        let tiles = chip.width.saturating_mul(chip.height).max(1);
        let needed = self.cores_per_chip.filter(|_| !resized).map_or(0, |cores| cores.div_ceil(tiles));
        chip.cores_per_tile = self.cores_per_tile.unwrap_or(chip.cores_per_tile.max(needed));
        let cores = if resized { chip.places() } else { chip.cores };
        chip.cores = self.cores_per_chip.unwrap_or(cores);
        chip.neuron_kinds = self.neuron_kinds.clone().unwrap_or(chip.neuron_kinds);
        chip.message_bits = self.message_bits.unwrap_or(chip.message_bits);
        chip.learning = self.learning.unwrap_or(chip.learning);
        chip.refractory = self.refractory.unwrap_or(chip.refractory);
        chip.limits = self.limits.applied(chip.limits);
        let is_stated = |entry: &LimitSource| self.limit_sources.iter().any(|own| own.limit.value == entry.limit.value);
        chip.limit_sources.retain(|entry| !self.limits.changes(&entry.limit) && !is_stated(entry));
        chip.limit_sources.extend(self.limit_sources.iter().cloned());
        chip.alternatives.retain(|entry| !self.limits.changes(&entry.limit));
        chip
    }
}

/// The most cores of a board: 16,384 chips of Loihi's mesh protocol (Davies et al. 2018) with 128
/// cores each.
pub const MOST_CORES: u64 = 16_384 * 128;

/// A board with its chip and its presets of constants.
#[derive(Debug, Clone)]
pub struct Target {
    name: String,
    chips_x: u32,
    chips_y: u32,
    chip: Chip,
    constants: Vec<Constants>,
    is_changed: bool,
}

impl Target {
    /// Returns this target, marked as changed from the target of its name.
    #[must_use]
    pub fn changed(self) -> Self {
        Target { is_changed: true, ..self }
    }

    /// Whether its board or chip differs from the target of its name.
    pub fn is_changed(&self) -> bool {
        self.is_changed
    }

    /// Changes every preset of constants.
    ///
    /// # Errors
    /// The errors of `change`, and of [`Constants::check`] for a changed preset.
    pub fn change_constants(&mut self, change: impl Fn(&mut Constants) -> Result<()>) -> Result<()> {
        for constants in &mut self.constants {
            change(constants)?;
            constants.check(&SourceText::new("", ""))?;
        }
        Ok(())
    }

    /// A board from its parts.
    ///
    /// # Errors
    /// A diagnostic when a size is 0 or too large, or no preset is given.
    pub fn new(file: &TargetFile, source: &SourceText, chip: Chip, mut constants: Vec<Constants>) -> Result<Self> {
        fn wrong(message: String) -> Diagnostic {
            Diagnostic::new("target.size", message)
        }
        for (what, side) in [("chips_x", &file.chips_x), ("chips_y", &file.chips_y)] {
            if !(1..=128).contains(&side.value) {
                return Err(wrong(format!("{what} {} is outside 1..=128", side.value)).at(source, side.span));
            }
        }
        chip.check_sizes()?;
        // The number of cores then fits its type, for any sides of the board.
        let cores = u64::from(file.chips_x.value) * u64::from(file.chips_y.value) * u64::from(chip.cores);
        if cores > MOST_CORES {
            return Err(
                wrong(format!("the board has {cores} cores, the limit is {MOST_CORES}")).at(source, file.chips_x.span)
            );
        }
        if let Some(power) = &file.unit_power {
            for preset in &mut constants {
                preset.unit_power = power.clone();
                preset.check(source)?;
            }
        }
        if constants.is_empty() {
            return Err(
                Diagnostic::new("target.constants", "the target has no preset of constants").in_file(source.path())
            );
        }
        Ok(Target {
            name: file.name.clone(),
            chips_x: file.chips_x.value,
            chips_y: file.chips_y.value,
            chip,
            constants,
            is_changed: false,
        })
    }

    /// Returns this board with other limits of a core, for tests and for what-if questions.
    #[must_use]
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.chip.limits = limits;
        self
    }

    /// Returns this board with another chip, for tests and for what-if questions.
    #[must_use]
    pub fn with_chip(mut self, chip: Chip) -> Self {
        self.chip = chip;
        self
    }

    /// Returns this board with one more preset of constants, in front of the others.
    #[must_use]
    pub fn with_preset(mut self, constants: Constants) -> Self {
        self.constants.retain(|preset| preset.name != constants.name);
        self.constants.insert(0, constants);
        self
    }

    /// The target's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its chip.
    pub fn chip(&self) -> &Chip {
        &self.chip
    }

    /// The limits of a core.
    pub fn limits(&self) -> &Limits {
        &self.chip.limits
    }

    /// Errors of predictions by a preset on this hardware; empty where the preset was measured on
    /// other hardware.
    pub fn errors<'c>(&self, preset: &'c Constants) -> &'c [ClassError] {
        if self.is_measured_by(preset) { &preset.errors } else { &[] }
    }

    /// Whether a preset was measured on this chip, or on one that differs only in limits of a core.
    pub fn is_measured_by(&self, preset: &Constants) -> bool {
        let own = [Some(self.chip.hardware()), self.chip.measured_as.as_deref()];
        own.contains(&Some(preset.hardware.as_str()))
    }

    /// Presets of constants; the first is the default.
    pub fn constants(&self) -> &[Constants] {
        &self.constants
    }

    /// Number of chips.
    pub fn chips(&self) -> u32 {
        self.chips_x * self.chips_y
    }

    /// Number of chips from west to east.
    pub fn chips_x(&self) -> u32 {
        self.chips_x
    }

    /// Number of chips from north to south.
    pub fn chips_y(&self) -> u32 {
        self.chips_y
    }

    /// Number of cores of all chips.
    pub fn cores(&self) -> u32 {
        self.chips() * self.chip.cores
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spanned::parse;

    fn read<T: serde::de::DeserializeOwned>(path: &str) -> (SourceText, T) {
        let text = std::fs::read_to_string(format!("{}/../../mapping/{path}", env!("CARGO_MANIFEST_DIR"))).unwrap();
        let source = SourceText::new(path, text);
        let value = parse(&source, "target.syntax").unwrap_or_else(|problem| panic!("{problem}"));
        (source, value)
    }

    #[test]
    fn a_source_without_a_limit_is_refused_where_it_stands() {
        let (source, _) = read::<Chip>("chips/tiny.ron");
        let changed =
            SourceText::new("changed.ron", source.text().replacen("limit: \"axons_in\"", "limit: \"axon_in\"", 1));
        let problem = parse::<Chip>(&changed, "target.syntax").unwrap().check(&changed).unwrap_err();
        assert_eq!(problem.message, "chip tiny: there is no limit axon_in");
        assert!(problem.position().is_some());
    }

    #[test]
    fn a_board_of_too_many_cores_is_refused() {
        let (source, file) = read::<TargetFile>("targets/tiny.ron");
        let file = TargetFile { chips_x: 128.into(), chips_y: 128.into(), ..file };
        let (_, chip) = read::<Chip>("chips/loihi1.ron");
        let (_, constants) = read::<Constants>("constants/loihi1-evidence.ron");
        assert_eq!(
            u64::from(Target::new(&file, &source, chip.clone(), vec![constants.clone()]).unwrap().cores()),
            MOST_CORES
        );
        let chip = Chip { width: 64, height: 64, cores_per_tile: 64, cores: 262_144, ..chip };
        assert_eq!(Target::new(&file, &source, chip, vec![constants]).unwrap_err().code, "target.size");
    }
}
