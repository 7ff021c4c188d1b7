//! The pictures of the page: which it shows, and whether they are those that the commands draw.

use super::PICTURES;
use super::page::Page;
use crate::images;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// More is too much for a page, bytes.
const LARGEST: usize = 60_000;

/// Names of the pictures that the page shows.
fn shown(page: &Page) -> BTreeSet<String> {
    let prefix = format!("]({PICTURES}/");
    let names = page.lines().iter().flat_map(|line| line.split(prefix.as_str()).skip(1));
    names.filter_map(|rest| Some(rest.split_once(')')?.0.to_owned())).collect()
}

/// What is wrong with the committed pictures, if these were drawn now.
pub fn differing(page: &Page, drawn: &Path) -> Vec<String> {
    let folder = images::root().join(PICTURES);
    let shown = shown(page);
    let mut complaints = Vec::new();
    for name in &shown {
        let file = format!("{PICTURES}/{name}");
        match (fs::read(folder.join(name)), fs::read(drawn.join(name))) {
            (_, Err(_)) => complaints.push(format!("{file}: no command of README.md draws figures/{name}")),
            (Err(_), _) => complaints.push(format!("{file}: missing")),
            (Ok(kept), Ok(_)) if kept.len() > LARGEST => {
                complaints.push(format!("{file}: {} bytes, expected at most {LARGEST}", kept.len()));
            }
            (Ok(kept), Ok(now)) if kept != now => {
                complaints.push(format!("{file}: the commands of README.md draw another picture"));
            }
            _ => {}
        }
    }
    let kept = fs::read_dir(&folder).into_iter().flatten().flatten();
    let names = kept.map(|entry| entry.file_name().to_string_lossy().into_owned());
    complaints.extend(
        names
            .filter(|name| !shown.contains(name))
            .map(|name| format!("{PICTURES}/{name}: not shown in README.md")),
    );
    complaints
}

/// Keeps the pictures that the page shows.
pub fn take(page: &Page, drawn: &Path) -> Result<()> {
    let folder = images::root().join(PICTURES);
    fs::create_dir_all(&folder)?;
    for name in shown(page) {
        let (from, to) = (drawn.join(&name), folder.join(&name));
        fs::copy(&from, &to).with_context(|| format!("no command of README.md draws figures/{name}"))?;
    }
    Ok(())
}
