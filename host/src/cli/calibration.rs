//! `guide calibration`: the constants of the rig that the device keeps.

use super::output::Output;
use super::rig_args::PortArgs;
use device::link::Client;
use formats::calibration_file::{self, force_n_per_code, knot_codes, knots_mm};
use protocol::{CalibrationRecord, PotentiometerTable};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Show, save or replace the calibration that the device keeps
#[derive(clap::Args)]
#[command(after_help = "Example:\n  guide calibration --port /dev/ttyACM0 --out unit-7.toml\n  \
                  guide calibration --port /dev/ttyACM0 --store unit-7.toml")]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Write the calibration to this file; with --store the one from before
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Store the calibration of this file on the device, which restarts with it
    #[arg(long, value_name = "FILE")]
    store: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report<'a> {
    schema: &'static str,
    id: &'a str,
    crc: String,
    travel_mm: f64,
    force_range_n: f64,
    force_n_per_code: [[f64; 2]; 2],
    potentiometers: Potentiometers,
    stored: bool,
    written: Option<String>,
}

#[derive(Serialize)]
struct Potentiometers {
    x: Potentiometer,
    y: Potentiometer,
}

#[derive(Serialize)]
struct Potentiometer {
    track_codes: [u16; 2],
    codes: Vec<u16>,
    rising_mm: Vec<f64>,
    falling_mm: Vec<f64>,
}

impl From<PotentiometerTable> for Potentiometer {
    fn from(table: PotentiometerTable) -> Self {
        Self {
            track_codes: table.track_codes,
            codes: knot_codes().to_vec(),
            rising_mm: knots_mm(table.rising_um).to_vec(),
            falling_mm: knots_mm(table.falling_um).to_vec(),
        }
    }
}

impl Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.stored {
            writeln!(f, "stored     the device has restarted with it")?;
        }
        writeln!(f, "id         {} (crc {})", self.id, self.crc)?;
        writeln!(f, "travel     {:.3} mm to either side of the straight needle", self.travel_mm)?;
        let [[xx, xy], [yx, yy]] = self.force_n_per_code.map(|row| row.map(|n| 1e6 * n));
        writeln!(f, "force      range {:.3} N; uN per code of channel 0, 1:", self.force_range_n)?;
        writeln!(f, "           x {xx:+.6} {xy:+.6}   y {yx:+.6} {yy:+.6}")?;
        let Potentiometers { x, y } = &self.potentiometers;
        for (axis, table) in [("x", x), ("y", y)] {
            let [first, last] = table.track_codes;
            writeln!(f, "position   {axis}, mm; valid codes {first} to {last}")?;
            let rows = table.codes.iter().zip(&table.rising_mm).zip(&table.falling_mm);
            for ((code, rising), falling) in rows {
                writeln!(f, "           code {code:>4}  rising {rising:+8.3}  falling {falling:+8.3}")?;
            }
        }
        match &self.written {
            Some(path) => writeln!(f, "written    {path}"),
            None => Ok(()),
        }
    }
}

/// Runs `guide calibration`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let new = args.store.as_deref().map(calibration_file::read).transpose()?;
    let mut client = Client::connect(&args.port.port)?;
    let mut record = client.calibration()?;
    if let Some(path) = &args.out {
        calibration_file::write(path, &record)?;
    }
    let stored = new.is_some();
    if let Some(new) = new {
        record = client.store_calibration(&new)?.calibration()?;
    }
    let written = args.out.as_ref().map(|path| path.display().to_string());
    let report = report(&record, stored, written);
    out.result(&report, &report)
}

fn report(record: &CalibrationRecord, stored: bool, written: Option<String>) -> Report<'_> {
    let [x, y] = record.potentiometers.map(Potentiometer::from);
    Report {
        schema: "guide.calibration/1",
        id: record.id.as_str(),
        crc: format!("{:08x}", record.crc()),
        travel_mm: f64::from(record.travel_um) / 1e3,
        force_range_n: f64::from(record.force_range_mn) / 1e3,
        force_n_per_code: force_n_per_code(record),
        potentiometers: Potentiometers { x, y },
        stored,
        written,
    }
}
