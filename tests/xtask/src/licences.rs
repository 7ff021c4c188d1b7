//! The licences of what is compiled into a program, and that nothing else is in the wheel.

use crate::build::{program, root};
use anyhow::{Context, Result, bail, ensure};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// File in which the build looks for it: `license-files` of `pyproject.toml`.
pub const FILE: &str = "THIRD-PARTY.txt";
/// Licence files of a package begin with one of these, in any case.
const NAMES: [&str; 6] = ["license", "licence", "copying", "unlicense", "notice", "copyright"];
/// The compiled module: of Unix, of Windows.
pub const MODULES: [&str; 2] = ["needle_guide/_core.abi3.so", "needle_guide/_core.pyd"];
/// Files of the wheel's own description.
const DESCRIPTION: [&str; 4] = ["METADATA", "WHEEL", "RECORD", "entry_points.txt"];
/// Prefix of the registry's name, and of a package's, in the paths that the compiler leaves in a library.
const REGISTRY: &str = "registry/src/";

/// Compiled program.
#[derive(Debug, Clone, Copy)]
pub struct Built<'a> {
    /// Package of the workspace.
    pub package: &'a str,
    /// Its features, beside those that it has by default.
    pub features: &'a str,
    /// Rust's name of the system.
    pub target: &'a str,
}

/// The Python module for a system.
pub const fn module(target: &str) -> Built<'_> {
    Built { package: "needle-guide", features: "extension", target }
}

/// A package that is compiled in.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Package {
    name: String,
    version: String,
    licence: String,
}

impl Package {
    /// As its folder is named.
    fn folder(&self) -> String {
        format!("{}-{}", self.name, self.version)
    }
}

/// Licences of everything that is compiled in, as text, and the packages.
#[derive(Debug)]
pub struct Licences {
    /// Text for the file.
    pub text: String,
    packages: BTreeSet<Package>,
}

impl Licences {
    /// A line `name version|licence` for each package.
    pub fn lines(&self) -> String {
        self.packages.iter().map(|one| format!("{} {}|{}\n", one.name, one.version, one.licence)).collect()
    }
}

/// Collects them from the packages' sources.
///
/// # Errors
/// Where a package states no licence or its sources are not there.
pub fn collect(built: &Built) -> Result<Licences> {
    let packages = packages(built)?;
    let sources = registry()?;
    let mut texts: BTreeMap<String, Vec<String>> = BTreeMap::new();
    let mut text = format!(
        "needle-guide is licensed under MIT OR Apache-2.0. The compiled program holds the {} packages below, each with its own licence, and \
         the standard library of Rust (MIT OR Apache-2.0, with parts that its COPYRIGHT-library.html names). Texts that several packages share are printed once.\n\n",
        packages.len()
    );
    for package in &packages {
        let folder = package.folder();
        let _ = writeln!(text, "{folder:<40} {}", package.licence);
        let files = licence_files(&sources, &folder)?;
        if files.is_empty() {
            texts
                .entry("(no text in the package: the licence named above)".to_owned())
                .or_default()
                .push(folder.clone());
        }
        for file in files {
            let words = String::from_utf8_lossy(&fs::read(&file)?).trim().replace("\r\n", "\n");
            texts.entry(words).or_default().push(folder.clone());
        }
    }
    for (words, folders) in &texts {
        let _ = write!(text, "\n{}\n{}\n\n{words}\n", "-".repeat(100), folders.join(", "));
    }
    Ok(Licences { text, packages })
}

/// Packages that cargo compiles in: no macros, no build scripts, none of this workspace.
fn packages(built: &Built) -> Result<BTreeSet<Package>> {
    let output = Command::new(program())
        .current_dir(root())
        .args(["tree", "--locked", "--package", built.package, "--features", built.features])
        .args(["--edges", "normal,no-proc-macro", "--target", built.target])
        .args(["--prefix", "none", "--format", "{p}|{l}"])
        .stdin(Stdio::null())
        .stderr(Stdio::inherit())
        .output()
        .context("cannot run cargo tree")?;
    ensure!(output.status.success(), "cargo tree failed");
    let packages = parse(&String::from_utf8_lossy(&output.stdout))?;
    ensure!(!packages.is_empty(), "cargo tree names no package");
    Ok(packages)
}

/// Lines like `serde v1.0.228|MIT OR Apache-2.0`; of packages of the workspace with a path, and `(*)` where one is repeated.
fn parse(tree: &str) -> Result<BTreeSet<Package>> {
    let mut packages = BTreeSet::new();
    for line in tree.lines().filter(|line| !line.is_empty()) {
        let (package, licence) = line.split_once('|').with_context(|| format!("cargo tree: `{line}`"))?;
        let licence = licence.trim_end_matches("(*)").trim();
        if package.contains("(/") {
            continue;
        }
        let mut words = package.split(' ');
        let (Some(name), Some(version)) =
            (words.next(), words.next().and_then(|word| word.strip_prefix('v')))
        else {
            bail!("cargo tree: `{line}`, expected a name and a version");
        };
        ensure!(!licence.is_empty(), "{name} {version}: states no licence");
        packages.insert(Package {
            name: name.to_owned(),
            version: version.to_owned(),
            licence: licence.to_owned(),
        });
    }
    Ok(packages)
}

/// Folders of the sources that cargo has unpacked.
fn registry() -> Result<Vec<PathBuf>> {
    let home = std::env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| Some(std::env::home_dir()?.join(".cargo")));
    let sources = home.context("no home folder, expected CARGO_HOME")?.join("registry/src");
    let entries = fs::read_dir(&sources).with_context(|| format!("{}: cannot read", sources.display()))?;
    entries.map(|entry| Ok(entry?.path())).collect()
}

fn licence_files(sources: &[PathBuf], package: &str) -> Result<Vec<PathBuf>> {
    let folder = sources.iter().map(|source| source.join(package)).find(|folder| folder.exists());
    let folder =
        folder.with_context(|| format!("{package}: its sources are not in the registry of cargo"))?;
    let mut files = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.file_name().map(|name| name.to_string_lossy().to_lowercase()).unwrap_or_default();
        if path.is_file() && NAMES.iter().any(|begin| name.starts_with(begin)) {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Checks that a wheel holds the package, its description and the licences, and that its library holds no package that they do not name.
/// `names` are the wheel's files, `library` the compiled module.
///
/// # Errors
/// The first file or package that does not belong there.
pub fn check(names: &[String], library: &[u8], licences: &Licences) -> Result<()> {
    let python = root().join("host/python/python");
    for name in names {
        let is_described = name.split_once(".dist-info/").is_some_and(|(_, inside)| {
            DESCRIPTION.contains(&inside) || inside.starts_with("sboms/") || is_licence(inside)
        });
        let is_source =
            Path::new(name).extension().is_some_and(|kind| kind == "py" || kind == "pyi" || kind == "typed")
                && python.join(name).is_file();
        ensure!(
            is_described || is_source || MODULES.contains(&name.as_str()),
            "{name}: is in the wheel, expected the package, its description and its licences only"
        );
    }
    let has_licence =
        |licence: &str| names.iter().any(|name| name.ends_with(&format!(".dist-info/licenses/{licence}")));
    ensure!(has_licence(FILE), "the wheel has no {FILE}");
    let compiled = traces(library);
    ensure!(!compiled.is_empty(), "the module names none of the packages that are compiled into it");
    let named: BTreeSet<String> = licences.packages.iter().map(Package::folder).collect();
    match compiled.iter().find(|package| !named.contains(*package)) {
        Some(package) => bail!("{package}: is compiled into the module, and {FILE} does not name it"),
        None => Ok(()),
    }
}

fn is_licence(inside: &str) -> bool {
    inside
        .strip_prefix("licenses/")
        .is_some_and(|name| ["LICENSE-MIT", "LICENSE-APACHE", FILE].contains(&name))
}

/// Packages of a registry whose paths are in a library, as the compiler puts them there for the messages of panics.
fn traces(library: &[u8]) -> BTreeSet<String> {
    let mut traces = BTreeSet::new();
    let begins =
        library.windows(REGISTRY.len()).enumerate().filter(|(_, window)| *window == REGISTRY.as_bytes());
    for (at, _) in begins {
        let path = library.get(at + REGISTRY.len()..).unwrap_or_default();
        let printable = path.iter().take(300).take_while(|byte| byte.is_ascii_graphic());
        let path: String = printable.map(|byte| char::from(*byte)).collect();
        // The registry's folder, then the package's; what follows ends it.
        let mut components = path.split(['/', '\\']).skip(1);
        if let (Some(package), Some(_)) = (components.next(), components.next()) {
            traces.insert(package.to_owned());
        }
    }
    traces
}

#[cfg(test)]
mod tests {
    use super::*;

    const TREE: &str = "needle-guide v0.1.0 (/here/host/python)|MIT OR Apache-2.0\n\
                        serde v1.0.228|MIT OR Apache-2.0\nserde v1.0.228|MIT OR Apache-2.0 (*)\n\
                        wasi v0.11.0+wasi-snapshot-preview1|Apache-2.0\n";

    #[test]
    fn the_tree_names_each_package_of_others_once() {
        let packages: Vec<String> = parse(TREE).unwrap().iter().map(Package::folder).collect();
        assert_eq!(packages, ["serde-1.0.228", "wasi-0.11.0+wasi-snapshot-preview1"]);
        assert!(parse("odd v1.0.0|\n").unwrap_err().to_string().contains("states no licence"));
    }

    #[test]
    fn what_a_wheel_must_not_hold_is_named() {
        let licences = Licences { text: String::new(), packages: parse("serde v1.0.228|MIT\n").unwrap() };
        assert_eq!(licences.lines(), "serde 1.0.228|MIT\n");
        let library = b"\0/home/x/registry/src/index-1a2b/serde-1.0.228/src/lib.rs\0";
        let good =
            ["needle_guide/__init__.py", "needle_guide/_core.abi3.so", "needle_guide-0.1.0.dist-info/RECORD"];
        let good = good.map(str::to_owned).to_vec();
        let listed = [good.clone(), vec![format!("needle_guide-0.1.0.dist-info/licenses/{FILE}")]].concat();
        assert!(check(&listed, library, &licences).is_ok());
        let fails =
            |names: &[String], library: &[u8]| check(names, library, &licences).unwrap_err().to_string();
        assert!(fails(&good, library).contains("has no THIRD-PARTY.txt"));
        for name in ["needle_guide.libs/libz.so.1", "needle_guide/secret.py", "other-1.0.dist-info/notes.txt"]
        {
            assert!(fails(&[listed.clone(), vec![name.to_owned()]].concat(), library).starts_with(name));
        }
        let library =
            b"registry/src/index-1a2b/serde-1.0.228/src/lib.rs\0registry/src/index-1a2b/ring-0.17.8/src/a.rs";
        assert!(fails(&listed, library).starts_with("ring-0.17.8: is compiled into the module"));
        assert!(fails(&listed, b"stripped").contains("names none"));
    }

    #[test]
    fn every_package_that_is_compiled_in_has_its_licence_in_the_text() {
        let licences = collect(&module("x86_64-unknown-linux-gnu")).unwrap();
        assert!(licences.packages.len() > 50, "{} packages", licences.packages.len());
        for package in &licences.packages {
            assert!(licences.text.matches(&package.folder()).count() >= 2, "{package:?}");
        }
        assert!(licences.text.contains("Permission is hereby granted"));
    }
}
