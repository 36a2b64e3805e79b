//! Recordings of event cameras and tactile sensors, streamed into spikes.
//!
//! Input: a file in one of the formats below, and [`super::options::EventOptions`]. Output: the
//! spikes of one sample and [`event::Counts`]. Each event passes from a buffered reader through
//! crop, pool, polarity and binning into a table of the occupied bins. So memory grows with the
//! resulting spikes, not with the file. Events outside the window are counted as dropped. Events
//! earlier than a previous one are counted as out of order and added to the bin of their time.
//!
//! Formats: `address` (N-MNIST `.bin`, SLAYER `.bs1` and `.bs2`, Prophesee `.dat`), `evt`
//! (Prophesee EVT2 and EVT3), `aedat` (AEDAT4), `tact` (VT_SNN's NeuTouch text), [`mod@text`] (CSV
//! with a header of x, y and time), [`nir_data`] (NIR's event and time-gridded data, which are
//! arrays, not streams).

mod address;
pub(crate) mod aedat;
mod bins;
pub mod event;
mod evt;
pub mod nir_data;
pub mod read;
mod tact;
pub mod text;
