//! Deflates what pages embed.

use std::io::Write;
use std::path::Path;

const CHARTS: &str = "../../assets/echarts/echarts.min.js";

fn main() -> std::io::Result<()> {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={CHARTS}");
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    let file = std::fs::File::create(Path::new(&out).join("echarts.min.js.deflate"))?;
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::best());
    deflated.write_all(&std::fs::read(CHARTS)?)?;
    deflated.finish().map(drop)
}
