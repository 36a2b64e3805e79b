//! Faults of the file system on request.
//!
//! Input: the variable `NSIM_FAULT=KIND:N`. Output: the N-th operation of the process (from 1) that
//! the kind befalls fails. Release builds do not have this file.
//!
//! | kind | befalls | what happens |
//! |---|---|---|
//! | `eio`, `enospc` | writes, makes, changes | an error, once |
//! | `broken` | writes, makes, changes | an error from then on |
//! | `full` | writes, makes | a full disk from then on |
//! | `short` | writes | half of the bytes, then a full disk |
//! | `partial`, `interrupted` | writes | half of the bytes, or none, which a caller has to continue |
//! | `kill`, `panic`, `abort` | writes, makes, changes | the process ends there, and nothing is tidied up |
//! | `torn` | writes | half of the bytes, then a kill |
//! | `power` | writes, makes, changes | a kill, and what no fsync has brought to the disk is lost |
//! | `read-eio`, `read-broken` | reads, looks | an error, once or from then on |
//! | `read-partial`, `read-interrupted` | reads | half of the bytes, or none, which a caller has to continue |
//! | `read-end` | reads | the file ends there |
//! | `list` | | the class of each operation is named on stderr |

use std::fs::File;
use std::io::{Error, ErrorKind, Result, Write};
use std::os::unix::fs::MetadataExt;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{LazyLock, Mutex};

use super::operation::{Extent, Operation};

static ASKED: LazyLock<Option<(String, u64)>> = LazyLock::new(|| {
    let text = std::env::var("NSIM_FAULT").ok()?;
    let (kind, number) = text.split_once(':')?;
    Some((kind.to_string(), number.parse().ok()?))
});
/// Operations that the kind could have befallen.
static DONE: AtomicU64 = AtomicU64::new(0);
/// Whether the disk is full since a short write.
static FULL: AtomicBool = AtomicBool::new(false);
/// Files with bytes that are not on the disk.
static UNSYNCED: Mutex<Vec<File>> = Mutex::new(Vec::new());

const EIO: i32 = 5;
const ENOSPC: i32 = 28;

fn error(code: i32) -> Result<Extent> {
    Err(Error::from_raw_os_error(code))
}

/// Lets an operation go on, or fails in its place.
pub(super) fn point(operation: Operation) -> Result<Extent> {
    let Some((kind, number)) = &*ASKED else { return Ok(Extent::Whole) };
    let kind = kind.as_str();
    let read = matches!(operation, Operation::Read | Operation::Look);
    let bytes = matches!(operation, Operation::Read | Operation::Write);
    if kind == "list" {
        let _ = writeln!(std::io::stderr(), "operation: {operation:?}");
        return Ok(Extent::Whole);
    }
    let takes_space = matches!(operation, Operation::Write | Operation::Make);
    if FULL.load(Ordering::SeqCst) && takes_space {
        return error(ENOSPC);
    }
    let of_bytes = ["short", "partial", "interrupted", "torn", "read-partial", "read-interrupted", "read-end"];
    if kind.starts_with("read-") != read || (of_bytes.contains(&kind) && !bytes) || (kind == "full" && !takes_space) {
        return Ok(Extent::Whole);
    }
    let here = DONE.fetch_add(1, Ordering::SeqCst) + 1;
    let stays = ["broken", "full", "read-broken"].contains(&kind);
    if here < *number || (here > *number && !stays) {
        return Ok(Extent::Whole);
    }
    if here == *number {
        let _ = writeln!(std::io::stderr(), "injected: {kind}");
    }
    match kind {
        "eio" | "broken" | "read-eio" | "read-broken" => error(EIO),
        "enospc" | "full" => error(ENOSPC),
        "interrupted" | "read-interrupted" => Err(ErrorKind::Interrupted.into()),
        "short" => {
            FULL.store(true, Ordering::SeqCst);
            Ok(Extent::Half)
        }
        "partial" | "read-partial" => Ok(Extent::Half),
        "read-end" => Ok(Extent::Nothing),
        "torn" => Ok(Extent::Torn),
        "panic" => panic!("a panic was asked for"),
        "abort" => std::process::abort(),
        "power" => {
            if let Ok(files) = UNSYNCED.lock() {
                files.iter().for_each(|file| drop(file.set_len(0)));
            }
            std::process::exit(137)
        }
        // Like a kill: no destructor runs, locks are released.
        _ => std::process::exit(137),
    }
}

fn same(one: &File, other: &File) -> bool {
    let place = |file: &File| file.metadata().ok().map(|found| (found.dev(), found.ino()));
    place(one) == place(other)
}

/// A file is being written.
pub(super) fn written(file: &File) {
    if ASKED.as_ref().is_some_and(|(kind, _)| kind == "power")
        && let Ok(mut files) = UNSYNCED.lock()
        && !files.iter().any(|other| same(other, file))
        && let Ok(file) = file.try_clone()
    {
        files.push(file);
    }
}

/// A file is on the disk.
pub(super) fn synced(file: &File) {
    if let Ok(mut files) = UNSYNCED.lock() {
        files.retain(|other| !same(other, file));
    }
}
