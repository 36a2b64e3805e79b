//! Deflates the chart library that pages embed, and passes on the path of the assets: the project's
//! folder, or the copies in a packaged crate.

use std::io::Write;
use std::path::Path;

const CHARTS: &str = "echarts/echarts.min.js";

fn main() -> std::io::Result<()> {
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    // The link of this folder is not used, since some systems store it as text.
    let assets = [own.join("../../assets"), own.join("assets")].into_iter().find(|assets| assets.is_dir());
    let assets = assets.unwrap_or_default();
    let charts = assets.join(CHARTS);
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed={}", charts.display());
    println!("cargo::rustc-env=ASSETS={}", assets.display());
    let out = std::env::var_os("OUT_DIR").unwrap_or_default();
    let file = std::fs::File::create(Path::new(&out).join("echarts.min.js.deflate"))?;
    let mut deflated = flate2::write::DeflateEncoder::new(file, flate2::Compression::best());
    deflated.write_all(&std::fs::read(charts)?)?;
    deflated.finish().map(drop)
}
