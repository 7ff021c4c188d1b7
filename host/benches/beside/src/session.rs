//! Loading a session's folder: nine lateral runs of 20 s at 1 kHz with five columns, and a sweep each.

use crate::clock::Clock;
use crate::forward::Own;
use anyhow::Result;
use formats::session::Session;
use std::fmt::Write;
use std::fs;
use std::path::Path;

const RUNS: usize = 9;
/// Rows of a run.
pub const ROWS: usize = 20_000;
const POINTS: usize = 200;

/// Writes the session, with so many rows in each run; returns its bytes.
pub fn write(folder: &Path, rows: usize) -> Result<usize> {
    fs::create_dir_all(folder)?;
    let mut session = "[session]\nformat = 1\n\n[needle]\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\nyoungs_modulus_gpa = 200\n\n\
                       [rig]\nguide2_mm = 60\nentry_mm = 70\n"
        .to_owned();
    let mut bytes = 0;
    let mut save = |name: &str, text: &str| {
        bytes += text.len();
        fs::write(folder.join(name), text)
    };
    for run in 0..RUNS {
        write!(
            session,
            "\n[[lateral]]\nid = \"l{run}\"\ndepth_mm = 30\nforce = \"f{run}.csv\"\nshape = \"s{run}.csv\"\n"
        )?;
        let mut force = "time_s,displacement_y_mm,force_y_n,displacement_x_mm,force_x_n\n".to_owned();
        for row in 0..rows {
            let time_s = 1e-3 * row as f64;
            let (sin, cos) = (0.9 * time_s + run as f64).sin_cos();
            let (y_mm, y_n, x_mm, x_n) = (1.2 * sin, 1.5 * sin + 0.01 * cos, 0.3 * cos, 0.4 * cos);
            writeln!(force, "{time_s:.6},{y_mm:.6},{y_n:.6},{x_mm:.6},{x_n:.6}")?;
        }
        save(&format!("f{run}.csv"), &force)?;
        let mut shape = "z_mm,deflection_y_mm,deflection_x_mm\n".to_owned();
        for point in 0..POINTS {
            let z_mm = 70.0 + 0.15 * point as f64;
            writeln!(shape, "{z_mm:.4},{:.6},{:.6}", 1.3 * (0.01 * z_mm).sin(), 0.2 * (0.01 * z_mm).cos())?;
        }
        save(&format!("s{run}.csv"), &shape)?;
    }
    save("session.toml", &session)?;
    Ok(bytes)
}

/// Loads it; the sum of every column over all runs.
pub fn load(clock: &mut Clock, folder: &Path) -> Result<Own> {
    let session = session_in(folder);
    let lateral = &session.lateral;
    let result = vec![
        sum_over_runs(&|run| sum(&lateral[run].force.time_s)),
        sum_over_runs(&|run| sum(&lateral[run].force.displacement_y_m)),
        sum_over_runs(&|run| sum(&lateral[run].force.force_y_n)),
        sum_over_runs(&|run| sum_of_present(&lateral[run].force.displacement_x_m)),
        sum_over_runs(&|run| sum_of_present(&lateral[run].force.force_x_n)),
        sum_over_runs(&|run| sum(&lateral[run].shape.z_m)),
        sum_over_runs(&|run| sum(&lateral[run].shape.y_m)),
        sum_over_runs(&|run| sum_of_present(&lateral[run].shape.x_m)),
    ];
    Ok(Own { result, seconds: clock.seconds("session load", || session_in(folder))? })
}

fn sum_of_present(values: &Option<Vec<f64>>) -> f64 {
    values.iter().flatten().sum::<f64>()
}

fn sum(values: &[f64]) -> f64 {
    values.iter().sum::<f64>()
}

fn sum_over_runs(of: &dyn Fn(usize) -> f64) -> f64 {
    (0..RUNS).map(of).sum::<f64>()
}

fn session_in(folder: &Path) -> Session {
    Session::read(folder).expect("a session")
}
