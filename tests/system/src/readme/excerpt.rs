//! Excerpts: blocks that show some lines of an output that stands in full elsewhere.
//!
//! A line `...` marks what is omitted; lines without one between them follow each other in the output too. So a page can show the
//! interesting part of a long output, and still shows nothing that the command does not print.

use super::page::{Block, Made};

/// Marks omitted lines.
const OMITTED: &str = "...";

/// What is wrong with the excerpts among these blocks.
pub fn complaints(blocks: &[Block]) -> Vec<String> {
    blocks.iter().filter_map(|block| complaint(block, blocks)).collect()
}

fn complaint(block: &Block, all: &[Block]) -> Option<String> {
    let Made::Excerpt(part) = &block.made else { return None };
    let sources: Vec<&Block> = all
        .iter()
        .filter(|other| match (part, &other.made) {
            (Some(part), Made::Rig(name)) => part == name,
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
    let whose = part.as_ref().map_or("in any output".to_owned(), |part| format!("in part {part}"));
    match reached {
        Some(Ok(())) => None,
        Some(Err(line)) => {
            let place = block.place_of(line);
            let text = block.lines().get(line).map_or("", String::as_str);
            Some(format!("{place}: `{text}` does not follow {whose} at this place"))
        }
        None => Some(format!("{}: no block to compare with {whose}", block.place())),
    }
}

/// Whether the pieces are in the text one after the other, else the excerpt's line from which on they are not.
fn in_order(pieces: &[&[String]], text: &[String]) -> Result<(), usize> {
    let (mut from, mut line) = (0, 0);
    for piece in pieces {
        if !piece.is_empty() {
            let found = (from..text.len()).find(|start| text[*start..].starts_with(piece));
            let Some(found) = found else {
                let longest = (from..text.len())
                    .map(|start| piece.iter().zip(&text[start..]).take_while(|(a, b)| a == b).count());
                return Err(line + longest.max().unwrap_or(0));
            };
            from = found + piece.len();
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
            let found = of(excerpt, mark).join("\n");
            assert!(found.contains(word), "{excerpt:?}: {found}");
        }
    }
}
