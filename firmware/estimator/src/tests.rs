//! Derivatives against differences, and what holds for any input.

use super::field::{Field, Layout};
use super::needle::{Mode, Shape};
use super::simulation::Simulation;
use super::{Row, Sample, Settings, Tracker};
use proptest::prelude::*;

const MODES: usize = 3;
const CELLS: usize = 24;
const LAYOUT: Layout = Layout { segments: 2, stiffness: 3, damping: 2 };
const PARAMETERS: usize = LAYOUT.parameters();

/// An 18 gauge needle of 130 mm on a fixture of 0.3 kg.
fn modes() -> [Mode<f64>; MODES] {
    let mode = |a: f64, frequency_rad_s: f64, base: f64| {
        // Modes of a clamped needle are close enough; all that is tested here holds for any shape.
        let (sin, cos) = a.sin_cos();
        let sine = (sin.mul_add(1.0, cos)) / (cos - sin + (-a).exp());
        Mode { wave_number_per_m: a / 0.13, frequency_rad_s, factors: [base - 45.0 * sine, 45.0, 45.0, 45.0] }
    };
    [mode(1.8756, 424.6, -0.06), mode(4.6945, 2659.9, 0.03), mode(7.855, 7447.0, -0.02)]
}

fn settings() -> Settings<f64, MODES> {
    Settings { layout: LAYOUT, ..Settings::new(0.13, 0.3, modes()) }
}

/// Goes in at 4 mm/s and sideways with a wobble.
fn rows() -> Vec<Row<f64>> {
    (1..40)
        .map(|i| {
            let depth_m = 1.1e-3 * f64::from(i);
            Row {
                step_s: 0.27,
                depth_m,
                base_m: 0.2 * depth_m + 1e-3 * (0.4 * f64::from(i)).sin(),
                force_n: 0.0,
                tip_m: 0.0,
                samples: 10.0,
            }
        })
        .collect()
}

/// Force and tip of the last row, and their derivatives.
fn last(parameters: &[f64; PARAMETERS]) -> ([f64; 2], [[f64; PARAMETERS]; 2]) {
    let settings = settings();
    let shape = Shape::new(settings.modes, settings.length_m, settings.cell_m);
    let mut field = Field::<f64, CELLS>::new(LAYOUT, settings.cell_m, 0.02, 0.0);
    field.set(parameters, CELLS);
    let mut simulation =
        Simulation::<f64, MODES, CELLS, PARAMETERS>::new(settings.cell_m, settings.length_m, 0.3, 0.0);
    let mut latest = ([0.0; 2], [[0.0; PARAMETERS]; 2]);
    for row in rows() {
        let predicted = simulation.predict(&shape, &field, &row).expect("regular");
        latest = ([predicted.force_n, predicted.tip_m], [predicted.force_by, predicted.tip_by]);
        simulation.advance(&row, &predicted, 0.0);
    }
    latest
}

/// Through forty rows, the path that they cut and the dampers' memory.
#[test]
fn derivatives_are_those_of_the_whole_insertion() {
    let parameters = [9.5, 0.3, -0.1, 10.2, -0.2, 0.05, 1.5, 0.2, 0.8, -0.1, 0.0, 0.0];
    let (_, derivatives) = last(&parameters);
    for index in 0..PARAMETERS - 2 {
        let at = |step: f64| {
            let mut moved = parameters;
            moved[index] += step;
            last(&moved).0
        };
        let (upper, lower) = (at(1e-4), at(-1e-4));
        for channel in 0..2 {
            let difference = (upper[channel] - lower[channel]) / 2e-4;
            let derivative = derivatives[channel][index];
            let scale = derivatives[channel].iter().fold(0.0_f64, |most, by| most.max(by.abs()));
            assert!(
                (derivative - difference).abs() < 1e-5 * scale,
                "{channel} {index}: {derivative} {difference}"
            );
        }
    }
}

/// The values from cell to cell are those of the functions evaluated there.
#[test]
fn mode_values_from_cell_to_cell_equal_evaluated_modes() {
    let shape = Shape::new(modes(), 0.13, 2e-3);
    for (cell, stepped) in shape.mode_values(0.031).take(45).enumerate() {
        let evaluated = shape.at(0.031 + 2e-3 * cell as f64);
        for (stepped, evaluated) in stepped.iter().zip(evaluated) {
            assert!((stepped - evaluated).abs() < 1e-10, "{cell}: {stepped} {evaluated}");
        }
    }
}

#[test]
fn a_layout_that_does_not_fit_is_refused() {
    let make = |layout| Tracker::<f64, MODES, CELLS, PARAMETERS, 16>::new(Settings { layout, ..settings() });
    assert!(make(LAYOUT).is_some());
    for layout in [
        Layout { segments: 1, ..LAYOUT },
        Layout { segments: 0, ..LAYOUT },
        Layout { stiffness: 9, damping: 0, segments: 1 },
        Layout { stiffness: 5, damping: 0, segments: 2 },
    ] {
        assert!(make(layout).is_none(), "{layout:?}");
    }
}

/// A memory of sixteen rows for forty: nothing stops, and the tissue is found about as well.
#[test]
fn a_full_memory_is_condensed() {
    let truth = [9.6, 0.0, 0.0, 9.9, 0.0, 0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.0];
    let settings =
        Settings { segment_m: 0.02, force_sd_n: 0.01, tip_sd_m: 1e-4, base_sd_m: 1e-5, ..settings() };
    let shape = Shape::new(settings.modes, settings.length_m, settings.cell_m);
    let mut field = Field::<f64, CELLS>::new(LAYOUT, settings.cell_m, settings.segment_m, settings.reach_m);
    field.set(&truth, CELLS);
    let mut simulation =
        Simulation::<f64, MODES, CELLS, PARAMETERS>::new(settings.cell_m, settings.length_m, 0.3, 0.0);
    let mut small = Tracker::<f64, MODES, CELLS, PARAMETERS, 16>::new(settings).expect("fits");
    let mut large = Tracker::<f64, MODES, CELLS, PARAMETERS, 128>::new(settings).expect("fits");
    let mut time_s = 0.0;
    for i in 0..800 {
        let depth_m = 0.055e-3 * f64::from(i);
        let base_m = 0.2 * depth_m;
        time_s += 0.02;
        let step_s = if i == 0 { 1.0 } else { 0.02 };
        let row = Row { step_s, depth_m, base_m, force_n: 0.0, tip_m: 0.0, samples: 1.0 };
        let predicted = simulation.predict(&shape, &field, &row).expect("regular");
        let sample = Sample { time_s, depth_m, base_m, force_n: predicted.force_n, tip_m: predicted.tip_m };
        simulation.advance(&row, &predicted, 0.0);
        small.update(&sample).expect("taken");
        large.update(&sample).expect("taken");
    }
    for estimate in [small.finish().expect("rows"), large.finish().expect("rows")] {
        let mean = 0.5 * (9.6_f64.exp() + 9.9_f64.exp());
        assert!((estimate.stiffness.value / mean - 1.0).abs() < 0.1, "{estimate:?} {mean}");
    }
}

fn number() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -0.2_f32..0.2,
        1 => prop::num::f32::ANY,
    ]
}

proptest! {
    /// Any input, in single precision and with a small memory: no panic, and every number that comes out is one, with
    /// stiffness above and damping not below nothing.
    #[test]
    fn any_input_leaves_numbers(
        samples in prop::collection::vec((0.0_f32..0.5, number(), number(), number(), number()), 1..200),
        start in (1e-3_f32..1e12, 0.0_f32..1e12),
    ) {
        let settings = Settings {
            layout: LAYOUT,
            start: [start.0, start.1],
            ..Settings::new(0.13, 0.3, modes().map(|mode| Mode {
            wave_number_per_m: mode.wave_number_per_m as f32,
            frequency_rad_s: mode.frequency_rad_s as f32,
            factors: mode.factors.map(|factor| factor as f32),
        }))
        };
        let mut tracker = Tracker::<f32, MODES, CELLS, PARAMETERS, 16>::new(settings).expect("fits");
        let mut time_s = 0.0;
        for (step_s, depth_m, base_m, force_n, tip_m) in samples {
            time_s += step_s;
            let sample = Sample { time_s, depth_m: depth_m * 0.3, base_m, force_n, tip_m };
            let estimates = tracker.update(&sample).ok().flatten().into_iter().chain(tracker.finish());
            for estimate in estimates {
                for value in [estimate.stiffness, estimate.damping] {
                    prop_assert!(value.value.is_finite() && value.low.is_finite(), "{estimate:?}");
                    prop_assert!(value.low <= value.high, "{estimate:?}");
                }
                prop_assert!(estimate.stiffness.value > 0.0 && estimate.damping.value >= 0.0, "{estimate:?}");
                prop_assert!(estimate.tip_m.is_finite() && estimate.misfit.is_finite(), "{estimate:?}");
            }
        }
    }
}
