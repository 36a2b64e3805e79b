//! Assignment of logical to physical cores, and the routes of messages between them.
//!
//! Chips form a rectangular board, and the tiles of a chip a rectangular mesh. A message goes east
//! or west first, then north or south (dimension order, as in Loihi's mesh: Davies et al. 2018).
//! Invariants of a [`Placement`]: it is one to one and inside the mesh.

use serde::{Deserialize, Serialize};

use crate::base::id::{CoreId, IdVec};
use crate::hardware::Target;

/// Sizes of the board and its chips.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Mesh {
    /// Number of chips from west to east.
    pub chips_x: u32,
    /// Number of chips from north to south.
    pub chips_y: u32,
    /// Number of tiles of a chip from west to east.
    pub width: u32,
    /// Number of tiles of a chip from north to south.
    pub height: u32,
    /// Number of cores of a tile.
    pub cores_per_tile: u32,
    /// Number of usable cores of a chip.
    pub cores_per_chip: u32,
}

impl Mesh {
    /// The mesh of a target.
    pub fn for_target(target: &Target) -> Self {
        let chip = target.chip();
        Mesh {
            chips_x: target.chips_x(),
            chips_y: target.chips() / target.chips_x(),
            width: chip.width,
            height: chip.height,
            cores_per_tile: chip.cores_per_tile,
            cores_per_chip: chip.cores,
        }
    }

    /// Whether it has cores, each with a place on a tile, and their number fits `u32`.
    pub fn is_countable(&self) -> bool {
        let Mesh { chips_x, chips_y, width, height, cores_per_tile, cores_per_chip } = *self;
        let all = [chips_x, chips_y, width, height, cores_per_tile].into_iter().try_fold(1u32, u32::checked_mul);
        all.is_some_and(|all| all > 0 && (1..=width * height * cores_per_tile).contains(&cores_per_chip))
    }

    /// Number of usable cores of the whole board.
    pub fn cores(&self) -> u32 {
        self.chips_x * self.chips_y * self.cores_per_chip
    }

    /// The core of a number, counted by chip, then row of tiles, then tile; `None` past the last.
    pub fn site(&self, number: u32) -> Option<Site> {
        let (chip, within) = (number / self.cores_per_chip, number % self.cores_per_chip);
        let tile = within / self.cores_per_tile;
        (number < self.cores()).then(|| Site {
            chip,
            x: tile % self.width,
            y: tile / self.width,
            core: within % self.cores_per_tile,
        })
    }

    /// The inverse of [`Mesh::site`]; `None` for a site outside the mesh.
    pub fn number(&self, site: Site) -> Option<u32> {
        let inside = site.x < self.width && site.y < self.height && site.core < self.cores_per_tile;
        if !inside || site.chip >= self.chips_x * self.chips_y {
            return None;
        }
        let within = (site.y * self.width + site.x) * self.cores_per_tile + site.core;
        (within < self.cores_per_chip).then(|| site.chip * self.cores_per_chip + within)
    }

    /// Column and row of a site's tile on the whole board.
    pub fn tile(&self, site: Site) -> (u32, u32) {
        let (chip_x, chip_y) = (site.chip % self.chips_x, site.chip / self.chips_x);
        (chip_x * self.width + site.x, chip_y * self.height + site.y)
    }

    /// Positions of a core's tile and chip.
    pub fn position(&self, site: Site) -> MeshPosition {
        MeshPosition { tile: self.tile(site), chip: (site.chip % self.chips_x, site.chip / self.chips_x) }
    }

    /// The corner of a core's chip, at which its input spikes enter.
    #[inline]
    pub fn corner(&self, of: MeshPosition) -> MeshPosition {
        MeshPosition { tile: (of.chip.0 * self.width, of.chip.1 * self.height), ..of }
    }

    /// The route of a message from one core to another.
    pub fn route(&self, from: Site, to: Site) -> Route {
        self.position(from).route(self.position(to))
    }

    /// The route of an input spike: it enters at the corner of its target's chip.
    pub fn route_from_corner(&self, to: Site) -> Route {
        Route { east_west: to.x, north_south: to.y, chip: 0 }
    }
}

/// A physical core.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Site {
    /// Chip number, row of chips by row.
    pub chip: u32,
    /// Column of the tile on the chip, from the west.
    pub x: u32,
    /// Row of the tile on the chip, from the north.
    pub y: u32,
    /// Core within the tile.
    pub core: u32,
}

/// Position of a core: columns and rows, from the north-west corner of the board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshPosition {
    /// Column and row of its tile.
    pub tile: (u32, u32),
    /// Column and row of its chip.
    pub chip: (u32, u32),
}

impl MeshPosition {
    /// The route of a message from here to another core.
    #[inline]
    pub fn route(self, to: MeshPosition) -> Route {
        Route {
            east_west: self.tile.0.abs_diff(to.tile.0),
            north_south: self.tile.1.abs_diff(to.tile.1),
            chip: self.chip.0.abs_diff(to.chip.0) + self.chip.1.abs_diff(to.chip.1),
        }
    }
}

/// Numbers of links that a message crosses.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, Serialize)]
pub struct Route {
    /// Links crossed east or west.
    pub east_west: u32,
    /// Links crossed north or south.
    pub north_south: u32,
    /// Links crossed between chips, included in the others.
    pub chip: u32,
}

impl Route {
    /// Links crossed; 0 within a tile.
    #[inline]
    pub fn links(self) -> u32 {
        self.east_west + self.north_south
    }

    /// The longer of two routes: by links, then links between chips, then links north or south.
    #[must_use]
    #[inline]
    pub fn max(self, other: Route) -> Route {
        fn key(r: Route) -> (u32, u32, u32) {
            (r.links(), r.chip, r.north_south)
        }
        if key(other) > key(self) { other } else { self }
    }
}

/// Reason why a placement is invalid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum PlacementError {
    /// The mesh has no cores, or more than can be numbered.
    #[error("the mesh has no cores, or more than can be numbered")]
    Mesh,
    /// A core is outside the mesh.
    #[error("{core} is placed on chip {} tile ({}, {}) core {}, which the target does not \
             have", site.chip, site.x, site.y, site.core)]
    Outside {
        /// The logical core.
        core: CoreId,
        /// Its physical core.
        site: Site,
    },
    /// Two cores have the same place.
    #[error("{first} and {second} are placed on the same physical core")]
    Shared {
        /// The core with the lower id.
        first: CoreId,
        /// The core with the higher id.
        second: CoreId,
    },
}

/// The physical core of every logical core.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(try_from = "Text")]
pub struct Placement {
    mesh: Mesh,
    sites: IdVec<CoreId, Site>,
}

/// Serialised form of a [`Placement`].
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename = "Placement")]
struct Text {
    mesh: Mesh,
    sites: IdVec<CoreId, Site>,
}

impl TryFrom<Text> for Placement {
    type Error = PlacementError;

    fn try_from(Text { mesh, sites }: Text) -> Result<Self, PlacementError> {
        Placement::new(mesh, sites)
    }
}

impl Placement {
    /// Builds a placement that is one to one and inside the mesh.
    ///
    /// # Errors
    /// [`PlacementError`] for a mesh without cores, or at the first core that violates this.
    pub fn new(mesh: Mesh, sites: IdVec<CoreId, Site>) -> Result<Self, PlacementError> {
        if !mesh.is_countable() {
            return Err(PlacementError::Mesh);
        }
        let mut taken: std::collections::HashMap<u32, CoreId> = std::collections::HashMap::new();
        for (core, &site) in sites.enumerate() {
            let number = mesh.number(site).ok_or(PlacementError::Outside { core, site })?;
            if let Some(first) = taken.insert(number, core) {
                return Err(PlacementError::Shared { first, second: core });
            }
        }
        Ok(Placement { mesh, sites })
    }

    /// The mesh.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The physical core of a logical core.
    pub fn site(&self, core: CoreId) -> Site {
        self.sites[core]
    }

    /// The physical cores of all logical cores.
    pub fn sites(&self) -> &IdVec<CoreId, Site> {
        &self.sites
    }

    /// Number of chips with a core in use.
    pub fn chips_used(&self) -> u32 {
        let chips: std::collections::BTreeSet<u32> = self.sites.iter().map(|site| site.chip).collect();
        chips.len() as u32
    }

    /// Number of logical cores.
    pub fn len(&self) -> usize {
        self.sites.len()
    }

    /// Whether there is no core.
    pub fn is_empty(&self) -> bool {
        self.sites.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MESH: Mesh = Mesh { chips_x: 2, chips_y: 2, width: 8, height: 4, cores_per_tile: 4, cores_per_chip: 128 };

    #[test]
    fn numbers_and_sites_are_inverse() {
        for number in 0..MESH.cores() {
            assert_eq!(MESH.number(MESH.site(number).unwrap()), Some(number));
        }
        assert_eq!(MESH.site(MESH.cores()), None);
    }

    #[test]
    fn routes_count_links_and_chip_borders() {
        let from = Site { chip: 0, x: 7, y: 3, core: 0 };
        let to = Site { chip: 3, x: 0, y: 1, core: 2 };
        assert_eq!(MESH.route(from, to), Route { east_west: 1, north_south: 2, chip: 2 });
        assert_eq!(MESH.route(to, from), MESH.route(from, to));
        assert_eq!(MESH.route_from_corner(from), Route { east_west: 7, north_south: 3, chip: 0 });
    }

    #[test]
    fn two_cores_cannot_share_a_place() {
        let site = MESH.site(5).unwrap();
        let error = Placement::new(MESH, vec![site, site].into()).unwrap_err();
        assert_eq!(error, PlacementError::Shared { first: CoreId(0), second: CoreId(1) });
        let outside = Site { chip: 4, ..site };
        assert!(matches!(Placement::new(MESH, vec![outside].into()), Err(PlacementError::Outside { .. })));
    }
}
