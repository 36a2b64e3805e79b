//! The pages of `nsim report`, opened by a browser without a network.
//!
//! Chromium draws every section of six pages. A pointer moves over each chart, each zoom is set,
//! each button of choices is pressed, and the page's errors and network loads are collected.
//! Without Chromium that test prints `skipped`; the text of a page is still tested.

use crate::common;
use crate::common::command::{nsim, object, said, succeeds};
use crate::learning::array;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

fn page(folder: &Path, name: &str, line: &[&str]) -> PathBuf {
    let path = folder.join(name);
    succeeds(folder, &[&["report"], line, &["-o", name, "--force"]].concat());
    path
}

/// The data of a page.
pub fn data(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap();
    let (_, rest) = text.split_once("<script type=\"application/json\" id=\"data\">").unwrap();
    serde_json::from_str(rest.split_once("</script>").unwrap().0).unwrap()
}

/// Two convolutions and a dense layer.
fn convolutions() -> String {
    let mut weight = (0..).map(|at: i64| 2 * (at * 7 % 31) - 20);
    let mut list = |count: usize| (0..count).map(|_| weight.next().unwrap().to_string()).collect::<Vec<_>>().join(", ");
    let mut nested = |sizes: &[usize]| {
        let [outer, inner, height, width] = sizes else { unreachable!() };
        let mut row = || format!("[{}]", list(*width));
        let mut plane = || format!("[{}]", (0..*height).map(|_| row()).collect::<Vec<_>>().join(", "));
        let mut volume = || format!("[{}]", (0..*inner).map(|_| plane()).collect::<Vec<_>>().join(", "));
        format!("[{}]", (0..*outer).map(|_| volume()).collect::<Vec<_>>().join(", "))
    };
    let (first, second) = (nested(&[6, 2, 3, 3]), nested(&[8, 6, 3, 3]));
    let dense = nested(&[1, 1, 4, 128]);
    let dense = &dense[2..dense.len() - 2];
    format!(
        "Network(name: \"convolutions\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [2, 16, 16]),
          Loihi(name: \"c1\", shape: [6, 8, 8], du: 2048, dv: 512, vth_mant: 60),
          Loihi(name: \"c2\", shape: [8, 4, 4], du: 2048, dv: 512, vth_mant: 60),
          Loihi(name: \"out\", shape: [4], du: 2048, dv: 512, vth_mant: 60)],
        projections: [Conv2d(from: [\"in\"], to: \"c1\", weights: {first}, stride: (2, 2), padding: (1, 1)),
          Conv2d(from: [\"c1\"], to: \"c2\", weights: {second}, stride: (2, 2), padding: (1, 1)),
          Dense(from: [\"c2\"], to: \"out\", weights: {dense})], output: \"out\")"
    )
}

/// Sigma-delta neurons whose output decides no class.
const VALUES: &str = "Network(name: \"values\", timestep_ms: 1.0, target: \"oheo-gulch\",
    populations: [Input(name: \"in\", shape: [4]),
        SigmaDelta(name: \"h\", shape: [3], vth_mant: 4, bias_mant: 0, spike_exp: 0, state_exp: 0),
        SigmaDelta(name: \"out\", shape: [2], vth_mant: 4, bias_mant: 0, spike_exp: 0, state_exp: 0)],
    projections: [Dense(from: [\"in\"], to: \"h\", weights: [[4, 8, 2, 6], [2, 2, 4, 8], [8, 2, -4, 2]]),
        Dense(from: [\"h\"], to: \"out\", weights: [[4, 8, 2], [2, -6, 4]])], output: \"out\")";

/// Five pages: the shipped network with 32 copies, a trained one next to its integers, convolutions
/// from another format, 1,024 copies, and a network of values.
fn pages(folder: &Path) -> Vec<(&'static str, PathBuf)> {
    let slip = page(folder, "slip.html", &["vtsnn-slip", "--samples", "0..6", "--baseline", "rtx-2080-ti"]);
    let trained = page(folder, "trained.html", &["vtsnn-slip-srm", "--samples", "0..4", "--baseline"]);
    std::fs::write(folder.join("conv.ron"), convolutions()).unwrap();
    succeeds(folder, &["export", "conv.ron", "-o", "conv.nir"]);
    let noise = "scene:noise?samples=2&steps=60&seed=2&rate=0.1";
    let conv = page(folder, "conv.html", &["conv.nir", "--input", noise, "--baseline"]);
    let many = ["vtsnn-slip", "--copies", "1024", "--target", "pohoiki-springs", "--samples", "0..2", "--baseline"];
    let many = page(folder, "many.html", &many);
    std::fs::write(folder.join("values.ron"), VALUES).unwrap();
    let values = page(folder, "values.html", &["values.ron", "--input", noise, "--baseline"]);
    vec![("slip", slip), ("trained", trained), ("conv", conv), ("many", many), ("values", values)]
}

/// A chain of this many populations.
fn chain(count: u32) -> String {
    let one = |n: u32| format!("Loihi(name: \"p{n}\", shape: [2], du: 1, dv: 1, vth_mant: 1)");
    let into = |n: u32| {
        let from = if n == 0 { "in".to_string() } else { format!("p{}", n - 1) };
        format!("Sparse(from: [\"{from}\"], to: \"p{n}\", synapses: [(0, 0, 2)])")
    };
    let list = |of: &dyn Fn(u32) -> String| (0..count).map(of).collect::<Vec<_>>().join(",");
    format!(
        "Network(name: \"chain\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]), {}], projections: \
         [{}],
        output: \"p{}\")",
        list(&one),
        list(&into),
        count - 1
    )
}

#[test]
fn of_many_populations_some_are_drawn_and_the_page_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("chain.ron"), chain(3_000)).unwrap();
    let noise = "scene:noise?samples=1&steps=20&seed=1";
    let path = page(here, "chain.html", &["chain.ron", "--input", noise, "--baseline"]);
    let data = data(&path);
    let network = &data["network"];
    let names: Vec<&str> =
        network["populations"].as_array().unwrap().iter().filter_map(|one| one["name"].as_str()).collect();
    assert!(names.len() == 40 && names[..2] == ["in", "p0"] && names[39] == "p2999", "{names:?}");
    assert_eq!((&network["populations_in_all"], &network["projections_in_all"]), (&3_001.into(), &3_000.into()));
    assert_eq!(data["sample"]["rasters"].as_array().unwrap().len(), 40);
    assert_eq!(data["results"][0]["populations"].as_array().unwrap().len(), 3_000, "the result is whole");
    let Some(browser) = chromium() else {
        common::say("skipped: no Chromium: the page of 3,000 populations was not opened");
        return;
    };
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--virtual-time-budget=60000"])
        .arg("--dump-dom")
        .arg(format!("--user-data-dir={}", here.join("profile").display()))
        .arg(format!("file://{}", path.display()))
        .output()
        .unwrap();
    let document = String::from_utf8_lossy(&output.stdout);
    assert!(document.contains("data-drawn=\"all\""), "not drawn");
    assert!(document.contains("The chart has 40 of 3\u{2009}001 populations"));
}

#[test]
fn a_page_of_values_has_the_messages_of_its_outputs() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    std::fs::write(here.join("values.ron"), VALUES).unwrap();
    let noise = "scene:noise?samples=1&steps=40&seed=2&rate=0.3";
    let data = data(&page(here, "values.html", &["values.ron", "--input", noise, "--baseline"]));
    let sample = &data["sample"];
    assert_eq!(
        (&sample["decides"], &sample["of_messages"], &data["confusion"]),
        (&false.into(), &true.into(), &Value::Null)
    );
    let probes =
        ["run", "values.ron", "--input", noise, "--probe", "out.message", "--probe-format", "csv", "-o", "traces"];
    succeeds(here, &probes);
    let name = std::fs::read_dir(here.join("traces")).unwrap().next().unwrap().unwrap().path();
    let text = std::fs::read_to_string(name).unwrap();
    let mut values = vec![vec![0; 40]; 2];
    for line in text.lines().skip(1) {
        let row: Vec<i64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
        values[row[2] as usize][row[1] as usize] = row[3];
    }
    for (index, values) in values.iter().enumerate() {
        let drawn = sample["potentials"].as_array().unwrap().iter().find(|one| one["name"] == format!("out[{index}]"));
        assert_eq!(drawn.unwrap()["largest"], serde_json::json!(values), "{text}");
        assert!(values.iter().any(|&value| value != 0), "{text}");
    }
    let values: Vec<&Value> = sample["rasters"].as_array().unwrap().iter().map(|one| &one["values"]).collect();
    assert_eq!(values, [&false, &true, &true]);
}

/// The panels of one synapse have the spikes, traces and weights that probes record.
#[test]
fn a_page_of_rules_has_what_they_learn() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let input = ["--input", "scene:noise?samples=1&steps=60&seed=2&rate=0.1"];
    let text = "Network(name: \"m\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [3]),
        Loihi(name: \"out\", shape: [2], du: 4096, dv: 512, vth_mant: 4)], projections: [Dense(name: \"p\", from: [\"in\"],
        to: \"out\", weights: [[8, 60, 20], [6, 4, 30]], learning: Rule(dw: \"2^-2*x1*y0\", epoch: 2, x1: (impulse:
        9, tau: 5)))], output: \"out\")";
    std::fs::write(here.join("m.ron"), text).unwrap();
    let data = data(&page(here, "m.html", &["m.ron", input[0], input[1], "--baseline"]));
    let rule = &data["learning"][0];
    let told = ["name", "epoch", "semantics", "synapses"].map(|key| rule[key].clone());
    assert_eq!(Value::from(told.to_vec()), serde_json::json!(["p", 2, "Silicon", 6]));
    assert_eq!(rule["changes"], serde_json::json!(["weight: 1*2^-2*y0*x1"]));
    let picture = rule["picture"].as_str().unwrap();
    let probes = ["--probe", "p.weight", "--probe", "p.x1", "-o", "traces"];
    succeeds(here, &[&["run", "m.ron", input[0], input[1]], probes.as_slice()].concat());
    let column =
        |name: &str, row: usize| array(&here.join(format!("traces/{name}.npy"))).1[60 * row..60 * (row + 1)].to_vec();
    let change = |row: usize| column("p.weight", row)[59] - [8, 60, 20, 6, 4, 30][row];
    let most = (0..6).rev().max_by_key(|&row| change(row).abs()).unwrap();
    assert!(change(most) > 0 && rule["changed"].as_u64() > Some(0));
    let named = format!("from source {} to target {}", most % 3, most / 3);
    assert!(picture.contains(&named), "{named}: {picture}");
    for values in [column("p.x1", most % 3), column("p.weight", most)] {
        let greatest = values.iter().max().unwrap();
        assert!(picture.contains(&format!(">{greatest}</text>")), "{values:?}: {picture}");
    }
}

#[test]
fn a_page_holds_what_energy_prints_and_loads_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    for (name, path) in pages(here) {
        let text = std::fs::read_to_string(&path).unwrap();
        let data = data(&path);
        // Each of these would start a load when the page opens.
        for load in [
            "src=\"http",
            "src='http",
            "@import",
            "url(http",
            "fetch(",
            "XMLHttpRequest",
            "<iframe",
            "<link rel=\"stylesheet\"",
        ] {
            assert!(!text.contains(load), "{name} contains {load}");
        }
        let own = text.len() - data.to_string().len();
        assert!(own < 5 << 20, "{name}: {own} bytes beside the data");
        let (result, sample) = (&data["results"][0], &data["sample"]);
        let steps = sample["steps"].as_u64().unwrap();
        assert!(steps > 0 && steps == sample["steps_of_sample"]);
        // A page that reduces nothing has the curves of the first sample: their spikes equal the
        // rasters'.
        assert_eq!(sample["steps_a_point"], 1);
        let copies = result["copies"].as_u64().unwrap();
        for raster in sample["rasters"].as_array().unwrap() {
            let curve = &sample["curves"][format!("spikes.{}", raster["name"].as_str().unwrap())];
            let spikes: f64 = curve.as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).sum();
            let marks = raster["step"].as_array().unwrap().len() as u64;
            assert_eq!(raster["unit"].as_array().unwrap().len() as u64, marks);
            match raster["every"].as_u64() {
                Some(1) => assert_eq!(spikes, (marks * copies) as f64, "{name} {}", raster["name"]),
                _ => assert!(marks * copies <= spikes as u64),
            }
        }
        assert_eq!(
            data["fit"]["cores"].as_array().unwrap().len() as u64,
            result["cores_used"].as_u64().unwrap(),
            "{name}"
        );
        assert!(name != "trained" || data["agreement"]["layers"].as_array().is_some_and(|layers| layers.len() == 3));
        let right = |index: usize| data["confusion"]["counts"][index][index].as_u64().unwrap_or(0);
        let diagonal = (0..3).map(right).sum::<u64>() as f64;
        assert_eq!(data["confusion"].is_null(), result["accuracy"].is_null(), "{name}");
        if let Some(accuracy) = result["accuracy"].as_f64() {
            assert_eq!(diagonal, (accuracy * result["samples"].as_f64().unwrap()).round(), "{name}");
        }
    }
    let printed = object(here, "energy vtsnn-slip --samples 0..6 --baseline rtx-2080-ti", 0);
    assert_eq!(data(&here.join("slip.html"))["results"][0], printed);
}

#[test]
fn results_are_compared_and_other_files_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let save = |line: &str, name: &str| std::fs::write(here.join(name), said(here, line).1).unwrap();
    save("energy --samples 0..1 --baseline --format json", "a.json");
    save("run --samples 0..1 --format json", "b.json");
    std::fs::write(here.join("c.json"), "{\"schema\": \"nsim.map/1\"}").unwrap();
    std::fs::write(here.join("d.json"), "{\"schema\": ").unwrap();
    std::fs::write(here.join("e.json"), r#"{"schema": "nsim.run/1", "model": "m", "populations": {}}"#).unwrap();
    let text = r#"{"schema": "nsim.energy/1", "rows": [{"low": {"total_mw": 1}}, {"low": {"total_mw": "1"}}]}"#;
    std::fs::write(here.join("f.json"), text).unwrap();
    let both = data(&page(here, "both.html", &["a.json", "b.json"]));
    assert_eq!(
        (&both["results"][0]["schema"], &both["results"][1]["schema"]),
        (&"nsim.energy/1".into(), &"nsim.run/1".into())
    );
    assert_eq!(both["origins"].as_array().unwrap().len(), 2);
    for (line, status, word) in [
        (&["c.json", "-o", "c.html"][..], 3, "report.result"),
        (&["a.json", "d.json", "-o", "d.html"], 3, "report.result"),
        (&["e.json", "-o", "d.html"], 3, "populations is not a list"),
        (&["a.json", "f.json", "-o", "d.html"], 3, "rows[1].low.total_mw is not a number"),
        (&["a.json", "-o", "d.pdf"], 2, ".html"),
        (&["vtsnn-slip", "b.json", "-o", "d.html"], 2, "b.json"),
        (&["vtsnn-slip", "-o", "d.html", "--format", "csv"], 2, "page"),
        (&["a.json", "b.json", "-o", "both.html"], 3, "--force"),
    ] {
        let (found, _, error) = said(here, &[&["report"], line].concat());
        assert!(found == status && error.contains(word), "{line:?}: {found} {error}");
    }
    assert!(!here.join("c.html").exists() && !here.join("d.html").exists());
}

#[test]
fn a_model_comes_through_a_pipe() {
    let folder = tempfile::tempdir().unwrap();
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let weights = "slip-tactile.safetensors";
    std::fs::copy(models.join(weights), folder.path().join(weights)).unwrap();
    let mut command = nsim(folder.path(), "report - --samples 0..1 --baseline -o piped.html");
    let output = command.pipe_stdin(models.join("slip-tactile.ron")).unwrap().output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let data = data(&folder.path().join("piped.html"));
    assert_eq!((&data["network"]["name"], data["origins"].as_array().unwrap().len()), (&"slip-tactile".into(), 0));
}

/// Checks that a page's own script cannot do. Appended to it, this moves the pointer over every
/// chart, turns the wheel, sets its zoom and focuses every control as the tabulator key does. It
/// reads the drawing, and stores the findings in the document.
const OBSERVER: &str = r#"<script>
(() => {
  const found = { sections: [], blank: [], silent: [], zoomed: 0, wheeled: 0, buttons: 0, unreachable: [] };
  const wait = () => {
    if (document.documentElement.dataset.drawn !== "all") return setTimeout(wait, 20);
    found.ready_ms = performance.now();
    found.sections = [...document.querySelectorAll("main section")].map((section) => section.id);
    const charts = [...document.querySelectorAll(".chart")];
    for (const box of charts) {
      const chart = echarts.getInstanceByDom(box);
      const canvas = box.querySelector("canvas");
      if (!chart || !canvas) { found.blank.push(box.getAttribute("aria-label")); continue; }
      const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
      let ink = 0;
      for (let at = 3; at < pixels.length; at += 4) ink += pixels[at] > 0 && pixels[at - 1] < 230;
      if (ink < 60) found.blank.push(box.getAttribute("aria-label"));
      const move = (type, x, y, more) => chart.getZr().dom.firstChild.dispatchEvent(new MouseEvent(type, { bubbles: true, clientX: x, clientY: y, ...more }));
      const place = box.getBoundingClientRect();
      box.scrollIntoView();
      const seen = () => [...box.querySelectorAll("div")].some((div) => div.style.pointerEvents === "none" && div.style.visibility !== "hidden" && div.textContent.trim().length > 2);
      const at = box.getBoundingClientRect();
      let hit = false;
      for (let y = 0.1; y < 0.95 && !hit; y += 0.04) for (let x = 0.02; x < 0.98 && !hit; x += 0.02) { move("mousemove", at.left + x * place.width, at.top + y * place.height); hit = seen(); }
      if (!hit) found.silent.push(box.getAttribute("aria-label"));
      const zooms = () => JSON.stringify((chart.getOption().dataZoom || []).map((zoom) => [zoom.start, zoom.end]));
      const unwheeled = zooms();
      for (let x = 0.2; x < 0.9 && unwheeled !== "[]" && unwheeled === zooms(); x += 0.2) for (let y = 0.1; y < 0.95 && unwheeled === zooms(); y += 0.08) {
        // Of an event that a script makes, Chromium takes a positive delta for a turn away from the
        // user.
        const wheel = { bubbles: true, cancelable: true, ctrlKey: true, deltaY: 240, clientX: at.left + x * place.width, clientY: at.top + y * place.height };
        chart.getZr().dom.firstChild.dispatchEvent(new WheelEvent("wheel", wheel));
      }
      found.wheeled += unwheeled !== "[]" && unwheeled !== zooms();
      const before = zooms();
      chart.dispatchAction({ type: "dataZoom", dataZoomIndex: 0, start: 20, end: 60 });
      found.zoomed += before !== "[]" && before !== zooms();
    }
    found.charts = charts.length;
    found.buttons = document.querySelectorAll("button, select, summary, nav a").length;
    for (const control of document.querySelectorAll("a[href], button, select, summary, input")) {
      if (control.offsetParent === null) continue;
      control.focus();
      if (document.activeElement !== control || control.tabIndex !== 0) found.unreachable.push(control.outerHTML.slice(0, 80));
    }
    for (const button of document.querySelectorAll(".choices button")) button.click();
    found.loads = performance.getEntriesByType("resource").map((entry) => entry.name).filter((name) => !name.startsWith("data:"));
    const result = document.createElement("pre");
    result.id = "found";
    result.textContent = JSON.stringify(found);
    document.body.append(result);
  };
  wait();
})();
</script>"#;

fn chromium() -> Option<&'static str> {
    ["chromium", "chromium-browser", "google-chrome"]
        .into_iter()
        .find(|name| Command::new(name).arg("--version").output().is_ok_and(|output| output.status.success()))
}

#[test]
fn a_browser_draws_every_section_without_an_error_or_a_network() {
    let Some(browser) = chromium() else {
        common::say("skipped: no Chromium: the pages of nsim report were not opened");
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let mut all = pages(here);
    std::fs::write(here.join("a.json"), data(&all[0].1)["results"][0].to_string()).unwrap();
    std::fs::write(here.join("b.json"), data(&all[1].1)["results"][0].to_string()).unwrap();
    all.push(("two", page(here, "two.html", &["a.json", "b.json"])));
    for (name, path) in all {
        let compared = data(&path)["agreement"].is_object();
        let text = std::fs::read_to_string(&path).unwrap();
        let (before, after) = text.rsplit_once("</body>").unwrap();
        let text = format!("{before}{OBSERVER}</body>{after}");
        std::fs::write(&path, text).unwrap();
        let profile = here.join(format!("profile-{name}"));
        let output = Command::new(browser)
            .args("--headless --no-sandbox --disable-gpu --disable-dev-shm-usage --hide-scrollbars".split(' '))
            .args("--enable-logging=stderr --window-size=1280,900 --virtual-time-budget=60000".split(' '))
            .args(["--host-resolver-rules=MAP * ~NOTFOUND", "--dump-dom"])
            .arg(format!("--user-data-dir={}", profile.display()))
            .arg(format!("file://{}", path.display()))
            .output()
            .unwrap();
        let (document, log) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
        let complaints: Vec<&str> = log.lines().filter(|line| line.contains("CONSOLE")).collect();
        assert!(complaints.is_empty(), "{name}: {complaints:?}");
        let (_, rest) = document.split_once("<pre id=\"found\">").unwrap_or_else(|| panic!("{name}: not drawn: {log}"));
        let found: Value = serde_json::from_str(rest.split_once("</pre>").unwrap().0).unwrap();
        let sections: Vec<&str> = found["sections"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
        let common = ["hardware", "network", "fit", "spikes", "potentials", "steps", "goes"];
        let expected: Vec<&str> = match name {
            "two" => vec!["compared", "origin"],
            _ => {
                let agreement = ["agreement"].into_iter().filter(|_| compared);
                let classes = ["classes"].into_iter().filter(|_| !matches!(name, "conv" | "values"));
                common.into_iter().chain(agreement).chain(classes).chain(["origin"]).collect()
            }
        };
        assert_eq!(sections, expected, "{name}");
        let number = |key: &str| found[key].as_u64().unwrap_or(0);
        let empty = Value::Array(vec![]);
        assert_eq!((&found["blank"], &found["loads"], &found["silent"]), (&empty, &empty, &empty), "{name}");
        assert!(number("charts") >= 3 && number("buttons") > 5, "{name}: {found}");
        assert!(name == "two" || number("zoomed") >= 4, "{name}: {found}");
        assert!(name == "two" || number("wheeled") >= 4, "{name}: {found}");
        assert_eq!(found["unreachable"], empty, "{name}");
    }
}
