//! Simulated worlds of four kinds, integrated by code of their own, with noise that is correlated in time: what is found, on what nothing is said, and
//! what is named falsely, over seeds.

mod cart;
mod chain;
#[path = "../common/mod.rs"]
mod common;
mod drive;
mod tank;

use discrepancy::*;
use std::cell::Cell;

const SIGN: &str = "friction/speed/sign";
const OVERFLOW: &str = "balance/level/above_level";
const PLAY: &str = "gear/position/bristle";
const RUN_OUT: &str = "gear/position/sine";
const LOSS: &str = "outer/outer_temperature/above_level";

/// A kind of worlds that differ in their seeds.
struct Kind {
    words: &'static str,
    hidden: &'static [&'static str],
    seeds: u64,
    diagnosed: fn(u64) -> Report,
    /// True values: of a parameter by its name, of a number of a law by both names, of the change on reversal.
    truth: &'static [(&'static str, f64)],
    /// Hidden laws that are missed at most.
    most_missed: usize,
}

/// The rows of the manual's table.
const KINDS: [Kind; 11] = [
    Kind {
        words: "nothing, in a cart",
        hidden: &[],
        seeds: 12,
        diagnosed: |seed| cart::diagnosed(seed, &|_, _| 0.0),
        truth: &[("mass", 2.4), ("viscous", 3.0)],
        most_missed: 0,
    },
    Kind {
        words: "dry friction of a cart",
        hidden: &[SIGN],
        seeds: 12,
        diagnosed: |seed| cart::diagnosed(seed, &|v, _| 0.8 * v.signum()),
        truth: &[("mass", 2.4), ("viscous", 3.0), ("friction/speed/sign a", 0.8)],
        most_missed: 1,
    },
    Kind {
        words: "dry friction, an offset and an asymmetry of a cart whose sum has a mean of about zero",
        hidden: &[SIGN, "friction/constant", "friction/speed/asymmetry"],
        seeds: 12,
        diagnosed: |seed| cart::diagnosed(seed, &|v, _| 0.8 * v.signum() - 0.5 + 0.7 * v.abs()),
        truth: &[("mass", 2.4)],
        most_missed: 6,
    },
    Kind {
        words: "dry friction of a cart that builds up over 40 mm; its interval is that of half the change on reversal",
        hidden: &["friction/position/bristle"],
        seeds: 12,
        diagnosed: |seed| {
            let state = Cell::new((0.0, 0.0));
            cart::diagnosed(seed, &|_, x| {
                let (bristle, previous_x) = state.get();
                let bristle = f64::clamp(bristle + x - previous_x, -0.02, 0.02);
                state.set((bristle, x));
                0.8 * bristle / 0.02
            })
        },
        truth: &[("mass", 2.4), ("reversal", 0.8)],
        most_missed: 1,
    },
    Kind {
        words: "nothing, in a tank",
        hidden: &[],
        seeds: 12,
        diagnosed: |seed| tank::diagnosed(seed, 0.0),
        truth: &[("outflow", 0.32)],
        most_missed: 0,
    },
    Kind {
        words: "overflow of a tank, inside a simulation",
        hidden: &[OVERFLOW],
        seeds: 12,
        diagnosed: |seed| tank::diagnosed(seed, 0.3),
        truth: &[("balance/level/above_level level", 9.0)],
        most_missed: 2,
    },
    Kind {
        words: "nothing, in a drive of two masses",
        hidden: &[],
        seeds: 6,
        diagnosed: |seed| drive::diagnosed(seed, 0.0, 0.0),
        truth: &[],
        most_missed: 0,
    },
    Kind {
        words: "backlash in such a drive (motor, load with dry friction), as the play of a position",
        hidden: &[PLAY],
        seeds: 6,
        diagnosed: |seed| drive::diagnosed(seed, 0.3, 0.0),
        truth: &[("ratio", 0.97)],
        most_missed: 1,
    },
    Kind {
        words: "a periodic error of its gear",
        hidden: &[RUN_OUT],
        seeds: 6,
        diagnosed: |seed| drive::diagnosed(seed, 0.0, 0.2),
        truth: &[("gear/position/sine period", 5.0)],
        most_missed: 1,
    },
    Kind {
        words: "nothing, in a chain of thermal masses",
        hidden: &[],
        seeds: 6,
        diagnosed: |seed| chain::diagnosed(seed, &|_| 0.0),
        truth: &[("loss", 0.015)],
        most_missed: 0,
    },
    Kind {
        words: "a loss above a temperature in such a chain, inside a simulation of two channels",
        hidden: &[LOSS],
        seeds: 6,
        diagnosed: |seed| chain::diagnosed(seed, &|outer| 0.03 * (outer - 20.0).max(0.0)),
        truth: &[("outer/outer_temperature/above_level level", 20.0)],
        most_missed: 1,
    },
];

/// Counts over seeds: hidden laws that are named, in a class, or of which nothing is said; laws named that are not hidden; intervals, and those that
/// hold the truth.
#[derive(Debug, Default)]
struct Rates {
    named: usize,
    in_a_class: usize,
    abstained: usize,
    false_names: usize,
    intervals: usize,
    held: usize,
}

/// All explanations of what a law explains.
fn explanations(term: &TermReport) -> Vec<String> {
    let rivals = term.rivals.iter().flat_map(|rival| std::iter::once(&rival.law).chain(&rival.with));
    std::iter::once(&term.law).chain(rivals).map(LawName::id).collect()
}

/// An estimate by the name of a parameter, by those of a law and of its number, or of the change on reversal.
fn estimate<'a>(report: &'a Report, name: &str) -> Option<&'a Estimate> {
    if name == "reversal" {
        return report.reversals.first().map(|reversal| &reversal.estimate);
    }
    let mut parameters = report.parameters.iter().map(|one| &one.estimate);
    let of_terms = report.terms.iter().filter(|term| name.starts_with(&term.law.id()));
    let mut of_laws = of_terms.flat_map(|term| &term.values);
    match name.rsplit_once(' ') {
        Some((_, number)) => of_laws.find(|one| one.name == number),
        None => parameters.find(|one| one.name == name),
    }
}

impl Rates {
    fn count(&mut self, kind: &Kind, report: &Report) {
        let named: Vec<String> =
            report.terms.iter().filter(|term| term.is_named).map(|term| term.law.id()).collect();
        for hidden in kind.hidden {
            let is_in_a_class =
                report.terms.iter().any(|term| explanations(term).iter().any(|id| id == hidden));
            if named.iter().any(|id| id == hidden) {
                self.named += 1;
            } else if is_in_a_class {
                self.in_a_class += 1;
            } else {
                self.abstained += 1;
            }
        }
        self.abstained += usize::from(kind.hidden.is_empty() && report.terms.is_empty());
        self.false_names += named.iter().filter(|id| !kind.hidden.contains(&id.as_str())).count();
        for (name, truth) in kind.truth {
            let Some(Estimate { ci95: [low, high], .. }) = estimate(report, name) else { continue };
            self.intervals += 1;
            self.held += usize::from((low..=high).contains(&truth));
        }
    }

    fn row(&self, kind: &Kind) -> String {
        let of_all = |count: usize| format!("{count} of {}", kind.seeds as usize * kind.hidden.len().max(1));
        let of_laws = |count: usize| if kind.hidden.is_empty() { "-".to_owned() } else { of_all(count) };
        let intervals =
            if self.intervals == 0 { "-".to_owned() } else { format!("{} of {}", self.held, self.intervals) };
        [
            kind.words.to_owned(),
            of_laws(self.named),
            of_laws(self.in_a_class),
            of_all(self.abstained),
            self.false_names.to_string(),
            intervals,
        ]
        .join(" | ")
    }
}

fn ids(report: &Report) -> Vec<String> {
    report.terms.iter().map(|term| term.law.id()).collect()
}

/// One seed of carts, for the first tier.
#[test]
fn one_cart_with_and_one_without_dry_friction() {
    let report = cart::diagnosed(3, &|v, _| 0.8 * v.signum());
    assert_eq!((report.verdict, ids(&report)), (Verdict::Explained, vec![SIGN.to_owned()]));
    let size = &report.terms[0].values[0];
    assert!((size.ci95[0]..=size.ci95[1]).contains(&0.8), "{report}");
    let report = cart::diagnosed(3, &|_, _| 0.0);
    assert_eq!(report.verdict, Verdict::Adequate, "{report}");
}

/// A friction of 1.4 N in one direction and 0.4 N in the other.
#[test]
fn an_asymmetric_friction_is_a_dry_friction_and_an_offset() {
    let report = cart::diagnosed(5, &|v, _| if v > 0.0 { 1.4 } else { -0.4 });
    for (parts, truth) in [(&report.offsets, 0.5), (&report.reversals, 0.9)] {
        let part = parts.first().unwrap_or_else(|| panic!("{report}"));
        let [low, high] = part.estimate.ci95;
        assert!(part.is_named && (low..=high).contains(&truth), "{report}");
    }
    let text = report.to_string();
    assert!(text.contains("in both directions alike") && text.contains("friction/speed/sign"), "{text}");
}

/// One seed of a drive, for the first tier.
#[test]
fn one_drive_with_backlash() {
    let report = drive::diagnosed(1, 0.3, 0.0);
    assert!(ids(&report).contains(&PLAY.to_owned()), "{report}");
}

/// The manual's table; [`KIND`] restricts it to rows that hold a text, and [`FIRST`] takes other seeds.
#[test]
#[ignore = "second tier: Monte Carlo over six to twelve seeds of eleven kinds, minutes"]
fn rates_over_seeds() {
    let only = std::env::var(KIND).unwrap_or_default();
    let first = std::env::var(FIRST).map_or(0, |text| text.parse().expect("the number of a seed"));
    let mut table = vec![
        "| hidden | named | in a class | nothing said | named falsely | 95 % intervals that hold |"
            .to_owned(),
        "|---|---|---|---|---|---|".to_owned(),
    ];
    let (mut complaints, mut intervals, mut held) = (Vec::new(), 0, 0);
    for kind in KINDS.iter().filter(|kind| kind.words.contains(&only)) {
        let mut rates = Rates::default();
        for seed in first..first + kind.seeds {
            let report = (kind.diagnosed)(seed);
            let earlier_false_names = rates.false_names;
            rates.count(kind, &report);
            if rates.false_names > earlier_false_names {
                eprintln!("{report}");
            }
            let laws: Vec<Vec<String>> = report.terms.iter().map(explanations).collect();
            eprintln!("{}, seed {seed}: {:?} {laws:?}", kind.words, report.verdict);
        }
        table.push(format!("| {} |", rates.row(kind)));
        // 5 % of twelve seeds are 0.6, and two or more of them have a probability of 12 %.
        if rates.false_names > 1 || (!kind.hidden.is_empty() && rates.abstained > kind.most_missed) {
            complaints.push(format!("{}: {rates:?}", kind.words));
        }
        (intervals, held) = (intervals + rates.intervals, held + rates.held);
    }
    // At once: the table of the page is made of this output.
    println!("\n{}", table.join("\n"));
    assert!(complaints.is_empty(), "{}", complaints.join("\n"));
    // Nine of ten: of a hundred at 95 % fewer than 90 hold with 1 %.
    assert!(10 * held >= 9 * intervals, "{held} of {intervals} intervals hold");
}

/// Environment variable with a text of the rows that are computed.
const KIND: &str = "DISCREPANCY_KIND";
/// Environment variable with the first seed, 0 where it is not stated.
const FIRST: &str = "DISCREPANCY_FIRST_SEED";
