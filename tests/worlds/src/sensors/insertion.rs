//! Readings of the tip in an insertion.

use super::super::MM;
use super::super::chain::{STEP_M, node_at};
use super::super::design::{InsertionPlan, NoisePlan};
use super::super::flaws::Flaws;
use super::super::insertion::{acting, commanded_m, tip_path};
use super::super::world::World;
use super::{Part, Random, Spread, add};
use formats::session::InsertionRun;
use std::f64::consts::PI;

/// An insertion as recorded.
pub(in super::super) fn insertion_run(
    world: &World,
    flaws: &Flaws<'_>,
    plan: &InsertionPlan,
    noise: &NoisePlan,
    seed: u64,
    run: u64,
) -> InsertionRun {
    let turn = plan.turn_at_mm.map(|turn_mm| node_at(MM * turn_mm));
    let rows: Vec<(usize, usize)> = (0..=node_at(MM * plan.depth_mm))
        .flat_map(|step| {
            (0..=usize::from(moves_guide2(step, &plan.guide2_steps))).map(move |side| (step, side))
        })
        .collect();
    let depth_m: Vec<f64> = rows.iter().map(|(step, _)| *step as f64 * STEP_M).collect();
    let mut random = Random::new(seed, Part::Tip, run);
    let spread = Spread::new(MM * noise.tip_mm, 0.0, STEP_M, 0.0, noise.outlier_share);
    let [tip_y_m, tip_x_m] = [0, 1].map(|plane| {
        let path = tip_path(world, plane, MM * plan.depth_mm, |step| acting(world, plan, step)[plane]);
        let straight = world.entry_angle_rad[plane];
        let positions = rows.iter().zip(&depth_m);
        let mut tip_m: Vec<f64> =
            positions.map(|((step, side), depth_m)| path[*step][*side] + straight * depth_m).collect();
        flaws.tip(plane as u64, &depth_m, &mut tip_m);
        add(&mut tip_m, random.errors(&spread, rows.len()), 0.0);
        tip_m
    });
    InsertionRun {
        id: plan.id.clone(),
        path: format!("{}.csv", plan.id).into(),
        tip_y_m,
        tip_x_m: Some(tip_x_m),
        time_s: Some(depth_m.iter().map(|depth_m| depth_m / (MM * plan.speed_mm_per_s)).collect()),
        rotation_rad: Some(
            rows.iter().map(|(step, _)| if turn.is_some_and(|at| *step > at) { PI } else { 0.0 }).collect(),
        ),
        guide2_y_m: guide2_readings(0, &rows, &plan.guide2_steps),
        guide2_x_m: guide2_readings(1, &rows, &plan.guide2_steps),
        base_force_y_n: None,
        tip_direction_y_rad: None,
        tip_direction_x_rad: None,
        depth_m,
    }
}

fn guide2_readings(
    plane: usize,
    rows: &[(usize, usize)],
    guide2_steps: &[crate::GuideStep],
) -> Option<Vec<f64>> {
    let commanded = rows.iter().map(|(step, side)| commanded_m(guide2_steps, *step)[*side][plane]);
    (!guide2_steps.is_empty()).then(|| commanded.collect())
}

/// Every step of guide 2 has a row on arriving and one on leaving.
fn moves_guide2(step: usize, guide2_steps: &[crate::GuideStep]) -> bool {
    guide2_steps.iter().any(|one| node_at(MM * one.depth_mm) == step)
}
