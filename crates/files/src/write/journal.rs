//! An append-only file of lines, from which interrupted work is resumed.
//!
//! Input: a path, a head that identifies the work, lines without line ends. Output: the lines that
//! were added before. Each line has a checksum; an incomplete line at the end is truncated when the
//! file is opened again. A lock admits one process at a time.
//!
//! Errors: `journal.other` for a file with another head, `journal.held` when another process has
//! the lock, `io.not-regular` for a pipe, `write.failed`.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::disk;
use crate::write::batch::{failed, open_or_make};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// A journal that is open.
#[derive(Debug)]
pub struct Journal {
    path: PathBuf,
    file: File,
}

/// FNV-1a, which finds truncated lines but not deliberate changes.
fn checksum(line: &str) -> u64 {
    line.bytes().fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn written(line: &str) -> String {
    format!("{:016x} {line}\n", checksum(line))
}

/// The complete lines at the start of a text, and their size in bytes.
fn whole_lines(text: &[u8]) -> (Vec<String>, usize) {
    let (mut lines, mut end) = (Vec::new(), 0);
    for piece in text.split_inclusive(|byte| *byte == b'\n') {
        let line = std::str::from_utf8(piece).ok().and_then(|piece| piece.get(17..piece.len() - 1));
        match line {
            Some(line) if written(line).as_bytes() == piece => lines.push(line.to_string()),
            _ => break,
        }
        end += piece.len();
    }
    (lines, end)
}

impl Journal {
    /// Opens a journal and returns the lines after its head. A journal that is absent, truncated
    /// within its head or without lines after it is begun anew.
    ///
    /// # Errors
    /// `journal.other`, `journal.held`, `io.not-regular`, `write.failed`.
    pub fn open(path: &Path, head: &str) -> Result<(Journal, Vec<String>)> {
        std::fs::create_dir_all(disk::folder_of(path)).map_err(failed(path))?;
        let file = open_or_make(path)?;
        if let Err(std::fs::TryLockError::WouldBlock) = file.try_lock() {
            return Err(Diagnostic::new("journal.held", "another process is using this file").in_file(path));
        }
        let mut journal = Journal { path: path.to_path_buf(), file };
        let mut text = Vec::new();
        disk::Input::open(path).and_then(|(mut input, _)| input.read_to_end(&mut text)).map_err(failed(path))?;
        // After a crash of the system, unwritten bytes may read as zeros.
        let told = text.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
        text.truncate(told);
        let (mut lines, mut end) = whole_lines(&text);
        if lines.is_empty() && !text.is_empty() && !written(head).as_bytes().starts_with(&text) {
            return Err(journal.other("not a journal of nsim"));
        }
        if lines.first().is_some_and(|first| first != head) {
            if lines.len() > 1 {
                return Err(journal.other("the journal of another sweep"));
            }
            // A journal of other work without lines may be replaced.
            (lines, end) = (Vec::new(), 0);
        }
        journal.file.set_len(end as u64).and_then(|()| journal.file.seek(SeekFrom::End(0))).map_err(failed(path))?;
        match lines.is_empty() {
            true => journal.add(head)?,
            false => drop(lines.remove(0)),
        }
        Ok((journal, lines))
    }

    fn other(&self, what: &str) -> Diagnostic {
        Diagnostic::new("journal.other", format!("this is {what}"))
            .help("remove it to start again, or give the result another name")
            .in_file(&self.path)
    }

    /// Adds a line.
    ///
    /// # Errors
    /// `write.failed`, after which no line may be added.
    pub fn add(&mut self, line: &str) -> Result<()> {
        self.file.write_all(written(line).as_bytes()).map_err(failed(&self.path))
    }

    /// Removes the file when the work is done.
    ///
    /// # Errors
    /// `write.failed`.
    pub fn remove(self) -> Result<()> {
        std::fs::remove_file(&self.path).map_err(failed(&self.path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whole_lines_come_back_whatever_was_cut() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/a.journal");
        let (mut journal, lines) = Journal::open(&path, "work 1").unwrap();
        assert!(lines.is_empty());
        assert_eq!(Journal::open(&path, "work 1").unwrap_err().code, "journal.held");
        ["one", "two, µ", "three"].into_iter().for_each(|line| journal.add(line).unwrap());
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        let ends: Vec<usize> = (0..whole.len()).filter(|&at| whole[at] == b'\n').map(|at| at + 1).collect();
        for cut in 0..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let (mut journal, lines) = Journal::open(&path, "work 1").unwrap();
            let left = ends.iter().filter(|&&end| end <= cut).count().saturating_sub(1);
            assert_eq!(lines, ["one", "two, µ", "three"][..left], "{cut}");
            ["one", "two, µ", "three"][left..].iter().for_each(|line| journal.add(line).unwrap());
            drop(journal);
            assert_eq!(std::fs::read(&path).unwrap(), whole);
        }
        assert_eq!(Journal::open(&path, "work 2").unwrap_err().code, "journal.other");
        // A journal without lines may be replaced.
        let other = folder.path().join("empty.journal");
        drop(Journal::open(&other, "work 1").unwrap());
        Journal::open(&other, "work 2").unwrap().0.add("one").unwrap();
        assert_eq!(Journal::open(&other, "work 2").unwrap().1, ["one"]);
        assert_eq!(Journal::open(&other, "work 1").unwrap_err().code, "journal.other");
        std::fs::write(&path, "something else").unwrap();
        assert_eq!(Journal::open(&path, "work 1").unwrap_err().code, "journal.other");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "something else");
        std::fs::write(&path, [0; 500]).unwrap();
        Journal::open(&path, "work 1").unwrap().0.remove().unwrap();
        assert!(!path.exists());
    }
}
