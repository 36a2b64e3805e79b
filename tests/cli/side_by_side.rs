//! `nsim agree` with several model files: one table of the trained network, its conversion and its
//! fine-tuned conversion.

use serde_json::Value;

use crate::common::command::{object, said};

#[test]
fn converted_and_fine_tuned_stand_beside_the_trained_network() {
    let folder = tempfile::tempdir().unwrap();
    let here = folder.path();
    let input = "scene:slip?samples=4&seed=9";
    let few = ["--calibration-samples", "4", "--delayed-copies", "2", "--input", input];
    let plain = object(here, &[&["convert", "vtsnn-slip-srm", "-o", "converted.ron"][..], &few].concat(), 0);
    assert_eq!(plain["fine_tune"], Value::Null);
    let train = ["--fine-tune", "1", "--train", "scene:slip?samples=8&seed=1"];
    let tuned = object(here, &[&["convert", "vtsnn-slip-srm", "-o", "tuned.ron"][..], &train, &few].concat(), 0);
    let tuning = &tuned["fine_tune"];
    assert_eq!((tuning["epochs"].as_u64(), tuning["samples"].as_u64()), (Some(1), Some(8)));
    assert_eq!(tuning["rows"].as_array().unwrap().len(), 2);
    assert_eq!(tuning["held_out"]["samples"], 4);
    let text = std::fs::read_to_string(here.join("tuned.ron")).unwrap();
    assert!(text.contains("fine-tuned for 1 epoch with seed 1 on 8 training samples"), "{text}");

    let both = ["agree", "vtsnn-slip-srm", "--against", "converted.ron", "--against", "tuned.ron", "--input", input];
    let agreed = object(here, &both, 0);
    assert_eq!((agreed["networks"].as_array().unwrap().len(), agreed["layers"].as_array().unwrap().len()), (2, 6));
    // Each row equals the result of the file alone.
    for (place, file) in ["converted.ron", "tuned.ron"].iter().enumerate() {
        let alone = format!("agree vtsnn-slip-srm --against {file} --input {input} --attribution off");
        let alone = object(here, &alone, 0);
        assert_eq!(agreed["networks"][place]["accuracy_b"], alone["accuracy_b"]);
        for layer in 0..3 {
            assert_eq!(agreed["layers"][3 * place + layer]["coincidence"], alone["layers"][layer]["coincidence"]);
        }
    }
    let (status, table, _) = said(here, &[&both[..], &["--format", "csv"]].concat());
    assert_eq!((status, table.lines().count()), (0, 1 + 3 + 6));
    assert!(table.lines().nth(1).unwrap().starts_with("as trained,"), "{table}");
    assert_eq!(said(here, &[&both[..], &["--require-class-agreement", "1.0", "--require-exact"]].concat()).0, 1);
    assert_eq!(said(here, &[&both[..], &["--plot", "p.svg"]].concat()).0, 2);
    assert_eq!(said(here, &[&both[..], &["--against", "out=spikes.npy"]].concat()).0, 2);
}
