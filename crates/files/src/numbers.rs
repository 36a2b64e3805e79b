//! Lists of numbers in a RON text.
//!
//! Input: the text of a list, nested at most four deep. Output: a tensor with an axis for each
//! depth. Errors point at the entry that is not a finite number, or at the row of another length.

use std::fmt;

use nsim_ir::base::diagnostic::Span;
use nsim_ir::locate::locate;
use nsim_ir::spanned::{read_at, refuse};
use nsim_ir::tensor::{Numbers, Tensor};
use serde::de::{DeserializeSeed, Deserializer, Error, SeqAccess, Visitor};

/// Greatest depth of lists: a convolution kernel is `[C'][C / groups][kh][kw]`.
const DEEPEST: usize = 4;

/// A list that is being read.
#[derive(Default)]
struct List {
    shape: Vec<usize>,
    numbers: Vec<f64>,
    /// Indices of the entry that is being read.
    entry: Vec<usize>,
    /// Whether this module refused that entry, rather than RON.
    refused: bool,
}

/// An entry within `depth` lists: a number, or a list.
struct Entry<'a> {
    list: &'a mut List,
    depth: usize,
}

/// Parses a list; `span` is the place of `text` in the file, for errors.
pub fn list_at<E: Error>(text: &str, span: Span) -> Result<Tensor, E> {
    let mut list = List::default();
    if let Err(problem) = read_at(text, span, Entry { list: &mut list, depth: 0 }) {
        let path: Vec<String> = list.entry.iter().map(usize::to_string).collect();
        let within = Span { start: 0, end: text.len() };
        let entry = locate(text, within, &path.join(".")).filter(|_| list.refused);
        let entry = entry.map(|entry| Span { start: span.start + entry.start, end: span.start + entry.end });
        return refuse(entry.unwrap_or(problem.span), problem.message);
    }
    match Tensor::new(list.shape, Numbers::Reals(list.numbers)) {
        Some(tensor) => Ok(tensor),
        None => refuse(span, "the rows have different lengths"),
    }
}

impl List {
    fn refused<T, E: Error>(&mut self, message: impl fmt::Display) -> Result<T, E> {
        self.refused = true;
        Err(E::custom(message))
    }
}

impl<'de> DeserializeSeed<'de> for Entry<'_> {
    type Value = ();
    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        deserializer.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Entry<'_> {
    type Value = ();
    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a number or a list of numbers")
    }

    fn visit_i64<E: Error>(self, number: i64) -> Result<(), E> {
        self.visit_f64(number as f64)
    }

    fn visit_u64<E: Error>(self, number: u64) -> Result<(), E> {
        self.visit_f64(number as f64)
    }

    fn visit_f64<E: Error>(self, number: f64) -> Result<(), E> {
        if !number.is_finite() {
            return self.list.refused(format!("{number} is not a finite number"));
        }
        if self.list.shape.len() != self.depth {
            return self.list.refused("a number is given where the other rows have a list");
        }
        self.list.numbers.push(number);
        Ok(())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> Result<(), A::Error> {
        let Entry { list, depth } = self;
        if depth == DEEPEST {
            return list.refused(format!("lists are nested deeper than {DEEPEST}"));
        }
        // The first list at a depth fixes the length of all others there.
        let is_first = list.shape.len() == depth;
        if is_first && !list.numbers.is_empty() {
            return list.refused("a list is given where the other rows have a number");
        }
        if is_first {
            list.shape.push(0);
        }
        let mut length = 0;
        list.entry.push(length);
        while entries.next_element_seed(Entry { list: &mut *list, depth: depth + 1 })?.is_some() {
            length += 1;
            list.entry[depth] = length;
        }
        list.entry.pop();
        let before = list.shape[depth];
        if !is_first && before != length {
            return list.refused(format!("the rows have different lengths: {length} here, {before} before"));
        }
        list.shape[depth] = length;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::de::value::Error;

    fn read(text: &str) -> Result<Tensor, Error> {
        list_at(text, Span { start: 0, end: text.len() })
    }

    #[test]
    fn lists_have_a_shape() {
        let tensor = read("[[1, -2.5 /* two */, 0x1F], // row\n [4,1_000,\t.5,],]").unwrap();
        assert_eq!(tensor.shape(), [2, 3]);
        assert_eq!(tensor.numbers(), &Numbers::Reals(vec![1.0, -2.5, 31.0, 4.0, 1000.0, 0.5]));
        for (text, shape) in [("[]", &[0][..]), ("[[], []]", &[2, 0]), ("[[[[7]]]]", &[1, 1, 1, 1])] {
            assert_eq!(read(text).unwrap().shape(), shape);
        }
        let exact = read("[1e-320, 123456789012345678, -0.0]").unwrap();
        let bits: Vec<u64> = exact.reals().map(f64::to_bits).collect();
        assert_eq!(bits, [1e-320, 123456789012345678.0, -0.0].map(f64::to_bits));
    }
}
