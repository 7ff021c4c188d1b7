//! Fuzz target: see `tests::fuzzed::files`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::files::run(data));
