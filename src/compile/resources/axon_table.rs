//! Which input axon each source has on the core that is being filled.
//!
//! In come sources by number, out go numbers of axons in the order in which sources first came. What it leaves out on
//! purpose: what the axons hold, which is for [`crate::compile::resources::incremental`] to know.

/// The input axon that each source has on a core, in a table that stays in a processor's cache: a network's sources are
/// millions, those of a core thousands.
#[derive(Debug)]
pub(crate) struct AxonOf {
    /// (core by count, source, axon), open addressing; at most half of the places are of the present core.
    places: Vec<(u32, u32, u32)>,
    core: u32,
    held: usize,
}

impl AxonOf {
    /// The table's first size.
    const PLACES: usize = 1 << 12;

    /// Of an empty core.
    pub fn new() -> Self {
        AxonOf { places: vec![(0, 0, 0); Self::PLACES], core: 1, held: 0 }
    }

    /// Begins another core.
    pub fn clear(&mut self) {
        (self.core, self.held) = (self.core + 1, 0);
    }

    /// Where a source is, or is to be. Neighbours stay neighbours; sources that lie a table apart do not meet.
    fn place(&self, source: u32) -> usize {
        let mask = self.places.len() - 1;
        let apart = (source >> Self::PLACES.trailing_zeros()).wrapping_mul(0x9e37_79b1);
        let mut at = (source.wrapping_add(apart >> 8)) as usize & mask;
        while self.places[at].0 == self.core && self.places[at].1 != source {
            at = (at + 1) & mask;
        }
        at
    }

    /// The axon of a source, which becomes `next` if it has none.
    pub fn get_or_insert(&mut self, source: u32, next: u32) -> u32 {
        let at = self.place(source);
        if self.places[at].0 == self.core {
            return self.places[at].2;
        }
        self.places[at] = (self.core, source, next);
        self.held += 1;
        if 2 * self.held > self.places.len() {
            let twice = vec![(0, 0, 0); 2 * self.places.len()];
            for place in std::mem::replace(&mut self.places, twice) {
                if place.0 == self.core {
                    let at = self.place(place.1);
                    self.places[at] = place;
                }
            }
        }
        next
    }
}
