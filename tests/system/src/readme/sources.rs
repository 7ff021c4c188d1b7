//! Every name of the source has its section in the manual: equations, JSON documents, faults; and the other way
//! round.

use super::book::{Book, MANUAL};
use crate::images;
use protocol::Fault;
use regex::Regex;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Folders of the crates.
const FOLDERS: [&str; 4] = ["firmware", "host", "protocol", "tests"];

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            if path.file_name().is_none_or(|name| name != "target") {
                rust_files(&path, found);
            }
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            found.push(path);
        }
    }
}

/// Name and text of every source file, with comments that go on over lines joined.
pub(super) fn sources() -> Vec<(String, String)> {
    let root = images::root();
    let mut files = Vec::new();
    FOLDERS.iter().for_each(|folder| rust_files(&root.join(folder), &mut files));
    let goes_on = Regex::new(r"\n[ \t]*//[/!]?[ \t]+").unwrap();
    files
        .into_iter()
        .map(|path| {
            let text = std::fs::read_to_string(&path).unwrap();
            (
                path.strip_prefix(root).unwrap().display().to_string(),
                goes_on.replace_all(&text, " ").into_owned(),
            )
        })
        .collect()
}

/// Numbers of the equations on the pages about the theory, with their page.
fn equations(book: &Book) -> BTreeMap<u32, String> {
    let anchor = Regex::new(r#"<a id="eq-(\d+)">"#).unwrap();
    let mut equations = BTreeMap::new();
    for page in book.pages().iter().filter(|page| page.name().starts_with(&format!("{MANUAL}/theory"))) {
        for number in anchor.captures_iter(&page.text()) {
            let number = number[1].parse().unwrap();
            assert_eq!(
                equations.insert(number, page.name().to_owned()),
                None,
                "equation {number} stands twice"
            );
        }
    }
    equations
}

#[test]
fn every_equation_that_a_comment_names_is_in_the_theory() {
    let equations = equations(&Book::read(images::root()).unwrap());
    assert!((1..=u32::try_from(equations.len()).unwrap()).eq(equations.keys().copied()), "numbers with gaps");
    let mention = Regex::new(r"theory, eqs?\. (\d+)(?:(?: to | and |, )(\d+))*").unwrap();
    let number = Regex::new(r"\d+").unwrap();
    let mut mentioned = 0;
    for (name, text) in sources() {
        for found in mention.find_iter(&text) {
            for number in number.find_iter(found.as_str()) {
                let number: u32 = number.as_str().parse().unwrap();
                assert!(equations.contains_key(&number), "{name}: `{}`: no such equation", found.as_str());
                mentioned += 1;
            }
        }
    }
    assert!(mentioned > 0, "no comment names an equation");
}

/// Whether a path as `module::Type::function` names something: all behind the module is defined in one file of it, or all of a path
/// that begins with a type in one file.
fn is_defined(path: &str, defined: &[(String, BTreeSet<String>)]) -> bool {
    let mut segments: Vec<&str> = path.split("::").collect();
    let module = segments[0].starts_with(char::is_lowercase).then(|| segments.remove(0));
    let is_of_module = |name: &str| {
        module.is_none_or(|module| {
            name.contains(&format!("/{module}/")) || name.ends_with(&format!("/{module}.rs"))
        })
    };
    defined
        .iter()
        .any(|(name, items)| is_of_module(name) && segments.iter().all(|part| items.contains(*part)))
}

#[test]
fn every_item_that_the_theory_names_exists() {
    let item = Regex::new(r"\b(?:fn|struct|enum|trait|const|static|mod|type)\s+(\w+)").unwrap();
    let defined: Vec<(String, BTreeSet<String>)> = sources()
        .into_iter()
        .map(|(name, text)| (name, item.captures_iter(&text).map(|found| found[1].to_owned()).collect()))
        .collect();
    let path = Regex::new(r"`(\w+(?:::\w+)+)`").unwrap();
    let book = Book::read(images::root()).unwrap();
    let mut named = 0;
    for page in book.pages().iter().filter(|page| page.name().starts_with(&format!("{MANUAL}/theory"))) {
        for found in path.captures_iter(&page.text()) {
            assert!(is_defined(&found[1], &defined), "{}: {}: no such item", page.name(), &found[1]);
            named += 1;
        }
    }
    assert!(named > 50, "{named} items");
    assert!(
        !is_defined("beam::no_such_function", &defined) && !is_defined("no_such_module::solve", &defined)
    );
}

/// The headings of a page of the manual, as they are written.
fn headings(book: &Book, name: &str) -> Vec<String> {
    let page = book.page(&format!("{MANUAL}/{name}")).unwrap();
    page.lines().iter().filter(|line| line.starts_with('#')).cloned().collect()
}

#[test]
fn every_json_document_has_its_place() {
    let schema = Regex::new(r#"(guide\.[a-z_-]+/\d+)\\?""#).unwrap();
    let book = Book::read(images::root()).unwrap();
    let headings = headings(&book, "json.md");
    // Other programs have documents of their own.
    let sources: Vec<(String, String)> = sources()
        .into_iter()
        .filter(|(name, _)| name.starts_with("host/") && !name.contains("test"))
        .collect();
    for (name, text) in &sources {
        for found in schema.captures_iter(text) {
            let heading = format!("### `{}`", &found[1]);
            assert!(headings.contains(&heading), "{name}: json.md has no heading {heading}");
        }
    }
    // And no heading is about a document that the program does not have.
    let documented = Regex::new(r"^### `((?:guide|needle)\.[a-z_-]+/\d+)`$").unwrap();
    let mut count = 0;
    for found in headings.iter().filter_map(|heading| documented.captures(heading)) {
        let quoted = format!("\"{}\"", &found[1]);
        assert!(
            sources.iter().any(|(_, text)| text.contains(&quoted)),
            "json.md: {quoted} is not in the source"
        );
        count += 1;
    }
    assert!(count > 40, "{count} documents found");
}

/// Names of what ends a steered run, as its results have them.
#[test]
fn every_fault_of_a_steered_run_has_its_place() {
    let name = Regex::new(r#"Self::\w+(?:\(_\)| \{ \.\. \})? => "([a-z_]+)","#).unwrap();
    let book = Book::read(images::root()).unwrap();
    let text = |name: &str| book.page(&format!("{MANUAL}/{name}")).unwrap().text();
    let pages = text("plants.md") + &text("commands/steer.md");
    let mut count = 0;
    for (file, text) in sources().iter().filter(|(name, _)| {
        ["host/steering/src/plant.rs", "host/steering/src/controller/error.rs"].contains(&name.as_str())
    }) {
        for found in name.captures_iter(text) {
            let row = format!("\n| `{}` | ", &found[1]);
            assert!(pages.contains(&row), "{file}: no row of plants.md or steer.md is about {}", &found[1]);
            count += 1;
        }
    }
    assert!(count > 20, "{count} names");
}

#[test]
fn every_fault_has_its_place() {
    let book = Book::read(images::root()).unwrap();
    let text = book.page(&format!("{MANUAL}/safety.md")).unwrap().text();
    for fault in Fault::ALL {
        let id = format!("<a id=\"fault-{}\"></a>", fault as u8);
        assert!(text.contains(&id), "safety.md has no place {id} for {fault:?}");
    }
}
