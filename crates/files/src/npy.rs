//! NumPy's `.npy` files.
//!
//! Input: a file's bytes. Output: an [`Array`], whose header has been checked against the bytes
//! that follow it. An array gives a [`Tensor`] in C order, or the indices of its non-zero numbers.
//! Object, complex, text, date and structured arrays are refused by name; `.npz` archives are not
//! read. The module also writes `u1`, `i4` and `f8` arrays from iterators.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::io::{BufWriter, Error, Write};
use std::path::{Path, PathBuf};

use super::budget::{Budget, MOST_ARRAY};
use super::element::Element;
use super::text::{NPY_MAGIC, is_time, read_bytes};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::tensor::Tensor;

/// The longest header that is read; NumPy's own reader stops at 10,000 bytes by default.
const MOST_HEADER: usize = 64 << 10;

/// An array file with a header that agrees with its bytes.
pub struct Array {
    path: PathBuf,
    /// The type as NumPy spells it: byte order, kind, size.
    dtype: String,
    shape: Vec<usize>,
    /// The numbers in C order begin at `data`.
    bytes: Vec<u8>,
    data: usize,
    element: Element,
}

/// The element type of a `dtype`; `None` for a type that is not read.
fn element(dtype: &str) -> Option<Element> {
    let (kind, size) = dtype.strip_prefix(['<', '>', '|'])?.split_at_checked(1)?;
    match (kind, size.parse().ok()?) {
        (_, size) if dtype.starts_with('|') && size != 1 => None,
        ("b", 1) => Some(Element::U(1)),
        ("i", size @ (1 | 2 | 4 | 8)) => Some(Element::I(size)),
        ("u", size @ (1 | 2 | 4 | 8)) => Some(Element::U(size)),
        ("f", size @ (2 | 4 | 8)) => Some(Element::F(size)),
        _ => None,
    }
}

/// The content of an unreadable type in words, and help to save its array in a readable type.
fn unread(dtype: &str) -> (&'static str, String) {
    if dtype.starts_with('[') {
        return ("records of several fields", remedy_of_records(dtype));
    }
    let (kind, way) = match dtype.chars().nth(1) {
        Some('O') => ("Python objects (pickled)", "array.astype(numpy.float64)"),
        Some('c') => ("complex numbers", "array.real or numpy.abs(array)"),
        Some('S' | 'a' | 'U') => ("text", "array.astype(numpy.float64)"),
        Some('m' | 'M') => ("dates or durations", "array.astype('int64')"),
        Some('V') => ("raw data", "array.view(DTYPE), with the type that was stored as bytes"),
        Some('b' | 'i' | 'u' | 'f') => ("numbers of an unusual size", "array.astype(numpy.float64)"),
        _ => ("numbers of an unknown kind", "array.astype(numpy.float64)"),
    };
    (kind, format!("save it as integers or floating-point numbers: {way}"))
}

/// Help for records of several fields, which NumPy cannot convert into numbers. For events it
/// prints the field names that their reader knows, and no other names.
fn remedy_of_records(dtype: &str) -> String {
    let nested = dtype[1..].contains('[');
    let mut names: Vec<&str> = dtype.split("('").skip(1).filter_map(|field| field.split('\'').next()).collect();
    names.retain(|name| !nested && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'));
    let time = names.iter().copied().find(|name| is_time(name));
    let places = names.iter().copied().filter(|name| matches!(*name, "x" | "y" | "p" | "polarity"));
    let Some(time) = time.filter(|_| names.contains(&"x")) else {
        return "save one of its fields as an array of numbers: array[array.dtype.names[0]]".to_string();
    };
    let unit = if time.contains('_') { "" } else { "_us" };
    let header: Vec<String> = [format!("{time}{unit}")].into_iter().chain(places.clone().map(Into::into)).collect();
    let columns: Vec<String> = [time].into_iter().chain(places).map(|name| format!("array['{name}']")).collect();
    format!(
        "save events as text: numpy.savetxt('events.csv', numpy.column_stack([{}]), fmt='%.17g', delimiter=',', \
         header='{}', comments=''); for times in other units, the header has _s, _ms or _ns",
        columns.join(", "),
        header.join(",")
    )
}

/// The values of a header's dictionary by key, as text (NumPy, `numpy/lib/format.py`); `None` when
/// the header is not a dictionary.
fn entries(header: &str) -> Option<BTreeMap<&str, &str>> {
    let body = header.trim().strip_prefix('{')?.strip_suffix('}')?;
    let (mut entries, mut start, mut colon) = (BTreeMap::new(), 0, None);
    let (mut depth, mut quote, mut escaped) = (0usize, None, false);
    for (at, byte) in body.bytes().chain([b',']).enumerate() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if quote.is_some() => escaped = true,
            _ if quote == Some(byte) => quote = None,
            _ if quote.is_some() => {}
            b'\'' | b'"' => quote = Some(byte),
            b'(' | b'[' => depth += 1,
            b')' | b']' => depth = depth.checked_sub(1)?,
            b':' if depth == 0 => colon = Some(at),
            b',' if depth == 0 => {
                match colon.take() {
                    Some(colon) => {
                        let key = body[start..colon].trim().trim_matches(['\'', '"']);
                        entries.insert(key, body[colon + 1..at].trim());
                    }
                    None if body[start..at].trim().is_empty() => {}
                    None => return None,
                }
                start = at + 1;
            }
            _ => {}
        }
    }
    (depth == 0 && quote.is_none()).then_some(entries)
}

/// The axes of a shape given as text; an axis beyond 64 bits becomes `u64::MAX`.
fn axes(shape: &str) -> Option<Vec<u64>> {
    let axes = shape.strip_prefix('(')?.strip_suffix(')')?.trim().trim_end_matches(',');
    if axes.is_empty() {
        return Some(Vec::new());
    }
    let axes = axes.split(',').map(|axis| {
        let digits = axis.trim();
        let whole = !digits.is_empty() && digits.bytes().all(|byte| byte.is_ascii_digit());
        whole.then(|| digits.parse().unwrap_or(u64::MAX))
    });
    axes.collect()
}

/// Numbers of `size` bytes in Fortran order (the first axis varies fastest), converted to C order.
fn in_c_order(numbers: &[u8], shape: &[usize], size: usize) -> Vec<u8> {
    let mut ordered = vec![0; numbers.len()];
    for (mut index, number) in numbers.chunks_exact(size).enumerate() {
        let (mut stride, mut place) = (numbers.len() / size, 0);
        for &axis in shape {
            stride /= axis;
            place += index % axis * stride;
            index /= axis;
        }
        ordered[place * size..][..size].copy_from_slice(number);
    }
    ordered
}

/// Opens a file. Errors are those of [`read_bytes`] and [`Array::from_bytes`].
pub fn open(path: &Path) -> Result<Array> {
    Array::from_bytes(path, read_bytes(path, MOST_ARRAY)?)
}

/// Reads a whole file into a tensor. Errors are those of [`open`] and [`Array::tensor`].
pub fn read(path: &Path) -> Result<Tensor> {
    open(path)?.tensor()
}

impl Array {
    /// An array from the bytes of its file; the path is for messages.
    ///
    /// # Errors
    /// `npy.format`, `npy.dtype`, `npy.shape`, `npy.truncated`, `npy.trailing`.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let problem = |code, message: String| Diagnostic::new(code, message).in_file(path);
        if !bytes.starts_with(NPY_MAGIC) {
            let other = problem("npy.format", "this is not a NumPy array: it does not start with \\x93NUMPY".into());
            return Err(match bytes.starts_with(b"PK\x03\x04") {
                true => other.help("this is an archive (.npz?); save each array with numpy.save"),
                false => other,
            });
        }
        let (length, start) = match *bytes.get(6..).unwrap_or_default() {
            [1, 0, a, b, ..] => (usize::from(u16::from_le_bytes([a, b])), 10),
            [2 | 3, 0, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]) as usize, 12),
            [major, minor, _, _, ..] if !(1..=3).contains(&major) || minor != 0 => {
                return Err(problem("npy.format", format!("version {major}.{minor} of the format is not supported")));
            }
            _ => return Err(problem("npy.truncated", "the file ends within its header".into())),
        };
        if length > MOST_HEADER {
            return Err(problem(
                "npy.format",
                format!("the header has a length of {length} bytes, the limit is {MOST_HEADER}"),
            ));
        }
        let data = start + length;
        let Some(header) = bytes.get(start..data) else {
            let message = format!("the header has a length of {length} bytes, but the file ends before");
            return Err(problem("npy.truncated", message));
        };
        let header = String::from_utf8_lossy(header);
        let said = entries(&header).unwrap_or_default();
        let fortran = match said.get("fortran_order") {
            Some(&"True") => Some(true),
            Some(&"False") => Some(false),
            _ => None,
        };
        let shape = said.get("shape").and_then(|shape| axes(shape));
        let (Some(descr), Some(fortran), Some(axes)) = (said.get("descr"), fortran, shape) else {
            let message = "the header cannot be read: it is not a dictionary of descr, fortran_order and shape";
            return Err(problem("npy.format", message.into()));
        };
        // Every number takes at least a byte. An array with an empty axis has no numbers, however
        // long the other axes are.
        let there = bytes.len() - data;
        let least = axes.iter().fold(1u64, |product, &axis| product.saturating_mul(axis.max(1)));
        let empty = axes.contains(&0);
        if least > if empty { u32::MAX.into() } else { there as u64 } {
            return Err(problem(
                "npy.shape",
                format!("the shape in the header needs at least {least} bytes, but {there} follow the header"),
            ));
        }
        let mut dtype = descr.trim_matches(['\'', '"']).to_string();
        let element = element(&dtype);
        if dtype.len() > 120 {
            dtype = dtype.chars().take(120).chain(" ..".chars()).collect();
        }
        let Some(element) = element else {
            let (kind, remedy) = unread(descr.trim_matches(['\'', '"']));
            let message = format!("the array's type {dtype} holds {kind}, which are not supported");
            return Err(problem("npy.dtype", message).help(remedy));
        };
        let shape: Vec<usize> = axes.iter().map(|&axis| axis as usize).collect();
        let need = if empty { 0 } else { element.bytes().saturating_mul(least as usize) };
        if need != there {
            let (code, word) = if there < need { ("npy.truncated", "only ") } else { ("npy.trailing", "") };
            let message = format!("shape {shape:?} of {dtype} needs {need} bytes, but {word}{there} follow the header");
            return Err(problem(code, message));
        }
        let (bytes, data) = match fortran && shape.len() > 1 {
            true => (in_c_order(&bytes[data..], &shape, element.bytes()), 0),
            false => (bytes, data),
        };
        Ok(Array { path: path.into(), dtype, shape, bytes, data, element })
    }

    /// The axes.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The type of its numbers, as NumPy spells it.
    pub fn dtype(&self) -> &str {
        &self.dtype
    }

    /// The file, for messages.
    pub fn path(&self) -> &Path {
        &self.path
    }

    fn is_big_endian(&self) -> bool {
        self.dtype.starts_with('>')
    }

    /// An index in C order as one index for each axis, for messages.
    fn indices(&self, mut index: usize) -> Vec<usize> {
        let mut indices = vec![0; self.shape.len()];
        for (place, &axis) in indices.iter_mut().zip(&self.shape).rev() {
            *place = index % axis;
            index /= axis;
        }
        indices
    }

    fn wrong(&self, index: usize, value: impl Display, why: &str) -> Diagnostic {
        Diagnostic::new("npy.value", format!("the number at {:?} is {value}, which is {why}", self.indices(index)))
            .in_file(&self.path)
    }

    fn failed(&self, error: impl Display) -> Diagnostic {
        Diagnostic::new("npy.format", format!("the numbers cannot be read: {error}")).in_file(&self.path)
    }

    /// All numbers in C order.
    ///
    /// # Errors
    /// `npy.value` for an integer beyond 32 bits and for NaN or infinity, with its index.
    pub fn tensor(&self) -> Result<Tensor> {
        let data = &self.bytes[self.data..];
        if self.dtype.ends_with("b1")
            && let Some(byte) = data.iter().find(|&&byte| byte > 1)
        {
            return Err(self.failed(format!("invalid value for bool: {byte}")));
        }
        let (count, width) = ((data.len() / self.element.bytes()) as u64, self.element.bytes() as u64);
        let taken = Budget::for_file(self.bytes.len() as u64, 1, 1).numbers(count, width);
        taken.map_err(|exceeded| self.failed(exceeded))?;
        let numbers =
            self.element.numbers(data, self.is_big_endian(), |index, value, why| self.wrong(index, value, why))?;
        Tensor::new(self.shape.clone(), numbers).ok_or_else(|| self.failed("they do not fill the shape"))
    }

    /// Calls `f` with the index of each number that is not zero, and the number, in C order.
    /// Recordings are sparse, so zeros are skipped eight bytes at a time.
    ///
    /// # Errors
    /// As [`Array::tensor`], and the errors of `f`.
    pub fn each_non_zero(&self, mut f: impl FnMut(usize, f64) -> Result<()>) -> Result<()> {
        let size = self.element.bytes();
        let big = self.is_big_endian();
        let data = &self.bytes[self.data..];
        for (word, bytes) in data.chunks(8).enumerate() {
            if bytes.try_into().is_ok_and(|bytes| u64::from_ne_bytes(bytes) == 0) {
                continue;
            }
            for (k, number) in bytes.chunks_exact(size).enumerate() {
                if number.iter().any(|&byte| byte != 0) {
                    let index = word * (8 / size) + k;
                    let number = self.element.number(number, big).check(|x, why| self.wrong(index, x, why))?;
                    // Minus zero has a byte that is not zero.
                    if number.real() != 0.0 {
                        f(index, number.real())?;
                    }
                }
            }
        }
        Ok(())
    }
}

/// An element type of written arrays.
pub trait Stored {
    /// Its type as NumPy spells it.
    const DTYPE: &str;
    /// Its bytes in little-endian order.
    fn bytes(self) -> impl AsRef<[u8]>;
}

macro_rules! stored {
    ($($number:ty: $dtype:literal),*) => {$(
        impl Stored for $number {
            const DTYPE: &str = $dtype;
            fn bytes(self) -> impl AsRef<[u8]> {
                self.to_le_bytes()
            }
        }
    )*};
}
stored!(u8: "'|u1'", i32: "'<i4'", f64: "'<f8'");

/// Writes an array in C order; `numbers` has to fill the shape.
///
/// # Errors
/// When the output cannot be written, or the numbers do not fill the shape.
pub fn write<T: Stored>(out: impl Write, shape: &[u64], numbers: impl IntoIterator<Item = T>) -> std::io::Result<()> {
    let mut out = BufWriter::with_capacity(crate::write::BUFFER_BYTES, out);
    out.write_all(&header(T::DTYPE, shape)?)?;
    let mut count = 0;
    for number in numbers {
        out.write_all(number.bytes().as_ref())?;
        count += 1;
    }
    match shape.iter().product::<u64>() == count {
        true => out.flush(),
        false => Err(Error::other(format!("{count} numbers do not fill the shape {shape:?}"))),
    }
}

/// The header of an array of this type in C order (NumPy, `numpy/lib/format.py`). Its version is
/// 1.0 where it is short enough, else 2.0. It is padded so that the numbers begin at a multiple of
/// 64.
///
/// # Errors
/// When 32 bits do not hold its length.
pub fn header(descr: &str, shape: &[u64]) -> std::io::Result<Vec<u8>> {
    let axes: String = shape.iter().map(|axis| format!("{axis},")).collect();
    let fields = format!("{{'descr': {descr}, 'fortran_order': False, 'shape': ({axes}), }}");
    let (version, length_bytes) = if fields.len() < 65_000 { (1, 2) } else { (2, 4) };
    let before = NPY_MAGIC.len() + 2 + length_bytes;
    let end = (before + fields.len() + 1).next_multiple_of(64);
    let length = u32::try_from(end - before).map_err(|_| Error::other("the header is too long"))?.to_le_bytes();
    let mut header = [NPY_MAGIC, &[version, 0], &length[..length_bytes], fields.as_bytes()].concat();
    header.resize(end - 1, b' ');
    header.push(b'\n');
    Ok(header)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng::unit;
    use nsim_ir::tensor::Numbers;

    /// A version 1 file as NumPy writes it.
    fn file(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}, }}");
        let width = (10 + header.len() + 1).next_multiple_of(64) - 11;
        let header = format!("{header:width$}\n");
        let length = (header.len() as u16).to_le_bytes();
        [&b"\x93NUMPY\x01\x00"[..], &length, header.as_bytes(), data].concat()
    }

    fn array(bytes: Vec<u8>) -> Result<Array> {
        Array::from_bytes(Path::new("a.npy"), bytes)
    }

    fn parse(bytes: Vec<u8>) -> Result<Tensor> {
        array(bytes)?.tensor()
    }

    fn code(bytes: Vec<u8>) -> &'static str {
        parse(bytes).unwrap_err().code
    }

    #[test]
    fn every_type_of_number_is_read() {
        let integers = |numbers: [i32; 2]| Numbers::Integers(numbers.into());
        let reals = |numbers: [f64; 2]| Numbers::Reals(numbers.into());
        let cases: [(&str, &[u8], Numbers); 13] = [
            ("'|b1'", &[0, 1], integers([0, 1])),
            ("'|i1'", &[0xff, 5], integers([-1, 5])),
            ("'|u1'", &[0xff, 5], integers([255, 5])),
            ("'<i2'", &[0xfe, 0xff, 1, 0], integers([-2, 1])),
            ("'>i2'", &[0xff, 0xfe, 0, 1], integers([-2, 1])),
            ("'<u2'", &[0xff, 0xff, 0, 0], integers([65535, 0])),
            ("'<i4'", &[0, 0, 0, 0x80, 1, 0, 0, 0], integers([i32::MIN, 1])),
            ("'<u4'", &[0xff, 0xff, 0xff, 0x7f, 1, 0, 0, 0], integers([i32::MAX, 1])),
            ("'<i8'", &[1i64, -1].map(i64::to_le_bytes).concat(), integers([1, -1])),
            ("'<f2'", &[0, 0x3c, 0, 0xc0], reals([1.0, -2.0])),
            ("'>f2'", &[0x3c, 0, 0xc0, 0], reals([1.0, -2.0])),
            ("'<f4'", &[0, 0, 0x80, 0x3f, 0, 0, 0, 0xbf], reals([1.0, -0.5])),
            ("'>f8'", &[1.5f64, -3.25].map(f64::to_be_bytes).concat(), reals([1.5, -3.25])),
        ];
        for (descr, data, numbers) in cases {
            let tensor = parse(file(descr, "False", "(2,)", data)).unwrap();
            assert_eq!((tensor.shape(), tensor.numbers()), (&[2][..], &numbers), "{descr}");
        }
        let error = parse(file("'|b1'", "False", "(2,)", &[1, 2])).unwrap_err();
        assert!(error.code == "npy.format" && error.message.ends_with("invalid value for bool: 2"), "{error}");
    }

    #[test]
    fn fortran_order_is_transposed() {
        // numpy.asfortranarray([[[0,1,2],[3,4,5]], [[6,7,8],[9,10,11]]]): the first axis runs
        // fastest.
        let data = [0, 6, 3, 9, 1, 7, 4, 10, 2, 8, 5, 11];
        let tensor = parse(file("'|u1'", "True", "(2, 2, 3)", &data)).unwrap();
        assert_eq!(tensor.numbers(), &Numbers::Integers((0..12).collect()));
    }

    #[test]
    fn scalars_and_empty_arrays_are_arrays() {
        assert_eq!(parse(file("'|u1'", "False", "()", &[7])).unwrap().numbers(), &Numbers::Integers(vec![7]));
        assert_eq!(parse(file("'<i4'", "True", "(0, 3)", &[])).unwrap().shape(), [0, 3]);
        assert_eq!(parse(file("'|u1'", "False", "(0,)", &[])).unwrap().len(), 0);
    }

    #[test]
    fn values_that_do_not_fit_are_named_by_their_index() {
        let data: Vec<u8> = [1i64, 2, 3, 1 << 31].iter().flat_map(|x| x.to_le_bytes()).collect();
        let error = parse(file("'<i8'", "False", "(2, 2)", &data)).unwrap_err();
        assert_eq!((error.code, error.message.contains("[1, 1] is 2147483648")), ("npy.value", true), "{error}");
        let data: Vec<u8> = [1f32, f32::NAN, 3.0, 4.0].iter().flat_map(|x| x.to_le_bytes()).collect();
        let error = parse(file("'<f4'", "True", "(2, 2)", &data)).unwrap_err();
        assert_eq!((error.code, error.message.contains("[1, 0] is NaN")), ("npy.value", true), "{error}");
    }

    #[test]
    fn hostile_headers_are_refused_before_anything_is_allocated() {
        for (descr, what) in [("'<U4'", "text"), ("'<M8[ns]'", "dates"), ("'<f16'", "unusual size")] {
            let error = parse(file(descr, "False", "(2,)", &[0; 64])).unwrap_err();
            assert_eq!((error.code, error.message.contains(what)), ("npy.dtype", true), "{descr}: {error}");
        }
        for (descr, help) in [
            ("[('x', '<i2'), ('y', '<i2'), ('p', '|b1'), ('t', '<i8')]", "header='t_us,x,y,p'"),
            ("[('t_ms', '<f8'), ('x', '<i2')]", "header='t_ms,x'"),
            ("[('a', '<f4'), ('b', '<i4')]", "array[array.dtype.names[0]]"),
            ("'<c8'", "array.real"),
        ] {
            let error = parse(file(descr, "False", "(2,)", &[0; 64])).unwrap_err();
            assert!(error.help.as_ref().is_some_and(|said| said.contains(help)), "{descr}: {:?}", error.help);
        }
        let huge =
            ["(18446744073709551615, 18446744073709551615)", "(4000000000000,)", "(99999999999999999999999999,)"];
        for shape in huge {
            assert_eq!(code(file("'<f8'", "False", shape, &[0; 64])), "npy.shape", "{shape}");
        }
        assert_eq!(code(file("'<f8'", "False", "(-8,)", &[0; 64])), "npy.format");
        let deep = "[".repeat(30_000);
        assert_eq!(code(file(&deep, "False", "(8,)", &[0; 64])), "npy.format");
        assert_eq!(code(b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec()), "npy.format");
        assert_eq!(code(b"\x93NUMPY\x01\x00\xff\x7f{".to_vec()), "npy.truncated");
        assert_eq!(code(b"\x93NUMPY\x01".to_vec()), "npy.truncated");
        assert_eq!(code(b"\x93NUMPY\x09\x00\x01\x00 ".to_vec()), "npy.format");
        assert_eq!(code(b"PK\x03\x04".to_vec()), "npy.format");
    }

    #[test]
    fn damage_anywhere_in_a_header_never_panics() {
        let good = file("'<i2'", "False", "(2, 3)", &[0; 12]);
        let mut refused = 0;
        for round in 0..20_000 {
            let below = |draw: u64, n: usize| (unit(7, round, draw) * n as f64) as usize;
            let mut bytes = good.clone();
            for change in 0..=below(0, 3) as u64 {
                let at = below(2 * change + 2, bytes.len());
                bytes[at] = below(2 * change + 3, 256) as u8;
            }
            bytes.truncate(bytes.len() - below(1, 4));
            refused += u32::from(parse(bytes).is_err());
        }
        assert!((10_000..20_000).contains(&refused), "{refused}");
    }

    #[test]
    fn what_is_written_is_read_back() {
        let mut bytes = Vec::new();
        write(&mut bytes, &[2, 1, 2], [1, -2, i32::MAX, i32::MIN]).unwrap();
        let tensor = parse(bytes).unwrap();
        assert_eq!(tensor.shape(), [2, 1, 2]);
        assert_eq!(tensor.numbers(), &Numbers::Integers(vec![1, -2, i32::MAX, i32::MIN]));
        let mut bytes = Vec::new();
        write(&mut bytes, &[3], [0, 1, 255]).unwrap();
        assert_eq!(parse(bytes).unwrap().numbers(), &Numbers::Integers(vec![0, 1, 255]));
        assert!(write(Vec::new(), &[3], [0, 1]).is_err());
        for shape in [&[6][..], &[2, 3], &[3, 1, 2], &[]] {
            let numbers: Vec<u8> = (0..shape.iter().product::<u64>() as u8).collect();
            let mut bytes = Vec::new();
            write(&mut bytes, shape, numbers.iter().copied()).unwrap();
            assert_eq!((bytes.len() - numbers.len()) % 64, 0);
            let tensor = parse(bytes).unwrap();
            let axes: Vec<usize> = shape.iter().map(|&axis| axis as usize).collect();
            assert_eq!(tensor.shape(), axes);
            assert_eq!(tensor.numbers(), &Numbers::Integers(numbers.iter().map(|&n| i32::from(n)).collect()));
        }
    }

    /// The indices of the numbers that are not zero, up to an error.
    fn non_zero(array: &Array) -> (Vec<usize>, Result<()>) {
        let mut found = Vec::new();
        let read = array.each_non_zero(|index, _| {
            found.push(index);
            Ok(())
        });
        (found, read)
    }

    #[test]
    fn non_zero_numbers_are_those_of_the_tensor() {
        // Every type, lengths around multiples of a word, both byte orders and both axis orders.
        let types = [
            "|b1", "|i1", "|u1", "<i2", ">i2", "<u2", "<i4", ">i4", "<u4", "<i8", ">i8", "<u8", "<f2", ">f2", "<f4",
            ">f4", "<f8", ">f8",
        ];
        for (case, dtype) in types.iter().enumerate() {
            let size: usize = dtype[2..].parse().unwrap();
            for (rows, columns) in [(1, 1), (3, 5), (8, 4), (7, 11)] {
                for order in ["False", "True"] {
                    let mut data = vec![0u8; rows * columns * size];
                    for k in 0..rows * columns {
                        if unit(case as u64, 1, k as u64) < 0.3 {
                            // A small integer, or a real that is neither zero nor infinite.
                            let at = if dtype.starts_with('>') { k * size + size - 1 } else { k * size };
                            data[at] = 1;
                        }
                    }
                    let shape = format!("({rows}, {columns})");
                    let array = array(file(&format!("'{dtype}'"), order, &shape, &data)).unwrap();
                    let (found, read) = non_zero(&array);
                    read.unwrap();
                    let expected: Vec<usize> = match array.tensor().unwrap().numbers() {
                        Numbers::Integers(numbers) => (0..numbers.len()).filter(|&k| numbers[k] != 0).collect(),
                        Numbers::Reals(numbers) => (0..numbers.len()).filter(|&k| numbers[k] != 0.0).collect(),
                    };
                    assert_eq!(found, expected, "{dtype} {shape} {order}");
                }
            }
        }
        let zero = file("'<f4'", "False", "(3,)", &[0, 0, 0, 0x80, 0, 0, 0x80, 0x3f, 0, 0, 0xc0, 0x7f]);
        let (found, read) = non_zero(&array(zero).unwrap());
        assert_eq!((found, read.unwrap_err().code), (vec![1], "npy.value"), "minus zero is zero, NaN is refused");
        let wide = file("'<i8'", "False", "(1,)", &(1i64 << 31).to_le_bytes());
        assert_eq!(non_zero(&array(wide).unwrap()).1.unwrap_err().code, "npy.value");
    }
}
