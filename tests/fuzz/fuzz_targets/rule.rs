//! Learning rules.

#![no_main]

#[path = "../../common/mod.rs"]
mod common;

libfuzzer_sys::fuzz_target!(|data: &[u8]| common::fuzzed::rule(data));
