//! Building the programs under test: the firmware's images and `guide`.

use anyhow::{Context, Result, bail};
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

/// Target of the firmware.
const TARGET: &str = "thumbv7em-none-eabihf";
/// Environment variable that names the program `guide` to test.
pub const GUIDE: &str = "NEEDLE_GUIDE_PROGRAM";
/// Cargo profile of the firmware's images.
const PROFILE: &str = "firmware";

/// A board that the firmware is built for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Board {
    /// STM32L475VG.
    #[value(name = "b-l475e-iot01a")]
    BL475eIot01a,
    /// STM32L476RG.
    #[value(name = "nucleo-l476rg")]
    NucleoL476rg,
}

impl Board {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::BL475eIot01a, Self::NucleoL476rg];

    /// Feature of the firmware, and key of its figures.
    pub const fn name(self) -> &'static str {
        match self {
            Self::BL475eIot01a => "b-l475e-iot01a",
            Self::NucleoL476rg => "nucleo-l476rg",
        }
    }

    /// The chip's name for `probe-rs`.
    pub const fn chip(self) -> &'static str {
        match self {
            Self::BL475eIot01a => "STM32L475VGTx",
            Self::NucleoL476rg => "STM32L476RGTx",
        }
    }

    /// Ports of QEMU's machine before the one that the firmware uses.
    pub const fn serial_ports_before(self) -> usize {
        match self {
            Self::BL475eIot01a => 0,
            Self::NucleoL476rg => 1,
        }
    }

    /// The folder of a build, which the first board has to itself.
    fn folder(self, of: &str) -> String {
        match self {
            Self::BL475eIot01a => of.to_owned(),
            Self::NucleoL476rg => format!("{of}-{}", self.name()),
        }
    }
}

/// A firmware image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Image {
    /// Image that is flashed to the board.
    Flash,
    /// The same with the trap-and-emulate layer, for QEMU.
    Qemu,
    /// The protocol's tests, for QEMU.
    Conformance,
    /// The protocol's tests, for the board.
    BoardConformance,
    /// The online estimator over a recorded run, for QEMU.
    Tracking,
    /// The control core over everything it can be made to do, for QEMU.
    Timing,
}

impl Image {
    const fn binary(self) -> &'static str {
        match self {
            Self::Flash | Self::Qemu => "firmware",
            Self::Conformance | Self::BoardConformance => "conformance",
            Self::Tracking => "tracking",
            Self::Timing => "timing",
        }
    }

    /// Folder of its build; images with the same dependencies share one.
    const fn folder(self) -> &'static str {
        match self {
            Self::Flash | Self::BoardConformance => "image-flash",
            Self::Qemu | Self::Conformance | Self::Tracking | Self::Timing => "image-qemu",
        }
    }

    const fn features(self) -> &'static str {
        match self {
            Self::Flash => "flash",
            // The same for all, so that what they depend on is built once.
            Self::Qemu | Self::Timing | Self::Tracking | Self::Conformance => "qemu,conformance",
            Self::BoardConformance => "flash,conformance",
        }
    }
}

/// Root of the workspace.
pub fn root() -> &'static Path {
    let manifest_folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    manifest_folder.ancestors().nth(2).unwrap_or(manifest_folder)
}

/// Folder of everything that is built.
pub fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Builds an image for the first board and returns its ELF file.
///
/// # Errors
/// As [`build_for`].
pub fn build(image: Image) -> Result<PathBuf> {
    build_for(Board::BL475eIot01a, image)
}

/// Images that this process has built: cargo need not check them for every test that boots one.
static BUILT: Mutex<Vec<(Board, Image, PathBuf)>> = Mutex::new(Vec::new());

/// Builds an image for a board, once in a process, and returns its ELF file.
///
/// # Errors
/// Where the build fails or warns; its messages have gone to standard error.
pub fn build_for(board: Board, image: Image) -> Result<PathBuf> {
    let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((_, _, elf)) = built.iter().find(|(of, which, _)| (*of, *which) == (board, image)) {
        return Ok(elf.clone());
    }
    let elf = run_build(board, image)?;
    built.push((board, image, elf.clone()));
    Ok(elf)
}

fn run_build(board: Board, image: Image) -> Result<PathBuf> {
    let folder = target_dir().join(board.folder(image.folder()));
    let mut child = cargo()
        .args(["image", "--bin", image.binary()])
        .args(["--features", &format!("{},{}", image.features(), board.name())])
        .arg("--target-dir")
        .arg(&folder)
        // Common dependencies of several images are built once; only the final crates have a folder of
        // their own.
        .env("CARGO_BUILD_BUILD_DIR", target_dir().join("image-parts"))
        .stdin(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot run cargo")?;
    // Progress is shown as it comes: the first build takes a minute.
    let mut warned = false;
    for line in BufReader::new(child.stderr.take().context("cargo has no messages")?).lines() {
        let line = line?;
        warned |= line.starts_with("warning");
        eprintln!("{line}");
    }
    if !child.wait()?.success() {
        bail!("the firmware does not build ({image:?}, {})", board.name());
    }
    if warned {
        bail!("the firmware builds with warnings ({image:?}, {})", board.name());
    }
    Ok(folder.join(TARGET).join(PROFILE).join(image.binary()))
}

/// Builds `guide` and returns the program, or returns the one that [`GUIDE`] names: what has just built everything sets it, and
/// nothing is built once more.
///
/// # Errors
/// Where the build fails; its messages have gone to standard error.
pub fn build_guide() -> Result<PathBuf> {
    if let Some(built) = std::env::var_os(GUIDE) {
        return Ok(built.into());
    }
    let status = cargo()
        .args(["build", "--package", "host", "--package", "system", "--bin", "guide"])
        .stdin(Stdio::null())
        .status()
        .context("cannot run cargo")?;
    if !status.success() {
        bail!("guide does not build");
    }
    Ok(target_dir().join("debug").join(format!("guide{}", std::env::consts::EXE_SUFFIX)))
}

/// Cargo as it was called, in the workspace.
pub fn cargo() -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.current_dir(root());
    command
}
