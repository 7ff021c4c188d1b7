//! Tests of which sessions count.

use super::*;
use crate::summary::SessionResult;

/// A record of a session without effects.
fn record(number: usize, ln_k_kpa: f64, ln_k_sd: f64) -> Summary {
    let result = SessionResult {
        verdict: "adequate".to_owned(),
        foundation: "springs".to_owned(),
        k_kpa: ln_k_kpa.exp(),
        k_ci95_kpa: [-normal_975(), normal_975()].map(|half| (ln_k_kpa + half * ln_k_sd).exp()),
        ln_k_kpa,
        ln_k_sd,
        ln_modulus_without_effects: [ln_k_kpa, ln_k_sd],
        youngs_modulus_kpa: None,
        tip_load_n: None,
        tip_load_ci95_n: None,
        discrepancy: BTreeMap::new(),
        noise: BTreeMap::new(),
        named: Vec::new(),
        log_evidence: BTreeMap::new(),
        amplitudes: Vec::new(),
        correlation_per_mille: Vec::new(),
    };
    Summary { result: Some(result), ..Summary::empty(format!("s{number}")) }
}

/// A record of a session with a tip load.
fn with_load(number: usize, load_n: f64) -> Summary {
    let mut record = record(number, 2.5, 0.05);
    if let Some(result) = &mut record.result {
        result.tip_load_n = Some(load_n);
        result.tip_load_ci95_n = Some([load_n - 0.02, load_n + 0.02]);
    }
    record
}

#[test]
fn sessions_that_do_not_identify_k_are_listed_and_do_not_count() {
    let measured: Vec<Summary> =
        (0..5).map(|number| record(number, 1.5 + 0.1 * number as f64, 0.05)).collect();
    let vague: Vec<Summary> = (5..9).map(|number| record(number, 2.7, 1.5)).collect();
    let alone = analyse(measured.clone(), &Options::default()).expect("a population");
    let combined = analyse([measured, vague.clone()].concat(), &Options::default()).expect("a population");
    assert_eq!(combined.groups[0].k_kpa, alone.groups[0].k_kpa);
    assert_eq!((combined.sessions.with_modulus, combined.sessions.used, combined.listed.len()), (9, 5, 4));
    // A population of only such sessions: no group, and no error, because what the sessions share can still be
    // analysed.
    let without_k = analyse(vague, &Options::default()).expect("a population");
    assert!(without_k.groups.is_empty() && without_k.listed.len() == 4, "{:?}", without_k.groups);
}

#[test]
fn one_session_does_not_determine_how_much_the_load_differs_between_sessions() {
    let single = analyse(vec![with_load(0, 0.2)], &Options::default()).expect("a population");
    assert_eq!(single.tip_load.iter().map(|tip| tip.between_n).collect::<Vec<_>>(), [None]);
    assert!(!crate::prior::prior_toml(&single).contains("[[tip]]"), "no prior of the next load");
    let records: Vec<Summary> = (0..3).map(|number| with_load(number, 0.1 + 0.1 * number as f64)).collect();
    let three = analyse(records, &Options::default()).expect("a population");
    let between_sd_n = three.tip_load[0].between_n.expect("a spread");
    assert!((0.08..0.12).contains(&between_sd_n), "{between_sd_n}");
}

#[test]
fn a_label_that_no_session_states_is_rejected_with_those_that_are_stated() {
    let options = Options { by: vec!["tisue".to_owned()], ..Options::default() };
    let labelled =
        Summary { tissue: Some("liver".to_owned()), rig: Some("a".to_owned()), ..record(0, 1.5, 0.1) };
    for (records, expected) in [
        (vec![labelled, record(1, 1.5, 0.1)], "one of rig, tissue"),
        (
            vec![record(0, 1.5, 0.1)],
            "a label or covariate, of which `[session]` in session.toml states none here",
        ),
    ] {
        assert_eq!(
            analyse(records, &options).unwrap_err().to_string(),
            format!("--by: \"tisue\" is stated by no session, expected {expected}")
        );
    }
}

#[test]
fn nesting_is_taken_from_the_labels_and_ignored_on_request_with_a_warning() {
    // Five subjects, four sessions each that agree as well as their errors let them.
    let records: Vec<Summary> = (0..20)
        .map(|number| {
            let subject = number / 4;
            let ln_k = 2.0 + 0.1 * subject as f64 + 0.02 * (number % 4) as f64;
            Summary { subject: Some(format!("p{subject}")), ..record(number, ln_k, 0.02) }
        })
        .collect();
    let nested = analyse(records.clone(), &Options::default()).expect("a population");
    let group = &nested.groups[0];
    assert_eq!(
        group.levels.iter().map(|level| level.level.as_str()).collect::<Vec<_>>(),
        ["subject", "session"]
    );
    assert!((3.5..4.5).contains(&group.degrees_of_freedom), "{}", group.degrees_of_freedom);
    assert!(nested.warnings.is_empty(), "{:?}", nested.warnings);
    let options = Options { independent: true, ..Options::default() };
    let flat = analyse(records, &options).expect("a population");
    let [nested_width_kpa, flat_width_kpa] = [&nested, &flat].map(|population| {
        let [low, high] = population.groups[0].k_kpa.ci95;
        high - low
    });
    assert!(nested_width_kpa > 1.8 * flat_width_kpa, "{nested_width_kpa} {flat_width_kpa}");
    assert!(
        flat.warnings.iter().any(|text| text.contains("20 sessions of 5 subjects")),
        "{:?}",
        flat.warnings
    );
}

/// Levels and warnings of twelve subjects with two sessions each; the next site's turn comes after `sessions_at_a_site`.
fn levels_of(sites: usize, sessions_at_a_site: usize) -> (Vec<String>, Vec<String>) {
    let records: Vec<Summary> = (0..24)
        .map(|number| {
            let site = Some(format!("site {}", number / sessions_at_a_site % sites));
            let subject = Some(format!("p{}", number / 2));
            Summary { site, subject, ..record(number, 2.0 + 0.03 * (number * 7 % 11) as f64, 0.02) }
        })
        .collect();
    let population = analyse(records, &Options::default()).expect("a population");
    let names = population.groups[0].levels.iter().map(|level| level.level.clone()).collect();
    (names, population.warnings)
}

#[test]
fn sites_are_a_level_from_three_on_and_where_no_subject_was_at_several() {
    assert_eq!(levels_of(3, 2).0, ["site", "subject", "session"]);
    let (names, warnings) = levels_of(2, 2);
    assert_eq!(names, ["subject", "session"]);
    assert!(warnings[0].contains("two sites"), "{warnings:?}");
    let (names, warnings) = levels_of(3, 1);
    assert_eq!(names, ["subject", "session"]);
    assert!(warnings[0].contains("several sites: 12"), "{warnings:?}");
}
