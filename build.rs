//! Tells the program which compiler built it: a measured time means little without. Deflates what pages embed, and lists
//! stored results.

use std::io::Write;
use std::path::Path;
use std::process::Command;

const RESULTS: &str = "results/paper";
const CHARTS: &str = "assets/echarts/echarts.min.js";

fn main() -> std::io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-env-changed=RUSTC");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let version = Command::new(rustc).arg("--version").output().ok().and_then(|out| String::from_utf8(out.stdout).ok());
    println!("cargo::rustc-env=NSIM_RUSTC={}", version.as_deref().map_or("rustc unknown", str::trim));
    println!("cargo::rerun-if-changed={CHARTS}");
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    let file = std::fs::File::create(Path::new(&out).join("echarts.min.js.deflate"))?;
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::best());
    deflated.write_all(&std::fs::read(CHARTS)?)?;
    deflated.finish()?;
    stored_results(Path::new(&out))
}

/// Lists the stored results of the paper's tables, so that the program carries each file that lies in their folder.
fn stored_results(out: &Path) -> std::io::Result<()> {
    println!("cargo::rerun-if-changed={RESULTS}");
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(RESULTS)? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "json") {
            paths.push(std::path::absolute(path)?);
        }
    }
    paths.sort();
    let mut list = String::from("&[\n");
    for path in &paths {
        let name = path.file_name().unwrap_or_default();
        list += &format!("    ({name:?}, include_str!({path:?})),\n");
    }
    std::fs::write(out.join("paper_results.rs"), list + "]\n")
}
