//! Fuzz target: see `tests::fuzzed::igtl`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| tests::fuzzed::igtl::run(data));
