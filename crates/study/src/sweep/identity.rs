//! The files of a sweep, by which its parts and its journal are identified.
//!
//! Input: a sweep and the changes of `--set`. Output: the files that they name, and the files that
//! these name: arrays of a model, parts of a target, recordings of a data set. A text in
//! quotes that is no file is skipped, so a file that a later version of nsim reads is included too.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::sweep::variants::Sweep;
use nsim_files::text::sibling_path;

/// Longest text in quotes that can be a path, bytes.
const LONGEST: usize = 4096;
/// Largest text that is searched for the names of other files, bytes.
const MOST_BYTES: u64 = 1 << 30;

/// Each file of a sweep; `set` has the values of `--set`.
pub fn files(sweep: &Sweep, set: &str) -> BTreeSet<PathBuf> {
    let mut named = Files::default();
    for name in sweep.names() {
        // An input can name its population, and options of its reader.
        let source = name.split_once('=').map_or(name.as_str(), |(_, source)| source);
        let path = source.split_once('?').map_or(source, |(path, _)| path);
        [name.as_str(), source, path].into_iter().for_each(|name| named.add(Path::new(name)));
    }
    while let Some(path) = named.unread.pop() {
        let text = std::fs::read_to_string(&path).unwrap_or_default();
        named.add_named_in(&text, &path);
        // Values that a sweep or --set gives to a model name files next to the model.
        named.add_named_in(sweep.text(), &path);
        named.add_named_in(set, &path);
    }
    named.files
}

/// The files found so far.
#[derive(Default)]
struct Files {
    files: BTreeSet<PathBuf>,
    /// Texts of nsim's own that can name other files.
    unread: Vec<PathBuf>,
}

impl Files {
    /// Adds a file, or the files of a folder.
    fn add(&mut self, path: &Path) {
        if path.is_dir() {
            let entries = std::fs::read_dir(path).into_iter().flatten().flatten();
            let arrays = entries.map(|entry| entry.path()).filter(|path| path.extension().is_some_and(|e| e == "npy"));
            arrays.for_each(|path| self.add_file(&path));
        } else {
            self.add_file(path);
        }
    }

    fn add_file(&mut self, path: &Path) {
        let Ok(data) = std::fs::metadata(path) else { return };
        if !data.is_file() || !self.files.insert(path.to_path_buf()) {
            return;
        }
        if path.extension().is_some_and(|extension| extension == "ron") && data.len() <= MOST_BYTES {
            self.unread.push(path.to_path_buf());
        }
    }

    /// Adds the files that a text names, relative to the file at `path` or to the working folder.
    fn add_named_in(&mut self, text: &str, path: &Path) {
        let names: BTreeSet<&str> = text.split('"').filter(|name| (1..LONGEST).contains(&name.len())).collect();
        for name in names.into_iter().filter(|name| name.contains(char::is_alphanumeric) && !name.contains('\n')) {
            // A target names its base, chip and constants without their extension.
            let parts = ["", "../targets/", "../chips/", "../constants/"].map(|folder| format!("{folder}{name}.ron"));
            self.add_file(Path::new(name));
            self.add_file(&sibling_path(path, name));
            parts.iter().for_each(|part| self.add_file(&sibling_path(path, part)));
        }
    }
}
