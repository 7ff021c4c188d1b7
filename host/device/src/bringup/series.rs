//! Statistics of a recorded channel: mean, trend, noise, and lines of the mains.

use std::f64::consts::TAU;

/// A channel at rest, at even times.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rest {
    /// Mean.
    pub mean: f64,
    /// Slope of a straight line, per second.
    pub slope_per_s: f64,
    /// Standard error of the slope.
    pub slope_error_per_s: f64,
    /// Standard deviation about the line and the mains' lines.
    pub sd: f64,
    /// Frequency of the stronger mains, hertz, and the amplitude of its fundamental.
    pub mains: (f64, f64),
    /// Amplitudes of its second and third harmonic.
    pub harmonics: [f64; 2],
}

/// Harmonics of the mains that are fitted.
const HARMONICS: u32 = 3;

impl Rest {
    /// Statistics of values at these times, seconds. `None` if there are too few for a line of the
    /// mains.
    pub fn of(time_s: &[f64], values: &[f64]) -> Option<Self> {
        let (first, last) = (time_s.first()?, time_s.last()?);
        let count = time_s.len().min(values.len());
        if count < 500 || last - first < 0.5 {
            return None;
        }
        let n = count as f64;
        fn mean_of(series: &[f64], n: f64) -> f64 {
            series.iter().sum::<f64>() / n
        }
        let (mean_s, mean) = (mean_of(time_s, n), mean_of(values, n));
        let spread: f64 = time_s.iter().map(|t| (t - mean_s).powi(2)).sum();
        let slope = time_s.iter().zip(values).map(|(t, v)| (t - mean_s) * (v - mean)).sum::<f64>() / spread;
        let mut residuals: Vec<f64> =
            time_s.iter().zip(values).map(|(t, v)| v - mean - slope * (t - mean_s)).collect();
        let strongest = [50.0, 60.0].into_iter().map(|hertz| (hertz, line(time_s, &residuals, hertz).0));
        let (hertz, _) = strongest.max_by(|a, b| a.1.total_cmp(&b.1))?;
        let mut amplitudes = [0.0; HARMONICS as usize];
        for (harmonic, amplitude) in (1..=HARMONICS).zip(&mut amplitudes) {
            let frequency_hz = hertz * f64::from(harmonic);
            let (size, cos, sin) = line(time_s, &residuals, frequency_hz);
            *amplitude = size;
            for (residuals, t) in residuals.iter_mut().zip(time_s) {
                let (s, c) = (TAU * frequency_hz * t).sin_cos();
                *residuals -= cos * c + sin * s;
            }
        }
        let sd = (residuals.iter().map(|v| v * v).sum::<f64>() / (n - 2.0)).sqrt();
        let [fundamental, second, third] = amplitudes;
        Some(Self {
            mean,
            slope_per_s: slope,
            slope_error_per_s: sd / spread.sqrt(),
            sd,
            mains: (hertz, fundamental),
            harmonics: [second, third],
        })
    }
}

/// Amplitude of a line at a frequency, and its parts in cosine and sine: projections, which over many periods are least squares.
fn line(time_s: &[f64], values: &[f64], hertz: f64) -> (f64, f64, f64) {
    let (mut cos, mut sin) = (0.0, 0.0);
    for (t, v) in time_s.iter().zip(values) {
        let (s, c) = (TAU * hertz * t).sin_cos();
        cos += v * c;
        sin += v * s;
    }
    let scale = 2.0 / values.len() as f64;
    (scale * cos.hypot(sin), scale * cos, scale * sin)
}

#[cfg(test)]
mod tests {
    use super::*;
    use noise::Noise;

    fn series(hertz: f64, amplitude: f64, slope: f64) -> (Vec<f64>, Vec<f64>) {
        let mut noise = Noise::new(4);
        let times: Vec<f64> = (0..4_000).map(|i| 7.3 + 1e-3 * f64::from(i)).collect();
        let values = times
            .iter()
            .map(|t| 0.2 + slope * t + amplitude * (TAU * hertz * t + 1.0).sin() + 0.005 * noise.normal())
            .collect();
        (times, values)
    }

    #[test]
    fn finds_the_line_the_trend_and_the_noise_beside_each_other() {
        for (hertz, amplitude, slope) in [(50.0, 0.0, 0.0), (50.0, 0.02, 0.01), (60.0, 0.2, -0.05)] {
            let (times, values) = series(hertz, amplitude, slope);
            let statistics = Rest::of(&times, &values).expect("enough");
            assert!((statistics.sd / 0.005 - 1.0).abs() < 0.1, "{statistics:?}");
            assert!(
                (statistics.slope_per_s - slope).abs()
                    < 5.0 * statistics.slope_error_per_s + 1e-3 * amplitude,
                "{statistics:?}"
            );
            assert!((statistics.mains.1 - amplitude).abs() < 0.002 + 0.01 * amplitude, "{statistics:?}");
            assert!(amplitude == 0.0 || statistics.mains.0 == hertz, "{statistics:?}");
        }
    }

    #[test]
    fn too_few_readings_give_nothing() {
        assert_eq!(Rest::of(&[0.0, 0.1], &[1.0, 1.0]), None);
        assert_eq!(Rest::of(&[], &[]), None);
    }
}
