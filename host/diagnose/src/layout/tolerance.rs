//! Statements about a rig: mostly right within a tolerance, and now and then not (theory, eq. 84).

/// A place that is stated of the rig and unknown within a tolerance.
#[derive(Debug, Clone, Copy)]
pub struct StatedPlace {
    /// Number of the parameter: how much further from guide 1 it is than stated, m.
    pub parameter: usize,
    /// Name of the quantity.
    pub name: &'static str,
    /// The effect that it is by name.
    pub effect: &'static str,
    /// Its tolerance.
    pub scale_m: f64,
}

impl StatedPlace {
    /// Its prior.
    pub fn prior(&self) -> HeavyTailed {
        HeavyTailed { scale: self.scale_m }
    }
}

/// Student's t with three degrees of freedom, the heaviest tail of whole degrees that still has a standard deviation: what is stated of a
/// rig is mostly right within its tolerance, and now and then wrong by many of them, as where a guide was measured to its other face. In
/// a fit a normal prior stands for it whose standard deviation follows the value (iteratively reweighted: every round minimises a bound of
/// the true objective that touches it at the current value).
pub struct HeavyTailed {
    scale: f64,
}

impl HeavyTailed {
    const FREEDOM: f64 = 3.0;

    /// Standard deviation of the normal prior that stands for it around a value.
    pub fn sd_at(&self, value: f64) -> f64 {
        ((Self::FREEDOM * self.scale * self.scale + value * value) / (Self::FREEDOM + 1.0)).sqrt()
    }

    /// Mean and variance under it of what a fit with the normal prior at its end gives as `value` and `variance`; nothing where the data
    /// have nothing of their own, as then the fit is as good as the prior.
    pub fn moments(&self, value: f64, variance: f64) -> Option<(f64, f64)> {
        let of_prior = self.sd_at(value).powi(-2);
        let of_data = variance.recip() - of_prior;
        if of_data <= 0.0 {
            return None;
        }
        let (mean, sd) = (value / (variance * of_data), of_data.sqrt().recip());
        // Both the data and the core of the prior are within this, which is as fine as the narrower of them needs.
        let reach = mean.abs() + 8.0 * sd.max(self.scale);
        let step = (0.1 * sd.min(self.scale)).max(reach / 20_000.0);
        let count = (reach / step).ceil() as i32;
        let (mut weights, mut first, mut second) = (0.0, 0.0, 0.0);
        for number in -count..=count {
            let node = f64::from(number) * step;
            let ln_tail =
                -0.5 * (Self::FREEDOM + 1.0) * ((node / self.scale).powi(2) / Self::FREEDOM).ln_1p();
            let weight = (ln_tail - 0.5 * ((node - mean) / sd).powi(2)).exp();
            weights += weight;
            first += weight * node;
            second += weight * node * node;
        }
        let mean = first / weights;
        let variance = second / weights - mean * mean;
        (weights > 0.0 && variance > 0.0).then_some((mean, variance))
    }

    pub fn ln_over_normal(&self, value: f64) -> f64 {
        let sd = self.sd_at(value);
        let normalized = value / self.scale;
        // Density for three degrees of freedom: 2 / (pi sqrt(3)).
        let ln_peak = (2.0 / (std::f64::consts::PI * 3f64.sqrt() * self.scale)).ln();
        let ln_tail = -0.5 * (Self::FREEDOM + 1.0) * (normalized * normalized / Self::FREEDOM).ln_1p();
        let ln_normal = -0.5 * (value / sd).powi(2) - (sd * std::f64::consts::TAU.sqrt()).ln();
        ln_peak + ln_tail - ln_normal
    }
}
