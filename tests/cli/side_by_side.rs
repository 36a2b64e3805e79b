//! `nsim agree` with several model files: one table of the trained network, its conversion and its
//! fine-tuned conversion.

use std::path::Path;

use assert_cmd::Command;
use serde_json::Value;

fn nsim(folder: &Path, args: &[&str]) -> (i32, String) {
    let output = Command::cargo_bin("nsim").unwrap().current_dir(folder).args(args).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stdout).unwrap())
}

fn object(folder: &Path, args: &[&str]) -> Value {
    let (status, text) = nsim(folder, args);
    assert_eq!(status, 0, "{args:?}");
    serde_json::from_str(&text).unwrap()
}

#[test]
fn converted_and_fine_tuned_stand_beside_the_trained_network() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let input = "scene:slip?samples=4&seed=9";
    let few = ["--calibration-samples", "4", "--delayed-copies", "2", "--format", "json", "--input", input];
    let plain = object(here, &[&["convert", "vtsnn-slip-srm", "-o", "converted.ron"][..], &few].concat());
    assert_eq!(plain["fine_tune"], Value::Null);
    let train = ["--fine-tune", "1", "--train", "scene:slip?samples=8&seed=1"];
    let tuned = object(here, &[&["convert", "vtsnn-slip-srm", "-o", "tuned.ron"][..], &train, &few].concat());
    let tuning = &tuned["fine_tune"];
    assert_eq!((tuning["epochs"].as_u64(), tuning["samples"].as_u64()), (Some(1), Some(8)));
    assert_eq!(tuning["rows"].as_array().unwrap().len(), 2);
    assert_eq!(tuning["held_out"]["samples"], 4);
    let text = std::fs::read_to_string(here.join("tuned.ron")).unwrap();
    assert!(text.contains("fine-tuned for 1 epoch with seed 1 on 8 training samples"), "{text}");

    let both = ["agree", "vtsnn-slip-srm", "--against", "converted.ron", "--against", "tuned.ron", "--input", input];
    let agreed = object(here, &[&both[..], &["--format", "json"]].concat());
    assert_eq!((agreed["networks"].as_array().unwrap().len(), agreed["layers"].as_array().unwrap().len()), (2, 6));
    // Each is what it is alone.
    for (place, file) in ["converted.ron", "tuned.ron"].iter().enumerate() {
        let alone = object(
            here,
            &[
                "agree",
                "vtsnn-slip-srm",
                "--against",
                file,
                "--input",
                input,
                "--attribution",
                "off",
                "--format",
                "json",
            ],
        );
        assert_eq!(agreed["networks"][place]["accuracy_b"], alone["accuracy_b"]);
        for layer in 0..3 {
            assert_eq!(agreed["layers"][3 * place + layer]["coincidence"], alone["layers"][layer]["coincidence"]);
        }
    }
    let (status, table) = nsim(here, &[&both[..], &["--format", "csv"]].concat());
    assert_eq!((status, table.lines().count()), (0, 1 + 3 + 6));
    assert!(table.lines().nth(1).unwrap().starts_with("as trained,"), "{table}");
    assert_eq!(nsim(here, &[&both[..], &["--require-class-agreement", "1.0", "--require-exact"]].concat()).0, 1);
    assert_eq!(nsim(here, &[&both[..], &["--plot", "p.svg"]].concat()).0, 2);
    assert_eq!(nsim(here, &[&both[..], &["--against", "out=spikes.npy"]].concat()).0, 2);
}
