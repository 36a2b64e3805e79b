//! Tensors of a PyTorch checkpoint, in both of its containers.
//!
//! Input: the bytes of a `.pt` file: a zip archive (torch 1.6 and later) or, from older versions,
//! five pickles, then raw numbers. Output: the names of its tensors, and single tensors. A tensor
//! of a dictionary within the checkpoint has that dictionary's key before its own, and a dot.
//! `super::pickle` reads the pickles and executes nothing: a checkpoint that pickles a whole module
//! is refused with the name of its class.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Cursor, Read};

use zip::ZipArchive;

use super::pickle::{self, Arena, PickleError, Value, ValueId};
use crate::kind::ZIP;
use nsim_files::budget::Budget;
use nsim_files::element::Element;
use nsim_ir::base::diagnostic::{Diagnostic, Result};

/// The deepest nesting of dictionaries that are searched for tensors.
const DEEPEST: usize = 4;
const MOST_TENSORS: usize = 1 << 14;
const MOST_FILES: usize = 1 << 16;

/// Help: how a network is read that its file does not hold as tensors.
const WAYS: &str = "save the weights of SLAYER or lava-dl, torch.save(net.state_dict(), \"weights.pt\"); a network of \
                    another tool is read in Python, nsim.from_torch(net, sample)";

/// The element type of a storage class.
fn element(class: &str) -> Option<Element> {
    Some(match class {
        "DoubleStorage" => Element::F(8),
        "FloatStorage" => Element::F(4),
        "HalfStorage" => Element::F(2),
        "BFloat16Storage" => Element::Bf16,
        "LongStorage" => Element::I(8),
        "IntStorage" => Element::I(4),
        "ShortStorage" => Element::I(2),
        "CharStorage" => Element::I(1),
        "ByteStorage" | "BoolStorage" => Element::U(1),
        _ => return None,
    })
}

/// A strided view of a storage, as the pickle describes a tensor.
#[derive(Debug, Clone)]
struct View {
    storage: String,
    element: Element,
    offset: usize,
    shape: Vec<usize>,
    strides: Vec<usize>,
}

enum Container {
    Zip(Box<ZipArchive<Cursor<Vec<u8>>>>, String, u64),
    /// Bytes of the file, and the range of each storage by key.
    Legacy(Vec<u8>, BTreeMap<String, std::ops::Range<usize>>),
}

/// A checkpoint whose tensors are read individually.
pub struct Checkpoint {
    container: Container,
    views: Vec<(String, View)>,
    dictionaries: Vec<String>,
}

fn wrong(message: impl Into<String>) -> Diagnostic {
    Diagnostic::new("import.torch", message)
}

fn pickle_diagnostic(error: &PickleError) -> Diagnostic {
    match error {
        PickleError::Class(class) => Diagnostic::new(
            "import.pickle",
            format!("this checkpoint pickles the class {class}, a whole module, and not only its weights"),
        )
        .help(format!("{WAYS}; nothing of the file was executed")),
        other => wrong(format!("the checkpoint cannot be read: {other}")),
    }
}

/// Opens a checkpoint.
///
/// # Errors
/// `import.pickle` for a pickled module, `import.torch` for a malformed checkpoint.
pub fn open(bytes: Vec<u8>) -> Result<Checkpoint> {
    let mut budget = Budget::for_file(bytes.len() as u64, MOST_TENSORS, DEEPEST);
    let checkpoint = if bytes.starts_with(ZIP) { open_zip(bytes) } else { open_legacy(bytes) }?;
    // Many tensors may be views of one storage, so the sum of their sizes counts.
    for (_, view) in &checkpoint.views {
        let count = view.shape.iter().fold(1u64, |product, &axis| product.saturating_mul(axis as u64));
        let taken = budget.item(0).and_then(|()| budget.numbers(count, view.element.bytes() as u64));
        taken.map_err(|exceeded| wrong(format!("the checkpoint is refused: {exceeded}")))?;
    }
    Ok(checkpoint)
}

fn open_zip(bytes: Vec<u8>) -> Result<Checkpoint> {
    let most = bytes.len() as u64;
    let mut archive =
        ZipArchive::new(Cursor::new(bytes)).map_err(|error| wrong(format!("the archive cannot be read: {error}")))?;
    if archive.len() > MOST_FILES {
        return Err(wrong(format!("the archive has {} files, more than {MOST_FILES}", archive.len())));
    }
    let pickle =
        archive.file_names().filter_map(Result::ok).find(|name| *name == "data.pkl" || name.ends_with("/data.pkl"));
    let Some(root) = pickle.map(|name| name.trim_end_matches("data.pkl").to_string()) else {
        return Err(wrong("the archive has no data.pkl, so it is not a checkpoint of PyTorch"));
    };
    if let Ok(order) = read_entry(&mut archive, most, &format!("{root}byteorder"))
        && order != b"little"
    {
        return Err(wrong("the checkpoint's numbers are big-endian").help("save it on a little-endian machine"));
    }
    let pickled = read_entry(&mut archive, most, &format!("{root}data.pkl"))?;
    let (arena, top, _) = pickle::load(&pickled).map_err(|error| pickle_diagnostic(&error))?;
    let views = views(&arena, top)?;
    let dictionaries = dictionaries(&arena, top, &views);
    Ok(Checkpoint { container: Container::Zip(Box::new(archive), root, most), views, dictionaries })
}

/// A file of an archive. PyTorch stores without compression, so no file is larger than the archive.
fn read_entry(archive: &mut ZipArchive<Cursor<Vec<u8>>>, most: u64, name: &str) -> Result<Vec<u8>> {
    let mut file = archive.by_name(name).map_err(|error| wrong(format!("'{name}' of the archive: {error}")))?;
    let mut bytes = Vec::new();
    if file.size() > most {
        return Err(wrong(format!("the length of '{name}' is {} bytes, the archive has {most}", file.size())));
    }
    file.read_to_end(&mut bytes).map_err(|error| wrong(format!("'{name}' of the archive: {error}")))?;
    Ok(bytes)
}

/// Reads the pickle at `at`, after which `at` is its end.
fn next_pickle(bytes: &[u8], at: &mut usize, what: &str) -> Result<(Arena, ValueId)> {
    let (arena, top, taken) = pickle::load(&bytes[*at..]).map_err(|error| match error {
        PickleError::Class(_) => pickle_diagnostic(&error),
        other => wrong(format!("{what} of the checkpoint cannot be read: {other}")),
    })?;
    *at += taken;
    Ok((arena, top))
}

fn open_legacy(bytes: Vec<u8>) -> Result<Checkpoint> {
    let mut at = 0;
    next_pickle(&bytes, &mut at, "the magic number")?;
    let (arena, version) = next_pickle(&bytes, &mut at, "the version")?;
    if arena.get(version) != &Value::Int(1001) {
        return Err(wrong("the checkpoint has an unknown version"));
    }
    let (arena, system) = next_pickle(&bytes, &mut at, "the machine")?;
    if entry(&arena, system, "little_endian") == Some(&Value::Bool(false)) {
        return Err(wrong("the checkpoint's numbers are big-endian").help("save it on a little-endian machine"));
    }
    let (arena, top) = next_pickle(&bytes, &mut at, "the tensors")?;
    let views = views(&arena, top)?;
    let dictionaries = dictionaries(&arena, top, &views);
    let (arena, keys) = next_pickle(&bytes, &mut at, "the list of storages")?;
    let Value::List(keys) = arena.get(keys) else { return Err(wrong("the list of storages is not a list")) };
    let elements: BTreeMap<&str, Element> =
        views.iter().map(|(_, view)| (view.storage.as_str(), view.element)).collect();
    let mut ranges = BTreeMap::new();
    for &key in keys {
        let Value::Text(key) = arena.get(key) else { return Err(wrong("a storage without a name")) };
        let Some(&element) = elements.get(key.as_str()) else {
            return Err(wrong(format!("no tensor uses storage '{key}'")));
        };
        let count = bytes.get(at..at + 8).and_then(|bytes| Some(i64::from_le_bytes(bytes.try_into().ok()?)));
        let count = count.and_then(|count| usize::try_from(count).ok());
        let end = count.and_then(|count| count.checked_mul(element.bytes())?.checked_add(at + 8));
        match end.filter(|&end| end <= bytes.len()) {
            Some(end) => {
                ranges.insert(key.clone(), at + 8..end);
                at = end;
            }
            None => return Err(wrong(format!("the file ends within storage '{key}'"))),
        }
    }
    Ok(Checkpoint { container: Container::Legacy(bytes, ranges), views, dictionaries })
}

fn entry<'a>(arena: &'a Arena, dict: ValueId, key: &str) -> Option<&'a Value> {
    let Value::Dict(pairs) = arena.get(dict) else { return None };
    let found = pairs.iter().find(|pair| matches!(arena.get(pair.0), Value::Text(text) if text == key))?;
    Some(arena.get(found.1))
}

/// All tensors of a dictionary and of nested ones, by dotted name.
fn views(arena: &Arena, top: ValueId) -> Result<Vec<(String, View)>> {
    let mut views = Vec::new();
    collect(arena, top, "", 0, &mut views)?;
    if views.is_empty() {
        return Err(wrong("the checkpoint holds no named tensors").help(WAYS));
    }
    Ok(views)
}

/// Keys of the dictionaries within a checkpoint that hold its tensors; none where the checkpoint
/// itself holds one.
fn dictionaries(arena: &Arena, top: ValueId, views: &[(String, View)]) -> Vec<String> {
    let Value::Dict(pairs) = arena.get(top) else { return Vec::new() };
    let within: BTreeSet<&str> = pairs
        .iter()
        .filter_map(|&(key, value)| match (arena.get(key), arena.get(value)) {
            (Value::Text(key), Value::Dict(_)) => Some(key.as_str()),
            _ => None,
        })
        .collect();
    let mut holders = BTreeSet::new();
    for (name, _) in views {
        // Keys may have dots themselves.
        match name.match_indices('.').map(|(end, _)| &name[..end]).find(|&key| within.contains(key)) {
            Some(key) => holders.insert(key),
            None => return Vec::new(),
        };
    }
    holders.into_iter().map(str::to_string).collect()
}

fn collect(arena: &Arena, id: ValueId, name: &str, depth: usize, views: &mut Vec<(String, View)>) -> Result<()> {
    match arena.get(id) {
        Value::Dict(pairs) if depth < DEEPEST => {
            for &(key, value) in pairs {
                let key = match arena.get(key) {
                    Value::Text(key) => key.clone(),
                    Value::Int(key) => key.to_string(),
                    _ => continue,
                };
                let inner = if name.is_empty() { key } else { format!("{name}.{key}") };
                collect(arena, value, &inner, depth + 1, views)?;
            }
        }
        Value::Call(function, arguments) if function == "_rebuild_parameter" => {
            // The first argument is the tensor; the depth excludes a parameter of a parameter.
            if let Some(&tensor) = arguments.first().filter(|_| depth <= DEEPEST) {
                collect(arena, tensor, name, DEEPEST + 1, views)?;
            }
        }
        Value::Call(function, arguments) if function.starts_with("_rebuild_tensor") => {
            if views.len() == MOST_TENSORS || name.len() > 1024 {
                return Err(wrong(format!(
                    "the checkpoint has more than {MOST_TENSORS} tensors, or a name of a kilobyte"
                )));
            }
            views.push((name.to_string(), view(arena, arguments, name)?));
        }
        _ => {}
    }
    Ok(())
}

/// Parses the arguments of `_rebuild_tensor_v2(storage, offset, size, stride, ..)`.
fn view(arena: &Arena, arguments: &[ValueId], name: &str) -> Result<View> {
    let bad = |what: &str| wrong_tensor(name, what);
    let &[storage, offset, shape, strides, ..] = arguments else { return Err(bad("it lacks arguments")) };
    let Value::Persistent(id) = arena.get(storage) else { return Err(bad("it has no storage")) };
    let Value::Tuple(parts) = arena.get(*id) else { return Err(bad("the description of its storage is invalid")) };
    let (Some(&word), Some(&class), Some(&key)) = (parts.first(), parts.get(1), parts.get(2)) else {
        return Err(bad("the description of its storage is invalid"));
    };
    let is_storage = matches!(arena.get(word), Value::Text(word) if word == "storage");
    let (Value::Name(_, class), Value::Text(key), true) = (arena.get(class), arena.get(key), is_storage) else {
        return Err(bad("the description of its storage is invalid"));
    };
    if parts.get(5).is_some_and(|&view| arena.get(view) != &Value::None) {
        return Err(bad("its storage is a view of another").help("save it again with a later PyTorch"));
    }
    let element = element(class).ok_or_else(|| bad(&format!("numbers of type {class} are not supported")))?;
    let offset = whole(arena, offset, name)?;
    let (shape, strides) = (whole_numbers(arena, shape, name)?, whole_numbers(arena, strides, name)?);
    let view = View { storage: key.clone(), element, offset, shape, strides };
    if view.shape.len() != view.strides.len() {
        return Err(bad("its shape and strides differ in length"));
    }
    Ok(view)
}

fn wrong_tensor(name: &str, what: &str) -> Diagnostic {
    wrong(format!("tensor '{name}': {what}"))
}

fn whole(arena: &Arena, id: ValueId, name: &str) -> Result<usize> {
    match arena.get(id) {
        Value::Int(x) => usize::try_from(*x).map_err(|_| wrong_tensor(name, "a negative number")),
        _ => Err(wrong_tensor(name, "an invalid number")),
    }
}

fn whole_numbers(arena: &Arena, id: ValueId, name: &str) -> Result<Vec<usize>> {
    match arena.get(id) {
        Value::Tuple(items) | Value::List(items) if items.len() <= 8 => {
            items.iter().map(|&item| whole(arena, item, name)).collect()
        }
        _ => Err(wrong_tensor(name, "a shape that is not a list, or has more than 8 axes")),
    }
}

impl Checkpoint {
    /// Names and shapes of the tensors, in the order of the file.
    pub fn entries(&self) -> impl Iterator<Item = (&str, &[usize])> {
        self.views.iter().map(|(name, view)| (name.as_str(), view.shape.as_slice()))
    }

    /// Keys of the dictionaries within the checkpoint that hold its tensors, sorted; none where the
    /// checkpoint itself holds one.
    pub fn dictionaries(&self) -> &[String] {
        &self.dictionaries
    }

    /// The type of a tensor's numbers as NumPy writes it, or `bf16`.
    pub fn dtype(&self, name: &str) -> Option<String> {
        let (_, view) = self.views.iter().find(|(key, _)| key == name)?;
        Some(view.element.dtype())
    }

    /// The numbers of a tensor in C order.
    ///
    /// # Errors
    /// `import.torch` when there is no such tensor, or its storage is too small.
    pub fn tensor(&mut self, name: &str) -> Result<Vec<f64>> {
        let Some((_, view)) = self.views.iter().find(|(key, _)| key == name) else {
            return Err(wrong(format!("there is no tensor '{name}'")));
        };
        match &mut self.container {
            Container::Zip(archive, root, most) => {
                let bytes = read_entry(archive, *most, &format!("{root}data/{}", view.storage))?;
                numbers(&bytes, view, name)
            }
            Container::Legacy(bytes, ranges) => match ranges.get(&view.storage) {
                Some(range) => numbers(&bytes[range.clone()], view, name),
                None => Err(wrong_tensor(name, &format!("storage '{}' is missing", view.storage))),
            },
        }
    }
}

fn numbers(bytes: &[u8], view: &View, name: &str) -> Result<Vec<f64>> {
    let size = view.element.bytes();
    let there = bytes.len() / size;
    let count = view.shape.iter().try_fold(1usize, |product, &axis| product.checked_mul(axis));
    let Some(count) = count.filter(|&count| count <= there) else {
        return Err(wrong_tensor(name, &format!("shape {:?} of a storage of {there} numbers", view.shape)));
    };
    if count == 0 {
        return Ok(Vec::new());
    }
    let span = view
        .shape
        .iter()
        .zip(&view.strides)
        .try_fold(view.offset, |end, (&axis, &stride)| end.checked_add(stride.checked_mul(axis.checked_sub(1)?)?));
    if span.is_none_or(|last| last >= there) {
        return Err(wrong_tensor(name, &format!("strides {:?} leave its storage of {there} numbers", view.strides)));
    }
    let mut index = vec![0usize; view.shape.len()];
    let mut reals = Vec::with_capacity(count);
    for _ in 0..count {
        let at = view.offset + index.iter().zip(&view.strides).map(|(i, stride)| i * stride).sum::<usize>();
        let real = view.element.number(&bytes[at * size..(at + 1) * size], false).real();
        if !real.is_finite() {
            return Err(wrong_tensor(name, &format!("the number at {index:?} is {real}")));
        }
        reals.push(real);
        for (place, &axis) in index.iter_mut().zip(&view.shape).rev() {
            *place += 1;
            if *place < axis {
                break;
            }
            *place = 0;
        }
    }
    Ok(reals)
}
