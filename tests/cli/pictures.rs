//! Pictures of the command line: each kind in each format, from models and from saved results.

use crate::common::command::{said, succeeds};

const MODEL: &str = "Network(name: \"m\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]),
    Loihi(name: \"hidden\", shape: [5], du: 2048, dv: 512, vth_mant: 8),
    Loihi(name: \"out\", shape: [2], du: 2048, dv: 512, vth_mant: 8)],
  projections: [Dense(from: [\"in\"], to: \"hidden\", weights: Uniform(low: 10, high: 60, step: 2, seed: 1)),
    Dense(from: [\"hidden\"], to: \"out\", weights: Uniform(low: 10, high: 60, step: 2, seed: 2))], output: \"out\")";

const INPUT: &str = "scene:noise?samples=3&steps=40&rate=0.2&seed=5";

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.ron"), MODEL).unwrap();
    folder
}

#[test]
fn a_run_is_drawn_in_every_format() {
    let folder = folder();
    let here = folder.path();
    for what in ["raster", "voltage", "energy", "time", "map"] {
        for (ending, magic) in [("svg", &b"<svg"[..]), ("png", &b"\x89PNG"[..]), ("pdf", &b"%PDF-1."[..])] {
            let line = format!("plot {what} m.ron --input {INPUT} -o {what}.{ending}");
            if ending != "svg" && cfg!(not(feature = "pictures")) {
                // The suggested name has just been written.
                let (status, printed, error) = said(here, &line);
                let offered = format!("name it {what}.svg");
                assert!(status == 2 && printed.is_empty() && error.contains("'pictures'"), "{line}: {error}");
                assert!(error.contains(&offered) && here.join(format!("{what}.svg")).exists(), "{line}: {error}");
                continue;
            }
            let (status, printed, error) = said(here, &line);
            assert_eq!((status, printed), (0, format!("{what}.{ending}\n")), "{line}: {error}");
            let bytes = std::fs::read(here.join(format!("{what}.{ending}"))).unwrap();
            assert!(bytes.starts_with(magic) && bytes.len() > 2000, "{line}");
            assert_eq!(said(here, &line).0, 3, "{line}: what is there is kept");
        }
    }
    let read = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
    let raster = read("raster.svg");
    assert!(raster.contains("@font-face") && !raster.contains("src:url(http") && raster.contains("m, sample 0"));
    for population in ["in", "hidden", "out"] {
        assert!(raster.contains(&format!(">{population}</text>")), "{population}");
    }
    assert!(read("voltage.svg").contains(">out[1]</text>") && read("map.svg").contains(">hidden"));
}

#[test]
fn the_weights_of_a_rule_are_drawn() {
    let folder = folder();
    let here = folder.path();
    let rule = |name: &str| format!("name: \"{name}\", learning: Rule(dw: \"x0\"), weights: Uniform(low: 10, high: 60");
    let text = MODEL.replacen("weights: Uniform(low: 10, high: 60", &rule("a"), 1);
    let two = "from: [\"hidden\"], to: \"out\", weights: Uniform(low: 10, high: 60";
    let text = text.replace(two, &two.replace("weights: Uniform(low: 10, high: 60", &rule("b")));
    std::fs::write(here.join("learns.ron"), text).unwrap();
    let drawn = |probe: &str| said(here, &format!("plot weights learns.ron --input {INPUT} {probe} -o -"));
    let (status, svg, _) = drawn("--samples 0..1");
    assert!(status == 0 && svg.contains("m, sample 0: weights of a") && svg.contains("step 40: "), "{svg}");
    // One matrix before and one after, of 4 sources and 5 targets; each weight grows.
    let cells = |svg: &str, rows: usize| {
        svg.matches(&format!(r##"height="{:.2}" fill="#0072b2""##, 264.0 / rows as f64)).count()
    };
    assert_eq!(cells(&svg, 5), 2 * 20);
    let (status, svg, _) = drawn("--probe b");
    assert!(status == 0 && svg.contains("weights of b") && cells(&svg, 2) == 2 * 10, "{svg}");
    let (status, _, error) = drawn("--probe c");
    assert!(status == 2 && error.contains("there are: a, b"), "{error}");
    let (status, _, error) = said(here, &format!("plot weights m.ron --input {INPUT} -o -"));
    assert!(status == 2 && error.contains("there are: none"), "{error}");
}

#[test]
fn probes_choose_what_is_drawn() {
    let folder = folder();
    let here = folder.path();
    let line = format!("plot raster m.ron --input {INPUT} --samples 2..3 --probe h* -o r.svg");
    assert_eq!(said(here, &line).0, 0);
    let raster = std::fs::read_to_string(here.join("r.svg")).unwrap();
    assert!(raster.contains(">hidden</text>") && !raster.contains(">in</text>") && raster.contains("sample 2"));
    let line = format!("plot voltage m.ron --input {INPUT} --probe hidden[4] --probe out -o -");
    let (status, svg, _) = said(here, &line);
    assert_eq!((status, svg.matches("<polyline").count()), (0, 3), "{svg}");
    assert!(svg.contains(">hidden[4]</text>"));
    let line = format!("plot messages m.ron --input {INPUT} --probe hidden[4] --probe out -o -");
    let (status, svg, _) = said(here, &line);
    assert!(status == 0 && svg.matches("<polyline").count() == 3, "{svg}");
    // A spike without a payload counts as 1.
    assert!(svg.contains(">hidden[4]: 1</text>"), "{svg}");
    for (wrong, why) in [
        ("voltage m.ron --probe hidden[5] -o a.svg", "compartments 0 to 4"),
        ("voltage m.ron --probe in -o a.svg", "there are hidden, out"),
        ("raster m.ron --probe hidden[0] -o a.svg", "whole populations"),
        ("energy m.ron --probe hidden -o a.svg", "raster, voltage, messages and weights"),
        ("raster m.ron -o a.gif", "name the picture .svg"),
        ("pareto m.ron -o a.svg", "nsim bench pareto m.ron --format json"),
        ("raster m.ron -o a.svg --format json", "does not support --format"),
    ] {
        let (status, printed, error) = said(here, &format!("plot {wrong} --input {INPUT}"));
        assert!(status == 2 && (printed + &error).contains(why), "{wrong}: {error}");
    }
    assert!(!here.join("a.svg").exists());
}

#[test]
fn saved_results_are_drawn_as_the_commands_draw_them() {
    let folder = folder();
    let here = folder.path();
    let save = |line: &str, name: &str| {
        let printed = succeeds(here, line);
        std::fs::write(here.join(name), printed).unwrap();
    };
    save(&format!("energy m.ron --baseline --input {INPUT} --plot own.svg --format json"), "e.json");
    save("map m.ron --time-budget 0 --pareto front.svg --format json", "m.json");
    save(&format!("agree m.ron --input {INPUT} --plot-causes causes.svg --format json"), "a.json");
    for (what, json, own) in
        [("hardware", "e.json", "own.svg"), ("pareto", "m.json", "front.svg"), ("agreement", "a.json", "causes.svg")]
    {
        succeeds(here, &format!("plot {what} {json} -o again-{own}"));
        let read = |name: &str| std::fs::read_to_string(here.join(name)).unwrap();
        assert!(read(own) == read(&format!("again-{own}")), "{what}");
    }
    assert_eq!(said(here, "plot time e.json -o t.svg").0, 0);
    assert_eq!(said(here, "plot energy e.json -o e.svg").0, 0);
    let (status, _, error) = said(here, "plot agreement e.json -o x.svg");
    assert!(status == 3 && error.contains("nsim agree"), "{error}");
    let (status, _, error) = said(here, "plot raster e.json -o x.svg");
    assert!(status == 2 && error.contains("runs a model"), "{error}");
}
