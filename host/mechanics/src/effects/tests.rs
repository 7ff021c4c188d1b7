//! Every effect of the catalogue: neutral values, sensitivities, and limiting cases in closed form.

use super::*;
use crate::{
    DriveSample, Experiment, Insertion, Lateral, Model, Needle, Profile, Rig, Series, Support, TipLaw,
    predict,
};

mod across;
mod frictions;
mod needle_and_tip;
mod tip_push;

#[test]
fn the_first_time_after_another_is_that_of_a_search_through_all() {
    let even: Vec<f64> = (0..50).map(|i| 0.3 + 0.02 * f64::from(i)).collect();
    let uneven: Vec<f64> = (0..50).map(|i| 0.01 * f64::from(i * i)).collect();
    for times_s in [even, uneven, vec![1.0], vec![1.0, 2.0], Vec::new()] {
        let between = (-10..300).map(|i| 0.1 * f64::from(i)).chain(times_s.iter().copied());
        for time_s in between.chain([f64::NEG_INFINITY, f64::INFINITY]) {
            let expected = times_s.iter().take_while(|s| **s <= time_s).count();
            assert_eq!(first_after(&times_s, time_s), expected, "{time_s} in {times_s:?}");
        }
    }
}

const GUIDE2_M: f64 = 0.06;
const ENTRY_M: f64 = 0.07;
/// A probe above the needle, a little to the side, that moves by 2 mm/s.
const IMAGE: ShapeImage = ShapeImage { beam_rad: -1.2, probe_m_per_s: 2e-3 };

/// A staircase in both planes, with ramps and holds, and sweeps in two holds.
fn lateral(depth_m: f64) -> Experiment {
    let mut drive = Vec::new();
    let (mut y_m, mut x_m) = (0.0, 0.0);
    for (level, [to_y_m, to_x_m]) in
        [[0.0, 0.0], [0.6e-3, 0.0], [1.2e-3, -0.4e-3], [0.0, 0.0], [-1.0e-3, 0.4e-3]].into_iter().enumerate()
    {
        for i in 0..20 {
            let ramp = (f64::from(i) / 10.0).min(1.0);
            let time_s = level as f64 * 2.0 + 0.1 * f64::from(i);
            let sample =
                DriveSample { time_s, y_m: y_m + ramp * (to_y_m - y_m), x_m: x_m + ramp * (to_x_m - x_m) };
            drive.push(sample);
        }
        (y_m, x_m) = (to_y_m, to_x_m);
    }
    let points_at = |time_s: f64| {
        [0.072, 0.08, 0.085, 0.099]
            .map(|z_m| ShapePoint { image: Some(IMAGE), ..ShapePoint::new(time_s, z_m) })
            .into_iter()
            .filter(move |p| p.z_m <= ENTRY_M + depth_m)
    };
    let shape = points_at(5.5).chain(points_at(7.0)).chain(points_at(9.7)).collect();
    Experiment::Lateral(Lateral { depth_m, drive, shape, reversal_m: [0.0; 2], order: 0.0 })
}

fn insertion() -> Experiment {
    Experiment::Insertion(Insertion {
        depth_m: vec![0.01, 0.03, 0.05, 0.08],
        rotation_rad: Profile::new(vec![[0.045, 0.0], [0.045, 3.0]]).expect("a profile"),
        guide2_m: Some(Default::default()),
        speed_m_per_s: Profile::constant(5e-3),
        ..Insertion::default()
    })
}

/// The same while guide 2 is moved, over a stretch and at rest.
fn moved_insertion() -> Experiment {
    let Experiment::Insertion(still) = insertion() else { panic!("an insertion") };
    let y = vec![[0.02, 0.0], [0.04, 0.8e-3], [0.06, 0.8e-3], [0.06, -0.5e-3]];
    let x = vec![[0.03, 0.0], [0.03, -0.6e-3]];
    let guide2_m = Some([y, x].map(|knots| Profile::new(knots).expect("a profile")));
    Experiment::Insertion(Insertion { guide2_m, ..still })
}

fn plain() -> Model {
    let rig = Rig::two_guides(Needle::gauge_18(), GUIDE2_M, ENTRY_M);
    let mut model = Model::uniform(rig, 16e3).expect("valid");
    model.tip = TipLaw::load([0.2, 0.0]);
    model
}

/// Model to which an effect is added: springs, or a body where only that has it.
fn plain_for(id: &str) -> Model {
    let plain = plain();
    let is_of_body = id == "tissue.finite_body";
    Model { support: if is_of_body { Support::half_space(0.5) } else { plain.support }, ..plain }
}

fn with(id: &str, values: &[f64]) -> Model {
    let mut model = plain_for(id);
    model.effects.push((effect(id).expect("an effect"), values.to_vec()));
    model
}

fn channels(model: &Model, experiment: &Experiment) -> Channels {
    predict(model, experiment).expect("predicts")
}

/// Everything that is predicted, in newtons and tenths of a millimetre.
fn numbers(model: &Model) -> Vec<f64> {
    let mut numbers = Vec::new();
    for experiment in [lateral(0.03), moved_insertion()] {
        let Channels { force_n, shape_m, tip_m, .. } = channels(model, &experiment);
        let series = [(force_n, 1.0), (shape_m, 1e4), (tip_m, 1e4)];
        for (series, unit) in series {
            numbers.extend(series.y.into_iter().chain(series.x.into_iter().flatten()).map(|v| unit * v));
        }
    }
    numbers
}

/// Values of an ordinary size, off the neutral ones.
fn typical(effect: &dyn Effect) -> Vec<f64> {
    effect
        .parameters()
        .iter()
        .map(|p| p.neutral + if p.nodes.is_empty() { p.prior_sd } else { 0.0 })
        .collect()
}

/// Over the whole catalogue: neutral values change no bit, others change something.
#[test]
fn neutral_effects_do_nothing_and_others_do_something() {
    let experiments = [lateral(0.03), moved_insertion()];
    for effect in EFFECTS {
        let neutral = with(effect.id(), &neutral(effect));
        let other_model = with(effect.id(), &typical(effect));
        let shows = effect.info().observable_in;
        for (experiment, shows) in experiments.iter().zip([shows.lateral, shows.insertion]) {
            let expected = channels(&plain_for(effect.id()), experiment);
            assert_eq!(channels(&neutral, experiment), expected, "{}", effect.id());
            assert_eq!(channels(&other_model, experiment) != expected, shows, "{}", effect.id());
        }
    }
}

#[test]
fn the_catalogue_is_consistent() {
    for (index, a) in EFFECTS.iter().enumerate() {
        assert_eq!(effect(a.id()).expect("found").id(), a.id());
        assert!(EFFECTS.iter().skip(index + 1).all(|b| a.id() != b.id()));
        assert!(!a.info().physics.is_empty() && !a.info().signature.is_empty());
        for parameter in a.parameters() {
            assert!(is_inside(parameter.range, parameter.neutral) && parameter.prior_sd > 0.0);
            assert!(parameter.likely.into_iter().all(|end| is_inside(parameter.range, end)), "{}", a.id());
            assert!(is_inside(parameter.likely, parameter.neutral), "{}", a.id());
            assert!(parameter.nodes.iter().all(|node| is_inside(parameter.likely, *node)), "{}", a.id());
        }
    }
    assert!(effect("nothing").is_none());
}

fn is_inside([least, most]: [f64; 2], value: f64) -> bool {
    (least..=most).contains(&value)
}

/// Central differences with two steps agree: what is predicted is smooth in every parameter.
#[test]
fn sensitivities_do_not_depend_on_the_step() {
    for effect in EFFECTS {
        let typical_values = typical(effect);
        for (index, parameter) in effect.parameters().iter().enumerate() {
            // A delay and a clearance pass over samples of the ramps: their answer has kinks there, none at these values.
            // A place moves the nodes of the grid, which is worth a few per cent of its effect.
            let (step_fraction, tolerance) =
                if parameter.nodes.is_empty() { (1e-3, 2e-3) } else { (5e-2, 5e-2) };
            let step = step_fraction * parameter.prior_sd;
            let (coarse, fine) = (
                slope(2.0 * step, &typical_values, index, effect),
                slope(step, &typical_values, index, effect),
            );
            let size = fine.iter().map(|v| v.abs()).fold(0.0, f64::max);
            for (a, b) in coarse.iter().zip(&fine) {
                assert!((a - b).abs() < tolerance * size, "{} {}: {a} {b}", effect.id(), parameter.name);
            }
        }
    }
}

fn slope(step: f64, typical_values: &[f64], index: usize, effect: &dyn Effect) -> Vec<f64> {
    let [increased, decreased] = [step, -step].map(|step| {
        let mut values = typical_values.to_vec();
        values[index] += step;
        numbers(&with(effect.id(), &values))
    });
    increased.iter().zip(&decreased).map(|(a, b)| (a - b) / (2.0 * step)).collect()
}

#[track_caller]
fn assert_close(value: f64, expected: f64, relative: f64) {
    assert!((value - expected).abs() <= relative * expected.abs(), "{value} is not {expected}");
}

#[test]
fn sensors_map_what_they_measure() {
    let experiment = lateral(0.03);
    let plain = channels(&plain(), &experiment);
    let n = 45;
    assert_close(
        channels_with("sensor.force_gain", &[0.1], &experiment).force_n.y[n],
        1.1 * plain.force_n.y[n],
        1e-14,
    );
    assert_close(
        channels_with("sensor.force_bias", &[0.1, -0.2], &experiment).force_n.y[n],
        plain.force_n.y[n] + 0.1,
        1e-14,
    );
    assert_close(
        forces_x(&channels_with("sensor.force_bias", &[0.1, -0.2], &experiment))[n],
        forces_x(&plain)[n] - 0.2,
        1e-14,
    );
    // Sample 45 is 4.5 s after the first.
    assert_close(
        channels_with("sensor.force_drift", &[0.01, 0.0], &experiment).force_n.y[n],
        plain.force_n.y[n] + 0.045,
        1e-12,
    );
    assert_close(
        channels_with("sensor.crosstalk", &[0.1], &experiment).force_n.y[n],
        plain.force_n.y[n] + 0.1 * forces_x(&plain)[n],
        1e-14,
    );
    assert_close(
        channels_with("sensor.delay", &[0.25], &experiment).force_n.y[n],
        0.5 * (plain.force_n.y[42] + plain.force_n.y[43]),
        1e-12,
    );
    assert_close(
        channels_with("sensor.shape_scale", &[0.1], &experiment).shape_m.y[1],
        1.1 * plain.shape_m.y[1],
        1e-14,
    );
    assert_close(
        channels_with("sensor.shape_offset", &[0.1, -0.2], &experiment).shape_m.y[1],
        plain.shape_m.y[1] + 1e-4,
        1e-14,
    );
    // The second point is at 80 mm, the third at 85: shifted by 5 mm the one shows the other.
    assert_close(
        channels_with("sensor.depth_shift", &[5.0], &experiment).shape_m.y[1],
        plain.shape_m.y[2],
        1e-12,
    );
    assert_eq!(channels_with("sensor.shape_scale", &[0.1], &experiment).force_n, plain.force_n);
}

fn channels_with(id: &str, values: &[f64], experiment: &Experiment) -> Channels {
    channels(&with(id, values), experiment)
}

fn forces_x(channels: &Channels) -> Vec<f64> {
    channels.force_n.x.clone().expect("two planes")
}

/// Along the beam, and nothing across it; not at all where nothing is known of the image.
#[test]
fn images_are_wrong_along_the_beam() {
    let experiment = lateral(0.03);
    let plain_shape = channels(&plain(), &experiment).shape_m;
    let [along_y, along_x] = IMAGE.along();
    assert!(along_y < -0.9 && along_x > 0.3);
    for (id, value) in [("imaging.sound_speed", 0.05), ("imaging.echo_offset", 0.3)] {
        let shape = channels(&with(id, &[value]), &experiment).shape_m;
        for i in 0..shape.y.len() {
            let ([y, x], [plain_y, plain_x]) = (plane_values(&shape, i), plane_values(&plain_shape, i));
            let deflected_m = plain_y * along_y + plain_x * along_x;
            let more_m = (y - plain_y) * along_y + (x - plain_x) * along_x;
            let perpendicular_m = (x - plain_x) * along_y - (y - plain_y) * along_x;
            let expected_m = if id == "imaging.sound_speed" { 0.05 * deflected_m } else { 0.3e-3 };
            assert!((more_m - expected_m).abs() < 1e-15, "{id} {i}: {more_m} {expected_m}");
            assert!(perpendicular_m.abs() < 1e-15, "{id} {i}: {perpendicular_m}");
        }
    }
    // The second point is at 80 mm, the third at 85: at 2 mm/s a lag of 2.5 s shows the one for the other.
    let late = channels(&with("imaging.lag", &[2.5]), &experiment).shape_m;
    assert_close(late.y[1], plain_shape.y[2], 1e-12);
    let Experiment::Lateral(mut unknown) = experiment else { panic!("lateral") };
    unknown.shape.iter_mut().for_each(|point| point.image = None);
    let unknown = Experiment::Lateral(unknown);
    for id in ["imaging.sound_speed", "imaging.echo_offset", "imaging.lag"] {
        assert_eq!(channels(&with(id, &[0.2]), &unknown).shape_m, plain_shape, "{id}");
    }
}

fn plane_values(shape: &Series, i: usize) -> [f64; 2] {
    [shape.y[i], shape.x.as_ref().expect("two planes")[i]]
}

#[test]
fn the_rig_comes_between_actuator_and_needle() {
    let experiment = lateral(0.03);
    let plain = channels(&plain(), &experiment);
    let stiffness = plain.force_n.y[59] / 1.2e-3;
    // A clamp of 0.35 rad/(N m): 1 mm takes 1.0152508e-3 m/N against 0.916319e-3.
    assert_close(
        channels_with("rig.clamp_compliance", &[0.35], &experiment).force_n.y[59],
        1.2e-3 / 0.0010152508803166775,
        1e-10,
    );
    // Two springs in series.
    let frame = channels_with("rig.frame_compliance", &[0.1], &experiment);
    assert_close(frame.force_n.y[59], 1.2e-3 / (1.0 / stiffness + 1e-4), 1e-12);
    assert_close(frame.shape_m.y[1] / plain.shape_m.y[1], frame.force_n.y[59] / plain.force_n.y[59], 1e-12);
    // The displacement read is the commanded one.
    assert_eq!(frame.displacement_m, plain.displacement_m);
    let loose = channels_with("rig.backlash", &[0.1], &experiment);
    assert_close(loose.force_n.y[59], 1.1e-3 * stiffness, 1e-12);
    assert_close(loose.force_n.y[99], -0.9e-3 * stiffness, 1e-12);
    assert_eq!(loose.force_n.y[62..79].iter().filter(|n| **n == 0.0).count(), 9);
    // Guide 2 stays where it was left until the play is taken up: behind on the way out, ahead on the way back.
    let late = channels_with("rig.play", &[0.1], &experiment);
    assert_close(late.force_n.y[59], 1.1e-3 * stiffness, 1e-12);
    assert_close(late.force_n.y[60], 1.1e-3 * stiffness, 1e-12);
    assert_close(late.force_n.y[79] - plain.force_n.y[79], 0.1e-3 * stiffness, 1e-9);
    assert_close(late.force_n.y[99], -0.9e-3 * stiffness, 1e-12);
    let dry = channels_with("rig.friction", &[0.05], &experiment);
    let added = |i: usize| dry.force_n.y[i] - plain.force_n.y[i];
    for (i, expected) in [(10, 0.0), (25, 0.05), (39, 0.05), (59, 0.05), (79, -0.05), (99, -0.05)] {
        assert!((added(i) - expected).abs() < 1e-12, "{i}: {}", added(i));
    }
}

/// The staircase along y as a sensor with noise reads it, which turns round in every sample; along x guide 2 stays.
fn noisy(seed: u64) -> Experiment {
    let Experiment::Lateral(mut noisy) = lateral(0.03) else { panic!("lateral") };
    let mut noise = noise::Noise::new(seed);
    for sample in &mut noisy.drive {
        sample.y_m += 1e-5 * noise.normal();
        sample.x_m = 1e-4 + 1e-5 * noise.normal();
    }
    noisy.reversal_m = [8e-5; 2];
    Experiment::Lateral(noisy)
}

/// Guide 2 does not turn round where its sensor's noise does.
#[test]
fn friction_follows_the_motion_and_not_the_noise_of_its_sensor() {
    let noisy = noisy(5);
    let plain = channels(&plain(), &noisy).force_n;
    let dry = channels(&with("rig.friction", &[0.05]), &noisy).force_n;
    let added: Vec<f64> = dry.y.iter().zip(&plain.y).map(|(dry, plain)| dry - plain).collect();
    for (i, expected) in [(10, 0.0), (25, 0.05), (39, 0.05), (59, 0.05), (79, -0.05), (99, -0.05)] {
        assert!((added[i] - expected).abs() < 1e-12, "{i}: {}", added[i]);
    }
    assert_eq!(dry.x, plain.x);
}

/// A little play, taken as it stands, would smooth the noise of the readings: a fit would find it in every recording.
#[test]
fn play_follows_the_motion_and_not_the_noise_of_its_sensor() {
    for seed in 7..12 {
        let noisy = noisy(seed);
        let plain = channels(&plain(), &noisy).force_n;
        let late = channels(&with("rig.play", &[0.005]), &noisy).force_n;
        let stiffness = channels(&self::plain(), &lateral(0.03)).force_n.y[59] / 1.2e-3;
        // Not in the last readings before the way back, which may count as its beginning.
        for (i, expected) in [(10, 0.0), (25, -1.0), (39, -1.0), (54, -1.0), (79, 1.0), (99, 1.0)] {
            let offset_um = 1e6 * (late.y[i] - plain.y[i]) / stiffness;
            assert!((offset_um - 5.0 * expected).abs() < 1e-6, "seed {seed}, {i}: {offset_um}");
        }
        assert_eq!(late.x, plain.x);
    }
}

/// A reversal is certain only some way back; friction has turned since that way began.
#[test]
fn friction_turns_where_the_way_back_begins() {
    let Experiment::Lateral(mut noisy) = lateral(0.03) else { panic!("lateral") };
    let mut noise = noise::Noise::new(6);
    noisy.drive.iter_mut().for_each(|sample| sample.y_m += 1e-5 * noise.normal());
    // Steps of ramps are 0.06 to 0.12 mm long.
    noisy.reversal_m = [0.25e-3; 2];
    let noisy = Experiment::Lateral(noisy);
    let plain = channels(&plain(), &noisy).force_n;
    let dry = channels(&with("rig.friction", &[0.05]), &noisy).force_n;
    for (i, expected) in [(20, 0.0), (22, 0.05), (60, 0.05), (61, -0.05), (62, -0.05), (80, -0.05)] {
        let added = dry.y[i] - plain.y[i];
        assert!((added - expected).abs() < 1e-12, "{i}: {added}");
    }
}

#[test]
fn tissue_effects_act_as_described() {
    let experiment = lateral(0.03);
    let plain = channels(&plain(), &experiment);
    // A boundary below the tip is none, a gap as deep as the needle leaves a cantilever: 3 EI / c2^3.
    assert_eq!(channels_with("tissue.layers", &[3.0, 40.0], &experiment).force_n, plain.force_n);
    assert!(
        channels_with("tissue.layers", &[3.0, 10.0], &experiment).force_n.y[59] > 1.02 * plain.force_n.y[59]
    );
    let cantilever = 3.0 * Needle::gauge_18().bending_stiffness_n_m2() / GUIDE2_M.powi(3) * 1.2e-3;
    assert_close(channels_with("tissue.entry_gap", &[30.0], &experiment).force_n.y[59], cantilever, 1e-9);
    // Layers with nothing above are a gap.
    let mut layered = with("tissue.layers", &[1e9, 5.0]);
    layered.foundation = layered.foundation.scaled(1e-9).expect("a foundation");
    let gap = channels_with("tissue.entry_gap", &[5.0], &experiment);
    assert_close(channels(&layered, &experiment).force_n.y[59], gap.force_n.y[59], 1e-6);
    // A hard skin holds the needle where it enters.
    let skin = channels_with("tissue.skin", &[1e6], &experiment);
    let held_beam =
        BeamProblem { guide2_m: GUIDE2_M, ..with("tissue.skin", &[1e6]).problem(0.03).expect("a problem") };
    assert!(held_beam.solve().expect("solves").deflection_m(1e-3, ENTRY_M).abs() < 1e-7);
    assert!(skin.force_n.y[59] > plain.force_n.y[59]);
    // Anisotropy by two is twice the modulus, horizontally.
    let twice = channels(&Model { foundation: plain_foundation(32e3), ..self::plain() }, &experiment);
    let split = channels_with("tissue.anisotropy", &[2.0], &experiment);
    assert_eq!((&split.force_n.y, &split.force_n.x), (&plain.force_n.y, &twice.force_n.x));
    // A block that gives is softer in its plane, a box that holds it stiffer; springs have no walls.
    let body = channels(&plain_for("tissue.finite_body"), &experiment);
    let in_block =
        |give_ln_y: f64| channels_with("tissue.finite_body", &[give_ln_y, 0.0, 100.0], &experiment);
    assert!(in_block(0.85).force_n.y[59] < 0.9 * body.force_n.y[59]);
    assert!(in_block(-0.4).force_n.y[59] > 1.05 * body.force_n.y[59]);
    assert_eq!(in_block(0.85).force_n.x, body.force_n.x);
    let mut springs = with("tissue.finite_body", &[0.85, 0.85, 100.0]);
    springs.support = Support::Springs;
    assert_eq!(channels(&springs, &experiment).force_n, plain.force_n);
    // A stiff shear layer keeps the needle straight in the tissue.
    let straight = channels_with("tissue.shear", &[1e5], &experiment);
    let [a, b, c] = [0, 1, 2].map(|i| straight.shape_m.y[i]);
    assert!(((c - b) / 5.0 - (b - a) / 8.0).abs() < 1e-5 * a.abs(), "{a} {b} {c}");
}

fn plain_foundation(modulus_pa: f64) -> crate::Foundation {
    crate::Foundation::uniform(modulus_pa).expect("a modulus")
}

/// In a lateral run the needle in tissue that yields is that of the elements, at any displacement; far from yielding it is linear.
#[test]
fn tissue_that_yields_gives_way() {
    let model = with("tissue.yield", &[20.0, 8.0]);
    let problem = model.problem(0.03).expect("a problem");
    let elements = crate::elements::Elements::new(&problem, 0.5e-3).expect("cut");
    let shape = vec![ShapePoint::new(0.0, 0.09)];
    for (held_m, least) in [(0.1e-3, 0.999), (1.5e-3, 0.9), (4e-3, 0.6)] {
        let drive = vec![DriveSample { time_s: 0.0, y_m: held_m, x_m: 0.0 }];
        let pushed = Experiment::Lateral(Lateral {
            depth_m: 0.03,
            drive,
            shape: shape.clone(),
            reversal_m: [0.0; 2],
            order: 0.0,
        });
        let measured = channels(&model, &pushed);
        let held_guide = crate::elements::Guide2::Held(held_m);
        let expected = elements.solve(&yielding_springs, |_| 0.0, held_guide, 0.0).expect("solves");
        assert_close(measured.force_n.y[0], expected.guide2_force_n, 2e-3);
        assert_close(measured.shape_m.y[0], expected.deflection_m(0.09), 2e-3);
        let linear = channels(&plain(), &pushed).force_n.y[0];
        assert!(measured.force_n.y[0] < linear && measured.force_n.y[0] > least * linear, "{held_m}");
    }
    // A tip that only cuts at an angle has no load to solve for, and is refused.
    let mut angled = model;
    angled.tip.cutting = crate::Cutting::Angle([0.02, 0.0]);
    assert!(predict(&angled, &insertion()).is_err());
}

fn yielding_springs(depth_m: f64, stretch_m: f64) -> crate::elements::Reaction {
    // 50 N/m at the surface, e times as much every 8 mm.
    let linear_n_per_m = 16e3 * stretch_m;
    let yielding_share = linear_n_per_m / (50.0 * (depth_m / 8e-3).exp());
    let root = (1.0 + yielding_share * yielding_share).sqrt();
    crate::elements::Reaction { force_n_per_m: linear_n_per_m / root, tangent_pa: 16e3 / root.powi(3) }
}
