//! A long list in a model file costs a small multiple of its text. Alone in its binary, since a process has one peak.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

#[path = "common/memory.rs"]
mod memory;

use memory::peak_kib as peak;
use nsim::io::model::load_model;

#[test]
fn long_lists_cost_a_small_multiple_of_their_text() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("long.ron");
    let write = |rows: String| {
        let text = format!(
            "Network(name: \"x\", timestep_ms: 1, populations: [], output: \"x\",\n\
             projections: [Dense(from: [], to: \"x\", weights: [{rows}])])"
        );
        std::fs::write(&path, &text).unwrap();
        text.len() as u64
    };
    for (what, row, most) in [("rows of one", "[1],", 16), ("plain numbers", "1,", 24)] {
        write(row.repeat(10));
        load_model(path.to_str().unwrap()).unwrap();
        let before = peak();
        let length = write(row.repeat((8 << 20) / row.len()));
        let begin = std::time::Instant::now();
        load_model(path.to_str().unwrap()).unwrap();
        println!("{what}: {:.3} s", begin.elapsed().as_secs_f64());
        match (before, peak()) {
            (Some(before), Some(after)) => {
                let grown = (after - before) * 1024;
                println!("{what}: {grown} bytes for {length} of text");
                assert!(grown < most * length, "{what}: {grown} bytes for {length} of text");
            }
            _ => println!("skipped: no /proc/self/status"),
        }
    }
}
