//! Spikes from files: arrays, lists, recordings of events, data sets.
//!
//! Input: a path. Output: [`PopulationSpikes`] of each sample, for one input population.
//! [`crate::kind`] detects the format of a file; `source` is the entry point. It calls the readers:
//! [`manifest`] reads data sets with the readers of `recordings`, which are `array`, `npz`,
//! [`csv`], `folder` and [`events`].

mod array;
pub mod csv;
pub mod events;
mod folder;
pub mod labels;
pub mod manifest;
pub(crate) mod npz;
pub mod options;
mod population;
mod recordings;
mod source;

pub use self::folder::{MANIFEST, list_folder};
pub use self::manifest::{Manifest, read_manifest};
pub use self::options::{EventOptions, Origin, Polarity, TimeUnit};
pub use self::population::{InputSpec, PopulationSpikes};
pub use self::recordings::warning_of_changes;
pub use self::source::{read_source, read_spikes};
pub use crate::kind::EventFormat;
