//! The likelihood of effects in groups of sessions (theory, eq. 73).
//!
//! Sessions are independent, so that scores and information of a parameter that they share add up: `b = sum x_i b_i`,
//! `G = sum x_i^2 G_i`, where `x_i` is how much of the effect a session has: 1 in a group, 0 or 1 before and after a
//! step, 0 to 1 along a trend. With a prior `N(0, I)` in units of its standard deviation the log evidence over the
//! model without the effect is `b^T (I + G)^-1 b / 2 - ln det(I + G) / 2`. If sessions differ by more than their own
//! errors (`Q` over its degrees of freedom above one) both are divided by that ratio (Birge).

use crate::summary::{Amplitude, NamedEffect, SessionResult, Summary};
use nalgebra::{SMatrix, SVector};
use statrs::distribution::{ChiSquared, ContinuousCDF};
use std::collections::{BTreeMap, HashMap};

/// Parameters of an effect that are no place: no effect of the catalogue has more.
pub(crate) const MAX_PARAMETERS: usize = 3;
pub(crate) type Vector = SVector<f64, MAX_PARAMETERS>;
pub(crate) type Matrix = SMatrix<f64, MAX_PARAMETERS, MAX_PARAMETERS>;

/// One parameter of an effect.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Parameter {
    pub name: String,
    pub is_log: bool,
    pub neutral: f64,
    pub two_sided: bool,
    pub prior_sd: f64,
}

/// An effect at one place, or without one.
#[derive(Debug, Clone)]
pub(crate) struct Hypothesis {
    pub effect: String,
    pub at: Option<(String, f64)>,
    pub parameters: Vec<Parameter>,
    /// Number of every parameter among all columns.
    columns: Vec<usize>,
}

/// Content of a session that is kept in memory.
#[derive(Debug, Clone)]
pub(crate) struct Likelihood {
    /// Number of each column among those of the session; `u16::MAX` where it has none.
    position: Vec<u16>,
    /// Remaining scores, in units of priors.
    score: Vec<f64>,
    /// Square roots of the information, in units of priors.
    root: Vec<f64>,
    /// Change of ln K, in units of priors.
    slope: Vec<f64>,
    correlation: Vec<i16>,
    /// Effects that the session names by itself, with those that compete.
    pub named: Vec<String>,
    /// Whether the session by itself leaves no misfit unexplained.
    pub is_explained: bool,
}

/// The likelihoods of all sessions and the hypotheses they are of.
#[derive(Debug, Clone, Default)]
pub(crate) struct Likelihoods {
    pub hypotheses: Vec<Hypothesis>,
    by_name: HashMap<(String, Option<String>), usize>,
    /// Column of every kind of parameter that was there.
    of_kinds: HashMap<usize, Option<usize>>,
    columns: usize,
    pub sessions: Vec<Option<Likelihood>>,
}

/// Score and information of a hypothesis over sessions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sum {
    b: Vector,
    g: Matrix,
    /// Squares of every session's own estimate, and their number.
    squares: f64,
    rank: f64,
    pub sessions: usize,
}

impl Default for Sum {
    fn default() -> Self {
        Self { b: Vector::zeros(), g: Matrix::zeros(), squares: 0.0, rank: 0.0, sessions: 0 }
    }
}

/// A test of a hypothesis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Test {
    /// Log evidence over the model without the effect.
    pub log_evidence: f64,
    /// Probability of a larger chi-square without the effect.
    pub p: f64,
    /// Posterior mean, in units of the priors, and its standard deviations.
    pub mean: Vector,
    pub sd: Vector,
}

impl Likelihoods {
    /// Adds a session; those without a result have no likelihood. `kinds` are those of all records.
    /// `own` are the numbers of those of its parameters.
    pub fn push(
        &mut self,
        summary: &Summary,
        likelihood: Option<Likelihood>,
        own: &[usize],
        kinds: &[Amplitude],
    ) {
        let named = summary.result.iter().flat_map(|result| &result.named);
        let placed_likelihood = likelihood.map(|likelihood| self.placed(likelihood, own, kinds, named));
        self.sessions.push(placed_likelihood);
    }

    /// A likelihood with the columns of its parameters.
    fn placed<'a>(
        &mut self,
        mut likelihood: Likelihood,
        own: &[usize],
        kinds: &[Amplitude],
        named: impl Iterator<Item = &'a NamedEffect>,
    ) -> Likelihood {
        let columns: Vec<Option<usize>> = own.iter().map(|kind| self.column(*kind, kinds)).collect();
        let mut position = vec![u16::MAX; self.columns];
        for (local, column) in columns.into_iter().enumerate() {
            if let (Some(column), Ok(local)) = (column, u16::try_from(local)) {
                position[column] = local;
            }
        }
        likelihood.position = position;
        for named in named {
            self.explain(&mut likelihood, &named.id);
        }
        likelihood
    }

    /// Column of a kind of parameter; `None` for what is beyond the catalogue's largest effect, which is not added up.
    fn column(&mut self, kind: usize, kinds: &[Amplitude]) -> Option<usize> {
        if let Some(kind_columns) = self.of_kinds.get(&kind) {
            return *kind_columns;
        }
        let amplitude = kinds.get(kind)?;
        let parameter_text = amplitude.at.as_ref().map(|(name, value)| format!("{name} {value}"));
        let number = *self.by_name.entry((amplitude.effect.clone(), parameter_text)).or_insert_with(|| {
            self.hypotheses.push(Hypothesis {
                effect: amplitude.effect.clone(),
                at: amplitude.at.clone(),
                parameters: Vec::new(),
                columns: Vec::new(),
            });
            self.hypotheses.len() - 1
        });
        let hypothesis = &mut self.hypotheses[number];
        let same_parameter = hypothesis.parameters.iter().position(|known| known.name == amplitude.parameter);
        let parameter_index = same_parameter.unwrap_or_else(|| {
            hypothesis.parameters.push(Parameter {
                name: amplitude.parameter.clone(),
                is_log: amplitude.scale == "log",
                neutral: amplitude.neutral,
                two_sided: amplitude.two_sided,
                prior_sd: amplitude.prior_sd,
            });
            hypothesis.columns.push(self.columns);
            self.columns += 1;
            hypothesis.parameters.len() - 1
        });
        let column =
            hypothesis.columns.get(parameter_index).copied().filter(|_| parameter_index < MAX_PARAMETERS);
        self.of_kinds.insert(kind, column);
        column
    }

    /// Takes off the other effects' scores what an effect that the session names by itself explains.
    fn explain(&self, likelihood: &mut Likelihood, id: &str) {
        let of_effect = self.hypotheses.iter().filter(|hypothesis| hypothesis.effect == id);
        let tests = of_effect.map(|hypothesis| {
            let mut sum = Sum::default();
            sum.add(&likelihood.block(hypothesis), 1.0);
            (hypothesis, sum.test(hypothesis))
        });
        let Some((hypothesis, test)) = tests.max_by(|a, b| a.1.log_evidence.total_cmp(&b.1.log_evidence))
        else {
            return;
        };
        let named_columns: Vec<usize> = self
            .hypotheses
            .iter()
            .filter(|other| likelihood.named.contains(&other.effect))
            .flat_map(|other| other.columns.iter().filter_map(|column| likelihood.local(*column)))
            .collect();
        let kept_scores: Vec<f64> = named_columns.iter().map(|local| likelihood.score[*local]).collect();
        likelihood.subtract(hypothesis, &test.mean);
        named_columns.iter().zip(kept_scores).for_each(|(local, score)| likelihood.score[*local] = score);
    }
}

impl Likelihood {
    /// Likelihood of a result, whose correlations it takes; without the columns of its parameters.
    pub fn of<S>(result: &mut SessionResult<S>) -> Self {
        let count = result.amplitudes.len();
        let mut correlation = std::mem::take(&mut result.correlation_per_mille);
        correlation.resize(count * count.saturating_sub(1) / 2, 0);
        correlation.shrink_to_fit();
        let amplitudes = &result.amplitudes;
        Self {
            position: Vec::new(),
            score: amplitudes.iter().map(|one| one.score * one.prior_sd).collect(),
            root: amplitudes.iter().map(|one| one.information.max(0.0).sqrt() * one.prior_sd).collect(),
            slope: amplitudes.iter().map(|one| one.ln_k_slope * one.prior_sd).collect(),
            correlation,
            named: result.named.iter().flat_map(|named| named.class.iter().cloned()).collect(),
            is_explained: result.verdict != "unexplained",
        }
    }

    fn local(&self, column: usize) -> Option<usize> {
        self.position.get(column).copied().filter(|local| *local != u16::MAX).map(usize::from)
    }

    /// Information of two amplitudes, in units of the priors.
    fn information(&self, i: usize, j: usize) -> f64 {
        let (low, high) = (i.min(j), i.max(j));
        let correlation = match high {
            _ if low == high => 1.0,
            _ => self.correlation.get(high * (high - 1) / 2 + low).map_or(0.0, |r| 1e-3 * f64::from(*r)),
        };
        correlation * self.root[i] * self.root[j]
    }

    /// Score and information of a hypothesis.
    pub fn block(&self, hypothesis: &Hypothesis) -> (Vector, Matrix) {
        let (mut b, mut g) = (Vector::zeros(), Matrix::zeros());
        // Once for each parameter: this is computed for every effect in every session and group.
        let mut locals = [None; MAX_PARAMETERS];
        locals.iter_mut().zip(&hypothesis.columns).for_each(|(local, column)| *local = self.local(*column));
        for (i, local) in locals.iter().enumerate() {
            let Some(local) = *local else { continue };
            b[i] = self.score[local];
            for (j, other) in locals.iter().enumerate() {
                g[(i, j)] = other.map_or(0.0, |other| self.information(local, other));
            }
        }
        (b, g)
    }

    /// Takes an effect of this size, in units of the priors, off all scores.
    pub fn subtract(&mut self, hypothesis: &Hypothesis, size: &Vector) {
        let columns = hypothesis.columns.iter().zip(size.iter());
        let locals: Vec<(usize, f64)> =
            columns.filter_map(|(column, size)| Some((self.local(*column)?, *size))).collect();
        for i in 0..self.score.len() {
            let change: f64 = locals.iter().map(|(j, size)| self.information(i, *j) * size).sum();
            self.score[i] -= change;
        }
    }

    /// By how much an effect of this size moves ln K, and the variance of that.
    pub fn ln_k_shift(&self, hypothesis: &Hypothesis, size: &Vector, sd: &Vector) -> (f64, f64) {
        let columns = hypothesis.columns.iter().zip(size.iter().zip(sd.iter()));
        columns
            .filter_map(|(column, (size, sd))| {
                let slope = self.slope[self.local(*column)?];
                Some((slope * size, (slope * sd).powi(2)))
            })
            .fold((0.0, 0.0), |(shift, variance), (s, v)| (shift + s, variance + v))
    }
}

impl Sum {
    /// Likelihoods of sessions that all have the whole effect.
    pub fn of(blocks: impl IntoIterator<Item = (Vector, Matrix)>) -> Self {
        let mut sum = Self::default();
        blocks.into_iter().for_each(|block| sum.add(&block, 1.0));
        sum
    }

    /// Adds the likelihood of a session, which has so much of the effect.
    pub fn add(&mut self, (b, g): &(Vector, Matrix), x: f64) {
        let mut information = *g;
        let least = 1e-9 * information.trace();
        let mut rank = 0.0;
        for i in 0..MAX_PARAMETERS {
            if information[(i, i)] > 0.0 {
                rank += 1.0;
                information[(i, i)] += least;
            } else {
                information[(i, i)] = 1.0;
            }
        }
        if rank == 0.0 {
            return;
        }
        self.b += *b * x;
        self.g += *g * (x * x);
        self.squares += squares(&information, b);
        self.rank += rank;
        self.sessions += 1;
    }

    /// Gain of log likelihood of an effect of this size.
    pub fn gain(&self, size: &Vector) -> f64 {
        self.b.dot(size) - 0.5 * size.dot(&(self.g * size))
    }

    /// The most information on one parameter, in units of its prior.
    pub fn information(&self) -> f64 {
        self.g.diagonal().max()
    }

    /// Tests the hypothesis that the sessions share the effect.
    pub fn test(&self, hypothesis: &Hypothesis) -> Test {
        let no_test =
            Test { log_evidence: f64::NEG_INFINITY, p: 1.0, mean: Vector::zeros(), sd: Vector::repeat(1.0) };
        let mut information = self.g;
        let least = 1e-9 * information.trace();
        let mut count = 0;
        for i in 0..MAX_PARAMETERS {
            if information[(i, i)] > 0.0 {
                count += 1;
                information[(i, i)] += least;
            } else {
                information[(i, i)] = 1.0;
            }
        }
        let Some(chi_square) = information.cholesky().map(|factor| self.b.dot(&factor.solve(&self.b))) else {
            return no_test;
        };
        let freedom = self.rank - f64::from(count);
        let ratio = if freedom > 0.5 { ((self.squares - chi_square) / freedom).max(1.0) } else { 1.0 };
        let (b, g) = (self.b / ratio, self.g / ratio);
        let Some(factor) = (Matrix::identity() + g).cholesky() else { return no_test };
        let mean = factor.solve(&b);
        let is_negative =
            hypothesis.parameters.iter().zip(mean.iter()).any(|(one, mean)| !one.two_sided && *mean < 0.0);
        if is_negative || count == 0 {
            return no_test;
        }
        let sides = hypothesis.parameters.iter().filter(|one| !one.two_sided).count() as f64;
        let half_ln_determinant = factor.l().diagonal().map(f64::ln).sum();
        Test {
            log_evidence: 0.5 * b.dot(&mean) - half_ln_determinant + sides * std::f64::consts::LN_2,
            p: ChiSquared::new(f64::from(count)).map_or(1.0, |chi| chi.sf(chi_square / ratio)),
            mean,
            sd: factor.inverse().diagonal().map(|variance| variance.max(0.0).sqrt()),
        }
    }

    /// Log evidence of a shared effect, the sessions' differences taken as chance, and its size in units of the priors; no evidence and
    /// no size of one that cannot be negative and would be.
    pub fn evidence(&self, hypothesis: &Hypothesis) -> (f64, Option<f64>) {
        let Some(factor) = (Matrix::identity() + self.g).cholesky() else { return (f64::NEG_INFINITY, None) };
        let mean = factor.solve(&self.b);
        let evidence = 0.5 * self.b.dot(&mean) - factor.l().diagonal().map(f64::ln).sum();
        if hypothesis.parameters.iter().zip(mean.iter()).any(|(one, mean)| !one.two_sided && *mean < 0.0) {
            return (evidence.min(0.0), None);
        }
        (evidence, Some(mean.amax()))
    }

    /// Cochran's Q of the sessions' own estimates, its degrees of freedom and p.
    pub fn heterogeneity(&self) -> (f64, f64, f64) {
        let mut information = self.g;
        let mut count = 0.0;
        for i in 0..MAX_PARAMETERS {
            if information[(i, i)] > 0.0 {
                count += 1.0;
            } else {
                information[(i, i)] = 1.0;
            }
        }
        let chi_square = information.cholesky().map_or(0.0, |factor| self.b.dot(&factor.solve(&self.b)));
        let (q, freedom) = ((self.squares - chi_square).max(0.0), self.rank - count);
        (q, freedom, ChiSquared::new(freedom).map_or(1.0, |chi| chi.sf(q)))
    }
}

/// `b^T G^-1 b`; 0 where G is not positive definite. Written out, as it is computed for every effect in every session and group.
fn squares(g: &Matrix, b: &Vector) -> f64 {
    let mut factor = *g;
    let mut remaining = *b;
    let mut sum = 0.0;
    for i in 0..MAX_PARAMETERS {
        let pivot = factor[(i, i)];
        if pivot <= 0.0 || !pivot.is_finite() {
            return 0.0;
        }
        sum += remaining[i] * remaining[i] / pivot;
        for j in i + 1..MAX_PARAMETERS {
            let ratio = factor[(j, i)] / pivot;
            remaining[j] -= ratio * remaining[i];
            for k in i + 1..=j {
                factor[(j, k)] -= ratio * factor[(k, i)];
            }
        }
    }
    sum
}

/// Groups of a label: its values with the sessions that have them, in order.
pub(crate) fn groups(labels: &[Option<String>]) -> BTreeMap<&str, Vec<usize>> {
    let mut groups: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (index, label) in labels.iter().enumerate() {
        if let Some(label) = label {
            groups.entry(label).or_default().push(index);
        }
    }
    groups
}
