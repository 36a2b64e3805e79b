//! Probe recordings in formats of other tools.
//!
//! Input: numbers `[samples][compartments][steps]` of one register of one population. Output: CSV
//! with a row for each spike or each number, or NIR data (spikes as events, other registers on a
//! grid of time). NumPy arrays are written in [`nsim_files::npy`].

use std::path::Path;

use crate::hdf5;
use crate::spikes::events::nir_data;
use nsim_files::write;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The most numbers of a NIR file, which is made in memory.
const MOST_GRIDDED: usize = 1 << 26;

/// A recorded register.
pub struct Trace<'a> {
    /// Name of the recorded population.
    pub population: &'a str,
    /// The register's name: spikes, u, v or v_register.
    pub register: &'a str,
    /// Samples, compartments, timesteps.
    pub shape: [usize; 3],
    /// Length of a timestep in seconds.
    pub dt_s: f64,
}

impl Trace<'_> {
    /// Writes rows `sample,timestep,channel` for spikes, `sample,timestep,compartment,value` for
    /// other registers. Errors are those of [`write::Batch::add`].
    pub fn csv(&self, path: &Path, batch: &mut write::Batch, numbers: impl Iterator<Item = f64>) -> Result<()> {
        let [_, units, steps] = self.shape;
        let spikes = self.register == "spikes";
        batch.add(path, |out| {
            if spikes {
                // Silence at the end has no row, so a comment has the length, as in event lists.
                writeln!(out, "# steps: {steps}\nsample,timestep,channel")?;
            } else {
                writeln!(out, "sample,timestep,compartment,value")?;
            }
            for (at, number) in numbers.enumerate() {
                let (sample, unit, step) = (at / (units * steps).max(1), at / steps.max(1) % units, at % steps.max(1));
                if !spikes {
                    writeln!(out, "{sample},{step},{unit},{number}")?;
                } else if number != 0.0 {
                    writeln!(out, "{sample},{step},{unit}")?;
                }
            }
            Ok(())
        })
    }

    /// Writes a file of NIR data, with the population as its node and the register as its
    /// observable.
    ///
    /// # Errors
    /// `write.too-large` beyond 2^26 numbers; as [`write::Batch::add`].
    pub fn nir(&self, path: &Path, batch: &mut write::Batch, numbers: impl Iterator<Item = f64>) -> Result<()> {
        let [samples, units, steps] = self.shape;
        if samples * units * steps > MOST_GRIDDED {
            let message =
                format!("{samples} x {units} x {steps} numbers are more than a NIR file takes, {MOST_GRIDDED}");
            return Err(
                Diagnostic::new("write.too-large", message).help("choose fewer --samples, or --probe-format npy")
            );
        }
        let data = if self.register == "spikes" {
            let mut events = vec![Vec::new(); samples];
            for (at, _) in numbers.enumerate().filter(|(_, number)| *number != 0.0) {
                events[at / (units * steps)].push(((at % steps) as u32, (at / steps % units) as u32));
            }
            events.iter_mut().for_each(|sample| sample.sort_unstable());
            nir_data::events(&events, units as u32, steps as u32, self.dt_s)
        } else {
            // In NIR the axis of time precedes the neurons.
            let mut grid = vec![0.0; samples * units * steps];
            for (at, number) in numbers.enumerate() {
                let (sample, unit, step) = (at / (units * steps), at / steps % units, at % steps);
                grid[(sample * steps + step) * units + unit] = number;
            }
            nir_data::time_grid(&grid, [samples, steps, units], self.dt_s)
        };
        let bytes = hdf5::write(&nir_data::file(self.population, self.register, data))?;
        batch.add(path, |out| out.write_all(&bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spikes::{EventOptions, InputSpec, read_source, read_spikes};

    fn whole(write: impl FnOnce(&mut write::Batch) -> Result<()>) {
        let mut batch = write::Batch::new(false);
        write(&mut batch).unwrap();
        batch.commit().unwrap();
    }

    #[test]
    fn spikes_that_are_written_are_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let trace = Trace { population: "out", register: "spikes", shape: [2, 3, 4], dt_s: 2e-3 };
        let numbers: Vec<f64> = (0..24).map(|i| f64::from(u8::from([1, 6, 11, 12, 23].contains(&i)))).collect();
        let events = [vec![(1, 0), (2, 1), (3, 2)], vec![(0, 0), (3, 2)]];
        let csv = folder.path().join("s.csv");
        whole(|batch| trace.csv(&csv, batch, numbers.iter().copied()));
        let back = read_source(&csv, 3).unwrap();
        assert_eq!((back.len(), back[0].steps), (2, 4));
        let nir = folder.path().join("s.nir");
        whole(|batch| trace.nir(&nir, batch, numbers.iter().copied()));
        let expected = InputSpec { units: 3, volume: None, dt_ms: 2.0, values: false };
        let again = read_spikes(&nir, "out", &expected, &EventOptions::default()).unwrap();
        for (sample, events) in events.iter().enumerate() {
            let mut from_csv = back[sample].events.clone();
            from_csv.sort_unstable();
            assert_eq!((&from_csv, &again[sample].events, again[sample].steps), (events, events, 4));
        }
    }

    #[test]
    fn voltages_keep_their_place() {
        let folder = tempfile::tempdir().unwrap();
        let trace = Trace { population: "out", register: "v", shape: [1, 2, 3], dt_s: 1e-3 };
        let path = folder.path().join("v.nir");
        whole(|batch| trace.nir(&path, batch, (0..6).map(f64::from)));
        let tree = hdf5::tree(&path, std::fs::read(&path).unwrap()).unwrap();
        let data = tree.numbers("nodes/out/observables/v/data").unwrap();
        assert_eq!(
            (data.shape(), data.reals().collect::<Vec<_>>()),
            (&[1, 3, 2][..], vec![0.0, 3.0, 1.0, 4.0, 2.0, 5.0])
        );
        let csv = folder.path().join("v.csv");
        whole(|batch| trace.csv(&csv, batch, (0..6).map(f64::from)));
        let text = std::fs::read_to_string(csv).unwrap();
        assert_eq!(text.lines().nth(4), Some("0,0,1,3"));
    }
}
