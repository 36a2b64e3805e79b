//! Sets `SHIPPED`: the folder of the shipped files, relative to this crate's: the project's, or a
//! packaged crate's, which has copies of them.
//!
//! Paths are relative, because cargo reuses what a build script printed after a checkout was
//! copied with its `target` folder. `env!("CARGO_MANIFEST_DIR")` in the source is read again.

use std::path::Path;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    // Not this folder's links, since some systems store links as text.
    let root = if Path::new("../../models").is_dir() { "/../.." } else { "" };
    println!("cargo::rustc-env=SHIPPED={root}");
}
