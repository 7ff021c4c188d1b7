//! Prerequisites of a fresh machine: the microcontroller's Rust target and a QEMU that has the
//! board.
//!
//! A missing prerequisite is installed if that takes no decision of the user (a Rust target through rustup; QEMU
//! through apt where this runs as root); otherwise one line states what to install.

use anyhow::{Context, Result, bail};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Target of the firmware.
pub const TARGET: &str = "thumbv7em-none-eabihf";
/// The QEMU program.
pub const QEMU: &str = "qemu-system-arm";
/// First QEMU that has the board with its serial ports and gives a pty a name of one's choice.
pub const QEMU_NEEDED: (u32, u32) = (9, 2);

const APT_SOURCES: &str = "/etc/apt/sources.list.d";
const BACKPORTS_FILE: &str = "/etc/apt/sources.list.d/needle-guide-backports.sources";

/// Runs `cargo xtask setup`.
///
/// # Errors
/// As [`ensure_all`]; with `only_name` nothing is installed or changed, and all that is missing is named.
pub fn setup(only_name: bool) -> Result<()> {
    if !only_name {
        return ensure_all();
    }
    let (major, minor) = QEMU_NEEDED;
    let missing: Vec<String> = [
        (!has_target(TARGET)?).then(|| format!("the Rust target {TARGET} (rustup target add {TARGET})")),
        (qemu_version() < Some(QEMU_NEEDED)).then(|| format!("{QEMU} {major}.{minor} or newer")),
    ]
    .into_iter()
    .flatten()
    .collect();
    if missing.is_empty() {
        println!("nothing is missing");
        return Ok(());
    }
    bail!("missing: {}", missing.join(", "))
}

/// Installs what is missing.
///
/// # Errors
/// Names what could not be installed and how to install it by hand.
pub fn ensure_all() -> Result<()> {
    ensure_target()?;
    ensure_qemu()
}

/// Installs the Rust target if it is missing.
///
/// # Errors
/// Where there is no rustup or it fails.
pub fn ensure_target() -> Result<()> {
    ensure_rust_target(TARGET, "to build the firmware")
}

/// Installs a Rust target if it is missing.
///
/// # Errors
/// Where there is no rustup or it fails.
pub fn ensure_rust_target(target: &str, purpose: &str) -> Result<()> {
    if has_target(target)? {
        return Ok(());
    }
    log(format_args!("installing the Rust target {target} ({purpose})"));
    run(Command::new("rustup").args(["target", "add", target]))
        .with_context(|| format!("cannot install the Rust target; by hand: rustup target add {target}"))
}

fn has_target(target: &str) -> Result<bool> {
    let sysroot = output(Command::new("rustc").args(["--print", "sysroot"]))?;
    Ok(Path::new(sysroot.trim()).join("lib/rustlib").join(target).is_dir())
}

/// Installs QEMU if it is missing or too old.
///
/// # Errors
/// States which version is needed and where to get it, where it cannot be installed.
pub fn ensure_qemu() -> Result<()> {
    let installed_version = qemu_version();
    if installed_version.is_some_and(|version| version >= QEMU_NEEDED) {
        return Ok(());
    }
    let (major, minor) = QEMU_NEEDED;
    let have = installed_version
        .map_or("there is none".to_owned(), |(major, minor)| format!("there is {major}.{minor}"));
    let requirement = format!("{QEMU} {major}.{minor} or newer is needed ({have})");
    let by_hand = "install it from your distribution (Debian 13, Ubuntu 25.04, Fedora 42, Homebrew have one; \
                   Debian 12 has one in its backports)";
    if !can_install() {
        bail!("{requirement}: {by_hand}");
    }
    log(format_args!(
        "{requirement}: installing it with apt (to run the firmware); `cargo xtask setup --no-install` only reports what is missing"
    ));
    apt(&["update"]).with_context(|| format!("{requirement}: {by_hand}"))?;
    let release = if candidate_version()? >= Some(QEMU_NEEDED) { None } else { add_backports()? };
    let mut arguments = vec!["install", "--yes", "--no-install-recommends"];
    if let Some(release) = &release {
        arguments.extend(["--target-release", release]);
    }
    arguments.push(QEMU);
    apt(&arguments).with_context(|| format!("{requirement}: {by_hand}"))?;
    match qemu_version() {
        Some(version) if version >= QEMU_NEEDED => Ok(()),
        _ => bail!("{requirement}, and apt has none that new: {by_hand}"),
    }
}

fn qemu_version() -> Option<(u32, u32)> {
    let text = output(Command::new(QEMU).arg("--version")).ok()?;
    parse_version(text.split("version ").nth(1)?)
}

/// Major and minor number at the start of a version, without a Debian epoch.
fn parse_version(text: &str) -> Option<(u32, u32)> {
    let upstream = match text.split_once(':') {
        Some((epoch, rest)) if epoch.bytes().all(|byte| byte.is_ascii_digit()) => rest,
        _ => text,
    };
    let mut numbers = upstream.split(|c: char| !c.is_ascii_digit()).map(str::parse);
    Some((numbers.next()?.ok()?, numbers.next()?.ok()?))
}

/// Version that apt would install from what is configured.
fn candidate_version() -> Result<Option<(u32, u32)>> {
    let policy = output(Command::new("apt-cache").args(["policy", QEMU]))?;
    let candidate = policy.lines().find_map(|line| line.trim().strip_prefix("Candidate: "));
    Ok(candidate.and_then(parse_version))
}

/// Adds the distribution's backports, at the address the machine's own sources already use; returns the suite's name.
fn add_backports() -> Result<Option<String>> {
    let release = fs::read_to_string("/etc/os-release").context("cannot determine the distribution")?;
    let field = |name: &str| {
        let value = release.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='));
        value.map(|value| value.trim_matches('"').to_owned())
    };
    let (Some(id), Some(codename)) = (field("ID"), field("VERSION_CODENAME")) else { return Ok(None) };
    if id != "debian" {
        return Ok(None);
    }
    let suite = format!("{codename}-backports");
    if !Path::new(BACKPORTS_FILE).exists() {
        let (address, key) =
            configured_archive(&codename).context("no source of this Debian release is configured")?;
        let signed = key.map_or(String::new(), |key| format!("Signed-By: {key}\n"));
        let source = format!("Types: deb\nURIs: {address}\nSuites: {suite}\nComponents: main\n{signed}");
        log(format_args!(
            "adding {suite} to this system's apt sources: {BACKPORTS_FILE}; to undo it, remove that file and run apt-get update"
        ));
        fs::write(BACKPORTS_FILE, source).with_context(|| format!("cannot write {BACKPORTS_FILE}"))?;
    }
    apt(&["update"])?;
    Ok(Some(suite))
}

/// Address and key of the archive that serves this release, from either form of apt's source files.
fn configured_archive(codename: &str) -> Option<(String, Option<String>)> {
    let mut files = vec![Path::new("/etc/apt/sources.list").to_owned()];
    files.extend(fs::read_dir(APT_SOURCES).into_iter().flatten().flatten().map(|entry| entry.path()));
    files.iter().filter_map(|file| fs::read_to_string(file).ok()).find_map(|text| archive_in(&text, codename))
}

fn archive_in(text: &str, codename: &str) -> Option<(String, Option<String>)> {
    let one_line = text.lines().find_map(|line| {
        let line = line.trim();
        let fields = line.strip_prefix("deb ")?;
        let key = fields.split_once("signed-by=").map(|(_, rest)| rest);
        let key = key.and_then(|rest| rest.split([']', ' ']).next()).map(str::to_owned);
        let mut words = fields.split_whitespace().skip_while(|word| !word.contains("://"));
        let address = words.next()?.to_owned();
        (words.next()? == codename).then_some((address, key))
    });
    one_line.or_else(|| {
        text.split("\n\n").find_map(|stanza| {
            let field = |name: &str| stanza.lines().find_map(|line| line.strip_prefix(name)).map(str::trim);
            let suites = field("Suites:")?;
            let address = field("URIs:")?.split_whitespace().next()?.to_owned();
            let serves = suites.split_whitespace().any(|suite| suite == codename);
            serves.then(|| (address, field("Signed-By:").map(str::to_owned)))
        })
    })
}

/// Whether packages of the system can be installed here.
pub fn can_install() -> bool {
    Path::new("/usr/bin/apt-get").exists() && is_root()
}

/// Runs apt-get without questions.
///
/// # Errors
/// Where it fails.
pub fn apt(arguments: &[&str]) -> Result<()> {
    run(Command::new("apt-get").arg("--quiet").args(arguments).env("DEBIAN_FRONTEND", "noninteractive"))
}

fn is_root() -> bool {
    output(Command::new("id").arg("-u")).is_ok_and(|id| id.trim() == "0")
}

/// Runs a command whose output is of interest only if it fails.
fn run(command: &mut Command) -> Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let result = command.stdin(Stdio::null()).output().with_context(|| format!("cannot run {name}"))?;
    if !result.status.success() {
        let stderr = String::from_utf8_lossy(&result.stderr);
        bail!("{name} failed: {}", stderr.lines().last().unwrap_or("no output"));
    }
    Ok(())
}

fn output(command: &mut Command) -> Result<String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let result = command.stdin(Stdio::null()).output().with_context(|| format!("cannot run {name}"))?;
    if !result.status.success() {
        bail!("{name} failed: {}", String::from_utf8_lossy(&result.stderr).trim());
    }
    Ok(String::from_utf8_lossy(&result.stdout).into_owned())
}

fn log(text: std::fmt::Arguments) {
    eprintln!("xtask: {text}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_of_qemu_and_of_debian_packages() {
        assert_eq!(parse_version("10.0.2 (Debian 1:10.0.2+ds-2)"), Some((10, 0)));
        assert_eq!(parse_version("1:7.2+dfsg-7+deb12u18"), Some((7, 2)));
        assert_eq!(parse_version("(none)"), None);
    }

    #[test]
    fn the_archive_is_found_in_both_forms_of_source_files() {
        let one_line =
            "# comment\ndeb [arch=amd64 signed-by=/k.gpg] http://mirror.example/debian trixie main\n";
        let archive_line = archive_in(one_line, "trixie");
        assert_eq!(archive_line, Some(("http://mirror.example/debian".into(), Some("/k.gpg".into()))));
        assert_eq!(archive_in(one_line, "bookworm"), None);
        let stanzas = "Types: deb\nURIs: http://s.example/sec\nSuites: trixie-security\n\n\
                       Types: deb\nURIs: http://m.example/debian\nSuites: trixie trixie-updates\nSigned-By: /k.gpg\n";
        let archive_line = archive_in(stanzas, "trixie");
        assert_eq!(archive_line, Some(("http://m.example/debian".into(), Some("/k.gpg".into()))));
        assert_eq!(archive_in("deb http://m.example/debian trixie main\n", "trixie").unwrap().1, None);
    }
}
