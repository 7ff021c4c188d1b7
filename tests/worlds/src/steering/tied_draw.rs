//! Tied needles drawn at random: tight limits, a load that wanders, backlash, bad readings.

use super::sensor::{Body, Flaws, SimulatedPlant};
use super::tied::{TiedNeedle, Ties};
use crate::random::normal;
use ::steering::{
    Command, Limits, NeedleStatement, Plant, PlantError, PriorStatement, RigStatement, Statement,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Growth of the load's random walk, share of the load per square root of a millimetre.
const WANDER: f64 = 0.015;

/// Tissue of a tied needle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tissues {
    /// One modulus.
    Plain,
    /// Two layers, skin, and ties that yield or relax.
    Standard,
}

/// A plant with a tied needle.
pub fn tied_world(tissues: Tissues, seed: u64, number: u64) -> SimulatedPlant<TiedNeedle> {
    tied_sibling(tissues, seed, number, 0)
}

/// Plants that state the same and hide something else, one for each `hidden`: where one of them goes, another may not be able to
/// go.
pub fn tied_sibling(tissues: Tissues, seed: u64, number: u64, hidden: u64) -> SimulatedPlant<TiedNeedle> {
    let mut stated_rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0071_6564);
    stated_rng.set_stream(number);
    let prior_kpa = stated_rng.random_range(10.0..=40.0);
    let prior_load_n = stated_rng.random_range(0.15..=0.4);
    let gap_mm = stated_rng.random_range(15.0_f64..=30.0).round();
    let (tip_noise_mm, bevel_deg) =
        (stated_rng.random_range(0.1..=0.3), stated_rng.random_range(-180.0..=180.0));
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x6869_6464 ^ hidden.wrapping_mul(0x9E37_79B9_7F4A_7C15));
    rng.set_stream(number);
    let mut ties = Ties {
        modulus_pa: 1e3 * prior_kpa * rng.random_range(0.5..=1.5),
        layers: Vec::new(),
        skin_n_per_m: 0.0,
        yield_n_per_m: [f64::INFINITY, 0.0],
        relaxing: [0.0, 1.0],
    };
    if tissues == Tissues::Standard {
        ties.layers.push([
            1e-3 * rng.random_range(15.0..=60.0),
            rng.random_range(0.5_f64.ln()..=2.0_f64.ln()).exp(),
        ]);
        ties.skin_n_per_m = rng.random_range(0.0..=600.0);
        if rng.random_range(0.0..=1.0) < 0.5 {
            ties.yield_n_per_m = [rng.random_range(40.0..=90.0), rng.random_range(2e3..=6e3)];
        } else {
            ties.relaxing = [rng.random_range(0.1..=0.4), rng.random_range(1.0..=10.0)];
        }
    }
    let mean_n = prior_load_n * rng.random_range(0.6..=1.4);
    let mut flaws = Flaws {
        play_mm: rng.random_range(0.02..=0.1),
        guide_offset_mm: [rng.random_range(-0.15..=0.15), rng.random_range(-0.15..=0.15)],
        lead: rng.random_range(-0.008..=0.008),
        bad: 0.05,
        force_offset_n: [rng.random_range(-0.1..=0.1), rng.random_range(-0.1..=0.1)],
        ..Flaws::default()
    };
    // A needle's angle beyond 10 mrad would be seen before it is pushed.
    flaws.slope = [0, 1].map(|_| (0.005 * normal(&mut rng)).clamp(-0.01, 0.01));
    let (mut parallel, mut perpendicular) = (1.0, 0.0);
    for _ in 0..=200 {
        flaws.load_n.push([mean_n * parallel, mean_n * perpendicular]);
        parallel += WANDER * normal(&mut rng);
        perpendicular += WANDER * normal(&mut rng);
    }
    let stated = Statement {
        plant: ::steering::VERSION.to_owned(),
        needle: NeedleStatement { ei_n_m2: Some(0.0157), outer_diameter_mm: Some(1.27) },
        rig: RigStatement {
            guide1_to_guide2_mm: Some(60.0),
            guide2_to_surface_mm: gap_mm,
            move_while_pushing: false,
            can_rotate: false,
            guide_moves_in_one_step: false,
        },
        limits: Limits {
            guide_travel_mm: 6.0,
            guide_speed_mm_s: 4.0,
            guide_force_n: Some(12.0),
            push_speed_mm_s: 5.0,
            rotation_speed_deg_s: 180.0,
            needle_strain: Some(0.004),
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
            slope_mrad: Some(5.0),
        }),
    };
    SimulatedPlant::new(stated, TiedNeedle::new(ties, 1e-3 * gap_mm), flaws, rng)
}

/// A point at the edge of what a needle reaches, mm: the end of a run with two guide moves, as large as a share of its limits
/// lets them be.
///
/// # Errors
/// None that a simulated plant has.
pub fn far_target<N: Body + Clone>(
    plant: &SimulatedPlant<N>,
    share_of_limits: f64,
    depth_mm: f64,
    seed: u64,
    number: u64,
) -> Result<[f64; 3], PlantError> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x0066_6172);
    rng.set_stream(number);
    let travel_mm = share_of_limits * plant.stated.limits.guide_travel_mm;
    // Depth, and guide position from there on, as a share of the travel.
    let moves = [[3.0_f64, 20.0], [25.0, 55.0]].map(|[low, high]| {
        (rng.random_range(low..=high).round(), [rng.random_range(-1.0..=1.0), rng.random_range(-1.0..=1.0)])
    });
    let mut size = 1.0;
    loop {
        let mut scout = plant.clone();
        let mut command = Command { bevel_deg: plant.stated.bevel_deg, ..Command::default() };
        for step in 1..=depth_mm.round() as usize {
            command = Command { t_s: command.t_s + 0.25, depth_mm: step as f64, ..command };
            scout.step(&command)?;
            for (from_mm, to) in moves {
                if (command.depth_mm - from_mm).abs() < 1e-9 {
                    let [guide_x_mm, guide_y_mm] = to.map(|share| size * share * travel_mm);
                    command = Command { t_s: command.t_s + 6.0, guide_x_mm, guide_y_mm, ..command };
                    scout.step(&command)?;
                }
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
        size *= 0.9;
    }
}

fn within_limit(peak: Option<f64>, limit: Option<f64>, share_of_limits: f64) -> bool {
    peak.zip(limit).is_none_or(|(peak, limit)| peak <= share_of_limits * limit)
}
