//! The tables of the study: how often the diagnosis was right, and what was taken for what.

use super::cases::Kind;
use super::outcome::Outcome;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// Good ones of all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Share {
    good: usize,
    all: usize,
}

impl Share {
    fn of<'a>(among: impl Iterator<Item = &'a Outcome>, good: impl Fn(&Outcome) -> bool) -> Self {
        among.map(good).collect()
    }
}

impl FromIterator<bool> for Share {
    fn from_iter<I: IntoIterator<Item = bool>>(all: I) -> Self {
        all.into_iter().fold(Self::default(), |share, good| Self {
            good: share.good + usize::from(good),
            all: share.all + 1,
        })
    }
}

impl std::fmt::Display for Share {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.all {
            0 => f.write_str("-"),
            all => write!(f, "{:.1} % ({} of {all})", 100.0 * self.good as f64 / all as f64, self.good),
        }
    }
}

/// The measures of some outcomes: name, goal, reached.
pub fn measures(outcomes: &[Outcome]) -> Vec<(&'static str, &'static str, String)> {
    let hidden = || outcomes.iter().filter(|o| o.case.hidden().is_some());
    let due = || outcomes.iter().filter(|o| o.is_due());
    let alone = || outcomes.iter().filter(|o| o.case.hidden().is_none());
    let covered: Share = outcomes.iter().flat_map(|o| o.covered()).map(|(_, good)| good).collect();
    let modulus: Share = outcomes.iter().filter_map(Outcome::is_modulus_covered).collect();
    let seconds: Vec<f64> = outcomes.iter().map(|o| o.seconds).collect();
    let mean_s = seconds.iter().sum::<f64>() / seconds.len().max(1) as f64;
    let slowest_s = seconds.iter().copied().fold(0.0, f64::max);
    let removed: Vec<f64> =
        outcomes.iter().filter(|o| !o.named().is_empty()).filter_map(Outcome::removed).collect();
    let mean_removed = removed.iter().sum::<f64>() / removed.len().max(1) as f64;
    let preferred: BTreeMap<&str, usize> =
        outcomes.iter().filter_map(Outcome::foundation).fold(BTreeMap::new(), |mut counts, foundation| {
            *counts.entry(foundation).or_default() += 1;
            counts
        });
    let mut rows = vec![
        (
            "explains >= 80 % of the misfit and a chi-square of 40: in a class of at most 3",
            ">= 95 %",
            Share::of(due(), Outcome::is_in_class).to_string(),
        ),
        ("of these named alone", ">= 80 %", Share::of(due(), Outcome::is_alone).to_string()),
        (
            "of these larger than a stated tolerance can imitate: in a class of at most 3",
            "",
            Share::of(due().filter(|o| o.is_beyond_tolerance()), Outcome::is_in_class).to_string(),
        ),
        ("every effect: in a class of at most 3", "", Share::of(hidden(), Outcome::is_in_class).to_string()),
        ("every effect: missed", "", Share::of(hidden(), Outcome::is_missed).to_string()),
        (
            "every effect: wrong, the true one not named",
            "",
            Share::of(hidden(), Outcome::is_wrong).to_string(),
        ),
        (
            "further effects named that are not there",
            "<= 2 %",
            Share::of(outcomes.iter(), Outcome::is_further_wrong).to_string(),
        ),
        (
            "background or homogeneous body alone: something named",
            "<= 2 %",
            Share::of(alone(), |o| !o.named().is_empty()).to_string(),
        ),
        (
            "accepted though the held-out misfit grows",
            "0",
            Share::of(outcomes.iter(), Outcome::has_grown).to_string(),
        ),
        (
            "removable held-out misfit that is gone where something is named",
            "",
            if removed.is_empty() { "-".to_owned() } else { format!("mean {:.1} %", 100.0 * mean_removed) },
        ),
        ("true parameters in their 95 % intervals", ">= 90 %", covered.to_string()),
        ("true modulus in its 95 % interval", ">= 90 %", modulus.to_string()),
        ("time for one session, one core", "", format!("mean {mean_s:.2} s, longest {slowest_s:.2} s")),
    ];
    let failed = outcomes.iter().filter(|o| o.diagnosis.is_err()).count();
    if failed > 0 {
        rows.push(("no diagnosis", "0", failed.to_string()));
    }
    if !preferred.is_empty() {
        let counts: Vec<String> = preferred.iter().map(|(name, count)| format!("{name} {count}")).collect();
        rows.push(("tissue preferred", "", counts.join(", ")));
    }
    rows
}

/// Measures of several sets of outcomes side by side, a table for every kind of session in them.
pub fn measures_table(sets: &[(String, Vec<Outcome>)]) -> String {
    let mut text = String::new();
    for (kind, title) in [
        (Kind::Effects, "One effect behind a background"),
        (Kind::Background, "A background alone"),
        (Kind::Body, "Elastic bodies"),
        (Kind::Insertions, "Insertions"),
        (Kind::ByHand, "Insertions by hand through one guide"),
    ] {
        let of_kind: Vec<(&str, Vec<Outcome>)> = sets
            .iter()
            .map(|(name, set)| {
                (name.as_str(), set.iter().filter(|o| o.case.kind == kind).cloned().collect::<Vec<_>>())
            })
            .collect();
        if of_kind.iter().all(|(_, set)| set.is_empty()) {
            continue;
        }
        let names: Vec<String> = of_kind.iter().map(|(name, set)| format!("{name}: {}", set.len())).collect();
        let _ = writeln!(text, "{title}\n\n| measure | goal | {} |", names.join(" | "));
        let _ = writeln!(text, "|---|---|{}", "---|".repeat(names.len()));
        let columns: Vec<_> = of_kind.iter().map(|(_, set)| measures(set)).collect();
        let first = columns.iter().max_by_key(|column| column.len());
        for (measure, goal, _) in first.into_iter().flatten() {
            let reached = columns.iter().map(|column| {
                let row = column.iter().find(|(name, ..)| name == measure);
                row.map_or("-", |(.., reached)| reached.as_str())
            });
            let reached: Vec<&str> = reached.collect();
            let _ = writeln!(text, "| {measure} | {goal} | {} |", reached.join(" | "));
        }
        text.push('\n');
    }
    text
}

/// One row per hidden effect: what became of it, and what else was named.
pub fn confusion(outcomes: &[Outcome]) -> String {
    let mut rows: BTreeMap<String, Vec<&Outcome>> = BTreeMap::new();
    outcomes.iter().for_each(|outcome| rows.entry(outcome.case.name()).or_default().push(outcome));
    let mut text = String::from(
        "| hidden | sessions | explains most | named alone | in a class | missed | wrong | further wrong | parameters covered | K covered | \
         else named or in the class |\n|---|---|---|---|---|---|---|---|---|---|---|\n",
    );
    for (name, of_row) in rows {
        let mut wrong_names: BTreeMap<&str, usize> = BTreeMap::new();
        for outcome in &of_row {
            let classes = outcome.named();
            let mentioned = classes.iter().flat_map(|(_, class)| class);
            for id in mentioned.filter(|id| Some(**id) != outcome.case.hidden()) {
                *wrong_names.entry(id).or_default() += 1;
            }
        }
        let wrong_texts: Vec<String> =
            wrong_names.iter().map(|(id, count)| format!("{id} {count}")).collect();
        let intervals: Share = of_row.iter().flat_map(|o| o.covered()).map(|(_, good)| good).collect();
        let modulus: Share = of_row.iter().filter_map(|o| o.is_modulus_covered()).collect();
        let alone = of_row.iter().filter(|o| o.is_alone()).count();
        let _ = writeln!(
            text,
            "| {name} | {} | {} | {alone} | {} | {} | {} | {} | {} | {} | {} |",
            of_row.len(),
            of_row.iter().filter(|o| o.is_due()).count(),
            of_row.iter().filter(|o| o.is_in_class()).count() - alone,
            of_row.iter().filter(|o| o.is_missed()).count(),
            of_row.iter().filter(|o| o.is_wrong()).count(),
            of_row.iter().filter(|o| o.is_further_wrong()).count(),
            fraction(intervals),
            fraction(modulus),
            wrong_texts.join(", "),
        );
    }
    text
}

fn fraction(share: Share) -> String {
    format!("{} of {}", share.good, share.all)
}
