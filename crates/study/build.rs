//! Lists the stored results of the paper's tables, so that the program carries each file that lies
//! in their folder: that of the project, or in a packaged crate its copy.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    // Not the link of this folder, which some systems store as text.
    let project = own.join("../../results/paper");
    let results = if project.is_dir() { project } else { own.join("results/paper") };
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={}", results.display());
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(results)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "json") {
            paths.push(std::fs::canonicalize(path)?);
        }
    }
    paths.sort();
    let mut list = String::from("&[\n");
    for path in &paths {
        let name = path.file_name().unwrap_or_default();
        list += &format!("    ({name:?}, include_str!({path:?})),\n");
    }
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    std::fs::write(Path::new(&out).join("paper_results.rs"), list + "]\n")
}
