//! Fuzz target: see `tests::fuzzed::device`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::device::run(data));
