//! Excerpts: blocks that show some lines of an output that stands in full elsewhere.
//!
//! A line `...` marks what is omitted; lines without one between them follow each other in the output too. So a page can show the
//! interesting part of a long output, and still shows nothing that the command does not print.

use super::page::{Block, Made};

/// Marks omitted lines.
const OMITTED: &str = "...";

/// Faults of the excerpts among these blocks.
pub fn complaints(blocks: &[Block]) -> Vec<String> {
    blocks.iter().filter_map(|block| complaint(block, blocks)).collect()
}

fn complaint(block: &Block, all: &[Block]) -> Option<String> {
    let Made::Excerpt(excerpt_part) = &block.made else { return None };
    let sources: Vec<&Block> = all
        .iter()
        .filter(|other| match (excerpt_part, &other.made) {
            (Some(excerpt_part), Made::Rig(name)) => excerpt_part == name,
            (Some(_), _) | (None, Made::Excerpt(_) | Made::File(_)) => false,
            (None, _) => true,
        })
        .collect();
    let pieces: Vec<&[String]> = block.lines().split(|line| line.trim() == OMITTED).collect();
    if pieces.iter().all(|piece| piece.is_empty()) {
        return Some(format!("{}: an excerpt without lines", block.place()));
    }
    // The line that gets furthest shows best what is wrong.
    let reached = sources
        .iter()
        .map(|source| in_order(&pieces, source.lines()))
        .max_by_key(|found| found.as_ref().map_or_else(|line| *line, |()| usize::MAX));
    let location = excerpt_part
        .as_ref()
        .map_or("in any output".to_owned(), |excerpt_part| format!("in part {excerpt_part}"));
    match reached {
        Some(Ok(())) => None,
        Some(Err(line)) => {
            let position = block.place_of(line);
            let text = block.lines().get(line).map_or("", String::as_str);
            Some(format!("{position}: `{text}` does not follow {location} at this place"))
        }
        None => Some(format!("{}: no block to compare with {location}", block.place())),
    }
}

/// Whether the pieces are in the text one after the other, else the excerpt's line from which on they are not.
fn in_order(pieces: &[&[String]], text: &[String]) -> Result<(), usize> {
    let (mut offset, mut line) = (0, 0);
    for piece in pieces {
        if !piece.is_empty() {
            let match_offset = (offset..text.len()).find(|start| text[*start..].starts_with(piece));
            let Some(match_offset) = match_offset else {
                let longest = (offset..text.len())
                    .map(|start| piece.iter().zip(&text[start..]).take_while(|(a, b)| a == b).count());
                return Err(line + longest.max().unwrap_or(0));
            };
            offset = match_offset + piece.len();
        }
        line += piece.len() + 1;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readme::page::Page;

    fn of(excerpt: &str, mark: &str) -> Vec<String> {
        let text = format!(
            "<!-- readme: quick -->\n```\n$ guide a\none\ntwo\nthree\nfour\n```\n\
             <!-- readme: rig demo -->\n```\nfive\nsix\n```\n<!-- readme: {mark} -->\n```\n{excerpt}\n```\n"
        );
        complaints(&Page::of("a.md", &text).blocks().unwrap())
    }

    #[test]
    fn an_excerpt_has_lines_of_one_output_in_their_order() {
        assert!(of("$ guide a\none\n...\nthree", "excerpt").is_empty());
        assert!(of("five\n...", "excerpt demo").is_empty());
        for (excerpt, mark, word) in [
            ("$ guide a\none\nthree", "excerpt", "a.md:18: `three` does not follow"),
            ("three\n...\none", "excerpt", "a.md:18: `one`"),
            ("one\n...\nfive", "excerpt", "`five` does not follow in any output"),
            ("one", "excerpt demo", "in part demo"),
            ("one", "excerpt other", "no block to compare with in part other"),
            ("...", "excerpt", "without lines"),
        ] {
            let complaints = of(excerpt, mark).join("\n");
            assert!(complaints.contains(word), "{excerpt:?}: {complaints}");
        }
    }
}
