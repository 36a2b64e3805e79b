//! Links by path in an HDF5 file, found in the file's bytes.
//!
//! Input: the bytes of a file. Output: the first soft or external link. The crate that reads files
//! skips such links in groups of the newer kind, and fails at links of the older kind. A member
//! would be missing silently, so files with such links are refused.
//!
//! Newer groups store links as messages (HDF5 file format specification 3.0, IV.A.2.g) in object
//! headers, or in a fractal heap. The bytes around a message distinguish it from weights. Older
//! groups store links in symbol table nodes (III.B).

/// The greatest distance in bytes of a link from the signature of its fractal heap.
const HEAP: usize = 1 << 16;
/// Bytes of an entry of a symbol table, for files with addresses of 64 bits.
const ENTRY: usize = 40;

/// Description of the first link by path, for messages.
pub(super) fn find(bytes: &[u8]) -> Option<String> {
    let mut heap = None;
    (0..bytes.len().saturating_sub(8)).find_map(|at| {
        match &bytes[at..at + 4] {
            b"FHDB" => heap = Some(at),
            b"SNOD" if in_node(&bytes[at..]) => return Some("a soft link".to_string()),
            _ => {}
        }
        let (length, link) = message(&bytes[at..])?;
        let in_heap = heap.is_some_and(|heap| at - heap < HEAP);
        (in_heap || in_header(bytes, at, length)).then_some(link)
    })
}

/// The little-endian number in two bytes at `at`.
fn short(bytes: &[u8], at: usize) -> Option<usize> {
    Some(usize::from(u16::from_le_bytes([*bytes.get(at)?, *bytes.get(at + 1)?])))
}

/// The bytes as a name of a link or target: non-empty UTF-8 without control characters.
fn text(bytes: &[u8]) -> Option<&str> {
    let text = std::str::from_utf8(bytes).ok()?;
    (!text.is_empty() && !text.contains(char::is_control)).then_some(text)
}

/// The length of the link message at the start of `bytes`, and a description of the link.
fn message(bytes: &[u8]) -> Option<(usize, String)> {
    let (&[1, flags, kind], true) = (bytes.first_chunk::<3>()?, bytes.len() > 8) else { return None };
    if flags & 0xe8 != 8 || !matches!(kind, 1 | 64) {
        return None;
    }
    // Optional fields precede the name's length: order of creation, character set.
    let size = 1 << (flags & 3);
    let at = 3 + if flags & 4 == 0 { 0 } else { 8 } + usize::from(flags >> 4 & 1);
    let length = bytes
        .get(at..at + size)?
        .iter()
        .rev()
        .try_fold(0usize, |length, &byte| Some(length << 8 | usize::from(byte)).filter(|&length| length < HEAP))?;
    let at = at + size;
    let name = text(bytes.get(at..at + length)?)?;
    let at = at + length;
    let length = short(bytes, at)?;
    let target = bytes.get(at + 2..at + 2 + length)?;
    let link = match kind {
        1 => format!("'{name}' is a soft link to '{}'", text(target)?),
        _ => {
            let mut parts = target.strip_prefix(b"\0")?.strip_suffix(b"\0")?.split(|&byte| byte == 0);
            let (file, object) = (text(parts.next()?)?, text(parts.next()?)?);
            format!("'{name}' is a link to '{object}' of another file, '{file}'")
        }
    };
    Some((at + 2 + length, link))
}

/// Whether the bytes before a message are its header, in one of the two versions.
fn in_header(bytes: &[u8], at: usize, length: usize) -> bool {
    const LINK: u8 = 6;
    let newer = |before: usize| {
        let start = at.checked_sub(before).filter(|&start| bytes[start] == LINK);
        start.is_some_and(|start| short(bytes, start + 1) == Some(length))
    };
    let older = at.checked_sub(8).is_some_and(|start| {
        let padded = short(bytes, start + 2).is_some_and(|size| size == length.next_multiple_of(8));
        short(bytes, start) == Some(LINK.into()) && padded && bytes[start + 5..at] == [0; 3]
    });
    newer(4) || newer(6) || older
}

/// Whether a symbol table node has an entry that is a soft link.
fn in_node(bytes: &[u8]) -> bool {
    let entries = short(bytes, 6).unwrap_or(0);
    bytes[4] == 1 && (0..entries).any(|entry| bytes.get(8 + entry * ENTRY + 16) == Some(&2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_are_no_links() {
        let noise: Vec<u8> = (0..1u64 << 16).map(|i| nsim_ir::base::rng::below(256, 1, i, 0) as u8).collect();
        assert_eq!(find(&noise), None);
        assert_eq!(
            find(b"\x06\x0e\0\0\x01\x08\x01\x06weight\x02\0/wabc"),
            Some("'weight' is a soft link to '/w'".into())
        );
        assert_eq!(find(b"\x06\x0f\0\0\x01\x08\x01\x06weight\x02\0/wabc"), None, "of another length");
    }
}
