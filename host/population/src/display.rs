//! A population for the eye: one screen.

use crate::results::{GroupResult, Population, SharedEffect, SharedKind, SpreadKind};
use crate::summary::Interval;
use std::fmt::{self, Display, Formatter};

/// Listed sessions and remarks that are shown.
const SHOWN: usize = 12;

impl Display for Population {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let counts = self.sessions;
        writeln!(
            f,
            "sessions     {}, {} with a modulus, {} used",
            counts.given, counts.with_modulus, counts.used
        )?;
        writeln!(f, "foundation modulus K, kPa (95 % interval)")?;
        writeln!(
            f,
            "  {:<24}{:>8}  {:<24}{:<26}{:<20}{:>5}",
            "group", "sessions", "mean", "between sessions, sd", "a new subject", "I^2"
        )?;
        for group in &self.groups {
            write_group(f, group)?;
        }
        for effect in &self.shared_effects {
            write_shared(f, effect)?;
        }
        if self.shared_effects.is_empty() {
            writeln!(
                f,
                "shared       no effect is shared by the sessions of a rig, needle, tissue or day, or by all sessions ({} tests)",
                self.tests
            )?;
        }
        for one in &self.spread {
            let kind = match one.kind {
                SpreadKind::Absent => continue,
                SpreadKind::Shared => "the same in all sessions",
                SpreadKind::Varying => "varies between sessions",
                SpreadKind::Single => "in single sessions",
            };
            writeln!(
                f,
                "spread       {}: {kind} ({} name it by themselves); log evidence shared {:+.1}, varying {:+.1}, single {:+.1}",
                one.effect,
                one.named_by_sessions,
                one.log_evidence_shared,
                one.log_evidence_varying,
                one.log_evidence_single
            )?;
        }
        for pair in &self.agreement {
            let ([low, high], [limit_low, limit_high]) = (pair.ratio_ci95, pair.limits95);
            writeln!(
                f,
                "agreement    {} {} over {}: K ratio {:.3} ({low:.3} to {high:.3}); 95 % of {} subjects within {limit_low:.3} to {limit_high:.3}",
                pair.label, pair.between[0], pair.between[1], pair.ratio, pair.subjects
            )?;
        }
        for tip in &self.tip_load {
            let [low, high] = tip.load_n.ci95;
            let spread_text =
                tip.between_n.map_or("not identifiable".to_owned(), |sd_n| format!("{sd_n:.3} N"));
            let [needle, tissue] =
                [&tip.needle, &tip.tissue].map(|label| label.as_deref().unwrap_or("not stated"));
            writeln!(
                f,
                "tip load     needle {needle}, tissue {tissue}: {:.3} N ({low:.3} to {high:.3}), sd between sessions {spread_text}; sessions: {}",
                tip.load_n.value, tip.sessions
            )?;
        }
        for one in self.listed.iter().take(SHOWN) {
            let how =
                if one.weight > 0.0 { format!("weight {:.2}", one.weight) } else { "not used".to_owned() };
            writeln!(f, "{how:<12} {}: {}", one.session, one.reason)?;
        }
        if self.listed.len() > SHOWN {
            writeln!(f, "             and {} more: --json lists them", self.listed.len() - SHOWN)?;
        }
        for warning in self.warnings.iter().take(SHOWN) {
            writeln!(f, "note         {warning}")?;
        }
        Ok(())
    }
}

fn write_group(f: &mut Formatter<'_>, group: &GroupResult) -> fmt::Result {
    let Interval { value, ci95: [low, high] } = group.k_kpa;
    let mean = format!("{value:.2} ({low:.2} to {high:.2})");
    let spread_text = match group.tau_ci95 {
        Some([low, high]) => {
            format!("{:.1} % ({:.1} to {:.1} %)", 100.0 * group.tau, 100.0 * low, 100.0 * high)
        }
        None => "not identifiable".to_owned(),
    };
    let new = group
        .new_subject95_kpa
        .map_or_else(|| "not identifiable".to_owned(), |[low, high]| format!("{low:.2} to {high:.2}"));
    writeln!(
        f,
        "  {:<24}{:>8}  {mean:<24}{spread_text:<26}{new:<20}{:>3.0} %",
        group.group, group.sessions, group.i_squared_percent
    )?;
    for level in group.levels.iter().filter(|_| group.levels.len() > 1) {
        let spread = match level.tau.zip(level.tau_ci95) {
            Some((tau, [low, high])) => {
                format!("sd {:.1} % ({:.1} to {:.1} %)", 100.0 * tau, 100.0 * low, 100.0 * high)
            }
            None => "sd not identifiable".to_owned(),
        };
        let icc = level.icc.zip(level.icc_ci95).map_or_else(String::new, |(icc, [low, high])| {
            format!(", intraclass correlation {icc:.2} ({low:.2} to {high:.2})")
        });
        writeln!(f, "  {:<24}{:>8}  level {}: {spread}{icc}", "", level.groups, level.level)?;
    }
    for (name, slope) in &group.slopes {
        let [low, high] = slope.ci95;
        writeln!(
            f,
            "  {:<24}{:>8}  ln K per unit of {name}: {:.4} ({low:.4} to {high:.4})",
            "", "", slope.value
        )?;
    }
    if let Some(all_sessions) = group.with_listed {
        let [low, high] = all_sessions.k_kpa.ci95;
        writeln!(
            f,
            "  {:<24}{:>8}  {:.2} ({low:.2} to {high:.2}), sd {:.1} %: with sessions that are not used",
            "",
            all_sessions.sessions,
            all_sessions.k_kpa.value,
            100.0 * all_sessions.tau
        )?;
    }
    Ok(())
}

/// Names the sessions that share an effect.
fn place(label: &str, group: &str) -> String {
    if label == "all" { group.to_owned() } else { format!("{label} {group}") }
}

fn write_shared(f: &mut Formatter<'_>, one: &SharedEffect) -> fmt::Result {
    let parameters: Vec<String> = one
        .parameters
        .iter()
        .map(|parameter| {
            let Interval { value, ci95: [low, high] } = parameter.estimate;
            format!("{} {value:.4} ({low:.4} to {high:.4})", parameter.name)
        })
        .collect();
    let parameter_text =
        one.at.as_ref().map_or_else(String::new, |(name, value)| format!(" at {name} {value}"));
    let when = match (one.kind, &one.began, &one.began_ci95) {
        (SharedKind::Step, Some(date), Some([from, to])) => format!(", since {date} ({from} to {to})"),
        (SharedKind::Trend, Some(date), _) => format!(", growing since {date}; value on the last date"),
        _ => String::new(),
    };
    writeln!(
        f,
        "shared       {}: {}{parameter_text}: {}{when}; {} sessions, log evidence {:+.1}",
        place(&one.label, &one.group),
        one.effect,
        parameters.join(", "),
        one.sessions,
        one.log_evidence
    )?;
    writeln!(
        f,
        "             held out: chi-square {:+.1} in {} sessions; p {:.1e} over all tests",
        one.held_out.misfit_change_chi2, one.held_out.sessions, one.p_adjusted
    )?;
    for other in &one.class {
        writeln!(
            f,
            "             or {}: {} (log evidence {:+.1})",
            place(&other.label, &other.group),
            other.effect,
            other.log_evidence
        )?;
    }
    Ok(())
}
