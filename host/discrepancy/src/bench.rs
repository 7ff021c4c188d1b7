//! A model with its data, ready to be fitted: predictions and residuals under any set of laws.

mod prepared;

pub(crate) use prepared::Prepared;

use super::data::{Data, Run};
use super::form::{Form, Shape, Span};
use super::model::{Error, ForwardModel, Regressor, Site};
use super::term::{Ranges, Term, Terms};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Effect of a probing law on the channels, in units of their scales: small enough to be linear, large relative to rounding.
const PROBE_EFFECT: f64 = 1e-3;
const MAX_PROBES: usize = 40;

/// A law that may act: its site, its regressor, its form and range, and the priors of its amplitudes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Law {
    pub site: usize,
    pub regressor: Option<usize>,
    pub form: Form,
    pub span: Span,
    /// Standard deviations of the priors of its amplitudes.
    pub amplitude_sds: Vec<f64>,
}

impl Law {
    /// Whether both have the same site, regressor and form.
    pub fn is_like(&self, other: &Self) -> bool {
        (self.site, self.regressor, self.form) == (other.site, other.regressor, other.form)
    }

    pub fn shape(&self) -> Option<Shape> {
        self.form.shape(&self.span)
    }

    /// Number of its parameters.
    pub fn len(&self) -> usize {
        self.form.amplitudes().len() + usize::from(self.shape().is_some())
    }
}

/// One number of a fit: its normal prior and its range.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Coordinate {
    pub mean: f64,
    pub sd: f64,
    pub least: f64,
    pub most: f64,
}

/// A model with its data.
pub(crate) struct Bench<'a> {
    pub model: &'a dyn ForwardModel,
    pub data: &'a Data,
    pub training: Vec<Prepared<'a>>,
    pub held_out: Vec<Prepared<'a>>,
    /// Scale of each channel: its standard deviation around its mean.
    pub scales: Vec<f64>,
    /// Ranges of the regressors of each site.
    pub spans: Vec<Vec<Span>>,
    /// Amplitude of a constant at each site that changes some channel by [`PROBE_EFFECT`].
    probes: Vec<f64>,
}

impl<'a> Bench<'a> {
    /// # Errors
    /// Where model and data do not belong together, or the model fails at its prior means.
    pub fn new(model: &'a dyn ForwardModel, data: &'a Data) -> Result<Self, Error> {
        super::model::check(model, data)?;
        let scales: Vec<f64> = (0..data.channels().len()).map(|channel| data.scale(channel)).collect();
        let training: Vec<Prepared<'a>> = data.training().map(|run| Prepared::new(run, &scales)).collect();
        let held_out = data.held_out().map(|run| Prepared::new(run, &scales)).collect();
        let mut bench =
            Self { model, data, training, held_out, scales, spans: Vec::new(), probes: Vec::new() };
        let start: Vec<f64> = model.parameters().iter().map(|parameter| parameter.mean).collect();
        bench.spans = bench.find_spans(&start)?;
        bench.probes =
            model.sites().iter().map(|site| bench.probe(site, &start)).collect::<Result<_, _>>()?;
        Ok(bench)
    }

    /// Ranges of all regressors: as declared, else of the data, else of the values that the model passes.
    fn find_spans(&self, start: &[f64]) -> Result<Vec<Vec<Span>>, Error> {
        let ranges = Ranges::default();
        for prepared in &self.training {
            self.predict(prepared.run, start, &[], Some(&ranges))?;
        }
        let mut spans = Vec::with_capacity(self.model.sites().len());
        for site in self.model.sites() {
            let regressors = site.regressors.iter().map(|regressor| self.span(site, regressor, &ranges));
            spans.push(regressors.collect::<Result<_, _>>()?);
        }
        Ok(spans)
    }

    /// Range of one regressor; `ranges` are those of the values that the model passed.
    fn span(&self, site: &Site, regressor: &Regressor, ranges: &Ranges) -> Result<Span, Error> {
        let [least, most] = match (regressor.range, &site.adds_to) {
            (Some(range), _) => range,
            (None, Some(_)) => self.range_of(&regressor.name),
            (None, None) => ranges.get(&site.name, &regressor.name).unwrap_or([0.0, 0.0]),
        };
        if most > least && (most - least).is_finite() {
            let step = if site.adds_to.is_some() { self.step_of(&regressor.name) } else { 0.0 };
            return Ok(Span { from: least, to: most, resolution: regressor.resolution, step });
        }
        Err(Error::Declaration {
            what: "regressor",
            name: format!("{}/{}", site.name, regressor.name),
            problem: "the model states no two values of it, and no range is declared".to_owned(),
            expected: "a range, or a model that states it where it adds the terms of the site".to_owned(),
        })
    }

    /// Least and largest value of a column of the runs that are fitted.
    fn range_of(&self, name: &str) -> [f64; 2] {
        let values = self.training.iter().filter_map(|prepared| prepared.run.column(name)).flatten();
        values.fold([f64::INFINITY, f64::NEG_INFINITY], |[least, most], x| [least.min(*x), most.max(*x)])
    }

    /// Mean distance of neighbouring values of a column of the runs that are fitted.
    fn step_of(&self, name: &str) -> f64 {
        let (mut distance, mut count) = (0.0, 0_usize);
        for values in self.training.iter().filter_map(|prepared| prepared.run.column(name)) {
            distance += values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum::<f64>();
            count += values.len().saturating_sub(1);
        }
        distance / count.max(1) as f64
    }

    /// The amplitude of a constant at a site that changes some channel by about [`PROBE_EFFECT`].
    fn probe(&self, site: &Site, start: &[f64]) -> Result<f64, Error> {
        if let Some(channel) = &site.adds_to {
            let channels = self.data.channels().iter().zip(&self.scales);
            let scale = channels.filter(|(one, _)| one.name == *channel).map(|(_, scale)| *scale).next();
            return Ok(PROBE_EFFECT * scale.unwrap_or(1.0));
        }
        let plain = self.residuals_of(&self.training, start, &[])?;
        let mut amplitude = 1.0;
        let mut has_effect = false;
        for _ in 0..MAX_PROBES {
            let span = Span::between(0.0, 1.0);
            let (name, form) = (site.name.clone(), Form::Constant);
            let term = Term { site: name, regressor: None, form, values: vec![amplitude], span };
            let effect = match self.residuals_of(&self.training, start, &[term]) {
                Ok(moved) => Some(rms(moved.iter().zip(&plain).map(|(a, b)| a - b))),
                Err(error) if error.is_of_these_values() => None,
                Err(error) => return Err(error),
            };
            match effect {
                Some(effect) if effect < 1e-3 * PROBE_EFFECT => amplitude *= 10.0,
                Some(effect) if effect < 30.0 * PROBE_EFFECT => {
                    has_effect = true;
                    amplitude *= PROBE_EFFECT / effect;
                    break;
                }
                _ => amplitude *= 0.1,
            }
        }
        if has_effect { Ok(amplitude) } else { Err(Error::NoEffect { site: site.name.clone() }) }
    }

    /// The parameters of a fit with these laws.
    pub fn coordinates(&self, laws: &[Law]) -> Vec<Coordinate> {
        let whole = [f64::NEG_INFINITY, f64::INFINITY];
        let of_model = self.model.parameters().iter().map(|parameter| {
            let [least, most] = parameter.range.unwrap_or(whole);
            Coordinate { mean: parameter.mean, sd: parameter.sd, least, most }
        });
        let of_laws = laws.iter().flat_map(|law| {
            let amplitudes = law.amplitude_sds.iter().map(|sd| Coordinate {
                mean: 0.0,
                sd: *sd,
                least: whole[0],
                most: whole[1],
            });
            // The shape is a fraction of its range: its normal prior has the moments of a uniform distribution.
            let sd = 12f64.sqrt().recip();
            let shape = law.shape().map(|_| Coordinate { mean: 0.5, sd, least: 0.0, most: 1.0 });
            amplitudes.chain(shape).collect::<Vec<_>>()
        });
        of_model.chain(of_laws).collect()
    }

    /// Laws with their parameter values, as the model evaluates them; `values` has all parameters of a fit.
    pub fn terms(&self, laws: &[Law], values: &[f64]) -> Vec<Term> {
        let mut unread = values.get(self.model.parameters().len()..).unwrap_or(&[]);
        laws.iter()
            .map(|law| {
                let (law_values, later_values) = unread.split_at(law.len().min(unread.len()));
                unread = later_values;
                let amplitudes = law.form.amplitudes().len();
                let mut values = law_values.to_vec();
                if let (Some(shape), Some(fraction)) = (law.shape(), values.get_mut(amplitudes)) {
                    *fraction = shape.at(*fraction);
                }
                self.term(law, values)
            })
            .collect()
    }

    /// A law with its parameter values in their own units.
    pub fn term(&self, law: &Law, values: Vec<f64>) -> Term {
        let site = self.model.sites().get(law.site);
        let regressor = law.regressor.and_then(|number| site?.regressors.get(number));
        Term {
            site: site.map_or_else(String::new, |site| site.name.clone()),
            regressor: regressor.map(|regressor| regressor.name.clone()),
            form: law.form,
            values,
            span: law.span,
        }
    }

    /// All channels of a run under these laws.
    fn predict(
        &self,
        run: &Run,
        values: &[f64],
        terms: &[Term],
        ranges: Option<&Ranges>,
    ) -> Result<Vec<Vec<f64>>, Error> {
        let parameters = values.get(..self.model.parameters().len()).unwrap_or(values);
        let model_terms: Vec<Term> =
            terms.iter().filter(|term| self.channel_of(term, run).is_none()).cloned().collect();
        let view = ranges.map_or(Terms::new(&model_terms), |ranges| Terms::recording(&model_terms, ranges));
        let mut channels = self.model.predict(run, parameters, &view).map_err(|cause| Error::Model {
            run: run.name.clone(),
            values: self.text(parameters),
            cause,
        })?;
        if channels.len() != run.channels.len() {
            return Err(Error::Size {
                run: run.name.clone(),
                found: format!("{} channels", channels.len()),
                expected: format!("{} channels", run.channels.len()),
            });
        }
        for (values, channel) in channels.iter().zip(&run.channels) {
            if values.len() != run.time_s.len() {
                return Err(Error::Size {
                    run: run.name.clone(),
                    found: format!("{} values of {}", values.len(), channel.name),
                    expected: format!("{}, one per instant", run.time_s.len()),
                });
            }
            if let Some((i, value)) = values.iter().enumerate().find(|(_, value)| !value.is_finite()) {
                return Err(Error::NotFinite {
                    run: run.name.clone(),
                    channel: channel.name.clone(),
                    reading: i + 1,
                    time_s: run.time_s.get(i).copied().unwrap_or(f64::NAN),
                    value: *value,
                    values: self.text(parameters),
                });
            }
        }
        for term in terms {
            let channel = self.channel_of(term, run).and_then(|number| channels.get_mut(number));
            let Some(values) = channel else { continue };
            let name = term.regressor.as_deref().unwrap_or(super::data::TIME);
            if let Some(x) = run.column(name) {
                term.form.add(&term.values, x, &term.span, values);
            }
        }
        Ok(channels)
    }

    /// Number of the channel to which the workflow adds a term; `None` if the model evaluates the term.
    fn channel_of(&self, term: &Term, run: &Run) -> Option<usize> {
        let site = self.model.sites().iter().find(|site| site.name == term.site)?;
        run.channels.iter().position(|channel| Some(&channel.name) == site.adds_to.as_ref())
    }

    fn text(&self, parameters: &[f64]) -> String {
        let named = self.model.parameters().iter().zip(parameters);
        named.map(|(parameter, value)| format!("{} {value}", parameter.name)).collect::<Vec<_>>().join(", ")
    }

    /// Measured less predicted, in units of the channels' scales, run by run.
    pub fn residuals_of(
        &self,
        runs: &[Prepared<'a>],
        values: &[f64],
        terms: &[Term],
    ) -> Result<Vec<DVector<f64>>, Error> {
        self.each(runs.iter().collect(), |prepared| {
            let predicted = self.predict(prepared.run, values, terms, None)?;
            Ok(prepared.measured() - prepared.means(&predicted, &self.scales))
        })
    }

    /// Results in the order of the items, computed on all cores where the model allows that.
    pub fn each<T: Send, R: Send>(
        &self,
        items: Vec<T>,
        compute: impl Fn(T) -> Result<R, Error> + Sync + Send,
    ) -> Result<Vec<R>, Error> {
        if self.model.is_parallel() {
            items.into_par_iter().map(compute).collect()
        } else {
            items.into_iter().map(compute).collect()
        }
    }

    /// The residuals of a set of laws over the runs that are fitted.
    pub fn residuals(&self, laws: &[Law], values: &[f64]) -> Result<Vec<DVector<f64>>, Error> {
        self.residuals_of(&self.training, values, &self.terms(laws, values))
    }

    /// Derivative of the predictions with respect to the amplitudes of a law, given the laws already in the model: one matrix
    /// per run, with a column per amplitude. `plain` are the residuals without the law. `None` if the model has no prediction
    /// with the law.
    pub fn columns(
        &self,
        law: &Law,
        shape: Option<f64>,
        values: &[f64],
        terms: &[Term],
        plain: &[DVector<f64>],
    ) -> Result<Option<Vec<DMatrix<f64>>>, Error> {
        let amplitudes = law.form.amplitudes().len();
        let mut columns: Vec<DMatrix<f64>> =
            plain.iter().map(|residuals| DMatrix::zeros(residuals.len(), amplitudes)).collect();
        for number in 0..amplitudes {
            let step = self.step(law, number, shape);
            let mut numbers = vec![0.0; amplitudes];
            if let Some(amplitude) = numbers.get_mut(number) {
                *amplitude = step;
            }
            numbers.extend(shape);
            let mut with_law = terms.to_vec();
            with_law.push(self.term(law, numbers));
            match self.residuals_of(&self.training, values, &with_law) {
                Ok(moved) => {
                    for ((matrix, moved), plain) in columns.iter_mut().zip(moved).zip(plain) {
                        matrix.set_column(number, &((plain - moved) / step));
                    }
                }
                Err(error) if error.is_of_these_values() => return Ok(None),
                Err(error) => return Err(error),
            }
        }
        Ok(Some(columns))
    }

    /// Step of an amplitude for the numerical derivative: the largest value of the law is then that of the constant that probes its
    /// site.
    fn step(&self, law: &Law, amplitude: usize, shape: Option<f64>) -> f64 {
        let probe = self.probes.get(law.site).copied().unwrap_or(PROBE_EFFECT);
        let Span { from, to, .. } = law.span;
        let largest = (0..=32)
            .map(|i| {
                let x = from + (to - from) * i as f64 / 32.0;
                law.form.value(amplitude, x, shape.unwrap_or(1.0), &law.span).abs()
            })
            .fold(0.0, f64::max);
        if largest > 0.0 { probe / largest } else { probe }
    }
}

/// Root of the mean square of columns of all runs.
pub(crate) fn rms(parts: impl Iterator<Item = DVector<f64>>) -> f64 {
    let (sum, count) =
        parts.fold((0.0, 0), |(sum, count), part| (sum + part.norm_squared(), count + part.len()));
    (sum / count.max(1) as f64).sqrt()
}
