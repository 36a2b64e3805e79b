//! NumPy and safetensors arrays, event lists in CSV.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| nsim::import::fuzz_entry::arrays(data));
