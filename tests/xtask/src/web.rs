//! `cargo xtask web`: the page `guide.html`; with `--test` it is opened in Chromium and compared with the program.

use crate::build::{cargo, root, run, target_dir};
use crate::setup;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

/// Target of the engine.
pub const TARGET: &str = "wasm32-wasip1";
/// Packages of the test in a browser, as Debian and its relatives name them.
const PACKAGES: [&str; 2] = ["chromium", "chromium-driver"];
const PROGRAMS: [&str; 2] = ["chromium", "chromedriver"];
/// The engine's entry point, which the page calls once per request.
const ENTRY: &str = "link-arg=--export=__main_void";

/// Makes the page, and tests it where that is requested.
///
/// # Errors
/// Where something cannot be installed or built, or the arguments are not known.
pub fn web(arguments: &[OsString]) -> Result<ExitCode> {
    let (is_test, page_options) = match arguments.split_first() {
        Some((first, rest)) if first == "--test" => (true, rest),
        _ => (false, arguments),
    };
    let (is_manual, arguments) = match arguments.split_first() {
        Some((first, page_options)) if first == "--manual" => (true, page_options),
        _ => (false, arguments),
    };
    if !is_test && arguments.iter().any(|argument| argument == "--help" || argument == "-h") {
        println!(
            "Make guide.html: the page with everything in it, opened from disk\n\nUsage: cargo xtask web [--manual | --test [OPTIONS]]\n\n\
             Options:\n  --manual  Put it beside the pages of the manual too, whose figures are live then (`mdbook serve host/manual`)\n  \
             --test    Open it in Chromium, compare what it shows with the program, measure, and take pictures;\n            \
             options of the test follow (--test --help)"
        );
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(unknown) = arguments.first().filter(|_| !is_test) {
        bail!("web: unknown option {}, expected --manual, --test or none", unknown.display());
    }
    announce(is_test);
    if is_test {
        ensure_browser()?;
    }
    let page = make(&[])?;
    if is_manual {
        let manual_page = root().join("host/manual/src/guide.html");
        fs::copy(&page, &manual_page).with_context(|| format!("{}: cannot write", manual_page.display()))?;
        println!("beside the manual: {}", manual_page.display());
    }
    if !is_test {
        println!("open {} in a browser", page.display());
        return Ok(ExitCode::SUCCESS);
    }
    let program = target_dir().join("debug").join("browser");
    run(&program, [OsStr::new("--page"), page.as_os_str()], page_options)
}

fn announce(is_test: bool) {
    eprintln!(
        "xtask: 1. the Rust target {TARGET}, if it is missing\n\
         xtask: 2. builds the engine of the page (minutes the first time) and `guide`, which makes the example and the records of {} sessions\n\
         xtask: 3. writes target/web/guide.html",
        SESSIONS.len()
    );
    if is_test {
        eprintln!(
            "xtask: 4. opens it in Chromium (installed with apt, if it is missing and this runs as root)"
        );
    }
}

/// Builds all parts and puts them together; with further options of cargo for the engine.
///
/// # Errors
/// Where something cannot be installed or built.
pub fn make(options: &[String]) -> Result<PathBuf> {
    setup::ensure_rust_target(TARGET, "to build the engine of the page")?;
    let engine = ["rustc", "--package", "web", "--bin", "engine", "--target", TARGET, "--profile", "web"];
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    cargo(&[&engine[..], &options, &["--", "-C", ENTRY]].concat())?;
    // Together, as for the demonstration: so they are built once.
    cargo(&["build", "--package", "host", "--package", "system", "--bin", "guide", "--bin", "system"])?;
    cargo(&["build", "--package", "browser", "--bin", "web-pack", "--bin", "browser"])?;
    let folder = target_dir().join("web");
    let (example, page) = (folder.join("example"), folder.join("guide.html"));
    if example.exists() {
        fs::remove_dir_all(&example).with_context(|| format!("{}: cannot remove", example.display()))?;
    }
    fs::create_dir_all(&folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    let debug = target_dir().join("debug");
    let exit_status = Command::new(debug.join("guide"))
        .args(["init", "--example"])
        .arg(&example)
        .stdout(Stdio::null())
        .status()
        .context("cannot run guide")?;
    ensure!(exit_status.success(), "guide init failed");
    let engine = target_dir().join(TARGET).join("web").join("engine.wasm");
    let records = records(&folder, &debug.join("guide"))?;
    let pack_arguments = [engine.as_os_str(), example.as_os_str(), records.as_os_str(), page.as_os_str()];
    let code = run(&debug.join("web-pack"), pack_arguments, &[])?;
    ensure!(code == ExitCode::SUCCESS, "the page could not be put together");
    Ok(page)
}

/// Sessions of which the page has the records: tissue, K in kilopascals, rig. Each with a noise of its own.
const SESSIONS: [(&str, f64, &str); 12] = [
    ("gel", 11.2, "rig-1"),
    ("gel", 12.6, "rig-2"),
    ("gel", 12.0, "rig-1"),
    ("gel", 13.1, "rig-2"),
    ("gel", 11.7, "rig-1"),
    ("gel", 12.3, "rig-2"),
    ("liver", 4.3, "rig-1"),
    ("liver", 5.6, "rig-2"),
    ("liver", 5.0, "rig-1"),
    ("liver", 6.1, "rig-2"),
    ("liver", 4.8, "rig-1"),
    ("liver", 5.3, "rig-2"),
];
/// From here on the plan of the example states its effect, its runs at 20 mm, and what a record does not need.
const RUNS: &str = "[[lateral]]\nid = \"d30-1\"\ndepth_mm = 30\n[[lateral]]\nid = \"d30-2\"\ndepth_mm = 30\n";

/// Simulates sessions of two tissues and writes their records; made again only where the program is newer.
fn records(folder: &Path, guide: &Path) -> Result<PathBuf> {
    let records = folder.join("example.jsonl");
    let changed = |path: &Path| fs::metadata(path).and_then(|found| found.modified()).ok();
    if changed(&records).is_some_and(|made| changed(guide).is_some_and(|built| built < made)) {
        return Ok(records);
    }
    let sessions = folder.join("sessions");
    if sessions.exists() {
        fs::remove_dir_all(&sessions).with_context(|| format!("{}: cannot remove", sessions.display()))?;
    }
    fs::create_dir_all(&sessions).with_context(|| format!("{}: cannot create", sessions.display()))?;
    let plan = folder.join("example").join("plan.toml");
    let plan = fs::read_to_string(&plan).with_context(|| format!("{}: cannot read", plan.display()))?;
    let (setup, _) = plan.split_once("[[effect]]").context("the plan of the example has no effect")?;
    let guide_in = |folder: &Path, arguments: &[&OsStr]| {
        let exit_status = Command::new(guide)
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status();
        ensure!(exit_status.context("cannot run guide")?.success(), "guide {:?} failed", arguments);
        Ok(())
    };
    let mut summarize: Vec<OsString> = vec!["summarize".into()];
    for (number, (tissue, k_kpa, rig)) in SESSIONS.iter().enumerate() {
        let seed = (number + 1).to_string();
        let name = format!("{tissue}-{seed}");
        let text = format!("{}\n{RUNS}", setup.replace("k_kpa = 12.0", &format!("k_kpa = {k_kpa}")));
        let file = format!("{name}.toml");
        fs::write(sessions.join(&file), text).with_context(|| format!("{file}: cannot write"))?;
        let options = ["simulate", "--config", &file, "--out", &name, "--seed", &seed].map(OsStr::new);
        guide_in(&sessions, &options)?;
        // Labels, by which sessions form groups.
        let session = sessions.join(&name).join("session.toml");
        let text =
            fs::read_to_string(&session).with_context(|| format!("{}: cannot read", session.display()))?;
        let date = format!("[session]\ndate = \"2026-{:02}-15\"\n", number + 1);
        let text = text.replacen("[session]\n", &date, 1).replacen(
            "[rig]\n",
            &format!("[rig]\nid = \"{rig}\"\n"),
            1,
        );
        // A table that the simulation writes too has the label in it.
        let (table, label) = ("[tissue]\n", format!("[tissue]\nid = \"{tissue}\"\n"));
        let text = if text.contains(table) { text.replacen(table, &label, 1) } else { text + "\n" + &label };
        fs::write(&session, text + &format!("\n[subject]\nid = \"s{seed}\"\n"))
            .with_context(|| format!("{}: cannot write", session.display()))?;
        summarize.push(name.into());
    }
    summarize.extend(["--out".into(), records.clone().into_os_string()]);
    let arguments: Vec<&OsStr> = summarize.iter().map(OsString::as_os_str).collect();
    guide_in(&sessions, &arguments)?;
    // A session that cannot be read is a record with its error.
    let text = fs::read_to_string(&records).with_context(|| format!("{}: cannot read", records.display()))?;
    if let Some(record) = text.lines().find(|record| !record.contains("\"error\":null")) {
        let record = record.to_owned();
        fs::remove_file(&records).with_context(|| format!("{}: cannot remove", records.display()))?;
        bail!("a session of the page's records cannot be summarized: {record}");
    }
    Ok(records)
}

/// Installs Chromium and its driver where they are missing.
fn ensure_browser() -> Result<()> {
    if PROGRAMS.iter().all(|program| {
        let version =
            Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    }) {
        return Ok(());
    }
    let packages = PACKAGES.join(" and ");
    if !setup::can_install() {
        bail!(
            "{} are needed for the test in a browser: install {packages} from your distribution",
            PROGRAMS.join(" and ")
        );
    }
    eprintln!("xtask: installing {packages} with apt (to test the page in a browser)");
    setup::apt(&["update"])?;
    let mut arguments = vec!["install", "--yes", "--no-install-recommends"];
    arguments.extend(PACKAGES);
    setup::apt(&arguments).with_context(|| format!("cannot install {packages}"))
}
