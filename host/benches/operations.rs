//! Every operation of the page of benches ([`README.md`](README.md)) without its peers: `cargo bench --bench operations`. The page, with
//! them: `cargo xtask bench`.

#![allow(dead_code, reason = "the modules are those of the page, which uses more of them")]

#[path = "beside/src/clock.rs"]
mod clock;
#[path = "beside/src/estimators.rs"]
mod estimators;
#[path = "beside/src/forward.rs"]
mod forward;
#[path = "beside/src/link.rs"]
mod link;
#[path = "beside/src/session.rs"]
mod session;

use anyhow::Result;
use clock::Clock;
use inference::energy::{Balance, energy_modulus};
use mechanics::{Model, Needle, Rig, Support};
use protocol::Sample;
use std::hint::black_box;
use std::path::Path;

const SEED: u32 = 1;

fn main() -> Result<()> {
    let mut clock = Clock::new(&Path::new(env!("CARGO_TARGET_TMPDIR")).join("operations"));
    forward::beam(&mut clock)?;
    foundations(&mut clock)?;
    forward::identification(&mut clock)?;
    energy(&mut clock)?;
    forward::insertion(&mut clock)?;
    estimators::recursive(&mut clock, &estimators::rows(SEED.into()))?;
    estimators::online(&mut clock, SEED.into())?;
    estimators::prediction(&mut clock)?;
    estimators::diagnosis(&mut clock)?;
    let folder = tempfile::tempdir()?;
    session::write(folder.path(), session::ROWS)?;
    session::load(&mut clock, folder.path())?;
    frames(&mut clock)
}

/// The same needle on springs and in an elastic body, at moduli that are new each time as in a fit: the body should cost no more than
/// five times as much.
fn foundations(clock: &mut Clock) -> Result<()> {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    for (name, support) in [("on springs", Support::Springs), ("in a body", Support::half_space(0.5))] {
        let mut modulus_pa = 16e3;
        clock.seconds(name, || {
            modulus_pa *= 1.0 + 1e-9;
            let model = Model::on(black_box(&rig).clone(), support, modulus_pa).expect("a model");
            model.beam(0.03).expect("solves").lateral_stiffness_n_per_m()
        })?;
    }
    Ok(())
}

/// The modulus of the same run by the balance of energy.
fn energy(clock: &mut Clock) -> Result<()> {
    let run = forward::run(40);
    let level = &run.levels[0];
    let balance = Balance {
        displacement_m: level.displacement_m[0],
        force_n: level.force_n[0],
        shape_m: level.shape.iter().map(|datum| (datum.z_m, datum.deflection_m[0])).collect(),
        shape_sd_m: run.shape_sd_m,
    };
    clock
        .seconds("energy", || {
            energy_modulus(black_box(&run.rig), run.depth_m, black_box(&balance)).expect("a modulus")
        })
        .map(|_| ())
}

/// A hundred frames of 32 samples each.
fn frames(clock: &mut Clock) -> Result<()> {
    let samples: Vec<Sample> = link::samples(SEED);
    let mut line = Vec::new();
    link::encode(&samples, &mut line);
    clock.seconds("decode 3200 samples", || {
        let mut sum = 0_u64;
        link::decode(black_box(&line), |t_us, sample| {
            sum = sum.wrapping_add(t_us).wrapping_add(sample.force_counts[0] as u64);
        });
        sum
    })?;
    clock.seconds("encode 3200 samples", || {
        line.clear();
        link::encode(black_box(&samples), &mut line);
        line.len()
    })?;
    Ok(())
}
