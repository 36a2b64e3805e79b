//! Rules of the source tree: dependencies of crates, cycles, sizes, module docs, names, and paths
//! in documents.
//!
//! Each rule prints all its violations.

// A test that cannot continue has failed.
#![allow(clippy::unwrap_used)]

mod source;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use source::{SourceFile, Sources};

/// Most files in a folder within a crate, besides `mod.rs`.
const MOST_FILES: usize = 12;

/// Most lines of a crate, with the tests in `src`.
const MOST_LINES: usize = 13_000;
/// Most lines of a function, from `fn` to its closing brace.
const MOST_LINES_OF_FUNCTION: usize = 80;
/// Most crates of the workspace, the command line included.
const MOST_CRATES: usize = 22;

/// Crates that name no board: differences between boards are in target files.
const BOARDLESS: [&str; 5] = ["compile", "cost", "report", "machine", "ir"];

/// The crates of the workspace and Python's, by name; `nsim` is the command line.
static CRATES: LazyLock<BTreeMap<String, Sources>> = LazyLock::new(|| {
    let mut folders: Vec<PathBuf> =
        fs::read_dir(root().join("crates")).unwrap().map(|entry| entry.unwrap().path()).collect();
    folders.push(root().join("python"));
    let named = |folder: &PathBuf| folder.file_name().unwrap().to_string_lossy().into_owned();
    let mut crates: BTreeMap<String, Sources> =
        folders.iter().map(|folder| (named(folder), Sources::read(folder))).collect();
    crates.insert("nsim".to_string(), Sources::read(root()));
    crates
});

/// The files of all crates, by their path in the repository.
fn sources() -> impl Iterator<Item = (String, &'static SourceFile)> {
    CRATES.iter().flat_map(|(name, sources)| {
        let folder = match name.as_str() {
            "nsim" => String::new(),
            "python" => "python/".to_string(),
            name => format!("crates/{name}/"),
        };
        sources.files.iter().map(move |file| (format!("{folder}{}", file.path), file))
    })
}

/// The crates of the workspace in a crate's manifest, without dependencies for tests.
fn uses(name: &str) -> BTreeSet<String> {
    let manifest = fs::read_to_string(root().join(format!("crates/{name}/Cargo.toml"))).unwrap();
    let dependencies = manifest.split("[dependencies]").nth(1).unwrap().split("\n[").next().unwrap().to_string();
    let named = |line: &str| Some(line.strip_prefix("nsim-")?.split(['.', ' ']).next()?.to_string());
    dependencies.lines().filter_map(named).collect()
}

/// All crates that a crate depends on, directly or not.
fn reach(name: &str) -> BTreeSet<String> {
    let mut reached = BTreeSet::new();
    let mut next: Vec<String> = uses(name).into_iter().collect();
    while let Some(name) = next.pop() {
        if reached.insert(name.clone()) {
            next.extend(uses(&name));
        }
    }
    reached
}

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

/// Fails with all violations of a rule.
fn hold(rule: &str, violations: impl IntoIterator<Item = String>) {
    let violations: Vec<String> = violations.into_iter().collect();
    assert!(violations.is_empty(), "{rule}:\n{}", violations.join("\n"));
}

/// The wrong lines of code, without tests, in some crates.
fn lines_with(within: impl Fn(&str) -> bool, wrong: impl Fn(&str) -> bool) -> Vec<String> {
    let files = sources().filter(|(path, _)| within(path));
    let lines = files.flat_map(|(path, file)| file.product_lines().map(move |(line, text)| (path.clone(), line, text)));
    let wrong = lines.filter(|(.., text)| wrong(text));
    wrong.map(|(path, line, text)| format!("{path}:{line}: {}", text.trim())).collect()
}

/// A crate with each kind of path that the rules must find, and some that they must not.
#[test]
fn every_kind_of_path_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let files = [
        ("main.rs", "fn main() { nsim::a::run() }"),
        ("lib.rs", "ranged!(/// A number, as [`crate::a::A`].\n N); pub mod a; pub mod b; #[cfg(test)] mod tests;"),
        ("a/mod.rs", "mod child; mod other; pub fn run() { child::f() } pub(crate) struct A;"),
        ("a/child.rs", "use super::other as o; pub fn f() {\n o::g(); assert!(crate::b::B::new() > 1);\n }"),
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
    let edges = |docs: bool| -> Vec<(String, Vec<String>)> {
        let graph = sources.graph(docs);
        let targets = |to: &BTreeMap<usize, Vec<String>>| to.keys().map(|&to| name(to)).collect();
        graph.iter().enumerate().map(|(from, to)| (name(from), targets(to))).collect()
    };
    let mut expected: [(&str, &[&str]); 7] = [
        ("a/child.rs", &["a/other.rs", "b.rs"]),
        ("a/mod.rs", &["a/child.rs"]),
        ("a/other.rs", &["a/mod.rs", "b.rs"]),
        ("b.rs", &[]),
        ("lib.rs", &[]),
        ("main.rs", &["a/mod.rs"]),
        ("tests.rs", &[]),
    ];
    let owned = |(from, to): (&str, &[&str])| (from.to_string(), to.iter().map(ToString::to_string).collect());
    assert_eq!(edges(false), expected.map(owned));
    (expected[3].1, expected[4].1) = (&["a/mod.rs"], &["a/mod.rs"]);
    assert_eq!(edges(true), expected.map(owned));
    assert!(!cycles(&sources, Unit::File).is_empty() && cycles(&sources, Unit::Entry).is_empty());
    let lengths: Vec<usize> = sources.files[0].functions.iter().map(|function| function.lines).collect();
    assert_eq!(lengths, [3]);
    assert_eq!(sources.files[3].product_lines().map(|(line, _)| line).collect::<Vec<_>>(), [1, 3]);
    assert!(
        holds_number("624 cores", "624") && holds_number("x=624.", "624") && !holds_number("6240, 0.624, 1_624", "624")
    );
}

#[test]
fn what_is_compared_with_nsim_s_own_work_shares_no_crate_with_it() {
    let only = |names: &[&str]| names.iter().map(ToString::to_string).collect::<BTreeSet<_>>();
    assert_eq!(reach("golden"), only(&["ir"]), "the interpreter is written from docs/semantics.md alone");
    assert_eq!(reach("check"), only(&["dynamics", "ir"]), "the checker takes no stage of the compiler");
    assert!(reach("study").is_superset(&only(&["check", "compile", "golden", "ir", "machine"])), "manifests are read");
}

#[test]
fn crates_are_few_and_none_is_large() {
    let workspace = CRATES.keys().filter(|name| *name != "python").count();
    assert!((8..=MOST_CRATES).contains(&workspace), "{workspace} crates");
    let lines = |sources: &Sources| sources.files.iter().map(|file| file.text.lines().count()).sum::<usize>();
    let large = CRATES.iter().map(|(name, sources)| (name, lines(sources))).filter(|(_, lines)| *lines > MOST_LINES);
    hold("a crate has at most 13,000 lines", large.map(|(name, lines)| format!("{name}: {lines} lines")));
}

/// What a rule about cycles groups a crate's files by.
#[derive(Clone, Copy, PartialEq)]
enum Unit {
    /// A file with its code.
    File,
    /// An entry of `src`, with code and doc comments: `a.rs` belongs to folder `a`.
    Entry,
}

impl Unit {
    /// The unit of a file; none for `lib.rs` and `main.rs` among entries.
    fn of_file(self, file: &SourceFile) -> Option<&str> {
        if self == Unit::File {
            return Some(&file.path);
        }
        let (_, within) = file.path.split_once("src/")?;
        let name = within.split('/').next()?.trim_end_matches(".rs");
        (!["lib", "main"].contains(&name)).then_some(name)
    }

    /// Whether a cycle is refused: of files any, of entries one through several folders.
    fn refuses(self, cycle: &[&str], sources: &Sources) -> bool {
        let is_folder = |name: &&&str| sources.files.iter().any(|file| file.path.contains(&format!("src/{name}/")));
        cycle.len() > 1 && (self == Unit::File || cycle.iter().filter(is_folder).count() > 1)
    }
}

/// Cycles among a crate's files or entries, and the paths that make them.
fn cycles(sources: &Sources, unit: Unit) -> Vec<String> {
    let mut edges: BTreeMap<(&str, &str), Vec<String>> = BTreeMap::new();
    for (from, targets) in sources.files.iter().zip(sources.graph(unit == Unit::Entry)) {
        for (target, names) in targets {
            let units = unit.of_file(from).zip(unit.of_file(&sources.files[target]));
            let Some((from, to)) = units.filter(|(from, to)| from != to) else { continue };
            edges.entry((from, to)).or_default().extend(names);
        }
    }
    let names: BTreeSet<&str> = edges.keys().flat_map(|&(from, to)| [from, to]).collect();
    let mut graph = DiGraph::<&str, ()>::new();
    let nodes: BTreeMap<&str, _> = names.into_iter().map(|name| (name, graph.add_node(name))).collect();
    for (from, to) in edges.keys() {
        graph.add_edge(nodes[from], nodes[to], ());
    }
    let components = tarjan_scc(&graph).into_iter();
    let components = components.map(|component| component.into_iter().map(|node| graph[node]).collect());
    let components: Vec<Vec<&str>> = components.filter(|cycle: &Vec<&str>| unit.refuses(cycle, sources)).collect();
    let in_cycle = |from, to| components.iter().any(|cycle| cycle.contains(&from) && cycle.contains(&to));
    let wrong = edges.into_iter().filter(|((from, to), _)| in_cycle(*from, *to));
    wrong.map(|((from, to), names)| format!("  {from} -> {to}: {}", names.join(", "))).collect()
}

/// Prints the cycles of all crates.
fn no_cycles(rule: &str, unit: Unit) {
    hold(
        rule,
        CRATES.iter().flat_map(|(name, sources)| {
            let wrong = cycles(sources, unit);
            (!wrong.is_empty()).then(|| format!("{name}:\n{}", wrong.join("\n")))
        }),
    );
}

#[test]
fn no_file_depends_on_itself() {
    no_cycles("files depend on each other without cycles", Unit::File);
}

/// A folder whose docs link to one that uses it cannot be read first.
#[test]
fn no_folder_of_a_crate_depends_on_itself() {
    no_cycles("folders of a crate depend on each other without cycles, links in docs included", Unit::Entry);
}

#[test]
fn functions_are_short() {
    let long = sources().flat_map(|(path, file)| {
        let long = file.functions.iter().filter(|function| !function.test && function.lines > MOST_LINES_OF_FUNCTION);
        long.map(move |function| format!("{path}:{}: {} has {} lines", function.line, function.name, function.lines))
    });
    hold("a function has at most 80 lines", long);
}

#[test]
fn every_file_is_part_of_its_crate_and_says_what_it_is() {
    let read: BTreeSet<String> = sources().map(|(path, _)| path).collect();
    let mut found = Vec::new();
    for folder in ["src", "crates", "python/src"] {
        files(&root().join(folder), "rs", &mut found);
    }
    let paths = found.iter().map(|path| path.strip_prefix(root()).unwrap().to_string_lossy().into_owned());
    let mut wrong: Vec<String> = paths
        .filter(|path| !read.contains(path) && !path.ends_with("/build.rs") && !path.contains("/tests/"))
        .map(|path| format!("{path}: no module declares it"))
        .collect();
    let undocumented = sources().filter(|(_, file)| !file.text.starts_with("//! "));
    wrong.extend(undocumented.map(|(path, _)| format!("{path}: has no module doc")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// What a build script printed is used again where a checkout was copied with its `target` folder.
#[test]
fn build_scripts_embed_no_absolute_path() {
    let mut found = Vec::new();
    files(&root().join("crates"), "rs", &mut found);
    let scripts: Vec<_> = found.into_iter().filter(|path| path.ends_with("build.rs")).collect();
    assert!(scripts.len() > 2);
    for path in scripts {
        let text = fs::read_to_string(&path).unwrap();
        // In the crate's source, which a script can write, it is the present checkout's folder.
        let absolute = ["env!(\"CARGO_MANIFEST_DIR\")", "canonicalize", "current_dir", "var(\"CARGO_MANIFEST_DIR"];
        let code: String = text.lines().filter(|line| !line.starts_with("//!")).collect();
        assert!(!absolute.iter().any(|word| code.contains(word)), "{}", path.display());
    }
}

#[test]
fn folders_hold_at_most_a_dozen_files() {
    let mut folders: BTreeMap<String, usize> = BTreeMap::new();
    // The folder `src` of a crate has one entry for each subject of the crate.
    for (path, _) in sources().filter(|(path, _)| !path.ends_with("/mod.rs")) {
        let folder = path.rsplit_once('/').unwrap().0.to_string();
        if !folder.ends_with("/src") && folder != "src" {
            *folders.entry(folder).or_default() += 1;
        }
    }
    let crowded = folders.into_iter().filter(|(_, files)| *files > MOST_FILES);
    let crowded = crowded.map(|(folder, files)| format!("{folder}: {files} files"));
    hold("a folder holds at most a dozen files besides mod.rs", crowded);
}

#[test]
fn functions_say_what_they_return() {
    let called_of = sources().flat_map(|(path, file)| {
        let functions = file.functions.iter().filter(|function| function.name == "of");
        functions.map(move |function| format!("{path}:{}: a function called `of`", function.line))
    });
    hold("`of` alone is no name", called_of);
}

/// Whether a text has a number as a word.
fn holds_number(text: &str, number: &str) -> bool {
    let numeric = |c: char| c.is_ascii_digit() || c == '_' || c == '.';
    text.split(|c| !numeric(c)).any(|digits| digits.trim_end_matches('.') == number)
}

#[test]
fn no_published_deployment_is_in_the_code() {
    let counted = |text: &str| ["594", "624"].iter().any(|number| holds_number(text, number));
    hold("the cores of a deployment are in its scenario file", lines_with(|_| true, counted));
}

#[test]
fn boards_are_named_in_their_files_only() {
    let mut targets = Vec::new();
    files(&root().join("mapping/targets"), "ron", &mut targets);
    let mut names: BTreeSet<String> = BTreeSet::new();
    for stem in targets.iter().map(|path| path.file_stem().unwrap().to_string_lossy().to_lowercase()) {
        // The family's name denotes the board as well; "tiny" and "loihi1" are also ordinary words.
        let family = stem.split('-').next().unwrap().to_string();
        names.extend((!["tiny", "loihi1"].contains(&family.as_str())).then_some(family));
        names.extend((stem != "tiny").then_some(stem));
    }
    let in_boardless = |path: &str| BOARDLESS.iter().any(|name| path.starts_with(&format!("crates/{name}/")));
    let named = |text: &str| names.iter().any(|name| text.to_lowercase().contains(name));
    hold("boards are named in their target files only", lines_with(in_boardless, named));
}

/// Folders whose files are named by path in documents.
const NAMED_FOLDERS: &str = ".ci .github assets benches crates docs examples mapping models python results src tests";

/// Paths in the repositories of other projects, which comments cite.
const CITED: [&str; 2] = ["docs/source/primitives.md", "docs/spec.md"];

/// Most words of a page of `docs`, the README or CONTRIBUTING; the pages of commands are generated.
const MOST_WORDS: usize = 4_100;

/// Words to avoid, in place of the field's terms.
const DIALECT: &str = "alike, at once, beside, comes to, dealt, for want of, foretold, handed, hears, in turn, \
                       leads nowhere, left out, nobody, so many, stands for, told, twins, whoever";

/// The words of [`DIALECT`] that a text has.
fn dialect(text: &str) -> impl Iterator<Item = &'static str> + use<> {
    let word = |word: &str| word.trim_matches(|c: char| !c.is_alphanumeric()).to_lowercase();
    let text = format!(" {} ", text.split_whitespace().map(word).collect::<Vec<_>>().join(" "));
    DIALECT.split(", ").filter(move |term| text.contains(&format!(" {term} ")))
}

/// The hand-written pages, by their path.
fn pages() -> Vec<(String, String)> {
    let mut paths: Vec<PathBuf> = ["README.md", "CONTRIBUTING.md"].map(|name| root().join(name)).into();
    files(&root().join("docs"), "md", &mut paths);
    let text = |path: &PathBuf| fs::read_to_string(path).unwrap();
    let named = |path: &PathBuf| path.strip_prefix(root()).unwrap().to_string_lossy().into_owned();
    paths.iter().map(|path| (named(path), text(path))).filter(|(path, _)| !path.contains("/commands/")).collect()
}

#[test]
fn pages_are_short_and_in_words_of_the_field() {
    let mut wrong = Vec::new();
    for (path, text) in pages() {
        let words = text.split_whitespace().count();
        if words > MOST_WORDS {
            wrong.push(format!("{path}: {words} words, at most {MOST_WORDS}"));
        }
        wrong.extend(dialect(&text).map(|term| format!("{path}: '{term}' is no term of the field")));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn comments_are_in_words_of_the_field() {
    let comment =
        |line: &'static str| line.trim_start().strip_prefix("//").map(|rest| rest.trim_start_matches(['/', '!']));
    let wrong = sources().flat_map(|(path, file)| {
        let comments: Vec<&str> = file.text.lines().filter_map(comment).collect();
        dialect(&comments.join("\n")).map(move |term| format!("{path}: '{term}' is no term of the field"))
    });
    hold("comments are in words of the field", wrong);
}

/// The names of links to the headings of a page.
fn anchors(page: &str) -> impl Iterator<Item = String> {
    page.lines().filter_map(|line| line.strip_prefix('#')).map(|heading| {
        let plain = heading.trim_matches(['#', ' ']).to_lowercase().replace(' ', "-");
        plain.chars().filter(|c| c.is_alphanumeric() || *c == '-' || *c == '_').collect()
    })
}

/// The paths between backquotes in a text.
fn quoted_paths(text: &str) -> impl Iterator<Item = &str> {
    let quoted = text.split('`').skip(1).step_by(2);
    quoted.filter(|quoted| {
        let folder = quoted.split_once('/').map(|(folder, _)| folder);
        folder.is_some_and(|folder| NAMED_FOLDERS.split(' ').any(|named| named == folder))
            && !quoted.contains([' ', '*', '<', '{', '\n'])
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
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { document.clone() } else { document.parent().unwrap().join(file) };
            let found = || anchor.is_empty() || anchors(&fs::read_to_string(&target).unwrap()).any(|of| of == anchor);
            if !(link.contains("://") || target.exists() && found()) {
                wrong.push(format!("{name} links to {link}, which does not exist"));
            }
        }
    }
    for (place, file) in sources() {
        for (line, text) in (1..).zip(file.text.lines()).filter(|(_, text)| text.trim_start().starts_with("//")) {
            let ours = |path: &&str| {
                !CITED.contains(path) && [".rs", ".md", ".ron", ".sh", "/"].iter().any(|e| path.ends_with(e))
            };
            let absent = quoted_paths(text).filter(ours).filter(|path| !root().join(path).exists());
            wrong.extend(absent.map(|path| format!("{place}:{line} names {path}, which does not exist")));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
