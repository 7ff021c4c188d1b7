//! Fuzz target: see `system::fuzzed::device`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::device::run(data));
