//! The evidence and the belief against one dense normal distribution of everything measured.

use super::super::belief::Belief;
use super::super::{Tissue, path::Bin};
use super::*;
use crate::model::{Insertion, Model, Needle, Profile, Rig};
use crate::testing::Noise;
use nalgebra::DVector;

/// Paths with made-up tips, at depths that differ from path to path.
fn paths(noise: &mut Noise) -> Vec<TipPath> {
    let path = |number: usize| TipPath {
        id: format!("i{number}"),
        planes: 2,
        bins: (0..9)
            .map(|i| {
                let depth_m = 1e-3 * (7.0 * i as f64 + number as f64);
                let tip_m = [1.0, 2.0].map(|a| 1e-3 + a * 0.04 * depth_m + 1e-4 * noise.normal());
                Bin {
                    depth_m,
                    tip_m,
                    direction_rad: [None; 2],
                    rows: 1.0 + (i % 3) as f64,
                    moving: i % 4 == 0,
                    leaving: false,
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
        rows_left_out: 0,
        rows: Vec::new(),
    };
    (0..3).map(path).collect()
}

#[test]
fn evidence_and_belief_are_those_of_one_dense_distribution() {
    let mut noise = Noise::new(3);
    let paths = paths(&mut noise);
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.08);
    let model = Model::uniform(rig, 12e3).expect("a model");
    let tissue = Tissue { model, modulus_sd_ln: 0.0, gap_m: 0.02, gap_sd_ln: 0.0 };
    let candidates = Candidates::new(&tissue, &paths, 0.06).expect("candidates");
    let layout = &candidates.layout;
    let scales = Scales {
        offset_m: [2e-3, 0.2e-3],
        entry_angle_rad: [0.03, 0.01],
        load_n: [0.3, 0.05],
        wander_n: [0.08, 0.04],
        memory_m: 0.07,
        irregularity_m: 0.05e-3,
        moving_m: 0.07e-3,
        reading_m: 0.1e-3,
    };
    let bases: Vec<&Basis> = candidates.bases[0].iter().collect();
    let designs: Vec<Design> =
        bases[..2].iter().zip(&paths).map(|(basis, path)| Design::new(basis, path, layout)).collect();
    let Evidence { ln, next } = Evidence::new(layout, &designs, &scales);

    // Everything measured in the first two, and the tip of the third at 60 mm after its own first four bins.
    let (map, ratios) = (scales.map(layout), scales.shared_ratios(layout));
    let mut all: Vec<(usize, DVector<f64>, f64, [f64; 2])> = Vec::new();
    for (number, path) in paths.iter().enumerate() {
        for bin in path.bins.iter().take(if number == 2 { 4 } else { 9 }) {
            let row = map.tr_mul(&bases[number].row(0, bin.depth_m, false));
            let rest =
                [0, 1].map(|plane| bin.tip_m[plane] - bases[number].guide2_m(plane, bin.depth_m, false));
            all.push((number, row, scales.variance_m2(bin.rows, bin.moving), rest));
        }
    }
    let covariance = |a: &(usize, DVector<f64>), b: &(usize, DVector<f64>)| {
        let shared: f64 = (0..ratios.len()).map(|i| a.1[i] * ratios[i] * ratios[i] * b.1[i]).sum();
        shared + if a.0 == b.0 { a.1.dot(&b.1) } else { 0.0 }
    };
    let rows: Vec<(usize, DVector<f64>)> =
        all.iter().map(|(number, row, ..)| (*number, row.clone())).collect();
    let dense = |count: usize| {
        let square = DMatrix::from_fn(count, count, |i, j| {
            covariance(&rows[i], &rows[j]) + if i == j { all[i].2 } else { 0.0 }
        });
        Cholesky::new(square).expect("positive")
    };
    let measured = |count: usize, plane: usize| DVector::from_fn(count, |i, _| all[i].3[plane]);
    let earlier = dense(18);
    let expected: f64 = (0..2)
        .map(|plane| {
            let y = measured(18, plane);
            -0.5 * y.dot(&earlier.solve(&y)) - half_ln_determinant(&earlier)
        })
        .sum();
    assert!((ln - expected).abs() < 1e-5, "{ln} is not {expected}");

    let learned = Learned {
        scales: vec![scales],
        parts: vec![Part { candidate: 0, scales: 0, ln_weight: 0.0, normal: next.mapped(&map) }],
    };
    let mut belief = Belief::new(&candidates, 2, &learned);
    paths[2].bins[..4].iter().for_each(|bin| belief.update(bin));
    let target = (2, map.tr_mul(&bases[2].row(0, 0.06, false)));
    let across = DVector::from_fn(rows.len(), |i, _| covariance(&rows[i], &target));
    let everything = dense(rows.len());
    let solved = everything.solve(&across);
    for (plane, found) in belief.tip_m(&[0.06]).swap_remove(0).into_iter().enumerate() {
        let mean_m = solved.dot(&measured(rows.len(), plane)) + bases[2].guide2_m(plane, 0.06, false);
        let variance = covariance(&target, &target) - across.dot(&solved) + scales.irregularity_m.powi(2);
        assert!((found.mean - mean_m).abs() < 1e-9, "{} is not {mean_m}", found.mean);
        assert!((found.sd / variance.sqrt() - 1.0).abs() < 1e-5, "{} is not {}", found.sd, variance.sqrt());
    }
}
