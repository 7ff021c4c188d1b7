//! Prediction of the next session by a population, as a file: `prior.toml`.
//!
//! ```toml
//! [prior]
//! format = 1
//! sessions = 40
//! by = ["tissue"]
//! [[modulus]]                       # K of a session of a new subject of a group
//! group = "liver"
//! sessions = 20
//! k_kpa = 5.2                       # median
//! ln_k_sd = 0.14                    # scale of ln K: between subjects and sessions, and of the mean
//! degrees_of_freedom = 18           # of a t-distribution
//! prediction95_kpa = [3.9, 7.0]
//! [[tip]]
//! needle = "18g"                    # where it is stated; tissue too
//! sessions = 20
//! load_n = 0.21
//! load_sd_n = 0.04
//! [discrepancy]                     # medians, as multiples of those of an ordinary rig
//! "smooth shape error" = 1.1
//! ```

use crate::results::Population;
use statrs::distribution::{ContinuousCDF, StudentsT};
use std::fmt::Write as _;

/// The prior of the next session that a population makes, as a TOML text; groups without a prediction are skipped.
pub fn prior_toml(population: &Population) -> String {
    let quoted_names: Vec<String> = population.by.iter().map(|name| quoted(name)).collect();
    let mut text = format!(
        "[prior]\nformat = 1\nsessions = {}\nby = [{}]\n",
        population.sessions.used,
        quoted_names.join(", ")
    );
    for group in &population.groups {
        let Some([low, high]) = group.new_session95_kpa else { continue };
        let Some(freedom) = group.new_session_degrees_of_freedom else { continue };
        let Ok(t) = StudentsT::new(0.0, 1.0, freedom) else { continue };
        // The t-distribution whose interval is the predicted one.
        let ln_k_sd = 0.5 * (high / low).ln() / t.inverse_cdf(0.975);
        let [ln_k, _] = group.ln_k;
        let _ = write!(
            text,
            "\n[[modulus]]\ngroup = {}\nsessions = {}\nk_kpa = {:?}\nln_k_sd = {ln_k_sd:?}\ndegrees_of_freedom = {freedom:.1}\n\
             prediction95_kpa = [{low:?}, {high:?}]\n",
            quoted(&group.group),
            group.sessions,
            ln_k.exp(),
        );
    }
    // One session alone does not determine by how much the next one differs.
    let spread = population.tip_load.iter().filter_map(|tip| tip.between_n.map(|between_n| (tip, between_n)));
    for (tip, between_n) in spread {
        let _ = write!(text, "\n[[tip]]\n");
        for (name, value) in [("needle", &tip.needle), ("tissue", &tip.tissue)] {
            value.iter().for_each(|value| {
                let _ = writeln!(text, "{name} = {}", quoted(value));
            });
        }
        let [low, high] = tip.load_n.ci95;
        let se = (high - low) / (2.0 * crate::normal_975());
        let _ = write!(
            text,
            "sessions = {}\nload_n = {:?}\nload_sd_n = {:?}\n",
            tip.sessions,
            tip.load_n.value,
            between_n.hypot(se)
        );
    }
    if !population.discrepancy.is_empty() {
        text.push_str("\n[discrepancy]\n");
    }
    for (name, multiple) in &population.discrepancy {
        let _ = writeln!(text, "{} = {multiple:?}", quoted(name));
    }
    text
}

fn quoted(text: &str) -> String {
    serde_json::Value::from(text).to_string()
}
