//! Checkpoints as torch writes them.

// Each test file is a crate of its own; a helper of tests may unwrap as they do.
#![allow(clippy::unwrap_used)]

use std::io::Write as _;

/// A tensor of a file.
pub type Entry = (&'static str, Vec<usize>, Vec<f32>);

/// A checkpoint in torch's zip container.
pub fn checkpoint(entries: &[Entry]) -> Vec<u8> {
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
    for (key, (name, shape, numbers)) in entries.iter().enumerate() {
        assert_eq!(shape.iter().product::<usize>(), numbers.len(), "{name}");
        text(&mut pickle, name);
        pickle.extend(b"ctorch._utils\n_rebuild_tensor_v2\n((");
        text(&mut pickle, "storage");
        pickle.extend(b"ctorch\nFloatStorage\n");
        text(&mut pickle, &key.to_string());
        text(&mut pickle, "cpu");
        number(&mut pickle, numbers.len());
        pickle.extend(b"tQ");
        number(&mut pickle, 0);
        pickle.push(b'(');
        shape.iter().for_each(|&side| number(&mut pickle, side));
        pickle.extend(b"t(");
        (0..shape.len()).for_each(|axis| number(&mut pickle, shape[axis + 1..].iter().product()));
        pickle.extend(b"t\x89ccollections\nOrderedDict\n)RtRs");
    }
    pickle.push(b'.');
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    archive.start_file("a/data.pkl", options).unwrap();
    archive.write_all(&pickle).unwrap();
    for (key, (_, _, numbers)) in entries.iter().enumerate() {
        archive.start_file(format!("a/data/{key}"), options).unwrap();
        archive.write_all(&numbers.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<_>>()).unwrap();
    }
    archive.finish().unwrap().into_inner()
}
