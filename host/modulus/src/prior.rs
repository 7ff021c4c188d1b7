//! Prior of K from many sessions, beside the information of a session's own data.
//!
//! ln K of a new subject has a t-distribution ([`ModulusPrior`]), the session's own estimate a normal error. A prior that contradicts the
//! data is not used: the probability of an estimate at least as far from the prior's median is below 1 %.

use formats::NORMAL_975;
use formats::prior_file::ModulusPrior;
use serde::Serialize;
use statrs::distribution::{Continuous, ContinuousCDF, Normal, StudentsT};

/// Prior predictive probability below which a prior is not used.
pub const CONTRADICTION: f64 = 0.01;
/// Points over the prior and over the likelihood in the integrals.
const POINTS: usize = 2000;
/// Standard deviations of the likelihood on either side over which it is integrated.
const REACH: f64 = 8.0;

/// A prior and what it does to a result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PriorResult {
    /// The file.
    pub file: String,
    /// The session's group in it.
    pub group: String,
    /// Sessions that it comes from.
    pub sessions: usize,
    /// Median of K of a new subject of the group.
    pub k_kpa: f64,
    /// The 95 % interval of K of a new subject.
    pub k95_kpa: [f64; 2],
    /// Probability, under the prior, of an estimate at least as far from the median as that of the session's own data; `None` where these
    /// do not identify K.
    pub p: Option<f64>,
    /// Whether the prior is used: p is not below 0.01.
    pub used: bool,
    /// K of prior and data together; `None` where the prior is not used.
    pub with_prior: Option<WithPrior>,
}

/// K of prior and data together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct WithPrior {
    /// Foundation modulus: the median.
    pub k_kpa: f64,
    /// Standard deviation of ln K.
    pub ln_k_sd: f64,
    /// 95 % interval.
    pub ci95_kpa: [f64; 2],
}

impl PriorResult {
    /// The prior beside the session's own estimate of ln K (of pascals) with its standard deviation, where there is one.
    pub fn new(prior: &ModulusPrior, own: Option<(f64, f64)>) -> Self {
        let p = own.map(|(ln_k, sd)| probability(prior, ln_k, sd));
        let is_used = p.is_none_or(|p| p >= CONTRADICTION);
        let combined = own.map_or_else(
            || {
                let [low, high] = interval_ln(prior);
                WithPrior {
                    k_kpa: 1e-3 * prior.modulus_pa,
                    ln_k_sd: (high - low) / (2.0 * NORMAL_975),
                    ci95_kpa: [low, high].map(|ln| 1e-3 * ln.exp()),
                }
            },
            |(ln_k, sd)| together(prior, ln_k, sd),
        );
        Self {
            file: prior.file.clone(),
            group: prior.group.clone(),
            sessions: prior.sessions,
            k_kpa: 1e-3 * prior.modulus_pa,
            k95_kpa: interval_ln(prior).map(|ln| 1e-3 * ln.exp()),
            p,
            used: is_used,
            with_prior: is_used.then_some(combined),
        }
    }

    /// The prior, for the eye: what it predicts, and what becomes of it.
    pub fn lines(&self) -> Vec<String> {
        let [low, high] = self.k95_kpa;
        let mut lines = vec![format!(
            "K {:.2} ({low:.2} to {high:.2}) kPa of a new subject, group {} of {}: {} sessions",
            self.k_kpa, self.group, self.file, self.sessions
        )];
        let p = self.p.map_or_else(
            || "K is not identifiable from the session".to_owned(),
            |p| if p < 1e-3 { "p < 0.001".to_owned() } else { format!("p {p:.3}") },
        );
        lines.push(match self.with_prior {
            Some(WithPrior { k_kpa, ci95_kpa: [low, high], .. }) => {
                format!("with the prior K {k_kpa:.2} ({low:.2} to {high:.2}) kPa; {p}")
            }
            None => format!("contradicts the session's data and is not used: {p}, below {CONTRADICTION}"),
        });
        lines
    }
}

fn student(prior: &ModulusPrior) -> Option<StudentsT> {
    StudentsT::new(prior.modulus_pa.ln(), prior.scale_ln, prior.degrees_of_freedom).ok()
}

/// The 95 % interval of ln K of a new subject.
fn interval_ln(prior: &ModulusPrior) -> [f64; 2] {
    let half =
        StudentsT::new(0.0, 1.0, prior.degrees_of_freedom).map_or(NORMAL_975, |t| t.inverse_cdf(0.975));
    [-half, half].map(|half| prior.modulus_pa.ln() + half * prior.scale_ln)
}

/// Probability of an estimate with this error at least as far from the prior's median.
fn probability(prior: &ModulusPrior, ln_k: f64, sd: f64) -> f64 {
    let (Some(student), Ok(normal)) = (student(prior), Normal::new(0.0, sd)) else { return 1.0 };
    let middle = prior.modulus_pa.ln();
    let distance = (ln_k - middle).abs();
    // ln K = middle + scale tan(angle): also the tails of few degrees of freedom are within a finite range, with a bounded density.
    let (mut sum, mut total) = (0.0, 0.0);
    for number in 0..POINTS {
        let tangent = (std::f64::consts::PI * ((number as f64 + 0.5) / POINTS as f64 - 0.5)).tan();
        let truth = prior.scale_ln * tangent;
        let weight = student.pdf(middle + truth) * (1.0 + tangent * tangent);
        sum += weight * (normal.sf(distance - truth) + normal.cdf(-distance - truth));
        total += weight;
    }
    sum / total
}

/// Prior times likelihood: median, standard deviation and interval.
fn together(prior: &ModulusPrior, ln_k: f64, sd: f64) -> WithPrior {
    let middle = prior.modulus_pa.ln();
    // Range in which either of them varies.
    let mut nodes: Vec<f64> = (0..POINTS)
        .flat_map(|number| [ln_k + REACH * sd * step(number), middle + REACH * prior.scale_ln * step(number)])
        .filter(|node| (node - ln_k).abs() <= REACH * sd)
        .collect();
    nodes.sort_by(f64::total_cmp);
    let t = student(prior);
    let log = |node: f64| t.map_or(0.0, |t| t.ln_pdf(node)) - 0.5 * ((node - ln_k) / sd).powi(2);
    let logs: Vec<f64> = nodes.iter().map(|node| log(*node)).collect();
    let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    // Mass of every cell between two nodes.
    let cells: Vec<(f64, f64)> = nodes
        .windows(2)
        .zip(logs.windows(2))
        .filter_map(|(ends, logs)| {
            let (&[start_ln, end_ln], &[first, last]) = (ends, logs) else { return None };
            let mass = 0.5 * (end_ln - start_ln) * ((first - largest).exp() + (last - largest).exp());
            Some((0.5 * (start_ln + end_ln), mass))
        })
        .collect();
    let total: f64 = cells.iter().map(|(_, mass)| mass).sum();
    let mean = cells.iter().map(|(ln, mass)| ln * mass).sum::<f64>() / total;
    let variance = cells.iter().map(|(ln, mass)| (ln - mean).powi(2) * mass).sum::<f64>() / total;
    WithPrior {
        k_kpa: quantile(0.5, &cells, total, mean),
        ln_k_sd: variance.sqrt(),
        ci95_kpa: [quantile(0.025, &cells, total, mean), quantile(0.975, &cells, total, mean)],
    }
}

fn quantile(share: f64, cells: &[(f64, f64)], total: f64, mean: f64) -> f64 {
    let mut mass_below = 0.0;
    let reached = cells.iter().find(|(_, mass)| {
        mass_below += mass;
        mass_below >= share * total
    });
    reached.map_or(mean, |(ln, _)| *ln).exp() * 1e-3
}

fn step(number: usize) -> f64 {
    2.0 * number as f64 / (POINTS - 1) as f64 - 1.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal, StudentT};

    fn prior(scale_ln: f64, degrees_of_freedom: f64) -> ModulusPrior {
        let (file, group) = ("prior.toml".to_owned(), "liver".to_owned());
        ModulusPrior { file, group, sessions: 20, modulus_pa: 5e3, scale_ln, degrees_of_freedom }
    }

    #[test]
    fn many_degrees_of_freedom_give_the_product_of_two_normal_distributions() {
        let (own_ln_k, sd) = (6e3f64.ln(), 0.1);
        let result = PriorResult::new(&prior(0.2, 1e7), Some((own_ln_k, sd)));
        let weights = [1.0 / 0.04, 1.0 / 0.01];
        let (precision, product) =
            (weights[0] + weights[1], weights[0] * 5e3f64.ln() + weights[1] * own_ln_k);
        let expected = (product / precision).exp() * 1e-3;
        let with_prior = result.with_prior.expect("used");
        assert!(
            (with_prior.k_kpa / expected - 1.0).abs() < 1e-3,
            "{}, expected {expected}",
            with_prior.k_kpa
        );
        assert!((with_prior.ln_k_sd - precision.sqrt().recip()).abs() < 1e-4, "{}", with_prior.ln_k_sd);
        let low = expected * (-NORMAL_975 / precision.sqrt()).exp();
        assert!(
            (with_prior.ci95_kpa[0] / low - 1.0).abs() < 2e-3,
            "{:?}, expected {low}",
            with_prior.ci95_kpa
        );
        // The distance of the estimate beside both standard deviations.
        let z = 1.2f64.ln() / 0.2f64.hypot(0.1);
        let p = 2.0 * Normal::standard().sf(z);
        assert!((result.p.expect("p") - p).abs() < 1e-3, "{:?}, expected {p}", result.p);
    }

    #[test]
    fn intervals_hold_sessions_of_the_population_and_one_in_a_hundred_contradicts() {
        let (prior, sd) = (prior(0.15, 6.0), 0.2);
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let student = StudentT::new(6.0).expect("degrees of freedom");
        let (mut covered, mut refused, sessions) = (0, 0, 1000);
        for _ in 0..sessions {
            let truth = prior.modulus_pa.ln() + 0.15 * Distribution::<f64>::sample(&student, &mut random);
            let own_ln_k = truth + sd * Distribution::<f64>::sample(&StandardNormal, &mut random);
            match PriorResult::new(&prior, Some((own_ln_k, sd))).with_prior {
                Some(with) => {
                    let [low, high] = with.ci95_kpa;
                    covered += usize::from((low..=high).contains(&(1e-3 * truth.exp())));
                }
                None => refused += 1,
            }
        }
        let coverage = covered as f64 / f64::from(sessions - refused);
        assert!((0.93..0.97).contains(&coverage), "held {coverage}");
        assert!((2..=22).contains(&refused), "refused {refused} of {sessions}");
    }

    #[test]
    fn a_prior_that_contradicts_is_not_used_and_one_without_data_is() {
        let contradicted = PriorResult::new(&prior(0.1, 20.0), Some((12e3f64.ln(), 0.05)));
        assert!(
            !contradicted.used
                && contradicted.with_prior.is_none()
                && contradicted.p.is_some_and(|p| p < 1e-3),
            "{contradicted:?}"
        );
        let alone = PriorResult::new(&prior(0.1, 20.0), None);
        assert_eq!(alone.with_prior.map(|with| with.ci95_kpa), Some(alone.k95_kpa));
        // A narrow prior beside an estimate that determines almost nothing.
        let vague = PriorResult::new(&prior(0.01, 20.0), Some((7e3f64.ln(), 2.0)));
        let [low, high] = vague.with_prior.expect("used").ci95_kpa;
        assert!((high / low).ln() < 0.06 && (low..high).contains(&5.0), "{low} to {high}");
    }
}
