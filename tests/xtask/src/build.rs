//! Builds with cargo's progress on the screen, and runs what was built.

use crate::progress::{Output, watched};
use crate::setup;
use anyhow::{Context, Result, anyhow, ensure};
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::thread;

/// Features of the firmware's image that most tests and the demonstration boot.
pub const FIRST_IMAGE: &str = "qemu,conformance,b-l475e-iot01a";

/// Announces the steps of `cargo xtask demo`.
pub fn announce_demo() {
    eprintln!(
        "xtask: 1. the Rust target and QEMU for the firmware, if they are missing\n\
         xtask: 2. builds `guide` and the simulated rig (minutes the first time, seconds after), then the firmware\n\
         xtask: 3. the firmware in QEMU measures a simulated tissue, and simulated ultrasound frames the needle's shape; `guide` identifies the \
         modulus K, predicts insertions, finds a hidden effect"
    );
}

/// Builds `guide` and the program `system`, and runs a task of the latter.
///
/// # Errors
/// Where the build fails or the program cannot be started.
pub fn system(task: &str, arguments: &[OsString]) -> Result<ExitCode> {
    cargo(&["build", "--package", "host", "--package", "system", "--bin", "guide", "--bin", "system"])?;
    run_system(task, arguments)
}

/// Builds `guide`, the program `system` and the image of the firmware, and runs the demonstration.
///
/// # Errors
/// As [`system`].
pub fn demo(arguments: &[OsString]) -> Result<ExitCode> {
    // Parts that it does not show are omitted: live screens, the page in the browser, DICOM, and everything of `system`
    // that tests need.
    let programs = ["build", "--package", "host", "--package", "system", "--bin", "guide", "--bin", "system"];
    with_image(|| cargo(&[&programs[..], &["--no-default-features"]].concat()))?;
    run_system("demo", arguments)
}

/// Builds the image that the demonstration and most tests boot beside another build: each has stretches that occupy one
/// processor only. The start of QEMU checks it again.
///
/// # Errors
/// Where one of them fails.
pub fn with_image(build: impl FnOnce() -> Result<()>) -> Result<()> {
    let image = thread::spawn(|| {
        let (folder, parts_dir) = (target_dir().join("image-qemu"), image_parts());
        let image = ["image", "--bin", "firmware", "--features", FIRST_IMAGE, "--target-dir"];
        cargo_with(
            &[&image[..], &[&*folder.to_string_lossy()]].concat(),
            &[("CARGO_BUILD_BUILD_DIR", &parts_dir.to_string_lossy())],
        )
    });
    build()?;
    image.join().map_err(|_| anyhow!("the build of the image has crashed"))?
}

/// Folder of what the firmware's images depend on.
pub fn image_parts() -> PathBuf {
    target_dir().join("image-parts")
}

/// Runs a task of the program `system`, which is built.
///
/// # Errors
/// Where it cannot be started.
pub fn run_system(task: &str, arguments: &[OsString]) -> Result<ExitCode> {
    run(&target_dir().join("debug").join("system"), [OsStr::new(task)], arguments)
}

/// Makes a table: with optimisation, but for the study that runs the firmware.
///
/// # Errors
/// As [`system`].
pub fn study(arguments: &[OsString]) -> Result<ExitCode> {
    match arguments.split_first() {
        Some((name, rest)) if name == "demo" => {
            setup::ensure_all()?;
            system("study-demo", rest)
        }
        Some((name, rest)) if name == "images" => system("study-images", rest),
        Some((name, rest)) if name == "bringup" => {
            setup::ensure_all()?;
            system("study-bringup", rest)
        }
        Some(_) => studies(arguments),
        None => {
            let code = studies(&["modulus-relation".into()])?;
            if code != ExitCode::SUCCESS {
                return Ok(code);
            }
            setup::ensure_all()?;
            system("readme", &["--group".into(), "long".into(), "--only".into(), "cargo xtask study".into()])
        }
    }
}

fn studies(arguments: &[OsString]) -> Result<ExitCode> {
    cargo(&["build", "--release", "--package", "studies", "--bin", "studies"])?;
    run(&target_dir().join("release").join("studies"), [], arguments)
}

/// Runs cargo in the workspace with its output on the screen.
///
/// # Errors
/// Where it fails.
pub fn cargo(arguments: &[&str]) -> Result<()> {
    cargo_with(arguments, &[])
}

/// The program `cargo` that runs this one.
pub fn program() -> OsString {
    std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}

/// The same with environment variables.
///
/// # Errors
/// Where it fails.
pub fn cargo_with(arguments: &[&str], environment: &[(&str, &str)]) -> Result<()> {
    let mut command = Command::new(program());
    command.current_dir(root()).args(arguments).envs(environment.iter().copied());
    let status = watched(&mut command, Output::Messages, |_| {})?;
    ensure!(status.success(), "cargo {} failed", arguments.join(" "));
    Ok(())
}

/// Runs a program to its end, in the folder that the user is in.
///
/// # Errors
/// Where it cannot be started.
pub fn run<'a>(
    program: &Path,
    first: impl IntoIterator<Item = &'a OsStr>,
    arguments: &[OsString],
) -> Result<ExitCode> {
    let status = Command::new(program)
        .args(first)
        .args(arguments)
        .env(PROGRAM, guide())
        .status()
        .with_context(|| format!("cannot run {}", program.display()))?;
    let code = status.code().and_then(|code| u8::try_from(code).ok());
    Ok(code.map_or(ExitCode::FAILURE, ExitCode::from))
}

/// Environment variable that names the program `guide` to what tests it: so it is not built once more.
pub const PROGRAM: &str = "NEEDLE_GUIDE_PROGRAM";

/// The program `guide` as tests and demonstration build it.
pub fn guide() -> PathBuf {
    target_dir().join("debug").join("guide")
}

/// Root of the workspace: of the one that cargo runs this in, which is another than it was compiled in where a checkout was copied with its
/// target folder.
pub fn root() -> PathBuf {
    let package = std::env::var_os("CARGO_MANIFEST_DIR");
    let package = package.map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).to_owned(), PathBuf::from);
    // Without `..`: these paths reach compilers, and what they write has to be the same wherever the checkout is.
    package.ancestors().nth(2).map_or_else(|| package.join("../.."), Path::to_owned)
}

/// Folder of everything that is built.
pub fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}
