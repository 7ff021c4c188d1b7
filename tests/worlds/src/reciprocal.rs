//! Paths of insertions by influence lines: every depth is solved by the exact beam, and the cut path is integrated against its
//! influence line in steps of a quarter of a millimetre. The beam is that of the forward model, its insertions are not.

use formats::session::{InsertionRun, Noise, Session};
use mechanics::{Beam, Foundation, ModelError, Rig};
use std::path::PathBuf;

/// Distance between depths.
pub const STEP_M: f64 = 0.25e-3;
/// Depths a millimetre.
pub const STEPS_PER_MM: usize = 4;

/// Tip at every millimetre under a load given at every step.
///
/// # Errors
/// Where the beam cannot be solved.
pub fn truth(
    rig: &Rig,
    modulus_pa: f64,
    last_mm: usize,
    load_n: impl Fn(usize) -> f64,
) -> Result<Vec<f64>, ModelError> {
    let lines = influence(rig, modulus_pa, last_mm)?;
    let load_n: Vec<f64> = (0..lines.len()).map(load_n).collect();
    Ok(cut(&lines, modulus_pa, &load_n).into_iter().step_by(STEPS_PER_MM).collect())
}

/// Record of one insertion at every millimetre: vertical and horizontal tip, rotation.
pub type Recorded = (Vec<f64>, Option<Vec<f64>>, Option<Vec<f64>>);

/// A session of insertions recorded at every millimetre.
pub fn insertion_session(rig: Rig, tip_sd_m: Option<f64>, recorded: Vec<Recorded>) -> Session {
    Session {
        dir: PathBuf::new(),
        name: None,
        rig,
        fixture_mass_kg: None,
        noise: Noise { tip_m: tip_sd_m, ..Noise::default() },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: recorded
            .into_iter()
            .enumerate()
            .map(|(number, (tip_y_m, tip_x_m, rotation_rad))| InsertionRun {
                id: format!("i{}", number + 1),
                path: PathBuf::from(format!("i{}.csv", number + 1)),
                depth_m: (0..tip_y_m.len()).map(|mm| 1e-3 * mm as f64).collect(),
                tip_y_m,
                tip_x_m,
                time_s: None,
                rotation_rad,
                guide2_y_m: None,
                guide2_x_m: None,
                base_force_y_n: None,
                tip_direction_y_rad: None,
                tip_direction_x_rad: None,
            })
            .collect(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}

/// At every step: shape of the needle inside the tissue, from the surface to the tip, under 1 N at the tip with guide 2 at zero.
/// By reciprocity this is also the tip's answer to a force anywhere along the needle.
///
/// # Errors
/// Where the beam cannot be solved.
pub fn influence(rig: &Rig, modulus_pa: f64, last_mm: usize) -> Result<Vec<Vec<f64>>, ModelError> {
    let foundation = Foundation::uniform(modulus_pa)?;
    let mut lines = Vec::new();
    for step in 0..=last_mm * STEPS_PER_MM {
        let beam = Beam::solve(rig, &foundation, STEP_M * step as f64)?;
        let (tip, guide) = (beam.tip_force(), beam.guide2_force());
        let guide_ratio = tip.deflection_m(rig.guide2_m) / guide.deflection_m(rig.guide2_m);
        let line = (0..=step).map(|i| {
            let z_m = rig.entry_m + STEP_M * i as f64;
            tip.deflection_m(z_m) - guide_ratio * guide.deflection_m(z_m)
        });
        lines.push(line.collect());
    }
    Ok(lines)
}

/// The path that a load cuts, by the trapezoidal rule with its newest end implicit.
pub fn cut(lines: &[Vec<f64>], modulus_pa: f64, load_n: &[f64]) -> Vec<f64> {
    let mut path_m: Vec<f64> = Vec::with_capacity(lines.len());
    for (line, load_n) in lines.iter().zip(load_n) {
        let compliance = line.last().copied().unwrap_or_default();
        let inner: f64 = line.iter().zip(&path_m).map(|(influence, u_m)| influence * u_m).sum();
        let first = line[0] * path_m.first().copied().unwrap_or_default();
        let springs = modulus_pa * STEP_M * (inner - 0.5 * first);
        let newest = if path_m.is_empty() { 0.0 } else { 0.5 * modulus_pa * STEP_M * compliance };
        path_m.push((load_n * compliance + springs) / (1.0 - newest));
    }
    path_m
}
