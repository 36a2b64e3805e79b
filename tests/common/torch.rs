//! Checkpoints in torch's formats.

// Each test file is a crate of its own; test helpers may unwrap.
#![allow(dead_code, clippy::unwrap_used)]

use std::io::Write as _;

/// A tensor of a file.
pub type Entry = (&'static str, Vec<usize>, Vec<f32>);

/// A pickled dictionary of tensors of 32 bits: name, key of its storage, shape (opcodes: CPython
/// `pickletools.py`).
pub fn pickle(tensors: impl Iterator<Item = (String, String, Vec<usize>)>) -> Vec<u8> {
    let text = |out: &mut Vec<u8>, text: &str| {
        out.push(b'X');
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.bytes());
    };
    let number = |out: &mut Vec<u8>, number: usize| {
        out.push(b'J');
        out.extend((number as u32).to_le_bytes());
    };
    let mut pickle = b"\x80\x02}".to_vec();
    for (name, storage, shape) in tensors {
        text(&mut pickle, &name);
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend(b"ctorch\nFloatStorage\n");
        text(&mut pickle, &storage);
        text(&mut pickle, "cpu");
        number(&mut pickle, shape.iter().product());
        pickle.extend(b"tQ");
        number(&mut pickle, 0);
        pickle.push(b'(');
        shape.iter().for_each(|&side| number(&mut pickle, side));
        pickle.extend(b"t(");
        (0..shape.len()).for_each(|axis| number(&mut pickle, shape[axis + 1..].iter().product()));
        pickle.extend(b"t\x89ccollections\nOrderedDict\n)RtRs");
    }
    pickle.push(b'.');
    pickle
}

/// A checkpoint in torch's zip container: a pickle, and the bytes of its storages by key.
pub fn archive(pickle: &[u8], storages: impl Iterator<Item = Vec<u8>>) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    archive.start_file("a/data.pkl", options).unwrap();
    archive.write_all(pickle).unwrap();
    for (key, bytes) in storages.enumerate() {
        archive.start_file(format!("a/data/{key}"), options).unwrap();
        archive.write_all(&bytes).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

/// A checkpoint with dictionaries of tensors within it, by key.
pub fn nested(parts: &[(&str, &[Entry])]) -> Vec<u8> {
    let (mut pickled, mut storages) = (b"\x80\x02}".to_vec(), Vec::new());
    for (key, entries) in parts {
        let tensor = |(at, (name, shape, _)): (usize, &Entry)| {
            ((*name).to_string(), (storages.len() + at).to_string(), shape.clone())
        };
        // A dictionary without its pickle's first two bytes and its end.
        let whole = pickle(entries.iter().enumerate().map(tensor));
        pickled.extend([&b"X"[..], &(key.len() as u32).to_le_bytes(), key.as_bytes()].concat());
        pickled.extend([&whole[2..whole.len() - 1], b"s"].concat());
        storages.extend(entries.iter().map(|(.., numbers)| numbers.iter().flat_map(|x| x.to_le_bytes()).collect()));
    }
    pickled.push(b'.');
    archive(&pickled, storages.into_iter())
}

/// A checkpoint of these tensors, each in a storage of its own.
pub fn checkpoint(entries: &[Entry]) -> Vec<u8> {
    let tensor = |(key, (name, shape, numbers)): (usize, &Entry)| {
        assert_eq!(shape.iter().product::<usize>(), numbers.len(), "{name}");
        ((*name).to_string(), key.to_string(), shape.clone())
    };
    let bytes = |(.., numbers): &Entry| numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
    archive(&pickle(entries.iter().enumerate().map(tensor)), entries.iter().map(bytes))
}
