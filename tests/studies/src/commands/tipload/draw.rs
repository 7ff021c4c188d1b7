//! Sessions of insertions whose truth is known: plain, with the small imperfections that every rig has, and with one guide.

use super::marching::{Held, Needle, NodeLoads, PLAIN, STEP_M, Tip, node_at};
use formats::session::{InsertionRun, Noise, Session};
use mechanics::{Guides, Needle as Drawn, Rig};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{PI, TAU};
use std::path::PathBuf;
use worlds::random::uniform;

const MM: f64 = 1e-3;
/// Noise of a tip reading.
pub const TIP_SD_M: f64 = 0.05 * MM;
/// Noise of a reading of the tip's direction.
const DIRECTION_SD_RAD: f64 = 1e-3;
const GUIDE2_M: f64 = 0.06;
/// Standard deviation of the logarithm of the ratio of stated to true gap.
const STATED_GAP_SD_LN: f64 = 0.3;

/// Kind of the world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Kind {
    /// One guide, with a rear of which nothing is stated and a tip whose direction is measured, instead of two.
    pub one_guide: bool,
    /// Sizes of the imperfections.
    pub imperfections: Imperfections,
    /// Hidden effect that the catalogue has a name for.
    pub hidden: Hidden,
}

/// An effect in a world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Hidden {
    /// None.
    #[default]
    Nothing,
    /// A skin of this stiffness, N/m.
    Skin(f64),
    /// Tissue that is softer down to a depth, m, by a factor.
    Softer(f64, f64),
    /// A tip load that is larger from a depth on, m, by so much, N.
    LoadStep(f64, f64),
}

/// Sizes of the imperfections; all 0 in a plain world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Imperfections {
    /// Tilt of the tracker against the rig, about each axis, rad.
    pub tilt_rad: f64,
    /// Guide 2 off its zero, m.
    pub guide2_m: f64,
    /// Scatter of the modulus between insertions, as a share.
    pub modulus: f64,
    /// Scatter of the tip load between insertions, as a share.
    pub load: f64,
    /// Scatter of the depth at which the tissue begins, m.
    pub entry_m: f64,
    /// Amplitude of a slow drift of the tracker, m.
    pub drift_m: f64,
}

impl Imperfections {
    /// Small: each passes unnoticed.
    pub fn small() -> Self {
        Self {
            tilt_rad: 0.3_f64.to_radians(),
            guide2_m: 0.05 * MM,
            modulus: 0.03,
            load: 0.03,
            entry_m: 0.5 * MM,
            drift_m: 0.05 * MM,
        }
    }

    /// Each of them so many times as large.
    pub fn times(self, factor: f64) -> Self {
        Self {
            tilt_rad: factor * self.tilt_rad,
            guide2_m: factor * self.guide2_m,
            modulus: factor * self.modulus,
            load: factor * self.load,
            entry_m: factor * self.entry_m,
            drift_m: factor * self.drift_m,
        }
    }
}

/// True parameters of one insertion.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// Vertical tip load, N.
    pub load_n: f64,
    /// Foundation modulus, Pa.
    pub modulus_pa: f64,
    /// Gap between guide 2 and the tissue, m.
    pub gap_m: f64,
}

/// A session and what is true of it.
#[derive(Debug, Clone)]
pub struct World {
    /// As recorded.
    pub session: Session,
    /// Per insertion.
    pub truth: Vec<Truth>,
}

/// Random numbers of one session.
struct Random(ChaCha8Rng);

impl Random {
    fn uniform(&mut self, least: f64, most: f64) -> f64 {
        uniform(least, most, &mut self.0)
    }

    /// Standard normal, by Box and Muller.
    fn normal(&mut self) -> f64 {
        let radius = (-2.0 * self.uniform(f64::MIN_POSITIVE, 1.0).ln()).sqrt();
        radius * (TAU * self.uniform(0.0, 1.0)).cos()
    }

    fn whole(&mut self, least: usize, most: usize) -> usize {
        (self.uniform(least as f64, most as f64 + 1.0) as usize).min(most)
    }
}

/// Outer and inner diameter of the needles, mm: 17, 18, 20 and 18 gauge with a stylet.
const NEEDLES_MM: [[f64; 2]; 4] = [[1.47, 1.07], [1.27, 1.0], [0.91, 0.6], [1.27, 0.0]];

/// Session `number` of a seed: each has its own stream. Every third has insertions that are turned half way, every third some in which
/// guide 2 is moved at rest; with one guide, which is moved in all of them, none is turned.
pub fn world(seed: u64, number: usize, kind: Kind) -> World {
    let Kind { one_guide, imperfections, hidden } = kind;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number as u64);
    let random = &mut Random(rng);
    let [outer_mm, inner_mm] = NEEDLES_MM[number % NEEDLES_MM.len()];
    let needle = Drawn {
        youngs_modulus_pa: 200e9,
        outer_diameter_m: MM * outer_mm,
        inner_diameter_m: MM * inner_mm,
        bevel_angle_rad: None,
        length_m: None,
        stiffness_known: true,
    };
    let modulus_pa = random.uniform(6e3, 25e3);
    let load_n = random.uniform(0.05, 0.4);
    let gap_m = on_node(random.uniform(0.01, 0.06));
    let depth_m = on_node(random.uniform(0.1, 0.14));
    let stated_m = gap_m * (STATED_GAP_SD_LN * random.normal()).exp();
    let count = random.whole(6, 12);
    let bending_n_m2 = needle.bending_stiffness_n_m2();
    let rig = if one_guide {
        let guides = Guides::One { rear_rotation_n_m_per_rad: [None; 2] };
        Rig { needle, guide2_m: 0.0, entry_m: stated_m, guides, tolerances: mechanics::Tolerances::default() }
    } else {
        Rig::two_guides(needle, GUIDE2_M, GUIDE2_M + stated_m)
    };
    let roll_rad = 0.1 * random.normal();
    let shared = Shared {
        tilt_rad: [0; 3].map(|_| imperfections.tilt_rad * random.normal()),
        guide2_m: [0; 2].map(|_| imperfections.guide2_m * random.normal()),
        angle_rad: [0; 2].map(|_| 3e-3 * random.normal()),
        roll_rad,
        rear_n_m: if one_guide { Some(rear_n_m(random, bending_n_m2)) } else { None },
        tilt_of_sensor_rad: if one_guide { [0; 2].map(|_| 20e-3 * random.normal()) } else { [0.0; 2] },
    };
    let (mut insertion, mut truth) = (Vec::new(), Vec::new());
    for run in 0..count {
        let entry_off_m = imperfections.entry_m * random.normal();
        let insertion_truth = Truth {
            load_n: load_n * scattered(random, imperfections.load),
            modulus_pa: modulus_pa * scattered(random, imperfections.modulus),
            gap_m: on_node((gap_m + entry_off_m).max(2.0 * STEP_M)),
        };
        // If the tissue begins later, the needle is less deep in it than its stated depth.
        let late_m = insertion_truth.gap_m - gap_m;
        let kind = match (one_guide, run % 2) {
            (true, _) => 2,
            (false, 0) => number % 3,
            _ => 0,
        };
        let lengths_m = [depth_m, late_m, imperfections.drift_m];
        let recorded = record(random, &insertion_truth, &shared, bending_n_m2, lengths_m, kind, hidden);
        insertion.push(InsertionRun {
            id: format!("i{}", run + 1),
            path: format!("i{}.csv", run + 1).into(),
            ..recorded
        });
        truth.push(insertion_truth);
    }
    let session = Session {
        dir: PathBuf::new(),
        name: None,
        rig,
        fixture_mass_kg: None,
        noise: Noise {
            tip_m: Some(TIP_SD_M),
            tip_direction_rad: one_guide.then_some(DIRECTION_SD_RAD),
            ..Noise::default()
        },
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion,
        indentation: Vec::new(),
        steering: Vec::new(),
    };
    World { session, truth }
}

fn scattered(random: &mut Random, share: f64) -> f64 {
    1.0 + share * random.normal()
}

fn on_node(length_m: f64) -> f64 {
    STEP_M * node_at(length_m) as f64
}

/// Common parameters of all insertions of a session besides needle and tissue.
struct Shared {
    tilt_rad: [f64; 3],
    guide2_m: [f64; 2],
    angle_rad: [f64; 2],
    roll_rad: f64,
    /// Rotation stiffness of the rear in one guide, vertical and horizontal.
    rear_n_m: Option<[f64; 2]>,
    /// Tilt of the direction sensor on the needle.
    tilt_of_sensor_rad: [f64; 2],
}

/// Rotation stiffness of a rear, N m/rad: anything from a clamp to a loose grip, in each plane its own.
fn rear_n_m(random: &mut Random, bending_n_m2: f64) -> [f64; 2] {
    [0; 2].map(|_| bending_n_m2 / 0.0157 * (0.3_f64.ln() + random.uniform(0.0, 1.0) * 100.0_f64.ln()).exp())
}

/// One insertion: 0 plain, 1 turned by half a turn at 40 mm, 2 guide 2 moved at rest at 30 and 60 mm.
fn record(
    random: &mut Random,
    own: &Truth,
    shared: &Shared,
    bending_n_m2: f64,
    [depth_m, late_m, drift_m]: [f64; 3],
    kind: usize,
    hidden: Hidden,
) -> InsertionRun {
    let needle = |plane: usize| {
        let mounting = shared.rear_n_m.map_or(Held::TwoGuides(GUIDE2_M), |rear| Held::OneGuide(rear[plane]));
        let plain =
            Needle { bending_n_m2, held: mounting, gap_m: own.gap_m, modulus_pa: own.modulus_pa, ..PLAIN };
        match hidden {
            Hidden::Nothing | Hidden::LoadStep(..) => plain,
            Hidden::Skin(skin_n_per_m) => Needle { skin_n_per_m, ..plain },
            Hidden::Softer(soft_m, times) => Needle { softer: [soft_m, times], ..plain },
        }
    };
    let turn_at = if kind == 1 { node_at(0.04) } else { usize::MAX };
    let steps_m = if kind == 2 {
        let most = if shared.rear_n_m.is_some() { 3.0 } else { 1.0 };
        [(0.03, most * random.uniform(-1.0, 1.0) * MM), (0.06, most * random.uniform(-1.0, 1.0) * MM)]
    } else {
        [(0.0, 0.0); 2]
    };
    // Depths as recorded count from where the tissue should begin.
    let late = (late_m / STEP_M).round() as i64;
    let nodes = (node_at(depth_m) as i64 - late).max(1) as usize;
    // The rear is held at another slope each time.
    let own_sd_rad = if shared.rear_n_m.is_some() { 5e-3 } else { 1e-3 };
    let own_angle_rad = [0; 2].map(|_| own_sd_rad * random.normal());
    let own_tilt_rad = [0; 2].map(|_| 2e-3 * random.normal());
    let plane = |plane: usize| {
        let load_component = if plane == 0 { shared.roll_rad.cos() } else { shared.roll_rad.sin() };
        let acting: Vec<NodeLoads> = (0..=nodes)
            .map(|step| {
                let depth = stated_depth(step, late);
                NodeLoads {
                    load_n: [false, true].map(|leaving| {
                        load_n(leaving, depth, &hidden, own.load_n)
                            * load_component
                            * if is_rotated(depth, leaving, turn_at) { -1.0 } else { 1.0 }
                    }),
                    guide2_m: [false, true].map(|leaving| {
                        shared.guide2_m[plane]
                            + if plane == 0 { commanded_m(depth, leaving, steps_m) } else { 0.0 }
                    }),
                }
            })
            .collect();
        needle(plane).path(&acting)
    };
    let paths = [plane(0), plane(1)];
    let offset_m = [0; 2].map(|_| 0.3 * MM * random.normal());
    let waves = [0; 2].map(|_| [random.uniform(0.1, 0.3), random.uniform(0.0, TAU)]);
    let mut columns: [Vec<f64>; 7] = Default::default();
    for depth in (0..=node_at(depth_m)).step_by(2) {
        let depth_at_m = STEP_M * depth as f64;
        let step = (depth as i64 - late).max(0) as usize;
        // A motion at rest is recorded by a second row at its depth.
        let moved =
            depth == turn_at || (kind == 2 && steps_m.iter().any(|(at_m, _)| node_at(*at_m) == depth));
        for leaving in [false, true].into_iter().take(if moved { 2 } else { 1 }) {
            let real_m: [f64; 2] = [0, 1].map(|plane| {
                paths[plane].get(step).map_or(0.0, |Tip { at_m, .. }| at_m[usize::from(leaving)])
                    + (shared.angle_rad[plane] + own_angle_rad[plane]) * depth_at_m
            });
            // The tracker's frame is tilted about all three axes.
            let [about_x, about_y, about_z] = shared.tilt_rad;
            let tracked_m = [
                real_m[0] + about_x * depth_at_m - about_z * real_m[1],
                real_m[1] + about_y * depth_at_m + about_z * real_m[0],
            ];
            columns[0].push(depth_at_m);
            for plane in 0..2 {
                let [length_m, phase] = waves[plane];
                let drift_m = drift_m * (TAU * depth_at_m / length_m + phase).sin();
                columns[1 + plane]
                    .push(tracked_m[plane] + offset_m[plane] + drift_m + TIP_SD_M * random.normal());
            }
            for plane in 0..2 {
                let slope_rad = paths[plane]
                    .get(step)
                    .map_or(0.0, |Tip { slope_rad, .. }| slope_rad[usize::from(leaving)]);
                let straight_rad = shared.angle_rad[plane] + own_angle_rad[plane] + shared.tilt_rad[plane];
                let tilt_rad = shared.tilt_of_sensor_rad[plane] + own_tilt_rad[plane];
                let read_rad = slope_rad + straight_rad + tilt_rad + DIRECTION_SD_RAD * random.normal();
                columns[5 + plane].push(read_rad);
            }
            columns[3].push(if is_rotated(depth, leaving, turn_at) { PI } else { 0.0 });
            columns[4].push(commanded_m(depth, leaving, steps_m));
        }
    }
    let [depth_m, tip_y_m, tip_x_m, rotation_rad, guide2_y_m, direction_y_rad, direction_x_rad] = columns;
    let is_directed = shared.rear_n_m.is_some();
    InsertionRun {
        tip_direction_y_rad: is_directed.then_some(direction_y_rad),
        tip_direction_x_rad: is_directed.then_some(direction_x_rad),
        id: String::new(),
        path: PathBuf::new(),
        depth_m,
        tip_y_m,
        tip_x_m: Some(tip_x_m),
        time_s: None,
        rotation_rad: (kind == 1).then_some(rotation_rad),
        guide2_y_m: (kind == 2).then_some(guide2_y_m),
        guide2_x_m: None,
        base_force_y_n: None,
    }
}

fn load_n(leaving: bool, depth: usize, hidden: &Hidden, load_n: f64) -> f64 {
    match hidden {
        Hidden::LoadStep(at_m, more_n) if depth > node_at(*at_m) || leaving && depth == node_at(*at_m) => {
            load_n + more_n
        }
        _ => load_n,
    }
}

fn stated_depth(step: usize, late: i64) -> usize {
    (step as i64 + late).max(0) as usize
}

fn is_rotated(depth: usize, leaving: bool, turn_at: usize) -> bool {
    depth > turn_at || (leaving && depth == turn_at)
}

fn commanded_m(depth: usize, leaving: bool, steps_m: [(f64, f64); 2]) -> f64 {
    steps_m
        .into_iter()
        .map(|(at_m, by_m)| {
            let node = node_at(at_m);
            if depth > node || (leaving && depth == node) { by_m } else { 0.0 }
        })
        .sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_follows_from_its_seed_and_number() {
        let kind = Kind { imperfections: Imperfections::small(), ..Kind::default() };
        let [a, b, other_world] = [(1, 4), (1, 4), (1, 5)].map(|(seed, number)| world(seed, number, kind));
        assert!(a.session == b.session && a.truth == b.truth && a.session != other_world.session);
    }

    /// Half of the insertions are turned, or guide 2 is moved: each motion at rest has a second row at its depth.
    #[test]
    fn motions_at_rest_are_recorded() {
        for (number, rows) in [(0, 0), (1, 1), (2, 2)] {
            let session = world(3, number, Kind::default()).session;
            assert_eq!([rests(&session.insertion[0]), rests(&session.insertion[1])], [rows, 0]);
        }
    }

    fn rests(run: &InsertionRun) -> usize {
        run.depth_m.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }
}
