//! Fuzz target: see `system::fuzzed::images`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::images::run(data));
