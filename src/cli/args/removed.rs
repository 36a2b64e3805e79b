//! Removed names of earlier versions, each with its replacement.

use std::ffi::OsString;

use clap::error::{ContextKind, ContextValue};

/// Removed words of a command line, and the advice that replaces them.
pub const REMOVED: &[(&str, &str)] = &[
    (
        "cache",
        "mappings are not cached: save one with `nsim map -o FILE` and give it to commands with `--mapping FILE`",
    ),
    (
        "--no-cache",
        "mappings are not cached: remove it, or save a mapping with `nsim map -o FILE` and give `--mapping FILE`",
    ),
    (
        "bench scale",
        "measure steps on R processes with `mpirun -n R nsim bench step`; docs/scale.md models more processes",
    ),
    (
        "run --probe-format parquet",
        "`nsim run --probe-format csv` writes the same columns, which pandas turns into Parquet",
    ),
    (
        "energy --calibrate",
        "fit constants as docs/studies/vtsnn_constants.py does, and use them with `nsim energy --constants FILE`",
    ),
    (
        "train --study",
        "`nsim sweep` trains each variant of a sweep file with `train: \"CONFIG.ron\"` and paths such as `train.seed`",
    ),
    ("train --seeds", "train with each seed by `nsim train CONFIG.ron --seed N -o MODEL.ron` in a loop of the shell"),
    ("bench batch", "`nsim energy --baseline rtx-2080-ti gpu-roofline` has the rows of a GPU, a sample at a time"),
    ("bench paper --markdown", "`nsim bench paper --format markdown > FILE.md` has a row a network"),
    (
        "bench early",
        "`nsim bench paper --train DIR` has accuracy, time and energy of early decisions in its rows `early`",
    ),
    ("plot early", "`nsim bench paper --train DIR` has early decisions in its rows `early`"),
    ("plot early-energy", "`nsim bench paper --train DIR` has early decisions in its rows `early`"),
];

/// Returns the error of clap, or the advice where a removed name is the cause.
pub fn explained(error: clap::Error, line: &[OsString], command: &mut clap::Command) -> clap::Error {
    let wrong = [ContextKind::InvalidSubcommand, ContextKind::InvalidArg, ContextKind::InvalidValue];
    let is_cause = |word: &str| {
        wrong.iter().any(|&kind| matches!(error.get(kind), Some(ContextValue::String(name)) if name == word))
    };
    let is_typed = |typed: &&(&str, &str)| {
        let (before, last) = typed.0.rsplit_once(' ').unwrap_or(("", typed.0));
        is_cause(last) && before.split_whitespace().all(|word| line.iter().any(|typed| typed == word))
    };
    match REMOVED.iter().find(is_typed) {
        Some((name, instead)) => command.error(error.kind(), format!("`{name}` was removed: {instead}")),
        None => error,
    }
}
