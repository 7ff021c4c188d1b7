//! The study of statistics over many sessions: templates from diagnosed sessions of the independent generator, then populations.

use anyhow::{Result, ensure};
use formats::session::Labels;
use inference::summarize_session;
use population::Summary;
use studies::population::{Outcome, Truth, study};
use worlds::{Background, Design, Foreign, Truth as World, on_all_cores};

/// Sessions that lack nothing, from which records are drawn.
const TEMPLATES: usize = 12;
const K_KPA: f64 = 12.0;

/// Repeated populations: a name and the population.
const POPULATIONS: [(&str, f64, f64, f64); 3] = [
    ("gain 1.03 of one rig, 1.03 of another from a date on, 3 % foreign", 1.03, 1.03, 0.03),
    ("gain 1.015 of one rig", 1.015, 1.0, 0.0),
    ("nothing shared", 1.0, 1.0, 0.0),
];

/// Prints a row per population.
pub fn run(repetitions: usize, sessions: usize, seed: u64) -> Result<()> {
    ensure!((100..=100_000).contains(&sessions), "--runs is {sessions}, expected 100 to 100000");
    ensure!((1..=10_000).contains(&repetitions), "--repeats is {repetitions}, expected 1 to 10000");
    let count = TEMPLATES + 2 * Foreign::ALL.len();
    let drawn_sessions = on_all_cores(count, |number| {
        let foreign = number.checked_sub(TEMPLATES).map(|number| Foreign::ALL[number % Foreign::ALL.len()]);
        record_of(foreign, number, seed)
    });
    let (templates, foreign) = drawn_sessions.split_at(TEMPLATES);
    println!(
        "| population | mean covered | sd covered | new subjects covered | gain named | step's rig named | as a step | its date covered | others named | foreign listed | clean listed |\n\
         |---|---|---|---|---|---|---|---|---|---|---|"
    );
    for (name, gain, step, share) in POPULATIONS {
        let truth = Truth { sessions, gain, step, foreign: share };
        let outcome = study(&truth, templates, (foreign, K_KPA), repetitions, seed)?;
        println!("| {name} | {} |", row(&outcome, &truth));
    }
    Ok(())
}

fn record_of(foreign: Option<Foreign>, number: usize, seed: u64) -> Summary {
    let number = number as u64 + seed.wrapping_mul(1000);
    let (world, design) = (world_with(foreign), Design::four_runs());
    let background = Background::drawn(&world, &design, number);
    let session = worlds::session_on(&world, &background, &design, number);
    summarize_session(format!("template {number}"), &session, &Labels::default(), number)
}

fn world_with(foreign: Option<Foreign>) -> World {
    World { k_kpa: K_KPA, tip_load_n: 0.2, effects: Vec::new(), foreign }
}

fn row(outcome: &Outcome, truth: &Truth) -> String {
    let groups = 3 * outcome.repetitions;
    [
        percent(outcome.means, groups),
        percent(outcome.taus, groups),
        percent(outcome.predicted, 100 * groups),
        detected_percent(truth.gain != 1.0, outcome.gains, outcome.repetitions),
        detected_percent(truth.step != 1.0, outcome.drifts, outcome.repetitions),
        detected_percent(truth.step != 1.0, outcome.steps[0], outcome.repetitions),
        if truth.step != 1.0 { percent(outcome.steps[1], outcome.steps[0]) } else { "-".to_owned() },
        percent(outcome.others, outcome.repetitions),
        if truth.foreign > 0.0 { percent(outcome.foreign[1], outcome.foreign[0]) } else { "-".to_owned() },
        percent(outcome.clean[1], outcome.clean[0]),
    ]
    .join(" | ")
}

fn detected_percent(there: bool, some: usize, repetitions: usize) -> String {
    if there { percent(some, repetitions) } else { "-".to_owned() }
}

fn percent(some: usize, all: usize) -> String {
    format!("{:.1} %", 100.0 * some as f64 / all.max(1) as f64)
}
