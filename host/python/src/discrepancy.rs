//! The workflow for models that are Python functions: what `needle_guide.discrepancy` is made of.

use super::failure::{analysis, usage};
use super::work::{Leave, Message, interruptible};
use ::discrepancy::{
    Data, Effect, Error, ForwardModel, ModelFailure, Options, Parameter, Ranges, Run, Site, Term, Terms,
    diagnose,
};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The laws that a model adds at its sites.
#[pyclass(frozen, module = "needle_guide._core")]
pub struct DiscrepancyTerms {
    list: Vec<Term>,
    sites: Arc<[String]>,
    /// Ranges of the values with which it was called.
    ranges: Ranges,
}

#[pymethods]
impl DiscrepancyTerms {
    /// Sum of the laws of a site, as a number or, where a regressor is an array, as an array.
    #[pyo3(signature = (site, **regressors))]
    fn __call__<'py>(
        &self,
        py: Python<'py>,
        site: &str,
        regressors: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        if !self.sites.iter().any(|one| one == site) {
            let message = format!("site {site:?} is none of those stated: {}", self.sites.join(", "));
            return Err(usage(py, &message));
        }
        let terms = Terms::recording(&self.list, &self.ranges);
        let (mut scalars, mut arrays) = (Vec::new(), Vec::new());
        for (name, value) in regressors.into_iter().flatten() {
            let name: String = name.extract()?;
            match value.extract::<f64>() {
                Ok(value) => scalars.push((name, value)),
                Err(_) => arrays.push((name, series(&value)?)),
            }
        }
        if arrays.is_empty() {
            let named: Vec<(&str, f64)> =
                scalars.iter().map(|(name, value)| (name.as_str(), *value)).collect();
            return Ok(terms.value(site, &named).into_pyobject(py)?.into_any());
        }
        let length = arrays.iter().map(|(_, values)| values.len()).max().unwrap_or(0);
        if let Some((name, values)) = arrays.iter().find(|(_, values)| values.len() != length) {
            let message = format!("regressor {name}: {} values, others have {length}", values.len());
            return Err(usage(py, &message));
        }
        arrays.extend(scalars.into_iter().map(|(name, value)| (name, vec![value; length])));
        let named: Vec<(&str, &[f64])> =
            arrays.iter().map(|(name, values)| (name.as_str(), values.as_slice())).collect();
        let mut sum = vec![0.0; length];
        terms.add(site, &named, &mut sum);
        Ok(PyArray1::from_vec(py, sum).into_any())
    }
}

/// Numbers of an array or of a sequence.
fn series(value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    match value.extract::<PyReadonlyArray1<'_, f64>>() {
        Ok(array) => Ok(array.as_array().iter().copied().collect()),
        Err(_) => value.extract(),
    }
}

/// A Python function `model(parameters, terms, run)` as a forward model.
struct Function {
    function: Py<PyAny>,
    /// Arguments that the function gets as its run, by name.
    runs: BTreeMap<String, Py<PyAny>>,
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
    names: Arc<[String]>,
    timeout: Duration,
    is_interrupted: Box<dyn Fn() -> bool + Send + Sync>,
    /// The exception of the last failure.
    raised: Arc<Mutex<Option<PyErr>>>,
}

impl Function {
    fn call(
        &self,
        py: Python<'_>,
        run: &Run,
        parameters: &[f64],
        terms: &Terms<'_>,
    ) -> PyResult<Vec<Vec<f64>>> {
        let values = PyDict::new(py);
        for (parameter, value) in self.parameters.iter().zip(parameters) {
            values.set_item(&parameter.name, value)?;
        }
        let py_terms = DiscrepancyTerms {
            list: terms.list().to_vec(),
            sites: Arc::clone(&self.names),
            ranges: Ranges::default(),
        };
        let py_terms = Py::new(py, py_terms)?;
        let py_run = self.runs.get(&run.name).map(|run| run.clone_ref(py));
        let result = self.function.call1(py, (values, py_terms.clone_ref(py), py_run))?;
        terms.include(&py_terms.get().ranges);
        let result = result.bind(py);
        let of_channel = |channel: &::discrepancy::Channel| match result.cast::<PyDict>() {
            Ok(channels) => match channels.get_item(&channel.name)? {
                Some(values) => series(&values),
                None => {
                    Err(PyValueError::new_err(format!("the model returns no channel {:?}", channel.name)))
                }
            },
            Err(_) if run.channels.len() == 1 => series(result),
            Err(_) => {
                Err(PyValueError::new_err("the model has to return a dict with an array for every channel"))
            }
        };
        run.channels.iter().map(of_channel).collect()
    }
}

impl ForwardModel for Function {
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
        if (self.is_interrupted)() {
            return Err(ModelFailure::Broken("interrupted".to_owned()));
        }
        let start = Instant::now();
        let result = Python::attach(|py| {
            self.call(py, run, parameters, terms).map_err(|error| {
                let text = error.to_string();
                *self.raised.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
                ModelFailure::Failed(text)
            })
        });
        if start.elapsed() > self.timeout {
            return Err(ModelFailure::Slow { limit_s: self.timeout.as_secs_f64() });
        }
        result
    }

    fn is_parallel(&self) -> bool {
        // The interpreter runs one function at a time.
        false
    }
}

/// Declarations beside the function and the runs, as JSON.
#[derive(serde::Deserialize)]
struct Stated {
    parameters: Vec<Parameter>,
    sites: Vec<Site>,
    effects: Vec<String>,
    everyday: f64,
    timeout_s: f64,
}

/// Name, unit, values and standard deviations of a channel.
type StatedChannel = (String, String, Vec<f64>, Option<Vec<f64>>);

/// A run without its values.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct StatedRun {
    name: String,
    time_s: Vec<f64>,
    channels: Vec<StatedChannel>,
    columns: Vec<(String, Vec<f64>)>,
    judges: bool,
    /// Argument that the model gets.
    run: Py<PyAny>,
}

/// Diagnoses a Python function by runs; returns the document and the text of the result.
#[pyfunction]
pub fn discrepancy(
    py: Python<'_>,
    function: Py<PyAny>,
    runs: Vec<Bound<'_, PyAny>>,
    stated: &str,
    on_step: Option<Py<PyAny>>,
) -> PyResult<(String, String)> {
    let Stated { parameters, sites, effects, everyday, timeout_s } = serde_json::from_str(stated)
        .map_err(|error| usage(py, &format!("parameters, sites or effects: {error}")))?;
    let timeout = Duration::try_from_secs_f64(timeout_s)
        .map_err(|_| usage(py, &format!("timeout_s: {timeout_s}, expected a number of seconds above 0")))?;
    let (mut py_runs, mut model_runs) = (BTreeMap::new(), Vec::new());
    for run in runs {
        let StatedRun { name, time_s, channels, columns, judges, run } = run.extract()?;
        if py_runs.insert(name.clone(), run).is_some() {
            return Err(usage(py, &format!("data: two runs have the name {name:?}")));
        }
        let channels = channels.into_iter().map(|(name, unit, values, sds)| ::discrepancy::Channel {
            name,
            unit,
            values,
            sds,
        });
        let columns = columns.into_iter().map(|(name, values)| ::discrepancy::Column {
            name,
            unit: String::new(),
            values,
        });
        let (channels, columns) = (channels.collect(), columns.collect());
        model_runs.push(Run { name, time_s, channels, columns, judges });
    }
    let data = Data::new(model_runs).map_err(|error| usage(py, &error.to_string()))?;
    let effects: Result<Vec<Effect>, Error> = effects.iter().map(|text| Effect::parse(text)).collect();
    let options = Options { everyday, effects: effects.map_err(|error| usage(py, &error.to_string()))? };
    let raised = Arc::new(Mutex::new(None));
    let raised_in_model = Arc::clone(&raised);
    let result = interruptible(
        py,
        move |messages, interrupted| {
            let names = sites.iter().map(|site| site.name.clone()).collect();
            let is_interrupted = Box::new(move || interrupted.is_set());
            let model = Function {
                function,
                runs: py_runs,
                parameters,
                sites,
                names,
                timeout,
                is_interrupted,
                raised: raised_in_model,
            };
            let messages = Mutex::new(messages);
            diagnose(&model, &data, &options, &|step| {
                messages.lock().unwrap_or_else(PoisonError::into_inner).send(Message::Step(step.to_owned()));
            })
        },
        |message| match (message, &on_step) {
            (Message::Step(step), Some(on_step)) => on_step.call1(py, (step,)).map(drop),
            _ => Ok(()),
        },
        Leave::Behind,
    )?;
    match result {
        Ok(report) => {
            let document =
                serde_json::to_string(&report).map_err(|error| analysis(py, &error.to_string()))?;
            Ok((document, report.to_string()))
        }
        Err(error) => {
            let is_usage = matches!(error, Error::Declaration { .. } | Error::Data(_));
            let exception =
                if is_usage { usage(py, &error.to_string()) } else { analysis(py, &error.to_string()) };
            let cause = raised.lock().unwrap_or_else(PoisonError::into_inner).take();
            if matches!(error, Error::Model { .. }) {
                exception.set_cause(py, cause);
            }
            Err(exception)
        }
    }
}
