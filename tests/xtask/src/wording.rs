//! Counts the private dialect of the code: local names that do not state what they hold, comment sentences that begin with a
//! clause, named closures, and public types of one crate that share a name. [`CONTRIBUTING`] has the figures of every crate. No
//! crate may exceed a limit, or where it already does, the figure that the document states.

mod source;

use crate::build::root;
use anyhow::{Context, Result, bail};
use source::Source;
use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Help of the task.
pub const HELP: &str = "Count local names, comments, closures and type names that are no plain English, per crate\n\n\
    Usage: cargo xtask wording [--list CRATE | --write]\n\n\
    Options:\n  --list CRATE  Print every place that counts, for the crate in this folder (host/device)\n  \
    --write       Write the figures into CONTRIBUTING.md\n";

/// The document with the figures.
const CONTRIBUTING: &str = "CONTRIBUTING.md";

/// Lines between which the document has the table.
const MARKS: [&str; 2] = ["<!-- wording: figures -->", "<!-- wording: end -->"];

/// Largest counts: percent of local names, percent of comment sentences, closures per 1000 lines. Eight codebases of the
/// field were counted: 0 to 1.9 %, 0 to 1.1 %, 0.1 to 4.5.
const LIMITS: [f64; 3] = [2.0, 2.0, 5.0];

/// Figures are written with one decimal place.
const ROUNDING: f64 = 0.05;

/// Names that several public types of a crate share, with the reason.
const SHARED_TYPES: [(&str, &str, &str); SHARED_COUNT] = include!("wording/shared_types.in");

const SHARED_COUNT: usize = 25;

/// Names that public types of a crate and of one that it depends on share, with the reason. Crates that do not depend on each
/// other may use a name twice: no code uses both.
const SHARED_ACROSS: [(&str, &str); SHARED_ACROSS_COUNT] = include!("wording/shared_across.in");

const SHARED_ACROSS_COUNT: usize = 73;

/// Counts of one crate.
#[derive(Default)]
struct Counts {
    lines: usize,
    closures: usize,
    names: usize,
    vague_names: usize,
    sentences: usize,
    clauses: usize,
}

impl Counts {
    fn add(&mut self, source: &Source) {
        self.lines += source.line_count();
        self.closures += source.closures().len();
        let names = source.local_names();
        self.names += names.len();
        self.vague_names += names.iter().filter(|(_, name)| source::is_vague(name)).count();
        let sentences = source.sentences();
        self.sentences += sentences.len();
        self.clauses += sentences.iter().filter(|(_, sentence)| source::begins_with_clause(sentence)).count();
    }

    /// In the order of [`LIMITS`].
    fn figures(&self) -> [f64; 3] {
        [
            100.0 * ratio(self.vague_names, self.names),
            100.0 * ratio(self.clauses, self.sentences),
            1000.0 * ratio(self.closures, self.lines),
        ]
    }
}

/// Runs the task `wording`.
///
/// # Errors
/// Where a file cannot be read or written, or an option is unknown.
pub fn wording(arguments: &[std::ffi::OsString]) -> Result<()> {
    let arguments: Vec<_> = arguments.iter().map(|argument| argument.to_string_lossy()).collect();
    match arguments.iter().map(AsRef::as_ref).collect::<Vec<&str>>()[..] {
        [] => print!("{}", table(&count()?)),
        ["--list", folder] => list(folder)?,
        ["--write"] => write()?,
        _ => bail!("wording: unknown options, expected --list CRATE, --write or none"),
    }
    Ok(())
}

/// Compares the code with the limits and with the figures of the document.
///
/// # Errors
/// Names every crate above a limit, every crate without figures in the document, and every shared name of types.
pub fn check() -> Result<()> {
    let document = fs::read_to_string(root().join(CONTRIBUTING))?;
    let written = written_figures(&document);
    let mut problems = Vec::new();
    for (folder, count) in &count()? {
        let Some(written) = written.get(folder) else {
            problems.push(format!("{folder} is not in {CONTRIBUTING}: cargo xtask wording --write"));
            continue;
        };
        let allowed = LIMITS.iter().zip(written).map(|(limit, figure)| limit.max(*figure));
        for ((figure, allowed), heading) in count.figures().into_iter().zip(allowed).zip(HEADINGS) {
            if figure > allowed + ROUNDING {
                problems.push(format!("{folder}: {heading}: {figure:.1}, at most {allowed}"));
            }
        }
    }
    problems.extend(shared_types()?);
    problems.extend(shared_across()?);
    if problems.is_empty() {
        return Ok(());
    }
    bail!("wording (cargo xtask wording --list CRATE prints the places):\n  {}", problems.join("\n  "))
}

const HEADINGS: [&str; 3] =
    ["vague local names, %", "comments that begin with a clause, %", "named closures per 1000 lines"];

/// Zero of nothing, as a crate may have no comments.
fn ratio(count: usize, total: usize) -> f64 {
    if total == 0 { 0.0 } else { count as f64 / total as f64 }
}

fn table(counts: &BTreeMap<String, Counts>) -> String {
    let mut table = format!("| crate | {} |\n|---|---|---|---|\n", HEADINGS.join(" | "));
    for (folder, count) in counts {
        let [names, comments, closures] = count.figures();
        writeln!(table, "| `{folder}` | {names:.1} | {comments:.1} | {closures:.1} |")
            .expect("a string can be written");
    }
    table
}

/// Figures of every crate in the document.
fn written_figures(document: &str) -> BTreeMap<String, Vec<f64>> {
    between_marks(document).unwrap_or_default().lines().filter_map(row).collect()
}

/// Folder and figures of a row of the table.
fn row(line: &str) -> Option<(String, Vec<f64>)> {
    let mut cells = line.trim_matches('|').split('|').map(str::trim);
    let folder = cells.next()?.strip_prefix('`')?.strip_suffix('`')?.to_owned();
    Some((folder, cells.map_while(|cell| cell.parse().ok()).collect()))
}

fn between_marks(document: &str) -> Option<&str> {
    let (_, after_mark) = document.split_once(MARKS[0])?;
    let (table, _) = after_mark.split_once(MARKS[1])?;
    Some(table)
}

fn write() -> Result<()> {
    let path = root().join(CONTRIBUTING);
    let document = fs::read_to_string(&path)?;
    let (head, following) =
        document.split_once(MARKS[0]).context("CONTRIBUTING.md has no table of figures")?;
    let (_, tail) =
        following.split_once(MARKS[1]).context("the table of figures in CONTRIBUTING.md has no end")?;
    let text = format!("{head}{}\n{}{}{tail}", MARKS[0], table(&count()?), MARKS[1]);
    fs::write(path, text)?;
    Ok(())
}

fn list(folder: &str) -> Result<()> {
    for path in files()? {
        if crate_of(&path) != folder {
            continue;
        }
        let source = Source::read(&path)?;
        let file = relative(&path);
        let names = source.local_names().into_iter().filter(|(_, name)| source::is_vague(name));
        let names = names.map(|(line, name)| (line, format!("local name `{name}`")));
        let closures = source.closures().into_iter().map(|(line, name)| (line, format!("closure `{name}`")));
        let sentences = source.sentences().into_iter().filter(|(_, text)| source::begins_with_clause(text));
        let sentences = sentences.map(|(line, text)| (line, format!("comment \"{text}\"")));
        for (line, place) in names.chain(closures).chain(sentences) {
            println!("{file}:{line}: {place}");
        }
    }
    Ok(())
}

fn count() -> Result<BTreeMap<String, Counts>> {
    let mut counts = BTreeMap::<String, Counts>::new();
    for path in files()? {
        counts.entry(crate_of(&path)).or_default().add(&Source::read(&path)?);
    }
    Ok(counts)
}

/// Public types of one crate that share a name and are not in [`SHARED_TYPES`], and entries of that list that no longer
/// apply.
fn shared_types() -> Result<Vec<String>> {
    let mut types = BTreeMap::<(String, String), BTreeSet<String>>::new();
    for path in files()? {
        for name in Source::read(&path)?.public_types() {
            types.entry((crate_of(&path), name)).or_default().insert(relative(&path));
        }
    }
    types.retain(|_, files| files.len() > 1);
    let is_excused = |folder: &str, name: &str| {
        SHARED_TYPES.iter().any(|(excused_folder, excused, _)| *excused_folder == folder && *excused == name)
    };
    let shared = types.iter().filter(|((folder, name), _)| !is_excused(folder, name));
    let shared = shared.map(|((_, name), files)| {
        format!(
            "public types share the name {name}: {}",
            files.iter().cloned().collect::<Vec<_>>().join(", ")
        )
    });
    let stale = SHARED_TYPES
        .iter()
        .filter(|(folder, name, _)| !types.contains_key(&((*folder).to_owned(), (*name).to_owned())));
    let stale = stale.map(|(folder, name, _)| format!("{folder}: no two public types share the name {name}"));
    Ok(shared.chain(stale).collect())
}

/// Names that public types of a crate and of one that it depends on share and that are not in [`SHARED_ACROSS`], and entries
/// of that list that no longer apply.
fn shared_across() -> Result<Vec<String>> {
    let mut crates_of = BTreeMap::<String, BTreeSet<String>>::new();
    for path in files()? {
        for name in Source::read(&path)?.public_types() {
            crates_of.entry(name).or_default().insert(crate_of(&path));
        }
    }
    let dependencies = dependencies()?;
    crates_of.retain(|_, folders| {
        folders.iter().any(|folder| dependencies.get(folder).is_some_and(|below| !below.is_disjoint(folders)))
    });
    let shared = crates_of
        .iter()
        .filter(|(name, _)| !SHARED_ACROSS.iter().any(|(excused, _)| excused == name))
        .map(|(name, folders)| {
            let folders: Vec<_> = folders.iter().cloned().collect();
            format!(
                "public types of crates that depend on each other share the name {name}: {}",
                folders.join(", ")
            )
        });
    let stale = SHARED_ACROSS
        .iter()
        .filter(|(name, _)| !crates_of.contains_key(*name))
        .map(|(name, _)| format!("no crate shares the name {name} with one that it depends on"));
    Ok(shared.chain(stale).collect())
}

/// Folders of the crates of the workspace that every crate depends on, also by way of others, without what only its tests use.
fn dependencies() -> Result<BTreeMap<String, BTreeSet<String>>> {
    let mut manifests = BTreeMap::new();
    for path in files()? {
        let folder = crate_of(&path);
        if let Entry::Vacant(missing) = manifests.entry(folder) {
            let manifest = fs::read_to_string(root().join(missing.key()).join("Cargo.toml"))?;
            missing.insert(manifest);
        }
    }
    let mut below: BTreeMap<String, BTreeSet<String>> = manifests
        .iter()
        .map(|(folder, manifest)| {
            let names: BTreeSet<&str> = dependency_names(manifest).collect();
            let used = manifests
                .iter()
                .filter(|(_, other)| package_name(other).is_some_and(|name| names.contains(name)))
                .map(|(folder, _)| folder.clone());
            (folder.clone(), used.collect())
        })
        .collect();
    // A pass adds what is one step further below: at most as many passes as there are crates.
    for _ in 0..below.len() {
        let passed = below.clone();
        for folders in below.values_mut() {
            let further: Vec<_> =
                folders.iter().filter_map(|folder| passed.get(folder)).flatten().cloned().collect();
            folders.extend(further);
        }
    }
    Ok(below)
}

/// Keys of the sections of a manifest that list dependencies of the crate itself.
fn dependency_names(manifest: &str) -> impl Iterator<Item = &str> {
    let mut is_listed = false;
    manifest.lines().filter_map(move |line| {
        if line.starts_with('[') {
            is_listed = line == "[dependencies]" || line.ends_with(".dependencies]");
            return None;
        }
        line.split(['.', ' ', '=']).next().filter(|name| is_listed && !name.is_empty())
    })
}

fn package_name(manifest: &str) -> Option<&str> {
    manifest.lines().find_map(|line| line.strip_prefix("name = \"")?.strip_suffix('"'))
}

/// Every Rust file of the project, in order.
fn files() -> Result<Vec<PathBuf>> {
    let mut folders = ["firmware", "host", "protocol", "tests"].map(|folder| root().join(folder)).to_vec();
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != "target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    Ok(files)
}

/// Folder of the crate that a file belongs to.
fn crate_of(file: &Path) -> String {
    let mut folders = file.ancestors().skip(1);
    let folder = folders.find(|folder| folder.join("Cargo.toml").exists()).unwrap_or(file);
    relative(folder)
}

fn relative(path: &Path) -> String {
    let path = path.strip_prefix(root()).unwrap_or(path).display().to_string();
    path.replace('\\', "/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dependencies_are_those_of_the_crate_itself() {
        let manifest = "[package]\nname = \"a\"\n\n[dependencies]\nb.workspace = true\nc = { path = \"../c\" }\n\n\
            [target.'cfg(unix)'.dependencies]\nd = \"1\"\n\n[dev-dependencies]\ne.workspace = true\n";
        assert_eq!(dependency_names(manifest).collect::<Vec<_>>(), ["b", "c", "d"]);
        assert_eq!(package_name(manifest), Some("a"));
    }
}
