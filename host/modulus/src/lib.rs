//! Foundation modulus, Young's modulus, and what else states a modulus of the tissue.
//!
//! | item | does |
//! |---|---|
//! | [`Relation`], [`relation`] | published relations between the two moduli; the one that a lateral run has in an elastic body |
//! | [`indentation`] | Young's modulus from an indentation: an independent measurement |
//! | [`energy`] | foundation modulus by the published energy balance, for comparison |
//! | [`prior`] | what many sessions predict of it |
//! | [`walls`] | what the walls of the tissue do to it, stated or not |
//!
//! The foundation modulus K (force per needle length and deflection) is not Young's modulus E. Published relations
//! between the two differ by more than the noise of an identification, so E is only ever reported with the name of its
//! relation.
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod energy;
pub mod indentation;
#[cfg(test)]
mod monte_carlo;
pub mod prior;
pub mod relation;
pub mod walls;

use mechanics::Needle;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::f64::consts::PI;

/// A published relation between foundation modulus and Young's modulus.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Relation {
    /// Vesic (1961), beam on a half space: `K = 0.65 (E D^4 / EI)^(1/12) E / (1 - nu^2)`.
    Vesic,
    /// Biot (1937), beam on a half space: `K = 0.95 (E D^4 / ((1 - nu^2) EI))^0.108 E / (1 - nu^2)`.
    Biot,
    /// Twice Vesic: tissue on both sides of the needle.
    Embedded,
    /// Rigid cylinder bonded in an incompressible full space (from the drag of a cylinder in viscous flow):
    /// `K = (4 pi / 3) E / (ln(L/D) + 0.839)`; Poisson's ratio is always 1/2.
    RigidCylinder,
}

impl Relation {
    /// All published ones.
    pub const ALL: [Self; 4] = [Self::Vesic, Self::Biot, Self::Embedded, Self::RigidCylinder];

    /// Its name in results and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vesic => "vesic",
            Self::Biot => "biot",
            Self::Embedded => "embedded",
            Self::RigidCylinder => "rigid-cylinder",
        }
    }

    /// Range in which it holds.
    pub fn validity(self) -> &'static str {
        match self {
            Self::Vesic | Self::Biot => {
                "long beam on the surface of an elastic half space, not embedded in it"
            }
            Self::Embedded => {
                "long beam embedded in an elastic body: twice the half space's stiffness, by analogy"
            }
            Self::RigidCylinder => {
                "rigid cylinder bonded in an incompressible full space: no surface, no bending"
            }
        }
    }

    /// Young's modulus of tissue with Poisson's ratio `poisson` in which a length `depth_m` of the needle is held by the
    /// foundation modulus `modulus_pa`.
    pub fn youngs_modulus_pa(self, modulus_pa: f64, needle: &Needle, depth_m: f64, poisson: f64) -> f64 {
        let diameter_m = needle.outer_diameter_m;
        let plane = 1.0 - poisson * poisson;
        let slenderness = diameter_m.powi(4) / needle.bending_stiffness_n_m2();
        match self {
            Self::Vesic => invert(0.65, slenderness, 1.0 / 12.0, modulus_pa, plane),
            Self::Biot => invert(0.95, slenderness / plane, 0.108, modulus_pa, plane),
            Self::Embedded => invert(1.3, slenderness, 1.0 / 12.0, modulus_pa, plane),
            Self::RigidCylinder => modulus_pa * ((depth_m / diameter_m).ln() + 0.839) / (4.0 / 3.0 * PI),
        }
    }
}

/// Modulus of which a power law gives this foundation modulus.
fn invert(factor: f64, base: f64, power: f64, modulus_pa: f64, plane: f64) -> f64 {
    (modulus_pa * plane / (factor * base.powf(power))).powf(1.0 / (1.0 + power))
}

/// Young's modulus of a half space under a flat cylindrical punch: `E = (1 - nu^2) F / (2 a x)`, Paper A (Lehmann et
/// al.), (21).
pub fn punch_modulus_pa(radius_m: f64, poisson: f64, depth_m: f64, force_n: f64) -> f64 {
    (1.0 - poisson * poisson) * force_n / (2.0 * radius_m * depth_m)
}

/// Mean and standard deviation of independent values; nothing for fewer than two.
pub fn mean_and_sd(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (values.len() > 1).then(|| (mean, (squares / (n - 1.0)).sqrt()))
}

/// A sample's mean, standard deviation and size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Number of values.
    pub count: usize,
}

impl Sample {
    /// The sample's figures; nothing for fewer than two values.
    pub fn of(values: &[f64]) -> Option<Self> {
        mean_and_sd(values).map(|(mean, sd)| Self { mean, sd, count: values.len() })
    }
}

/// Two-sided p-value of Welch's t-test: how likely means of one population differ by as much. `None` if the samples
/// have no scatter.
pub fn welch_p(a: Sample, b: Sample) -> Option<f64> {
    let total = mean_variance(a) + mean_variance(b);
    let freedom = total * total / (welch_term(a) + welch_term(b));
    let t = (a.mean - b.mean) / total.sqrt();
    let distribution = StudentsT::new(0.0, 1.0, freedom).ok()?;
    t.is_finite().then(|| 2.0 * distribution.sf(t.abs()))
}

fn welch_term(s: Sample) -> f64 {
    mean_variance(s).powi(2) / (s.count as f64 - 1.0)
}

/// Variance of a sample's mean.
fn mean_variance(s: Sample) -> f64 {
    s.sd * s.sd / s.count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relations_give_the_reference_ratios() {
        let needle = Needle::gauge_18();
        for (youngs_pa, vesic, biot) in [
            (5e3, 0.2697686478916176, 0.28791504827938535),
            (16e3, 0.29722634893776495, 0.3264529234373485),
            (30e3, 0.3132112932589154, 0.34938535707440144),
        ] {
            for (relation, ratio) in
                [(Relation::Vesic, vesic), (Relation::Biot, biot), (Relation::Embedded, 2.0 * vesic)]
            {
                let recovered_pa = relation.youngs_modulus_pa(ratio * youngs_pa, &needle, 0.03, 0.5);
                assert!((recovered_pa / youngs_pa - 1.0).abs() < 1e-12, "{relation:?} {recovered_pa}");
            }
        }
        for (depth_m, ratio) in [(0.02, 1.16), (0.03, 1.05), (0.04, 0.98), (0.1, 0.80)] {
            let youngs_pa = Relation::RigidCylinder.youngs_modulus_pa(16e3, &needle, depth_m, 0.5);
            assert!((16e3 / youngs_pa - ratio).abs() < 0.006, "{depth_m}: {}", 16e3 / youngs_pa);
        }
    }

    #[test]
    fn punch_gives_the_reference_value() {
        assert!((punch_modulus_pa(0.0021, 0.5, 0.0035, 0.3) / 15306.122448979591 - 1.0).abs() < 1e-12);
    }

    #[test]
    fn welch_gives_the_reference_p_values() {
        let reference = Sample { mean: 16.23, sd: 2.73, count: 6 };
        for (mean, sd, p) in [
            (16.53, 2.63, 0.8501777811135484),
            (14.0, 2.62, 0.1794861890862098),
            (13.94, 3.15, 0.2087032545236291),
        ] {
            let p_value = welch_p(Sample { mean, sd, count: 6 }, reference).expect("a p-value");
            assert!((p_value - p).abs() < 1e-9, "{p_value} {p}");
        }
        let still = Sample { mean: 1.0, sd: 0.0, count: 2 };
        assert_eq!(welch_p(still, still), None);
    }
}
