//! The section on insertions: tip load, predicted path against what was measured, errors.

use super::page::{Block, FIGURES, Fact, Outcome, Section, count, estimate, number, value, words};
use crate::figures;
use inference::predict::{InsertionResult, Prediction};

/// Facts for the summary.
pub(super) fn facts(found: &Prediction) -> Vec<Fact> {
    let mut load = Vec::new();
    for (plane, loads_n) in [
        ("vertical", loads_n(|one| one.tip_force_n, &found.insertions)),
        ("horizontal", loads_n(|one| one.tip_force_x_n, &found.insertions)),
    ] {
        load.extend(over_insertions(&loads_n).map(|text| format!("{plane} {text}")));
    }
    let mut facts = Vec::new();
    if !load.is_empty() {
        facts.push(Fact::new("Tip load", load.join("; ")));
    }
    let until_mm = found.insertions.first().map_or(0.0, |one| one.identified_until_mm);
    facts.push(Fact::new(
        "Prediction error",
        match (mean(|one| one.mae_mm, &found.insertions), mean(|one| one.last_error_mm, &found.insertions)) {
            (Some(mae_mm), Some(last_mm)) => format!(
                "{mae_mm:.2} mm on average beyond {until_mm:.0} mm, {last_mm:.2} mm at the last depth (mean over the insertions)"
            ),
            _ => format!("not known: nothing was measured beyond {until_mm:.0} mm"),
        },
    ));
    facts
}

fn mean(of: fn(&InsertionResult) -> Option<f64>, insertions: &[InsertionResult]) -> Option<f64> {
    let errors_mm: Vec<f64> = insertions.iter().filter_map(of).collect();
    (!errors_mm.is_empty()).then(|| errors_mm.iter().sum::<f64>() / errors_mm.len() as f64)
}

fn loads_n(of: fn(&InsertionResult) -> Option<f64>, insertions: &[InsertionResult]) -> Vec<f64> {
    insertions.iter().filter_map(of).collect()
}

/// One load, or the mean and range of several.
fn over_insertions(loads_n: &[f64]) -> Option<String> {
    let mean_n = loads_n.iter().sum::<f64>() / loads_n.len() as f64;
    let least_n = loads_n.iter().copied().fold(f64::INFINITY, f64::min);
    let most_n = loads_n.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    match loads_n.len() {
        0 => None,
        1 => Some(format!("{mean_n:+.3} N")),
        several => Some(format!(
            "{mean_n:+.3} N, mean of {}; least {least_n:+.3} N, greatest {most_n:+.3} N",
            count(several, "insertion")
        )),
    }
}

/// Warnings of all insertions, each message once.
pub(super) fn warnings(found: &Prediction) -> Vec<String> {
    found.messages()
}

/// The section.
pub(super) fn section(outcome: &Outcome<Prediction>) -> Section {
    outcome.section("insertions", "Insertions", |found| {
        let good: Vec<_> = found.insertions.iter().filter(|one| one.error.is_none()).collect();
        let until_mm = good.first().map_or(0.0, |one| one.identified_until_mm);
        let mut blocks = vec![
            Block::Text(format!(
                "The tip was measured to {until_mm:.0} mm and is predicted beyond, with the band that holds 95 % of the readings. \
                 Tip loads are those at that depth, before any rotation."
            )),
            loads(&good),
            errors(&good),
        ];
        blocks.extend(methods(&good));
        blocks.extend(learned(&good));
        blocks.push(Block::Notes(warnings(found)));
        for one in good.iter().take(FIGURES) {
            blocks.push(Block::figure(
                format!(
                    "Insertion {}: tip measured (dots) and predicted (line, 95 % band) beyond the grey line; below, the tip load",
                    one.id
                ),
                figures::insertion(one),
            ));
        }
        if good.len() > FIGURES {
            blocks.push(Block::Text(format!(
                "Figures of {} more are not shown; guide predict --plots draws them.",
                count(good.len() - FIGURES, "insertion")
            )));
        }
        blocks
    })
}

fn loads(good: &[&InsertionResult]) -> Block {
    let columns = [
        words("insertion"),
        number("vertical, N"),
        number("sd, N"),
        number("horizontal, N"),
        number("sd, N"),
    ];
    Block::table(
        "Tip load",
        columns,
        good.iter()
            .map(|one| {
                vec![
                    one.id.clone(),
                    value(one.tip_force_n, 3),
                    value(one.tip_force_sd_n, 3),
                    value(one.tip_force_x_n, 3),
                    value(one.tip_force_x_sd_n, 3),
                ]
            })
            .collect(),
    )
}

/// Predicted and measured tip at the last depth, plane by plane, and the distance over all depths.
fn errors(good: &[&InsertionResult]) -> Block {
    let mut rows = Vec::new();
    for one in good {
        let last = one.depth_mm.len().saturating_sub(1);
        let checked_index = one.last_measured_mm.map_or(last, |mm| mm.round() as usize);
        let planes = [
            (
                "vertical",
                Some(&one.tip_y_mm),
                Some(&one.lo95_y_mm),
                Some(&one.hi95_y_mm),
                Some(&one.measured_y_mm),
            ),
            (
                "horizontal",
                one.tip_x_mm.as_ref(),
                one.lo95_x_mm.as_ref(),
                one.hi95_x_mm.as_ref(),
                one.measured_x_mm.as_ref(),
            ),
        ];
        for (plane, tip_mm, low_mm, high_mm, measured_mm) in planes {
            let Some(tip_mm) = value_at(tip_mm, checked_index) else { continue };
            let measured_mm = measured_mm.and_then(|list| list.get(checked_index)).copied().flatten();
            rows.push(vec![
                one.id.clone(),
                plane.to_owned(),
                checked_index.to_string(),
                estimate(
                    Some(tip_mm),
                    value_at(low_mm, checked_index)
                        .zip(value_at(high_mm, checked_index))
                        .map(|(low, high)| [low, high]),
                    2,
                ),
                value(measured_mm, 2),
                measured_mm.map_or("-".to_owned(), |measured_mm| format!("{:+.2}", tip_mm - measured_mm)),
                value(one.mae_mm, 2),
            ]);
        }
    }
    let columns = [
        words("insertion"),
        words("plane"),
        number("at depth, mm"),
        number("predicted, mm (95 %)"),
        number("measured, mm"),
        number("error, mm"),
        number("mean distance, mm"),
    ];
    Block::table(
        "Predicted and measured tip; the mean distance is over all depths beyond the readings used, both planes",
        columns,
        rows,
    )
}

fn value_at(list: Option<&Vec<f64>>, checked_index: usize) -> Option<f64> {
    list.and_then(|list| list.get(checked_index)).copied()
}

/// Predictions of other methods from the same data.
fn methods(good: &[&InsertionResult]) -> Option<Block> {
    let names: Vec<&str> = good.first()?.compare.iter().map(|other| other.method).collect();
    let of_own =
        |of: fn(&InsertionResult) -> Option<f64>| mean_text(good.iter().map(|one| of(one)).collect());
    let mut rows =
        vec![vec!["mechanics".to_owned(), of_own(|one| one.mae_mm), of_own(|one| one.last_error_mm)]];
    for name in names {
        let found = || good.iter().map(|one| one.compare.iter().find(|other| other.method == name));
        let mae_mm = mean_text(found().map(|other| other?.mae_mm).collect());
        let last_mm = mean_text(found().map(|other| other?.last_error_mm).collect());
        rows.push(vec![name.to_owned(), mae_mm, last_mm]);
    }
    let columns =
        [words("method"), number("mean beyond the readings used, mm"), number("at the last depth, mm")];
    Some(Block::table(
        "Distance from the measured tip by several methods, mean over the insertions",
        columns,
        rows,
    ))
}

fn mean_text(errors: Vec<Option<f64>>) -> String {
    let known_errors: Vec<f64> = errors.into_iter().flatten().collect();
    value((!known_errors.is_empty()).then(|| known_errors.iter().sum::<f64>() / known_errors.len() as f64), 2)
}

fn learned(good: &[&InsertionResult]) -> Option<Block> {
    let has_rear = good.iter().any(|one| rears(one).is_some());
    let rows: Vec<_> = good
        .iter()
        .filter_map(|one| {
            let learned = one.learned.as_ref()?;
            let source_ids = if learned.from.is_empty() { "-".to_owned() } else { learned.from.join(", ") };
            let mut row = vec![one.id.clone(), source_ids, learned.modulus_text(), learned.gap_text()];
            row.extend(has_rear.then(|| rears(one).unwrap_or_else(|| "-".to_owned())));
            Some(row)
        })
        .collect();
    let mut columns =
        vec![words("insertion"), words("learned from"), number("K (95 %)"), number("effective gap (95 %)")];
    columns.extend(has_rear.then(|| number("rotation stiffness of the rear, y and x (95 %)")));
    (!rows.is_empty()).then(|| {
        let title = "Modulus and gap of each insertion with 95 % intervals, from the others and what is known of its own path; \
                     the gap reaches from guide 2 to where the tissue begins to hold the needle";
        Block::table(title, columns, rows)
    })
}

fn rears(one: &InsertionResult) -> Option<String> {
    one.learned.as_ref()?.rear_text()
}
