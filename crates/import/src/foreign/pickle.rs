//! A restricted reader of pickles: data only.
//!
//! Input: the bytes of a pickle of protocol 0 to 5. Output: its values in an [`Arena`], with
//! references by index. Nothing is called or imported: a name such as
//! `torch._utils._rebuild_tensor_v2` stays a name. A call of a known name becomes a value, a call
//! of any other is an error with that name (opcodes: CPython `Lib/pickletools.py`). The numbers of
//! values, of stack entries and of memo entries are limited.
//!
//! `serde-pickle` 1.2 reads neither persistent ids, by which a checkpoint refers to its storages,
//! nor calls of functions other than a few built-in ones.

use std::collections::HashMap;

/// The most values, stack entries and entries of lists of a pickle.
const MOST_VALUES: usize = 1 << 20;
/// The error of a line that is not a number.
const NO_NUMBER: &str = "an invalid number";

/// Index of a value in the arena.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct ValueId(u32);

/// A value.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    None,
    Bool(bool),
    /// An integer of at most 64 bits.
    Int(i64),
    /// A longer integer, little-endian.
    Long(Vec<u8>),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
    Tuple(Vec<ValueId>),
    /// A list or a set.
    List(Vec<ValueId>),
    /// A dictionary, in insertion order.
    Dict(Vec<(ValueId, ValueId)>),
    /// The name of a class or function: module and name.
    Name(String, String),
    /// The value of a persistent id.
    Persistent(ValueId),
    /// A call of a known name: the name's last part and its arguments.
    Call(String, Vec<ValueId>),
}

/// A reason for which a pickle is refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum PickleError {
    /// It creates an object of a class or calls an unknown function.
    #[error("it pickles {0}")]
    Class(String),
    /// It ends early or contradicts itself.
    #[error("{0} at byte {1}")]
    Malformed(&'static str, usize),
    /// It exceeds the number of values.
    #[error("it has more than {MOST_VALUES} values")]
    TooLarge,
}

/// The values of a pickle.
#[derive(Debug, Clone)]
pub struct Arena {
    values: Vec<Value>,
}

impl Arena {
    pub fn get(&self, id: ValueId) -> &Value {
        &self.values[id.0 as usize]
    }
}

/// Whether calls of a name become values.
fn known(module: &str, name: &str) -> bool {
    matches!(
        (module, name),
        ("collections", "OrderedDict")
            | ("torch._utils", "_rebuild_tensor_v2" | "_rebuild_tensor" | "_rebuild_parameter")
            | ("torch", "Size")
            | ("_codecs", "encode")
    )
}

#[derive(Default)]
struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    values: Vec<Value>,
    stack: Vec<ValueId>,
    /// Stack heights at the open marks.
    marks: Vec<usize>,
    memo: HashMap<u32, ValueId>,
    entries: usize,
}

type Result<T> = std::result::Result<T, PickleError>;

/// Reads the pickle at the start of `bytes`: its values, the id of the result, and its length in
/// bytes.
pub fn load(bytes: &[u8]) -> Result<(Arena, ValueId, usize)> {
    let mut machine = Machine { bytes, ..Machine::default() };
    while !machine.step()? {}
    let top = machine.pop()?;
    Ok((Arena { values: machine.values }, top, machine.at))
}

impl<'a> Machine<'a> {
    fn wrong<T>(&self, what: &'static str) -> Result<T> {
        Err(PickleError::Malformed(what, self.at))
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.bytes.get(self.at..).and_then(|rest| rest.get(..count)) {
            Some(taken) => {
                self.at += count;
                Ok(taken)
            }
            None => self.wrong("it ends within a value"),
        }
    }

    fn fixed<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    /// A size that is stored in `width` bytes.
    fn size(&mut self, width: usize) -> Result<usize> {
        let mut size = [0; 8];
        size[..width].copy_from_slice(self.take(width)?);
        usize::try_from(u64::from_le_bytes(size)).or_else(|_| self.wrong("a size beyond all memory"))
    }

    fn line(&mut self) -> Result<&'a str> {
        let rest = &self.bytes[self.at..];
        let Some(end) = rest.iter().position(|&byte| byte == b'\n') else { return self.wrong("a line without end") };
        self.at += end + 1;
        match std::str::from_utf8(&rest[..end]) {
            Ok(line) => Ok(line.trim_end_matches('\r')),
            Err(_) => self.wrong("a line that is not text"),
        }
    }

    fn push(&mut self, value: Value) -> Result<()> {
        if self.values.len() >= MOST_VALUES {
            return Err(PickleError::TooLarge);
        }
        let id = ValueId(self.values.len() as u32);
        self.values.push(value);
        self.put(id)
    }

    fn put(&mut self, id: ValueId) -> Result<()> {
        if self.stack.len() >= MOST_VALUES {
            return Err(PickleError::TooLarge);
        }
        self.stack.push(id);
        Ok(())
    }

    fn pop(&mut self) -> Result<ValueId> {
        let floor = self.marks.last().copied().unwrap_or(0);
        let above = (self.stack.len() > floor).then(|| self.stack.pop()).flatten();
        above.map_or_else(|| self.wrong("a value is missing"), Ok)
    }

    fn top(&self) -> Result<ValueId> {
        self.stack.last().copied().map_or_else(|| self.wrong("a value is missing"), Ok)
    }

    fn value(&self, id: ValueId) -> &Value {
        &self.values[id.0 as usize]
    }

    /// Removes the last mark and the values above it, and returns these.
    fn marked(&mut self) -> Result<Vec<ValueId>> {
        match self.marks.pop() {
            Some(height) if height <= self.stack.len() => Ok(self.stack.split_off(height)),
            _ => self.wrong("a mark is missing"),
        }
    }

    /// Removes and returns the last values of the stack, the lowest first.
    fn last(&mut self, count: u8) -> Result<Vec<ValueId>> {
        let mut items = (0..count).map(|_| self.pop()).collect::<Result<Vec<_>>>()?;
        items.reverse();
        Ok(items)
    }

    fn grow(&mut self, entries: usize) -> Result<()> {
        self.entries += entries;
        if self.entries > MOST_VALUES { Err(PickleError::TooLarge) } else { Ok(()) }
    }

    fn append(&mut self, items: Vec<ValueId>) -> Result<()> {
        self.grow(items.len())?;
        let list = self.top()?;
        match &mut self.values[list.0 as usize] {
            Value::List(list) => list.extend(items),
            _ => return self.wrong("a list is missing"),
        }
        Ok(())
    }

    fn set(&mut self, items: &[ValueId]) -> Result<()> {
        self.grow(items.len())?;
        let dict = self.top()?;
        let pairs = items.chunks_exact(2).map(|pair| (pair[0], pair[1]));
        match &mut self.values[dict.0 as usize] {
            Value::Dict(dict) if items.len().is_multiple_of(2) => dict.extend(pairs),
            _ => return self.wrong("a dictionary is missing"),
        }
        Ok(())
    }

    fn memoise(&mut self, key: u32) -> Result<()> {
        let id = self.top()?;
        if self.memo.len() >= MOST_VALUES {
            return Err(PickleError::TooLarge);
        }
        self.memo.insert(key, id);
        Ok(())
    }

    fn recall(&mut self, key: u32) -> Result<()> {
        match self.memo.get(&key) {
            Some(&id) => self.put(id),
            None => self.wrong("a value that was not stored"),
        }
    }

    fn reduce(&mut self) -> Result<()> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let Value::Name(module, name) = self.value(function) else {
            return self.wrong("a call of an object without a name");
        };
        if !known(module, name) {
            return Err(PickleError::Class(format!("{module}.{name}")));
        }
        let Value::Tuple(arguments) = self.value(arguments) else {
            return self.wrong("a call without arguments");
        };
        let (name, arguments) = (name.clone(), arguments.clone());
        self.grow(arguments.len())?;
        match name.as_str() {
            // Old Pythons pass the pairs as an argument in protocols 0 and 1.
            "OrderedDict" => {
                let mut pairs = Vec::new();
                if let Some(Value::List(list)) = arguments.first().map(|&id| self.value(id)) {
                    for &pair in list {
                        match self.value(pair) {
                            Value::Tuple(pair) | Value::List(pair) if pair.len() == 2 => pairs.push((pair[0], pair[1])),
                            _ => return self.wrong("an entry that is not a pair"),
                        }
                    }
                }
                self.grow(pairs.len())?;
                self.push(Value::Dict(pairs))
            }
            "Size" => match arguments.first() {
                Some(&size) => self.put(size),
                None => self.wrong("a size without numbers"),
            },
            _ => self.push(Value::Call(name, arguments)),
        }
    }

    /// Executes an opcode; returns whether it was the last.
    fn step(&mut self) -> Result<bool> {
        let [opcode] = self.fixed()?;
        match self.literal(opcode)? {
            Some(value) => self.push(value)?,
            None if opcode == b'.' => return Ok(true),
            None => self.operate(opcode)?,
        }
        Ok(false)
    }

    /// The value of an opcode that pushes one; `None` for others.
    fn literal(&mut self, opcode: u8) -> Result<Option<Value>> {
        Ok(Some(match opcode {
            b'N' => Value::None,
            0x88 => Value::Bool(true),
            0x89 => Value::Bool(false),
            b'K' => Value::Int(u8::from_le_bytes(self.fixed()?).into()),
            b'M' => Value::Int(u16::from_le_bytes(self.fixed()?).into()),
            b'J' => Value::Int(i32::from_le_bytes(self.fixed()?).into()),
            b'I' | b'L' => match (opcode, self.line()?) {
                (b'I', "00") => Value::Bool(false),
                (b'I', "01") => Value::Bool(true),
                (_, line) => Value::Int(line.trim_end_matches('L').parse().or_else(|_| self.wrong(NO_NUMBER))?),
            },
            0x8a | 0x8b => {
                let size = self.size(if opcode == 0x8a { 1 } else { 4 })?;
                let bytes = self.take(size)?;
                if size <= 8 {
                    let negative = bytes.last().is_some_and(|byte| byte & 0x80 != 0);
                    let mut wide = [if negative { 0xff } else { 0 }; 8];
                    wide[..size].copy_from_slice(bytes);
                    Value::Int(i64::from_le_bytes(wide))
                } else {
                    Value::Long(bytes.to_vec())
                }
            }
            b'G' => Value::Float(f64::from_be_bytes(self.fixed()?)),
            b'F' => Value::Float(self.line()?.parse().or_else(|_| self.wrong(NO_NUMBER))?),
            b'V' | b'S' => Value::Text(self.line()?.trim_matches(['\'', '"']).to_string()),
            b'X' | b'T' | 0x8c | b'U' | 0x8d | b'B' | b'C' | 0x8e | 0x96 => {
                let size = self.size(match opcode {
                    0x8c | b'U' | b'C' => 1,
                    b'X' | b'T' | b'B' => 4,
                    _ => 8,
                })?;
                let bytes = self.take(size)?;
                match opcode {
                    b'B' | b'C' | 0x8e | 0x96 => Value::Bytes(bytes.to_vec()),
                    _ => Value::Text(String::from_utf8_lossy(bytes).into_owned()),
                }
            }
            b']' | 0x8f => Value::List(Vec::new()),
            b'}' => Value::Dict(Vec::new()),
            b')' => Value::Tuple(Vec::new()),
            b'c' => Value::Name(self.line()?.to_string(), self.line()?.to_string()),
            _ => return Ok(None),
        }))
    }

    /// Executes an opcode that makes or fills a tuple, a list, a set or a dictionary.
    fn fill(&mut self, opcode: u8) -> Result<()> {
        let items = match opcode {
            0x85..=0x87 => self.last(opcode - 0x84)?,
            b'a' => self.last(1)?,
            b's' => self.last(2)?,
            _ => self.marked()?,
        };
        match opcode {
            b't' | b'l' | 0x91 => {
                self.grow(items.len())?;
                self.push(if opcode == b't' { Value::Tuple(items) } else { Value::List(items) })
            }
            0x85..=0x87 => self.push(Value::Tuple(items)),
            b'a' | b'e' | 0x90 => self.append(items),
            b'd' => {
                self.push(Value::Dict(Vec::new()))?;
                self.set(&items)
            }
            _ => self.set(&items),
        }
    }

    /// Executes an opcode that changes the stack, the marks or the memo.
    fn operate(&mut self, opcode: u8) -> Result<()> {
        match opcode {
            0x80 => match self.size(1)? {
                0..=5 => Ok(()),
                _ => self.wrong("an unknown protocol"),
            },
            0x95 => self.take(8).map(drop),
            b'(' if self.marks.len() >= MOST_VALUES => Err(PickleError::TooLarge),
            b'(' => {
                self.marks.push(self.stack.len());
                Ok(())
            }
            // POP removes a mark if it is on top.
            b'0' if self.marks.last() == Some(&self.stack.len()) => {
                self.marks.pop();
                Ok(())
            }
            b'0' => self.pop().map(drop),
            b'1' => self.marked().map(drop),
            b'2' => self.top().and_then(|top| self.put(top)),
            b't' | b'l' | 0x91 | b'd' | 0x85..=0x87 | b'a' | b'e' | 0x90 | b's' | b'u' => self.fill(opcode),
            b'q' | b'r' | 0x94 | b'p' | b'h' | b'j' | b'g' => {
                let key = match opcode {
                    b'q' | b'h' => u8::from_le_bytes(self.fixed()?).into(),
                    b'r' | b'j' => u32::from_le_bytes(self.fixed()?),
                    0x94 => self.memo.len() as u32,
                    _ => self.line()?.parse().or_else(|_| self.wrong(NO_NUMBER))?,
                };
                if matches!(opcode, b'h' | b'j' | b'g') { self.recall(key) } else { self.memoise(key) }
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                match (self.value(module), self.value(name)) {
                    (Value::Text(module), Value::Text(name)) => self.push(Value::Name(module.clone(), name.clone())),
                    _ => self.wrong("a name that is not text"),
                }
            }
            b'R' => self.reduce(),
            // Attributes of an ordered dictionary, such as PyTorch's `_metadata`, are ignored.
            b'b' => {
                self.pop()?;
                match self.value(self.top()?) {
                    Value::Dict(_) => Ok(()),
                    _ => self.wrong("the state of an object without state"),
                }
            }
            b'Q' => {
                let id = self.pop()?;
                self.push(Value::Persistent(id))
            }
            b'P' => {
                let line = self.line()?.to_string();
                self.push(Value::Text(line))?;
                let id = self.pop()?;
                self.push(Value::Persistent(id))
            }
            // Objects of classes, which pickled modules consist of.
            0x81 | 0x92 | b'i' | b'o' => {
                let class = self.values.iter().rev().find_map(|value| match value {
                    Value::Name(module, name) => Some(format!("{module}.{name}")),
                    _ => None,
                });
                Err(PickleError::Class(class.unwrap_or_else(|| "an object".to_string())))
            }
            0x82..=0x84 => Err(PickleError::Class("an extension code".to_string())),
            _ => {
                self.at -= 1;
                self.wrong("an unknown opcode")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value_text(arena: &Arena, id: ValueId) -> String {
        let each = |ids: &[ValueId]| ids.iter().map(|&id| value_text(arena, id)).collect::<Vec<_>>().join(" ");
        match arena.get(id) {
            Value::Tuple(items) => format!("({})", each(items)),
            Value::List(items) => format!("[{}]", each(items)),
            Value::Dict(pairs) => {
                format!("{{{}}}", pairs.iter().map(|&(k, v)| each(&[k, v])).collect::<Vec<_>>().join(", "))
            }
            Value::Persistent(id) => format!("@{}", value_text(arena, *id)),
            Value::Call(name, arguments) => format!("{name}({})", each(arguments)),
            other => format!("{other:?}"),
        }
    }

    #[test]
    fn data_is_read_in_every_protocol() {
        // pickle.dumps({'a': [1, -2, 3.5], 'b': (True, None)}, protocol=p) of CPython 3.11.
        let expected = "{Text(\"a\") [Int(1) Int(-2) Float(3.5)], Text(\"b\") (Bool(true) None)}";
        let pickles: [&[u8]; 3] = [
            b"(dp0\nVa\np1\n(lp2\nI1\naI-2\naF3.5\nasVb\np3\n(I01\nNtp4\ns.",
            b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01]q\x02(K\x01J\xfe\xff\xff\xffG@\x0c\x00\x00\x00\x00\x00\x00eX\x01\x00\x00\x00bq\x03\x88N\x86q\x04u.",
            b"\x80\x04\x95\x25\x00\x00\x00\x00\x00\x00\x00}\x94(\x8c\x01a\x94]\x94(K\x01J\xfe\xff\xff\xffG@\x0c\x00\x00\x00\x00\x00\x00e\x8c\x01b\x94\x88N\x86\x94u.",
        ];
        for pickle in pickles {
            let (arena, top, taken) = load(pickle).unwrap();
            assert_eq!((value_text(&arena, top).as_str(), taken), (expected, pickle.len()));
        }
    }

    #[test]
    fn what_would_be_executed_is_named_and_refused() {
        for (pickle, named) in [
            (&b"cos\nsystem\n(S'echo hello'\ntR."[..], "os.system"),
            (b"\x80\x02cmodels\nNet\n)\x81}b.", "models.Net"),
            (b"\x80\x04\x8c\x08builtins\x8c\x04eval\x93\x8c\x01x\x85R.", "builtins.eval"),
        ] {
            assert_eq!(load(pickle).unwrap_err(), PickleError::Class(named.to_string()));
        }
    }

    #[test]
    fn a_pickle_may_refer_to_itself_and_may_be_cut() {
        let cycle = b"\x80\x02]q\x00h\x00a.";
        let (arena, top, _) = load(cycle).unwrap();
        assert_eq!(arena.get(top), &Value::List(vec![top]));
        for cut in 0..cycle.len() {
            assert!(load(&cycle[..cut]).is_err());
        }
    }
}
