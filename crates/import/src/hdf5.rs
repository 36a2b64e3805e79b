//! HDF5 files as a tree in memory: the only module that uses an HDF5 crate.
//!
//! Input: the bytes of a file, or a tree. Output: a [`Group`] with all groups and data sets below
//! it, or the bytes of a file. Numbers are stored in the bytes of their own type, little-endian.
//!
//! A file is not trusted: objects, depth, texts and decoded bytes are counted and bounded
//! (`Budget`). Links that name a path are refused (`hdf5_links`), and errors of the crate become
//! diagnostics. Only NIR's data files use attributes. Compound types, references and numbers of
//! unusual layouts become [`Item::Other`].

use std::collections::BTreeMap;
use std::path::Path;

use hdf5_pure::{
    AttrValue, ChunkCacheConfig, Dataset, DatasetBuilder, Datatype, DatatypeByteOrder, File, FileAccessProperties,
    FileBuilder, FinishedGroup, FixedPointLayout, FloatingPointLayout, GroupBuilder, VlenStringReadOptions,
};

use nsim_files::budget::{Budget, Exceeded, MOST_ARRAY};
use nsim_files::element::Element;
use nsim_files::text::{is_standard_stream, read_bytes};
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The first bytes of every HDF5 file (HDF5 file format specification 3.0, II.A).
pub const MAGIC: &[u8] = b"\x89HDF\r\n\x1a\n";
/// The most groups and data sets of a file.
const MOST_OBJECTS: usize = 1 << 16;
/// The deepest nesting of groups.
const DEEPEST: usize = 16;
const MOST_AXES: usize = 8;
/// The most strings of a data set.
const MOST_STRINGS: u64 = 1 << 16;

/// Command that copies FILE to NEW: links become copies of their targets, and arrays get h5py's
/// default layout.
const REWRITE_COMMAND: &str = "python3 -c \"import h5py; copy = lambda old, new: [copy(old[k], new.create_group(k)) if \
                         hasattr(old[k], 'keys') else new.create_dataset(k, data=old[k][()]) for k in old]; \
                         copy(h5py.File('FILE'), h5py.File('NEW', 'w'))\"";

/// Reals of 16 bits: IEEE 754's half precision, and bfloat16.
const BINARY16: FloatingPointLayout = FloatingPointLayout {
    bit_offset: 0,
    bit_precision: 16,
    exponent_location: 10,
    exponent_size: 5,
    mantissa_location: 0,
    mantissa_size: 10,
    exponent_bias: 15,
};
const BFLOAT16: FloatingPointLayout =
    FloatingPointLayout { exponent_location: 7, exponent_size: 8, mantissa_size: 7, exponent_bias: 127, ..BINARY16 };

/// A group of an HDF5 file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Group {
    /// Its members by name.
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
    /// A member of a type that is not read: the name of the type.
    Other(String),
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
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Number of elements.
    pub fn len(&self) -> usize {
        self.bytes.len() / self.element.bytes()
    }

    /// Whether there are no elements.
    pub fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// Whether they are integers.
    pub fn is_integer(&self) -> bool {
        !self.element.is_real()
    }

    /// The type of an element as NumPy writes it: kind and bytes.
    pub fn dtype(&self) -> String {
        self.element.dtype()
    }

    /// Reals of 64 bits.
    ///
    /// # Panics
    /// When the numbers do not fill the shape, an error of the caller, as for the other
    /// constructors.
    pub fn f64(shape: &[usize], reals: &[f64]) -> Numbers {
        Numbers::from_bytes(shape, Element::F(8), reals.iter().flat_map(|x| x.to_le_bytes()).collect())
    }

    /// Reals of 32 bits.
    pub fn f32(shape: &[usize], reals: &[f32]) -> Numbers {
        Numbers::from_bytes(shape, Element::F(4), reals.iter().flat_map(|x| x.to_le_bytes()).collect())
    }

    /// Integers of 64 bits.
    pub fn i64(shape: &[usize], integers: &[i64]) -> Numbers {
        Numbers::from_bytes(shape, Element::I(8), integers.iter().flat_map(|x| x.to_le_bytes()).collect())
    }

    fn from_bytes(shape: &[usize], element: Element, bytes: Vec<u8>) -> Numbers {
        let numbers = Numbers { shape: shape.to_vec(), element, bytes };
        assert_eq!(numbers.len(), shape.iter().product::<usize>(), "the numbers fill the shape");
        numbers
    }

    /// Each number as a real. Integers beyond 2^53 are rounded.
    pub fn reals(&self) -> impl Iterator<Item = f64> + '_ {
        self.bytes.chunks_exact(self.element.bytes()).map(|bytes| self.element.number(bytes, false).real())
    }
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
    /// The group with `item` added.
    #[must_use]
    pub fn with(mut self, name: &str, item: impl Into<Item>) -> Self {
        self.insert(name, item);
        self
    }

    /// Adds a member.
    pub fn insert(&mut self, name: &str, item: impl Into<Item>) {
        self.items.insert(name.to_string(), item.into());
    }

    /// A member by its path.
    pub fn get(&self, path: &str) -> Option<&Item> {
        match path.split_once('/') {
            Some((first, rest)) => self.group(first)?.get(rest),
            None => self.items.get(path),
        }
    }

    /// A group among the members.
    pub fn group(&self, path: &str) -> Option<&Group> {
        match self.get(path)? {
            Item::Group(group) => Some(group),
            _ => None,
        }
    }

    /// An array among the members.
    pub fn numbers(&self, path: &str) -> Option<&Numbers> {
        match self.get(path)? {
            Item::Numbers(numbers) => Some(numbers),
            _ => None,
        }
    }

    /// The number of a member that is a scalar or an array of one element.
    pub fn number(&self, path: &str) -> Option<f64> {
        let numbers = self.numbers(path)?;
        (numbers.len() == 1).then(|| numbers.reals().next())?
    }

    /// The path and type of the first member of a type that is not read.
    pub fn first_unsupported(&self) -> Option<(String, &str)> {
        self.items.iter().find_map(|(name, item)| match item {
            Item::Other(what) => Some((name.clone(), what.as_str())),
            Item::Group(group) => group.first_unsupported().map(|(path, what)| (format!("{name}/{path}"), what)),
            Item::Numbers(_) | Item::Texts(..) => None,
        })
    }

    /// The text of a member that is a single text.
    pub fn text(&self, path: &str) -> Option<&str> {
        match self.get(path)? {
            Item::Texts(_, texts) if texts.len() == 1 => Some(&texts[0]),
            _ => None,
        }
    }
}

/// The remaining budget of a file that is being read.
struct ReadBudget<'a> {
    path: &'a Path,
    budget: Budget,
}

impl ReadBudget<'_> {
    /// Subtracts a claim from the budget.
    fn take(&mut self, claim: impl FnOnce(&mut Budget) -> Result<(), Exceeded>) -> Result<()> {
        claim(&mut self.budget)
            .map_err(|exceeded| Diagnostic::new("hdf5.too-large", exceeded.to_string()).in_file(self.path))
    }

    fn wrong(&self, what: &dyn std::fmt::Display) -> Diagnostic {
        let what: String = what.to_string().chars().take(300).collect();
        let layout = ["data layout", "chunk index", "external files", "filter"].iter().any(|part| what.contains(part));
        let mut problem = Diagnostic::new("hdf5.format", format!("the HDF5 file cannot be read: {what}"));
        if layout {
            problem =
                problem.help(format!("h5py writes its arrays in the oldest layout, which is read: {REWRITE_COMMAND}"));
        }
        problem.in_file(self.path)
    }
}

/// The bytes of a file of another tool. A recording of events is reported as such even when it is
/// too large.
///
/// # Errors
/// As [`read_bytes`]; `hdf5.events`.
pub fn read_foreign_file(path: &Path) -> Result<Vec<u8>> {
    read_bytes(path, MOST_ARRAY).map_err(|problem| {
        let large = problem.code == "io.too-large" && !is_standard_stream(path);
        let file = if large { File::open_streaming(path).ok() } else { None };
        let events = file.and_then(|file| refuse_events(&file.root()).err());
        events.map_or(problem, |events| events.in_file(path))
    })
}

/// Reads a whole file.
///
/// # Errors
/// `hdf5.format`, `hdf5.link`, `hdf5.too-large`.
pub fn tree(path: &Path, bytes: Vec<u8>) -> Result<Group> {
    let mut budget = ReadBudget { path, budget: Budget::for_file(bytes.len() as u64, MOST_OBJECTS, DEEPEST) };
    if let Some(link) = super::hdf5_links::find(&bytes) {
        return Err(Diagnostic::new("hdf5.link", format!("the HDF5 file has links that are not followed: {link}"))
            .help(format!("write their targets in their place: {REWRITE_COMMAND}"))
            .in_file(path));
    }
    let options = FileAccessProperties::new().with_chunk_cache(ChunkCacheConfig::disabled());
    let file = File::from_bytes_with_options(bytes, options).map_err(|error| budget.wrong(&error))?;
    refuse_events(&file.root()).map_err(|problem| problem.in_file(path))?;
    group(&file.root(), &mut budget, 0)
}

/// Whether a group of a file has these data sets.
fn has(root: &hdf5_pure::Group, group: &str, members: &[&str]) -> bool {
    let group = root.iter_groups().ok().and_then(|mut groups| groups.find(|(name, _)| name == group));
    let datasets = group.and_then(|(_, group)| group.datasets().ok()).unwrap_or_default();
    members.iter().all(|member| datasets.iter().any(|name| name == member))
}

/// Refuses recordings of events by the names of their groups, before decoding: they are large and
/// compressed by special filters.
fn refuse_events(root: &hdf5_pure::Group) -> Result<()> {
    let (what, help) = match () {
        () if has(root, "CD", &["events"]) => (
            "Metavision's recording of events (CD/events)",
            "convert it with Metavision's tools: metavision_file_to_dat -i FILE",
        ),
        () if has(root, "events", &["x", "y", "t", "p"]) => (
            "a recording of events in the layout of DSEC (events/x, y, t, p)",
            "write its events as rows of text with the header t_us,x,y,p",
        ),
        () => return Ok(()),
    };
    Err(Diagnostic::new("hdf5.events", format!("this HDF5 file is {what}, which is not read")).help(help))
}

fn group(group: &hdf5_pure::Group, budget: &mut ReadBudget<'_>, depth: usize) -> Result<Group> {
    budget.take(|budget| budget.item(depth))?;
    let mut items = BTreeMap::new();
    for (name, child) in group.iter_groups().map_err(|error| budget.wrong(&error))? {
        items.insert(name, Item::Group(self::group(&child, budget, depth + 1)?));
    }
    for (name, dataset) in group.iter_datasets().map_err(|error| budget.wrong(&error))? {
        budget.take(|budget| budget.item(depth))?;
        let item = self::dataset(&name, &dataset, budget)?;
        items.insert(name, item);
    }
    let attributes = group.attrs().unwrap_or_default();
    let attributes = attributes.into_iter().filter_map(|(name, value)| Some((name, Attribute::from_value(&value)?)));
    Ok(Group { items, attributes: attributes.collect() })
}

/// The type of an element and whether it is big-endian; `None` for types that are not read as
/// numbers.
fn element(datatype: &Datatype) -> Option<(Element, bool)> {
    let (element, order) = match datatype {
        Datatype::FixedPoint { size: size @ (1 | 2 | 4 | 8), byte_order, layout } => {
            let (size, bits) = (*size as u8, 8 * *size as u16);
            match layout {
                FixedPointLayout { bit_offset: 0, bit_precision, signed } if *bit_precision == bits => {
                    (if *signed { Element::I(size) } else { Element::U(size) }, byte_order)
                }
                _ => return None,
            }
        }
        Datatype::FloatingPoint { size, byte_order, layout } => match (size, layout) {
            (2, &BINARY16) => (Element::F(2), byte_order),
            (2, &BFLOAT16) => (Element::Bf16, byte_order),
            (4, &FloatingPointLayout::IEEE754_BINARY32) => (Element::F(4), byte_order),
            (8, &FloatingPointLayout::IEEE754_BINARY64) => (Element::F(8), byte_order),
            _ => return None,
        },
        // h5py writes bool as an enumeration of an 8-bit integer.
        Datatype::Enumeration { base_type, .. } => return element(base_type),
        _ => return None,
    };
    match order {
        DatatypeByteOrder::LittleEndian => Some((element, false)),
        DatatypeByteOrder::BigEndian => Some((element, true)),
        DatatypeByteOrder::Vax => None,
    }
}

fn dataset(name: &str, dataset: &Dataset, budget: &mut ReadBudget<'_>) -> Result<Item> {
    let wrong = |budget: &ReadBudget<'_>, error: &dyn std::fmt::Display| budget.wrong(&format!("{name}: {error}"));
    let axes = dataset.shape().map_err(|error| wrong(budget, &error))?;
    if axes.len() > MOST_AXES {
        return Err(wrong(budget, &format!("an array of {} axes", axes.len())));
    }
    fn product(axes: &[u64]) -> Option<u64> {
        axes.iter().try_fold(1u64, |product, &axis| product.checked_mul(axis))
    }
    let length = product(&axes);
    let datatype = dataset.datatype().map_err(|error| wrong(budget, &error))?;
    // A chunk is decoded whole, even where the shape uses little of it.
    let chunk = dataset.chunk_shape().map_err(|error| wrong(budget, &error))?;
    let decoded = length.max(chunk.map_or(Some(0), |chunk| product(&chunk)));
    let width = dataset.element_size().map_err(|error| wrong(budget, &error))?;
    let size = decoded.filter(|_| length.is_some()).and_then(|decoded| decoded.checked_mul(width)).unwrap_or(u64::MAX);
    // `decoded` bounds the axes, unless the array is empty.
    let shape: Vec<usize> = axes.iter().map(|&axis| usize::try_from(axis).unwrap_or(usize::MAX)).collect();
    if let Some((element, is_big)) = element(&datatype) {
        budget.take(|budget| budget.numbers(size / width.max(1), width))?;
        let mut bytes = dataset.read_raw().map_err(|error| wrong(budget, &error))?;
        if is_big {
            bytes.chunks_exact_mut(width as usize).for_each(<[u8]>::reverse);
        }
        let numbers = Numbers { shape, element, bytes };
        if length != Some(numbers.len() as u64) || !numbers.bytes.len().is_multiple_of(numbers.element.bytes()) {
            return Err(wrong(budget, &"its bytes do not fill its shape"));
        }
        return Ok(Item::Numbers(numbers));
    }
    let variable = match datatype {
        Datatype::String { .. } => false,
        Datatype::VariableLength { is_string: true, .. } => true,
        other => {
            let mut name = format!("{other:?}");
            name.truncate(name.find([' ', '{']).unwrap_or(40).min(40));
            return Ok(Item::Other(name));
        }
    };
    if length.is_none_or(|length| length > MOST_STRINGS) {
        return Err(wrong(budget, &format!("more than {MOST_STRINGS} texts")));
    }
    budget.take(|budget| budget.bytes(size))?;
    if variable {
        // Many references may name one long text, so the sum of their lengths counts.
        let payload = dataset.vlen_string_payload_size().map_err(|error| wrong(budget, &error))?;
        budget.take(|budget| budget.bytes(payload))?;
    }
    let texts = if variable { dataset.read_vlen_strings(VlenStringReadOptions::new()) } else { dataset.read_string() };
    let mut texts = texts.map_err(|error| wrong(budget, &error))?;
    for text in &mut texts {
        text.truncate(text.find('\0').unwrap_or(text.len()));
    }
    if Some(texts.len() as u64) != length {
        return Err(wrong(budget, &"its texts do not fill its shape"));
    }
    Ok(Item::Texts(shape, texts))
}

/// The bytes of a file with this tree. Attributes are written for groups only, as they are read.
///
/// # Errors
/// `hdf5.write` for a tree that the format cannot represent.
pub fn write(root: &Group) -> Result<Vec<u8>> {
    let mut file = FileBuilder::new();
    for (name, item) in &root.items {
        match item {
            Item::Group(group) => {
                let builder = file.create_group(name);
                file.add_group(build_group(builder, group));
            }
            item => build_dataset(file.create_dataset(name), item),
        }
    }
    for (name, attribute) in &root.attributes {
        file.set_attr(name, attribute.to_value());
    }
    file.finish().map_err(|error| Diagnostic::new("hdf5.write", format!("the HDF5 file cannot be written: {error}")))
}

impl Attribute {
    /// The attribute, if it is one number or one text.
    fn from_value(value: &AttrValue) -> Option<Attribute> {
        let number =
            value.as_f64().or_else(|| value.as_i64().map(|x| x as f64)).or_else(|| value.as_u64().map(|x| x as f64));
        number.map(Attribute::Number).or_else(|| Some(Attribute::Text(value.as_str()?.to_string())))
    }

    fn to_value(&self) -> AttrValue {
        match self {
            Attribute::Number(x) => AttrValue::F64(*x),
            Attribute::Text(text) => AttrValue::String(text.clone()),
        }
    }
}

fn build_group(mut builder: GroupBuilder, group: &Group) -> FinishedGroup {
    for (name, item) in &group.items {
        match item {
            Item::Group(inner) => {
                let inner = build_group(builder.create_group(name), inner);
                builder.add_group(inner);
            }
            item => build_dataset(builder.create_dataset(name), item),
        }
    }
    for (name, attribute) in &group.attributes {
        builder.set_attr(name, attribute.to_value());
    }
    builder.finish()
}

fn build_dataset(builder: &mut DatasetBuilder, item: &Item) {
    match item {
        Item::Numbers(numbers) => {
            let axes: Vec<u64> = numbers.shape.iter().map(|&axis| axis as u64).collect();
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
            let axes: Vec<u64> = axes.iter().map(|&axis| axis as u64).collect();
            builder.with_vlen_strings(&texts).with_shape(&axes);
        }
        // Callers pass groups elsewhere, and trees that are written have no `Other`.
        Item::Group(_) | Item::Other(_) => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_read_is_found_at_any_depth() {
        let inner = Group {
            items: BTreeMap::from([("w".to_string(), Item::Other("Compound".to_string()))]),
            ..Group::default()
        };
        let root = Group::default().with("a", Numbers::i64(&[1], &[1])).with("nodes", inner);
        assert_eq!(root.first_unsupported(), Some(("nodes/w".to_string(), "Compound")));
    }
}
