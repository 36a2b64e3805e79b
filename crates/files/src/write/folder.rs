//! A folder of files with a manifest that names them, replaced as a whole.
//!
//! Input: a folder and the name of its manifest. While files are written, the folder has a locked
//! file [`MARKER`] and no manifest. A marker without a lock means that a writer was killed; another
//! process may replace its files. The manifest is written last.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::batch::{Batch, check_free, failed, open_or_make};
use crate::disk;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The file that marks a folder as unfinished.
const MARKER: &str = ".nsim-unfinished";

/// Folders that this process is writing.
static WRITING: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Folders that this process has begun to write and not finished.
pub(super) fn unfinished() -> Vec<PathBuf> {
    WRITING.lock().map(|writing| writing.iter().cloned().collect()).unwrap_or_default()
}

/// A folder that is being written.
#[derive(Debug)]
pub struct Folder {
    path: PathBuf,
    manifest: PathBuf,
    /// The marker file, whose lock lasts while it is open.
    _marker: File,
    /// Whether files of the folder may be replaced.
    replace: bool,
}

/// Whether a writer of this folder was killed or is still writing. A marker next to a manifest does
/// not count: it is about to be removed, or the manifest is.
///
/// # Errors
/// When the state of the files cannot be determined.
pub fn is_unfinished(folder: &Path, manifest: &str) -> std::io::Result<bool> {
    Ok(disk::exists(&folder.join(MARKER))? && !disk::exists(&folder.join(manifest))?)
}

impl Folder {
    /// Begins to write: creates the marker and removes an existing manifest, if `force` permits it.
    ///
    /// # Errors
    /// `write.exists`, `write.folder`, `write.not-regular`, `write.failed`; `write.busy` when
    /// another process is writing to the folder.
    pub fn begin(path: &Path, manifest: &str, force: bool) -> Result<Folder> {
        let (name, manifest) = (manifest, path.join(manifest));
        check_free(&manifest, force)?;
        std::fs::create_dir_all(path).map_err(failed(path))?;
        let marker = path.join(MARKER);
        let interrupted = is_unfinished(path, name).map_err(failed(path))?;
        let file = open_or_make(&marker)?;
        if let Err(std::fs::TryLockError::WouldBlock) = file.try_lock() {
            return Err(Diagnostic::new("write.busy", "another nsim is writing to this folder").in_file(path));
        }
        if disk::named(&manifest).map_err(failed(path))?.is_some() {
            std::fs::remove_file(&manifest).map_err(failed(path))?;
        }
        if let Ok(mut writing) = WRITING.lock() {
            writing.insert(path.to_path_buf());
        }
        Ok(Folder { path: path.to_path_buf(), manifest, _marker: file, replace: force || interrupted })
    }

    /// Writes a file of the folder.
    ///
    /// # Errors
    /// `write.exists`, `write.failed`; as [`Batch::add`].
    pub fn member(&self, name: &str, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
        let mut batch = Batch::new(self.replace);
        batch.add(&self.path.join(name), |out| fill(out))?;
        batch.name_all()
    }

    /// Writes the manifest. Errors are those of [`Batch::add`] and [`Batch::commit`].
    pub fn finish(self, text: &str) -> Result<()> {
        let mut batch = Batch::new(false);
        batch.add(&self.manifest, |out| out.write_all(text.as_bytes()))?;
        batch.commit()?;
        if let Ok(mut writing) = WRITING.lock() {
            writing.remove(&self.path);
        }
        let marker = self.path.join(MARKER);
        std::fs::remove_file(&marker).map_err(failed(&marker))
    }
}
