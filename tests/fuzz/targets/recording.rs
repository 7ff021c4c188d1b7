//! Fuzz target: see `tests::fuzzed::recording`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::recording::run(data));
