//! A mapping that a Python loop steps, for example with a robot or an environment in it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::base::id::{ChannelId, CompartmentId, PopulationId, RuleId};
use nsim::ir::graph::Shape;
use nsim::ir::learning::draws::{Recorded, Use};
use nsim::ir::learning::{Column, Variable};
use nsim::ir::neurons::NeuronKind;
use nsim::ir::quantised::{self, Quantised, Units};
use nsim::ir::spikes::{Engine, Message};
use nsim::session::Session as Stepped;
use nsim::session::learning::parse_probe;
use nsim::session::outcome::Probe;
use nsim::session::priced::MeteredMapping;
use nsim::session::samples::{Division, lay_out};
use nsim::session::session::append_before_pruning;
use numpy::{Element, PyArray1, PyArrayMethods, PyUntypedArray};
use pyo3::exceptions::{PyKeyError, PyTypeError};
use pyo3::prelude::*;
use pyo3::sync::MutexExt;
use pyo3::types::{IntoPyDict, PyDict, PyList, PyTuple};

use crate::arrays::{Array, copied, matches_shape};
use crate::energy::{Energy, Metering};
use crate::error::exception;
use crate::keywords::{Keywords, usage};
use crate::shared::Shared;
use crate::spikes::steps_to_run;
use crate::steering::{add_values, signals};
use crate::work::try_detached;

/// Channels that spike in a step, with the integers of their messages.
type Input = Vec<(ChannelId, i32)>;

/// A mapping after some timestep; `Mapping.session()` opens one.
///
/// `step` runs one timestep, `session["POPULATION"]` has the spikes and state of a population after
/// it. All copies of a network get the same input; spikes and registers are of the first.
#[pyclass(frozen, module = "nsim")]
pub struct Session {
    mapping: Arc<Shared>,
    /// A thread that steps holds the lock; the others wait.
    state: Mutex<State>,
}

/// The state of a session, which threads use one after another.
struct State {
    /// `None` once the session is closed.
    stepped: Option<Stepped>,
    /// How its timesteps are priced; `None` where they are not metered.
    metering: Option<Arc<Metering>>,
    /// Scratch memory: the input of a step.
    shown: Input,
}

impl State {
    fn stepped(&self) -> PyResult<&Stepped> {
        self.stepped.as_ref().ok_or_else(closed)
    }
}

/// The state of a session after some timestep.
#[pyclass(frozen, module = "nsim")]
pub struct Snapshot {
    mapping: Arc<Shared>,
    stepped: Stepped,
    metering: Option<Arc<Metering>>,
}

/// Spikes and state of a population of a session after the last timestep.
#[pyclass(frozen, module = "nsim")]
pub struct Population {
    session: Py<Session>,
    id: PopulationId,
}

impl Session {
    /// A session before its first step; `energy` is whether it is metered, or options of pricing.
    /// Without it a session is metered where its mapping can be priced.
    pub fn new(py: Python<'_>, mapping: &Arc<Shared>, seed: u64, energy: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let compiled = mapping.compiled();
        let options = match energy.map(|given| given.extract::<bool>().map_err(|_| given.cast::<PyDict>())) {
            None => Err(()),
            Some(Ok(true)) => Ok(Some(Keywords::new(None)?)),
            Some(Ok(false)) => Ok(None),
            Some(Err(options)) => Ok(Some(Keywords::new(Some(options?))?)),
        };
        let metering = match options {
            Ok(options) => options.map(|keywords| Metering::new(py, mapping, &keywords)).transpose()?,
            Err(()) => Metering::new(py, mapping, &Keywords::new(None)?).ok(),
        };
        let (metering, settings) = metering.unzip();
        let stepped = try_detached(py, || {
            let metered = settings.as_ref().map(|_| MeteredMapping::new(compiled));
            let copies = metered.as_ref().map_or(compiled.options.copies, MeteredMapping::copies_run);
            let program = metered.as_ref().map_or(&compiled.program, MeteredMapping::program);
            let division = Division::new(program, 1);
            let image = match mapping.image(division).filter(|image| Arc::ptr_eq(image.program(), program)) {
                Some(image) => image.clone(),
                None => lay_out(program, division)?,
            };
            let mut stepped = Stepped::open_metered(&image, &compiled.one, copies, settings);
            stepped.set_seed(seed);
            Ok::<_, Diagnostic>(stepped)
        })?;
        let state = State { stepped: Some(stepped), metering: metering.map(Arc::new), shown: Vec::new() };
        Ok(Session { mapping: mapping.clone(), state: Mutex::new(state) })
    }

    pub fn network(&self) -> &Quantised {
        &self.mapping.compiled().one
    }

    /// Refuses a closed session.
    pub fn check_open(&self, py: Python<'_>) -> PyResult<()> {
        self.state(py).stepped().map(|_| ())
    }

    /// The result of an action on the session.
    pub fn stepped<T>(&self, py: Python<'_>, action: impl FnOnce(&mut Stepped) -> T) -> PyResult<T> {
        self.state(py).stepped.as_mut().map(action).ok_or_else(closed)
    }

    /// Whether a message of this population is set for the next step.
    fn is_set_next(&self, py: Python<'_>, first: u32, population: &quantised::Population) -> PyResult<bool> {
        let channels = first..first + population.shape.len();
        self.stepped(py, |stepped| stepped.next().iter().any(|(channel, _)| channels.contains(&channel.0)))
    }

    /// The state, once no other thread uses it. A panic leaves it whole.
    fn state(&self, py: Python<'_>) -> MutexGuard<'_, State> {
        self.state.lock_py_attached(py).unwrap_or_else(PoisonError::into_inner)
    }
}

fn closed() -> PyErr {
    usage("the session is closed".into(), "open another: with mapping.session() as session")
}

/// Refuses an array with a value for each channel that has neither one axis nor the axes of the
/// population.
fn check_each(array: &Array<'_>, name: &str, shape: Shape, what: &str) -> PyResult<()> {
    if matches_shape(shape, array.shape()) {
        return Ok(());
    }
    let message = format!("'{name}' has {} channels, and {what} of shape {:?}", shape.len(), array.shape());
    Err(usage(message, &format!("give one for each channel, along one axis or as {shape}")))
}

/// Adds the channels of a population that spike in a step, from their numbers or from a truth value
/// for each.
fn add_channels(shown: &mut Input, given: &Bound<'_, PyAny>, first: u32, name: &str, shape: Shape) -> PyResult<()> {
    let (units, before, mut are_truths) = (shape.len(), shown.len(), false);
    let help = "give the numbers of the channels that spike, counted from 0, or a truth value for each: array > 0";
    let mut add = |number| shown.push((ChannelId(number), 1));
    // A masked array is an array, too.
    let plain = given.cast_exact::<PyUntypedArray>().ok();
    // Whether each number is one of a channel, of an array whose numbers can be copied.
    fn added<T: Element + Copy + TryInto<u32>>(
        array: &Bound<'_, PyUntypedArray>,
        add: &mut impl FnMut(u32),
    ) -> Option<bool> {
        let numbers = copied(array, |number: T| number.try_into().ok())?;
        Some(numbers.into_iter().all(|number| number.map(&mut *add).is_some()))
    }
    let of_plain = |array: &Bound<'_, PyUntypedArray>| {
        added::<i64>(array, &mut add)
            .or_else(|| added::<i32>(array, &mut add))
            .or_else(|| added::<u32>(array, &mut add))
    };
    let are_whole = if let Some(are_whole) = plain.and_then(of_plain) {
        are_whole
    } else if given.is_instance_of::<PyList>() || given.is_instance_of::<PyTuple>() || given.hasattr("__array__")? {
        let array = Array::new(given, format!("'{name}'"))?;
        let numbers = || array.numbers(units as usize, help);
        if array.holds_truth_values() {
            check_each(&array, name, shape, "truth values")?;
            are_truths = true;
            (0..).zip(numbers()?).filter(|&(_, spikes)| spikes != 0.0).for_each(|(number, _)| add(number));
            true
        } else if array.is_of_bytes() && matches_shape(shape, array.shape()) {
            // `run` reads a byte for each channel as spikes.
            let message =
                format!("'{name}' has {units} channels, and a byte for each is not a list of channel numbers");
            return Err(usage(message, help));
        } else {
            match array.shape() {
                [0] => true,
                [_] if array.holds_integers() => {
                    let whole = |x: f64| (x >= 0.0 && x <= f64::from(u32::MAX)).then_some(x as u32);
                    numbers()?.into_iter().all(|x| whole(x).map(&mut add).is_some())
                }
                _ => false,
            }
        }
    } else {
        let message = format!("the channels of '{name}' are {}", given.get_type().name()?);
        return Err(PyTypeError::new_err(format!("{message}, not a list or an array")));
    };
    if !are_whole {
        return Err(usage(format!("the channels of '{name}' are not a list of whole numbers from 0"), help));
    }
    let own = &mut shown[before..];
    if !are_truths && own.len() == units as usize && own.iter().all(|(number, _)| number.0 <= 1) {
        let message = format!(
            "'{name}' has {units} channels, and as many integers of 0 and 1 are channel numbers or a truth value for each"
        );
        return Err(usage(message, "give array > 0, or the channels that spike as truth values: [True, False, ..]"));
    }
    own.sort_unstable_by_key(|(number, _)| *number);
    if let Some((ChannelId(number), _)) = own.last().filter(|(number, _)| number.0 >= units) {
        return Err(usage(format!("'{name}' has {units} channels, so channel {number} cannot spike"), help));
    }
    if let Some(twice) = own.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        return Err(usage(format!("channel {} of '{name}' is given twice", twice[0].0.0), help));
    }
    own.iter_mut().for_each(|(number, _)| number.0 += first);
    Ok(())
}

#[pymethods]
impl Session {
    /// Runs one timestep.
    ///
    /// `inputs` is a dictionary from input populations to the numbers of the channels that spike,
    /// or to an array with a truth value for each channel; for a network with one input population
    /// it may be the channels alone. An input population that sends integers takes an array with an
    /// integer for each channel. Populations without an entry are silent; in `step()` all are.
    #[pyo3(signature = (inputs=None))]
    fn step(&self, py: Python<'_>, inputs: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        // Without the lock, as reading an input can run Python code that uses this session.
        let mut shown = std::mem::take(&mut self.state(py).shown);
        shown.clear();
        if let Some(inputs) = inputs {
            let network = self.network();
            let mut add = |name: &str, given: &Bound<'_, PyAny>| {
                let population = network.inputs().find(|(_, population)| population.name == name);
                let known = population.and_then(|(_, p)| Some((p.first_channel()?.0, p)));
                let Some((first, population)) = known else {
                    let known: Vec<&str> = network.inputs().map(|(_, population)| population.name.as_str()).collect();
                    let message = format!("'{name}' is not an input population");
                    return Err(usage(message, &format!("the input populations are: {}", known.join(", "))));
                };
                if self.is_set_next(py, first, population)? {
                    let message = format!("'{name}' is set for this step by session.signal too");
                    return Err(usage(message, "give it in one of them"));
                }
                match population.message {
                    Message::Value(_) => {
                        let is_signal = signals(network).any(|(signal, _)| signal == first);
                        add_values(&mut shown, given, (first, population), is_signal)
                    }
                    _ => add_channels(&mut shown, given, first, name, population.shape),
                }
            };
            match inputs.cast::<PyDict>() {
                Ok(by_name) => by_name.iter().try_for_each(|(name, given)| add(&name.extract::<String>()?, &given))?,
                Err(_) => {
                    let mut names = network.inputs().map(|(_, population)| population.name.as_str());
                    match (names.next(), names.next()) {
                        (Some(name), None) => add(name, inputs)?,
                        _ => {
                            let message = "the network has several input populations".to_string();
                            return Err(usage(message, "give a dictionary from input populations to channels"));
                        }
                    }
                }
            }
        }
        let mut state = self.state(py);
        let stepped = state.stepped.as_mut().ok_or_else(closed)?;
        let done = try_detached(py, || stepped.step(shown.iter().copied()));
        state.shown = shown;
        done
    }

    /// Runs several timesteps and returns `probes` by name, int32 arrays `[steps, units]`.
    ///
    /// `inputs` is a dictionary from input populations to arrays `[channels.., steps]` or `Events`,
    /// or the value of the only one; populations without an entry are silent. `steps` is needed
    /// where no input has it. Probes are POPULATION.u, .v, .spikes, .message, or a word of state.
    #[pyo3(signature = (inputs=None, steps=None, probes=None))]
    fn run<'py>(
        &self,
        py: Python<'py>,
        inputs: Option<&Bound<'py, PyAny>>,
        steps: Option<u32>,
        probes: Option<Vec<String>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let (probes, network) = (probes.unwrap_or_default(), self.network());
        let sample = steps_to_run(network, inputs, steps)?;
        let readers = probes.iter().map(|name| probe_named(network, name)).collect::<PyResult<Vec<Probe>>>()?;
        let mut rows: Vec<Vec<i32>> = vec![Vec::new(); readers.len()];
        let mut state = self.state(py);
        let stepped = state.stepped.as_mut().ok_or_else(closed)?;
        let record = |stepped: &Stepped| {
            readers.iter().zip(&mut rows).for_each(|(probe, rows)| stepped.append_probe(network, probe, rows));
        };
        try_detached(py, || stepped.run_on(&sample, record))?;
        let values = PyDict::new(py);
        for (name, rows) in probes.iter().zip(rows) {
            let shape = [sample.steps() as usize, rows.len() / sample.steps().max(1) as usize];
            values.set_item(name, PyArray1::from_vec(py, rows).reshape(shape)?)?;
        }
        Ok(values)
    }

    /// Integers that the next timestep adds to each compartment, by POPULATION.q (to its arrivals)
    /// and POPULATION.bias (to u + bias). They hold for this timestep only.
    #[getter]
    fn added(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Added)
    }

    /// Numbers of registers that left their width since the session was opened or reset, over all
    /// copies: `q`, `u` (or u + bias), and `v`, which was clipped.
    #[getter]
    fn overflow<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let overflow = self.stepped(py, |stepped| stepped.overflow())?;
        let counts = [("q", overflow.q_wrapped), ("u", overflow.u_wrapped), ("v", overflow.v_clipped)];
        counts.into_py_dict(py)
    }

    /// Timesteps since the session was opened or reset.
    #[getter]
    fn steps(&self, py: Python<'_>) -> PyResult<u32> {
        Ok(self.state(py).stepped()?.steps())
    }

    /// The state, for `restore`.
    fn snapshot(&self, py: Python<'_>) -> PyResult<Snapshot> {
        let state = self.state(py);
        let (stepped, metering) = (state.stepped()?.clone(), state.metering.clone());
        Ok(Snapshot { mapping: self.mapping.clone(), stepped, metering })
    }

    /// Restores a snapshot of a session of this mapping.
    fn restore(&self, py: Python<'_>, snapshot: &Snapshot) -> PyResult<()> {
        let mut state = self.state(py);
        state.stepped()?;
        if !Arc::ptr_eq(&self.mapping, &snapshot.mapping) {
            let message = "the snapshot belongs to another mapping".to_string();
            return Err(usage(message, "restore a snapshot() of a session of this mapping"));
        }
        state.stepped = Some(snapshot.stepped.clone());
        state.metering.clone_from(&snapshot.metering);
        Ok(())
    }

    /// Returns to the state before the first timestep. What rules have learned stays, unless
    /// `learned` is False.
    #[pyo3(signature = (learned=true))]
    fn reset(&self, py: Python<'_>, learned: bool) -> PyResult<()> {
        let mut state = self.state(py);
        let stepped = state.stepped.as_mut().ok_or_else(closed)?;
        if learned {
            return stepped.reset().map_err(|problem| exception(py, problem));
        }
        stepped.reset_all();
        Ok(())
    }

    /// Weights by the name of a projection that learns, one a synapse in rows of a probe, int32:
    /// those with which the next timestep delivers. They can be set.
    #[getter]
    fn weights(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Synapses(Variable::Weight))
    }

    /// Delays of synapses, as `weights`; read-only.
    #[getter]
    fn delays(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Synapses(Variable::Delay))
    }

    /// Tags of synapses, as `weights`; read-only.
    #[getter]
    fn tags(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Synapses(Variable::Tag))
    }

    /// Traces of a projection that learns, by NAME.x1 and so on; read-only.
    #[getter]
    fn traces(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Traces)
    }

    /// Values of signals in the next timestep, by the name of their population: a number for each
    /// channel. They hold for this timestep only.
    #[getter]
    fn signal(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Signal)
    }

    /// Random numbers that a projection takes in the next timestep, a dictionary by use, as in the
    /// files of `draws` of `Mapping.run`. Once set, they are set before each timestep that takes
    /// some.
    #[getter]
    fn draws(slf: &Bound<'_, Self>) -> PyResult<Values> {
        Values::new(slf, Kind::Draws)
    }

    /// Cost of the timesteps so far, as in `Mapping.energy` for a sample with this input, unless
    /// the session was opened with `energy=False`.
    fn energy(&self, py: Python<'_>) -> PyResult<Energy> {
        let Some(metering) = self.state(py).metering.clone() else {
            // A mapping that cannot be priced says why.
            Metering::new(py, &self.mapping, &Keywords::new(None)?)?;
            let message = "the session does not count what the energy of its timesteps needs".to_string();
            return Err(usage(message, "open it without energy=False"));
        };
        let steps = self.stepped(py, |stepped| stepped.metered())?;
        match steps.filter(|steps| steps.outcome.steps > 0) {
            Some(steps) => Energy::of_session(py, &self.mapping, &metering, steps),
            None => Err(usage("no timestep has run".into(), "call step() first")),
        }
    }

    fn __getitem__(slf: &Bound<'_, Self>, name: &str) -> PyResult<Population> {
        let session = slf.get();
        session.state(slf.py()).stepped()?;
        let network = session.network();
        let Some(id) = network.population_named(name) else {
            let known: Vec<&str> = network.populations().iter().map(|population| population.name.as_str()).collect();
            return Err(PyKeyError::new_err(format!("no population '{name}'; there are: {}", known.join(", "))));
        };
        Ok(Population { session: slf.clone().unbind(), id })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    fn __exit__(&self, ended: &Bound<'_, PyAny>, _value: &Bound<'_, PyAny>, _traceback: &Bound<'_, PyAny>) {
        self.state(ended.py()).stepped = None;
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let name = &self.network().parts().name;
        match &self.state(py).stepped {
            Some(stepped) => format!("<nsim.Session {name} after {} timesteps>", stepped.steps()),
            None => format!("<nsim.Session {name}, closed>"),
        }
    }
}

impl Population {
    /// Units that spiked in the last step, and the integers of their messages.
    fn spiking(&self, py: Python<'_>) -> PyResult<Vec<(u32, i32)>> {
        let (state, network) = (self.session.get().state(py), self.session.get().network());
        let stepped = state.stepped()?;
        let population = &network.populations()[self.id];
        let units = population.shape.len();
        Ok(match &population.units {
            Units::Input(first) => {
                let carried = |value| population.message.factor().unwrap_or(value);
                let own = stepped.last_input().filter_map(|(channel, value)| {
                    Some((channel.0.checked_sub(first.0).filter(|&number| number < units)?, carried(value)))
                });
                own.collect()
            }
            Units::Compartments { first, .. } => {
                let spikes = stepped.spikes(*first, units);
                spikes.into_iter().map(|(i, value)| (network.index_before_pruning(self.id, i), value)).collect()
            }
        })
    }

    /// A word of state of each compartment, by the name of the word.
    fn words<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let (state, network) = (self.session.get().state(py), self.session.get().network());
        let stepped = state.stepped()?;
        let population = &network.populations()[self.id];
        let Units::Compartments { first, neurons, .. } = &population.units else {
            let message = format!("input population '{}' has no {name}", population.name);
            return Err(usage(message, "populations of compartments have state"));
        };
        let kind = if population.shape.is_empty() { NeuronKind::Loihi } else { neurons.get(0).kind };
        let columns = kind.table().state;
        let Some(column) = columns.iter().position(|column| column.name == name) else {
            let known: Vec<&str> = columns.iter().map(|column| column.name).collect();
            let message = format!("the {} neurons of '{}' have no {name}", kind.name(), population.name);
            return Err(usage(message, &format!("their state is: {}", known.join(", "))));
        };
        let engine = stepped.engine();
        let states = (0..population.shape.len()).map(|i| (i, engine.state(CompartmentId(first.0 + i), column)));
        let mut values = Vec::new();
        append_before_pruning(network, self.id, states, &mut values);
        Ok(PyArray1::from_vec(py, values))
    }
}

#[pymethods]
impl Population {
    /// The numbers of the units that spiked in the last timestep, ascending, int32.
    #[getter]
    fn spikes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let spiking = self.spiking(py)?;
        Ok(PyArray1::from_iter(py, spiking.into_iter().map(|(number, _)| number as i32)))
    }

    /// The integer of each of these spikes, 1 for a binary spike, int32.
    #[getter]
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        let spiking = self.spiking(py)?;
        Ok(PyArray1::from_iter(py, spiking.into_iter().map(|(_, value)| value)))
    }

    /// The membrane of each compartment after the last timestep, int32.
    #[getter]
    fn v<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        self.words(py, "v")
    }

    /// The current of each compartment after the last timestep, int32.
    #[getter]
    fn u<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray1<i32>>> {
        self.words(py, "u")
    }

    /// A word of state of each compartment after the last timestep, by the name of the word, int32.
    fn state<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyArray1<i32>>> {
        self.words(py, name)
    }

    fn __len__(&self) -> usize {
        self.session.get().network().units_before_pruning(self.id) as usize
    }
}

/// The most numbers of an array that a session takes.
const MOST_NUMBERS: usize = 1 << 27;

/// The integers of an array.
fn integers(given: &Bound<'_, PyAny>, name: String, help: &str) -> PyResult<Vec<i32>> {
    let array = Array::new(given, name)?;
    let whole = |(index, value): (usize, f64)| {
        let wrong = || array.wrong(index, value, "and an integer of 32 bits is expected").help(help);
        if f64::from(value as i32) == value { Ok(value as i32) } else { Err(exception(given.py(), wrong())) }
    };
    array.numbers(MOST_NUMBERS, help)?.into_iter().enumerate().map(whole).collect()
}

/// The probe of this name, POPULATION.WHAT.
fn probe_named(network: &Quantised, name: &str) -> PyResult<Probe> {
    let parts = name.rsplit_once('.');
    let probe = parts.and_then(|(population, what)| {
        Probe::named(&network.populations()[network.population_named(population)?], what)
    });
    probe.ok_or_else(|| {
        let known: Vec<&str> = network.populations().iter().map(|population| population.name.as_str()).collect();
        let help = format!("probes are POPULATION.u, .v, .spikes, .message; populations: {}", known.join(", "));
        usage(format!("no probe '{name}'"), &help)
    })
}

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
    /// Integers that the next timestep adds to compartments.
    Added,
}

/// Values of a session by name, such as `session.weights["NAME"]`.
#[pyclass(frozen, module = "nsim")]
pub struct Values {
    session: Py<Session>,
    kind: Kind,
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
            Kind::Added => network.populations().iter().map(|population| population.name.as_str()).collect(),
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

    fn signal(&self, name: &str) -> PyResult<(u32, &quantised::Population)> {
        let signal = signals(self.session.get().network()).find(|(_, population)| population.name == name);
        signal.ok_or_else(|| self.unknown(name))
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
            Kind::Added => {
                let added = session.stepped(py, |stepped| stepped.added_to(session.network(), name))?;
                return Ok(PyArray1::from_vec(py, added.map_err(|problem| exception(py, problem))?).into_any());
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
                let weights = integers(given, format!("weights['{name}']"), "give integers, one for each synapse")?;
                session.stepped(py, |stepped| stepped.write_weights(rule, &weights))?
            }
            Kind::Added => {
                let added = integers(given, format!("added['{name}']"), "give integers, one for each compartment")?;
                session.stepped(py, |stepped| stepped.add_next(session.network(), name, &added))?
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
