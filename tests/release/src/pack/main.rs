//! Makes the bundle of a release from what `cargo xtask release` has built.
//!
//! Usage: `release-pack STAGE BUNDLE VERSION COMMIT SECONDS`, the last one the time of the commit since 1970. The stage holds
//!
//! | folder | becomes |
//! |---|---|
//! | `systems/NAME` | an archive for each system, a zip file for Windows |
//! | `firmware/BOARD.elf` | one zip file: what to flash, how, and the calibration that the image starts with |
//! | `manual` | a zip file of the site, and one page |
//! | `files` | as it is |
//! | `licences/NAME.txt` | the manifest's packages: lines `name version|licence` |
#![forbid(unsafe_code)]
#![deny(missing_docs)]

mod firmware;
mod manual;

use anyhow::{Context, Result, bail, ensure};
use release::archive::{self, Entry};
use release::manifest::{File, Held, MANIFEST, Manifest, SCHEMA, SUMS, sha256, sums};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use time::OffsetDateTime;

/// Licence of the project.
const LICENCE: &str = "MIT OR Apache-2.0";
/// The text that every archive of a system begins with.
const README: &str = include_str!("../../texts/README.txt");

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [stage, bundle, version, commit, seconds] = arguments.as_slice() else {
        bail!(
            "expected five arguments: the stage, the bundle, version, commit, its time in seconds since 1970"
        );
    };
    let seconds: i64 = seconds.parse().with_context(|| format!("`{seconds}` is no time in seconds"))?;
    let time = OffsetDateTime::from_unix_timestamp(seconds).context("no time of a commit")?;
    let mut bundle = Bundle { folder: bundle.into(), version, time, files: BTreeMap::new() };
    let stage = Path::new(stage);
    bundle.systems(&stage.join("systems"))?;
    bundle.firmware(&stage.join("firmware"))?;
    bundle.manual(&stage.join("manual"))?;
    bundle.files(&stage.join("files"))?;
    let packages = packages(&stage.join("licences"))?;
    bundle.finish(commit, packages)
}

struct Bundle<'a> {
    folder: PathBuf,
    version: &'a str,
    time: OffsetDateTime,
    files: BTreeMap<String, File>,
}

impl Bundle<'_> {
    /// A file of the bundle, and what it holds.
    fn add(&mut self, name: &str, is: &str, content: &[u8], entries: &[Entry]) -> Result<()> {
        let path = self.folder.join(name);
        fs::write(&path, content).with_context(|| format!("{}: cannot write", path.display()))?;
        println!("{name:<58}{:>9.1} MB", content.len() as f64 / 1e6);
        let file = File {
            is: is.to_owned(),
            bytes: content.len() as u64,
            sha256: sha256(content),
            holds: entries
                .iter()
                .map(|entry| {
                    let manifest_entry =
                        Held { bytes: entry.content.len() as u64, sha256: sha256(&entry.content) };
                    (entry.name.clone(), manifest_entry)
                })
                .collect(),
        };
        ensure!(self.files.insert(name.to_owned(), file).is_none(), "{name}: two files of this name");
        Ok(())
    }

    fn systems(&mut self, folder: &Path) -> Result<()> {
        for system in sub_folders(folder)? {
            let mut entries = archive::entries(&folder.join(&system))?;
            let program = entries.iter().find(|entry| entry.is_program);
            let program = program.with_context(|| format!("{system}: has no program"))?.name.clone();
            let content = README.replace("{version}", self.version).replace("{program}", &program);
            let name = "README.txt".to_owned();
            entries.push(Entry { name, content: content.into_bytes(), is_program: false });
            entries.sort_by(|a, b| a.name.cmp(&b.name));
            let top = format!("needle-guide-{}-{system}", self.version);
            let (ending, content) = if system.starts_with("windows") {
                ("zip", archive::zip(&top, &entries, self.time)?)
            } else {
                ("tar.gz", archive::tar_gz(&top, &entries, self.time)?)
            };
            let is = format!("the program `guide` for {system}");
            self.add(&format!("{top}.{ending}"), &is, &content, &entries)?;
        }
        Ok(())
    }

    fn firmware(&mut self, folder: &Path) -> Result<()> {
        if !folder.exists() {
            return Ok(());
        }
        let entries = firmware::entries(folder, self.version)?;
        let top = format!("needle-guide-{}-firmware", self.version);
        let content = archive::zip(&top, &entries, self.time)?;
        self.add(&format!("{top}.zip"), "firmware of both boards, and how to flash it", &content, &entries)
    }

    fn manual(&mut self, folder: &Path) -> Result<()> {
        if !folder.exists() {
            return Ok(());
        }
        let single_page = manual::one_page(folder, self.version)?;
        let name = format!("needle-guide-{}-manual.html", self.version);
        self.add(&name, "the manual as one page", single_page.as_bytes(), &[])?;
        let entries = archive::entries(folder)?;
        let top = format!("needle-guide-{}-manual", self.version);
        let content = archive::zip(&top, &entries, self.time)?;
        self.add(&format!("{top}-site.zip"), "the manual as a site: open index.html", &content, &entries)
    }

    fn files(&mut self, folder: &Path) -> Result<()> {
        for entry in archive::entries(folder)? {
            let is = match entry.name.rsplit_once('.').map(|(_, ending)| ending) {
                Some("whl") => "the Python wheel",
                Some("html") => "the program as one page for a browser",
                _ => "the project's licence",
            };
            self.add(&entry.name, is, &entry.content, &[])?;
        }
        Ok(())
    }

    /// Manifest and checksums.
    fn finish(self, commit: &str, packages: BTreeMap<String, BTreeMap<String, String>>) -> Result<()> {
        let manifest = Manifest {
            schema: SCHEMA.to_owned(),
            version: self.version.to_owned(),
            commit: commit.to_owned(),
            date: self.time.date().to_string(),
            licence: LICENCE.to_owned(),
            files: self.files,
            packages,
        };
        write(&self.folder, MANIFEST, serde_json::to_string_pretty(&manifest)? + "\n")?;
        write(&self.folder, SUMS, sums(&self.folder)?)
    }
}

fn write(folder: &Path, name: &str, text: String) -> Result<()> {
    fs::write(folder.join(name), text).with_context(|| format!("{name}: cannot write"))
}

/// Names of the folders in a folder, in order; none where there is none.
fn sub_folders(folder: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten() {
        let entry = entry?;
        if entry.path().is_dir() {
            names.push(entry.file_name().to_string_lossy().into_owned());
        }
    }
    names.sort();
    Ok(names)
}

fn packages(folder: &Path) -> Result<BTreeMap<String, BTreeMap<String, String>>> {
    let mut package_files = BTreeMap::new();
    for entry in archive::entries(folder)? {
        let text = String::from_utf8(entry.content).with_context(|| format!("{}: is no text", entry.name))?;
        let packages: Option<BTreeMap<String, String>> = text
            .lines()
            .map(|line| {
                let (package, licence) = line.split_once('|')?;
                Some((package.to_owned(), licence.to_owned()))
            })
            .collect();
        let packages =
            packages.with_context(|| format!("{}: expected `name version|licence`", entry.name))?;
        ensure!(!packages.is_empty(), "{}: names no package", entry.name);
        package_files.insert(entry.name.trim_end_matches(".txt").to_owned(), packages);
    }
    Ok(package_files)
}
