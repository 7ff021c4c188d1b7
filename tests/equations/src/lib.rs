//! Typesets the equations of the manual.
//!
//! A page has each equation as plain text, which every terminal and editor shows, and behind it the same in TeX, in a comment that no
//! reader of Markdown shows:
//!
//! ````text
//! ```text
//! 1/b = (4 EI/K)^(1/4)
//! ```
//! <!-- tex
//! 1/b = (4 EI/K)^{1/4}
//! -->
//! ````
//!
//! In the manual as a site the TeX takes the place of the text, as MathML, which browsers draw without a script or a font of ours; the text
//! remains below it, folded. An equation without TeX stays as it is. mdBook calls the program `equations` as a preprocessor.
//!
//! ```
//! let page = "```text\na/b\n```\n<!-- tex\n\\frac{a}{b}\n-->\n";
//! let typeset = equations::typeset(page)?;
//! assert!(typeset.contains("<mfrac>") && typeset.contains("a/b"));
//! # Ok::<(), equations::EquationError>(())
//! ```
#![forbid(unsafe_code)]

use pulldown_latex::config::{DisplayMode, RenderConfig};
use pulldown_latex::{Event, Parser, Storage, push_mathml};

/// Line before the TeX of an equation.
const BEGIN: &str = "<!-- tex";
/// Line after it.
const END: &str = "-->";
/// Begin of rows below each other, as the library writes it.
const ALIGNED: &str = "<mtable class=\"menv-alignlike menv-align\">";
/// Spellings of the library that are no valid HTML, with valid ones.
const REPAIRS: [(&str, &str); 3] =
    [("\"minsize=", "\" minsize="), ("<mo><</mo>", "<mo>&lt;</mo>"), ("<mo>></mo>", "<mo>&gt;</mo>")];
/// Fences of the plain text.
const FENCES: [&str; 2] = ["```text", "```"];

/// Why an equation cannot be typeset.
#[derive(Debug, thiserror::Error)]
pub enum EquationError {
    /// The comment does not follow the plain text of an equation.
    #[error("line {line}: TeX that does not follow a block of plain text")]
    Alone {
        /// Line of the comment, counted from 1.
        line: usize,
    },
    /// The comment has no end.
    #[error("line {line}: TeX without a line `{END}` after it")]
    Open {
        /// Line of the comment, counted from 1.
        line: usize,
    },
    /// The TeX is not understood.
    #[error("line {line}: {reason}")]
    Tex {
        /// Line of the comment, counted from 1.
        line: usize,
        /// Reason of the parser.
        reason: String,
    },
}

/// The page with its equations typeset.
///
/// # Errors
/// [`EquationError`] for the first equation that cannot be typeset.
pub fn typeset(page: &str) -> Result<String, EquationError> {
    let mut lines: Vec<String> = Vec::new();
    let mut remaining_lines = page.lines().enumerate();
    while let Some((index, line)) = remaining_lines.next() {
        if line.trim_end() != BEGIN {
            lines.push(line.to_owned());
            continue;
        }
        let number = index + 1;
        let rows: Vec<&str> =
            remaining_lines.by_ref().map(|(_, row)| row).take_while(|row| row.trim_end() != END).collect();
        if rows.is_empty() || page.lines().nth(index + rows.len() + 1).map(str::trim_end) != Some(END) {
            return Err(EquationError::Open { line: number });
        }
        let text_begin = begin_of_text(&lines).ok_or(EquationError::Alone { line: number })?;
        let text = lines.split_off(text_begin);
        let mathml = mathml(&rows).map_err(|reason| EquationError::Tex { line: number, reason })?;
        lines.push(format!("<div class=\"equation\">{mathml}</div>"));
        lines.extend(["", "<details class=\"plain\"><summary>as text</summary>", ""].map(str::to_owned));
        lines.extend(text);
        lines.extend(["", "</details>", ""].map(str::to_owned));
    }
    Ok(lines.join("\n") + "\n")
}

/// Index of the line with which the plain text begins that ends with the last line.
fn begin_of_text(lines: &[String]) -> Option<usize> {
    let [begin, end] = FENCES;
    let (last_line, earlier_lines) = lines.split_last()?;
    let index = earlier_lines.iter().rposition(|line| line.starts_with(end))?;
    (last_line == end && earlier_lines.get(index).is_some_and(|line| line == begin)).then_some(index)
}

/// The rows of an equation, one below the other from the same left edge, on one line.
fn mathml(rows: &[&str]) -> Result<String, String> {
    let rows: Vec<String> = rows.iter().map(|row| format!("& {row}")).collect();
    let tex = format!(r"\begin{{aligned}} {} \end{{aligned}}", rows.join(r" \\ "));
    let storage = Storage::new();
    let events: Result<Vec<Event<'_>>, _> = Parser::new(&tex, &storage).collect();
    let events =
        events.map_err(|error| error.to_string().split_whitespace().collect::<Vec<_>>().join(" "))?;
    let config = RenderConfig { display_mode: DisplayMode::Block, ..RenderConfig::default() };
    let mut mathml = String::new();
    let parsed = events.into_iter().map(Ok::<_, pulldown_latex::ParserError>);
    push_mathml(&mut mathml, parsed, config).map_err(|error| error.to_string())?;
    // The library leaves the style of its tables to a style sheet, which not every copy of the manual has.
    let styled = mathml
        .replace(ALIGNED, "<mtable displaystyle=\"true\">")
        .replace("<mtr><mtd></mtd><mtd>", "<mtr><mtd style=\"text-align: left; padding: .25em 0\">");
    // It also leaves out a blank between two attributes, and writes signs of comparison as they are.
    let valid = REPAIRS.iter().fold(styled, |text, (written, valid)| text.replace(written, valid));
    Ok(valid.replace('\n', " "))
}

#[cfg(test)]
mod tests;
