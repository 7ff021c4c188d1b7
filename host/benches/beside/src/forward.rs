//! Beam, identification and insertion: what is measured, and the same problems as the peers in Python have them.

use crate::clock::Clock;
use anyhow::Result;
use inference::{
    Block, ForceZero, HoldData, LateralData, Measured, Parameter, ShapeDatum, SharedErrors, fit,
};
use mechanics::growth::{DEFAULT_STEP_M, GrowingBeam, Guide2Grip, NodeLoads};
use mechanics::insertion::grid_m;
use mechanics::{Beam, Foundation, Model, ModelError, Needle, Rig};
use std::cell::Cell;
use std::hint::black_box;

/// Length of the needle in the tissue, and places where its shape is computed.
pub const DEPTH_M: f64 = 0.03;
const SAMPLES: usize = 40;
const SHAPE_SD_M: f64 = 25e-6;
/// Deepest tip of the insertion.
const INSERTION_M: f64 = 0.14;

/// Time and result of one of our programs: compared with what peers give.
pub struct Own {
    /// Seconds.
    pub seconds: f64,
    /// Numbers.
    pub result: Vec<f64>,
}

impl Own {
    fn of(clock: &mut Clock, name: &str, work: impl Fn() -> Vec<f64>) -> Result<Self> {
        Ok(Self { result: work(), seconds: clock.seconds(name, &work)? })
    }
}

pub fn rig() -> Rig {
    Rig::two_guides(Needle::gauge_18(), 0.06, 0.07)
}

/// Positions at which the shape is computed: the centres of so many cells of the needle in the
/// tissue.
fn places(count: usize) -> impl Iterator<Item = f64> {
    (0..count).map(move |i| 0.07 + DEPTH_M * (i as f64 + 0.5) / count as f64)
}

/// The deflection at guide 2 and the shape at 40 places under 1 N at guide 2.
pub fn beam(clock: &mut Clock) -> Result<Own> {
    let (rig, foundation) = (rig(), Foundation::uniform(16e3)?);
    Own::of(clock, "beam solve", || {
        let beam = Beam::solve(black_box(&rig), &foundation, DEPTH_M).expect("solves");
        let response = beam.guide2_force();
        let positions_m: Vec<f64> = [rig.guide2_m].into_iter().chain(places(SAMPLES)).collect();
        response.deflections_m(&positions_m)
    })
}

/// Unknown ln K.
pub const LN_K: Parameter = Parameter { start: 9.0, step: 1e-4, least: 2.0, most: 16.0, prior: None };

/// A lateral run at 1.2 mm and K = 16 kPa with errors that repeat, with so many places of its shape.
pub fn run(samples: usize) -> LateralData {
    let beam = Beam::solve(&rig(), &Foundation::uniform(16e3).expect("a modulus"), DEPTH_M).expect("solves");
    let shape = places(samples).enumerate().map(|(i, z_m)| {
        let error_m = SHAPE_SD_M * (2.0 * i as f64).sin();
        ShapeDatum::new(z_m, [beam.deflection_m(1.2e-3, z_m) + error_m, 0.0])
    });
    let level = HoldData {
        displacement_m: vec![Measured { value: 1.205e-3, sd: 15e-6 }],
        force_n: vec![Measured { value: beam.force_n(1.2e-3) + 0.05, sd: 0.1 }],
        shape: shape.collect(),
    };
    LateralData {
        support: mechanics::Support::Springs,
        rig: rig(),
        depth_m: DEPTH_M,
        planes: 1,
        levels: vec![level],
        shape_sd_m: SHAPE_SD_M,
        force_zero: ForceZero::Exact,
        shared: SharedErrors::default(),
        uses_force: true,
        effects: Vec::new(),
        fixed: None,
    }
}

/// ln K, with the displacement of guide 2 as an unknown of its own.
pub fn identification(clock: &mut Clock) -> Result<Own> {
    let data = [run(SAMPLES)];
    Own::of(clock, "identification", || {
        let fit = fit(black_box(&[LN_K]), black_box(&data)).expect("fits");
        vec![fit.shared[0], 1e3 * fit.nuisances[0][0]]
    })
}

/// The model of an insertion to 140 mm.
pub fn insertion_model() -> Model {
    Model::uniform(Rig { entry_m: 0.085, ..rig() }, 12e3).expect("a model")
}

/// The tip at every 10 mm, mm, in steps of 0.5 mm.
pub fn insertion(clock: &mut Clock) -> Result<Own> {
    let problem = insertion_model().problem(INSERTION_M)?;
    Own::of(clock, "insertion", || {
        let nodes_m = grid_m(INSERTION_M, DEFAULT_STEP_M, &[]);
        let growth =
            GrowingBeam::without_slopes(black_box(&problem), nodes_m, Guide2Grip::Holding).expect("grows");
        let states = growth.under_load(|_| NodeLoads { load_n: [0.2; 2], guide2_m: [0.0; 2] });
        states.iter().step_by(20).skip(1).map(|state| 1e3 * state.tip_m[0]).collect()
    })
}

/// Number of needles that the identification solves.
pub fn model_runs() -> Result<usize> {
    struct Counted(LateralData, Cell<usize>);
    impl Block for Counted {
        type Prepared<'a> = <LateralData as Block>::Prepared<'a>;

        fn nuisances(&self) -> Vec<Parameter> {
            self.0.nuisances()
        }

        fn prepare(&self, shared: &[f64]) -> Result<Self::Prepared<'_>, ModelError> {
            self.1.set(self.1.get() + 1);
            self.0.prepare(shared)
        }

        fn residuals(&self, ready: &Self::Prepared<'_>, nuisances: &[f64]) -> Result<Vec<f64>, ModelError> {
            self.0.residuals(ready, nuisances)
        }
    }
    let data = [Counted(run(SAMPLES), Cell::new(0))];
    fit(&[LN_K], &data)?;
    Ok(data[0].1.get())
}
