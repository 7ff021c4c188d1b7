//! Whether readings still follow a model, asked after every one of them (theory, eq. 86, 87 and 89).
//!
//! The difference of measurement and model has noise whose neighbours are alike, and may be off by a known tolerance:
//! friction, the interval of the modulus. Less what its predecessor predicts of it, and over the standard deviation of
//! what is left, a difference `z` has under the model a mean within a known `d`, whatever came before. So `exp(l (z -
//! d) - l^2 / 2)` has a mean of at most 1 for every `l > 0`, and the sum `M` of its products from every beginning until
//! now (the detector of Shiryaev and Roberts) grows by at most 1 a step in the mean. The likelihood ratio bounds how
//! often it exceeds a threshold, whenever and however often it is examined: the mean time between false alarms is at
//! least the threshold in steps (Shin, Ramdas and Rinaldo, "E-detectors: a nonparametric framework for sequential
//! change detection", 2023).

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Shifts, in standard deviations of a step, that the mixture looks for: small ones that last and large ones at once.
const SHIFTS: [f64; 5] = [0.5, 1.0, 2.0, 4.0, 8.0];
/// A difference that is further beyond what is allowed counts as this many standard deviations. With it one step multiplies the sum of a
/// shift by at most `exp(18)`, and the mean over the ten of them by a tenth of that, `exp(15.7)`: below the threshold of one alarm in a
/// thousand hours, `exp(17.4)`, so that a single step that is far off, a touch, is no departure. Less than it is only makes the evidence less.
const MOST_SD: f64 = 6.0;
/// Probability with which the standard deviation that a calibration states is not exceeded by the true one.
const SURE: f64 = 0.999;
/// Correlation of neighbours above which their differences would be all that is left.
const MOST_CORRELATION: f64 = 0.98;

/// Noise of the differences of measurement and model, step by step.
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

    /// As steps show it in which nothing happens: the standard deviation is the largest that they leave possible with a probability of
    /// 99.9 %, because one that is too small gives false alarms; nothing for fewer than three of them.
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

    /// Standard deviation of a step less what its predecessor predicts of it.
    fn of_innovation(&self) -> f64 {
        self.sd * (1.0 - self.correlation * self.correlation).sqrt()
    }
}

/// Since when, and by how much, readings no longer follow the model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Departure {
    /// Number of the first step that does not, from 0.
    pub since: u64,
    /// Mean difference of measurement and model since then.
    pub mean: f64,
    /// Sum of the steps' differences since then, standard deviations.
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
    /// Start of the present evidence for each shift, and its logarithm.
    runs: [[Run; SHIFTS.len()]; 2],
    steps: u64,
    last: Option<f64>,
}

/// The evidence for a shift since it was last against it.
#[derive(Debug, Clone, Copy, Default)]
struct Run {
    since: u64,
    ln: f64,
    /// Sums since then: of the differences, of the innovations beyond the tolerance, and how many they are.
    sum: f64,
    beyond: f64,
    count: f64,
}

impl Detector {
    /// For noise, with steps of so many seconds and at most so many false alarms an hour in the mean.
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

    /// Takes in a step: measurement less model, by how much the model may be off there, and by how much what it is off
    /// may have changed since the step before (friction where guide 2 turns back). Departure that is detected when the
    /// threshold is exceeded; detection goes on all the same.
    pub fn step(&mut self, difference: f64, tolerance: f64, change: f64) -> Option<Departure> {
        if !(difference.is_finite() && tolerance.is_finite() && change.is_finite()) {
            // A missing measurement neither contributes nor predicts.
            self.last = None;
            self.steps += 1;
            return None;
        }
        // Off by b now and by b - c before, the innovation is off by (1 - r) b + r c.
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
        // Each of the shifts has an equal part of the mixture.
        let mixture = ln_total - ((2 * SHIFTS.len()) as f64).ln();
        let (_, run, sign) = best.filter(|_| mixture > self.ln_threshold)?;
        Some(Departure {
            since: run.since,
            mean: run.sum / run.count,
            sigma: sign * run.beyond / run.count.sqrt(),
        })
    }

    /// Begins again, after what was found has been dealt with.
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
