//! A Rust file, divided into code and comments: enough to count names and sentences, without a parser.

use anyhow::{Context, Result};
use std::fs;
use std::path::Path;

/// Prepositions: the relation of a thing to another, not the thing.
const PREPOSITIONS: &str = "about above across after against ahead along alongside amid among around as at atop away back \
    before behind below beneath beside besides between beyond by down during for from in inside into near of off on onto \
    out outside over past per since through to together toward towards under until up upon with within without";

/// Pronouns, and determiners that are used as such.
const PRONOUNS: &str = "all another any anything both each either everything few her here him his it its itself neither \
    none nothing one ones other others own same something some such that their them themselves there these they this \
    those us what which who whose";

/// Participles and nouns that fit anything.
const VAGUE: &str = "apart done far found given got held kept known left made part parts place placed places rest rests \
    said seen share shares taken tell thing things told tried turned used wanted way ways";

/// Suffixes that state a unit: `at_m` is as vague as `at`.
const UNITS: &str = "m mm um n mn s ms us pa kpa rad deg hz n_per_m per_m";

/// Words with which a noun clause or a fragment begins.
const CLAUSES: [&str; 7] = ["What", "Where", "Of", "How", "That", "Which", "Nothing"];

/// A file whose code has blanks for comments and literals, beside its comments.
pub struct Source {
    code: String,
    /// Line and text of every run of comment lines; a blank comment line ends a run.
    comments: Vec<(usize, String)>,
}

impl Source {
    /// Reads a file.
    ///
    /// # Errors
    /// Where it cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        Ok(Self::new(&fs::read_to_string(path).with_context(|| path.display().to_string())?))
    }

    pub fn new(text: &str) -> Self {
        Self { code: code(text), comments: comments(text) }
    }

    pub fn line_count(&self) -> usize {
        self.code.lines().count()
    }

    /// Line and name of every variable that a `let` binds.
    pub fn local_names(&self) -> Vec<(usize, String)> {
        let tokens = self.tokens();
        let mut names = Vec::new();
        for start in (0..tokens.len()).filter(|index| tokens[*index].1 == "let") {
            names.extend(pattern_names(&tokens[start + 1..]));
        }
        names
    }

    /// Line and name of every closure that a `let` names.
    pub fn closures(&self) -> Vec<(usize, String)> {
        let tokens = self.tokens();
        let mut closures = Vec::new();
        for start in (0..tokens.len()).filter(|index| tokens[*index].1 == "let") {
            let mut pattern = tokens[start + 1..].iter().skip_while(|(_, word)| *word == "mut");
            let Some((line, name)) = pattern.next() else { continue };
            let mut value = pattern.skip_while(|(_, word)| !["=", ";", "{"].contains(word));
            let is_bound = value.next().is_some_and(|(_, word)| *word == "=");
            let mut value = value.skip_while(|(_, word)| *word == "move");
            if is_bound && value.next().is_some_and(|(_, word)| *word == "|") {
                closures.push((*line, (*name).to_owned()));
            }
        }
        closures
    }

    /// Names of types that are public without a restriction.
    pub fn public_types(&self) -> Vec<String> {
        let tokens = self.tokens();
        let is_type = |word: &str| ["struct", "enum", "trait", "union"].contains(&word);
        let public = tokens.windows(3).filter(|words| words[0].1 == "pub" && is_type(words[1].1));
        public.map(|words| words[2].1.to_owned()).collect()
    }

    /// Line and text of every sentence of the comments that begins with a capital letter.
    pub fn sentences(&self) -> Vec<(usize, String)> {
        let mut sentences = Vec::new();
        for (line, text) in &self.comments {
            for sentence in split_sentences(text) {
                let sentence = sentence.trim_start_matches(|c: char| !c.is_alphanumeric() && c != '`');
                if sentence.starts_with(char::is_uppercase) {
                    sentences.push((*line, sentence.to_owned()));
                }
            }
        }
        sentences
    }

    /// Line and text of every token of the code.
    fn tokens(&self) -> Vec<(usize, &str)> {
        let mut tokens = Vec::new();
        for (index, line) in self.code.lines().enumerate() {
            let mut remaining = line.trim_start();
            while let Some(first) = remaining.chars().next() {
                let is_word = |c: char| c.is_alphanumeric() || c == '_';
                let length = if is_word(first) {
                    remaining.find(|c| !is_word(c)).unwrap_or(remaining.len())
                } else if remaining.starts_with("::") {
                    2
                } else {
                    first.len_utf8()
                };
                let (token, tail) = remaining.split_at(length);
                tokens.push((index + 1, token));
                remaining = tail.trim_start();
            }
        }
        tokens
    }
}

/// Variables of the pattern with which the tokens begin, without those that take the name of a field.
fn pattern_names(tokens: &[(usize, &str)]) -> Vec<(usize, String)> {
    let mut names = Vec::new();
    let (mut depth, mut braces) = (0_i32, 0_i32);
    let mut previous = "";
    for (index, (line, word)) in tokens.iter().enumerate() {
        match *word {
            "(" | "[" => depth += 1,
            ")" | "]" => depth -= 1,
            "{" => (depth, braces) = (depth + 1, braces + 1),
            "}" => (depth, braces) = (depth - 1, braces - 1),
            "=" | ";" | ":" if depth == 0 => break,
            _ => {}
        }
        if depth < 0 {
            break;
        }
        let following = tokens.get(index + 1).map_or("", |(_, word)| *word);
        let is_variable = word.starts_with(|c: char| c.is_ascii_lowercase() || c == '_')
            && !["mut", "ref", "_", "box"].contains(word)
            && !["::", "(", "{", "!"].contains(&following)
            && !["::", "'"].contains(&previous);
        // `Type { field }` takes the field's name.
        let is_field = braces > 0 && (following == ":" || ["{", ","].contains(&previous));
        if is_variable && !is_field {
            names.push((*line, (*word).to_owned()));
        }
        previous = *word;
    }
    names
}

/// Whether a name is of the lists, with or without a unit.
pub fn is_vague(name: &str) -> bool {
    let name = name.trim_matches('_');
    let stems = UNITS.split(' ').filter_map(|unit| name.strip_suffix(unit)?.strip_suffix('_'));
    std::iter::once(name).chain(stems).any(|stem| {
        [PREPOSITIONS, PRONOUNS, VAGUE].iter().any(|list| list.split_whitespace().any(|word| word == stem))
    })
}

/// Whether a sentence begins with a word of [`CLAUSES`].
pub fn begins_with_clause(sentence: &str) -> bool {
    let first = sentence.split(|c: char| !c.is_alphabetic()).next().unwrap_or_default();
    CLAUSES.contains(&first)
}

/// Sentences of a text: they end with a full stop, an exclamation mark, a question mark or a colon before a space.
fn split_sentences(text: &str) -> Vec<&str> {
    let mut sentences = Vec::new();
    let mut start = 0;
    for (index, mark) in text.match_indices(['.', '!', '?', ':']) {
        let end = index + mark.len();
        if text[end..].starts_with(' ') {
            sentences.push(text[start..end].trim());
            start = end;
        }
    }
    sentences.push(text[start..].trim());
    sentences
}

/// Runs of comment lines, with the line at which each begins.
fn comments(text: &str) -> Vec<(usize, String)> {
    let mut comments: Vec<(usize, String)> = Vec::new();
    let mut goes_on = false;
    for (index, line) in text.lines().enumerate() {
        let comment =
            line.trim_start().strip_prefix("//").map(|line| line.trim_start_matches(['/', '!']).trim());
        let Some(comment) = comment.filter(|comment| !comment.is_empty()) else {
            goes_on = false;
            continue;
        };
        match comments.last_mut() {
            Some((_, run)) if goes_on => {
                run.push(' ');
                run.push_str(comment);
            }
            _ => comments.push((index + 1, comment.to_owned())),
        }
        goes_on = true;
    }
    comments
}

/// The text with spaces in place of comments, strings and characters; lines stay.
fn code(text: &str) -> String {
    let mut code = String::with_capacity(text.len());
    let mut remaining = text;
    while let Some(first) = remaining.chars().next() {
        let length = literal_length(remaining, code.chars().next_back());
        let token_length = length.unwrap_or(first.len_utf8());
        let (token, tail) = remaining.split_at(token_length);
        if length.is_some() {
            code.extend(token.chars().map(|c| if c == '\n' { '\n' } else { ' ' }));
        } else {
            code.push_str(token);
        }
        remaining = tail;
    }
    code
}

/// Length of the comment or literal with which a text begins; nothing where code begins.
fn literal_length(text: &str, before: Option<char>) -> Option<usize> {
    let to_end = |found: Option<usize>| found.unwrap_or(text.len());
    if text.starts_with("//") {
        return Some(to_end(text.find('\n')));
    }
    if text.starts_with("/*") {
        return Some(to_end(text.find("*/").map(|end| end + 2)));
    }
    if text.starts_with('"') {
        return Some(to_end(escaped_end(text, '"')));
    }
    if let Some(quoted) = text.strip_prefix('\'') {
        // A lifetime has no second quotation mark.
        let mut letters = quoted.chars();
        let (first, second) = (letters.next()?, letters.next());
        let is_character = first == '\\' || second == Some('\'');
        return is_character.then(|| to_end(escaped_end(text, '\'')));
    }
    let is_in_word = before.is_some_and(|c| c.is_alphanumeric() || c == '_');
    let raw = text.strip_prefix('b').unwrap_or(text).strip_prefix('r')?;
    let hashes = raw.len() - raw.trim_start_matches('#').len();
    if is_in_word || !raw[hashes..].starts_with('"') {
        return None;
    }
    let end = format!("\"{}", "#".repeat(hashes));
    let body = hashes + 1;
    let begin = text.len() - raw.len();
    Some(to_end(raw[body..].find(&end).map(|at| begin + body + at + end.len())))
}

/// End of a literal that begins with a quotation mark, after the second one that no backslash escapes.
fn escaped_end(text: &str, quotation_mark: char) -> Option<usize> {
    let mut is_escaped = false;
    for (index, letter) in text.char_indices().skip(1) {
        match letter {
            _ if is_escaped => is_escaped = false,
            '\\' => is_escaped = true,
            _ if letter == quotation_mark => return Some(index + letter.len_utf8()),
            _ => {}
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(text: &str) -> Vec<String> {
        Source::new(text).local_names().into_iter().map(|(_, name)| name).collect()
    }

    #[test]
    fn local_names_are_those_of_patterns() {
        assert_eq!(names("let mut at: f64 = of(x);"), ["at"]);
        assert_eq!(names("let (a, [b, ..]) = c;"), ["a", "b"]);
        assert_eq!(names("if let Some(found) = search(left) {}"), ["found"]);
        assert_eq!(names("let Rig { guide2_m, needle: shaft, .. } = rig;"), ["shaft"]);
        assert_eq!(names("// let at = 1;\nlet text = \"let of = 2;\";"), ["text"]);
        assert_eq!(
            names("let quote = '\"'; let lifetime: &'static str = r#\"let \"at\" = 3\"#;"),
            ["quote", "lifetime"]
        );
    }

    #[test]
    fn vague_names_are_so_with_a_unit_too() {
        assert!(
            ["at", "at_m", "from_mm", "_taken", "own", "stiffness_held"]
                .iter()
                .filter(|n| is_vague(n))
                .count()
                == 5
        );
        assert!(!["depth_m", "format", "stiffness_n_per_m", "partial"].iter().any(|name| is_vague(name)));
    }

    #[test]
    fn closures_are_counted_where_they_have_a_name() {
        let source =
            Source::new("let half = |x| x / 2.0;\nlet next = move || 1;\nxs.map(|x| x);\nlet y = a || b;");
        let closures: Vec<_> = source.closures().into_iter().map(|(line, _)| line).collect();
        assert_eq!(closures, [1, 2]);
    }

    #[test]
    fn clauses_are_found_in_every_sentence_of_a_comment() {
        let source = Source::new(
            "/// Force. What the\n/// sensor reads.\n///\n/// That is all: Of them.\nlet x = 1; // no\n",
        );
        let clauses = source.sentences().into_iter().filter(|(_, text)| begins_with_clause(text));
        assert_eq!(clauses.map(|(line, _)| line).collect::<Vec<_>>(), [1, 4, 4]);
    }

    #[test]
    fn public_types_are_those_without_a_restriction() {
        let source =
            Source::new("pub struct A;\npub(crate) struct B;\npub enum C {}\nstruct D;\n/// pub struct E;\n");
        assert_eq!(source.public_types(), ["A", "C"]);
    }
}
