//! Cores in classes.
//!
//! Input: a key of each core, equal for cores that store the same. Output: the class of each core,
//! and the first core of each class. Classes are numbered by their first cores.

use std::collections::HashMap;
use std::hash::Hash;

use nsim_ir::base::id::{ClassId, CoreId, IdVec};

/// Which core is of which class.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Classes {
    /// The class of each core.
    pub of: IdVec<CoreId, ClassId>,
    /// The first core of each class.
    pub firsts: IdVec<ClassId, CoreId>,
}

impl Classes {
    /// The classes of cores with these keys, in order of cores.
    pub fn by_key<K: Hash + Eq>(keys: impl Iterator<Item = K>) -> Self {
        let (mut known, mut classes) = (HashMap::new(), Classes::default());
        for (core, key) in (0..).map(CoreId).zip(keys) {
            let class = *known.entry(key).or_insert_with(|| classes.firsts.push(core));
            classes.of.push(class);
        }
        classes
    }

    /// The first core of the class of a core.
    pub fn first(&self, core: CoreId) -> CoreId {
        self.firsts[self.of[core]]
    }
}
