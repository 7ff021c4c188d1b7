//! The engine serves any rig: no word of one is in it.

use std::path::{Path, PathBuf};

/// All files of a folder and of those in it.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path());
    entries.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

#[test]
fn the_engine_knows_no_needle() {
    let sources = files(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    assert!(sources.len() > 20);
    for path in sources {
        let text = std::fs::read_to_string(&path).expect("a text").to_lowercase();
        for word in ["needle", "tissue", "insertion", "guide", "modulus"] {
            let line = text.lines().position(|line| line.contains(word));
            assert_eq!(line, None, "{}: {word} in the line after this number", path.display());
        }
    }
}
