//! The linked image of the board: what can panic in it, and what can call itself.

use std::collections::BTreeMap;
use system::images::{self, Image};
use system::panics;

fn image() -> Vec<u8> {
    std::fs::read(images::build(Image::Flash).unwrap()).unwrap()
}

/// Sources and numbers of places of the manual's table; no number for a library.
fn listed() -> BTreeMap<String, Option<usize>> {
    let page = std::fs::read_to_string(images::root().join("host/manual/src/panics.md")).unwrap();
    page.lines()
        .filter_map(|line| {
            let mut cells = line.strip_prefix("| `")?.split(" | ");
            let source = cells.next()?.trim_end_matches('`').to_owned();
            let count = cells.next()?.parse().ok();
            cells.next().map(|_why| (source, count))
        })
        .collect()
}

#[test]
#[ignore = "needs the firmware's toolchain: cargo xtask test --all runs it"]
fn every_place_that_can_panic_is_listed_with_the_reason_why_it_is_not_reached() {
    let (panic_sites, listed) = (panics::sources(&image()).unwrap(), listed());
    assert!(panic_sites.values().sum::<usize>() > 50, "the search finds them: {panic_sites:?}");
    for (source, places) in &panic_sites {
        let most = listed
            .get(source)
            .unwrap_or_else(|| panic!("{source} can panic and is not listed: {panic_sites:#?}"));
        assert!(most.is_none_or(|most| *places <= most), "{source}: {places} places, {most:?} are listed");
    }
    for source in listed.keys() {
        assert!(panic_sites.contains_key(source), "{source} is listed, and nothing in it panics");
    }
}

#[test]
#[ignore = "needs the firmware's toolchain: cargo xtask test --all runs it"]
fn nothing_calls_itself_but_a_panic_and_the_log() {
    let recursive = panics::recursive(&image()).unwrap();
    println!("{recursive:#?}");
    let is_expected =
        |name: &&String| ["panic", "rust_begin_unwind", "defmt"].iter().any(|part| name.contains(part));
    let unexpected: Vec<_> = recursive.iter().filter(|name| !is_expected(name)).collect();
    assert!(unexpected.is_empty(), "{unexpected:#?} can call themselves");
}
