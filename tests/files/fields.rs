//! The table of fields in `tests/files/fields.md`: a field with another valid value changes the
//! model, adds a warning or is refused, and a field without meaning changes nothing.
//! `docs/import.md` has each field in a row of its layer.

use std::collections::BTreeSet;
use std::path::Path;

use crate::torch::{Entry, checkpoint};
use crate::tree;
use nsim::files::lower::lower;
use nsim::files::network::NetworkFile;
use nsim::import::foreign;
use nsim::import::foreign::{Imported, Options, Reading};
use nsim::import::hdf5;
use nsim::import::hdf5::{Group, Item, Numbers};
use nsim::ir::base::warning::Warning;
use serde_json::Value;

/// A row: the owner of the field, its name, the other value.
struct Row {
    owner: String,
    field: String,
    other: String,
}

fn rows() -> Vec<Row> {
    let text = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/fields.md")).unwrap();
    let table = text.split("\n## Fields").nth(1).unwrap().split("\n## ").next().unwrap();
    let plain = |cell: &str| cell.trim().trim_matches('`').to_string();
    let cells = table.lines().filter_map(|line| line.strip_prefix('|')).map(|line| line.split('|').collect::<Vec<_>>());
    cells
        .filter(|cells| cells.len() == 5 && !["in", "---"].contains(&cells[0].trim()))
        .map(|cells| Row { owner: plain(cells[0]), field: plain(cells[1]), other: plain(cells[3]) })
        .collect()
}

/// A value of the table as an item of a file: nested lists, a number or a word.
fn item(text: &str) -> Item {
    fn flat(value: &Value, depth: usize, shape: &mut Vec<usize>, numbers: &mut Vec<f64>) {
        match value {
            Value::Array(items) => {
                if shape.len() == depth {
                    shape.push(items.len());
                }
                items.iter().for_each(|item| flat(item, depth + 1, shape, numbers));
            }
            number => numbers.push(number.as_f64().unwrap()),
        }
    }
    let Ok(value) = serde_json::from_str::<Value>(text) else { return text.into() };
    if let Ok(pairs) = serde_json::from_str::<Vec<[String; 2]>>(text) {
        return Item::Texts(vec![pairs.len(), 2], pairs.into_iter().flatten().collect());
    }
    let (mut shape, mut numbers) = (Vec::new(), Vec::new());
    flat(&value, 0, &mut shape, &mut numbers);
    if numbers.iter().all(|x| x.fract() == 0.0) {
        return Numbers::i64(&shape, &numbers.iter().map(|&x| x as i64).collect::<Vec<_>>()).into();
    }
    Numbers::f64(&shape, &numbers).into()
}

/// A group with these members, each a value in the table's notation.
fn group(members: &[(&str, &str)]) -> Group {
    members.iter().fold(Group::default(), |group, (key, value)| group.with(key, item(value)))
}

/// The model of a file and its warnings; `None` if it is refused.
fn model(root: &Group, options: &Options) -> Option<(NetworkFile, Vec<Warning>)> {
    let bytes = hdf5::write(root).unwrap();
    let Imported { mut model, warnings, .. } = foreign::from_bytes(Path::new("net.nir"), bytes, options).ok()?;
    lower(&model.build(Path::new("net.nir")).ok()?).ok()?;
    // The provenance has the notes of the import.
    model.provenance = None;
    Some((model, warnings))
}

const LIF: [(&str, f64); 4] = [("tau", 0.008), ("r", 8.0), ("v_leak", 0.0), ("v_threshold", 1.0)];
const CUBA: [(&str, f64); 5] = [("tau_syn", 0.004), ("tau_mem", 0.008), ("w_in", 4.0), ("r", 8.0), ("v_leak", 0.0)];
const LINEAR: [(&str, &str); 2] = [("type", "Linear"), ("weight", "[[1, 2, 3, 4], [2, 3, 4, 5], [3, 4, 5, 6]]")];

/// A graph with a node `x` of this type, which has this field if its type supports it.
fn nir(kind: &str, change: Option<&(&str, Item)>) -> Group {
    let line = |nodes: Vec<(&'static str, Group)>| nodes;
    let lif = |units: usize| tree::node("LIF", &[units], &LIF);
    // Neurons with one set of parameters, which fits any shape.
    let any = || lif(1);
    let (input, output) =
        (|| group(&[("type", "Input"), ("shape", "[4]")]), || group(&[("type", "Output"), ("shape", "[3]")]));
    let image = || group(&[("type", "Input"), ("shape", "[1, 4, 4]")]);
    let end = || group(&[("type", "Output")]);
    let neuron = |fields: &[(&str, f64)]| {
        let node = tree::node(kind, &[3], fields);
        line(vec![("i", input()), ("w", group(&LINEAR)), ("x", node), ("o", output())])
    };
    let nodes = match kind {
        "Input" => line(vec![("x", input()), ("w", group(&LINEAR)), ("n", lif(3)), ("o", output())]),
        "Output" => line(vec![("i", input()), ("w", group(&LINEAR)), ("n", lif(3)), ("x", output())]),
        "Linear" => line(vec![("i", input()), ("x", group(&LINEAR)), ("n", lif(3)), ("o", output())]),
        "Affine" => {
            let affine = group(&[("bias", "[0, 0, 1]"), ("weight", LINEAR[1].1), ("type", "Affine")]);
            line(vec![("i", input()), ("x", affine), ("n", lif(3)), ("o", output())])
        }
        "Scale" | "Delay" => {
            let node = match kind {
                "Scale" => group(&[("type", "Scale"), ("scale", "[1, 2, 3]")]),
                _ => group(&[("type", "Delay"), ("delay", "[0.001, 0.002, 0]")]),
            };
            line(vec![("i", input()), ("w", group(&LINEAR)), ("x", node), ("n", lif(3)), ("o", output())])
        }
        "Conv2d" => {
            let conv = group(&[
                ("type", "Conv2d"),
                ("weight", "[[[[1, 2], [3, 4]]]]"),
                ("bias", "[1]"),
                ("stride", "[1, 1]"),
                ("padding", "[0, 0]"),
                ("dilation", "[1, 1]"),
                ("groups", "1"),
                ("input_shape", "[4, 4]"),
            ]);
            line(vec![("i", image()), ("x", conv), ("n", any()), ("o", end())])
        }
        "SumPool2d" | "AvgPool2d" => {
            let pool = group(&[("type", kind), ("kernel_size", "[2, 2]"), ("stride", "[2, 2]"), ("padding", "[0, 0]")]);
            line(vec![("i", image()), ("x", pool), ("n", any()), ("o", end())])
        }
        "Conv1d" => {
            let conv = group(&[
                ("type", "Conv1d"),
                ("weight", "[[[1, 2]], [[3, 4]]]"),
                ("bias", "[1, 0]"),
                ("stride", "1"),
                ("padding", "0"),
                ("dilation", "1"),
                ("groups", "1"),
                ("input_shape", "4"),
            ]);
            let image = group(&[("type", "Input"), ("shape", "[1, 4]")]);
            line(vec![("i", image), ("x", conv), ("n", any()), ("o", end())])
        }
        "Flatten" => {
            let flatten = group(&[("type", "Flatten"), ("start_dim", "0"), ("end_dim", "-1")]);
            let weights = Group::default().with("type", "Linear").with("weight", Numbers::f64(&[2, 16], &[0.5; 32]));
            line(vec![("i", image()), ("x", flatten), ("w", weights), ("n", lif(2)), ("o", end())])
        }
        "LIF" => neuron(&LIF),
        "CubaLIF" => neuron(&[&CUBA[..], &[("v_threshold", 1.0)]].concat()),
        "IF" => neuron(&[("r", 1.0), ("v_threshold", 1.0)]),
        "Threshold" => neuron(&[("threshold", 1.0)]),
        "LI" => neuron(&LIF[..3]),
        "CubaLI" => neuron(&CUBA),
        "I" => neuron(&[("r", 1.0)]),
        "NIRGraph" | "file" => line(vec![("i", input()), ("w", group(&LINEAR)), ("n", lif(3)), ("o", output())]),
        other => panic!("no graph with a node {other}"),
    };
    let edges: Vec<(&str, &str)> = nodes.windows(2).map(|pair| (pair[0].0, pair[1].0)).collect();
    let changed = |(name, mut node): (&'static str, Group)| {
        if let Some((field, value)) = change.filter(|_| name == "x") {
            node.insert(field, value.clone());
        }
        (name, node)
    };
    let mut root = tree::nir(nodes.into_iter().map(changed), edges);
    match (change, root.items.get_mut("node")) {
        (Some((field, value)), Some(Item::Group(graph))) if kind == "NIRGraph" => graph.insert(field, value.clone()),
        (Some((field, value)), _) if kind == "file" => root.insert(field, value.clone()),
        _ => {}
    }
    root
}

/// A netx file of an input, a convolution and a dense layer; a field of one of them, or of the
/// neurons, is changed.
fn netx(owner: &str, change: Option<&(&str, Item)>) -> Group {
    let changed = |mut group: Group, name: &str| {
        if let Some((field, value)) = change.filter(|_| owner == name) {
            group.insert(field, value.clone());
        }
        group
    };
    let neuron = || {
        let members = [("type", "LOIHI"), ("iDecay", "1024"), ("vDecay", "128"), ("vThMant", "80"), ("theta", "5120")];
        let neuron = group(&members).with("refDelay", item("1"));
        changed(neuron, "neuron")
    };
    let mut input = group(&[("type", "input"), ("shape", "[1, 3, 3]")]);
    if owner == "input" {
        input = input.with("weight", item("36")).with("bias", item("34")).with("neuron", neuron());
    }
    let conv = group(&[
        ("type", "conv"),
        ("shape", "[1, 2, 2]"),
        ("weight", "[[[[2, 4], [6, 8]]]]"),
        ("bias", "[2]"),
        ("stride", "[1, 1]"),
        ("padding", "[0, 0]"),
        ("dilation", "[1, 1]"),
        ("groups", "1"),
        ("kernelSize", "[2, 2]"),
        ("inChannels", "1"),
        ("outChannels", "1"),
    ]);
    let (first, kind) = match owner {
        "pool" => (
            group(&[
                ("type", "pool"),
                ("shape", "[1, 2, 2]"),
                ("weight", "[[[[64, 64], [64, 64]]]]"),
                ("bias", "[2]"),
                ("kernelSize", "[2, 2]"),
                ("stride", "[1, 1]"),
                ("padding", "[0, 0]"),
                ("dilation", "[1, 1]"),
            ]),
            "pool",
        ),
        "convT" => (conv.with("type", "convT").with("shape", item("[1, 4, 4]")), "convT"),
        "unpool" => (
            group(&[
                ("type", "unpool"),
                ("shape", "[1, 6, 6]"),
                ("weight", "[[[[64, 64], [64, 64]]]]"),
                ("bias", "[2]"),
                ("kernelSize", "[2, 2]"),
                ("stride", "[2, 2]"),
                ("padding", "[0, 0]"),
                ("dilation", "[1, 1]"),
            ]),
            "unpool",
        ),
        _ => (conv, "conv"),
    };
    let features = first.numbers("shape").unwrap().reals().product::<f64>() as usize;
    let mut dense = group(&[("type", "dense"), ("shape", "[2]"), ("bias", "[2, 2]"), ("outFeatures", "2")]);
    let weights: Vec<i64> = (0..2 * features as i64).map(|i| 2 * (i % 50 + 1)).collect();
    dense = dense
        .with("weight", Numbers::i64(&[2, features], &weights))
        .with("inFeatures", Numbers::i64(&[], &[features as i64]));
    for (kind, key) in [("dense_rec", "weight_rec"), ("recurrent", "recWeight")] {
        if owner == kind {
            dense = dense.with("type", kind).with(key, item("[[2, 4], [6, 8]]"));
        }
    }
    let flatten = group(&[("type", "flatten"), ("shape", &format!("[{features}]"))]);
    let average = group(&[("type", "average"), ("shape", "[1]")]);
    let dense = changed(changed(changed(dense, "dense"), "dense_rec"), "recurrent");
    let mut layers = Group::default()
        .with("0", changed(input, "input"))
        .with("1", changed(first, kind).with("neuron", neuron()))
        .with("2", changed(flatten, "flatten"))
        .with("3", dense.with("neuron", neuron()));
    if owner == "average" {
        layers = layers.with("4", changed(average, "average"));
    }
    let simulation = changed(group(&[("Ts", "1")]), "simulation");
    Group::default().with("layer", layers).with("simulation", simulation)
}

/// A state dict with a neuron of this text.
fn described(kind: &str, change: Option<(&str, &str)>) -> Option<NetworkFile> {
    let mut fields: Vec<(&str, &str)> = match kind {
        "simulation" => vec![("Ts", "1"), ("tSample", "9")],
        "LOIHI" => vec![("vThMant", "80"), ("vDecay", "128"), ("iDecay", "1024"), ("refDelay", "1"), ("wgtExp", "0")],
        "SRMALPHA" => vec![("theta", "10"), ("tauSr", "10"), ("tauRef", "1"), ("scaleRef", "2")],
        "CUBA" => vec![("threshold", "1.25"), ("current_decay", "0.25"), ("voltage_decay", "0.03")],
        other => panic!("no neuron {other}"),
    };
    if let Some((field, value)) = change {
        fields.retain(|(key, _)| *key != field);
        fields.push((field, value));
    }
    let fields: String = fields.iter().map(|(key, value)| format!(", {key}: {value}")).collect();
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("neuron.yml");
    let text = match kind {
        "simulation" => format!(
            "simulation: {{{}}}\nneuron: {{type: SRMALPHA, theta: 10, tauSr: 10, tauRef: 1, scaleRef: 2}}\n",
            &fields[2..]
        ),
        _ => format!("neuron: {{type: {kind}{fields}}}\n"),
    };
    std::fs::write(&config, text).unwrap();
    let bytes = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus/checkpoint/zip")).unwrap();
    let options = Options { neuron: Some(config), ..Options::default() };
    let mut model = foreign::from_bytes(Path::new("net.pt"), bytes, &options).ok()?.model;
    lower(&model.build(Path::new("net.pt")).ok()?).ok()?;
    model.provenance = None;
    Some(model)
}

/// A state dict with one tensor changed.
fn tensors(tool: &str, change: Option<(&'static str, &str)>) -> Option<NetworkFile> {
    let number = |name, x: f32| -> Entry { (name, vec![], vec![x]) };
    let weights: Entry = ("weight", vec![2, 3], vec![0.5, 1.0, 1.5, -0.5, 0.75, 1.25]);
    let named = |name, entry: &Entry| (name, entry.1.clone(), entry.2.clone());
    let own = |name| -> Entry { (name, vec![2, 2], vec![0.5, 0.25, -0.5, 1.0]) };
    let (mut entries, yaml): (Vec<Entry>, &str) = match tool {
        "lava-dl" => (
            vec![
                named("blocks.0.synapse.weight", &weights),
                own("blocks.0.recurrent_synapse.weight"),
                number("blocks.0.neuron.current_decay", 1024.0),
                number("blocks.0.neuron.voltage_decay", 128.0),
            ],
            "neuron: {type: CUBA, threshold: 1.25}",
        ),
        "weight norm" => (
            vec![
                ("f.weight_g", vec![2, 1], vec![64.0, 80.0]),
                named("f.weight_v", &weights),
                number("l.srmKernel", 1.0),
            ],
            "neuron: {type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024}",
        ),
        "pruned" => (
            vec![
                ("f.weight_mask", vec![2, 3], vec![1.0, 1.0, 0.0, 1.0, 1.0, 0.0]),
                ("f.weight_orig", vec![2, 3], vec![20.0, 40.0, 60.0, -20.0, 30.0, 50.0]),
                number("l.refKernel", 1.0),
            ],
            "neuron: {type: LOIHI, vThMant: 80, vDecay: 128, iDecay: 1024}",
        ),
        other => panic!("no state dict of {other}"),
    };
    if let Some((field, value)) = change {
        let Item::Numbers(numbers) = item(value) else { panic!() };
        let entry = (field, numbers.shape().to_vec(), numbers.reals().map(|x| x as f32).collect());
        match entries.iter_mut().find(|(name, ..)| *name == field) {
            Some(old) => *old = entry,
            None => entries.push(entry),
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("neuron.yml");
    std::fs::write(&config, yaml).unwrap();
    let options = Options { neuron: Some(config), ..Options::default() };
    let mut model = foreign::from_bytes(Path::new("net.pt"), checkpoint(&entries), &options).ok()?.model;
    lower(&model.build(Path::new("net.pt")).ok()?).ok()?;
    model.provenance = None;
    Some(model)
}

fn unwarned(model: Option<NetworkFile>) -> Option<(NetworkFile, Vec<Warning>)> {
    model.map(|model| (model, Vec::new()))
}

/// Tensors of state dicts have their own names; the page lists them by tool.
#[test]
fn each_field_is_described_in_the_row_of_its_layer() {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/import.md")).unwrap();
    let described: Vec<(&str, &str)> =
        page.lines().filter_map(|line| line.strip_prefix("| ")?.split_once(" | ")).collect();
    for Row { owner, field, .. } in rows() {
        let (format, kind) = owner.split_once(' ').unwrap();
        let of_layer = |layers: &str| layers.split(", ").any(|layer| layer == kind);
        let found = described.iter().any(|(layers, fields)| of_layer(layers) && fields.contains(&format!("`{field}`")));
        assert!(format == "torch" || found, "docs/import.md has no `{field}` in a row of {owner}");
    }
}

#[test]
fn a_field_that_means_something_else_changes_the_model_or_is_warned_of_or_refused() {
    let rows = rows();
    assert!(rows.len() > 80, "{}", rows.len());
    let unique: BTreeSet<(&str, &str)> = rows.iter().map(|row| (row.owner.as_str(), row.field.as_str())).collect();
    assert_eq!(unique.len(), rows.len());
    let options = Options { reading: Reading { dt_ms: Some(1.0), ..Reading::default() }, ..Options::default() };
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("image.npy");
    let pixels = (0..9u8).map(|i| f64::from(i) / 9.0);
    nsim::files::npy::write(std::fs::File::create(&image).unwrap(), &[3, 3], pixels).unwrap();
    for Row { owner, field, other } in &rows {
        let (format, kind) = owner.split_once(' ').unwrap();
        let value = if other == "-" { "7" } else { other };
        let (before, after) = match format {
            "NIR" => {
                let change = (field.as_str(), item(value));
                (model(&nir(kind, None), &options), model(&nir(kind, Some(&change)), &options))
            }
            "netx" => {
                let change = (field.as_str(), item(value));
                // The file has the timestep, and an image drives an input layer with neurons.
                let image = (kind == "input").then(|| image.clone());
                let options = Options { image, ..Options::default() };
                (model(&netx(kind, None), &options), model(&netx(kind, Some(&change)), &options))
            }
            "torch" => {
                let field: &'static str = field.clone().leak();
                (unwarned(tensors(kind, None)), unwarned(tensors(kind, Some((field, value)))))
            }
            "YAML" => (unwarned(described(kind, None)), unwarned(described(kind, Some((field, value))))),
            other => panic!("no format {other}"),
        };
        assert!(before.is_some(), "{owner}: the graph without a change is refused");
        assert_eq!(before == after, other == "-", "{owner}, {field}: {value}");
    }
}
