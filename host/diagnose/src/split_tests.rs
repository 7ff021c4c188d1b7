//! Choice of the held-out runs, and judgement of models by them.

use super::super::tests::truth;
use super::super::{Layout, Noises, Options, Start, data_split, diagnose, fit_start, runs_of};
use super::*;
use worlds::{Design, session};

/// An insertion of mean speed cannot confirm an effect of the speed, and an unturned one cannot separate a rolled bevel from a tilted tracker.
#[test]
fn of_insertions_at_different_speeds_a_fast_one_that_was_turned_is_held_out() {
    let session = session(&truth(Vec::new()), &Design::insertions(), 5);
    let held_out = data_split(&session).expect("usable").held_out;
    let insertions: Vec<&str> =
        held_out.iter().map(String::as_str).filter(|id| id.starts_with("insertion")).collect();
    assert_eq!(insertions, ["insertion8turned"]);
}

/// Twelve insertions at three speeds: one of each speed is held out.
#[test]
fn of_many_insertions_each_speed_has_one_that_is_held_out() {
    let mut design = Design::insertions();
    let more: Vec<_> = design.insertion.clone();
    design.insertion.extend(more.into_iter().map(|mut plan| {
        // At another depth the insertions are not repeats.
        (plan.id, plan.depth_mm) = (format!("{}b", plan.id), 95.0);
        plan
    }));
    let held_out = data_split(&session(&truth(Vec::new()), &design, 5)).expect("usable").held_out;
    for speed in ["insertion2", "insertion5", "insertion8"] {
        assert_eq!(held_out.iter().filter(|id| id.starts_with(speed)).count(), 1, "{speed}: {held_out:?}");
    }
}

/// The start of a session without effects, and its judge.
fn start_and_judge() -> (Start, Judge) {
    let session = session(&truth(Vec::new()), &Design::insertions(), 5);
    let (runs, _) = runs_of(&session).expect("runs");
    let (Training { runs, .. }, held_out) = split(runs);
    let noise = Noise::of(&runs, &session.stated_noise());
    let layout = Layout::new(&session.rig, &runs, Vec::new());
    let noises = Noises { session: noise, reference: noise };
    let start = fit_start(&layout, &runs, &noises, &[], &Multiples::new()).expect("a fit");
    let judge = held_out.judge(&start, &noise, &Multiples::new()).expect("a judge");
    (start, judge)
}

/// By the chain rule of normal densities the misfit given the training runs is the joint one less that of the training runs.
#[test]
fn what_was_held_out_is_judged_after_the_training_runs() {
    let (start, judge) = start_and_judge();
    let everyday = judge.imperfections.everyday();
    let parts = judge.after_training(&start.fitted, &everyday).expect("parts");
    let readings: usize = parts.iter().map(|part| part.readings).sum();
    let sum: f64 = parts.iter().map(|part| part.square).sum();
    assert!((0.5..1.5).contains(&(sum / readings as f64)), "{sum} of {readings} readings");
    assert!(judge.is_chance(&start.fitted));

    // With exact parameters the residuals do not change along them.
    let mut exact = start.fitted.clone();
    exact.covariance *= 1e-18;
    let parts = judge.after_training(&exact, &everyday).expect("parts");
    let held_out = posterior::residuals(&exact.layout, &judge.runs, exact.values()).expect("residuals");
    let all_runs = [exact.residuals.clone(), held_out].concat();
    let [joint_misfit, training_misfit] =
        [(&judge.imperfections, &all_runs), (&judge.of_training, &exact.residuals)].map(
            |(patterns, residuals)| posterior::misfit(patterns, &everyday, residuals).expect("a misfit"),
        );
    let (sum, expected) = (parts.iter().map(|part| part.square).sum::<f64>(), joint_misfit - training_misfit);
    assert!((sum / expected - 1.0).abs() < 1e-6, "{sum} {expected}");
    assert_eq!(parts[0].readings, judge.runs[0].run.readings_of_parts()[0].len());
}

/// An error of a parameter within its posterior uncertainty costs little: the held-out runs are expected to correct it.
#[test]
fn what_is_not_determined_costs_no_more_than_it_can_be() {
    let (start, judge) = start_and_judge();
    let square = |fitted: &Fitted| -> f64 {
        let parts = judge.after_training(fitted, &judge.imperfections.everyday()).expect("parts");
        parts.iter().map(|part| part.square).sum()
    };
    let mut values = start.fitted.values().to_vec();
    values[0] += 0.2;
    let Start { runs, patterns, fitted } = &start;
    let mut off = Fitted::new(&fitted.layout, runs, patterns, &values, &fitted.sizes, 0).expect("a fit");
    off.covariance = fitted.covariance.clone();
    let as_certain = square(&off);
    off.covariance[(0, 0)] += 0.2 * 0.2;
    let (as_open, right) = (square(&off), square(&start.fitted));
    assert!(as_certain > right + 10.0, "{as_certain} {right}");
    assert!((as_open - right).abs() < 0.2 * (as_certain - right), "{as_open} {as_certain} {right}");
}

/// A model that needs a larger discrepancy has a wider predictive density, and therefore a larger loss.
#[test]
fn a_larger_discrepancy_costs_density() {
    let (start, judge) = start_and_judge();
    let [fitted_size, larger] = [1.0, 4.0].map(|factor| {
        let mut fitted = start.fitted.clone();
        fitted.sizes.iter_mut().for_each(|size| *size *= factor);
        judge.losses(&fitted).expect("losses").of_density.iter().sum::<f64>()
    });
    assert!(larger > fitted_size + 2.0, "{fitted_size} {larger}");
}

#[test]
fn runs_of_a_kind_are_judged_by_themselves() {
    let (start, judge) = start_and_judge();
    let mut sum = 0.0;
    for (kind, kinds) in [(Kind::Lateral, RunKinds::LATERAL), (Kind::Insertion, RunKinds::INSERTION)] {
        let misfit = judge.held_out_misfit_in(&start.fitted, kinds).expect("held out");
        let of_kind = judge.runs.iter().filter(|run| run.run.kind == kind);
        let readings: usize = of_kind.map(|run| run.run.data.len()).sum();
        let per_reading = misfit / readings as f64;
        assert!((0.5..1.5).contains(&per_reading), "{kind:?}: {per_reading}");
        sum += misfit;
    }
    let joint_misfit = judge.held_out_misfit_in(&start.fitted, RunKinds::BOTH).expect("held out");
    assert!((sum / joint_misfit - 1.0).abs() < 1e-9, "{sum}");
}

/// The rule is what a user reads: it may not state a part as held out that no run has.
#[test]
fn the_rule_states_what_is_held_out_and_nothing_else() {
    let mut single = Design::four_runs();
    single.lateral.truncate(1);
    single.lateral[0].levels_mm = vec![1.0];
    let too_little = data_split(&session(&truth(Vec::new()), &single, 5)).expect("usable");
    assert_eq!(too_little.held_out, Vec::<String>::new());
    assert!(!too_little.rule.contains("is held out"), "{}", too_little.rule);
    let enough = data_split(&session(&truth(Vec::new()), &Design::four_runs(), 5)).expect("usable");
    assert!(!enough.held_out.is_empty() && enough.rule.contains("is held out"), "{}", enough.rule);
}

/// Values and intervals are those of fits to all runs: so is the noise beside them.
#[test]
fn the_reported_noise_is_that_of_all_runs() {
    let mut design = Design::four_runs();
    design.noise.stated = false;
    let session = session(&truth(vec![]), &design, 11);
    let diagnosis = diagnose(&session, &Options::default(), |_| {}).expect("a diagnosis");
    assert!(diagnosis.gap.is_some());
    let (runs, _) = runs_of(&session).expect("runs");
    let noise = Noise::of(&runs, &session.stated_noise());
    assert_eq!(diagnosis.noise["force_n"], noise.force.reading_sd(), "{:?}", diagnosis.noise);
    assert_eq!(diagnosis.noise["shape_mm"], 1e3 * noise.shape.sd(), "{:?}", diagnosis.noise);
}
