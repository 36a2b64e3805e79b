//! Groups of a mapping's cores: no copy on them shares a core with copies of other groups.
//!
//! Input: a mapping of several copies. Output: its [`CoreGroups`], so that one group of each kind
//! can be run in place of all.

use petgraph::unionfind::UnionFind;

use crate::mapping::Mapping;
use nsim_ir::base::id::{CompartmentId, CoreId, Id};
use nsim_ir::groups::{CopySizes, CoreGroups, GroupMembers};

impl Mapping {
    /// Sizes of one copy.
    pub fn one_copy(&self) -> CopySizes {
        let one = &self.one;
        let populations = one.populations().len() as u32;
        CopySizes { compartments: one.compartments(), channels: one.channels(), populations }
    }

    /// Groups of cores and copies that belong together, ordered by their first core.
    pub fn together(&self) -> Vec<GroupMembers> {
        let (program, one) = (&self.program, self.one.compartments());
        let mut joined = UnionFind::new(program.cores().len());
        let first = |copy: u32| program.seats()[CompartmentId(copy * one)].core.index();
        for (core, image) in program.cores().iter().enumerate() {
            image.ids.iter().for_each(|id| _ = joined.union(core, first(id.0 / one)));
        }
        let mut groups: Vec<GroupMembers> = Vec::new();
        let mut number = vec![None; program.cores().len()];
        for core in 0..program.cores().len() {
            let group = *number[joined.find(core)].get_or_insert(groups.len());
            groups.resize(groups.len().max(group + 1), GroupMembers::default());
            groups[group].cores.push(CoreId::new(core));
        }
        for copy in 0..self.options.copies {
            if let Some(group) = number[joined.find(first(copy))] {
                groups[group].copies.push(copy);
            }
        }
        groups
    }

    /// The groups of its cores; `None` for a single copy, and where no two groups are of one kind.
    pub fn core_groups(&self) -> Option<CoreGroups> {
        if self.options.copies < 2 {
            return None;
        }
        let groups = CoreGroups::new(&self.program, self.one_copy(), &self.together()).ok()?;
        (groups.kinds.len() < groups.groups.len()).then_some(groups)
    }
}
