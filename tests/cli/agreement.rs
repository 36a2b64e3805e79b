//! `nsim agree`.

use crate::{MODEL, SRM, has_keys, nsim, object, said, succeeds, write};

#[test]
fn agreement_says_what_each_layer_loses_and_draws_where_spikes_part() {
    let folder = tempfile::tempdir().unwrap();
    let picture = folder.path().join("first.svg");
    let model = write(folder.path(), "srm.ron", SRM);
    let input = ["--input", "scene:noise?samples=4&rate=0.2", "--seed", "3", "--plot", picture.to_str().unwrap()];
    let agree = object(&[&["agree", &model][..], &input].concat(), 0);
    let layers: Vec<&str> = agree["lost"].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap()).collect();
    assert_eq!(layers, ["hidden", "out"]);
    for row in agree["lost"].as_array().unwrap() {
        let added: f64 = row["causes"].as_object().unwrap().values().map(|added| added.as_f64().unwrap()).sum();
        assert!((added - row["disagreement"].as_f64().unwrap()).abs() < 1e-4, "causes add up: {row}");
    }
    let svg = std::fs::read_to_string(&picture).unwrap();
    assert!(svg.contains("first difference in step") && svg.matches("<polyline").count() == 3, "{svg}");
    let (_, text, _) = said(&["agree", &model, "--input", "scene:noise?samples=4&rate=0.2", "--seed", "3"]);
    assert!(text.contains("'hidden' loses "), "{text}");
}

#[test]
fn a_spike_response_model_runs_in_real_numbers_and_agrees_or_not() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "srm.ron", SRM);
    let scene = "scene:noise?samples=6&rate=0.1";
    let run =
        object(&["run", &model, "--input", scene, "--probe", "hidden.u", "-o", folder.path().to_str().unwrap()], 0);
    assert_eq!((&run["engine"], &run["samples"]), (&"reference".into(), &6.into()));
    let bytes = std::fs::read(folder.path().join("hidden.u.npy")).unwrap();
    assert!(String::from_utf8_lossy(&bytes[..80]).contains("<f8"));
    let (code, _, stderr) = said(&["run", &model, "--input", scene, "--engine", "fast"]);
    assert!(code == 0 && stderr.contains("equal decays") && stderr.contains("nsim convert"), "{stderr}");
    assert_eq!(said(&["run", &model, "--input", scene, "--engine", "reference", "--prune", "static"]).0, 2);

    let agree = object(&["agree", &model, "--input", scene, "--calibration-samples", "8"], 0);
    assert_eq!((&agree["schema"], &agree["samples"]), (&"nsim.agree/1".into(), &6.into()));
    has_keys(&agree, &["class_agreement", "layers", "attribution", "conversion"]);
    let keys =
        ["name", "shift", "spikes_a", "spikes_b", "coincidence", "van_rossum", "victor_purpura", "potential_rmse"];
    has_keys(&agree["layers"][0], &keys);
    has_keys(&agree["layers"][0]["first_divergence"], &["sample", "timestep", "neuron", "a", "b"]);
    assert!(agree["attribution"].as_array().unwrap().len() >= 5);
    has_keys(&agree["attribution"][0], &["cause", "class_agreement", "coincidence", "potential_rmse", "share"]);
    let search = &agree["conversion"]["search"];
    assert!(search["residual"]["count_error"].as_f64() <= search["start"]["count_error"].as_f64(), "{search}");
    let analytic = ["agree", &model, "--input", scene, "--conversion", "analytic"];
    object(&[&analytic[..], &["--require-exact"]].concat(), 1);
    object(&[&analytic[..], &["--against", "golden", "--require-exact"]].concat(), 0);
    assert_eq!(said(&[&analytic[..], &["--require-class-agreement", "1.5"]].concat()).0, 2);
    assert_eq!(said(&["agree", "vtsnn-slip", "--against", "srm"]).0, 2);
    let one_thread = object(&[&analytic[..], &["--threads", "1"]].concat(), 0);
    assert_eq!(one_thread, object(&[&analytic[..], &["--threads", "2"]].concat(), 0));
}

#[test]
fn neurons_that_subtract_are_compared_on_a_target_that_has_them() {
    let folder = tempfile::tempdir().unwrap();
    let subtracting = MODEL.replace("Loihi(", "SoftReset(");
    let model = write(folder.path(), "soft.ron", &subtracting);
    let scene = ["--input", "scene:noise?samples=3&steps=20&rate=0.4"];
    let agree = object(&[&["agree", &model][..], &scene].concat(), 0);
    assert_eq!(agree["target"], "oheo-gulch");
    let (code, _, stderr) = said(&[&["map", &model][..], &[]].concat());
    assert!(code == 3 && stderr.contains("--target oheo-gulch") && stderr.contains("nsim convert"), "{stderr}");
    // A named target is used unchanged.
    assert_eq!(said(&[&["agree", &model, "--target", "nahuku-32"][..], &scene].concat()).0, 3);
}

#[test]
fn a_conversion_is_not_taken_for_the_trained_network() {
    let folder = tempfile::tempdir().unwrap();
    let trained = write(folder.path(), "srm.ron", SRM);
    let converted = folder.path().join("c.ron").display().to_string();
    let scene = ["--input", "scene:noise?samples=4&steps=20&rate=0.3"];
    let text = succeeds(&[&["convert", &trained, "-o", &converted][..], &scene].concat());
    // The result on held-out samples comes first.
    assert!(text.find("held-out").unwrap() < text.find("stage").unwrap(), "{text}");
    let (_, text, _) = said(&[&["agree", &converted][..], &scene].concat());
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(text.contains("(a: the conversion, real numbers)"), "{text}");
    assert!(text.contains(&format!("nsim agree {trained} --against {converted}")), "{text}");
    let agree = object(&[&["agree", &converted][..], &scene].concat(), 0);
    assert_eq!(agree["converted_from"], trained.as_str());
    let first = folder.path().join("first.svg").display().to_string();
    let line = [&["agree", &trained, "--against", &converted, "--plot", &first][..], &scene].concat();
    let (_, text, _) = said(&line);
    assert!(std::path::Path::new(&first).exists() == text.contains("written: "), "{text}");
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    for said in
        [", the trained network (a) and ", ", the converted network as deployed on simulated cores of nahuku-32 (b)"]
    {
        assert!(text.contains(said), "{text}");
    }
}

#[test]
fn nothing_is_compared_in_vain() {
    for wrong in [&["--steps", "0"][..], &["--against", "golden", "--svg", "causes.svg"]] {
        let folder = tempfile::tempdir().unwrap();
        let mut command = nsim(&[&["agree", "--samples", "0..1"], wrong].concat());
        assert_eq!(command.current_dir(&folder).output().unwrap().status.code(), Some(2), "{wrong:?}");
        assert!(std::fs::read_dir(&folder).unwrap().next().is_none());
    }
}
