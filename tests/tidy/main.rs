//! Rules of the source tree: layers, cycles, sizes of folders, module docs, names, and paths that documents name.
//!
//! Each rule prints all its violations. Exceptions are named in the lists below; one that is no longer needed fails too.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use source::Sources;

/// Rooms of `src` from the lowest layer up. A room names itself and rooms of lower lines, not its neighbours on a line.
const LAYERS: [&[&str]; 16] = [
    &["base"],
    &["error"],
    &["desc"],
    &["io", "ir"],
    &["neuron"],
    &["cost"],
    &["compile", "machine", "golden", "reference", "scene"],
    &["drive"],
    &["agree", "stress", "train", "baseline"],
    &["convert"],
    &["bench"],
    &["report"],
    &["energy"],
    &["sweep"],
    &["cli", "python"],
    &["main"],
];

/// Files in a folder besides `mod.rs`.
const MOST_FILES: usize = 12;

/// Rooms in which no board is named: what differs from board to board is in its target file.
const BOARDLESS: [&str; 5] = ["compile", "cost", "report", "machine", "ir"];

/// Exceptions that are left: cycles, as the files in each.
const CYCLES: &[&[&str]] = &[];
/// Folders with more files than a dozen.
const CROWDED: &[&str] = &[];
/// Files with the core counts of one published deployment.
const DEPLOYMENT_COUNTS: &[&str] = &[];
/// Files that name a board.
const BOARDS_NAMED: &[&str] = &[];

static SOURCES: LazyLock<Sources> = LazyLock::new(|| Sources::read(root()));

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

/// Fails with all violations that are no exception, and all exceptions that nothing violates.
fn hold(rule: &str, violations: &BTreeMap<String, Vec<String>>, exceptions: &[&str]) {
    let exceptions: BTreeSet<&str> = exceptions.iter().copied().collect();
    let mut wrong: Vec<String> = Vec::new();
    for (whose, what) in violations.iter().filter(|(whose, _)| !exceptions.contains(whose.as_str())) {
        wrong.extend(what.iter().map(|what| format!("{whose}: {what}")));
    }
    let needed = |exception: &&&str| !violations.contains_key(**exception);
    wrong.extend(exceptions.iter().filter(needed).map(|e| format!("{e}: is named as an exception and needs none")));
    assert!(wrong.is_empty(), "{rule}:\n{}", wrong.join("\n"));
}

/// A crate with each kind of path that the rules have to see, and some that they must not.
#[test]
fn every_kind_of_path_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let files = [
        ("main.rs", "fn main() { nsim::a::run() }"),
        ("lib.rs", "pub mod a; pub mod b; #[cfg(test)] mod tests;"),
        ("a/mod.rs", "mod child; mod other; pub fn run() { child::f() } pub(crate) struct A;"),
        ("a/child.rs", "use super::other as o; pub fn f() { o::g(); assert!(crate::b::B::new() > 1); }"),
        (
            "a/other.rs",
            "use std::io; #[serde(default = \"crate::b::zero\")] struct S; pub fn g() -> super::A { io::b::x() }",
        ),
        ("b.rs", "//! [`crate::a::A`]\n#[cfg(test)] mod tests { use crate::a::A; }\nfn f() { struct a; b::c() }"),
        ("tests.rs", "use crate::{a::A, b};"),
    ];
    for (name, text) in files {
        let path = folder.path().join("src").join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }
    let sources = Sources::read(folder.path());
    let name = |file: usize| sources.files[file].path.strip_prefix("src/").unwrap().to_string();
    let edges: Vec<(String, Vec<String>)> = sources
        .graph()
        .iter()
        .enumerate()
        .map(|(from, to)| (name(from), to.keys().map(|&to| name(to)).collect()))
        .collect();
    let expected: [(&str, &[&str]); 7] = [
        ("a/child.rs", &["a/other.rs", "b.rs"]),
        ("a/mod.rs", &["a/child.rs"]),
        ("a/other.rs", &["a/mod.rs", "b.rs"]),
        ("b.rs", &[]),
        ("lib.rs", &[]),
        ("main.rs", &["a/mod.rs"]),
        ("tests.rs", &[]),
    ];
    assert_eq!(edges, expected.map(|(from, to)| (from.to_string(), to.iter().map(ToString::to_string).collect())));
    assert_eq!(sources.files[3].product_lines().map(|(line, _)| line).collect::<Vec<_>>(), [1, 3]);
    assert!(
        holds_number("624 cores", "624") && holds_number("x=624.", "624") && !holds_number("6240, 0.624, 1_624", "624")
    );
}

#[test]
fn imports_go_downward_only() {
    let layer = |room: &str| LAYERS.iter().position(|rooms| rooms.contains(&room));
    let mut violations: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in &SOURCES.files {
        let Some(room) = file.module.first() else { continue };
        let mut wrong = |what| violations.entry(file.path.clone()).or_default().push(what);
        let Some(here) = layer(room) else {
            wrong(format!("{room} is in no layer"));
            continue;
        };
        for import in &file.imports {
            let Some(other) = import.path.first() else { continue };
            match layer(other) {
                Some(there) if there < here || other == room => {}
                Some(_) => wrong(format!("line {} names {}", import.line, import.path.join("::"))),
                None => wrong(format!("line {} names {other}, which is in no layer", import.line)),
            }
        }
    }
    hold("a room names itself and rooms of lower layers only", &violations, &[]);
}

#[test]
fn no_file_depends_on_itself() {
    let edges = SOURCES.graph();
    let mut graph = DiGraph::<usize, ()>::new();
    let nodes: Vec<_> = (0..edges.len()).map(|file| graph.add_node(file)).collect();
    for (from, to) in edges.iter().enumerate().flat_map(|(from, edges)| edges.keys().map(move |to| (from, *to))) {
        graph.add_edge(nodes[from], nodes[to], ());
    }
    let mut wrong = Vec::new();
    let mut excused: BTreeMap<&str, bool> =
        CYCLES.iter().flat_map(|cycle| cycle.iter().map(|file| (*file, false))).collect();
    for component in tarjan_scc(&graph).into_iter().filter(|component| component.len() > 1) {
        let cycle: BTreeSet<usize> = component.into_iter().map(|node| graph[node]).collect();
        let paths: BTreeSet<&str> = cycle.iter().map(|&file| SOURCES.files[file].path.as_str()).collect();
        if CYCLES.iter().any(|known| paths.iter().all(|path| known.contains(path))) {
            excused.extend(paths.iter().map(|path| (*path, true)));
            continue;
        }
        wrong.push(format!("a cycle of {} files:", cycle.len()));
        for &from in &cycle {
            for (to, names) in edges[from].iter().filter(|(to, _)| cycle.contains(to)) {
                let [from, to] = [from, *to].map(|file| &SOURCES.files[file].path);
                wrong.push(format!("  {from} -> {to}: {}", names.join(", ")));
            }
        }
    }
    let unneeded = excused.into_iter().filter(|(_, needed)| !needed);
    wrong.extend(unneeded.map(|(file, _)| format!("{file}: is named as an exception and is in no cycle")));
    assert!(wrong.is_empty(), "files depend on each other without cycles:\n{}", wrong.join("\n"));
}

/// What the interpreter may import: types that hold data, the engine's interface, and `rng`, which defines random synapses.
const GOLDEN_IMPORTS: [&str; 21] = [
    "base::fixed::Decay",
    "base::id::ChannelId",
    "base::id::CompartmentId",
    "base::id::Id",
    "base::id::IdVec",
    "base::rng",
    "desc::network::Semantics",
    "desc::network::ThresholdTest",
    "desc::neurons::NeuronKind",
    "ir::activity::Overflow",
    "ir::activity::Totals",
    "ir::graph::Window",
    "ir::quantised::Neuron",
    "ir::quantised::Projection",
    "ir::quantised::Quantised",
    "ir::quantised::Reset",
    "ir::quantised::SpikeSource",
    "ir::quantised::Units",
    "ir::quantised::connectivity::Connectivity",
    "ir::source_counts::LeftField",
    "ir::spikes::Engine",
];
/// Functions of the rooms below that the interpreter may call: they return stored data and decide nothing.
const GOLDEN_CALLS: &[&str] = &["channels", "first_compartment", "below", "parts", "populations", "projections"];
/// Names that collections of the standard library have too.
const COLLECTIONS: &[&str] = &[
    "any", "clear", "default", "from", "get", "ids", "index", "iter", "iter_mut", "len", "map", "max", "min", "new",
    "push", "try_from",
];

/// What the checkers may take from the compiler: formulas of the hardware's formats, and the form of a sampled core; no
/// counter, and no stage.
const CHECKER_IMPORTS: [&str; 5] = [
    "compile::check",
    "compile::emit::sample::SampledCore",
    "compile::resources::axon_sharing",
    "compile::resources::exact::profiles",
    "compile::resources::packing",
];

/// Whether a path is in a list, or within what the list names.
fn within(path: &str, allowed: &[&str]) -> bool {
    allowed
        .iter()
        .any(|allowed| path.strip_prefix(allowed).is_some_and(|rest| rest.is_empty() || rest.starts_with("::")))
}

/// The paths that files take from elsewhere in the crate, tests left out, with file and line.
fn taken(by: impl Fn(&[String]) -> bool) -> Vec<(String, String)> {
    let files = SOURCES.files.iter().filter(|file| by(&file.module));
    files
        .flat_map(|file| {
            let imports = file.imports.iter().filter(|import| !import.test);
            imports.map(|import| (import.path.join("::"), format!("{}:{}", file.path, import.line)))
        })
        .collect()
}

#[test]
fn the_interpreter_shares_no_rule_with_what_it_is_compared_with() {
    let golden = |module: &[String]| module.first().is_some_and(|room| room == "golden");
    let taken = taken(golden);
    assert!(
        taken.iter().any(|(path, _)| path == "ir::quantised::connectivity::Connectivity"),
        "its imports are read: {taken:?}"
    );
    let foreign = taken.iter().filter(|(path, _)| !within(path, &["golden"]) && !within(path, &GOLDEN_IMPORTS));
    let mut wrong: Vec<String> = foreign.map(|(path, place)| format!("{place} names {path}")).collect();
    let below = |file: &&source::SourceFile| {
        !file.test && file.module.first().is_some_and(|r| r == "base" || r == "desc" || r == "ir")
    };
    let functions: BTreeSet<&str> = SOURCES
        .files
        .iter()
        .filter(below)
        .flat_map(|file| file.functions.iter().map(|(name, _)| name.as_str()))
        .collect();
    assert!(["falls_on", "for_each_from", "scaled"].iter().all(|rule| functions.contains(rule)), "the rules are read");
    for file in SOURCES.files.iter().filter(|file| golden(&file.module)) {
        let own: BTreeSet<&str> = file.functions.iter().map(|(name, _)| name.as_str()).collect();
        for (name, line) in &file.calls {
            let name = name.as_str();
            let known = [GOLDEN_CALLS, COLLECTIONS].concat().contains(&name) || own.contains(name);
            if functions.contains(name) && !known {
                wrong.push(format!("{}:{line} calls {name}", file.path));
            }
        }
    }
    assert!(wrong.is_empty(), "the interpreter takes plain data only:\n{}", wrong.join("\n"));
}

#[test]
fn the_checkers_use_no_stage_of_the_compiler() {
    let checkers = |module: &[String]| module.len() > 1 && module[0] == "compile" && module[1] == "check";
    let foreign = |(path, _): &(String, String)| path.starts_with("compile::") && !within(path, &CHECKER_IMPORTS);
    let wrong: Vec<String> =
        taken(checkers).into_iter().filter(foreign).map(|(path, place)| format!("{place} names {path}")).collect();
    assert!(wrong.is_empty(), "a checker shares nothing with what it checks:\n{}", wrong.join("\n"));
}

#[test]
fn every_file_is_part_of_the_crate_and_says_what_it_is() {
    let read: BTreeSet<&str> = SOURCES.files.iter().map(|file| file.path.as_str()).collect();
    let mut found = Vec::new();
    files(&root().join("src"), "rs", &mut found);
    let paths = found.iter().map(|path| path.strip_prefix(root()).unwrap().to_string_lossy().into_owned());
    let mut wrong: Vec<String> = paths
        .filter(|path| !read.contains(path.as_str()))
        .map(|path| format!("{path}: no module declares it"))
        .collect();
    let undocumented = SOURCES.files.iter().filter(|file| !file.text.starts_with("//! "));
    wrong.extend(undocumented.map(|file| format!("{}: has no module doc", file.path)));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn folders_hold_at_most_a_dozen_files() {
    let mut folders: BTreeMap<String, Vec<&str>> = BTreeMap::new();
    for file in SOURCES.files.iter().filter(|file| !file.path.ends_with("/mod.rs")) {
        folders.entry(file.path.rsplit_once('/').unwrap().0.to_string()).or_default().push(&file.path);
    }
    folders.retain(|_, files| files.len() > MOST_FILES);
    let violations =
        folders.into_iter().map(|(folder, files)| (folder, vec![format!("{} files", files.len())])).collect();
    hold("a folder holds at most a dozen files besides mod.rs", &violations, CROWDED);
}

#[test]
fn functions_say_what_they_return() {
    let mut violations: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in &SOURCES.files {
        for (_, line) in file.functions.iter().filter(|(name, _)| name == "of") {
            violations.entry(file.path.clone()).or_default().push(format!("line {line}: a function called `of`"));
        }
    }
    hold("`of` alone is no name", &violations, &[]);
}

/// Whether a text holds a number, written alone.
fn holds_number(text: &str, number: &str) -> bool {
    let numeric = |c: char| c.is_ascii_digit() || c == '_' || c == '.';
    text.split(|c| !numeric(c)).any(|digits| digits.trim_end_matches('.') == number)
}

#[test]
fn no_published_deployment_is_in_the_code() {
    let mut violations: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in &SOURCES.files {
        for (line, text) in file.product_lines() {
            if ["594", "624"].iter().any(|number| holds_number(text, number)) {
                violations.entry(file.path.clone()).or_default().push(format!("line {line}: {}", text.trim()));
            }
        }
    }
    hold("the cores of a deployment are in its scenario file", &violations, DEPLOYMENT_COUNTS);
}

#[test]
fn boards_are_named_in_their_files_only() {
    let mut targets = Vec::new();
    files(&root().join("mapping/targets"), "ron", &mut targets);
    let mut names: BTreeSet<String> = BTreeSet::new();
    for stem in targets.iter().map(|path| path.file_stem().unwrap().to_string_lossy().to_lowercase()) {
        // The family's name says as much as the board's; "tiny" and "loihi1" are words of their own.
        let family = stem.split('-').next().unwrap().to_string();
        names.extend((!["tiny", "loihi1"].contains(&family.as_str())).then_some(family));
        names.extend((stem != "tiny").then_some(stem));
    }
    let mut violations: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for file in SOURCES.files.iter().filter(|file| file.module.first().is_some_and(|r| BOARDLESS.contains(&r.as_str())))
    {
        for (line, text) in file.product_lines() {
            let lower = text.to_lowercase();
            if names.iter().any(|name| lower.contains(name)) {
                violations.entry(file.path.clone()).or_default().push(format!("line {line}: {}", text.trim()));
            }
        }
    }
    hold("boards are named in their target files only", &violations, BOARDS_NAMED);
}

/// Folders whose files documents name by their path.
const NAMED_FOLDERS: [&str; 9] =
    ["src/", "tests/", "docs/", "models/", "mapping/", "benches/", "examples/", ".github/", ".ci/"];

/// Paths in the repositories of other projects, which comments cite.
const CITED: [&str; 2] = ["docs/source/primitives.md", "docs/spec.md"];

/// The paths that a text names between backquotes.
fn quoted_paths(text: &str) -> impl Iterator<Item = &str> {
    let quoted = text.split('`').skip(1).step_by(2);
    quoted.filter(|quoted| {
        NAMED_FOLDERS.iter().any(|folder| quoted.starts_with(folder)) && !quoted.contains([' ', '*', '<', '{', '\n'])
    })
}

#[test]
fn paths_in_documents_exist() {
    let mut wrong = Vec::new();
    let mut documents: Vec<PathBuf> =
        ["README.md", "CHANGELOG.md", "CONTRIBUTING.md"].map(|name| root().join(name)).into();
    for folder in ["docs", ".github"] {
        files(&root().join(folder), "md", &mut documents);
    }
    for document in documents {
        let name = document.strip_prefix(root()).unwrap().display();
        let text = fs::read_to_string(&document).unwrap();
        let absent = quoted_paths(&text).filter(|path| !root().join(path).exists());
        wrong.extend(absent.map(|path| format!("{name} names {path}, which does not exist")));
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if !link.contains("://") && !link.starts_with('#') {
                let target = document.parent().unwrap().join(link.split('#').next().unwrap());
                if !target.exists() {
                    wrong.push(format!("{name} links to {link}, which does not exist"));
                }
            }
        }
    }
    for file in &SOURCES.files {
        for (line, text) in (1..).zip(file.text.lines()).filter(|(_, text)| text.trim_start().starts_with("//")) {
            let ours = |path: &&str| {
                !CITED.contains(path) && [".rs", ".md", ".ron", ".sh", "/"].iter().any(|e| path.ends_with(e))
            };
            let absent = quoted_paths(text).filter(ours).filter(|path| !root().join(path).exists());
            wrong.extend(absent.map(|path| format!("{}:{line} names {path}, which does not exist", file.path)));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
