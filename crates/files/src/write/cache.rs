//! A folder of the user in which results are kept that take long to find again.
//!
//! Input: a name of letters and digits, bytes. Output: the bytes that were kept under a name. An
//! entry is a file, written as every file is ([`crate::write`]): absent, old or complete at every
//! moment, whatever other processes do. Once all entries take more than [`MOST_BYTES`] the oldest
//! are removed.
//!
//! Nothing here is an error but what `nsim cache` is asked to do: where there is no folder, or it
//! cannot be read or written, nothing is kept. Whoever reads an entry must not believe it.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::SystemTime;

use crate::{disk, text, write};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// Bytes of all entries that are kept at most.
pub const MOST_BYTES: u64 = 1 << 30;
const SUFFIX: &str = ".mapping";

/// Whether this process neither reads nor writes the cache.
static OFF: AtomicBool = AtomicBool::new(false);

/// Lets this process neither read nor write the cache.
pub fn turn_off() {
    OFF.store(true, Ordering::SeqCst);
}

/// Whether this process writes no entries, because another of the same job does.
static READ_ONLY: AtomicBool = AtomicBool::new(false);

/// Lets this process read the cache and not write it.
pub fn read_only() {
    READ_ONLY.store(true, Ordering::SeqCst);
}

/// The user's folder, if the system says which.
#[must_use]
pub fn folder() -> Option<PathBuf> {
    let set = |name: &str| std::env::var_os(name).filter(|path| Path::new(path).is_absolute()).map(PathBuf::from);
    let base = set("XDG_CACHE_HOME").or_else(|| {
        if cfg!(windows) {
            set("LOCALAPPDATA")
        } else if cfg!(target_os = "macos") {
            set("HOME").map(|home| home.join("Library/Caches"))
        } else {
            set("HOME").map(|home| home.join(".cache"))
        }
    })?;
    Some(base.join("nsim").join("mappings"))
}

/// What is kept under a name.
#[must_use]
pub fn get(name: &str) -> Option<Vec<u8>> {
    if OFF.load(Ordering::SeqCst) {
        return None;
    }
    read(&folder()?.join(format!("{name}{SUFFIX}")))
}

fn read(path: &Path) -> Option<Vec<u8>> {
    disk::exists(path).ok().filter(|&exists| exists)?;
    text::read_bytes(path, MOST_BYTES).ok()
}

/// Keeps bytes under a name, if that is possible.
pub fn put(name: &str, bytes: &[u8]) {
    if OFF.load(Ordering::SeqCst) || READ_ONLY.load(Ordering::SeqCst) || bytes.len() as u64 > MOST_BYTES {
        return;
    }
    let Some(folder) = folder() else { return };
    let path = folder.join(format!("{name}{SUFFIX}"));
    match write::file(&path, true, |out| out.write_all(bytes)) {
        Ok(()) => drop(keep(&folder, MOST_BYTES)),
        Err(error) => tracing::debug!(%error, "the mapping is not kept"),
    }
}

/// An entry.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its file.
    pub path: PathBuf,
    /// Bytes.
    pub bytes: u64,
    /// When it was written.
    pub written: SystemTime,
}

/// The entries of a folder, the newest first; none where there is no folder.
///
/// # Errors
/// `cache.folder` when it cannot be listed.
pub fn entries(folder: &Path) -> Result<Vec<Entry>> {
    let failed = |error: std::io::Error| Diagnostic::new("cache.folder", format!("{}: {error}", folder.display()));
    if !disk::exists(folder).map_err(failed)? {
        return Ok(Vec::new());
    }
    let entry = |path: PathBuf| {
        let name = path.file_name()?.to_str()?;
        // What another process has removed meanwhile is no entry.
        let found = name.ends_with(SUFFIX).then(|| disk::named(&path).ok().flatten())??;
        Some(Entry { bytes: found.len(), written: found.modified().ok()?, path: path.clone() })
    };
    let mut entries: Vec<Entry> = disk::list(folder).map_err(failed)?.into_iter().filter_map(entry).collect();
    entries.sort_by(|a, b| (b.written, &a.path).cmp(&(a.written, &b.path)));
    Ok(entries)
}

/// Removes the oldest entries until the others take at most so many bytes; returns how many were
/// removed.
///
/// # Errors
/// As [`entries`].
pub fn keep(folder: &Path, most_bytes: u64) -> Result<usize> {
    let (mut sum, mut removed) = (0u64, 0);
    for entry in entries(folder)? {
        sum = sum.saturating_add(entry.bytes);
        if sum > most_bytes && disk::remove(&entry.path).is_ok() {
            removed += 1;
        }
    }
    Ok(removed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn the_oldest_entries_give_way_and_other_files_stay() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(entries(&folder.path().join("absent")).unwrap(), []);
        let now = SystemTime::now();
        for (age, name) in ["d.mapping", "a.mapping", "c.mapping", "b.mapping"].into_iter().enumerate() {
            let path = folder.path().join(name);
            std::fs::write(&path, [0; 100]).unwrap();
            let file = std::fs::File::options().write(true).open(&path).unwrap();
            file.set_modified(now - Duration::from_secs(60 * age as u64)).unwrap();
        }
        std::fs::write(folder.path().join("other"), [0; 500]).unwrap();
        let names = || {
            let found = entries(folder.path()).unwrap();
            found.iter().map(|e| e.path.file_name().unwrap().to_str().unwrap().to_string()).collect::<Vec<_>>()
        };
        assert_eq!(names(), ["d.mapping", "a.mapping", "c.mapping", "b.mapping"]);
        assert_eq!(keep(folder.path(), 400).unwrap(), 0);
        assert_eq!(keep(folder.path(), 250).unwrap(), 2);
        assert_eq!(names(), ["d.mapping", "a.mapping"]);
        assert_eq!(keep(folder.path(), 0).unwrap(), 2);
        assert!(folder.path().join("other").exists());
    }
}
