//! The operations on the file system that reading and writing consist of, each a place where a
//! fault can be injected.
//!
//! Input: paths and open files. Output: what the operation returns. What may fail fails as an
//! error: nothing that cannot be looked at counts as absent, and a file that ends before its length
//! is an error and not a shorter file. `faults` says which faults builds with debug assertions
//! inject.

#[cfg(all(debug_assertions, unix))]
mod faults;
mod operation;

use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Read, Result, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use tempfile::TempPath;

use self::operation::{Extent, Operation};

/// Lets an operation go on, or fails in its place.
#[cfg(all(debug_assertions, unix))]
use faults::point;

#[cfg(not(all(debug_assertions, unix)))]
fn point(_: Operation) -> Result<Extent> {
    Ok(Extent::Whole)
}

fn change() -> Result<()> {
    point(Operation::Change).map(drop)
}

fn make() -> Result<()> {
    point(Operation::Make).map(drop)
}

fn look() -> Result<()> {
    point(Operation::Look).map(drop)
}

/// Writes some bytes.
pub(super) fn write(file: &mut File, bytes: &[u8]) -> Result<usize> {
    #[cfg(all(debug_assertions, unix))]
    faults::written(file);
    part_of(file, bytes)
}

fn part_of(out: &mut impl Write, bytes: &[u8]) -> Result<usize> {
    match point(Operation::Write)? {
        Extent::Whole => out.write(bytes),
        #[cfg(all(debug_assertions, unix))]
        Extent::Nothing => Ok(0),
        #[cfg(all(debug_assertions, unix))]
        Extent::Half => out.write(&bytes[..bytes.len().div_ceil(2)]),
        #[cfg(all(debug_assertions, unix))]
        Extent::Torn => {
            out.write_all(&bytes[..bytes.len() / 2])?;
            out.flush()?;
            // Like a kill: no destructor runs.
            std::process::exit(137)
        }
    }
}

/// Stdout as a place where writes fail.
pub(super) struct Stdout(pub(super) std::io::StdoutLock<'static>);

impl Write for Stdout {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        part_of(&mut self.0, bytes)
    }

    fn flush(&mut self) -> Result<()> {
        self.0.flush()
    }
}

/// Waits until a file's content is on the disk.
pub(super) fn sync(file: &File) -> Result<()> {
    change()?;
    file.sync_all()?;
    #[cfg(all(debug_assertions, unix))]
    faults::synced(file);
    Ok(())
}

/// Waits until the names in a folder are on the disk, where the system can.
pub(super) fn sync_folder(folder: &Path) -> Result<()> {
    change()?;
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Makes a folder and those above it, and brings their names to the disk.
pub(super) fn make_folder(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    let made: Vec<&Path> = folder.ancestors().take_while(|one| !one.as_os_str().is_empty() && !one.exists()).collect();
    make()?;
    std::fs::create_dir_all(folder)?;
    made.iter().try_for_each(|one| sync_folder(&folder_of(one)))
}

/// Makes a file of a name that no file has.
pub(super) fn create(builder: &tempfile::Builder<'_, '_>, folder: &Path) -> Result<(File, TempPath)> {
    make()?;
    Ok(builder.tempfile_in(folder)?.into_parts())
}

/// Opens a file for writing that keeps what it holds, and makes it when it is absent.
pub(super) fn open_or_make(path: &Path) -> Result<File> {
    make()?;
    File::options().create(true).truncate(false).write(true).open(path)
}

/// Cuts a file to so many bytes and goes to its end.
pub(super) fn cut(file: &mut File, bytes: u64) -> Result<()> {
    change()?;
    file.set_len(bytes)?;
    file.seek(SeekFrom::Start(bytes)).map(drop)
}

/// Gives a temporary file its name; one that exists is replaced or kept.
pub(super) fn persist(temporary: TempPath, path: &Path, replace: bool) -> Result<()> {
    change()?;
    let named = if replace { temporary.persist(path) } else { temporary.persist_noclobber(path) };
    named.map_err(|error| error.error)
}

/// Renames a file.
pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    change()?;
    std::fs::rename(from, to)
}

/// Removes a file.
pub(super) fn remove(path: &Path) -> Result<()> {
    change()?;
    std::fs::remove_file(path)
}

/// The folder that a file lies in.
pub(super) fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}

/// What stands at a path, behind symbolic links.
pub(super) fn metadata(path: &Path) -> Result<Metadata> {
    look()?;
    std::fs::metadata(path)
}

/// What stands at a path itself, if anything.
pub(super) fn named(path: &Path) -> Result<Option<Metadata>> {
    look()?;
    present(path.symlink_metadata())
}

/// Whether there is something at a path.
///
/// # Errors
/// When it cannot be told.
pub fn exists(path: &Path) -> Result<bool> {
    look()?;
    Ok(present(path.metadata())?.is_some())
}

/// None for what is not there. A name within a file is as absent as one within an absent folder.
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
    look()?;
    std::fs::read_dir(folder)?.map(|entry| Ok(entry?.path())).collect()
}

/// A file that is read from its beginning to its end.
#[derive(Debug)]
pub struct Input {
    file: File,
    /// Bytes before its end; none of a pipe.
    left: u64,
}

impl Input {
    /// Opens a file.
    pub(super) fn open(path: &Path) -> Result<(Input, Metadata)> {
        look()?;
        let file = File::open(path)?;
        look()?;
        let metadata = file.metadata()?;
        let left = if metadata.is_file() { metadata.len() } else { 0 };
        Ok((Input { file, left }, metadata))
    }
}

impl Read for Input {
    /// Goes on after a signal: `BufRead::fill_buf` does not.
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        loop {
            match self.read_once(buffer) {
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }
}

impl Input {
    fn read_once(&mut self, buffer: &mut [u8]) -> Result<usize> {
        if buffer.is_empty() {
            return Ok(0);
        }
        let wanted = match point(Operation::Read)? {
            #[cfg(all(debug_assertions, unix))]
            Extent::Nothing => 0,
            #[cfg(all(debug_assertions, unix))]
            Extent::Half | Extent::Torn => buffer.len().div_ceil(2),
            Extent::Whole => buffer.len(),
        };
        let read = if wanted == 0 { 0 } else { self.file.read(&mut buffer[..wanted])? };
        if read == 0 && self.left > 0 {
            return Err(Error::other(format!("it ends {} bytes before its length", self.left)));
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
        assert!(error.to_string().contains("60 bytes before"), "{error}");
        assert!(exists(&path).unwrap() && !exists(&path.join("b")).unwrap());
        assert!(named(&folder.path().join("b")).unwrap().is_none());
        assert_eq!(list(folder.path()).unwrap(), [path]);
    }
}
