//! Whether to colour: as `--color` requests; else not where `NO_COLOR` is set, `TERM` is `dumb`, or it is no terminal.

use clap::{ColorChoice, ValueEnum};
#[cfg(feature = "screen")]
use ratatui::crossterm::style::force_color_output;
use std::ffi::OsString;
use std::io::{self, IsTerminal};

/// Choice of `--color`, before the command line is parsed: its own errors and help are coloured, or not, as well. The
/// parser refuses a value that is no choice.
pub fn requested(arguments: impl IntoIterator<Item = OsString>) -> ColorChoice {
    let mut arguments = arguments.into_iter();
    let mut choice = ColorChoice::Auto;
    while let Some(argument) = arguments.next() {
        let value = match argument.to_str() {
            Some("--") => break,
            Some("--color") => arguments.next().and_then(|value| value.into_string().ok()),
            Some(other) => other.strip_prefix("--color=").map(str::to_owned),
            None => None,
        };
        if let Some(value) = value {
            choice = ColorChoice::from_str(&value, false).unwrap_or(choice);
        }
    }
    choice
}

/// Whether standard error is coloured; sets the live screen too, which has a switch of its own.
pub fn settle(choice: ColorChoice) -> bool {
    #[cfg(feature = "screen")]
    match choice {
        ColorChoice::Always => force_color_output(true),
        ColorChoice::Never => force_color_output(false),
        ColorChoice::Auto => {}
    }
    on(
        choice,
        io::stderr().is_terminal() && understands_colours(),
        std::env::var_os("NO_COLOR").as_deref(),
        std::env::var_os("TERM").as_deref(),
    )
}

/// Whether the terminal knows the sequences that colour. The older consoles of Windows have to be asked for them.
fn understands_colours() -> bool {
    #[cfg(all(windows, feature = "screen"))]
    return ratatui::crossterm::ansi_support::supports_ansi();
    #[cfg(all(windows, not(feature = "screen")))]
    return false;
    #[cfg(not(windows))]
    true
}

fn on(
    choice: ColorChoice,
    is_terminal: bool,
    no_color: Option<&std::ffi::OsStr>,
    term: Option<&std::ffi::OsStr>,
) -> bool {
    match choice {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        // https://no-color.org: set and not empty.
        ColorChoice::Auto => {
            is_terminal && no_color.is_none_or(|value| value.is_empty()) && term.is_none_or(|t| t != "dumb")
        }
    }
}

/// Beginning of a remark, and its colour.
const LABELS: [(&str, &str); 2] = [("error:", "\x1b[1;31m"), ("warning:", "\x1b[1;33m")];

/// A line with its label coloured, where it has one.
pub fn label(line: &str) -> String {
    let labelled = LABELS.iter().find_map(|(label, colour)| Some((label, colour, line.strip_prefix(label)?)));
    labelled.map_or_else(|| line.to_owned(), |(label, colour, rest)| format!("{colour}{label}\x1b[0m{rest}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::ffi::OsStr;

    #[test]
    fn the_choice_is_found_before_parsing() {
        assert_eq!(requested_in("guide ports"), ColorChoice::Auto);
        assert_eq!(requested_in("guide --color never ports"), ColorChoice::Never);
        assert_eq!(requested_in("guide ports --color=always"), ColorChoice::Always);
        assert_eq!(requested_in("guide ports --color=mauve"), ColorChoice::Auto);
        assert_eq!(requested_in("guide identify -- --color=always"), ColorChoice::Auto);
        assert_eq!(requested_in("guide --color"), ColorChoice::Auto);
    }

    fn requested_in(line: &str) -> ColorChoice {
        requested(line.split(' ').map(OsString::from))
    }

    #[test]
    fn colours_only_on_terminals_and_where_not_declined() {
        let (auto, set, empty) = (ColorChoice::Auto, Some(OsStr::new("1")), Some(OsStr::new("")));
        assert!(on(auto, true, None, None) && on(auto, true, empty, Some(OsStr::new("xterm"))));
        assert!(!on(auto, false, None, None) && !on(auto, true, set, None));
        assert!(!on(auto, true, None, Some(OsStr::new("dumb"))));
        assert!(on(ColorChoice::Always, false, set, None) && !on(ColorChoice::Never, true, None, None));
    }

    #[test]
    fn labels_alone_are_coloured() {
        assert_eq!(label("error: no"), "\x1b[1;31merror:\x1b[0m no");
        assert_eq!(label("drawing error: no"), "drawing error: no");
    }
}
