//! Recordings for one input population from any kind of source: the entry point of this module.
//!
//! Input: a path and the requirements of the population. Output: the spikes of each sample, with
//! the label of the source. The caller assigns sources to populations and compares their numbers of
//! samples.

use std::path::Path;

use super::manifest::read_manifest;
use super::options::EventOptions;
use super::population::{InputSpec, PopulationSpikes};
use super::recordings::{self, Request};
use crate::kind::FileKind;
use nsim_ir::base::diagnostic::Result;

/// Reads a source for a population of `units` channels.
///
/// # Errors
/// `input.kind` for an unknown kind of file; `input.*`, `npy.*`, `io.*` for problems of a known
/// one.
pub fn read_source(path: &Path, units: u64) -> Result<Vec<PopulationSpikes>> {
    read_spikes(path, "", &InputSpec { units, volume: None, dt_ms: 1.0, values: false }, &EventOptions::default())
}

/// Reads a source for a population, with the options after its `?`. Options other than `polarity`
/// and `least` are for recordings of events. In an array, `polarity` applies to the one axis of
/// length 2 before time.
///
/// # Errors
/// As [`read_source`]; `input.option` for an option that the source does not support.
pub fn read_spikes(
    path: &Path,
    population: &str,
    expected: &InputSpec,
    options: &EventOptions,
) -> Result<Vec<PopulationSpikes>> {
    if FileKind::detect(path)? != FileKind::Ron {
        return recordings::read(path, Request { population, expected, options });
    }
    recordings::takes_no_options(path, options)?;
    read_manifest(path)?.read_only(expected)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_files::npy;

    fn array(folder: &Path, name: &str, shape: &[u64], numbers: &[u8]) -> std::path::PathBuf {
        let path = folder.join(name);
        npy::write(std::fs::File::create(&path).unwrap(), shape, numbers.iter().copied()).unwrap();
        path
    }

    #[test]
    fn both_layouts_of_an_array_are_read() {
        let folder = tempfile::tempdir().unwrap();
        // Two samples, 1 x 2 channels, three steps.
        let path = array(folder.path(), "a.npy", &[2, 1, 2, 3], &[0, 1, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0]);
        let samples = read_source(&path, 2).unwrap();
        assert_eq!(samples.iter().map(|s| s.events.clone()).collect::<Vec<_>>(), [vec![(1, 0), (2, 1)], vec![(0, 0)]]);
        assert!(samples.iter().all(|s| (s.steps, s.units, s.label) == (3, Some(2), None)));
        let sample = read_source(&path, 4).unwrap();
        assert_eq!((sample.len(), &sample[0].events[..]), (1, &[(1, 0), (2, 1), (0, 2)][..]));
        let error = read_source(&path, 3).unwrap_err();
        assert_eq!(error.code, "input.shape");
        assert!(error.message.contains("as one sample it has 4, as 2 samples 2 in each"), "{error}");
        let line = array(folder.path(), "b.npy", &[3], &[0, 1, 0]);
        assert_eq!(read_source(&line, 1).unwrap()[0].events, [(1, 0)]);
        for (shape, units) in [(&[2, 0][..], 2), (&[], 1)] {
            let path = array(folder.path(), "c.npy", shape, &vec![0; shape.iter().product::<u64>() as usize]);
            assert!(read_source(&path, units).unwrap_err().code.ends_with(".shape"));
        }
        let long = array(folder.path(), "d.npy", &[1, (1 << 24) + 1], &vec![0; (1 << 24) + 1]);
        assert_eq!(read_source(&long, 1).unwrap_err().code, "input.too-long");
    }

    #[test]
    fn a_folder_is_read_in_order_of_its_numbers() {
        let folder = tempfile::tempdir().unwrap();
        for (i, label) in [(10, 3), (2, 1), (0, 0)] {
            array(folder.path(), &format!("sample_{i}_label_{label}.npy"), &[1, 1], &[1]);
        }
        std::fs::write(folder.path().join("README.md"), "x").unwrap();
        std::fs::write(folder.path().join("sample_x_label_1.npy"), "x").unwrap();
        let labels: Vec<_> = read_source(folder.path(), 1).unwrap().iter().map(|s| s.label).collect();
        assert_eq!(labels, [Some(0), Some(1), Some(3)]);
        array(folder.path(), "sample_02_label_5.npy", &[1, 1], &[1]);
        assert_eq!(read_source(folder.path(), 1).unwrap_err().code, "input.folder");
        let outer = tempfile::tempdir().unwrap();
        std::fs::create_dir(outer.path().join("train")).unwrap();
        let error = read_source(outer.path(), 1).unwrap_err();
        assert!(error.code == "input.folder" && error.help.unwrap().contains("train"), "{}", error.message);
    }

    fn read_as(path: &Path, units: u64, options: &str) -> Result<Vec<PopulationSpikes>> {
        let options = EventOptions::parse(&nsim_ir::stimulus::pairs(options)?)?;
        read_spikes(path, "", &InputSpec { units, volume: None, dt_ms: 1.0, values: false }, &options)
    }

    /// Compares [N, taxels, 2, T] and [N, 2, height, width, T], as VT_SNN writes them, with loops
    /// over all axes.
    #[test]
    fn the_polarities_of_an_array_merge_wherever_their_axis_is() {
        let folder = tempfile::tempdir().unwrap();
        let (n, outer, inner, steps) = (3u32, 5u32, 4u32, 6u32);
        // Each layout, with the sizes before and after the polarity.
        for (shape, before, behind) in
            [(vec![n, outer, 2, steps], outer, 1), (vec![n, 2, outer, inner, steps], 1, outer * inner)]
        {
            let size = shape.iter().product::<u32>();
            let numbers: Vec<u8> =
                (0..size).map(|i| u8::from(nsim_ir::base::rng::unit(3, 0, u64::from(i)) < 0.3)).collect();
            let shape: Vec<u64> = shape.into_iter().map(u64::from).collect();
            let path = array(folder.path(), &format!("{behind}.npy"), &shape, &numbers);
            for (options, wanted) in
                [("polarity=merge", [true, true]), ("polarity=on", [false, true]), ("polarity=off", [true, false])]
            {
                let read = read_as(&path, u64::from(before * behind), options).unwrap();
                assert_eq!(read.len(), n as usize);
                for (sample, read) in (0..n).zip(read) {
                    let mut events = Vec::new();
                    for (a, b, t) in
                        (0..before).flat_map(|a| (0..behind).flat_map(move |b| (0..steps).map(move |t| (a, b, t))))
                    {
                        let spike = |p: u32| {
                            numbers[((((sample * before + a) * 2 + p) * behind + b) * steps + t) as usize] != 0
                        };
                        if (0..2).any(|p| wanted[p as usize] && spike(p)) {
                            events.push((t, a * behind + b));
                        }
                    }
                    let mut got = read.events;
                    got.sort_unstable();
                    events.sort_unstable();
                    assert_eq!(got, events, "{options}");
                }
            }
            assert_eq!(read_as(&path, u64::from(2 * before * behind), "").unwrap().len(), n as usize);
            assert_eq!(read_as(&path, 7, "polarity=merge").unwrap_err().code, "input.shape");
            assert_eq!(read_as(&path, 20, "polarity=merge&pool=2").unwrap_err().code, "input.option");
        }
        let twice = array(folder.path(), "t.npy", &[2, 2, 3, 1], &[0; 12]);
        assert!(read_as(&twice, 6, "polarity=merge").unwrap_err().message.contains("which is the polarity"));
    }

    #[test]
    fn a_folder_of_recordings_is_read_by_label_or_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let named = folder.path().join("named");
        std::fs::create_dir(&named).unwrap();
        for (name, rows) in [("cup_10_2.tact", "1 1 0.0005\n"), ("cup_2_10.tact", "0 18 0.0010\n1 80 0.0031\n")] {
            std::fs::write(named.join(name), rows).unwrap();
        }
        let read = read_as(&named, 156, "steps=4").unwrap();
        // cup_2 comes before cup_10; cell 18 is taxel 16, cell 80 taxel 77.
        assert_eq!(read.iter().map(|s| s.label).collect::<Vec<_>>(), [None, None]);
        assert_eq!((&read[0].events[..], &read[1].events[..]), (&[(1, 32), (3, 155)][..], &[(0, 1)][..]));
        let merged = read_as(&named, 78, "steps=2&bin_ms=2&polarity=merge").unwrap();
        assert_eq!((merged[0].steps, &merged[0].events[..]), (2, &[(0, 16), (1, 77)][..]));
        std::fs::write(named.join("sample_3_label_1.tact"), "1 1 0.001\n").unwrap();
        let read = read_as(&named, 156, "steps=4").unwrap();
        assert_eq!((read.len(), read[0].label), (1, Some(1)));
        std::fs::write(named.join("sample_4_label_1.tact"), "1 1 0.001\n2 1 0.001\n").unwrap();
        let error = read_as(&named, 156, "steps=4").unwrap_err();
        assert!(error.message.contains("row 2") && error.file().unwrap().ends_with("sample_4_label_1.tact"), "{error}");
    }

    /// A data set that names itself would be read without end.
    #[test]
    fn a_data_set_is_no_recording_of_a_data_set() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("d.ron");
        std::fs::write(&path, r#"DataSet(name: "x", populations: {"a": "a"}, recordings: {"a": "d.ron"})"#).unwrap();
        let error = read_source(&path, 1).unwrap_err();
        assert!(error.code == "input.kind" && error.message.contains("another data set"), "{error}");
        assert_eq!(error.position().unwrap().line, 1);
    }
}
