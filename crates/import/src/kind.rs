//! Detection of file kinds, for all commands.
//!
//! Input: a path, or the first bytes of a file and its name. Output: a [`FileKind`]. The content
//! decides; the name decides among formats whose files begin with data, and for content that is not
//! recognised. The readers of HDF5 files distinguish their trees.
//!
//! Errors: `io.*` for a file that cannot be opened, `io.lfs-pointer`.

use std::fmt;
use std::io::Read;
use std::path::Path;

use super::hdf5;
use super::spikes::csv;
use super::spikes::events::aedat::AEDAT;
use super::spikes::events::text::begins_recording;
use nsim_files::text::{NPY_MAGIC, is_standard_stream, open, refuse_pointer, unreadable};
use nsim_ir::base::diagnostic::Result;
use nsim_ir::base::names::named_variants;
use nsim_ir::locate::root_name;

/// The first bytes of an archive of PyTorch or NumPy.
pub const ZIP: &[u8] = b"PK\x03\x04";
/// Bytes of a file that are examined, many since a text may begin with comments.
const HEAD: usize = 1 << 16;

/// The kinds of recordings, for messages.
pub const RECORDINGS: &str = "recordings of events (.bin, .bs1, .bs2, .dat, .raw, .aedat4, .tact, text with the header t_us,x,y,p or with \
                             rows t x y p, NIR data)";

named_variants! {
    /// The formats of event recordings.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum EventFormat {
        /// SLAYER `.bs2`: x, y, polarity and 23 bits of microseconds.
        Bs2 = "SLAYER .bs2",
        /// SLAYER `.bs1`: 16 bits of channel, polarity and 23 bits of microseconds.
        Bs1 = "SLAYER .bs1",
        /// Prophesee `.dat`.
        Dat = "Prophesee .dat",
        /// Prophesee `.raw` with EVT2 or EVT3.
        Raw = "Prophesee .raw",
        /// AEDAT; version 4 is read.
        Aedat4 = "AEDAT",
        /// VT_SNN's `.tact`.
        Tact = "VT_SNN .tact",
        /// Text whose header names x and a time, or rows `t x y p`.
        Text = "events as text",
        /// N-MNIST `.bin`: like `.bs2`, with entries that mark overflows of the clock.
        Bin = "N-MNIST .bin",
    }
}

/// The kind of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A folder.
    Folder,
    /// Standard input or a pipe, from which detection reads no byte.
    Stream,
    /// A description of nsim's own: a model, a target, a data set.
    Ron,
    /// A NumPy array.
    Npy,
    /// An archive of NumPy arrays.
    Npz,
    /// Rows `timestep,channel`.
    SpikeList,
    /// A recording of events.
    Events(EventFormat),
    /// HDF5.
    Hdf5,
    /// A checkpoint of PyTorch, or a pickle of something else.
    Torch,
    /// A safetensors file.
    Safetensors,
    /// YAML, recognised by its name.
    Yaml,
    /// A network of another tool, recognised by its name (`.net`) only.
    Net,
    /// None of these.
    Unknown,
}

impl fmt::Display for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            FileKind::Folder => "a folder",
            FileKind::Stream => "a pipe",
            FileKind::Ron => "a description in RON",
            FileKind::Npy => "a NumPy array",
            FileKind::Npz => "an archive of NumPy arrays",
            FileKind::SpikeList => "a list of spikes",
            FileKind::Events(format) => return write!(f, "a recording of events ({})", format.name()),
            FileKind::Hdf5 => "an HDF5 file",
            FileKind::Torch => "a PyTorch checkpoint",
            FileKind::Safetensors => "a file of tensors (safetensors)",
            FileKind::Yaml => "a YAML file",
            FileKind::Net | FileKind::Unknown => "a file of no kind that is known",
        })
    }
}

impl FileKind {
    /// The kind of the file or folder at a path.
    ///
    /// # Errors
    /// `io.*` when it cannot be opened, `io.lfs-pointer`.
    pub fn detect(path: &Path) -> Result<FileKind> {
        if is_standard_stream(path) {
            return Ok(FileKind::Stream);
        }
        if path.is_dir() {
            return Ok(FileKind::Folder);
        }
        let (file, found) = open(path)?;
        if !found.is_file() {
            return Ok(FileKind::Stream);
        }
        let mut head = Vec::new();
        file.take(HEAD as u64).read_to_end(&mut head).map_err(|error| unreadable(path, &error))?;
        refuse_pointer(path, &head)?;
        Ok(FileKind::from_bytes(&head, path))
    }

    /// The kind of a file from its name and its first bytes.
    pub fn from_bytes(bytes: &[u8], name: &Path) -> FileKind {
        let head = &bytes[..bytes.len().min(HEAD)];
        let extension = name.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let content = match head {
            _ if head.starts_with(NPY_MAGIC) => Some(FileKind::Npy),
            _ if head.starts_with(hdf5::MAGIC) => Some(FileKind::Hdf5),
            _ if head.starts_with(AEDAT) => Some(FileKind::Events(EventFormat::Aedat4)),
            _ if head.starts_with(ZIP) => Some(archive(head, extension == "npz")),
            _ if head.starts_with(b"% ") => prophesee(head),
            // Rows of a .tact may have four numbers, too.
            _ if !head.contains(&0) => text(&String::from_utf8_lossy(head))
                .filter(|kind| extension != "tact" || *kind != FileKind::Events(EventFormat::Text)),
            _ => None,
        };
        content.unwrap_or_else(|| match extension.as_str() {
            "ron" => FileKind::Ron,
            "npy" => FileKind::Npy,
            "npz" => FileKind::Npz,
            "csv" => FileKind::SpikeList,
            "bin" => FileKind::Events(EventFormat::Bin),
            "bs2" => FileKind::Events(EventFormat::Bs2),
            "bs1" => FileKind::Events(EventFormat::Bs1),
            "dat" => FileKind::Events(EventFormat::Dat),
            "raw" => FileKind::Events(EventFormat::Raw),
            "aedat" | "aedat4" => FileKind::Events(EventFormat::Aedat4),
            "tact" => FileKind::Events(EventFormat::Tact),
            "nir" | "h5" | "hdf5" => FileKind::Hdf5,
            "pt" | "pth" => FileKind::Torch,
            "safetensors" => FileKind::Safetensors,
            "yaml" | "yml" => FileKind::Yaml,
            "net" if head.starts_with(b"\x80") => FileKind::Torch,
            "net" => FileKind::Net,
            // A recording without an extension could begin so too.
            _ => match head {
                [0x80, 2..=5, ..] => FileKind::Torch,
                [_, _, _, _, _, 0, 0, 0, b'{', ..] => FileKind::Safetensors,
                _ => FileKind::Unknown,
            },
        })
    }
}

/// The kind of an archive, from the name of its first file.
fn archive(head: &[u8], named_npz: bool) -> FileKind {
    let length = head.get(26..28).map_or(0, |bytes| usize::from(u16::from_le_bytes([bytes[0], bytes[1]])));
    let first = head.get(30..30 + length).unwrap_or_default();
    if first.ends_with(b".npy") || named_npz && !first.ends_with(b"/data.pkl") {
        FileKind::Npz
    } else {
        FileKind::Torch
    }
}

/// The kind of a file with Prophesee's header, from the header's lines.
fn prophesee(head: &[u8]) -> Option<FileKind> {
    let lines = head.split(|&byte| byte == b'\n').map_while(|line| line.strip_prefix(b"% ")).take(256);
    let named = lines.map(|line| String::from_utf8_lossy(line).to_ascii_lowercase()).find_map(|line| {
        let begins = |with: &[&str]| with.iter().any(|with| line.starts_with(with));
        match () {
            () if begins(&["evt ", "format evt"]) => Some(EventFormat::Raw),
            () if begins(&["data file containing", "version "]) => Some(EventFormat::Dat),
            () => None,
        }
    });
    named.map(FileKind::Events)
}

/// The kind of a text, from its first lines.
fn text(text: &str) -> Option<FileKind> {
    let text = text.trim_start_matches('\u{feff}');
    let root = root_name(text);
    if root.starts_with(|first: char| first.is_ascii_uppercase()) && text.contains(&format!("{root}(")) {
        return Some(FileKind::Ron);
    }
    if begins_recording(text) {
        return Some(FileKind::Events(EventFormat::Text));
    }
    let row = text.lines().map(str::trim).find(|row| !row.is_empty() && !row.starts_with('#'))?;
    csv::is_header(row).then_some(FileKind::SpikeList)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_content_decides_and_the_name_where_it_says_nothing() {
        let kind = |bytes: &[u8], name: &str| FileKind::from_bytes(bytes, Path::new(name));
        let zip = |first: &str| [ZIP, &[0; 22], &[first.len() as u8, 0, 0, 0], first.as_bytes()].concat();
        for (bytes, kind_of_it) in [
            (&b"\x93NUMPY\x01\0"[..], FileKind::Npy),
            (&b"\x89HDF\r\n\x1a\n\0"[..], FileKind::Hdf5),
            (&zip("archive/data.pkl"), FileKind::Torch),
            (&zip("spikes.npy"), FileKind::Npz),
            (b"#!AER-DAT4.0\r\n\0\0", FileKind::Events(EventFormat::Aedat4)),
            (b"#!AER-DAT2.0\r\n\0\0", FileKind::Events(EventFormat::Aedat4)),
            (b"% date 2020\n% evt 3.0\n\x01\0", FileKind::Events(EventFormat::Raw)),
            (b"% Data file containing CD events.\n% Version 2\n\x0c\x08", FileKind::Events(EventFormat::Dat)),
            (b"# by hand\nt_us,x,y,p\n1,2,3,1\n", FileKind::Events(EventFormat::Text)),
            (b"timestep,channel\n1,2\n", FileKind::SpikeList),
            (b"// a model\nNetwork(name: \"x\")", FileKind::Ron),
        ] {
            for name in ["a", "a.bin", "a.csv", "a.npy", "a.aedat", "a.txt", "a.h5", "a.pt"] {
                assert_eq!(kind(bytes, name), kind_of_it, "{name} with {}", String::from_utf8_lossy(bytes));
            }
        }
        // A recording may begin with any byte.
        assert_eq!(kind(b"\x80\x02\x00", "a.bin"), FileKind::Events(EventFormat::Bin));
        assert_eq!(kind(b"\x80\x02\x00", "a"), FileKind::Torch);
        assert_eq!(kind(b"% \x01\x02", "a.dat"), FileKind::Events(EventFormat::Dat));
        assert_eq!(kind(b"0,1\n", "a.csv"), FileKind::SpikeList);
        assert_eq!(kind(b"g 0 1", "a.net"), FileKind::Net);
        assert_eq!(kind(b"hello", "a"), FileKind::Unknown);
    }
}
