//! Heavy-tailed priors of stated positions of a rig and of the sizes of effects (theory, eq. 84).

/// A stated position of the rig that is uncertain within a tolerance.
#[derive(Debug, Clone, Copy)]
pub struct StatedPlace {
    /// Index of the parameter: true less stated distance from guide 1, m.
    pub parameter: usize,
    /// Name of the quantity.
    pub name: &'static str,
    /// The effect that names it.
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

/// A parameter whose prior has heavy tails.
#[derive(Debug, Clone, Copy)]
pub struct HeavyTailedParameter {
    /// Number of the parameter.
    pub parameter: usize,
    /// Center of the prior, in the scale of the fits.
    pub center: f64,
    /// Distribution around the center.
    pub prior: HeavyTailed,
}

impl HeavyTailedParameter {
    /// The parameter of a stated position.
    pub fn of_place(place: StatedPlace) -> Self {
        Self { parameter: place.parameter, center: 0.0, prior: place.prior() }
    }
}

/// Student's t with three degrees of freedom, the smallest whole number with which it has a standard deviation. A stated
/// position is mostly right within its tolerance, and now and then wrong by many tolerances, for example if a guide was
/// measured to its other face. An effect mostly has a size that a careful laboratory may overlook, and now and then a much
/// larger one. Under a normal prior ten standard deviations would cost fifty nats, and a wrong effect at two standard
/// deviations would be named instead.
///
/// In a fit it is approximated by a normal prior whose standard deviation depends on the value (iterative reweighting: every
/// iteration minimizes an upper bound of the objective that touches it at the current value).
#[derive(Debug, Clone, Copy)]
pub struct HeavyTailed {
    /// Scale of ordinary values.
    pub scale: f64,
}

impl HeavyTailed {
    const FREEDOM: f64 = 3.0;

    /// Standard deviation of the normal prior that approximates it around a value.
    pub fn sd_at(&self, value: f64) -> f64 {
        ((Self::FREEDOM * self.scale * self.scale + value * value) / (Self::FREEDOM + 1.0)).sqrt()
    }

    /// Posterior mean and variance under this prior, from `value` and `variance` of a fit with the normal prior; `None` if the
    /// data carry no information of their own, so that the fit equals the prior.
    pub fn moments(&self, value: f64, variance: f64) -> Option<(f64, f64)> {
        let of_prior = self.sd_at(value).powi(-2);
        let of_data = variance.recip() - of_prior;
        if of_data <= 0.0 {
            return None;
        }
        let (mean, sd) = (value / (variance * of_data), of_data.sqrt().recip());
        // The grid contains the data and the core of the prior, with a step that is fine enough for the narrower of the two.
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

    /// Log density less that of the normal prior that approximates it around a value.
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

#[cfg(test)]
mod tests {
    use super::*;

    const PRIOR: HeavyTailed = HeavyTailed { scale: 0.3 };

    /// Logarithm of the density at a value, by the normal prior that stands for it around another one.
    fn ln_density(value: f64, around: f64) -> f64 {
        let sd = PRIOR.sd_at(around);
        let ln_normal = |x: f64| -0.5 * (x / sd).powi(2) - (sd * std::f64::consts::TAU.sqrt()).ln();
        ln_normal(value) + PRIOR.ln_over_normal(around)
    }

    #[test]
    fn the_density_is_that_of_students_t() {
        let step = 1e-3;
        let mass: f64 = (-200_000..=200_000)
            .map(|number| {
                let value = f64::from(number) * step;
                step * ln_density(value, value).exp()
            })
            .sum();
        assert!((mass - 1.0).abs() < 1e-6, "{mass}");
        // Ten standard deviations cost what they are worth: not fifty nats but seven.
        let cost = ln_density(0.0, 0.0) - ln_density(3.0, 3.0);
        assert!((cost - 2.0 * (1.0 + 100.0 / 3.0_f64).ln()).abs() < 1e-12, "{cost}");
    }

    #[test]
    fn the_normal_prior_touches_it_from_below() {
        for around in [0.0, 0.2, 1.0, 4.0] {
            for value in [0.0, 0.1, 0.5, 1.0, 2.0, 8.0] {
                assert!(ln_density(value, around) <= ln_density(value, value) + 1e-12, "{value} {around}");
            }
        }
    }

    /// Informative data determine the value; uninformative data leave the spread of the prior.
    #[test]
    fn moments_are_those_of_data_and_tail() {
        let with_data = |mean: f64, data_sd: f64| {
            // Mean and variance at which a fit ends, with the normal prior that stands for this one.
            let mut value = mean;
            for _ in 0..200 {
                value = mean / (1.0 + (data_sd / PRIOR.sd_at(value)).powi(2));
            }
            let variance = (data_sd.powi(-2) + PRIOR.sd_at(value).powi(-2)).recip();
            PRIOR.moments(value, variance).expect("moments")
        };
        let (mean, variance) = with_data(3.0, 0.05);
        assert!((mean - 3.0).abs() < 0.01 && (variance.sqrt() - 0.05).abs() < 1e-3, "{mean} {variance}");
        let (mean, variance) = with_data(0.0, 30.0);
        // Standard deviation of Student's t with three degrees of freedom.
        let expected = PRIOR.scale * 3f64.sqrt();
        assert!(mean.abs() < 1e-9 && (variance.sqrt() / expected - 1.0).abs() < 0.05, "{mean} {variance}");
    }
}
