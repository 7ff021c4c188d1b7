//! Rules about the source and what it is built from that no lint checks.

use crate::images::{cargo, root};
use serde_json::Value;
use spdx::{Expression, ParseMode};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn sources(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] }).collect()
}

#[test]
fn the_firmware_is_unsafe_at_start_up_and_in_qemu_only() {
    let root = root().join("firmware/src");
    let allowed = ["board/fault.rs", "board/guard.rs", "board/mod.rs", "board/retained.rs", "qemu/"];
    for path in sources(&root) {
        let text = std::fs::read_to_string(&path).unwrap();
        let name = path.strip_prefix(&root).unwrap().to_string_lossy().into_owned();
        let uses = ["unsafe {", "unsafe fn", "unsafe impl", "unsafe extern", "#[unsafe("];
        if uses.iter().any(|word| text.contains(word)) {
            assert!(allowed.iter().any(|allowed| name.starts_with(allowed)), "{name} is unsafe");
        }
    }
}

/// Every other crate forbids it.
#[test]
fn all_crates_but_the_firmware_forbid_unsafe_code() {
    for package in packages().iter().filter(|package| package["source"].is_null()) {
        let name = package["name"].as_str().unwrap();
        for target in
            package["targets"].as_array().unwrap().iter().filter(|target| target["kind"][0] == "lib")
        {
            let text = std::fs::read_to_string(target["src_path"].as_str().unwrap()).unwrap();
            assert!(name == "firmware" || text.contains("#![forbid(unsafe_code)]"), "{name}");
        }
    }
}

/// All packages that the workspace is built from on a Linux machine.
fn packages() -> Vec<Value> {
    let output = cargo()
        .args([
            "metadata",
            "--format-version",
            "1",
            "--locked",
            "--filter-platform",
            "x86_64-unknown-linux-gnu",
        ])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let resolved: BTreeSet<&str> = metadata["resolve"]["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .filter_map(|node| node["id"].as_str())
        .collect();
    let all = metadata["packages"].as_array().unwrap();
    all.iter().filter(|package| resolved.contains(package["id"].as_str().unwrap())).cloned().collect()
}

#[test]
fn everything_has_a_licence_that_deny_toml_allows_and_comes_from_the_registry() {
    let text = std::fs::read_to_string(root().join("deny.toml")).unwrap();
    let config: toml::Table = toml::from_str(&text).unwrap();
    let allowed: BTreeSet<String> = config["licenses"]["allow"]
        .as_array()
        .unwrap()
        .iter()
        .map(|licence| licence.as_str().unwrap().to_owned())
        .collect();
    let packages = packages();
    assert!(packages.len() > 100);
    for package in packages.iter().filter(|package| !package["source"].is_null()) {
        let name = package["name"].as_str().unwrap();
        assert!(
            package["source"].as_str().unwrap().starts_with("registry+"),
            "{name} is not from the registry"
        );
        let stated = package["license"].as_str().unwrap_or_else(|| panic!("{name} states no licence"));
        let expression = Expression::parse_mode(stated, ParseMode::LAX).unwrap();
        let fits = expression.evaluate(|requirement| allowed.contains(&requirement.to_string()));
        assert!(fits, "{name}: {stated}");
    }
}
