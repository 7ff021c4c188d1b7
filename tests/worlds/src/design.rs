//! Measurements and their precision.

use super::MM;
use formats::session::Noise;

/// Runs of a session and its instruments.
#[derive(Debug, Clone, PartialEq)]
pub struct Design {
    /// Lateral runs.
    pub lateral: Vec<LateralPlan>,
    /// Insertions.
    pub insertion: Vec<InsertionPlan>,
    /// Its instruments.
    pub noise: NoisePlan,
    /// Images of the shape, if the session states them.
    pub images: Option<ImagePlan>,
}

/// A probe over the needle that sweeps forth in one hold and back in the next.
#[derive(Debug, Clone, PartialEq)]
pub struct ImagePlan {
    /// Direction of the beam in the plane across the needle, from x towards y.
    pub beam_deg: f64,
    /// Speed of the probe.
    pub speed_mm_per_s: f64,
}

impl Default for ImagePlan {
    /// From above, at 5 mm/s.
    fn default() -> Self {
        Self { beam_deg: -90.0, speed_mm_per_s: 5.0 }
    }
}

/// A lateral run: guide 2 goes from rest to one level after the other and holds each.
#[derive(Debug, Clone, PartialEq)]
pub struct LateralPlan {
    /// Name of the run.
    pub id: String,
    /// Insertion depth; rounded to the grid of half a millimetre.
    pub depth_mm: f64,
    /// Plane in which guide 2 moves: 0 for y, 1 for x.
    pub axis: usize,
    /// Displacements that are held.
    pub levels_mm: Vec<f64>,
    /// Duration of each hold.
    pub hold_s: f64,
    /// Speed between them.
    pub ramp_mm_per_s: f64,
}

/// An insertion at constant speed.
#[derive(Debug, Clone, PartialEq)]
pub struct InsertionPlan {
    /// Name of the run.
    pub id: String,
    /// Final depth; rounded to the grid of half a millimetre.
    pub depth_mm: f64,
    /// Speed.
    pub speed_mm_per_s: f64,
    /// Depth at which the needle is turned by 180 degrees, at rest; the row at this depth is from before
    /// the turn.
    pub turn_at_mm: Option<f64>,
    /// Steps of guide 2 at rest, in order of depth; each step has a row before it and one after it.
    pub guide2_steps: Vec<GuideStep>,
}

/// A step of guide 2 at rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuideStep {
    /// Depth of the tip; rounded to the grid of half a millimetre.
    pub depth_mm: f64,
    /// Target of guide 2, vertically and horizontally.
    pub to_mm: [f64; 2],
}

/// Errors of the instruments.
#[derive(Debug, Clone, PartialEq)]
pub struct NoisePlan {
    /// Standard deviation of a force reading; half of its variance is correlated in time.
    pub force_n: f64,
    /// Correlation time of that half.
    pub force_correlation_s: f64,
    /// Step to which forces are rounded; 0 for none.
    pub force_step_n: f64,
    /// Standard deviation of the displacement of guide 2.
    pub displacement_mm: f64,
    /// Standard deviation of the shape before rounding; 30 % of its variance is correlated along the needle.
    pub shape_mm: f64,
    /// Correlation length of that part.
    pub shape_correlation_mm: f64,
    /// Pixel to which the shape is rounded; 0 for none.
    pub pixel_mm: f64,
    /// Standard deviation of the tip position.
    pub tip_mm: f64,
    /// Share of force, shape and tip samples that are off by 6 to 12 standard deviations.
    pub outlier_share: f64,
    /// Samples of force and displacement per second.
    pub rate_hz: f64,
    /// Whether the session states its noise.
    pub stated: bool,
}

impl Default for NoisePlan {
    fn default() -> Self {
        Self {
            force_n: 0.02,
            force_correlation_s: 0.15,
            force_step_n: 0.005,
            displacement_mm: 0.01,
            shape_mm: 0.02,
            shape_correlation_mm: 2.0,
            pixel_mm: 0.05,
            tip_mm: 0.05,
            outlier_share: 0.005,
            rate_hz: 20.0,
            stated: true,
        }
    }
}

impl NoisePlan {
    /// Perfect instruments at the same rate.
    pub fn none(&self) -> Self {
        Self {
            force_n: 0.0,
            force_step_n: 0.0,
            displacement_mm: 0.0,
            shape_mm: 0.0,
            pixel_mm: 0.0,
            tip_mm: 0.0,
            outlier_share: 0.0,
            ..self.clone()
        }
    }

    /// A quiet force sensor, as on a bench: the zero of a tare is far above what a hold's mean scatters by.
    pub fn quiet_force() -> Self {
        Self { force_n: 0.005, force_step_n: 0.0005, ..Self::default() }
    }

    /// As a careful laboratory states it: rounding of the shape counted, correlation and outliers not.
    pub(super) fn statement(&self) -> Noise {
        Noise {
            force_n: Some(self.force_n),
            force_zero_n: None,
            displacement_m: Some(MM * self.displacement_mm),
            shape_m: Some(MM * self.shape_mm.hypot(self.pixel_mm / 12f64.sqrt())),
            tip_m: Some(MM * self.tip_mm),
            tip_direction_rad: None,
        }
    }
}

const AXES: [&str; 2] = ["y", "x"];

/// The usual staircase at a depth; `take` distinguishes repeats.
fn staircase(axis: usize, depth_mm: f64, take: &str) -> LateralPlan {
    LateralPlan {
        id: format!("{}{depth_mm:.0}{take}", AXES[axis]),
        depth_mm,
        axis,
        levels_mm: vec![0.0, 0.4, 0.8, 1.2, 0.8, 0.0, -0.6, -1.2, 0.0],
        hold_s: 3.0,
        ramp_mm_per_s: 1.0,
    }
}

fn guide2_steps(steps: &[(f64, [f64; 2])]) -> Vec<GuideStep> {
    steps.iter().map(|&(depth_mm, to_mm)| GuideStep { depth_mm, to_mm }).collect()
}

impl Design {
    fn of(lateral: Vec<LateralPlan>, insertion: Vec<InsertionPlan>) -> Self {
        Self { lateral, insertion, noise: NoisePlan::default(), images: None }
    }

    /// Both axes at 20, 30 and 40 mm, y twice.
    pub fn nine_runs() -> Self {
        Self::nine_runs_at([20.0, 30.0, 40.0])
    }

    /// Both axes at three depths, y twice.
    pub fn nine_runs_at(depths_mm: [f64; 3]) -> Self {
        let y = depths_mm.iter().flat_map(|mm| [staircase(0, *mm, "a"), staircase(0, *mm, "b")]);
        let x = depths_mm.iter().map(|mm| staircase(1, *mm, "a"));
        Self::of(y.chain(x).collect(), Vec::new())
    }

    /// The runs of [`Self::nine_runs`] with a shape of which it is known how it was imaged.
    pub fn imaged() -> Self {
        Self { images: Some(ImagePlan::default()), ..Self::nine_runs() }
    }

    /// The y axis at three depths and once more at 30 mm, the x axis at 30 mm.
    pub fn four_runs() -> Self {
        let y = [20.0, 30.0, 40.0].map(|mm| staircase(0, mm, "a"));
        let lateral = y.into_iter().chain([staircase(1, 30.0, "a"), staircase(0, 30.0, "b")]);
        Self::of(lateral.collect(), Vec::new())
    }

    /// Runs in air, twice in each axis: small holds on both sides of zero for the play, large ones for the compliances.
    pub fn in_air() -> Self {
        let lateral = vec![air_run(0, "a"), air_run(1, "a"), air_run(0, "b"), air_run(1, "b")];
        Self { noise: NoisePlan::quiet_force(), ..Self::of(lateral, Vec::new()) }
    }

    /// A few lateral runs and six insertions: three speeds, each straight on and turned halfway.
    pub fn insertions() -> Self {
        let lateral = [20.0, 40.0].iter().flat_map(|mm| [staircase(0, *mm, "a"), staircase(0, *mm, "b")]);
        let insertion = [2.0, 5.0, 8.0].into_iter().flat_map(|speed_mm_per_s: f64| {
            [("straight", None), ("turned", Some(50.0))].map(|(kind, turn_at_mm)| InsertionPlan {
                id: format!("insertion{speed_mm_per_s:.0}{kind}"),
                depth_mm: 100.0,
                speed_mm_per_s,
                turn_at_mm,
                guide2_steps: Vec::new(),
            })
        });
        Self::of(lateral.collect(), insertion.collect())
    }

    /// Eight insertions without any lateral run: straight on, turned, and with guide 2 moved at rest, once or twice.
    pub fn moved_insertions() -> Self {
        let plans = [
            straight(&[]),
            straight(&[(30.0, [0.8, 0.0]), (60.0, [-0.4, 0.3])]),
            turned(50.0, &[]),
            straight(&[(40.0, [0.0, -0.7]), (70.0, [0.6, -0.7])]),
            turned(40.0, &[]),
            straight(&[(30.0, [-0.6, 0.5])]),
            turned(60.0, &[(30.0, [0.7, 0.0])]),
            straight(&[(50.0, [0.9, 0.4])]),
        ];
        let insertion =
            plans.into_iter().zip(1..).map(|((turn_at_mm, guide2_steps), number)| InsertionPlan {
                id: format!("insertion{number}"),
                depth_mm: 100.0,
                speed_mm_per_s: 5.0,
                turn_at_mm,
                guide2_steps,
            });
        Self::of(Vec::new(), insertion.collect())
    }
}

fn turned(at_mm: f64, steps: &[(f64, [f64; 2])]) -> (Option<f64>, Vec<GuideStep>) {
    (Some(at_mm), guide2_steps(steps))
}

fn straight(steps: &[(f64, [f64; 2])]) -> (Option<f64>, Vec<GuideStep>) {
    (None, guide2_steps(steps))
}

fn air_run(axis: usize, take: &str) -> LateralPlan {
    LateralPlan {
        id: format!("{}-air{take}", AXES[axis]),
        depth_mm: 0.0,
        axis,
        levels_mm: vec![
            0.0, 0.15, 0.3, 0.6, 2.0, 4.0, 2.0, 0.6, 0.3, 0.15, 0.0, -0.15, -0.3, -0.6, -2.0, -4.0, -2.0,
            -0.6, 0.0,
        ],
        hold_s: 1.5,
        ramp_mm_per_s: 2.0,
    }
}
