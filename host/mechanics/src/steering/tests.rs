//! Modes, overlap integrals and simulation against reference values: modes by an independent solver, the simulation by
//! Radau's method with the history integral carried as a differential equation, its tolerances of 1e-10 and 1e-12 apart by up to 1e-13 m.

use super::history::{ShapeFunctions, SupportMatrix};
use super::modes::{Clamped, free_modes};
use super::*;

const FIXTURE_KG: f64 = 0.3;

fn needle() -> Needle {
    Needle::gauge_18()
}

fn clamped(fixture_mass_kg: f64) -> Clamped {
    Clamped { fixture_mass_kg, ..Dynamics::steel(&needle(), 0.13, FIXTURE_KG).clamped(&needle()) }
}

/// `[l L, xi, phi(0), phi(L), phi(L/2)]`.
fn modes_are(fixture_mass_kg: f64, reference: [[f64; 5]; 3]) {
    let modes = free_modes(&clamped(fixture_mass_kg), 3).expect("a needle");
    for (mode, [a, xi, base, tip, middle]) in modes.iter().zip(reference) {
        assert!(is_close(mode.wave_number_per_m * 0.13, a), "{mode:?}");
        assert!(is_close(mode.frequency_rad_s, xi), "{mode:?}");
        assert!(is_close(mode.value(0.0), base), "{} {base}", mode.value(0.0));
        assert!(is_close(mode.value(0.13), tip), "{} {tip}", mode.value(0.13));
        assert!(is_close(mode.value(0.065), middle), "{} {middle}", mode.value(0.065));
    }
}

fn is_close(found: f64, expected: f64) -> bool {
    (found / expected - 1.0).abs() < 1e-9
}

#[test]
fn modes_on_a_heavy_fixture() {
    modes_are(
        0.3,
        [
            [
                1.8755741889527962,
                424.5837445643333,
                -0.05778108587687029,
                90.22551289183315,
                30.594140006480004,
            ],
            [
                4.694452814309828,
                2659.897028430108,
                0.03204394722538708,
                90.23333652009835,
                -64.39450343640921,
            ],
            [
                7.854965533722607,
                7447.0356948751505,
                -0.018792197593717735,
                90.2356161905767,
                1.7827991972080155,
            ],
        ],
    );
}

#[test]
fn modes_on_a_light_fixture() {
    modes_are(
        0.05,
        [
            [
                1.877910519749345,
                425.64217873587535,
                -0.3447183638290853,
                90.16976812431238,
                30.378983010204145,
            ],
            [
                4.696256538719367,
                2661.9414170258337,
                0.19181197783705303,
                90.21605895681672,
                -64.37244487617156,
            ],
            [7.856004546992611, 7449.005934112554, -0.1126135001513165, 90.22965863850183, 1.814020278810546],
        ],
    );
}

/// Modes are orthogonal to each other and to the translation in the mass of needle and fixture, at any mass of the fixture.
#[test]
fn modes_are_orthogonal() {
    for fixture_kg in [0.0, 1e-4, 0.05, 20.0] {
        let needle = clamped(fixture_kg);
        let modes = free_modes(&needle, 8).expect("a needle");
        for (i, mode) in modes.iter().enumerate() {
            let value = |x: f64| mode.value(x);
            // sqrt(mass) of the translation is the scale of this product.
            let translation = inertia_product(&value, &|_| 1.0, fixture_kg, needle.density_kg_per_m)
                / (fixture_kg + needle.density_kg_per_m * 0.13).sqrt();
            assert!(translation.abs() < 1e-9, "{fixture_kg} kg, mode {i}: {translation}");
            for (j, other) in modes.iter().enumerate() {
                let overlap =
                    inertia_product(&value, &|x| other.value(x), fixture_kg, needle.density_kg_per_m);
                assert!(
                    (overlap - f64::from(u8::from(i == j))).abs() < 1e-9,
                    "{fixture_kg} kg, {i} {j}: {overlap}"
                );
            }
        }
    }
}

fn inertia_product(
    a: &dyn Fn(f64) -> f64,
    b: &dyn Fn(f64) -> f64,
    fixture_kg: f64,
    density_kg_per_m: f64,
) -> f64 {
    density_kg_per_m * crate::quadrature::integrate(0.0, 0.13, 0.01, |x| a(x) * b(x))
        + fixture_kg * a(0.0) * b(0.0)
}

#[test]
fn overlap_of_the_inserted_part() {
    let modes = free_modes(&clamped(FIXTURE_KG), 3).expect("a needle");
    let functions = ShapeFunctions::of(&modes, 0.13);
    let factors = functions.factors(&modes);
    let reference = [
        (
            0.02,
            [
                0.02,
                1.613411715215048,
                1.1445445059550428,
                0.740738431373437,
                130.76287549925866,
                94.42125423600557,
                63.064107429406334,
                72.68483602268645,
                53.76514173389959,
                45.44794537363708,
            ],
        ),
        (
            0.08,
            [
                0.08,
                4.250580230002868,
                -1.197013370913214,
                -0.6203807937910067,
                260.39427107236287,
                14.914655869017484,
                -20.118254535128944,
                208.75051625381772,
                78.52955757812887,
                146.41185890414388,
            ],
        ),
    ];
    for (depth_m, upper) in reference {
        // In many steps as in one.
        for steps in [1, 400] {
            let mut overlap = SupportMatrix::new(&functions);
            for i in 0..steps {
                overlap.advance(
                    grid_m(i, depth_m, steps),
                    grid_m(i + 1, depth_m, steps),
                    std::iter::once((grid_m(i + 1, depth_m, steps) - grid_m(i, depth_m, steps), 1.0)),
                );
            }
            let transformed = &factors * overlap.matrix() * factors.transpose();
            let mut expected = upper.iter();
            for i in 0..4 {
                for j in i..4 {
                    let expected = expected.next().expect("ten values");
                    assert!(
                        (transformed[(i, j)] / expected - 1.0).abs() < 1e-9,
                        "{depth_m} {i} {j} {}",
                        transformed[(i, j)]
                    );
                    assert!(
                        (transformed[(i, j)] - transformed[(j, i)]).abs()
                            < 1e-9 * transformed[(i, i)].abs().max(1.0)
                    );
                }
            }
        }
    }
}

fn grid_m(i: i32, depth_m: f64, steps: i32) -> f64 {
    depth_m * f64::from(i) / f64::from(steps)
}

fn tissue(modes: usize) -> (Foundation, Dynamics) {
    let damping = Foundation::uniform(2e3).expect("valid");
    let dynamics = Dynamics { damping, modes, ..Dynamics::steel(&needle(), 0.13, FIXTURE_KG) };
    (Foundation::uniform(2e4).expect("valid"), dynamics)
}

fn force_n(time_s: f64) -> f64 {
    0.5 * (std::f64::consts::PI * time_s / 4.0).sin()
}

/// Steps of the given length, 10 mm/s.
fn run(step_s: f64, until_s: f64) -> Steering {
    let count = (until_s / step_s).round() as usize;
    let time_s: Vec<f64> = (0..=count).map(|i| i as f64 * step_s).collect();
    let depth_m = time_s.iter().map(|time_s| 0.01 * time_s).collect();
    let drive = BaseDrive::Force(time_s.iter().map(|&time_s| force_n(time_s)).collect());
    Steering { time_s, depth_m, drive }
}

#[test]
fn average_acceleration_is_the_reference_scheme() {
    let (stiffness, dynamics) = tissue(1);
    let channels = simulate(&needle(), &stiffness, &Dynamics { step_s: 1.0, ..dynamics }, &run(0.1, 0.5))
        .expect("simulates");
    let reference = [
        [8.806940745013591e-05, 0.0002893397480805594],
        [0.0003785242017550215, 0.0015839287829157857],
        [0.0008874495981676313, 0.004344307664543878],
        [0.0015313933360487158, 0.008203843166624331],
        [0.0021552117430874854, 0.012132626586098738],
    ];
    for (i, [tip_m, base_m]) in reference.into_iter().enumerate() {
        assert!((channels.tip_m[i + 1] / tip_m - 1.0).abs() < 1e-11, "{i} {}", channels.tip_m[i + 1]);
        assert!((channels.base_m[i + 1] / base_m - 1.0).abs() < 1e-11, "{i}");
    }
}

/// Within 2e-13 m: the reference is good to 1e-13 m, the rounding of 4096 steps adds as much.
/// Steps extrapolated to zero (the error of the scheme has even powers of the step only) against the reference at 0.5, 1, 2, 3
/// and 4 s: tip, base.
fn simulation_is(modes: usize, convective: bool, reference: [[f64; 2]; 5], within_m: f64) {
    let (stiffness, dynamics) = tissue(modes);
    let dynamics = Dynamics { convective, step_s: 1.0, ..dynamics };
    let times_s = [0.5, 1.0, 2.0, 3.0, 4.0];
    let simulated_with = |step_s: f64| -> Vec<f64> {
        let channels = simulate(&needle(), &stiffness, &dynamics, &run(step_s, 4.0)).expect("simulates");
        times_s
            .iter()
            .flat_map(|&time_s| {
                [channels.tip_m[index(time_s, step_s)], channels.base_m[index(time_s, step_s)]]
            })
            .collect()
    };
    let mut table: Vec<Vec<f64>> = Vec::new();
    for halvings in 0..4 {
        let mut row = simulated_with(1.0 / 256.0 / f64::from(1 << halvings));
        let mut factor = 1.0;
        for previous in &mut table {
            factor *= 4.0;
            let better: Vec<f64> = row
                .iter()
                .zip(&*previous)
                .map(|(fine, coarse)| fine + (fine - coarse) / (factor - 1.0))
                .collect();
            *previous = std::mem::replace(&mut row, better);
        }
        table.push(row);
    }
    let best = table.last().expect("rows");
    for (found, expected) in best.iter().zip(reference.as_flattened()) {
        assert!((found - expected).abs() < within_m, "{found} {expected}: off by {:e}", found - expected);
    }
}

fn index(time_s: f64, step_s: f64) -> usize {
    (time_s / step_s).round() as usize
}

#[test]
fn simulation_with_one_mode() {
    simulation_is(
        1,
        false,
        [
            [0.0021964312741599296, 0.012447350640259036],
            [0.0026549468856615927, 0.015580253605314376],
            [0.0013039784815986923, 0.021545859900914385],
            [0.0004949149856219547, 0.01187982217932069],
            [0.0010773858157298501, 0.0026347242663391905],
        ],
        2e-13,
    );
}

#[test]
fn simulation_with_three_modes() {
    simulation_is(
        3,
        false,
        [
            [0.002148583203319475, 0.012636852358730738],
            [0.0025807791985597707, 0.0156916628840756],
            [0.0011230846628532676, 0.021649371983745242],
            [0.0003696447171591919, 0.011808484827540076],
            [0.000852914216480704, 0.0024785075705156994],
        ],
        2e-13,
    );
}

#[test]
fn simulation_with_the_damper_on_the_tissue() {
    simulation_is(
        1,
        true,
        [
            [0.0021137705942185104, 0.012396169885925503],
            [0.002440855969061663, 0.015369663373821165],
            [0.0008788333457138801, 0.021310702553487985],
            [2.422432447886716e-05, 0.011742372889216668],
            [0.0006316480160372379, 0.002591379597417289],
        ],
        2e-13,
    );
}
