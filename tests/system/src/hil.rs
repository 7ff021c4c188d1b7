//! `cargo xtask hil`: a board on a debug probe. The protocol's tests run on it, then it gets its firmware, then `guide bringup` runs the
//! steps that need no hand.
//!
//! `probe-rs` flashes and runs; the test program ends by an exit code over semihosting, which `probe-rs run` ends with. The same program runs
//! in QEMU in the tests, so that what fails here is the board.

use crate::images::{self, Board, Image, root};
use anyhow::{Context, Result, bail, ensure};
use std::ffi::OsString;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The program that flashes and runs.
const PROBE_RS: &str = "probe-rs";
/// Steps of `guide bringup` that move nothing and need no hand.
const AT_REST: [&str; 4] = ["link", "supply", "converter", "potentiometers"];
/// Those that move guide 2, in their order.
const IN_MOTION: [&str; 3] = ["motors", "loop", "force"];

/// Options of `cargo xtask hil`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Example:\n  cargo xtask hil --board nucleo-l476rg --port /dev/ttyACM0")]
pub struct Args {
    /// The board
    #[arg(long, value_enum, default_value = "b-l475e-iot01a")]
    board: Board,
    /// The debug probe, where there are several, as `probe-rs list` prints it
    #[arg(long, value_name = "VID:PID:SERIAL")]
    probe: Option<String>,
    /// The board's serial port, for `guide bringup`; without it only the tests run and the firmware is flashed
    #[arg(long, value_name = "PORT")]
    port: Option<String>,
    /// Also the steps that move guide 2: the needle is mounted in air, and nobody is near
    #[arg(long, requires = "port")]
    motion: bool,
    /// Keep the result of `guide bringup` in this file
    #[arg(long, value_name = "FILE", default_value = "bringup.toml")]
    out: PathBuf,
}

/// One program to run: what it is for, its name and its arguments.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Step {
    what: &'static str,
    program: PathBuf,
    arguments: Vec<OsString>,
}

/// All of it, in order.
fn steps(args: &Args, tests: &Path, firmware: &Path, guide: &Path) -> Vec<Step> {
    let probe_rs = |what, verb: &str, image: Option<&Path>| {
        let mut arguments: Vec<OsString> = vec![verb.into(), "--chip".into(), args.board.chip().into()];
        if let Some(probe) = &args.probe {
            arguments.extend(["--probe".into(), probe.into()]);
        }
        arguments.extend(image.map(Into::into));
        Step { what, program: PROBE_RS.into(), arguments }
    };
    let mut steps = vec![
        probe_rs("the protocol's tests", "run", Some(tests)),
        probe_rs("flashing the firmware", "download", Some(firmware)),
        probe_rs("starting the firmware", "reset", None),
    ];
    if let Some(port) = &args.port {
        let mut arguments: Vec<OsString> =
            vec!["bringup".into(), "--yes".into(), "--port".into(), port.into()];
        let motion: &[&str] = if args.motion { &IN_MOTION } else { &[] };
        for step in AT_REST.iter().chain(motion) {
            arguments.extend(["--step".into(), step.into()]);
        }
        arguments.extend(["--out".into(), args.out.clone().into()]);
        steps.push(Step { what: "guide bringup", program: guide.into(), arguments });
    }
    steps
}

/// Runs everything; the first step that fails ends it.
///
/// # Errors
/// Where `probe-rs` is not installed, an image does not build, or a step fails.
pub fn run(args: &Args) -> Result<()> {
    ensure_probe_rs()?;
    let tests = images::build_for(args.board, Image::BoardConformance)?;
    // Both are built before anything is flashed.
    let firmware = images::build_for(args.board, Image::Flash)?;
    let guide = if args.port.is_some() { images::build_guide()? } else { PathBuf::new() };
    for step in steps(args, &tests, &firmware, &guide) {
        println!("\n     {} ({})", step.what, args.board.name());
        let status = Command::new(&step.program)
            .args(&step.arguments)
            .stdin(Stdio::null())
            .status()
            .with_context(|| format!("cannot run {}", step.program.display()))?;
        ensure!(status.success(), "{} failed ({status})", step.what);
    }
    if args.port.is_none() {
        println!("\nguide bringup was not run: it needs the board's serial port (--port)");
    }
    let page = root().join("host/manual/src/on-a-board.md");
    println!("what only the board shows, with places for the figures: {}", page.display());
    Ok(())
}

fn ensure_probe_rs() -> Result<()> {
    match Command::new(PROBE_RS).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => bail!("`{PROBE_RS} --version` fails ({status})"),
        Err(error) if error.kind() == ErrorKind::NotFound => bail!(
            "{PROBE_RS} is not installed; it flashes and runs programs on a board: cargo install --locked probe-rs-tools, or https://probe.rs"
        ),
        Err(error) => Err(error).with_context(|| format!("cannot run {PROBE_RS}")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        args: Args,
    }

    fn lines(options: &[&str]) -> Vec<String> {
        let args = Line::try_parse_from(["hil"].iter().chain(options)).unwrap().args;
        steps(&args, Path::new("tests"), Path::new("image"), Path::new("guide"))
            .iter()
            .map(|step| {
                let arguments: Vec<_> = step.arguments.iter().map(|text| text.to_string_lossy()).collect();
                format!("{} {}", step.program.display(), arguments.join(" "))
            })
            .collect()
    }

    #[test]
    fn tests_come_before_the_firmware_and_motion_only_where_it_is_allowed() {
        assert_eq!(
            lines(&["--board", "nucleo-l476rg", "--probe", "0483:374b:066F"]),
            [
                "probe-rs run --chip STM32L476RGTx --probe 0483:374b:066F tests",
                "probe-rs download --chip STM32L476RGTx --probe 0483:374b:066F image",
                "probe-rs reset --chip STM32L476RGTx --probe 0483:374b:066F",
            ]
        );
        let at_rest = lines(&["--port", "/dev/ttyACM0"]);
        assert_eq!(at_rest.len(), 4);
        assert!(at_rest[0].contains("STM32L475VGTx"));
        assert_eq!(
            at_rest[3],
            "guide bringup --yes --port /dev/ttyACM0 --step link --step supply --step converter --step potentiometers --out bringup.toml"
        );
        let moving = lines(&["--port", "/dev/ttyACM0", "--motion"]);
        assert!(moving[3].contains("--step potentiometers --step motors --step loop --step force --out"));
        assert!(Line::try_parse_from(["hil", "--motion"]).is_err(), "motion without a port");
    }
}
