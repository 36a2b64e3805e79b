//! Spikes from archives of NumPy arrays, `.npz`.
//!
//! Input: an archive of `numpy.savez` or `savez_compressed`. Output: the spikes of each sample,
//! with labels where the archive has them. The spikes are the array with the name of the
//! population, else `spikes`, `x`, `data`, `arr_0`, else the only one. Labels are the array
//! `labels`, `y` or `targets`. Other arrays are ignored.
//!
//! Errors: `input.npz`; `input.labels`; errors of arrays.

use std::io::{Cursor, Read};
use std::path::Path;

use zip::ZipArchive;

use super::array;
use super::events::text::is_header;
use super::labels;
use super::options::ArrayOptions;
use super::population::PopulationSpikes;
use nsim_files::npy;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The most bytes of an unpacked array, since few compressed bytes may claim many.
const MOST_UNPACKED: u64 = 256 << 20;
const MOST_ARRAYS: usize = 4096;
const SPIKES: [&str; 4] = ["spikes", "x", "data", "arr_0"];
const LABELS: [&str; 3] = ["labels", "y", "targets"];

/// An archive of arrays.
pub(crate) struct Archive<'p> {
    path: &'p Path,
    zip: ZipArchive<Cursor<Vec<u8>>>,
    /// The names of its files.
    files: Vec<String>,
}

impl<'p> Archive<'p> {
    /// Reads the list of files.
    pub(crate) fn open(path: &'p Path, bytes: Vec<u8>) -> Result<Self> {
        let zip = ZipArchive::new(Cursor::new(bytes))
            .map_err(|error| wrong(path, format!("the archive cannot be read: {error}")))?;
        if zip.len() > MOST_ARRAYS {
            return Err(wrong(path, format!("the archive has {} files, more than {MOST_ARRAYS}", zip.len())));
        }
        let files = zip.file_names().filter_map(std::result::Result::ok).map(|name| name.to_string()).collect();
        Ok(Archive { path, zip, files })
    }

    /// The names of the arrays.
    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.files.iter().filter_map(|name| name.strip_suffix(".npy"))
    }

    /// Reads an array.
    pub(crate) fn array(&mut self, name: &str) -> Result<npy::Array> {
        let path = self.path;
        let broken =
            |error: &dyn std::fmt::Display| wrong(path, format!("'{name}' of the archive cannot be read: {error}"));
        let file = self.zip.by_name(&format!("{name}.npy")).map_err(|error| broken(&error))?;
        if file.size() > MOST_UNPACKED {
            return Err(broken(&format!("{} bytes are more than {MOST_UNPACKED}", file.size())));
        }
        let mut bytes = Vec::new();
        file.take(MOST_UNPACKED).read_to_end(&mut bytes).map_err(|error| broken(&error))?;
        npy::Array::from_bytes(path, bytes)
    }
}

fn wrong(path: &Path, message: String) -> Diagnostic {
    Diagnostic::new("input.npz", message).in_file(path)
}

/// Reads the bytes of a file for a population of `units` channels.
pub fn from_bytes(
    path: &Path,
    bytes: Vec<u8>,
    population: &str,
    units: u64,
    options: ArrayOptions,
) -> Result<Vec<PopulationSpikes>> {
    let mut archive = Archive::open(path, bytes)?;
    let names: Vec<String> = archive.names().map(str::to_string).collect();
    let arrays: Vec<&str> = names.iter().map(String::as_str).collect();
    let find = |wanted: &[&str]| {
        wanted.iter().find_map(|wanted| arrays.iter().copied().find(|name| name.eq_ignore_ascii_case(wanted)))
    };
    let named_labels = find(&LABELS);
    let mut others = arrays.iter().copied().filter(|name| Some(*name) != named_labels);
    let only = others.next().filter(|_| others.next().is_none());
    let exact = arrays.iter().copied().find(|name| *name == population);
    let Some(spikes) = exact.or_else(|| find(&SPIKES)).or(only) else {
        let message =
            format!("no array of the archive is named '{population}' or spikes; there are {}", arrays.join(", "));
        return Err(wrong(path, message)
            .help("name the array of each population as the population: np.savez(FILE, POPULATION=spikes)"));
    };
    let spikes = archive.array(spikes)?;
    // Arrays of x and time are a list of events, of which x alone would be read.
    if is_header(&arrays.join(",")) && spikes.shape().len() == 1 {
        return Err(wrong(path, format!("the archive holds events ({}), not spikes", arrays.join(", ")))
            .help("write them as rows of text with the header t_us,x,y,p (t_s, t_ms or t_ns in other units)"));
    }
    let mut recordings = array::from_array(&spikes, units, options)?;
    if let Some(name) = named_labels {
        labels::apply(path, &labels::from_array(&archive.array(name)?)?, &mut recordings)?;
    }
    Ok(recordings)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::write::{SimpleFileOptions, ZipWriter};

    use super::*;

    fn archive(arrays: &[(&str, &[u64], &[u8])], method: zip::CompressionMethod) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for (name, shape, numbers) in arrays {
            zip.start_file(format!("{name}.npy"), SimpleFileOptions::default().compression_method(method)).unwrap();
            let mut bytes = Vec::new();
            npy::write(&mut bytes, shape, numbers.iter().copied()).unwrap();
            zip.write_all(&bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    fn read(bytes: Vec<u8>, population: &str) -> Result<Vec<PopulationSpikes>> {
        from_bytes(Path::new("a.npz"), bytes, population, 2, ArrayOptions::default())
    }

    #[test]
    fn the_array_of_a_population_is_found_and_labelled() {
        let spikes: (&[u64], &[u8]) = (&[2, 2, 3], &[0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]);
        for method in [zip::CompressionMethod::Stored, zip::CompressionMethod::Deflated] {
            for name in ["touch", "x", "arr_0", "anything"] {
                let read = read(archive(&[(name, spikes.0, spikes.1), ("y", &[2], &[1, 0])], method), "touch").unwrap();
                assert_eq!(read.iter().map(|s| s.label).collect::<Vec<_>>(), [Some(1), Some(0)]);
                assert_eq!(read.iter().map(|s| s.events.len()).collect::<Vec<_>>(), [2, 1]);
            }
        }
        let stored = zip::CompressionMethod::Stored;
        let code = |arrays: &[(&str, &[u64], &[u8])]| read(archive(arrays, stored), "touch").unwrap_err().code;
        assert_eq!(code(&[("a", spikes.0, spikes.1), ("b", spikes.0, spikes.1)]), "input.npz");
        assert_eq!(code(&[("x", spikes.0, spikes.1), ("y", &[3], &[1, 0, 1])]), "input.labels");
        assert_eq!(code(&[]), "input.npz");
        // An array x of events is not an array of spikes.
        let events: [(&str, &[u64], &[u8]); 3] = [("x", &[2], &[0, 1]), ("y", &[2], &[1, 0]), ("t", &[2], &[1, 9])];
        let error =
            from_bytes(Path::new("a.npz"), archive(&events, stored), "touch", 1, ArrayOptions::default()).unwrap_err();
        assert!(error.message.contains("holds events (x, y, t)"), "{error}");
        assert_eq!(read(b"no archive".to_vec(), "touch").unwrap_err().code, "input.npz");
    }
}
