//! Temporary files, which are removed on a signal.
//!
//! Input: a folder. Output: a file `.nsim-*.tmp` in it. After SIGKILL it remains.

use std::collections::BTreeSet;
use std::io::Result;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use tempfile::NamedTempFile;

/// Temporary files of this process.
static HELD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

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
        let mut builder = tempfile::Builder::new();
        builder.prefix(".nsim-").suffix(".tmp");
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // A temporary file is private by default; this one gets the permissions of an ordinary
            // file.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        let mut held = HELD.lock().map_err(|_| std::io::Error::other("a thread panicked"))?;
        let file = builder.tempfile_in(folder)?;
        held.insert(file.path().to_path_buf());
        let _held = Held(file.path().to_path_buf());
        Ok(Temporary { file, _held })
    }

    /// Renames the file to `path`.
    pub(super) fn persist(self, path: &Path, replace: bool) -> Result<()> {
        let named = if replace { self.file.persist(path) } else { self.file.persist_noclobber(path) };
        named.map(drop).map_err(|error| error.error)
    }
}

/// Removes the temporary files of this process and blocks new ones by keeping the lock.
pub(super) fn abandon() {
    if let Ok(held) = HELD.lock() {
        held.iter().for_each(|path| drop(std::fs::remove_file(path)));
        std::mem::forget(held);
    }
}
