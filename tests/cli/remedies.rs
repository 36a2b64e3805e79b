//! Remedies that change a model or its mapping. Each phrase of printed advice is applied, and the
//! refusal or warning disappears. A phrase that no test knows fails.

use std::fmt::Write;
use std::path::Path;

use serde_json::Value;

use crate::{object, said, write};

/// A model whose layout remedies change.
#[derive(Clone)]
struct Net {
    polarities: u32,
    side: u32,
    /// Compartments between the input and the demanding part, one for each channel.
    relayed: bool,
    units: u32,
    /// Projections from each source, and their delays, bits and exponents.
    delays: Vec<u32>,
    bits: u32,
    exponents: Vec<i32>,
    /// Number of intermediate populations, each with input from a part of the sources.
    parts: u32,
}

const NET: Net = Net {
    polarities: 2,
    side: 8,
    relayed: false,
    units: 2,
    delays: Vec::new(),
    bits: 8,
    exponents: Vec::new(),
    parts: 0,
};

impl Net {
    fn channels(&self) -> u32 {
        self.polarities * self.side * self.side
    }

    fn text(&self) -> String {
        let (polarities, side, channels, units) = (self.polarities, self.side, self.channels(), self.units);
        let mut populations = format!("Input(name: \"in\", shape: [{polarities}, {side}, {side}]), ");
        let mut projections = String::new();
        let mut add = |name: &str, units: u32| {
            let _ = write!(populations, "Loihi(name: {name:?}, shape: [{units}], du: 4096, dv: 1024, vth_mant: 100), ");
        };
        let bits = self.bits;
        let weights = "weights: Uniform(low: 16, high: 112, step: 16, seed: 1)";
        let mut list = Vec::new();
        let source = if self.relayed { "h" } else { "in" };
        if self.relayed {
            add("h", channels);
            let ones: Vec<String> = (0..channels).map(|c| format!("({c}, {c}, 64)")).collect();
            list.push(("in", "h".to_string(), format!("synapses: [{}]), ", ones.join(", ")), "Sparse"));
        }
        let delays = if self.delays.is_empty() { vec![0] } else { self.delays.clone() };
        let exponents = if self.exponents.is_empty() { vec![0] } else { self.exponents.clone() };
        let each = delays.iter().flat_map(|delay| exponents.iter().map(move |exponent| (delay, exponent)));
        for (delay, exponent) in each {
            let fields = format!("weight_bits: {bits}, weight_exp: {exponent}, delay: {delay}), ");
            if self.parts == 0 {
                list.push((source, "out".to_string(), format!("{weights}, {fields}"), "Dense"));
            }
            for part in 0..self.parts {
                let mine = (0..channels).filter(|c| c % self.parts == part);
                let synapses = mine.flat_map(|c| (0..units).map(move |unit| format!("({c}, {unit}, 64)")));
                let synapses = synapses.collect::<Vec<_>>().join(", ");
                list.push((source, format!("part{part}"), format!("synapses: [{synapses}], {fields}"), "Sparse"));
            }
        }
        for part in 0..self.parts {
            add(&format!("part{part}"), units);
        }
        add("out", units);
        for (from, to, rest, kind) in &list {
            let _ = write!(projections, "{kind}(from: [{from:?}], to: {to:?}, {rest}");
        }
        for part in 0..self.parts {
            let _ = write!(projections, "Dense(from: [\"part{part}\"], to: \"out\", {weights}), ");
        }
        format!(
            "Network(name: \"n\", timestep_ms: 1.0, populations: [{populations}], projections: [{projections}], \
             output: \"out\")"
        )
    }
}

/// The action of a phrase of advice: the changed model, and the words to type. `None` for a phrase
/// that explains.
fn done(phrase: &str, net: &Net, silent: &str) -> Option<(Net, Vec<String>)> {
    let model = |change: &dyn Fn(&mut Net)| {
        let mut net = net.clone();
        change(&mut net);
        Some((net, Vec::new()))
    };
    let typed = |value: &str| {
        let option =
            phrase.split_whitespace().map(|word| word.trim_matches(|c: char| !c.is_ascii_alphanumeric() && c != '-'));
        let option = option.into_iter().find(|word| word.starts_with("--")).unwrap();
        Some((
            net.clone(),
            [option, value].iter().filter(|word| !word.is_empty()).map(|word| (*word).to_string()).collect(),
        ))
    };
    match phrase {
        "merge polarities (halves the channels)" => model(&|net| net.polarities = 1),
        "prune inputs that never fire (--prune INPUT)" => typed(silent),
        "pool more before this population" => model(&|net| net.side /= 2),
        "split the fan-in over intermediate populations" => model(&|net| net.parts = 2),
        "use fewer synapses" | "use fewer of its synapses" => model(&|net| net.delays.truncate(net.delays.len() / 2)),
        "fewer weight bits" => model(&|net| net.bits = 4),
        "no delays" | "shorten the longest delay into this population" => model(&|net| net.delays.fill(0)),
        "let projections into this population share weight exponent" => model(&|net| net.exponents.fill(0)),
        "use less of the resources that draw on it (axons_in" => model(&|net| net.side /= 2),
        "reduce the fan-out" => model(&|net| net.units /= 4),
        "let `--relays` add compartments" => typed(""),
        _ => None,
    }
}

/// Phrases that explain, and phrases for more than one remedy.
const EXPLAIN: [&str; 13] = [
    "and cores",
    "that forward spikes",
    "every input channel that sends to a core takes one input axon there",
    "every compartment that sends to a core takes one input axon there",
    "if a source has several synapses there",
    "take fewer words",
    "these are the words of one source",
    "sign mode and weight bits",
    "a compartment takes one accumulator for each step of it",
    "rounded up to a power of two",
    "a spike takes one output axon for each destination core (more slots when that core is on another chip)",
    "synapse_words)",
    "or",
];

/// The phrases of advice.
fn phrases(help: &str) -> Vec<String> {
    let help = help.replace(" or no delays", ", no delays").replace(" take fewer words", ", take fewer words");
    let parts = help.split([',', ';', ':']).map(|part| part.trim().trim_start_matches("or ").to_string());
    parts.filter(|part| !part.is_empty()).collect()
}

/// Each alternative in the reasons of a network that slightly exceeds a limit.
#[test]
fn each_phrase_of_why_a_network_does_not_fit_makes_it_fit() {
    let folder = tempfile::tempdir().unwrap();
    // Half of the channels never fire.
    let rows: String = (0..64).map(|channel| format!("{channel},{}\n", 2 * channel)).collect();
    let silent = write(folder.path(), "half.csv", &format!("timestep,channel\n{rows}"));
    let sources = Net { delays: vec![9; 8], ..NET };
    let fan = Net { polarities: 1, side: 1, relayed: true, units: 20_000, ..NET };
    let mut taken = 0;
    for (net, limit) in [
        (NET, "axons_in"),
        (Net { relayed: true, ..NET }, "axons_in"),
        (sources.clone(), "synapse_words"),
        (sources, "synapse_words_per_axon"),
        (Net { exponents: vec![0, 2], ..NET }, "synapse_formats"),
        (Net { delays: vec![20], ..NET }, "accumulators"),
        (fan.clone(), "axons_out_per_compartment"),
        (fan, "axons_out"),
    ] {
        let model = write(folder.path(), "n.ron", &net.text());
        let map = |most: u64| {
            object_of(&["map", &model, "--target", "loihi1-chip", "--set", &format!("target.limits.{limit}={most}")])
        };
        let reason = |map: &Value| map["reasons"][0].clone();
        let need = reason(&map(1))["need"].as_u64().unwrap();
        let most = format!("target.limits.{limit}={}", need - 1);
        let refused = map(need - 1);
        let help = reason(&refused)["help"].as_str().unwrap_or_else(|| panic!("{limit}: {refused}")).to_string();
        let mut remedies = 0;
        for phrase in phrases(&help) {
            let Some((changed, typed)) = done(&phrase, &net, &silent) else {
                assert!(EXPLAIN.contains(&phrase.as_str()), "{limit}: {phrase:?} of {help:?} is not tried");
                continue;
            };
            let changed = write(folder.path(), "changed.ron", &changed.text());
            let line = ["map", &changed, "--target", "loihi1-chip", "--set", &most];
            let typed: Vec<&str> = typed.iter().map(String::as_str).collect();
            let line = [&line[..], &typed].concat();
            let mut after = object_of(&line);
            let gone =
                after["reasons"].as_array().unwrap().iter().all(|one| one["code"] != refused["reasons"][0]["code"]);
            assert!(gone, "{limit}, {phrase:?}: {}", after["reasons"]);
            // Relays take more cores than some boards have, which the message states too.
            if let Some((_, board)) =
                after["remedies"][0]["change"].as_str().and_then(|change| change.split_once("--target "))
            {
                let mut line = line.clone();
                line[3] = board;
                after = object_of(&line);
            }
            assert_eq!(after["fits"], true, "{limit}, {phrase:?}: {}", after["reasons"]);
            remedies += 1;
        }
        assert!(remedies > 0, "{limit}: {help}");
        taken += remedies;
    }
    assert!(taken > 15, "{taken}");
}

/// Each change that `nsim map` tried is typed unchanged, and the network fits.
#[test]
fn each_change_that_was_tried_makes_it_fit() {
    let folder = tempfile::tempdir().unwrap();
    let wide = Net { polarities: 1, side: 70, ..NET };
    let fan = Net { polarities: 1, side: 1, relayed: true, units: 9000, ..NET };
    let coarse = Net { delays: vec![9; 8], ..NET };
    let many_cores = Net { polarities: 1, units: 1200, ..NET };
    let (one, many) = (["--target", "loihi1-chip"], ["--target", "loihi1-chip", "--copies", "200"]);
    let few = |limit| [&one[..], &["--set", limit]].concat();
    let mut kinds = std::collections::BTreeSet::new();
    for (net, typed) in [
        (Some(&wide), &one[..]),
        (Some(&fan), &few("target.limits.axons_out_per_compartment=4")),
        (Some(&coarse), &few("target.limits.synapse_words_per_axon=2")),
        (Some(&NET), &few("target.limits.axons_in=100")),
        (Some(&many_cores), &few("target.limits.synapse_words=100")),
        (None, &many),
    ] {
        let written = |net: &Net| write(folder.path(), "n.ron", &net.text());
        let model = net.map_or("vtsnn-slip".to_string(), written);
        let line = [&["map", &model], typed].concat();
        let refused = object_of(&line);
        for remedy in refused["remedies"].as_array().unwrap() {
            let change = remedy["change"].as_str().unwrap();
            let words: Vec<&str> = change.split_once(": ").unwrap().1.split(' ').collect();
            // A board or a number of copies replaces the one on the command line.
            let place = line.iter().position(|word| *word == words[0] && *word != "--set");
            let rest =
                line.iter().enumerate().filter(|(at, _)| place.is_none_or(|place| ![place, place + 1].contains(at)));
            let again: Vec<&str> = rest.map(|(_, word)| *word).chain(words).collect();
            let fits = object_of(&again);
            assert_eq!(fits["fits"], true, "{again:?}: {}", fits["reasons"]);
            kinds.insert(remedy["kind"].as_str().unwrap().to_string());
            if remedy["kind"] == "limit" {
                // A smaller value does not suffice.
                let (path, least) = again.last().unwrap().split_once('=').unwrap();
                let less = format!("{path}={}", least.parse::<u64>().unwrap() - 1);
                assert_eq!(object_of(&[&again[..again.len() - 1], &[&less]].concat())["fits"], false, "{again:?}");
            }
        }
    }
    let known = ["copies", "doubled_limit", "limit", "relays", "target", "weight_bits"];
    assert!(known.iter().all(|kind| kinds.contains(*kind)), "{kinds:?}");
}

/// A mapping that takes too many cores is no bound, and names the population that fills them.
#[test]
fn a_mapping_of_too_many_cores_names_its_population_and_what_it_fills() {
    let folder = tempfile::tempdir().unwrap();
    let model = write(folder.path(), "n.ron", &Net { polarities: 1, units: 1200, ..NET }.text());
    let line = ["map", &model, "--target", "loihi1-chip", "--set", "target.limits.synapse_words=100"];
    let (code, text, _) = said(&line);
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(code == 1 && text.contains("this mapping takes 200 cores") && !text.contains("at least"), "{text}");
    assert!(text.contains("; out is on 200 of them, the fullest with 64 of 100 words;"), "{text}");
    assert!(text.contains("use a larger board: --target "), "{text}");
}

/// The object of `nsim map`, whether or not the network fits.
fn object_of(line: &[&str]) -> Value {
    let (code, stdout, stderr) = said(&[line, &["--format", "json"]].concat());
    assert!(code < 2, "{line:?}: {stderr}");
    serde_json::from_str(&stdout).unwrap()
}

/// A model of two channels and one compartment.
fn single(neuron: &str, projection: &str) -> String {
    format!(
        "Network(name: \"n\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [2]),
         Loihi(name: \"out\", shape: [1], {neuron})], projections: [Dense(from: [\"in\"], to: \"out\", {projection})],
         output: \"out\")"
    )
}

/// The number after some words of a text.
fn number(text: &str, before: &str) -> i64 {
    let (_, behind) = text.split_once(before).unwrap_or_else(|| panic!("{before:?} is not in {text:?}"));
    let digits: String = behind.chars().take_while(char::is_ascii_digit).collect();
    digits.parse().unwrap_or_else(|_| panic!("no number behind {before:?} in {text:?}"))
}

/// The words of `--set` in a text.
fn set(text: &str) -> String {
    let (_, behind) = text.split_once("--set ").unwrap_or_else(|| panic!("{text:?}"));
    behind.split_whitespace().next().unwrap().trim_end_matches([',', ';']).to_string()
}

/// Each warning of a run, and the change that it suggests.
#[test]
fn each_warning_of_a_run_is_gone_after_the_change_that_it_names() {
    let folder = tempfile::tempdir().unwrap();
    let noise = ["--input", "scene:noise?samples=2&steps=100&rate=0.5&seed=1"];
    // The model, the code, the words of the advice, and the settings that they suggest.
    type Change = fn(&str) -> Vec<String>;
    let rows: [(String, &str, &str, Change); 13] = [
        (
            single("du: 4096, dv: 4096, vth_mant: 1", "weights: [[8, 8]], weight_exp: -4"),
            "silent-output",
            "a weight_exp that does not round them to zero",
            |_| vec!["projections.0.weight_exp=-2".to_string()],
        ),
        (
            single("du: 4096, dv: 1024, vth_mant: 9000", "weights: [[64, 64]]"),
            "silent-output",
            "lower vth_mant",
            |said| vec![format!("populations.out.vth_mant={}", number(said, "from 9000 to "))],
        ),
        (
            single("du: 4096, dv: 4096, vth_mant: 1", "weights: [[2, 0]], weight_exp: -1"),
            "silent-output",
            "raise the weight_exp",
            |said| vec![format!("projections.0.weight_exp={}", -1 + number(said, "of its inputs by "))],
        ),
        (single("du: 4096, dv: 4096, vth_mant: 131071", "weights: [[64, 64]]"), "silent-output", "decision", |said| {
            vec![set(said)]
        }),
        (single("du: 4096, dv: 1024, vth_mant: 10", "weights: [[-64, -64]]"), "silent-output", "or a bias", |_| {
            vec!["populations.out.bias_mant=4000".to_string(), "populations.out.bias_exp=3".to_string()]
        }),
        (
            single("du: 4096, dv: 1024, vth_mant: 10", "weights: [[-64, -64]]"),
            "silent-output",
            "give it positive weights",
            |_| vec!["projections.0.weights=[[64, 64]]".to_string()],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 100, vmax_exp: 1", "weights: [[250, 250]]"),
            "clipped",
            "raise vmax_exp",
            |_| vec!["populations.out.vmax_exp=7".to_string()],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90", "weights: [[63, -61]], weight_exp: 1"),
            "weights-rounded",
            "double them and lower weight_exp by 1",
            |said| {
                let lower = 1 - number(said, "lower weight_exp by ");
                vec!["projections.0.weights=[[126, -122]]".to_string(), format!("projections.0.weight_exp={lower}")]
            },
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90", "weights: [[63, 4]], sign: Mixed"),
            "weights-rounded",
            "changed 1 of 2 weights, by at most 1.000 (not in the reference engine): sign: Excitatory holds them",
            |_| vec!["projections.0.sign=Excitatory".to_string()],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90", "weights: [[-255, -3]], sign: Mixed, weight_bits: 6"),
            "weights-rounded",
            "sign: Inhibitory with weight_bits: 8 holds them",
            |_| vec!["projections.0.sign=Inhibitory".to_string(), "projections.0.weight_bits=8".to_string()],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90, refractory: 5", "weights: [[64, 64]]")
                .replace("output:", "semantics: Lava, output:"),
            "parameter-ignored",
            "refractory is ignored under semantics Lava",
            |said| vec![set(said)],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90, vmin_exp: 20", "weights: [[64, 64]]")
                .replace("output:", "semantics: Slayer, output:"),
            "parameter-ignored",
            "vmin_exp is ignored under semantics Slayer",
            |said| vec![set(said)],
        ),
        (
            single("du: 4096, dv: 0, vth_mant: 90", "weights: [[0, 0]]")
                .replace("output:", "decision: GreatestV, output:"),
            "silent-output",
            "raise them",
            |_| vec!["projections.0.weights=[[2, 2]]".to_string()],
        ),
    ];
    for (text, code, advice, change) in rows {
        let model = write(folder.path(), "n.ron", &text);
        let warnings = |more: &[&str]| {
            let run = object(&[&["run", &model], &noise[..], more].concat(), 0);
            let rows = run["warnings"].as_array().unwrap().clone();
            rows.into_iter().find(|row| row["code"] == code).map(|row| row["message"].as_str().unwrap().to_string())
        };
        let said = warnings(&[]).unwrap_or_else(|| panic!("{text} is not warned of"));
        assert!(said.contains(advice), "{advice:?}: {said}");
        let changes = change(&said);
        let sets: Vec<&str> = changes.iter().flat_map(|change| ["--set", change.as_str()]).collect();
        assert_eq!(warnings(&sets), None, "{said}, with {sets:?}");
    }
}

/// A refractory period beyond a chip's counter is refused, and each of the remedies maps.
#[test]
fn a_refractory_period_beyond_the_chips_counter_fits_where_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let model =
        write(folder.path(), "n.ron", &single("du: 4096, dv: 0, vth_mant: 90, refractory: 101", "weights: [[64, 64]]"));
    let (status, _, refused) = said(&["map", &model]);
    let advice = "shorten it, set refractory: 101 in a chip of your own, or choose a target with a longer one";
    assert!(status == 3 && refused.contains("map.refractory") && refused.contains(advice), "{status}: {refused}");
    let own = write(folder.path(), "own.ron", r#"Target(base: "nahuku-32", refractory: 101)"#);
    for remedy in [&["--set", "populations.1.refractory=63"][..], &["--target", &own], &["--target", "boundless"]] {
        let (status, _, told) = said(&[&["map", &model][..], remedy].concat());
        assert_eq!(status, 0, "{remedy:?}: {told}");
    }
}

/// Advice that ends in a command or option: it is taken from the output, and typed.
#[test]
fn what_is_printed_to_be_typed_is_typed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    // A mapping strategy that takes more cores than the board has.
    let synapses: Vec<String> =
        (0..8).flat_map(|unit| (0..3).map(move |k| format!("({}, {unit}, 100)", 3 * (unit % 2) + k))).collect();
    let two = format!(
        "Network(name: \"two\", timestep_ms: 1.0, populations: [Input(name: \"in\", shape: [6]), Loihi(name: \"out\",
         shape: [8], du: 4096, dv: 1024, vth_mant: 10)], projections: [Sparse(from: [\"in\"], to: \"out\", synapses:
         [{}])], output: \"out\")",
        synapses.join(", ")
    );
    let two = write(folder.path(), "two.ron", &two);
    let board = "Target(base: \"tiny\", name: \"two\", width: 1, height: 1, chips_x: 1, chips_y: 1, cores_per_tile: 2, \
                 cores_per_chip: 2)";
    let board = write(folder.path(), "board.ron", board);
    let line = ["map", &two, "--target", &board, "--set", "target.limits.axons_in=3"];
    let refused = object_of(&[&line[..], &["--strategy", "sequential"]].concat());
    let mut remedies = refused["remedies"].as_array().unwrap().iter();
    let remedy = remedies.find(|remedy| remedy["kind"] == "strategy").unwrap_or_else(|| panic!("{refused}"));
    let typed = remedy["change"].as_str().unwrap().split_once(": ").unwrap().1.split(' ').collect::<Vec<_>>();
    assert_eq!(typed[0], "--strategy");
    assert_eq!(object_of(&[&line[..], &typed].concat())["fits"], true);
    // The number of cores from the message.
    let cores = number(refused["reasons"][0]["help"].as_str().unwrap(), "a target of ");
    let board = board_of(cores, folder.path());
    let line = ["map", &two, "--target", &board, "--set", "target.limits.axons_in=3", "--strategy", "sequential"];
    assert_eq!(object_of(&line)["fits"], true, "{cores} cores");

    // A constant without its unit.
    let line = ["energy", "--samples", "0..1"];
    let refused = object(&[&line[..], &["--set", "constants.injection_time=0.4"]].concat(), 3);
    let typed = set(refused["help"].as_str().unwrap()).replace("NUMBER", "0.4");
    object(&[&line[..], &["--set", &typed]].concat(), 0);

    // A saved mapping whose cores exceed a limit.
    let saved = at("saved.ron");
    assert_eq!(said(&["map", &two, "-o", &saved]).0, 0);
    let few = ["--set", "target.limits.axons_in=3"];
    let refused = object_of(&[&["map", &two, "--mapping", &saved], &few[..]].concat());
    let advice = refused["reasons"][0]["help"].as_str().unwrap();
    assert!(advice.contains("let nsim make a new mapping") && advice.contains("move compartments"), "{advice}");
    let moved = at("moved.ron");
    assert_eq!(object_of(&[&["map", &two, "-o", &moved], &few[..]].concat())["fits"], true);
    assert_eq!(object_of(&[&["map", &two, "--mapping", &moved], &few[..]].concat())["fits"], true);
}

/// Refusals of a model or of a combination of options, each with every remedy.
#[test]
fn each_way_out_of_a_refusal_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name).display().to_string();
    let noise = "scene:noise?samples=1&steps=20&rate=0.5";
    let plain = "du: 4096, dv: 1024, vth_mant: 10";
    let weights = |weights: &str| single(plain, &format!("weights: [[{weights}]]"));
    let delayed = |delay: u32| single(plain, &format!("weights: [[8, 8]], delay: {delay}"));
    let loops = |delay: u32| {
        let own = format!("], projections: [Dense(from: [\"out\"], to: \"out\", weights: [[-8]], delay: {delay}), ");
        weights("8, 8").replace("], projections: [", &own)
    };
    let late = single("du: 4096, dv: 1024, vth_mant: 10, start_step: 2", "weights: [[8, 8]]");
    let sanafe = |name: &str| {
        vec!["energy".to_string(), "--export-sanafe".to_string(), at(name), "--input".into(), noise.into()]
    };
    let run = || vec!["run".to_string(), "--input".into(), noise.into()];
    let map = |more: &[&str]| [&["map"], more].concat().into_iter().map(str::to_string).collect::<Vec<_>>();
    // The refused command and model; the words of the advice, and the command and model that they
    // suggest.
    type Typed = (Vec<String>, String);
    let rows: [(Typed, Vec<(&str, Typed)>); 8] = [
        (
            (sanafe("a"), late.clone()),
            vec![(
                "--set populations.NAME.start_step=0",
                ([sanafe("b"), vec!["--set".into(), "FROM HELP".into()]].concat(), late),
            )],
        ),
        (
            (sanafe("c"), delayed(3)),
            vec![
                ("all projections from inputs delay 0", (sanafe("d"), delayed(0))),
                ("or all delay 1", (sanafe("e"), delayed(1))),
            ],
        ),
        ((sanafe("f"), loops(2)), vec![("between compartments delay 0", (sanafe("g"), loops(0)))]),
        (
            (map(&["--prune", "static", "--relays"]), weights("8, 8")),
            vec![
                ("remove --prune", (map(&["--relays"]), weights("8, 8"))),
                ("or --relays", (map(&["--prune", "static"]), weights("8, 8"))),
            ],
        ),
        (
            (run(), weights("0.5, 1.5")),
            vec![
                ("give weight_scale", (run(), weights("0.5, 1.5").replace("]])", "]], weight_scale: 4)"))),
                ("or give a real vth", (run(), weights("0.5, 1.5").replace("vth_mant: 10", "vth: 2"))),
            ],
        ),
        (
            (run(), weights("255, 256")),
            vec![(
                "raise weight_exp and halve the weights",
                (run(), weights("128, 128").replace("]])", "]], weight_exp: 1)")),
            )],
        ),
        (
            (run(), weights("255, 255").replace("]])", "]], sign: Mixed)")),
            vec![
                ("choose another sign mode", (run(), weights("255, 255").replace("]])", "]], sign: Excitatory)"))),
                (
                    "or scale weights and threshold together",
                    (run(), weights("128, 128").replace("vth_mant: 10", "vth_mant: 5")),
                ),
            ],
        ),
        (
            (run(), single("du: 4096, tau_u_ms: 4, dv: 1024, vth_mant: 10", "weights: [[8, 8]]")),
            vec![
                ("keep one of them", (run(), weights("8, 8"))),
                ("keep one of them", (run(), weights("8, 8").replace("du: 4096", "tau_u_ms: 4"))),
            ],
        ),
    ];
    for ((words, text), ways) in rows {
        let typed = |words: &[String], text: &str, help: &str| {
            let model = write(folder.path(), "n.ron", text);
            let mut words: Vec<String> = words.to_vec();
            words.insert(1, model);
            if let Some(value) = words.iter_mut().find(|word| *word == "FROM HELP") {
                *value = set(help).replace("NAME", "out");
            }
            words
        };
        let words = typed(&words, &text, "");
        let refused = object(&words.iter().map(String::as_str).collect::<Vec<_>>(), 3);
        let help = refused["help"].as_str().unwrap();
        for (advice, (words, text)) in ways {
            assert!(help.contains(advice), "{words:?}: {help:?} lacks {advice:?}");
            let words = typed(&words, &text, help);
            object(&words.iter().map(String::as_str).collect::<Vec<_>>(), 0);
        }
    }
}

/// The strings of a source file that a user may see, without tests and comments.
fn strings(text: &str) -> String {
    let text = text.split("#[cfg(test)]").next().unwrap_or_default();
    text.lines().filter(|line| !line.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n")
}

/// Every option and command in any message exists in nsim, and a test sets every value that a
/// message sets.
#[test]
fn messages_name_options_commands_and_values_that_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut files = Vec::new();
    let mut folders = vec![root.join("src"), root.join("crates")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false if path.extension().is_some_and(|extension| extension == "rs") => files.push(path),
                false => {}
            }
        }
    }
    let (_, all, _) = said(&["help"]);
    let commands: Vec<&str> = all
        .lines()
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
        .filter(|word| !word.is_empty())
        .collect();
    let mut known = all.clone();
    for command in &commands {
        let (_, help, _) = said(&["help", command]);
        for below in help
            .lines()
            .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
            .filter(|word| !word.is_empty() && !word.starts_with('-'))
        {
            known += &said(&["help", command, below]).1;
        }
        known += &help;
    }
    // Options of cargo, which builds nsim, and one of a build with the feature nvml.
    let others = ["--features", "--release", "--gpu-command"];
    // Values that this file's tests, or tests/cli/advice.rs, take from the message and set.
    let tried = [
        "timestep_ms=",
        "decision=GreatestV",
        "populations.NAME.start_step=0",
        "constants.{path}=",
        "semantics=Hardware",
    ];
    let tried = [&tried[..], &["projections.{place}.weight_bits=", "target.limits.{}="]].concat();
    // Examples of help texts.
    let tried =
        [&tried[..], &["PATH=VALUE", "constants.injection_time=", "weight_decay=", "layers.touch.size="]].concat();
    let mut wrong = Vec::new();
    let (mut options, mut sets) = (0, 0);
    // A command of the feature ann, which the tested program lacks; and removed names, whose own
    // test tries their replacements.
    let left_out = ["bench/ann.rs", "args/removed.rs"];
    for file in files.into_iter().filter(|file| !left_out.iter().any(|name| file.ends_with(name))) {
        let text = strings(&std::fs::read_to_string(&file).unwrap());
        for (place, _) in text.match_indices("--") {
            let name: String = text[place + 2..].chars().take_while(|c| c.is_ascii_lowercase() || *c == '-').collect();
            let name = name.trim_end_matches('-');
            let before = text[..place].chars().last().unwrap_or(' ');
            if name.len() < 2 || before == '-' || before.is_ascii_alphanumeric() {
                continue;
            }
            let option = format!("--{name}");
            options += 1;
            if !known.contains(&option) && !others.contains(&option.as_str()) {
                wrong.push(format!("{}: {option}", file.display()));
            }
        }
        for (place, _) in text.match_indices("--set ") {
            let behind = text[place + 6..].split_whitespace().next().unwrap_or_default();
            // The user's own words are repeated unchanged.
            if !behind.contains('=') || behind.starts_with(['{', '\'']) {
                continue;
            }
            sets += 1;
            if !tried.iter().any(|tried| behind.starts_with(tried)) {
                wrong.push(format!("{}: --set {behind}", file.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert!(options > 150 && sets > 5, "{options} {sets}");
}

/// A board of this many cores.
fn board_of(cores: i64, folder: &Path) -> String {
    let text = format!(
        "Target(base: \"tiny\", name: \"many\", width: 1, height: 1, chips_x: 1, chips_y: 1, cores_per_tile: {cores}, \
         cores_per_chip: {cores})"
    );
    write(folder, "many.ron", &text)
}

/// Both forms of a refusal have equal text, including the command of an option.
#[test]
fn reasons_say_the_same_as_text_and_as_json() {
    let folder = tempfile::tempdir().unwrap();
    let model = Net { polarities: 1, side: 1, relayed: true, units: 9000, ..NET };
    let model = write(folder.path(), "n.ron", &model.text());
    let few = ["--set", "target.limits.axons_out_per_compartment=2", "--input", "scene:noise?samples=1"];
    for command in ["agree", "run", "energy"] {
        let line = [&[command, &model][..], &few].concat();
        let (_, _, text) = said(&line);
        let map = object(&line, 1);
        let advice = map["reasons"][0]["help"].as_str().unwrap();
        let words = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words(&text).contains(advice), "{command}: {text} lacks {advice}");
        assert_eq!(advice.contains("(nsim map has --relays)"), command == "agree", "{command}: {advice}");
    }
}
