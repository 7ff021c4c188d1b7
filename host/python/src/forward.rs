//! The forward model over many sets of parameters: force of guide 2, shape of the needle, and their derivatives.

use super::failure::usage;
use super::work::computed;
use mechanics::{BeamProblem, Foundation, ModelError, Needle, Rig};
use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// A parameter: its name, and the step of its derivative as a share of the value and at least so much.
struct Parameter {
    name: &'static str,
    relative: f64,
    least: f64,
    /// Least value that the model takes.
    from: f64,
}

const fn parameter(name: &'static str, relative: f64, least: f64, from: f64) -> Parameter {
    Parameter { name, relative, least, from }
}

const COUNT: usize = 9;
const ALL: [Parameter; COUNT] = [
    parameter("k_kpa", 1e-3, 1e-6, 0.0),
    parameter("depth_mm", 0.0, 0.02, 0.0),
    parameter("displacement_mm", 1e-2, 1e-2, f64::NEG_INFINITY),
    parameter("guide2_mm", 0.0, 0.02, 0.0),
    parameter("entry_mm", 0.0, 0.02, 0.0),
    parameter("bending_stiffness_n_m2", 1e-3, 1e-9, 0.0),
    parameter("gap_mm", 0.0, 0.02, 0.0),
    parameter("skin_n_per_mm", 1e-3, 1e-4, 0.0),
    parameter("gradient_per_mm", 0.0, 1e-4, f64::NEG_INFINITY),
];
/// Names of the columns.
pub const PARAMETERS: [&str; COUNT] = {
    let mut names = [""; COUNT];
    let mut i = 0;
    while i < COUNT {
        names[i] = ALL[i].name;
        i += 1;
    }
    names
};
/// Offsets, in steps, and weights of the first derivative to fourth order: in the middle of five points, and at their beginning.
const CENTRAL: [(f64, f64); 4] =
    [(-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0)];
const FORWARD: [(f64, f64); 5] =
    [(0.0, -25.0 / 12.0), (1.0, 4.0), (2.0, -3.0), (3.0, 4.0 / 3.0), (4.0, -0.25)];

type Row = [f64; COUNT];

/// Force of guide 2 in newtons and deflection in millimetres at the places.
fn solve(row: &Row, z_m: &[f64]) -> Result<(f64, Vec<f64>), ModelError> {
    let [k_kpa, depth_mm, displacement_mm, guide2_mm, entry_mm, bending_stiffness, gap_mm, skin, gradient] =
        *row;
    let rig = Rig::two_guides(Needle::gauge_18(), 1e-3 * guide2_mm, 1e-3 * entry_mm);
    rig.validate()?;
    let mut foundation = Foundation::uniform(1e3 * k_kpa)?;
    if gradient != 0.0 {
        foundation = foundation.graded(1e3 * gradient)?;
    }
    if gap_mm != 0.0 {
        foundation = foundation.with_gap(1e-3 * gap_mm)?;
    }
    let problem = BeamProblem {
        bending_stiffness_n_m2: bending_stiffness,
        skin_n_per_m: 1e3 * skin,
        ..BeamProblem::new(&rig, foundation, 1e-3 * depth_mm)
    };
    let beam = problem.solve()?;
    let force_n = beam.force_n(1e-3 * displacement_mm);
    let mut deflections = beam.deflections_m(1e-3 * displacement_mm, z_m);
    deflections.iter_mut().for_each(|at| *at *= 1e3);
    Ok((force_n, deflections))
}

/// Derivative of the same by one parameter.
fn derivative(row: &Row, column: usize, z_m: &[f64]) -> Result<(f64, Vec<f64>), ModelError> {
    let Some((parameter, value)) = ALL.get(column).zip(row.get(column).copied()) else {
        return Ok((0.0, vec![0.0; z_m.len()]));
    };
    let step = (parameter.relative * value.abs()).max(parameter.least);
    let stencil = if value - 2.0 * step < parameter.from { FORWARD.as_slice() } else { CENTRAL.as_slice() };
    let (mut force, mut shape) = (0.0, vec![0.0; z_m.len()]);
    for (offset, weight) in stencil {
        let mut moved = *row;
        if let Some(value) = moved.get_mut(column) {
            *value += offset * step;
        }
        let (force_n, deflections) = solve(&moved, z_m)?;
        force += weight * force_n / step;
        shape.iter_mut().zip(deflections).for_each(|(sum, at)| *sum += weight * at / step);
    }
    Ok((force, shape))
}

/// Results over sets of parameters, set by set.
struct Results {
    force: Vec<f64>,
    shape: Vec<f64>,
    force_by: Vec<f64>,
    shape_by: Vec<f64>,
}

fn all(
    rows: &[Row],
    z_m: &[f64],
    columns: &[usize],
    is_left: &dyn Fn() -> bool,
) -> Result<Results, (usize, ModelError)> {
    let (sets, position_count) = (rows.len(), z_m.len());
    // Growing them would write every result twice.
    let mut results = Results {
        force: Vec::with_capacity(sets),
        shape: Vec::with_capacity(sets * position_count),
        force_by: Vec::with_capacity(sets * columns.len()),
        shape_by: Vec::with_capacity(sets * columns.len() * position_count),
    };
    for (number, row) in rows.iter().enumerate() {
        if is_left() {
            break;
        }
        let (force, shape) = solve(row, z_m).map_err(|error| (number, error))?;
        results.force.push(force);
        results.shape.extend(shape);
        for column in columns {
            let (force, shape) = derivative(row, *column, z_m).map_err(|error| (number, error))?;
            results.force_by.push(force);
            results.shape_by.extend(shape);
        }
    }
    Ok(results)
}

type Arrays<'py> = (
    Bound<'py, numpy::PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray3<f64>>,
);

/// Force (n) in newtons, deflection (n, places) in millimetres, and the derivatives by the named columns, (n, columns) and
/// (n, columns, places). `first` is the number of the first of these sets, for errors.
#[pyfunction]
pub fn forward<'py>(
    py: Python<'py>,
    parameters: PyReadonlyArray2<'py, f64>,
    z_mm: PyReadonlyArray1<'py, f64>,
    columns: Vec<usize>,
    first: usize,
) -> PyResult<Arrays<'py>> {
    if parameters.shape().get(1) != Some(&COUNT) {
        return Err(usage(py, &format!("parameters: expected {COUNT} columns")));
    }
    if let Some(column) = columns.iter().find(|column| **column >= COUNT) {
        return Err(usage(py, &format!("columns: {column}, expected 0 to {}", COUNT - 1)));
    }
    let rows: Vec<Row> = parameters
        .as_array()
        .rows()
        .into_iter()
        .map(|row| std::array::from_fn(|column| row.get(column).copied().unwrap_or(f64::NAN)))
        .collect();
    let z_m: Vec<f64> = z_mm.as_array().iter().map(|mm| 1e-3 * mm).collect();
    let (count, position_count, column_count) = (rows.len(), z_m.len(), columns.len());
    let derivatives = computed(py, move |_, flag| all(&rows, &z_m, &columns, &|| flag.is_set()), |_| Ok(()))?;
    let results = derivatives.map_err(|(number, error)| usage(py, &explain(first + number, &error)))?;
    let shaped = |error: numpy::ndarray::ShapeError| super::failure::internal(py, &error.to_string());
    Ok((
        results.force.into_pyarray(py),
        Array2::from_shape_vec((count, position_count), results.shape).map_err(shaped)?.into_pyarray(py),
        Array2::from_shape_vec((count, column_count), results.force_by).map_err(shaped)?.into_pyarray(py),
        Array3::from_shape_vec((count, column_count, position_count), results.shape_by)
            .map_err(shaped)?
            .into_pyarray(py),
    ))
}

/// The error with the number of its set and the name that the parameter has here.
fn explain(number: usize, error: &ModelError) -> String {
    let ModelError::OutOfRange { name, value, expected } = error else {
        return format!("set {number}: {error}");
    };
    let scaled = match *name {
        "modulus_pa" => Some(("k_kpa", 1e-3)),
        "depth_m" => Some(("depth_mm", 1e3)),
        "guide2_m" => Some(("guide2_mm", 1e3)),
        "entry_m" => Some(("entry_mm", 1e3)),
        "gap_m" => Some(("gap_mm", 1e3)),
        "gradient_per_m" => Some(("gradient_per_mm", 1e-3)),
        "skin_n_per_m" => Some(("skin_n_per_mm", 1e-3)),
        _ => None,
    };
    let (name, factor) = scaled.unwrap_or((*name, 1.0));
    format!("{name}[{number}]: {} is out of range, expected {expected}", value * factor)
}
