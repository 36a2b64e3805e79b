//! Resources of a core, and their use by compartments.
//!
//! | count | file |
//! |---|---|
//! | use of a core, from its totals | `counter`, `packing`, `formats` |
//! | stored synapses, words of a core of Loihi 2 | `formats` |
//! | the totals of a finished partition | `exact`, from the order of `sorted_synapses` |
//! | the totals while a core is filled | `incremental` |
//! | the totals of a box of a layer | `closed_form`, `receptive_field`, `even_draws` |
//! | sources and targets of a compartment | `fan_in`, `fan_out` |
//! | lists that several input axons select | `axon_sharing` |

pub mod axon_sharing;
pub mod closed_form;
pub mod counter;
pub mod even_draws;
pub mod exact;
pub mod fan_in;
pub mod fan_out;
pub mod formats;
pub mod incremental;
pub mod packing;
pub mod receptive_field;
pub mod sorted_synapses;
