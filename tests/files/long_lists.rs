//! A long list in a model file costs a small multiple of its text.

use crate::memory;
use nsim::import::model::load_model;

fn check(test: &str, row: &str, most: u64) {
    memory::alone(module_path!(), test, |growth| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("long.ron");
        let rows = row.repeat((8 << 20) / row.len());
        let text = format!(
            "Network(name: \"x\", timestep_ms: 1, populations: [], output: \"x\",\n\
             projections: [Dense(from: [], to: \"x\", weights: [{rows}])])"
        );
        let length = text.len() as u64;
        std::fs::write(&path, text).unwrap();
        let begin = std::time::Instant::now();
        load_model(path.to_str().unwrap()).unwrap();
        println!("{:.3} s for {length} bytes of text", begin.elapsed().as_secs_f64());
        assert!(growth.kib().is_none_or(|grown| grown * 1024 < most * length), "the bound is {most} times the text");
    });
}

#[test]
fn rows_of_one_number_cost_a_small_multiple_of_their_text() {
    check("rows_of_one_number_cost_a_small_multiple_of_their_text", "[1],", 16);
}

#[test]
fn plain_numbers_cost_a_small_multiple_of_their_text() {
    check("plain_numbers_cost_a_small_multiple_of_their_text", "1,", 24);
}
