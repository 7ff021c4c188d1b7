//! The record of a session for statistics over many sessions, `needle.summary/1`.

use diagnose::{
    Diagnosis, EffectAmplitude, INCOMPRESSIBLE, Linearisation, Options, ScaleKind, Verdict,
    diagnose_and_linearise,
};
use formats::NORMAL_975;
use formats::session::{Covariate, Labels, Session, SessionError};
use population::{Amplitude, Interval, NamedEffect, SessionResult, Summary, Value};
use std::path::Path;

/// Number of digits of derived quantities: enough for every interval.
const DIGITS: usize = 6;

/// The record of the session in a folder. A failed part states its `error` in the record, so that one session does not stop the
/// others.
pub fn summarize(dir: &Path, seed: u64) -> Summary {
    let id = dir.display().to_string();
    match (Session::read(dir), Labels::read(dir)) {
        (Ok(session), Ok(labels)) => summarize_session(id, &session, &labels, seed),
        (session, labels) => failed(id, session.err().as_ref().or(labels.as_ref().err())),
    }
}

/// The record of a session that cannot be read.
fn failed(id: String, error: Option<&SessionError>) -> Summary {
    Summary { error: error.map(ToString::to_string), ..Summary::empty(id) }
}

/// The record of a session in memory.
pub fn summarize_session(id: String, session: &Session, labels: &Labels, seed: u64) -> Summary {
    let options = Options {
        seed,
        foundation: session.tissue.foundation.into(),
        poisson: session.tissue.poisson.unwrap_or(INCOMPRESSIBLE),
        ..Options::default()
    };
    let diagnosis = diagnose_and_linearise(session, &options, |_| {});
    let (result, error) = match diagnosis {
        Ok((diagnosis, linearised)) => (Some(result(&diagnosis, &linearised)), None),
        Err(error) => (None, Some(error.to_string())),
    };
    Summary {
        name: labels.name.clone(),
        date: labels.date.map(|date| date.to_string()),
        site: labels.site.clone(),
        subject: labels.subject.clone(),
        rig: labels.rig.clone(),
        needle: labels.needle.clone(),
        tissue: labels.tissue.clone(),
        covariates: labels
            .covariates
            .iter()
            .map(|(name, value)| (name.clone(), covariate_value(value)))
            .collect(),
        error,
        result,
        ..Summary::empty(id)
    }
}

fn covariate_value(value: &Covariate) -> Value {
    match value {
        Covariate::Number(number) => Value::Number(*number),
        Covariate::Text(text) => Value::Text(text.clone()),
    }
}

fn result(found: &Diagnosis, linearised: &Linearisation) -> SessionResult {
    let [low, high] = found.k_ci95_kpa;
    let (ln_modulus_pa, ln_modulus_sd) = linearised.ln_modulus_pa;
    let half_width = 0.5 * (high / low).ln();
    let (ln_k_kpa, ln_k_sd) = match found.verdict {
        // The interval spans the values of competing effects, so that its ends are as likely as its middle.
        Verdict::Ambiguous => (0.5 * (high * low).ln(), half_width),
        _ => (found.k_kpa.ln(), half_width / NORMAL_975),
    };
    let named = found.effects.iter().map(|effect| NamedEffect {
        id: effect.id.clone(),
        parameters: effect
            .parameters
            .iter()
            .map(|(name, at)| {
                let ci95 = at.ci95.map(rounded);
                (name.clone(), Interval { value: rounded(at.value), ci95 })
            })
            .collect(),
        log_evidence: rounded(effect.log_evidence_gain),
        class: effect.class.clone(),
    });
    SessionResult {
        verdict: match found.verdict {
            Verdict::Adequate => "adequate",
            Verdict::Named => "named",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Unexplained => "unexplained",
        }
        .to_owned(),
        foundation: found.foundation.used.to_owned(),
        k_kpa: rounded(found.k_kpa),
        k_ci95_kpa: [rounded(low), rounded(high)],
        ln_k_kpa: rounded(ln_k_kpa),
        ln_k_sd: rounded(ln_k_sd),
        ln_modulus_without_effects: [ln_modulus_pa - 1e3f64.ln(), ln_modulus_sd].map(rounded),
        youngs_modulus_kpa: found.foundation.youngs_modulus_kpa.map(|youngs| rounded(youngs.value)),
        tip_load_n: found.tip_load_n.map(rounded),
        tip_load_ci95_n: found.tip_load_ci95_n.map(|ends| ends.map(rounded)),
        discrepancy: linearised
            .discrepancy
            .iter()
            .map(|(name, multiple)| ((*name).to_owned(), rounded(*multiple)))
            .collect(),
        noise: found.noise.iter().map(|(name, sd)| (name.clone(), rounded(*sd))).collect(),
        named: named.collect(),
        log_evidence: linearised
            .log_evidence
            .iter()
            .map(|(id, gain)| ((*id).to_owned(), rounded(*gain)))
            .collect(),
        amplitudes: linearised.amplitudes.iter().filter_map(amplitude).collect(),
        correlation_per_mille: linearised.correlation_per_mille.clone(),
    }
}

fn amplitude(one: &EffectAmplitude) -> Option<Amplitude> {
    let infos = one.effect.parameters();
    let info = infos.get(one.parameter)?;
    let parameter_value =
        one.place.and_then(|(place, value)| Some((infos.get(place)?.name.to_owned(), rounded(value))));
    Some(Amplitude {
        effect: one.effect.id().to_owned(),
        parameter: info.name.to_owned(),
        at: parameter_value,
        scale: if one.scale == ScaleKind::Log { "log" } else { "linear" }.to_owned(),
        neutral: info.neutral,
        two_sided: info.is_two_sided(),
        prior_sd: rounded(one.prior_sd),
        score: rounded(one.score),
        information: rounded(one.information),
        ln_k_slope: rounded(one.ln_modulus_slope),
    })
}

/// A number rounded to the significant digits.
fn rounded(value: f64) -> f64 {
    if value == 0.0 || !value.is_finite() {
        return value;
    }
    format!("{value:.*e}", DIGITS - 1).parse().unwrap_or(value)
}
