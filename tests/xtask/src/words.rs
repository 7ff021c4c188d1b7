//! Words that names and texts of the project do not use, with the field's terms for them. A program does not tell, hear or believe;
//! data are measured, simulated, skipped.

use anyhow::{Context, Result, bail};
use std::process::Command;

/// Words, also as parts of names, and what to write instead.
const WORDS: [(&str, &str); 36] = [
    ("told", "reported, stated, identified, commanded"),
    ("tell", "report, distinguish"),
    ("tells", "reports, distinguishes"),
    ("telling", "reporting, distinguishing"),
    ("heard", "received"),
    ("hears", "receives"),
    ("seen", "measured, observed, received"),
    ("said", "reported, stated"),
    ("says", "reports, states"),
    ("saying", "reporting, stating"),
    ("asks", "requests, requires"),
    ("asked", "requested, required"),
    ("knows", "has, holds"),
    ("believes", "estimates, assumes"),
    ("believed", "estimated, assumed"),
    ("belief", "posterior, estimate"),
    ("rival", "competing effect"),
    ("rivals", "competing effects"),
    ("witness", "observer"),
    ("whoever", "the client, the user, the caller"),
    ("somebody", "a client, a user, a caller"),
    ("left out", "skipped, omitted"),
    ("made up", "simulated"),
    ("anew", "again"),
    ("lately", "recently"),
    ("wander", "process noise"),
    ("wanders", "varies"),
    ("wandering", "varying"),
    ("lump", "inclusion"),
    ("lumps", "inclusions"),
    ("legacy", "retained state"),
    ("of the day", "current"),
    ("as it should be", "unaffected"),
    ("does no harm", "is tolerated"),
    ("way out at most", "outbox at most"),
    ("known then", "the estimate at that time"),
];

/// Where a word has to stay: the file (the end of its path), a part of the line, and why.
const ALLOWED: [(&str, &str, &str); 5] = [
    ("tests/xtask/src/words.rs", "", "the list itself"),
    ("CHANGELOG.md", "`wander_n`", "fields of a former version"),
    ("identify/src/results/run.rs", "\"left_out\"", "a field of guide.identify/1"),
    ("manual/src/json.md", "\"left_out\"", "a field of guide.identify/1"),
    ("page/identify.js", "run.left_out", "a field of guide.identify/1"),
];

/// Files with text by hand.
const TEXTS: [&str; 6] = ["*.rs", "*.md", "*.toml", "*.js", "*.html", "*.py"];

/// Searches all files that are in the repository.
///
/// # Errors
/// Every place of such a word, with what to write instead.
pub fn check() -> Result<()> {
    let listed = Command::new("git")
        .args(["ls-files", "-z", "--"])
        .args(TEXTS)
        .output()
        .context("cannot list the project's files with git")?;
    let mut found = String::new();
    for path in String::from_utf8(listed.stdout)?.split_terminator('\0') {
        // A file that is deleted and not yet committed.
        let Ok(text) = std::fs::read_to_string(path) else { continue };
        for (number, line) in text.lines().enumerate() {
            let allowed = |(file, part, _): &&(&str, &str, &str)| path.ends_with(file) && line.contains(part);
            if ALLOWED.iter().any(|one| allowed(&one)) {
                continue;
            }
            for (word, instead) in words_in(line) {
                found += &format!("\n{path}:{}: \"{word}\": write {instead}", number + 1);
            }
        }
    }
    if !found.is_empty() {
        bail!("words that the project does not use (tests/xtask/src/words.rs):{found}");
    }
    Ok(())
}

/// The listed words of a line. Names are split at underlines and at capitals.
fn words_in(line: &str) -> Vec<(&'static str, &'static str)> {
    let mut split = String::from(" ");
    let mut before = ' ';
    for letter in line.chars() {
        if letter.is_ascii_uppercase() && before.is_ascii_lowercase() {
            split.push(' ');
        }
        split.push(if letter.is_alphanumeric() { letter.to_ascii_lowercase() } else { ' ' });
        before = letter;
    }
    split.push(' ');
    WORDS.into_iter().filter(|(word, _)| split.contains(&format!(" {word} "))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_words_in_sentences_and_names() {
        let words = |line| words_in(line).into_iter().map(|(word, _)| word).collect::<Vec<_>>();
        assert_eq!(words("let is_told = NotSeen::of(one);"), ["told", "seen"]);
        assert_eq!(words("The rows were left out."), ["left out"]);
        assert_eq!(words("let lumps = FIELDS_LATELY;"), ["lately", "lumps"]);
        assert!(words("A retold story of unforeseen tellers").is_empty());
    }
}
