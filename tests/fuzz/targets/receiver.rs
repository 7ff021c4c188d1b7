//! Fuzz target: see `system::fuzzed::receiver`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::receiver::run(data));
