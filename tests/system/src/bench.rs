//! The whole bench: firmware in QEMU, simulated rig, serial port, in a folder of its own.

use crate::cosim::{Cosim, Fault};
use crate::images::{self, Board, Image};
use crate::qemu::{self, HANGS, Line, Qemu};
use crate::terminals::Terminals;
use anyhow::{Result, ensure};
use control::calibration::Calibration;
use control::slots::to_stored;
use emulation::flash_model::{ERASED, PAGES, STORED_BYTES};
use simulation::rig::config::RigConfig;
use std::fs;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant, SystemTime};
use tempfile::TempDir;

/// Simulated session, and its report.
struct Setup {
    board: Board,
    line: Line,
    limit: Duration,
}

impl Setup {
    fn new(limit: Duration) -> Self {
        Self { board: Board::BL475eIot01a, line: Line::Socket, limit }
    }
}

/// A running bench. Dropping it ends everything.
#[derive(Debug)]
pub struct Bench {
    qemu: Option<Qemu>,
    cosim: Option<Cosim>,
    terminals: Option<Terminals>,
    folder: TempDir,
}

impl Bench {
    /// Builds the image if need be and starts it with a rig. Everything is ended when the time limit is over, even if a part hangs.
    ///
    /// # Errors
    /// Where anything of it cannot be had.
    pub fn start(config: RigConfig, seed: u64, speed: f64, limit: Duration) -> Result<Self> {
        // The simulated rig is built as designed, and its calibration is stored: the constants need no acknowledgement.
        let calibrated = to_stored(&Calibration::nominal_record(), 1);
        Self::with_flash(config, seed, speed, limit, &[&calibrated])
    }

    /// The same with the image of another board.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn on(board: Board, config: RigConfig, seed: u64, speed: f64) -> Result<Self> {
        let calibrated = to_stored(&Calibration::nominal_record(), 1);
        let setup = Setup { board, ..Setup::new(HANGS) };
        Self::assemble(setup, config, seed, speed, &[&calibrated], Vec::new())
    }

    /// As [`Self::start`], at a pseudo terminal: for programs that expect a serial port, and for what only a port can do.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn at_terminal(config: RigConfig, seed: u64, speed: f64, limit: Duration) -> Result<Self> {
        let calibrated = to_stored(&Calibration::nominal_record(), 1);
        let setup = Setup { line: Line::Terminal, ..Setup::new(limit) };
        Self::assemble(setup, config, seed, speed, &[&calibrated], Vec::new())
    }

    /// The same with these faults of wiring, mounting and sensors, and no stored calibration: a board fresh from the solder.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn wired(config: RigConfig, seed: u64, speed: f64, faults: Vec<Fault>) -> Result<Self> {
        Self::assemble(Setup::new(HANGS), config, seed, speed, &[], faults)
    }

    /// The same with this content of the flash's pages: what is missing is erased.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn with_flash(
        config: RigConfig,
        seed: u64,
        speed: f64,
        limit: Duration,
        pages: &[&[u8]],
    ) -> Result<Self> {
        Self::assemble(Setup::new(limit), config, seed, speed, pages, Vec::new())
    }

    fn assemble(
        Setup { board, line, limit }: Setup,
        config: RigConfig,
        seed: u64,
        speed: f64,
        pages: &[&[u8]],
        faults: Vec<Fault>,
    ) -> Result<Self> {
        let elf = images::build_for(board, Image::Qemu)?;
        let folder = tempfile::Builder::new().prefix("needle-guide-").tempdir()?;
        lay_out(folder.path(), pages)?;
        // The rig waits for QEMU to open its pipes, but not for long.
        let turn = qemu::turn();
        let cosim = Cosim::start_wired(config, seed, folder.path(), speed, faults)?;
        let qemu = Qemu::start_for(board, line, turn, &elf, folder.path(), limit)?;
        let terminals = if line == Line::Terminal { Some(Terminals::watch()?) } else { None };
        let bench = Self { qemu: Some(qemu), cosim: Some(cosim), terminals, folder };
        bench.await_first_steps(limit)?;
        Ok(bench)
    }

    /// Waits until the firmware's clock runs.
    fn await_first_steps(&self, limit: Duration) -> Result<()> {
        let began = Instant::now();
        while self.rig().steps() < 10 {
            ensure!(self.runs()?, "the firmware ended at once: {:#?}", self.log());
            ensure!(began.elapsed() < limit, "the firmware did not start in {limit:?}: {:#?}", self.log());
            thread::sleep(Duration::from_millis(5));
        }
        Ok(())
    }

    /// The port, as `guide` takes it.
    pub fn port(&self) -> String {
        self.folder.path().join("serial").display().to_string()
    }

    /// Folder for files of this run.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The rig.
    ///
    /// # Panics
    /// After [`Self::stop`].
    pub fn rig(&self) -> &Cosim {
        self.cosim.as_ref().expect("the bench runs")
    }

    /// Whether this computer's pseudo terminals keep up, where the link goes over one.
    pub fn terminals(&self) -> Option<&Terminals> {
        self.terminals.as_ref()
    }

    /// The firmware's log so far.
    pub fn log(&self) -> Vec<String> {
        self.qemu.as_ref().map(Qemu::log).unwrap_or_default()
    }

    /// Whether the firmware runs.
    ///
    /// # Errors
    /// Where the system does not report it.
    pub fn runs(&self) -> Result<bool> {
        self.qemu.as_ref().map_or(Ok(false), |qemu| Ok(qemu.exited()?.is_none()))
    }

    /// Sets another time limit for everything, from now on.
    pub fn limit(&self, limit: Duration) {
        if let Some(qemu) = &self.qemu {
            qemu.limit(limit);
        }
    }

    /// Ends the firmware as a power switch would, at once.
    pub fn pull_the_plug(&mut self) {
        self.qemu = None;
    }

    /// Powers the firmware off and waits for its end.
    ///
    /// # Errors
    /// Where the lockstep failed, or the firmware does not end or ends with another code than 0.
    pub fn stop(mut self) -> Result<Vec<String>> {
        if let Some(cosim) = self.cosim.take() {
            cosim.stop()?;
        }
        match self.qemu.take() {
            Some(qemu) => {
                let (code, log) = qemu.wait(HANGS)?;
                ensure!(code == 0, "the firmware ended with code {code}; its log: {log:#?}");
                Ok(log)
            }
            None => Ok(Vec::new()),
        }
    }
}

/// Puts into a folder what a board has before it is powered on: the content of its flash's pages, those of the calibration first, where what
/// is missing is erased, and a number of its own.
pub(crate) fn lay_out(folder: &Path, pages: &[&[u8]]) -> Result<()> {
    let mut flash = vec![ERASED; PAGES * STORED_BYTES];
    // The pages that count the starts come before.
    for (kept, page) in flash.chunks_exact_mut(STORED_BYTES).skip(control::starts::PAGES).zip(pages) {
        kept.iter_mut().zip(*page).for_each(|(kept, byte)| *kept = *byte);
    }
    fs::write(folder.join("flash.bin"), flash)?;
    fs::write(folder.join("unique-id.bin"), unique_id())?;
    Ok(())
}

/// A number that no other board has: a host must not take a new rig for the one before.
fn unique_id() -> [u8; 12] {
    let unix_time = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let mut bytes = [0; 12];
    let (time, process) = bytes.split_at_mut(8);
    time.copy_from_slice(&(unix_time.as_nanos() as u64).to_le_bytes());
    process.copy_from_slice(&std::process::id().to_le_bytes());
    bytes
}

impl Drop for Bench {
    fn drop(&mut self) {
        // QEMU first: the rig's thread then reaches the end of its pipe.
        self.qemu = None;
        self.cosim = None;
        if thread::panicking()
            && let Some(stall) = self.terminals.as_ref().and_then(Terminals::stall)
        {
            eprintln!("{stall}");
        }
    }
}
