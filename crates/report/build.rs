//! Deflates the chart library that pages embed, and passes on the folder of the assets, relative to
//! this crate's: the project's, or the copies in a packaged crate. Paths are relative for the
//! reason in `crates/files/build.rs`.

use std::io::Write;
use std::path::Path;

const CHARTS: &str = "echarts/echarts.min.js";

fn main() -> std::io::Result<()> {
    // The link of this folder is not used, since some systems store it as text.
    let assets = if Path::new("../../assets").is_dir() { "../../assets" } else { "assets" };
    let charts = format!("{assets}/{CHARTS}");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={charts}");
    println!("cargo::rustc-env=ASSETS=/{assets}");
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    let file = std::fs::File::create(Path::new(&out).join("echarts.min.js.deflate"))?;
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::best());
    deflated.write_all(&std::fs::read(charts)?)?;
    deflated.finish().map(drop)
}
