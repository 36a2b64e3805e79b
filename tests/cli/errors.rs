//! An error names its place and the intended name or value.

use crate::{MODEL, has_keys, object, said, succeeds, write};
use nsim::cli::args::removed::REMOVED;

#[test]
fn a_slip_is_answered_with_what_was_meant() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "small.ron", MODEL);
    let single = write(folder.path(), "single.ron", &MODEL.replacen("shape: [3]", "shape: 3", 1));
    let unknown = write(folder.path(), "unknown.ron", &MODEL.replacen("from: [\"hidden\"]", "from: [\"hiden\"]", 1));
    let silence = |name: &str, shape: &[u64]| {
        let (path, count) = (folder.path().join(name), shape.iter().product::<u64>());
        nsim::files::npy::write(std::fs::File::create(&path).unwrap(), shape, (0..count).map(|_| 0u8)).unwrap();
        path.display().to_string()
    };
    let (first, samples) = (silence("first.npy", &[50, 3]), silence("samples.npy", &[2, 50, 3]));
    for (line, status, answer) in [
        (&["run", "vtsnn-slp"][..], 3, "did you mean 'vtsnn-slip'?"),
        (&["map", "--target", "nahuku32"], 3, "did you mean 'nahuku-32'?"),
        (&["map", "--target", "loihi2"], 3, "did you mean 'oheo-gulch'?"),
        (&["energy", &model, "--input", "scene:noise", "--constants", "davies2017"], 2, "did you mean 'davies2018'?"),
        (&["run", &unknown], 3, "did you mean 'hidden'?"),
        (&["run", &model, "--input", &format!("inn={first}")], 3, "did you mean 'in'?"),
        (&["run", &single], 3, "write [3]"),
        (&["run", &model, "--input", &first], 3, "time before channels"),
        (&["run", &model, "--input", &samples], 3, "time before channels"),
    ] {
        let (code, _, stderr) = said(line);
        assert!(code == status && stderr.contains(answer), "{line:?}: {code} {stderr}");
    }
}

#[test]
fn a_removed_name_is_answered_with_one_that_exists() {
    for (name, instead) in REMOVED {
        let words: Vec<&str> = name.split(' ').collect();
        // An option follows any command, unless its own command is named.
        let line = if words[0].starts_with('-') { [&["run"][..], &words].concat() } else { words };
        let (code, _, stderr) = said(&line);
        let says = format!("`{name}` was removed: {instead}");
        assert!(code == 2 && stderr.contains(&says), "{line:?}: {code} {stderr}");
        let commands = instead.split('`').skip(1).step_by(2).filter_map(|typed| typed.strip_prefix("nsim "));
        for typed in commands {
            let mut words = typed.split(' ');
            let is_name = |word: &&str| word.starts_with(|first: char| first.is_ascii_lowercase());
            let command: Vec<&str> = words.by_ref().take_while(is_name).collect();
            let help = succeeds(&[&command[..], &["--help"]].concat());
            for option in typed.split(' ').filter(|word| word.starts_with('-')) {
                assert!(help.contains(&format!("{option} ")), "{typed}: {option}");
            }
        }
    }
}

#[test]
fn independent_errors_of_a_file_are_told_together() {
    let folder = tempfile::tempdir().unwrap();
    let line = |du: u32, second: &str, to: &str, output: &str| {
        format!(
            "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]),
             Loihi(name: \"a\", shape: [4], du: {du}, dv: 5001, vth_mant: 130),
             Loihi(name: \"b\", shape: [{second}], du: 1024, dv: 256, vth_mant: 1300000)],
             projections: [Random(from: [\"in\"], to: \"{to}\", fan_out: 2, low: 0, high: 8, seed: 1),
             Random(from: [\"y\"], to: \"a\", fan_out: 2, low: 0, high: 8, seed: 1)], output: \"{output}\")"
        )
    };
    let codes_and_lines = |text: &str| {
        let model = write(folder.path(), "bad.ron", text);
        let error = object(&["map", &model], 3);
        let others = error["others"].as_array().unwrap();
        let (_, _, stderr) = said(&["map", &model]);
        assert_eq!(stderr.matches("error[").count(), 1 + others.len(), "{stderr}");
        std::iter::once(&error)
            .chain(others)
            .map(|one| (one["code"].to_string(), one["line"].to_string()))
            .collect::<Vec<_>>()
    };
    let told = |list: &[(&str, u32)]| -> Vec<(String, String)> {
        list.iter().map(|(code, line)| (format!("\"{code}\""), line.to_string())).collect()
    };
    // A population that cannot be read hides its references; unknown names hide wrong values.
    assert_eq!(codes_and_lines(&line(500, "0", "x", "zz")), told(&[("model.shape", 3)]));
    let unknown = "model.unknown-population";
    assert_eq!(codes_and_lines(&line(500, "2", "x", "zz")), told(&[(unknown, 4), (unknown, 5), (unknown, 5)]));
    let values = line(5000, "2", "a", "b").replace("[\"y\"]", "[\"b\"]");
    let range = "model.range";
    assert_eq!(codes_and_lines(&values), told(&[(range, 2), (range, 2), (range, 3)]));
}

#[test]
fn errors_have_a_status_a_place_and_an_object() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "bad.ron", &MODEL.replace("du: 1024", "du: 5000"));
    let error = object(&["map", &model], 3);
    assert_eq!((&error["schema"], &error["line"]), (&"nsim.error/1".into(), &2.into()));
    has_keys(&error, &["code", "message", "help"]);
    let (code, stdout, stderr) = said(&["map", &model]);
    assert_eq!((code, stdout.as_str()), (3, ""));
    assert!(stderr.contains("bad.ron:2") && stderr.contains("decay 5000"), "{stderr}");

    let usage = object(&["map", "--bogus"], 2);
    assert_eq!((&usage["schema"], &usage["code"]), (&"nsim.error/1".into(), &"usage".into()));
    assert!(usage["message"].as_str().unwrap().contains("--bogus"), "{usage}");
    assert_eq!(said(&["run", "--samples", "5..2"]).0, 2);
    assert_eq!(said(&["run", "--samples", "500000..500001"]).0, 2);
    assert_eq!(said(&["no-such-command"]).0, 2);
    assert_eq!(said(&["run", "--threads", "0"]).0, 2);
    assert_eq!(said(&["bench", "no-such-bench"]).0, 2);
    assert_eq!(said(&["bench", "step", "--network", "random-2m"]).0, 2);
    assert_eq!(said(&["map", "no-such-model"]).0, 3);
    assert_eq!(said(&["run", "--input", "scene:no-such-scene"]).0, 3);
    assert_eq!(said(&["run", "--input", "vision=absent.npy"]).0, 3);
}
