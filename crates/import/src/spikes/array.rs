//! Spikes from NumPy arrays.
//!
//! Input: an array `[channels.., T]` or `[samples, channels.., T]`, in which one whole number
//! other than zero is a spike, and the expected number of channels. Output: the spikes of each
//! sample. A polarity option merges or drops the one axis of length 2 before time. Errors:
//! `input.shape`, `input.too-long`, `input.too-many`, `input.value`, and errors of the array's
//! numbers.

use super::options::{ArrayOptions, Polarity};
use super::population::{PopulationSpikes, too_many};
use nsim_files::budget::{MOST_EVENTS, MOST_STEPS};
use nsim_files::npy;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

fn product(axes: &[usize]) -> Option<u64> {
    axes.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis as u64))
}

/// Maps an index along the channel axes to a channel, under a polarity option.
#[derive(Clone, Copy)]
struct Merging {
    polarity: Polarity,
    /// Number of channels per index of the polarity axis.
    inner: usize,
}

impl Merging {
    /// The channel; `None` for a dropped polarity. Index 1 of the axis is a rise.
    fn channel(self, flat: usize) -> Option<usize> {
        let on = (flat / self.inner) % 2 == 1;
        let spiking = match self.polarity {
            Polarity::Both => return Some(flat),
            Polarity::Merge => true,
            Polarity::On => on,
            Polarity::Off => !on,
        };
        spiking.then(|| flat / (2 * self.inner) * self.inner + flat % self.inner)
    }

    /// The merging of channel axes that results in `units` channels; `None` for another number.
    fn for_axes(polarity: Polarity, axes: &[usize], units: u64) -> Result<Option<Merging>, String> {
        let channels = product(axes);
        if polarity == Polarity::Both {
            return Ok((channels == Some(units)).then_some(Merging { polarity, inner: 1 }));
        }
        if channels != units.checked_mul(2) {
            return Ok(None);
        }
        let mut pairs = (0..axes.len()).filter(|&axis| axes[axis] == 2);
        match (pairs.next(), pairs.next()) {
            (Some(axis), None) => Ok(Some(Merging { polarity, inner: axes[axis + 1..].iter().product() })),
            (None, _) => Ok(None),
            _ => Err(format!("several of the axes {axes:?} before time have length 2: which is the polarity?")),
        }
    }
}

/// The spikes of an array for a population of `units` channels.
pub(super) fn from_array(array: &npy::Array, units: u64, options: ArrayOptions) -> Result<Vec<PopulationSpikes>> {
    let (path, shape, polarity) = (array.path(), array.shape(), options.polarity);
    let wrong = |message: String| Diagnostic::new("input.shape", message).in_file(path);
    let Some((&steps, leading)) = shape.split_last() else {
        return Err(wrong("a single number is not a recording; an array has shape [channels.., T]".to_string()));
    };
    let one = Merging::for_axes(polarity, leading, units).map_err(wrong)?;
    let each = match leading.split_first() {
        Some((_, channels)) if one.is_none() => Merging::for_axes(polarity, channels, units).map_err(wrong)?,
        _ => None,
    };
    let (samples, merging) = match (one, each) {
        (Some(merging), _) => (1, merging),
        (None, Some(merging)) => (leading[0], merging),
        (None, None) => {
            let one = product(leading).unwrap_or(u64::MAX);
            let mut message =
                format!("shape {shape:?} does not fit a population of {units} channels: as one sample it has {one}");
            if let Some(each) = leading.split_first().and_then(|(_, channels)| product(channels)) {
                message.push_str(&format!(", as {} samples {each} in each", leading[0]));
            }
            // [T, channels..] or [samples, T, channels..]: time precedes the channels.
            let channels = |from: usize| product(shape.get(from..).unwrap_or_default()) == Some(units);
            let time_first = polarity == Polarity::Both && (channels(1) || shape.len() > 2 && channels(2));
            let help = match polarity {
                _ if time_first => {
                    "this looks like time before channels: move time to the last axis, np.moveaxis(spikes, FROM, -1)"
                }
                Polarity::Both => "the last axis is time; the axes before it, in C order, are the channel",
                _ => {
                    "polarity= selects one of two polarities: an axis before time must have length 2, and there must \
                     be twice the channels"
                }
            };
            return Err(wrong(message).help(help));
        }
    };
    if samples == 0 || steps == 0 {
        return Err(wrong(format!("shape {shape:?} holds no timestep")));
    }
    let steps = match u32::try_from(steps) {
        Ok(steps) if steps <= MOST_STEPS => steps,
        _ => {
            return Err(Diagnostic::new("input.too-long", format!("{steps} timesteps are more than {MOST_STEPS}"))
                .help("the last axis is time")
                .in_file(path));
        }
    };
    u32::try_from(units).map_err(|_| wrong(format!("{units} channels exceed the 32-bit range of channel numbers")))?;
    let rows = units as usize * if polarity == Polarity::Both { 1 } else { 2 };
    let mut recordings = PopulationSpikes::silent(samples, units, steps, path.display().to_string());
    let mut entries = options.entries(path);
    array.each_non_zero(|index, number| {
        if !entries.is_spike(index, number)? {
            return Ok(());
        }
        let (row, step) = (index / steps as usize, index % steps as usize);
        let (sample, Some(channel)) = (row / rows, merging.channel(row % rows)) else {
            return Ok(());
        };
        let PopulationSpikes { events, values, .. } = &mut recordings[sample];
        if events.len() == MOST_EVENTS {
            return Err(too_many().in_file(path));
        }
        events.push((step as u32, channel as u32));
        if options.values {
            values.push(options.value(number, path)?);
        }
        Ok(())
    })?;
    entries.finish()?;
    if polarity == Polarity::Merge {
        for recording in &mut recordings {
            recording.events.sort_unstable();
            recording.events.dedup();
        }
    }
    Ok(recordings)
}
