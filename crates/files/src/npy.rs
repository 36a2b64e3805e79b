//! NumPy's `.npy` files.
//!
//! Input: a file's bytes. Output: an [`Array`], whose header has been held against the bytes that
//! are there, and from it a [`Tensor`] in C order or the indices of its non-zero numbers. Object,
//! complex, text, date and structured arrays are refused by name; `.npz` archives are not read.
//! Also writes `u1`, `i4` and `f8` arrays as they come.

use std::fmt::Display;
use std::io::Write;
use std::path::{Path, PathBuf};

use npyz::{DType, Endianness, NpyHeader, Order, TypeChar, WriterBuilder};

use super::budget::{Budget, MOST_ARRAY};
use super::element::Element;
use super::text::is_time;
use super::text::{NPY_MAGIC, read_bytes};
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::tensor::{Numbers, Tensor};

/// The longest header that is read; NumPy's own reader stops at 10,000 bytes by default.
const MOST_HEADER: usize = 64 << 10;
/// The deepest brackets of a header: a structured type within a structured type.
const DEEPEST_HEADER: usize = 8;

/// An array file whose header fits its bytes.
pub struct Array {
    path: PathBuf,
    header: NpyHeader,
    shape: Vec<usize>,
    bytes: Vec<u8>,
    data: usize,
    element: Element,
}

/// The kind of numbers that a type stores; none for one that is not read.
fn element(dtype: &DType) -> Option<Element> {
    let DType::Plain(plain) = dtype else { return None };
    match (plain.type_char(), u8::try_from(plain.size_field()).ok()?) {
        (TypeChar::Bool, 1) => Some(Element::U(1)),
        (TypeChar::Int, size @ (1 | 2 | 4 | 8)) => Some(Element::I(size)),
        (TypeChar::Uint, size @ (1 | 2 | 4 | 8)) => Some(Element::U(size)),
        (TypeChar::Float, size @ (2 | 4 | 8)) => Some(Element::F(size)),
        _ => None,
    }
}

fn dtype_name(dtype: &DType) -> String {
    let mut name = match dtype {
        DType::Plain(plain) => plain.to_string(),
        other => other.descr(),
    };
    if name.len() > 120 {
        name = name.chars().take(120).collect();
        name.push_str(" ..");
    }
    name
}

/// What an unreadable type holds, in words.
fn kind_of(dtype: &DType) -> &'static str {
    match dtype {
        DType::Plain(plain) => match plain.type_char() {
            TypeChar::Object => "Python objects (pickled)",
            TypeChar::Complex => "complex numbers",
            TypeChar::ByteStr | TypeChar::UnicodeStr => "text",
            TypeChar::TimeDelta | TypeChar::DateTime => "dates or durations",
            TypeChar::RawData => "raw data",
            _ => "numbers of an unusual size",
        },
        DType::Record(_) | DType::Array(..) => "records of several fields",
    }
}

/// How an array of an unreadable type is saved so that it is read.
fn remedy(dtype: &DType) -> String {
    let kind = match dtype {
        DType::Plain(plain) => plain.type_char(),
        // NumPy converts no record of several fields into a number.
        DType::Record(fields) => {
            // Fields of events, by what their reader takes for a time; of other names none is
            // printed.
            let plain = |name: &&str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
            let names = || fields.iter().map(|field| field.name.as_str()).filter(plain);
            let time = names().find(|name| is_time(name));
            let places = names().filter(|name| matches!(*name, "x" | "y" | "p" | "polarity"));
            let Some(time) = time.filter(|_| names().any(|name| name == "x")) else {
                return "save one field of it as an array of numbers: array[array.dtype.names[0]]".to_string();
            };
            let unit = if time.contains('_') { "" } else { "_us" };
            let header: Vec<String> =
                [format!("{time}{unit}")].into_iter().chain(places.clone().map(Into::into)).collect();
            let columns: Vec<String> =
                [time].into_iter().chain(places).map(|name| format!("array['{name}']")).collect();
            return format!(
                "events are read as text: numpy.savetxt('events.csv', numpy.column_stack([{}]), fmt='%.17g', \
                 delimiter=',', \
                 header='{}', comments=''); of times in other units the header says _s, _ms or _ns",
                columns.join(", "),
                header.join(",")
            );
        }
        DType::Array(..) => {
            return "save its numbers without a type of several: numpy.array(array.tolist())".to_string();
        }
    };
    let way = match kind {
        TypeChar::Complex => "array.real or numpy.abs(array)",
        TypeChar::TimeDelta | TypeChar::DateTime => "array.astype('int64')",
        TypeChar::RawData => "array.view(DTYPE), with the type that was stored as bytes",
        _ => "array.astype(numpy.float64)",
    };
    format!("save it as integers or floating-point numbers: {way}")
}

/// Checks the header's length, its nesting and the sizes that it claims, and returns where the
/// numbers begin. The parser behind it checks none of these: it recurses, allocates and multiplies
/// as the header says.
fn check_header(path: &Path, bytes: &[u8]) -> Result<usize> {
    let problem = |code, message: String| Err(Diagnostic::new(code, message).in_file(path));
    if !bytes.starts_with(NPY_MAGIC) {
        let archive =
            bytes.starts_with(b"PK\x03\x04").then_some("this is an archive (.npz?); save each array with numpy.save");
        let mut other = Diagnostic::new("npy.format", "this is not a NumPy array: it does not start with \\x93NUMPY");
        other.help = archive.map(Into::into);
        return Err(other.in_file(path));
    }
    let (length, start) = match *bytes.get(6..).unwrap_or_default() {
        [1, 0, a, b, ..] => (usize::from(u16::from_le_bytes([a, b])), 10),
        [2 | 3, 0, a, b, c, d, ..] => (u32::from_le_bytes([a, b, c, d]) as usize, 12),
        [major, minor, _, _, ..] if !(1..=3).contains(&major) || minor != 0 => {
            return problem("npy.format", format!("version {major}.{minor} of the format is not known"));
        }
        _ => return problem("npy.truncated", "the file ends within its header".into()),
    };
    if length > MOST_HEADER {
        return problem("npy.format", format!("the header claims {length} bytes; {MOST_HEADER} are read"));
    }
    let Some(header) = bytes.get(start..start + length) else {
        return problem("npy.truncated", format!("the header claims {length} bytes and the file ends before"));
    };
    let mut depth = 0usize;
    let mut quote = None;
    let mut number: Option<u64> = None;
    let mut numbers = 1u64;
    let mut empty = false;
    let mut escaped = false;
    for &byte in header.iter().chain(b" ") {
        if let Some(open) = quote {
            match byte {
                _ if escaped => escaped = false,
                b'\\' => escaped = true,
                _ if byte == open => quote = None,
                _ => {}
            }
            continue;
        }
        if byte.is_ascii_digit() {
            number = Some(number.unwrap_or(0).saturating_mul(10).saturating_add(u64::from(byte - b'0')));
            continue;
        }
        empty |= number == Some(0);
        numbers = numbers.saturating_mul(number.take().unwrap_or(1).max(1));
        match byte {
            b'\'' | b'"' => quote = Some(byte),
            b'(' | b'[' | b'{' => depth += 1,
            b')' | b']' | b'}' => depth = depth.saturating_sub(1),
            _ => {}
        }
        if depth > DEEPEST_HEADER {
            return problem("npy.format", format!("the header has brackets deeper than {DEEPEST_HEADER}"));
        }
    }
    // Every number of an array takes at least a byte; an array with an empty axis has none, however
    // long the others are.
    let there = (bytes.len() - start - length) as u64;
    if numbers > if empty { u64::from(u32::MAX) } else { there } {
        return problem(
            "npy.shape",
            format!("the shape in the header asks for at least {numbers} bytes, and {there} follow it"),
        );
    }
    Ok(start + length)
}

/// Opens a file.
///
/// # Errors
/// As [`read_bytes`] and [`Array::from_bytes`].
pub fn open(path: &Path) -> Result<Array> {
    Array::from_bytes(path, read_bytes(path, MOST_ARRAY)?)
}

/// Reads a whole file into a tensor.
///
/// # Errors
/// As [`open`] and [`Array::tensor`].
pub fn read(path: &Path) -> Result<Tensor> {
    open(path)?.tensor()
}

impl Array {
    /// An array from the bytes of its file; the path is for messages.
    ///
    /// # Errors
    /// `npy.format`, `npy.dtype`, `npy.shape`, `npy.truncated`, `npy.trailing`.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let data = check_header(path, &bytes)?;
        let header = NpyHeader::from_reader(&bytes[..data]).map_err(|error| {
            Diagnostic::new("npy.format", format!("the header cannot be read: {error}")).in_file(path)
        })?;
        let dtype = header.dtype();
        let Some(element) = element(&dtype) else {
            return Err(Diagnostic::new(
                "npy.dtype",
                format!("the array's type {} holds {}, which are not read", dtype_name(&dtype), kind_of(&dtype)),
            )
            .help(remedy(&dtype))
            .in_file(path));
        };
        let there = bytes.len() - data;
        let overflow =
            || Diagnostic::new("npy.shape", format!("shape {:?} is larger than memory", header.shape())).in_file(path);
        let mut shape = Vec::with_capacity(header.shape().len());
        let mut need = element.bytes();
        for &axis in header.shape() {
            let axis = usize::try_from(axis).map_err(|_| overflow())?;
            need = need.checked_mul(axis).ok_or_else(overflow)?;
            shape.push(axis);
        }
        if need != there {
            let (code, word) = if there < need { ("npy.truncated", "only ") } else { ("npy.trailing", "") };
            return Err(Diagnostic::new(
                code,
                format!(
                    "shape {shape:?} of {} needs {need} bytes, and {word}{there} follow the header",
                    dtype_name(&dtype)
                ),
            )
            .in_file(path));
        }
        Ok(Array { path: path.into(), header, shape, bytes, data, element })
    }

    /// The axes.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// The type of its numbers, as NumPy spells it.
    #[must_use]
    pub fn dtype(&self) -> String {
        dtype_name(&self.header.dtype())
    }

    /// The file, for messages.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the first axis runs fastest.
    fn is_fortran(&self) -> bool {
        self.header.order() == Order::Fortran && self.shape.len() > 1
    }

    fn is_big_endian(&self) -> bool {
        matches!(self.header.dtype(), DType::Plain(plain) if plain.endianness() == Endianness::Big)
    }

    /// An index in the order of the file as index in C order.
    fn c_order(&self) -> impl Fn(usize) -> usize + use<> {
        // Last axis of the file's order first: in Fortran order that is the first axis.
        let fortran = self.is_fortran();
        let shape = if fortran { self.shape.clone() } else { Vec::new() };
        move |mut index| {
            if !fortran {
                return index;
            }
            let mut stride: usize = shape.iter().product();
            let mut place = 0;
            for &axis in &shape {
                stride /= axis;
                place += index % axis * stride;
                index /= axis;
            }
            place
        }
    }

    /// Numbers in the order of the file as numbers in C order.
    fn in_c_order<T: Copy + Default>(&self, numbers: Vec<T>) -> Vec<T> {
        if !self.is_fortran() {
            return numbers;
        }
        let (place, mut ordered) = (self.c_order(), vec![T::default(); numbers.len()]);
        numbers.into_iter().enumerate().for_each(|(index, x)| ordered[place(index)] = x);
        ordered
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
        let is_bool = matches!(self.header.dtype(), DType::Plain(plain) if plain.type_char() == TypeChar::Bool);
        if is_bool && let Some(byte) = data.iter().find(|&&byte| byte > 1) {
            return Err(self.failed(format!("invalid value for bool: {byte}")));
        }
        let (count, width) = ((data.len() / self.element.bytes()) as u64, self.element.bytes() as u64);
        let taken = Budget::for_file(self.bytes.len() as u64, 1, 1).numbers(count, width);
        taken.map_err(|exceeded| self.failed(exceeded))?;
        let place = self.c_order();
        let wrong = |index, value: &dyn Display, why: &str| self.wrong(place(index), value, why);
        let numbers = match self.element.numbers(data, self.is_big_endian(), wrong)? {
            Numbers::Integers(numbers) => Numbers::Integers(self.in_c_order(numbers)),
            Numbers::Reals(numbers) => Numbers::Reals(self.in_c_order(numbers)),
        };
        Tensor::new(self.shape.clone(), numbers).ok_or_else(|| self.failed("they do not fill the shape"))
    }

    /// Calls `f` with the C-order index of each number that is not zero, and the number, in the
    /// order of the file. Recordings are sparse, so zeros are skipped eight bytes at a time.
    ///
    /// # Errors
    /// As [`Array::tensor`], and whatever `f` says.
    pub fn each_non_zero(&self, mut f: impl FnMut(usize, f64) -> Result<()>) -> Result<()> {
        let place = self.c_order();
        let size = self.element.bytes();
        let big = self.is_big_endian();
        let data = &self.bytes[self.data..];
        for (word, bytes) in data.chunks(8).enumerate() {
            if bytes.try_into().is_ok_and(|bytes| u64::from_ne_bytes(bytes) == 0) {
                continue;
            }
            for (k, number) in bytes.chunks_exact(size).enumerate() {
                if number.iter().any(|&byte| byte != 0) {
                    let index = place(word * (8 / size) + k);
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

/// Writes an array in C order as its numbers come; their number must be the product of the shape.
/// The type is that of the numbers, such as `u1`, `i4` and `f8`.
///
/// # Errors
/// When the output cannot be written, or the numbers do not fill the shape.
pub fn write<T: npyz::AutoSerialize>(
    out: impl Write,
    shape: &[u64],
    numbers: impl IntoIterator<Item = T>,
) -> std::io::Result<()> {
    let mut writer = npyz::WriteOptions::new().default_dtype().shape(shape).writer(out).begin_nd()?;
    writer.extend(numbers)?;
    writer.finish()
}

/// Writes an array of bytes in C order that is there as a whole; its length must be the product of
/// the shape.
///
/// The header is that of version 1.0 (NumPy, `numpy/lib/format.py`): padded so that the numbers
/// begin at a multiple of 64.
///
/// # Errors
/// When the output cannot be written, or the numbers do not fill the shape.
pub fn write_bytes(out: &mut dyn Write, shape: &[u64], bytes: &[u8]) -> std::io::Result<()> {
    if shape.iter().product::<u64>() != bytes.len() as u64 {
        return Err(std::io::Error::other(format!("{} bytes do not fill the shape {shape:?}", bytes.len())));
    }
    let axes: String = shape.iter().map(|axis| format!("{axis},")).collect();
    let fields = format!("{{'descr': '|u1', 'fortran_order': False, 'shape': ({axes}), }}");
    let before = NPY_MAGIC.len() + 4;
    let padded = (before + fields.len() + 1).next_multiple_of(64) - before - 1;
    let length = u16::try_from(padded + 1).map_err(|_| std::io::Error::other("the shape has too many axes"))?;
    let header = format!("{fields}{}\n", " ".repeat(padded - fields.len()));
    out.write_all(NPY_MAGIC)?;
    out.write_all(&[1, 0])?;
    out.write_all(&length.to_le_bytes())?;
    out.write_all(header.as_bytes())?;
    out.write_all(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nsim_ir::base::rng::unit;

    /// A version 1 file as NumPy writes it.
    fn file(descr: &str, fortran: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let mut header = format!("{{'descr': {descr}, 'fortran_order': {fortran}, 'shape': {shape}, }}");
        while (10 + header.len() + 1) % 64 != 0 {
            header.push(' ');
        }
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(data);
        bytes
    }

    fn parse(bytes: Vec<u8>) -> Result<Tensor> {
        Array::from_bytes(Path::new("a.npy"), bytes)?.tensor()
    }

    fn code(bytes: Vec<u8>) -> &'static str {
        parse(bytes).unwrap_err().code
    }

    #[test]
    fn every_type_of_number_is_read() {
        let cases: [(&str, &[u8], Numbers); 12] = [
            ("'|b1'", &[0, 1], Numbers::Integers(vec![0, 1])),
            ("'|i1'", &[0xff, 5], Numbers::Integers(vec![-1, 5])),
            ("'|u1'", &[0xff, 5], Numbers::Integers(vec![255, 5])),
            ("'<i2'", &[0xfe, 0xff, 1, 0], Numbers::Integers(vec![-2, 1])),
            ("'>i2'", &[0xff, 0xfe, 0, 1], Numbers::Integers(vec![-2, 1])),
            ("'<u2'", &[0xff, 0xff, 0, 0], Numbers::Integers(vec![65535, 0])),
            ("'<i4'", &[0, 0, 0, 0x80, 1, 0, 0, 0], Numbers::Integers(vec![i32::MIN, 1])),
            ("'<u4'", &[0xff, 0xff, 0xff, 0x7f, 1, 0, 0, 0], Numbers::Integers(vec![i32::MAX, 1])),
            (
                "'<i8'",
                &[1, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff],
                Numbers::Integers(vec![1, -1]),
            ),
            ("'<f2'", &[0, 0x3c, 0, 0xc0], Numbers::Reals(vec![1.0, -2.0])),
            ("'>f2'", &[0x3c, 0, 0xc0, 0], Numbers::Reals(vec![1.0, -2.0])),
            ("'<f4'", &[0, 0, 0x80, 0x3f, 0, 0, 0, 0xbf], Numbers::Reals(vec![1.0, -0.5])),
        ];
        for (descr, data, numbers) in cases {
            let tensor = parse(file(descr, "False", "(2,)", data)).unwrap();
            assert_eq!((tensor.shape(), tensor.numbers()), (&[2][..], &numbers), "{descr}");
        }
        let error = parse(file("'|b1'", "False", "(2,)", &[1, 2])).unwrap_err();
        assert!(error.code == "npy.format" && error.message.ends_with("invalid value for bool: 2"), "{error}");
        let data: Vec<u8> = [1.5f64, -3.25].iter().flat_map(|x| x.to_be_bytes()).collect();
        assert_eq!(
            parse(file("'>f8'", "False", "(2, 1)", &data)).unwrap().numbers(),
            &Numbers::Reals(vec![1.5, -3.25])
        );
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
        let overflows = file("'|u1'", "False", "(9223372036854775808, 9223372036854775808, 0)", &[]);
        assert_eq!(code(overflows), "npy.shape");
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
        for (descr, what) in [
            ("'|O'", "Python objects"),
            ("'<c8'", "complex"),
            ("'<U4'", "text"),
            ("'<M8[ns]'", "dates"),
            ("'<f16'", "unusual size"),
            ("[('a', '<f4'), ('b', '<i4', (2,))]", "several fields"),
        ] {
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
        assert_eq!(code(file("'<f8'", "False", "(8,)", &[0; 63])), "npy.truncated");
        assert_eq!(code(file("'<f8'", "False", "(8,)", &[0; 65])), "npy.trailing");
        assert_eq!(code(file("'<f8'", "False", "(-8,)", &[0; 64])), "npy.format");
        let deep = "[".repeat(30_000);
        assert_eq!(code(file(&deep, "False", "(8,)", &[0; 64])), "npy.format");
        assert_eq!(code(b"\x93NUMPY\x02\x00\xff\xff\xff\xff".to_vec()), "npy.format");
        assert_eq!(code(b"\x93NUMPY\x01\x00\xff\x7f{".to_vec()), "npy.truncated");
        assert_eq!(code(b"\x93NUMPY\x01".to_vec()), "npy.truncated");
        assert_eq!(code(b"\x93NUMPY\x09\x00\x01\x00 ".to_vec()), "npy.format");
        assert_eq!(code(b"PK\x03\x04".to_vec()), "npy.format");
        assert_eq!(code(Vec::new()), "npy.format");
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
            write_bytes(&mut bytes, shape, &numbers).unwrap();
            assert_eq!((bytes.len() - numbers.len()) % 64, 0);
            let tensor = parse(bytes).unwrap();
            let axes: Vec<usize> = shape.iter().map(|&axis| axis as usize).collect();
            assert_eq!(tensor.shape(), axes);
            assert_eq!(tensor.numbers(), &Numbers::Integers(numbers.iter().map(|&n| i32::from(n)).collect()));
        }
        assert!(write_bytes(&mut Vec::new(), &[3], &[0, 1]).is_err());
        // The header's length is stored in two bytes.
        assert!(write_bytes(&mut Vec::new(), &vec![1; 40_000], &[0]).is_err());
    }

    #[test]
    fn non_zero_numbers_are_those_of_the_tensor() {
        // Every type, lengths around whole words, sparse and dense, both orders of bytes and of
        // axes.
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
                            // A small number of either kind: one that floats read as neither zero
                            // nor infinite.
                            let at = if dtype.starts_with('>') { k * size + size - 1 } else { k * size };
                            data[at] = 1;
                        }
                    }
                    let shape = format!("({rows}, {columns})");
                    let array =
                        Array::from_bytes(Path::new("a.npy"), file(&format!("'{dtype}'"), order, &shape, &data))
                            .unwrap();
                    let mut found = Vec::new();
                    array
                        .each_non_zero(|index, _| {
                            found.push(index);
                            Ok(())
                        })
                        .unwrap();
                    found.sort_unstable();
                    let expected: Vec<usize> = match array.tensor().unwrap().numbers() {
                        Numbers::Integers(numbers) => (0..numbers.len()).filter(|&k| numbers[k] != 0).collect(),
                        Numbers::Reals(numbers) => (0..numbers.len()).filter(|&k| numbers[k] != 0.0).collect(),
                    };
                    assert_eq!(found, expected, "{dtype} {shape} {order}");
                }
            }
        }
        let zero = file("'<f4'", "False", "(3,)", &[0, 0, 0, 0x80, 0, 0, 0x80, 0x3f, 0, 0, 0xc0, 0x7f]);
        let array = Array::from_bytes(Path::new("a.npy"), zero).unwrap();
        let mut found = Vec::new();
        let error = array
            .each_non_zero(|index, _| {
                found.push(index);
                Ok(())
            })
            .unwrap_err();
        assert_eq!((found, error.code), (vec![1], "npy.value"), "minus zero is zero, NaN is refused");
        let wide = file("'<i8'", "False", "(1,)", &(1i64 << 31).to_le_bytes());
        let wide = Array::from_bytes(Path::new("a.npy"), wide).unwrap();
        assert_eq!(wide.each_non_zero(|_, _| Ok(())).unwrap_err().code, "npy.value");
    }
}
