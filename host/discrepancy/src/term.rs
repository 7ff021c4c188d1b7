//! Laws at sites, as a model evaluates them.

use super::form::{Form, Span};
use serde::Serialize;
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// A law at a site.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Term {
    /// Name of the site.
    pub site: String,
    /// Name of the regressor; nothing for a constant.
    pub regressor: Option<String>,
    /// Its form.
    pub form: Form,
    /// Amplitudes, then the number of its shape.
    pub values: Vec<f64>,
    /// Range of the regressor's values.
    pub span: Span,
}

/// Ranges of regressors as a model states them.
pub(crate) type Stated = Mutex<BTreeMap<(String, String), [f64; 2]>>;

/// The laws of a hypothesis; none in the plain model.
#[derive(Debug, Clone, Copy)]
pub struct Terms<'a> {
    list: &'a [Term],
    stated: Option<&'a Stated>,
}

impl<'a> Terms<'a> {
    /// Takes these laws.
    pub fn new(list: &'a [Term]) -> Self {
        Self { list, stated: None }
    }

    /// The same, and what the model states as regressors is kept.
    pub(crate) fn recording(list: &'a [Term], stated: &'a Stated) -> Self {
        Self { list, stated: Some(stated) }
    }

    /// All of them.
    pub fn list(&self) -> &'a [Term] {
        self.list
    }

    /// Sum of the laws of a site at these values of its regressors, one instant alone. A law with a history is not evaluated here:
    /// it acts where the model calls [`Terms::add`] and its regressor is declared so.
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

    /// Adds what the laws of a site do over whole series.
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
        let Some(stated) = self.stated else { return };
        let mut stated = stated.lock().unwrap_or_else(PoisonError::into_inner);
        for (name, values) in regressors {
            let empty = [f64::INFINITY, f64::NEG_INFINITY];
            let range = stated.entry((site.to_owned(), name.to_owned())).or_insert(empty);
            for x in values.iter().filter(|x| x.is_finite()) {
                *range = [range[0].min(*x), range[1].max(*x)];
            }
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
        let stated = Stated::default();
        let terms = Terms::recording(&list, &stated);
        assert_eq!(terms.value("joint", &[("speed", -0.3)]), -1.5);
        let mut sum = [0.0; 2];
        terms.add("joint", &[("speed", &[-0.1, 0.7])], &mut sum);
        assert_eq!(sum, [-1.5, 2.5]);
        let stated = stated.lock().expect("no thread has failed");
        assert_eq!(stated[&("joint".to_owned(), "speed".to_owned())], [-0.3, 0.7]);
    }
}
