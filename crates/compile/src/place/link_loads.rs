//! Messages over the links of a board, in each of four directions.
//!
//! Input: routes with their rates. Output: the load of every link, the greatest and the sum. Routes
//! are added as differences at their ends, so the work does not depend on their length.

use nsim_ir::placement::Mesh;

/// Loads of the links of one direction: lines of tiles, each with a link between neighbours.
struct Lines {
    /// Number of tiles: one more than links of a line, so that a route can end at the last tile.
    length: usize,
    differences: Vec<i64>,
}

impl Lines {
    fn new(lines: u32, tiles: u32) -> Self {
        Lines { length: tiles as usize, differences: vec![0; lines as usize * tiles as usize] }
    }

    /// Adds a route from tile `low` to tile `high` of a line, `low <= high`.
    fn add(&mut self, line: u32, low: u32, high: u32, weight: i64) {
        let start = line as usize * self.length;
        self.differences[start + low as usize] += weight;
        self.differences[start + high as usize] -= weight;
    }

    /// The load of the link after each tile, line by line.
    fn each(&self) -> impl Iterator<Item = u64> {
        self.differences.chunks(self.length.max(1)).flat_map(|line| {
            line.iter().scan(0i64, |load, difference| {
                *load += difference;
                Some(*load as u64)
            })
        })
    }

    /// Greatest load, greatest load after every `of_chip` tiles, where a chip ends, and sum of
    /// loads; lines are of whole chips.
    fn loads(&self, of_chip: u32) -> [u64; 3] {
        let (mut most, mut between, mut sum) = (0, 0, 0);
        self.each().enumerate().for_each(|(tile, load)| {
            most = most.max(load);
            sum += load;
            if (tile + 1).is_multiple_of(of_chip.max(1) as usize) {
                between = between.max(load);
            }
        });
        [most, between, sum]
    }
}

/// Loads eastwards, westwards, southwards and northwards.
pub struct LinkLoads([Lines; 4]);

impl LinkLoads {
    /// Returns loads of 0 on all links of a board.
    pub fn new(mesh: &Mesh) -> Self {
        let (columns, rows) = (mesh.chips_x * mesh.width, mesh.chips_y * mesh.height);
        let (of_rows, of_columns) = (|| Lines::new(rows, columns), || Lines::new(columns, rows));
        LinkLoads([of_rows(), of_rows(), of_columns(), of_columns()])
    }

    /// Adds the route of messages from one tile to another, along its row first.
    pub fn add(&mut self, from: (u32, u32), to: (u32, u32), weight: i64) {
        let [east, west, south, north] = &mut self.0;
        let along_row = if from.0 <= to.0 { east } else { west };
        along_row.add(from.1, from.0.min(to.0), from.0.max(to.0), weight);
        let along_column = if from.1 <= to.1 { south } else { north };
        along_column.add(to.0, from.1.min(to.1), from.1.max(to.1), weight);
    }

    /// Adds other loads of the same board.
    pub fn merge(&mut self, other: &LinkLoads) {
        for (lines, others) in self.0.iter_mut().zip(&other.0) {
            lines.differences.iter_mut().zip(&others.differences).for_each(|(sum, other)| *sum += other);
        }
    }

    /// The greatest load, the greatest between two chips, and the sum of loads.
    pub fn greatest(&self, mesh: &Mesh) -> [u64; 3] {
        let of_chips = [mesh.width, mesh.width, mesh.height, mesh.height];
        let loads = self.0.iter().zip(of_chips).map(|(lines, of_chip)| lines.loads(of_chip));
        loads.fold([0, 0, 0], |[most, between, sum], load| [load[0].max(most), load[1].max(between), load[2] + sum])
    }

    /// The loads of both directions together: from each tile eastwards, row by row, and southwards,
    /// column by column.
    pub fn both_directions(&self) -> [Vec<u64>; 2] {
        let together = |a: &Lines, b: &Lines| a.each().zip(b.each()).map(|(a, b)| a + b).collect();
        let [east, west, south, north] = &self.0;
        [together(east, west), together(south, north)]
    }
}
