//! Atomic writing of files.
//!
//! Input: what to write and where, `-` for stdout. Afterwards the complete file exists under its name, or nothing has
//! changed. An existing file is replaced only on request.

use std::io::{BufWriter, ErrorKind, Write};
use std::path::Path;

use super::text::is_standard_stream;
use crate::base::diagnostic::{Diagnostic, Result};

fn exists(path: &Path) -> Diagnostic {
    Diagnostic::new("write.exists", "the file exists already")
        .help("add --force to replace it, or give another name")
        .in_file(path)
}

fn failed(path: &Path, error: &std::io::Error) -> Diagnostic {
    Diagnostic::new("write.failed", format!("cannot be written: {error}")).in_file(path)
}

/// Checks that a file may be written there, before a long run that would otherwise fail at its end.
///
/// # Errors
/// `write.exists`, `write.folder`.
pub fn check_free(path: &Path, force: bool) -> Result<()> {
    if is_standard_stream(path) {
        return Ok(());
    }
    if path.is_dir() {
        return Err(Diagnostic::new("write.folder", "this is a folder; a file is to be written").in_file(path));
    }
    if !force && path.symlink_metadata().is_ok() {
        return Err(exists(path));
    }
    Ok(())
}

/// [`check_free`] for each of several files.
///
/// # Errors
/// As [`check_free`].
pub fn check_all_free(paths: impl IntoIterator<Item: AsRef<Path>>, force: bool) -> Result<()> {
    paths.into_iter().try_for_each(|path| check_free(path.as_ref(), force))
}

/// Writes a file through `fill`: under a temporary name in the same folder, which is made when it is absent, renamed once
/// it is complete. `-` is stdout.
///
/// # Errors
/// `write.exists`, `write.folder`, `write.failed`.
pub fn file(path: &Path, force: bool, fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>) -> Result<()> {
    let fail = |error: std::io::Error| failed(path, &error);
    if is_standard_stream(path) {
        let mut out = BufWriter::new(std::io::stdout().lock());
        return fill(&mut out).and_then(|()| out.flush()).or_else(ignore_closed_pipe).map_err(fail);
    }
    check_free(path, force)?;
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    std::fs::create_dir_all(folder).map_err(fail)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".nsim-").suffix(".tmp");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // A temporary file is private by default; this one gets the permissions of an ordinary file.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut temporary = builder.tempfile_in(folder).map_err(fail)?;
    let mut out = BufWriter::new(temporary.as_file_mut());
    fill(&mut out).map_err(fail)?;
    out.flush().map_err(fail)?;
    drop(out);
    let kept = if force { temporary.persist(path) } else { temporary.persist_noclobber(path) };
    kept.map(drop).map_err(|error| match error.error.kind() {
        // Somebody else made it in the meantime.
        ErrorKind::AlreadyExists => exists(path),
        _ => failed(path, &error.error),
    })
}

/// Writes a text file.
///
/// # Errors
/// As [`file()`].
pub fn text(path: &Path, force: bool, text: &str) -> Result<()> {
    file(path, force, |out| out.write_all(text.as_bytes()))
}

/// Prints to stdout. A reader that has gone away (`nsim .. | head`) is not an error.
///
/// # Errors
/// `write.failed`.
pub fn stdout(text: &str) -> Result<()> {
    self::text(Path::new("-"), false, text)
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
