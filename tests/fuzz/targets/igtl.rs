//! Fuzz target: see `system::fuzzed::igtl`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::igtl::run(data));
