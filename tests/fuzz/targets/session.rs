//! Fuzz target: see `system::fuzzed::session`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::session::run(data));
