//! A page as lines, and the blocks in it that are made.

use super::tolerance::Tolerance;
use anyhow::{Context, Result, bail, ensure};
use std::fs;
use std::ops::Range;
use std::path::Path;

/// Begin of the line that states when a block was made.
const SIGNED: &str = "Made on ";

/// Source of a block.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Made {
    /// Its own commands, without a rig.
    Quick,
    /// No command: it is a file that later commands read.
    File(String),
    /// A part of what a rig shows.
    Rig(String),
    /// Lines of other blocks: of this part of the rig, or of those with the same commands.
    Excerpt(Option<String>),
    /// A section of the table of unknowns.
    Assumptions(String),
    /// A command that takes long. Below the block a line states when it was.
    Long(String),
}

/// A marked block: what stands in a fence, or a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Block {
    /// Source of the block.
    pub made: Made,
    /// Its commands fail.
    pub fails: bool,
    /// Allowed difference of its numbers from those of the command.
    pub tolerance: Tolerance,
    /// Its page, from the root.
    page: String,
    /// Its lines, without the fence, counted from 0.
    range: Range<usize>,
    lines: Vec<String>,
}

impl Block {
    /// Its lines.
    pub fn lines(&self) -> &[String] {
        &self.lines
    }

    /// Its lines, each with its end.
    pub fn text(&self) -> String {
        self.lines.iter().map(|line| format!("{line}\n")).collect()
    }

    /// Its page, from the root.
    pub fn page(&self) -> &str {
        &self.page
    }

    /// File and number of a line of it.
    pub fn place_of(&self, line: usize) -> String {
        format!("{}:{}", self.page, self.range.start + line + 1)
    }

    /// File and number of its first line.
    pub fn place(&self) -> String {
        self.place_of(0)
    }

    /// Whether it is a table of Markdown.
    pub fn is_table(&self) -> bool {
        self.lines.first().is_some_and(|line| line.starts_with('|'))
    }
}

/// A page of Markdown.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Page {
    name: String,
    lines: Vec<String>,
}

impl Page {
    /// Reads the page with this name: its path from the root.
    ///
    /// # Errors
    /// Where there is none.
    pub fn read(root: &Path, name: &str) -> Result<Self> {
        let text = fs::read_to_string(root.join(name)).with_context(|| format!("{name}: cannot read"))?;
        Ok(Self::of(name, &text))
    }

    /// From its text.
    pub fn of(name: &str, text: &str) -> Self {
        Self { name: name.to_owned(), lines: text.lines().map(str::to_owned).collect() }
    }

    /// Its path from the root.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its text.
    pub fn text(&self) -> String {
        self.lines.iter().map(|line| format!("{line}\n")).collect()
    }

    /// Its lines.
    pub fn lines(&self) -> &[String] {
        &self.lines
    }

    /// The marked blocks.
    ///
    /// # Errors
    /// Where a mark is not understood, has no block after it, or a fence has no end.
    pub fn blocks(&self) -> Result<Vec<Block>> {
        let (mut blocks, mut tolerance) = (Vec::new(), Tolerance::default());
        for (number, line) in self.lines.iter().enumerate() {
            let Some(mark) = line.strip_prefix("<!-- readme: ").and_then(|rest| rest.strip_suffix(" -->"))
            else {
                continue;
            };
            let place = || format!("{}:{}: `{mark}`", self.name, number + 1);
            if let Some(stated) = Tolerance::read(mark).with_context(place)? {
                tolerance = stated;
                continue;
            }
            let (what, fails) = mark.strip_suffix(" fails").map_or((mark, false), |what| (what, true));
            let maker = match what.split_once(' ') {
                None if what == "quick" => Made::Quick,
                None if what == "excerpt" => Made::Excerpt(None),
                Some(("excerpt", part)) => Made::Excerpt(Some(part.to_owned())),
                Some(("file", name)) => Made::File(name.to_owned()),
                Some(("assumptions", section)) => Made::Assumptions(section.to_owned()),
                Some(("rig", part)) => Made::Rig(part.to_owned()),
                Some(("long", command)) => Made::Long(command.to_owned()),
                _ => bail!(
                    "{}: expected `quick`, `file NAME`, `assumptions SECTION`, `rig PART`, `long COMMAND`, `excerpt`, `excerpt PART` or `numbers within N %`; \
                     `fails` after it where the commands fail",
                    place()
                ),
            };
            let range = self.block_after(number).with_context(place)?;
            ensure!(!range.is_empty(), "{}: the block is empty", place());
            let lines = self.lines[range.clone()].to_vec();
            blocks.push(Block { made: maker, fails, tolerance, page: self.name.clone(), range, lines });
        }
        Ok(blocks)
    }

    fn block_after(&self, mark: usize) -> Result<Range<usize>> {
        let first = mark + 1;
        if self.line_is(first, &|line| line.starts_with("```")) {
            let end = self.end_line(first + 1, &|line| line == "```").context("the block has no end")?;
            return Ok(first + 1..end);
        }
        // A table stands apart from a comment, else it is shown as text.
        if self.line_is(first, &str::is_empty) && self.line_is(first + 1, &|line| line.starts_with('|')) {
            let end = self.end_line(first + 1, &|line| !line.starts_with('|')).unwrap_or(self.lines.len());
            return Ok(first + 1..end);
        }
        bail!("expected a fence in the next line, or a table after an empty one")
    }

    fn end_line(&self, from: usize, what: &dyn Fn(&str) -> bool) -> Option<usize> {
        (from..self.lines.len()).find(|line| what(&self.lines[*line]))
    }

    fn line_is(&self, line: usize, what: &dyn Fn(&str) -> bool) -> bool {
        self.lines.get(line).is_some_and(|line| what(line))
    }

    /// Gives blocks of this page another text; those that take long state below that they are of this day.
    pub fn replace(&mut self, mut fresh: Vec<(Block, String)>, today: &str) {
        // From the end, so that the places before it stay right.
        fresh.sort_by_key(|(block, _)| std::cmp::Reverse(block.range.start));
        for (block, text) in fresh {
            if let Made::Long(command) = &block.made {
                self.sign(block.range.end, &format!("{SIGNED}{today} by `{command}`."));
            }
            self.lines.splice(block.range, text.lines().map(str::to_owned));
        }
    }

    /// Puts a line below a block that ends before this one, in the place of an earlier one.
    fn sign(&mut self, end: usize, words: &str) {
        let next_line = end + usize::from(self.lines.get(end).is_some_and(|line| line == "```"));
        let is_signed = self.lines.get(next_line + 1).is_some_and(|line| line.starts_with(SIGNED));
        let replaced = if is_signed { next_line..next_line + 2 } else { next_line..next_line };
        self.lines.splice(replaced, [String::new(), words.to_owned()]);
    }

    /// Writes it.
    ///
    /// # Errors
    /// Where that is not possible.
    pub fn write(&self, root: &Path) -> Result<()> {
        fs::write(root.join(&self.name), self.text()).with_context(|| format!("{}: cannot write", self.name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# A\n<!-- readme: quick -->\n```console\n$ guide ports\nnone\n```\n\n\
                        <!-- readme: long cargo x -->\n\n| a |\n|---|\n| 1 |\n\n```text\nleft alone\n```\n";

    #[test]
    fn marked_blocks_are_found_and_replaced() {
        let mut page = Page::of("a.md", TEXT);
        let blocks = page.blocks().unwrap();
        assert_eq!(blocks.len(), 2);
        assert_eq!(
            (&blocks[0].made, blocks[0].place(), blocks[0].text().as_str()),
            (&Made::Quick, "a.md:4".to_owned(), "$ guide ports\nnone\n")
        );
        assert_eq!((blocks[1].is_table(), blocks[1].lines().len()), (true, 3));
        let fresh = ["$ guide ports\none\ntwo", "| a |\n|---|\n| 2 |"];
        for today in ["2024-02-29", "2024-03-01"] {
            let blocks = page.blocks().unwrap();
            page.replace(blocks.into_iter().zip(fresh.map(str::to_owned)).collect(), today);
            let signed = format!("| 2 |\n\nMade on {today} by `cargo x`.");
            assert_eq!(page, Page::of("a.md", &TEXT.replace("none", "one\ntwo").replace("| 1 |", &signed)));
        }
    }

    #[test]
    fn marks_that_are_not_understood_are_named() {
        for (text, word) in [
            ("<!-- readme: slow -->\n```\na\n```\n", "a.md:1: `slow`: expected `quick`"),
            ("<!-- readme: quick -->\ntext\n", "expected a fence"),
            ("<!-- readme: quick -->\n```\nno end\n", "has no end"),
            ("<!-- readme: quick -->\n```\n```\n", "is empty"),
        ] {
            let error = format!("{:#}", Page::of("a.md", text).blocks().unwrap_err());
            assert!(error.contains(word), "{error}");
        }
    }
}
