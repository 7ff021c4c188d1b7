//! Typesetting of made-up pages, and of every page of the manual.

use super::*;
use std::fs;
use std::path::{Path, PathBuf};

const PAGE: &str = "# Title\n\n**Eq. 1**\n\n```text\n1/b = (4 EI/K)^(1/4)\n```\n<!-- tex\n\\frac{1}{b} = \\left(\\frac{4 EI}{K}\\right)^{1/4}\n-->\n\nText.\n";

#[test]
fn an_equation_is_mathml_with_its_text_below_and_the_rest_is_kept() {
    let typeset = typeset(PAGE).unwrap();
    assert!(typeset.starts_with("# Title\n\n**Eq. 1**\n\n<div class=\"equation\"><math"), "{typeset}");
    assert!(
        typeset.contains("<mfrac>") && typeset.contains("```text\n1/b = (4 EI/K)^(1/4)\n```"),
        "{typeset}"
    );
    assert!(typeset.ends_with("\nText.\n") && !typeset.contains("<!--"), "{typeset}");
    // Fractions of full size, from the left edge.
    assert!(
        typeset.contains("<mtable displaystyle=\"true\"><mtr><mtd style=\"text-align: left;"),
        "{typeset}"
    );
    assert!(!typeset.contains("class=\"menv"), "{typeset}");
    // One line, as a blank one ends the block of HTML.
    assert_eq!(typeset.lines().filter(|line| line.contains("<math")).count(), 1);
}

#[test]
fn the_result_is_valid_html() {
    let typeset = typeset("```text\na < b\n```\n<!-- tex\n\\big(a < b\\big) > c\n-->\n").unwrap();
    assert!(typeset.contains("<mo>&lt;</mo>") && typeset.contains("<mo>&gt;</mo>"), "{typeset}");
    // Attributes are apart.
    assert!(
        !typeset.split('"').skip(2).step_by(2).any(|text| text.starts_with(char::is_alphabetic)),
        "{typeset}"
    );
}

#[test]
fn a_page_without_tex_stays_as_it_is() {
    let page = "A\n\n```text\nx\n```\n\n<!-- readme: quick -->\nB\n";
    assert_eq!(typeset(page).unwrap(), page);
}

fn failure(page: &str) -> String {
    typeset(page).unwrap_err().to_string()
}

#[test]
fn what_cannot_be_typeset_is_named_with_its_line() {
    assert!(failure("A\n<!-- tex\nx\n-->\n").starts_with("line 2: TeX that does not follow"));
    assert!(failure("```text\nx\n```\n\n<!-- tex\nx\n-->\n").starts_with("line 5: "));
    assert!(
        failure("```console\nx\n```\n<!-- tex\nx\n-->\n").starts_with("line 4: TeX that does not follow")
    );
    assert!(failure("```text\nx\n```\n<!-- tex\nx\n").starts_with("line 4: TeX without"));
    assert!(failure("```text\nx\n```\n<!-- tex\n\\frac{a\n-->\n").starts_with("line 4: "));
    assert!(failure("```text\nx\n```\n<!-- tex\n\\nosuchcommand\n-->\n").starts_with("line 4: "));
}

fn pages(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) = entries.partition(|path| path.is_dir());
    let nested_pages = folders.iter().flat_map(|folder| pages(folder));
    files
        .into_iter()
        .filter(|path| path.extension().is_some_and(|ending| ending == "md"))
        .chain(nested_pages)
        .collect()
}

/// Every equation of the manual is there twice, as text and as TeX, and as many rows of it as lines of text where that is a single one.
#[test]
fn every_equation_of_the_manual_is_typeset() {
    let manual = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../host/manual/src");
    let mut count = 0;
    for path in pages(&manual) {
        let page = fs::read_to_string(&path).unwrap();
        let typeset = typeset(&page).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let numbered = page.lines().filter(|line| line.starts_with("**Eq. ")).count();
        assert_eq!(typeset.matches("<div class=\"equation\">").count(), numbered, "{}", path.display());
        count += numbered;
    }
    assert!(count > 80, "{count} equations");
}
