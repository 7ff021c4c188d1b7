//! The peers in Python: an environment of their own from pinned requirements, and their times and results.

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Time and result of a peer.
#[derive(Debug, Deserialize)]
pub struct Peer {
    /// Name.
    pub name: String,
    /// Seconds, where it runs here.
    pub seconds: Option<f64>,
    /// Numbers that are compared with ours.
    #[serde(default)]
    pub result: Vec<f64>,
    /// Why it does not run here.
    pub error: Option<String>,
}

/// Python with the peers' libraries.
pub struct Python {
    program: PathBuf,
    scripts: PathBuf,
    cache: PathBuf,
}

impl Python {
    /// Makes the environment in the cache folder, unless it is there and of the same requirements.
    ///
    /// # Errors
    /// Where Python or the network is missing.
    pub fn new(scripts: &Path, cache: &Path) -> Result<Self> {
        let requirements = fs::read_to_string(scripts.join("requirements.txt"))?;
        let environment = cache.join("python");
        let stamp = environment.join("requirements.txt");
        let program = environment.join("bin").join("python");
        if fs::read_to_string(&stamp).ok().as_ref() != Some(&requirements) {
            println!("Python: installing {}", requirements.split_whitespace().collect::<Vec<_>>().join(", "));
            run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&environment))?;
            run(Command::new(&program)
                .args(["-m", "pip", "install", "--quiet", "-r"])
                .arg(scripts.join("requirements.txt")))?;
            fs::write(&stamp, requirements)?;
        }
        Ok(Self { program, scripts: scripts.to_owned(), cache: cache.to_owned() })
    }

    /// Versions of Python and of what it computes with.
    pub fn version(&self) -> Result<String> {
        let text = "import platform, numpy, scipy; print('Python', platform.python_version() + ', NumPy', numpy.__version__ + ', SciPy', scipy.__version__)";
        Ok(run(Command::new(&self.program).args(["-c", text]))?.trim().to_owned())
    }

    /// Times the peers of a script, on one core as we are.
    pub fn peers(&self, script: &str, given: &impl Serialize) -> Result<Vec<Peer>> {
        let input = self.cache.join(format!("{script}.json"));
        fs::write(&input, serde_json::to_string(given)?)?;
        let mut command = Command::new(&self.program);
        command.arg("-B").arg(self.scripts.join(format!("{script}.py"))).arg(&input);
        for threads in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"] {
            command.env(threads, "1");
        }
        let text = run(&mut command)?;
        // Libraries may print before it.
        let line = text.lines().last().unwrap_or_default();
        serde_json::from_str(line).with_context(|| format!("{script}.py printed {line}"))
    }
}

fn run(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| format!("{command:?}"))?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        bail!("{command:?}: {}", stderr.lines().last().unwrap_or("failed"));
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}
