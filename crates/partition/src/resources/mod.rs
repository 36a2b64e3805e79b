//! What a core has, and what compartments use of it.

pub mod axon_sharing;
pub mod by_core;
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
