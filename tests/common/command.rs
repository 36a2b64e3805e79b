//! Runs the `nsim` command.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

/// Words of a command line: a string split at its blanks, or a list of words.
pub trait Words {
    fn words(self) -> Vec<String>;
}

impl Words for &str {
    fn words(self) -> Vec<String> {
        self.split(' ').map(str::to_string).collect()
    }
}

impl Words for &String {
    fn words(self) -> Vec<String> {
        self.as_str().words()
    }
}

impl Words for &[&str] {
    fn words(self) -> Vec<String> {
        self.iter().map(ToString::to_string).collect()
    }
}

impl<const N: usize> Words for &[&str; N] {
    fn words(self) -> Vec<String> {
        self.as_slice().words()
    }
}

impl Words for &Vec<&str> {
    fn words(self) -> Vec<String> {
        self.as_slice().words()
    }
}

/// The command, in a folder.
pub fn nsim(folder: &Path, line: impl Words) -> Command {
    let mut command = Command::cargo_bin("nsim").unwrap();
    command.args(line.words()).current_dir(folder);
    command
}

/// Exit status, stdout and stderr.
pub fn said(folder: &Path, line: impl Words) -> (i32, String, String) {
    let output = nsim(folder, line).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code().unwrap(), text(&output.stdout), text(&output.stderr))
}

/// The output of a command that has to succeed.
pub fn succeeds(folder: &Path, line: impl Words) -> String {
    let words = line.words();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let (status, out, err) = said(folder, &words);
    assert_eq!(status, 0, "{words:?}: {err}");
    out
}

/// The result object of a command that ends with `status`.
pub fn object(folder: &Path, line: impl Words, status: i32) -> Value {
    let words = line.words();
    let words: Vec<&str> = words.iter().map(String::as_str).chain(["--format", "json"]).collect();
    let (code, out, err) = said(folder, &words);
    assert_eq!(code, status, "{words:?}: {out}{err}");
    serde_json::from_str(&out).unwrap_or_else(|error| panic!("{words:?}: {error}: {out}"))
}
