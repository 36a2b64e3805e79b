//! Target files with the chip and the constants that they name.
//!
//! Input: a path or the name of a shipped target. Output: a [`Target`]. The parts of a target file
//! are looked up in its folder, then in `../chips` and `../constants`, then among the shipped ones.

use std::collections::BTreeSet;
use std::path::Path;

use super::changes;
use super::network::NetworkFile;
use super::shipped::{self, Origin, Shipped};
use super::text::{read_text, sibling_path};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::base::names::did_you_mean;
use nsim_ir::hardware::constants::{Constants, ConstantsChanges};
use nsim_ir::hardware::{Chip, Target, TargetChanges, TargetFile};
use nsim_ir::locate::value;
use nsim_ir::neurons::NeuronKind;
use nsim_ir::resource::Limits;
use nsim_ir::spanned::{Spanned, parse};

/// Loads a target: a path, `-`, or a shipped name.
///
/// # Errors
/// `target.*`, `chip.*`, `constants.*`, `io.*`.
pub fn load_target(argument: &str) -> Result<Target> {
    let (source, origin) = shipped::path_or_shipped_text(argument, shipped::TARGETS, "target", "target.unknown")?;
    let mut target = target(&source, origin)?;
    if let Some(fields) = changes::target_fields()? {
        // A change is parsed like a target file that has this target as its base.
        let text = format!("Target(base: {:?}, name: {:?}, {fields})", argument, target.name());
        let source = SourceText::new(SET, text);
        target = on_base(&source, Origin::Shipped, parse(&source, "set.value")?, &target)?;
    }
    target.change_constants(changes::constants)?;
    Ok(target)
}

/// The target `named`, else the model's or the usual one. Where an unnamed target lacks a kind of
/// the model's neurons, returns the first shipped target that has all kinds, and a sentence about
/// it. Errors are those of [`load_target`].
pub fn target_with_neurons(file: &NetworkFile, named: Option<&str>) -> Result<(Target, Option<String>)> {
    let target = load_target(file.target_or_usual(named))?;
    let neurons = file.populations.iter().filter(|population| population.loihi.is_some());
    let kinds: BTreeSet<NeuronKind> = neurons.map(|population| population.kind).collect();
    if named.is_some() || has_kinds(&target, &kinds) {
        return Ok((target, None));
    }
    let Some(other) = shipped_with_kinds(&kinds).into_iter().next() else { return Ok((target, None)) };
    let lacks = format!(
        "{}, the target of nsim map, does not have the neurons of the network: this result is for {}",
        target.name(),
        other.name()
    );
    Ok((other, Some(lacks)))
}

fn has_kinds(target: &Target, kinds: &BTreeSet<NeuronKind>) -> bool {
    kinds.iter().all(|kind| target.chip().neuron_kinds.contains(&kind.family()))
}

/// Shipped targets whose compartments can be of all these kinds.
pub fn shipped_with_kinds(kinds: &BTreeSet<NeuronKind>) -> Vec<Target> {
    let targets = shipped::TARGETS.iter().filter_map(|shipped| load_target(shipped.name).ok());
    targets.filter(|target| has_kinds(target, kinds)).collect()
}

/// Loads a target from its text. Errors are those of [`load_target`].
pub fn target(source: &SourceText, origin: Origin) -> Result<Target> {
    target_within(source, origin, DEEPEST)
}

/// The path in messages about `--set`.
const SET: &str = "<--set>";

/// The greatest number of bases below a target, and of presets below a preset.
const DEEPEST: u32 = 8;

fn target_within(source: &SourceText, origin: Origin, deepest: u32) -> Result<Target> {
    if value(source.text(), "base").is_some() {
        return changed(source, origin, deepest);
    }
    let file: TargetFile = parse(source, "target.syntax")?;
    let chip_source = part(source, origin, &file.chip, "chips", "chip", shipped::CHIPS)?;
    let chip = parse_chip(&chip_source)?;
    let constants = presets(source, origin, &file.constants)?;
    // A problem without a place in the target file comes from the chip's file.
    Target::new(&file, source, chip, constants).map_err(|problem| problem.or_in_file(chip_source.path()))
}

/// Reads a target that changes its base.
fn changed(source: &SourceText, origin: Origin, deepest: u32) -> Result<Target> {
    let changes: TargetChanges = parse(source, "target.syntax")?;
    let base_source = part(source, origin, &changes.base, "targets", "target", shipped::TARGETS)?;
    let is_shipped = shipped::TARGETS.iter().any(|shipped| Path::new(shipped.path) == base_source.path());
    let base_origin = if is_shipped { Origin::Shipped } else { Origin::File };
    let Some(deepest) = deepest.checked_sub(1) else {
        let message = format!("targets have more than {DEEPEST} levels of base");
        return Err(Diagnostic::new("target.base", message).at(source, changes.base.span));
    };
    let base = target_within(&base_source, base_origin, deepest)?;
    on_base(source, origin, changes, &base)
}

/// A target with changes to its base.
fn on_base(source: &SourceText, origin: Origin, changes: TargetChanges, base: &Target) -> Result<Target> {
    let stem = source.path().file_stem().map_or_else(|| "target".into(), |stem| stem.to_string_lossy().into_owned());
    let name = changes.name.clone().unwrap_or(stem);
    // A chip that `--set` changes has no file that could name it.
    let own_name = match source.path() == Path::new(SET) {
        true => format!("{}, changed", base.chip().hardware()),
        false => name.clone(),
    };
    let pools: Vec<&str> = base.limits().pools.iter().map(|pool| pool.name.as_str()).collect();
    if let Some(wrong) = changes.limits.pools.keys().find(|name| !pools.contains(&name.as_str())) {
        let names = [&pools[..], &Limits::NAMES].concat();
        let meant = did_you_mean(wrong, names.iter().copied());
        return Err(Diagnostic::new("target.limit", format!("{} has no limit {wrong}", base.name()))
            .help(format!("{meant}limits are {}", names.join(", ")))
            .in_file(source.path()));
    }
    let chip = changes.chip(base.chip().clone(), &own_name);
    chip.check(source)?;
    if changes.cores_per_tile.is_none() && chip.cores_per_tile != base.chip().cores_per_tile {
        let (cores, held) = (chip.cores, chip.cores_per_tile);
        tracing::warn!(
            "{name}: its {cores} cores make tiles of {held}; for other tiles, give width, height or cores_per_tile"
        );
    }
    let differs = chip.name == own_name || changes.chips_x.is_some() || changes.chips_y.is_some();
    let is_changed = name == base.name() && (differs || base.is_changed());
    let constants = match &changes.constants {
        None => base.constants().to_vec(),
        Some(names) => presets(source, origin, names)?,
    };
    let file = TargetFile {
        name,
        notes: changes.notes.unwrap_or_default(),
        chip: chip.name.clone().into(),
        chips_x: changes.chips_x.unwrap_or_else(|| base.chips_x().into()),
        chips_y: changes.chips_y.unwrap_or_else(|| base.chips_y().into()),
        constants: Vec::new(),
        unit_power: None,
    };
    let target = Target::new(&file, source, chip, constants).map_err(|problem| problem.or_in_file(source.path()))?;
    Ok(if is_changed { target.changed() } else { target })
}

fn presets(source: &SourceText, origin: Origin, names: &[Spanned<String>]) -> Result<Vec<Constants>> {
    let mut presets = Vec::new();
    for name in names {
        let text = part(source, origin, name, "constants", "preset of constants", shipped::CONSTANTS)?;
        presets.push(parse_constants(&text)?);
    }
    Ok(presets)
}

/// A chip from its text.
///
/// # Errors
/// `chip.syntax`, and the errors of [`Chip::check`].
pub fn parse_chip(source: &SourceText) -> Result<Chip> {
    let chip: Chip = parse(source, "chip.syntax")?;
    chip.check(source)?;
    Ok(chip)
}

/// A preset of constants from its text, which may list only differences from another preset
/// (`base`).
///
/// # Errors
/// `constants.syntax`, `constants.base`, and the errors of [`Constants::check`].
pub fn parse_constants(source: &SourceText) -> Result<Constants> {
    constants_within(source, DEEPEST)
}

fn constants_within(source: &SourceText, deepest: u32) -> Result<Constants> {
    let is_shipped = shipped::CONSTANTS.iter().any(|shipped| Path::new(shipped.path) == source.path());
    let stem = || source.path().file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let mut constants = if value(source.text(), "base").is_some() {
        let changes: ConstantsChanges = parse(source, "constants.syntax")?;
        let Some(deepest) = deepest.checked_sub(1) else {
            let message = format!("constants have more than {DEEPEST} levels of base");
            return Err(Diagnostic::new("constants.base", message).at(source, changes.base.span));
        };
        let origin = if is_shipped { Origin::Shipped } else { Origin::File };
        let base = part(source, origin, &changes.base, "constants", "preset of constants", shipped::CONSTANTS)?;
        let base = constants_within(&base, deepest)?;
        let name = changes.name.clone().or(stem()).unwrap_or_else(|| base.name.clone());
        changes.applied(&base, name)
    } else {
        let mut constants: Constants = parse(source, "constants.syntax")?;
        if !is_shipped {
            // A user's constants have no measured prediction errors.
            constants.errors.clear();
        }
        constants
    };
    if !is_shipped && shipped::CONSTANTS.iter().any(|shipped| shipped.name == constants.name) {
        // A file with the name of a shipped preset gets another name.
        constants.name =
            stem().filter(|stem| *stem != constants.name).unwrap_or(format!("{}, changed", constants.name));
    }
    constants.check(source).map_err(|problem| problem.or_in_file(source.path()))?;
    Ok(constants)
}

/// Loads a preset of constants: a path, `-`, or a shipped name.
///
/// # Errors
/// `constants.*`, `io.*`.
pub fn load_constants(argument: &str) -> Result<Constants> {
    let (source, _) =
        shipped::path_or_shipped_text(argument, shipped::CONSTANTS, "preset of constants", "constants.unknown")?;
    let mut constants = parse_constants(&source)?;
    changes::constants(&mut constants)?;
    Ok(constants)
}

/// The text of a chip, base or preset that a target or preset names.
fn part(
    source: &SourceText,
    origin: Origin,
    name: &Spanned<String>,
    folder: &str,
    kind: &str,
    table: &'static [Shipped],
) -> Result<SourceText> {
    if origin == Origin::File {
        let file = format!("{}.ron", name.value);
        for path in [sibling_path(source.path(), &file), sibling_path(source.path(), &format!("../{folder}/{file}"))] {
            // A target and its chip may have one name.
            let itself =
                path.canonicalize().is_ok_and(|path| source.path().canonicalize().is_ok_and(|own| own == path));
            if Path::is_file(&path) && !itself {
                return read_text(&path);
            }
        }
    }
    match Shipped::find(table, &name.value) {
        Some(shipped) => Ok(shipped.source()),
        None => {
            let names: Vec<&str> = table.iter().map(|shipped| shipped.name).collect();
            let help = match name.value.strip_suffix(".ron") {
                Some(stem) => format!("write the name without .ron: {stem:?}"),
                None => {
                    format!("shipped files: {}; or put {}.ron next to the target file", names.join(", "), name.value)
                }
            };
            Err(Diagnostic::new("target.part", format!("there is no {kind} named '{}'", name.value))
                .help(help)
                .at(source, name.span))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::hardware::constants::FigureClass;
    use nsim_ir::resource::Resource;

    const CONSTANTS: &str =
        "Constants(base: \"davies2018\",\n hop_ns_energy: (value: 3, unit: pJ, source: \"s\", status: assumed))";

    fn chip() -> &'static str {
        Shipped::find(shipped::CHIPS, "tiny").unwrap().text
    }

    fn load(target: &str, chip: &str, constants: &str) -> Result<Target> {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [("t.ron", target), ("one.ron", chip), ("c.ron", constants)] {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        load_target(folder.path().join("t.ron").to_str().unwrap())
    }

    const TARGET: &str =
        "Target(name: \"t\", notes: \"\", chip: \"one\",\n chips_x: 2, chips_y: 1, constants: [\"c\"])";

    #[test]
    fn every_shipped_target_loads_and_has_its_published_size() {
        let sizes = shipped::TARGETS.iter().map(|shipped| {
            let target = load_target(shipped.name).unwrap_or_else(|error| panic!("{error}"));
            assert_eq!(target.name(), shipped.name);
            (shipped.name, target.chips(), target.cores())
        });
        let published = [
            ("tiny", 2, 8),
            ("loihi1-chip", 1, 128),
            ("kapoho-bay", 2, 256),
            ("nahuku-32", 32, 4096),
            ("pohoiki-springs", 768, 98_304),
            ("oheo-gulch", 1, 128),
            ("oheo-gulch-2022", 1, 128),
            ("kapoho-point", 8, 1024),
            ("hala-point", 1152, 147_456),
            ("boundless", 1, 16_384),
        ];
        assert_eq!(sizes.collect::<Vec<_>>(), published);
    }

    #[test]
    fn every_limit_and_every_constant_of_a_shipped_board_names_its_source() {
        for name in ["tiny", "loihi1-chip", "kapoho-bay", "nahuku-32", "pohoiki-springs"] {
            let target = load_target(name).unwrap();
            let limits = serde_json::to_value(target.limits()).unwrap();
            let fields: Vec<&String> = limits.as_object().unwrap().keys().collect();
            // Loihi 1 counts words in place of synapses, and none of neurons.
            let of_loihi2 = ["stored_synapses", "neuron_words", "axon_map_words", "groups", "neuron_sizes"];
            let named: Vec<&str> = Limits::NAMES.into_iter().filter(|name| !of_loihi2.contains(name)).collect();
            assert_eq!(fields, named);
            let sources = &target.chip().limit_sources;
            for field in fields {
                let of_field: Vec<_> = sources.iter().filter(|entry| entry.limit.value == *field).collect();
                assert_eq!(of_field.len(), 1, "{name}: {field}");
                assert!(!of_field[0].source.is_empty(), "{name}: {field}");
            }
            assert_eq!(
                target.constants().iter().map(|c| c.name.as_str()).collect::<Vec<_>>(),
                ["loihi1-evidence", "vtsnn-calibrated", "sanafe-calibrated", "davies2018"]
            );
            for constants in target.constants() {
                assert!(constants.list().iter().all(|(_, constant)| !constant.source.is_empty()));
                assert!(constants.barrier.iter().all(|entry| !entry.time.source.is_empty()));
            }
        }
    }

    #[test]
    fn parts_beside_the_file_are_found() {
        let target = load(TARGET, chip(), CONSTANTS).unwrap();
        assert_eq!((target.name(), target.cores(), target.constants()[0].hop_ns_energy.value.value), ("t", 8, 3.0));
    }

    #[test]
    fn problems_point_into_the_file_that_has_them() {
        let error = load(TARGET, &chip().replace("cores: 4", "cores: 5"), CONSTANTS).unwrap_err();
        assert_eq!((error.code, error.file().unwrap().ends_with("one.ron")), ("target.size", true));
        let error = load(TARGET, &chip().replace("Nengo", "Tight"), CONSTANTS).unwrap_err();
        let line = chip()[..chip().find("Nengo").unwrap()].lines().count();
        assert_eq!((error.code, error.position().unwrap().line), ("chip.syntax", line), "{error}");
        for (from, to, code) in [("pJ", "ns", "target.unit"), ("value: 3", "value: -3", "target.constant")] {
            let error = load(TARGET, chip(), &CONSTANTS.replace(from, to)).unwrap_err();
            assert_eq!((error.code, error.position().unwrap().line), (code, 2), "{error}");
        }
        assert_eq!(load_target("nahuku-33").unwrap_err().code, "target.unknown");
    }

    #[test]
    fn a_preset_says_only_what_differs_from_another_and_keeps_the_errors_of_the_rest() {
        let read = |text: &str| parse_constants(&SourceText::new("mine.ron", text.to_string()));
        let value = "(value: 0.3, unit: mW, source: \"me\", status: assumed)";
        let mine = read(&format!("Constants(base: \"loihi1-evidence\", core_static_power: {value})")).unwrap();
        let base = load_constants("loihi1-evidence").unwrap();
        assert_eq!((mine.name.as_str(), mine.core_static_power.value.value), ("mine", 0.3));
        assert_eq!(mine.injection_time.value.value, base.injection_time.value.value);
        let classes = |of: &Constants| of.errors.iter().map(|error| error.class).collect::<Vec<_>>();
        let kept: Vec<_> = classes(&base).into_iter().filter(|class| *class != FigureClass::Static).collect();
        assert_eq!(classes(&mine), kept);
        // A copy gets another name and has no measured errors.
        let copy = read(Shipped::find(shipped::CONSTANTS, "loihi1-evidence").unwrap().text).unwrap();
        assert_eq!((copy.name.as_str(), copy.errors.len()), ("mine", 0));
        assert_eq!(read("Constants(base: \"loihi2\")").unwrap_err().code, "target.part");
    }

    #[test]
    fn a_chip_that_a_file_changes_goes_by_its_own_name_and_has_no_errors_of_loihi() {
        let read = |text: &str| target(&SourceText::new("own.ron", text.to_string()), Origin::File).unwrap();
        let board = read("Target(base: \"loihi1-chip\", chips_x: 2)");
        let own = read("Target(base: \"loihi1-chip\", limits: (compartments: 2048), x86_cores: 0)");
        assert_eq!((board.chip().hardware(), own.chip().hardware()), ("loihi", "own"));
        assert_eq!((board.errors(&board.constants()[0]).len(), own.errors(&own.constants()[0]).len()), (7, 0));
        assert_eq!(own.chip().x86_cores_in_use, 0);
    }

    #[test]
    fn a_target_says_only_what_differs_from_another() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            load_target(path.to_str().unwrap())
        };
        let wide = write(
            "wide.ron",
            "// Not a base: this is a remark.\nTarget(base: \"loihi1-chip\", cores_per_tile: 8, limits: (axons_out: \
             8192))",
        )
        .unwrap();
        let plain = load_target("loihi1-chip").unwrap();
        assert_eq!((wide.name(), wide.cores(), wide.chip().cores_per_tile), ("wide", 256, 8));
        assert_eq!(wide.limits(), &plain.limits().clone().with(Resource::AxonsOut, 8192));
        assert_eq!(wide.constants().len(), plain.constants().len());
        assert!(wide.chip().limit_sources.iter().all(|entry| entry.limit.value != "axons_out"));
        let stated = "Target(base: \"wide\", limits: (axons_out: 9000), limit_sources: [(limit: \"axons_out\", \
                      source: \"my layout\", status: assumed), (limit: \"axons_in\", source: \"my layout\", \
                      status: assumed)])";
        let stated = write("stated.ron", stated).unwrap();
        let mine: Vec<_> = stated.chip().limit_sources.iter().filter(|entry| entry.source == "my layout").collect();
        assert_eq!((mine.len(), stated.chip().limit_sources.len()), (2, wide.chip().limit_sources.len() + 1));
        let board = "Target(base: \"wide\", name: \"board\", chips_x: 3, constants: [\"davies2018\"])";
        let board = write("board.ron", board).unwrap();
        assert_eq!((board.name(), board.cores(), board.constants().len()), ("board", 768, 1));
        assert_eq!(board.limits(), wide.limits());
        for (text, code, word) in [
            ("Target(base: \"loihi7\")", "target.part", "loihi7"),
            ("Target(base: \"tiny.ron\")", "target.part", "without .ron: \"tiny\""),
            ("Target(base: \"tiny\", limits: (pools: (memory: 5)))", "target.limit", "no limit memory"),
            ("Target(base: \"tiny\", limits: (axons: 1))", "target.syntax", "axons_out"),
            ("Target(base: \"tiny\", chips_x: 500)", "target.size", "500"),
            ("Target(base: \"loihi1-chip\", cores_per_tile: 4, cores_per_chip: 256)", "target.size", "256"),
            ("Target(base: \"loihi1-chip\", cores_per_chip: 129, width: 8)", "target.size", "have 128 places"),
        ] {
            let error = write("wrong.ron", text).unwrap_err();
            assert_eq!(error.code, code, "{text}: {error}");
            assert!(format!("{error} {}", error.help.clone().unwrap_or_default()).contains(word), "{text}: {error}");
        }
        write("a.ron", "Target(base: \"b\")").unwrap_err();
        assert_eq!(write("b.ron", "Target(base: \"a\")").unwrap_err().code, "target.base");
    }
}
