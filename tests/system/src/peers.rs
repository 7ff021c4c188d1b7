//! Other people's OpenIGTLink: `pyigtl` for Python, and the C++ library's examples as Debian packages them; and environments for Python.
//!
//! They are set up in `target/peers` when they are first needed; where they cannot be had, the reason is reported
//! instead. No file is installed in the system.

use crate::images::root;
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

/// Folder of a set-up, once it is complete; `make` makes it, and again where it was made of something else.
fn folder(
    name: &str,
    made_of: &str,
    make: impl FnOnce(&Path) -> Result<(), String>,
) -> Result<PathBuf, String> {
    made_in(&root().join("target/peers").join(name), made_of, make)
}

fn made_in(
    folder: &Path,
    made_of: &str,
    make: impl FnOnce(&Path) -> Result<(), String>,
) -> Result<PathBuf, String> {
    let _turn = SET_UP.lock();
    let complete = folder.join("complete");
    if !fs::read_to_string(&complete).is_ok_and(|before| before == made_of) {
        let cannot = |error: std::io::Error| format!("{}: {error}", folder.display());
        // Remains of an earlier attempt are deleted.
        let _ = fs::remove_dir_all(folder);
        fs::create_dir_all(folder).map_err(cannot)?;
        make(folder)?;
        fs::write(&complete, made_of).map_err(cannot)?;
    }
    Ok(folder.to_owned())
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
    let text =
        fs::read_to_string(&requirements).map_err(|error| format!("{}: {error}", requirements.display()))?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
    environment("python", &lines.collect::<Vec<_>>())
}

/// A Python in an environment of its own with these packages of PyPI, made again where the list has changed.
///
/// # Errors
/// Why there is none.
pub fn environment(name: &str, packages: &[&str]) -> Result<PathBuf, String> {
    let ready = folder(name, &packages.join("\n"), |folder| {
        run(Command::new("python3").args(["-m", "venv"]).arg(folder))?;
        let pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
        run(Command::new(folder.join("bin/python")).args(pip).args(packages)).map(|_| ())
    })?;
    Ok(ready.join("bin/python"))
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
    let folder = folder("openigtlink", &PACKAGES.join("\n"), |folder| {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_up_is_made_once_and_again_where_its_list_has_changed_or_it_was_not_completed() {
        let base = tempfile::tempdir().expect("a folder");
        let environment = base.path().join("environment");
        let set_up = |made_of: &str, succeeds: bool| {
            let mut was_made = false;
            let outcome = made_in(&environment, made_of, |_| {
                was_made = true;
                if succeeds { Ok(()) } else { Err("no network".to_owned()) }
            });
            (was_made, outcome.is_ok())
        };
        assert_eq!(set_up("numpy", true), (true, true));
        assert_eq!(set_up("numpy", true), (false, true));
        assert_eq!(set_up("numpy\npandas", false), (true, false));
        assert_eq!(set_up("numpy\npandas", true), (true, true));
        assert_eq!(set_up("numpy\npandas", true), (false, true));
    }
}
