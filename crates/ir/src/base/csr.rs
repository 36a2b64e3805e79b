//! Compressed sparse rows: a list of items for each row, in one allocation.
//!
//! Input: rows of items in order, or (row, item) pairs in any order. Output: slices by row.
//! Invariants: the offsets begin at 0, never decrease, and end at the number of items, which is
//! below 2^32. Errors: [`NotClosed`] for offsets that break an invariant.

use serde::ser::{Serialize, Serializer};

/// Offsets that do not divide the items into rows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the offsets of rows do not divide their items")]
pub struct NotClosed;

/// Rows of items.
#[derive(Debug, Clone, PartialEq, Eq, serde::Deserialize)]
#[serde(try_from = "Vec<Vec<T>>")]
pub struct Csr<T> {
    first: Vec<u32>,
    items: Vec<T>,
}

/// Serialised as a list of rows.
impl<T: Serialize> Serialize for Csr<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter())
    }
}

impl<T> TryFrom<Vec<Vec<T>>> for Csr<T> {
    type Error = NotClosed;

    fn try_from(rows: Vec<Vec<T>>) -> Result<Self, NotClosed> {
        let ends = rows.iter().scan(0, |end, row| {
            *end += row.len();
            Some(u32::try_from(*end).map_err(|_| NotClosed))
        });
        let first = std::iter::once(Ok(0)).chain(ends).collect::<Result<_, _>>()?;
        Csr::new(first, rows.into_iter().flatten().collect())
    }
}

impl<T> Default for Csr<T> {
    fn default() -> Self {
        Csr { first: vec![0], items: Vec::new() }
    }
}

impl<T> Csr<T> {
    /// Rows from their offsets, one more than there are rows, and their items.
    ///
    /// # Errors
    /// [`NotClosed`] if an invariant does not hold.
    pub fn new(first: Vec<u32>, items: Vec<T>) -> Result<Self, NotClosed> {
        let ends = first.first() == Some(&0) && first.last().map(|&end| end as usize) == Some(items.len());
        if ends && first.is_sorted() { Ok(Csr { first, items }) } else { Err(NotClosed) }
    }

    /// No rows yet, with capacity for these numbers of rows and items.
    pub fn with_capacity(rows: usize, items: usize) -> Self {
        let mut first = Vec::with_capacity(rows + 1);
        first.push(0);
        Csr { first, items: Vec::with_capacity(items) }
    }

    /// Builds rows from (row, item) pairs in any order, which each row keeps. `visit` is called
    /// twice, and passes the same pairs to its argument both times.
    ///
    /// # Panics
    /// As [`Csr::push`], and when a row does not exist.
    pub fn by_row(rows: usize, mut visit: impl FnMut(&mut dyn FnMut(usize, T))) -> Self
    where
        T: Clone,
    {
        let (mut first, mut any) = (vec![0u32; rows + 1], None);
        visit(&mut |row, item| {
            first[row + 1] += 1;
            any.get_or_insert(item);
        });
        let Some(item) = any else { return Csr { first, items: Vec::new() } };
        for row in 0..rows {
            first[row + 1] = first[row].checked_add(first[row + 1]).expect("fewer than 2^32 items");
        }
        let mut items = vec![item; first[rows] as usize];
        let mut next = first.clone();
        visit(&mut |row, item| {
            items[next[row] as usize] = item;
            next[row] += 1;
        });
        Csr { first, items }
    }

    /// Appends a row.
    ///
    /// # Panics
    /// When all rows together reach 2^32 items; the limits of a core and of a network exclude it.
    pub fn push(&mut self, row: impl IntoIterator<Item = T>) {
        self.extend_last(row);
        self.end();
    }

    /// Appends items to a row that is not ended yet.
    pub fn extend_last(&mut self, items: impl IntoIterator<Item = T>) {
        self.items.extend(items);
    }

    /// Ends the row that [`Csr::extend_last`] appended to.
    ///
    /// # Panics
    /// As [`Csr::push`].
    pub fn end(&mut self) {
        self.first.push(u32::try_from(self.items.len()).expect("fewer than 2^32 items"));
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.first.len() - 1
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// One row.
    #[inline]
    pub fn get(&self, row: usize) -> &[T] {
        &self.items[self.first[row] as usize..self.first[row + 1] as usize]
    }

    /// One row, to be changed in place.
    #[inline]
    pub fn get_mut(&mut self, row: usize) -> &mut [T] {
        &mut self.items[self.first[row] as usize..self.first[row + 1] as usize]
    }

    /// The offset of each row among all items, then the end of the last row.
    pub fn firsts(&self) -> &[u32] {
        &self.first
    }

    /// The items of all rows.
    pub fn items(&self) -> &[T] {
        &self.items
    }

    /// The items of all rows, to be changed in place.
    pub fn items_mut(&mut self) -> &mut [T] {
        &mut self.items
    }

    /// The rows in order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &[T]> {
        (0..self.len()).map(|row| self.get(row))
    }

    /// Releases memory that is not used.
    pub fn shrink_to_fit(&mut self) {
        self.first.shrink_to_fit();
        self.items.shrink_to_fit();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_are_checked() {
        assert_eq!(Csr::new(vec![0, 2, 2, 3], vec!['a', 'b', 'c']).unwrap().get(0), ['a', 'b']);
        for first in [vec![], vec![0], vec![1, 3], vec![0, 2], vec![0, 4, 3]] {
            assert_eq!(Csr::new(first, vec!['a', 'b', 'c']), Err(NotClosed));
        }
    }

    #[test]
    fn pairs_in_any_order_make_rows_in_their_order() {
        let pairs = [(2, 'a'), (0, 'b'), (2, 'c'), (3, 'd'), (0, 'e')];
        let csr = Csr::by_row(4, |put| pairs.iter().for_each(|&(row, item)| put(row, item)));
        let mut pushed = Csr::default();
        [vec!['b', 'e'], vec![], vec!['a', 'c'], vec!['d']].into_iter().for_each(|row| pushed.push(row));
        assert_eq!(csr, pushed);
        assert_eq!(csr.iter().map(<[char]>::len).collect::<Vec<_>>(), [2, 0, 2, 1]);
    }
}
