//! Files that belong together: no file gets its name before all are complete.
//!
//! Input: paths and their contents. Output: all of the files; each is old or complete at every
//! moment. The last one is renamed last, since it names the others.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::temporary::Temporary;
use crate::disk;
use crate::text::{self, is_standard_stream};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

fn exists(path: &Path) -> Diagnostic {
    Diagnostic::new("write.exists", "the file exists already")
        .help("add --force to replace it, or give another name")
        .in_file(path)
}

/// Makes the diagnostic of a file that cannot be written.
pub(super) fn failed(path: &Path) -> impl Fn(std::io::Error) -> Diagnostic {
    move |error| Diagnostic::new("write.failed", format!("cannot be written: {error}")).in_file(path)
}

/// Size of write buffers in bytes: an array of a few MB takes some twenty system calls.
pub(crate) const BUFFER_BYTES: usize = 1 << 18;

/// Opens a file for writing without truncating it; an absent file is created. A pipe is refused,
/// since opening it would wait for a reader.
pub(super) fn open_or_make(path: &Path) -> Result<File> {
    match path.metadata() {
        Ok(found) if !found.is_file() && !found.is_dir() => {
            Err(text::not_regular(path).help("remove it, or give the result another name"))
        }
        _ => {
            let mut options = File::options();
            options.create(true).truncate(false).write(true).open(path).map_err(failed(path))
        }
    }
}

/// Checks that a file may be written, before a long run that would otherwise fail at its end.
///
/// # Errors
/// `write.exists`, `write.folder`, `write.failed`; `write.not-regular` for a device, a pipe, a
/// socket or a link to nothing.
pub fn check_free(path: &Path, force: bool) -> Result<()> {
    if is_standard_stream(path) {
        return Ok(());
    }
    let Some(named) = disk::named(path).map_err(failed(path))? else { return Ok(()) };
    let kind = path.metadata().map(|metadata| metadata.file_type());
    match kind {
        Ok(kind) if kind.is_dir() => {
            Err(Diagnostic::new("write.folder", "this is a folder, but the result is a file").in_file(path))
        }
        Ok(kind) if !kind.is_file() => Err(not_regular(path, "this is a device, a pipe or a socket")),
        _ if !force => Err(exists(path)),
        Err(_) if named.is_symlink() => Err(not_regular(path, "this is a link whose target does not exist")),
        _ => Ok(()),
    }
}

fn not_regular(path: &Path, what: &str) -> Diagnostic {
    Diagnostic::new("write.not-regular", format!("{what}; only regular files are replaced"))
        .help("give the name of a file, or - for stdout")
        .in_file(path)
}

/// [`check_free`] for each of several files. Errors are those of [`check_free`].
pub fn check_all_free(paths: impl IntoIterator<Item: AsRef<Path>>, force: bool) -> Result<()> {
    paths.into_iter().try_for_each(|path| check_free(path.as_ref(), force))
}

/// Files that belong together: no file gets its name before all are complete.
#[derive(Debug)]
pub struct Batch {
    force: bool,
    parts: Vec<(PathBuf, Temporary)>,
}

impl Batch {
    /// An empty batch; existing files are replaced only with `force`.
    pub fn new(force: bool) -> Batch {
        Batch { force, parts: Vec::new() }
    }

    /// Writes a file of the batch under a temporary name, through `fill`, and returns its result.
    ///
    /// # Errors
    /// `write.exists`, `write.folder`, `write.not-regular`, `write.failed`.
    pub fn add<T>(
        &mut self,
        path: &Path,
        fill: impl FnOnce(&mut (dyn Write + Send)) -> std::io::Result<T>,
    ) -> Result<T> {
        check_free(path, self.force)?;
        // The target of a symbolic link is replaced, not the link.
        let real = match path.symlink_metadata() {
            Ok(named) if named.is_symlink() => path.canonicalize().map_err(failed(path))?,
            _ => path.to_path_buf(),
        };
        let mut temporary = Temporary::new(&disk::folder_of(&real)).map_err(failed(path))?;
        let mut out = BufWriter::with_capacity(BUFFER_BYTES, temporary.file.as_file_mut());
        let filled = fill(&mut out).map_err(failed(path))?;
        out.flush().and_then(|()| out.get_ref().sync_all()).map_err(failed(path))?;
        drop(out);
        self.parts.push((real, temporary));
        Ok(filled)
    }

    /// Renames the files in order and syncs their folders.
    ///
    /// # Errors
    /// `write.exists`, `write.failed`.
    pub fn commit(self) -> Result<()> {
        let folders: BTreeSet<PathBuf> = self.parts.iter().map(|(path, _)| disk::folder_of(path)).collect();
        self.name_all()?;
        folders.iter().try_for_each(|folder| disk::sync_folder(folder).map_err(failed(folder)))
    }

    /// Renames the temporary files, in order.
    pub(super) fn name_all(self) -> Result<()> {
        let Batch { force, parts } = self;
        parts.into_iter().try_for_each(|(path, file)| {
            file.persist(&path, force).map_err(|error| match error.kind() {
                // Another process has created it in the meantime.
                ErrorKind::AlreadyExists => exists(&path),
                _ => failed(&path)(error),
            })
        })
    }
}
