//! A forward model that is a function.

use super::data::Run;
use super::model::{ForwardModel, ModelFailure, Parameter, Site};
use super::term::Terms;

/// A forward model that is a function `predict(run, parameters, terms)`.
pub struct FunctionModel<F> {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
    predict: F,
}

impl<F> FunctionModel<F>
where
    F: Fn(&Run, &[f64], &Terms<'_>) -> Result<Vec<Vec<f64>>, ModelFailure> + Sync,
{
    /// Model with these parameters and sites, and with the function as [`ForwardModel::predict`].
    pub fn new(parameters: Vec<Parameter>, sites: Vec<Site>, predict: F) -> Self {
        Self { parameters, sites, predict }
    }
}

impl<F> ForwardModel for FunctionModel<F>
where
    F: Fn(&Run, &[f64], &Terms<'_>) -> Result<Vec<Vec<f64>>, ModelFailure> + Sync,
{
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn sites(&self) -> &[Site] {
        &self.sites
    }

    fn predict(
        &self,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> Result<Vec<Vec<f64>>, ModelFailure> {
        (self.predict)(run, parameters, terms)
    }
}
