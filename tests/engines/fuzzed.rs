//! The seeds of the fuzz targets of networks, kinds, rules and mapping files, and random bytes.

use std::path::Path;

use crate::common::{fuzzed, random};
use nsim::files::mapping::mapping_text;
use nsim::files::target::load_target;
use nsim::ir::base::rng;
use nsim::ir::placement::Mesh;
use nsim_testing::cases;
use rayon::prelude::*;

fn seeds(target: &str, check: fn(&[u8])) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus").join(target);
    let files: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    assert!(files.len() >= 3, "{target}");
    files.par_iter().for_each(|path| check(&std::fs::read(path).unwrap()));
}

#[test]
fn networks_of_seeds_and_of_random_bytes_hold_what_the_fuzzer_holds() {
    seeds("network", fuzzed::network);
    (0..cases(150)).into_par_iter().for_each(|seed| {
        let length = rng::below(3_000, seed, 0, 0);
        fuzzed::network(&(0..length).map(|at| rng::bits(seed, at, 1) as u8).collect::<Vec<_>>());
    });
}

#[test]
fn kinds_rules_and_mapping_files_of_seeds_hold_what_the_fuzzer_holds() {
    seeds("kind", fuzzed::kind);
    seeds("rule", fuzzed::rule);
    seeds("mapping", fuzzed::mapping);
    let mesh = Mesh::for_target(&load_target("loihi1-chip").unwrap());
    for seed in 0..20 {
        let file = random::mapping(&nsim_testing::random_network(3), &mesh, seed);
        fuzzed::mapping(mapping_text(&file).unwrap().as_bytes());
    }
}
