//! Fuzz target: see `sequences::run_bytes`.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| sequences::run_bytes(data));
