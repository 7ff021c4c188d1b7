//! Builds of different selections of crates share what they are made of: the libraries below them have one set of features each.

#![allow(missing_docs, clippy::unwrap_used)]

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

/// Sets of features by library: more than one where a compiler's plug-in needs it too.
type Features = BTreeMap<String, BTreeSet<String>>;

/// The sets that cargo resolves for a selection.
fn resolved(selection: &[&str]) -> Features {
    let output = Command::new(env!("CARGO"))
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .args(["tree", "--locked", "--prefix", "none", "--format", "{p}|{f}"])
        .args(selection)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let mut features = Features::new();
    for line in text.lines().filter(|line| !line.is_empty()) {
        let (library, set) = line.trim_end_matches(" (*)").split_once('|').unwrap();
        features.entry(library.to_owned()).or_default().insert(set.to_owned());
    }
    features
}

#[test]
fn program_module_studies_and_single_crates_are_built_of_what_the_workspace_is() {
    let workspace = resolved(&["--workspace"]);
    assert!(workspace.len() > 200, "{}", workspace.len());
    let selections: [&[&str]; 8] = [
        &["--package", "host", "--edges", "no-dev"],
        &["--package", "studies", "--edges", "no-dev"],
        &["--package", "needle-guide", "--features", "extension", "--edges", "no-dev"],
        &["--package", "mechanics"],
        &["--package", "inference"],
        &["--package", "diagnose"],
        &["--package", "steering"],
        &["--package", "host"],
    ];
    for selection in selections {
        for (library, sets) in resolved(selection) {
            let Some(workspace_sets) = workspace.get(&library) else { continue };
            // The module is empty in the workspace: its own features are for it alone.
            if library.starts_with("needle-guide ") {
                continue;
            }
            let added: Vec<&String> = sets.difference(workspace_sets).collect();
            assert!(
                added.is_empty(),
                "{selection:?}: {library} with the features {added:?}, in the workspace with {workspace_sets:?}: a library that needs more than \
                 `host/features/Cargo.toml` states has it stated there"
            );
        }
    }
}
