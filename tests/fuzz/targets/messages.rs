//! Fuzz target: see `tests::fuzzed::messages`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::messages::run(data));
