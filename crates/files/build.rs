//! Where shipped files lie: in the folder of the project, or in a packaged crate, which has copies.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let own = env!("CARGO_MANIFEST_DIR");
    let project = format!("{own}/../..");
    // Not the links of this folder, which some systems store as text.
    let root = if Path::new(&project).join("models").is_dir() { project.as_str() } else { own };
    println!("cargo::rustc-env=SHIPPED={root}");
}
