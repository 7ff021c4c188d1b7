//! Fuzz target: see `tests::fuzzed::session`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::session::run(data));
