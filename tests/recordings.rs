//! Recordings and arrays that other programs wrote, read as what their descriptions say they hold.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

mod common;

use nsim::desc::tensor::Numbers;
use nsim::io::npy;
use nsim::io::spikes::{PopulationSpikes, list_folder, read_source};

fn spikes(samples: &[PopulationSpikes]) -> usize {
    samples.iter().map(|sample| sample.events.len()).sum()
}

#[test]
fn three_hundred_container_recordings() {
    let Some(data) = common::data("ev-containers") else { return };
    let mut all = Vec::new();
    for (folder, count, each) in [("train", 240, 12), ("test", 60, 3)] {
        let samples = read_source(&data.join(folder), 78).unwrap();
        assert_eq!(samples.len(), count);
        assert!(samples.iter().all(|sample| sample.steps == 325 && sample.units == Some(78)));
        for class in 0..20 {
            assert_eq!(samples.iter().filter(|sample| sample.label == Some(class)).count(), each, "class {class}");
        }
        all.extend(samples);
    }
    // The description's figures: 2,564 spikes a sample, 1,098 to 5,683, mean density 0.101.
    let counts: Vec<usize> = all.iter().map(|sample| sample.events.len()).collect();
    assert_eq!((counts.iter().min(), counts.iter().max()), (Some(&1098), Some(&5683)));
    assert_eq!(spikes(&all) / 300, 2564);
    let density = spikes(&all) as f64 / (300.0 * 78.0 * 325.0);
    assert!((density - 0.101).abs() < 5e-4, "{density}");
    // In order of the numbers, not of the names: sample 2 comes before sample 10.
    let listed = list_folder(&data.join("test")).unwrap();
    assert_eq!(listed.iter().map(|entry| entry.0).collect::<Vec<_>>(), (0..60).collect::<Vec<_>>());
    let error = read_source(&data, 78).unwrap_err();
    assert!(error.help.unwrap().contains("test, train"));
}

#[test]
fn one_recording_and_ten() {
    let (Some(silicon), Some(random)) = (common::data("silicon"), common::data("vtsnn-random")) else { return };
    let one = read_source(&silicon.join("input.npy"), 250).unwrap();
    assert_eq!((one.len(), one[0].steps), (1, 500));
    let hidden = read_source(&silicon.join("hidden_spikes.npy"), 25).unwrap();
    assert_eq!(hidden[0].events.iter().filter(|event| event.0 <= 498).count(), 639);
    let ten = read_source(&random.join("tactile.npy"), 156).unwrap();
    assert_eq!((ten.len(), ten[9].steps), (10, 150));
    let vision = read_source(&random.join("vision.npy"), 3150).unwrap();
    let rate = spikes(&vision) as f64 / (10.0 * 3150.0 * 150.0);
    assert!((rate - 0.01).abs() < 2e-4, "{rate}");
    // The array of counts was made from the array of spikes by another program.
    let counts = npy::read(&random.join("output_counts.npy")).unwrap();
    let output = read_source(&random.join("output_spikes.npy"), 2).unwrap();
    let mut own = Vec::new();
    for sample in &output {
        own.extend((0..2).map(|unit| sample.events.iter().filter(|event| event.1 == unit).count() as i32));
    }
    assert_eq!(counts.numbers(), &Numbers::Integers(own));
    let error = read_source(&random.join("tactile.npy"), 155).unwrap_err();
    assert!(error.message.contains("10 samples 156 in each"), "{error}");
}
