//! A run as one page that opens in any browser without a network: `nsim report`.
//!
//! Input: counts and costs of a run, as JSON; its network, mapping and first sample. Output: HTML
//! that includes the data, the program that draws them (`page.js`), and Apache ECharts
//! (`assets/echarts`, Apache License 2.0), unchanged. The page states by how much data are reduced.

pub mod fit;
pub mod job;
pub mod network;
pub mod sample;

use std::io::Read;

use serde_json::{Value, json};

use crate::charts::draw::COLOURS;
use nsim_ir::base::names::markup;

const TEMPLATE: &str = include_str!("page.html");
const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");
/// Apache ECharts, as the build deflated it.
const CHARTS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/echarts.min.js.deflate"));

/// A file or source that a page was made from.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Origin {
    /// Its kind: model, target, input, mapping.
    pub what: &'static str,
    /// Its path or name.
    pub name: String,
    /// SHA-256 of its bytes, in hexadecimal digits.
    pub sha256: String,
}

/// Provenance of a page.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Provenance {
    /// The command as it was typed.
    pub command: String,
    /// Files and sources that it read.
    pub origins: Vec<Origin>,
}

/// Sections of a page; a null section is omitted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sections {
    /// `nsim.energy/1` or `nsim.run/1`; two where two are compared.
    pub results: Vec<Value>,
    /// [`network::json`].
    pub network: Value,
    /// [`fit::json`].
    pub fit: Value,
    /// [`sample::json`].
    pub sample: Value,
    /// [`sample::confusion`].
    pub confusion: Value,
    /// What each rule learns in the first sample, with its picture.
    pub learning: Value,
    /// `nsim.agree/1` against the trained network.
    pub agreement: Value,
}

/// The page.
pub fn html(title: &str, sections: &Sections, provenance: &Provenance) -> String {
    let Sections { results, network, fit, sample, confusion, learning, agreement } = sections;
    let data = json!({
        "schema": "nsim.report/1", "nsim": env!("CARGO_PKG_VERSION"), "title": title, "colours": COLOURS,
        "command": provenance.command, "origins": provenance.origins, "results": results, "network": network,
        "fit": fit, "sample": sample, "confusion": confusion, "learning": learning, "agreement": agreement,
    });
    // `</script` would end the script, and `<!--<script` would hide its end. `<` occurs in strings
    // only, where it can be escaped.
    let data = data.to_string().replace('<', "\\u003c");
    let parts = [("title", markup(title)), ("style", STYLE.to_string()), ("charts", charts())];
    let parts = parts.into_iter().chain([("data", data), ("script", SCRIPT.to_string())]);
    let mut rest = TEMPLATE;
    let mut page = String::with_capacity(TEMPLATE.len() + (2 << 20));
    for (name, text) in parts {
        let mark = format!("{{{{{name}}}}}");
        if let Some((before, after)) = rest.split_once(&mark) {
            page += before;
            page += &text;
            rest = after;
        }
    }
    page + rest
}

/// Source text of the chart library.
fn charts() -> String {
    let mut text = String::new();
    // Inflating the build's output does not fail; a test compares it with the file.
    let _ = flate2::read::DeflateDecoder::new(CHARTS).read_to_string(&mut text);
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_charts_are_the_file() {
        let file = include_str!(concat!(env!("CARGO_MANIFEST_DIR"), env!("ASSETS"), "/echarts/echarts.min.js"));
        assert!(charts() == file && file.len() > 500_000);
    }

    #[test]
    fn a_page_holds_its_data_once_and_nothing_of_it_ends_a_script() {
        let name = "</script><b>& \u{2028} {{data}}";
        let sections = Sections { results: vec![json!({ "model": name })], ..Sections::default() };
        let origin = Origin { what: "model", name: name.to_string(), sha256: "00".to_string() };
        let provenance = Provenance { command: format!("nsim report '{name}'"), origins: vec![origin] };
        let page = html(name, &sections, &provenance);
        assert!(!page.contains("{{style}}") && !page.contains("{{script}}") && page.contains("echarts"));
        let (_, data) = page.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
        let (data, _) = data.split_once("</script>").unwrap();
        let read: Value = serde_json::from_str(data).unwrap();
        assert_eq!((&read["results"][0]["model"], &read["title"]), (&json!(name), &json!(name)));
        assert_eq!(page.matches("<title>").count(), 1);
        assert!(page.contains("<title>&lt;/script&gt;&lt;b&gt;&amp; "));
    }
}
