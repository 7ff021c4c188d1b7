//! Fuzz target: see `tests::fuzzed::receiver`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::receiver::run(data));
