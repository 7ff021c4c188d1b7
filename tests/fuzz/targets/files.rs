//! Fuzz target: see `system::fuzzed::files`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| system::fuzzed::files::run(data));
