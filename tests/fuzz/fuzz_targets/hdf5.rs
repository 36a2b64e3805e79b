//! netx, NIR and any other HDF5 file, through import.

#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| nsim::import::fuzz_entry::hdf5(data));
