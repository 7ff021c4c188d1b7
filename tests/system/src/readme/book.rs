//! README.md and the pages of the manual, in the order of reading.

use super::page::{Block, Page};
use anyhow::{Context, Result, bail, ensure};
use std::path::Path;

/// Folder of the manual, from the root.
pub const MANUAL: &str = "host/manual/src";
/// The list of its pages.
const SUMMARY: &str = "SUMMARY.md";
/// Pages beside the manual whose links are checked with it.
const BESIDE: [&str; 4] = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"];

/// All pages.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Book {
    pages: Vec<Page>,
}

impl Book {
    /// Reads the manual's pages in the order of its summary, then those beside it.
    ///
    /// # Errors
    /// Where a page is missing, or lies in the manual without being in the summary.
    pub fn read(root: &Path) -> Result<Self> {
        let summary = Page::read(root, &format!("{MANUAL}/{SUMMARY}"))?;
        let mut names: Vec<String> =
            linked(&summary.text()).iter().map(|name| format!("{MANUAL}/{name}")).collect();
        let mut listed = names.clone();
        listed.sort_unstable();
        let twice = listed.windows(2).find(|pair| pair[0] == pair[1]);
        ensure!(twice.is_none(), "{}: a page is listed twice: {twice:?}", summary.name());
        for name in files(&root.join(MANUAL))? {
            let name = format!("{MANUAL}/{name}");
            if name != summary.name() && listed.binary_search(&name).is_err() {
                bail!("{name}: not in {}", summary.name());
            }
        }
        names.push(summary.name().to_owned());
        names.extend(BESIDE.map(str::to_owned));
        let pages: Result<Vec<Page>> = names.iter().map(|name| Page::read(root, name)).collect();
        Ok(Self { pages: pages? })
    }

    /// From pages.
    #[cfg(test)]
    pub fn of(pages: Vec<Page>) -> Self {
        Self { pages }
    }

    /// Its pages.
    pub fn pages(&self) -> &[Page] {
        &self.pages
    }

    /// The page with this path from the root.
    pub fn page(&self, name: &str) -> Option<&Page> {
        self.pages.iter().find(|page| page.name() == name)
    }

    /// The marked blocks of all pages, in the order of reading.
    ///
    /// # Errors
    /// Where a mark is not understood, has no block after it, or a fence has no end.
    pub fn blocks(&self) -> Result<Vec<Block>> {
        let mut blocks = Vec::new();
        for page in &self.pages {
            blocks.extend(page.blocks()?);
        }
        Ok(blocks)
    }

    /// Gives blocks another text, and writes the pages that this changes.
    ///
    /// # Errors
    /// Where a page cannot be written.
    pub fn replace(&mut self, root: &Path, fresh: Vec<(Block, String)>, today: &str) -> Result<()> {
        for page in &mut self.pages {
            let page_blocks: Vec<(Block, String)> =
                fresh.iter().filter(|(block, _)| block.page() == page.name()).cloned().collect();
            if !page_blocks.is_empty() {
                page.replace(page_blocks, today);
                page.write(root)?;
            }
        }
        Ok(())
    }
}

/// The files that a summary links to, in its order.
fn linked(summary: &str) -> Vec<String> {
    let links = summary.lines().filter_map(|line| Some(line.split_once("](")?.1.split_once(')')?.0));
    links.filter(|name| name.ends_with(".md")).map(|name| name.trim_start_matches("./").to_owned()).collect()
}

/// Pages in a folder, with those of its folders.
fn files(folder: &Path) -> Result<Vec<String>> {
    let mut paths = Vec::new();
    let entries = std::fs::read_dir(folder).with_context(|| format!("{}: cannot list", folder.display()))?;
    for entry in entries {
        let entry = entry?;
        let name = entry.file_name().to_string_lossy().into_owned();
        if entry.file_type()?.is_dir() {
            paths.extend(files(&entry.path())?.iter().map(|inner| format!("{name}/{inner}")));
        } else if name.ends_with(".md") {
            paths.push(name);
        }
    }
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIST: &str = "# Summary\n\n[First](first.md)\n- [A](./a.md)\n  - [B](a/b.md)\n- [Draft]()\n";

    #[test]
    fn the_summary_gives_the_order_and_every_page_is_in_it() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join(MANUAL);
        std::fs::create_dir_all(folder.join("a")).unwrap();
        std::fs::write(folder.join(SUMMARY), LIST).unwrap();
        for name in ["first.md", "a.md", "a/b.md"] {
            std::fs::write(folder.join(name), "# Title\n").unwrap();
        }
        for name in BESIDE {
            std::fs::write(root.path().join(name), "# Title\n").unwrap();
        }
        let book = Book::read(root.path()).unwrap();
        let names: Vec<&str> = book.pages().iter().take(3).map(Page::name).collect();
        assert_eq!(names, ["first.md", "a.md", "a/b.md"].map(|name| format!("{MANUAL}/{name}")));
        std::fs::write(folder.join("a/c.md"), "# Title\n").unwrap();
        let error = format!("{:#}", Book::read(root.path()).unwrap_err());
        assert!(error.contains("a/c.md: not in"), "{error}");
        std::fs::remove_file(folder.join("a/c.md")).unwrap();
        std::fs::remove_file(folder.join("a/b.md")).unwrap();
        let error = format!("{:#}", Book::read(root.path()).unwrap_err());
        assert!(error.contains("a/b.md: cannot read"), "{error}");
    }
}
