//! The library that Python loads; the tests in Python are run by `cargo xtask test` on the library that this one has cargo build.
#![cfg(feature = "extension")]
#![forbid(unsafe_code)]

/// Function that Python calls when it imports `needle_guide._core`.
const ENTRY: &[u8] = b"PyInit__core";

#[test]
fn the_library_has_the_entry_of_its_module() {
    let test = std::env::current_exe().expect("this program");
    let library = test.with_file_name("libneedle_guide_core.so");
    let bytes = std::fs::read(&library).unwrap_or_else(|error| panic!("{}: {error}", library.display()));
    assert!(bytes.windows(ENTRY.len()).any(|window| window == ENTRY));
}
