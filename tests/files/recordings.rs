//! Recordings and arrays of other programs, read with the contents that their descriptions state.

use crate::common;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Write;
use std::path::Path;

use nsim::files::npy;
use nsim::import::hdf5;
use nsim::import::kind::{EventFormat, FileKind};
use nsim::import::spikes::events::event::Counts;
use nsim::import::spikes::events::nir_data;
use nsim::import::spikes::events::read::read_input;
use nsim::import::spikes::{EventOptions, InputSpec, PopulationSpikes, list_folder, read_source, read_spikes};
use nsim::ir::tensor::Numbers;

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
    // Figures of the description: 2,564 spikes a sample, 1,098 to 5,683, mean density 0.101.
    let counts: Vec<usize> = all.iter().map(|sample| sample.events.len()).collect();
    assert_eq!((counts.iter().min(), counts.iter().max()), (Some(&1098), Some(&5683)));
    assert_eq!(spikes(&all) / 300, 2564);
    let density = spikes(&all) as f64 / (300.0 * 78.0 * 325.0);
    assert!((density - 0.101).abs() < 5e-4, "{density}");
    // Samples are in numeric order: sample 2 comes before sample 10.
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
    // Another program made the array of counts from the array of spikes.
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

/// A recording, the options of its reader, and a changed recording for each field of
/// `tests/files/fields.md`.
struct Format {
    name: &'static str,
    extension: &'static str,
    bytes: Vec<u8>,
    options: &'static str,
    fields: Vec<(&'static str, Vec<u8>)>,
}

/// The bytes with new ones from a position on.
fn with(bytes: &[u8], at: usize, new: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    bytes[at..at + new.len()].copy_from_slice(new);
    bytes
}

fn replaced(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
    [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()
}

fn words<const N: usize>(header: &str, words: &[[u8; N]]) -> Vec<u8> {
    [header.as_bytes(), &words.concat()].concat()
}

/// A zip archive of these files.
pub fn npz(files: &[(&str, &[u8])]) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for (name, bytes) in files {
        let packed = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Deflated);
        zip.start_file(*name, packed).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// AEDAT4 without compression: two events in a packet of stream 1.
fn aedat4(table_at: i64, description: &str) -> Vec<u8> {
    let mut header = vec![24, 0, 0, 0];
    header.extend(b"IOHE");
    // The table's size and its fields: compression, position of the table of packets, description.
    header.extend([0, 0, 0, 0, 0, 0, 10, 0, 20, 0, 4, 0, 8, 0, 16, 0]);
    header.extend(10i32.to_le_bytes());
    header.extend(0i32.to_le_bytes());
    header.extend(table_at.to_le_bytes());
    header.extend(4u32.to_le_bytes());
    header.extend((description.len() as u32).to_le_bytes());
    header.extend(description.as_bytes());
    header.extend([0; 4]);
    let mut packet = Vec::new();
    for bytes in [&[16u8, 0, 0, 0][..], b"EVTS", &[0, 0, 6, 0, 8, 0, 4, 0, 6, 0, 0, 0, 4, 0, 0, 0, 2, 0, 0, 0]] {
        packet.extend(bytes);
    }
    for (t, x, y, on) in [(1000i64, 1i16, 2i16, 1u8), (3000, 3, 4, 0)] {
        packet.extend(t.to_le_bytes());
        packet.extend(x.to_le_bytes());
        packet.extend(y.to_le_bytes());
        packet.extend([on, 0, 0, 0]);
    }
    let mut file = b"#!AER-DAT4.0\r\n".to_vec();
    file.extend((header.len() as u32).to_le_bytes());
    file.extend(header);
    file.extend(1i32.to_le_bytes());
    file.extend((packet.len() as u32 + 4).to_le_bytes());
    file.extend((packet.len() as u32).to_le_bytes());
    file.extend(packet);
    file
}

fn formats() -> Vec<Format> {
    let mut formats = Vec::new();
    let mut add = |name, extension, bytes: &[u8], options, fields: Vec<(&'static str, Vec<u8>)>| {
        formats.push(Format { name, extension, bytes: bytes.to_vec(), options, fields });
    };
    let addressed = [1, 2, 0x80, 0, 9, 3, 4, 0x00, 0x0b, 0xb8];
    let shared = |also: (&'static str, Vec<u8>)| {
        vec![
            ("x", with(&addressed, 0, &[5])),
            ("y", with(&addressed, 1, &[5])),
            ("polarity", with(&addressed, 2, &[0])),
            ("time", with(&addressed, 8, &[0x17])),
            also,
        ]
    };
    add("bin", "bin", &addressed, "size=16,16", shared(("y = 240", [&[0, 240, 0, 0, 0][..], &addressed].concat())));
    add("bs2", "bs2", &addressed, "size=16,16", shared(("y = 240", with(&addressed, 1, &[240]))));
    let flat = [0, 2, 0x80, 0, 9, 0, 4, 0x00, 0x0b, 0xb8];
    let channel = ("channel", with(&flat, 0, &[0, 3]));
    let (polarity, time) = (("polarity", with(&flat, 2, &[0])), ("time", with(&flat, 8, &[0x17])));
    add("bs1", "bs1", &flat, "size=256,1", vec![channel, polarity, time]);

    let header = "% Data file containing CD events\n% Version 2\n% Date 2020\n% Height 16\n% Width 16\n";
    let event = |t: u32, x: u32, y: u32, p: u32| {
        let word = x | y << 14 | p << 28;
        [t.to_le_bytes(), word.to_le_bytes()].concat()
    };
    let file =
        |header: &str, kind: [u8; 2], last: Vec<u8>| [header.as_bytes(), &kind, &event(9, 1, 2, 1), &last].concat();
    let dat = file(header, [12, 8], event(3000, 3, 4, 0));
    let fields = vec![
        ("Version", replaced(&dat, "Version 2", "Version 1")),
        ("Width, Height", replaced(&dat, "Width 16", "Width 32")),
        ("other lines", replaced(&dat, "Date 2020", "Date 2021")),
        ("event type", file(header, [14, 8], event(3000, 3, 4, 0))),
        ("event size", file(header, [12, 16], event(3000, 3, 4, 0))),
        ("time", file(header, [12, 8], event(6000, 3, 4, 0))),
        ("x", file(header, [12, 8], event(3000, 5, 4, 0))),
        ("y", file(header, [12, 8], event(3000, 3, 5, 0))),
        ("polarity", file(header, [12, 8], event(3000, 3, 4, 1))),
        ("polarity above 1", file(header, [12, 8], event(3000, 3, 4, 2))),
    ];
    add("dat", "dat", &dat, "", fields);

    let header = "% date 2020\n% evt 2.0\n% format EVT2;height=16;width=16\n% geometry 16x16\n";
    let event = |kind: u32, low: u32, x: u32, y: u32| (kind << 28 | low << 22 | x << 11 | y).to_le_bytes();
    let high = |time: u32| (8 << 28 | time).to_le_bytes();
    let raw = |high: [u8; 4], last: [u8; 4]| words(header, &[high, event(1, 9, 1, 2), last]);
    let evt2 = raw(high(1), event(0, 40, 3, 4));
    let fields = vec![
        ("evt, format", replaced(&evt2, "evt 2.0", "evt 3.0")),
        ("geometry, width, height", replaced(&evt2, "16x16", "32x16")),
        ("other lines", replaced(&evt2, "date 2020", "date 2021")),
        ("word type", raw(high(1), event(10, 40, 3, 4))),
        ("time high", raw((9u32 << 28).to_le_bytes(), event(0, 40, 3, 4))),
        ("time low", raw(high(1), event(0, 60, 3, 4))),
        ("x", raw(high(1), event(0, 40, 5, 4))),
        ("y", raw(high(1), event(0, 40, 3, 5))),
        ("polarity", raw(high(1), event(1, 40, 3, 4))),
    ];
    add("raw, EVT2", "raw", &evt2, "bin_ms=0.01", fields);
    let other = replaced(&replaced(&evt2, "evt 2.0", "evt 2.1"), "EVT2;", "EVT21;");
    add("raw, EVT2.1", "raw", &evt2, "bin_ms=0.01", vec![("evt, format", other)]);

    let header = "% date 2020\n% evt 3.0\n% format EVT3;height=16;width=16\n% geometry 16x16\n";
    let base = [0x8001u16, 0x6009, 0x0002, 0x2801, 0x3803, 0x4005, 0x5001, 0x6200, 0x0004, 0x2003, 0xa001];
    let evt3 = |place: usize, word: u16| {
        let mut base = base;
        base[place] = word;
        words(header, &base.map(u16::to_le_bytes))
    };
    let whole = evt3(0, base[0]);
    let fields = vec![
        ("evt, format", replaced(&whole, "EVT3", "EVT2")),
        ("geometry, width, height", replaced(&whole, "width=16", "width=32")),
        ("other lines", replaced(&whole, "date 2020", "date 2021")),
        ("word type", evt3(3, 0xa801)),
        ("time high", evt3(0, 0x9001)),
        ("time low", evt3(7, 0x6300)),
        ("row", evt3(8, 0x0005)),
        ("camera", evt3(8, 0x0804)),
        ("x", evt3(9, 0x2005)),
        ("polarity", evt3(9, 0x2803)),
        ("vector's base", evt3(4, 0x3804)),
        ("vector's polarity", evt3(4, 0x3003)),
        ("vector's bits", evt3(5, 0x4007)),
        ("bits 8 to 11 of a vector of 8", evt3(6, 0x5f01)),
        ("content of triggers", evt3(10, 0xa002)),
    ];
    add("raw, EVT3", "raw", &whole, "bin_ms=0.01", fields);

    let stream = |number: u32, kind: &str, columns: u32| {
        format!(
            "<node name=\"{number}\" path=\"/outInfo/{number}/\"><attr key=\"typeIdentifier\" \
             type=\"string\">{kind}</attr>\
             <node name=\"info\"><attr key=\"sizeX\">{columns}</attr><attr key=\"sizeY\">16</attr>\
             <attr key=\"source\">CAM</attr></node></node>"
        )
    };
    let description = |streams: &str| format!("<dv version=\"2.0\"><node name=\"outInfo\">{streams}</node></dv>");
    let (frames, events) = (stream(0, "FRME", 16), stream(1, "EVTS", 16));
    let usual = description(&format!("{frames}{events}"));
    let file = aedat4(-1, &usual);
    let two = aedat4(-1, &description(&format!("{}{events}", stream(0, "EVTS", 16))));
    let first = file.len() - 32;
    let packet = file.len() - 72;
    assert_eq!(&file[packet..packet + 4], &[1, 0, 0, 0], "the packet's stream");
    let short = |size: u8| [&file[..packet + 4], &[size, 0, 0, 0], &file[packet + 8..]].concat();
    let fields = vec![
        ("version", replaced(&file, "DAT4.0", "DAT3.1")),
        ("compression", with(&file, 18 + 28, &[1])),
        ("dataTablePosition", aedat4(10, &usual)),
        ("infoNode: streams, their types", two),
        ("infoNode: sizeX, sizeY", aedat4(-1, &description(&format!("{frames}{}", stream(1, "EVTS", 32))))),
        ("infoNode: source and others", replaced(&file, "CAM", "DVS")),
        ("packet's stream", with(&file, packet, &[0])),
        ("packet's size", short(80)),
        ("identifier", replaced(&file, "EVTS\0\0\x06", "TRIG\0\0\x06")),
        ("timestamp", with(&file, first + 17, &[0x17])),
        ("x", with(&file, first + 8, &[5])),
        ("y", with(&file, first + 10, &[5])),
        ("polarity", with(&file, first + 12, &[0])),
        ("three bytes after it", with(&file, first + 13, &[1, 1, 1])),
    ];
    add("aedat4", "aedat4", &file, "", fields);

    let tact = |text: &str| text.as_bytes().to_vec();
    let row = |text: &str| tact(&format!("# a\n1 2 0.001\n{text}\n"));
    let fields = vec![
        ("polarity", row("1 3 0.003")),
        ("cell", row("0 4 0.003")),
        ("cells 17 and 49", row("0 17 0.003")),
        ("seconds", row("0 3 0.004")),
        ("nanoseconds", row("0 3 0.003 2000000")),
        ("lines of #", tact("# b\n1 2 0.001\n0 3 0.003\n")),
    ];
    add("tact", "tact", &row("0 3 0.003"), "", fields);
    let rows = |header: &str, row: &str| format!("{header}\n1000,1,2,1,0\n{row}\n").into_bytes();
    let fields = vec![
        ("unit of the time", rows("t_ns,x,y,p,more", "3000,3,4,0,0")),
        ("time", rows("t_us,x,y,p,more", "6000,3,4,0,0")),
        ("x", rows("t_us,x,y,p,more", "3000,5,4,0,0")),
        ("y", rows("t_us,x,y,p,more", "3000,3,5,0,0")),
        ("p", rows("t_us,x,y,p,more", "3000,3,4,1,0")),
        ("sample, label, camera, stream, sensor, trigger", rows("t_us,x,y,p,camera", "3000,3,4,0,1")),
        ("other columns, lines of #", rows("t_us,x,y,p,more", "3000,3,4,0,1")),
    ];
    add("events as text", "csv", &rows("t_us,x,y,p,more", "3000,3,4,0,0"), "size=16,16", fields);
    let rows = |size: &str, row: &str| format!("# a\n{size}\n0.001 1 2 1\n{row}\n").into_bytes();
    let fields = vec![
        ("width and height", rows("32 16", "0.003\t3 4 0")),
        ("t", rows("16 16", "0.006\t3 4 0")),
        ("x", rows("16 16", "0.003\t5 4 0")),
        ("y", rows("16 16", "0.003\t3 5 0")),
        ("p", rows("16 16", "0.003\t3 4 1")),
        ("a fifth number", rows("16 16", "0.003\t3 4 0 1")),
        ("a header in a line of #", b"# the columns are t x y p\n# t y x p\n0.001 1 2 1\n0.003\t3 4 0\n".to_vec()),
    ];
    add("rows t x y p", "txt", &rows("16 16", "0.003\t3 4 0"), "unit=s", fields);
    let list = |text: &str| text.as_bytes().to_vec();
    let fields = vec![
        ("timestep", list("# steps: 9\n# label: 1\nsample,timestep,channel\n0,1,2\n0,4,4\n")),
        ("channel", list("# steps: 9\n# label: 1\nsample,timestep,channel\n0,1,2\n0,3,5\n")),
        ("sample", list("# steps: 9\n# label: 1\nsample,timestep,channel\n0,1,2\n1,3,4\n")),
        ("# steps", list("# steps: 8\n# label: 1\nsample,timestep,channel\n0,1,2\n0,3,4\n")),
        ("# label", list("# steps: 9\n# label: 2\nsample,timestep,channel\n0,1,2\n0,3,4\n")),
    ];
    add("spikes as text", "csv", &list("# steps: 9\n# label: 1\nsample,timestep,channel\n0,1,2\n0,3,4\n"), "", fields);

    let array = |descr: &str, order: &str, shape: &str, at: usize| {
        let header = format!("{{'descr': '{descr}', 'fortran_order': {order}, 'shape': {shape}, }}\n");
        let mut file = b"\x93NUMPY\x01\0".to_vec();
        file.extend((header.len() as u16).to_le_bytes());
        file.extend(header.bytes());
        file.extend((0..512 * 4).map(|i| u8::from(i == 5 || i == at)));
        file
    };
    let usual = array("|u1", "False", "(512, 4)", 99);
    let fields = vec![
        ("version", with(&usual, 6, &[9])),
        ("descr", array("<u2", "False", "(512, 4)", 99)),
        ("fortran_order", array("|u1", "True ", "(512, 4)", 99)),
        ("shape", array("|u1", "False", "(4, 512)", 99)),
        ("values", array("|u1", "False", "(512, 4)", 98)),
    ];
    add("spikes as npy", "npy", &usual, "", fields);

    let silent = replaced(&array("|u1", "False", "(512, 4)", 5), "\x01", "\0");
    let labels = |class: u8| {
        let mut bytes = Vec::new();
        npy::write(&mut bytes, &[1], std::iter::once(class)).unwrap();
        bytes
    };
    let zipped = npz(&[("spikes.npy", &usual), ("y.npy", &labels(1)), ("more.npy", &silent)]);
    // The compression method is in the header of each array and in the central list.
    let mut bzip2 = zipped.clone();
    for (mark, method) in [(*b"PK\x03\x04", 8), (*b"PK\x01\x02", 10)] {
        let places: Vec<usize> = (0..bzip2.len() - 4).filter(|&at| bzip2[at..at + 4] == mark).collect();
        places.iter().for_each(|at| bzip2[at + method] = 12);
    }
    let more = |name: &str, array: &[u8]| {
        npz(&[("spikes.npy", &usual), ("y.npy", &labels(1)), ("more.npy", &silent), (name, array)])
    };
    let fields = vec![
        ("compression", bzip2),
        ("array named like the population", more("in.npy", &silent)),
        ("labels, y, targets", npz(&[("spikes.npy", &usual), ("y.npy", &labels(2)), ("more.npy", &silent)])),
        ("x beside t", npz(&[("x.npy", &labels(1)), ("y.npy", &labels(1)), ("t.npy", &labels(1))])),
        ("other arrays", npz(&[("spikes.npy", &usual), ("y.npy", &labels(1)), ("more.npy", &usual)])),
    ];
    add("spikes as npz", "npz", &zipped, "", fields);

    let nir_data = |kind: &str, numbers: &[(&str, f64)], arrays: &[(&str, hdf5::Numbers)]| {
        let mut group = hdf5::Group::default();
        for (name, array) in arrays {
            group = group.with(name, array.clone());
        }
        group.attributes.insert("__type__".to_string(), hdf5::Attribute::Text(kind.to_string()));
        for (name, x) in numbers {
            group.attributes.insert((*name).to_string(), hdf5::Attribute::Number(*x));
        }
        hdf5::write(&nir_data::file("in", "spikes", group)).unwrap()
    };
    let valued = |idx: i64, time: f64, value: f64, neurons: f64, end: f64, kind: &str| {
        let arrays = [
            ("idx", hdf5::Numbers::i64(&[1, 2], &[1, idx])),
            ("time", hdf5::Numbers::f64(&[1, 2], &[0.001, time])),
            ("value", hdf5::Numbers::f64(&[1, 2], &[1.0, value])),
        ];
        nir_data(kind, &[("n_neurons", neurons), ("t_max", end)], &arrays)
    };
    let kind = "ValuedEventData";
    let fields = vec![
        ("__type__", valued(2, 0.003, 1.0, 512.0, 0.01, "OtherData")),
        ("idx", valued(3, 0.003, 1.0, 512.0, 0.01, kind)),
        ("time", valued(2, 0.004, 1.0, 512.0, 0.01, kind)),
        ("value", valued(2, 0.003, 0.5, 512.0, 0.01, kind)),
        ("n_neurons", valued(2, 0.003, 1.0, 16.0, 0.01, kind)),
        ("t_max", valued(2, 0.003, 1.0, 512.0, 0.02, kind)),
    ];
    add("NIR data, events", "nir", &valued(2, 0.003, 1.0, 512.0, 0.01, kind), "", fields);
    let grid = |at: usize, dt: f64| {
        let mut numbers = vec![0.0; 4 * 512];
        numbers[at] = 1.0;
        nir_data("TimeGriddedData", &[("dt", dt)], &[("data", hdf5::Numbers::f64(&[1, 4, 512], &numbers))])
    };
    add("NIR data, grid", "nir", &grid(7, 0.001), "", vec![("data", grid(8, 0.001)), ("dt", grid(7, 0.002))]);
    formats
}

/// Another value of a field changes the result or is refused; a field without meaning changes
/// nothing.
#[test]
fn every_field_of_a_recording_is_used_checked_or_listed_as_without_meaning() {
    let folder = tempfile::tempdir().unwrap();
    let read = |extension: &str, bytes: &[u8], options: &str| {
        let path = folder.path().join(format!("a.{extension}"));
        std::fs::write(&path, bytes).unwrap();
        let options = EventOptions::parse(&nsim::ir::stimulus::pairs(options).unwrap()).unwrap();
        let units = if extension == "tact" { 156 } else { 512 };
        read_spikes(&path, "in", &InputSpec { units, volume: None, dt_ms: 1.0, values: false }, &options)
    };
    let documented =
        std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/files/fields.md")).unwrap();
    let section = documented.split("\n## Fields of recordings").nth(1).unwrap().split("\n## ").next().unwrap();
    let rows: BTreeMap<(String, String), bool> = section
        .lines()
        .filter(|line| line.starts_with("| ") && !line.starts_with("| format"))
        .map(|line| {
            let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
            ((cells[0].to_string(), cells[1].to_string()), cells[3] != "without meaning")
        })
        .collect();
    let mut tried = BTreeSet::new();
    let mut wrong = Vec::new();
    for Format { name, extension, bytes, options, fields } in formats() {
        let whole = read(extension, &bytes, options).unwrap_or_else(|problem| panic!("{name}: {problem}"));
        assert!(whole.iter().any(|sample| !sample.events.is_empty()), "{name}");
        for (field, changed) in fields {
            let key = (name.to_string(), field.to_string());
            let Some(&has_meaning) = rows.get(&key) else {
                wrong.push(format!("{name}, {field}: not in tests/files/fields.md"));
                continue;
            };
            assert_ne!(changed, bytes, "{name}, {field}");
            let differs = read(extension, &changed, options).map_or(true, |read| read != whole);
            if differs != has_meaning {
                wrong.push(format!("{name}, {field}: differs: {differs}, has a meaning: {has_meaning}"));
            }
            tried.insert(key);
        }
    }
    wrong.extend(rows.keys().filter(|key| !tried.contains(*key)).map(|key| format!("{key:?}: no test")));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn read_text(text: &str, options: &str) -> nsim::ir::base::diagnostic::Result<Vec<(u32, u32)>> {
    read_bytes("a.csv", text.as_bytes(), options).map(|(events, _)| events)
}

/// Spikes on 2 x 16 x 16 channels and the counts, in steps of a millisecond.
fn read_bytes(
    name: &str,
    bytes: &[u8],
    options: &str,
) -> nsim::ir::base::diagnostic::Result<(Vec<(u32, u32)>, Counts)> {
    let FileKind::Events(format) = FileKind::from_bytes(bytes, Path::new(name)) else { panic!("{name}") };
    let options = EventOptions::parse(&nsim::ir::stimulus::pairs(options).unwrap()).unwrap();
    let expected = InputSpec { units: 512, volume: Some((2, 16, 16)), dt_ms: 1.0, values: false };
    let (spikes, counts) = read_input(&mut &bytes[..], name, format, &expected, &options)?;
    Ok((spikes.events, counts))
}

#[test]
fn the_unit_of_times_is_named_or_asked_for() {
    let rows = |header: &str, unit_us: f64| {
        let rows = [3811.0, 4811.0, 9200.0, 21000.0].map(|us| format!("{},1,2,1\n", us / unit_us));
        format!("{header},x,y,p\n{}", rows.concat())
    };
    let right = read_text(&rows("t_us", 1.0), "").unwrap();
    assert_eq!(right.iter().map(|event| event.0).collect::<Vec<_>>(), [0, 1, 5, 17]);
    assert_eq!(read_text(&rows("t", 1.0), "").unwrap(), right, "microseconds are plausible");
    for (unit, unit_us) in [("s", 1e6), ("ms", 1e3), ("ns", 1e-3)] {
        let error = read_text(&rows("t", unit_us), "").unwrap_err();
        assert_eq!(error.code, "input.unit", "{unit}: {error}");
        // Both remedies in the message.
        let help = error.help.unwrap();
        assert!(help.contains(&format!("t_{unit}")) && help.contains("?unit="), "{help}");
        assert_eq!(read_text(&rows(&format!("t_{unit}"), unit_us), "").unwrap(), right, "{unit}");
        assert_eq!(read_text(&rows("timestamp", unit_us), &format!("unit={unit}")).unwrap(), right, "{unit}");
        assert_eq!(read_text(&rows("t_us", 1.0), &format!("unit={unit}")).unwrap_err().code, "input.option");
    }
    // Whole milliseconds, which would all be within a timestep if they were microseconds.
    let error = read_text("time,x,y\n1,1,1\n2,1,1\n9,1,1\n", "").unwrap_err();
    assert!(error.code == "input.unit" && error.message.contains("3 events in 0.008 ms"), "{error}");
    assert_eq!(read_bytes("a.bin", &[0; 5], "unit=s").unwrap_err().code, "input.option");
}

#[test]
fn rows_without_a_header_are_t_x_y_p_or_refused_with_the_header_to_write() {
    let rows = ["0.003811 1 2 1", "0.004811 3 2 0", "0.0092 1 2 1", "0.021 5 7 1"];
    let right = read_text(&format!("t_s,x,y,p\n{}", rows.join("\n").replace(' ', ",")), "").unwrap();
    let spaced = rows.join("\n");
    for text in [
        spaced.clone(),
        format!("16 16\n{spaced}"),
        spaced.replace(' ', "\t"),
        spaced.replace(" 0", " -1"),
        spaced.replace(" 1 2 1", " 1.000e+00 2.000e+00 1.000e+00"),
        format!("t x y p\n{spaced}"),
        format!("# columns: t x y p\n{spaced}").replace('x', "X"),
        format!("# made by hand\n# t x y p\n{spaced}"),
        format!("# t,x,y,p\n{}", spaced.replace(' ', ",")),
    ] {
        for name in ["events.txt", "a", "a.csv", "a.dat"] {
            let (events, counts) = read_bytes(name, text.as_bytes(), "unit=s").unwrap();
            assert_eq!((events, counts.columns_assumed), (right.clone(), !text.contains('x')), "{text}");
        }
        // Seconds are no plausible microseconds.
        assert_eq!(read_text(&text, "").unwrap_err().code, "input.unit", "{text}");
    }
    let tact = FileKind::from_bytes(b"1 2 12 0\n", Path::new("a.tact"));
    assert_eq!(tact, FileKind::Events(EventFormat::Tact), "a row of .tact with nanoseconds");
    let commas = spaced.replace(' ', ",");
    for (text, says) in [
        (commas.clone(), "row 1: it is not a header"),
        (format!("{spaced}\n0.020 1 1 1\n"), "row 5: its first number is 1000 us less"),
        (format!("{spaced}\n0.022 1 1\n"), "row 5: it has 3 fields"),
        (format!("{spaced}\n0.022 1 1 7\n"), "polarity 7"),
        (format!("16 16\n16 16\n{spaced}"), "row 2: it is not"),
    ] {
        let error = decode_text(&text);
        assert!(error.code == "input.events" && error.message.contains(says), "{text}: {error}");
    }
    // The remedies of the message.
    assert_eq!(read_text(&format!("t_s,x,y,p\n{commas}"), "").unwrap(), right);
    assert_eq!(read_text(&format!("t_s x y p\n{spaced}"), "").unwrap(), right);
    assert_eq!(read_text("x,y,p,t_us\n1,2,1,3811\n3,2,0,4811\n1,2,1,9200\n5,7,1,21000\n", "").unwrap(), right);
}

/// The problem of reading a text as events in seconds, whatever its kind.
fn decode_text(text: &str) -> nsim::ir::base::diagnostic::Diagnostic {
    let expected = InputSpec { units: 512, volume: Some((2, 16, 16)), dt_ms: 1.0, values: false };
    let options = EventOptions::parse(&nsim::ir::stimulus::pairs("unit=s").unwrap()).unwrap();
    read_input(&mut text.as_bytes(), "a", EventFormat::Text, &expected, &options).unwrap_err()
}

#[test]
fn a_recording_that_is_cut_off_is_read_to_the_last_whole_record() {
    for Format { name, extension, bytes, options, .. } in formats() {
        if !["bin", "bs2", "bs1", "dat", "raw", "aedat4"].contains(&extension) || name == "bs1" {
            continue;
        }
        let (_, whole) = read_bytes(&format!("a.{extension}"), &bytes, options).unwrap();
        let (_, cut) =
            read_bytes(&format!("a.{extension}"), &bytes[..bytes.len() - 1], &format!("{options}&steps=99")).unwrap();
        assert_eq!((whole.cut_bytes, cut.cut_bytes.is_some()), (None, true), "{name}");
        let lost = if extension == "aedat4" { 2 } else { u64::from(name != "raw, EVT3") };
        assert_eq!(cut.events, whole.events - lost, "{name}");
    }
    let (events, counts) = read_bytes("a.csv", b"t_us,x,y\n10,1,1\n2000,2", "").unwrap();
    assert_eq!((events.len(), counts.cut_bytes), (1, Some(6)));
    let tact = |text: &str| {
        let expected = InputSpec { units: 156, volume: None, dt_ms: 1.0, values: false };
        read_input(&mut text.as_bytes(), "a.tact", EventFormat::Tact, &expected, &EventOptions::default())
    };
    let (_, counts) = tact("1 2 0.001\n0 3 0.003\n1 2").unwrap();
    assert_eq!((counts.events, counts.cut_bytes), (2, Some(3)));
    let error = tact("1 2 0.001\n0 3\n1 2 0.003\n").unwrap_err();
    assert!(error.message.contains("row 2"), "{error}");
}

#[test]
fn clocks_step_back_and_turn_as_their_formats_say() {
    let evt3 = |words: &[u16]| {
        let words: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        [b"% evt 3.0\n", words.as_slice()].concat()
    };
    let steps = |bytes: &[u8]| {
        let (events, counts) = read_bytes("a.raw", bytes, "size=16,16&start_ms=0").unwrap();
        (events.iter().map(|event| event.0).collect::<Vec<_>>(), counts.clock_turns, counts.disordered)
    };
    // A low half that is lower by 5 us stays as written; a drop over half the range means an
    // omitted high half.
    assert_eq!(steps(&evt3(&[0x8001, 0x6400, 1, 0x2801, 0x63fb, 0x2802])), (vec![5, 5], 0, 1));
    assert_eq!(steps(&evt3(&[0x8001, 0x6fff, 1, 0x2801, 0x6000, 0x2802])), (vec![8, 8], 1, 0));
    assert_eq!(steps(&evt3(&[0x8fff, 0x6fff, 0x8000, 0x6000, 1, 0x2802])), (vec![16_777], 1, 0));
    // A step back over a wrap is undone: 4 ms back and forth, and no second wrap.
    let over = [0x8fff, 0x6ff8, 1, 0x2801, 0x8000, 0x2802, 0x8fff, 0x6ffa, 0x2803, 0x8000, 0x6001, 0x2804];
    let (events, counts) = read_bytes("a.raw", &evt3(&over), "size=16,16&start_ms=0&bin_ms=10000").unwrap();
    assert_eq!(events.iter().map(|event| event.0).collect::<BTreeSet<_>>(), [1].into());
    assert_eq!(counts.span_us, Some((0xff_fff8, 0x100_0001)));
    let dat = |times: &[u32]| {
        let events = times.iter().flat_map(|t| [t.to_le_bytes(), [1, 0, 0, 0]].concat()).collect::<Vec<_>>();
        [b"% Data file containing CD events\n\x0c\x08", events.as_slice()].concat()
    };
    let (_, counts) = read_bytes("a.dat", &dat(&[u32::MAX - 5, 3, u32::MAX - 1, 9]), "bin_ms=1000").unwrap();
    assert_eq!(counts.span_us, Some((i64::from(u32::MAX) - 5, (1 << 32) + 9)));
    let (_, counts) = read_bytes("a.raw", &evt3(&[1, 0x2801, 0x8001, 0x2801]), "").unwrap();
    assert_eq!((counts.events, counts.dropped), (2, 1), "before any time");
    // Data may begin like a header line, except for the space.
    let (events, _) = read_bytes("a.raw", &evt3(&[0x8025, 0x2801]), "").unwrap();
    assert_eq!(events.len(), 1);
    let (marked, counts) = read_bytes("a.bin", &[1, 1, 0, 0, 0, 0, 240, 0, 0, 0, 1, 1, 0, 0, 0], "").unwrap();
    assert_eq!((marked, counts.clock_turns), (vec![(0, 17), (8, 17)], 1));
}

#[test]
fn of_two_cameras_one_is_chosen() {
    let word = |words: &[u16]| words.iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
    let evt3 = [b"% evt 3.0\n", word(&[0x8001, 1, 0x2801, 0x0802, 0x2802]).as_slice()].concat();
    assert!(read_bytes("a.raw", &evt3, "").unwrap_err().help.unwrap().contains("?stream=1"));
    assert_eq!(read_bytes("a.raw", &evt3, "stream=0").unwrap().0, [(0, 256 + 17)]);
    assert_eq!(read_bytes("a.raw", &evt3, "stream=1").unwrap().0, [(0, 256 + 34)]);
    let stream = |number: u32| {
        format!(
            "<node name=\"{number}\"><attr key=\"typeIdentifier\">EVTS</attr><node name=\"info\"><attr \
             key=\"sizeX\">16</attr>\
             <attr key=\"sizeY\">16</attr><attr key=\"source\">CAM{number}</attr></node></node>"
        )
    };
    let file = aedat4(-1, &format!("<node name=\"outInfo\">{}{}</node>", stream(0), stream(1)));
    let error = read_bytes("a.aedat", &file, "").unwrap_err();
    assert!(error.message.contains("stream 0 of CAM0, 16 x 16 pixels; stream 1 of CAM1"), "{error}");
    assert_eq!(read_bytes("a.aedat", &file, "stream=1").unwrap().1.events, 2);
    assert_eq!(read_bytes("a.aedat", &file, "stream=2").unwrap_err().code, "input.option");
    let old = read_bytes("a.aedat", b"#!AER-DAT3.1\r\n#Format: RAW\r\n", "").unwrap_err();
    assert!(old.message.contains("AEDAT 3.1") && old.help.unwrap().contains("t_us,x,y,p"), "{}", old.message);
}

#[test]
fn events_in_hdf5_are_refused_by_their_names() {
    let numbers = || hdf5::Numbers::i64(&[2], &[1, 2]);
    let metavision = hdf5::Group::default().with("CD", hdf5::Group::default().with("events", numbers()));
    let parts =
        ["x", "y", "t", "p"].into_iter().fold(hdf5::Group::default(), |group, name| group.with(name, numbers()));
    let dsec = hdf5::Group::default().with("events", parts).with("t_offset", numbers());
    for (tree, name) in [(metavision, "Metavision"), (dsec, "DSEC")] {
        let error = hdf5::tree(Path::new("a.h5"), hdf5::write(&tree).unwrap()).unwrap_err();
        assert!(error.code == "hdf5.events" && error.message.contains(name) && error.help.is_some(), "{error}");
        // The message also names a file that is too large.
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.h5");
        std::fs::write(&path, hdf5::write(&tree).unwrap()).unwrap();
        std::fs::File::options().write(true).open(&path).unwrap().set_len((1 << 30) + 1).unwrap();
        assert_eq!(hdf5::read_foreign_file(&path).unwrap_err().message, error.message);
        std::fs::File::create(&path).unwrap().set_len((1 << 30) + 1).unwrap();
        assert_eq!(hdf5::read_foreign_file(&path).unwrap_err().code, "io.too-large");
    }
}
