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
    let all_packages = metadata["packages"].as_array().unwrap();
    all_packages
        .iter()
        .filter(|package| resolved.contains(package["id"].as_str().unwrap()))
        .cloned()
        .collect()
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

/// Keys at the top of a file of the Citation File Format 1.2.0 that this project may use, and those that it has to have.
const CITATION_KEYS: [&str; 13] = [
    "cff-version",
    "message",
    "title",
    "abstract",
    "type",
    "version",
    "license",
    "authors",
    "keywords",
    "doi",
    "date-released",
    "repository-code",
    "url",
];
const CITATION_NEEDS: [&str; 4] = ["cff-version", "message", "title", "authors"];

#[test]
fn the_citation_is_of_this_version_and_licence() {
    let text = std::fs::read_to_string(root().join("CITATION.cff")).unwrap();
    let keys: Vec<&str> = text
        .lines()
        .filter(|line| line.starts_with(char::is_alphabetic))
        .map(|line| line.split_once(':').unwrap_or_else(|| panic!("{line}: expected a key")).0)
        .collect();
    assert!(keys.iter().all(|key| CITATION_KEYS.contains(key)), "{keys:?}");
    assert!(CITATION_NEEDS.iter().all(|key| keys.contains(key)), "{keys:?}");
    assert_eq!(keys.len(), keys.iter().collect::<BTreeSet<_>>().len(), "a key stands twice");
    assert_eq!(value_of("cff-version", &text), "1.2.0");
    assert_eq!(value_of("version", &text), env!("CARGO_PKG_VERSION"));
    let list = text.split_once("\nlicense:\n").expect("a list of licences").1;
    let licences: Vec<&str> = list.lines().map_while(|line| line.strip_prefix("  - ")).collect();
    assert_eq!(licences.join(" OR "), env!("CARGO_PKG_LICENSE"));
    let wheel = std::fs::read_to_string(root().join("host/python/pyproject.toml")).unwrap();
    assert_eq!(
        wheel.parse::<toml::Table>().unwrap()["project"]["version"].as_str(),
        Some(env!("CARGO_PKG_VERSION"))
    );
}

fn value_of<'a>(key: &str, text: &'a str) -> &'a str {
    let line = text.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(": "));
    line.unwrap_or_else(|| panic!("{key}: missing"))
}
