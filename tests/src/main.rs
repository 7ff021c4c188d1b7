//! `cargo xtask`: sets up what is missing, builds, tests and demonstrates the whole system.
fn main() {}
