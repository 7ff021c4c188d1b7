//! Expected interval of a run, over depth and displacement: the plan of the program for the rig of a session, or for a
//! standard one.

use crate::answer::AnswerError;
use crate::drawing::Figure;
use crate::results::json;
use formats::session::{FoundationKind, Setup, template};
use inference::diagnose::INCOMPRESSIBLE;
use inference::plan::{Limits, PlanInput, plan as planned};
use mechanics::Support;
use mechanics::unknowns::sensors;
use serde::Deserialize;
use std::path::{Path, PathBuf};

const SPACING_M: f64 = 1e-3;
const RATE_HZ: f64 = 20.0;
const LEVELS: [f64; 2] = [0.0, 1.0];
/// Largest number of depths or displacements of one map.
const MAX_VALUES: usize = 40;
const MM: f64 = 1e-3;

/// Request of a plan: the range of the modulus, the runs of the map, and limits.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// Folder of the session whose rig and noise are used; a standard needle and rig without one.
    #[serde(default)]
    pub dir: Option<PathBuf>,
    /// Moduli that the tissue may have, least and greatest: K, or E where the session states a body.
    pub modulus_kpa: [f64; 2],
    /// Insertion depths.
    pub depth_mm: Vec<f64>,
    /// Displacements of guide 2.
    pub displacement_mm: Vec<f64>,
    /// Length of a hold.
    pub hold_s: f64,
    /// Largest lateral force.
    pub force_limit_n: f64,
    /// Largest strain of the needle.
    pub strain_limit_percent: f64,
    /// Largest deflection in the tissue.
    pub deflection_limit_mm: f64,
}

impl PlanRequest {
    fn input(&self) -> Result<PlanInput, AnswerError> {
        let setup = match &self.dir {
            Some(dir) => Setup::read(&dir.join("session.toml"))?,
            None => Setup::parse(Path::new("standard rig"), template::SESSION)?,
        };
        for (name, values) in [("depth_mm", &self.depth_mm), ("displacement_mm", &self.displacement_mm)] {
            if values.len() > MAX_VALUES {
                let expected = format!("at most {MAX_VALUES}");
                return Err(AnswerError::Value { name, value: format!("{} values", values.len()), expected });
            }
        }
        for (name, value) in [
            ("force_limit_n", self.force_limit_n),
            ("strain_limit_percent", self.strain_limit_percent),
            ("deflection_limit_mm", self.deflection_limit_mm),
        ] {
            if !(value.is_finite() && value > 0.0) {
                let expected = "a positive number".to_owned();
                return Err(AnswerError::Value { name, value: value.to_string(), expected });
            }
        }
        let [least, most] = self.modulus_kpa;
        if least > most {
            let value = format!("{least} to {most}");
            let expected = "the least modulus before the greatest".to_owned();
            return Err(AnswerError::Value { name: "modulus_kpa", value, expected });
        }
        let Setup { rig, noise, tissue, .. } = setup;
        let support = match tissue.foundation {
            Some(FoundationKind::Body) => {
                Support::Body { poisson: tissue.poisson.unwrap_or(INCOMPRESSIBLE), block: tissue.block() }
            }
            _ => Support::Springs,
        };
        Ok(PlanInput {
            support,
            poisson_sd: tissue.poisson_sd.unwrap_or(0.0),
            walls: tissue.walls,
            modulus_range_pa: self.modulus_kpa.map(|kpa| 1e3 * kpa),
            force_sd_n: noise.force_n.unwrap_or(sensors::FORCE_NOISE.mean()),
            displacement_sd_m: noise.displacement_m.unwrap_or(sensors::DISPLACEMENT_NOISE.mean()),
            shape_sd_m: noise.shape_m.unwrap_or(sensors::SHAPE_NOISE.mean()),
            shape_spacing_m: SPACING_M,
            rate_hz: RATE_HZ,
            hold_s: self.hold_s,
            levels: LEVELS.to_vec(),
            nuisances: Vec::new(),
            depths_m: metres(&self.depth_mm),
            displacements_m: metres(&self.displacement_mm),
            guide2_m: vec![rig.guide2_m],
            limits: Limits {
                force_n: self.force_limit_n,
                needle_strain: 1e-2 * self.strain_limit_percent,
                deflection_m: MM * self.deflection_limit_mm,
            },
            rig,
        })
    }
}

fn metres(mm: &[f64]) -> Vec<f64> {
    mm.iter().map(|mm| MM * mm).collect()
}

/// Result of `guide plan`.
pub fn plan(request: &PlanRequest) -> Result<String, AnswerError> {
    let plan_result = planned(&request.input()?)?;
    let title = "Half-width of the 95 % interval over insertion depth, for every displacement".to_owned();
    let drawn = vec![Figure::new("plan".to_owned(), title, figures::plan(&plan_result)?)];
    json(plan_result, drawn)
}
