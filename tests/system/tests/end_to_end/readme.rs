//! README.md and the manual show what the commands print, and name only what there is.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::process::Command;
use system::images::{build_guide, cargo, root, target_dir};
use system::readme::book::{Book, MANUAL};
use system::readme::check_quick;
use system::readme::page::Page;

/// Options of other programs that the pages name: cargo, cargo bench and cargo test, probe-rs, git, snakemake.
const OF_OTHERS: [&str; 22] = [
    "--no-default-features",
    "--path",
    "--bench",
    "--all-targets",
    "--nocapture",
    "--include-ignored",
    "--chip",
    "--help",
    "--lib",
    "--config",
    "--workspace",
    "--no-deps",
    "--open",
    "--release",
    "--example",
    "--snakefile",
    "--cores",
    "--rerun-incomplete",
    "--slurm-status-command",
    "--slurm-status-attempts",
    "--container-image",
    "--kubernetes-persistent-volumes",
];

/// A command of cargo itself, whose options are cargo's and its programs', or of Python, whose options are those of a script: they are not
/// checked here.
fn of_others(text: &str) -> bool {
    let mut words = text.split_whitespace().skip_while(|word| word.contains('='));
    match words.next() {
        Some("cargo") => words.next() != Some("xtask"),
        first => first == Some("python"),
    }
}

#[test]
fn the_pages_show_what_the_commands_print() {
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

    /// `cargo xtask`: its own tasks, with the options of the programs that it runs.
    fn xtask() -> Self {
        let system = Self::of(Path::new(env!("CARGO_BIN_EXE_system"))).commands;
        let tasks = sub_commands(&help_of("xtask", &[])).into_iter();
        let mut commands: BTreeMap<String, BTreeSet<String>> =
            tasks.map(|name| (name.clone(), system.get(&name).cloned().unwrap_or_default())).collect();
        let of_studies = options(&help_of("studies", &[])).into_iter();
        let of_system =
            ["study-demo", "study-bringup"].into_iter().filter_map(|name| system.get(name)).flatten();
        let of_studies = of_studies.chain(of_system.cloned());
        commands.entry("study".to_owned()).or_default().extend(of_studies);
        for task in ["test", "release", "wording", "flash"] {
            commands.entry(task.to_owned()).or_default().extend(options(&help_of("xtask", &[task])));
        }
        commands.entry("web".to_owned()).or_default().extend(options(&help_of("browser", &[])));
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

/// Beside this test where the whole workspace is tested; else they are built.
fn help_of(package: &str, task: &[&str]) -> String {
    let built = target_dir().join("debug").join(package);
    let mut command = if built.exists() {
        Command::new(built)
    } else {
        let mut command = cargo();
        command.args(["run", "--quiet", "--package", package, "--"]);
        command
    };
    let output = command.args(task).arg("--help").env("COLUMNS", "100").output().unwrap();
    assert!(output.status.success(), "{package}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
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
    words
        .filter(|word| {
            word.strip_prefix("--").is_some_and(|name| name.starts_with(|c: char| c.is_ascii_lowercase()))
        })
        .map(str::to_owned)
        .collect()
}

/// Typed commands of a page: code in a line, and the lines of fenced blocks, joined where they go on,
/// and the commands of marks; with the line's number.
fn typed(page: &Page) -> Vec<(usize, String)> {
    let mut commands: Vec<(usize, String)> = Vec::new();
    let (mut fenced, mut goes_on) = (false, false);
    for (number, line) in page.lines().iter().enumerate() {
        // Blocks of a list's items are indented.
        let line = line.trim_start();
        if line.starts_with("```") {
            fenced = !fenced;
        } else if fenced {
            let text = line.strip_prefix("$ ").unwrap_or(line).split(" #").next().unwrap_or_default();
            match commands.last_mut().filter(|_| goes_on) {
                Some((_, last)) => *last = format!("{} {}", last.trim_end_matches('\\'), text.trim_start()),
                None => commands.push((number + 1, text.to_owned())),
            }
            goes_on = text.ends_with('\\');
        } else if let Some(command) = line.strip_prefix("<!-- readme: long ") {
            commands.push((number + 1, command.trim_end_matches(" -->").to_owned()));
        } else {
            // A command that is broken over two lines would be read the wrong way round.
            assert!(
                line.matches('`').count().is_multiple_of(2),
                "{}:{}: code has no end",
                page.name(),
                number + 1
            );
            commands.extend(line.split('`').skip(1).step_by(2).map(|code| (number + 1, code.to_owned())));
        }
    }
    commands
}

#[test]
fn every_command_and_option_of_the_pages_exists() {
    let (guide, xtask) = (Program::of(&build_guide().unwrap()), Program::xtask());
    let every: BTreeSet<&String> = guide.commands.values().chain(xtask.commands.values()).flatten().collect();
    let book = Book::read(root()).unwrap();
    let mut wrong = Vec::new();
    let typed = book.pages().iter().flat_map(|page| typed(page).into_iter().map(move |typed| (page, typed)));
    for (page, (number, text)) in typed.filter(|(_, (_, text))| !of_others(text)) {
        let is_known = match (text.strip_prefix("guide "), text.strip_prefix("cargo xtask ")) {
            // A label that is drawn as `guide 1 ...` is a part of the rig.
            (Some(rest), _) if rest.starts_with(|c: char| c.is_ascii_lowercase()) => {
                Some(guide.options(rest))
            }
            (_, Some(rest)) => Some(xtask.options(rest)),
            _ => None,
        };
        // Quoted text is that of an option, and may be a command of its own.
        let words = shlex::split(&text).unwrap_or_else(|| vec![text.clone()]);
        // Options behind `--` are those of another command.
        let own_words = words.iter().take_while(|word| *word != "--");
        let named = own_words.filter(|word| is_known.is_none() || word.starts_with("--"));
        for option in named.flat_map(|word| options_in(word)) {
            let fault = match &is_known {
                Some(None) => continue,
                // Every command has it, and help does not list it as an option of its own.
                Some(Some(_)) if option == "--help" => continue,
                Some(Some((_, options))) if options.contains(&option) => continue,
                Some(Some((name, _))) => format!("{name} has no option {option}"),
                None if every.contains(&option) || OF_OTHERS.contains(&option.as_str()) => continue,
                None => format!("no command has an option {option}"),
            };
            wrong.push(format!("{}:{number}: `{text}`: {fault}", page.name()));
        }
        if is_known == Some(None) {
            wrong.push(format!("{}:{number}: `{text}`: no such command", page.name()));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// Every sub-command has a page with its own outputs, and no page is about a command that does not exist.
#[test]
fn every_command_has_its_page() {
    let guide = Program::of(&build_guide().unwrap());
    let book = Book::read(root()).unwrap();
    let folder = format!("{MANUAL}/commands/");
    let names = book.pages().iter().filter_map(|page| page.name().strip_prefix(&folder)?.strip_suffix(".md"));
    assert_eq!(names.map(str::to_owned).collect::<BTreeSet<_>>(), guide.top());
    for name in guide.top() {
        let page = book.page(&format!("{folder}{name}.md")).unwrap();
        let blocks = page.blocks().unwrap();
        let lines = || blocks.iter().flat_map(|block| block.lines());
        assert!(
            page.lines().first().is_some_and(|line| *line == format!("# `guide {name}`")),
            "{name}: title"
        );
        assert!(lines().any(|line| line.starts_with(&format!("$ guide {name} "))), "{name}: no output of it");
    }
}

/// Every effect of the catalogue is described.
#[test]
fn every_effect_has_its_place() {
    let output = Command::new(build_guide().unwrap()).args(["effects", "--json"]).output().unwrap();
    let catalogue: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let effects = catalogue["effects"].as_array().unwrap();
    let book = Book::read(root()).unwrap();
    let page = book.page(&format!("{MANUAL}/effects.md")).unwrap();
    assert!(effects.len() > 20);
    for effect in effects {
        let title = format!("### `{}`", effect["id"].as_str().unwrap());
        assert!(page.lines().contains(&title), "effects.md has no heading {title}");
    }
}

/// The tables name every sub-command once, no other, and in each row only options of the commands in that row.
#[test]
fn the_tables_of_commands_are_those_of_the_program() {
    let guide = Program::of(&build_guide().unwrap());
    let book = Book::read(root()).unwrap();
    let page = book.page(&format!("{MANUAL}/commands.md")).unwrap();
    // A table for each group of commands.
    let rows = page.lines().iter().filter(|line| line.starts_with("| [`guide "));
    let mut named = Vec::new();
    for row in rows {
        let (names, does) = row[1..].split_once(" | ").unwrap();
        let mut of_row = Vec::new();
        for code in codes(names) {
            let command_name = code.strip_prefix("guide ").unwrap_or(&code).to_owned();
            let (name, options) =
                guide.options(&command_name).unwrap_or_else(|| panic!("{row}: no command {command_name}"));
            let unknown = options_in(&command_name).into_iter().find(|option| !options.contains(option));
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

fn codes(text: &str) -> Vec<String> {
    // In a table a bar that is no border is escaped.
    text.replace("\\|", " ").split('`').skip(1).step_by(2).map(str::to_owned).collect()
}

/// The table of kinds names every kind of recording once, no other, and every ending that the program lists of frames and tables.
#[test]
fn the_table_of_kinds_is_that_of_the_program() {
    let output = Command::new(build_guide().unwrap()).args(["import", "--help"]).output().unwrap();
    let help = String::from_utf8(output.stdout).unwrap();
    let kinds: Vec<&str> = help
        .lines()
        .skip_while(|line| line.trim() != "Possible values:")
        .skip(1)
        .take_while(|line| !line.trim().is_empty())
        .filter_map(|line| Some(line.trim().strip_prefix("- ")?.split_once(':')?.0))
        .collect();
    let book = Book::read(root()).unwrap();
    let page = book.page(&format!("{MANUAL}/commands/import.md")).unwrap();
    let rows: Vec<&String> = page
        .lines()
        .iter()
        .skip_while(|line| *line != "| kind | reads | becomes |")
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .collect();
    assert_eq!(rows.len(), kinds.len());
    assert!(kinds.iter().all(|kind| row(kind, &rows).split(" | ").count() == 3), "{kinds:?}");
    for (kind, title, least) in
        [("ultrasound", "Frames (ultrasound, camera):", 9), ("table", "Tables (table):", 10)]
    {
        let endings = endings(title, &help);
        assert!(endings.len() >= least, "{title} {endings:?}");
        let missing: Vec<&String> =
            endings.iter().filter(|ending| !row(kind, &rows).contains(*ending)).collect();
        assert!(missing.is_empty(), "{kind}: the page has no {missing:?}");
        let codes = row(kind, &rows).split('`').skip(1).step_by(2).map(|code| format!("`{code}`"));
        let unknown: Vec<String> =
            codes.filter(|code| code.starts_with("`.") && !endings.contains(code)).collect();
        assert!(unknown.is_empty(), "{kind}: the program lists no {unknown:?}");
    }
}

fn row<'a>(kind: &str, rows: &[&'a String]) -> &'a String {
    rows.iter().copied().find(|row| row.starts_with(&format!("| `{kind}` |"))).unwrap()
}

fn endings(title: &str, help: &str) -> BTreeSet<String> {
    // The last of this title: the options have one of the same.
    let from = help.rfind(&format!("\n{title}\n")).unwrap();
    let list = help[from..].lines().skip(2);
    let names = list.take_while(|line| !line.is_empty()).filter_map(|line| Some(line.split_once(':')?.0));
    let names = names.flat_map(|names| names.trim().split(", ")).filter(|name| name.starts_with('.'));
    names.map(|name| format!("`{name}`")).collect()
}
