//! Reports with all that makes them again, and bundles that somebody has changed.

use super::{add_lateral_run, failure, folder, guide, json, path, text, writer};
use serde_json::Value;
use std::fs::{self, File};
use std::io::{Cursor, Read, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

/// A bundle of a small session; where it is, and what the command printed.
fn bundled(folder: &Path) -> (std::path::PathBuf, Value) {
    let dir = folder.join("phantom");
    add_lateral_run(&mut writer(&dir));
    let file = folder.join("phantom.zip");
    let bundle_json = json(&["report", path(&dir), "--bundle", path(&file), "--json"]);
    (file, bundle_json)
}

/// The files of an archive.
fn unpacked(file: &Path) -> Vec<(String, Vec<u8>)> {
    let mut zip = ZipArchive::new(File::open(file).expect("there")).expect("a zip file");
    let count = zip.len();
    (0..count)
        .map(|number| {
            let mut entry = zip.by_index(number).expect("an entry");
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).expect("read");
            (entry.name().expect("a name").into_owned(), bytes)
        })
        .collect()
}

fn packed(file: &Path, entries: &[(String, Vec<u8>)]) {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in entries {
        zip.start_file(name.as_str(), SimpleFileOptions::default()).expect("begun");
        zip.write_all(bytes).expect("written");
    }
    fs::write(file, zip.finish().expect("finished").into_inner()).expect("written");
}

/// The document of a verification that fails, and its exit code.
fn refused(file: &Path) -> Value {
    let output = guide(&["report", "--verify", path(file), "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    serde_json::from_slice(&output.stdout).expect("a document")
}

#[test]
fn a_bundle_is_verified_elsewhere_and_a_changed_byte_is_named() {
    let first_folder = folder();
    let (file, bundle_json) = bundled(first_folder.path());
    assert_eq!(bundle_json["schema"], "guide.bundle_made/1");
    // The same session gives the same bytes.
    let again = first_folder.path().join("again.zip");
    let dir = first_folder.path().join("phantom");
    json(&["report", path(&dir), "--bundle", path(&again), "--json"]);
    assert!(fs::read(&file).expect("there") == fs::read(&again).expect("there"));
    // Elsewhere, and without the session.
    let second_folder = folder();
    let copy = second_folder.path().join("copy.zip");
    fs::copy(&file, &copy).expect("copied");
    fs::remove_dir_all(&dir).expect("removed");
    let verified = json(&["report", "--verify", path(&copy), "--json"]);
    assert_eq!(verified["verdict"], "verified");
    assert_eq!(verified["sha256_of_list"], bundle_json["sha256_of_list"]);
    assert_eq!(verified["different"], Value::Array(Vec::new()));
    let entries = unpacked(&copy);
    assert_eq!(verified["unchanged"], entries.len() - 1);
    let names: Vec<&str> = entries.iter().map(|(name, _)| name.as_str()).collect();
    for name in ["phantom/session.toml", "report.html", "results/identify.json", "draws/diagnose.json"] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    // One byte of a file: it is named, and nothing else is.
    let changed = second_folder.path().join("changed.zip");
    for number in (1..entries.len()).filter(|number| is_tried(&entries[*number].0)) {
        let mut altered = entries.clone();
        let (name, bytes) = &mut altered[number];
        *bytes.last_mut().expect("not empty") ^= 1;
        let name = name.clone();
        packed(&changed, &altered);
        let document = refused(&changed);
        assert_eq!(document["changed"], serde_json::json!([name]));
        assert_eq!(document["verdict"], "changed");
        // No result is computed from inputs that have changed.
        assert_eq!(document["different"].is_null(), name.starts_with("phantom/"), "{name}");
    }
    // A file less and one more, and a list that states something else than it did.
    let mut without_report: Vec<_> =
        entries.iter().filter(|(name, _)| name != "report.html").cloned().collect();
    without_report.push(("phantom/more.csv".to_owned(), b"1\n".to_vec()));
    packed(&changed, &without_report);
    let document = refused(&changed);
    assert_eq!(document["missing"], serde_json::json!(["report.html"]));
    assert_eq!(document["added"], serde_json::json!(["phantom/more.csv"]));
    let mut altered = entries.clone();
    let list = text(&altered[0].1).replace("\"seed\": 1,", "\"seed\": 2,");
    altered[0].1 = list.into_bytes();
    packed(&changed, &altered);
    let document = refused(&changed);
    assert_eq!(document["verdict"], "not_reproduced");
    assert_eq!(
        document["different"],
        serde_json::json!(["draws/diagnose.json", "draws/identify.json", "report.html"])
    );
}

fn is_tried(name: &str) -> bool {
    name.starts_with("phantom/") || name == "report.html"
}

#[test]
fn what_is_no_bundle_is_refused_with_its_place() {
    let folder = folder();
    let file = folder.path().join("bad.zip");
    fs::write(&file, "no archive").expect("written");
    assert!(failure(&["report", "--verify", path(&file)]).contains("bad.zip: no bundle"));
    packed(&file, &[entry("a.csv", b"1")]);
    assert!(failure(&["report", "--verify", path(&file)]).contains("bundle.json: missing"));
    packed(&file, &[entry("bundle.json", b"{}")]);
    let line = failure(&["report", "--verify", path(&file)]);
    assert!(line.contains("bundle.json: missing field") && line.contains("line 1"), "{line}");
    for name in ["../outside", "/etc/passwd", "a/../../b", "a\\b"] {
        packed(&file, &[entry(name, b"1")]);
        let line = failure(&["report", "--verify", path(&file)]);
        assert!(line.contains("is no name of a file in a bundle"), "{line}");
    }
    // Cut off anywhere.
    let (whole, _) = bundled(folder.path());
    let bytes = fs::read(&whole).expect("there");
    for length in [1, bytes.len() / 2, bytes.len() - 1] {
        fs::write(&file, &bytes[..length]).expect("written");
        assert!(failure(&["report", "--verify", path(&file)]).contains("bad.zip: "));
    }
}

fn entry(name: &str, bytes: &[u8]) -> (String, Vec<u8>) {
    (name.to_owned(), bytes.to_vec())
}
