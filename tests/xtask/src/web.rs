//! `cargo xtask web`: the page `guide.html`; with `--test` it is opened in Chromium and compared with the program.

use crate::build::{cargo, run, target_dir};
use crate::setup;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};

/// Target of the engine.
const TARGET: &str = "wasm32-wasip1";
/// What the test in a browser needs, as Debian and its relatives name it.
const PACKAGES: [&str; 2] = ["chromium", "chromium-driver"];
const PROGRAMS: [&str; 2] = ["chromium", "chromedriver"];
/// The engine's entry point, which the page calls once per request.
const ENTRY: &str = "link-arg=--export=__main_void";

/// Makes the page, and tests it where that is requested.
///
/// # Errors
/// Where something cannot be installed or built, or the arguments are not known.
pub fn web(arguments: &[OsString]) -> Result<ExitCode> {
    let (is_test, rest) = match arguments.split_first() {
        Some((first, rest)) if first == "--test" => (true, rest),
        _ => (false, arguments),
    };
    if !is_test && arguments.iter().any(|argument| argument == "--help" || argument == "-h") {
        println!(
            "Make guide.html: the page with everything in it, opened from disk\n\nUsage: cargo xtask web [--test [OPTIONS]]\n\n\
             Options:\n  --test  Open it in Chromium, compare what it shows with the program, measure, and take pictures;\n          \
             options of the test follow (--test --help)"
        );
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(unknown) = arguments.first().filter(|_| !is_test) {
        bail!("web: unknown option {}, expected --test or none", unknown.display());
    }
    announce(is_test);
    if is_test {
        ensure_browser()?;
    }
    let page = make()?;
    if !is_test {
        println!("open {} in a browser", page.display());
        return Ok(ExitCode::SUCCESS);
    }
    let program = target_dir().join("debug").join("browser");
    run(&program, [OsStr::new("--page"), page.as_os_str()], rest)
}

fn announce(is_test: bool) {
    eprintln!(
        "xtask: 1. the Rust target {TARGET}, if it is missing\n\
         xtask: 2. builds the engine of the page (minutes the first time) and `guide`, which makes the example\n\
         xtask: 3. writes target/web/guide.html"
    );
    if is_test {
        eprintln!(
            "xtask: 4. opens it in Chromium (installed with apt, if it is missing and this runs as root)"
        );
    }
}

/// Builds all parts and puts them together.
fn make() -> Result<PathBuf> {
    setup::ensure_rust_target(TARGET, "to build the engine of the page")?;
    cargo(&[
        "rustc",
        "--package",
        "web",
        "--bin",
        "engine",
        "--target",
        TARGET,
        "--profile",
        "web",
        "--",
        "-C",
        ENTRY,
    ])?;
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
    let made = Command::new(debug.join("guide"))
        .args(["init", "--example"])
        .arg(&example)
        .stdout(Stdio::null())
        .status()
        .context("cannot run guide")?;
    ensure!(made.success(), "guide init failed");
    let engine = target_dir().join(TARGET).join("web").join("engine.wasm");
    let code =
        run(&debug.join("web-pack"), [engine.as_os_str(), example.as_os_str(), page.as_os_str()], &[])?;
    ensure!(code == ExitCode::SUCCESS, "the page could not be put together");
    Ok(page)
}

/// Installs Chromium and its driver where they are missing.
fn ensure_browser() -> Result<()> {
    let is_there = |program: &&str| {
        let version =
            Command::new(program).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        version.is_ok_and(|status| status.success())
    };
    if PROGRAMS.iter().all(is_there) {
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
