//! The generator against known values, and what every effect and every seed does.

use super::chain::node_at;
use super::effects::ids;
use super::insertion::tip_path;
use super::lateral::march;
use super::*;
use std::time::Instant;

fn truth(effects: Vec<(&'static str, Vec<f64>)>) -> Truth {
    Truth { k_kpa: 16.0, tip_load_n: 0.2, effects, foreign: None }
}

fn world(truth: &Truth) -> World {
    World::new(truth, &Rig::two_guides(Needle::gauge_18(), 0.06, 0.07))
}

fn quiet(design: Design) -> Design {
    Design { noise: design.noise.none(), ..design }
}

/// A run in each plane and two insertions, without noise.
fn small() -> Design {
    let (mut design, insertions) = (Design::four_runs(), Design::insertions());
    design.lateral = [2, 3].map(|i| design.lateral[i].clone()).to_vec();
    design.insertion = [1, 2].map(|i| insertions.insertion[i].clone()).to_vec();
    quiet(design)
}

/// Effects that no insertion shows in which guide 2 rests, beside those of the sensors; anisotropy shows where the bevel is rolled.
const LATERAL_ONLY: [&str; 6] = [
    "tissue.stiffening",
    "tissue.relaxation",
    "tissue.anisotropy",
    "rig.backlash",
    "rig.play",
    "rig.friction",
];

/// Every number of a session, channel by channel.
fn channels(session: &Session) -> [Vec<f64>; 4] {
    let mut channels: [Vec<f64>; 4] = Default::default();
    for run in &session.lateral {
        channels[0].extend(run.force.force_y_n.iter().chain(run.force.force_x_n.iter().flatten()));
        let displacements =
            run.force.displacement_y_m.iter().chain(run.force.displacement_x_m.iter().flatten());
        channels[1].extend(displacements);
        channels[2].extend(run.shape.y_m.iter().chain(run.shape.x_m.iter().flatten()));
    }
    for run in &session.insertion {
        channels[3].extend(run.tip_y_m.iter().chain(run.tip_x_m.iter().flatten()));
    }
    channels
}

/// Largest change of force, displacement, shape and tip.
fn changes(a: &Session, b: &Session) -> [f64; 4] {
    let (a, b) = (channels(a), channels(b));
    std::array::from_fn(|i| {
        assert_eq!(a[i].len(), b[i].len());
        a[i].iter().zip(&b[i]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    })
}

#[test]
fn the_chain_meets_the_exact_beam() {
    // Exact piecewise solution: K = 16 kPa, 30 mm, 1.2 mm.
    let motion = march(&world(&truth(vec![])), 0, 0.03, &[1.2e-3], 0.05, &[0]);
    let error = motion.force_n[0] / 1.309563697895257 - 1.0;
    assert!(error.abs() < 5e-4, "{error:e}");
    // Two other depths with compliance 1 / (N/m) of the exact one, and the deflection of the tip under 1 N.
    for (depth_m, guide2_m, tip_m) in [
        (0.02, 0.001203090475020565, 0.0016671029256442277),
        (0.04, 0.0008093162262611191, 0.0006087037834378356),
    ] {
        let motion = march(&world(&truth(vec![])), 0, depth_m, &[guide2_m], 0.05, &[0]);
        let shape_error = motion.shape_m[0].last().expect("a tip") / tip_m - 1.0;
        assert!((motion.force_n[0] - 1.0).abs() < 5e-4, "{}", motion.force_n[0]);
        assert!(shape_error.abs() < 1e-3, "{shape_error:e}");
    }
}

#[test]
fn layers_clamp_and_axial_load_meet_exact_beams() {
    // Exact piecewise solutions with 1 N at guide 2.
    let layered = Truth { k_kpa: 8.0, ..truth(vec![("tissue.layers", vec![2.5, 15.0])]) };
    let motion = march(&world(&layered), 0, 0.04, &[0.0008436775134765891], 0.05, &[0]);
    assert_close("layers", motion.force_n[0], 1.0);
    assert_close("layers", motion.shape_m[0][node_at(0.11)], 0.0005813383385502344);
    let loose = world(&truth(vec![("rig.clamp_compliance", vec![0.35])]));
    let motion = march(&loose, 0, 0.03, &[0.0010152508803166775], 0.05, &[0]);
    assert_close("clamp", motion.force_n[0], 1.0);
    assert_close("clamp", motion.shape_m[0][node_at(0.1)], 0.0010759285585691131);
    // A beam-column in air, pushed at its end.
    let mut column = world(&Truth { k_kpa: 0.0, ..truth(vec![("needle.axial_load", vec![1.5])]) });
    column.guide2_m = Some(0.1);
    let wave = (1.5 / column.bending_n_m2).sqrt() * 0.1;
    let motion = march(&column, 0, 0.03, &[1e-3], 0.05, &[]);
    assert_close("column", motion.force_n[0], 1e-3 * 1.5 / 0.1 / (wave.tan() / wave - 1.0));
}

fn assert_close(name: &str, found: f64, exact: f64) {
    assert!((found / exact - 1.0).abs() < 1e-3, "{name}: {found} {exact}");
}

#[test]
fn the_tip_meets_the_exact_path() {
    let needle = Needle::gauge_18();
    let two_guides = path_in(10.36, 0.07, Some(0.06), 1.0, &needle);
    for (depth_m, exact_m) in
        [(0.01, 0.00010956798017770746), (0.05, 0.0012967586780219227), (0.14, 0.007638295678198378)]
    {
        assert_on_path(two_guides[node_at(depth_m)], exact_m);
    }
    assert_on_path(path_in(12.61, 0.09, Some(0.06), 1.0, &needle)[node_at(0.1)], 0.005697196567407374);
    assert_on_path(path_in(16.0, 0.07, None, 1.0, &needle)[node_at(0.1)], 0.008851159079261442);
    let rotated = path_in(10.36, 0.042, None, 0.07, &needle);
    for (depth_m, exact_m) in [(0.07, 0.003568821172216439), (0.08, 0.002073532932077765)] {
        assert_on_path(rotated[node_at(depth_m)], exact_m);
    }
    let [_, leaving_m] = rotated[node_at(0.07)];
    assert_on_path([leaving_m, 0.0], 0.002038004820363318);
}

fn assert_on_path([arriving_m, _]: [f64; 2], exact_m: f64) {
    let error = arriving_m / exact_m - 1.0;
    assert!(error.abs() < 2e-3, "{arriving_m} {exact_m} {error:e}");
}

fn path_in(k_kpa: f64, entry_m: f64, guide2_m: Option<f64>, turn_m: f64, needle: &Needle) -> Vec<[f64; 2]> {
    let truth = Truth { k_kpa, ..truth(vec![]) };
    let mut world = World::new(&truth, &Rig::two_guides(needle.clone(), 0.06, entry_m));
    world.guide2_m = guide2_m;
    let plan = InsertionPlan {
        id: String::new(),
        depth_mm: 140.0,
        speed_mm_per_s: 0.0,
        turn_at_mm: Some(1e3 * turn_m),
        guide2_steps: Vec::new(),
    };
    tip_path(&world, 0, 0.14, |step| insertion::acting(&world, &plan, step)[0])
}

#[test]
fn every_effect_does_something_and_nothing_when_neutral() {
    let plain = session(&truth(vec![]), &small(), 1);
    for id in ids() {
        let [_, _, strong] = strengths(id).expect("strengths");
        let changed = changes(&plain, &session(&truth(vec![(id, strong.clone())]), &small(), 1));
        let [force_n, displacement_m, shape_m, tip_m] = changed;
        assert_eq!(displacement_m, 0.0, "{id}");
        assert!(force_n > 0.02 || shape_m > 2e-5 || tip_m > 1e-4, "{id} {changed:?}");
        let acts_on_tip = !id.starts_with("sensor.") && !LATERAL_ONLY.contains(&id);
        assert_eq!(tip_m > 1e-9, acts_on_tip, "{id} {changed:?}");
        let neutral = if ["tissue.layers", "tissue.anisotropy"].contains(&id) { 1.0 } else { 0.0 };
        let mut values = strong;
        let two_neutral = !["tissue.layers", "tissue.relaxation", "tip.load_step"].contains(&id);
        values.iter_mut().take(if two_neutral { 2 } else { 1 }).for_each(|value| *value = neutral);
        let changed = changes(&plain, &session(&truth(vec![(id, values)]), &small(), 1));
        assert!(changed.iter().all(|change| *change < 1e-9), "{id} {changed:?}");
    }
}

/// Only where a session states how its shape was imaged, and along the beam only, or along the way of the probe.
#[test]
fn images_are_wrong_along_their_beam() {
    for id in imaging_ids() {
        let [_, _, strong] = strengths(id).expect("strengths");
        // Guide 2 moves along y in the first run.
        let ([above_y, above_x], [aside_y, aside_x]) =
            (shape_m(-90.0, &strong, id), shape_m(0.0, &strong, id));
        assert!(above_y > 1e-5 && above_x < 1e-12, "{id} {above_y} {above_x}");
        match id {
            "imaging.lag" => assert!((aside_y - above_y).abs() < 1e-12),
            "imaging.echo_offset" => assert!(aside_y < 1e-12 && (aside_x - above_y).abs() < 1e-12),
            _ => assert!(aside_y < 1e-12 && aside_x < 1e-12, "{aside_y} {aside_x}"),
        }
        let unstated = session(&truth(vec![(id, strong)]), &small(), 1);
        let plain = session(&truth(vec![]), &small(), 1);
        assert_eq!(unstated.lateral[0].shape.y_m, plain.lateral[0].shape.y_m, "{id}");
    }
}

fn shape_m(beam_deg: f64, strong: &[f64], id: &'static str) -> [f64; 2] {
    let (plain, wrong) = (
        noiseless_with(&imaged_at(beam_deg), vec![0.0], id),
        noiseless_with(&imaged_at(beam_deg), strong.to_vec(), id),
    );
    let most_m = |of: fn(&formats::session::ShapeSeries) -> Vec<f64>| {
        let pairs = of(&plain.lateral[0].shape).into_iter().zip(of(&wrong.lateral[0].shape));
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    };
    [most_m(|shape| shape.y_m.clone()), most_m(|shape| shape.x_m.clone().expect("two planes"))]
}

fn noiseless_with(design: &Design, values: Vec<f64>, id: &'static str) -> Session {
    session(&truth(vec![(id, values)]), design, 1)
}

fn imaged_at(beam_deg: f64) -> Design {
    Design { images: Some(ImagePlan { beam_deg, ..ImagePlan::default() }), ..quiet(small()) }
}

#[test]
fn foreign_effects_are_far_beyond_noise() {
    let plain = session(&truth(vec![]), &small(), 1);
    for foreign in Foreign::ALL.into_iter().chain([Foreign::HeldTip, Foreign::Sleeve]) {
        let foreign_truth = Truth { foreign: Some(foreign), ..truth(vec![]) };
        let [force_n, displacement_m, shape_m, _] = changes(&plain, &session(&foreign_truth, &small(), 1));
        assert_eq!(displacement_m, 0.0);
        assert!(force_n > 0.08 || shape_m > 0.15e-3, "{} {force_n} {shape_m}", foreign.name());
    }
}

#[test]
fn histories_are_as_described() {
    let (time_s, plain_n) = force_n(vec![]);
    // Friction keeps the sign of the last motion: none, up in the hold of 0.4, down in that of 0.8 after 1.2.
    let (_, rubbed_n) = force_n(vec![("rig.friction", vec![0.1])]);
    let signs = [2.0, 5.0, 15.0].map(|now_s| {
        ((rubbed_n[sample_at(now_s, &time_s)] - plain_n[sample_at(now_s, &time_s)]) * 10.0).round()
    });
    assert_eq!(signs, [0.0, 1.0, -1.0]);
    // Guide 2 follows its play: behind by it on the way out, ahead by it on the way back.
    let (_, played_n) = force_n(vec![("rig.play", vec![0.1])]);
    assert!(
        (behind_mm(12.0, &played_n, &plain_n, &time_s) + 0.1).abs() < 1e-6
            && (behind_mm(15.0, &played_n, &plain_n, &time_s) - 0.1).abs() < 1e-6
    );
    // A delay shows in ramps only.
    let (_, late_n) = force_n(vec![("sensor.delay", vec![0.12])]);
    assert!((late_n[sample_at(5.0, &time_s)] - plain_n[sample_at(5.0, &time_s)]).abs() < 1e-9);
    let slope_n_per_s = plain_n[sample_at(3.3, &time_s)] - plain_n[sample_at(3.25, &time_s)];
    assert!(
        (late_n[sample_at(3.3, &time_s)] - (plain_n[sample_at(3.3, &time_s)] - slope_n_per_s * 0.12 / 0.05))
            .abs()
            < 1e-9
    );
    // Relaxed tissue of modulus K is, long after, tissue of (1 - f) K.
    let relaxing = truth(vec![("tissue.relaxation", vec![0.3, 0.5])]);
    let motion = march(&world(&relaxing), 0, 0.03, &[1.2e-3; 400], 0.05, &[]);
    let soft = Truth { k_kpa: 0.7 * 16.0, ..truth(vec![]) };
    let end_n = march(&world(&soft), 0, 0.03, &[1.2e-3], 0.05, &[]).force_n[0];
    assert!((motion.force_n[399] / end_n - 1.0).abs() < 1e-6, "{} {end_n}", motion.force_n[399]);
    // A frame gives way by its compliance, a bent needle rests with a known force.
    let (_, framed_n) = force_n(vec![("rig.frame_compliance", vec![0.1])]);
    let stiffness_n_per_mm = plain_n[sample_at(12.0, &time_s)] / 1.2;
    let expected_n = 1.2 * stiffness_n_per_mm / (1.0 + 0.1 * stiffness_n_per_mm);
    assert!((framed_n[sample_at(12.0, &time_s)] - expected_n).abs() < 1e-6);
    // A bent needle rests with a known force, straight at guide 2, at a slope of a quarter of its bend there.
    let (_, bent_n) = force_n(vec![("needle.prebend", vec![0.2])]);
    let prestress_n = -3.0 * Needle::gauge_18().bending_stiffness_n_m2() * 0.2 / 0.12;
    let added_n =
        [1.0, 12.0].map(|now_s| bent_n[sample_at(now_s, &time_s)] - plain_n[sample_at(now_s, &time_s)]);
    assert!(added_n.iter().all(|added_n| (added_n - prestress_n).abs() < 1e-9), "{added_n:?} {prestress_n}");
    let bent = march(&world(&truth(vec![("needle.prebend", vec![0.2])])), 0, 0.03, &[0.0], 0.05, &[0]);
    let tip_m = 0.25 * 0.2 * 0.06 * 0.04 + 0.5 * 0.2 * 0.04 * 0.04;
    assert!(bent.shape_m[0][node_at(0.06)].abs() < 1e-12);
    assert!((bent.shape_m[0][node_at(0.1)] - tip_m).abs() < 1e-12);
}

fn behind_mm(now_s: f64, played_n: &[f64], plain_n: &[f64], time_s: &[f64]) -> f64 {
    (played_n[sample_at(now_s, time_s)] - plain_n[sample_at(now_s, time_s)])
        / (plain_n[sample_at(12.0, time_s)] / 1.2)
}

fn sample_at(wanted_s: f64, time_s: &[f64]) -> usize {
    time_s.iter().position(|now_s| (now_s - wanted_s).abs() < 1e-9).expect("a sample")
}

fn force_n(effects: Vec<(&'static str, Vec<f64>)>) -> (Vec<f64>, Vec<f64>) {
    let session = session(&truth(effects), &small(), 1);
    (session.lateral[0].force.time_s.clone(), session.lateral[0].force.force_y_n.clone())
}

fn sd(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt()
}

#[test]
fn noise_is_as_planned() {
    let mut design = Design::nine_runs();
    design.insertion = Design::insertions().insertion;
    design.noise.outlier_share = 0.0;
    let noisy = session(&truth(vec![]), &design, 3);
    assert_eq!(noisy, session(&truth(vec![]), &design, 3));
    assert_ne!(noisy, session(&truth(vec![]), &design, 4));
    let noise = channels(&noisy);
    let clean = channels(&session(&truth(vec![]), &quiet(design.clone()), 3));
    let errors = |channel: usize| noise[channel].iter().zip(&clean[channel]).map(|(a, b)| a - b);
    let pixel_sd_m = 1e-3 * 0.02_f64.hypot(0.05 / 12f64.sqrt());
    for (channel, expected) in
        [0.02_f64.hypot(0.005 / 12f64.sqrt()), 1e-5, pixel_sd_m, 5e-5].into_iter().enumerate()
    {
        // The shape has the fewest samples that count: pixels of one sweep where the needle is straight agree.
        assert!((sd(errors(channel)) / expected - 1.0).abs() < 0.06, "{channel} {}", sd(errors(channel)));
    }
    let force: Vec<f64> = errors(0).collect();
    let neighbours = force.windows(2).map(|pair| pair[0] * pair[1]).sum::<f64>()
        / force.iter().map(|f| f * f).sum::<f64>();
    assert!((neighbours - 0.5 * (-0.05f64 / 0.15).exp()).abs() < 0.03, "{neighbours}");
    assert!((noisy.noise.shape_m.expect("stated") / pixel_sd_m - 1.0).abs() < 1e-12);
    assert!(noise[0].iter().all(|force_n| ((force_n / 0.005) - (force_n / 0.005).round()).abs() < 1e-6));
    // Outliers: six standard deviations and more, one in two hundred.
    design.noise.outlier_share = 0.005;
    let spoilt = channels(&session(&truth(vec![]), &design, 3));
    let spikes = spoilt[0].iter().zip(&clean[0]).filter(|(a, b)| (*a - *b).abs() > 0.09).count();
    assert!((spikes as f64 / force.len() as f64 - 0.005).abs() < 0.002, "{spikes} of {}", force.len());
}

#[test]
fn plans_follow_the_design() {
    let nine = session(&truth(vec![]), &Design::nine_runs(), 1);
    assert_eq!(nine.lateral.len(), 9);
    let run = &nine.lateral[2];
    assert_eq!((run.depth_m, run.shape.z_m.len()), (0.03, 5 * 30));
    assert!((run.shape.z_m[0] - 0.0705).abs() < 1e-12 && (run.shape.z_m[29] - 0.0995).abs() < 1e-12);
    let sweeps_s: Vec<f64> = run.shape.time_s.as_ref().expect("times").iter().step_by(30).copied().collect();
    let expected_s = [1.5, 11.7, 15.1, 26.1, 30.3];
    assert!(sweeps_s.iter().zip(expected_s).all(|(a, b)| (a - b).abs() < 1e-9), "{sweeps_s:?}");
    let insertions = session(&truth(vec![]), &Design::insertions(), 1);
    assert_eq!((insertions.lateral.len(), insertions.insertion.len()), (4, 6));
    let rotation_rad = insertions.insertion[1].rotation_rad.as_ref().expect("rotation");
    assert_eq!((rotation_rad.len(), rotation_rad[100], rotation_rad[101]), (201, 0.0, std::f64::consts::PI));
    assert!(strengths("tissue.unknown").is_none());
    let unknown =
        std::panic::catch_unwind(|| session(&truth(vec![("tissue.unknown", vec![1.0])]), &small(), 1));
    assert!(unknown.is_err());
}

#[test]
fn sessions_are_quick_to_make() {
    timed("nine runs", vec![], Design::nine_runs());
    timed("nine runs, relaxing", vec![("tissue.relaxation", vec![0.2, 2.0])], Design::nine_runs());
    timed("nine runs, stiffening", vec![("tissue.stiffening", vec![1.0])], Design::nine_runs());
    timed("insertions", vec![], Design::insertions());
}

fn timed(what: &str, effects: Vec<(&'static str, Vec<f64>)>, design: Design) {
    let start = Instant::now();
    session(&truth(effects), &design, 1);
    println!("{what}: {:.1} ms", 1e3 * start.elapsed().as_secs_f64());
}
