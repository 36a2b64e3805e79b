//! Access to files and folders.
//!
//! Input: paths and open files. Output: metadata, lists of paths, bytes. A path that cannot be
//! examined is an error, not an absent file. A file that ends before its length is an error, not a
//! shorter file.

use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Read, Result};
use std::path::{Path, PathBuf};

/// Waits until the names in a folder are on the disk, where the system can.
pub(super) fn sync_folder(folder: &Path) -> Result<()> {
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

pub(super) fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// Metadata of the entry at a path; links are not followed.
pub(super) fn named(path: &Path) -> Result<Option<Metadata>> {
    present(path.symlink_metadata())
}

/// Whether a file or folder exists at a path.
///
/// # Errors
/// When it cannot be determined.
pub fn exists(path: &Path) -> Result<bool> {
    Ok(present(path.metadata())?.is_some())
}

/// `None` for an absent path. A name within a file is as absent as one within an absent folder.
fn present(found: Result<Metadata>) -> Result<Option<Metadata>> {
    match found {
        Ok(metadata) => Ok(Some(metadata)),
        Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(None),
        Err(error) => Err(error),
    }
}

/// The paths in a folder.
///
/// # Errors
/// When it cannot be listed to its end.
pub fn list(folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
}

/// A file that is read from its beginning to its end.
#[derive(Debug)]
pub struct Input {
    file: File,
    /// Unread bytes of a regular file; 0 for a pipe.
    left: u64,
}

impl Input {
    pub(super) fn open(path: &Path) -> Result<(Input, Metadata)> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        let left = if metadata.is_file() { metadata.len() } else { 0 };
        Ok((Input { file, left }, metadata))
    }
}

impl Read for Input {
    /// Retries after a signal, since `BufRead::fill_buf` does not.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        let read = loop {
            match self.file.read(buffer) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                read => break read?,
            }
        };
        if read == 0 && self.left > 0 {
            return Err(Error::other(format!("the file ends {} bytes early", self.left)));
        }
        self.left = self.left.saturating_sub(read as u64);
        Ok(read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_is_cut_while_it_is_read_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, [7; 100]).unwrap();
        let mut input = Input::open(&path).unwrap().0;
        let mut some = [0; 30];
        input.read_exact(&mut some).unwrap();
        File::options().write(true).open(&path).unwrap().set_len(40).unwrap();
        let mut rest = Vec::new();
        let error = input.read_to_end(&mut rest).unwrap_err();
        assert!(error.to_string().contains("60 bytes early"), "{error}");
        assert!(exists(&path).unwrap() && !exists(&path.join("b")).unwrap());
        assert!(named(&folder.path().join("b")).unwrap().is_none());
        assert_eq!(list(folder.path()).unwrap(), [path]);
    }
}
