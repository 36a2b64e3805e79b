//! Files as bytes and as text, with a bound on their size.
//!
//! Input: a path, `-` for stdin. Output: the content, or a diagnostic that names the problem: no
//! file, a folder, a Git-LFS pointer, a binary file.

use std::fs::Metadata;
use std::io::{ErrorKind, Read};
use std::path::Path;

use sha2::{Digest, Sha256};

use super::budget::MOST_TEXT;
use super::disk::Input;
use nsim_ir::base::diagnostic::{Diagnostic, Result, SourceText, Span};

/// The first bytes of every `.npy` file.
pub const NPY_MAGIC: &[u8] = b"\x93NUMPY";
/// The first bytes of a Git-LFS pointer (git-lfs `docs/spec.md`).
const LFS: &[u8] = b"version https://git-lfs";

/// Whether an argument means stdin or stdout.
pub fn is_standard_stream(path: &Path) -> bool {
    path.as_os_str() == "-"
}

/// The diagnostic for a file that cannot be read.
pub fn unreadable(path: &Path, error: &std::io::Error) -> Diagnostic {
    let diagnostic = match error.kind() {
        ErrorKind::NotFound => {
            let mut missing = Diagnostic::new("io.missing", "there is no such file");
            if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty() && !folder.exists()) {
                missing = missing.help(format!("the folder {} does not exist either", folder.display()));
            }
            missing
        }
        ErrorKind::PermissionDenied => Diagnostic::new("io.denied", "permission to read the file is denied"),
        ErrorKind::IsADirectory => Diagnostic::new("io.folder", "this is a folder, not a file"),
        _ => Diagnostic::new("io.read", format!("cannot be read: {error}")),
    };
    diagnostic.in_file(path)
}

/// Whether a path names a descriptor that is open already, such as the pipe of a shell's
/// `<(command)`.
fn is_descriptor(path: &Path) -> bool {
    ["/dev/fd", "/proc/self/fd", "/dev/stdin"].iter().any(|open| path.starts_with(open))
}

/// The diagnostic for a pipe, a socket or a device, which may have no end.
pub fn not_regular(path: &Path) -> Diagnostic {
    Diagnostic::new("io.not-regular", "this is a pipe, a socket or a device, not a regular file").in_file(path)
}

/// Opens a regular file, or an open descriptor. Others are refused: a named pipe may have no
/// writer, and a device may have no end.
///
/// # Errors
/// `io.missing`, `io.folder`, `io.denied`, `io.not-regular`, `io.read`.
pub fn open(path: &Path) -> Result<(Input, Metadata)> {
    let found = path.metadata().map_err(|error| unreadable(path, &error))?;
    if !found.is_file() && !found.is_dir() && !is_descriptor(path) {
        return Err(not_regular(path).help("give a regular file, or - to read stdin"));
    }
    let (file, metadata) = Input::open(path).map_err(|error| unreadable(path, &error))?;
    if metadata.is_dir() {
        return Err(unreadable(path, &ErrorKind::IsADirectory.into()));
    }
    Ok((file, metadata))
}

/// Refuses a file that begins as a Git-LFS pointer.
///
/// # Errors
/// `io.lfs-pointer`.
pub fn refuse_pointer(path: &Path, begin: &[u8]) -> Result<()> {
    if !begin.starts_with(LFS) {
        return Ok(());
    }
    Err(Diagnostic::new("io.lfs-pointer", "this is a Git-LFS pointer, not the file itself")
        .help("run `git lfs pull` in the repository of the file")
        .in_file(path))
}

/// The bytes of a file of at most `limit` bytes.
///
/// # Errors
/// `io.missing`, `io.folder`, `io.denied`, `io.not-regular`, `io.read`, `io.too-large`,
/// `io.lfs-pointer`.
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let too_large = |size: String| {
        Diagnostic::new("io.too-large", format!("the file has {size} bytes, the limit is {limit}")).in_file(path)
    };
    if is_standard_stream(path) {
        std::io::stdin().lock().take(limit + 1).read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    } else {
        let (file, metadata) = open(path)?;
        if metadata.len() > limit {
            return Err(too_large(metadata.len().to_string()));
        }
        bytes.reserve_exact(usize::try_from(metadata.len()).unwrap_or(0) + 1);
        file.take(limit + 1).read_to_end(&mut bytes).map_err(|error| unreadable(path, &error))?;
    }
    if bytes.len() as u64 > limit {
        return Err(too_large(format!("more than {limit}")));
    }
    refuse_pointer(path, &bytes)?;
    Ok(bytes)
}

/// SHA-256 of bytes, in hexadecimal digits.
pub fn sha256(bytes: &[u8]) -> String {
    digits(&Sha256::digest(bytes))
}

/// SHA-256 of a file, read in pieces.
///
/// # Errors
/// `io.missing`, `io.folder`, `io.denied`, `io.not-regular`, `io.read`.
pub fn sha256_of_file(path: &Path) -> Result<String> {
    let (mut file, _) = open(path)?;
    let (mut hash, mut piece) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut piece).map_err(|error| unreadable(path, &error))? {
            0 => return Ok(digits(&hash.finalize())),
            read => hash.update(&piece[..read]),
        }
    }
}

fn digits(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The text of a RON file.
///
/// # Errors
/// As [`read_bytes`]; `io.utf8` with the position of the first byte that is not UTF-8.
pub fn read_text(path: &Path) -> Result<SourceText> {
    decode(path, read_bytes(path, MOST_TEXT)?)
}

/// Bytes as the text of a file.
///
/// # Errors
/// `io.utf8` with the position of the first byte that is not UTF-8.
pub fn decode(path: &Path, bytes: Vec<u8>) -> Result<SourceText> {
    let name = if is_standard_stream(path) { Path::new("<stdin>") } else { path };
    match String::from_utf8(bytes) {
        Ok(text) => {
            // A byte order mark is not part of the text.
            let text = text.strip_prefix('\u{feff}').map(str::to_owned).unwrap_or(text);
            Ok(SourceText::new(name, text))
        }
        Err(error) => {
            let good = error.utf8_error().valid_up_to();
            let bytes = error.into_bytes();
            let byte = bytes[good];
            let text = std::str::from_utf8(&bytes[..good]).unwrap_or_default();
            let help = if bytes.starts_with(NPY_MAGIC) {
                "this is a NumPy array; a text file is expected here"
            } else if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
                "this looks like UTF-16; save the file as UTF-8"
            } else {
                "a text file in UTF-8 is expected here"
            };
            let diagnostic = Diagnostic::new("io.utf8", format!("byte 0x{byte:02x} at offset {good} is not UTF-8"))
                .at(&SourceText::new(name, text), Span { start: good, end: good });
            Err(diagnostic.help(help))
        }
    }
}

/// The path of a file that the file at `path` names, relative to its folder.
pub fn sibling_path(path: &Path, name: &str) -> std::path::PathBuf {
    path.parent().unwrap_or(Path::new("")).join(name)
}

/// Names of a column of times; a unit may follow: `_s`, `_ms`, `_us`, `_ns`.
pub const TIMES: [&str; 5] = ["t", "ts", "time", "timestamp", "timestamps"];

/// Whether a column of this name holds times.
pub fn is_time(name: &str) -> bool {
    let name = name.to_ascii_lowercase();
    let stem = name.rsplit_once('_').filter(|(_, unit)| matches!(*unit, "s" | "ms" | "us" | "ns"));
    TIMES.contains(&stem.map_or(name.as_str(), |(stem, _)| stem))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    #[test]
    fn what_is_not_a_text_file_is_named() {
        let (folder, path) = file("a.ron", b"ok \xff");
        let bad = read_text(&path).unwrap_err();
        assert_eq!((bad.code, bad.position().unwrap().column), ("io.utf8", 4));
        assert_eq!(read_text(folder.path()).unwrap_err().code, "io.folder");
        let absent = read_text(&folder.path().join("x/absent.ron")).unwrap_err();
        assert_eq!(absent.code, "io.missing");
        assert!(absent.help.unwrap().contains("does not exist either"));
        assert_eq!(read_bytes(&path, 3).unwrap_err().code, "io.too-large");
    }

    #[test]
    fn a_byte_order_mark_is_dropped() {
        let (_folder, path) = file("a.ron", "\u{feff}()".as_bytes());
        assert_eq!(&**read_text(&path).unwrap().text(), "()");
    }
}
