//! What a session reads and sets by name between timesteps: what rules change, signals and random
//! numbers.

use nsim::ir::base::id::{ChannelId, RuleId};
use nsim::ir::learning::draws::{Recorded, Use};
use nsim::ir::learning::{Column, Variable};
use nsim::ir::quantised::{Population, Quantised};
use nsim::ir::spikes::Message;
use nsim::session::learning::parse_probe;
use numpy::PyArray1;
use pyo3::exceptions::{PyKeyError, PyTypeError};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::{Array, matches_shape};
use crate::error::exception;
use crate::keywords::usage;
use crate::session::Session;

/// The most numbers of an array that a session takes.
const MOST_NUMBERS: usize = 1 << 27;

/// What the names of [`Values`] select.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// A variable of the synapses of a projection that learns.
    Synapses(Variable),
    /// A trace of a projection that learns: NAME.x1.
    Traces,
    /// The value of a signal in the next timestep.
    Signal,
    /// Random numbers of a projection that learns, in the next timestep.
    Draws,
}

/// Values of a session by name, such as `session.weights["NAME"]`.
#[pyclass(frozen, module = "nsim")]
pub struct Values {
    session: Py<Session>,
    kind: Kind,
}

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

impl Values {
    /// These values of a session.
    pub fn new(session: &Bound<'_, Session>, kind: Kind) -> PyResult<Self> {
        session.get().check_open(session.py())?;
        Ok(Values { session: session.clone().unbind(), kind })
    }

    fn names(&self) -> Vec<&str> {
        let network = self.session.get().network();
        match self.kind {
            Kind::Signal => signals(network).map(|(_, population)| population.name.as_str()).collect(),
            _ => network.parts().rules.iter().map(|rule| rule.name.as_str()).collect(),
        }
    }

    fn unknown(&self, name: &str) -> PyErr {
        let what = if self.kind == Kind::Signal { "signal" } else { "projection that learns" };
        PyKeyError::new_err(format!("no {what} '{name}'; there are: {}", self.names().join(", ")))
    }

    fn rule(&self, py: Python<'_>, name: &str) -> PyResult<RuleId> {
        self.session.get().stepped(py, |stepped| stepped.rule_named(name))?.map_err(|_| self.unknown(name))
    }

    fn signal(&self, name: &str) -> PyResult<(u32, &Population)> {
        let found = signals(self.session.get().network()).find(|(_, population)| population.name == name);
        found.ok_or_else(|| self.unknown(name))
    }
}

#[pymethods]
impl Values {
    /// The values of this name, int32; of `draws` a dictionary with the number of those that the
    /// next timestep takes.
    fn __getitem__<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let session = self.session.get();
        let (rule, column) = match self.kind {
            Kind::Synapses(variable) => (self.rule(py, name)?, Column::Variable(variable)),
            Kind::Traces => match parse_probe(name) {
                Some((name, column @ Column::Trace(_), false)) => (self.rule(py, name)?, column),
                _ => return Err(PyKeyError::new_err(format!("'{name}' is not NAME.x1, .x2, .y1, .y2, .y3 or .r1"))),
            },
            Kind::Signal => {
                let (first, population) = self.signal(name)?;
                let mut values = vec![0; population.shape.len() as usize];
                session.stepped(py, |stepped| {
                    for &(channel, value) in stepped.next() {
                        if let Some(place) = channel.0.checked_sub(first).and_then(|n| values.get_mut(n as usize)) {
                            *place = value;
                        }
                    }
                })?;
                return Ok(PyArray1::from_vec(py, values).into_any());
            }
            Kind::Draws => {
                let rule = self.rule(py, name)?;
                let needed = session.stepped(py, |stepped| stepped.draws_needed(rule))?;
                let counts = PyDict::new(py);
                for (of, count) in needed.map_err(|problem| exception(py, problem))? {
                    counts.set_item(of.name(), count)?;
                }
                return Ok(counts.into_any());
            }
        };
        Ok(PyArray1::from_vec(py, session.stepped(py, |stepped| stepped.learned(rule, column))?).into_any())
    }

    fn __setitem__(&self, py: Python<'_>, name: &str, given: &Bound<'_, PyAny>) -> PyResult<()> {
        let session = self.session.get();
        let done = match self.kind {
            Kind::Synapses(Variable::Weight) => {
                let rule = self.rule(py, name)?;
                let array = Array::new(given, format!("weights['{name}']"))?;
                let help = "give integers, one for each synapse";
                let mut weights = Vec::new();
                for (index, value) in array.numbers(MOST_NUMBERS, help)?.into_iter().enumerate() {
                    if f64::from(value as i32) != value {
                        let wrong = array.wrong(index, value, "and a weight is an integer").help(help);
                        return Err(exception(py, wrong));
                    }
                    weights.push(value as i32);
                }
                session.stepped(py, |stepped| stepped.write_weights(rule, &weights))?
            }
            Kind::Signal => {
                let mut shown = Vec::new();
                add_values(&mut shown, given, self.signal(name)?, true)?;
                session.stepped(py, |stepped| stepped.set_next(shown))?
            }
            Kind::Draws => {
                let (rule, mut numbers) = (self.rule(py, name)?, Recorded::new());
                for (key, array) in given.cast::<PyDict>()?.iter() {
                    let key: String = key.extract()?;
                    let Some(of) = Use::ALL.into_iter().find(|of| of.name() == key) else {
                        let known = Use::ALL.map(Use::name).join(", ");
                        return Err(usage(format!("draws['{name}']: unknown key '{key}'"), &format!("keys: {known}")));
                    };
                    let help = "give the numbers of one step";
                    let array = Array::new(&array, format!("draws['{name}']['{key}']"))?;
                    numbers.insert(of, array.numbers(MOST_NUMBERS, help)?);
                }
                session.stepped(py, |stepped| stepped.set_draws(rule, numbers))?
            }
            Kind::Synapses(_) | Kind::Traces => {
                return Err(PyTypeError::new_err("these values can only be read; weights and signals can be set"));
            }
        };
        done.map_err(|problem| exception(py, problem))
    }

    /// The names; of traces the names of their projections.
    fn keys(&self) -> Vec<&str> {
        self.names()
    }
}
