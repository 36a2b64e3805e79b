//! Writing: files that are absent, old or complete at every moment.
//!
//! Input: a path, `-` for stdout, and the content. A file is written under a temporary name in its
//! folder, synced, renamed, and its folder synced. Several files that belong together ([`Batch`])
//! are all complete before the first is renamed. A folder with a manifest is a [`Folder`]. Only
//! regular files are replaced, and only on request; of a symbolic link, the target is replaced.

mod batch;
pub mod checksum;
mod folder;
pub mod journal;
mod temporary;

use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

pub(crate) use self::batch::BUFFER_BYTES;
use self::batch::failed;
pub use self::batch::{Batch, check_all_free, check_free};
pub use self::folder::{Folder, is_unfinished};
use super::text::is_standard_stream;
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::names::printable;

static PRINTING: AtomicBool = AtomicBool::new(false);

/// Whether stdout has received output, after which nothing may be added to a result.
pub fn has_printed() -> bool {
    PRINTING.load(Ordering::SeqCst)
}

/// Whether stdout is suppressed, because another process of the job prints.
static SILENT: AtomicBool = AtomicBool::new(false);

/// Suppresses stdout of this process, or restores it.
pub fn be_silent(silent: bool) {
    SILENT.store(silent, Ordering::SeqCst);
}

/// Whether stdout of this process is suppressed.
pub fn is_silent() -> bool {
    SILENT.load(Ordering::SeqCst)
}

/// Writes a file through `fill`; an absent folder is created. `-` is stdout.
///
/// # Errors
/// `write.exists`, `write.folder`, `write.not-regular`, `write.failed`.
pub fn file(path: &Path, force: bool, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    if is_standard_stream(path) {
        if is_silent() {
            return Ok(());
        }
        let mut out = BufWriter::new(std::io::stdout().lock());
        PRINTING.store(true, Ordering::SeqCst);
        let done = fill(&mut out).and_then(|()| out.flush()).or_else(ignore_closed_pipe);
        return done.map_err(failed(Path::new("<stdout>")));
    }
    let mut batch = Batch::new(force);
    batch.add(path, |out| fill(out))?;
    batch.commit()
}

/// Removes the temporary files of this process before it ends, and prevents new ones. Returns the
/// folders that remain unfinished.
pub fn abandon() -> Vec<PathBuf> {
    temporary::abandon();
    folder::unfinished()
}

/// Writes a text file. Errors are those of [`file()`].
pub fn text(path: &Path, force: bool, text: &str) -> Result<()> {
    file(path, force, |out| out.write_all(text.as_bytes()))
}

/// Prints a text to stdout, with unprintable characters replaced. A closed pipe (`nsim .. | head`)
/// is not an error.
///
/// # Errors
/// `write.failed`.
pub fn stdout(text: &str) -> Result<()> {
    self::text(Path::new("-"), false, &printable(text))
}

fn ignore_closed_pipe(error: std::io::Error) -> std::io::Result<()> {
    if error.kind() == ErrorKind::BrokenPipe { Ok(()) } else { Err(error) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_appears_whole_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/deep/a.txt");
        text(&path, false, "one").unwrap();
        assert_eq!(text(&path, false, "two").unwrap_err().code, "write.exists");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one");
        text(&path, true, "two").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        let half = file(&path, true, |out| {
            out.write_all(b"half")?;
            Err(std::io::Error::other("disk on fire"))
        });
        assert_eq!(half.unwrap_err().code, "write.failed");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "two");
        let names: Vec<_> = std::fs::read_dir(path.parent().unwrap()).unwrap().collect();
        assert_eq!(names.len(), 1, "{names:?}");
        assert_eq!(text(folder.path(), true, "x").unwrap_err().code, "write.folder");
        assert_eq!(text(&path.join("b"), false, "x").unwrap_err().code, "write.failed");
    }

    #[cfg(unix)]
    #[test]
    fn a_file_is_readable_for_others_as_the_umask_says() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().unwrap();
        let (ours, plain) = (folder.path().join("a"), folder.path().join("b"));
        text(&ours, false, "x").unwrap();
        std::fs::write(&plain, "x").unwrap();
        let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode();
        assert_eq!(mode(&ours), mode(&plain));
    }
}
