//! Sequential test of whether readings still follow a model, after every reading (theory, eq. 86, 87 and 89).
//!
//! The residual, measurement less model, has autocorrelated noise and an error of the model within a known tolerance (friction, the
//! interval of the modulus). Let `z` be the residual less its prediction from the previous one, in standard deviations of this
//! innovation. Under the model the mean of `z` given the past is within a known `d`. So `exp(l (z - d) - l^2 / 2)` has a mean of at
//! most 1 for every `l > 0`, and the sum `M` of its products from every beginning until now (the detector of Shiryaev and Roberts)
//! grows by at most 1 a step on average. Therefore the mean time to a false alarm is at least the threshold of `M`, in steps, however
//! often `M` is examined (Shin, Ramdas and Rinaldo, "E-detectors: a nonparametric framework for sequential change detection", 2023).

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Shifts of the mixture, in standard deviations of an innovation: small ones, which are detected after many steps, and large ones, which
/// are detected at once.
const SHIFTS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// Largest excess of an innovation over the tolerance that counts, in standard deviations. One step multiplies the sum of a shift by at
/// most `exp(18)`, and raises the mean over the ten sums to about a tenth of that, `exp(15.7)`. The threshold of one alarm in a thousand
/// hours is `exp(17.4)`, so that a single outlying step, such as a touch, causes no alarm. Clipping only lowers the evidence.
const MOST_SD: f64 = 6.0;
/// Confidence that the true standard deviation does not exceed the calibrated one.
const SURE: f64 = 0.999;
/// Upper limit of the correlation of neighbours: with a larger one the innovation would be little more than the difference of neighbours.
const MOST_CORRELATION: f64 = 0.98;

/// Noise of the residuals, step by step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StepNoise {
    /// Standard deviation.
    pub sd: f64,
    /// Correlation of neighbours, 0 to 1.
    pub correlation: f64,
}

impl StepNoise {
    /// Steps that are independent of each other.
    pub fn independent(sd: f64) -> Self {
        Self { sd, correlation: 0.0 }
    }

    /// Estimates the noise from residuals at rest. The standard deviation is the upper confidence limit of 99.9 %, because one that is too
    /// small causes false alarms. `None` for fewer than three steps.
    pub fn of_rest(steps: &[f64]) -> Option<Self> {
        let count = steps.len() as f64;
        if steps.len() < 3 {
            return None;
        }
        let mean = steps.iter().sum::<f64>() / count;
        let squares: f64 = steps.iter().map(|value| (value - mean).powi(2)).sum();
        let products: f64 = steps.windows(2).map(|pair| (pair[0] - mean) * (pair[1] - mean)).sum();
        let correlation = if squares > 0.0 { (products / squares).clamp(0.0, MOST_CORRELATION) } else { 0.0 };
        // Correlated steps count as fewer independent ones.
        let independent = ((count - 1.0) * (1.0 - correlation) / (1.0 + correlation)).max(1.0);
        let least = ChiSquared::new(independent).ok()?.inverse_cdf(1.0 - SURE);
        let sd = (squares / (count - 1.0) * independent / least).sqrt();
        (sd.is_finite() && sd > 0.0).then_some(Self { sd, correlation })
    }

    /// Standard deviation of an innovation: a residual less its prediction from the previous one.
    fn of_innovation(&self) -> f64 {
        self.sd * (1.0 - self.correlation * self.correlation).sqrt()
    }
}

/// A departure of the readings from the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// Number of the first step of the departure, from 0.
    pub since: u64,
    /// Mean residual since then.
    pub mean: f64,
    /// Sum of the innovations beyond the tolerance since then, in standard deviations of this sum.
    pub sigma: f64,
}

/// The detector.
#[derive(Debug, Clone)]
pub struct Detector {
    noise: StepNoise,
    /// Logarithm of the threshold.
    ln_threshold: f64,
    /// Logarithm of the sum of each shift, up and down.
    ln_sums: [[f64; SHIFTS.len()]; 2],
    /// Start and logarithm of the current evidence for each shift, up and down.
    runs: [[Run; SHIFTS.len()]; 2],
    steps: u64,
    last: Option<f64>,
}

/// The evidence for a shift since it last began anew, that is, since its logarithm was last not above 0.
#[derive(Debug, Clone, Copy, Default)]
struct Run {
    since: u64,
    ln: f64,
    /// Since then: sum of the residuals, sum of the innovations beyond the tolerance, and number of steps.
    sum: f64,
    beyond: f64,
    count: f64,
}

impl Detector {
    /// A detector for this noise, with steps of `step_s` seconds and on average at most `false_alarms_per_hour`.
    pub fn new(noise: StepNoise, step_s: f64, false_alarms_per_hour: f64) -> Self {
        let steps = 3600.0 / (step_s * false_alarms_per_hour).max(f64::MIN_POSITIVE);
        Self {
            noise,
            ln_threshold: steps.ln(),
            ln_sums: [[f64::NEG_INFINITY; SHIFTS.len()]; 2],
            runs: Default::default(),
            steps: 0,
            last: None,
        }
    }

    /// Adds a step: the residual, the largest error of the model there, and the largest change of this error since the previous
    /// step (friction, if guide 2 reverses). Returns the departure while the threshold is exceeded; the detector continues in any case.
    pub fn step(&mut self, difference: f64, tolerance: f64, change: f64) -> Option<Departure> {
        if !(difference.is_finite() && tolerance.is_finite() && change.is_finite()) {
            // A missing measurement neither contributes nor predicts.
            self.last = None;
            self.steps += 1;
            return None;
        }
        // If the model is off by b now and was off by b - c before, the innovation is off by (1 - r) b + r c.
        let (predicted, allowed, sd) = match self.last {
            Some(last) => {
                let r = self.noise.correlation;
                (r * last, (1.0 - r) * tolerance.abs() + r * change.abs(), self.noise.of_innovation())
            }
            None => (0.0, tolerance.abs(), self.noise.sd),
        };
        let (innovation, allowed) = ((difference - predicted) / sd, allowed / sd);
        self.last = Some(difference);
        let detected_step = self.steps;
        self.steps += 1;
        let mut best: Option<(f64, Run, f64)> = None;
        for (side, sign) in [1.0, -1.0].into_iter().enumerate() {
            let excess = (sign * innovation - allowed).min(MOST_SD);
            for (place, shift) in SHIFTS.into_iter().enumerate() {
                let ln = shift * excess - 0.5 * shift * shift;
                let sum = &mut self.ln_sums[side][place];
                *sum = ln_add(*sum, 0.0) + ln;
                let run = &mut self.runs[side][place];
                if run.ln <= 0.0 {
                    *run = Run { since: detected_step, ..Run::default() };
                }
                run.ln += ln;
                run.sum += difference;
                run.beyond += excess;
                run.count += 1.0;
                if best.is_none_or(|(most, ..)| *sum > most) {
                    best = Some((*sum, *run, sign));
                }
            }
        }
        let ln_total = self.ln_sums.iter().flatten().fold(f64::NEG_INFINITY, |all, sum| ln_add(all, *sum));
        // All shifts have equal weights in the mixture.
        let mixture = ln_total - ((2 * SHIFTS.len()) as f64).ln();
        let (_, run, sign) = best.filter(|_| mixture > self.ln_threshold)?;
        Some(Departure {
            since: run.since,
            mean: run.sum / run.count,
            sigma: sign * run.beyond / run.count.sqrt(),
        })
    }

    /// Discards the evidence so far, after a departure has been handled.
    pub fn reset(&mut self) {
        self.ln_sums = [[f64::NEG_INFINITY; SHIFTS.len()]; 2];
        self.runs = Default::default();
        self.last = None;
    }
}

/// Logarithm of a sum.
fn ln_add(a: f64, b: f64) -> f64 {
    let (most, least) = if a > b { (a, b) } else { (b, a) };
    if most.is_finite() { most + (least - most).exp().ln_1p() } else { most }
}

#[cfg(test)]
mod tests;
