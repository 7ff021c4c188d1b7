//! Growth of cost: times at four or five sizes, and the exponent by least squares in logarithms with its 95 % interval.

use crate::clock::Clock;
use crate::{forward, session};
use anyhow::{Context, Result};
use inference::{LateralData, Parameter, effect_parameters, fit};
use mechanics::effects::effect;
use mechanics::elements::{Elements, Guide2};
use mechanics::growth::{NodeLoads, GrowingBeam, Guide2Grip};
use mechanics::insertion::grid_m;
use mechanics::modes::RayleighRitz;
use mechanics::steering::{BaseDrive, Dynamics, Steering, simulate};
use mechanics::{BeamProblem, Foundation, Layer, Needle};
use formats::session::Session;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::path::Path;

/// One law of growth.
pub struct Growing {
    /// Quantity that grows.
    pub name: &'static str,
    /// Its sizes.
    pub sizes: Vec<usize>,
    /// Seconds at each.
    pub seconds: Vec<f64>,
    /// Theoretical exponent for large sizes.
    pub theory: f64,
    /// Why.
    pub why: &'static str,
    /// Exponent and half of its 95 % interval.
    pub exponent: [f64; 2],
}

/// Slope in logarithms, and half of its 95 % interval.
fn exponent(sizes: &[usize], seconds: &[f64]) -> Result<[f64; 2]> {
    let x: Vec<f64> = sizes.iter().map(|size| (*size as f64).ln()).collect();
    let y: Vec<f64> = seconds.iter().map(|seconds| seconds.ln()).collect();
    let n = x.len() as f64;
    let (mean_x, mean_y) = (x.iter().sum::<f64>() / n, y.iter().sum::<f64>() / n);
    let square: f64 = x.iter().map(|x| (x - mean_x).powi(2)).sum();
    let slope = x.iter().zip(&y).map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / square;
    let variance = x.iter().zip(&y).map(|(x, y)| (y - mean_y - slope * (x - mean_x)).powi(2)).sum::<f64>() / (n - 2.0);
    let quantile = StudentsT::new(0.0, 1.0, n - 2.0)?.inverse_cdf(0.975);
    Ok([slope, quantile * (variance / square).sqrt()])
}

struct Study<'c> {
    clock: &'c mut Clock,
    all: Vec<Growing>,
}

impl Study<'_> {
    fn grow<W: FnMut() -> T, T>(
        &mut self,
        name: &'static str,
        sizes: &[usize],
        (theory, why): (f64, &'static str),
        work_of: impl Fn(usize) -> Result<W>,
    ) -> Result<()> {
        let mut seconds = Vec::new();
        for size in sizes {
            seconds.push(self.clock.seconds(&format!("{name} {size}"), work_of(*size)?)?);
        }
        let exponent = exponent(sizes, &seconds)?;
        self.all.push(Growing { name, sizes: sizes.to_vec(), seconds, theory, why, exponent });
        Ok(())
    }
}

/// Measures all of them.
pub fn measure(clock: &mut Clock, cache: &Path) -> Result<Vec<Growing>> {
    let mut study = Study { clock, all: Vec::new() };
    let rig = forward::rig();
    let uniform = Foundation::uniform(16e3)?;
    study.grow(
        "beam: layers",
        &[16, 32, 64, 128, 256],
        (1.0, "two sweeps, a piece per layer"),
        |layers| {
            let upper = (1..layers).map(|i| Layer {
                bottom_m: mechanics::DEPTH_M * i as f64 / layers as f64,
                modulus_pa: 1e3 * (10 + i % 7) as f64,
            });
            let foundation = Foundation::layered(upper.collect(), 16e3)?;
            let problem = BeamProblem::new(&rig, foundation, mechanics::DEPTH_M);
            Ok(move || problem.solve().expect("solves"))
        },
    )?;
    study.grow(
        "finite elements: elements",
        &[200, 400, 800, 1600, 3200],
        (1.0, "a banded system per Newton step"),
        |count| {
            let problem = BeamProblem::new(&rig, uniform.clone(), mechanics::DEPTH_M);
            let elements = Elements::new(&problem, 0.1 / count as f64)?;
            let springs = uniform.clone();
            Ok(move || elements.solve(&springs, |_| 0.0, Guide2::Force(1.0), 0.0).expect("solves"))
        },
    )?;
    study.grow(
        "Rayleigh-Ritz: modes",
        &[8, 16, 32, 64],
        (3.0, "modes squared integrals with panels per mode"),
        |modes| {
            let problem = BeamProblem::new(&rig, uniform.clone(), mechanics::DEPTH_M);
            Ok(move || RayleighRitz::solve(&problem, modes).expect("solves"))
        },
    )?;
    study.grow("steering: modes", &[4, 6, 8, 12, 16], (3.0, "a dense system per step"), |modes| {
        let dynamics = Dynamics { modes, ..Dynamics::steel(&Needle::gauge_18(), 0.13, 0.3) };
        let time_s: Vec<f64> = (0..21).map(|i| 0.01 * f64::from(i)).collect();
        let depth_m = time_s.iter().map(|t| 0.04 + 0.01 * t).collect();
        let drive = BaseDrive::Position(time_s.iter().map(|t| 1e-3 * t).collect());
        let steering = Steering { time_s, depth_m, drive };
        let foundation = uniform.clone();
        Ok(move || simulate(&Needle::gauge_18(), &foundation, &dynamics, &steering).expect("a run"))
    })?;
    study.grow(
        "insertion: depth steps",
        &[140, 280, 560, 1120],
        (2.0, "a back substitution per step"),
        |steps| {
            let problem = forward::insertion_model().problem(0.14)?;
            Ok(move || {
                let nodes_m = grid_m(0.14, 0.14 / steps as f64, &[]);
                let growth = GrowingBeam::without_slopes(&problem, nodes_m, Guide2Grip::Holding).expect("grows");
                growth.under_load(|_| NodeLoads { load_n: [0.2; 2], guide2_m: [0.0; 2] })
            })
        },
    )?;
    let fitted = |unknowns: Vec<Parameter>, data: Vec<LateralData>| {
        Ok(move || fit(&unknowns, &data).map(|fit| fit.chi_square).expect("fits"))
    };
    study.grow(
        "identification: shape samples",
        &[1000, 2000, 4000, 8000],
        (1.0, "residuals"),
        |samples| fitted(vec![forward::LN_K], vec![forward::run(samples)]),
    )?;
    study.grow(
        "identification: runs",
        &[8, 16, 32, 64, 128],
        (1.0, "runs are eliminated one by one"),
        |runs| fitted(vec![forward::LN_K], vec![forward::run(40); runs]),
    )?;
    let nuisances = [
        "rig.frame_compliance",
        "sensor.force_gain",
        "needle.stiffness",
        "rig.clamp_compliance",
        "sensor.shape_scale",
        "needle.axial_load",
        "tissue.shear",
        "tissue.skin",
    ];
    study.grow(
        "identification: effects",
        &[1, 2, 4, 8],
        (1.0, "at most: two model runs per unknown and step, and some that do not grow"),
        |count| {
            let effects = nuisances.iter().take(count).map(|id| effect(id).with_context(|| (*id).to_owned()));
            let effects = effects.collect::<Result<Vec<_>>>()?;
            let mut unknowns = vec![forward::LN_K];
            unknowns.extend(effect_parameters(&effects));
            fitted(unknowns, vec![LateralData { effects, ..forward::run(40) }])
        },
    )?;
    study.grow(
        "session load: rows",
        &[2500, 5000, 10_000, 20_000],
        (1.0, "a pass over the text"),
        |rows| {
            let folder = cache.join(format!("session-{rows}"));
            session::write(&folder, rows)?;
            Ok(move || Session::read(&folder).expect("a session"))
        },
    )?;
    Ok(study.all)
}
