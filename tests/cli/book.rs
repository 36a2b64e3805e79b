//! The book: its tutorials run as printed, its pages of commands equal their `--help`, its table of
//! contents names every page.
//!
//! In a tutorial, a shell runs each `sh` block in the page's own folder, and ends with status 0 or
//! the one of `exit=`. A later `text` block is the output of the last `sh` block, where `...`
//! represents any lines. Blocks `ron NAME` and `csv NAME` are files. A `python run` block is run if
//! a Python with the package `nir` is found, else reported as skipped; `python/tests/test_torch.py`
//! runs the blocks `python torch`, `test_sessions.py` those named `python session`, whose output is
//! the next `text session`. `NSIM_BLESS=1` writes the pages of commands anew.

use crate::common;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn pages(folder: &str) -> Vec<PathBuf> {
    let listed = std::fs::read_dir(root().join("docs").join(folder)).unwrap();
    let mut found: Vec<PathBuf> = listed.map(|entry| entry.unwrap().path()).collect();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "md"));
    found.sort();
    found
}

/// A fenced block: its line number, the words after the fence, its lines.
struct Block {
    line: usize,
    words: Vec<String>,
    body: String,
}

fn blocks(text: &str) -> Vec<Block> {
    let (mut found, mut open): (Vec<Block>, bool) = (Vec::new(), false);
    for (number, line) in (1..).zip(text.lines()) {
        match (line.strip_prefix("```"), open) {
            (Some(words), false) => {
                let words = words.split_whitespace().map(str::to_string).collect();
                found.push(Block { line: number, words, body: String::new() });
                open = true;
            }
            (Some(_), true) => open = false,
            (None, true) => {
                if let Some(block) = found.last_mut() {
                    block.body += line;
                    block.body.push('\n');
                }
            }
            (None, false) => {}
        }
    }
    found
}

/// Whether an output equals the text of a page.
fn is_shown(shown: &str, printed: &str) -> bool {
    let printed: Vec<&str> = printed.lines().map(str::trim_end).collect();
    let (mut at, mut gap) = (0, false);
    for line in shown.lines().map(str::trim_end) {
        if line == "..." {
            gap = true;
            continue;
        }
        let found = printed[at..].iter().position(|other| *other == line);
        match found {
            Some(skipped) if gap || skipped == 0 => (at, gap) = (at + skipped + 1, false),
            _ => return false,
        }
    }
    gap || at == printed.len()
}

#[test]
fn shown_output_is_compared_line_by_line() {
    for (shown, printed, same) in [
        ("a\nb\n", "a\nb\n", true),
        ("a\n", "a\nb\n", false),
        ("a\n...\n", "a\nb\n", true),
        ("...\nb\n", "a\nb\n", true),
        ("...\na\n", "a\nb\n", false),
        ("a\n...\nc\n", "a\nb\nb\nc  \n", true),
        ("a\n...\nd\n", "a\nb\nc\n", false),
        ("b\n", "a\nb\n", false),
    ] {
        assert_eq!(is_shown(shown, printed), same, "{shown:?} {printed:?}");
    }
}

fn python() -> Option<String> {
    let named = std::env::var("NSIM_PYTHON").unwrap_or_else(|_| "python3".to_string());
    let status = Command::new(&named).args(["-c", "import nir, numpy"]).output().ok()?.status;
    status.success().then_some(named)
}

#[test]
fn tutorials_run_as_they_are_printed() {
    let program = assert_cmd::cargo::cargo_bin("nsim");
    let path = std::env::join_paths(
        [program.parent().unwrap().to_path_buf()]
            .into_iter()
            .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
    );
    let (path, python) = (path.unwrap(), python());
    let tutorials = pages("tutorials");
    assert!(tutorials.len() >= 6);
    std::thread::scope(|scope| {
        for page in &tutorials {
            let (path, python) = (&path, &python);
            scope.spawn(move || tutorial(page, path, python.as_deref()));
        }
    });
}

fn tutorial(page: &Path, path: &std::ffi::OsStr, python: Option<&str>) {
    let name = page.file_name().unwrap().to_string_lossy();
    let text = std::fs::read_to_string(page).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let mut printed = String::new();
    let mut commands = 0;
    for Block { line, words, body } in blocks(&text) {
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        match *words {
            ["ron" | "csv", file] => std::fs::write(folder.path().join(file), body).unwrap(),
            ["sh", ..] => {
                let wanted = words.get(1).and_then(|word| word.strip_prefix("exit=")).map_or(0, |s| s.parse().unwrap());
                let mut shell = Command::new("bash");
                shell.args(["-e", "-c", &body]).current_dir(folder.path()).env("PATH", path).env("LC_ALL", "C");
                let output = shell.output().unwrap();
                printed = String::from_utf8(output.stdout).unwrap();
                let said = String::from_utf8_lossy(&output.stderr);
                assert_eq!(output.status.code(), Some(wanted), "{name}:{line}: {body}{printed}{said}");
                commands += 1;
            }
            ["text"] => assert!(is_shown(&body, &printed), "{name}:{line} shows\n{body}\nand there is\n{printed}"),
            ["python", "run"] => match python {
                Some(python) => {
                    let output = Command::new(python).args(["-c", &body]).current_dir(folder.path()).output().unwrap();
                    assert!(output.status.success(), "{name}:{line}: {}", String::from_utf8_lossy(&output.stderr));
                }
                None => {
                    common::say(&format!("skipped: {name} from line {line} on, no Python with the package nir"));
                    return;
                }
            },
            ["python", "torch" | "session" | "nengo"] => commands += 1,
            _ => {}
        }
    }
    assert!(commands > 0, "{name} has no command");
}

/// Every command with a page.
fn commands() -> Vec<String> {
    let help = |words: &[&str]| {
        let mut command = Command::new(assert_cmd::cargo::cargo_bin("nsim"));
        String::from_utf8(command.args(words).arg("--help").output().unwrap().stdout).unwrap()
    };
    let listed = |text: &str| -> Vec<String> {
        let lines = text.lines().take_while(|line| !line.starts_with("Options") && !line.starts_with("Arguments"));
        let names = lines.filter_map(|line| line.strip_prefix("  ")?.split("  ").next());
        let is_name = |name: &&str| name.starts_with(|c: char| c.is_ascii_lowercase()) && *name != "help";
        names.filter(is_name).map(str::to_string).collect()
    };
    let all = listed(&help(&[])).into_iter().filter(|name| !name.contains(' '));
    all.flat_map(|name| {
        let below = listed(&help(&[&name]));
        let below: Vec<String> = below.iter().map(|other| format!("{name} {other}")).collect();
        if below.is_empty() { vec![name.clone()] } else { below }
    })
    .collect()
}

#[test]
fn each_command_has_a_page_that_is_its_help() {
    let bless = std::env::var_os("NSIM_BLESS").is_some_and(|value| value == "1");
    let summary = std::fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    let mut files = Vec::new();
    for name in commands() {
        let file = format!("{}.md", name.replace(' ', "-"));
        let mut command = Command::new(assert_cmd::cargo::cargo_bin("nsim"));
        let output = command.args(name.split(' ')).arg("--help").output().unwrap();
        let help: String =
            String::from_utf8(output.stdout).unwrap().lines().map(|line| format!("{}\n", line.trim_end())).collect();
        let page = format!("# nsim {name}\n\n```text\n{help}```\n");
        let path = root().join("docs/commands").join(&file);
        if bless {
            std::fs::write(&path, &page).unwrap();
        }
        let kept = std::fs::read_to_string(&path).unwrap_or_default();
        assert_eq!(
            kept, page,
            "docs/commands/{file} is not what --help prints: NSIM_BLESS=1 cargo test --test cli book:: writes it"
        );
        files.push(file);
    }
    for file in &files {
        assert!(summary.contains(&format!("(commands/{file})")), "docs/SUMMARY.md does not name commands/{file}");
    }
    for path in pages("commands") {
        let file = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(files.contains(&file), "docs/commands/{file} is of no command");
    }
}

#[test]
fn the_table_of_contents_names_every_page() {
    let summary = std::fs::read_to_string(root().join("docs/SUMMARY.md")).unwrap();
    for folder in ["", "tutorials"] {
        for page in pages(folder) {
            let file = page.strip_prefix(root().join("docs")).unwrap().display().to_string();
            assert!(
                file == "SUMMARY.md" || summary.contains(&format!("({file})")),
                "docs/SUMMARY.md does not name {file}"
            );
        }
    }
    for link in summary.split("](").skip(1).filter_map(|rest| rest.split_once(')')) {
        assert!(root().join("docs").join(link.0).exists(), "docs/SUMMARY.md names {}, which is not there", link.0);
    }
}
