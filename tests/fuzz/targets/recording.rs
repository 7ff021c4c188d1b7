//! Fuzz target: see `system::fuzzed::recording`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::recording::run(data));
