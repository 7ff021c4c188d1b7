//! Text of others on its way to a terminal, a log or a document.
//!
//! Names in sessions, paths, what a device says of its board and peers of themselves may hold anything: sequences that move the cursor, colour
//! or rename a terminal, and marks that turn the direction of writing. All results, remarks, errors and documents pass through [`printable`].

use std::borrow::Cow;
use std::fmt::Write;

/// Form of an escaped character.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// `\u{1b}`, for people.
    Text,
    /// `\u001b`, in strings of a JSON document.
    Json,
}

/// The text with every character escaped that does something to its reader instead of being shown; line ends and tabulators stay.
pub fn printable(text: &str, form: Form) -> Cow<'_, str> {
    if !text.contains(acts) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        match form {
            _ if !acts(c) => shown.push(c),
            // All of them have four digits at most.
            Form::Json => _ = write!(shown, "\\u{:04x}", u32::from(c)),
            Form::Text => _ = write!(shown, "\\u{{{:x}}}", u32::from(c)),
        }
    }
    Cow::Owned(shown)
}

/// Controls of C0 and C1, marks of direction, and what is no character.
pub(crate) fn acts(c: char) -> bool {
    c.is_control() && !matches!(c, '\n' | '\t')
        || matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{fffe}' | '\u{ffff}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_acts_on_a_terminal_is_shown_and_what_does_not_stays() {
        let hostile = "board\u{1b}]0;owned\u{7}\u{9b}2J\r\u{7f}\u{202e}x\n\tµm";
        let text = printable(hostile, Form::Text);
        assert_eq!(text, "board\\u{1b}]0;owned\\u{7}\\u{9b}2J\\u{d}\\u{7f}\\u{202e}x\n\tµm");
        assert!(matches!(printable("1.2 µm ± 3 \n", Form::Text), Cow::Borrowed(_)));
    }

    #[test]
    fn a_document_reads_back_as_it_was() {
        let hostile = "board\u{1b}[2J\u{9b}2J\u{7f}\u{202e}x";
        let document = serde_json::to_string(hostile).expect("a string");
        let shown = printable(&document, Form::Json);
        assert!(!shown.chars().any(acts), "{shown}");
        assert_eq!(serde_json::from_str::<String>(&shown).expect("a string"), hostile);
    }
}
