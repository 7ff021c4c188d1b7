//! An electro-mechanical positioning axis, measured by others (Janot, Gautier and Brunot, "Data set and reference models of EMPS", Nonlinear
//! System Identification Benchmarks, 2019): from mass and viscous friction alone.
//!
//! The makers' own identification has a mass of 95.1 kg, viscous friction of 203.5 N s/m, dry friction of 20.4 N and an offset of -3.2 N.

mod common;

use common::{arrays, channel, column, derivative, mass_and_viscous_friction, measured, parameter};
use discrepancy::*;

fn inner(values: &[f64], cut: usize) -> Vec<f64> {
    values[cut..values.len() - cut].to_vec()
}

fn run(name: &str, path: &std::path::PathBuf, judges: bool) -> Run {
    let arrays = arrays(path);
    let time = &arrays["t"];
    let step_s = time[1] - time[0];
    let gain = arrays["gtau"][0];
    let force: Vec<f64> = arrays["vir"].iter().map(|voltage| gain * voltage).collect();
    // The series are not smoothed here: the workflow fits means over blocks, of force, acceleration and every law alike.
    let speed = derivative(&arrays["qm"], step_s);
    let acceleration = derivative(&speed, step_s);
    Run {
        name: name.to_owned(),
        time_s: inner(time, 2),
        channels: vec![channel("force", "N", inner(&force, 2))],
        columns: vec![
            column("position", "m", inner(&arrays["qm"], 2)),
            column("speed", "m/s", inner(&speed, 1)),
            column("acceleration", "m/s^2", acceleration),
        ],
        judges,
    }
}

/// Dry friction of this axis builds up within a millimetre: the makers' 20.4 N are that of a sign and a bristle together. Their offset is that of a model
/// without an asymmetry, the mean of its even laws over the data. The manual's page has all figures.
#[test]
fn names_dry_friction_of_a_measured_axis_and_refuses_what_does_not_help() {
    let (Some(train), Some(test)) = (measured("emps/DATA_EMPS.mat"), measured("emps/DATA_EMPS_PULSES.mat"))
    else {
        return;
    };
    let data = Data::new(vec![run("trajectory", &train, false), run("pulses", &test, true)]).expect("data");
    let axis = mass_and_viscous_friction(
        parameter("mass", "kg", 100.0, 100.0),
        parameter("viscous", "N s/m", 200.0, 200.0),
    );
    let report = diagnose(&axis, &data, &Options::default(), &|_| ()).expect("a result");
    println!("{report}");
    let ids: Vec<String> = report.terms.iter().map(|term| term.law.id()).collect();
    for id in ["friction/speed/sign", "friction/speed/asymmetry"] {
        assert!(report.terms.iter().any(|term| term.is_named && term.law.id() == id), "{ids:?}");
    }
    assert!(!ids.iter().any(|id| id.ends_with("/decay")), "{ids:?}");
    // A bristle is followed in the first millimetres of a stroke; no function of the place on the axis is there.
    assert_eq!(ids.iter().find(|id| id.starts_with("friction/position/") && !id.ends_with("/bristle")), None);
    let (offset, reversal) = (&report.offsets[0], &report.reversals[0]);
    assert!(offset.is_named && reversal.is_named, "{offset:?} {reversal:?}");
    let [mass, viscous] = [0, 1].map(|number: usize| &report.parameters[number].estimate);
    for (estimate, value) in
        [(&offset.estimate, -3.2), (&reversal.estimate, 20.4), (mass, 95.1), (viscous, 203.5)]
    {
        let [low, high] = estimate.ci95;
        assert!((low..=high).contains(&value), "{estimate:?} for {value}");
    }
    let held_out = report.channels[0].held_out.expect("a run judges");
    assert!(held_out.after < 0.0495 * held_out.measured, "{held_out:?}");
}
