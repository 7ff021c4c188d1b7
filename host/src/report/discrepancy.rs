//! The section on what the model lacks: where it disagrees, what is missing, what adding it is worth, what to measure next.

use super::page::{Block, Fact, Outcome, Section, estimate, number, thinned, value, words};
use crate::figures;
use inference::diagnose::display::{channel, quantity, unit};
use inference::diagnose::{Channel, Diagnosis, HeldOutMisfit, ModulusStatus, Verdict};
use mechanics::effects::effect;

/// Residuals drawn of one channel.
const POINTS: usize = 300;
/// Effects of the ranking in the table.
const RANKS: usize = 12;

/// Facts for the summary.
pub(super) fn facts(found: &Diagnosis) -> Vec<Fact> {
    let mut verdict = found.verdict.explained().to_owned();
    if !found.effects.is_empty() {
        let named = found
            .effects
            .iter()
            .map(|effect| [vec![effect.id.clone()], effect.competing_effects()].concat().join(" or "));
        verdict = format!("{verdict}: {}", named.collect::<Vec<_>>().join("; "));
    }
    if let Some(gap) =
        found.gap.as_ref().filter(|_| !found.effects.is_empty() || !found.moved_since.is_empty())
    {
        verdict = format!("{verdict}; on held-out runs {}", removed(gap));
    }
    vec![Fact::new("Diagnosis", verdict)]
}

/// K with what is missing, as the first of the facts; `None` where nothing is named.
pub(super) fn headline(found: &Diagnosis) -> Option<Fact> {
    let names: Vec<&str> = found.effects.iter().map(|effect| effect.id.as_str()).collect();
    matches!(found.verdict, Verdict::Named | Verdict::Ambiguous).then(|| {
        Fact::new(
            format!("Foundation modulus K with {} (95 %)", names.join(" and ")),
            format!("{}; guide identify --model takes it into the other results", modulus(found)),
        )
    })
}

/// Effects that the results of the other sections lack; `None` if none is missing.
pub(super) fn warning(found: &Diagnosis) -> Option<String> {
    let names: Vec<&str> = found.effects.iter().map(|effect| effect.id.as_str()).collect();
    match found.verdict {
        Verdict::Adequate => None,
        Verdict::Unexplained => Some(
            "model and measurement disagree, and no effect explains it: the intervals of this page but the diagnosis's do not include what is missing"
                .to_owned(),
        ),
        Verdict::Named | Verdict::Ambiguous => Some(format!(
            "the model lacks {}: with it K is {}; the other results are without it (--model takes it in)",
            names.join(" and "),
            modulus(found)
        )),
    }
}

/// K with its interval and unit, where the runs identify it.
fn modulus(found: &Diagnosis) -> String {
    match found.k_status {
        ModulusStatus::Identified => {
            format!("{} kPa", estimate(Some(found.k_kpa), Some(found.k_ci95_kpa), 2))
        }
        status @ ModulusStatus::NotIdentified => status.modulus_text(found.k_kpa, found.k_ci95_kpa),
    }
}

/// Benefit of adding the effects.
fn removed(gap: &HeldOutMisfit) -> String {
    let removed_percent =
        gap.removed.zip(gap.removed_ci95).map(|(share, ends)| (share, ends.map(|end| 100.0 * end)));
    match removed_percent {
        Some((share, ends)) => {
            format!("{} % of the removable misfit removed", estimate(Some(100.0 * share), Some(ends), 0))
        }
        None => "the misfit is not above chance".to_owned(),
    }
}

/// The section.
pub(super) fn section(outcome: &Outcome<Diagnosis>) -> Section {
    outcome.section("discrepancy", "What the model lacks", |found| {
        let mut blocks = vec![Block::Text(summary(found)), Block::Notes(remarks(found))];
        blocks.extend(regions(found));
        blocks.extend(effects(found));
        if let Some(of_gap) = &found.gap {
            blocks.extend(gap(of_gap));
        }
        blocks.extend(ranking(found));
        blocks.extend(predictive(found));
        blocks
    })
}

/// Forces beside what the final model predicts of them.
fn predictive(found: &Diagnosis) -> Option<Block> {
    let drawn = figures::predictive(found.draws.as_ref()?).transpose()?;
    let caption = "Forces as measured, as predicted before the data (grey, cut off at the edges) and with them (blue), 95 % bands; \
                   a model that fits has 19 of 20 dots in the blue band";
    Some(Block::figure(caption, drawn))
}

/// Summary of the diagnosis, in sentences.
fn summary(found: &Diagnosis) -> String {
    let noise: Vec<String> = found.noise.iter().map(|(name, sd)| quantity(name, *sd)).collect();
    let mut text = format!(
        "Session: {}. Noise of a reading, one standard deviation: {}. {} effects were tested. Verdict: {}.",
        found.split,
        noise.join(", "),
        found.ranking.len() - found.not_identifiable.len().min(found.ranking.len()),
        found.verdict.explained()
    );
    if !found.given.is_empty() {
        more(format!("The model had {} from the beginning.", found.given.join(", ")), &mut text);
    }
    if !found.partial.is_empty() {
        more(
            format!(
                "{}: better by evidence, but leaves more than noise, or the larger part of the misfit, or does not improve held-out runs: a description and no name.",
                found.partial.join(", ")
            ),
            &mut text,
        );
    }
    let remaining: Vec<String> = found.discrepancy.iter().map(|(name, sd)| quantity(name, *sd)).collect();
    if !remaining.is_empty() {
        more(format!("Smooth discrepancy that is left: {}.", remaining.join(", ")), &mut text);
    }
    more(format!("Under the final model K is {}", modulus(found)), &mut text);
    match found.tip_load_n {
        Some(load_n) => more(
            format!("and the tip load {} N.", estimate(Some(load_n), found.tip_load_ci95_n, 3)),
            &mut text,
        ),
        None => text.push('.'),
    }
    text
}

fn more(sentence: String, text: &mut String) {
    text.push(' ');
    text.push_str(&sentence);
}

/// Next measurements, quantities that are not identifiable from the session, and remarks.
fn remarks(found: &Diagnosis) -> Vec<String> {
    let mut remarks = Vec::new();
    if let Some(next) = &found.next_measurement {
        remarks.push(format!(
            "Measure next: {}: distinguishes {} (chi-square {:.0} expected).",
            next.what,
            next.separates.join(" and "),
            next.expected_divergence
        ));
    }
    if !found.not_identifiable.is_empty() {
        remarks.push(format!("Not identifiable from these runs: {}.", found.not_identifiable.join(", ")));
    }
    remarks.extend(found.limits.iter().chain(&found.warnings).cloned());
    remarks
}

fn regions(found: &Diagnosis) -> Option<Block> {
    let list: Vec<String> = found.regions.iter().map(ToString::to_string).collect();
    let mut list = list.into_iter();
    let first = list.next()?;
    let mut notes = vec![format!("Model and measurement disagree most at {first}.")];
    notes.extend(list);
    Some(Block::Notes(notes))
}

fn effects(found: &Diagnosis) -> Option<Block> {
    let rows = found.effects.iter().map(|one| {
        let competitors = one.competing_effects();
        vec![
            one.id.clone(),
            effect(&one.id).map_or("-".to_owned(), |of| of.info().physics.to_owned()),
            one.parameters_in_words(),
            value(Some(one.log_evidence_gain), 1),
            one.probability_in_words(),
            if competitors.is_empty() { "none".to_owned() } else { competitors.join(", ") },
        ]
    });
    let rows: Vec<_> = rows.collect();
    let columns = [
        words("effect"),
        words("physics"),
        words("parameters (95 %)"),
        number("log evidence"),
        words("probability"),
        words("or instead"),
    ];
    (!rows.is_empty()).then(|| Block::table("What is missing", columns, rows))
}

fn gap(gap: &HeldOutMisfit) -> Vec<Block> {
    let mut rows = vec![vec![
        "chi-square per reading".to_owned(),
        value(Some(gap.before.chi2_reduced), 2),
        value(Some(gap.after.chi2_reduced), 2),
        "-".to_owned(),
    ]];
    rows.extend(gap.before.rmse.iter().map(|(name, before)| {
        let rmse_after = gap.after.rmse.get(name).copied();
        vec![
            format!("{}, root mean square", channel(name)),
            value(Some(*before), 3),
            value(rmse_after, 3),
            unit(name).to_owned(),
        ]
    }));
    let caption =
        format!("Held-out runs ({}) before and after: {}", gap.heldout_runs.join(", "), removed(gap));
    let columns = [words("distance"), number("before"), number("after"), words("unit")];
    let mut drawn = gap.clone();
    drawn.points = Channel::ALL
        .iter()
        .flat_map(|channel| {
            let of_channel: Vec<_> =
                gap.points.iter().filter(|point| point.channel == *channel).copied().collect();
            thinned(&of_channel, POINTS)
        })
        .collect();
    vec![
        Block::table(caption, columns, rows),
        Block::figure(
            "Measured less predicted on the held-out runs, before and after, channel by channel",
            figures::residuals(&drawn),
        ),
        Block::figure("Root mean square of these residuals, before and after", figures::gap(gap)),
    ]
}

fn ranking(found: &Diagnosis) -> Vec<Block> {
    let rows = found.ranking.iter().take(RANKS).map(|ranked| {
        let how = if ranked.refitted { "refitted" } else { "by its score" };
        vec![
            ranked.id.clone(),
            value(Some(ranked.log_evidence_gain), 1),
            how.to_owned(),
            value(Some(ranked.score_chi2), 1),
        ]
    });
    let rows: Vec<_> = rows.collect();
    if rows.is_empty() {
        return Vec::new();
    }
    let caption = format!(
        "Leading effects by log evidence over the starting model; {:.1} is needed for a name",
        found.margin
    );
    let columns = [words("effect"), number("log evidence"), words("found"), number("score, chi-square")];
    vec![Block::table(caption.clone(), columns, rows), Block::figure(caption, figures::ranking(found))]
}
