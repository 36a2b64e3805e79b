//! The house in order: layers, module docs, paths that documents name.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use std::fs;
use std::path::{Path, PathBuf};

/// Rooms from the ground up; a room imports only what stands on a lower line than itself, and itself.
const LAYERS: [&[&str]; 12] = [
    &["base"],
    &["desc"],
    &["io", "ir"],
    &["cost"],
    &["compile", "machine", "golden", "reference", "scene"],
    &["drive"],
    &["agree", "stress", "train"],
    &["convert"],
    &["bench"],
    &["report"],
    &["error"],
    &["cli"],
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn files(folder: &Path, extension: &str, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<PathBuf> = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            files(&path, extension, found);
        } else if path.extension().is_some_and(|e| e == extension) {
            found.push(path);
        }
    }
}

fn sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    files(&root().join("src"), "rs", &mut found);
    found
}

fn room_of(path: &Path) -> String {
    let within = path.strip_prefix(root().join("src")).unwrap();
    within.components().next().unwrap().as_os_str().to_string_lossy().trim_end_matches(".rs").to_string()
}

fn layer(room: &str) -> Option<usize> {
    LAYERS.iter().position(|rooms| rooms.contains(&room))
}

/// The rooms that a file's code names as `crate::room`, tests included.
fn imports(text: &str) -> Vec<String> {
    let code = text.lines().filter(|line| !line.trim_start().starts_with("//"));
    let mut rooms = Vec::new();
    for line in code {
        for after in line.split("crate::").skip(1) {
            let room: String = after.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            if !room.is_empty() {
                rooms.push(room);
            }
        }
    }
    rooms
}

#[test]
fn imports_go_downward_only() {
    let mut wrong = Vec::new();
    for path in sources() {
        let room = room_of(&path);
        if room == "lib" || room == "main" {
            continue;
        }
        let here = layer(&room).unwrap_or_else(|| panic!("{room} is in no layer"));
        for import in imports(&fs::read_to_string(&path).unwrap()) {
            match layer(&import) {
                Some(there) if there < here || import == room => {}
                Some(_) => wrong.push(format!("{} imports {import}", path.display())),
                None => wrong.push(format!("{} imports {import}, which is in no layer", path.display())),
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_module_says_what_it_is() {
    for path in sources() {
        let text = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with("//! "), "{} has no module doc", path.display());
    }
}

#[test]
fn paths_in_documents_exist() {
    let mut documents = vec![root().join("README.md"), root().join("CHANGELOG.md")];
    files(&root().join("docs"), "md", &mut documents);
    for document in documents {
        let text = fs::read_to_string(&document).unwrap();
        for quoted in text.split('`').skip(1).step_by(2) {
            let path =
                ["src/", "tests/", "docs/", "models/", "mapping/", "benches/"].iter().any(|f| quoted.starts_with(f));
            if path && !quoted.contains([' ', '*', '<', '{']) {
                assert!(root().join(quoted).exists(), "{} names {quoted}, which does not exist", document.display());
            }
        }
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if !link.contains("://") && !link.starts_with('#') {
                let target = document.parent().unwrap().join(link.split('#').next().unwrap());
                assert!(target.exists(), "{} links to {link}, which does not exist", document.display());
            }
        }
    }
}
