//! Messages of spikes: their destination cores, and the input axons that they select there.
//!
//! Input: a list of [`AxonTarget`] for each compartment of a core. Output: [`AxonsOut`]: the
//! destination cores, and by compartment indices into them, each with an axon. Cores with identical
//! index lists share them, as most cores of a convolution do. So its messages take the memory of a
//! few cores. Errors: [`NotClosed`] when a core sends to more than 2^16 others.

use std::sync::Arc;

use serde::{Deserialize, Serialize, Serializer};

use crate::base::csr::{Csr, NotClosed};
use crate::base::id::CoreId;

/// An input axon of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct AxonTarget {
    /// Destination core.
    pub core: CoreId,
    /// The input axon on that core.
    pub axon: u16,
}

/// An input axon of one of the destination cores of a core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct IndexedTarget {
    /// Index into the destination cores.
    pub core_index: u16,
    /// The input axon on that core.
    pub axon: u16,
}

/// Messages that the spikes of a core's compartments send, by slot.
#[derive(Debug, Clone, Default, PartialEq, Eq, Deserialize)]
#[serde(try_from = "Vec<Vec<AxonTarget>>")]
pub struct AxonsOut {
    cores: Vec<CoreId>,
    lists: Arc<Csr<IndexedTarget>>,
}

impl AxonsOut {
    /// Builds messages from the destination cores and the index lists by slot.
    ///
    /// # Errors
    /// [`NotClosed`] when an index is outside `cores`.
    pub fn new(cores: Vec<CoreId>, lists: Arc<Csr<IndexedTarget>>) -> Result<Self, NotClosed> {
        let closed = lists.items().iter().all(|reached| usize::from(reached.core_index) < cores.len());
        if closed { Ok(AxonsOut { cores, lists }) } else { Err(NotClosed) }
    }

    /// Returns these messages with every destination core mapped by `core`.
    ///
    /// # Errors
    /// The first error of `core`.
    pub fn renumbered<E>(&self, core: impl FnMut(CoreId) -> Result<CoreId, E>) -> Result<Self, E> {
        let cores = self.cores.iter().copied().map(core).collect::<Result<_, E>>()?;
        Ok(AxonsOut { cores, lists: self.lists.clone() })
    }

    /// Returns the messages to the cores for which `keep` is true.
    pub fn filtered(&self, keep: impl Fn(CoreId) -> bool) -> Self {
        let mut cores = Vec::new();
        let number = |&core: &CoreId| {
            keep(core).then(|| {
                cores.push(core);
                (cores.len() - 1) as u16
            })
        };
        let numbers: Vec<Option<u16>> = self.cores.iter().map(number).collect();
        let mut lists = Csr::default();
        for list in self.lists.iter() {
            lists.push(
                list.iter()
                    .filter_map(|to| Some(IndexedTarget { core_index: numbers[usize::from(to.core_index)]?, ..*to })),
            );
        }
        lists.shrink_to_fit();
        AxonsOut { cores, lists: lists.into() }
    }

    /// Destination cores.
    pub fn cores(&self) -> &[CoreId] {
        &self.cores
    }

    /// Index lists by slot, which other cores may share.
    pub fn lists(&self) -> &Arc<Csr<IndexedTarget>> {
        &self.lists
    }

    /// Number of compartments.
    pub fn len(&self) -> usize {
        self.lists.len()
    }

    /// Whether there is no compartment.
    pub fn is_empty(&self) -> bool {
        self.lists.is_empty()
    }

    /// The messages of a slot's spike.
    #[inline]
    pub fn get(&self, slot: usize) -> Messages<'_> {
        Messages::Indexed(&self.cores, self.lists.get(slot).iter())
    }

    /// The messages by slot.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Messages<'_>> {
        (0..self.len()).map(|slot| self.get(slot))
    }

    /// All messages, in the order of slots.
    pub fn items(&self) -> Messages<'_> {
        Messages::Indexed(&self.cores, self.lists.items().iter())
    }
}

impl TryFrom<Vec<Vec<AxonTarget>>> for AxonsOut {
    type Error = NotClosed;

    fn try_from(lists: Vec<Vec<AxonTarget>>) -> Result<Self, NotClosed> {
        let mut cores: Vec<CoreId> = lists.iter().flatten().map(|to| to.core).collect();
        cores.sort_unstable();
        cores.dedup();
        let reached = |to: &AxonTarget| {
            let core = u16::try_from(cores.partition_point(|&core| core < to.core)).map_err(|_| NotClosed)?;
            Ok(IndexedTarget { core_index: core, axon: to.axon })
        };
        let lists = lists.iter().map(|list| list.iter().map(reached).collect::<Result<Vec<_>, _>>());
        let lists = Csr::try_from(lists.collect::<Result<Vec<_>, _>>()?)?;
        AxonsOut::new(cores, lists.into())
    }
}

/// Serialised as a list of messages for each slot.
impl Serialize for AxonsOut {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.iter().map(Iterator::collect::<Vec<_>>))
    }
}

/// Iterator over messages of spikes.
#[derive(Debug, Clone)]
pub enum Messages<'a> {
    /// Messages of an input channel.
    Channel(std::slice::Iter<'a, AxonTarget>),
    /// Messages of compartments: the destination cores, and indices into them.
    Indexed(&'a [CoreId], std::slice::Iter<'a, IndexedTarget>),
}

impl Iterator for Messages<'_> {
    type Item = AxonTarget;

    #[inline]
    fn next(&mut self) -> Option<AxonTarget> {
        match self {
            Messages::Channel(list) => list.next().copied(),
            Messages::Indexed(cores, list) => {
                list.next().map(|to| AxonTarget { core: cores[usize::from(to.core_index)], axon: to.axon })
            }
        }
    }

    #[inline]
    fn nth(&mut self, place: usize) -> Option<AxonTarget> {
        match self {
            Messages::Channel(list) => *list = list.as_slice().get(place..).unwrap_or_default().iter(),
            Messages::Indexed(_, list) => *list = list.as_slice().get(place..).unwrap_or_default().iter(),
        }
        self.next()
    }

    #[inline]
    fn size_hint(&self) -> (usize, Option<usize>) {
        match self {
            Messages::Channel(list) => list.size_hint(),
            Messages::Indexed(_, list) => list.size_hint(),
        }
    }
}

impl ExactSizeIterator for Messages<'_> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_those_that_were_given() {
        let to = |core, axon| AxonTarget { core: CoreId(core), axon };
        let given = vec![vec![to(9, 1), to(2, 0)], vec![], vec![to(5, 7), to(9, 3), to(9, 3)]];
        let out = AxonsOut::try_from(given.clone()).unwrap();
        let lists = |out: &AxonsOut| out.iter().map(Iterator::collect).collect::<Vec<Vec<AxonTarget>>>();
        assert_eq!((out.cores(), lists(&out)), (&[2, 5, 9].map(CoreId)[..], given.clone()));
        assert!(out.items().eq(given.concat()));
        let later = |core: CoreId| Ok::<_, ()>(CoreId(core.0 + 1));
        assert_eq!(lists(&out.renumbered(later).unwrap())[0], [to(10, 1), to(3, 0)]);
        assert_eq!(lists(&out.filtered(|core| core.0 != 2)), [vec![to(9, 1)], vec![], given[2].clone()]);
        assert!(AxonsOut::new(vec![CoreId(0), CoreId(1)], out.lists.clone()).is_err());
    }
}
