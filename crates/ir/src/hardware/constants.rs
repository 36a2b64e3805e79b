//! Constants of energy, time and power, in presets (`mapping/constants`). Each figure has a unit, a
//! source and a status, so that a report can name its origin.
//!
//! [`Constants::check`] checks units, ranges and sources. `nsim_cost` defines the counts that a
//! constant is multiplied by.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::base::names::named_variants;
pub use crate::base::units::Unit;
use crate::spanned::Spanned;

/// Confidence in a constant, the most trusted first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Status {
    /// Printed by its source.
    #[serde(alias = "Published")]
    Published,
    /// Fitted to measurements, as the source says.
    #[serde(alias = "Calibrated")]
    Calibrated,
    /// Not known; chosen, with the reason in the source.
    #[serde(alias = "Assumed")]
    Assumed,
    /// Absent from the preset, and counted as 0. Files cannot give it.
    #[serde(skip_deserializing, rename = "not given")]
    NotGiven,
}

named_variants!(Status {
    Published = "published", Calibrated = "calibrated", Assumed = "assumed"; Status::NotGiven => "not given"
});

/// The origin of a value from the command line, in [`Constants::stated_in`].
pub const SET_OPTION: &str = "--set";

/// The name of the barrier times among constants.
pub const BARRIER: &str = "barrier";

/// The value of a constant by one group of authors.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finding {
    /// The authors, as workloads name them: predictions of their work exclude this value.
    pub group: String,
    /// The value, in the constant's unit.
    pub value: f64,
    /// Place of publication, or derivation from published figures.
    pub source: String,
}

named_variants! {
    /// Figures whose prediction errors are correlated, so that one factor bounds them.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize, Serialize)]
    #[serde(rename_all(serialize = "snake_case"))]
    pub enum FigureClass {
        /// Static power of neuron cores or of x86 cores.
        Static = "static",
        /// Dynamic power of x86 cores.
        X86Dynamic = "x86_dynamic",
        /// Energy of the neuron cores' events in a step.
        CoreEnergy = "core_energy",
        /// Dynamic power of the neuron cores' events, as fast as possible.
        CoreDynamic = "core_dynamic",
        /// Power of a whole board.
        Rails = "rails",
        /// Power that x86 cores at work add to a board.
        X86Rails = "x86_rails",
        /// Time of a step.
        Time = "time",
    }
}

/// Prediction error of a class, with each work predicted without its authors' findings.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ClassError {
    /// The class of figures.
    pub class: FigureClass,
    /// Number of works that print such figures. It is 0 where the factor bounds the constants
    /// themselves, within the range that their sources leave open.
    pub works: u32,
    /// Bound on the error factor of a new work, with a chance of 80 %, if works were counted.
    pub within_80: f64,
    /// The bound with a chance of 90 %; absent where works are too few.
    #[serde(default)]
    pub within_90: Option<f64>,
}

/// Rule by which the parts of a core's work and the mesh make the time of a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum StepForm {
    /// Parts follow each other: the sum, (9), (11) and (17) of `docs/energy.md`.
    #[default]
    Sum,
    /// Parts overlap: the greatest of them, (21), after Timcheck et al. 2026 (arXiv 2601.10035).
    Greatest,
}

/// Steps in which the process of the x86 cores takes its turn.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum TurnRule {
    /// Every step.
    #[default]
    EachStep,
    /// Steps with input from the host.
    WithInput,
}

/// A number with its origin.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Constant {
    /// The number, in `unit`.
    pub value: Spanned<f64>,
    /// Its unit.
    pub unit: Unit,
    /// The least and the greatest value that its sources leave open, in `unit`.
    #[serde(default)]
    pub bounds: Option<(f64, f64)>,
    /// Paper and table, or repository and file.
    pub source: String,
    /// Confidence in it.
    pub status: Status,
    /// The values by each group of authors: `value` is their median (as of [`median`]), or one of
    /// them that the others confirm.
    #[serde(default)]
    pub findings: Vec<Finding>,
}

impl Constant {
    fn not_given(unit: Unit) -> Self {
        let source = "not given by this preset".to_string();
        Constant { value: 0.0.into(), unit, bounds: None, source, status: Status::NotGiven, findings: Vec::new() }
    }

    /// The median of the findings of all groups but this one; `None` when there are none.
    pub fn without(&self, group: &str) -> Option<f64> {
        let others = self.findings.iter().filter(|finding| finding.group != group);
        median(others.map(|finding| finding.value).collect())
    }

    fn no_energy() -> Self {
        Constant::not_given(Unit::pJ)
    }

    fn no_time() -> Self {
        Constant::not_given(Unit::ns)
    }

    fn no_host_time() -> Self {
        Constant::not_given(Unit::us)
    }

    fn no_power() -> Self {
        Constant::not_given(Unit::mW)
    }

    fn no_ratio() -> Self {
        Constant::not_given(Unit::ratio)
    }
}

/// The median, or the geometric mean of two middle values; `None` without values.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        1 => Some(values[middle]),
        _ => Some((values.get(middle.checked_sub(1)?)? * values[middle]).sqrt()),
    }
}

/// Time of a barrier over tiles or cores in use of a chip; between entries it is interpolated
/// linearly.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BarrierTime {
    /// Tiles in use; 0 in presets whose barrier goes by cores.
    #[serde(default)]
    pub tiles: u64,
    /// Cores in use; 0 in presets whose barrier goes by tiles.
    #[serde(default)]
    pub cores: u64,
    /// The time.
    pub time: Constant,
}

impl BarrierTime {
    /// Number and name of the parts.
    pub fn parts(&self) -> (u64, &'static str) {
        if self.cores > 0 { (self.cores, "cores") } else { (self.tiles, "tiles") }
    }
}

/// A figure of a source that no count of a run multiplies, stored for the record.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnusedConstant {
    /// Its name.
    pub name: String,
    /// The figure.
    pub constant: Constant,
    /// Reason why nothing is charged for it.
    pub why: String,
}

/// Calls a macro with every single-valued constant and its unit; tables with a value for each are
/// made from this list alone. A constant with a default may be absent: it is then 0 and
/// [`Status::NotGiven`].
#[macro_export]
macro_rules! for_each_constant {
    ($make:ident) => {
        $make! {
            /// Energy of a synaptic event of a dense list, pJ.
            synapse_dense_energy: pJ,
            /// Energy of a synaptic event of a sparse list, pJ.
            synapse_sparse_energy: pJ,
            /// Energy of the rule of a plastic synapse, evaluated once, pJ.
            synapse_update_energy: pJ = "Constant::no_energy",
            /// Energy of a dendritic accumulator read in a step, pJ.
            dendrite_energy: pJ = "Constant::no_energy",
            /// Energy of a compartment visited in a step, pJ.
            compartment_energy: pJ,
            /// Additional energy of a compartment that is not idle, pJ.
            compartment_active_energy: pJ,
            /// Additional energy of a compartment that spikes, pJ.
            spike_energy: pJ = "Constant::no_energy",
            /// Energy of a message sent, pJ.
            axon_out_energy: pJ = "Constant::no_energy",
            /// Energy of a message received, pJ.
            axon_in_energy: pJ = "Constant::no_energy",
            /// Energy of a message that stays within its tile, pJ.
            local_hop_energy: pJ = "Constant::no_energy",
            /// Energy of a link crossed east or west, pJ.
            hop_ew_energy: pJ,
            /// Energy of a link crossed north or south, pJ.
            hop_ns_energy: pJ,
            /// Additional energy of a link between chips, pJ.
            hop_chip_energy: pJ = "Constant::no_energy",
            /// Time of a synaptic event of a dense list, ns.
            synapse_dense_time: ns,
            /// Time of a synaptic event of a sparse list, ns.
            synapse_sparse_time: ns,
            /// Time of the rule of a plastic synapse, evaluated once, ns.
            synapse_update_time: ns = "Constant::no_time",
            /// Time of a compartment visited in a step, ns.
            compartment_time: ns,
            /// Additional time of a compartment that is not idle, ns.
            compartment_active_time: ns,
            /// Time of a neuron whose program the model states, in place of `compartment_time`, ns.
            microcode_time: ns = "Constant::no_time",
            /// Additional time of a compartment that spikes, ns.
            spike_time: ns = "Constant::no_time",
            /// Time of a message sent, ns.
            axon_out_time: ns = "Constant::no_time",
            /// Time of a message received, ns.
            axon_in_time: ns = "Constant::no_time",
            /// Time of a message that stays within its tile, ns.
            local_hop_time: ns = "Constant::no_time",
            /// Time of a link crossed east or west, ns.
            hop_ew_time: ns,
            /// Time of a link crossed north or south, ns.
            hop_ns_time: ns,
            /// Additional time of a link between chips, ns.
            hop_chip_time: ns = "Constant::no_time",
            /// Time of a message on a link, which passes messages sequentially, ns.
            link_time: ns,
            /// Time of a message on a link between chips, ns.
            link_chip_time: ns,
            /// Messages that wait at a link before it blocks their sender.
            link_buffer: messages,
            /// Time of a spike from an x86 core to its chip, or of another word from the host, us.
            injection_time: us = "Constant::no_host_time",
            /// Time of the x86 cores' process in a step, with or without spikes, us.
            turn_time: us = "Constant::no_host_time",
            /// Time of a hop between chips, there and back, in a barrier, us.
            chip_hop_time: us = "Constant::no_host_time",
            /// Time of a 32-bit word that an x86 core sets when state is reset, ns.
            reset_word_time: ns = "Constant::no_time",
            /// Static power of a neuron core in use, as a profiler attributes it, mW.
            core_static_power: mW,
            /// Static power of a neuron core over the power of an x86 core; 0: x86 cores have none.
            x86_static_ratio: ratio = "Constant::no_ratio",
            /// Power of a chip's x86 clock, as soon as one of its x86 cores runs, mW.
            x86_clock_power: mW = "Constant::no_power",
            /// Power of an x86 core while it works, mW.
            x86_active_power: mW = "Constant::no_power",
            /// Fraction of a step in which an x86 core works that injects spikes.
            x86_injecting_share: ratio = "Constant::no_ratio",
            /// Leakage of a powered chip without its cores, mW. A profiler counts chips in use; the
            /// rails count all chips on the board.
            chip_static_power: mW = "Constant::no_power",
            /// Power of a chip on the board before a program is loaded, from the rails, mW.
            chip_boot_power: mW = "Constant::no_power",
            /// Power of an x86 core once a program is loaded, from the rails, mW.
            x86_on_power: mW = "Constant::no_power",
            /// Power that an x86 core at work adds, from the rails, mW.
            x86_rails_power: mW = "Constant::no_power",
            /// Power that a neuron core in use adds while it runs, from the rails, mW.
            core_rails_power: mW = "Constant::no_power",
            /// Power of the whole unit with its host side while nothing runs, mW a chip on the
            /// board.
            unit_power: mW = "Constant::no_power",
        }
    };
}
pub use for_each_constant;

macro_rules! constants {
    ($($(#[$doc:meta])* $field:ident: $unit:ident $(= $default:literal)?,)*) => {
        /// A preset of energies, times and powers. Energies add up: a compartment that is visited,
        /// updated and spikes costs all three.
        #[derive(Debug, Clone, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Constants {
            /// The preset's name.
            pub name: String,
            /// Differences between the sources, and the choice of this preset.
            pub notes: String,
            /// The measured hardware, as chips name theirs: errors hold for no other.
            #[serde(default)]
            pub hardware: String,
            /// Errors of predictions with these constants, by class.
            #[serde(default)]
            pub errors: Vec<ClassError>,
            /// Rule for the time of a step.
            #[serde(default)]
            pub step: StepForm,
            /// Steps in which x86 cores take their turn.
            #[serde(default)]
            pub turn: TurnRule,
            /// Bounds in us of barriers over numbers of parts without a measurement.
            #[serde(default)]
            pub barrier_bounds: Option<(f64, f64)>,
            /// Barrier times by tiles or cores in use, ascending.
            pub barrier: Vec<BarrierTime>,
            /// Figures of these sources that enter no sum.
            #[serde(default)]
            pub unused: Vec<UnusedConstant>,
            /// By the name of a constant that this preset does not state: the preset that states
            /// it, or `--set`.
            #[serde(skip)]
            pub stated_in: BTreeMap<&'static str, String>,
            /// Names of constants from a base that is a preset of other hardware.
            #[serde(skip)]
            pub borrowed: BTreeSet<&'static str>,
            $($(#[$doc])* $(#[serde(default = $default)])? pub $field: Constant,)*
        }
        /// A preset that states only differences from a base preset.
        #[derive(Debug, Clone, Deserialize)]
        #[serde(deny_unknown_fields, rename = "Constants")]
        pub struct ConstantsChanges {
            /// The base preset: a shipped one, or a file next to this one.
            pub base: Spanned<String>,
            /// The preset's name; the name of its file unless given.
            pub name: Option<String>,
            /// A description.
            #[serde(default)]
            pub notes: String,
            /// Its hardware, where it differs from the base's.
            pub hardware: Option<String>,
            /// Errors of predictions, in place of the base's.
            pub errors: Option<Vec<ClassError>>,
            /// Rule for the time of a step, where it differs from the base's.
            pub step: Option<StepForm>,
            /// Steps in which x86 cores take their turn, where they differ from the base's.
            pub turn: Option<TurnRule>,
            /// Bounds in us of barriers over numbers of parts without a measurement.
            pub barrier_bounds: Option<(f64, f64)>,
            /// Barrier times, in place of the base's.
            pub barrier: Option<Vec<BarrierTime>>,
            $($(#[$doc])* pub $field: Option<Constant>,)*
        }

        impl ConstantsChanges {
            /// The base with the changes. It loses the errors of figures that follow from a changed
            /// constant, and all errors if the hardware differs.
            #[must_use]
            pub fn applied(self, base: &Constants, name: String) -> Constants {
                let mut constants = Constants { name, notes: self.notes, ..base.clone() };
                constants.hardware = self.hardware.unwrap_or(constants.hardware);
                let foreign = constants.hardware != base.hardware && !base.hardware.is_empty();
                let inherited = |stated_in: &mut BTreeMap<_, _>, name| {
                    stated_in.entry(name).or_insert_with(|| base.name.clone());
                };
                match self.barrier {
                    Some(barrier) => {
                        constants.barrier = barrier;
                        constants.stated_in.remove(BARRIER);
                        constants.forget_errors(&[FigureClass::Time]);
                    }
                    None => inherited(&mut constants.stated_in, BARRIER),
                }
                $(match self.$field {
                    Some(constant) => {
                        constants.$field = constant;
                        constants.stated_in.remove(stringify!($field));
                        constants.borrowed.remove(stringify!($field));
                        constants.forget_errors(classes_of(stringify!($field)));
                    }
                    None => {
                        inherited(&mut constants.stated_in, stringify!($field));
                        if foreign && constants.$field.status != Status::NotGiven {
                            constants.borrowed.insert(stringify!($field));
                        }
                    }
                })*
                constants.step = self.step.unwrap_or(constants.step);
                constants.turn = self.turn.unwrap_or(constants.turn);
                constants.barrier_bounds = self.barrier_bounds.or(constants.barrier_bounds);
                if constants.hardware != base.hardware {
                    constants.errors.clear();
                }
                constants.errors = self.errors.unwrap_or(constants.errors);
                constants
            }
        }

        impl Constants {
            /// Whether bounds of the constants themselves bound figures, in place of errors.
            pub fn is_bounded(&self) -> bool {
                let barriers = self.barrier.iter().map(|entry| &entry.time);
                self.list().into_iter().map(|(_, one)| one).chain(barriers).any(|one| one.bounds.is_some())
            }

            /// Returns the preset without the findings of a group of authors. A constant that only
            /// they found stays; a barrier that only they measured takes the time of the nearest
            /// other.
            #[must_use]
            pub fn without(&self, group: &str) -> Constants {
                let mut others = self.clone();
                for (name, constant) in self.list() {
                    if let (Some(own), Some(value)) = (others.get_mut(name), constant.without(group)) {
                        own.value = value.into();
                    }
                }
                let is_theirs = |entry: &BarrierTime| {
                    !entry.time.findings.is_empty() && entry.time.without(group).is_none()
                };
                for entry in others.barrier.iter_mut().filter(|entry| is_theirs(entry)) {
                    let parts = entry.parts().0;
                    let measured = self.barrier.iter().filter(|other| !is_theirs(other));
                    if let Some(nearest) = measured.min_by_key(|other| other.parts().0.abs_diff(parts)) {
                        entry.time = Constant { bounds: None, ..nearest.time.clone() };
                    }
                }
                others
            }

            /// Drops the errors of these classes, when their constants change.
            pub fn forget_errors(&mut self, classes: &[FigureClass]) {
                self.errors.retain(|error| !classes.contains(&error.class));
            }

            /// The names of all single-valued constants, in a fixed order.
            pub const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            /// Constants that only presets of Loihi 2 state. Tables list them where they are given:
            /// elsewhere nothing is charged for them.
            pub const ADDED: [&'static str; 3] = ["microcode_time", "core_rails_power", "unit_power"];

            /// A single-valued constant by its name, mutable.
            pub fn get_mut(&mut self, name: &str) -> Option<&mut Constant> {
                match name {
                    $(stringify!($field) => Some(&mut self.$field),)*
                    _ => None,
                }
            }

            /// Name and constant of every field that tables list, in a fixed order.
            pub fn listed(&self) -> impl Iterator<Item = (&'static str, &Constant)> {
                let is_listed = |(name, one): &(&str, &Constant)| {
                    one.status != Status::NotGiven || !Constants::ADDED.contains(name)
                };
                self.list().into_iter().filter(is_listed)
            }

            /// Name and constant of every single-valued field, in a fixed order.
            pub fn list(&self) -> Vec<(&'static str, &Constant)> {
                vec![$((stringify!($field), &self.$field),)*]
            }

            /// Checks units, ranges, sources, and the order of barrier times.
            ///
            /// # Errors
            /// A diagnostic at the first constant that is outside 0..=10^9, in another unit or
            /// without a source. Also for barrier times that are missing or not ascending.
            pub fn check(&self, source: &SourceText) -> Result<()> {
                $(check_constant(source, stringify!($field), &self.$field, Unit::$unit)?;)*
                if self.barrier.is_empty() {
                    return Err(Diagnostic::new("target.barrier", "the barrier times are missing"));
                }
                for pair in self.barrier.windows(2) {
                    let [(first, name), (second, other)] = [pair[0].parts(), pair[1].parts()];
                    if first >= second || name != other {
                        let message = "barrier times are not in ascending order of tiles, or of cores";
                        return Err(
                            Diagnostic::new("target.barrier", message).at(source, pair[1].time.value.span)
                        );
                    }
                }
                for entry in &self.barrier {
                    check_constant(source, "barrier", &entry.time, Unit::us)?;
                }
                for entry in &self.unused {
                    check_constant(source, &entry.name, &entry.constant, entry.constant.unit)?;
                }
                Ok(())
            }
        }
    };
}

for_each_constant!(constants);

/// The classes of figures that depend on a constant.
pub fn classes_of(constant: &str) -> &'static [FigureClass] {
    use FigureClass::{CoreDynamic, CoreEnergy, Rails, Static, Time, X86Dynamic, X86Rails};
    match constant {
        "core_static_power" | "x86_static_ratio" => &[Static],
        "chip_static_power" => &[Static, Rails],
        "x86_clock_power" => &[X86Dynamic, Rails],
        "x86_active_power" | "x86_injecting_share" => &[X86Dynamic],
        "x86_rails_power" => &[X86Rails, Rails],
        "chip_boot_power" | "x86_on_power" | "core_rails_power" | "unit_power" => &[Rails],
        name if name.ends_with("_energy") => &[CoreEnergy, CoreDynamic, Rails],
        // A power is an energy over a time, so it depends on both.
        _ => &[Time, CoreDynamic],
    }
}

fn check_constant(source: &SourceText, name: &str, constant: &Constant, unit: Unit) -> Result<()> {
    let value = constant.value.value;
    let wrong = |code, message: String| Diagnostic::new(code, message).at(source, constant.value.span);
    if constant.source.trim().is_empty() {
        return Err(wrong("target.source", format!("the source of {name} is missing")).help(
            "state where the figure is published, the data that it was fitted to, or the reason for assuming it",
        ));
    }
    if constant.unit != unit {
        let problem = wrong("target.unit", format!("{name} needs unit {unit:?}, but the file has {:?}", constant.unit));
        let converted = unit.parsed(&format!("{value}{}", constant.unit.suffix()));
        return Err(match converted {
            Ok(converted) => problem.help(format!("write value: {converted}, unit: {unit:?}")),
            Err(_) => problem,
        });
    }
    if !(0.0..=1e9).contains(&value) {
        return Err(wrong("target.constant", format!("{name} {value} is outside 0..=1e9")));
    }
    match constant.bounds {
        Some((low, high)) if !(0.0 <= low && low <= value && value <= high && high <= 1e9) => {
            let message = format!("{name} {value} is outside its bounds {low} to {high}, which are within 0..=1e9");
            Err(wrong("target.constant", message).help("state bounds: (low, high) around the value"))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spanned::parse;

    #[test]
    fn typed_values_take_units_and_times_need_them() {
        for (unit, typed, value) in [
            (Unit::us, "0.4us", 0.4),
            (Unit::us, "400 ns", 0.4),
            (Unit::ns, "0.4us", 400.0),
            (Unit::mW, "0.6", 0.6),
            (Unit::mW, "600uW", 0.6),
            (Unit::pJ, "1.5nJ", 1_500.0),
            (Unit::ratio, "0.5", 0.5),
        ] {
            assert_eq!(unit.parsed(typed), Ok(value), "{typed}");
        }
        for (unit, typed) in
            [(Unit::us, "0.4"), (Unit::ns, "3"), (Unit::mW, "1pJ"), (Unit::pJ, "x"), (Unit::ratio, "1mW")]
        {
            assert!(unit.parsed(typed).is_err(), "{typed}");
        }
    }

    #[test]
    fn constants_with_findings_are_their_median() {
        let (_, constants) = loihi1();
        let found: Vec<_> = constants.list().into_iter().filter(|(_, one)| !one.findings.is_empty()).collect();
        assert_eq!(found.len(), 8);
        for (name, constant) in found {
            let middle = constant.without("").unwrap();
            assert!((constant.value.value / middle - 1.0).abs() < 1e-3, "{name}: {middle}");
        }
    }

    fn loihi1() -> (SourceText, Constants) {
        let path = format!("{}/../../mapping/constants/loihi1-evidence.ron", env!("CARGO_MANIFEST_DIR"));
        let source = SourceText::new("loihi1-evidence.ron", std::fs::read_to_string(path).unwrap());
        let constants = parse(&source, "target.syntax").unwrap_or_else(|problem| panic!("{problem}"));
        (source, constants)
    }

    #[test]
    fn what_a_preset_need_not_give_is_zero_and_not_given() {
        let (source, whole) = loihi1();
        let without = |name: &str| {
            let lines = source.text().lines().filter(|line| !line.trim_start().starts_with(name));
            parse::<Constants>(&SourceText::new("c.ron", lines.collect::<Vec<_>>().join("\n")), "target.syntax")
        };
        let preset = without("spike_time").unwrap();
        preset.check(&source).unwrap();
        assert_eq!((preset.spike_time.value.value, preset.spike_time.status), (0.0, Status::NotGiven));
        assert_eq!(preset.list().len(), whole.list().len());
        assert!(without("core_static_power").is_err());
    }

    #[test]
    fn a_constant_without_a_source_is_refused_where_it_stands() {
        let (source, _) = loihi1();
        let text = source.text().replacen("SANA-FE 8951ab0, arch/loihi.yaml: hop east or west", "", 1);
        let changed = SourceText::new("changed.ron", text);
        let problem = parse::<Constants>(&changed, "target.syntax").unwrap().check(&changed).unwrap_err();
        assert_eq!(problem.message, "the source of hop_ew_energy is missing");
        assert!(problem.position().is_some());
    }
}
