//! The evidence and what follows for the next insertion against one dense normal distribution of everything measured.

use super::super::Tissue;
use super::super::candidates::{Candidate, Candidates, Fineness};
use super::super::path::{Bin, TipPath};
use super::super::place::depths;
use super::super::scales::{COUNT, Known, ReadingNoise};
use super::*;
use mechanics::{Insertion, Model, Needle, Profile, Rig};
use noise::Noise;

/// Paths with simulated tips, at depths that differ from path to path.
fn paths(noise: &mut Noise) -> Vec<TipPath> {
    (0..3)
        .map(|number| TipPath {
            id: format!("i{number}"),
            planes: 2,
            bins: (0..9)
                .map(|i| {
                    let depth_m = 1e-3 * (7.0 * i as f64 + number as f64);
                    let tip_m = [1.0, 2.0].map(|a| 1e-3 + a * 0.04 * depth_m + 1e-4 * noise.normal());
                    Bin {
                        depth_m,
                        tip_m,
                        rows: 1.0 + (i % 3) as f64,
                        moving: i % 4 == 0,
                        leaving: false,
                        direction_rad: Default::default(),
                    }
                })
                .collect(),
            deepest_m: 0.06,
            done: Insertion {
                depth_m: Vec::new(),
                rotation_rad: Profile::default(),
                guide2_m: Some([
                    Profile::new(vec![[0.0, 0.0], [0.06, 1e-3 * number as f64]]).expect("a profile"),
                    Profile::default(),
                ]),
                ..Insertion::default()
            },
            gaps_m: Vec::new(),
            rows_skipped: 0,
            rows: Vec::new(),
        })
        .collect()
}

#[test]
fn evidence_and_prediction_are_those_of_one_dense_distribution() {
    let mut noise = Noise::new(3);
    let paths = paths(&mut noise);
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.08);
    let model = Model::uniform(rig, 12e3).expect("a model");
    let tissue = Tissue { model, modulus_sd_ln: 0.5, gap_m: 0.02, gap_sd_ln: 0.5, rear: None };
    let candidates = Candidates::new(&tissue, &paths, 0.06).expect("candidates");
    let candidate = Candidate { modulus_ln: 0.1, gap_ln: -0.05, rear_share: [0.0; 2] };
    let responses = candidates.responses(candidate, Fineness::Fine).expect("responses");
    let layout = &candidates.layout;
    assert_eq!(layout.systems(), 2);
    let scales = Scales::from_logarithms(
        &[0.3; COUNT],
        Known {
            noise: ReadingNoise { position_m: 0.1e-3, ..ReadingNoise::default() },
            rear_share: 0.0,
            load_n: 0.2,
        },
    );
    let bases: Vec<Basis> =
        (0..3).map(|path| Basis::new(&candidates, &responses, candidate, path, [0.2, 0.1])).collect();
    let systems: Vec<_> = bases[..2]
        .iter()
        .zip(&paths)
        .map(|(basis, path)| System::of(basis, path, &basis.places(depths(&path.bins)), layout))
        .collect();
    let recordings: Vec<_> = systems.iter().map(Vec::as_slice).collect();
    let evidence = Evidence::new(layout, &recordings, &scales, false).expect("evidence");

    // Covariances from the map itself: own part of each insertion, and the shared one.
    let map = scales.map(layout, false);
    let length = layout.of_plane();
    let mut expected_ln = 0.0;
    for plane in 0..2 {
        let mut rows: Vec<(usize, Vec<f64>, f64, f64)> = Vec::new();
        for (number, path) in paths.iter().enumerate().take(2) {
            for bin in &path.bins {
                let (row, guide2_m) = bases[number].row(plane, Measured::Position, bin.depth_m, false);
                let mut row: Vec<f64> = row.iter().copied().collect();
                map.pull_back_rows(&mut row, 1, length);
                let variance = scales.variance(Measured::Position, bin.rows, bin.moving);
                rows.push((number, row, variance, bin.tip_m[plane] - guide2_m));
            }
        }
        let keys: Vec<_> = rows.iter().map(|(number, row, ..)| (*number, row.clone())).collect();
        let count = rows.len();
        let dense = DMatrix::from_fn(count, count, |i, j| {
            covariance(&keys[i], &keys[j], &map, length) + if i == j { rows[i].2 } else { 0.0 }
        });
        let factor = dense.cholesky().expect("positive");
        let measured = DVector::from_fn(count, |i, _| rows[i].3);
        expected_ln -= 0.5 * measured.dot(&factor.solve(&measured));
        expected_ln -= factor.l_dirty().diagonal().iter().map(|value| value.ln()).sum::<f64>();

        // The tip of the third at 60 mm, before any of it is known.
        let (row, _) = bases[2].row(plane, Measured::Position, 0.06, false);
        let next = &evidence.next(layout, &scales)[plane];
        let mut target: Vec<f64> = row.iter().copied().collect();
        map.pull_back_rows(&mut target, 1, length);
        let target = (2, target);
        let cross_covariance = DVector::from_fn(count, |i, _| covariance(&keys[i], &target, &map, length));
        let solved = factor.solve(&cross_covariance);
        let (mean_m, predicted_m) = (solved.dot(&measured), row.dot(&next.mean));
        assert!((predicted_m - mean_m).abs() < 1e-8, "{predicted_m} is not {mean_m}");
        let variance = covariance(&target, &target, &map, length) - cross_covariance.dot(&solved);
        let found_variance = row.dot(&(&next.covariance * &row));
        assert!((found_variance / variance - 1.0).abs() < 1e-4, "{found_variance} is not {variance}");
    }
    assert!((evidence.ln - expected_ln).abs() < 1e-4, "{} is not {expected_ln}", evidence.ln);
}

fn covariance(a: &(usize, Vec<f64>), b: &(usize, Vec<f64>), map: &Map, length: usize) -> f64 {
    let products = a.1.iter().zip(&b.1).enumerate();
    products
        .map(|(i, (x, y))| x * y * (squared_ratio(i, map, length) + if a.0 == b.0 { 1.0 } else { 0.0 }))
        .sum::<f64>()
}

fn squared_ratio(i: usize, map: &Map, length: usize) -> f64 {
    map.ratio(i, length).powi(2)
}
