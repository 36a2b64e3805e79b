//! Constants of energy, time and power: presets of them (`mapping/constants`), each figure with its
//! unit, source and status, so that a report can say where it comes from.
//!
//! [`Constants::check`] holds units, signs and sources. What a constant is multiplied with is for
//! `cost` to say.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::base::names::named_variants;
use crate::spanned::Spanned;

/// How far a constant can be trusted, the most trusted first.
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
    /// Absent from the preset, and counted as 0. No file writes it.
    #[serde(skip_deserializing, rename = "not given")]
    NotGiven,
}

named_variants!(Status {
    Published = "published", Calibrated = "calibrated", Assumed = "assumed"; Status::NotGiven => "not given"
});

/// The unit of a constant as it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[allow(non_camel_case_types, missing_docs)]
pub enum Unit {
    pJ,
    ns,
    us,
    mW,
    messages,
    ratio,
}

/// Where a value stands that was typed.
pub const SET: &str = "--set";

/// The name of the barrier times among constants.
pub const BARRIER: &str = "barrier";

/// Units that a value may be typed in, each with the unit in which its kind of value is stored, and
/// the factor to that unit.
const TYPED: [(&str, Unit, f64); 11] = [
    ("fJ", Unit::pJ, 1e-3),
    ("pJ", Unit::pJ, 1.0),
    ("nJ", Unit::pJ, 1e3),
    ("uJ", Unit::pJ, 1e6),
    ("ps", Unit::ns, 1e-3),
    ("ns", Unit::ns, 1.0),
    ("us", Unit::ns, 1e3),
    ("ms", Unit::ns, 1e6),
    ("uW", Unit::mW, 1e-3),
    ("mW", Unit::mW, 1.0),
    ("W", Unit::mW, 1e3),
];

impl Unit {
    /// What follows a number of this unit.
    pub fn suffix(self) -> &'static str {
        match self {
            Unit::pJ => "pJ",
            Unit::ns => "ns",
            Unit::us => "us",
            Unit::mW => "mW",
            Unit::messages | Unit::ratio => "",
        }
    }

    /// A typed value such as `0.4us` in this unit. Constants of time come in ns and in us, so that
    /// a time without its unit is refused.
    ///
    /// # Errors
    /// A sentence for what is no number, or is in a unit of something else.
    pub fn parsed(self, typed: &str) -> Result<f64, String> {
        let typed = typed.trim();
        let end = typed.len() - typed.chars().rev().take_while(char::is_ascii_alphabetic).count();
        let (number, unit) = (typed[..end].trim(), &typed[end..]);
        let number: f64 = number.parse().map_err(|_| format!("{typed} is no number"))?;
        let (measured, each) = match self {
            Unit::us => (Unit::ns, 1e3),
            other => (other, 1.0),
        };
        if unit.is_empty() {
            return match measured {
                Unit::ns => Err(format!("{typed} has no unit, and constants of time are in ns and in us")),
                _ => Ok(number),
            };
        }
        match TYPED.iter().find(|(name, of, _)| *name == unit && *of == measured) {
            // Multiplied before it is divided, so that 400 ns is 0.4 us and no neighbour of that.
            Some((.., factor)) if *factor >= 1.0 => Ok(number * factor / each),
            Some((.., factor)) => Ok(number / (1.0 / factor).round() / each),
            None => Err(format!("{unit} is no unit of a constant in {}", self.suffix())),
        }
    }
}

/// What one group of authors found of a constant.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Finding {
    /// The authors, as workloads name them: a prediction of their work is made without it.
    pub group: String,
    /// The constant by them, in its unit.
    pub value: f64,
    /// Where it is printed, or how it follows from what is.
    pub source: String,
}

named_variants! {
    /// Figures whose predictions are wrong together, so that one factor bounds them.
    #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize, Serialize)]
    #[serde(rename_all(serialize = "snake_case"))]
    pub enum FigureClass {
        /// Static power of neuron cores or of x86 cores.
        Static = "static",
        /// Power of x86 cores on top.
        X86Dynamic = "x86_dynamic",
        /// Energy of the neuron cores' events in a step.
        CoreEnergy = "core_energy",
        /// Power of the neuron cores' events, as fast as possible.
        CoreDynamic = "core_dynamic",
        /// Power of a whole board.
        Rails = "rails",
        /// Time of a step.
        Time = "time",
    }
}

/// How far predictions of a class were off, each work predicted without its authors' findings.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ClassError {
    /// Which figures.
    pub class: FigureClass,
    /// Works that print such figures; 0 where the factor bounds the constants themselves, between
    /// what their sources leave open.
    pub works: u32,
    /// A new work's figures are within this factor with a chance of 80 %, if works were counted.
    pub within_80: f64,
    /// The factor with a chance of 90 %; absent where works are too few.
    #[serde(default)]
    pub within_90: Option<f64>,
}

/// How the parts of a core's work and the mesh make the time of a step.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub enum StepForm {
    /// Parts follow each other: the sum, (9), (11) and (17) of `docs/energy.md`.
    #[default]
    Sum,
    /// Parts overlap: the greatest of them, (21), after Timcheck et al. 2026 (arXiv 2601.10035).
    Greatest,
}

/// A number with its origin.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Constant {
    /// The number, in `unit`.
    pub value: Spanned<f64>,
    /// Its unit.
    pub unit: Unit,
    /// Paper and table, or repository and file.
    pub source: String,
    /// How far it can be trusted.
    pub status: Status,
    /// What each group of authors found, where the value is the median of that: of two in the
    /// middle the geometric mean.
    #[serde(default)]
    pub findings: Vec<Finding>,
}

impl Constant {
    fn not_given(unit: Unit) -> Self {
        let source = "not given by this preset".to_string();
        Constant { value: 0.0.into(), unit, source, status: Status::NotGiven, findings: Vec::new() }
    }

    /// The median of the findings of other groups than this one; `None` when there are none.
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

/// The median; of two in the middle their geometric mean. `None` of nothing.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() % 2 {
        1 => Some(values[middle]),
        _ => Some((values.get(middle.checked_sub(1)?)? * values[middle]).sqrt()),
    }
}

/// Time of a barrier for up to this many tiles in use; between entries it is interpolated linearly.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BarrierTime {
    /// Tiles in use.
    pub tiles: u64,
    /// The time.
    pub time: Constant,
}

/// A figure that a source gives in addition to the others and that no count of a run multiplies:
/// stored for the record.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnusedConstant {
    /// Its name.
    pub name: String,
    /// The figure.
    pub constant: Constant,
    /// Why nothing is charged for it.
    pub why: String,
}

/// Calls a macro with every single-valued constant and its unit: what holds a value for each is
/// made from this list alone. Those that a source need not give are 0 without it,
/// [`Status::NotGiven`].
#[macro_export]
macro_rules! for_each_constant {
    ($make:ident) => {
        $make! {
            /// A synaptic event of a dense list.
            synapse_dense_energy: pJ,
            /// A synaptic event of a sparse list.
            synapse_sparse_energy: pJ,
            /// A dendritic accumulator read in a step.
            dendrite_energy: pJ = "Constant::no_energy",
            /// A compartment visited in a step.
            compartment_energy: pJ,
            /// On top, when it is not idle.
            compartment_active_energy: pJ,
            /// On top, when it spikes.
            spike_energy: pJ = "Constant::no_energy",
            /// A message sent.
            axon_out_energy: pJ = "Constant::no_energy",
            /// A message received.
            axon_in_energy: pJ = "Constant::no_energy",
            /// A message that stays within its tile.
            local_hop_energy: pJ = "Constant::no_energy",
            /// A link crossed east or west.
            hop_ew_energy: pJ,
            /// A link crossed north or south.
            hop_ns_energy: pJ,
            /// On top, for a link between chips.
            hop_chip_energy: pJ = "Constant::no_energy",
            /// A synaptic event of a dense list.
            synapse_dense_time: ns,
            /// A synaptic event of a sparse list.
            synapse_sparse_time: ns,
            /// A compartment visited in a step.
            compartment_time: ns,
            /// On top, when it is not idle.
            compartment_active_time: ns,
            /// On top, when it spikes.
            spike_time: ns = "Constant::no_time",
            /// A message sent.
            axon_out_time: ns = "Constant::no_time",
            /// A message received.
            axon_in_time: ns = "Constant::no_time",
            /// A message that stays within its tile.
            local_hop_time: ns = "Constant::no_time",
            /// A link crossed east or west.
            hop_ew_time: ns,
            /// A link crossed north or south.
            hop_ns_time: ns,
            /// On top, for a link between chips.
            hop_chip_time: ns = "Constant::no_time",
            /// A message on a link, which passes them one after the other.
            link_time: ns,
            /// A message on a link between chips.
            link_chip_time: ns,
            /// Messages that wait at a link, before its sender is held up.
            link_buffer: messages,
            /// A spike that an x86 core hands to its chip, or another word that the host sends.
            injection_time: us = "Constant::no_host_time",
            /// The turn of the x86 cores' process in a step, whether there are spikes or not.
            turn_time: us = "Constant::no_host_time",
            /// A hop between chips, there and back, in a barrier.
            chip_hop_time: us = "Constant::no_host_time",
            /// A word of 32 bits that an x86 core sets when state is reset.
            reset_word_time: ns = "Constant::no_time",
            /// Static power of a neuron core in use, as a profiler attributes it.
            core_static_power: mW,
            /// That over the static power of an x86 core; 0: x86 cores have none.
            x86_static_ratio: ratio = "Constant::no_ratio",
            /// Power of a chip's x86 clock, as soon as one of its x86 cores runs.
            x86_clock_power: mW = "Constant::no_power",
            /// Power of an x86 core while it works.
            x86_active_power: mW = "Constant::no_power",
            /// Share of a step in which an x86 core works that injects spikes.
            x86_injecting_share: ratio = "Constant::no_ratio",
            /// Leakage of a powered chip, besides that of its cores: of chips in use as a profiler
            /// counts, of all on the board on the rails.
            chip_static_power: mW = "Constant::no_power",
            /// Power of a chip on the board before a program is loaded, as the rails show it.
            chip_boot_power: mW = "Constant::no_power",
            /// Power of an x86 core once a program is loaded, as the rails show it.
            x86_on_power: mW = "Constant::no_power",
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
            /// Where sources disagree, and what this preset follows.
            pub notes: String,
            /// The hardware that was measured, as chips name theirs: errors hold for no other.
            #[serde(default)]
            pub hardware: String,
            /// How far predictions with these constants were off.
            #[serde(default)]
            pub errors: Vec<ClassError>,
            /// How the time of a step follows from its parts.
            #[serde(default)]
            pub step: StepForm,
            /// Barrier times by tiles in use, ascending.
            pub barrier: Vec<BarrierTime>,
            /// Figures of the same sources that enter no sum.
            #[serde(default)]
            pub unused: Vec<UnusedConstant>,
            /// By the name of a constant that this preset does not state, the preset that does, or
            /// `--set`.
            #[serde(skip)]
            pub stated_in: BTreeMap<&'static str, String>,
            /// The constants that are of other hardware than the preset, which its base states.
            #[serde(skip)]
            pub borrowed: BTreeSet<&'static str>,
            $($(#[$doc])* $(#[serde(default = $default)])? pub $field: Constant,)*
        }
        /// A preset that says only what differs from another.
        #[derive(Debug, Clone, Deserialize)]
        #[serde(deny_unknown_fields, rename = "Constants")]
        pub struct ConstantsChanges {
            /// The other preset: a shipped one, or a file next to this one.
            pub base: Spanned<String>,
            /// The preset's name; that of its file unless given.
            pub name: Option<String>,
            /// What it is.
            #[serde(default)]
            pub notes: String,
            /// The hardware that it is of, where that is not the other preset's.
            pub hardware: Option<String>,
            /// How far predictions may be off, in place of the other preset's.
            pub errors: Option<Vec<ClassError>>,
            /// How the time of a step follows from its parts, where not as in the other preset.
            pub step: Option<StepForm>,
            /// Barrier times in place of the other preset's.
            pub barrier: Option<Vec<BarrierTime>>,
            $($(#[$doc])* pub $field: Option<Constant>,)*
        }

        impl ConstantsChanges {
            /// The other preset with the changes. Errors of figures that follow from a changed
            /// constant are gone, and those of other hardware.
            #[must_use]
            pub fn applied(self, base: &Constants, name: String) -> Constants {
                let mut made = Constants { name, notes: self.notes, ..base.clone() };
                made.hardware = self.hardware.unwrap_or(made.hardware);
                let foreign = made.hardware != base.hardware && !base.hardware.is_empty();
                let inherited = |stated_in: &mut BTreeMap<_, _>, name| {
                    stated_in.entry(name).or_insert_with(|| base.name.clone());
                };
                match self.barrier {
                    Some(barrier) => {
                        made.barrier = barrier;
                        made.stated_in.remove(BARRIER);
                        made.forget_errors(&[FigureClass::Time]);
                    }
                    None => inherited(&mut made.stated_in, BARRIER),
                }
                $(match self.$field {
                    Some(constant) => {
                        made.$field = constant;
                        made.stated_in.remove(stringify!($field));
                        made.borrowed.remove(stringify!($field));
                        made.forget_errors(classes_of(stringify!($field)));
                    }
                    None => {
                        inherited(&mut made.stated_in, stringify!($field));
                        if foreign && made.$field.status != Status::NotGiven {
                            made.borrowed.insert(stringify!($field));
                        }
                    }
                })*
                made.step = self.step.unwrap_or(made.step);
                if made.hardware != base.hardware {
                    made.errors.clear();
                }
                made.errors = self.errors.unwrap_or(made.errors);
                made
            }
        }

        impl Constants {
            /// Drops the errors of these classes: they were of other constants.
            pub fn forget_errors(&mut self, classes: &[FigureClass]) {
                self.errors.retain(|error| !classes.contains(&error.class));
            }

            /// The names of all single-valued constants, in a fixed order.
            pub const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            /// One constant, by its name, to be changed.
            pub fn get_mut(&mut self, name: &str) -> Option<&mut Constant> {
                match name {
                    $(stringify!($field) => Some(&mut self.$field),)*
                    _ => None,
                }
            }

            /// Name and constant of every single-valued field, in a fixed order.
            pub fn list(&self) -> Vec<(&'static str, &Constant)> {
                vec![$((stringify!($field), &self.$field),)*]
            }

            /// Checks units and signs.
            ///
            /// # Errors
            /// A diagnostic at the first constant that is negative, not finite, above 10^9, or in
            /// another unit.
            pub fn check(&self, source: &SourceText) -> Result<()> {
                $(check_constant(source, stringify!($field), &self.$field, Unit::$unit)?;)*
                if self.barrier.is_empty() {
                    return Err(Diagnostic::new("target.barrier", "no barrier time is given"));
                }
                for pair in self.barrier.windows(2) {
                    if pair[0].tiles >= pair[1].tiles {
                        return Err(Diagnostic::new("target.barrier", "barrier times are not in ascending order of tiles")
                            .at(source, pair[1].time.value.span));
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

/// The classes of figures that follow from a constant.
pub fn classes_of(constant: &str) -> &'static [FigureClass] {
    use FigureClass::{CoreDynamic, CoreEnergy, Rails, Static, Time, X86Dynamic};
    match constant {
        "core_static_power" | "x86_static_ratio" => &[Static],
        "chip_static_power" => &[Static, Rails],
        "x86_clock_power" | "x86_active_power" | "x86_injecting_share" => &[X86Dynamic, Rails],
        "chip_boot_power" | "x86_on_power" => &[Rails],
        name if name.ends_with("_energy") => &[CoreEnergy, CoreDynamic, Rails],
        // A power is an energy over a time.
        _ => &[Time, CoreDynamic],
    }
}

fn check_constant(source: &SourceText, name: &str, constant: &Constant, unit: Unit) -> Result<()> {
    let value = constant.value.value;
    let wrong = |code, message: String| Diagnostic::new(code, message).at(source, constant.value.span);
    if constant.source.trim().is_empty() {
        return Err(wrong("target.source", format!("{name} names no source"))
            .help("say where the figure is printed, what it was fitted to, or why it is assumed"));
    }
    if constant.unit != unit {
        let problem = wrong("target.unit", format!("{name} needs {unit:?}, and the file has {:?}", constant.unit));
        let converted = unit.parsed(&format!("{value}{}", constant.unit.suffix()));
        return Err(match converted {
            Ok(converted) => problem.help(format!("write value: {converted}, unit: {unit:?}")),
            Err(_) => problem,
        });
    }
    if !(0.0..=1e9).contains(&value) {
        return Err(wrong("target.constant", format!("{name} {value} is outside 0..=1e9")));
    }
    Ok(())
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
        assert_eq!(found.len(), 7);
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
        assert_eq!(problem.message, "hop_ew_energy names no source");
        assert!(problem.position().is_some());
    }
}
