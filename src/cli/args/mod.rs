//! Arguments that several commands share, and their meanings.

pub(super) mod columns;
pub(super) mod conversion;
pub(super) mod input;
pub(super) mod jobs;
pub(super) mod learning;
pub(super) mod reading;
pub(super) mod recording;
pub mod removed;
pub(super) mod saved;
pub(super) mod steps;
pub(super) mod values;
