//! Arrays of numbers that Python passes: one conversion for spikes, events, weights, parameters and
//! labels.
//!
//! Input: a value that NumPy makes an array of, and its name in messages. Output: its shape and its
//! numbers in C order, for any layout, byte order and type. Invariants: every returned number is
//! finite and an element of the array; a `bool` is 0 or 1, for any byte. Errors: `input.array` with
//! the argument, the index, the value and a remedy.
//!
//! `numpy.nditer` reads numbers in parts of bounded size, and a converted copy of the whole array
//! is never made: an array may claim more numbers than it stores (`numpy.broadcast_to`).

use nsim::import::spikes::options::{SPIKE_RULE, SpikeValues};
use nsim::ir::base::diagnostic::Diagnostic;
use nsim::ir::graph::Shape;
use numpy::{
    Element, PyArray1, PyArrayDescrMethods, PyArrayDyn, PyArrayMethods, PyUntypedArray, PyUntypedArrayMethods,
};
use pyo3::exceptions::PyException;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyTuple};

use crate::error::exception;

/// Numbers of an array that are compared together.
const TOGETHER: usize = 32;
/// Numbers of one converted part.
const PART: usize = 1 << 16;
/// The deepest list of lists that is searched for masked arrays; NumPy's arrays have at most 64
/// axes.
const DEEPEST: usize = 64;

/// An array of integers, real numbers or truth values.
pub struct Array<'py> {
    name: String,
    array: Bound<'py, PyUntypedArray>,
    /// Whether its numbers are truth values, whose bytes need not be 0 and 1.
    is_truth: bool,
}

/// The numbers of an array of one axis with this type of numbers, which takes less time than
/// NumPy's conversion; `None` of other arrays, and of those whose numbers are not aligned.
pub fn copied<T: Element + Copy, U>(array: &Bound<'_, PyUntypedArray>, of: impl Fn(T) -> U) -> Option<Vec<U>> {
    let array = array.cast::<PyArray1<T>>().ok()?;
    let is_whole = array.strides().iter().all(|stride| stride.unsigned_abs() % align_of::<T>() == 0);
    (array.data().is_aligned() && is_whole).then(|| array.to_owned_array().iter().map(|&number| of(number)).collect())
}

/// A value that is an array of integers or real numbers of at most 8 bytes, of NumPy's own type.
fn plain<'py>(value: &Bound<'py, PyAny>) -> Option<Bound<'py, PyUntypedArray>> {
    let array = value.cast_exact::<PyUntypedArray>().ok()?;
    let dtype = array.dtype();
    matches!((dtype.kind(), dtype.itemsize()), (b'i' | b'u', _) | (b'f', ..=8)).then(|| array.clone())
}

impl<'py> Array<'py> {
    /// Makes one of any value that NumPy makes an array of; `name` is the argument.
    pub fn new(value: &Bound<'py, PyAny>, name: impl Into<String>) -> PyResult<Self> {
        let (py, name) = (value.py(), name.into());
        // A masked array, and a list of arrays, is none of this type.
        if let Some(array) = plain(value) {
            return Ok(Array { name, array, is_truth: false });
        }
        let numpy = py.import("numpy")?;
        if is_masked(value, &numpy.getattr("ma")?.getattr("MaskedArray")?, 0)? {
            let help = "fill the masked values: array.filled(0)";
            return Err(refused(py, format!("{name} is a masked array, whose mask would be lost"), help));
        }
        let array =
            numpy.call_method1("asarray", (value,)).map_err(|error| match error.is_instance_of::<PyException>(py) {
                true => {
                    let help = match value.hasattr("detach").unwrap_or(false) {
                        true => "convert a tensor to an array: tensor.detach().cpu().to_dense().float().numpy()",
                        false => {
                            "the rows of an array must have equal lengths: pad samples with zeros, or give one at a \
                             time"
                        }
                    };
                    refused(py, format!("{name} is not an array of numbers: {}", error.value(py)), help)
                }
                false => error,
            })?;
        let array = array.cast_into::<PyUntypedArray>()?;
        let dtype = array.dtype();
        let (what, help) = match (dtype.kind(), dtype.itemsize()) {
            (b'b', _) => {
                let array = array.call_method1("view", ("u1",))?.cast_into()?;
                return Ok(Array { name, array, is_truth: true });
            }
            (b'i' | b'u', _) | (b'f', ..=8) => return Ok(Array { name, array, is_truth: false }),
            (b'f', _) => ("long floating-point numbers", "convert to numbers of 8 bytes: array.astype(numpy.float64)"),
            (b'c', _) => ("complex numbers", "take one part of them: array.real, array.imag or numpy.abs(array)"),
            (b'O', _) => (
                "Python objects",
                "an array needs rows of equal length, with numbers of at most 64 bits and no None; convert a sparse \
                 array with array.toarray()",
            ),
            (b'V', _) if dtype.has_fields() => (
                "records of several fields",
                "take one field, such as array[array.dtype.names[0]]; events with the fields t, x, y and p are spikes",
            ),
            (b'V', _) => ("raw bytes", "read the numbers stored as bytes with array.view(DTYPE)"),
            (b'M' | b'm', _) => ("dates or durations", "convert to a number of units: array.astype('int64')"),
            _ => ("text", "convert text to numbers: array.astype(float)"),
        };
        Err(refused(py, format!("{name} has dtype {dtype}: it holds {what}, which are not supported"), help))
    }

    /// Its name in messages.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The axes.
    pub fn shape(&self) -> &[usize] {
        self.array.shape()
    }

    /// Whether its numbers are truth values.
    pub fn holds_truth_values(&self) -> bool {
        self.is_truth
    }

    /// Whether its numbers are integers.
    pub fn holds_integers(&self) -> bool {
        !self.is_truth && self.array.dtype().kind() != b'f'
    }

    /// Whether its numbers are integers of a byte.
    pub fn is_of_bytes(&self) -> bool {
        self.holds_integers() && self.array.dtype().itemsize() == 1
    }

    /// Bytes from its first number to its last: an array that repeats its numbers claims more.
    pub fn stored_bytes(&self) -> u64 {
        let axes = self.shape().iter().zip(self.array.strides());
        let ahead = axes.fold(0u64, |sum, (&length, &stride)| {
            sum.saturating_add((length.saturating_sub(1) as u64).saturating_mul(stride.unsigned_abs() as u64))
        });
        ahead.saturating_add(self.array.dtype().itemsize() as u64)
    }

    /// Error for the number at an index in C order.
    pub fn wrong(&self, index: usize, value: f64, why: &str) -> Diagnostic {
        let mut left = index;
        let mut indices: Vec<String> = Vec::with_capacity(self.shape().len());
        for &axis in self.shape().iter().rev() {
            indices.push((left % axis.max(1)).to_string());
            left /= axis.max(1);
        }
        indices.reverse();
        // Debug writes great and small numbers with an exponent.
        let plain = value == 0.0 || (1e-5..1e15).contains(&value.abs());
        let value = if plain { format!("{value}") } else { format!("{value:?}") };
        Diagnostic::new("input.array", format!("{}[{}] is {value}, {why}", self.name, indices.join(", ")))
    }

    fn not_finite(&self, index: usize, value: f64) -> Diagnostic {
        let help = match self.name.as_str() {
            "labels" => "remove samples without a label: spikes[numpy.isfinite(labels)]",
            _ => "numpy.nan_to_num(array, posinf=0, neginf=0) makes it 0",
        };
        self.wrong(index, value, "not a finite number").help(help)
    }

    /// Calls `read` with the index in C order and the value of every number.
    pub fn each(&self, mut read: impl FnMut(usize, f64) -> Result<(), nsim::Error>) -> PyResult<()> {
        let mut index = 0;
        parts(&self.array, "f8", |part: &[f64]| {
            for &number in part {
                if !number.is_finite() {
                    return Err(self.not_finite(index, number).into());
                }
                read(index, if self.is_truth { f64::from(number != 0.0) } else { number })?;
                index += 1;
            }
            Ok(())
        })
    }

    /// All numbers, at most `most`; `help` is the advice for more.
    pub fn numbers(&self, most: usize, help: &str) -> PyResult<Vec<f64>> {
        let count = self.array.len();
        if count > most {
            let message = format!("{} has {count} numbers, more than {most}", self.name);
            return Err(refused(self.array.py(), message, help));
        }
        if let Some(numbers) = self.plain_numbers() {
            return Ok(numbers);
        }
        let mut numbers = Vec::with_capacity(count);
        self.each(|_, number| {
            numbers.push(number);
            Ok(())
        })?;
        Ok(numbers)
    }

    /// All numbers of an array of one axis whose numbers Rust can copy, as sessions get in each
    /// step; `None` of others, and where a number is not finite.
    fn plain_numbers(&self) -> Option<Vec<f64>> {
        let of_f64 = || copied(&self.array, |x: f64| x).filter(|all| all.iter().all(|x| x.is_finite()));
        let of_i64 = || copied(&self.array, |x: i64| x as f64);
        if self.is_truth { None } else { of_f64().or_else(|| copied(&self.array, |x: i32| x.into())).or_else(of_i64) }
    }

    /// Calls `add` with the index in C order of every number that is not zero; refuses a negative
    /// or fractional number, and several values, which are counts.
    ///
    /// Most numbers of recordings are zero, so [`TOGETHER`] numbers are compared at a time.
    pub fn each_spike(&self, mut add: impl FnMut(usize) -> Result<(), nsim::Error>) -> PyResult<()> {
        let mut values = SpikeValues::default();
        let mut spike = |index: usize, number: f64| {
            if !number.is_finite() {
                return Err(self.not_finite(index, number).into());
            }
            if number.fract() != 0.0 {
                let wrong = self.wrong(index, number, SPIKE_RULE);
                let help = "encode real numbers as spikes (constant input: \
                            docs/tutorials/from-pytorch.md#other-codes), or let values from 0.5 be spikes: \
                            array >= 0.5";
                return Err(Diagnostic::new("input.value", wrong.message).help(help).into());
            }
            values.add(index, number);
            add(index)
        };
        let mut index = 0;
        if self.array.dtype().itemsize() == 1 {
            let bytes = self.array.call_method1("view", ("u1",))?.cast_into::<PyUntypedArray>()?;
            let value = |byte: u8| match (self.is_truth, self.array.dtype().kind()) {
                (true, _) => 1.0,
                (_, b'i') => f64::from(byte as i8),
                _ => f64::from(byte),
            };
            let mut read = |part: &[u8]| {
                for numbers in part.chunks(TOGETHER) {
                    if numbers.iter().fold(0, |any, &number| any | number) != 0 {
                        let spikes = numbers.iter().enumerate().filter(|(_, number)| **number != 0);
                        spikes
                            .map(|(place, &byte)| (index + place, byte))
                            .try_for_each(|(i, byte)| spike(i, value(byte)))?;
                    }
                    index += numbers.len();
                }
                Ok(())
            };
            // Bytes that lie in order are read in place.
            match bytes.is_c_contiguous() {
                true => read(bytes.cast::<PyArrayDyn<u8>>()?.readonly().as_slice()?)
                    .map_err(|problem| exception(bytes.py(), problem))?,
                false => parts(&bytes, "u1", read)?,
            }
            return self.refuse_counts(&values);
        }
        parts(&self.array, "f8", |part: &[f64]| {
            for numbers in part.chunks(TOGETHER) {
                if numbers.iter().fold(false, |any, &number| any | (number != 0.0)) {
                    let spikes = numbers.iter().enumerate().filter(|(_, number)| **number != 0.0);
                    spikes.map(|(place, &number)| (index + place, number)).try_for_each(|(i, x)| spike(i, x))?;
                }
                index += numbers.len();
            }
            Ok(())
        })?;
        self.refuse_counts(&values)
    }

    /// Refuses numbers that spikes without a value would lose.
    fn refuse_counts(&self, values: &SpikeValues) -> PyResult<()> {
        let Some(((index, number), message)) = values.loss() else { return Ok(()) };
        let help = "array != 0 makes each entry one spike, array >= 2 those from 2 on; array > 0 and array < 0 \
                    are the channels of two polarities; an input with message_bits sends the numbers";
        let wrong = Diagnostic::new("input.value", self.wrong(index, number, &message).message);
        Err(exception(self.array.py(), wrong.help(help)))
    }
}

/// Whether axes equal the shape of a population, or are one axis of all its units; axes of length 1
/// are ignored.
pub fn matches_shape(shape: Shape, axes: &[usize]) -> bool {
    let plain = |axes: &[usize]| axes.iter().copied().filter(|&axis| axis != 1).collect::<Vec<_>>();
    let own: Vec<usize> = shape.axes().into_iter().map(|axis| axis as usize).collect();
    let axes = plain(axes);
    axes == plain(&own) || axes == plain(&[shape.len() as usize])
}

/// Calls `read` with contiguous parts of an array, in C order, as numbers of type `dtype`.
fn parts<T: Element>(
    array: &Bound<'_, PyUntypedArray>,
    dtype: &str,
    mut read: impl FnMut(&[T]) -> Result<(), nsim::Error>,
) -> PyResult<()> {
    let py = array.py();
    if array.is_empty() {
        return Ok(());
    }
    let options = PyDict::new(py);
    options.set_item("flags", ["external_loop", "buffered"])?;
    options.set_item("op_flags", [["readonly", "nbo", "aligned", "contig"]])?;
    options.set_item("op_dtypes", [dtype])?;
    options.set_item("order", "C")?;
    options.set_item("casting", "same_kind")?;
    options.set_item("buffersize", PART)?;
    let numpy = py.import("numpy")?;
    // Below NumPy 2.3, `nditer` converts an array without axes into memory that it does not keep.
    let array = numpy.call_method1("atleast_1d", (array,))?;
    for part in numpy.getattr("nditer")?.call((array,), Some(&options))?.try_iter()? {
        let part = part?.cast_into::<PyArrayDyn<T>>()?;
        read(part.readonly().as_slice()?).map_err(|problem| exception(py, problem))?;
    }
    Ok(())
}

/// Whether a value is a masked array, or a list that has one, whose mask NumPy would drop.
fn is_masked(value: &Bound<'_, PyAny>, masked: &Bound<'_, PyAny>, depth: usize) -> PyResult<bool> {
    if value.is_instance(masked)? {
        return Ok(true);
    }
    if depth == DEEPEST || !(value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>()) {
        return Ok(false);
    }
    for item in value.try_iter()? {
        if is_masked(&item?, masked, depth + 1)? {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Kind of thing that the entries of an array count.
#[derive(Clone, Copy)]
pub struct CountBound {
    /// Its name, in the singular.
    pub what: &'static str,
    /// Number of things, at most 2^32.
    pub limit: u64,
    /// Advice for an entry that is no count.
    pub help: &'static str,
    /// Error code of an entry that is no count.
    pub code: &'static str,
}

impl Array<'_> {
    /// Refuses truth values, which count nothing.
    pub fn check_counts(&self, help: &str) -> PyResult<()> {
        match self.is_truth {
            true => Err(refused(self.array.py(), format!("{} holds truth values, expected numbers", self.name), help)),
            false => Ok(()),
        }
    }

    /// The value of an entry, a count from 0.
    pub fn count(&self, index: usize, value: f64, of: CountBound) -> Result<u32, nsim::Error> {
        if value >= 0.0 && value < of.limit as f64 && value.fract() == 0.0 {
            return Ok(value as u32);
        }
        let last = of.limit.saturating_sub(1);
        let mut problem = self.wrong(index, value, &format!("not a {}: a whole number from 0 to {last}", of.what));
        problem.code = of.code;
        Err(problem.help(of.help).into())
    }
}

fn refused(py: Python<'_>, message: String, help: &str) -> PyErr {
    exception(py, Diagnostic::new("input.array", message).help(help))
}
