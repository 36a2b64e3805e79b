//! Folders with a recording for each sample.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::kind::FileKind;
use nsim_files::{disk, write};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// File name of the manifest of a folder of recordings.
pub const MANIFEST: &str = "dataset.ron";

/// Sample number and label of a name `sample_<i>_label_<c>.npy`, with any extension.
fn sample_name(name: &str) -> Option<(u64, u32)> {
    let (stem, _) = name.rsplit_once('.')?;
    let (index, label) = stem.strip_prefix("sample_")?.split_once("_label_")?;
    let plain = [index, label].iter().all(|text| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit()));
    if plain { Some((index.parse().ok()?, label.parse().ok()?)) } else { None }
}

/// A sort key that compares the numbers within a name by their value.
fn natural_order(name: &str) -> Vec<(Option<u128>, String)> {
    let letters: Vec<char> = name.chars().collect();
    let runs = letters.chunk_by(|a, b| a.is_ascii_digit() == b.is_ascii_digit()).map(String::from_iter);
    runs.map(|run| (run.parse().ok(), run)).collect()
}

/// Sample number, label and path of each recording of a folder, sorted by number. When no name has
/// a number and a label, every recording of events is a sample without a label. They are then
/// sorted by name, with numbers in names by value.
///
/// # Errors
/// `input.folder` for no recording, or two of one number; `input.unfinished`; `io.*`.
pub fn list_folder(folder: &Path) -> Result<Vec<(u64, Option<u32>, PathBuf)>> {
    let unreadable =
        |error: std::io::Error| Diagnostic::new("io.read", format!("cannot be read: {error}")).in_file(folder);
    let mut unfinished = false;
    for one in [Some(folder), folder.parent()].into_iter().flatten() {
        unfinished |= write::is_unfinished(one, MANIFEST).map_err(unreadable)?;
    }
    if unfinished {
        let message = "its recordings are incomplete: the command that wrote them was interrupted";
        return Err(Diagnostic::new("input.unfinished", message)
            .help("run `nsim scene .. -o` on this folder again")
            .in_file(folder));
    }
    let mut samples = BTreeMap::new();
    let mut others = Vec::new();
    for path in disk::list(folder).map_err(unreadable)? {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let named = match sample_name(&name) {
            Some(named) if matches!(FileKind::detect(&path)?, FileKind::Npy | FileKind::Events(_)) => Some(named),
            _ => None,
        };
        match named {
            Some((index, label)) => {
                if samples.insert(index, (Some(label), path)).is_some() {
                    return Err(Diagnostic::new("input.folder", format!("two files are sample {index}"))
                        .help("keep one file for each sample, sample_<i>_label_<c>.npy")
                        .in_file(folder));
                }
            }
            None => others.push((name, path)),
        }
    }
    if samples.is_empty() {
        let mut events: Vec<&(String, PathBuf)> = others.iter().collect();
        events.retain(|(_, path)| matches!(FileKind::detect(path), Ok(FileKind::Events(_))));
        events.sort_by_cached_key(|(name, _)| natural_order(name));
        samples = events.iter().zip(0..).map(|((_, path), index)| (index, (None, path.clone()))).collect();
    }
    if samples.is_empty() {
        others.sort();
        let missing =
            Diagnostic::new("input.folder", "the folder holds no sample_<i>_label_<c>.npy and no recording of events")
                .in_file(folder);
        let inner: Vec<&str> =
            others.iter().filter(|(_, path)| path.is_dir()).map(|(name, _)| name.as_str()).take(8).collect();
        let help = if others.iter().any(|(name, _)| name == MANIFEST) {
            format!("it holds a manifest: give {}", folder.join(MANIFEST).display())
        } else if inner.is_empty() {
            format!("it holds {} other files", others.len())
        } else {
            format!("it holds the folders {}; give one of them", inner.join(", "))
        };
        return Err(missing.help(help));
    }
    Ok(samples.into_iter().map(|(index, (label, path))| (index, label, path)).collect())
}
