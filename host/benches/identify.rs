//! Speed of one identification: one lateral run at 30 mm, 1.2 mm, 40 shape samples. Beside SciPy: `cargo xtask bench`.

use criterion::Criterion;
use host::inference::energy::{Balance, energy_modulus};
use host::inference::{LateralData, LevelData, Measured, Parameter, ShapeDatum, fit};
use host::model::{Beam, Foundation, Needle, Rig};
use std::hint::black_box;

const DEPTH_M: f64 = 0.03;
const SAMPLES: usize = 40;
const SHAPE_SD_M: f64 = 25e-6;

fn rig() -> Rig {
    Rig { needle: Needle::gauge_18(), guide2_m: 0.06, entry_m: 0.07 }
}

/// Force and shape at 1.2 mm and K = 16 kPa, with errors that repeat.
fn measured() -> (Measured, Measured, Vec<(f64, f64)>) {
    let foundation = Foundation::uniform(16e3).expect("a modulus");
    let beam = Beam::solve(&rig(), &foundation, DEPTH_M).expect("solves");
    let shape = (0..SAMPLES).map(|i| {
        let z_m = 0.07 + DEPTH_M * (i as f64 + 0.5) / SAMPLES as f64;
        (z_m, beam.deflection_m(1.2e-3, z_m) + SHAPE_SD_M * (2.0 * i as f64).sin())
    });
    let force = Measured { value: beam.force_n(1.2e-3) + 0.05, sd: 0.1 };
    (Measured { value: 1.205e-3, sd: 15e-6 }, force, shape.collect())
}

const LN_K: Parameter = Parameter { start: 9.0, step: 1e-4, least: 2.0, most: 16.0, prior: None };

fn data() -> [LateralData; 1] {
    let (displacement, force, shape) = measured();
    let shape = shape.iter().map(|(z_m, u_m)| ShapeDatum { z_m: *z_m, deflection_m: [*u_m, 0.0] });
    let level =
        LevelData { displacement_m: vec![displacement], force_n: vec![force], shape: shape.collect() };
    [LateralData {
        rig: rig(),
        depth_m: DEPTH_M,
        planes: 1,
        levels: vec![level],
        shape_sd_m: SHAPE_SD_M,
        force_offset: false,
        uses_force: true,
        effects: Vec::new(),
        fixed: None,
    }]
}

fn likelihood(criterion: &mut Criterion) {
    let data = data();
    criterion.bench_function("likelihood", |bencher| {
        bencher.iter(|| fit(black_box(&[LN_K]), black_box(&data)).expect("fits"));
    });
}

fn energy(criterion: &mut Criterion) {
    let (displacement_m, force_n, shape_m) = measured();
    let balance = Balance { displacement_m, force_n, shape_m, shape_sd_m: SHAPE_SD_M };
    let rig = rig();
    criterion.bench_function("energy", |bencher| {
        bencher.iter(|| energy_modulus(black_box(&rig), DEPTH_M, black_box(&balance)).expect("a modulus"));
    });
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    likelihood(&mut criterion);
    energy(&mut criterion);
    criterion.final_summary();
}
