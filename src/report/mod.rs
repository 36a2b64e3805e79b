//! Results as text for people, JSON for scripts and CSV for spreadsheets.
//!
//! In come values of the stages below; out go strings. Nothing is computed here that another stage could need.

pub mod map;
