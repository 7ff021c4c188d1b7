//! Cascaded tanks, measured by others (Schoukens, Mattson, Wigren and Noel, "Cascaded tanks benchmark combining soft and hard nonlinearities",
//! 2016): a pump fills the upper tank, which drains into the lower one, whose level is measured. From Torricelli's law alone.

mod common;

use common::{channel, column, integrated, measured, parameter, regressor, site};
use discrepancy::*;

/// Distance of two samples, and steps of the integration between them.
const SAMPLE_S: f64 = 4.0;
const STEPS: usize = 4;

fn tanks() -> impl ForwardModel {
    let parameters = vec![
        parameter("outflow of upper", "V^0.5/s", 0.05, 0.05),
        parameter("inflow of lower", "V^0.5/s", 0.05, 0.05),
        parameter("outflow of lower", "V^0.5/s", 0.05, 0.05),
        parameter("pump", "1/s", 0.05, 0.05),
        parameter("upper at first", "V", 5.0, 5.0),
        parameter("lower at first", "V", 5.0, 5.0),
    ];
    let sites = vec![
        site("upper", "V/s", None, vec![regressor("upper_level", "V")]),
        site("lower", "V/s", None, vec![regressor("lower_level", "V")]),
    ];
    FunctionModel::new(parameters, sites, |run: &Run, parameters: &[f64], terms: &Terms<'_>| {
        let &[upper_out, lower_in, lower_out, pump, upper, lower] = parameters else {
            return Err(ModelFailure::Failed(format!("{} parameters", parameters.len())));
        };
        let rates = |[upper, lower]: [f64; 2], u: f64| {
            let (upper_root, lower_root) = (upper.max(0.0).sqrt(), lower.max(0.0).sqrt());
            let of_upper = terms.value("upper", &[("upper_level", upper)]);
            let of_lower = terms.value("lower", &[("lower_level", lower)]);
            [
                pump * u - upper_out * upper_root + of_upper,
                lower_in * upper_root - lower_out * lower_root + of_lower,
            ]
        };
        let states =
            integrated(run.needed("pump")?, [upper, lower], (STEPS, SAMPLE_S / STEPS as f64, 0.0), rates);
        Ok(vec![states.iter().map(|[_, lower]| *lower).collect()])
    })
}

fn run(name: &str, text: &str, columns: [usize; 2], judges: bool) -> Run {
    let lines = text.lines().skip(1).filter(|line| !line.trim_matches(',').is_empty());
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let [pump, level] =
        columns.map(|i| rows.iter().map(|row| row[i].parse().expect("a number")).collect::<Vec<f64>>());
    Run {
        name: name.to_owned(),
        time_s: (0..rows.len()).map(|i| SAMPLE_S * i as f64).collect(),
        channels: vec![channel("level", "V", level)],
        columns: vec![column("pump", "V", pump)],
        judges,
    }
}

/// Parts of a run whose readings are at the largest one, from 1: there both tanks are full.
fn full(run: &Run) -> usize {
    let levels = &run.channels[0].values;
    let largest = levels.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let is_full: Vec<bool> = levels.iter().map(|level| *level == largest).collect();
    is_full.windows(2).filter(|pair| !pair[0] && pair[1]).count()
}

/// The makers state an overflow of the upper tank. It acts twice in either record: a test that counts such parts and not readings cannot confirm it.
#[test]
fn the_overflow_of_measured_tanks_is_named() {
    let Some(path) = measured("tanks/dataBenchmark.csv") else { return };
    let text = std::fs::read_to_string(path).expect("a readable file");
    let runs = vec![run("estimation", &text, [0, 2], false), run("validation", &text, [1, 3], true)];
    assert_eq!(runs.iter().map(full).collect::<Vec<_>>(), [2, 2]);
    let data = Data::new(runs).expect("data");
    let report = diagnose(&tanks(), &data, &Options::default(), &|_| ()).expect("a result");
    println!("{report}");
    let overflow = report.terms.iter().find(|term| term.law.id() == "upper/upper_level/above_level");
    assert!(overflow.is_some_and(|term| term.is_named && term.values[0].ci95[1] < 0.0), "{report}");
    assert!(report.terms.iter().all(|term| term.held_out.is_some_and(|one| one.is_confirmed())), "{report}");
}
