//! Temporary files, which are removed on a signal.
//!
//! Input: a folder. Output: a file `.nsim-*.tmp` in it. After SIGKILL it remains until a process
//! writes to the folder again: the file of a living process has a lock.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Result;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Duration;

use tempfile::NamedTempFile;

/// Temporary files of this process.
static HELD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Folders from which this process has removed the files of killed ones.
static SWEPT: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

const PREFIX: &str = ".nsim-";
const SUFFIX: &str = ".tmp";

/// Age of a file that is removed, so that its process has had the time to lock it.
const LEAST_AGE: Duration = Duration::from_secs(60);

/// A file that is being written.
#[derive(Debug)]
pub(super) struct Temporary {
    pub(super) file: NamedTempFile,
    _held: Held,
}

/// A path that a signal has to remove.
#[derive(Debug)]
struct Held(PathBuf);

impl Drop for Held {
    fn drop(&mut self) {
        if let Ok(mut held) = HELD.lock() {
            held.remove(&self.0);
        }
    }
}

impl Temporary {
    /// Creates a file in a folder, which is created when absent.
    pub(super) fn new(folder: &Path) -> Result<Temporary> {
        std::fs::create_dir_all(folder)?;
        if SWEPT.lock().is_ok_and(|mut swept| swept.insert(folder.to_path_buf())) {
            remove_abandoned(folder);
        }
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // A temporary file is private by default; this one gets the permissions of an ordinary
            // file.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut held = HELD.lock().map_err(|_| std::io::Error::other("a thread panicked"))?;
        let file = builder.tempfile_in(folder)?;
        // Without locks, as on some network drives, nothing is removed later.
        let _ = file.as_file().try_lock();
        held.insert(file.path().to_path_buf());
        let _held = Held(file.path().to_path_buf());
        Ok(Temporary { file, _held })
    }

    pub(super) fn persist(self, path: &Path, replace: bool) -> Result<()> {
        let named = if replace { self.file.persist(path) } else { self.file.persist_noclobber(path) };
        named.map(drop).map_err(|error| error.error)
    }
}

/// Removes the temporary files of killed processes from a folder, as far as the system permits.
fn remove_abandoned(folder: &Path) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let is_ours = name.to_str().is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX));
        if is_ours && is_abandoned(&entry.path()).unwrap_or(false) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
}

/// Whether a file is old, and no process has locked it.
fn is_abandoned(path: &Path) -> Result<bool> {
    let data = path.symlink_metadata()?;
    let is_old = data.is_file() && data.modified()?.elapsed().is_ok_and(|age| age > LEAST_AGE);
    Ok(is_old && File::open(path)?.try_lock().is_ok())
}

/// Removes the temporary files of this process and blocks new ones by keeping the lock.
pub(super) fn abandon() {
    if let Ok(held) = HELD.lock() {
        held.iter().for_each(|path| drop(std::fs::remove_file(path)));
        std::mem::forget(held);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_killed_processes_are_removed_and_those_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, age: u64| {
            let file = File::create(folder.path().join(name)).unwrap();
            file.set_modified(std::time::SystemTime::now() - Duration::from_secs(age)).unwrap();
            file
        };
        let locked = file(".nsim-living.tmp", 3_600);
        locked.try_lock().unwrap();
        drop([file(".nsim-killed.tmp", 3_600), file(".nsim-new.tmp", 1), file("other.tmp", 3_600)]);
        drop(Temporary::new(folder.path()).unwrap());
        let entries = std::fs::read_dir(folder.path()).unwrap();
        let names: BTreeSet<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        assert_eq!(names.into_iter().collect::<Vec<_>>(), [".nsim-living.tmp", ".nsim-new.tmp", "other.tmp"]);
    }
}
