//! The plan against simulated sessions: the promised half-width beside the scatter of K over sessions that are simulated and identified.

use formats::NORMAL_975;
use formats::model_file::ModelFile;
use formats::session::{Noise, Session};
use inference::identify::{FoundationChoice, Options, identify};
use inference::plan::{Limits, PlanInput, plan};
use mechanics::{Needle, Rig, Support};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use simulation::simulate::{Axis, LateralPlan, Sensors, SimulationPlan, SweepLevels};
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Zero of the force after a tare, N: what a plan assumes where no hold measures it.
const ZERO_SD_N: f64 = 0.01;

/// A run that could be made.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyProtocol {
    /// Its name.
    pub name: &'static str,
    /// Foundation modulus.
    pub modulus_pa: f64,
    /// Position of guide 2.
    pub guide2_m: f64,
    /// Insertion depth.
    pub depth_m: f64,
    /// Displacement of guide 2.
    pub displacement_m: f64,
    /// Holds, as multiples of the displacement.
    pub levels: Vec<f64>,
    /// Readings per second.
    pub rate_hz: f64,
    /// Length of a hold.
    pub hold_s: f64,
    /// Distance between points of the shape.
    pub spacing_m: f64,
    /// Standard deviations of single readings.
    pub sensors: Sensors,
}

/// Promised and observed interval.
#[derive(Debug, Clone, PartialEq)]
pub struct StudyRow {
    /// Name of the protocol.
    pub name: &'static str,
    /// Half-width of the plan.
    pub promised_percent: f64,
    /// 1.96 standard deviations of ln K over the sessions.
    pub observed_percent: f64,
    /// Sessions whose stated interval holds the truth.
    pub covered: usize,
    /// Sessions.
    pub sessions: usize,
}

impl StudyRow {
    /// Promised over observed.
    pub fn ratio(&self) -> f64 {
        self.promised_percent / self.observed_percent
    }

    /// 95 % interval of that ratio, were there as many sessions as one likes: what the scatter of so few determines (chi-square).
    pub fn ratio_ci95(&self) -> [f64; 2] {
        let freedom = self.sessions as f64 - 1.0;
        [0.025, 0.975].map(|share| self.ratio() * ratio_bound(share, freedom))
    }
}

fn ratio_bound(share: f64, freedom: f64) -> f64 {
    ChiSquared::new(freedom).map_or(f64::NAN, |chi| (chi.inverse_cdf(share) / freedom).sqrt())
}

/// Seven protocols that differ in all that a lab can choose: rate, hold, depth, displacement, guide, spacing, noise, tissue.
pub fn protocols() -> Vec<StudyProtocol> {
    let example = StudyProtocol {
        name: "example: 20 mm, 1.2 mm, 20 Hz",
        modulus_pa: 12e3,
        guide2_m: 0.06,
        depth_m: 0.02,
        displacement_m: 1.2e-3,
        levels: vec![0.0, 1.0],
        rate_hz: 20.0,
        hold_s: 3.0,
        spacing_m: 1e-3,
        sensors: sensors(0.02, 0.01, 0.025),
    };
    vec![
        example.clone(),
        StudyProtocol {
            name: "40 mm, 0.8 mm, 20 Hz",
            depth_m: 0.04,
            displacement_m: 0.8e-3,
            ..example.clone()
        },
        StudyProtocol {
            name: "30 mm, 1 mm, device at 1 kHz",
            depth_m: 0.03,
            displacement_m: 1e-3,
            rate_hz: 1000.0,
            hold_s: 1.0,
            sensors: sensors(0.05, 0.02, 0.03),
            ..example.clone()
        },
        StudyProtocol {
            name: "30 mm, there and back, 50 Hz",
            depth_m: 0.03,
            levels: vec![0.0, 0.5, 1.0, 0.5, 0.0],
            rate_hz: 50.0,
            ..example.clone()
        },
        StudyProtocol {
            name: "60 mm in stiff tissue, guide 2 at 45 mm",
            modulus_pa: 40e3,
            guide2_m: 0.045,
            depth_m: 0.06,
            spacing_m: 2e-3,
            ..example.clone()
        },
        StudyProtocol {
            name: "12 mm in soft tissue, both ways",
            modulus_pa: 4e3,
            depth_m: 0.012,
            displacement_m: 2e-3,
            levels: vec![0.0, 1.0, -1.0, 0.0],
            spacing_m: 0.5e-3,
            ..example.clone()
        },
        StudyProtocol {
            name: "25 mm without a hold at zero, coarse force",
            depth_m: 0.025,
            levels: vec![1.0],
            hold_s: 10.0,
            sensors: sensors(0.2, 0.005, 0.05),
            ..example
        },
    ]
}

fn sensors(force_n: f64, displacement_mm: f64, shape_mm: f64) -> Sensors {
    Sensors {
        force_n,
        displacement_m: 1e-3 * displacement_mm,
        shape_m: 1e-3 * shape_mm,
        tip_m: 0.05e-3,
        tip_direction_rad: None,
    }
}

impl StudyProtocol {
    fn rig(&self) -> Rig {
        Rig::two_guides(Needle::gauge_18(), self.guide2_m, 0.07)
    }

    /// The question whose answer is the promise.
    pub fn question(&self) -> PlanInput {
        PlanInput {
            rig: self.rig(),
            support: Support::Springs,
            poisson_sd: 0.0,
            walls: None,
            modulus_range_pa: [self.modulus_pa; 2],
            force_sd_n: self.sensors.force_n,
            displacement_sd_m: self.sensors.displacement_m,
            shape_sd_m: self.sensors.shape_m,
            shape_spacing_m: self.spacing_m,
            rate_hz: self.rate_hz,
            hold_s: self.hold_s,
            levels: self.levels.clone(),
            nuisances: Vec::new(),
            depths_m: vec![self.depth_m],
            displacements_m: vec![self.displacement_m],
            guide2_m: vec![self.guide2_m],
            limits: Limits { force_n: 100.0, needle_strain: 1.0, deflection_m: 1.0 },
        }
    }

    /// A session of one run.
    fn session(&self, seed: u64) -> Option<Session> {
        let model = ModelFile { modulus_pa: Some(self.modulus_pa), ..ModelFile::default() };
        let lateral = LateralPlan {
            id: "r".to_owned(),
            depth_m: self.depth_m,
            axis: Axis::Y,
            levels_m: self.levels.iter().map(|level| level * self.displacement_m).collect(),
            hold_s: self.hold_s,
            ramp_m_per_s: 1e-3,
            rate_hz: self.rate_hz,
            sweep_levels: SweepLevels::Extremes,
            spacing_m: self.spacing_m,
        };
        let simulation_plan = SimulationPlan { model, lateral: vec![lateral], insertion: Vec::new() };
        let mut simulated = simulation_plan.carry_out(&self.rig(), self.sensors, seed).ok()?;
        // Drift of the zero after a tare.
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let drawn: f64 = StandardNormal.sample(&mut random);
        let zero_n = ZERO_SD_N * drawn;
        simulated
            .lateral
            .iter_mut()
            .flat_map(|run| &mut run.force.force_y_n)
            .for_each(|force_n| *force_n += zero_n);
        Some(Session {
            dir: "simulated".into(),
            name: None,
            rig: self.rig(),
            fixture_mass_kg: None,
            noise: Noise {
                force_zero_n: Some(ZERO_SD_N),
                force_n: Some(self.sensors.force_n),
                displacement_m: Some(self.sensors.displacement_m),
                shape_m: Some(self.sensors.shape_m),
                tip_m: None,
                tip_direction_rad: None,
            },
            tissue: Default::default(),
            lateral: simulated.lateral,
            insertion: Vec::new(),
            indentation: Vec::new(),
            steering: Vec::new(),
        })
    }

    /// Promise and scatter over so many sessions; `None` where the plan or a session fails.
    pub fn compare(&self, sessions: usize, seed: u64) -> Option<StudyRow> {
        let promised_percent = plan(&self.question()).ok()?.choices.first()?.half_width_percent;
        let truth_kpa = 1e-3 * self.modulus_pa;
        // K of springs is what is planned.
        let options =
            Options { foundation: Some(FoundationChoice::Springs), model_error: false, ..Options::default() };
        let (mut logs, mut covered) = (Vec::new(), 0);
        for number in 0..sessions as u64 {
            let session = self.session(seed.wrapping_mul(1_000_003).wrapping_add(number))?;
            let pooled = identify(&session, &options).ok()?.pooled;
            logs.push((pooled.k_kpa / truth_kpa).ln());
            covered += usize::from((pooled.ci95_kpa[0]..=pooled.ci95_kpa[1]).contains(&truth_kpa));
        }
        let (_, sd) = inference::modulus::mean_and_sd(&logs)?;
        let observed_percent = 100.0 * ((NORMAL_975 * sd).exp() - 1.0);
        Some(StudyRow { name: self.name, promised_percent, observed_percent, covered, sessions })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Promised over observed: 24 sessions determine a standard deviation to 15 %, seven protocols together to 5.5 %.
    #[test]
    fn planned_intervals_agree_with_the_scatter_of_simulated_sessions() {
        const SESSIONS: usize = 24;
        let protocols = protocols();
        let rows: Vec<StudyRow> = (1..)
            .zip(&protocols)
            .map(|(seed, protocol)| protocol.compare(SESSIONS, seed).expect("a session and its plan"))
            .collect();
        for row in &rows {
            println!(
                "{:<45} {:.3} % promised, {:.3} % observed",
                row.name, row.promised_percent, row.observed_percent
            );
            assert!((0.68..1.5).contains(&promised_over_observed(row)), "{row:?}");
            assert!(row.covered >= 19, "{row:?}");
        }
        let mean_ratio =
            (rows.iter().map(|row| promised_over_observed(row).ln()).sum::<f64>() / rows.len() as f64).exp();
        assert!((0.86..1.16).contains(&mean_ratio), "{mean_ratio}");
        // An interval that is promised to be half as wide is narrower.
        for (a, b) in rows.iter().flat_map(|a| rows.iter().map(move |b| (a, b))) {
            if a.promised_percent < 0.6 * b.promised_percent {
                assert!(a.observed_percent < b.observed_percent, "{a:?} {b:?}");
            }
        }
    }

    fn promised_over_observed(row: &StudyRow) -> f64 {
        row.promised_percent / row.observed_percent
    }
}
