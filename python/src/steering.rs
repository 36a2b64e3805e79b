//! Values of input populations that a session sets for a timestep: messages and signals.

use nsim::ir::base::id::ChannelId;
use nsim::ir::quantised::{Population, Quantised};
use nsim::ir::spikes::Message;
use pyo3::prelude::*;

use crate::arrays::{Array, matches_shape};
use crate::keywords::usage;

/// Adds the messages of a population's channels in a step, from a number for each.
pub fn add_values(
    shown: &mut Vec<(ChannelId, i32)>,
    given: &Bound<'_, PyAny>,
    (first, population): (u32, &Population),
    is_signal: bool,
) -> PyResult<()> {
    let (name, shape) = (&population.name, population.shape);
    let bits = match population.message {
        Message::Value(bits) if is_signal => bits.get(),
        _ => 32,
    };
    let array = Array::new(given, name)?;
    if !matches_shape(shape, array.shape()) {
        let message = format!("'{name}' has {} channels, and numbers of shape {:?}", shape.len(), array.shape());
        return Err(usage(message, &format!("give one for each channel, along one axis or as {shape}")));
    }
    let limit = 2f64.powi(i32::from(bits) - 1);
    let help = format!("give an integer from {} to {} for each channel, 0 for none", -limit, limit - 1.0);
    for (number, value) in array.numbers(shape.len() as usize, &help)?.into_iter().enumerate() {
        if value.fract() != 0.0 || !(-limit..limit).contains(&value) {
            return Err(usage(format!("channel {number} of '{name}' cannot send {value}"), &help));
        }
        shown.push((ChannelId(first + number as u32), value as i32));
    }
    Ok(())
}

/// The populations that are signals of a rule, each with its first channel.
pub fn signals(network: &Quantised) -> impl Iterator<Item = (u32, &Population)> {
    let is_signal = |id| {
        let mut plastic = network.plastic().filter_map(|(_, projection)| projection.plastic.as_ref());
        plastic.any(|plastic| plastic.signals.contains(&Some(id)))
    };
    network
        .inputs()
        .filter_map(move |(id, population)| Some((population.first_channel()?.0, population)).filter(|_| is_signal(id)))
}
