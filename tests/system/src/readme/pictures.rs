//! The pictures of the pages: which they show, and whether they are those that the commands draw.

use super::PICTURES;
use super::book::Book;
use crate::images;
use anyhow::{Context, Result};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// More is too much for a page, bytes.
const LARGEST: usize = 60_000;

/// Names of the pictures that the pages show.
fn shown(book: &Book) -> BTreeSet<String> {
    let folder = PICTURES.rsplit('/').next().unwrap_or(PICTURES);
    let texts: Vec<String> = book.pages().iter().map(|page| page.text()).collect();
    let links = texts.iter().flat_map(|text| text.split("](").skip(1));
    let names = links.filter_map(|rest| {
        let (path, name) = rest.split_once(')')?.0.rsplit_once('/')?;
        (path.rsplit('/').next() == Some(folder)).then(|| name.to_owned())
    });
    names.collect()
}

/// Faults of the committed pictures, if these were drawn now.
pub fn differing(book: &Book, drawn: &Path) -> Vec<String> {
    let folder = images::root().join(PICTURES);
    let shown = shown(book);
    let mut complaints = Vec::new();
    for name in &shown {
        let file = format!("{PICTURES}/{name}");
        match (fs::read(folder.join(name)), fs::read(drawn.join(name))) {
            (_, Err(_)) => complaints.push(format!("{file}: no command of the pages draws figures/{name}")),
            (Err(_), _) => complaints.push(format!("{file}: missing")),
            (Ok(kept), Ok(_)) if kept.len() > LARGEST => {
                complaints.push(format!("{file}: {} bytes, expected at most {LARGEST}", kept.len()));
            }
            (Ok(kept), Ok(now)) if kept != now => {
                complaints.push(format!("{file}: the commands of the pages draw another picture"));
            }
            _ => {}
        }
    }
    let committed = fs::read_dir(&folder).into_iter().flatten().flatten();
    let names = committed.map(|entry| entry.file_name().to_string_lossy().into_owned());
    complaints.extend(
        names
            .filter(|name| !shown.contains(name))
            .map(|name| format!("{PICTURES}/{name}: not shown on any page")),
    );
    complaints
}

/// Keeps the pictures that the pages show.
pub fn take(book: &Book, drawn: &Path) -> Result<()> {
    let folder = images::root().join(PICTURES);
    fs::create_dir_all(&folder)?;
    for name in shown(book) {
        let (drawn_picture, committed_picture) = (drawn.join(&name), folder.join(&name));
        fs::copy(&drawn_picture, &committed_picture)
            .with_context(|| format!("no command of the pages draws figures/{name}"))?;
    }
    Ok(())
}
