//! The files embedded in the program, so that it works from any folder: models, targets, chips,
//! constants, measurements and scenarios.
//!
//! Each kind has a table, with a line for each file. The error for an unknown name lists the known
//! names.

use std::path::Path;

use super::text::{is_standard_stream, read_text};
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText};
use nsim_ir::base::names::did_you_mean;

/// A file in the binary.
#[derive(Debug, Clone, Copy)]
pub struct Shipped {
    /// Its name, without folder and extension.
    pub name: &'static str,
    /// Its path in the project.
    pub path: &'static str,
    /// Its content.
    pub text: &'static str,
}

/// Files of one folder by name, or of several folders, each with a prefix of the names.
macro_rules! shipped {
    ($folder:literal: $($name:literal),* $(,)?) => {
        shipped!($folder as "": $($name),*)
    };
    ($($folder:literal as $prefix:literal: $($name:literal),* $(,)?);*) => {
        &[$($(Shipped {
            name: concat!($prefix, $name),
            path: concat!($folder, "/", $name, ".ron"),
            text: include_str!(concat!(env!("CARGO_MANIFEST_DIR"), env!("SHIPPED"), "/", $folder, "/", $name, ".ron")),
        },)*)*]
    };
}

/// Models, first those with a file of arrays each.
macro_rules! models {
    ($($name:literal),*; $($alone:literal),*) => {
        /// Shipped models.
        pub const MODELS: &[Shipped] = shipped!("models": $($name,)* $($alone),*);
        /// The arrays that shipped models refer to: path within `models/`, content.
        pub const ARRAYS: &[(&str, &[u8])] = &[$((
            concat!($name, ".safetensors"),
            include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), env!("SHIPPED"), "/models/", $name, ".safetensors")).as_slice(),
        )),*];
    };
}

models!(
    "container-few-shot",
    "container-tactile",
    "container-tactile-clock",
    "container-tactile-srm",
    "paper-container-both-count",
    "paper-container-both-weighted",
    "paper-container-tactile-count",
    "paper-container-tactile-weighted",
    "paper-container-vision-count",
    "paper-container-vision-weighted",
    "paper-slip-both-count",
    "paper-slip-both-weighted",
    "paper-slip-tactile-count",
    "paper-slip-tactile-weighted",
    "paper-slip-vision-count",
    "paper-slip-vision-weighted",
    "pes-channel",
    "slip-tactile",
    "slip-tactile-rf",
    "slip-tactile-sdnn",
    "slip-vision",
    "stdp-pattern",
    "vtsnn-container",
    "vtsnn-slip",
    "vtsnn-slip-srm";
    "cartpole"
);
/// Training files of shipped models, and of the cells of the paper's tables.
pub const TRAININGS: &[Shipped] = shipped!(
    "models/train" as "":
    "container-tactile",
    "container-tactile-clock",
    "container-tactile-clock-srm",
    "container-tactile-srm",
    "slip-tactile",
    "slip-tactile-rf",
    "slip-tactile-sdnn",
    "slip-vision",
    "vtsnn-container",
    "vtsnn-slip",
    "vtsnn-slip-srm";
    "models/train/paper" as "paper-":
    "slip-tactile",
    "slip-vision",
    "slip-both",
    "container-tactile",
    "container-vision",
    "container-both",
);
/// Shipped targets.
pub const TARGETS: &[Shipped] = shipped!("mapping/targets": "tiny", "loihi1-chip", "kapoho-bay", "nahuku-32", "pohoiki-springs", "oheo-gulch",
        "oheo-gulch-2022", "kapoho-point", "hala-point", "boundless");
/// Shipped chips.
pub const CHIPS: &[Shipped] = shipped!("mapping/chips": "loihi1", "loihi2", "tiny", "boundless");
/// Shipped presets of constants.
pub const CONSTANTS: &[Shipped] = shipped!(
    "mapping/constants":
    "davies2018",
    "loihi1-evidence",
    "loihi2-modelled",
    "sanafe-calibrated",
    "vtsnn-calibrated",
);
/// Shipped tables of measurements.
pub const MEASUREMENTS: &[Shipped] = shipped!("mapping/measurements": "vtsnn-offline", "vtsnn-realtime");
/// Shipped published workloads.
pub const WORKLOADS: &[Shipped] = shipped!(
    "mapping/workloads":
    "smnist-nahuku",
    "smnist-wolf-mountain",
    "smnist-rails",
    "quartz-mnist-11-cores-51-steps",
    "quartz-mnist-11-cores-91-steps",
    "quartz-mnist-11-cores-171-steps",
    "quartz-mnist-11-cores-331-steps",
    "quartz-mnist-11-cores-651-steps",
    "quartz-mnist-18-cores-50-steps",
    "quartz-mnist-18-cores-90-steps",
    "quartz-mnist-18-cores-170-steps",
    "quartz-mnist-18-cores-330-steps",
    "quartz-mnist-18-cores-650-steps",
    "quartz-cifar",
    "relnet",
    "nxtf-mnist",
    "nxtf-mnist-april",
    "braille",
    "ntidigits",
    "blouw-base",
    "blouw-branch",
    "ceolini-emg",
    "vtsnn-offline",
    "vtsnn-realtime",
    "olfaction",
    "knn",
    "nmnist",
    "nmnist-auto",
    "pilotnet-lif",
    "balafrej-pair",
    "qp-pipg",
    "ozu-ns-lif",
    "ozu-ss-lif",
    "ozu-ns-izhikevich",
    "ozu-ss-izhikevich",
    "nxtf-paper-mnist",
);

/// Shipped rows of other hardware.
pub const BASELINES: &[Shipped] = shipped!("mapping/baselines": "rtx-2080-ti");

/// Shipped scenarios.
pub const SCENARIOS: &[Shipped] = shipped!("mapping/scenarios": "vtsnn-slip-paper");

/// All of these tables.
pub const TABLES: &[&[Shipped]] = &[MODELS, TARGETS, CHIPS, CONSTANTS, MEASUREMENTS, WORKLOADS, SCENARIOS, BASELINES];

/// Origin of a text, on which the search for the files that it names depends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Origin {
    /// From a file, or stdin.
    File,
    /// From the binary.
    Shipped,
}

impl Shipped {
    /// The file with this name.
    pub fn find(table: &'static [Shipped], name: &str) -> Option<&'static Shipped> {
        table.iter().find(|shipped| shipped.name == name)
    }

    /// Its text under its path in the project.
    pub fn source(&self) -> SourceText {
        SourceText::new(self.path, self.text)
    }
}

/// Whether an argument is a path: it is `-`, it contains `/`, `\` or `.`, or such a file exists.
/// Otherwise it is a name.
pub fn is_path(argument: &str) -> bool {
    let path = Path::new(argument);
    is_standard_stream(path) || argument.contains(['/', '\\', '.']) || path.is_file()
}

/// Names of chips, and the shipped target that is meant by each.
const CHIP_ALIASES: [(&str, &str); 4] =
    [("loihi", "loihi1-chip"), ("loihi1", "loihi1-chip"), ("loihi2", "oheo-gulch"), ("loihi-2", "oheo-gulch")];

/// The error for a name that is not shipped.
pub fn unknown(code: &'static str, kind: &str, name: &str, table: &[Shipped]) -> Diagnostic {
    let names: Vec<&str> = table.iter().map(|shipped| shipped.name).collect();
    let meant = CHIP_ALIASES.iter().find(|(called, target)| *called == name.to_lowercase() && names.contains(target));
    Diagnostic::new(code, format!("there is no shipped {kind} named '{name}'")).help(format!(
        "{}shipped files: {}; or give a path to a .ron file",
        did_you_mean(meant.map_or(name, |(_, target)| *target), names.iter().copied()),
        names.join(", ")
    ))
}

/// The text of an argument that is a path or a shipped name.
///
/// # Errors
/// As [`read_text`], and `code` for a name that the table does not have.
pub fn path_or_shipped_text(
    argument: &str,
    table: &'static [Shipped],
    kind: &str,
    code: &'static str,
) -> Result<(SourceText, Origin)> {
    if is_path(argument) {
        return Ok((read_text(Path::new(argument))?, Origin::File));
    }
    let shipped = Shipped::find(table, argument).ok_or_else(|| unknown(code, kind, argument, table))?;
    Ok((shipped.source(), Origin::Shipped))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_paths_are_distinguished() {
        assert!(is_path("./x") && is_path("x.ron") && is_path("a/b") && is_path("-"));
        assert!(!is_path("vtsnn-slip") && !is_path("src"));
    }

    #[test]
    fn names_are_listed_once_and_files_bear_the_names_inside() {
        for table in [MODELS, TRAININGS, TARGETS, CHIPS, CONSTANTS, MEASUREMENTS, SCENARIOS] {
            for (i, shipped) in table.iter().enumerate() {
                assert!(table[..i].iter().all(|other| other.name != shipped.name), "{}", shipped.name);
                assert!(shipped.text.contains(&format!("name: \"{}\"", shipped.name)), "{}", shipped.path);
            }
        }
    }
}
