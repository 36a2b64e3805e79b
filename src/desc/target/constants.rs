//! Constants of energy, time and power: presets of them (`mapping/constants`), each figure with its unit, source and status, so
//! that a report can say where it comes from.
//!
//! [`Constants::check`] holds units, signs and sources. What a constant is multiplied with is for `cost` to say.

use serde::{Deserialize, Serialize};

use crate::base::diagnostic::{Diagnostic, Result, SourceText};
use crate::base::names::named_variants;
use crate::desc::spanned::Spanned;

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
}

named_variants!(Status { Published = "published", Calibrated = "calibrated", Assumed = "assumed" });

/// The unit of a constant as it is written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[allow(non_camel_case_types, missing_docs)]
pub enum Unit {
    pJ,
    ns,
    us,
    mW,
    messages,
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
}

impl Constant {
    fn not_given(unit: Unit) -> Self {
        Constant { value: 0.0.into(), unit, source: "not given by this preset".to_string(), status: Status::Assumed }
    }

    fn no_energy() -> Self {
        Constant::not_given(Unit::pJ)
    }

    fn no_time() -> Self {
        Constant::not_given(Unit::ns)
    }
}

/// Time of a barrier for up to so many tiles in use; between entries it is interpolated linearly.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BarrierTime {
    /// Tiles in use.
    pub tiles: u64,
    /// The time.
    pub time: Constant,
}

/// A figure that a source gives beside the others and that no count of a run multiplies: kept so that it is on record.
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

/// A cell of a table of measurements beside what the calibrated constants make of it.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Residual {
    /// The cell, as `unit figure`.
    pub cell: String,
    /// What was measured, as printed.
    pub printed: String,
    /// What the model gives.
    pub model: f64,
    /// Model less measured, in percent of the measured.
    pub percent: f64,
}

/// Calls a macro with every single-valued constant and its unit: what holds a value for each is made from this list alone.
/// Those that a source need not give are zero and assumed without it.
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
            /// On top, when it is not at rest.
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
            /// A powered core in a step.
            core_step_energy: pJ = "Constant::no_energy",
            /// A synaptic event of a dense list.
            synapse_dense_time: ns,
            /// A synaptic event of a sparse list.
            synapse_sparse_time: ns,
            /// A compartment visited in a step.
            compartment_time: ns,
            /// On top, when it is not at rest.
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
            /// A spike injected from outside.
            injection_time: ns = "Constant::no_time",
            /// The turn of one copy's injection in a step, whether it has spikes or not.
            injection_step_time: ns = "Constant::no_time",
            /// An output spike read out.
            readout_time: ns = "Constant::no_time",
            /// Static power of a powered core.
            core_static_power: mW,
            /// Static power of an x86 core in use.
            x86_static_power: mW,
            /// Power of an x86 core in use on top, whether it has work or not.
            x86_busy_power: mW,
        }
    };
}
pub(crate) use for_each_constant;

macro_rules! constants {
    ($($(#[$doc:meta])* $field:ident: $unit:ident $(= $default:literal)?,)*) => {
        /// A preset of energies, times and powers. Energies add up: a compartment that is visited, updated and spikes costs
        /// all three.
        #[derive(Debug, Clone, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct Constants {
            /// The preset's name.
            pub name: String,
            /// Where sources disagree, and what this preset follows.
            pub notes: String,
            /// Barrier times by tiles in use, ascending.
            pub barrier: Vec<BarrierTime>,
            /// Figures of the same sources that enter no sum.
            #[serde(default)]
            pub unused: Vec<UnusedConstant>,
            /// What a calibration left over, when the preset is the result of one.
            #[serde(default)]
            pub residuals: Vec<Residual>,
            $($(#[$doc])* $(#[serde(default = $default)])? pub $field: Constant,)*
        }
        impl Constants {
            /// The names of all single-valued constants, in a fixed order.
            pub const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            /// The unit in which a constant is written.
            #[must_use]
            pub fn unit_of(name: &str) -> Option<Unit> {
                match name {
                    $(stringify!($field) => Some(Unit::$unit),)*
                    _ => None,
                }
            }

            /// One constant, by its name, to be changed.
            pub fn get_mut(&mut self, name: &str) -> Option<&mut Constant> {
                match name {
                    $(stringify!($field) => Some(&mut self.$field),)*
                    _ => None,
                }
            }

            /// Name and constant of every single-valued field, in a fixed order.
            #[must_use]
            pub fn list(&self) -> Vec<(&'static str, &Constant)> {
                vec![$((stringify!($field), &self.$field),)*]
            }

            /// Checks units and signs.
            ///
            /// # Errors
            /// A diagnostic at the first constant that is negative, not finite, above 10^9, or in another unit.
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

fn check_constant(source: &SourceText, name: &str, constant: &Constant, unit: Unit) -> Result<()> {
    let value = constant.value.value;
    let wrong = |code, message: String| Diagnostic::new(code, message).at(source, constant.value.span);
    if constant.source.trim().is_empty() {
        return Err(wrong("target.source", format!("{name} names no source"))
            .help("say where the figure is printed, what it was fitted to, or why it is assumed"));
    }
    if constant.unit != unit {
        return Err(wrong("target.unit", format!("{name} is in {:?}, not {unit:?}", constant.unit)));
    }
    if !(0.0..=1e9).contains(&value) {
        return Err(wrong("target.constant", format!("{name} {value} is outside 0..=1e9")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::desc::spanned::parse;

    fn davies() -> (SourceText, Constants) {
        let path = format!("{}/mapping/constants/davies2018.ron", env!("CARGO_MANIFEST_DIR"));
        let source = SourceText::new("davies2018.ron", std::fs::read_to_string(path).unwrap());
        let constants = parse(&source, "target.syntax").unwrap_or_else(|problem| panic!("{problem}"));
        (source, constants)
    }

    #[test]
    fn what_a_preset_need_not_give_is_zero_and_assumed() {
        let (source, whole) = davies();
        let without = |name: &str| {
            let lines = source.text().lines().filter(|line| !line.trim_start().starts_with(name));
            parse::<Constants>(&SourceText::new("c.ron", lines.collect::<Vec<_>>().join("\n")), "target.syntax")
        };
        let preset = without("readout_time").unwrap();
        preset.check(&source).unwrap();
        assert_eq!((preset.readout_time.value.value, preset.readout_time.status), (0.0, Status::Assumed));
        assert_eq!(preset.list().len(), whole.list().len());
        assert!(without("core_static_power").is_err());
    }

    #[test]
    fn a_constant_without_a_source_is_refused_where_it_stands() {
        let (source, _) = davies();
        let text =
            source.text().replacen("Davies et al. 2018, IEEE Micro 38(1), table 2: tile hop east or west", "", 1);
        let changed = SourceText::new("changed.ron", text);
        let problem = parse::<Constants>(&changed, "target.syntax").unwrap().check(&changed).unwrap_err();
        assert_eq!(problem.message, "hop_ew_energy names no source");
        assert!(problem.position().is_some());
    }
}
