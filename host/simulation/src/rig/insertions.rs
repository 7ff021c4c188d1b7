//! Insertions by hand into the simulated rig's tissue, the tip followed by a tracker.
//!
//! The forward model, with what a lab finds too: the bevel turned a little differently each time, a tip load with process noise, a guide
//! that holds the needle less well than drawn, an axis of depth that is not quite the needle's, pushes of five millimetres that
//! spring back, and a tracker with noise.

use super::{Noise, RigError, SimulatedRig, Stream};
use formats::session::InsertionRun;
use mechanics::{Cutting, Experiment, Insertion, Model, ModelError, Profile, Rig, TipLaw, predict};

/// Depth of the last push, millimetres.
const LAST_MM: usize = 100;
/// Pushes, millimetres, and readings at each stop.
const PUSH_MM: usize = 5;
const READINGS: usize = 4;
/// Mean tip load and its scatter from insertion to insertion, N; process noise per stop, N.
const LOAD_N: f64 = 0.2;
const LOAD_SD_N: f64 = 0.015;
const PROCESS_NOISE_SD_N: f64 = 0.005;
/// Angles, rad: of the bevel, of the axis of depth in all insertions and in each.
const BEVEL_SD_RAD: f64 = 0.1;
const AXIS_SD_RAD: f64 = 0.01;
const ANGLE_SD_RAD: f64 = 0.003;
/// Spread of the effective gap between guide 2 and tissue about the drawn one, logarithm.
const GAP_LN: f64 = 0.6;
const GAP_SD_LN: f64 = 0.2;
/// Noise of the tracker, m.
pub const TIP_SD_M: f64 = 0.06e-3;

impl SimulatedRig {
    /// Inserts the needle `count` times, each time from the surface.
    ///
    /// # Errors
    /// [`RigError::Model`] where the forward model refuses the rig.
    pub fn insertions(&self, rig: &Rig, seed: u64, count: usize) -> Result<Vec<InsertionRun>, RigError> {
        let mut noise = Noise::new(seed, Stream::Insertions);
        let mut rig = rig.clone();
        rig.entry_m = rig.guide2_m + (rig.entry_m - rig.guide2_m) * (GAP_LN + GAP_SD_LN * noise.draw()).exp();
        let mut model = Model::uniform(rig, self.truth().modulus_pa)?;
        let axis_rad = [AXIS_SD_RAD * noise.draw(), AXIS_SD_RAD * noise.draw()];
        let offset_m = [1e-3 * noise.draw(), 1e-3 * noise.draw()];
        (1..=count)
            .map(|number| {
                let angle_rad = axis_rad.map(|axis_rad| axis_rad + ANGLE_SD_RAD * noise.draw());
                model.tip = tip(&mut noise, angle_rad)?;
                Ok(insert(&model, &mut noise, offset_m, format!("i{number}"))?)
            })
            .collect()
    }
}

/// One insertion's tip load and angle.
fn tip(noise: &mut Noise, entry_angle_rad: [f64; 2]) -> Result<TipLaw, ModelError> {
    let bevel_rad = BEVEL_SD_RAD * noise.draw();
    let mut load_n = LOAD_N + LOAD_SD_N * noise.draw();
    let mut planes = [Vec::new(), Vec::new()];
    for stop in 0..=LAST_MM / PUSH_MM {
        let depth_m = 1e-3 * (stop * PUSH_MM) as f64;
        planes[0].push([depth_m, load_n * bevel_rad.cos()]);
        planes[1].push([depth_m, load_n * bevel_rad.sin()]);
        load_n += PROCESS_NOISE_SD_N * noise.draw();
    }
    let [y, x] = planes;
    Ok(TipLaw {
        cutting: Cutting::Load([Profile::new(y)?, Profile::new(x)?]),
        entry_angle_rad,
        ..TipLaw::default()
    })
}

/// Recorded rows: a row in every push, and rows while the needle rests.
fn insert(
    model: &Model,
    noise: &mut Noise,
    offset_m: [f64; 2],
    id: String,
) -> Result<InsertionRun, ModelError> {
    let mut depths_m: Vec<f64> = Vec::new();
    for stop in 0..=LAST_MM / PUSH_MM {
        let rest_depth_m = 1e-3 * (stop * PUSH_MM) as f64;
        if stop > 0 {
            depths_m.push(rest_depth_m + (0.5e-3 * noise.draw()).abs());
        }
        depths_m.extend((0..READINGS).map(|_| (rest_depth_m + 0.05e-3 * noise.draw()).max(0.0)));
    }
    let insertion =
        Insertion { depth_m: depths_m.clone(), guide2_m: Some(Default::default()), ..Insertion::default() };
    let tip_m = predict(model, &Experiment::Insertion(insertion))?.tip_m;
    Ok(InsertionRun {
        path: format!("{id}.csv").into(),
        id,
        time_s: Some((0..depths_m.len()).map(|row| 0.5 * row as f64).collect()),
        depth_m: depths_m,
        tip_y_m: measured_tip_m(tip_m.y, 0, offset_m, noise),
        tip_x_m: tip_m.x.map(|x| measured_tip_m(x, 1, offset_m, noise)),
        rotation_rad: None,
        guide2_y_m: None,
        guide2_x_m: None,
        base_force_y_n: None,
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
    })
}

fn measured_tip_m(path_m: Vec<f64>, plane: usize, offset_m: [f64; 2], noise: &mut Noise) -> Vec<f64> {
    path_m.iter().map(|u_m| u_m + offset_m[plane] + TIP_SD_M * noise.draw()).collect()
}
