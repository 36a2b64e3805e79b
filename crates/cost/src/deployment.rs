//! Cores, chips and x86 cores of a job, on which power and time depend besides counts.
//!
//! Input: a placement and its target, or a published job's own numbers. Output: a [`Deployment`].
//! Invariant: each number is of all copies together.

use std::collections::BTreeMap;

use crate::job::DeployedCores;
pub use crate::job::{Host, Streams};
use crate::transport::{Timing, Transport, Words};
use nsim_ir::hardware::Target;
use nsim_ir::placement::Placement;

/// Work of the x86 cores of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HostWork {
    /// Source of the input spikes.
    pub host: Host,
    /// Input streams of a chip.
    pub streams: Streams,
    /// Words of a core that are set to zero after each sample; 0: no reset.
    pub reset_words: u64,
    /// Timesteps of a sample.
    pub steps_per_sample: u32,
}

impl Default for HostWork {
    fn default() -> Self {
        HostWork { host: Host::Stream, streams: Streams::One, reset_words: 0, steps_per_sample: 1 }
    }
}

impl HostWork {
    /// Returns the default work: x86 cores inject, where a chip has any in use.
    pub fn for_target(target: &Target) -> Self {
        let host = if target.chip().x86_cores_in_use > 0 { Host::Stream } else { Host::None };
        HostWork { host, ..HostWork::default() }
    }

    /// Returns the default work with the requested host, if any.
    ///
    /// # Errors
    /// The reason why a target has no such host: its chips keep no x86 core busy.
    pub fn fed_by(host: Option<Host>, target: &Target) -> Result<Self, String> {
        let usual = HostWork::for_target(target);
        match host {
            Some(host) if host != Host::None && usual.host == Host::None => {
                Err(format!("{}: {} uses no x86 core", host.name(), target.chip().hardware()))
            }
            host => Ok(HostWork { host: host.unwrap_or(usual.host), ..usual }),
        }
    }
}

/// The numbers on which power and time depend, for all copies together.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Deployment {
    /// Its name: `spread`, `packed`, `paper`, its file, or another origin.
    pub name: String,
    /// Copies of the network.
    pub copies: u32,
    /// Neuron cores in use.
    pub cores_used: u64,
    /// Tiles with a core in use, on the chip with most of them; they take part in its barrier.
    pub tiles_used: u64,
    /// Cores in use of the chip with most of them.
    pub chip_cores: u64,
    /// Chips with a core in use.
    pub chips_used: u64,
    /// Hops between chips of the barrier.
    pub chip_hops: u64,
    /// Chips on the board, whether in use or not.
    pub board_chips: u64,
    /// Source of the input spikes.
    pub host: Host,
    /// x86 cores that run a program.
    pub x86_cores: u64,
    /// Chips with such an x86 core.
    pub x86_chips: u64,
    /// x86 cores that inject or reset; the others wait.
    pub x86_working: u64,
    /// Input streams of the chip with most copies.
    pub streams: u64,
    /// Words that an x86 core sets to zero sequentially after a sample.
    pub reset: Words,
    /// Words besides spikes that the host sends to a chip in a sample.
    pub sent: Words,
}

/// Contents of the rows of the energy table.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RowCounts {
    /// Copies of the job, of which the row of neuron cores is one.
    pub copies: u64,
    /// x86 cores of the x86 row.
    pub x86_cores: u64,
    /// Number of such rows that the job's x86 cores would fill, at least 1.
    pub x86_rows: u64,
}

/// Numbers of the chip with most cores in use.
#[derive(Clone, Copy)]
struct FullestChip {
    cores: u64,
    tiles: u64,
    copies: u64,
}

/// Hops of a barrier between chips: across the board where it is full, else a square.
pub fn chip_hops(chips_used: u64, chips_x: u32, chips_y: u32) -> u64 {
    let (wide, high) = (u64::from(chips_x), u64::from(chips_y));
    if chips_used == wide * high {
        return wide + high - 2;
    }
    let side = (1..).find(|side| side * side >= chips_used).unwrap_or(1).max(1);
    (side - 1) + (chips_used.div_ceil(side).max(1) - 1)
}

impl Deployment {
    /// Returns the numbers of a mapping, whose placement has all copies.
    pub fn from_placement(
        name: impl Into<String>,
        placement: &Placement,
        target: &Target,
        copies: u32,
        work: HostWork,
    ) -> Self {
        let mut chips = BTreeMap::<u32, (u64, std::collections::BTreeSet<(u32, u32)>)>::new();
        for site in placement.sites() {
            let chip = chips.entry(site.chip).or_default();
            chip.0 += 1;
            chip.1.insert((site.x, site.y));
        }
        let most_cores = chips.values().map(|(cores, _)| *cores).max().unwrap_or(0);
        let tiles_used = chips.values().map(|(_, tiles)| tiles.len() as u64).max().unwrap_or(0);
        let (cores_used, chips_used) = (placement.len() as u64, chips.len() as u64);
        // The number of copies on a chip is proportional to its cores.
        let on_fullest = (most_cores * u64::from(copies)).div_ceil(cores_used.max(1)).max(1);
        let x86_cores = chips_used * u64::from(target.chip().x86_cores_in_use);
        let fullest = FullestChip { cores: most_cores, tiles: tiles_used, copies: on_fullest };
        Deployment::new(name, DeployedCores { cores_used, chips_used, x86_cores }, fullest, target, copies, work)
    }

    /// Returns the deployment for given numbers of cores, chips and x86 cores.
    pub fn from_numbers(
        name: impl Into<String>,
        cores: DeployedCores,
        target: &Target,
        copies: u32,
        work: HostWork,
    ) -> Self {
        let most_cores = cores.cores_used.div_ceil(cores.chips_used.max(1));
        let fullest = FullestChip {
            cores: most_cores,
            tiles: most_cores.div_ceil(target.chip().cores_per_tile.into()),
            copies: u64::from(copies).div_ceil(cores.chips_used.max(1)),
        };
        Deployment::new(name, cores, fullest, target, copies, work)
    }

    fn new(
        name: impl Into<String>,
        cores: DeployedCores,
        fullest: FullestChip,
        target: &Target,
        copies: u32,
        work: HostWork,
    ) -> Self {
        let DeployedCores { cores_used, chips_used, x86_cores } = cores;
        // Without a host an x86 core runs only to reset, and no host works without an x86 core.
        let x86_cores = if work.host == Host::None && work.reset_words == 0 { 0 } else { x86_cores };
        let host = if x86_cores == 0 { Host::None } else { work.host };
        Deployment {
            name: name.into(),
            copies,
            cores_used,
            tiles_used: fullest.tiles,
            chip_cores: fullest.cores,
            chips_used,
            chip_hops: chip_hops(chips_used, target.chips_x(), target.chips() / target.chips_x()),
            board_chips: target.chips().into(),
            host,
            x86_cores,
            x86_chips: x86_cores.min(chips_used),
            x86_working: x86_cores,
            streams: if work.streams == Streams::One { 1 } else { fullest.copies },
            reset: Words {
                count: if x86_cores > 0 { work.reset_words * fullest.cores } else { 0 },
                steps: work.steps_per_sample,
            },
            sent: Words::NONE,
        }
    }

    /// Copies and x86 cores that the rows of the table count: one copy has the whole job in its
    /// rows; of several copies a row is one copy, or one x86 core.
    pub fn rows_count(&self) -> RowCounts {
        let copies = u64::from(self.copies.max(1));
        let x86_cores = if copies == 1 { self.x86_cores } else { self.x86_cores.min(1) };
        RowCounts { copies, x86_cores, x86_rows: self.x86_cores.max(1) / x86_cores.max(1) }
    }

    /// Whether an x86 process takes a turn in each step.
    pub fn takes_turns(&self) -> bool {
        self.x86_cores > 0 && (self.host != Host::None || self.reset.count > 0)
    }

    /// Number of x86 cores that inject, take turns or reset.
    pub fn x86_at_work(&self) -> u64 {
        if self.host != Host::None || self.takes_turns() { self.x86_working } else { 0 }
    }

    /// Returns the timing of a step, where steps count spikes of `copies_counted` copies.
    pub fn timing(&self, transport: Transport, copies_counted: u32) -> Timing {
        Timing {
            transport,
            tiles_used: self.tiles_used,
            chip_cores: self.chip_cores,
            chip_hops: self.chip_hops,
            turn: self.takes_turns(),
            streams: if self.host == Host::Stream { self.streams } else { 0 },
            copies: copies_counted.max(1).into(),
            reset: self.reset,
            sent: self.sent,
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use nsim_ir::placement::Mesh;

    pub(crate) fn nahuku() -> Target {
        nsim_files::target::load_target("nahuku-32").unwrap()
    }

    /// The published deployment of the shipped model.
    pub(crate) fn paper() -> Deployment {
        let cores = DeployedCores { cores_used: 594, chips_used: 5, x86_cores: 5 };
        Deployment::from_numbers("paper", cores, &nahuku(), 32, HostWork::default())
    }

    pub(crate) fn sequential(cores: u32) -> Placement {
        let mesh = Mesh::for_target(&nahuku());
        let sites = (0..cores).map(|number| mesh.site(number).unwrap()).collect::<Vec<_>>();
        Placement::new(mesh, sites.into()).unwrap()
    }

    #[test]
    fn barriers_cross_the_board_where_it_is_full_and_else_a_square() {
        assert_eq!([1, 2, 5, 14, 22].map(|chips| chip_hops(chips, 8, 4)), [0, 1, 3, 6, 8]);
        assert_eq!(chip_hops(32, 8, 4), 10);
        assert_eq!((chip_hops(256, 4, 64), chip_hops(768, 12, 64)), (66, 74));
    }

    #[test]
    fn the_published_594_cores_fill_5_chips_in_order() {
        let work = HostWork { streams: Streams::Copies, ..HostWork::default() };
        let packed = Deployment::from_placement("packed", &sequential(594), &nahuku(), 32, work);
        let paper = paper();
        for deployment in [&packed, &paper] {
            assert_eq!((deployment.cores_used, deployment.chips_used, deployment.x86_cores), (594, 5, 5));
            assert_eq!((deployment.chip_hops, deployment.board_chips), (3, 32));
        }
        // The fullest chip has 128 of 594 cores, so 7 of 32 copies.
        assert_eq!((packed.tiles_used, packed.streams, paper.streams), (32, 7, 1));
    }

    #[test]
    fn without_a_host_no_x86_core_runs_and_nothing_is_injected() {
        let work = HostWork { host: Host::None, ..HostWork::default() };
        let alone = Deployment::from_placement("packed", &sequential(3), &nahuku(), 1, work);
        assert_eq!((alone.x86_cores, alone.x86_chips, alone.takes_turns()), (0, 0, false));
        assert_eq!(alone.timing(Transport::Analytic, 1).streams, 0);
        // One that resets runs, and a host without an x86 core does not.
        let resets = Deployment::from_placement("x", &sequential(3), &nahuku(), 1, HostWork { reset_words: 9, ..work });
        assert_eq!((resets.x86_at_work(), resets.reset.count, resets.host), (1, 27, Host::None));
        let cores = DeployedCores { cores_used: 1, chips_used: 1, x86_cores: 0 };
        let alone = Deployment::from_numbers("x", cores, &nahuku(), 1, HostWork::default());
        assert_eq!((alone.host, alone.x86_at_work(), alone.takes_turns()), (Host::None, 0, false));
    }
}
