//! The last test file to run (files run by name): says once more, together, which tests were
//! skipped for want of recordings.
//!
//! A passing test is silent, and cargo starts a process for each file, so this one does not ask the
//! others: it reads their source, finds the folder that each test asks `common::data` for, and
//! looks whether it is there.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use syn::visit::{self, Visit};

/// The folders of recordings that tests ask for; one that is not listed is a slip of the pen and
/// would be skipped for ever.
const FOLDERS: [&str; 13] = [
    "cases",
    "silicon",
    "neuron",
    "vtsnn-random",
    "ev-containers",
    "oxford-slayer",
    "netx",
    "nir",
    "events",
    "loihi2/neuron",
    "loihi2/slayer",
    "loihi2/rf_blocks",
    "loihi2/pilotnet_sdnn",
];

/// The folders that the tests of a file ask for.
#[derive(Default)]
struct Asked {
    within: String,
    folders: Vec<(String, String)>,
}

impl<'ast> Visit<'ast> for Asked {
    fn visit_item_fn(&mut self, node: &'ast syn::ItemFn) {
        self.within = node.sig.ident.to_string();
        visit::visit_item_fn(self, node);
    }

    fn visit_expr_call(&mut self, node: &'ast syn::ExprCall) {
        if let (syn::Expr::Path(function), Some(syn::Expr::Lit(argument))) = (&*node.func, node.args.first())
            && function.path.segments.last().is_some_and(|segment| segment.ident == "data")
            && let syn::Lit::Str(folder) = &argument.lit
        {
            self.folders.push((folder.value(), self.within.clone()));
        }
        visit::visit_expr_call(self, node);
    }
}

/// The Rust files below a folder, but for the fuzzers' own crate.
fn test_files(folder: &Path) -> Vec<PathBuf> {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    entries.sort();
    let below = |path: PathBuf| match path.is_dir() {
        true if path.ends_with("fuzz") => Vec::new(),
        true => test_files(&path),
        false => vec![path],
    };
    let mut files: Vec<PathBuf> = entries.into_iter().flat_map(below).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "rs"));
    files
}

#[test]
fn skipped_tests_are_named() {
    let root = common::data_root();
    let mut skipped: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let (mut asking, mut unknown) = (0, Vec::new());
    for path in test_files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests")) {
        let mut asked = Asked::default();
        asked.visit_file(&syn::parse_file(&std::fs::read_to_string(&path).unwrap()).unwrap());
        let relative = path.strip_prefix(env!("CARGO_MANIFEST_DIR")).unwrap().display().to_string();
        for (folder, test) in asked.folders {
            asking += 1;
            if !FOLDERS.contains(&folder.as_str()) {
                unknown.push(format!("{relative}: {test} asks for {folder}"));
            }
            if !root.join(&folder).is_dir() {
                skipped.entry(folder).or_default().push(format!("{relative} {test}"));
            }
        }
    }
    assert!(unknown.is_empty() && asking > 10, "{asking} requests, of unknown folders: {unknown:?}");
    if skipped.is_empty() {
        return;
    }
    let count: usize = skipped.values().map(Vec::len).sum();
    common::say(&format!("\n==== {count} tests skipped: no recordings at {} ====", root.display()));
    for (folder, tests) in skipped {
        common::say(&format!("no {folder}: {}", tests.join(", ")));
    }
    common::say("NSIM_DATA names another folder; NSIM_REQUIRE_DATA=1 makes a missing recording fail\n");
}
