//! SLAYER's network configs.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| nsim::import::fuzz_entry::yaml(data));
