//! HDF5 files as a tree in memory, read under a budget.
//!
//! Comes in: the bytes of a file. Goes out: a [`Group`] with all groups and data sets below it, numbers still in the
//! bytes of their own type. A file is not trusted: objects, depth, strings and decoded bytes are counted and bounded
//! ([`MOST_FIXED`] and [`MOST_RATIO`]), links to other files are not followed, and a reader that fails becomes a
//! diagnostic. Attributes are read for the NIR data files only; compound types and references are left out (they become
//! [`Item::Other`]).

use std::collections::BTreeMap;
use std::path::Path;

use hdf5_pure::{AttrValue, DatasetBuilder, FileBuilder, FinishedGroup, GroupBuilder};
use hdf5_reader::messages::datatype::{StringSize, VarLenKind};
use hdf5_reader::{Dataset, Datatype, Hdf5File, OpenOptions};

use crate::base::diagnostic::Diagnostic;

/// What every HDF5 file begins with (HDF5 file format specification 3.0, II.A).
pub const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
/// Decoded bytes that any file may have.
pub const MOST_FIXED: u64 = 32 << 20;
/// Decoded bytes that a file may have in addition, for each byte of its own: compressed arrays are larger than their file.
pub const MOST_RATIO: u64 = 8;
/// Groups and data sets of a file.
const MOST_OBJECTS: usize = 1 << 16;
/// Groups within groups.
const DEEPEST: usize = 16;
/// Axes of an array.
const MOST_AXES: usize = 8;
/// Strings of a data set.
const MOST_STRINGS: u64 = 1 << 16;

/// A group's members by name.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Group {
    /// Its members.
    pub items: BTreeMap<String, Item>,
    /// Its attributes that are a number or a text.
    pub attributes: BTreeMap<String, Attribute>,
}

/// An attribute's value.
#[derive(Debug, Clone, PartialEq)]
pub enum Attribute {
    /// A number.
    Number(f64),
    /// A text.
    Text(String),
}

/// A member of a group.
#[derive(Debug, Clone, PartialEq)]
pub enum Item {
    /// A group.
    Group(Group),
    /// Numbers.
    Numbers(Numbers),
    /// Texts, in C order.
    Texts(Vec<usize>, Vec<String>),
    /// Something of a type that is not read.
    Other(String),
}

/// How the numbers of an array are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Element {
    I(u8),
    U(u8),
    F(u8),
}

/// An array of numbers in the bytes of its own type.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    shape: Vec<usize>,
    element: Element,
    bytes: Vec<u8>,
}

impl Numbers {
    /// The axes; none for a scalar.
    #[must_use]
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// How many.
    #[must_use]
    pub fn len(&self) -> usize {
        self.bytes.len() / self.size()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Whether they are integers.
    #[must_use]
    pub fn is_integer(&self) -> bool {
        !matches!(self.element, Element::F(_))
    }

    /// The type of an element as NumPy writes it: kind and bytes.
    #[must_use]
    pub fn dtype(&self) -> String {
        let (kind, size) = match self.element {
            Element::I(size) => ('i', size),
            Element::U(size) => ('u', size),
            Element::F(size) => ('f', size),
        };
        format!("{kind}{size}")
    }

    /// Reals of 64 bits.
    ///
    /// # Panics
    /// When the numbers do not fill the shape, a mistake of the caller; the other makers alike.
    #[must_use]
    pub fn f64(shape: &[usize], reals: &[f64]) -> Numbers {
        Numbers::of(shape, Element::F(8), reals.iter().flat_map(|x| x.to_ne_bytes()).collect())
    }

    /// Reals of 32 bits.
    #[must_use]
    pub fn f32(shape: &[usize], reals: &[f32]) -> Numbers {
        Numbers::of(shape, Element::F(4), reals.iter().flat_map(|x| x.to_ne_bytes()).collect())
    }

    /// Integers of 64 bits.
    #[must_use]
    pub fn i64(shape: &[usize], integers: &[i64]) -> Numbers {
        Numbers::of(shape, Element::I(8), integers.iter().flat_map(|x| x.to_ne_bytes()).collect())
    }

    fn of(shape: &[usize], element: Element, bytes: Vec<u8>) -> Numbers {
        let numbers = Numbers { shape: shape.to_vec(), element, bytes };
        assert_eq!(numbers.len(), shape.iter().product::<usize>(), "the numbers fill the shape");
        numbers
    }

    fn size(&self) -> usize {
        let (Element::I(size) | Element::U(size) | Element::F(size)) = self.element;
        usize::from(size)
    }

    /// Each number as a real. Integers beyond 2^53 are rounded.
    pub fn reals(&self) -> impl Iterator<Item = f64> + '_ {
        let element = self.element;
        self.bytes.chunks_exact(self.size()).map(move |b| match element {
            Element::F(4) => f64::from(f32::from_ne_bytes(fixed(b))),
            Element::F(_) => f64::from_ne_bytes(fixed(b)),
            Element::U(1) => f64::from(b[0]),
            Element::U(2) => f64::from(u16::from_ne_bytes(fixed(b))),
            Element::U(4) => f64::from(u32::from_ne_bytes(fixed(b))),
            Element::U(_) => u64::from_ne_bytes(fixed(b)) as f64,
            Element::I(1) => f64::from(b[0] as i8),
            Element::I(2) => f64::from(i16::from_ne_bytes(fixed(b))),
            Element::I(4) => f64::from(i32::from_ne_bytes(fixed(b))),
            Element::I(_) => i64::from_ne_bytes(fixed(b)) as f64,
        })
    }
}

/// Bytes of a known number.
fn fixed<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut array = [0; N];
    array.copy_from_slice(bytes);
    array
}

impl From<Group> for Item {
    fn from(group: Group) -> Self {
        Item::Group(group)
    }
}

impl From<Numbers> for Item {
    fn from(numbers: Numbers) -> Self {
        Item::Numbers(numbers)
    }
}

impl From<&str> for Item {
    fn from(text: &str) -> Self {
        Item::Texts(Vec::new(), vec![text.to_string()])
    }
}

impl Group {
    /// The group with one more member.
    #[must_use]
    pub fn with(mut self, name: &str, item: impl Into<Item>) -> Self {
        self.items.insert(name.to_string(), item.into());
        self
    }

    /// A member by its path.
    #[must_use]
    pub fn get(&self, path: &str) -> Option<&Item> {
        match path.split_once('/') {
            Some((first, rest)) => self.group(first)?.get(rest),
            None => self.items.get(path),
        }
    }

    /// A group among the members.
    #[must_use]
    pub fn group(&self, path: &str) -> Option<&Group> {
        match self.get(path)? {
            Item::Group(group) => Some(group),
            _ => None,
        }
    }

    /// An array among the members.
    #[must_use]
    pub fn numbers(&self, path: &str) -> Option<&Numbers> {
        match self.get(path)? {
            Item::Numbers(numbers) => Some(numbers),
            _ => None,
        }
    }

    /// The only number of a member: a scalar or an array of one.
    #[must_use]
    pub fn number(&self, path: &str) -> Option<f64> {
        let numbers = self.numbers(path)?;
        (numbers.len() == 1).then(|| numbers.reals().next())?
    }

    /// The only text of a member.
    #[must_use]
    pub fn text(&self, path: &str) -> Option<&str> {
        match self.get(path)? {
            Item::Texts(_, texts) if texts.len() == 1 => Some(&texts[0]),
            _ => None,
        }
    }
}

/// What may still be decoded.
struct Budget<'a> {
    path: &'a Path,
    bytes: u64,
    objects: usize,
}

impl Budget<'_> {
    fn take(&mut self, bytes: u64) -> Result<(), Diagnostic> {
        match self.bytes.checked_sub(bytes) {
            Some(rest) => self.bytes = rest,
            None => {
                let message = format!(
                    "its arrays would decode to more than {} MiB and {MOST_RATIO} times the file's size",
                    MOST_FIXED >> 20
                );
                return Err(Diagnostic::new("hdf5.too-large", message).in_file(self.path));
            }
        }
        Ok(())
    }

    fn object(&mut self, depth: usize) -> Result<(), Diagnostic> {
        self.objects += 1;
        if self.objects > MOST_OBJECTS || depth > DEEPEST {
            let message =
                format!("it has more than {MOST_OBJECTS} groups and data sets, or groups deeper than {DEEPEST}");
            return Err(Diagnostic::new("hdf5.too-large", message).in_file(self.path));
        }
        Ok(())
    }

    fn wrong(&self, what: &dyn std::fmt::Display) -> Diagnostic {
        let mut what = what.to_string();
        if what.len() > 300 {
            what = what.chars().take(300).collect();
        }
        Diagnostic::new("hdf5.format", format!("the HDF5 file cannot be read: {what}")).in_file(self.path)
    }
}

/// Reads a whole file.
///
/// # Errors
/// `hdf5.format`, `hdf5.too-large`.
pub fn tree(path: &Path, bytes: Vec<u8>) -> Result<Group, Diagnostic> {
    let most = MOST_FIXED + MOST_RATIO * bytes.len() as u64;
    let mut budget = Budget { path, bytes: most, objects: 0 };
    let options = OpenOptions::default()
        .with_chunk_cache_bytes(0)
        .with_max_chunk_bytes(most as usize)
        .with_max_read_bytes(most as usize)
        .with_max_object_header_bytes(1 << 20);
    let file = Hdf5File::from_vec_with_options(bytes, options).map_err(|error| budget.wrong(&error))?;
    let root = file.root_group().map_err(|error| budget.wrong(&error))?;
    group(&root, &mut budget, 0)
}

fn group(group: &hdf5_reader::group::Group, budget: &mut Budget<'_>, depth: usize) -> Result<Group, Diagnostic> {
    budget.object(depth)?;
    let (groups, datasets) = group.members().map_err(|error| budget.wrong(&error))?;
    let mut items = BTreeMap::new();
    for child in groups {
        items.insert(child.name().to_string(), Item::Group(self::group(&child, budget, depth + 1)?));
    }
    for dataset in datasets {
        budget.object(depth)?;
        items.insert(dataset.name().to_string(), self::dataset(&dataset, budget)?);
    }
    Ok(Group { items, attributes: attributes(&group.attributes().unwrap_or_default()) })
}

fn attributes(list: &[hdf5_reader::Attribute]) -> BTreeMap<String, Attribute> {
    let value = |attribute: &hdf5_reader::Attribute| match &attribute.datatype {
        Datatype::String { .. } | Datatype::VarLen { .. } => attribute.read_string().ok().map(Attribute::Text),
        Datatype::FixedPoint { .. } | Datatype::FloatingPoint { .. } => {
            attribute.read_as_f64().ok().map(Attribute::Number)
        }
        _ => None,
    };
    list.iter().filter_map(|attribute| Some((attribute.name.clone(), value(attribute)?))).collect()
}

fn element(datatype: &Datatype) -> Option<Element> {
    match datatype {
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), signed: true, .. } => Some(Element::I(*size)),
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), signed: false, .. } => Some(Element::U(*size)),
        Datatype::FloatingPoint { size: size @ (4 | 8), .. } => Some(Element::F(*size)),
        // h5py writes bool as an enumeration of an 8-bit integer.
        Datatype::Enum { base, .. } => element(base),
        _ => None,
    }
}

fn dataset(dataset: &Dataset, budget: &mut Budget<'_>) -> Result<Item, Diagnostic> {
    let wrong =
        |budget: &Budget<'_>, error: &dyn std::fmt::Display| budget.wrong(&format!("{}: {error}", dataset.name()));
    let shape: Vec<usize> = dataset.shape().iter().map(|&axis| usize::try_from(axis).unwrap_or(usize::MAX)).collect();
    if shape.len() > MOST_AXES {
        return Err(wrong(budget, &format!("an array of {} axes", shape.len())));
    }
    let length = shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis));
    let size = dataset.raw_byte_len().map_err(|error| wrong(budget, &error))?;
    if let Some(element) = element(dataset.dtype()) {
        budget.take(size as u64)?;
        let bytes = dataset.read_native_bytes().map_err(|error| wrong(budget, &error))?;
        let numbers = Numbers { shape, element, bytes };
        if length != Some(numbers.len()) || !numbers.bytes.len().is_multiple_of(numbers.size()) {
            return Err(wrong(budget, &"its bytes do not fill its shape"));
        }
        return Ok(Item::Numbers(numbers));
    }
    let variable = match dataset.dtype() {
        Datatype::String { size: StringSize::Fixed(_), .. } => false,
        Datatype::String { size: StringSize::Variable, .. } | Datatype::VarLen { kind: VarLenKind::String, .. } => true,
        other => {
            let mut name = format!("{other:?}");
            name.truncate(name.find([' ', '{']).unwrap_or(40).min(40));
            return Ok(Item::Other(name));
        }
    };
    if length.is_none_or(|length| length as u64 > MOST_STRINGS) {
        return Err(wrong(budget, &format!("more than {MOST_STRINGS} texts")));
    }
    budget.take(size as u64)?;
    if !variable {
        let texts = dataset.read_strings().map_err(|error| wrong(budget, &error))?;
        return Ok(Item::Texts(shape, texts));
    }
    // Many references may name one long text: each is resolved and counted by itself.
    let raw = dataset.read_raw_bytes().map_err(|error| wrong(budget, &error))?;
    let mut texts = Vec::new();
    for reference in raw.chunks_exact(dataset.vlen_reference_size().max(1)) {
        let bytes = dataset.resolve_vlen_reference_bytes(reference, 1).map_err(|error| wrong(budget, &error))?;
        budget.take(bytes.len() as u64)?;
        let end = bytes.iter().position(|&byte| byte == 0).unwrap_or(bytes.len());
        texts.push(String::from_utf8_lossy(&bytes[..end]).into_owned());
    }
    if Some(texts.len()) != length {
        return Err(wrong(budget, &"its texts do not fill its shape"));
    }
    Ok(Item::Texts(shape, texts))
}

/// The bytes of a file with this tree. Attributes are written for groups and not for data sets, as they are read.
///
/// # Errors
/// `hdf5.write` for what the format cannot hold.
pub fn write(root: &Group) -> Result<Vec<u8>, Diagnostic> {
    let failed = |error: &dyn std::fmt::Display| {
        Diagnostic::new("hdf5.write", format!("the HDF5 file cannot be written: {error}"))
    };
    let mut file = FileBuilder::new();
    for (name, item) in &root.items {
        match item {
            Item::Group(group) => {
                let builder = file.create_group(name);
                file.add_group(filled(builder, group));
            }
            item => fill(file.create_dataset(name), item),
        }
    }
    for (name, attribute) in &root.attributes {
        file.set_attr(name, attribute.written());
    }
    file.finish().map_err(|error| failed(&error))
}

impl Attribute {
    fn written(&self) -> AttrValue {
        match self {
            Attribute::Number(x) => AttrValue::F64(*x),
            Attribute::Text(text) => AttrValue::String(text.clone()),
        }
    }
}

fn filled(mut builder: GroupBuilder, group: &Group) -> FinishedGroup {
    for (name, item) in &group.items {
        match item {
            Item::Group(inner) => {
                let inner = filled(builder.create_group(name), inner);
                builder.add_group(inner);
            }
            item => fill(builder.create_dataset(name), item),
        }
    }
    for (name, attribute) in &group.attributes {
        builder.set_attr(name, attribute.written());
    }
    builder.finish()
}

fn fill(builder: &mut DatasetBuilder, item: &Item) {
    let shape = |axes: &[usize]| axes.iter().map(|&axis| axis as u64).collect::<Vec<_>>();
    match item {
        Item::Numbers(numbers) => {
            let axes = shape(&numbers.shape);
            match numbers.element {
                Element::F(4) => builder.with_f32_data(&numbers.reals().map(|x| x as f32).collect::<Vec<_>>()),
                Element::F(_) => builder.with_f64_data(&numbers.reals().collect::<Vec<_>>()),
                Element::U(1) => builder.with_u8_data(&numbers.bytes),
                _ => builder.with_i64_data(&numbers.reals().map(|x| x as i64).collect::<Vec<_>>()),
            }
            .with_shape(&axes);
        }
        Item::Texts(axes, texts) => {
            let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
            builder.with_vlen_strings(&texts).with_shape(&shape(axes));
        }
        // Neither is ever a data set of a tree that was made to be written.
        Item::Group(_) | Item::Other(_) => {}
    }
}
