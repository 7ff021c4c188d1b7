//! Intervals that do not lean on the fit being linear: profile likelihood and parametric bootstrap of the first shared
//! parameter (theory, eq. 27).

use super::{Block, Fit, FitError, ForceZero, LateralData, Measured, Parameter, Prior, fit};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

/// Standard deviation that pins a parameter: its misfit is far below rounding of chi-square.
const PINNED_SD: f64 = 1e-7;
/// Furthest that the end of an interval is searched for, standard deviations.
const FURTHEST_SD: f64 = 12.0;
const BISECTIONS: usize = 24;

/// Rise of chi-square above its minimum with the first shared parameter pinned at `value` and all others fitted to it.
///
/// # Errors
/// [`FitError`] where there is no fit.
pub fn profile<B: Block>(
    shared: &[Parameter],
    blocks: &[B],
    best: &Fit,
    value: f64,
) -> Result<f64, FitError> {
    let mut pinned = shared.to_vec();
    pinned.iter_mut().zip(&best.shared).for_each(|(parameter, found)| parameter.start = *found);
    if let Some(first) = pinned.first_mut() {
        first.start = value;
        first.prior = Some(Prior { mean: value, sd: PINNED_SD });
    }
    Ok(fit(&pinned, blocks)?.chi_square - best.chi_square)
}

/// Points at which the profile has risen by `rise` on both sides of its minimum; an end that is not found within
/// twelve standard deviations is infinite: the data do not bound the parameter there.
///
/// # Errors
/// [`FitError`] where there is no fit on the way.
pub fn profile_interval<B: Block>(
    shared: &[Parameter],
    blocks: &[B],
    best: &Fit,
    rise: f64,
) -> Result<[f64; 2], FitError> {
    let centre = best.shared.first().copied().unwrap_or(f64::NAN);
    let sd = best.covariance.get((0, 0)).copied().unwrap_or(f64::NAN).sqrt();
    Ok([
        interval_end(-1.0, centre, sd, rise, shared, blocks, best)?,
        interval_end(1.0, centre, sd, rise, shared, blocks, best)?,
    ])
}

fn interval_end<B: Block>(
    direction: f64,
    centre: f64,
    sd: f64,
    rise: f64,
    shared: &[Parameter],
    blocks: &[B],
    best: &Fit,
) -> Result<f64, FitError> {
    let (mut inner, mut outer) = (0.0, rise.sqrt());
    while profile(shared, blocks, best, bound_at(outer, centre, direction, sd))? < rise {
        (inner, outer) = (outer, 1.5 * outer);
        if outer > FURTHEST_SD {
            return Ok(direction * f64::INFINITY);
        }
    }
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (inner + outer);
        if profile(shared, blocks, best, bound_at(middle, centre, direction, sd))? < rise {
            inner = middle
        } else {
            outer = middle
        }
    }
    Ok(bound_at(0.5 * (inner + outer), centre, direction, sd))
}

fn bound_at(distance: f64, centre: f64, direction: f64, sd: f64) -> f64 {
    centre + direction * distance * sd
}

/// The first shared parameter as found on `count` sets of data drawn from the fit, in increasing order: what repeats of the
/// same experiment would give. Sets without a fit are skipped. On all cores; the result does not depend on how many there are.
pub fn bootstrap(
    shared: &[Parameter],
    blocks: &[LateralData],
    best: &Fit,
    count: usize,
    seed: u64,
) -> Vec<f64> {
    let mut reference = shared.to_vec();
    reference.iter_mut().zip(&best.shared).for_each(|(parameter, found)| parameter.start = *found);
    let mut redraws: Vec<f64> = (0..count)
        .into_par_iter()
        .filter_map(|number| {
            // A stream of its own: a draw is the same whichever thread takes it, and when.
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            random.set_stream(number as u64);
            let drawn: Vec<LateralData> = blocks
                .iter()
                .zip(&best.residuals)
                .map(|(block, residuals)| block.redrawn(residuals, || StandardNormal.sample(&mut random)))
                .collect();
            fit(&reference, &drawn).ok()?.shared.first().copied()
        })
        .collect();
    redraws.sort_by(f64::total_cmp);
    redraws
}

/// The value below which a share of sorted values lies, between neighbours by their distance; nothing for no values.
pub fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let position = share.clamp(0.0, 1.0) * sorted.len().checked_sub(1)? as f64;
    let (lower, upper) = (sorted.get(position.floor() as usize)?, sorted.get(position.ceil() as usize)?);
    Some(lower + (upper - lower) * position.fract())
}

impl LateralData {
    /// The run as the fit with these residuals predicts it, with new noise; residuals are in the order of
    /// [`Block::residuals`].
    fn redrawn(&self, residuals: &[f64], mut normal: impl FnMut() -> f64) -> Self {
        let mut drawn = self.clone();
        let mut residuals = residuals.iter();
        let mut change = |sd: f64| sd * (normal() - residuals.next().copied().unwrap_or_default());
        for plane in 0..self.planes {
            let mut redraw = |measured: Option<&mut Measured>| {
                if let Some(measured) = measured {
                    measured.value += change(measured.sd);
                }
            };
            drawn.levels.iter_mut().for_each(|level| redraw(level.displacement_m.get_mut(plane)));
            if self.uses_force {
                drawn.levels.iter_mut().for_each(|level| redraw(level.force_n.get_mut(plane)));
            }
            for point in drawn.levels.iter_mut().flat_map(|level| &mut level.shape) {
                if let Some(deflection_m) = point.deflection_m.get_mut(plane) {
                    let ratio = point.sd_ratio.get(plane).copied().unwrap_or(1.0);
                    *deflection_m += change(self.shape_sd_m * ratio);
                }
            }
        }
        if let ForceZero::Assumed(zeros) = &mut drawn.force_zero
            && self.uses_force
        {
            zeros.iter_mut().take(self.planes).for_each(|zero| zero.value += change(zero.sd));
        }
        for (plane, error) in self.shared_deflections() {
            drawn.shared.deflection[plane][error] += change(1.0);
        }
        drawn.shared.z += change(1.0);
        drawn
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HoldData, ShapeDatum, SharedErrors};
    use mechanics::{Beam, Foundation, Needle, Rig};

    const LN_K: Parameter = Parameter { start: 9.5, step: 1e-4, least: 2.0, most: 16.0, prior: None };

    fn data(shape_sd_m: f64) -> Vec<LateralData> {
        let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
        let beam = Beam::solve(&rig, &Foundation::uniform(16e3).expect("valid"), 0.03).expect("solves");
        let level = HoldData {
            displacement_m: vec![Measured { value: 1.2e-3, sd: 15e-6 }],
            force_n: vec![Measured { value: beam.force_n(1.2e-3), sd: 0.1 }],
            shape: (1..30)
                .map(|i| {
                    let z_m = 0.07 + 1e-3 * f64::from(i);
                    ShapeDatum::new(z_m, [beam.deflection_m(1.2e-3, z_m), 0.0])
                })
                .collect(),
        };
        vec![LateralData {
            support: mechanics::Support::Springs,
            rig,
            depth_m: 0.03,
            planes: 1,
            levels: vec![level],
            shape_sd_m,
            force_zero: ForceZero::Exact,
            shared: SharedErrors::default(),
            uses_force: true,
            effects: Vec::new(),
            fixed: None,
        }]
    }

    #[test]
    fn three_kinds_of_interval_agree_where_the_data_are_good() {
        let blocks = data(25e-6);
        let best = fit(&[LN_K], &blocks).expect("fits");
        let sd = best.covariance[(0, 0)].sqrt();
        let centre = best.shared[0];
        let [low, high] = profile_interval(&[LN_K], &blocks, &best, 1.96 * 1.96).expect("an interval");
        assert!(((centre - low) / (1.96 * sd) - 1.0).abs() < 0.03, "{low} {centre} {high}");
        assert!(((high - centre) / (1.96 * sd) - 1.0).abs() < 0.03, "{low} {centre} {high}");
        let drawn = bootstrap(&[LN_K], &blocks, &best, 400, 3);
        let (low, high) =
            (quantile(&drawn, 0.025).expect("values"), quantile(&drawn, 0.975).expect("values"));
        assert!(((high - low) / (3.92 * sd) - 1.0).abs() < 0.12, "{low} {high} {sd}");
        assert_eq!(drawn, bootstrap(&[LN_K], &blocks, &best, 400, 3), "the same seed");
        assert_ne!(drawn, bootstrap(&[LN_K], &blocks, &best, 400, 4));
    }

    /// Readings that are drawn around a fit are off from it by the drawn numbers: in both planes, and with all that a run may state.
    #[test]
    fn redrawn_readings_are_off_from_the_fit_by_the_drawn_numbers() {
        let mut run = data(25e-6).remove(0);
        (run.planes, run.force_zero) = (2, ForceZero::assumed(0.02));
        let level = &mut run.levels[0];
        level.displacement_m.push(Measured { value: 0.7e-3, sd: 20e-6 });
        level.force_n.push(Measured { value: 0.8, sd: 0.2 });
        for point in &mut level.shape {
            point.deflection_m[1] = 0.6 * point.deflection_m[0] + 10e-6;
            (point.sd_ratio, point.z_shared_sd_m) = ([2.0, 0.5], 0.1e-3);
            point.shared_m = [[10e-6, 0.0, 0.0], [0.0, 20e-6, 0.0]];
        }
        let best = fit(&[LN_K], std::slice::from_ref(&run)).expect("fits");
        let mut drawn = Vec::new();
        let again = run.redrawn(&best.residuals[0], || {
            drawn.push((drawn.len() as f64).sin());
            drawn[drawn.len() - 1]
        });
        let ready = again.prepare(&best.shared).expect("a needle");
        let deviations = again.residuals(&ready, &best.nuisances[0]).expect("residuals");
        assert_eq!(deviations.len(), drawn.len());
        for (number, (deviations, drawn)) in deviations.iter().zip(&drawn).enumerate() {
            assert!((deviations - drawn).abs() < 1e-6, "{number}: {deviations} is not {drawn}");
        }
    }

    #[test]
    fn draws_do_not_depend_on_the_number_of_threads() {
        let blocks = data(25e-6);
        let best = fit(&[LN_K], &blocks).expect("fits");
        fn on(threads: usize, blocks: &[LateralData], best: &Fit) -> Vec<u64> {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let drawn = pool.install(|| bootstrap(&[LN_K], blocks, best, 50, 3));
            drawn.into_iter().map(f64::to_bits).collect::<Vec<_>>()
        }
        assert_eq!(on(1, &blocks, &best), on(4, &blocks, &best));
    }

    /// Poor data: the profile is lopsided in ln K, and its ends are where chi-square really has risen.
    #[test]
    fn the_profile_is_that_of_chi_square() {
        let blocks = data(0.3e-3);
        let best = fit(&[LN_K], &blocks).expect("fits");
        let [low, high] = profile_interval(&[LN_K], &blocks, &best, 3.84).expect("an interval");
        for end in [low, high] {
            assert!((profile(&[LN_K], &blocks, &best, end).expect("fits") - 3.84).abs() < 1e-3);
        }
        let centre = best.shared[0];
        assert!(((high - centre) / (centre - low) - 1.0).abs() > 0.02, "{low} {centre} {high}");
        assert!(profile(&[LN_K], &blocks, &best, centre).expect("fits").abs() < 1e-6);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[1.0, 2.0, 4.0], 0.75), Some(3.0));
        assert_eq!(quantile(&[7.0], 0.3), Some(7.0));
        assert_eq!(quantile(&[], 0.3), None);
    }
}
