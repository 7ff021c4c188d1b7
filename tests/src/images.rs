//! Building the programs under test: the firmware's images and `guide`.

use crate::setup::TARGET;
use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// Cargo profile of the firmware's images.
const PROFILE: &str = "firmware";

/// A firmware image.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Image {
    /// What is flashed to the board.
    Flash,
    /// The same with the trap-and-emulate layer, for QEMU.
    Qemu,
    /// The protocol's tests, for QEMU.
    Conformance,
    /// The online estimator over a recorded run, for QEMU.
    Tracking,
    /// The control core over everything it can be made to do, for QEMU.
    Timing,
}

impl Image {
    /// All of them, those first that most tests need.
    pub const ALL: [Self; 5] = [Self::Qemu, Self::Conformance, Self::Tracking, Self::Timing, Self::Flash];

    const fn binary(self) -> &'static str {
        match self {
            Self::Flash | Self::Qemu => "firmware",
            Self::Conformance => "conformance",
            Self::Tracking => "tracking",
            Self::Timing => "timing",
        }
    }

    /// Folder of its build; images with the same dependencies share one.
    const fn folder(self) -> &'static str {
        match self {
            Self::Flash => "image-flash",
            Self::Qemu | Self::Conformance | Self::Tracking | Self::Timing => "image-qemu",
        }
    }

    const fn features(self) -> &'static str {
        match self {
            Self::Flash => "flash",
            Self::Qemu | Self::Timing => "qemu",
            Self::Tracking => "qemu,steering",
            Self::Conformance => "conformance",
        }
    }
}

/// Root of the workspace.
pub fn root() -> &'static Path {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR"));
    tests.parent().unwrap_or(tests)
}

/// Folder of everything that is built.
pub fn target_dir() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from)
}

/// Builds an image and returns its ELF file.
///
/// # Errors
/// Where the build fails or warns; its messages have gone to standard error.
pub fn build(image: Image) -> Result<PathBuf> {
    let folder = target_dir().join(image.folder());
    let output = cargo()
        .args(["build", "--quiet", "--package", "firmware", "--bin", image.binary()])
        .args([
            "--target",
            TARGET,
            "--profile",
            PROFILE,
            "--no-default-features",
            "--features",
            image.features(),
        ])
        .arg("--target-dir")
        .arg(&folder)
        .stdin(Stdio::null())
        .output()
        .context("cannot run cargo")?;
    let said = String::from_utf8_lossy(&output.stderr);
    eprint!("{said}");
    if !output.status.success() {
        bail!("the firmware does not build ({image:?})");
    }
    if said.contains("warning") {
        bail!("the firmware builds with warnings ({image:?})");
    }
    Ok(folder.join(TARGET).join(PROFILE).join(image.binary()))
}

/// Lints an image's code as it is for the microcontroller.
///
/// # Errors
/// Where there is anything to say.
pub fn lint(image: Image) -> Result<()> {
    let status = cargo()
        .args(["clippy", "--quiet", "--package", "firmware"])
        .args([
            "--target",
            TARGET,
            "--profile",
            PROFILE,
            "--no-default-features",
            "--features",
            image.features(),
        ])
        .arg("--target-dir")
        .arg(target_dir().join(image.folder()))
        .args(["--", "-D", "warnings"])
        .status()
        .context("cannot run cargo")?;
    if !status.success() {
        bail!("clippy complains about the firmware ({image:?})");
    }
    Ok(())
}

/// Builds `guide` and returns the program.
///
/// # Errors
/// Where the build fails; its messages have gone to standard error.
pub fn build_guide() -> Result<PathBuf> {
    let status = cargo()
        // With this package the dependencies are those that xtask itself was built with; alone `host` has some with fewer
        // features, and all would be built once more.
        .args(["build", "--quiet", "--package", "host", "--package", "tests", "--bin", "guide"])
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
