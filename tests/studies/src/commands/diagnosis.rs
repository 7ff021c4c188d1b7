//! `cargo xtask study diagnose`: the blind study of the discrepancy workflow, its goals and its confusion matrix.

use anyhow::{Context, Result, ensure};
use inference::diagnose::Verdict;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::sync::atomic::{AtomicUsize, Ordering};
use studies::diagnose::{Hidden, Outcome, Size, cases, run as run_cases};
use time::OffsetDateTime;

/// An effect is identifiable where its expected log evidence over the nearest competitor is above this, and must be in its class where
/// its expected gain of chi-square is.
const APART: f64 = 5.0;
const GAIN: f64 = 40.0;

/// Imperfect sessions for every repeat of the study.
const IMPERFECT: usize = 30;

/// Runs the study with two seeds, the one used while building and a fresh one, and writes its tables where the documentation has
/// them; only some of its sessions, of the first seed, are printed one by one.
///
/// # Errors
/// Where the tables cannot be written.
pub fn run(repeats: usize, seeds: [u64; 2], only: &str, is_pure: bool) -> Result<()> {
    ensure!((1..=1000).contains(&repeats), "--repeats is {repeats}, expected 1 to 1000");
    let [seed, fresh] = seeds;
    let outcomes = outcomes(repeats, seed, only)?;
    if !only.is_empty() {
        outcomes.iter().for_each(|outcome| println!("{}", line(outcome)));
        return Ok(());
    }
    if is_pure {
        println!(
            "{} sessions, seed {seed}\n\n{}\n{}",
            outcomes.len(),
            goals(&[(seed, &outcomes)]),
            confusion(&outcomes)
        );
        return Ok(());
    }
    let again = self::outcomes(repeats, fresh, only)?;
    let imperfect = super::imperfect::tables(IMPERFECT * repeats, seeds)?;
    let today = OffsetDateTime::now_utc().date();
    let text = format!(
        "# Blind study of `guide diagnose`\n\nMade on {today} by `cargo xtask study diagnose --repeats {repeats} --seed {seed} --fresh-seed {fresh}`. The first \
         seed was used while building, the second never before.\n\n## Nothing but one effect, two, or something without a name\n\n\
         {} and {} sessions.\n\n{}\n{}\n## Effects behind small imperfections, elastic bodies, insertions\n\n\
         Modulus: the mean over the tissue that was touched.\n\n{imperfect}",
        outcomes.len(),
        again.len(),
        goals(&[(seed, &outcomes), (fresh, &again)]),
        confusion(&outcomes),
    );
    let path = super::root().join("host/manual/src/blind-study.md");
    std::fs::write(&path, &text).with_context(|| format!("{}: cannot write", path.display()))?;
    print!("{text}");
    for outcome in outcomes.iter().chain(&again).filter(|outcome| is_surprise(outcome)) {
        eprintln!("{}", line(outcome));
    }
    Ok(())
}

/// Outcomes of the sessions whose names hold `only`.
fn outcomes(repeats: usize, seed: u64, only: &str) -> Result<Vec<Outcome>> {
    let size = Size { nothing: 40 * repeats, one: repeats, pairs: 12 * repeats, foreign: 2 * repeats };
    let mut cases = cases(size, seed);
    cases.retain(|(hidden, _)| name(hidden).contains(only));
    let finished = AtomicUsize::new(0);
    let outcomes = run_cases(&cases, |_| {
        let finished_count = finished.fetch_add(1, Ordering::Relaxed) + 1;
        if finished_count.is_multiple_of(20) {
            eprintln!("{finished_count} of {} sessions", cases.len());
        }
    });
    ensure!(outcomes.len() == cases.len(), "{} sessions fail", cases.len() - outcomes.len());
    Ok(outcomes)
}

fn name(hidden: &Hidden) -> String {
    match hidden {
        Hidden::Nothing => "nothing".to_owned(),
        Hidden::NothingImaged => "nothing, imaging stated".to_owned(),
        Hidden::One(id, strength) => format!("{id}, {}", ["weak", "middle", "strong"][*strength]),
        Hidden::Pair(a, b) => format!("{a} + {b}"),
        Hidden::Foreign(name) => format!("foreign: {name}"),
    }
}

/// Whether an effect is what is named, alone in its class.
fn is_named(outcome: &Outcome, id: &str) -> bool {
    outcome.named.iter().any(|(named, class)| named == id && class.len() == 1)
}

/// Whether an effect is in a class.
fn is_in_class(outcome: &Outcome, id: &str) -> bool {
    outcome.named.iter().any(|(_, class)| class.iter().any(|member| member == id))
}

fn is_surprise(outcome: &Outcome) -> bool {
    match &outcome.hidden {
        Hidden::Nothing | Hidden::NothingImaged => outcome.verdict != Verdict::Adequate,
        Hidden::One(id, _) => {
            let identifiable = outcome.expected_apart.is_some_and(|apart| apart > APART);
            let detectable = outcome.expected_gain.is_some_and(|gain| gain >= GAIN);
            (identifiable && !(is_named(outcome, id) && outcome.named.len() == 1))
                || (detectable && !is_in_class(outcome, id))
        }
        Hidden::Pair(a, b) => !(is_in_class(outcome, a) && is_in_class(outcome, b)),
        Hidden::Foreign(_) => outcome.verdict != Verdict::Unexplained,
    }
}

/// Count of some and of all, as a share.
struct Share(usize, usize);

impl Share {
    fn of<'a>(among: impl Iterator<Item = &'a Outcome>, good: impl Fn(&Outcome) -> bool) -> Self {
        among.fold(Self(0, 0), |Self(good_ones, all), outcome| {
            Self(good_ones + usize::from(good(outcome)), all + 1)
        })
    }
}

impl std::fmt::Display for Share {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self(good, total) = self;
        write!(f, "{:.1} % ({good} of {total})", 100.0 * *good as f64 / (*total).max(1) as f64)
    }
}

/// Rows of the table of goals.
const MEASURES: usize = 10;

/// Goals and what was reached with each seed.
fn goals(sets: &[(u64, &[Outcome])]) -> String {
    let seeds: Vec<String> = sets.iter().map(|(seed, _)| format!("seed {seed}")).collect();
    let mut text =
        format!("| measure | goal | {} |\n|---|---|{}\n", seeds.join(" | "), "---|".repeat(sets.len()));
    let columns: Vec<_> = sets.iter().map(|(_, outcomes)| reached(outcomes)).collect();
    for (row, (measure, goal, _)) in columns.iter().flatten().take(MEASURES).enumerate() {
        let reached: Vec<&str> = columns.iter().map(|column| column[row].2.as_str()).collect();
        let _ = writeln!(text, "| {measure} | {goal} | {} |", reached.join(" | "));
    }
    text
}

/// Measure, goal and what was reached.
fn reached(outcomes: &[Outcome]) -> [(&'static str, &'static str, String); MEASURES] {
    let single_effects = || {
        outcomes.iter().filter_map(|o| if let Hidden::One(id, _) = &o.hidden { Some((o, *id)) } else { None })
    };
    let clean_sessions =
        || outcomes.iter().filter(|o| matches!(o.hidden, Hidden::Nothing | Hidden::NothingImaged));
    let foreign = || outcomes.iter().filter(|o| matches!(o.hidden, Hidden::Foreign(_)));
    let pairs = || outcomes.iter().filter(|o| matches!(o.hidden, Hidden::Pair(..)));
    let identifiable = || {
        single_effects().filter(|(o, _)| o.expected_apart.is_some_and(|apart| apart > APART)).map(|(o, _)| o)
    };
    let detectable =
        || single_effects().filter(|(o, _)| o.expected_gain.is_some_and(|gain| gain >= GAIN)).map(|(o, _)| o);
    let classes: Vec<usize> =
        single_effects().flat_map(|(o, _)| o.named.iter().map(|(_, class)| class.len())).collect();
    let class_size = classes.iter().sum::<usize>() as f64 / classes.len().max(1) as f64;
    let covered: Vec<bool> = outcomes.iter().flat_map(|o| o.covered.iter().map(|(_, good)| *good)).collect();
    let coverage = Share(covered.iter().filter(|good| **good).count(), covered.len());
    let removed: Vec<f64> =
        outcomes.iter().filter(|o| !o.named.is_empty()).filter_map(|o| o.removed).collect();
    let mean_removed = removed.iter().sum::<f64>() / removed.len().max(1) as f64;
    let named = || outcomes.iter().filter(|o| !o.named.is_empty());
    let chi2_after: Vec<f64> = named().filter_map(|o| o.chi2_after).collect();
    let mean_after = chi2_after.iter().sum::<f64>() / chi2_after.len().max(1) as f64;
    let explained = Share(chi2_after.iter().filter(|chi2| **chi2 <= 1.2).count(), chi2_after.len());
    let mostly_removed = Share(removed.iter().filter(|share| **share >= 0.9).count(), removed.len());
    let seconds: Vec<f64> =
        single_effects().filter(|(_, id)| !id.starts_with("tip.")).map(|(o, _)| o.seconds).collect();
    let mean_seconds = seconds.iter().sum::<f64>() / seconds.len().max(1) as f64;
    let slowest = seconds.iter().copied().fold(0.0, f64::max);
    [
        (
            "false alarm on effect-free sessions",
            "<= 2 %",
            Share::of(clean_sessions(), |o| o.verdict != Verdict::Adequate).to_string(),
        ),
        (
            "true effect named (class of one) where it is identifiable",
            ">= 95 %",
            Share::of(identifiable(), |o| is_named(o, id_of(o)) && o.named.len() == 1).to_string(),
        ),
        (
            "true effect inside the reported class, expected gain >= 40",
            ">= 98 %",
            Share::of(detectable(), |o| is_in_class(o, id_of(o))).to_string(),
        ),
        ("class size, mean", "<= 1.5", format!("{class_size:.2}")),
        (
            "effects outside the catalogue: `unexplained`, nothing named",
            ">= 90 %",
            Share::of(foreign(), |o| o.verdict == Verdict::Unexplained && o.named.is_empty()).to_string(),
        ),
        (
            "two effects at once: both named",
            ">= 80 %",
            format!(
                "{}, both in their classes {}",
                Share::of(pairs(), |o: &Outcome| match &o.hidden {
                    Hidden::Pair(a, b) =>
                        [a, b].iter().all(|id| o.named.iter().any(|(named, _)| named == *id)),
                    _ => false,
                }),
                Share::of(pairs(), |o: &Outcome| match &o.hidden {
                    Hidden::Pair(a, b) => [a, b].iter().all(|id| is_in_class(o, id)),
                    _ => false,
                })
            ),
        ),
        ("95 % intervals cover the true parameters", "90-98 %", coverage.to_string()),
        (
            "removable misfit removed on held-out runs",
            ">= 90 %",
            format!("mean {:.1} %, at least 90 % in {mostly_removed}", 100.0 * mean_removed),
        ),
        ("reduced chi-square after", "<= 1.2", format!("mean {mean_after:.2}, at most 1.2 in {explained}")),
        (
            "time for one session of nine runs, one core",
            "<= 2 s",
            format!("mean {mean_seconds:.2} s, slowest {slowest:.2} s (all cores busy)"),
        ),
    ]
}

fn id_of(o: &Outcome) -> &str {
    if let Hidden::One(id, _) = &o.hidden { id } else { "" }
}

/// One row per effect: what became of it, and what else was reported.
fn confusion(outcomes: &[Outcome]) -> String {
    let mut rows: BTreeMap<String, Vec<&Outcome>> = BTreeMap::new();
    for outcome in outcomes {
        let row = match &outcome.hidden {
            Hidden::One(id, _) => (*id).to_owned(),
            Hidden::Pair(..) => "two effects".to_owned(),
            other => name(other),
        };
        rows.entry(row).or_default().push(outcome);
    }
    let mut text = String::from(
        "| hidden | sessions | named | in a class | adequate | unexplained | covered | else named or in the class |\n|---|---|---|---|---|---|---|---|\n",
    );
    for (row, of_row) in rows {
        let with_hidden = of_row.iter().filter(|o| !hidden_ids(o).is_empty());
        let [named, named_or_classed] = [is_named, is_in_class].map(|is_found| {
            with_hidden.clone().filter(|o| hidden_ids(o).iter().all(|id| is_found(o, id))).count()
        });
        let classed = named_or_classed - named;
        let mut wrong_names: BTreeMap<&str, usize> = BTreeMap::new();
        for outcome in &of_row {
            let mentioned = outcome.named.iter().flat_map(|(_, class)| class);
            for id in mentioned.filter(|id| !hidden_ids(outcome).contains(&id.as_str())) {
                *wrong_names.entry(id).or_default() += 1;
            }
        }
        let intervals: Vec<bool> =
            of_row.iter().flat_map(|o| o.covered.iter().map(|(_, good)| *good)).collect();
        let covered_count = intervals.iter().filter(|good| **good).count();
        let wrong_texts: Vec<String> =
            wrong_names.iter().map(|(id, count)| format!("{id} {count}")).collect();
        let _ = writeln!(
            text,
            "| {row} | {} | {named} | {classed} | {} | {} | {covered_count} of {} | {} |",
            of_row.len(),
            of_row.iter().filter(|o| o.verdict == Verdict::Adequate).count(),
            of_row.iter().filter(|o| o.verdict == Verdict::Unexplained).count(),
            intervals.len(),
            wrong_texts.join(", ")
        );
    }
    text
}

fn hidden_ids(o: &Outcome) -> Vec<&str> {
    match &o.hidden {
        Hidden::One(id, _) => vec![*id],
        Hidden::Pair(a, b) => vec![*a, *b],
        _ => Vec::new(),
    }
}

/// Everything about one session, for a closer examination.
fn line(outcome: &Outcome) -> String {
    let missed: Vec<&String> =
        outcome.covered.iter().filter(|(_, good)| !good).map(|(name, _)| name).collect();
    format!(
        "{} (seed {}): {:?} {:?}; expected gain {:.0}, apart {:.1} from {}; smooth structure p {:.1e} before, {:.1e} after; removed {:?}, \
         chi-square {:.2}; partial {:?}; intervals missed {missed:?}; {:?}; {:.2} s",
        name(&outcome.hidden),
        outcome.seed,
        outcome.verdict,
        outcome.named,
        outcome.expected_gain.unwrap_or(f64::NAN),
        outcome.expected_apart.unwrap_or(f64::NAN),
        outcome.competitor.as_deref().unwrap_or("none"),
        outcome.p[0],
        outcome.p[1],
        outcome.removed,
        outcome.chi2_after.unwrap_or(f64::NAN),
        outcome.partial,
        outcome.found,
        outcome.seconds,
    )
}
