//! What the independent forms may import: an interpreter or a checker that shares a rule with what it checks proves nothing.

// A test that cannot go on has failed.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// The code of a file of `src` without its tests and comments.
fn code(path: &str) -> String {
    let text = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(path)).unwrap();
    let text = text.split("#[cfg(test)]").next().unwrap().to_string();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// Every name that a file takes from the library, as `module::Name`, braces resolved.
fn imports(code: &str) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    for after in code.split("crate::").skip(1) {
        let path: String = after.chars().take_while(|c| c.is_alphanumeric() || "_:".contains(*c)).collect();
        let list = after[path.len()..].strip_prefix('{').and_then(|rest| rest.split_once('}'));
        match list {
            Some((list, _)) => {
                assert!(!list.contains('{'), "nested braces after crate::{path}");
                let listed = list.split(',').map(str::trim).filter(|name| !name.is_empty());
                names.extend(listed.map(|name| format!("{path}{name}")));
            }
            None => _ = names.insert(path),
        }
    }
    names
}

/// Types that hold data, the engine's interface, and `rng`, which defines random synapses.
const GOLDEN: [&str; 20] = [
    "base::fixed::Decay",
    "base::id::ChannelId",
    "base::id::CompartmentId",
    "base::id::Id",
    "base::id::IdVec",
    "base::rng",
    "desc::network::Semantics",
    "desc::network::ThresholdTest",
    "desc::neurons::NeuronKind",
    "ir::activity::Overflow",
    "ir::activity::Totals",
    "ir::graph::Window",
    "ir::quantised::Connectivity",
    "ir::quantised::Neuron",
    "ir::quantised::Projection",
    "ir::quantised::Quantised",
    "ir::quantised::Reset",
    "ir::quantised::SpikeSource",
    "ir::quantised::Units",
    "ir::spikes::Engine",
];

/// The methods of those types that read data or are named as those of containers; none computes what a network does.
const READERS: [&str; 13] = [
    "channels",
    "clear",
    "first_compartment",
    "get",
    "get_or_insert",
    "index",
    "iter",
    "iter_mut",
    "len",
    "parts",
    "populations",
    "projections",
    "enumerate",
];

/// Every method of the files that golden imports types from.
fn methods_of_the_data() -> BTreeSet<String> {
    let files = ["base/fixed.rs", "ir/activity.rs", "ir/graph.rs", "ir/quantised.rs", "desc/network.rs"];
    let mut methods = BTreeSet::new();
    for file in files {
        for after in code(file).split("fn ").skip(1) {
            let name: String = after.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
            let arguments = &after[name.len()..];
            if arguments.starts_with("(self") || arguments.starts_with("(&self") || arguments.starts_with("(&mut self")
            {
                methods.insert(name);
            }
        }
    }
    methods
}

#[test]
fn golden_imports_plain_data_only() {
    let code = code("golden.rs");
    let allowed: BTreeSet<String> = GOLDEN.map(str::to_string).into();
    let taken = imports(&code);
    let wrong: Vec<_> = taken.difference(&allowed).collect();
    assert!(wrong.is_empty(), "golden imports {wrong:?}");
    assert!(!code.contains("super::"), "golden has no neighbours");
    assert!(taken.contains("ir::quantised::Connectivity"), "the imports were not found: {taken:?}");
}

#[test]
fn golden_calls_no_rule_of_the_data() {
    let code = code("golden.rs");
    let called = |method: &&String| code.contains(&format!(".{method}(")) || code.contains(&format!("::{method}("));
    let methods = methods_of_the_data();
    assert!(methods.contains("falls_on") && methods.contains("for_each_from") && methods.contains("scaled"));
    let wrong: Vec<_> = methods.iter().filter(called).filter(|m| !READERS.contains(&m.as_str())).collect();
    assert!(wrong.is_empty(), "golden calls {wrong:?}");
}

#[test]
fn the_check_that_a_program_equals_its_network_imports_no_stage() {
    let stages = |path: &str| -> Vec<String> {
        imports(&code(path)).into_iter().filter(|name| name.starts_with("compile::")).collect()
    };
    assert_eq!(stages("compile/check/equivalence.rs"), [""; 0]);
    // The sampled form checks cores that the compiler writes for it, by the two checks.
    for import in stages("compile/check/sampled.rs") {
        let allowed = ["compile::check::", "compile::emit::sample::SampledCore"];
        assert!(allowed.iter().any(|prefix| import.starts_with(prefix)), "{import}");
    }
}
