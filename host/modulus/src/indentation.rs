//! Young's modulus from an indentation: slope of the force against depth with unknown force offset and contact point
//! (theory, eq. 32).
//!
//! `F = F0 + E g(d - d0)` in contact and `F0` before it. Flat punch of radius a: `g(x) = 2 a x k / (1 - nu^2)` (Sneddon 1965; Paper A
//! (21) where the layer is thick, with `k = 1`); sphere of radius R: `g(x) = 4 sqrt(R) x^1.5 k / (3 (1 - nu^2))` (Hertz 1882); `k` is the factor
//! for a layer of finite thickness on a rigid base ([`layer`]).

pub mod layer;

pub use formats::session::Indenter;
use layer::{SphereFactor, punch_factor};
use nalgebra::{DMatrix, DVector, Matrix3};
use readings::holds::mean;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// What is pressed into what.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Form of the indenter.
    pub indenter: Indenter,
    /// Its radius.
    pub radius_m: f64,
    /// Poisson's ratio of the tissue.
    pub poisson: f64,
    /// Thickness of the tissue on a rigid base; none is a half space.
    pub thickness_m: Option<f64>,
}

/// What an indentation gives.
#[derive(Debug, Clone, PartialEq)]
pub struct IndentationFit {
    /// Young's modulus.
    pub youngs_pa: f64,
    /// Its 95 % interval from the scatter about the curve; nothing for fewer than [`MIN_ROWS_OF_INTERVAL`] rows.
    pub ci95_pa: Option<[f64; 2]>,
    /// Force before contact; `None` where a flat punch was in contact all along (any offset fits then with its own contact point).
    pub offset_n: Option<f64>,
    /// Depth reading at contact; `None` where the offset is nothing.
    pub contact_m: Option<f64>,
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
    /// Whether the other form of indenter fits the rows far better.
    pub fits_other_form: bool,
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
/// Grid of contact points, and rounds of refinement.
const GRID: usize = 81;
const ROUNDS: usize = 5;

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
    let curve = Curve::new(contact, 1.5 * (last_m - first_m.min(0.0)), last_m)?;
    let found = match contact.indenter {
        Indenter::Flat => flat(&rows, &curve),
        Indenter::Sphere => sphere(&rows, &curve),
    };
    let fit = found
        .filter(|fit| fit.slope_pa > 0.0 && fit.slope_pa.is_finite())
        .ok_or(IndentationError::NoSlope)?;
    let other_form = match contact.indenter {
        Indenter::Flat => Indenter::Sphere,
        Indenter::Sphere => Indenter::Flat,
    };
    let other = Curve::new(&Contact { indenter: other_form, thickness_m: None, ..*contact }, last_m, last_m)?;
    let other = match other_form {
        Indenter::Flat => line(&rows, &other, first_m),
        Indenter::Sphere => sphere(&rows, &other),
    };
    Ok(fit.result(&curve, last_m, other.map(|other| other.mean_square())))
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

/// `g` of the module.
struct Curve {
    contact: Contact,
    flat_factor: f64,
    sphere_factor: Option<SphereFactor>,
}

impl Curve {
    fn new(contact: &Contact, most_m: f64, depth_m: f64) -> Result<Self, IndentationError> {
        let mut curve = Self { contact: *contact, flat_factor: 1.0, sphere_factor: None };
        if let Some(thickness_m) = contact.thickness_m {
            let too_thin =
                || IndentationError::TooThin { thickness_mm: 1e3 * thickness_m, depth_mm: 1e3 * depth_m };
            if depth_m >= thickness_m {
                return Err(too_thin());
            }
            match contact.indenter {
                Indenter::Flat => {
                    let ratio = contact.radius_m / thickness_m;
                    curve.flat_factor = punch_factor(ratio, contact.poisson).ok_or_else(too_thin)?;
                }
                Indenter::Sphere => {
                    let factor = SphereFactor::new(contact.radius_m, thickness_m, most_m, contact.poisson);
                    curve.sphere_factor = Some(factor.ok_or_else(too_thin)?);
                }
            }
        }
        Ok(curve)
    }

    /// Factor for the thickness.
    fn factor(&self, x_m: f64) -> f64 {
        match (&self.sphere_factor, self.contact.thickness_m) {
            (Some(factor), Some(thickness_m)) => factor.at(self.contact.radius_m * x_m / thickness_m.powi(2)),
            _ => self.flat_factor,
        }
    }

    /// Force per modulus at a depth below contact.
    fn at(&self, x_m: f64) -> f64 {
        let Contact { indenter, radius_m, poisson, .. } = self.contact;
        let x_m = x_m.max(0.0);
        let plain = match indenter {
            Indenter::Flat => 2.0 * radius_m * x_m,
            Indenter::Sphere => 4.0 / 3.0 * radius_m.sqrt() * x_m.powf(1.5),
        };
        plain * self.factor(x_m) / (1.0 - poisson * poisson)
    }
}

/// A curve through rows.
#[derive(Clone)]
struct Fitted {
    slope_pa: f64,
    offset_n: f64,
    contact_m: f64,
    /// Whether the contact point is determined by the rows.
    has_contact: bool,
    rows: Vec<[f64; 2]>,
    residuals_n: Vec<f64>,
}

impl Fitted {
    /// Offset and slope for a contact point.
    fn at(rows: &[[f64; 2]], curve: &Curve, contact_m: f64) -> Option<Self> {
        let n = rows.len() as f64;
        let g: Vec<f64> = rows.iter().map(|[d, _]| curve.at(d - contact_m)).collect();
        let (mean_g, mean_f) =
            (g.iter().sum::<f64>() / n, rows.iter().map(|[_, force]| force).sum::<f64>() / n);
        let square: f64 = g.iter().map(|g| (g - mean_g).powi(2)).sum();
        let product: f64 = g.iter().zip(rows).map(|(g, [_, f])| (g - mean_g) * (f - mean_f)).sum();
        if square <= 0.0 {
            return None;
        }
        let slope_pa = product / square;
        let offset_n = mean_f - slope_pa * mean_g;
        let residuals_n = g.iter().zip(rows).map(|(g, [_, f])| f - offset_n - slope_pa * g).collect();
        Some(Self { slope_pa, offset_n, contact_m, has_contact: true, rows: rows.to_vec(), residuals_n })
    }

    fn mean_square(&self) -> f64 {
        self.residuals_n.iter().map(|r| r * r).sum::<f64>() / self.residuals_n.len().max(1) as f64
    }

    /// The best contact point between two, by a grid that becomes finer.
    fn search(rows: &[[f64; 2]], curve: &Curve, [mut from_m, mut to_m]: [f64; 2]) -> Option<Self> {
        let mut best: Option<Self> = None;
        for _ in 0..ROUNDS {
            let step_m = (to_m - from_m) / (GRID - 1) as f64;
            let candidates = (0..GRID).filter_map(|i| Self::at(rows, curve, from_m + i as f64 * step_m));
            let found = candidates.min_by(|a, b| a.mean_square().total_cmp(&b.mean_square()))?;
            (from_m, to_m) = (found.contact_m - 2.0 * step_m, found.contact_m + 2.0 * step_m);
            best = Some(found);
        }
        best
    }

    fn result(&self, curve: &Curve, last_m: f64, other: Option<f64>) -> IndentationFit {
        let rows = self.rows.len();
        let unknowns = if self.has_contact { 3 } else { 2 };
        let freedom = rows as f64 - f64::from(unknowns);
        // Readings of one sweep are correlated: so many are worth so few.
        let effective = mean(&self.residuals_n).effective_samples.max(1.0);
        let worth = (rows as f64 / effective).max(1.0);
        let variance = self.mean_square() * rows as f64 / freedom.max(1.0) * worth;
        let sd_pa = self.slope_variance(curve).map(|unit| (unit * variance).sqrt());
        let quantile =
            StudentsT::new(0.0, 1.0, (freedom / worth).max(2.0)).map_or(1.96, |t| t.inverse_cdf(0.975));
        let ci95_pa = sd_pa
            .filter(|sd| rows >= MIN_ROWS_OF_INTERVAL && sd.is_finite())
            .map(|sd| [self.slope_pa - quantile * sd, self.slope_pa + quantile * sd]);
        let (nonlinearity, nonlinearity_se) = self.nonlinearity(curve, worth);
        let floor = f64::EPSILON * self.rows.iter().map(|[_, f]| f * f).fold(0.0, f64::max);
        IndentationFit {
            youngs_pa: self.slope_pa,
            ci95_pa,
            offset_n: self.has_contact.then_some(self.offset_n),
            contact_m: self.has_contact.then_some(self.contact_m),
            deepest_m: last_m - self.contact_m,
            nonlinearity,
            nonlinearity_se,
            residual_n: self.mean_square().sqrt(),
            thickness_factor: curve.factor(last_m - self.contact_m),
            rows,
            fits_other_form: other.is_some_and(|other| other + floor < 0.5 * self.mean_square()),
        }
    }

    /// Variance of the slope for readings of unit variance.
    fn slope_variance(&self, curve: &Curve) -> Option<f64> {
        let step_m = 1e-4 * (span(&self.rows).1 - self.contact_m).abs();
        let mut normal = Matrix3::zeros();
        for [d, _] in &self.rows {
            let x_m = d - self.contact_m;
            let by_contact =
                (curve.at(x_m - step_m) - curve.at(x_m + step_m)) / (2.0 * step_m) * self.slope_pa;
            let row = [1.0, curve.at(x_m), if self.has_contact { by_contact } else { 0.0 }];
            for i in 0..3 {
                for j in 0..3 {
                    normal[(i, j)] += row[i] * row[j];
                }
            }
        }
        if !self.has_contact {
            normal[(2, 2)] = 1.0;
        }
        // Scaled to a unit diagonal before it is inverted: lengths and forces differ by powers of ten.
        let scale = normal.diagonal().map(|d| d.max(f64::MIN_POSITIVE).sqrt().recip());
        let scaled = Matrix3::from_fn(|i, j| normal[(i, j)] * scale[i] * scale[j]);
        scaled.try_inverse().map(|inverse| inverse[(1, 1)] * scale[1] * scale[1]).filter(|v| *v >= 0.0)
    }

    /// Slope of the deeper half of the rows in contact over that of the shallower half, less 1, with its standard error.
    fn nonlinearity(&self, curve: &Curve, worth: f64) -> (f64, f64) {
        let inside: Vec<[f64; 2]> = self.rows.iter().filter(|[d, _]| *d > self.contact_m).copied().collect();
        if inside.len() < 6 {
            return (0.0, 0.0);
        }
        let (first_m, last_m) = span(&inside);
        let middle_m = 0.5 * (first_m + last_m);
        let slope = |half: Vec<[f64; 2]>| -> Option<[f64; 2]> {
            let x = DMatrix::from_fn(half.len(), 2, |i, j| {
                if j == 0 { 1.0 } else { curve.at(half[i][0] - self.contact_m) }
            });
            let y = DVector::from_iterator(half.len(), half.iter().map(|[_, f]| *f));
            let scale = x.column(1).amax().max(f64::MIN_POSITIVE);
            let mut x = x;
            x.column_mut(1).scale_mut(1.0 / scale);
            let inverse = x.tr_mul(&x).try_inverse()?;
            let found = &inverse * x.tr_mul(&y);
            let freedom = (half.len() as f64 - 2.0).max(1.0);
            let variance = (&y - &x * &found).norm_squared() / freedom * worth;
            Some([found[1] / scale, (variance * inverse[(1, 1)]).sqrt() / scale])
        };
        let half =
            |is_deep: bool| inside.iter().filter(|[d, _]| (*d > middle_m) == is_deep).copied().collect();
        match (slope(half(false)), slope(half(true))) {
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

/// A straight line through all rows: a punch that is in contact from the first one.
fn line(rows: &[[f64; 2]], curve: &Curve, first_m: f64) -> Option<Fitted> {
    // Any contact point above the rows gives the same line.
    Fitted::at(rows, curve, first_m).map(|fit| Fitted { has_contact: false, ..fit })
}

/// A flat punch: flat before contact where there are such rows, straight after the toe.
fn flat(rows: &[[f64; 2]], curve: &Curve) -> Option<Fitted> {
    let (first_m, last_m) = span(rows);
    let kinked = Fitted::search(rows, curve, [first_m, last_m - 0.2 * (last_m - first_m)]);
    let approach = kinked.filter(|fit| has_approach(rows, fit, curve));
    let Some(approach) = approach else {
        let contact_m = first_m.min(0.0).max(first_m - 0.25 * (last_m - first_m));
        let toe_m = contact_m + TOE * (last_m - contact_m);
        let used: Vec<[f64; 2]> = rows.iter().filter(|[d, _]| *d > toe_m).copied().collect();
        let used = if used.len() < MIN_ROWS { rows } else { &used };
        return line(used, curve, first_m.min(0.0));
    };
    // Rows of the toe lie between; offset and line are extrapolated to where they meet.
    let toe_m = approach.contact_m + TOE * (last_m - approach.contact_m);
    let is_used = |[d, _]: &&[f64; 2]| *d < approach.contact_m - 0.02 * (last_m - first_m) || *d > toe_m;
    let used: Vec<[f64; 2]> = rows.iter().filter(is_used).copied().collect();
    let around = 0.2 * (last_m - approach.contact_m);
    Fitted::search(&used, curve, [approach.contact_m - around, approach.contact_m + around])
}

/// Whether rows before the contact point are those of an indenter that does not touch yet.
fn has_approach(rows: &[[f64; 2]], fit: &Fitted, curve: &Curve) -> bool {
    let before: Vec<[f64; 2]> = rows.iter().filter(|[d, _]| *d < fit.contact_m).copied().collect();
    if before.len() < MIN_ROWS {
        return false;
    }
    let n = before.len() as f64;
    let (mean_d, mean_f) = before.iter().fold((0.0, 0.0), |(d, f), row| (d + row[0] / n, f + row[1] / n));
    let square: f64 = before.iter().map(|[d, _]| (d - mean_d).powi(2)).sum();
    let product: f64 = before.iter().map(|[d, f]| (d - mean_d) * (f - mean_f)).sum();
    let unit = curve.at(1e-3) / 1e-3;
    product < SLOPE_BEFORE * fit.slope_pa * unit * square
}

/// A sphere: the curve's bend determines the contact point, before which there may be rows.
fn sphere(rows: &[[f64; 2]], curve: &Curve) -> Option<Fitted> {
    let (first_m, last_m) = span(rows);
    let length_m = last_m - first_m;
    Fitted::search(rows, curve, [first_m - 0.3 * length_m, last_m - 0.2 * length_m])
}

#[cfg(test)]
mod tests;
