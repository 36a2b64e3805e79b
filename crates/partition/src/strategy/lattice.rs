//! Cuts of the layers of a network into boxes, a core each.
//!
//! Input: a network in which every projection is a window or all to all. Output: its [`Layer`]s,
//! and for each the grid of boxes that takes the fewest cores, with the use of every box
//! ([`crate::resources::closed_form`]).

use std::collections::HashMap;
use std::ops::Range;

use crate::resources::axon_sharing::Places;
use crate::resources::closed_form::{BoxUse, Channels, Layer, Parts, Side, part, use_of};
use crate::resources::formats::Formats;
use crate::resources::packing;
use crate::resources::receptive_field::WindowAxis;
use crate::strategy::tiles::{self, Grid};
use nsim_ir::base::id::{CompartmentId, IdVec, PopulationId};
use nsim_ir::partition::CoreUsage;
use nsim_ir::quantised::Quantised;
use nsim_ir::resource::{Limits, Resource};

/// Most grids of a layer that are tried.
const TRIALS: usize = 200;

/// The layers of a network, empty for inputs; `None` when a projection is neither a window nor all
/// to all, two join the same populations, or a neuron has compartments of several.
pub fn layers(network: &Quantised) -> Option<IdVec<PopulationId, Layer>> {
    if !network.parts().children.is_empty() {
        return None;
    }
    let (formats, places) = (Formats::for_network(network), Places::of_windows(network));
    let of = |id| Layer::for_population(network, id, &formats, &places).filter(|layer| !layer.joined);
    network.populations().ids().map(of).collect()
}

/// Grid of boxes over a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Lattice {
    /// Channels, rows and columns of a box; boxes at the end may be smaller.
    pub size: (u32, u32, u32),
    /// Boxes along channels, rows and columns.
    along: (u32, u32, u32),
}

impl Lattice {
    /// Returns the grid of boxes of this size over a layer of this shape; `None` when a side of a
    /// box is 0 or longer than the layer's.
    pub fn new(shape: (u32, u32, u32), size: (u32, u32, u32)) -> Option<Self> {
        let within = |length: u32, size: u32| (1..=length).contains(&size).then(|| length.div_ceil(size));
        let along = (within(shape.0, size.0)?, within(shape.1, size.1)?, within(shape.2, size.2)?);
        Some(Lattice { size, along })
    }

    /// Number of boxes.
    pub fn boxes(&self) -> u32 {
        self.along.0 * self.along.1 * self.along.2
    }

    /// Boxes (channels, row, column) in the order of cores: rows of boxes run to and fro.
    pub fn order(&self) -> impl Iterator<Item = (u32, u32, u32)> + use<> {
        tiles::to_and_fro(self.along.0, self.along.1, self.along.2)
    }

    /// Index of a box in that order.
    pub fn number(&self, at: (u32, u32, u32)) -> u32 {
        let (c, y, x) = at;
        let x = if y.is_multiple_of(2) { x } else { self.along.2 - 1 - x };
        (y * self.along.2 + x) * self.along.0 + c
    }

    /// Compartments of every box, in slot order, of a layer whose first compartment is `first`.
    pub fn members(self, layer: &Layer, first: CompartmentId) -> impl Iterator<Item = Vec<CompartmentId>> + use<'_> {
        self.order().map(move |at| {
            let indices = tiles::cell(layer.shape, self.size, at, layer.by_channel);
            indices.into_iter().map(|index| CompartmentId(first.0 + index)).collect()
        })
    }
}

/// A layer cut into boxes, a core each.
#[derive(Debug, Clone)]
pub struct Cut {
    /// Grid of the boxes.
    pub lattice: Lattice,
    kinds: [Vec<u32>; 3],
    /// Rows and columns of each kind.
    sides: [Vec<Side>; 2],
    uses: HashMap<(u32, u32, u32), BoxUse>,
}

fn parts(length: u32, size: u32) -> impl Iterator<Item = Range<u32>> {
    (0..length.div_ceil(size)).map(move |at| part(length, size, at))
}

/// Distinct items and the number of each item's kind.
fn kinds<T: Eq + std::hash::Hash + Clone>(items: impl Iterator<Item = T>) -> (Vec<T>, Vec<u32>) {
    let (mut distinct, mut known): (Vec<T>, HashMap<T, u32>) = (Vec::new(), HashMap::new());
    let numbers = items
        .map(|item| {
            *known.entry(item).or_insert_with_key(|item| {
                distinct.push(item.clone());
                distinct.len() as u32 - 1
            })
        })
        .collect();
    (distinct, numbers)
}

impl Cut {
    /// Cuts a layer into the boxes of a lattice.
    pub fn new(layer: &Layer, lattice: Lattice, formats: &Formats, limits: &Limits) -> Self {
        let ((c, h, w), size) = (layer.shape, lattice.size);
        let (channels, of_channels) = kinds(parts(c, size.0).map(|part| Channels::of_part(layer, &part)));
        let (rows, of_rows) = kinds(parts(h, size.1).map(|part| Side::of_part(layer, WindowAxis::rows, &part)));
        let (columns, of_columns) = kinds(parts(w, size.2).map(|at| Side::of_part(layer, WindowAxis::columns, &at)));
        let mut uses = HashMap::new();
        for (i, channels) in channels.iter().enumerate() {
            for (j, rows) in rows.iter().enumerate() {
                for (k, columns) in columns.iter().enumerate() {
                    let used = use_of(layer, formats, limits, Parts { channels, rows, columns });
                    uses.insert((i as u32, j as u32, k as u32), used);
                }
            }
        }
        Cut { lattice, kinds: [of_channels, of_rows, of_columns], sides: [rows, columns], uses }
    }

    /// Returns the first grid, by number of boxes and then of messages, of which every box fits a
    /// core with at most `most` compartments.
    ///
    /// # Errors
    /// The use of one compartment alone, when no grid was found.
    pub fn fewest_boxes(layer: &Layer, formats: &Formats, limits: &Limits, most: u32) -> Result<Self, CoreUsage> {
        let most = most.min(limits[Resource::Compartments]).min(packing::MOST_SLOTS);
        let mut cut = None;
        tiles::first_that_fits(&tiles::grids(layer, formats, limits, most), TRIALS, |Grid { size, .. }| {
            // A box in the middle, whose windows are whole, reveals most grids that do not fit.
            if layer.middle(*size, formats, limits).exceeds(limits) {
                return false;
            }
            let Some(lattice) = Lattice::new(layer.shape, *size) else { return false };
            let found = Cut::new(layer, lattice, formats, limits);
            let fits = !found.uses.values().any(|used| used.exceeds(limits));
            cut = fits.then_some(found);
            fits
        });
        if let Some(cut) = cut {
            return Ok(cut);
        }
        let found = Cut::new(layer, Lattice { size: (1, 1, 1), along: layer.shape }, formats, limits);
        match found.uses.values().any(|used| used.exceeds(limits)) {
            true => Err(layer.middle((1, 1, 1), formats, limits).usage),
            false => Ok(found),
        }
    }

    /// Kind of a box: boxes of one kind have the same resource use.
    pub fn kind(&self, at: (u32, u32, u32)) -> (u32, u32, u32) {
        (self.kinds[0][at.0 as usize], self.kinds[1][at.1 as usize], self.kinds[2][at.2 as usize])
    }

    /// Rows of the boxes in one row of the grid.
    pub fn rows(&self, row: u32) -> &Side {
        &self.sides[0][self.kinds[1][row as usize] as usize]
    }

    /// Columns of the boxes in one column of the grid.
    pub fn columns(&self, column: u32) -> &Side {
        &self.sides[1][self.kinds[2][column as usize] as usize]
    }

    /// Resource use of the core of a box.
    pub fn used(&self, at: (u32, u32, u32)) -> &BoxUse {
        &self.uses[&self.kind(at)]
    }
}
