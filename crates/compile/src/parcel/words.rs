//! Numbers, texts and lists as 32-bit words, and back.
//!
//! Input: values one after the other. Output: words from which they are read in the same order.
//! Invariant: nothing is allocated by a length that is read before as many words are known to be
//! left. Errors: [`Damaged`] where words end too early or no value is meant by them.

use nsim_partition::error::CompileError;

/// Words that mean nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("what another rank sent is damaged")]
pub struct Damaged;

impl From<Damaged> for CompileError {
    fn from(damaged: Damaged) -> Self {
        CompileError::fault(damaged)
    }
}

/// Words that are written.
#[derive(Debug, Default)]
pub struct Writer(Vec<u32>);

impl Writer {
    /// Adds a number.
    pub fn put(&mut self, word: u32) {
        self.0.push(word);
    }

    /// Adds a number that may be negative.
    pub fn signed(&mut self, number: i32) {
        self.put(number.cast_unsigned());
    }

    /// Adds a number of two words.
    pub fn wide(&mut self, number: u64) {
        self.0.extend([number as u32, (number >> 32) as u32]);
    }

    /// Adds a list and its length.
    pub fn list(&mut self, words: &[u32]) {
        self.wide(words.len() as u64);
        self.0.extend_from_slice(words);
    }

    /// Adds a list of small numbers, two in a word, and its length.
    pub fn halves(&mut self, numbers: &[i16]) {
        self.wide(numbers.len() as u64);
        let half = |number: Option<&i16>| u32::from(number.copied().unwrap_or(0).cast_unsigned());
        self.0.extend(numbers.chunks(2).map(|pair| half(pair.first()) | half(pair.get(1)) << 16));
    }

    /// Adds a text.
    pub fn text(&mut self, text: &str) {
        self.wide(text.len() as u64);
        self.0.extend(
            text.as_bytes()
                .chunks(4)
                .map(|bytes| bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte))),
        );
    }

    /// Adds whether there is a value; the caller adds the value.
    pub fn is_some<T>(&mut self, value: Option<T>) -> Option<T> {
        self.put(value.is_some().into());
        value
    }

    /// The words.
    #[must_use]
    pub fn into_words(self) -> Vec<u32> {
        self.0
    }
}

/// Words that are left to be read.
#[derive(Debug)]
pub struct Reader<'a>(&'a [u32]);

impl<'a> Reader<'a> {
    /// All of them.
    #[must_use]
    pub fn new(words: &'a [u32]) -> Self {
        Reader(words)
    }

    /// The next number.
    ///
    /// # Errors
    /// [`Damaged`], as of all that follow.
    pub fn take(&mut self) -> Result<u32, Damaged> {
        let (&word, rest) = self.0.split_first().ok_or(Damaged)?;
        self.0 = rest;
        Ok(word)
    }

    /// The next number, which may be negative.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn signed(&mut self) -> Result<i32, Damaged> {
        self.take().map(u32::cast_signed)
    }

    /// The next number of two words.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn wide(&mut self) -> Result<u64, Damaged> {
        let (low, high) = (self.take()?, self.take()?);
        Ok(u64::from(low) | u64::from(high) << 32)
    }

    /// A length, of things of which each takes at least a word.
    ///
    /// # Errors
    /// [`Damaged`] when there are not as many words.
    pub fn length(&mut self) -> Result<usize, Damaged> {
        let length = usize::try_from(self.wide()?).map_err(|_| Damaged)?;
        if length <= self.0.len() { Ok(length) } else { Err(Damaged) }
    }

    fn words(&mut self, count: usize) -> Result<&'a [u32], Damaged> {
        let (words, rest) = self.0.split_at_checked(count).ok_or(Damaged)?;
        self.0 = rest;
        Ok(words)
    }

    /// The next list.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn list(&mut self) -> Result<&'a [u32], Damaged> {
        let length = self.length()?;
        self.words(length)
    }

    /// The next list of small numbers.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn halves(&mut self) -> Result<impl ExactSizeIterator<Item = i16> + use<'a>, Damaged> {
        let length = usize::try_from(self.wide()?).map_err(|_| Damaged)?;
        let words = self.words(length.div_ceil(2))?;
        Ok((0..length).map(move |at| ((words[at / 2] >> (at % 2 * 16)) as u16).cast_signed()))
    }

    /// The next text.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn text(&mut self) -> Result<String, Damaged> {
        let length = usize::try_from(self.wide()?).map_err(|_| Damaged)?;
        let bytes = self.words(length.div_ceil(4))?.iter().flat_map(|word| word.to_le_bytes());
        String::from_utf8(bytes.take(length).collect()).map_err(|_| Damaged)
    }

    /// Whether a value follows.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn is_some(&mut self) -> Result<bool, Damaged> {
        match self.take()? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(Damaged),
        }
    }

    /// The next number, as one of these.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn one_of<T: Copy>(&mut self, all: &[T]) -> Result<T, Damaged> {
        all.get(self.take()? as usize).copied().ok_or(Damaged)
    }

    /// That nothing is left.
    ///
    /// # Errors
    /// [`Damaged`].
    pub fn end(&self) -> Result<(), Damaged> {
        if self.0.is_empty() { Ok(()) } else { Err(Damaged) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_read() {
        let mut words = Writer::default();
        words.signed(-5);
        words.wide(1 << 40);
        words.list(&[7, 8]);
        words.halves(&[-1, 300, -32_768]);
        words.text("läuft");
        words.is_some(None::<()>);
        let words = words.into_words();
        let mut reader = Reader::new(&words);
        assert_eq!((reader.signed(), reader.wide(), reader.list()), (Ok(-5), Ok(1 << 40), Ok(&[7, 8][..])));
        assert_eq!(reader.halves().unwrap().collect::<Vec<_>>(), [-1, 300, -32_768]);
        assert_eq!((reader.text().as_deref(), reader.is_some(), reader.end()), (Ok("läuft"), Ok(false), Ok(())));
        assert_eq!(Reader::new(&[9, 0, 1]).list(), Err(Damaged), "a list that is longer than what is left");
        assert!(Reader::new(&[u32::MAX, u32::MAX]).text().is_err());
    }
}
