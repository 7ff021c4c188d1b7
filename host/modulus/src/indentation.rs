//! Young's modulus from an indentation: slope of the force against depth with unknown force offset and contact point
//! (theory, eq. 32).
//!
//! `F = F0 + E g(d - d0)` in contact and `F0` before it. Flat punch of radius a: `g(x) = 2 a x k / (1 - nu^2)` (Sneddon 1965; Paper A
//! (21) where the layer is thick, with `k = 1`); sphere of radius R: `g(x) = 4 sqrt(R) x^1.5 k / (3 (1 - nu^2))` (Hertz 1882); cone of half
//! angle alpha: `g(x) = 2 tan(alpha) x^2 / (pi (1 - nu^2))` (Sneddon 1965); `k` is the factor for a layer of finite thickness on a rigid base
//! ([`layer`]). Contact point, offset and drift are unknown in every fit, and the interval is that of the modulus with all of them integrated
//! out ([`posterior`]).

mod curve;
pub mod layer;
mod posterior;

use curve::Curve;
pub use formats::session::Indenter;
use nalgebra::{DMatrix, DVector};
use posterior::{Given, Rows};
use readings::holds::mean;

/// Indenter and tissue.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Form of the indenter.
    pub indenter: Indenter,
    /// Its radius; that of the base of a cone.
    pub radius_m: f64,
    /// Angle between the axis of a cone and its side; of no meaning for others.
    pub half_angle_rad: f64,
    /// Poisson's ratio of the tissue.
    pub poisson: f64,
    /// Thickness of the tissue on a rigid base; none is a half space.
    pub thickness_m: Option<f64>,
}

/// Result of an indentation.
#[derive(Debug, Clone, PartialEq)]
pub struct IndentationFit {
    /// Young's modulus: the median.
    pub youngs_pa: f64,
    /// Its 95 % interval with contact point, offset and drift integrated out; nothing for fewer than [`MIN_ROWS_OF_INTERVAL`] rows.
    pub ci95_pa: Option<[f64; 2]>,
    /// Force before contact; `None` where a flat punch was in contact all along (any offset fits then with its own contact point).
    pub offset_n: Option<f64>,
    /// Depth reading at contact; `None` where the offset is nothing.
    pub contact_m: Option<f64>,
    /// Its 95 % interval; nothing where it is not determined.
    pub contact_ci95_m: Option<[f64; 2]>,
    /// Ratio of the interval's ends over that for the best contact point: how much of it is that contact point, offset and modulus are hardly
    /// separable.
    pub by_contact: f64,
    /// Largest depth below contact.
    pub deepest_m: f64,
    /// Slope of the deeper half over that of the shallower one, less 1: zero for the model.
    pub nonlinearity: f64,
    /// Its standard error.
    pub nonlinearity_se: f64,
    /// Root mean square of what the curve leaves.
    pub residual_n: f64,
    /// Factor for the finite thickness at the largest depth.
    pub thickness_factor: f64,
    /// Rows used.
    pub rows: usize,
    /// The other form of indenter that fits the rows far better, where one does.
    pub fits_other_form: Option<Indenter>,
}

/// Why there is no modulus.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum IndentationError {
    /// Too few rows.
    #[error("{found} rows of increasing depth, expected {MIN_ROWS} or more")]
    FewRows {
        /// Number of rows.
        found: usize,
    },
    /// It does not push back.
    #[error("force_n: no modulus, expected a force that grows with depth, positive when pressed in")]
    NoSlope,
    /// The indentation is as deep as the tissue.
    #[error(
        "tissue_thickness_mm: {thickness_mm}, expected more than the depth of {depth_mm:.3} mm and a fifth of the contact's radius"
    )]
    TooThin {
        /// Thickness of the tissue.
        thickness_mm: f64,
        /// Largest depth.
        depth_mm: f64,
    },
}

/// Fewest rows.
pub const MIN_ROWS: usize = 3;
/// Fewest rows from which the scatter gives an interval.
pub const MIN_ROWS_OF_INTERVAL: usize = 8;
/// Share of the depth after contact that is not used with a flat punch: an edge touches before the whole face does.
const TOE: f64 = 0.2;
/// Before contact the force has less than this share of the slope after it.
const SLOPE_BEFORE: f64 = 0.1;
/// Before the first row contact may be as far as this many lengths of the curve, for indenters without a radius that limits it.
const BEFORE: f64 = 10.0;

/// Young's modulus from the loading part of an indentation.
///
/// # Errors
/// [`IndentationError`].
pub fn indented(
    contact: &Contact,
    depth_m: &[f64],
    force_n: &[f64],
) -> Result<IndentationFit, IndentationError> {
    let rows = loading(depth_m, force_n);
    if rows.len() < MIN_ROWS {
        return Err(IndentationError::FewRows { found: rows.len() });
    }
    let (first_m, last_m) = span(&rows);
    // Strains of order one are beyond every law here: no contact point is further from the deepest row than the radius.
    let earliest_m = match contact.indenter {
        Indenter::Flat => first_m.min(0.0),
        Indenter::Sphere => (last_m - contact.radius_m).min(first_m - 0.3 * (last_m - first_m)),
        Indenter::Cone => first_m - BEFORE * (last_m - first_m),
    };
    let curve = Curve::new(contact, 1.5 * (last_m - earliest_m), last_m)?;
    let contact_range_m = [earliest_m, last_m - 0.2 * (last_m - first_m)];
    let fit = match contact.indenter {
        Indenter::Flat => flat(&rows, &curve),
        Indenter::Sphere | Indenter::Cone => Fit::new(rows.clone(), &curve, Some(contact_range_m)),
    };
    let fit = fit.ok_or(IndentationError::NoSlope)?;
    let other_forms = Indenter::ALL.into_iter().filter(|form| *form != contact.indenter);
    let best_other = other_forms
        .filter_map(|form| {
            let half_angle_rad =
                if form == Indenter::Cone { std::f64::consts::FRAC_PI_4 } else { contact.half_angle_rad };
            let changed = Contact { indenter: form, thickness_m: None, half_angle_rad, ..*contact };
            let other_curve = Curve::new(&changed, last_m, last_m).ok()?;
            let other_range_m =
                (form != Indenter::Flat).then_some([first_m - 0.3 * (last_m - first_m), contact_range_m[1]]);
            let rows =
                Rows { rows: &rows, curve: &other_curve, worth: 1.0, has_contact: other_range_m.is_some() };
            let fitted_rows = match other_range_m {
                Some(other_range_m) => rows.best(other_range_m),
                None => rows.given(first_m),
            }?;
            Some((mean_square(&rows.residuals_n(&fitted_rows)), form))
        })
        .min_by(|a, b| a.0.total_cmp(&b.0));
    fit.result(&curve, first_m, last_m, best_other).ok_or(IndentationError::NoSlope)
}

/// Rows up to the greatest depth.
fn loading(depth_m: &[f64], force_n: &[f64]) -> Vec<[f64; 2]> {
    let rows: Vec<[f64; 2]> = depth_m.iter().zip(force_n).map(|(depth, force)| [*depth, *force]).collect();
    let (_, most_m) = span(&rows);
    let count = rows.iter().position(|[d, _]| *d >= most_m).map_or(0, |deepest| deepest + 1);
    rows.into_iter().take(count).collect()
}

fn span(rows: &[[f64; 2]]) -> (f64, f64) {
    rows.iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), [d, _]| (least.min(*d), most.max(*d)))
}

/// A curve through rows.
struct Fit {
    rows: Vec<[f64; 2]>,
    given: Given,
    residuals_n: Vec<f64>,
    /// Between which depths the contact point is; nothing where it changes nothing.
    places_m: Option<[f64; 2]>,
}

impl Fit {
    /// The best curve, with its contact point between two depths or, without these, above all rows.
    fn new(rows: Vec<[f64; 2]>, curve: &Curve, places_m: Option<[f64; 2]>) -> Option<Self> {
        let fitted = Rows { rows: &rows, curve, worth: 1.0, has_contact: places_m.is_some() };
        let initial_fit = match places_m {
            Some(places_m) => fitted.best(places_m),
            None => fitted.given(span(&rows).0.min(0.0)),
        }?;
        let residuals_n = fitted.residuals_n(&initial_fit);
        Some(Self { rows, given: initial_fit, residuals_n, places_m })
    }

    fn result(
        &self,
        curve: &Curve,
        first_m: f64,
        last_m: f64,
        other: Option<(f64, Indenter)>,
    ) -> Option<IndentationFit> {
        let Self { rows, given, residuals_n, places_m } = self;
        // Readings of one sweep are correlated: so many are worth so few.
        let effective = mean(residuals_n).effective_samples.max(1.0);
        let worth = (rows.len() as f64 / effective).max(1.0);
        let fitted = Rows { rows, curve, worth, has_contact: places_m.is_some() };
        let default_range_m = [given.contact_m; 2];
        let contact_posterior =
            fitted.posterior(places_m.unwrap_or(default_range_m), first_m, last_m - first_m)?;
        let alone =
            Rows { has_contact: false, ..fitted }.posterior(default_range_m, first_m, last_m - first_m)?;
        let [low, high] = [0.025, 0.975].map(|p| contact_posterior.quantile_pa(p));
        let [low_alone, high_alone] = [0.025, 0.975].map(|p| alone.quantile_pa(p));
        let has_contact = places_m.is_some();
        let (nonlinearity, nonlinearity_se) = self.nonlinearity(curve, worth);
        let floor = f64::EPSILON * rows.iter().map(|[_, f]| f * f).fold(0.0, f64::max);
        let own_square = mean_square(residuals_n);
        Some(IndentationFit {
            youngs_pa: contact_posterior.quantile_pa(0.5),
            ci95_pa: (rows.len() >= MIN_ROWS_OF_INTERVAL).then_some([low, high]),
            offset_n: has_contact.then_some(given.offset_n),
            contact_m: has_contact.then_some(given.contact_m),
            contact_ci95_m: has_contact.then(|| contact_posterior.contact_m()),
            by_contact: (high / low) / (high_alone / low_alone),
            deepest_m: last_m - given.contact_m,
            nonlinearity,
            nonlinearity_se,
            residual_n: own_square.sqrt(),
            thickness_factor: curve.factor(last_m - given.contact_m),
            rows: rows.len(),
            fits_other_form: other
                .filter(|(square, _)| square + floor < 0.5 * own_square)
                .map(|(_, form)| form),
        })
    }

    /// Slope of the deeper half of the rows in contact over that of the shallower half, less 1, with its standard error.
    fn nonlinearity(&self, curve: &Curve, worth: f64) -> (f64, f64) {
        let loaded_rows: Vec<[f64; 2]> =
            self.rows.iter().filter(|[d, _]| *d > self.given.contact_m).copied().collect();
        if loaded_rows.len() < 6 {
            return (0.0, 0.0);
        }
        let (first_m, last_m) = span(&loaded_rows);
        let middle_m = 0.5 * (first_m + last_m);
        let slope = |half: Vec<[f64; 2]>| -> Option<[f64; 2]> {
            let x = DMatrix::from_fn(half.len(), 2, |i, j| {
                if j == 0 { 1.0 } else { curve.at(half[i][0] - self.given.contact_m) }
            });
            let y = DVector::from_iterator(half.len(), half.iter().map(|[_, f]| *f));
            let scale = x.column(1).amax().max(f64::MIN_POSITIVE);
            let mut x = x;
            x.column_mut(1).scale_mut(1.0 / scale);
            let inverse = x.tr_mul(&x).try_inverse()?;
            let coefficients = &inverse * x.tr_mul(&y);
            let freedom = (half.len() as f64 - 2.0).max(1.0);
            let variance = (&y - &x * &coefficients).norm_squared() / freedom * worth;
            Some([coefficients[1] / scale, (variance * inverse[(1, 1)]).sqrt() / scale])
        };
        match (slope(half_of(false, &loaded_rows, middle_m)), slope(half_of(true, &loaded_rows, middle_m))) {
            (Some([shallow, shallow_sd]), Some([deep, deep_sd])) if shallow > 0.0 => {
                let ratio = deep / shallow;
                (ratio - 1.0, ratio.abs() * (shallow_sd / shallow).hypot(deep_sd / deep))
            }
            (Some([shallow, shallow_sd]), Some([deep, deep_sd])) => {
                // A shallow half without slope: all of the force comes later.
                (1.0, (shallow_sd.hypot(deep_sd) / (deep - shallow).abs()).min(1.0))
            }
            _ => (0.0, 0.0),
        }
    }
}

/// Rows of the upper or the lower half of an indentation.
fn half_of(is_deep: bool, loaded_rows: &[[f64; 2]], middle_m: f64) -> Vec<[f64; 2]> {
    loaded_rows.iter().filter(|[d, _]| (*d > middle_m) == is_deep).copied().collect()
}

fn mean_square(residuals_n: &[f64]) -> f64 {
    residuals_n.iter().map(|r| r * r).sum::<f64>() / residuals_n.len().max(1) as f64
}

/// A flat punch: flat before contact where there are such rows, straight after the toe.
fn flat(rows: &[[f64; 2]], curve: &Curve) -> Option<Fit> {
    let (first_m, last_m) = span(rows);
    let kinked = Fit::new(rows.to_vec(), curve, Some([first_m, last_m - 0.2 * (last_m - first_m)]));
    let Some(approach) = kinked.filter(|fit| has_approach(rows, fit, curve)) else {
        let contact_m = first_m.min(0.0).max(first_m - 0.25 * (last_m - first_m));
        let toe_m = contact_m + TOE * (last_m - contact_m);
        let approach_rows: Vec<[f64; 2]> = rows.iter().filter(|[d, _]| *d > toe_m).copied().collect();
        let kept_rows = if approach_rows.len() < MIN_ROWS { rows.to_vec() } else { approach_rows };
        return Fit::new(kept_rows, curve, None);
    };
    // Rows of the toe lie between; offset and line are extrapolated to where they meet.
    let contact_m = approach.given.contact_m;
    let toe_m = contact_m + TOE * (last_m - contact_m);
    let approach_rows: Vec<[f64; 2]> = rows
        .iter()
        .filter(|[d, _]| *d < contact_m - 0.02 * (last_m - first_m) || *d > toe_m)
        .copied()
        .collect();
    let half_range_m = 0.2 * (last_m - contact_m);
    Fit::new(approach_rows, curve, Some([contact_m - half_range_m, contact_m + half_range_m]))
}

/// Whether rows before the contact point are those of an indenter that does not touch yet.
fn has_approach(rows: &[[f64; 2]], fit: &Fit, curve: &Curve) -> bool {
    let rows_before: Vec<[f64; 2]> = rows.iter().filter(|[d, _]| *d < fit.given.contact_m).copied().collect();
    if rows_before.len() < MIN_ROWS {
        return false;
    }
    let n = rows_before.len() as f64;
    let (mean_d, mean_f) =
        rows_before.iter().fold((0.0, 0.0), |(d, f), row| (d + row[0] / n, f + row[1] / n));
    let square: f64 = rows_before.iter().map(|[d, _]| (d - mean_d).powi(2)).sum();
    let product: f64 = rows_before.iter().map(|[d, f]| (d - mean_d) * (f - mean_f)).sum();
    let unit = curve.at(1e-3) / 1e-3;
    product < SLOPE_BEFORE * fit.given.slope_pa * unit * square
}

#[cfg(test)]
mod tests;
