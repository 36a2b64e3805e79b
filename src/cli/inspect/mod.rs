//! `nsim inspect FILE`: the contents of a file.
//!
//! Input: a file, a folder, or a shipped name. Output: its kind, its facts, and tables of its
//! parts. Nothing is compiled: `nsim map` may still refuse an inspected model.

mod foreign;
mod hardware;
pub mod help;
pub(in crate::cli) mod network;
pub mod show;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::{Value, json};

use crate::cli::args::reading::ReadingArgs;
use crate::cli::context::{Answer, Context};
use crate::cli::inspect::hardware::{
    baseline_findings, chip_findings, constants_findings, scenario_findings, target_findings,
};
use crate::cli::inspect::network::network_findings;
use crate::cli::output;
use nsim_energy::baseline::Baseline;
use nsim_energy::published::scenario;
use nsim_files::mapping::mapping;
use nsim_files::shipped::{self, Origin};
use nsim_files::{npy, safetensors, target, text};
use nsim_import::foreign::Reading;
use nsim_import::kind::FileKind;
use nsim_import::model;
use nsim_import::spikes::{self, EventOptions, manifest};
use nsim_ir::base::diagnostic::{Diagnostic, SourceText};
use nsim_ir::locate::root_name;
use nsim_ir::mapping::{MappingFile, PrunedFile, Run, check_unchanged};
use nsim_ir::stimulus::{InputArg, InputSource};
use nsim_report::inspect::{Findings, FindingsTable, number};
use nsim_session::error::Error;

/// Command-line arguments.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "EXAMPLES:
  nsim inspect vtsnn-slip                 a shipped model
  nsim inspect nahuku-32                  a shipped target and its constants
  nsim inspect weights.npy --format json  shape, type and range of an array
  nsim inspect network.nir                arrays of a model of another tool, and options needed to import it
  nsim inspect recording.aedat4           events, extent and duration
  nsim inspect recordings/                a folder of sample_<i>_label_<c>.npy")]
pub struct Args {
    /// A model, target, mapping, data set, .npy, .safetensors or .csv file, a model of another tool
    /// (.net, .nir, .pt), a recording of events, a folder of recordings, or a shipped name; after
    /// a recording, its options as --input of nsim run takes them
    pub file: String,
    #[command(flatten)]
    pub reading: ReadingArgs,
}

pub fn run(args: &Args, context: Context) -> Result<Answer, Error> {
    let findings = inspect(&args.file, &args.reading.reading())?;
    let json = || findings.json("nsim.inspect/1", &args.file);
    output::print(context.format, || findings.text(&args.file), json, || findings.csv())?;
    Ok(Answer::Yes)
}

fn inspect(argument: &str, reading: &Reading) -> Result<Findings, Diagnostic> {
    let (path, options) = match InputArg::parse(argument)? {
        InputArg { population: None, source: InputSource::Events(path, pairs) } if !Path::new(argument).exists() => {
            (path, EventOptions::parse(&pairs)?)
        }
        _ => (argument.into(), EventOptions::default()),
    };
    let path = path.as_path();
    if !shipped::is_path(argument) && !path.exists() {
        return inspect_shipped(argument, reading);
    }
    let kind = FileKind::detect(path)?;
    let is_recording = matches!(kind, FileKind::Folder | FileKind::Events(_));
    let is_data = is_recording || matches!(kind, FileKind::Npy | FileKind::SpikeList | FileKind::Safetensors);
    let misplaced = match () {
        () if options != EventOptions::default() && !is_recording => "options after '?' apply to recordings of events",
        () if *reading != Reading::default() && is_data => "--dt, --from and --reset apply to models",
        () => "",
    };
    if !misplaced.is_empty() {
        return Err(Diagnostic::new("input.option", format!("{misplaced}, and this is {kind}")).in_file(path));
    }
    match kind {
        FileKind::Folder => inspect_folder(path, &options),
        FileKind::Npy => inspect_npy(path),
        FileKind::SpikeList => inspect_csv(path),
        // Models, targets and other descriptions: the text says which.
        FileKind::Ron | FileKind::Stream => inspect_ron(text::read_text(path)?, Origin::File, reading),
        FileKind::Events(format) => foreign::recording(path, format, &options),
        FileKind::Safetensors => inspect_safetensors(path),
        kind => foreign::model(path, kind, reading),
    }
}

fn inspect_shipped(name: &str, reading: &Reading) -> Result<Findings, Diagnostic> {
    let tables =
        [shipped::MODELS, shipped::TARGETS, shipped::CHIPS, shipped::CONSTANTS, shipped::SCENARIOS, shipped::BASELINES];
    for table in tables {
        if let Some(found) = shipped::Shipped::find(table, name) {
            return inspect_ron(found.source(), Origin::Shipped, reading);
        }
    }
    let names: BTreeSet<&str> = tables.into_iter().flatten().map(|shipped| shipped.name).collect();
    let names: Vec<&str> = names.into_iter().collect();
    Err(Diagnostic::new("inspect.unknown", format!("there is no file and no shipped file named '{name}'"))
        .help(format!("shipped are: {}", names.join(", "))))
}

fn inspect_ron(source: SourceText, origin: Origin, reading: &Reading) -> Result<Findings, Diagnostic> {
    match root_name(source.text()) {
        "Network" => Ok(network_findings(&model::check_reading(model::network(source, origin)?, reading)?)),
        "Target" => Ok(target_findings(&target::target(&source, origin)?)),
        "Chip" => Ok(chip_findings(&target::parse_chip(&source)?)),
        "Constants" => Ok(constants_findings(&target::parse_constants(&source)?)),
        "Baseline" => Ok(baseline_findings(&Baseline::parse(&source)?)),
        "Scenario" => Ok(scenario_findings(&scenario::scenario(&source)?)),
        "Mapping" => {
            let mapping = mapping(&source)?;
            check_unchanged(&mapping).map_err(|problem| problem.in_file(source.path()))?;
            Ok(mapping_findings(&mapping))
        }
        "DataSet" => Ok(dataset_findings(&manifest::from_source(source)?)),
        other => {
            let message = match other {
                "" => "the type at the beginning of the file is missing".to_string(),
                other => format!("'{other}' is not a kind of file of nsim"),
            };
            let begins = "Network(, Target(, Chip(, Constants(, Baseline(, Scenario(, Mapping( or DataSet(";
            let help = format!("a .ron file begins with {begins}");
            Err(Diagnostic::new("inspect.kind", message).help(help).in_file(source.path()))
        }
    }
}

fn mapping_findings(mapping: &MappingFile) -> Findings {
    let rows = mapping.cores.iter().map(|core| {
        let compartments: u64 = core.holds.iter().map(|run| u64::from(run.count)).sum();
        let run =
            |run: &Run| format!("{}[{}..{}]", run.population, run.first, u64::from(run.first) + u64::from(run.count));
        let holds: Vec<String> = core.holds.iter().map(run).collect();
        json!([core.chip, core.x, core.y, core.core, compartments, holds.join(" ")])
    });
    let boxed = mapping.layers.iter().map(|layer| {
        let chips: BTreeSet<u32> = layer.places.iter().map(|on| on.chip).collect();
        let (channels, rows, columns) = layer.size;
        let size = format!("{channels} x {rows} x {columns}");
        json!([layer.population, size, layer.places().count(), chips.len()])
    });
    let chips: BTreeSet<u32> =
        mapping.cores.iter().map(|core| core.chip).chain(mapping.places().map(|(chip, _)| chip)).collect();
    let table = if mapping.layers.is_empty() {
        FindingsTable::new("cores", &["chip", "x", "y", "core", "compartments", "holds"], rows)
    } else {
        FindingsTable::new("layers", &["population", "box", "cores", "chips"], boxed)
    };
    Findings {
        kind: "mapping",
        facts: vec![
            ("model", json!(mapping.model)),
            ("target", json!(mapping.target)),
            ("copies", json!(mapping.copies)),
            ("strategy", json!(mapping.strategy)),
            ("seed", json!(mapping.seed)),
            ("pruned", mapping.pruned.as_ref().map_or(json!("none"), pruning_text)),
            ("cores_used", json!(mapping.cores.len() + mapping.places().count())),
            ("chips_used", json!(chips.len())),
        ],
        tables: vec![table],
    }
}

/// Pruning of a mapping, as text: for its input spikes, or static.
fn pruning_text(pruned: &PrunedFile) -> Value {
    let dead: u64 = pruned.dead.iter().map(|run| u64::from(run.count)).sum();
    match &pruned.stimulus {
        Some(stimulus) => json!(format!("for {}, which never fires {dead} channels", stimulus.join(" "))),
        None => json!("static"),
    }
}

fn labels_table(labels: impl Iterator<Item = Option<u32>>, names: &[String]) -> FindingsTable {
    let mut counts: BTreeMap<Option<u32>, u64> = BTreeMap::new();
    for label in labels {
        *counts.entry(label).or_default() += 1;
    }
    let row = |(label, count): (Option<u32>, u64)| {
        let name = label.and_then(|label| names.get(label as usize));
        json!([label, name, count])
    };
    FindingsTable::new("labels", &["label", "class", "samples"], counts.into_iter().map(row))
}

fn dataset_findings(manifest: &spikes::Manifest) -> Findings {
    let set = manifest.set();
    let folds: Vec<usize> = set.folds.iter().map(|fold| fold.value.len()).collect();
    Findings {
        kind: "dataset",
        facts: vec![
            ("name", json!(set.name)),
            ("samples", json!(set.samples.len())),
            ("steps", json!(set.steps)),
            ("populations", json!(set.populations.values().collect::<Vec<_>>())),
            ("classes", json!(set.classes)),
            ("recordings", json!(set.recordings.values().map(|file| &file.value).collect::<Vec<_>>())),
            ("fold_sizes", json!(folds)),
            ("splits", json!(set.splits.len())),
            ("seed", json!(set.seed)),
            ("provenance", json!(set.provenance)),
        ],
        tables: vec![labels_table(set.samples.iter().map(|sample| sample.value.label), &set.classes)],
    }
}

fn inspect_npy(path: &Path) -> Result<Findings, Diagnostic> {
    let array = npy::open(path)?;
    let (dtype, tensor) = (array.dtype(), array.tensor()?);
    let (least, greatest) = (tensor.reals().reduce(f64::min), tensor.reals().reduce(f64::max));
    let non_zero = tensor.reals().filter(|&x| x != 0.0).count();
    let density = (!tensor.is_empty()).then(|| non_zero as f64 / tensor.len() as f64);
    Ok(Findings {
        kind: "npy",
        facts: vec![
            ("shape", json!(array.shape())),
            ("dtype", json!(dtype)),
            ("numbers", json!(tensor.len())),
            ("min", json!(least.map(number))),
            ("max", json!(greatest.map(number))),
            // Arrays with fractions hold no spikes.
            ("spikes", json!(tensor.reals().all(|x| x.fract() == 0.0).then_some(non_zero))),
            ("density", json!(density)),
        ],
        tables: Vec::new(),
    })
}

fn inspect_safetensors(path: &Path) -> Result<Findings, Diagnostic> {
    let entries = safetensors::open(path)?.entries()?;
    let rows = entries.iter().map(|entry| json!([entry.key, entry.dtype, entry.shape]));
    Ok(Findings {
        kind: "safetensors",
        facts: vec![("tensor_count", json!(entries.len()))],
        tables: vec![FindingsTable::new("tensors", &["key", "dtype", "shape"], rows)],
    })
}

fn inspect_csv(path: &Path) -> Result<Findings, Diagnostic> {
    let samples = spikes::csv::read(path, 1 << 32)?;
    let events = || samples.iter().flat_map(|sample| &sample.events);
    Ok(Findings {
        kind: "events",
        facts: vec![
            ("samples", json!(samples.len())),
            ("steps", json!(samples.first().map(|sample| sample.steps))),
            ("spikes", json!(events().count())),
            ("highest_channel", json!(events().map(|event| event.1).max())),
            ("label", json!(samples.first().and_then(|sample| sample.label))),
        ],
        tables: Vec::new(),
    })
}

fn inspect_folder(path: &Path, options: &EventOptions) -> Result<Findings, Diagnostic> {
    let listed = spikes::list_folder(path)?;
    let (mut spikes, mut places, mut events) = (0u64, 0u64, 0u64);
    let mut shapes: Vec<Vec<usize>> = Vec::new();
    for (_, _, file) in &listed {
        // The number of spikes in a recording of events depends on the options of a run.
        if let FileKind::Events(format) = FileKind::detect(file)? {
            events += foreign::events(file, format, options)?;
            continue;
        }
        let array = npy::open(file)?;
        array.each_non_zero(|_, _| {
            spikes += 1;
            Ok(())
        })?;
        places += array.shape().iter().product::<usize>() as u64;
        if !shapes.iter().any(|shape| shape == array.shape()) {
            shapes.push(array.shape().to_vec());
        }
    }
    let steps: BTreeSet<usize> = shapes.iter().filter_map(|shape| shape.last().copied()).collect();
    let arrays = !shapes.is_empty();
    let mut facts = vec![
        ("samples", json!(listed.len())),
        ("shapes", json!(shapes)),
        ("steps", json!(steps)),
        ("spikes", json!(arrays.then_some(spikes))),
        ("density", json!((places > 0).then(|| spikes as f64 / places as f64))),
    ];
    if events > 0 || !arrays {
        facts.push(("events", json!(events)));
    }
    Ok(Findings {
        kind: "recordings",
        facts,
        tables: vec![labels_table(listed.iter().map(|(_, label, _)| *label), &[])],
    })
}

#[cfg(test)]
mod tests {
    use crate::cli::inspect::*;

    fn findings(name: &str, bytes: &[u8]) -> Result<Findings, Diagnostic> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        inspect(path.to_str().unwrap(), &Reading::default())
    }

    fn object(findings: &Findings) -> Value {
        findings.json("nsim.inspect/1", "f")
    }

    const MODEL: &str = r#"/* a */ // b
Network(name: "m", timestep_ms: 1.0,
    populations: [
        Input(name: "in", shape: [2, 4, 4]),
        Loihi(name: "conv", shape: [3, 2, 2], du: 1, dv: [1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1], vth_mant: 1),
        Loihi(name: "pool", shape: [2, 2, 2]),
        Loihi(name: "out", shape: [2]),
    ],
    projections: [
        Conv2d(from: ["in"], to: "conv", stride: (2, 2), padding: (1, 1), weights: [
            [[[1, 1, 1], [1, 1, 1], [1, 1, 1]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]]],
            [[[1, 1, 1], [1, 1, 1], [1, 1, 1]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]]],
            [[[1, 1, 1], [1, 1, 1], [1, 1, 1]], [[1, 1, 1], [1, 1, 1], [1, 1, 1]]],
        ]),
        SumPool2d(from: ["in"], to: "pool", kernel: (2, 2), weight: 1),
        Dense(from: ["conv", "pool"], to: "out", weights: Uniform(low: -1, high: 1, seed: 1), delay: 2),
        Random(from: ["out"], to: "out", fan_out: 3, low: -2, high: 2, seed: 1),
    ],
    output: "out",
)"#;

    #[test]
    fn a_model_is_counted_without_being_compiled() {
        let found = findings("m.ron", MODEL.as_bytes()).unwrap();
        let object = object(&found);
        // Windows of 3 places start at -1 and 1 on an axis of 4. The first loses one place: 2 + 3
        // on each axis.
        let counts: Vec<_> = object["projections"].as_array().unwrap().iter().map(|p| p["synapses"].as_u64()).collect();
        assert_eq!(counts, [Some(3 * 2 * 5 * 5), Some(2 * 4 * 4), Some(20 * 2), Some(6)]);
        assert_eq!((&object["synapses"], &object["kind"]), (&json!(150 + 32 + 40 + 6), &json!("model")));
        assert_eq!(object["populations"][1]["parameters"], "du 1, dv each, vth_mant 1");
        assert!(found.text("m").contains("conv + pool"), "{}", found.text("m"));
        assert!(found.csv().starts_with("name,kind,shape,units,parameters\nin,input,\"[2, 4, 4]\",32,\n"));
    }

    #[test]
    fn rules_are_listed() {
        let rule = r#"delay: 2, learning: Rule(dw: "x0", dt: "x1*y0", epoch: 4)"#;
        let object = object(&findings("m.ron", MODEL.replace("delay: 2", rule).as_bytes()).unwrap());
        let [name, changes] = ["conv+pool->out", "dw x0; dt x1*y0"];
        assert_eq!(object["rules"], json!([{"name": name, "changes": changes, "epoch": 4}]));
    }

    #[test]
    fn shapes_beyond_all_measure_have_no_count() {
        let text = MODEL.replace("[2, 2, 2]", "[2, 9999999999, 9999999999]").replace("[2]", "[18446744073709551615]");
        let object = object(&findings("m.ron", text.as_bytes()).unwrap());
        assert_eq!((&object["synapses"], &object["projections"][2]["synapses"]), (&Value::Null, &Value::Null));
    }

    #[test]
    fn arrays_events_and_folders_are_described() {
        let mut bytes = Vec::new();
        npy::write(&mut bytes, &[2, 2], [0, -3, 0, 9]).unwrap();
        let array = object(&findings("a.npy", &bytes).unwrap());
        assert_eq!((&array["shape"], &array["dtype"]), (&json!([2, 2]), &json!("<i4")));
        assert_eq!((&array["min"], &array["max"], &array["spikes"]), (&json!(-3), &json!(9), &json!(2)));
        let events = findings("e.csv", b"# steps: 9\n3,77\n").unwrap();
        assert_eq!(events.csv().lines().nth(4).unwrap(), "highest_channel,77");
        let folder = tempfile::tempdir().unwrap();
        for name in ["sample_0_label_1.npy", "sample_1_label_1.npy"] {
            std::fs::write(folder.path().join(name), &bytes).unwrap();
        }
        let folder = object(&inspect(folder.path().to_str().unwrap(), &Reading::default()).unwrap());
        assert_eq!((&folder["spikes"], folder.get("events")), (&json!(4), None));
        assert_eq!(
            (&folder["density"], &folder["labels"]),
            (&json!(0.5), &json!([{"label": 1, "class": null, "samples": 2}]))
        );
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.bin", "b.bin"] {
            std::fs::write(folder.path().join(name), [3, 4, 0x80, 0, 9, 5, 6, 0, 1, 0]).unwrap();
        }
        let folder = object(&inspect(folder.path().to_str().unwrap(), &Reading::default()).unwrap());
        assert_eq!((&folder["spikes"], &folder["events"]), (&Value::Null, &json!(4)));
    }

    #[test]
    fn a_shipped_target_shows_each_constant_with_unit_source_and_status() {
        let object = object(&inspect("nahuku-32", &Reading::default()).unwrap());
        assert_eq!((&object["kind"], &object["chips"], &object["cores"]), (&json!("target"), &json!(32), &json!(4096)));
        let constants = object["constants"].as_array().unwrap();
        for preset in ["davies2018", "sanafe-calibrated"] {
            let of = constants.iter().filter(|constant| constant["preset"] == preset);
            // 28 fields, and at least one barrier time.
            assert!(of.clone().count() > 28, "{preset}");
            assert!(
                of.into_iter().all(|c| c["unit"].is_string() && c["source"].is_string() && c["status"].is_string())
            );
        }
        assert_eq!(object["limits"].as_array().unwrap().len(), 17);
    }

    #[test]
    fn a_mapping_is_listed_by_core() {
        let text = r#"Mapping(model: "m", target: "t", copies: 1, strategy: "s", seed: 1, cores: [
            (chip: 2, x: 0, y: 0, core: 1, holds: [(population: "a", first: 4294967295, count: 4294967295)])])"#;
        let object = object(&findings("m.ron", text.as_bytes()).unwrap());
        assert_eq!(
            (&object["chips_used"], &object["cores"][0]["compartments"]),
            (&json!(1), &json!(4_294_967_295_u32))
        );
    }

    #[test]
    fn what_is_not_known_is_said() {
        assert_eq!(findings("a.ron", b"Zoo()").err().unwrap().code, "inspect.kind");
        assert_eq!(findings("a.ron", b"/* x").err().unwrap().code, "inspect.kind");
        assert_eq!(findings("a.xyz", b"").err().unwrap().code, "inspect.kind");
        assert_eq!(inspect("./absent.xyz", &Reading::default()).err().unwrap().code, "io.missing");
        assert_eq!(inspect("absent", &Reading::default()).err().unwrap().code, "inspect.unknown");
    }
}
