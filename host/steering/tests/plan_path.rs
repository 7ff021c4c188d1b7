//! A plan without a plant: the same as what a run states before its first push.

use steering::{Event, Options, Outcome, SteerError, plan_path, steer};
use worlds::steering::{Kind, reachable_target, target_by_rotations, world};

const DEPTH_MM: f64 = 100.0;

#[test]
fn it_states_what_a_run_states_before_the_first_push() {
    let mut plant = world(Kind::Plain, 4411, 0);
    let options = Options::new(reachable_target(&plant, DEPTH_MM, 4411, 0).expect("a target"));
    let plan = plan_path(&plant.stated, &options).expect("planned");
    let mut forecast = None;
    let run = steer(&mut plant, &options, &mut |event| {
        if let Event::Forecast { reachable_mm, within, .. } = event {
            forecast = Some((reachable_mm.clone(), within.clone()));
        }
    })
    .expect("steered");
    assert!(plan.is_reachable && plan.nearest_mm.is_none());
    assert_eq!((plan.reachable_mm.clone(), plan.within.clone()), forecast.expect("stated"));
    assert_eq!((plan.reachable_mm, plan.within), (run.reachable_mm, run.within_before));
    // It leads to the target by its own account, and starts at the first stop.
    let last = plan.plan.path.last().expect("a path");
    assert_eq!(last.depth_mm, DEPTH_MM);
    let miss_mm =
        (0..2).map(|i| (plan.plan.expected_tip_mm[i] - options.target_mm[i]).abs()).fold(0.0, f64::max);
    let unsteered_mm =
        (0..2).map(|i| (plan.unsteered_tip_mm[i] - options.target_mm[i]).abs()).fold(0.0, f64::max);
    assert!(miss_mm < 0.3 * unsteered_mm.max(1.0), "{miss_mm} of {unsteered_mm} mm");
    assert_eq!(plan.plan.plan_depth_mm.first(), Some(&5.0));
}

#[test]
fn what_the_tip_is_uncertain_by_adds_up_to_the_whole() {
    let plant = world(Kind::Plain, 4411, 1);
    let options = Options { cut_angle: false, ..Options::new([1.0, 1.0, DEPTH_MM]) };
    let spread = plan_path(&plant.stated, &options).expect("planned").spread_mm;
    let causes = spread.causes();
    let sum = causes.iter().map(|(_, sd)| sd * sd).sum::<f64>().sqrt();
    assert!((sum / spread.all - 1.0).abs() < 0.02, "{sum} {spread:?}");
    assert!(causes.windows(2).all(|pair| pair[0].1 >= pair[1].1), "the largest first");
    // 10 mrad over 100 mm, give or take what the tissue makes of it.
    assert!((0.7..1.3).contains(&spread.slope), "{spread:?}");
}

#[test]
fn a_target_out_of_reach_has_the_nearest_point_and_is_refused_by_a_run() {
    let mut plant = world(Kind::Plain, 4411, 2);
    let options = Options::new([80.0, 0.0, DEPTH_MM]);
    let plan = plan_path(&plant.stated, &options).expect("planned");
    let run = steer(&mut plant, &options, &mut |_| {}).expect("refused");
    let Outcome::Refused { nearest_mm, distance_mm, .. } = run.outcome else { panic!("{:?}", run.outcome) };
    assert_eq!((plan.nearest_mm, plan.beyond_reach_mm), (Some(nearest_mm), Some(distance_mm)));
    assert!(!plan.is_reachable && plan.within.is_empty() && distance_mm > 20.0);
}

#[test]
fn rotations_are_planned_without_a_probability() {
    let mut plant = world(Kind::Plain, 4411, 3);
    plant.stated.limits.guide_travel_mm = 0.0;
    let target_mm = target_by_rotations(&plant, DEPTH_MM, 4411, 3).expect("a target");
    let options = Options { rotations: 2, ..Options::new(target_mm) };
    let plan = plan_path(&plant.stated, &options).expect("planned");
    assert!(!plan.plan.rotations.is_empty() && plan.within.is_empty() && plan.reachable_mm.is_empty());
    // A stop that is new for a rotation has no band of its own, and leaves those of the others where they are.
    let unturned = Options { rotations: 0, ..options.clone() };
    let still = plan_path(&plant.stated, &unturned).expect("planned");
    assert_eq!(plan.plan.path.len(), still.plan.path.len());
    for (turned, still) in plan.plan.path.iter().zip(&still.plan.path) {
        assert_eq!((turned.depth_mm, turned.sd_mm), (still.depth_mm, still.sd_mm));
    }
    plant.stated.rig.can_rotate = false;
    assert_eq!(plan_path(&plant.stated, &options), Err(SteerError::CannotRotate));
}
