//! `guide calibrate`: constants of the rig from known loads or a gauge.

use super::output::Output;
use anyhow::anyhow;
use device::calibrate::{
    CalibrateError, ForceFit, ForceReading, GaugeReading, PositionFit, fit_force, fit_position,
};
use formats::calibration_file;
use formats::calibration_readings::{read_gauge, read_loads};
use serde::Serialize;
use std::fmt::{self, Display};
use std::path::PathBuf;

/// Compute a calibration from known loads or from a gauge
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide calibrate force weights.csv --from before.toml --out unit-7.toml\n  \
                  guide calibrate position gauge.csv --axis y --from unit-7.toml --out unit-7.toml"
)]
pub struct Args {
    /// Kind of measurement
    #[arg(value_enum)]
    kind: Kind,
    /// Readings: a CSV file with the columns load_x_n, load_y_n, force_x_n, force_y_n (force), or gauge_mm, position_mm in the order of
    /// the motion (position)
    #[arg(value_name = "CSV")]
    readings: PathBuf,
    /// Calibration of the device while the readings were taken (`guide calibration --out`)
    #[arg(long, value_name = "FILE")]
    from: PathBuf,
    /// Write the new calibration to this file
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Axis along which the gauge measured
    #[arg(long, value_enum, required_if_eq("kind", "position"))]
    axis: Option<Axis>,
}

#[derive(Debug, Clone, Copy, PartialEq, clap::ValueEnum)]
enum Kind {
    /// Known loads on the force sensor, in two directions
    Force,
    /// A gauge against guide 2, upwards and back
    Position,
}

#[derive(Debug, Clone, Copy, clap::ValueEnum, Serialize)]
#[serde(rename_all = "lowercase")]
enum Axis {
    X,
    Y,
}

/// The document.
#[derive(Serialize)]
struct Document<'a> {
    schema: &'static str,
    readings: usize,
    #[serde(flatten)]
    found: Found,
    id: &'a str,
    written: String,
}

#[derive(Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum Found {
    Force(Force),
    Position(Position),
}

#[derive(Serialize)]
struct Force {
    /// Reported over true force; rows: reported x, y; columns: load along x, y.
    response: [[f64; 2]; 2],
    response_ci95: [[Option<[f64; 2]>; 2]; 2],
    offset_n: [f64; 2],
    offset_ci95_n: [Option<[f64; 2]>; 2],
    turned_deg: f64,
    residual_sd_n: Option<f64>,
    worst_reading: usize,
    worst_residual_n: f64,
}

impl From<&ForceFit> for Force {
    fn from(fit: &ForceFit) -> Self {
        Self {
            response: fit.response.map(|row| row.map(|entry| entry.value)),
            response_ci95: fit.response.map(|row| row.map(|entry| entry.ci95)),
            offset_n: fit.offset_n.map(|offset| offset.value),
            offset_ci95_n: fit.offset_n.map(|offset| offset.ci95),
            turned_deg: fit.turned_deg,
            residual_sd_n: fit.residual_sd_n,
            worst_reading: fit.worst.index + 1,
            worst_residual_n: fit.worst.residual,
        }
    }
}

impl Display for Force {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for ((axis, row), ci95) in ["x", "y"].into_iter().zip(self.response).zip(self.response_ci95) {
            let entries = row.into_iter().zip(ci95).zip(["x", "y"]);
            let entries: Vec<String> = entries
                .map(|((value, ci95), load)| format!("{} N per N along {load}", interval(value, ci95, 4)))
                .collect();
            writeln!(f, "reported {axis} {}", entries.join(", "))?;
        }
        for ((axis, offset_n), ci95_n) in ["x", "y"].into_iter().zip(self.offset_n).zip(self.offset_ci95_n) {
            writeln!(f, "unloaded {axis} {} N", interval(offset_n, ci95_n, 4))?;
        }
        writeln!(f, "turned     {:+.2} degrees from x towards y", self.turned_deg)?;
        if let Some(sd_n) = self.residual_sd_n {
            writeln!(
                f,
                "residuals  sd {sd_n:.4} N; the largest {:.4} N at reading {}",
                self.worst_residual_n, self.worst_reading
            )?;
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct Position {
    axis: Axis,
    largest_error_mm: f64,
    scale: f64,
    play_mm: Option<f64>,
    play_ci95_mm: Option<[f64; 2]>,
    residual_sd_mm: f64,
    worst_reading: usize,
    worst_residual_mm: f64,
    covered_mm: [f64; 2],
}

/// Metres to millimetres.
const MM: f64 = 1e3;

impl Position {
    fn new(axis: Axis, fit: &PositionFit) -> Self {
        Self {
            axis,
            largest_error_mm: MM * fit.largest_error_m,
            scale: fit.scale,
            play_mm: fit.play_m.map(|play| MM * play.value),
            play_ci95_mm: fit.play_m.and_then(|play| play.ci95).map(|ci95| ci95.map(|m| MM * m)),
            residual_sd_mm: MM * fit.residual_sd_m,
            worst_reading: fit.worst.index + 1,
            worst_residual_mm: MM * fit.worst.residual,
            covered_mm: fit.covered_m.map(|m| MM * m),
        }
    }
}

impl Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "before     error {:.3} mm at most; the gauge moved {:.4} mm per reported mm",
            self.largest_error_mm, self.scale
        )?;
        match self.play_mm {
            Some(play_mm) => writeln!(f, "play       {} mm", interval(play_mm, self.play_ci95_mm, 3))?,
            None => writeln!(f, "play       as before: fewer than three readings on the way back")?,
        }
        writeln!(
            f,
            "residuals  sd {:.4} mm; the largest {:+.4} mm at reading {}",
            self.residual_sd_mm, self.worst_residual_mm, self.worst_reading
        )?;
        let [lowest_mm, highest_mm] = self.covered_mm;
        writeln!(f, "covered    {lowest_mm:+.3} to {highest_mm:+.3} mm; linear beyond")
    }
}

/// A value with its interval, where there is one.
fn interval(value: f64, ci95: Option<[f64; 2]>, digits: usize) -> String {
    match ci95 {
        Some([low, high]) => format!("{value:+.digits$} ({low:+.digits$} to {high:+.digits$})"),
        None => format!("{value:+.digits$}"),
    }
}

impl Display for Document<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.found {
            Found::Force(force) => write!(f, "{force}")?,
            Found::Position(position) => write!(f, "{position}")?,
        }
        writeln!(f, "written    {} (id {}), from {} readings", self.written, self.id, self.readings)
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let previous_record = calibration_file::read(&args.from)?;
    let of_readings = |error: CalibrateError| anyhow!("{}: {error}", args.readings.display());
    let (readings, fit_json, record) = match (args.kind, args.axis) {
        (Kind::Force, Some(_)) => {
            return Err(anyhow!("--axis: expected with position only; loads have a column for each axis"));
        }
        (Kind::Force, None) => {
            let readings: Vec<ForceReading> = read_loads(&args.readings)?
                .into_iter()
                .map(|[load_n, reported_n]| ForceReading { load_n, reported_n })
                .collect();
            let fit = fit_force(&readings, &previous_record).map_err(of_readings)?;
            (readings.len(), Found::Force(Force::from(&fit)), fit.record)
        }
        (Kind::Position, axis) => {
            let axis = axis.ok_or_else(|| anyhow!("--axis: expected x or y with position"))?;
            let readings: Vec<GaugeReading> = read_gauge(&args.readings)?
                .into_iter()
                .map(|[gauge_m, reported_m]| GaugeReading { gauge_m, reported_m })
                .collect();
            let fit = fit_position(&readings, axis as usize, &previous_record).map_err(of_readings)?;
            (readings.len(), Found::Position(Position::new(axis, &fit)), fit.record)
        }
    };
    calibration_file::write(&args.out, &record)?;
    let document = Document {
        schema: "guide.calibrate/1",
        readings,
        found: fit_json,
        id: record.id.as_str(),
        written: args.out.display().to_string(),
    };
    out.result(&document, &document)
}
