//! Temporary files: held by a lock while a process writes them, removed by the next one when it
//! died.
//!
//! Input: a folder. Output: a file in it under a name `.nsim-*.tmp`, locked. A file of such a name
//! that nobody holds was left by a process that was killed; [`clean`] removes it. Between making a
//! file and locking it another process may remove it: a file that has lost its name is made again.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{Result, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use tempfile::TempPath;

use crate::disk;

const PREFIX: &str = ".nsim-";
const SUFFIX: &str = ".tmp";
/// How often a temporary file is made again when another process removes it.
const ATTEMPTS: usize = 16;

/// Temporary files of this process, which a signal removes.
static HELD: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());
/// Folders in which this process has removed what others left.
static CLEANED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// A file that is being written.
#[derive(Debug)]
pub(super) struct Temporary {
    file: File,
    path: Option<TempPath>,
}

impl Temporary {
    /// A new file in a folder, which is made when it is absent.
    pub(super) fn new(folder: &Path) -> Result<Temporary> {
        std::fs::create_dir_all(folder)?;
        clean(folder);
        let mut builder = tempfile::Builder::new();
        builder.prefix(PREFIX).suffix(SUFFIX);
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // A temporary file is private by default; this one gets the permissions of an ordinary
            // file.
            builder.permissions(std::fs::Permissions::from_mode(0o666));
        }
        for _ in 0..ATTEMPTS {
            let (file, path) = {
                let Ok(mut held) = HELD.lock() else { break };
                let (file, path) = builder.tempfile_in(folder)?.into_parts();
                held.insert(path.to_path_buf());
                (file, path)
            };
            let temporary = Temporary { file, path: Some(path) };
            // Where files cannot be locked nobody removes those of others either.
            let _ = temporary.file.lock();
            if has_name(&temporary.file) {
                return Ok(temporary);
            }
        }
        Err(std::io::Error::other("temporary files are removed as soon as they are made"))
    }

    /// Waits until the content is on the disk.
    pub(super) fn sync(&self) -> Result<()> {
        self.file.sync_all()
    }

    /// Gives the file its name.
    pub(super) fn persist(mut self, path: &Path, replace: bool) -> Result<()> {
        match self.path.take() {
            Some(temporary) => {
                let name = temporary.to_path_buf();
                let named = match replace {
                    true => temporary.persist(path),
                    false => temporary.persist_noclobber(path),
                };
                forget(&name);
                named.map_err(|error| error.error)
            }
            None => Ok(()),
        }
    }
}

impl Write for Temporary {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> Result<()> {
        self.file.flush()
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        if let Some(path) = self.path.take() {
            forget(&path);
        }
    }
}

fn forget(path: &Path) {
    if let Ok(mut held) = HELD.lock() {
        held.remove(path);
    }
}

#[cfg(unix)]
fn has_name(file: &File) -> bool {
    use std::os::unix::fs::MetadataExt;
    file.metadata().is_ok_and(|metadata| metadata.nlink() > 0)
}

#[cfg(not(unix))]
fn has_name(_: &File) -> bool {
    true
}

/// Removes the temporary files of a folder that nobody holds, once for each folder.
fn clean(folder: &Path) {
    if !CLEANED.lock().is_ok_and(|mut cleaned| cleaned.insert(folder.to_path_buf())) {
        return;
    }
    // What cannot be listed or looked at stays for another command.
    for path in disk::list(folder).unwrap_or_default() {
        let name = path.file_name().and_then(std::ffi::OsStr::to_str);
        if name.is_some_and(|name| name.starts_with(PREFIX) && name.ends_with(SUFFIX))
            && disk::named(&path).is_ok_and(|found| found.is_some_and(|found| found.is_file()))
            && let Ok(file) = File::open(&path)
            && file.try_lock().is_ok()
        {
            let _ = std::fs::remove_file(&path);
        }
    }
}

/// Removes the temporary files of this process and lets it make no more: it is about to end.
pub(super) fn abandon() {
    if let Ok(held) = HELD.lock() {
        held.iter().for_each(|path| drop(std::fs::remove_file(path)));
        std::mem::forget(held);
    }
}
