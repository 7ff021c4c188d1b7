//! The function of a term.

use super::{Regressor, Site};
use crate::effects::ParameterInfo;

/// A function of one number with one parameter or two. All but `constant`, `toe`, `within`, `decay` and `polynomial` vanish at 0, so that what they change is told from the rest of
/// the model; what is a bump or a step elsewhere stays small there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Form {
    /// `a`.
    Constant,
    /// `a x`.
    Linear,
    /// `a x^2`.
    Quadratic,
    /// `a x^3`.
    Cubic,
    /// `a |x|`.
    Absolute,
    /// `a sign(x)`.
    Sign,
    /// `a x / sqrt(x^2 + b^2)`: towards a limit.
    Saturation,
    /// `a (1 - exp(-x / b))`: towards a limit, from 0 on.
    Exponential,
    /// `a` beyond `b`.
    Step,
    /// `a` up to `b`.
    Within,
    /// `a (1 - b / sqrt(x^2 + b^2))`, none about 0 and `a` far from it: a reaction with -1 goes towards a limit.
    Knee,
    /// `a b / sqrt(x^2 + b^2)`, `a` about 0 and none far from it: a reaction with -1 begins late, as in a channel wider than the needle.
    Toe,
    /// `a exp(-(x - b)^2 / (2 w^2))` with a width of a tenth of the typical range.
    Bump,
    /// `a sin(2 pi x / b) + c (cos(2 pi x / b) - 1)`.
    Sine,
    /// `a P(x)`, with P the play of half width `b`: it stays until `x` is further than `b` from it, and follows from there on. So
    /// yields what has slip or plastic flow, and a hysteresis that does not depend on rate.
    Play,
    /// `a z / b`, with z what the play of half width `b` is behind: it follows `x` within `b` and slips beyond, as a bristle or an elastoplastic contact does.
    Bristle,
    /// `a sign(x) exp(-|x| / b)`: what friction has more at rest than in fast motion (Stribeck).
    Decay,
    /// Function that a person has written ([`define`](super::define)).
    Own,
    /// A cubic, by Legendre's polynomials over the typical range: so each of its parameters has the size of what it does.
    Polynomial,
}

/// Start values of the search for a place, a length or a period, as shares of the typical size.
const PLACES: [f64; 12] = [0.1, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0, 1.2, 1.4, 1.7, 2.0];
const LENGTHS: [f64; 5] = [0.1, 0.25, 0.5, 1.0, 2.0];
/// Periods, each an eighth longer than the one before: over as many periods as a session holds, a phase that stays within half a turn.
const PERIODS: usize = 28;
const SHORTEST: f64 = 0.1;
const LONGER: f64 = 1.125;
/// Width of a bump and of the slope of a step, as shares of the typical size.
pub(super) const WIDTH: f64 = 0.12;
/// Length over which a needle of 18 gauge averages a modulus of 10 kPa: a fifth of `(4 E I / K)^(1/4)`, 40 mm.
const FELT_MM: f64 = 8.0;
const EDGE: f64 = 0.01;

impl Form {
    /// Every one that the grammar has.
    pub const ALL: [Self; 18] = [
        Self::Constant,
        Self::Linear,
        Self::Quadratic,
        Self::Cubic,
        Self::Absolute,
        Self::Sign,
        Self::Saturation,
        Self::Exponential,
        Self::Step,
        Self::Within,
        Self::Knee,
        Self::Toe,
        Self::Bump,
        Self::Sine,
        Self::Polynomial,
        Self::Play,
        Self::Bristle,
        Self::Decay,
    ];

    /// The forms below but for the last one, which has memory.
    const WITHOUT_MEMORY: &[Self] = Self::OF_MOTION.split_at(Self::OF_MOTION.len() - 1).0;
    /// Forms of readings, and of tissue under a motion that it keeps.
    const OF_MOTION: &[Self] = Self::OF_THE_FORCE.split_at(Self::OF_THE_FORCE.len() - 1).0;

    /// Forms of the force that moves guide 2: also that of a friction that builds up over a way.
    const OF_THE_FORCE: &[Self] = &[
        Self::Linear,
        Self::Quadratic,
        Self::Cubic,
        Self::Absolute,
        Self::Sign,
        Self::Saturation,
        Self::Sine,
        Self::Play,
        Self::Bristle,
    ];

    /// Those that make sense of a site and a regressor.
    pub(super) fn of(site: Site, regressor: Regressor) -> &'static [Self] {
        match regressor {
            Regressor::Deflection if site == Site::Reaction => {
                &[Self::Linear, Self::Quadratic, Self::Absolute, Self::Sign, Self::Knee, Self::Toe]
            }
            Regressor::Along => &[Self::Linear, Self::Step, Self::Bump],
            Regressor::ToTip => &[Self::Within, Self::Bump],
            Regressor::Constant => &[Self::Constant],
            Regressor::Direction => &[Self::Linear],
            // One axis acts on the other: turned axes, an arc, a side that is preferred.
            Regressor::Across => &[Self::Linear, Self::Quadratic, Self::Absolute, Self::Sign],
            // Viscous friction, the difference of both directions, and what is more at rest.
            Regressor::Speed => &[Self::Linear, Self::Absolute, Self::Decay],
            Regressor::Run | Regressor::Depth | Regressor::Use => {
                &[Self::Linear, Self::Quadratic, Self::Exponential, Self::Step]
            }
            // Tissue and sensors that yield under a displacement or a force keep that; play of guide 2 itself is backlash.
            Regressor::Displacement if site == Site::Force => Self::OF_THE_FORCE,
            Regressor::Displacement if site == Site::Tissue => Self::OF_MOTION,
            Regressor::Force if site == Site::Force => Self::OF_MOTION,
            // A motion to and fro as the force that it causes rises would have no single equilibrium.
            Regressor::Force if matches!(site, Site::Tissue | Site::Guide) => &[
                Self::Linear,
                Self::Quadratic,
                Self::Cubic,
                Self::Absolute,
                Self::Sign,
                Self::Saturation,
                Self::Play,
            ],
            Regressor::Displacement | Regressor::Force | Regressor::Deflection => Self::WITHOUT_MEMORY,
            Regressor::Place | Regressor::Share => &[
                Self::Linear,
                Self::Quadratic,
                Self::Exponential,
                Self::Step,
                Self::Bump,
                Self::Sine,
                Self::Polynomial,
            ],
            Regressor::Time => {
                &[Self::Linear, Self::Quadratic, Self::Exponential, Self::Step, Self::Bump, Self::Sine]
            }
        }
    }

    /// Whether it is the same for `-x` as for `x`.
    pub(super) fn is_even(self) -> bool {
        matches!(self, Self::Constant | Self::Quadratic | Self::Absolute | Self::Knee | Self::Toe)
    }

    /// Its name in ids.
    pub fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Linear => "linear",
            Self::Quadratic => "quadratic",
            Self::Cubic => "cubic",
            Self::Absolute => "absolute",
            Self::Sign => "sign",
            Self::Saturation => "saturation",
            Self::Exponential => "exponential",
            Self::Step => "step",
            Self::Within => "within",
            Self::Knee => "knee",
            Self::Toe => "toe",
            Self::Bump => "bump",
            Self::Sine => "sine",
            Self::Polynomial => "polynomial",
            Self::Play => "play",
            Self::Bristle => "bristle",
            Self::Decay => "decay",
            Self::Own => "own",
        }
    }

    /// Its value at `x`, both in their own units.
    pub fn value(self, parameters: &[f64], regressor: Regressor, x: f64) -> f64 {
        let &[a, ref more @ ..] = parameters else { return 0.0 };
        let typical = regressor.typical();
        let last = more.last().copied().unwrap_or(typical).abs().max(1e-9);
        match self {
            Self::Constant => a,
            Self::Linear => a * x,
            Self::Quadratic => a * x * x,
            Self::Cubic => a * x * x * x,
            Self::Absolute => a * x.abs(),
            // As steep as what is measured distinguishes: no jump that a difference could fall on.
            Self::Sign => a * (x / (EDGE * typical)).tanh(),
            Self::Saturation => a * x / distance(x, last),
            Self::Exponential => a * (1.0 - (-x / last).exp()),
            Self::Step => 0.5 * a * (1.0 + ((x - last) / (EDGE * typical)).tanh()),
            Self::Within => 0.5 * a * (1.0 - ((x - last) / (EDGE * typical)).tanh()),
            Self::Knee => a * (1.0 - last / distance(x, last)),
            Self::Toe => a * last / distance(x, last),
            Self::Bump => a * (-0.5 * ((x - last) / (WIDTH * typical)).powi(2)).exp(),
            Self::Sine => {
                let cosine = more.first().copied().unwrap_or_default();
                let (sin, cos) = (std::f64::consts::TAU * x / last).sin_cos();
                a * sin + cosine * (cos - 1.0)
            }
            // From its rest.
            Self::Play => a * followed(0.0, x, last),
            Self::Bristle => a * (x - followed(0.0, x, last)) / last,
            Self::Decay if x == 0.0 => 0.0,
            Self::Decay => a * x.signum() * (-x.abs() / last).exp(),
            // Its value is that of its own function.
            Self::Own => 0.0,
            Self::Polynomial => {
                let powers = powers(parameters, regressor);
                powers.iter().rev().fold(0.0, |sum, factor| sum * x + factor)
            }
        }
    }

    /// Its value at `x` after what came before, whose play is `state`; and the play there. Forms without memory have none.
    pub(super) fn value_after(
        self,
        parameters: &[f64],
        regressor: Regressor,
        x: f64,
        state: f64,
    ) -> (f64, f64) {
        match (self, parameters) {
            (Self::Play, &[factor, half_width]) => {
                let state = followed(state, x, half_width.abs());
                (factor * state, state)
            }
            (Self::Bristle, &[limit, half_width]) => {
                let width = half_width.abs().max(f64::MIN_POSITIVE);
                let state = followed(state, x, width);
                (limit * (x - state) / width, state)
            }
            _ => (self.value(parameters, regressor, x), state),
        }
    }

    /// Its parameters for a site and a regressor: amplitudes, then a place, a length or a period.
    pub(super) fn parameters(self, site: Site, regressor: Regressor) -> Vec<ParameterInfo> {
        let (unit, of) = (site.unit(), regressor.unit());
        let typical = regressor.typical();
        let overlooked = site.overlooked();
        let amplitude = |name: &str, power: i32| {
            let per = match (power, of) {
                (0, _) => String::new(),
                (1, "") => "_per_unit".to_owned(),
                (_, "") => format!("_per_unit{power}"),
                (1, of) => format!("_per_{of}"),
                (power, of) => format!("_per_{of}{power}"),
            };
            // At the typical size of the regressor it does as much as is overlooked.
            let sd = overlooked / typical.powi(power) * self.spread(site, regressor);
            let name: &'static str =
                Box::leak(format!("{}{per}", name_with_unit(name, unit)).into_boxed_str());
            let [mut range, mut likely] = [300.0, 20.0].map(|many| [-many * sd, many * sd]);
            // Nothing that is taken along goes further than what moves it.
            if matches!(site, Site::Tissue | Site::Guide) && power == 1 && of == "mm" {
                [range, likely] = [range, likely].map(|ends| ends.map(|end: f64| end.clamp(-1.0, 1.0)));
            }
            // No needle has less than no stiffness, and no support pushes.
            match site {
                Site::Stiffness if power == 0 => {
                    (range[0], likely[0]) = (range[0].max(-0.98), likely[0].max(-0.95));
                }
                Site::GuideTurn | Site::TipSupport => (range[0], likely[0]) = (0.0, 0.0),
                _ => {}
            }
            ParameterInfo::amplitude(name, 0.0, range, likely, sd)
        };
        let place = |name: &str, shares: &[f64]| {
            let name: &'static str = Box::leak(name_with_unit(name, of).into_boxed_str());
            let nodes: Vec<f64> = shares.iter().map(|share| share * typical).collect();
            let (least, most) = (nodes[0], nodes[nodes.len() - 1]);
            let nodes: &'static [f64] = Box::leak(nodes.into_boxed_slice());
            let middle = (least * most).sqrt();
            let (range, likely) = ([0.2 * least, 10.0 * most], [0.8 * least, 1.25 * most]);
            ParameterInfo::location(name, middle, range, likely, 0.5 * middle, nodes)
        };
        match self {
            Self::Constant => vec![amplitude("offset", 0)],
            Self::Linear if regressor == Regressor::Direction => vec![amplitude("amplitude", 0)],
            Self::Linear | Self::Absolute => vec![amplitude("slope", 1)],
            Self::Play => vec![amplitude("slope", 1), place("half_width", &LENGTHS)],
            Self::Quadratic => vec![amplitude("coefficient", 2)],
            Self::Cubic => vec![amplitude("coefficient", 3)],
            Self::Sign => vec![amplitude("amplitude", 0)],
            Self::Saturation | Self::Exponential | Self::Knee | Self::Toe | Self::Decay => {
                vec![amplitude("limit", 0), place("scale", &LENGTHS)]
            }
            Self::Bristle => vec![amplitude("limit", 0), place("half_width", &LENGTHS)],
            Self::Step | Self::Within => vec![amplitude("step", 0), place("at", &PLACES)],
            Self::Bump => vec![amplitude("height", 0), place("at", &PLACES)],
            Self::Sine => {
                let periods: Vec<f64> =
                    (0..PERIODS).map(|number| SHORTEST * LONGER.powi(number as i32)).collect();
                vec![amplitude("sine", 0), amplitude("cosine", 0), place("period", &periods)]
            }
            Self::Own => Vec::new(),
            Self::Polynomial => {
                ["offset", "first", "second", "third"].into_iter().map(|name| amplitude(name, 0)).collect()
            }
        }
    }

    /// Ratio of an amplitude to the negligible amplitude of its site: a needle feels the mean modulus over some
    /// [`FELT_MM`], and a bump does that much to the mean.
    fn spread(self, site: Site, regressor: Regressor) -> f64 {
        if (self, site, regressor) == (Self::Bump, Site::Modulus, Regressor::Place) {
            FELT_MM / (WIDTH * regressor.typical() * std::f64::consts::TAU.sqrt())
        } else {
            1.0
        }
    }
}

/// Name with its unit behind an underscore.
fn name_with_unit(name: &str, unit: &str) -> String {
    if unit.is_empty() { name.to_owned() } else { format!("{name}_{unit}") }
}

/// Length of the hypotenuse; of numbers of ordinary size, and so without the guards of `f64::hypot`, which cost a sixth of a diagnosis.
fn distance(x: f64, y: f64) -> f64 {
    (x * x + y * y).sqrt()
}

/// Play of this half width that was at `state`, after the input has come to `x`.
fn followed(state: f64, x: f64, half_width: f64) -> f64 {
    state.max(x - half_width).min(x + half_width)
}

/// Factors of the powers of `x` in a sum of Legendre's polynomials over the range of a regressor.
pub(super) fn powers(parameters: &[f64], regressor: Regressor) -> [f64; 4] {
    let (a, b, c, d) = (
        number_or_zero(0, parameters),
        number_or_zero(1, parameters),
        number_or_zero(2, parameters),
        number_or_zero(3, parameters),
    );
    // The range ends at 1 for a share, and beyond the typical size elsewhere.
    let range = if regressor == Regressor::Share { 1.0 } else { 1.5 * regressor.typical() };
    // In y = x / range: P1 = 2 y - 1, P2 = 6 y^2 - 6 y + 1, P3 = 20 y^3 - 30 y^2 + 12 y - 1.
    [
        a - b + c - d,
        (2.0 * b - 6.0 * c + 12.0 * d) / range,
        (6.0 * c - 30.0 * d) / range.powi(2),
        20.0 * d / range.powi(3),
    ]
}

/// Value of a parameter, 0 where it is missing.
fn number_or_zero(at: usize, parameters: &[f64]) -> f64 {
    parameters.get(at).copied().unwrap_or_default()
}
