//! README.md says what the commands say, and names only what there is.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use system::images::build_guide;
use system::readme::page::Page;
use system::readme::{check_quick, path};

/// Options of other programs that the page names: cargo, cargo bench and cargo test, probe-rs.
const OF_OTHERS: [&str; 6] = ["--path", "--bench", "--all-targets", "--nocapture", "--chip", "--help"];

#[test]
fn the_readme_says_what_the_commands_say() {
    check_quick().unwrap_or_else(|error| panic!("{error:#}"));
}

/// Sub-commands and options of a program, by the words that lead to them (`import slicer`).
struct Program {
    commands: BTreeMap<String, BTreeSet<String>>,
}

impl Program {
    fn of(program: &Path) -> Self {
        let mut commands = BTreeMap::new();
        let mut waiting = vec![Vec::new()];
        while let Some(words) = waiting.pop() {
            let output = Command::new(program).args(&words).arg("--help").output().unwrap();
            assert!(output.status.success(), "{words:?}");
            let help = String::from_utf8(output.stdout).unwrap();
            waiting.extend(sub_commands(&help).into_iter().map(|name| [words.clone(), vec![name]].concat()));
            commands.insert(words.join(" "), options(&help));
        }
        Self { commands }
    }

    /// Options of the command that a line begins with, if it is one.
    fn options(&self, line: &str) -> Option<(String, &BTreeSet<String>)> {
        let words: Vec<&str> = line.split_whitespace().take_while(|word| !word.starts_with('-')).collect();
        (1..=words.len()).rev().find_map(|length| {
            let name = words[..length].join(" ");
            self.commands.get(&name).map(|options| (name, options))
        })
    }

    fn top(&self) -> BTreeSet<String> {
        self.commands.keys().filter(|name| !name.is_empty() && !name.contains(' ')).cloned().collect()
    }
}

fn sub_commands(help: &str) -> Vec<String> {
    let list =
        help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    let names = list.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    let names = names.filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").map(str::to_owned).collect()
}

fn options(help: &str) -> BTreeSet<String> {
    let definitions = help.lines().map(str::trim_start).filter(|line| line.starts_with('-'));
    definitions.flat_map(options_in).collect()
}

/// The long options in a text.
fn options_in(text: &str) -> Vec<String> {
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || c == '-'));
    let is_option = |word: &&str| {
        word.strip_prefix("--").is_some_and(|name| name.starts_with(|c: char| c.is_ascii_lowercase()))
    };
    words.filter(is_option).map(str::to_owned).collect()
}

/// What is typed on the page: code in a line, and the lines of fenced blocks, joined where they go on, and
/// the commands of marks; with the line's number.
fn typed(page: &Page) -> Vec<(usize, String)> {
    let mut found: Vec<(usize, String)> = Vec::new();
    let (mut fenced, mut goes_on) = (false, false);
    for (number, line) in page.lines().iter().enumerate() {
        if line.starts_with("```") {
            fenced = !fenced;
        } else if fenced {
            let text = line.strip_prefix("$ ").unwrap_or(line).split(" #").next().unwrap_or_default();
            match found.last_mut().filter(|_| goes_on) {
                Some((_, last)) => *last = format!("{} {}", last.trim_end_matches('\\'), text.trim_start()),
                None => found.push((number + 1, text.to_owned())),
            }
            goes_on = text.ends_with('\\');
        } else if let Some(command) = line.strip_prefix("<!-- readme: long ") {
            found.push((number + 1, command.trim_end_matches(" -->").to_owned()));
        } else {
            // What is broken over two lines would be read the wrong way round.
            assert!(line.matches('`').count().is_multiple_of(2), "README.md:{}: code has no end", number + 1);
            found.extend(line.split('`').skip(1).step_by(2).map(|code| (number + 1, code.to_owned())));
        }
    }
    found
}

#[test]
fn every_command_and_option_of_the_readme_exists() {
    let (guide, xtask) =
        (Program::of(&build_guide().unwrap()), Program::of(Path::new(env!("CARGO_BIN_EXE_system"))));
    let every: BTreeSet<&String> = guide.commands.values().chain(xtask.commands.values()).flatten().collect();
    let page = Page::read(path()).unwrap();
    let mut wrong = Vec::new();
    for (number, text) in typed(&page) {
        let known = match (text.strip_prefix("guide "), text.strip_prefix("cargo xtask ")) {
            // What is drawn as `guide 1 ...` is a part of the rig.
            (Some(rest), _) if rest.starts_with(|c: char| c.is_ascii_lowercase()) => {
                Some(guide.options(rest))
            }
            (_, Some(rest)) => Some(xtask.options(rest)),
            _ => None,
        };
        // What is quoted is the text of an option, and may be a command of its own.
        let words = shlex::split(&text).unwrap_or_else(|| vec![text.clone()]);
        let named = words.iter().filter(|word| known.is_none() || word.starts_with("--"));
        for option in named.flat_map(|word| options_in(word)) {
            let fault = match &known {
                Some(None) => continue,
                Some(Some((_, options))) if options.contains(&option) => continue,
                Some(Some((name, _))) => format!("{name} has no option {option}"),
                None if every.contains(&option) || OF_OTHERS.contains(&option.as_str()) => continue,
                None => format!("no command has an option {option}"),
            };
            wrong.push(format!("README.md:{number}: `{text}`: {fault}"));
        }
        if known == Some(None) {
            wrong.push(format!("README.md:{number}: `{text}`: no such command"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The table names every sub-command once, no other, and in each row only options of the commands in that row.
#[test]
fn the_table_of_commands_is_that_of_the_program() {
    let guide = Program::of(&build_guide().unwrap());
    let page = Page::read(path()).unwrap();
    let rows = page.lines().iter().skip_while(|line| *line != "| command | does |").skip(2);
    let mut named = Vec::new();
    for row in rows.take_while(|line| line.starts_with('|')) {
        let (names, does) = row[1..].split_once(" | ").unwrap();
        let codes = |text: &str| -> Vec<String> {
            // In a table a bar that is no border is escaped.
            text.replace("\\|", " ").split('`').skip(1).step_by(2).map(str::to_owned).collect()
        };
        let mut of_row = Vec::new();
        for code in codes(names) {
            let rest = code.strip_prefix("guide ").unwrap_or(&code).to_owned();
            let (name, options) = guide.options(&rest).unwrap_or_else(|| panic!("{row}: no command {rest}"));
            let unknown = options_in(&rest).into_iter().find(|option| !options.contains(option));
            assert_eq!(unknown, None, "{row}: not an option of {name}");
            named.push(name.split(' ').next().unwrap().to_owned());
            of_row.push(name);
        }
        let allowed: BTreeSet<&String> = of_row
            .iter()
            .chain(codes(does).iter().filter(|code| guide.commands.contains_key(*code)))
            .flat_map(|name| &guide.commands[name])
            .collect();
        for option in codes(does).iter().flat_map(|code| options_in(code)) {
            assert!(allowed.contains(&option), "{row}: {of_row:?} has no option {option}");
        }
    }
    // `import` has a row for each kind of recording.
    named.dedup();
    assert_eq!(named.len(), named.iter().collect::<BTreeSet<_>>().len(), "named twice: {named:?}");
    assert_eq!(named.into_iter().collect::<BTreeSet<_>>(), guide.top());
}
