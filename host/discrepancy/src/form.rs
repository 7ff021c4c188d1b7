//! Forms of laws: functions of one regressor with a few parameters.
//!
//! A law is `sum_i a_i f_i(x; s)`: it is linear in the amplitudes `a_i` and has at most one shape parameter `s` (a level, a
//! length, a period). A jump at zero is smoothed by the error of the regressor: with standard deviation `e` of that error, the
//! mean of the sign of `x` is `erf(x / (sqrt 2 e))`.

use serde::{Deserialize, Serialize};
use statrs::function::erf::erf;

/// Number of values of a shape that the search evaluates.
const GRID: usize = 8;

/// A function of one regressor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Form {
    /// `a`.
    Constant,
    /// `a x`: viscous friction, a stiffness, a gain.
    Proportional,
    /// `a sign(x)`: dry friction.
    Sign,
    /// `a |x|`: half the difference between the slopes of both sides.
    Asymmetry,
    /// `a x^2`.
    Square,
    /// `a x |x|`: drag.
    SignedSquare,
    /// `a max(x - level, 0)`: an overflow, a stop.
    AboveLevel,
    /// `a max(level - x, 0)`.
    BelowLevel,
    /// `a` above the level, zero below it.
    Step,
    /// `a sign(x) exp(-|x| / length)`: friction that falls with speed (Stribeck), or a toe region if x has one sign.
    Decay,
    /// `a sin(2 pi x / period) + b cos(2 pi x / period)`: cogging, a run-out.
    Sine,
    /// `a z / width`, where `z` follows `x` and stays between `-width` and `width`: a bristle or an elastoplastic contact; on a
    /// position with `a = -width` it is play.
    Bristle,
    /// `a cos(k pi (x - from) / (to - from))`: a basis function of the discrepancy; the search does not try it as a law.
    #[serde(skip)]
    Cosine(u8),
}

/// A shape parameter with its range for the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Name of the parameter.
    pub name: &'static str,
    /// Its range.
    pub range: [f64; 2],
    /// Whether the prior is uniform in its logarithm instead of its value.
    pub is_logarithmic: bool,
}

impl Shape {
    /// Value at a fraction of the range.
    pub fn at(&self, fraction: f64) -> f64 {
        let [least, most] = self.range;
        if self.is_logarithmic {
            least * (most / least).powf(fraction)
        } else {
            least + fraction * (most - least)
        }
    }

    /// Fractions of the range at which the search evaluates it.
    pub fn grid() -> impl Iterator<Item = f64> {
        (0..GRID).map(|i| (i as f64 + 0.5) / GRID as f64)
    }
}

/// Range of a regressor's values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Span {
    /// Least value.
    pub from: f64,
    /// Largest value.
    pub to: f64,
    /// Standard deviation of its error.
    #[serde(default)]
    pub resolution: f64,
    /// Mean distance of consecutive values in time; 0 if unknown.
    #[serde(default)]
    pub step: f64,
}

impl Span {
    /// Range between two values that are known without error.
    pub fn between(from: f64, to: f64) -> Self {
        Self { from, to, resolution: 0.0, step: 0.0 }
    }

    /// Whether it contains values of both signs, where each side is longer than the resolution and than a twentieth of the other side.
    pub fn has_both_signs(&self) -> bool {
        let (negative, positive) = (-self.from, self.to);
        negative.min(positive) > self.resolution.max(0.05 * negative.max(positive))
    }

    fn length(&self) -> f64 {
        self.to - self.from
    }

    /// Expected sign of a true value, given a reading with normal error of the resolution.
    fn sign(&self, x: f64) -> f64 {
        match self.resolution {
            e if e > 0.0 => erf(x / (std::f64::consts::SQRT_2 * e)),
            _ if x == 0.0 => 0.0,
            _ => x.signum(),
        }
    }
}

impl Form {
    /// All forms that the search tries.
    pub const ALL: [Self; 12] = [
        Self::Constant,
        Self::Proportional,
        Self::Sign,
        Self::Asymmetry,
        Self::Square,
        Self::SignedSquare,
        Self::AboveLevel,
        Self::BelowLevel,
        Self::Step,
        Self::Decay,
        Self::Sine,
        Self::Bristle,
    ];

    /// Its name in files, documents and messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Proportional => "proportional",
            Self::Sign => "sign",
            Self::Asymmetry => "asymmetry",
            Self::Square => "square",
            Self::SignedSquare => "signed_square",
            Self::AboveLevel => "above_level",
            Self::BelowLevel => "below_level",
            Self::Step => "step",
            Self::Decay => "decay",
            Self::Sine => "sine",
            Self::Bristle => "bristle",
            Self::Cosine(_) => "cosine",
        }
    }

    /// The form with this name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|form| form.name() == name)
    }

    /// Its formula, with `x` for the regressor.
    pub fn formula(self) -> &'static str {
        match self {
            Self::Constant => "a",
            Self::Proportional => "a x",
            Self::Sign => "a sign(x)",
            Self::Asymmetry => "a |x|",
            Self::Square => "a x^2",
            Self::SignedSquare => "a x |x|",
            Self::AboveLevel => "a max(x - level, 0)",
            Self::BelowLevel => "a max(level - x, 0)",
            Self::Step => "a (x > level)",
            Self::Decay => "a sign(x) exp(-|x| / length)",
            Self::Sine => "a sin(2 pi x / period) + b cos(2 pi x / period)",
            Self::Bristle => "a z / width, z follows x within the width",
            Self::Cosine(_) => "a cos(k pi (x - from) / (to - from))",
        }
    }

    /// Names of its amplitudes.
    pub fn amplitudes(self) -> &'static [&'static str] {
        if self == Self::Sine { &["a", "b"] } else { &["a"] }
    }

    /// Power of the regressor's unit by which the site's unit is divided to give the amplitude's unit.
    pub fn power(self) -> u8 {
        match self {
            Self::Proportional | Self::Asymmetry | Self::AboveLevel | Self::BelowLevel => 1,
            Self::Square | Self::SignedSquare => 2,
            _ => 0,
        }
    }

    /// Whether it depends on earlier values of the regressor.
    pub fn has_history(self) -> bool {
        self == Self::Bristle
    }

    /// The even part `(f(x) + f(-x)) / 2` of a function of unit amplitude, which acts as an offset. A constant is even. For a
    /// regressor of one sign the even part of all other forms is taken as zero.
    pub fn even_part(self, amplitude: usize, x: f64, shape: f64, span: &Span) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Bristle => 0.0,
            _ if span.has_both_signs() => {
                0.5 * (self.value(amplitude, x, shape, span) + self.value(amplitude, -x, shape, span))
            }
            _ => 0.0,
        }
    }

    /// Whether the form differs from all others over this range: a form with a sign or an absolute value needs values of both signs.
    pub fn applies_to(self, span: &Span) -> bool {
        match self {
            Self::Sign | Self::Asymmetry | Self::SignedSquare => span.has_both_signs(),
            _ => true,
        }
    }

    /// Its shape parameter over values of this range.
    pub fn shape(self, span: &Span) -> Option<Shape> {
        let length = span.length();
        let scale = if span.has_both_signs() { span.to.abs().max(span.from.abs()) } else { length };
        // A level in the outer tenths acts on too few values to be identifiable.
        let level_range = [span.from + 0.1 * length, span.to - 0.1 * length];
        let (name, least, most) = match self {
            Self::AboveLevel | Self::BelowLevel | Self::Step => {
                return Some(Shape { name: "level", range: level_range, is_logarithmic: false });
            }
            // A shorter decay acts on less than a fiftieth of the values; a longer one resembles a constant and a slope.
            Self::Decay => ("length", scale / 50.0, scale / 2.0),
            // A bristle narrower than the step between readings acts as a jump. If the step is unknown, 200 readings per range are assumed.
            Self::Bristle if span.step > 0.0 => ("width", span.step, length / 4.0),
            Self::Bristle => ("width", length / 200.0, length / 4.0),
            // A sine with fewer than two periods in the range does not differ from other smooth functions.
            Self::Sine => ("period", length / 10.0, length / 2.0),
            _ => return None,
        };
        let range = [least.max(span.resolution).min(0.5 * most), most];
        Some(Shape { name, range, is_logarithmic: true })
    }

    /// Value of a function of unit amplitude, for all forms without history.
    pub fn value(self, amplitude: usize, x: f64, shape: f64, span: &Span) -> f64 {
        match self {
            Self::Constant => 1.0,
            Self::Proportional => x,
            Self::Sign => span.sign(x),
            Self::Asymmetry => x.abs(),
            Self::Square => x * x,
            Self::SignedSquare => x * x.abs(),
            Self::AboveLevel => (x - shape).max(0.0),
            Self::BelowLevel => (shape - x).max(0.0),
            Self::Step => 0.5 * (1.0 + span.sign(x - shape)),
            Self::Decay if span.has_both_signs() => span.sign(x) * (-x.abs() / shape).exp(),
            Self::Decay => (-(x - span.from).max(0.0) / shape).exp(),
            Self::Sine if amplitude == 0 => (std::f64::consts::TAU * x / shape).sin(),
            Self::Sine => (std::f64::consts::TAU * x / shape).cos(),
            Self::Bristle => (x / shape).clamp(-1.0, 1.0),
            Self::Cosine(k) => {
                let fraction = (x - span.from) / span.length().max(f64::MIN_POSITIVE);
                (f64::from(k) * std::f64::consts::PI * fraction.clamp(0.0, 1.0)).cos()
            }
        }
    }

    /// Adds the law over a whole series. A bristle is relaxed at the first value.
    pub fn add(self, values: &[f64], x: &[f64], span: &Span, sum: &mut [f64]) {
        let amplitudes = self.amplitudes().len();
        let shape = values.get(amplitudes).copied().unwrap_or(1.0);
        if self == Self::Bristle {
            let amplitude = values.first().copied().unwrap_or(0.0);
            let (mut bristle, mut previous_x) = (0.0, x.first().copied().unwrap_or(0.0));
            for (sum, x) in sum.iter_mut().zip(x) {
                bristle = f64::clamp(bristle + x - previous_x, -shape, shape);
                previous_x = *x;
                *sum += amplitude * bristle / shape;
            }
            return;
        }
        for (number, amplitude) in values.iter().take(amplitudes).enumerate() {
            for (sum, x) in sum.iter_mut().zip(x) {
                *sum += amplitude * self.value(number, *x, shape, span);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SPAN: Span = Span { from: -2.0, to: 2.0, resolution: 0.0, step: 0.0 };

    #[test]
    fn names_lead_back_to_their_forms() {
        for form in Form::ALL {
            assert_eq!(Form::named(form.name()), Some(form));
        }
        assert_eq!(Form::named("cosine"), None);
    }

    #[test]
    fn a_bristle_follows_within_its_width_and_slips_beyond() {
        let mut force = [0.0; 5];
        Form::Bristle.add(&[3.0, 0.5], &[0.0, 0.25, 1.0, 0.75, -1.0], &SPAN, &mut force);
        assert_eq!(force, [0.0, 1.5, 3.0, 1.5, -3.0]);
    }

    #[test]
    fn a_sign_with_an_uncertain_regressor_is_its_mean() {
        let uncertain = Span { resolution: 0.1, ..SPAN };
        assert!((Form::Sign.value(0, 0.1, 1.0, &uncertain) - 0.682_689).abs() < 1e-5);
        assert_eq!(Form::Sign.value(0, 1e-9, 1.0, &SPAN), 1.0);
        assert_eq!(Form::Sign.value(0, 0.0, 1.0, &SPAN), 0.0);
    }

    #[test]
    fn forms_of_two_sides_need_both() {
        let one_sided = Span::between(0.0, 1.0);
        assert!(!Form::Sign.applies_to(&one_sided) && Form::Sign.applies_to(&SPAN));
        // A toe region begins at the least value.
        assert_eq!(Form::Decay.value(0, 0.0, 0.1, &one_sided), 1.0);
    }

    #[test]
    fn even_parts_are_what_both_signs_have_in_common() {
        let even = |form: Form, x| form.even_part(0, x, 0.5, &SPAN);
        assert_eq!((even(Form::Constant, 1.5), even(Form::Asymmetry, -1.5)), (1.0, 1.5));
        for form in [Form::Sign, Form::Proportional, Form::SignedSquare, Form::Decay, Form::Bristle] {
            assert_eq!(even(form, 1.5), 0.0, "{}", form.name());
        }
        // The even part of a step is half of it beyond its level on either side, and zero between.
        assert_eq!((even(Form::Step, 1.5), even(Form::Step, 0.25)), (0.5, 0.0));
        assert_eq!(even(Form::AboveLevel, -1.5), 0.5);
        assert_eq!(Form::Square.even_part(0, 0.5, 0.0, &Span::between(0.0, 1.0)), 0.0);
    }

    #[test]
    fn shapes_stay_in_their_ranges() {
        for form in Form::ALL {
            let Some(shape) = form.shape(&SPAN) else { continue };
            for fraction in Shape::grid() {
                let value = shape.at(fraction);
                assert!(value >= shape.range[0] && value <= shape.range[1], "{}", form.name());
            }
        }
    }
}
