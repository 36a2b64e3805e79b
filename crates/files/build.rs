//! Sets `SHIPPED`: the project's folder, or a packaged crate's, which has copies of shipped files.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let own = env!("CARGO_MANIFEST_DIR");
    let project = format!("{own}/../..");
    // Not this folder's links, since some systems store links as text.
    let root = if Path::new(&project).join("models").is_dir() { project.as_str() } else { own };
    println!("cargo::rustc-env=SHIPPED={root}");
}
