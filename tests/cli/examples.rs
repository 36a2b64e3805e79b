//! The examples are short, and each runs to its end.

#[path = "../../examples/map.rs"]
mod map;
#[path = "../../examples/price.rs"]
mod price;
#[path = "../../examples/run.rs"]
mod run;

use std::path::Path;

#[test]
fn each_example_runs() {
    for (name, example) in [("map", map::main()), ("price", price::main()), ("run", run::main())] {
        assert!(example.is_ok(), "{name}: {example:?}");
    }
}

#[test]
fn each_example_is_run_here_and_under_forty_lines() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(folder).expect("the examples") {
        let path = entry.expect("an entry").path();
        let lines = std::fs::read_to_string(&path).expect("a text").lines().count();
        assert!(lines < 40, "{}: {lines} lines", path.display());
        names.push(path.file_stem().expect("a name").to_string_lossy().into_owned());
    }
    names.sort();
    assert_eq!(names, ["map", "price", "run"]);
}
