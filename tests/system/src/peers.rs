//! Other people's OpenIGTLink: `pyigtl` for Python, and the C++ library's examples as Debian packages them; and environments for Python.
//!
//! They are set up in `target/peers` when they are first needed; where they cannot be had, the reason is reported instead. Nothing is
//! installed in the system.

use crate::images::root;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Mutex;

/// Debian's packages: the library, its headers, its examples.
const PACKAGES: [&str; 3] = ["libopenigtlink1.11", "libopenigtlink-dev", "openigtlink-examples"];
/// One set-up at a time.
static SET_UP: Mutex<()> = Mutex::new(());

/// A process that is ended when it is dropped.
#[derive(Debug)]
pub struct Running(pub Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Folder of a set-up, once it is complete; `make` makes it.
fn folder(name: &str, make: impl FnOnce(&Path) -> Result<(), String>) -> Result<PathBuf, String> {
    let _turn = SET_UP.lock();
    let folder = root().join("target/peers").join(name);
    let complete = folder.join("complete");
    if !complete.exists() {
        let cannot = |error: std::io::Error| format!("{}: {error}", folder.display());
        // What an earlier attempt has left.
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).map_err(cannot)?;
        make(&folder)?;
        fs::write(&complete, "").map_err(cannot)?;
    }
    Ok(folder)
}

fn run(command: &mut Command) -> Result<Output, String> {
    let name = command.get_program().to_string_lossy().into_owned();
    let output = command.stdin(Stdio::null()).output().map_err(|error| format!("{name}: {error}"))?;
    if output.status.success() {
        return Ok(output);
    }
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    Err(format!("{name} failed: {}", stderr.lines().last().unwrap_or_default()))
}

/// A Python that has `pyigtl`.
///
/// # Errors
/// Why there is none.
pub fn python() -> Result<PathBuf, String> {
    let requirements = scripts().join("requirements.txt");
    environment("python", &["--requirement".as_ref(), requirements.as_os_str()])
}

/// A Python in an environment of its own with these packages of PyPI.
///
/// # Errors
/// Why there is none.
pub fn environment(name: &str, packages: &[impl AsRef<OsStr>]) -> Result<PathBuf, String> {
    let made = folder(name, |folder| {
        run(Command::new("python3").args(["-m", "venv"]).arg(folder))?;
        let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
        run(Command::new(folder.join("bin/python")).args(pip).args(packages)).map(|_| ())
    })?;
    Ok(made.join("bin/python"))
}

/// Scripts for that Python.
pub fn scripts() -> PathBuf {
    root().join("tests/peers")
}

/// Folder with the C++ library's examples as programs.
///
/// # Errors
/// Why there is none.
pub fn examples(names: &[&str]) -> Result<PathBuf, String> {
    let folder = folder("openigtlink", |folder| {
        run(Command::new("apt-get").args(["download", "--quiet"]).args(PACKAGES).current_dir(folder))?;
        for entry in fs::read_dir(folder).map_err(|error| error.to_string())?.flatten() {
            if entry.path().extension().is_some_and(|kind| kind == "deb") {
                run(Command::new("dpkg-deb").arg("--extract").arg(entry.path()).arg(folder))?;
            }
        }
        Ok(())
    })?;
    let _turn = SET_UP.lock();
    names.iter().try_for_each(|name| compiled(&folder, name))?;
    Ok(folder)
}

/// Compiles an example, once.
fn compiled(folder: &Path, name: &str) -> Result<(), String> {
    let program = folder.join(Path::new(name).file_name().unwrap_or_default());
    if program.exists() {
        return Ok(());
    }
    let source = folder.join("usr/share/doc/openigtlink-examples/examples").join(format!("{name}.cxx"));
    // Under another name until it is complete.
    let unfinished = program.with_extension("unfinished");
    let mut compiler = Command::new("g++");
    compiler.args(["-w", "-pthread", "-o"]).arg(&unfinished).arg(source).arg("-I");
    compiler.arg(folder.join("usr/include/openigtlink")).arg(folder.join("usr/lib/libOpenIGTLink.so.1.11"));
    run(compiler.arg(format!("-Wl,-rpath,{}", folder.join("usr/lib").display())))?;
    fs::rename(&unfinished, &program).map_err(|error| format!("{}: {error}", program.display()))
}
