//! Foreign files: files of peers give their contents, round trips lose nothing, and damaged files
//! are refused within a bound on memory.
//!
//! The files of `tests/fuzz/corpus` were made by h5py 3.16, nir 1.0.8, expelliarmus 1.1.12 and
//! dv-processing 2.0.4 from random numbers (headers shortened); the checkpoints by hand, as torch's
//! `serialization.py` writes them.

use crate::common;
use crate::memory;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use nsim::files::network::{NetworkFile, Parameter, PopulationDesc, ProjectionDesc, ProjectionKind, tensor};
use nsim::import::foreign;
use nsim::import::foreign::{Options, Reading, nir_export};
use nsim::import::fuzz_entry;
use nsim::import::hdf5;
use nsim::import::hdf5::{Item, Numbers};
use nsim::import::model::load_model;
use nsim::import::spikes::events::event::{Counts, Event, Sink};
use nsim::import::spikes::events::{nir_data, read as events};
use nsim::import::spikes::{EventFormat, EventOptions, InputSpec, read_source, read_spikes};
use nsim::ir::arithmetic::{ResetDesc, Semantics, ThresholdTest};
use nsim::ir::base::rng;
use proptest::prelude::*;

/// Bound on the memory for any file: 96 MiB and 32 times its size.
const FIXED_KIB: u64 = 96 << 10;
const RATIO: u64 = 32;

fn corpus() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fuzz/corpus")
}

type Target = fn(&[u8]);
const TARGETS: [(&str, Target); 5] = [
    ("hdf5", fuzz_entry::hdf5),
    ("checkpoint", fuzz_entry::checkpoint),
    ("yaml", fuzz_entry::yaml),
    ("events", fuzz_entry::events),
    ("arrays", fuzz_entry::arrays),
];

fn files(target: &str) -> Vec<(String, Vec<u8>)> {
    let mut files: Vec<_> = std::fs::read_dir(corpus().join(target))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap()))
        .collect();
    files.sort();
    assert!(files.len() >= 3, "{target}");
    files
}

/// A file damaged by a few changes that a seed determines.
fn damaged(bytes: &[u8], seed: u64) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let draw = |i: u64, below: usize| rng::below(below.max(1) as u64, seed, i, 1) as usize;
    for change in 0..=draw(0, 4) as u64 {
        let at = draw(10 * change + 1, bytes.len());
        match draw(10 * change + 2, 5) {
            0 => bytes.truncate(at),
            1 if at < bytes.len() => bytes[at] ^= 1 << draw(10 * change + 3, 8),
            2 if at < bytes.len() => bytes[at] = [0, 0xff, 0x7f, 0x80][draw(10 * change + 3, 4)],
            3 if at + 8 <= bytes.len() => {
                let number = [u64::MAX, 1 << 62, 1 << 31, 0][draw(10 * change + 3, 4)];
                bytes[at..at + 8].copy_from_slice(&number.to_le_bytes());
            }
            _ => {
                let end = (at + draw(10 * change + 3, 64)).min(bytes.len());
                let copy = bytes[at.min(end)..end].to_vec();
                bytes.splice(at..at, copy);
            }
        }
        if bytes.is_empty() {
            break;
        }
    }
    bytes
}

#[test]
fn corpora_and_damaged_files_neither_panic_nor_take_memory_beyond_the_bound() {
    memory::alone(
        module_path!(),
        "corpora_and_damaged_files_neither_panic_nor_take_memory_beyond_the_bound",
        |growth| {
            // `NSIM_FUZZ_FACTOR=15` runs more rounds than suit a test, for a minute or two.
            let factor = std::env::var("NSIM_FUZZ_FACTOR").map_or(1, |factor| factor.parse().unwrap());
            let mut largest = 0;
            for (target, run) in TARGETS {
                for (name, bytes) in files(target) {
                    largest = largest.max(bytes.len() as u64);
                    run(&bytes);
                    // Large files are slow to read in a test build.
                    let changes = factor * if bytes.len() > 20_000 { 40 } else { 400 };
                    for seed in 0..changes {
                        run(&damaged(&bytes, seed ^ (name.len() as u64) << 32));
                    }
                }
            }
            let bound = FIXED_KIB + RATIO * largest / 1024;
            assert!(growth.kib().is_none_or(|grown| grown <= bound), "the bound is {bound} KiB");
        },
    );
}

#[test]
fn a_small_file_that_claims_much_is_refused_before_it_is_unpacked() {
    memory::alone(module_path!(), "a_small_file_that_claims_much_is_refused_before_it_is_unpacked", |growth| {
        // Zeros compress by a factor of a thousand: 40 MiB exceed the decoded size of a small file.
        let path = PathBuf::from("bomb.net");
        let mut file = hdf5_pure::FileBuilder::new();
        let zeros = vec![0.0f64; 5 << 20];
        file.create_dataset("zeros")
            .with_f64_data(&zeros)
            .with_shape(&[5 << 20])
            .with_chunks(&[1 << 16])
            .with_deflate(9);
        drop(zeros);
        let bytes = file.finish().unwrap();
        assert!(bytes.len() < 1 << 20, "{} bytes", bytes.len());
        let error = foreign::from_bytes(&path, bytes, &Options::default()).unwrap_err();
        assert_eq!(error.code, "hdf5.too-large", "{error}");
        // A shape larger than the stored weights.
        let layer = hdf5::Group::default()
            .with("type", "dense")
            .with("shape", Numbers::i64(&[3], &[1 << 20, 1 << 20, 1 << 20]))
            .with("weight", Numbers::f32(&[1, 1], &[2.0]));
        let root = hdf5::Group::default().with("layer", hdf5::Group::default().with("0", layer));
        let error = foreign::from_bytes(&path, hdf5::write(&root).unwrap(), &Options::default()).unwrap_err();
        assert!(error.code.starts_with("import."), "{error}");
        assert!(growth.kib().is_none_or(|grown| grown < FIXED_KIB), "the bound is {FIXED_KIB} KiB");
    });
}

/// A sink that keeps every event.
#[derive(Default)]
struct All(Vec<(i64, u32, u32, bool)>, Counts);

impl Sink for All {
    fn size(&mut self, columns: u32, rows: u32) {
        assert_eq!((columns, rows), (16, 16));
    }

    fn event(&mut self, event: Event) -> Result<(), nsim::ir::base::diagnostic::Diagnostic> {
        self.0.push((event.t_us, event.x, event.y, event.on));
        Ok(())
    }

    fn counts(&mut self) -> &mut Counts {
        &mut self.1
    }
}

/// The events in all recordings of the corpus.
fn recorded() -> Vec<(i64, u32, u32, bool)> {
    let text = std::fs::read_to_string(corpus().join("../events.csv")).unwrap();
    text.lines()
        .skip(1)
        .map(|line| {
            let n: Vec<i64> = line.split(',').map(|field| field.parse().unwrap()).collect();
            (n[0], n[1] as u32, n[2] as u32, n[3] == 1)
        })
        .collect()
}

#[test]
fn recordings_that_peers_wrote_hold_what_they_wrote() {
    let expected = recorded();
    assert_eq!(expected.len(), 40);
    for (name, format) in [
        ("dat", EventFormat::Dat),
        ("evt2", EventFormat::Raw),
        ("evt3", EventFormat::Raw),
        ("aedat4_lz4", EventFormat::Aedat4),
        ("aedat4_zstd", EventFormat::Aedat4),
        ("aedat4_none", EventFormat::Aedat4),
        ("bs2", EventFormat::Bs2),
    ] {
        let bytes = std::fs::read(corpus().join("events").join(name)).unwrap();
        let mut all = All::default();
        events::decode(format, &EventOptions::default(), &mut &bytes[1..], &mut all)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        // Simultaneous events have no order in a vector of EVT3, whose writer omitted high halves
        // of the time; the file has them.
        let sorted = |mut events: Vec<_>| {
            events.sort_unstable();
            events
        };
        assert_eq!(sorted(all.0), sorted(expected.clone()), "{name}");
    }
    // One-dimensional: channels without rows; cells of a finger, where two of eighty are absent.
    let flat = |name: &str, format| {
        let bytes = std::fs::read(corpus().join("events").join(name)).unwrap();
        let mut all = All::default();
        events::decode(format, &EventOptions::default(), &mut &bytes[1..], &mut all).unwrap();
        all.0
    };
    let line: Vec<_> = expected.iter().map(|&(t, x, _, on)| (t, x, 0, on)).collect();
    assert_eq!(flat("bs1", EventFormat::Bs1), line);
    let taxels: Vec<_> =
        line.iter().filter(|e| e.1 != 7).map(|&(t, x, _, on)| (t, x + 9 - u32::from(x > 7), 0, on)).collect();
    assert_eq!(flat("tact", EventFormat::Tact), taxels);
    assert_eq!(flat("tact4", EventFormat::Tact), taxels);
}

#[test]
fn crop_pool_bins_and_polarities_follow_their_definition() {
    let recorded = recorded();
    let bytes = std::fs::read(corpus().join("events/aedat4_zstd")).unwrap();
    let read = |expected: InputSpec, query: &[(&str, &str)]| {
        let pairs: Vec<_> = query.iter().map(|(k, v)| ((*k).to_string(), (*v).to_string())).collect();
        let options = EventOptions::parse(&pairs).unwrap();
        events::read_input(&mut &bytes[1..], "x", EventFormat::Aedat4, &expected, &options)
    };
    let expected = |units| InputSpec { units, volume: None, dt_ms: 1.0, values: false };
    let first = recorded[0].0;
    let (all, counts) = read(expected(512), &[]).unwrap();
    let mut wanted: Vec<(u32, u32)> = recorded
        .iter()
        .map(|&(t, x, y, on)| (((t - first) / 1000) as u32, (u32::from(on) * 16 + y) * 16 + x))
        .collect();
    wanted.sort_unstable();
    wanted.dedup();
    assert_eq!((counts.events, counts.dropped, counts.disordered), (40, 0, 0));
    assert_eq!(counts.merged, 40 - wanted.len() as u64);
    assert_eq!(all.events, wanted);
    // A part of the sensor, two by two pixels, 2 ms, one polarity.
    let query =
        [("crop", "2,4,8,6"), ("pool", "2"), ("bin_ms", "2"), ("polarity", "merge"), ("steps", "5"), ("start_ms", "6")];
    let (part, counts) = read(expected(12), &query).unwrap();
    let inside = |&&(t, x, y, _): &&(i64, u32, u32, bool)| {
        (2..10).contains(&x) && (4..10).contains(&y) && (6000..16_000).contains(&t)
    };
    let mut wanted: Vec<(u32, u32)> = recorded
        .iter()
        .filter(inside)
        .map(|&(t, x, y, _)| (((t - 6000) / 2000) as u32, (y - 4) / 2 * 4 + (x - 2) / 2))
        .collect();
    assert_eq!(counts.dropped, 40 - wanted.len() as u64);
    wanted.sort_unstable();
    wanted.dedup();
    assert_eq!((part.steps, part.events), (5, wanted));
    // A recording that does not fit is refused, with the number of its channels.
    let error = read(expected(100), &[]).unwrap_err();
    assert!(error.code == "input.shape" && error.message.contains("512 channels"), "{error}");
    assert!(EventOptions::parse(&[("crop".into(), "1,2".into())]).is_err());
    assert!(EventOptions::parse(&[("what".into(), "1".into())]).unwrap_err().help.unwrap().contains("polarity"));
}

#[test]
fn a_million_events_take_the_memory_of_their_spikes() {
    memory::alone(module_path!(), "a_million_events_take_the_memory_of_their_spikes", |growth| {
        /// Two million events on sixteen pixels within a millisecond, generated during reading.
        struct Endless(u64);
        impl std::io::Read for Endless {
            fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
                let whole = (buffer.len() / 5).min((2_000_000 - self.0) as usize);
                for event in buffer.chunks_exact_mut(5).take(whole) {
                    let t = (self.0 % 1000) as u32;
                    event.copy_from_slice(&[
                        (self.0 % 4) as u8,
                        (self.0 / 4 % 4) as u8,
                        (t >> 16) as u8,
                        (t >> 8) as u8,
                        t as u8,
                    ]);
                    self.0 += 1;
                }
                Ok(whole * 5)
            }
        }
        let expected = InputSpec { units: 32, volume: Some((2, 4, 4)), dt_ms: 1.0, values: false };
        let mut input = std::io::BufReader::new(Endless(0));
        let options = EventOptions { steps: Some(1), ..EventOptions::default() };
        let (spikes, counts) = events::read_input(&mut input, "x", EventFormat::Bs2, &expected, &options).unwrap();
        assert_eq!((spikes.events.len(), counts.events, counts.merged), (16, 2_000_000, 1_999_984));
        assert!(counts.disordered > 1_900_000, "{counts:?}");
        assert!(growth.kib().is_none_or(|grown| grown < 16 << 10), "the bound is 16 MiB");
    });
}

#[test]
fn twenty_recordings_of_nmnist() {
    let Some(data) = common::data("events") else { return };
    for sample in 1..=20 {
        let path = data.join(format!("nmnist/{sample}.bs2"));
        let events = std::fs::metadata(&path).unwrap().len() / 5;
        let expected = InputSpec { units: 2312, volume: Some((2, 34, 34)), dt_ms: 1.0, values: false };
        let (spikes, counts) = events::read_file(&path, EventFormat::Bs2, &expected, &EventOptions::default()).unwrap();
        assert_eq!((counts.events, counts.dropped), (events, 0), "{sample}");
        assert!((250..=400).contains(&spikes.steps), "{sample}: {} steps", spikes.steps);
        assert_eq!(read_source(&path, 2312).unwrap()[0].events, spikes.events);
    }
}

#[test]
fn nir_data_is_read_in_both_kinds_and_written_back() {
    for name in ["nir_events", "nir_grid"] {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.nir");
        std::fs::copy(corpus().join("hdf5").join(name), &path).unwrap();
        let expected = InputSpec { units: 3, volume: None, dt_ms: 1.0, values: false };
        let samples = read_spikes(&path, "in", &expected, &EventOptions::default()).unwrap();
        let events: Vec<_> = samples.iter().map(|s| (s.steps, s.events.clone())).collect();
        assert_eq!(events, [(10, vec![(1, 2), (4, 0)]), (10, vec![(9, 1)])], "{name}");
        let ours = nir_data::events(&[events[0].1.clone(), events[1].1.clone()], 3, 10, 1e-3);
        let bytes = hdf5::write(&nir_data::file("in", "spikes", ours)).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let again = read_spikes(&path, "in", &expected, &EventOptions::default()).unwrap();
        assert_eq!(again[0].events, events[0].1);
        assert_eq!(again[1].events, events[1].1);
    }
}

/// Shape and numbers of each array, by its path; texts as their lengths and bytes.
type Arrays = BTreeMap<String, (Vec<usize>, Vec<f64>)>;

fn text_numbers(texts: &[String]) -> Vec<f64> {
    texts.iter().flat_map(|text| text.bytes().chain([0]).map(f64::from)).collect()
}

fn arrays_of_tree(group: &hdf5::Group, path: &str, found: &mut Arrays) {
    for (name, item) in &group.items {
        let path = format!("{path}/{name}");
        match item {
            Item::Group(group) => arrays_of_tree(group, &path, found),
            Item::Numbers(numbers) => drop(found.insert(path, (numbers.shape().to_vec(), numbers.reals().collect()))),
            Item::Texts(shape, texts) => drop(found.insert(path, (shape.clone(), text_numbers(texts)))),
            Item::Other(_) => {}
        }
    }
}

/// The arrays of a file, read by another crate.
fn arrays_of_another_reader(group: &hdf5_reader::group::Group, path: &str, found: &mut Arrays) {
    use hdf5_reader::Datatype::{Enum, FixedPoint, FloatingPoint, String, VarLen};
    let (groups, datasets) = group.members().unwrap();
    for child in &groups {
        arrays_of_another_reader(child, &format!("{path}/{}", child.name()), found);
    }
    for dataset in &datasets {
        let shape: Vec<usize> = dataset.shape().iter().map(|&axis| axis as usize).collect();
        let bytes = || dataset.read_native_bytes().unwrap();
        let dtype = if let Enum { base, .. } = dataset.dtype() { base } else { dataset.dtype() };
        let numbers = match dtype {
            FloatingPoint { size: 4, .. } => {
                bytes().chunks_exact(4).map(|b| f32::from_ne_bytes(b.try_into().unwrap()).into()).collect()
            }
            FloatingPoint { size: 8, .. } => {
                bytes().chunks_exact(8).map(|b| f64::from_ne_bytes(b.try_into().unwrap())).collect()
            }
            FixedPoint { size: 1, signed: true, .. } => bytes().iter().map(|&b| f64::from(b as i8)).collect(),
            FixedPoint { size: 1, .. } => bytes().iter().map(|&b| f64::from(b)).collect(),
            FixedPoint { size: 4, .. } => {
                bytes().chunks_exact(4).map(|b| i32::from_ne_bytes(b.try_into().unwrap()).into()).collect()
            }
            FixedPoint { size: 8, .. } => {
                bytes().chunks_exact(8).map(|b| i64::from_ne_bytes(b.try_into().unwrap()) as f64).collect()
            }
            String { .. } | VarLen { .. } => text_numbers(&dataset.read_strings().unwrap()),
            _ => continue,
        };
        found.insert(format!("{path}/{}", dataset.name()), (shape, numbers));
    }
}

/// nsim reads and writes HDF5 by one crate; another reads equal arrays from the files of peers and
/// from nsim's own.
#[test]
fn another_hdf5_reader_finds_the_same_arrays() {
    let written = hdf5::Group::default()
        .with("real", Numbers::f64(&[2, 2], &[0.0, -1.5, 1e300, f64::INFINITY]))
        .with("single", Numbers::f32(&[3], &[0.5, -0.25, 7.0]))
        .with("whole", Numbers::i64(&[], &[-7]))
        .with("empty", Numbers::f64(&[0, 3], &[]))
        .with("inner", hdf5::Group::default().with("type", "dense").with("deep", Numbers::i64(&[2], &[1, i64::MAX])));
    let mut compared = 0;
    for (name, bytes) in files("hdf5").into_iter().chain([("written".to_string(), hdf5::write(&written).unwrap())]) {
        let Ok(tree) = hdf5::tree(Path::new(&name), bytes.clone()) else { continue };
        let (mut ours, mut theirs) = (Arrays::new(), Arrays::new());
        arrays_of_tree(&tree, "", &mut ours);
        let file = hdf5_reader::Hdf5File::from_vec(bytes).unwrap();
        arrays_of_another_reader(&file.root_group().unwrap(), "", &mut theirs);
        assert_eq!(ours, theirs, "{name}");
        compared += 1;
    }
    assert!(compared >= 8, "{compared} files");
}

/// Reads the files that `tests/layouts/make.py` wrote.
#[test]
fn layouts_and_links_of_hdf5_are_read_or_refused_by_their_names() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/layouts");
    let read = |name: &str| {
        let bytes = std::fs::read(folder.join(name)).unwrap();
        foreign::from_bytes(
            Path::new(name),
            bytes,
            &Options { reading: Reading { dt_ms: Some(1.0), ..Reading::default() }, ..Options::default() },
        )
    };
    let weights = |name: &str| match &read(name).unwrap().model.projections[0].kind {
        ProjectionKind::Dense(weights) => weights.tensor().reals().collect::<Vec<_>>(),
        _ => panic!("{name}"),
    };
    for name in ["nir_float16", "nir_float16_big_endian", "nir_bfloat16"] {
        assert_eq!(weights(name), [0.5, -0.25, 1.5, 3.0], "{name}");
    }
    for name in ["chunks_implicit", "chunks_extensible"] {
        assert_eq!(weights(name), [2.0, 4.0, 6.0, 8.0], "{name}");
    }
    for (name, code, says) in [
        ("layout_5", "hdf5.format", "weight: HDF5 format error: invalid data layout version: 5"),
        ("chunks_b_tree_2", "hdf5.format", "a version 2 B-tree chunk index"),
        ("virtual", "hdf5.format", "virtual (VDS) data layout"),
        ("soft_weight", "hdf5.link", "a soft link"),
        ("soft_bias", "hdf5.link", "'bias' is a soft link to '/elsewhere'"),
        ("external_bias", "hdf5.link", "'bias' is a link to '/bias' of another file, 'other.h5'"),
        ("external_bias_latest", "hdf5.link", "'bias' is a link to '/bias' of another file, 'other.h5'"),
    ] {
        let error = read(name).unwrap_err();
        assert!(error.code == code && error.message.contains(says), "{name}: {error}");
        assert!(error.help.unwrap().contains("python3 -c"), "{name}");
    }
}

#[test]
fn what_is_known_and_not_imported_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let read = |name: &str, bytes: &[u8]| {
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let error = foreign::read(&path, &Options::default()).unwrap_err();
        assert_eq!(error.file(), Some(path.as_path()), "{error}");
        (error.code, format!("{} {}", error.message, error.help.unwrap_or_default()))
    };
    let of = |target: &str, name: &str| std::fs::read(corpus().join(target).join(name)).unwrap();
    let lfs = format!("version https://git-lfs.github.com/spec/v1\noid sha256:{}\nsize 12345\n", "4d".repeat(32));
    for (file, bytes, code, says) in [
        ("a.net", lfs.as_bytes().to_vec(), "io.lfs-pointer", "git lfs pull"),
        ("b.net", b"g 3 threshold=1\nn 0.0 bias=2\ne 0.0->0.1 w=1\n".to_vec(), "import.sanafe", "SANA-FE"),
        ("c.pt", of("checkpoint", "module"), "import.pickle", "models.Net"),
        ("d.net", of("hdf5", "no_network"), "import.not-a-network", "holds no network"),
        ("e.net", of("hdf5", "netx_alif"), "import.netx", "thDecay"),
        ("f.yml", of("yaml", "loihi"), "import.kind", "--neuron"),
        ("g.pt", of("checkpoint", "zip"), "import.option", "--neuron"),
        ("h.net", Vec::new(), "import.kind", "empty"),
    ] {
        let (found, said) = read(file, &bytes);
        assert!(found == code && said.contains(says), "{file}: {found}: {said}");
    }
}

#[test]
fn every_layer_of_netx_and_every_node_of_nir_becomes_a_network() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options { reading: Reading { dt_ms: None, ..Reading::default() }, ..Options::default() };
    for (name, synapses) in [
        (
            "netx_every_layer",
            vec!["Conv2d", "Sparse", "Sparse", "Sparse", "Sparse", "Dense", "Dense", "Dense", "Sparse"],
        ),
        ("netx_latest", vec!["Conv2d", "Sparse", "Sparse", "Sparse", "Sparse", "Dense", "Dense", "Dense", "Sparse"]),
        ("nir_recurrent", vec!["Dense", "Dense", "Dense", "Dense"]),
        ("nir_conv", vec!["Conv2d", "Conv2d", "Dense"]),
    ] {
        let path = folder.path().join(format!("{name}.net"));
        std::fs::copy(corpus().join("hdf5").join(name), &path).unwrap();
        let network = load_model(path.to_str().unwrap()).unwrap_or_else(|error| panic!("{name}: {error}"));
        let kinds: Vec<&str> = network.file().projections.iter().map(ProjectionDesc::kind_name).collect();
        let mut sorted = (kinds.clone(), synapses.clone());
        sorted.0.sort_unstable();
        sorted.1.sort_unstable();
        assert_eq!(sorted.0, sorted.1, "{name}: {kinds:?}");
        let graph = nsim::files::lower::lower(&network);
        if name.starts_with("netx") {
            // Its layer without a neuron never spikes, and a layer follows it.
            let error = graph.unwrap_err();
            assert!(error.code == "model.cannot-send" && error.message.contains("'layer6'"), "{name}: {error}");
            continue;
        }
        let graph = graph.unwrap_or_else(|error| panic!("{name}: {error}"));
        nsim::quantise::quantise::quantise(&graph).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
    let imported = foreign::read(&folder.path().join("nir_recurrent.net"), &options).unwrap();
    let model = imported.model;
    assert!((model.timestep_ms - 0.1).abs() < 1e-12);
    // dt / tau_syn = 1/4 and dt / tau_mem = 1/16 of 4096; the delay of three steps; 'w_in' and 'r'
    // undo the scaling.
    let population = model.population("l").unwrap();
    assert_eq!(population.parameter("du"), Some(&Parameter::Same(1024.0)));
    assert_eq!(population.parameter("dv"), Some(&Parameter::Same(256.0)));
    assert_eq!(model.projections.iter().find(|p| p.to == "q").unwrap().delay, 3);
    for (name, dt) in [("nir_nested", Some(0.1)), ("nir_conv1d", Some(1.0))] {
        let bytes = std::fs::read(corpus().join("hdf5").join(name)).unwrap();
        let options = Options { reading: Reading { dt_ms: dt, ..Reading::default() }, ..Options::default() };
        let imported =
            foreign::from_bytes(Path::new("x.nir"), bytes, &options).unwrap_or_else(|e| panic!("{name}: {e}"));
        let network = imported.model.build(Path::new("x.nir")).unwrap();
        nsim::files::lower::lower(&network).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
}

/// Models of every kind of population and projection that a model file can have.
fn models() -> impl Strategy<Value = NetworkFile> {
    let real = || prop_oneof![Just(0.0), -1e3..1e3f64, Just(1.0 / 3.0), Just(-1e-300)];
    let whole = |low: i64, high: i64| (low..=high).prop_map(|x| x as f64);
    let each = move |n: usize| {
        (
            prop_oneof![
                whole(0, 4096).prop_map(Parameter::Same),
                prop::collection::vec(whole(0, 4096), n).prop_map(Parameter::Each)
            ],
            whole(0, 4096).prop_map(Parameter::Same),
            prop::option::of(whole(-4095, 4095)),
            0u32..4,
            1i64..63,
        )
    };
    (
        (each(12), each(20), prop::bool::ANY, prop::bool::ANY),
        prop::collection::vec(real(), 12 * 18),
        prop::collection::vec(whole(-128, 127).prop_map(|x| 2.0 * x), 20 * 30),
        prop::collection::vec((0u64..20, 0u64..20, -50.0..50.0f64), 0..9),
        (-8i64..=7, 0u32..63, prop::option::of(1u64..100), "[a-zA-Z \"\\\\µ\n]{0,12}"),
    )
        .prop_map(|((first, second, inclusive, lava), kernel, dense, synapses, (exponent, delay, reset, text))| {
            let mut model = NetworkFile::new(&text, 0.1);
            let parameters = |(du, dv, bias, _, refractory): (Parameter, Parameter, Option<f64>, u32, i64)| {
                let mut list = vec![("du", du), ("dv", dv), ("vth_mant", Parameter::Same(80.0))];
                if let Some(bias) = bias {
                    list.push(("bias_mant", Parameter::Same(bias)));
                    list.push(("bias_exp", Parameter::Same(3.0)));
                }
                list.push(("refractory", Parameter::Same(refractory as f64)));
                list
            };
            model.populations = vec![
                PopulationDesc::input("in", vec![2, 3, 3]),
                PopulationDesc { start_step: first.3, ..PopulationDesc::loihi("a", vec![3, 2, 2], parameters(first)) },
                PopulationDesc { start_step: second.3, ..PopulationDesc::loihi("b", vec![20], parameters(second)) },
            ];
            let conv = ProjectionKind::Conv2d {
                weights: tensor(vec![3, 2, 2, 2], kernel[..24].to_vec()),
                stride: (1, 1),
                padding: (0, 0),
                padding_after: (0, 0),
                dilation: (1, 1),
                groups: 1,
            };
            let joined = ProjectionDesc {
                from: vec!["in".into(), "a".into()],
                delay,
                weight_exp: Some(exponent),
                sign: None,
                ..ProjectionDesc::new("", "b", ProjectionKind::Dense(tensor(vec![20, 30], dense)))
            };
            model.projections = vec![
                ProjectionDesc { weight_scale: Some(2.5), ..ProjectionDesc::new("in", "a", conv) },
                joined,
                ProjectionDesc {
                    weight_scale: Some(1.0),
                    ..ProjectionDesc::new("b", "b", ProjectionKind::Sparse(synapses))
                },
            ];
            model.output = "b".to_string();
            model.reset = reset.map(|interval| ResetDesc { interval, offset: 2 });
            model.threshold = if inclusive { ThresholdTest::Inclusive } else { ThresholdTest::Strict };
            model.semantics = if lava { Semantics::Lava } else { Semantics::Hardware };
            model.provenance = Some(text);
            model
        })
}

/// Three models are equal: as imported, written and read again, and parsed from its text.
#[test]
fn every_imported_model_equals_the_one_that_is_read_from_its_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ron");
    let mut compared = 0;
    let layouts = std::fs::read_dir(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/layouts")).unwrap();
    let layouts = layouts.map(|entry| entry.unwrap().path()).filter(|path| path.is_file());
    let layouts = layouts.map(|path| (path.display().to_string(), std::fs::read(path).unwrap()));
    for (name, bytes) in ["hdf5", "checkpoint"].into_iter().flat_map(files).chain(layouts) {
        let options = Options { reading: Reading { dt_ms: Some(1.0), ..Reading::default() }, ..Options::default() };
        let Ok(imported) = foreign::from_bytes(Path::new(&name), bytes, &options) else { continue };
        let built = imported.model.build(&path).unwrap();
        assert_eq!(built.resolved().unwrap(), imported.model, "{name}");
        assert_eq!(&NetworkFile::parse(built.source()).unwrap(), built.file(), "{name}");
        imported.model.write(&path, true).unwrap();
        let read = load_model(path.to_str().unwrap()).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(read.resolved().unwrap(), imported.model, "{name}");
        compared += 1;
    }
    assert!(compared >= 8, "{compared} files");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn a_model_is_written_and_read_without_loss(model in models()) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("m.ron");
        model.write(&path, false).unwrap();
        let back = load_model(path.to_str().unwrap()).unwrap().resolved().unwrap();
        prop_assert_eq!(&back, &model);
    }

    #[test]
    fn a_model_is_exported_to_nir_and_read_back_without_loss(model in models()) {
        let (tree, _) = nir_export::export(&model).unwrap();
        let bytes = hdf5::write(&tree).unwrap();
        let back = foreign::from_bytes(Path::new("m.nir"), bytes, &Options::default()).unwrap();
        prop_assert_eq!(&back.model, &model);
    }
}

#[test]
fn an_exported_file_that_was_changed_is_not_restored() {
    let mut model = NetworkFile::new("m", 0.5);
    let parameters =
        vec![("du", Parameter::Same(1024.0)), ("dv", Parameter::Same(0.0)), ("vth_mant", Parameter::Same(64.0))];
    model.populations =
        vec![PopulationDesc::input("in", vec![2]), PopulationDesc::loihi("out", vec![1], parameters.clone())];
    let weights = ProjectionKind::Dense(tensor(vec![1, 2], vec![2.0, -4.0]));
    model.projections = vec![ProjectionDesc::new("in", "out", weights)];
    model.output = "out".to_string();
    let (mut tree, _) = nir_export::export(&model).unwrap();
    let Some(Item::Group(node)) = tree.items.get_mut("node") else { panic!() };
    let Some(Item::Group(nodes)) = node.items.get_mut("nodes") else { panic!() };
    let linear = nodes.group("w0_0").unwrap().clone().with("weight", Numbers::f64(&[1, 2], &[6.0, -4.0]));
    nodes.items.insert("w0_0".to_string(), linear.into());
    let read = foreign::from_bytes(Path::new("m.nir"), hdf5::write(&tree).unwrap(), &Options::default()).unwrap();
    assert!(read.notes[0].contains("differ from the model in its metadata"), "{:?}", read.notes);
    let out = read.model.population("out").unwrap();
    // This neuron by its equations, with the weight of the file.
    assert_eq!(out.parameter("du"), Some(&Parameter::Same(1024.0)));
    assert_eq!(out.parameter("dv"), Some(&Parameter::Same(0.0)));
    assert_eq!(out.parameter("vth"), Some(&Parameter::Same(64.0)));
    assert_eq!(read.model.projections[0].kind, ProjectionKind::Dense(tensor(vec![1, 2], vec![6.0, -4.0])));
    assert_eq!(read.model.timestep_ms, 0.5);
}
