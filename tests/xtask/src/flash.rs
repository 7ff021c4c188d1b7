//! `cargo xtask flash`: builds the firmware of a board and flashes it.

use crate::build::{cargo_with, image_parts, target_dir};
use crate::check::is_installed;
use crate::setup;
use anyhow::{Context, Result, bail, ensure};
use std::ffi::{OsStr, OsString};
use std::path::PathBuf;
use std::process::{Command, ExitCode};

/// Help of the task.
pub const HELP: &str = "Build the firmware of a board and flash it with probe-rs\n\n\
    Usage: cargo xtask flash [--board BOARD] [--log]\n\n\
    Options:\n  \
      --board BOARD  b-l475e-iot01a (default) or nucleo-l476rg\n  \
      --log          Stay connected and print the firmware's log, until Ctrl-C\n\n\
    The motor supply is off while a board is flashed. A calibration that is stored in the board stays.\n";

/// A board: its name, which is a feature of the firmware too, and its chip as probe-rs names it.
#[derive(Clone, Copy)]
struct Board {
    name: &'static str,
    chip: &'static str,
}

const BOARDS: [Board; 2] = [
    Board { name: "b-l475e-iot01a", chip: "STM32L475VGTx" },
    Board { name: "nucleo-l476rg", chip: "STM32L476RGTx" },
];

/// Runs the task.
///
/// # Errors
/// The image cannot be built, or probe-rs is missing or fails.
pub fn flash(arguments: &[OsString]) -> Result<ExitCode> {
    let (board, shows_log) = options(arguments)?;
    setup::ensure_target()?;
    let image = image(board)?;
    ensure!(
        is_installed("probe-rs"),
        "probe-rs is not installed: `cargo install --locked probe-rs-tools`, or flash {} with another tool (host/manual/src/rig.md)",
        image.display()
    );
    let verb = if shows_log { "run" } else { "download" };
    let status = Command::new("probe-rs")
        .args([verb, "--chip", board.chip])
        .arg(&image)
        .status()
        .context("cannot run probe-rs")?;
    ensure!(status.success(), "probe-rs {verb}: {status}");
    if !shows_log {
        // After a download the chip is halted.
        let status = Command::new("probe-rs")
            .args(["reset", "--chip", board.chip])
            .status()
            .context("cannot run probe-rs")?;
        ensure!(status.success(), "probe-rs reset: {status}");
    }
    Ok(ExitCode::SUCCESS)
}

fn options(arguments: &[OsString]) -> Result<(&'static Board, bool)> {
    let (mut board, mut shows_log) = (&BOARDS[0], false);
    let mut arguments = arguments.iter().map(OsString::as_os_str);
    while let Some(argument) = arguments.next() {
        match argument.to_str() {
            Some("--log") => shows_log = true,
            Some("--board") => board = named(arguments.next())?,
            _ => bail!("flash: unknown option {}, expected --board or --log", argument.display()),
        }
    }
    Ok((board, shows_log))
}

fn named(name: Option<&OsStr>) -> Result<&'static Board> {
    let board_names = BOARDS.map(|board| board.name).join(" or ");
    let name = name.with_context(|| format!("--board: expected {}", board_names))?;
    BOARDS
        .iter()
        .find(|board| name == board.name)
        .with_context(|| format!("--board: `{}` is not known, expected {}", name.display(), board_names))
}

/// Builds the image that is flashed; its path.
fn image(board: &Board) -> Result<PathBuf> {
    eprintln!("xtask: firmware of {}", board.name);
    let folder = target_dir().join(format!("image-flash-{}", board.name));
    let features = format!("flash,{}", board.name);
    cargo_with(
        &[
            "image",
            "--locked",
            "--bin",
            "firmware",
            "--features",
            &features,
            "--target-dir",
            &folder.to_string_lossy(),
        ],
        &[("CARGO_BUILD_BUILD_DIR", &image_parts().to_string_lossy())],
    )?;
    Ok(folder.join(setup::TARGET).join("firmware/firmware"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::build::root;

    fn parse(arguments: &[&str]) -> Result<(&'static Board, bool)> {
        options(&arguments.iter().map(OsString::from).collect::<Vec<_>>())
    }

    #[test]
    fn options_name_a_board() {
        let (board, shows_log) = parse(&[]).expect("the default");
        assert_eq!((board.name, shows_log), ("b-l475e-iot01a", false));
        let (board, shows_log) = parse(&["--log", "--board", "nucleo-l476rg"]).expect("a board");
        assert_eq!((board.chip, shows_log), ("STM32L476RGTx", true));
        for (wrong, message) in [
            (&["--board"][..], "expected b-l475e-iot01a or nucleo-l476rg"),
            (&["--board", "nucleo"], "`nucleo` is not known"),
            (&["--fast"], "unknown option --fast"),
        ] {
            let error = parse(wrong).err().expect("refused").to_string();
            assert!(error.contains(message), "{error}");
        }
    }

    /// The boards are those that the tests on a board know, and features of the firmware.
    #[test]
    fn boards_and_chips_are_those_of_the_firmware() {
        let [images, features] = ["tests/system/src/images.rs", "firmware/Cargo.toml"]
            .map(|path| std::fs::read_to_string(root().join(path)).expect("a source"));
        for board in &BOARDS {
            assert!(images.contains(board.chip), "{}", board.chip);
            assert!(features.contains(&format!("{} = [", board.name)), "{}", board.name);
        }
    }
}
