//! Lists the stored results of the paper's tables, so that the program embeds each file of their
//! folder. A packaged crate has a copy of the project's folder. Paths are relative for the reason
//! in `crates/files/build.rs`.

use std::path::Path;

fn main() -> std::io::Result<()> {
    // The link of this folder is not used, since some systems store it as text.
    let project = "../../results/paper";
    let results = if Path::new(project).is_dir() { project } else { "results/paper" };
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={results}");
    let mut names = Vec::new();
    for entry in std::fs::read_dir(results)? {
        let name = entry?.file_name().to_string_lossy().into_owned();
        names.extend(name.ends_with(".json").then_some(name));
    }
    names.sort();
    let mut list = String::from("&[\n");
    for name in &names {
        let path = format!("/{results}/{name}");
        list += &format!("    ({name:?}, include_str!(concat!(env!(\"CARGO_MANIFEST_DIR\"), {path:?}))),\n");
    }
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    std::fs::write(Path::new(&out).join("paper_results.rs"), list + "]\n")
}
