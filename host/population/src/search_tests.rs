//! Simulated records: shared effects are named, with their dates, and nothing else is.

use super::*;
use crate::Records;
use crate::patterns::LABELS;
use crate::summary::{Amplitude, NamedEffect, SessionResult, Summary};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::collections::BTreeMap as Map;

/// Effects of the simulated records: id, prior sd, information of one session, change of ln K per unit.
const EFFECTS: [(&str, f64, f64, f64); 4] = [
    ("sensor.force_gain", 0.06, 2500.0, 0.4),
    ("rig.backlash", 0.1, 900.0, -0.2),
    ("tissue.shear", 5.0, 1.0, 0.01),
    ("sensor.delay", 0.3, 400.0, 0.0),
];
/// Correlation of the first two.
const CORRELATION: f64 = 0.6;

/// Information on two effects together.
fn information(i: usize, j: usize) -> f64 {
    let correlation = match (i, j) {
        _ if i == j => 1.0,
        (0, 1) | (1, 0) => CORRELATION,
        _ => 0.0,
    };
    correlation * (EFFECTS[i].2 * EFFECTS[j].2).sqrt()
}

/// A record with true values of the effects.
fn record(number: usize, rig: &str, day: usize, truth: [f64; 4], random: &mut ChaCha8Rng) -> Summary {
    let normal: [f64; 5] = std::array::from_fn(|_| StandardNormal.sample(random));
    let second = CORRELATION * normal[0] + (1.0 - CORRELATION * CORRELATION).sqrt() * normal[1];
    let noise = [normal[0], second, normal[2], normal[3]];
    let ln_k = 2.5 + 0.1 * normal[4] + (0..4).map(|i| EFFECTS[i].3 * truth[i]).sum::<f64>();
    let result = SessionResult {
        verdict: "adequate".to_owned(),
        foundation: "springs".to_owned(),
        k_kpa: ln_k.exp(),
        k_ci95_kpa: [0.9 * ln_k.exp(), 1.1 * ln_k.exp()],
        ln_k_kpa: ln_k,
        ln_k_sd: 0.05,
        ln_modulus_without_effects: [ln_k, 0.05],
        youngs_modulus_kpa: None,
        tip_load_n: None,
        tip_load_ci95_n: None,
        discrepancy: Map::new(),
        noise: Map::new(),
        named: Vec::new(),
        log_evidence: Map::new(),
        amplitudes: (0..4)
            .map(|i| Amplitude {
                effect: EFFECTS[i].0.to_owned(),
                parameter: "size".to_owned(),
                at: None,
                scale: "linear".to_owned(),
                neutral: 0.0,
                two_sided: true,
                prior_sd: EFFECTS[i].1,
                score: (0..4).map(|j| information(i, j) * truth[j]).sum::<f64>()
                    + noise[i] * EFFECTS[i].2.sqrt(),
                information: EFFECTS[i].2,
                ln_k_slope: EFFECTS[i].3,
            })
            .collect(),
        correlation_per_mille: vec![600, 0, 0, 0, 0, 0],
    };
    let date = date_of(2_461_000.0 + day as f64);
    Summary {
        rig: Some(rig.to_owned()),
        date,
        result: Some(result),
        ..Summary::empty(format!("s{number:04}"))
    }
}

fn found(records: &[Summary]) -> (Vec<Found>, Likelihoods) {
    let (_, mut data) = Records::from(records.to_vec()).likelihoods();
    let group_labels = Places {
        labels: LABELS.map(|name| records.iter().map(|record| record.label(name)).collect()),
        days: records.iter().map(Summary::day).collect(),
    };
    let (effects, _) = search(&mut data, &group_labels);
    (effects, data)
}

/// Records of three rigs over 60 days; the first has a gain, the second one from day 30 on.
fn three_rigs(sessions: usize, gain: f64, step: f64, seed: u64) -> Vec<Summary> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..sessions)
        .map(|number| {
            let (rig, day) = (number % 3, number * 60 / sessions);
            let gain = match rig {
                0 => gain,
                1 if day >= 30 => step,
                _ => 0.0,
            };
            record(number, ["a", "b", "c"][rig], day, [gain, 0.0, 0.0, 0.0], &mut random)
        })
        .collect()
}

#[test]
fn a_gain_that_no_session_can_name_is_named_for_its_rig_and_a_step_with_its_date() {
    // One session's standard deviation is 0.02 alone: 0.03 is 1.5 of them.
    let (effects, _) = found(&three_rigs(120, 0.03, 0.05, 1));
    assert_eq!(effects.len(), 2, "{:?}", effects.iter().map(|one| &one.result).collect::<Vec<_>>());
    let [shared, step] = ["a", "b"]
        .map(|rig| effects.iter().map(|one| &one.result).find(|result| result.group == rig).expect("named"));
    assert_eq!(
        (shared.effect.as_str(), shared.kind, shared.sessions),
        ("sensor.force_gain", SharedKind::Shared, 40)
    );
    let [low, high] = shared.parameters[0].estimate.ci95;
    assert!((low..=high).contains(&0.03) && high - low < 0.02, "{low} to {high}");
    assert_eq!((step.effect.as_str(), step.kind), ("sensor.force_gain", SharedKind::Step));
    let [earliest, latest] = step.began_ci95.clone().expect("dates");
    let began = date_of(2_461_030.0).expect("a date");
    assert!(earliest <= began && began <= latest, "{earliest} to {latest}, expected {began}");
    assert!(shared.held_out.misfit_change_chi2 < 0.0 && step.held_out.misfit_change_chi2 < 0.0);
}

#[test]
fn nothing_is_named_where_nothing_is_shared() {
    let named: usize = (0..40).map(|seed| found(&three_rigs(60, 0.0, 0.0, 100 + seed)).0.len()).sum();
    assert!(named <= 2, "{named} of 40");
}

#[test]
fn what_was_found_is_taken_off_the_scores_of_others_and_moves_k_back() {
    let records = three_rigs(120, 0.04, 0.0, 3);
    let (effects, data) = found(&records);
    let first_effect = effects.first().expect("named");
    let (shift, variance) = first_effect.ln_k_shift(&data, first_effect.members[0].0, 1.0).expect("a shift");
    assert!(
        (shift - 0.4 * 0.04).abs() < 3.0 * variance.sqrt() + 1e-9 && variance > 0.0,
        "{shift} +- {}",
        variance.sqrt()
    );
    // Backlash, whose scores are correlated, has nothing left in this rig.
    let backlash = &data.hypotheses[1];
    let residual_test = sum(&data, backlash, first_effect.members.iter().copied()).test(backlash);
    assert!(residual_test.p > 1e-3, "p {}", residual_test.p);
}

#[test]
fn k_of_every_session_of_the_rig_is_corrected_whatever_the_order_of_names_and_dates() {
    let forth = three_rigs(120, 0.1, 0.0, 3);
    let mut reversed = forth.clone();
    reversed
        .iter_mut()
        .enumerate()
        .for_each(|(number, record)| record.session = format!("s{:04}", 9999 - number));
    for records in [forth, reversed] {
        let population = crate::analysis::analyse(records, &crate::Options::default()).expect("a population");
        let corrected =
            population.rows.iter().filter(|row| (row.k_recorded_kpa / row.k_kpa.value).ln().abs() > 1e-9);
        let rigs: Vec<_> = corrected.map(|row| row.rig.as_deref().expect("a rig")).collect();
        assert_eq!(rigs, ["a"; 40]);
    }
}

#[test]
fn a_session_that_names_an_effect_by_itself_adds_no_evidence_for_others_through_it() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut single_record = record(0, "a", 0, [0.3, 0.0, 0.0, 0.0], &mut random);
    if let Some(result) = &mut single_record.result {
        let parameters = Map::new();
        let class = vec!["sensor.force_gain".to_owned()];
        result.named =
            vec![NamedEffect { id: "sensor.force_gain".to_owned(), parameters, log_evidence: 50.0, class }];
    }
    let (_, data) = Records::from(vec![single_record]).likelihoods();
    let likelihood = data.sessions[0].as_ref().expect("a likelihood");
    let [gain_size, backlash_size] = [0, 1].map(|number: usize| {
        let (b, g) = likelihood.block(&data.hypotheses[number]);
        b[0] / g[(0, 0)].sqrt()
    });
    assert!(gain_size > 10.0, "its own score stays: {gain_size}");
    assert!(backlash_size.abs() < 3.5, "that of backlash is left without it: {backlash_size}");
}

fn leave_unexplained(record: &mut Summary) {
    record.result.iter_mut().for_each(|result| "unexplained".clone_into(&mut result.verdict));
}

#[test]
fn a_gain_of_a_rig_whose_sessions_are_mostly_unexplained_is_named_and_single_unexplained_sessions_take_no_part()
 {
    let mut records = three_rigs(30, 0.08, 0.0, 3);
    records
        .iter_mut()
        .filter(|record| record.rig.as_deref() == Some("a"))
        .take(7)
        .for_each(leave_unexplained);
    let (named, _) = found(&records);
    let groups: Vec<_> = named.iter().map(|one| (one.result.group.as_str(), one.result.sessions)).collect();
    assert_eq!(groups, [("a", 10)]);
    let mut records = three_rigs(30, 0.0, 0.0, 4);
    let mut random = ChaCha8Rng::seed_from_u64(6);
    for number in [0, 3, 6] {
        records[number] = record(number, "a", number, [0.5, 0.0, 0.0, 0.0], &mut random);
        leave_unexplained(&mut records[number]);
    }
    assert!(found(&records).0.is_empty());
}
