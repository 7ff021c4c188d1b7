//! Content of a bundle: `MANIFEST.json`, and the checksums as `sha256sum --check` reads them.

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Its file.
pub const MANIFEST: &str = "MANIFEST.json";
/// The file of checksums, of every other file of the bundle.
pub const SUMS: &str = "SHA256SUMS";
/// Version of the document.
pub const SCHEMA: &str = "needle-guide.release/1";

/// A bundle.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// [`SCHEMA`].
    pub schema: String,
    /// Version of the project.
    pub version: String,
    /// The source's commit.
    pub commit: String,
    /// Day of the commit, which all files are dated by.
    pub date: String,
    /// Licence of the project.
    pub licence: String,
    /// Files by name.
    pub files: BTreeMap<String, File>,
    /// Packages of others by what they are compiled into: licence expressions by name and version.
    pub packages: BTreeMap<String, BTreeMap<String, String>>,
}

/// A file of the bundle.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct File {
    /// Kind of the file, and its system.
    pub is: String,
    /// Its size.
    pub bytes: u64,
    /// Its checksum, hexadecimal.
    pub sha256: String,
    /// Content of an archive: what it holds.
    #[serde(skip_serializing_if = "BTreeMap::is_empty", default)]
    pub holds: BTreeMap<String, Held>,
}

/// A file in an archive.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Held {
    /// Its size.
    pub bytes: u64,
    /// Its checksum, hexadecimal.
    pub sha256: String,
}

/// SHA-256 in hexadecimal.
pub fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().fold(String::new(), |mut text, byte| {
        // Writing to a string does not fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}

/// The checksums of all files of a folder but their own, in order of their names.
///
/// # Errors
/// Where the folder or a file cannot be read.
pub fn sums(folder: &Path) -> Result<String> {
    let mut text = String::new();
    for name in names(folder)?.into_iter().filter(|name| name != SUMS) {
        let path = folder.join(&name);
        let content = fs::read(&path).with_context(|| format!("{}: cannot read", path.display()))?;
        let _ = writeln!(text, "{}  {name}", sha256(&content));
    }
    Ok(text)
}

/// Reads the manifest of a bundle and compares it with the files: every file is named, with its size and checksum, and no other.
///
/// # Errors
/// The first difference.
pub fn verify(folder: &Path) -> Result<Manifest> {
    let path = folder.join(MANIFEST);
    let text = fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
    let manifest: Manifest = serde_json::from_str(&text).with_context(|| format!("{}", path.display()))?;
    ensure!(manifest.schema == SCHEMA, "{}: {}, expected {SCHEMA}", path.display(), manifest.schema);
    for (name, file) in &manifest.files {
        let content =
            fs::read(folder.join(name)).with_context(|| format!("{name}: is in the manifest only"))?;
        ensure!(
            content.len() as u64 == file.bytes,
            "{name}: {} bytes, expected {}",
            content.len(),
            file.bytes
        );
        ensure!(sha256(&content) == file.sha256, "{name}: another checksum than in the manifest");
    }
    let unnamed = names(folder)?
        .into_iter()
        .find(|name| name != MANIFEST && name != SUMS && !manifest.files.contains_key(name));
    if let Some(name) = unnamed {
        bail!("{name}: is not in the manifest");
    }
    let stated = fs::read_to_string(folder.join(SUMS)).with_context(|| format!("{SUMS}: cannot read"))?;
    ensure!(stated == sums(folder)?, "{SUMS}: other checksums than those of the files");
    Ok(manifest)
}

/// In what two bundles differ: the files by name, those in archives too, and what is stated of the whole.
pub fn differences(one: &Manifest, other: &Manifest) -> Vec<String> {
    let mut differing = Vec::new();
    for (a, b) in stated(one).iter().zip(&stated(other)).filter(|(a, b)| a != b) {
        differing.push(format!("{MANIFEST}: {a} and {b}"));
    }
    if one.packages != other.packages {
        differing.push(format!("{MANIFEST}: other packages are compiled in"));
    }
    for name in union(&one.files, &other.files) {
        let (Some(a), Some(b)) = (one.files.get(name), other.files.get(name)) else {
            differing.push(format!("{name}: is in one bundle only"));
            continue;
        };
        if a == b {
            continue;
        }
        differing.push(format!("{name}: {} and {} bytes", a.bytes, b.bytes));
        let differing_entries =
            union(&a.holds, &b.holds).into_iter().filter(|held| a.holds.get(*held) != b.holds.get(*held));
        differing.extend(differing_entries.map(|held| format!("{name}: {held}")));
    }
    differing
}

fn stated(manifest: &Manifest) -> [String; 3] {
    [&manifest.version, &manifest.commit, &manifest.date].map(String::clone)
}

fn union<'m, V>(one: &'m BTreeMap<String, V>, other: &'m BTreeMap<String, V>) -> BTreeSet<&'m String> {
    one.keys().chain(other.keys()).collect()
}

fn names(folder: &Path) -> Result<BTreeSet<String>> {
    let entries = fs::read_dir(folder).with_context(|| cannot_read(folder))?;
    entries
        .map(|entry| {
            Ok(entry.with_context(|| cannot_read(folder))?.file_name().to_string_lossy().into_owned())
        })
        .collect()
}

fn cannot_read(folder: &Path) -> String {
    format!("{}: cannot read", folder.display())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bundle() -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        write_file("a.html", "page", &folder);
        let file = File { is: "page".into(), bytes: 4, sha256: sha256(b"page"), holds: BTreeMap::new() };
        let manifest = Manifest {
            schema: SCHEMA.into(),
            version: "0.0.0".into(),
            commit: "abc".into(),
            date: "2026-01-01".into(),
            licence: "MIT".into(),
            files: [("a.html".to_owned(), file)].into_iter().collect(),
            packages: BTreeMap::new(),
        };
        write_file(MANIFEST, &serde_json::to_string(&manifest).unwrap(), &folder);
        write_file(SUMS, &sums(folder.path()).unwrap(), &folder);
        folder
    }

    fn write_file(name: &str, text: &str, folder: &tempfile::TempDir) {
        fs::write(folder.path().join(name), text).unwrap()
    }

    #[test]
    fn a_bundle_as_it_was_made_is_accepted() {
        assert_eq!(verify(bundle().path()).unwrap().files.len(), 1);
        assert_eq!(sha256(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn bundles_of_other_bytes_are_told_apart_down_to_the_file_in_an_archive() {
        let manifest = verify(bundle().path()).unwrap();
        assert_eq!(differences(&manifest, &manifest), Vec::<String>::new());
        let mut changed = manifest.clone();
        changed.commit = "abd".into();
        let file = changed.files.get_mut("a.html").unwrap();
        file.sha256 = sha256(b"pagf");
        file.holds.insert("guide".into(), Held { bytes: 1, sha256: sha256(b"g") });
        let lines = ["MANIFEST.json: abc and abd", "a.html: 4 and 4 bytes", "a.html: guide"];
        assert_eq!(differences(&manifest, &changed), lines);
        changed.files.clear();
        assert_eq!(differences(&manifest, &changed)[1], "a.html: is in one bundle only");
    }

    #[test]
    fn what_was_changed_added_or_lost_is_named() {
        assert!(rejection(&|at| fs::write(at.join("a.html"), "pagf").unwrap()).contains("checksum"));
        assert!(
            rejection(&|at| fs::write(at.join("a.html"), "pages").unwrap()).contains("5 bytes, expected 4")
        );
        assert!(
            rejection(&|at| fs::remove_file(at.join("a.html")).unwrap()).contains("in the manifest only")
        );
        assert!(
            rejection(&|at| fs::write(at.join("b.html"), "").unwrap())
                .contains("b.html: is not in the manifest")
        );
        assert!(rejection(&|at| fs::write(at.join(SUMS), "").unwrap()).contains(SUMS));
    }

    fn rejection(change: &dyn Fn(&Path)) -> String {
        let folder = bundle();
        change(folder.path());
        verify(folder.path()).unwrap_err().to_string()
    }
}
