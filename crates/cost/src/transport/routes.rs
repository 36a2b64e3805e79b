//! Links that the messages of a program cross, and the messages that meet.
//!
//! Input: a program, or the program of one group for each kind of identical groups of cores
//! ([`CoreGroups`]). Output: [`MessageRoutes`]: for each source its messages, and the regions of
//! chips on which messages meet. Counts cover all groups.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::ops::Range;
use std::sync::OnceLock;

use petgraph::unionfind::UnionFind;
use rayon::prelude::*;

use crate::constants::CostTable;
use crate::model::{route_time, sum_of_cores, times};
use nsim_ir::activity::{CoreCounts, HopCounts, StepActivity};
use nsim_ir::base::csr::Csr;
use nsim_ir::base::id::{ChannelId, CoreId, Id};
use nsim_ir::groups::{CoreGroups, Kind};
use nsim_ir::partition::Seat;
use nsim_ir::placement::{Mesh, Route, Site};
use nsim_ir::program::{AxonTarget, Program};

/// One message that a spike of some source sends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Message {
    pub(super) core: CoreId,
    pub(super) events_dense: u32,
    pub(super) events_sparse: u32,
}

/// Routes of a program's messages, and of the messages of identical groups of cores.
///
/// Messages wait for each other within a region, the chips that exchange them; messages of
/// different regions never meet. Of identical regions one is simulated.
#[derive(Debug, Clone)]
pub struct MessageRoutes {
    pub(super) kinds: Vec<KindOfGroup>,
    /// One region of each kind.
    pub(super) regions: Vec<Region>,
    /// Messages by channel.
    pub(super) inputs: Csr<Message>,
    /// Messages by compartment.
    pub(super) spikes: Csr<Message>,
    /// Core, slot, and number of compartments of that core, by compartment.
    pub(super) seats: Vec<(CoreId, u32, u32)>,
    /// Links that a spike's messages cross in all groups: by channel, then by compartment. Empty
    /// for a whole program, whose steps have these counts.
    pub(super) crossed: Vec<CrossedLinks>,
    /// Times of input spikes under the first requested preset, if [`InputTimes::new`] has them.
    pub(super) input_times: OnceLock<Option<InputTimes>>,
}

/// Times of the only message of an input spike.
#[derive(Debug, Clone, Copy)]
pub(super) struct InputTime {
    /// The receiving core.
    pub(super) to: u32,
    /// Handling time at the receiver.
    pub(super) handling: u64,
    /// Time from the port, through the empty mesh, until it is handled.
    pub(super) through: u64,
}

/// Times of the input spikes of each channel under a preset.
#[derive(Debug, Clone)]
pub(super) struct InputTimes {
    table: CostTable,
    /// Times by channel; `None` where it sends nothing.
    pub(super) channels: Vec<Option<InputTime>>,
    /// The longest time through the mesh.
    pub(super) longest: u64,
}

impl InputTimes {
    /// The times for one group of cores on one chip, each input sending at most one message.
    fn new(routes: &MessageRoutes, table: &CostTable) -> Option<Self> {
        let ([_], [region]) = (routes.kinds.as_slice(), routes.regions.as_slice()) else { return None };
        if !region.is_simple() {
            return None;
        }
        let time = |list: &[Message]| match list {
            [] => Some(None),
            [message] => {
                let to = message.core.index();
                let handling = message.handling(table);
                let through = route_time(region.entries[to].1, table).0.saturating_add(handling);
                Some(Some(InputTime { to: to as u32, handling, through }))
            }
            _ => None,
        };
        let lists = (0..routes.inputs.len()).map(|channel| routes.inputs.get(channel));
        let channels = lists.map(time).collect::<Option<Vec<_>>>()?;
        let longest = channels.iter().flatten().map(|time| time.through).max().unwrap_or(0);
        Some(InputTimes { table: table.clone(), channels, longest })
    }
}

impl Message {
    /// Its handling time at the receiver, ps.
    pub(super) fn handling(&self, table: &CostTable) -> u64 {
        let counts = [
            (table.axon_in_time, 1),
            (table.synapse_dense_time, self.events_dense.into()),
            (table.synapse_sparse_time, self.events_sparse.into()),
        ];
        times(&counts).0
    }
}

/// A kind of groups of cores, and its number of groups.
#[derive(Debug, Clone)]
pub(super) struct KindOfGroup {
    pub(super) kind: Kind,
    pub(super) groups: u64,
}

/// Links that messages cross.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct CrossedLinks {
    pub(super) hops: HopCounts,
    pub(super) longest: Route,
}

/// Chips that exchange messages with no other chips.
///
/// Senders are the cores, then the port of each chip for its inputs: the chip's corner.
#[derive(Debug, Clone)]
pub(super) struct Region {
    pub(super) columns: u32,
    pub(super) rows: u32,
    pub(super) chip_width: u32,
    pub(super) chip_height: u32,
    pub(super) chips_x: u32,
    /// Tile of each sender.
    pub(super) tiles: Vec<(u32, u32)>,
    pub(super) cores: usize,
    /// Kind of each group of cores and its first core here.
    pub(super) groups: Vec<(usize, usize)>,
    /// For each core, the port through which its inputs enter, and their route from there.
    pub(super) entries: Vec<(usize, Route)>,
    /// Whether each link joins two chips.
    pub(super) between: Vec<bool>,
}

/// Number of sources of a piece, whose messages one thread looks up.
const PIECE: u32 = 1 << 12;
/// Number of pieces of each thread that are joined in one call, which bounds their memory.
const PIECES: usize = 4;

/// Returns the messages of each of these sources, which are numbered channels first.
fn messages(program: &Program, sources: Range<u32>) -> Csr<Message> {
    let message = |AxonTarget { core, axon }| {
        let class = program.class_of(core);
        let (events_dense, events_sparse) = class.dense_and_sparse(class.inputs.get(usize::from(axon)).stored);
        Message { core, events_dense, events_sparse }
    };
    let piece = |&first: &u32| {
        let mut piece = Csr::default();
        for source in first..sources.end.min(first.saturating_add(PIECE)) {
            piece.push(program.messages(source).map(message));
        }
        piece
    };
    let mut all = Csr::default();
    let pieces: Vec<u32> = sources.clone().step_by(PIECE as usize).collect();
    for some in pieces.chunks(PIECES * rayon::current_num_threads()) {
        let lists: Vec<Csr<Message>> = some.par_iter().map(piece).collect();
        lists.iter().flat_map(Csr::iter).for_each(|list| all.push(list.iter().copied()));
    }
    all.shrink_to_fit();
    all
}

/// What identical regions have in common.
#[derive(PartialEq, Eq, Hash)]
struct RegionShape {
    chips_x: u32,
    chips_y: u32,
    /// Kind of each group, and tile of each of its cores.
    groups: Vec<(usize, Vec<(u32, u32)>)>,
}

/// The least number, and the length of the range to the greatest.
fn extent(numbers: impl Iterator<Item = u32> + Clone) -> (u32, u32) {
    let low = numbers.clone().min().unwrap_or(0);
    (low, numbers.max().unwrap_or(0) - low + 1)
}

impl RegionShape {
    fn new(mesh: Mesh, groups: &[(usize, &[Site])]) -> Self {
        let chips = groups.iter().flat_map(|(_, sites)| sites.iter()).map(|site| site.chip);
        let (left, chips_x) = extent(chips.clone().map(|chip| chip % mesh.chips_x));
        let (top, chips_y) = extent(chips.map(|chip| chip / mesh.chips_x));
        let tile = |site: &Site| {
            let (x, y) = mesh.tile(*site);
            (x - left * mesh.width, y - top * mesh.height)
        };
        let groups = groups.iter().map(|(kind, sites)| (*kind, sites.iter().map(tile).collect()));
        RegionShape { chips_x, chips_y, groups: groups.collect() }
    }

    fn region(&self, mesh: Mesh) -> Region {
        let RegionShape { chips_x, chips_y, .. } = *self;
        let (mut groups, mut tiles) = (Vec::new(), Vec::new());
        for (kind, of_group) in &self.groups {
            groups.push((*kind, tiles.len()));
            tiles.extend_from_slice(of_group);
        }
        let cores = tiles.len();
        tiles.extend((0..chips_x * chips_y).map(|chip| (chip % chips_x * mesh.width, chip / chips_x * mesh.height)));
        Region {
            columns: chips_x * mesh.width,
            rows: chips_y * mesh.height,
            chip_width: mesh.width,
            chip_height: mesh.height,
            chips_x,
            tiles,
            cores,
            groups,
            entries: Vec::new(),
            between: Vec::new(),
        }
        .with_entries()
    }
}

/// Joins the chips that exchange messages, and those that their messages cross.
fn joined_chips(mesh: Mesh, groups: &[(usize, &[Site])]) -> UnionFind<usize> {
    let mut joined = UnionFind::new((mesh.chips_x * mesh.chips_y) as usize);
    for (_, sites) in groups {
        let chips: BTreeSet<u32> = sites.iter().map(|site| site.chip).collect();
        chips.iter().zip(chips.iter().skip(1)).for_each(|(&one, &next)| _ = joined.union(one as usize, next as usize));
        // Messages between chips cross the chips in between, along the row first.
        let pairs = chips.iter().flat_map(|&from| chips.iter().map(move |&to| (from, to)));
        for (from, to) in pairs.filter(|_| groups.len() > 1) {
            let corner = from / mesh.chips_x * mesh.chips_x + to % mesh.chips_x;
            let row = from.min(corner)..=from.max(corner);
            let column = (corner.min(to)..=corner.max(to)).step_by(mesh.chips_x as usize);
            row.chain(column).for_each(|chip| _ = joined.union(from as usize, chip as usize));
        }
    }
    joined
}

/// Returns the regions of groups on a board: the first of identical ones, with their number.
fn regions(mesh: Mesh, groups: &[(usize, &[Site])]) -> Vec<(Region, u64)> {
    let mut joined = joined_chips(mesh, groups);
    let mut members: BTreeMap<usize, Vec<(usize, &[Site])>> = BTreeMap::new();
    for group in groups {
        if let Some(site) = group.1.first() {
            members.entry(joined.find_mut(site.chip as usize)).or_default().push(*group);
        }
    }
    let mut regions: Vec<(Region, u64)> = Vec::new();
    let mut known: HashMap<RegionShape, usize> = HashMap::new();
    for groups in members.values() {
        let shape = RegionShape::new(mesh, groups);
        if let Some(&first) = known.get(&shape) {
            regions[first].1 += 1;
            continue;
        }
        regions.push((shape.region(mesh), 1));
        known.insert(shape, regions.len() - 1);
    }
    regions
}

impl MessageRoutes {
    /// The routes of a program's messages.
    pub fn of_program(program: &Program) -> Self {
        let kind = Kind {
            cores: 0..program.cores().len() as u32,
            channels: 0..program.channels(),
            compartments: 0..program.compartments(),
            copies: 1,
        };
        let sites: Vec<Site> = program.cores().iter().map(|image| image.site).collect();
        MessageRoutes::new(program, &[kind], &[(0, &sites)])
    }

    /// The routes of the messages of all groups, with the numbers of their common program.
    pub fn of_groups(groups: &CoreGroups) -> Self {
        let of_group = groups.groups.iter().map(|group| (group.kind, group.sites.as_slice()));
        MessageRoutes::new(&groups.program, &groups.kinds, &of_group.collect::<Vec<_>>())
    }

    fn new(program: &Program, kinds: &[Kind], groups: &[(usize, &[Site])]) -> Self {
        let cores = program.cores();
        let all = program.channels() + program.compartments();
        let (inputs, spikes) = (messages(program, 0..program.channels()), messages(program, program.channels()..all));
        let seat = |seat: &Seat| (seat.core, u32::from(seat.slot), cores[seat.core].ids.len() as u32);
        let seats = program.seats().iter().map(seat).collect();
        let of_kind = |kind| groups.iter().filter(|group| group.0 == kind).count() as u64;
        let kinds = kinds.iter().enumerate();
        let kinds = kinds.map(|(number, kind)| KindOfGroup { kind: kind.clone(), groups: of_kind(number) });
        let (kinds, regions) = (kinds.collect(), regions(*program.mesh(), groups));
        let (crossed, input_times) = (Vec::new(), OnceLock::new());
        let mut routes = MessageRoutes { kinds, regions: Vec::new(), inputs, spikes, seats, crossed, input_times };
        if groups.len() > 1 {
            routes.crossed = routes.crossed_links(&regions);
        }
        routes.regions = regions.into_iter().map(|(region, _)| region).collect();
        routes
    }

    /// Links that a spike's messages cross, by channel and then by compartment.
    fn crossed_links(&self, regions: &[(Region, u64)]) -> Vec<CrossedLinks> {
        let mut crossed = vec![CrossedLinks::default(); self.inputs.len() + self.spikes.len()];
        for (region, times) in regions {
            for &(kind, first) in &region.groups {
                let Kind { cores, channels, compartments, .. } = &self.kinds[kind].kind;
                let in_region = |core: CoreId| first + core.index() - cores.start as usize;
                let mut add = |source: usize, from: Option<CoreId>, list: &[Message]| {
                    let CrossedLinks { hops, longest } = &mut crossed[source];
                    for message in list {
                        let to = in_region(message.core);
                        let route = region.route(from.map_or_else(|| region.port(to), in_region), to);
                        hops.add_routes(route, *times);
                        *longest = longest.max(route);
                    }
                };
                for channel in channels.start as usize..channels.end as usize {
                    add(channel, None, self.inputs.get(channel));
                }
                for compartment in compartments.start as usize..compartments.end as usize {
                    let list = self.spikes.get(compartment);
                    add(self.inputs.len() + compartment, Some(self.seats[compartment].0), list);
                }
            }
        }
        crossed
    }

    /// Times of input spikes under a preset, where they are known without simulation.
    pub(super) fn input_times(&self, table: &CostTable) -> Option<&InputTimes> {
        let times = self.input_times.get_or_init(|| InputTimes::new(self, table)).as_ref();
        times.filter(|times| times.table == *table)
    }

    /// Whether the program represents no other groups of cores.
    fn is_whole(&self) -> bool {
        self.crossed.is_empty()
    }

    /// The counts of all cores of all groups in a step.
    pub fn sum_of_cores(&self, step: &StepActivity) -> CoreCounts {
        if self.is_whole() {
            return sum_of_cores(step.cores.as_slice());
        }
        let mut all = CoreCounts::default();
        for KindOfGroup { kind, groups } in &self.kinds {
            let of_kind = kind.cores.start as usize..kind.cores.end as usize;
            all += sum_of_cores(&step.cores.as_slice()[of_kind]).times(*groups);
        }
        all
    }

    /// The links that the messages of all groups cross in a step.
    pub fn hops(&self, step: &StepActivity) -> HopCounts {
        self.crossed_links_in(step).hops
    }

    pub(super) fn crossed_links_in(&self, step: &StepActivity) -> CrossedLinks {
        let mut all = CrossedLinks { hops: step.hops, longest: step.longest };
        if !self.is_whole() {
            all = CrossedLinks::default();
            let channels = step.channels.iter().map(|channel| channel.index());
            let fired = step.fired.iter().map(|compartment| self.inputs.len() + compartment.index());
            for source in channels.chain(fired) {
                all.hops += self.crossed[source].hops;
                all.longest = all.longest.max(self.crossed[source].longest);
            }
        }
        all
    }

    /// The input spikes of all groups in a step.
    pub(super) fn spikes_in(&self, step: &StepActivity) -> u64 {
        match &*self.kinds {
            [kind] => step.spikes_in * kind.groups,
            kinds => {
                let of = |channel: &ChannelId| kinds.iter().find(|kind| kind.kind.channels.contains(&channel.0));
                step.channels.iter().filter_map(of).map(|kind| kind.groups).sum()
            }
        }
    }
}

impl Region {
    /// This region with the entries of its cores and the kinds of its links.
    pub(super) fn with_entries(mut self) -> Self {
        let entry = |core| (self.port_of(core), self.route(self.port_of(core), core));
        self.entries = (0..self.cores).map(entry).collect();
        self.between = self.between_chips();
        self
    }

    /// Whether it is one group of cores with one port.
    fn is_simple(&self) -> bool {
        self.groups == [(0, 0)] && self.tiles.len() == self.cores + 1
    }

    /// The port through which a core's inputs enter.
    pub(super) fn port(&self, core: usize) -> usize {
        self.entries[core].0
    }

    fn port_of(&self, core: usize) -> usize {
        let (x, y) = self.tiles[core];
        self.cores + (y / self.chip_height * self.chips_x + x / self.chip_width) as usize
    }

    pub(super) fn route(&self, from: usize, to: usize) -> Route {
        let ((fx, fy), (tx, ty)) = (self.tiles[from], self.tiles[to]);
        let chip = (fx / self.chip_width).abs_diff(tx / self.chip_width)
            + (fy / self.chip_height).abs_diff(ty / self.chip_height);
        Route { east_west: fx.abs_diff(tx), north_south: fy.abs_diff(ty), chip }
    }

    /// By direction (east, west, south, north): tiles of a chip, of the region, and lines.
    fn lines(&self) -> [(u32, u32, u32); 4] {
        let (rows, columns) = ((self.chip_width, self.columns, self.rows), (self.chip_height, self.rows, self.columns));
        [rows, rows, columns, columns]
    }

    /// Number of links between tiles. They are numbered by direction, then by the line of tiles
    /// along it, then in the order in which messages cross them.
    pub(super) fn links(&self) -> usize {
        4 * (self.columns * self.rows) as usize
    }

    /// Whether each link joins two chips; no link leads to the first tile of a line.
    pub(super) fn between_chips(&self) -> Vec<bool> {
        let mut between = Vec::with_capacity(self.links());
        for (direction, (chip, tiles, lines)) in self.lines().into_iter().enumerate() {
            for at in (0..lines).flat_map(|_| 0..tiles) {
                let crossed = if direction % 2 == 0 { at } else { tiles - at };
                between.push(at > 0 && crossed.is_multiple_of(chip));
            }
        }
        between
    }

    /// The links on a message's route, along its row first, each part in the order of crossing.
    pub(super) fn path(&self, from: usize, to: usize) -> [Range<usize>; 2] {
        let ((fx, fy), (tx, ty)) = (self.tiles[from], self.tiles[to]);
        let part = |direction: u32, (at, to): (u32, u32), line: u32, tiles: u32| {
            let (begin, back) = (line * tiles, u32::from(to < at));
            let first = (direction + back) * self.columns * self.rows + begin;
            let place = |tile: u32| if back == 1 { tiles - 1 - tile } else { tile };
            (first + place(at) + 1) as usize..(first + place(to) + 1) as usize
        };
        [part(0, (fx, tx), fy, self.columns), part(2, (fy, ty), tx, self.rows)]
    }

    /// Number of messages over the busiest link of a chip, and over the busiest between chips.
    pub(super) fn busiest_links(&self, routes: &MessageRoutes, step: &StepActivity) -> [u32; 2] {
        if step.channels.is_empty() && step.fired.is_empty() {
            return [0; 2];
        }
        // Difference arrays over rows (east, west) and columns (south, north): +1 where a message
        // enters a line of tiles, -1 where it leaves. So the cost does not grow with the route.
        let (columns, rows) = (self.columns as usize, self.rows as usize);
        let mut lines = [(); 4].map(|()| vec![0i32; columns * rows]);
        self.each_message(routes, step, |sender, to, _| {
            let ((fx, fy), (tx, ty)) = (self.tiles[sender], self.tiles[to]);
            let mut add = |direction: usize, line: usize, from: u32, to: u32| {
                lines[direction][line + from as usize] += 1;
                lines[direction][line + to as usize] -= 1;
            };
            add(usize::from(fx > tx), fy as usize * columns, fx.min(tx), fx.max(tx));
            add(2 + usize::from(fy > ty), tx as usize * rows, fy.min(ty), fy.max(ty));
        });
        let mut busiest = [0; 2];
        for (direction, line) in lines.iter().enumerate() {
            let (length, of_chip) = if direction < 2 { (columns, self.chip_width) } else { (rows, self.chip_height) };
            for tiles in line.chunks(length.max(1)) {
                let mut load = 0;
                for (tile, difference) in (1..).zip(tiles) {
                    load += difference;
                    let most: &mut u32 = &mut busiest[usize::from(tile % of_chip.max(1) == 0)];
                    *most = (*most).max(load as u32);
                }
            }
        }
        busiest
    }

    /// Calls `see` with sender, receiver and message of every message of a step.
    pub(super) fn each_message(
        &self,
        routes: &MessageRoutes,
        step: &StepActivity,
        mut see: impl FnMut(usize, usize, &Message),
    ) {
        for &(kind, first) in &self.groups {
            let Kind { cores, channels, compartments, .. } = &routes.kinds[kind].kind;
            let in_region = |core: CoreId| first + core.index() - cores.start as usize;
            for channel in step.channels.iter().filter(|channel| channels.contains(&channel.0)) {
                for message in routes.inputs.get(channel.index()) {
                    let to = in_region(message.core);
                    see(self.port(to), to, message);
                }
            }
            for compartment in step.fired.iter().filter(|compartment| compartments.contains(&compartment.0)) {
                let sender = in_region(routes.seats[compartment.index()].0);
                routes.spikes.get(compartment.index()).iter().for_each(|m| see(sender, in_region(m.core), m));
            }
        }
    }

    /// Returns the port, from 0, of the first message of each input spike, in the order of spikes.
    pub(super) fn ports<'a>(
        &'a self,
        routes: &'a MessageRoutes,
        step: &'a StepActivity,
    ) -> impl Iterator<Item = usize> + 'a {
        self.groups.iter().flat_map(move |&(kind, first)| {
            let Kind { cores, channels, .. } = &routes.kinds[kind].kind;
            step.channels.iter().filter(|channel| channels.contains(&channel.0)).map(move |channel| {
                let entered = routes.inputs.get(channel.index()).first();
                entered.map_or(0, |message| self.port(first + message.core.index() - cores.start as usize) - self.cores)
            })
        })
    }

    /// Number of input spikes at the port with most of them.
    pub(super) fn most_spikes(&self, routes: &MessageRoutes, step: &StepActivity) -> u64 {
        if routes.kinds.len() == 1 && self.is_simple() {
            return step.channels.len() as u64;
        }
        let mut spikes = vec![0; self.tiles.len() - self.cores + 1];
        self.ports(routes, step).for_each(|port| spikes[port] += 1);
        spikes.into_iter().max().unwrap_or(0)
    }
}
