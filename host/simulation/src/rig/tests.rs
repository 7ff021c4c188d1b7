use super::*;

const PERIOD_S: f64 = 1e-3;
const REST: BridgeInputs = [[0.0; 2]; 2];

fn rig(seed: u64) -> SimulatedRig {
    SimulatedRig::new(RigConfig::default(), seed).expect("the default rig is sound")
}

#[test]
fn a_seed_repeats_exactly_and_another_differs() {
    assert_eq!(run(5), run(5));
    assert_ne!(run(5).2, run(6).2);
}

fn run(seed: u64) -> (Vec<Codes>, Vec<ShapeSample>, Truth) {
    let mut rig = rig(seed);
    let codes: Vec<Codes> = (0..200).map(|_| rig.step([[0.5, 0.0], [0.0, 0.7]], PERIOD_S)).collect();
    (codes, rig.sweep(), rig.truth())
}

#[test]
fn a_sweep_changes_nothing_in_the_force_noise() {
    let (mut with_sweep, mut without_sweep) = (rig(1), rig(1));
    with_sweep.sweep();
    assert_eq!(with_sweep.step(REST, PERIOD_S), without_sweep.step(REST, PERIOD_S));
}

#[test]
fn the_motor_stands_within_its_dead_band_and_stops_at_the_ends() {
    let mut rig = rig(2);
    let start = rig.position_m();
    for _ in 0..1_000 {
        rig.step([[0.1, 0.0], [1.0, 0.95]], PERIOD_S);
    }
    assert_eq!(rig.position_m(), start);
    for _ in 0..5_000 {
        rig.step([[1.0, 0.0], [0.0, 1.0]], PERIOD_S);
    }
    assert_eq!(rig.position_m(), [0.025, -0.025]);
}

#[test]
fn converters_saturate_instead_of_wrapping() {
    let mut config = RigConfig::default();
    config.simulation.modulus_kpa = Range { low: 900.0, high: 900.0 };
    let mut rig = SimulatedRig::new(config, 3).expect("stiff tissue is sound");
    let mut codes = rig.step(REST, PERIOD_S);
    for _ in 0..5_000 {
        codes = rig.step([[1.0, 0.0], [0.0, 1.0]], PERIOD_S);
    }
    assert_eq!(codes.bridge, [8_388_607, -8_388_608]);
    assert_eq!(codes.potentiometer[0], 4_095);
}

#[test]
fn readings_scatter_about_the_truth_as_configured() {
    let mut rig = rig(4);
    let count = 20_000;
    let codes: Vec<Codes> = (0..count).map(|_| rig.step(REST, PERIOD_S)).collect();
    let [force_n, _] = rig.force_n();
    let code_per_n = 5.0 / 9.375 / 5.0 * 8_388_607.0;
    let readings_n: Vec<f64> = codes.iter().map(|codes| f64::from(codes.bridge[0]) / code_per_n).collect();
    let mean = readings_n.iter().sum::<f64>() / f64::from(count);
    let sd = (readings_n.iter().map(|n| (n - mean).powi(2)).sum::<f64>() / f64::from(count)).sqrt();
    assert!((mean - force_n - rig.bridge_offset_n[0]).abs() < 4.0 * 0.005 / f64::from(count).sqrt());
    assert!((sd / 0.005 - 1.0).abs() < 0.03, "{sd}");
    let [x_m, _] = rig.position_m();
    let mean_code =
        codes.iter().map(|codes| f64::from(codes.potentiometer[0])).sum::<f64>() / f64::from(count);
    assert!(((mean_code - 2_048.0) * 0.05 / 4_096.0 - x_m).abs() < 1e-6);
}

#[test]
fn a_sweep_measures_the_needle_of_the_forward_model() {
    let mut config = RigConfig::default();
    config.simulation.ultrasound.noise_mm = 0.0;
    config.simulation.ultrasound.pixel_mm = 1e-6;
    let mut rig = SimulatedRig::new(config, 7).expect("sound");
    let [x_m, y_m] = rig.position_m();
    let sweep = rig.sweep();
    assert_eq!(sweep.len(), 30);
    for sample in sweep {
        let expected = [x_m, y_m].map(|m| rig.beam.deflection_m(m, sample.z_m));
        for (measured_m, expected_m) in sample.deflection_m.iter().zip(expected) {
            assert!((measured_m - expected_m).abs() < 1e-9);
        }
    }
}

#[test]
fn unsound_configurations_are_refused_by_name() {
    let mut config = RigConfig::default();
    config.simulation.depth_mm = -1.0;
    let message = SimulatedRig::new(config, 0).expect_err("negative depth").to_string();
    assert!(message.contains("depth_mm is -1"), "{message}");
}

#[test]
fn a_needle_of_someone_else_loads_the_guide_until_it_is_taken_away() {
    let mut rig = SimulatedRig::new(RigConfig::default(), 3).expect("a rig");
    let needle_force_n = rig.force_n();
    let [x_m, y_m] = rig.position_m();
    let load = NeedleLoad { at_m: [x_m - 1e-3, y_m], force_n: [0.5, -0.2], stiffness_n_per_m: 300.0 };
    rig.set_load(Some(load));
    let [x_n, y_n] = rig.force_n();
    assert!((x_n - 0.8).abs() < 1e-12 && (y_n + 0.2).abs() < 1e-12, "{x_n} N, {y_n} N");
    rig.set_load(None);
    assert_eq!(rig.force_n(), needle_force_n);
}
