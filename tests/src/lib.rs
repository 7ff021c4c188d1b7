//! What the end-to-end tests and `cargo xtask` share: set-up, images, QEMU, the simulated rig beside it.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod bench;
pub mod beside;
pub mod campaign;
pub mod cosim;
pub mod demo;
pub mod fuzz;
pub mod fuzzed;
pub mod images;
mod numbers;
pub mod peers;
mod pty;
pub mod qemu;
pub mod readme;
pub mod setup;
pub mod size;
pub mod soak;
pub mod stress;
pub mod study;
pub mod suite;
pub mod terminals;
pub mod timing;
pub mod tracking;
pub mod trial;
pub mod wire;

#[cfg(test)]
mod rules {
    //! Rules about the source that no lint knows.

    use std::path::{Path, PathBuf};

    fn sources(folder: &Path) -> Vec<PathBuf> {
        let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        entries.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] }).collect()
    }

    #[test]
    fn the_firmware_is_unsafe_at_start_up_and_in_qemu_only() {
        let root = crate::images::root().join("firmware/src");
        let allowed = ["board/fault.rs", "board/mod.rs", "board/retained.rs", "qemu/"];
        for path in sources(&root) {
            let text = std::fs::read_to_string(&path).unwrap();
            let name = path.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
            let uses = ["unsafe {", "unsafe fn", "unsafe impl", "unsafe extern", "#[unsafe("];
            if uses.iter().any(|word| text.contains(word)) {
                assert!(allowed.iter().any(|allowed| name.starts_with(allowed)), "{name} is unsafe");
            }
        }
    }
}
