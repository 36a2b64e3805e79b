//! The operations on the file system that writing consists of, each a place where a fault can be injected.
//!
//! Input: paths and open files. Output: what the operation returns. In builds with debug assertions the variable
//! `NSIM_FAULT=KIND:N` makes the N-th operation of the process (from 1) fail: `eio`, `enospc`, `short` (half of a write
//! happens before it fails), `kill` (the process ends there, and nothing is tidied up), `panic` or `abort`. Release builds do
//! not look at it.

use std::fs::File;
use std::io::{Result, Write};
use std::path::{Path, PathBuf};

use tempfile::TempPath;

/// Lets an operation go on, or fails in its place.
#[cfg(debug_assertions)]
fn point() -> Result<Fault> {
    use std::io::Error;
    use std::sync::LazyLock;
    use std::sync::atomic::{AtomicU64, Ordering};
    static ASKED: LazyLock<Option<(String, u64)>> = LazyLock::new(|| {
        let text = std::env::var("NSIM_FAULT").ok()?;
        let (kind, number) = text.split_once(':')?;
        Some((kind.to_string(), number.parse().ok()?))
    });
    static DONE: AtomicU64 = AtomicU64::new(0);
    let Some((kind, number)) = &*ASKED else { return Ok(Fault::None) };
    if DONE.fetch_add(1, Ordering::Relaxed) + 1 != *number {
        return Ok(Fault::None);
    }
    let _ = writeln!(std::io::stderr(), "injected: {kind}");
    match kind.as_str() {
        "eio" => Err(Error::from_raw_os_error(5)),
        "enospc" => Err(Error::from_raw_os_error(28)),
        "short" => Ok(Fault::Short),
        "panic" => panic!("a panic was asked for"),
        "abort" => std::process::abort(),
        // Like a kill: no destructor runs, locks are released.
        _ => std::process::exit(137),
    }
}

#[cfg(not(debug_assertions))]
fn point() -> Result<Fault> {
    Ok(Fault::None)
}

/// What befalls a write.
#[derive(Debug, PartialEq, Eq)]
enum Fault {
    None,
    /// Half of it happens. Operations other than writes fail as a whole.
    Short,
}

/// [`point`] for what happens wholly or not at all.
fn whole() -> Result<()> {
    if point()? == Fault::Short { Err(std::io::Error::from_raw_os_error(28)) } else { Ok(()) }
}

/// Writes some bytes.
pub(super) fn write(file: &mut File, bytes: &[u8]) -> Result<usize> {
    if point()? == Fault::Short {
        file.write_all(&bytes[..bytes.len() / 2])?;
        return Err(std::io::Error::from_raw_os_error(28));
    }
    file.write(bytes)
}

/// Waits until a file's content is on the disk.
pub(super) fn sync(file: &File) -> Result<()> {
    whole()?;
    file.sync_all()
}

/// Waits until the names in a folder are on the disk, where the system can.
pub(super) fn sync_folder(folder: &Path) -> Result<()> {
    whole()?;
    if cfg!(unix) { File::open(folder)?.sync_all() } else { Ok(()) }
}

/// Makes a folder and those above it.
pub(super) fn make_folder(folder: &Path) -> Result<()> {
    if folder.is_dir() {
        return Ok(());
    }
    whole()?;
    std::fs::create_dir_all(folder)
}

/// Makes a file of a name that no file has.
pub(super) fn create(builder: &tempfile::Builder<'_, '_>, folder: &Path) -> Result<(File, TempPath)> {
    whole()?;
    Ok(builder.tempfile_in(folder)?.into_parts())
}

/// Gives a temporary file its name; one that exists is replaced or kept.
pub(super) fn persist(temporary: TempPath, path: &Path, replace: bool) -> Result<()> {
    whole()?;
    let named = if replace { temporary.persist(path) } else { temporary.persist_noclobber(path) };
    named.map_err(|error| error.error)
}

/// Renames a file.
pub(super) fn rename(from: &Path, to: &Path) -> Result<()> {
    whole()?;
    std::fs::rename(from, to)
}

/// Removes a file.
pub(super) fn remove(path: &Path) -> Result<()> {
    whole()?;
    std::fs::remove_file(path)
}

/// The folder that a file lies in.
pub(super) fn folder_of(path: &Path) -> PathBuf {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_path_buf(),
        _ => PathBuf::from("."),
    }
}
