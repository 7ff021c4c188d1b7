//! Plants drawn at random, and targets that they can reach.

use super::needle::{Needle, Tip, Tissue};
use super::sensor::{Body, Flaws, SimulatedPlant};
use crate::random::normal;
use ::steering::{
    Command, Limits, NeedleStatement, Plant, PlantError, PriorStatement, RigStatement, Statement,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Hidden effect of a plant besides those that all have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// No effect.
    Plain,
    /// The path leaves the needle at an angle.
    CutAngle,
    /// The guides have 0.4 to 0.6 mm of play.
    Backlash,
    /// The frame that carries guide 2 gives.
    Frame,
    /// The needle turns in guide 1.
    Clamp,
    /// The needle is bent by itself.
    Prebend,
    /// The modulus grows with depth.
    Gradient,
    /// The tissue is stiffer in y.
    Anisotropy,
    /// The tissue resists shear between its layers.
    Shear,
    /// The tip's load jumps.
    LoadStep,
    /// The bevel is turned from what is stated.
    Roll,
    /// The tip sensor is tilted.
    SensorTilt,
    /// The tip sensor drifts.
    SensorDrift,
    /// The needle is pressed along its axis.
    AxialLoad,
    /// Modulus outside of the prior's range.
    Stiff,
    /// Strong skin.
    Skin,
}

impl Kind {
    /// All that are hidden by themselves.
    pub const HIDDEN: [Kind; 15] = [
        Self::CutAngle,
        Self::Backlash,
        Self::Frame,
        Self::Clamp,
        Self::Prebend,
        Self::Gradient,
        Self::Anisotropy,
        Self::Shear,
        Self::LoadStep,
        Self::Roll,
        Self::SensorTilt,
        Self::SensorDrift,
        Self::AxialLoad,
        Self::Stiff,
        Self::Skin,
    ];

    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Plain => "none",
            Self::CutAngle => "cut angle",
            Self::Backlash => "backlash",
            Self::Frame => "frame compliance",
            Self::Clamp => "clamp compliance",
            Self::Prebend => "prebend",
            Self::Gradient => "gradient",
            Self::Anisotropy => "anisotropy",
            Self::Shear => "shear layer",
            Self::LoadStep => "load step",
            Self::Roll => "bevel roll",
            Self::SensorTilt => "sensor tilt",
            Self::SensorDrift => "sensor drift",
            Self::AxialLoad => "axial load",
            Self::Stiff => "modulus outside the prior",
            Self::Skin => "strong skin",
        }
    }
}

/// A plant of a kind.
pub fn world(kind: Kind, seed: u64, number: u64) -> SimulatedPlant {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number);
    let prior_kpa = rng.random_range(10.0..=40.0);
    let prior_load_n = rng.random_range(0.15..=0.4);
    let gap_mm = rng.random_range(15.0_f64..=30.0).round();
    let mut tissue = Tissue {
        modulus_pa: 1e3 * prior_kpa * rng.random_range(0.5..=1.5),
        layers: vec![[1e-3 * rng.random_range(15.0..=60.0), rng.random_range(-0.7_f64..=0.7).exp()]],
        gradient_per_m: 0.0,
        skin_n_per_m: rng.random_range(0.0..=800.0),
        yield_n_per_m: f64::INFINITY,
        yield_depth_m: 0.01,
        relaxing: 0.0,
        relaxation_s: 3.0,
        anisotropy: 1.0,
        shear_n: 0.0,
    };
    if rng.random_range(0.0..=1.0) < 0.5 {
        tissue.yield_n_per_m = rng.random_range(40.0..=90.0);
    } else {
        tissue.relaxing = rng.random_range(0.1..=0.4);
        tissue.relaxation_s = rng.random_range(1.0..=10.0);
    }
    let mut sign = |size: f64| if rng.random_range(0.0..=1.0) < 0.5 { size } else { -size };
    let mut flaws = Flaws::default();
    let signs = [sign(1.0), sign(1.0), sign(1.0), sign(1.0), sign(1.0)];
    flaws.play_mm = rng.random_range(0.02..=0.1);
    flaws.guide_offset_mm = [rng.random_range(-0.15..=0.15), rng.random_range(-0.15..=0.15)];
    flaws.lead = rng.random_range(-0.008..=0.008);
    flaws.bad = 0.05;
    flaws.force_offset_n = [rng.random_range(-0.1..=0.1), rng.random_range(-0.1..=0.1)];
    let mean_n = prior_load_n * rng.random_range(0.6..=1.4);
    let memory_mm = rng.random_range(20.0_f64..=50.0);
    let (tip_noise_mm, bevel_deg) = (rng.random_range(0.1..=0.3), rng.random_range(-180.0..=180.0));
    let [stiff, size, angle] = [
        rng.random_range(0.5..=1.0),
        rng.random_range(0.5..=1.0),
        rng.random_range(0.0..=std::f64::consts::TAU),
    ];
    flaws.slope = [0.010 * normal(&mut rng), 0.010 * normal(&mut rng)];
    let (mut parallel, mut perpendicular) = (normal(&mut rng), normal(&mut rng));
    let persistence = (-1.0 / memory_mm).exp();
    let fresh = (1.0 - persistence * persistence).sqrt();
    for _ in 0..=200 {
        flaws.load_n.push([mean_n * (1.0 + 0.15 * parallel), mean_n * 0.1 * perpendicular]);
        parallel = persistence * parallel + fresh * normal(&mut rng);
        perpendicular = persistence * perpendicular + fresh * normal(&mut rng);
    }
    let mut tip = Tip::Load;
    let mut needle = Needle::new(tissue, tip, 1e-3 * gap_mm);
    match kind {
        Kind::Plain => {}
        Kind::CutAngle => tip = Tip::Angle(0.02 + 0.03 * size),
        Kind::Backlash => flaws.play_mm = 0.2 + 0.1 * size,
        Kind::Frame => needle.frame_m_per_n = 0.3e-3 * size,
        Kind::Clamp => needle.clamp_rad_per_n_m = 0.4 * size,
        Kind::Prebend => needle.prebend_per_m = signs[0] * 0.4 * size,
        Kind::Gradient => needle.tissue.gradient_per_m = 10.0 * size,
        Kind::Anisotropy => {
            needle.tissue.anisotropy = if signs[0] > 0.0 { 1.0 + size } else { 1.0 / (1.0 + size) }
        }
        Kind::Shear => needle.tissue.shear_n = 4.0 * size,
        Kind::LoadStep => {
            let stiff_start_mm = (20.0 + 50.0 * stiff) as usize;
            flaws.load_n.iter_mut().skip(stiff_start_mm).for_each(|n| n[0] += signs[0] * 0.4 * size * mean_n);
        }
        Kind::Roll => flaws.roll_rad = signs[0] * 0.5 * size,
        Kind::SensorTilt => flaws.sensor_tilt = [0.003 * size * angle.cos(), 0.003 * size * angle.sin()],
        Kind::SensorDrift => {
            flaws.sensor_drift_mm_s = [0.004 * size * angle.cos(), 0.004 * size * angle.sin()]
        }
        Kind::AxialLoad => needle.axial_n = 2.0 * size,
        Kind::Stiff => {
            let factor = if signs[0] > 0.0 { 1.5 + size } else { 0.5 / (1.0 + size) };
            needle.tissue.modulus_pa = 1e3 * prior_kpa * factor;
        }
        Kind::Skin => needle.tissue.skin_n_per_m = 2000.0 * size,
    }
    needle.tip = tip;
    let stated = Statement {
        plant: ::steering::VERSION.to_owned(),
        needle: NeedleStatement { ei_n_m2: Some(0.0157), outer_diameter_mm: Some(1.27) },
        rig: RigStatement {
            guide1_to_guide2_mm: Some(60.0),
            guide2_to_surface_mm: gap_mm,
            move_while_pushing: false,
            can_rotate: true,
            guide_moves_in_one_step: false,
        },
        limits: Limits {
            guide_travel_mm: 6.0,
            guide_speed_mm_s: 4.0,
            guide_force_n: Some(8.0),
            push_speed_mm_s: 5.0,
            rotation_speed_deg_s: 180.0,
            needle_strain: Some(0.006),
            tissue_compression_mm: None,
        },
        max_depth_mm: 120.0,
        depth_step_mm: 1.0,
        tip_noise_mm,
        tip_delay_s: 0.2,
        tip_rate_hz: 10.0,
        tip_slope_noise_mrad: None,
        force_noise_n: Some(0.02),
        guide_error_mm: 0.3,
        bevel_deg,
        prior: Some(PriorStatement {
            foundation_kpa: Some(prior_kpa),
            foundation_range: Some([0.5, 1.5]),
            tip_load_n: Some(prior_load_n),
            tip_load_range: Some([0.5, 1.5]),
            slope_mrad: Some(10.0),
        }),
    };
    SimulatedPlant::new(stated, needle, flaws, rng)
}

/// A point that the plant's needle reaches with two rotations and without guide moves, mm: the end of a run of its own.
///
/// # Errors
/// None that a simulated plant has.
pub fn target_by_rotations(
    plant: &SimulatedPlant,
    depth_mm: f64,
    seed: u64,
    number: u64,
) -> Result<[f64; 3], PlantError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0070_7247);
    rng.set_stream(number);
    let turn_depths_mm = [rng.random_range(15.0..45.0_f64), rng.random_range(50.0..75.0_f64)].map(f64::round);
    let turns_deg = [rng.random_range(-180.0..180.0), rng.random_range(-180.0..180.0)];
    let mut scout = plant.clone();
    let mut command = Command { bevel_deg: plant.stated.bevel_deg, ..Command::default() };
    for step in 1..=depth_mm.round() as usize {
        command = Command { t_s: command.t_s + 0.25, depth_mm: step as f64, ..command };
        scout.step(&command)?;
        for (turn_mm, turns_deg) in turn_depths_mm.iter().zip(turns_deg) {
            if (command.depth_mm - turn_mm).abs() < 1e-9 {
                command =
                    Command { t_s: command.t_s + 2.0, bevel_deg: command.bevel_deg + turns_deg, ..command };
                scout.step(&command)?;
            }
        }
    }
    let [x, y] = scout.tip_mm();
    Ok([x, y, depth_mm])
}

/// A point that the plant's needle reaches with some guide moves within 0.6 of its limits, mm: the end of a run of its own.
///
/// # Errors
/// None that a simulated plant has.
pub fn reachable_target<N: Body + Clone>(
    plant: &SimulatedPlant<N>,
    depth_mm: f64,
    seed: u64,
    number: u64,
) -> Result<[f64; 3], PlantError> {
    reachable_within(plant, 0.6, depth_mm, seed, number)
}

/// The same within another share of its limits.
///
/// # Errors
/// None that a simulated plant has.
pub fn reachable_within<N: Body + Clone>(
    plant: &SimulatedPlant<N>,
    share_of_limits: f64,
    depth_mm: f64,
    seed: u64,
    number: u64,
) -> Result<[f64; 3], PlantError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x007a_26e7);
    rng.set_stream(number);
    let angle: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let mut sideways_mm =
        f64::min(rng.random_range(1.5..3.5), share_of_limits * plant.stated.limits.guide_travel_mm);
    let start_mm = rng.random_range(8.0..20.0);
    let length_mm = rng.random_range(10.0..30.0);
    let steps = depth_mm.round() as usize;
    loop {
        let mut scout = plant.clone();
        let mut command = Command { bevel_deg: plant.stated.bevel_deg, ..Command::default() };
        for step in 1..=steps {
            let depth = depth_mm * step as f64 / steps as f64;
            command = Command { t_s: command.t_s + 0.25, depth_mm: depth, ..command };
            scout.step(&command)?;
            let fraction = ((depth - start_mm) / length_mm).clamp(0.0, 1.0);
            let target = [sideways_mm * fraction * angle.cos(), sideways_mm * fraction * angle.sin()];
            if (target[0] - command.guide_x_mm).hypot(target[1] - command.guide_y_mm) > 1e-9 {
                command = Command {
                    t_s: command.t_s + 0.5,
                    guide_x_mm: target[0],
                    guide_y_mm: target[1],
                    ..command
                };
                scout.step(&command)?;
            }
        }
        let end = scout.end()?;
        let limits = &plant.stated.limits;
        if within_limit(end.peak_force_n, limits.guide_force_n, share_of_limits)
            && within_limit(end.peak_strain, limits.needle_strain, share_of_limits)
        {
            let [x, y] = scout.tip_mm();
            return Ok([x, y, depth_mm]);
        }
        sideways_mm *= 0.8;
    }
}

fn within_limit(peak: Option<f64>, limit: Option<f64>, share_of_limits: f64) -> bool {
    peak.zip(limit).is_none_or(|(peak, limit)| peak <= share_of_limits * limit)
}
