//! Import circles between sibling modules: two modules of one parent that use each other, directly or through further siblings. A module
//! in a circle can be neither read nor tested without all others of it.
//!
//! A module stands for everything below it: where `a::x` uses `b::y` and `b::z` uses `a::w`, `a` and `b` are in a circle. A name that a
//! parent re-exports belongs to the module that defines it. Tests do not count.

mod graph;
mod modules;

use anyhow::{Context, Result, bail};
use graph::Circle;
use std::path::Path;
use std::process::Command;

/// Circles that stand, as the message prints them, and why. The list only gets shorter: a circle that has gone has to be removed from it.
const STANDING: [(&str, &str); 5] = [
    (
        "firmware: board, qemu",
        "the layer of QEMU takes the place of peripherals at the addresses that the board's pins name",
    ),
    ("firmware: board: pins, registers", "each board lists the registers that are read back at its start"),
    ("firmware: qemu: peripherals, time", "the emulated time ends in resets, which peripherals carry out"),
    (
        "host/diagnose: adequacy, characterize, discrepancy, evidence, known, layout, posterior, results, score, search, sizes, \
         split, start",
        "a parameter that is known has a layout, and the layout of a fit has what is known",
    ),
    (
        "host/mechanics: effects, insertion, predict, prepared, prestress",
        "an effect acts on the channels of the forward model, which applies the effects",
    ),
];

/// Searches all crates of the workspace.
///
/// # Errors
/// Every circle that is not on the list, with the imports that close it; every line of the list without its circle.
pub fn check() -> Result<()> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--", "Cargo.toml", "*/Cargo.toml"])
        .output()
        .context("cannot list the project's crates with git")?;
    let mut circles = Vec::new();
    for manifest in String::from_utf8(listed.stdout)?.split_terminator('\0') {
        let folder = Path::new(manifest).parent().unwrap_or(Path::new(""));
        for root in ["src/lib.rs", "src/main.rs"] {
            let root = folder.join(root);
            if root.is_file() {
                circles.extend(graph::circles(&folder.display().to_string(), &modules::read(&root)?));
            }
        }
    }
    let complaints = complaints(&circles, &STANDING);
    if !complaints.is_empty() {
        bail!("import circles between sibling modules (tests/xtask/src/circles.rs):{complaints}");
    }
    Ok(())
}

/// New circles, and lines of the list that no circle has.
fn complaints(circles: &[Circle], standing: &[(&str, &str)]) -> String {
    let mut found = String::new();
    for circle in circles.iter().filter(|circle| standing.iter().all(|(name, _)| *name != circle.name)) {
        found += &format!("\n{}", circle.name);
        for import in &circle.imports {
            found += &format!("\n    {import}");
        }
    }
    for (name, _) in standing.iter().filter(|(name, _)| circles.iter().all(|circle| circle.name != *name)) {
        found += &format!("\nthere is no such circle any more, remove it from the list: {name}");
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_a_new_circle_with_its_imports_and_a_line_of_the_list_without_its_circle() {
        let circle =
            Circle { name: "host/one: a, b".into(), imports: vec!["a -> b".into(), "b -> a".into()] };
        assert_eq!(complaints(&[circle], &[]), "\nhost/one: a, b\n    a -> b\n    b -> a");
        let circle = Circle { name: "host/one: a, b".into(), imports: Vec::new() };
        assert_eq!(complaints(&[circle], &[("host/one: a, b", "a reason")]), "");
        let gone = complaints(&[], &[("host/one: a, b", "a reason")]);
        assert_eq!(gone, "\nthere is no such circle any more, remove it from the list: host/one: a, b");
    }
}
