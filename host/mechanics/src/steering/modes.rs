//! Modes of the moving needle: a beam clamped to a fixture that is itself free to move sideways (theory, eq. 47).

use crate::quadrature::integrate;
use crate::{ModelError, check};
use std::f64::consts::PI;

/// A clamped needle on a moving fixture, as far as its modes are concerned.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clamped {
    /// Free length, from the fixture to the tip.
    pub length_m: f64,
    /// Bending stiffness.
    pub bending_stiffness_n_m2: f64,
    /// Mass of the needle per length.
    pub density_kg_per_m: f64,
    /// Mass of the fixture that moves with the needle's base.
    pub fixture_mass_kg: f64,
}

/// One unconstrained mode `phi(x) = A cos + B sin + R e^(l (x - L)) + D e^(-l x)` of `l x`, scaled to unit modal mass:
/// `rho int phi^2 + m_b phi(0)^2 = 1`, positive at the tip.
///
/// Slope 0 at the base, `phi'''(0) = (m_b / rho) l^4 phi(0)`, `phi'' = phi''' = 0` at the tip. Written with exponentials that
/// are at most 1 on the needle: `cosh` and `sinh` would cancel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeMode {
    /// Wave number `l`, 1/m.
    pub wave_number_per_m: f64,
    /// Natural frequency `xi = l^2 sqrt(EI / rho)`, rad/s.
    pub frequency_rad_s: f64,
    /// Factors of cos, sin, the exponential that rises to 1 at the tip, the one that falls from 1 at the base.
    pub factors: [f64; 4],
    length_m: f64,
}

/// The shape at `a = l L`, with the sine's factor set to `mass * a`, and how far the tip is from being free of moment
/// and shear at once.
fn shape(a: f64, mass: f64) -> ([f64; 4], f64) {
    let (sin, cos) = a.sin_cos();
    let small = (-a).exp();
    let sine = mass * a;
    let cosine = -(sine + 2.0 + small * sine * (sin + cos)) / (1.0 + small * (cos - sin));
    let rise = 0.5 * (cosine * (cos - sin) + sine * (sin + cos));
    let fall = sine + rise * small;
    ([cosine, sine, rise, fall], -cosine * (cos + sin) - sine * (sin - cos) + 2.0 * small * fall)
}

impl FreeMode {
    /// Mode number `index`, from 1.
    ///
    /// Its `l L` lies between the root of the clamped needle (an infinitely heavy fixture), near `pi (index - 1/2)`, and
    /// that of the guided one (no fixture mass), near `pi (index - 1/4)`.
    fn new(needle: &Clamped, index: usize) -> Self {
        let length_m = needle.length_m;
        let mass = needle.fixture_mass_kg / (needle.density_kg_per_m * length_m);
        let middle = PI * (index as f64 - 0.5);
        let (mut low, mut high) = (middle - 0.1, middle + 0.25 * PI + 0.1);
        let sign = shape(low, mass).1.signum();
        // Bisection to the last bit: once per needle, and nothing to go wrong.
        for _ in 0..60 {
            let half = 0.5 * (low + high);
            if shape(half, mass).1.signum() == sign { low = half } else { high = half }
        }
        let a = 0.5 * (low + high);
        let wave_number_per_m = a / length_m;
        let stiffness = (needle.bending_stiffness_n_m2 / needle.density_kg_per_m).sqrt();
        let frequency_rad_s = wave_number_per_m.powi(2) * stiffness;
        let mode = Self { wave_number_per_m, frequency_rad_s, factors: shape(a, mass).0, length_m };
        let square = integrate(0.0, length_m, length_m * PI / a, |x_m| mode.value(x_m).powi(2));
        let modal_mass_kg =
            needle.density_kg_per_m * square + needle.fixture_mass_kg * mode.value(0.0).powi(2);
        let scale = mode.value(length_m).signum() / modal_mass_kg.sqrt();
        Self { factors: mode.factors.map(|factor| factor * scale), ..mode }
    }

    /// `phi(x)`, `x` from the base.
    pub fn value(&self, x_m: f64) -> f64 {
        let l = self.wave_number_per_m;
        let (sin, cos) = (l * x_m).sin_cos();
        let [a, b, rise, fall] = self.factors;
        a * cos + b * sin + rise * (l * (x_m - self.length_m)).exp() + fall * (-l * x_m).exp()
    }
}

/// Most modes: the twentieth bends the needle every few millimetres.
pub const MAX_MODES: usize = 20;

/// The first `count` modes.
///
/// # Errors
/// [`ModelError::OutOfRange`] for a needle that is none, or a number of modes that is 0 or too large.
pub fn free_modes(needle: &Clamped, count: usize) -> Result<Vec<FreeMode>, ModelError> {
    check("modes", count as f64, "1 to 20", (1..=MAX_MODES).contains(&count))?;
    check("length_m", needle.length_m, "more than 0", needle.length_m > 0.0)?;
    let stiffness = needle.bending_stiffness_n_m2;
    check("bending_stiffness_n_m2", stiffness, "more than 0", stiffness > 0.0)?;
    check("density_kg_per_m", needle.density_kg_per_m, "more than 0", needle.density_kg_per_m > 0.0)?;
    check("fixture_mass_kg", needle.fixture_mass_kg, "0 or more", needle.fixture_mass_kg >= 0.0)?;
    Ok((1..=count).map(|index| FreeMode::new(needle, index)).collect())
}
