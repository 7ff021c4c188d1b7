//! Fuzz target: see `system::fuzzed::messages`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::messages::run(data));
