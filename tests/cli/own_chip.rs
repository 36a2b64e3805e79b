//! A chip other than Loihi: its limits, its constants, absent values, and impossible ones.

use serde_json::Value;

use crate::{object, said, succeeds, write};

const CHIP: &str = "Chip(name: \"tern\", notes: \"\", width: 4, height: 4, cores_per_tile: 1, cores: 16, x86_cores: 0,
  x86_cores_in_use: 0, limits: (compartments: 256, axons_in: 1024, axons_out: 1024, axon_out_slots: 1,
    axon_out_slots_off_chip: 1, synapses_per_entry: 64, packing: Nengo,
    unlimited: [axons_out_per_compartment, synapse_words, synapse_words_per_axon, synapse_formats,
      compartment_profiles, threshold_profiles, accumulators],
    pools: [(name: \"memory\", unit: \"bytes\", limit: 65536,
      costs: { stored_synapses: 1, axons_in: 4, compartments: 16 })]))";

/// The constants that every preset must have, and a spike's energy.
fn constants() -> String {
    let units = [
        (
            "pJ",
            "synapse_dense_energy synapse_sparse_energy compartment_energy compartment_active_energy hop_ew_energy \
             hop_ns_energy spike_energy",
        ),
        (
            "ns",
            "synapse_dense_time synapse_sparse_time compartment_time compartment_active_time hop_ew_time hop_ns_time \
             link_time link_chip_time",
        ),
        ("messages", "link_buffer"),
        ("mW", "core_static_power"),
    ];
    let one = |name: &str, unit: &str| format!("{name}: (value: 2, unit: {unit}, source: \"me\", status: assumed)");
    let all = units.iter().flat_map(|(unit, names)| names.split(' ').map(|name| one(name, unit)));
    let barrier = "barrier: [(tiles: 1, time: (value: 0.1, unit: us, source: \"me\", status: assumed))]";
    let all: Vec<String> = all.collect();
    format!("Constants(name: \"synth\", notes: \"\", hardware: \"tern\", {barrier}, {})", all.join(", "))
}

/// A folder with the chip, its constants and a board of one, and the board's path.
fn board() -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    write(folder.path(), "tern.ron", CHIP);
    write(folder.path(), "synth.ron", &constants());
    let board = "Target(name: \"board\", notes: \"\", chip: \"tern\", chips_x: 1, chips_y: 1, constants: [\"synth\"])";
    let board = write(folder.path(), "board.ron", board);
    (folder, board)
}

const PRICED: [&str; 5] = ["energy", "slip-tactile", "--samples", "0..1", "--baseline"];

/// Notes of a priced run on its constants.
fn notes(more: &[&str]) -> String {
    let energy = object(&[&PRICED[..], more].concat(), 0);
    let notes = energy["notes"].as_array().unwrap().iter().map(|note| note.as_str().unwrap().to_string());
    notes.collect::<Vec<_>>().join("\n")
}

#[test]
fn constants_that_are_not_given_are_no_assumptions_and_are_named_where_they_would_count() {
    let (folder, board) = board();
    let synth = folder.path().join("synth.ron").display().to_string();
    let found = object(&["inspect", &synth], 0);
    let entry = |name: &str| {
        let all = found["constants"].as_array().unwrap();
        all.iter().find(|one| one["name"] == name).unwrap_or_else(|| panic!("{name}")).clone()
    };
    assert_eq!((&entry("turn_time")["status"], &entry("turn_time")["from"]), (&"not given".into(), &Value::Null));
    assert_eq!((&entry("spike_energy")["status"], &entry("spike_energy")["from"]), (&"assumed".into(), &"here".into()));
    for (more, named, unnamed) in [
        (&["--target", &board][..], "dendrite_energy", "turn_time"),
        (&["--target", &board, "--accounting", "rails"], "chip_boot_power", "turn_time"),
        (&["--target", "loihi1-chip", "--constants", &synth], "injection_time, turn_time", "chip_boot_power"),
        (&["--target", "loihi1-chip", "--constants", &synth, "--host", "none"], "dendrite_energy", "injection_time"),
    ] {
        let notes = notes(more);
        let line = notes.lines().find(|line| line.starts_with("Not given in synth, counted as 0: ")).unwrap();
        assert!(line.contains(named) && !line.contains(unnamed), "{more:?}: {line}");
    }
    let (_, full, _) = said(&[&PRICED[..], &["--target", &board, "--full"]].concat());
    assert!(full.contains("18 assumed") && full.contains("22 not given"), "{full}");
}

/// Leakage of a chip is in the static power of both accountings, in every command that prices.
#[test]
fn leakage_is_a_chip_s_and_counts_in_both_accountings() {
    let (folder, board) = board();
    let leaky = constants().replace("core_static_power: (value: 2,", "core_static_power: (value: 0,");
    let given = "chip_static_power: (value: 5, unit: mW, source: \"me\", status: assumed))";
    let leaky = format!("{}, {given}", leaky.strip_suffix(')').unwrap());
    let leaky = write(folder.path(), "leaky.ron", &leaky.replace("\"synth\"", "\"leaky\""));
    let sweep = format!(
        "Sweep(model: \"slip-tactile\", target: {board:?}, samples: \"0..1\", set: {{\"options.constants\": {leaky:?}}},
         grid: [(paths: [\"options.accounting\"], values: [\"profiler\", \"rails\"])])"
    );
    let sweep = write(folder.path(), "s.ron", &sweep);
    let (_, table, error) = said(&["sweep", &sweep]);
    for (place, accounting) in ["profiler", "rails"].into_iter().enumerate() {
        let more = ["--target", &board, "--constants", &leaky, "--accounting", accounting];
        let energy = object(&[&PRICED[..], &more].concat(), 0);
        let total = energy["rows"].as_array().unwrap().iter().find(|row| row["unit"] == "total").unwrap();
        assert_eq!(total["static_mw"], 5.0, "{accounting}: {total}");
        assert!(!energy["notes"].to_string().contains("chip_static_power"), "{energy}");
        let row = table.lines().nth(1 + place).unwrap_or_else(|| panic!("{error}"));
        assert!(row.contains(&format!(",{},", total["energy_uj"])), "{accounting}: {row}");
    }
    // Without either constant leakage is absent, which a note states.
    let none = constants().replace("core_static_power: (value: 2,", "core_static_power: (value: 0,");
    let none = write(folder.path(), "none.ron", &none);
    assert!(notes(&["--target", &board, "--constants", &none]).contains("chip_static_power"));
}

/// Constants of a preset that this chip cannot use, and constants of other hardware.
#[test]
fn constants_of_a_preset_that_are_not_charged_or_borrowed_are_named() {
    let (folder, board) = board();
    let given = "injection_time: (value: 0.05, unit: us, source: \"me\", status: assumed))";
    let fed = format!("{}, {given}", constants().strip_suffix(')').unwrap());
    let mix =
        "Constants(base: \"loihi1-evidence\", hardware: \"tern\", spike_energy: (value: 4, unit: pJ, source: \"me\",
        status: assumed))";
    for (text, wanted) in [
        (fed.as_str(), "injection_time is not counted: tern has no x86 core."),
        (mix, " constants are from loihi1-evidence; energy of events: "),
    ] {
        let preset = write(folder.path(), "preset.ron", text);
        let notes = notes(&["--target", &board, "--constants", &preset]);
        assert!(notes.contains(wanted), "{wanted}: {notes}");
        for named in
            ["synapse_dense_energy 35.5 pJ", "; time of a step: barrier ", "; power: core_static_power 0.6026 mW"]
        {
            assert_eq!(notes.contains(named), text == mix, "{named}: {notes}");
        }
    }
}

#[test]
fn a_constant_that_is_set_in_vain_is_said() {
    let (_folder, board) = board();
    let set = ["--set", "constants.injection_time=1us", "--set", "constants.spike_energy=5"];
    let said = notes(&[&["--target", &board][..], &set].concat());
    assert!(said.contains("Without effect: injection_time. This run has no cost of this kind, and tern"), "{said}");
    assert!(!said.contains("injection_time, spike_energy"), "{said}");
    assert!(!notes(&[&["--target", "loihi1-chip"][..], &set].concat()).contains("Without effect"));
    let message = object(&["energy", "--set", "constants.spike_energy=-3"], 3);
    assert!(message["message"].as_str().unwrap().contains("spike_energy=-3: outside 0 to 1e9"), "{message}");
    let reset = [&PRICED[..], &["--target", &board, "--reset-words", "1000"]].concat();
    assert!(crate::said(&reset).2.contains("--reset-words needs an x86 core"), "{reset:?}");
}

#[test]
fn intervals_are_of_the_hardware_that_was_measured() {
    let (folder, board) = board();
    let value = "(value: 4, unit: pJ, source: \"me\", status: assumed)";
    let mix = format!("Constants(base: \"loihi1-evidence\", hardware: \"tern\", synapse_dense_energy: {value})");
    let mix = write(folder.path(), "mix.ron", &mix);
    let half = "Target(base: \"nahuku-32\", limits: (synapse_words: 8192))";
    let half = write(folder.path(), "half.ron", half);
    for (more, hardware, whose) in [
        (&["slip-tactile", "--target", &board, "--constants", &mix][..], "tern", "the errors of preset mix"),
        (&["--target", &half], "half", ""),
        (&["--set", "target.limits.synapse_words=8192"], "loihi, changed", ""),
        (&["--set", "target.cores_per_tile=2"], "loihi, changed", "the constants' errors on loihi, changed"),
        (&["--set", "target.chips_x=4"], "loihi", ""),
    ] {
        let energy = object(&[&["energy"], more, &["--samples", "0..1", "--baseline"]].concat(), 0);
        let rows = energy["rows"].as_array().unwrap();
        assert!(rows.iter().all(|row| row["hardware"] == hardware), "{more:?}: {rows:?}");
        let none = energy["high"].as_object().unwrap().values().all(Value::is_null);
        assert_eq!(none, !whose.is_empty(), "{more:?}");
        assert!(energy["notes"].to_string().contains(whose), "{more:?}: {}", energy["notes"]);
        let paper = [&["energy", "--deployment", "paper"], more].concat();
        assert_eq!(said(&paper).0, 2, "{more:?}");
    }
}

#[test]
fn a_constant_in_another_unit_is_refused_with_its_value_in_the_right_one() {
    let folder = tempfile::tempdir().unwrap();
    let text =
        "Constants(base: \"loihi1-evidence\", injection_time: (value: 50, unit: ns, source: \"me\", status: assumed))";
    let preset = write(folder.path(), "preset.ron", text);
    let refused = object(&["inspect", &preset], 3);
    assert_eq!(refused["help"], "write value: 0.05, unit: us", "{refused}");
}

/// More cores in tiles without a stated size make larger tiles, which a note states.
#[test]
fn more_cores_make_larger_tiles_and_say_so() {
    let (_folder, board) = board();
    let (code, _, stderr) = said(&["map", "slip-tactile", "--target", &board, "--set", "target.cores_per_chip=17"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(stderr.contains("17 cores make tiles of 2") && stderr.contains("cores_per_tile"), "{stderr}");
}

/// Impossible values are refused in a chip file as in a target.
#[test]
fn impossible_chips_are_refused_with_the_field_to_set() {
    let (folder, board) = board();
    let files = std::cell::Cell::new(0);
    let of = |text: &str| {
        files.set(files.get() + 1);
        write(folder.path(), &format!("wrong{}.ron", files.get()), text)
    };
    let map = |set: &str| ["map", "slip-tactile", "--target", &board, "--set", set].map(str::to_string).to_vec();
    let inspect = |from: &str, to: &str| vec!["inspect".to_string(), of(&CHIP.replace(from, to))];
    let base = |fields: &str| vec!["inspect".to_string(), of(&format!("Target(base: \"board\", {fields})"))];
    for (line, says) in [
        (base("cores_per_chip: 17, cores_per_tile: 1"), "cores 17 is outside 1..=16: 4 x 4 tiles of 1 have 16 places"),
        (base("cores_per_chip: 100, width: 2"), "cores 100 is outside 1..=8"),
        (inspect("cores: 16", "cores: 17"), "cores 17 is outside 1..=16"),
        (inspect("cores: 16", "cores: 0"), "cores 0 is outside 1..=16"),
        (inspect("width: 4", "width: 400"), "width 400 is outside 1..=64"),
        (inspect("stored_synapses: 1, ", ""), "synapses have no limit"),
        (inspect("{ stored_synapses: 1,", "{ stored_synapses: 1, stored_synapses: 1,"), "has two costs"),
        (inspect("\"bytes\"", "\"KB\""), "write both in bytes or in bits"),
        (map("target.limits.memry=1"), "board has no limit memry"),
    ] {
        let words: Vec<&str> = line.iter().map(String::as_str).collect();
        let refused = object(&words, 3);
        let all = format!("{} {}", refused["message"], refused["help"]);
        assert!(all.contains(says), "{line:?}: {refused}");
    }
}

/// Memory of a core is set and swept by the pool's name; each core's use of it is listed.
#[test]
fn a_memory_is_set_and_swept_by_its_name() {
    let (folder, board) = board();
    let line = ["map", "slip-tactile", "--target", &board, "--format", "csv"];
    let use_of = |more: &[&str]| {
        let csv = succeeds(&[&line[..], more].concat());
        csv.lines().map(|row| row.split(',').map(str::to_string).collect::<Vec<_>>()).collect::<Vec<_>>()
    };
    let whole = use_of(&[]);
    assert_eq!(whole[0][9..], ["stored_synapses", "memory"]);
    let number = |cell: &String| cell.parse::<u64>().unwrap();
    for row in &whole[1..] {
        assert_eq!(number(&row[10]), number(&row[9]) + 4 * number(&row[5]) + 16 * number(&row[4]));
    }
    assert!(use_of(&["--set", "target.limits.memory=3000"]).len() > whole.len());
    let sweep = format!(
        "Sweep(model: \"slip-tactile\", target: {board:?}, samples: \"0..1\", grid: [(name: \"memory\", paths: \
         [\"target.limits.memory\"], values: [3000, 65536])])"
    );
    let sweep = write(folder.path(), "sweep.ron", &sweep);
    let out = folder.path().join("out.csv").display().to_string();
    succeeds(&["sweep", &sweep, "-o", &out]);
    let rows = std::fs::read_to_string(&out).unwrap();
    assert!(rows.lines().nth(1).unwrap().contains("3000") && rows.lines().count() == 3, "{rows}");
    let inspected = object(&["inspect", &board], 0)["limits"].to_string();
    let costs = "65536 bytes: axons_in * 4";
    assert!(inspected.contains("\"memory\"") && inspected.contains("stored_synapses * 1"), "{costs}: {inspected}");
}

/// A remedy that rounds all weights between two populations to 0 is not offered.
#[test]
fn fewer_weight_bits_are_no_remedy_where_all_weights_become_0_and_say_how_many_do() {
    let (folder, board) = board();
    let model = |(low, high): (i32, i32), weight: i32| {
        let text = format!(
            "Network(name: \"two\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [4]), Loihi(name: \
             \"a\", shape: [300], du: 4096, dv: 4096, vth_mant: 10), Loihi(name: \"b\", shape: [300], du: 4096, dv: \
             4096, vth_mant: 10)], projections: [Dense(from: [\"in\"], to: \"a\", weights: Uniform(low: {low}, \
             high: {high}, step: 2, seed: 1)), Dense(from: [\"a\"], to: \"b\", weights: Uniform(low: {weight}, high: 120, step: 2, \
             seed: 1))], output: \"b\")"
        );
        write(folder.path(), "two.ron", &text)
    };
    for (of_input, weight, memory, offered) in
        [((16, 16), 120, 4096, None), ((16, 16), 2, 4096, None), ((-120, 120), -120, 8192, Some("of 90486 become 0"))]
    {
        let set = format!("target.limits.memory={memory}");
        let refused = object(&["map", &model(of_input, weight), "--target", &board, "--set", &set], 1);
        let remedies = refused["remedies"].as_array().unwrap();
        let bits = remedies.iter().find(|one| one["kind"] == "weight_bits");
        assert_eq!(bits.is_some(), offered.is_some(), "{refused}");
        assert!(bits.is_none_or(|bits| bits["change"].as_str().unwrap().contains(offered.unwrap())), "{refused}");
    }
}

#[test]
fn a_comparison_says_which_rows_hold_a_host_and_what_was_set() {
    let (_folder, board) = board();
    let targets = format!("loihi1-chip,{board}");
    let line = ["compare", "slip-tactile", "--targets", &targets, "--samples", "0..1"];
    let words = |more: &[&str]| {
        let text = succeeds(&[&line[..], more].concat());
        text.split_whitespace().collect::<Vec<_>>().join(" ")
    };
    let host = " % of a step on loihi1-chip, none on board; --host none omits them";
    assert!(words(&[]).contains(host), "{}", words(&[]));
    let alone = words(&["--host", "none", "--set", "constants.spike_energy=1000pJ"]);
    assert!(!alone.contains("x86 cores for input"), "{alone}");
    assert!(alone.contains("--set changes every row: constants.spike_energy"), "{alone}");
}

/// Each message names the required text.
#[test]
fn messages_of_chips_and_constants_name_what_to_write() {
    let (folder, board) = board();
    let of = |name: &str, text: &str| write(folder.path(), name, text);
    let unit = of("unit.ron", &constants().replacen("value: 2, unit: pJ", "value: 2, unit: ns", 1));
    let stem = of(
        "stem.ron",
        "Target(name: \"x\", notes: \"\", chip: \"tern.ron\", chips_x: 1, chips_y: 1, constants: [\"synth\"])",
    );
    let field = of("field.ron", &constants().replacen("spike_energy", "spike_enrgy", 1));
    let missing =
        of("missing.ron", &CHIP.replace("synapses_per_entry: 64, packing: Nengo,", "").replace("synapse_formats,", ""));
    let kind = of(
        "izh.ron",
        "Network(name: \"own\", timestep_ms: 1.0, kinds: [Kind(name: \"Own\", state: [(name: \"v\", bits: 24, \
         overflow: Clip)], parameters: [], update: [\"v = v + in\"], spikes: \"v >= 95\", reset: [\"v = 0\"])], \
         populations: [Input(name: \"in\", shape: [2]), Own(name: \"cells\", shape: [2])], projections: \
         [Dense(from: [\"in\"], to: \"cells\", weights: [[2, 2], [2, 2]])], output: \"cells\")",
    );
    for (line, says) in [
        (&["inspect", &unit][..], "synapse_dense_energy needs unit pJ, but the file has ns"),
        (&["inspect", &stem], "write the name without .ron: \\\"tern\\\""),
        (&["inspect", &field], "`Constants` has no field `spike_enrgy`: did you mean 'spike_energy'?"),
        (&["inspect", &missing], "missing fields `synapse_formats`, `synapses_per_entry`, `packing`"),
        (&["map", &kind, "--target", &board], "add it to a chip of your own, as neuron_kinds: [Microcode]"),
    ] {
        let refused = object(line, 3);
        let all = format!("{} {}", refused["message"], refused["help"]);
        assert!(all.contains(says), "{line:?}: {refused}");
    }
    // With the kind the chip supports it, and the price names the omitted costs.
    write(folder.path(), "tern.ron", &CHIP.replace("limits: (", "neuron_kinds: [Loihi, Microcode], limits: ("));
    let noise = "scene:noise?samples=1&steps=5";
    let priced = object(&["energy", &kind, "--target", &board, "--input", noise, "--baseline"], 0);
    let notes = priced["notes"].to_string();
    assert!(notes.contains("An update of Own has 4 instructions and costs 4/12 of a visited compartment"), "{priced}");
    // 2 neurons of 2 pJ a visit, and of 2 pJ each if active; or as the kind states it.
    let text = std::fs::read_to_string(&kind).unwrap().replace("update:", "time: \"5ns\", energy: \"12pJ\", update:");
    let stated = write(folder.path(), "stated.ron", &text);
    let energy = |model: &str, more: &[&str]| {
        let line = ["energy", model, "--target", &board, "--input", noise, "--baseline"];
        let priced = object(&[&line[..], more].concat(), 0);
        let time = priced["time_us_per_timestep"]["slowest_core"].as_f64().unwrap();
        (priced["breakdown_pj_per_timestep"]["compartment"].as_f64().unwrap(), time, priced["notes"].to_string())
    };
    let (pj, us, notes) = energy(&stated, &[]);
    assert!((pj - 24.0).abs() < 1e-9 && notes.contains("costs 12 pJ and 5 ns, as the model states"), "{pj}: {notes}");
    assert!(us >= 0.01, "{us}");
    let doubled = energy(&kind, &["--set", "constants.compartment_energy=4pJ"]).0 - energy(&kind, &[]).0;
    assert!((doubled - 2.0 * 2.0 * 4.0 / 12.0).abs() < 1e-2, "{doubled}");
}
