//! Event recordings: the first byte chooses the format.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| nsim::import::fuzz_entry::events(data));
