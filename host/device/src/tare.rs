//! Quality of a tare: the device's report of its readings, in units, with intervals and a verdict.

use crate::link::Client;
use protocol::{Tare, UNIQUE_CODES};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Share of readings that may be missing.
const MISSING_SHARE: f64 = 0.01;
/// Drift in a minute, as a share of the sensor's rated range, that matters.
const DRIFT_PER_MINUTE: f64 = 0.01;
/// Standard deviation of a reading, as a share of the rated range, above which something shakes or hangs loose.
const NOISE_SHARE: f64 = 0.02;
/// Readings from which on a sound converter must have given [`UNIQUE_CODES`] different codes.
const READINGS_FOR_CODES: u32 = 100;

/// Result of a tare along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TareAxis {
    /// The new zero, relative to the calibration's zero, newtons.
    pub zero_n: f64,
    /// Its standard error, newtons; nothing without readings.
    pub zero_standard_error_n: Option<f64>,
    /// Standard deviation of a single reading about the drift, newtons.
    pub sd_n: f64,
    /// Drift, newtons per second.
    pub drift_n_per_s: f64,
    /// Its 95 % interval, newtons per second, for white noise; nothing below three readings.
    pub drift_ci95_n_per_s: Option<[f64; 2]>,
}

/// Zeros of a tare and the quality of its readings.
#[derive(Debug, Clone, PartialEq)]
pub struct TareQuality {
    /// Along x and y.
    pub axes: [TareAxis; 2],
    /// Time it lasted, seconds.
    pub duration_s: f64,
    /// Valid readings.
    pub readings: u32,
    /// Readings there should have been: one per control period.
    pub expected_readings: u32,
    /// Different codes of converter channel 0 and 1; [`UNIQUE_CODES`] stands for that many or more.
    pub unique_codes: [u8; 2],
    /// Rated range of a force channel, newtons.
    pub force_range_n: f64,
}

/// A fault of a tare.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum TareFault {
    /// No reading was valid.
    #[error("no reading was valid: check the converter's cable and supply")]
    NoReadings,
    /// Too many readings were not valid.
    #[error("{:.1} % of the readings are missing, more than {:.0} %: check the converter's cable and clock", 1e2 * .share, 1e2 * MISSING_SHARE)]
    Missing {
        /// Share of the readings.
        share: f64,
    },
    /// The force drifts, beyond what noise explains.
    #[error(
        "{axis} drifts by {n_per_minute:+.3} N a minute, more than {limit_n:.3} N: let the sensor warm up and the needle rest, tare again"
    )]
    Drift {
        /// Axis.
        axis: char,
        /// Newtons in a minute.
        n_per_minute: f64,
        /// Allowed drift, newtons in a minute.
        limit_n: f64,
    },
    /// The readings scatter more than a sensor at rest does.
    #[error("{axis} scatters by {sd_n:.3} N, more than {limit_n:.3} N: vibration or a loose wire")]
    Noise {
        /// Axis.
        axis: char,
        /// Standard deviation of a reading, newtons.
        sd_n: f64,
        /// Allowed value, newtons.
        limit_n: f64,
    },
    /// The converter gives the same few codes.
    #[error(
        "channel {channel} gave only {codes} distinct codes, a working one gives {UNIQUE_CODES} or more: check the converter"
    )]
    FewCodes {
        /// Channel, 0 or 1.
        channel: usize,
        /// Different codes.
        codes: u8,
    },
}

impl TareQuality {
    /// Quality from a device's tare.
    pub fn new(client: &Client, tare: &Tare) -> Self {
        let scales = client.hello().scales;
        let count_n = f64::from(scales.force_nn_per_count) * 1e-9;
        let period_s = f64::from(client.hello().sample_period_us) * 1e-6;
        Self::of(tare, count_n, period_s, f64::from(scales.force_range_mn) * 1e-3)
    }

    fn of(tare: &Tare, count_n: f64, period_s: f64, force_range_n: f64) -> Self {
        let duration_s = f64::from(tare.periods) * period_s;
        let n = f64::from(tare.readings);
        let [zero_x, zero_y] = tare.zero_counts;
        let [sd_x, sd_y] = tare.sd_counts;
        let [drift_x, drift_y] = tare.drift_counts_per_s;
        Self {
            axes: [((zero_x, sd_x), drift_x), ((zero_y, sd_y), drift_y)].map(|((zero, sd), drift)| {
                let (sd_n, drift_n_per_s) = (f64::from(sd) * count_n, f64::from(drift) * count_n);
                // Slope of a line through n evenly spread readings with white noise, per reading, times readings per second.
                let slope_sd = sd_n * (12.0 / n.powi(3)).sqrt() * (n / duration_s);
                let t = StudentsT::new(0.0, 1.0, n - 2.0).ok().filter(|_| duration_s > 0.0);
                let half = t.map(|t| t.inverse_cdf(0.975) * slope_sd);
                TareAxis {
                    zero_n: f64::from(zero) * count_n,
                    zero_standard_error_n: (n > 0.0).then(|| sd_n / n.sqrt()),
                    sd_n,
                    drift_n_per_s,
                    drift_ci95_n_per_s: half.map(|half| [drift_n_per_s - half, drift_n_per_s + half]),
                }
            }),
            duration_s,
            readings: tare.readings,
            expected_readings: tare.periods,
            unique_codes: tare.unique_codes,
            force_range_n,
        }
    }

    /// Valid readings per second; `None` where the tare took no time.
    pub fn readings_per_s(&self) -> Option<f64> {
        (self.duration_s > 0.0).then(|| f64::from(self.readings) / self.duration_s)
    }

    /// Faults of the tare; empty if it is good.
    pub fn faults(&self) -> Vec<TareFault> {
        if self.readings == 0 {
            return vec![TareFault::NoReadings];
        }
        let mut faults = Vec::new();
        let missing_fraction =
            1.0 - f64::from(self.readings) / f64::from(self.expected_readings.max(self.readings));
        if missing_fraction > MISSING_SHARE {
            faults.push(TareFault::Missing { share: missing_fraction });
        }
        for (axis, found) in ['x', 'y'].into_iter().zip(&self.axes) {
            let limit_n = DRIFT_PER_MINUTE * self.force_range_n;
            let n_per_minute = 60.0 * found.drift_n_per_s;
            let significant = found.drift_ci95_n_per_s.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
            if significant && n_per_minute.abs() > limit_n {
                faults.push(TareFault::Drift { axis, n_per_minute, limit_n });
            }
            let limit_n = NOISE_SHARE * self.force_range_n;
            if found.sd_n > limit_n {
                faults.push(TareFault::Noise { axis, sd_n: found.sd_n, limit_n });
            }
        }
        for (channel, codes) in self.unique_codes.into_iter().enumerate() {
            if self.readings >= READINGS_FOR_CODES && codes < UNIQUE_CODES {
                faults.push(TareFault::FewCodes { channel, codes });
            }
        }
        faults
    }

    /// `good`, or the faults.
    pub fn verdict(&self) -> String {
        let faults: Vec<String> = self.faults().iter().map(ToString::to_string).collect();
        if faults.is_empty() { "good".to_owned() } else { faults.join("; ") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    const GOOD: Tare = Tare {
        zero_counts: [2_000, -100],
        sd_counts: [100, 90],
        drift_counts_per_s: [5, -3],
        periods: 1_000,
        readings: 998,
        unique_codes: [UNIQUE_CODES; 2],
    };

    /// Counts of 50 uN, periods of 1 ms, a range of 5 N.
    fn of(tare: Tare) -> TareQuality {
        TareQuality::of(&tare, 50e-6, 1e-3, 5.0)
    }

    #[test]
    fn a_good_tare_is_reported_in_units() {
        let quality = of(GOOD);
        let [x, y] = quality.axes;
        assert!((x.zero_n - 0.1).abs() < 1e-12 && (y.sd_n - 4.5e-3).abs() < 1e-12);
        assert!((x.zero_standard_error_n.expect("readings") - 5e-3 / 998f64.sqrt()).abs() < 1e-12);
        let [low, high] = x.drift_ci95_n_per_s.expect("readings");
        let half = 1.962 * 5e-3 * (12.0 / 998f64.powi(3)).sqrt() * 998.0;
        assert!(
            (0.5 * (high - low) / half - 1.0).abs() < 1e-3 && (0.5 * (low + high) - 250e-6).abs() < 1e-12
        );
        assert!((quality.readings_per_s().expect("time") - 998.0).abs() < 1e-9);
        assert_eq!(quality.verdict(), "good");
    }

    #[test]
    fn what_is_wrong_is_reported() {
        fn faulty(tare: Tare, expected: &str) {
            let verdict = of(tare).verdict();
            assert!(verdict.contains(expected), "{verdict}");
        }
        faulty(Tare { readings: 0, ..GOOD }, "no reading was valid");
        faulty(Tare { readings: 0, periods: 0, ..GOOD }, "no reading was valid");
        faulty(Tare { readings: 980, ..GOOD }, "2.0 % of the readings are missing");
        faulty(
            Tare { drift_counts_per_s: [0, -40], ..GOOD },
            "y drifts by -0.120 N a minute, more than 0.050 N",
        );
        faulty(Tare { sd_counts: [2_500, 90], ..GOOD }, "x scatters by 0.125 N");
        faulty(Tare { unique_codes: [UNIQUE_CODES, 3], ..GOOD }, "channel 1 gave only 3 distinct codes");
        let two_faults = of(Tare { readings: 900, unique_codes: [1, UNIQUE_CODES], ..GOOD });
        assert_eq!(two_faults.faults().len(), 2);
        assert!(two_faults.verdict().contains("; "));
    }

    #[test]
    fn what_noise_explains_is_no_fault() {
        // A drift of 0.15 N a minute that these readings cannot distinguish from none, and few codes of few readings.
        let short =
            Tare { drift_counts_per_s: [50, 0], periods: 20, readings: 20, unique_codes: [9, 8], ..GOOD };
        assert_eq!(of(short).verdict(), "good");
        let tiny = of(Tare { periods: 2, readings: 2, unique_codes: [2, 2], ..GOOD });
        assert_eq!((tiny.axes[0].drift_ci95_n_per_s, tiny.verdict().as_str()), (None, "good"));
    }

    #[test]
    fn the_interval_of_the_drift_has_its_stated_coverage() {
        let mut noise = Noise::new(11);
        let (n, trials) = (200, 400);
        let mut covered = 0;
        for _ in 0..trials {
            let values: Vec<f64> = (0..n).map(|_| 100.0 * noise.normal()).collect();
            let centre = 0.5 * f64::from(n - 1);
            let moment: f64 = values.iter().zip(0..n).map(|(v, i)| v * (f64::from(i) - centre)).sum();
            let square: f64 = (0..n).map(|i| (f64::from(i) - centre).powi(2)).sum();
            let drift = (1e3 * moment / square).round() as i32;
            let tare = Tare {
                drift_counts_per_s: [drift, 0],
                periods: n as u32,
                readings: n as u32,
                sd_counts: [100, 100],
                ..GOOD
            };
            let [low, high] = of(tare).axes[0].drift_ci95_n_per_s.expect("readings");
            covered += u32::from(low <= 0.0 && 0.0 <= high);
        }
        let coverage = f64::from(covered) / f64::from(trials);
        assert!((0.92..=0.98).contains(&coverage), "{coverage}");
    }
}
