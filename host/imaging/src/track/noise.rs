//! Errors of a sequence's echoes: how large they are beside what each image states, and how far along the needle neighbours share them.
//!
//! Frames that are closer than the beam is thick show the same speckle, so that they err together. A curve that is fitted to them follows a part
//! of that, and neither the size of the residuals nor their correlation shows it. So both are estimated by restricted maximum likelihood,
//! which counts what the curve takes (Patterson and Thompson, Recovery of inter-block information when block sizes are unequal, 1971): errors
//! are the sum of one that is each frame's own and one that is correlated like the overlap of two beams, and the result is the mean over widths and
//! shares, weighted by their likelihood.

use super::Echo;
use crate::curve::Splines;
use nalgebra::{DMatrix, DVector};

/// Widths of the correlation along the needle, millimetres: from a fraction of the step between frames to that of a beam 4 mm thick.
const WIDTHS_MM: [f64; 6] = [0.2, 0.4, 0.6, 0.8, 1.2, 1.6];
/// Shares of the variance that neighbours share. In speckle without noise nearly all of it is, and a frame's own part sets the scale of the
/// rest: a share that ends at 95 % makes errors half as large as they are.
const SHARES: [f64; 5] = [0.5, 0.8, 0.95, 0.99, 0.997];
/// Frames for each interval between knots, at least.
const FRAMES_PER_INTERVAL: usize = 4;
/// Frames that are taken together: what is shared across the border of two blocks is omitted, and the time grows with their number.
const BLOCK: usize = 128;

/// Errors along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Factor of the standard deviations from images.
    pub scale: f64,
    /// Successive frames that share their error: by so much a mean of many has more variance than one of independent frames.
    pub correlated_frames: f64,
}

/// One assumption about the errors, and what follows from it for a sequence.
#[derive(Default)]
struct Assumed {
    /// Determinant of the errors' correlation and of the curve.
    log_determinant: f64,
    /// Sum of squares about the curve.
    squares: f64,
    freedom: usize,
    /// Sum over the frames of how many share the error of each.
    shared: f64,
    frames: usize,
}

/// A sequence: its frames with what a curve can be at each, and the error last, in standard deviations.
struct Sequence {
    rows: DMatrix<f64>,
    places_mm: Vec<f64>,
    freedom: usize,
}

impl Noise {
    /// Noise of echoes in the order of their positions along the needle; `None` if they are too
    /// few.
    pub fn of(echoes: &[Echo], axis: usize) -> Option<Self> {
        Self::of_all(&[echoes], axis)
    }

    /// The one noise of several sequences of one scanner; those with too few echoes add nothing. A single sequence shows the size of its errors
    /// and how far they are shared so uncertainly that every sixth states half or twice its variance, or less or more.
    pub fn of_all(sequences: &[&[Echo]], axis: usize) -> Option<Self> {
        let sequences: Vec<Sequence> =
            sequences.iter().filter_map(|echoes| Sequence::of(echoes, axis)).collect();
        // As likely beforehand as that something is shared.
        let width_and_share_count = (WIDTHS_MM.len() * SHARES.len()) as f64;
        let white = assumed(&sequences, WIDTHS_MM[0], 0.0).map(|own| (width_and_share_count.ln(), own));
        let shared = WIDTHS_MM.into_iter().flat_map(|width_mm| SHARES.map(|share| (width_mm, share)));
        let shared = shared.filter_map(|(mm, share)| Some((0.0, assumed(&sequences, mm, share)?)));
        let models: Vec<(f64, Assumed)> = white.into_iter().chain(shared).collect();
        let best = models.iter().map(log_posterior).reduce(f64::max)?;
        let [weights, variance, correlated] =
            models.iter().fold([0.0; 3], |[sum, variance, correlated], one| {
                let weight = (log_posterior(one) - best).exp();
                let (_, best) = one;
                let weighted = weight * best.squares / best.freedom as f64;
                [sum + weight, variance + weighted, correlated + weighted * best.shared / best.frames as f64]
            });
        let noise =
            Self { scale: (variance / weights).sqrt(), correlated_frames: (correlated / variance).max(1.0) };
        (noise.scale.is_finite() && noise.scale > 0.0 && noise.correlated_frames.is_finite()).then_some(noise)
    }
}

fn log_posterior((prior, one): &(f64, Assumed)) -> f64 {
    prior + one.log_likelihood()
}

impl Assumed {
    /// With the variance integrated out under a prior that has no scale.
    fn log_likelihood(&self) -> f64 {
        -0.5 * (self.log_determinant + (self.freedom + 2) as f64 * self.squares.ln())
    }
}

impl Sequence {
    /// `None` if the echoes are too few for a curve.
    fn of(echoes: &[Echo], axis: usize) -> Option<Self> {
        let (first, last) = (echoes.first()?, echoes.last()?);
        let most = (echoes.len() / FRAMES_PER_INTERVAL).max(1);
        let splines = Splines::over(first.z_mm, last.z_mm, most)?;
        let columns = splines.count();
        let freedom = echoes.len().checked_sub(columns + 2).filter(|freedom| *freedom > 0)?;
        let mut rows = DMatrix::<f64>::zeros(echoes.len(), columns + 1);
        for (number, echo) in echoes.iter().enumerate() {
            let (first_knot, basis) = splines.at(echo.z_mm);
            for (offset, value) in basis.into_iter().enumerate() {
                rows[(number, first_knot + offset)] = value / echo.sd_mm[axis];
            }
            rows[(number, columns)] = echo.across_mm[axis] / echo.sd_mm[axis];
        }
        Some(Self { rows, places_mm: echoes.iter().map(|echo| echo.z_mm).collect(), freedom })
    }

    /// Fits the last column by the others, with errors of which neighbours share a part.
    fn fitted(&self, width_mm: f64, share: f64) -> Option<Assumed> {
        let columns = self.rows.ncols() - 1;
        let mut products = DMatrix::<f64>::zeros(columns + 1, columns + 1);
        let (mut log_determinant, mut shared, mut first_echo) = (0.0, 0.0, 0);
        for places_mm in self.places_mm.chunks(BLOCK) {
            let count = places_mm.len();
            let covariance = DMatrix::from_fn(count, count, |i, j| {
                if i == j { 1.0 } else { covariance_of(i, j, share, width_mm, places_mm) }
            });
            shared += covariance.sum();
            let factor = covariance.cholesky()?;
            log_determinant += 2.0 * factor.l_dirty().diagonal().map(f64::ln).sum();
            let block = self.rows.rows(first_echo, count).into_owned();
            products += block.transpose() * factor.solve(&block);
            first_echo += count;
        }
        let normal = products.view((0, 0), (columns, columns)).into_owned().cholesky()?;
        let right: DVector<f64> = products.view((0, columns), (columns, 1)).column(0).into_owned();
        let squares = products[(columns, columns)] - right.dot(&normal.solve(&right));
        let curve_determinant: f64 = 2.0 * normal.l_dirty().diagonal().map(f64::ln).sum();
        Some(Assumed {
            log_determinant: log_determinant + curve_determinant,
            squares,
            freedom: self.freedom,
            shared,
            frames: self.places_mm.len(),
        })
    }
}

fn covariance_of(i: usize, j: usize, share: f64, width_mm: f64, places_mm: &[f64]) -> f64 {
    share * (-0.5 * ((places_mm[i] - places_mm[j]) / width_mm).powi(2)).exp()
}

/// Fit of all sequences together, each with a curve of its own.
fn assumed(sequences: &[Sequence], width_mm: f64, share: f64) -> Option<Assumed> {
    let mut total = Assumed::default();
    for sequence in sequences {
        let sequence_fit = sequence.fitted(width_mm, share)?;
        total.log_determinant += sequence_fit.log_determinant;
        total.squares += sequence_fit.squares;
        total.freedom += sequence_fit.freedom;
        total.shared += sequence_fit.shared;
        total.frames += sequence_fit.frames;
    }
    (total.frames > 0 && total.log_likelihood().is_finite()).then_some(total)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const STEP_MM: f64 = 0.3;
    const SD_MM: f64 = 0.02;

    fn normal(random: &mut impl Rng) -> f64 {
        StandardNormal.sample(random)
    }

    /// Errors of unit variance that neighbours share as speckle is shared, by the overlap of two beams: not as the estimator assumes it.
    fn speckled(random: &mut impl Rng, count: usize, width_mm: f64) -> Vec<f64> {
        let half = (4.0 * width_mm / STEP_MM).ceil() as usize;
        let source: Vec<f64> = (0..count + 2 * half).map(|_| normal(random)).collect();
        let beam: Vec<f64> = (0..=2 * half)
            .map(|at| (-((at as f64 - half as f64) * STEP_MM / width_mm).powi(2)).exp())
            .collect();
        let size = beam.iter().map(|value| value * value).sum::<f64>().sqrt();
        source
            .windows(beam.len())
            .take(count)
            .map(|near| near.iter().zip(&beam).map(|(a, b)| a * b).sum::<f64>() / size)
            .collect()
    }

    /// Squared errors of a mean over a sequence with a smooth weight, beside the variance that so many of them state for it together, and the
    /// variance of single frames beside the stated one; means over such groups. Last the standard deviation of the logarithm of what is stated.
    fn calibration([width_mm, own]: [f64; 2], count: usize, together: usize, seed: u64) -> [f64; 3] {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let groups = 300 / together;
        let scale = 1.3;
        let mut sums = [0.0; 4];
        for _ in 0..groups {
            let mut sequence = || -> (Vec<f64>, Vec<Echo>) {
                let shared = speckled(&mut random, count, width_mm);
                let errors: Vec<f64> = shared
                    .into_iter()
                    .map(|shared| {
                        scale * SD_MM * ((1.0 - own).sqrt() * shared + own.sqrt() * normal(&mut random))
                    })
                    .collect();
                let echoes: Vec<Echo> = errors
                    .iter()
                    .enumerate()
                    .map(|(number, error)| {
                        let z_mm = 30.0 + STEP_MM * number as f64;
                        let echo_mm = 5.0 + 1.2 * (-z_mm / 28.0).exp() * (z_mm / 28.0).cos() + error;
                        Echo { across_mm: [echo_mm, 0.0], z_mm, sd_mm: [SD_MM; 2], score: 3.0 }
                    })
                    .collect();
                (errors, echoes)
            };
            let sequences: Vec<_> = (0..together).map(|_| sequence()).collect();
            let echoes: Vec<&[Echo]> = sequences.iter().map(|(_, echoes)| echoes.as_slice()).collect();
            let noise = Noise::of_all(&echoes, 0).expect("enough frames");
            let (errors, _) = &sequences[0];
            let error: f64 =
                errors.iter().enumerate().map(|(number, error)| half_sine(number, count) * error).sum();
            let squares: f64 = (0..count).map(|number| half_sine(number, count).powi(2)).sum();
            let stated = (noise.scale * SD_MM).powi(2);
            sums[0] += error * error / (stated * noise.correlated_frames * squares);
            sums[1] += (scale * SD_MM).powi(2) / stated;
            let logarithm = (stated * noise.correlated_frames).ln();
            sums[2] += logarithm;
            sums[3] += logarithm * logarithm;
        }
        let [mean, frame, logarithm, square] = sums.map(|sum| sum / groups as f64);
        [mean, frame, (square - logarithm * logarithm).sqrt()]
    }

    fn half_sine(number: usize, count: usize) -> f64 {
        (number as f64 / count as f64 * std::f64::consts::PI).sin()
    }

    #[test]
    fn errors_that_neighbours_share_are_as_large_as_stated() {
        for (width_mm, own, count, seed) in
            [(0.6, 0.3, 100, 1), (0.7, 0.003, 100, 2), (1.2, 0.1, 100, 3), (0.05, 0.5, 100, 4)]
        {
            let [mean, frame, _] = calibration([width_mm, own], count, 1, seed);
            println!("{width_mm} {own} {count}: mean {mean:.3} frame {frame:.3}");
            assert!(
                (0.6..1.4).contains(&mean),
                "{width_mm} mm, {own}: a mean's squared error is {mean} of its variance"
            );
            assert!((0.8..1.2).contains(&frame), "{width_mm} mm, {own}: {frame}");
        }
    }

    /// Several sequences together state it closer.
    fn state_their_errors_together(scanners: &[(f64, f64, u64)]) {
        for &(width_mm, own, seed) in scanners {
            let [_, _, alone] = calibration([width_mm, own], 100, 1, seed);
            let [mean, frame, spread] = calibration([width_mm, own], 100, 3, seed);
            println!(
                "{width_mm} {own}: mean {mean:.3} frame {frame:.3} spread {spread:.3} beside {alone:.3}"
            );
            assert!((0.45..1.4).contains(&mean), "{width_mm} mm, {own}: {mean}");
            // Never too small: a width and a share that fit nearly as well state more.
            assert!((0.6..1.2).contains(&frame), "{width_mm} mm, {own}: {frame}");
            assert!(spread < 0.95 * alone, "{width_mm} mm, {own}: {spread} beside {alone}");
        }
    }

    #[test]
    fn sequences_of_one_scanner_state_their_errors_together() {
        state_their_errors_together(&[(0.6, 0.3, 11)]);
    }

    #[test]
    #[ignore = "study in small: cargo xtask test --all runs it"]
    fn sequences_of_scanners_of_other_widths_state_their_errors_together() {
        state_their_errors_together(&[(0.7, 0.003, 12), (1.2, 0.1, 13)]);
    }

    #[test]
    fn a_short_sequence_beside_a_long_one_changes_nothing() {
        let mut random = ChaCha8Rng::seed_from_u64(20);
        let mut echo = |number: usize| {
            let echo_mm = [5.0 + SD_MM * normal(&mut random), 0.0];
            Echo { across_mm: echo_mm, z_mm: 30.0 + STEP_MM * number as f64, sd_mm: [SD_MM; 2], score: 3.0 }
        };
        let long: Vec<Echo> = (0..60).map(&mut echo).collect();
        assert_eq!(Noise::of_all(&[&long, &long[..3]], 0), Noise::of(&long, 0));
    }

    #[test]
    fn too_few_frames_state_nothing() {
        for count in 0..7 {
            let echoes: Vec<Echo> = (0..count).map(|number| echo_at(f64::from(number))).collect();
            assert_eq!(Noise::of(&echoes, 0), None, "{count}");
        }
        assert_eq!(Noise::of(&[echo_at(3.0); 40], 0), None, "all at one place");
    }

    fn echo_at(z_mm: f64) -> Echo {
        Echo { across_mm: [0.0; 2], z_mm, sd_mm: [SD_MM; 2], score: 3.0 }
    }
}
