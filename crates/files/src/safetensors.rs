//! Tensors of a safetensors file.
//!
//! Input: a file and a key. Output: a [`Tensor`]. 8-bit floats and packed formats are refused. The
//! file's size bounds the memory of all tensors together ([`Budget`]).

use std::cell::RefCell;
use std::path::{Path, PathBuf};

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};

use super::budget::{Budget, MOST_ARRAY};
use super::element::Element;
use super::text::read_bytes;
use nsim_ir::base::diagnostic::{Diagnostic, Result};
use nsim_ir::tensor::{Numbers, Tensor};

/// Key, type and shape of a tensor, as the file states them.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Its key.
    pub key: String,
    /// The type of its numbers.
    pub dtype: String,
    /// The axes.
    pub shape: Vec<usize>,
}

/// The bytes of a safetensors file, from which several tensors can be read.
pub struct TensorFile {
    path: PathBuf,
    bytes: Vec<u8>,
    budget: RefCell<Budget>,
}

/// The most tensors that are read from a file.
const MOST_TENSORS: usize = 1 << 16;

/// Reads a file.
///
/// # Errors
/// As [`read_bytes`]; `safetensors.format`.
pub fn open(path: &Path) -> Result<TensorFile> {
    TensorFile::from_bytes(path, read_bytes(path, MOST_ARRAY)?)
}

impl TensorFile {
    /// Parses a file from its bytes; the path is for messages.
    ///
    /// # Errors
    /// `safetensors.format`.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self> {
        let budget = RefCell::new(Budget::for_file(bytes.len() as u64, MOST_TENSORS, 1));
        let file = TensorFile { path: path.into(), bytes, budget };
        file.view()?;
        Ok(file)
    }

    fn view(&self) -> Result<SafeTensors<'_>> {
        SafeTensors::deserialize(&self.bytes).map_err(|error| {
            Diagnostic::new("safetensors.format", format!("this is not a complete safetensors file: {error}"))
                .in_file(&self.path)
        })
    }

    /// Its tensors, by key.
    ///
    /// # Errors
    /// `safetensors.format`.
    pub fn entries(&self) -> Result<Vec<Entry>> {
        let view = self.view()?;
        let mut entries: Vec<Entry> = view
            .iter()
            .map(|(key, tensor)| Entry {
                key: key.to_string(),
                dtype: format!("{:?}", tensor.dtype()),
                shape: tensor.shape().to_vec(),
            })
            .collect();
        entries.sort_by(|a, b| a.key.cmp(&b.key));
        Ok(entries)
    }

    /// One tensor.
    ///
    /// # Errors
    /// `safetensors.key` with the keys that exist, `safetensors.dtype`, `safetensors.value` with
    /// the index.
    pub fn tensor(&self, key: &str) -> Result<Tensor> {
        let view = self.view()?;
        let Ok(tensor) = view.tensor(key) else {
            let entries = self.entries()?;
            let keys: Vec<&str> = entries.iter().take(20).map(|entry| entry.key.as_str()).collect();
            let more = entries.len().saturating_sub(keys.len());
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            return Err(Diagnostic::new("safetensors.key", format!("there is no tensor '{key}'"))
                .help(format!("tensors of the file: {}{more}", keys.join(", ")))
                .in_file(&self.path));
        };
        let numbers = self.numbers(key, &tensor)?;
        Tensor::new(tensor.shape().to_vec(), numbers).ok_or_else(|| {
            Diagnostic::new("safetensors.format", format!("tensor '{key}' does not fill its shape")).in_file(&self.path)
        })
    }

    fn numbers(&self, key: &str, tensor: &TensorView<'_>) -> Result<Numbers> {
        let Some(element) = element(tensor.dtype()) else {
            let message = format!("tensor '{key}' has type {:?}, which is not supported", tensor.dtype());
            return Err(Diagnostic::new("safetensors.dtype", message)
                .help("supported types: F64, F32, F16, BF16, integers of 8 to 64 bits and BOOL")
                .in_file(&self.path));
        };
        let (width, data) = (element.bytes(), tensor.data());
        let mut budget = self.budget.borrow_mut();
        let taken = budget.item(1).and_then(|()| budget.numbers((data.len() / width) as u64, width as u64));
        taken.map_err(|exceeded| Diagnostic::new("safetensors.format", exceeded.to_string()).in_file(&self.path))?;
        element.numbers(data, false, |index, value, why| {
            Diagnostic::new("safetensors.value", format!("number {index} of tensor '{key}' is {value}, which is {why}"))
                .in_file(&self.path)
        })
    }
}

/// The element type of a `Dtype`; `None` for a type that is not read.
fn element(dtype: Dtype) -> Option<Element> {
    Some(match dtype {
        Dtype::I8 => Element::I(1),
        Dtype::I16 => Element::I(2),
        Dtype::I32 => Element::I(4),
        Dtype::I64 => Element::I(8),
        Dtype::BOOL | Dtype::U8 => Element::U(1),
        Dtype::U16 => Element::U(2),
        Dtype::U32 => Element::U(4),
        Dtype::U64 => Element::U(8),
        Dtype::F16 => Element::F(2),
        Dtype::F32 => Element::F(4),
        Dtype::F64 => Element::F(8),
        Dtype::BF16 => Element::Bf16,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A file in the layout of the format's specification: length, JSON, data.
    fn file(json: &str, data: &[u8]) -> Result<TensorFile> {
        let mut bytes = (json.len() as u64).to_le_bytes().to_vec();
        bytes.extend(json.bytes());
        bytes.extend(data);
        TensorFile::from_bytes(Path::new("w.safetensors"), bytes)
    }

    fn one(dtype: &str, data: &[u8], count: usize) -> Result<Numbers> {
        let json = format!(r#"{{"w":{{"dtype":"{dtype}","shape":[{count}],"data_offsets":[0,{}]}}}}"#, data.len());
        Ok(file(&json, data)?.tensor("w")?.numbers().clone())
    }

    #[test]
    fn every_type_of_number_is_read() {
        assert_eq!(one("BOOL", &[0, 1], 2).unwrap(), Numbers::Integers(vec![0, 1]));
        assert_eq!(one("I8", &[255], 1).unwrap(), Numbers::Integers(vec![-1]));
        assert_eq!(one("U8", &[255], 1).unwrap(), Numbers::Integers(vec![255]));
        assert_eq!(one("I16", &[0xfe, 0xff], 1).unwrap(), Numbers::Integers(vec![-2]));
        assert_eq!(one("I32", &(-7i32).to_le_bytes(), 1).unwrap(), Numbers::Integers(vec![-7]));
        assert_eq!(one("I64", &(-7i64).to_le_bytes(), 1).unwrap(), Numbers::Integers(vec![-7]));
        assert_eq!(one("F16", &[0, 0xc0], 1).unwrap(), Numbers::Reals(vec![-2.0]));
        assert_eq!(one("BF16", &[0x40, 0xc0], 1).unwrap(), Numbers::Reals(vec![-3.0]));
        assert_eq!(one("F32", &0.5f32.to_le_bytes(), 1).unwrap(), Numbers::Reals(vec![0.5]));
        assert_eq!(one("F64", &0.1f64.to_le_bytes(), 1).unwrap(), Numbers::Reals(vec![0.1]));
    }

    #[test]
    fn a_problem_names_the_tensor() {
        let error = one("I64", &(1i64 << 40).to_le_bytes(), 1).unwrap_err();
        assert!(error.code == "safetensors.value" && error.message.contains("number 0 of tensor 'w'"), "{error}");
        assert_eq!(one("F32", &f32::INFINITY.to_le_bytes(), 1).unwrap_err().code, "safetensors.value");
        assert_eq!(one("F8_E4M3", &[0], 1).unwrap_err().code, "safetensors.dtype");
    }

    #[test]
    fn damaged_files_are_refused() {
        let huge = r#"{"w":{"dtype":"F64","shape":[4000000000000,4000000000000],"data_offsets":[0,8]}}"#;
        let deep = format!("{{\"w\":{}", "[".repeat(100_000));
        for json in [huge, "{", "", &deep] {
            assert_eq!(file(json, &[0; 8]).err().unwrap().code, "safetensors.format", "{json:.60}");
        }
        assert_eq!(TensorFile::from_bytes(Path::new("w"), vec![]).err().unwrap().code, "safetensors.format");
    }
}
