//! How many cores a deployment uses, powers and keeps busy.
//!
//! Static power is charged for powered cores, which are more than those in use where power comes in tiles or chips.

use std::collections::{BTreeMap, BTreeSet};

use crate::cost::host::Host;
use crate::cost::transport::{Timing, Transport};
use crate::desc::published::scenario::{DeployedCores, ScenarioFile};
use crate::desc::target::{Chip, PowerUnit};
use crate::ir::placement::Placement;

/// The numbers of cores that static power, x86 power and the barrier depend on, for all copies together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployment {
    /// `packed`, `paper`, or the file it came from.
    pub name: String,
    /// Copies of the workload that share it.
    pub copies: u32,
    /// Neuron cores in use.
    pub cores_used: u64,
    /// Neuron cores that draw static power.
    pub cores_powered: u64,
    /// Tiles with a core in use: they take part in the barrier.
    pub tiles_used: u64,
    /// Chips with a core in use.
    pub chips_used: u64,
    /// The x86 cores in use; `None` for the chips alone.
    pub host: Option<Host>,
}

impl Deployment {
    /// The mapping's own numbers; the placement holds all copies.
    #[must_use]
    pub fn from_placement(name: impl Into<String>, placement: &Placement, chip: &Chip, copies: u32) -> Self {
        let chips_used = u64::from(placement.chips_used());
        Deployment {
            name: name.into(),
            copies,
            cores_used: placement.len() as u64,
            cores_powered: powered_cores(placement, chip),
            tiles_used: tiles_used(placement).len() as u64,
            chips_used,
            host: Some(host(placement, chip, copies)),
        }
    }

    /// The numbers of a published job.
    #[must_use]
    pub fn from_scenario(name: impl Into<String>, scenario: &ScenarioFile) -> Self {
        let DeployedCores { cores_used, cores_powered, tiles_used, chips_used, x86_cores } = scenario.deployment.value;
        let copies = scenario.copies.value;
        let host = Some(Host::even(x86_cores, copies.into()));
        Deployment { name: name.into(), copies, cores_used, cores_powered, tiles_used, chips_used, host }
    }

    /// What the time of a step depends on here; messages are followed for the first preset alone.
    #[must_use]
    pub fn timing(&self, transport: Transport) -> Timing {
        Timing { transport, tiles_used: self.tiles_used, host: self.host, followed: 1 }
    }

    /// x86 cores in use; none where the chips are looked at alone.
    #[must_use]
    pub fn x86_cores(&self) -> u64 {
        self.host.map_or(0, |host| host.x86_cores)
    }
}

/// The x86 cores of the chips in use. Copies are on a chip in proportion to its cores.
fn host(placement: &Placement, chip: &Chip, copies: u32) -> Host {
    let mut cores = BTreeMap::<u32, u64>::new();
    placement.sites().iter().for_each(|site| *cores.entry(site.chip).or_default() += 1);
    let most = cores.values().copied().max().unwrap_or(0);
    let (copies, x86_cores) = (u64::from(copies), u64::from(chip.x86_cores_in_use));
    let on_one_chip = (most * copies).div_ceil((placement.len() as u64).max(1));
    // A chip without x86 cores is served from outside, as all others.
    let copies_in_turn = if x86_cores == 0 { copies } else { on_one_chip.div_ceil(x86_cores) };
    Host { x86_cores: cores.len() as u64 * x86_cores, copies, copies_in_turn: copies_in_turn.max(1) }
}

/// The cores that draw static power: all those of each core, tile or chip in use.
#[must_use]
pub fn powered_cores(placement: &Placement, chip: &Chip) -> u64 {
    match chip.power_unit {
        PowerUnit::Core => placement.len() as u64,
        PowerUnit::Chip => u64::from(placement.chips_used()) * u64::from(chip.cores),
        PowerUnit::Tile => tiles_used(placement)
            .into_iter()
            .map(|(_, y, x)| {
                // The last tile of a chip may have cores that cannot be used, and then does not power them.
                let before = (y * chip.width + x) * chip.cores_per_tile;
                u64::from(chip.cores.saturating_sub(before).min(chip.cores_per_tile))
            })
            .sum(),
    }
}

/// Chip, row and column of each tile with a core in use.
fn tiles_used(placement: &Placement) -> BTreeSet<(u32, u32, u32)> {
    placement.sites().iter().map(|site| (site.chip, site.y, site.x)).collect()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::base::diagnostic::SourceText;
    use crate::desc::spanned::parse;
    use crate::ir::placement::Mesh;

    pub(crate) fn loihi1() -> Chip {
        let path = format!("{}/mapping/chips/loihi1.ron", env!("CARGO_MANIFEST_DIR"));
        parse(&SourceText::new("loihi1", std::fs::read_to_string(path).unwrap()), "target.syntax").unwrap()
    }

    /// The published deployment of the shipped model.
    pub(crate) fn paper() -> Deployment {
        let path = format!("{}/mapping/scenarios/vtsnn-slip-paper.ron", env!("CARGO_MANIFEST_DIR"));
        let source = SourceText::new("scenario", std::fs::read_to_string(path).unwrap());
        Deployment::from_scenario("paper", &parse(&source, "scenario.syntax").unwrap())
    }

    pub(crate) fn sequential(cores: u32) -> Placement {
        let mesh = Mesh { chips_x: 8, chips_y: 4, width: 8, height: 4, cores_per_tile: 4, cores_per_chip: 128 };
        let sites = (0..cores).map(|number| mesh.site(number).unwrap()).collect::<Vec<_>>();
        Placement::new(mesh, sites.into()).unwrap()
    }

    #[test]
    fn power_comes_in_cores_tiles_or_chips() {
        let chip = |power_unit| Chip { power_unit, ..loihi1() };
        let placement = sequential(129);
        assert_eq!(powered_cores(&placement, &chip(PowerUnit::Core)), 129);
        assert_eq!(powered_cores(&placement, &chip(PowerUnit::Tile)), 132);
        assert_eq!(powered_cores(&placement, &chip(PowerUnit::Chip)), 256);
        let uneven = Chip { cores: 126, ..chip(PowerUnit::Tile) };
        let mesh = Mesh { cores_per_chip: 126, ..*placement.mesh() };
        let last = Placement::new(mesh, vec![mesh.site(125).unwrap()].into()).unwrap();
        assert_eq!(powered_cores(&last, &uneven), 2);
    }

    #[test]
    fn the_paper_s_594_cores_take_5_chips_and_5_x86_cores_when_filled_in_order() {
        let packed = Deployment::from_placement("packed", &sequential(594), &loihi1(), 32);
        let paper = paper();
        assert_eq!((packed.cores_used, packed.chips_used, packed.x86_cores()), (594, 5, 5));
        assert_eq!((paper.cores_used, paper.chips_used, paper.x86_cores()), (594, 5, 5));
        // Filled without gaps they would be 149 tiles; the paper's 624 powered cores are 156.
        assert_eq!((packed.tiles_used, packed.cores_powered), (149, 596));
        assert_eq!(paper.cores_powered, paper.tiles_used * 4);
    }
}
