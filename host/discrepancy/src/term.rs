//! Laws at sites, in the form that a model evaluates.

use super::form::{Form, Span};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// A law at a site.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Term {
    /// Name of the site.
    pub site: String,
    /// Name of the regressor; `None` for a constant.
    pub regressor: Option<String>,
    /// Its form.
    pub form: Form,
    /// Amplitudes, then the shape parameter.
    pub values: Vec<f64>,
    /// Range of the regressor's values.
    pub span: Span,
}

/// Ranges of the regressors' values that a model passes when it evaluates laws, by site and regressor.
#[derive(Debug, Default)]
pub struct Ranges(Mutex<BTreeMap<(String, String), [f64; 2]>>);

impl Ranges {
    /// The range of a regressor at a site; `None` if the model has not passed a finite value.
    pub fn get(&self, site: &str, regressor: &str) -> Option<[f64; 2]> {
        let ranges = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        ranges.get(&(site.to_owned(), regressor.to_owned())).copied()
    }

    fn record<'b>(&self, site: &str, regressors: impl Iterator<Item = (&'b str, &'b [f64])>) {
        let mut ranges = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        for (name, values) in regressors {
            for x in values.iter().filter(|x| x.is_finite()) {
                let range = ranges.entry((site.to_owned(), name.to_owned())).or_insert([*x, *x]);
                *range = [range[0].min(*x), range[1].max(*x)];
            }
        }
    }
}

/// The laws of a hypothesis; none in the plain model.
#[derive(Debug, Clone, Copy)]
pub struct Terms<'a> {
    list: &'a [Term],
    ranges: Option<&'a Ranges>,
}

impl<'a> Terms<'a> {
    /// Terms of these laws.
    pub fn new(list: &'a [Term]) -> Self {
        Self { list, ranges: None }
    }

    /// Terms of these laws, which record the ranges of regressors.
    pub fn recording(list: &'a [Term], ranges: &'a Ranges) -> Self {
        Self { list, ranges: Some(ranges) }
    }

    /// Adds ranges that were recorded elsewhere, for example by a copy of these laws.
    pub fn include(&self, ranges: &Ranges) {
        let ranges = ranges.0.lock().unwrap_or_else(PoisonError::into_inner);
        for ((site, name), range) in ranges.iter() {
            self.record(site, std::iter::once((name.as_str(), range.as_slice())));
        }
    }

    /// All laws.
    pub fn list(&self) -> &'a [Term] {
        self.list
    }

    /// Sum of the laws of a site at these values of its regressors, at one instant. A law with a history is not evaluated here,
    /// but by [`Terms::add`], if its regressor is declared to have a history.
    pub fn value(&self, site: &str, regressors: &[(&str, f64)]) -> f64 {
        let mut sum = [0.0];
        self.record(site, regressors.iter().map(|(name, x)| (*name, std::slice::from_ref(x))));
        for term in self.list.iter().filter(|term| term.site == site) {
            let x = match &term.regressor {
                None => 0.0,
                Some(name) => match regressors.iter().find(|(one, _)| one == name) {
                    Some((_, x)) => *x,
                    None => continue,
                },
            };
            term.form.add(&term.values, &[x], &term.span, &mut sum);
        }
        sum[0]
    }

    /// Adds the laws of a site over whole series.
    pub fn add(&self, site: &str, regressors: &[(&str, &[f64])], sum: &mut [f64]) {
        self.record(site, regressors.iter().copied());
        for term in self.list.iter().filter(|term| term.site == site) {
            match &term.regressor {
                None => sum.iter_mut().for_each(|sum| *sum += term.values.first().copied().unwrap_or(0.0)),
                Some(name) => {
                    if let Some((_, x)) = regressors.iter().find(|(one, _)| one == name) {
                        term.form.add(&term.values, x, &term.span, sum);
                    }
                }
            }
        }
    }

    fn record<'b>(&self, site: &str, regressors: impl Iterator<Item = (&'b str, &'b [f64])>) {
        if let Some(ranges) = self.ranges {
            ranges.record(site, regressors);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn laws_of_a_site_add_up_and_others_do_not() {
        let span = Span::between(-1.0, 1.0);
        let term = |site: &str, regressor: Option<&str>, form, values: &[f64]| Term {
            site: site.to_owned(),
            regressor: regressor.map(str::to_owned),
            form,
            values: values.to_vec(),
            span,
        };
        let list = [
            term("joint", None, Form::Constant, &[0.5]),
            term("joint", Some("speed"), Form::Sign, &[2.0]),
            term("spring", Some("speed"), Form::Sign, &[100.0]),
        ];
        let ranges = Ranges::default();
        let terms = Terms::recording(&list, &ranges);
        assert_eq!(terms.value("joint", &[("speed", -0.3)]), -1.5);
        let mut sum = [0.0; 2];
        terms.add("joint", &[("speed", &[-0.1, 0.7])], &mut sum);
        assert_eq!(sum, [-1.5, 2.5]);
        assert_eq!(ranges.get("joint", "speed"), Some([-0.3, 0.7]));
        let whole_run = Ranges::default();
        Terms::recording(&[], &whole_run).include(&ranges);
        assert_eq!(
            (whole_run.get("joint", "speed"), whole_run.get("spring", "speed")),
            (Some([-0.3, 0.7]), None)
        );
    }
}
