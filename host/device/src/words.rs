//! Command lines of other programs: splits them into words, and joins words to a line that a shell splits into the same words.
//!
//! On Unix as a shell does. On Windows a backslash is part of a path and quotes nothing, and the shells there know double quotation marks
//! only; single ones are read too, so that the manual's examples work.

/// The words of a command line; none where a quotation mark is not closed.
pub fn split(line: &str) -> Option<Vec<String>> {
    if cfg!(windows) { split_for_windows(line) } else { shlex::split(line) }
}

/// A command line of these words.
pub fn join<'a>(words: impl IntoIterator<Item = &'a str>) -> String {
    let quote = if cfg!(windows) { quote_for_windows } else { quote_for_unix };
    words.into_iter().map(quote).collect::<Vec<_>>().join(" ")
}

fn quote_for_unix(word: &str) -> String {
    // A word with a zero byte, which no command line has, stays as it is.
    shlex::try_quote(word).map_or_else(|_| word.to_owned(), Into::into)
}

fn quote_for_windows(word: &str) -> String {
    if !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || r"\/:._-+=,@".contains(c)) {
        word.to_owned()
    } else {
        format!("\"{word}\"")
    }
}

fn split_for_windows(line: &str) -> Option<Vec<String>> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    for letter in line.chars() {
        match (quote, letter) {
            (Some(open), _) if letter == open => quote = None,
            (None, '"' | '\'') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, _) if letter.is_whitespace() => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    quote.is_none().then_some(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_windows_stay_whole() {
        fn words(line: &str) -> Vec<String> {
            split_for_windows(line).expect("words")
        }
        assert_eq!(words(r"C:\scan\sweep.exe  --out C:\data"), [r"C:\scan\sweep.exe", "--out", r"C:\data"]);
        assert_eq!(
            words(r#""C:\Program Files\scan.exe" --id "" 'a b'"#),
            [r"C:\Program Files\scan.exe", "--id", "", "a b"]
        );
        assert_eq!(words("  "), Vec::<String>::new());
        assert_eq!(split_for_windows(r#"scan "C:\data"#), None);
    }

    #[test]
    fn a_joined_line_has_the_same_words() {
        let words = ["guide", "import", r"C:\my data\it's.csv", "", "--at=3,-2", "d 1"];
        let line = words.map(quote_for_windows).join(" ");
        assert_eq!(line, r#"guide import "C:\my data\it's.csv" "" --at=3,-2 "d 1""#);
        assert_eq!(split_for_windows(&line).expect("words"), words);
        assert_eq!(split(&join(words)).expect("words"), words);
    }
}
