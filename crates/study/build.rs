//! Lists the stored results of the paper's tables, so that the program embeds each file of their
//! folder. A packaged crate has a copy of the project's folder.

use std::path::Path;

fn main() -> std::io::Result<()> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    // The link of this folder is not used, since some systems store it as text.
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
