//! PyTorch checkpoints in both containers, through import.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| nsim::import::fuzz_entry::checkpoint(data));
