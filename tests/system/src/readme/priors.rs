//! Priors stand in the table of unknowns and in the catalogue of effects, and nowhere else.

use super::sources::sources;
use regex::Regex;

/// Folders in which a prior may be stated: the table, and the catalogue, which is its part for
/// effects.
const TABLE: [&str; 2] = ["host/mechanics/src/unknowns", "host/mechanics/src/effects"];
/// Generators of truths, studies and tests have numbers of their own: one that took them from the table would confirm it.
const GENERATORS: [&str; 5] =
    ["host/simulation/", "host/examples/", "host/benches/", "host/modulus/src/monte_carlo.rs", "tests/"];

/// Constants that have the name of a prior and are none.
const OTHERS: [(&str, &[&str]); 5] = [
    (
        "a distance at which something is decided, or a step of a search, in standard deviations",
        &[
            "host/diagnose/src/characterize/play.rs AROUND_SD",
            "host/diagnose/src/characterize/play.rs GIVEN_SD_MM",
            "host/diagnose/src/characterize/play.rs SHARE_OF_SD",
            "host/diagnose/src/found.rs NEAR_SD",
            "host/diagnose/src/known.rs MOVED_SD",
            "host/diagnose/src/posterior/round.rs MAX_STEP_SD",
            "host/diagnose/src/posterior.rs SAME_SD",
            "host/diagnose/src/posterior/iteration.rs SETTLED_SD",
            "host/diagnose/src/posterior/quantities.rs SLOPE_SD",
            "host/discrepancy/src/evidence/integrated.rs POINT_SD",
            "host/discrepancy/src/fit.rs MAX_STEP_SD",
            "host/discrepancy/src/fit.rs SETTLED_SD",
            "host/identify/src/pool.rs PROFILE_REACH_SD",
            "host/imaging/src/camera.rs MAX_SD_PX",
            "host/imaging/src/sweep/lag.rs MAX_SD_S",
            "host/imaging/src/track.rs GATE_SD",
            "host/inference/src/predict/prior.rs MIN_SD_LN",
            "host/population/src/analysis.rs MAX_LN_K_SD",
            "host/readings/src/holds/median.rs SD_OF_MEDIAN",
            "host/readings/src/holds/motion.rs BEYOND_SD",
            "host/readings/src/holds/sweeps.rs STANDS_SD",
            "host/readings/src/intervals.rs FURTHEST_SD",
            "host/readings/src/intervals.rs PINNED_SD",
            "host/readings/src/lateral.rs FAR_SD",
            "host/readings/src/sequential.rs MOST_SD",
            "host/inference/src/follow/mod.rs SURE_SD",
            "host/steering/src/controller/compare.rs SURE_SD",
            "host/src/screen/steered.rs HALF_BAND_SD",
        ],
    ),
    (
        "what a file or a user may state",
        &[
            "host/formats/src/prior_file.rs SD_LN",
            "host/formats/src/session/schema.rs SD_MM",
            "host/formats/src/session/tissue.rs POISSON_SD",
            "host/suspicions/src/lib.rs DIRECTION_SD_MRAD",
            "host/suspicions/src/lib.rs FORCE_SD_N",
            "host/suspicions/src/lib.rs LENGTH_SD_MM",
        ],
    ),
    (
        "the estimator on the target, which is built without the host's crates",
        &["firmware/estimator/src/filter.rs DAMPING_SD", "firmware/estimator/src/filter.rs LOG_STIFFNESS_SD"],
    ),
    (
        "laws, noise and discrepancy of rigs of others, of which the table of this rig's unknowns states nothing",
        &[
            "host/discrepancy/src/basis.rs SMALLER_SD_LN",
            "host/discrepancy/src/fit.rs `sd: 0.3,`",
            "host/discrepancy/src/lib.rs `everyday: 0.01,`",
            "host/discrepancy/src/noise.rs ODDS_SD",
        ],
    ),
    ("a published method, kept as it was published", &["host/track/src/kalman.rs LOG_SD"]),
];

/// The source without its unit tests, which stand at its end.
fn shipped(text: &str) -> &str {
    let tests = Regex::new(r"#\[cfg\(test\)\]\s+mod \w+ \{").unwrap();
    tests.find(text).map_or(text, |tests| &text[..tests.start()])
}

/// Files that state constants of the program.
fn is_of_the_program(name: &str) -> bool {
    !is_in(&TABLE, name) && !is_in(&GENERATORS, name) && !name.contains("tests") && !name.contains("testing")
}

fn is_in(folders: &[&str], name: &str) -> bool {
    folders.iter().any(|folder| name.starts_with(folder))
}

/// Priors that a source states, by its name: constants, and distributions of numbers in place of entries.
fn stated(name: &str, text: &str) -> Vec<String> {
    let constant = Regex::new(
        r"(?m)^\s*(?:pub(?:\([a-z: ]+\))?\s+)?(?:const|static)\s+([A-Z0-9_]+)\s*:[^=;]*f(?:64|32)[^=]*=",
    )
    .unwrap();
    let is_prior = Regex::new(r"(?:^|_)SD(?:$|_)|PRIOR|TYPICAL|EVERYDAY|EXPECTED").unwrap();
    let literal = Regex::new(
        r"\b(?:(?:prior_)?sd|everyday|modulus_sd_ln|gap_sd_ln):\s*(?:\d*[1-9]|\d+\.\d*[1-9])[\d._e-]*\s*[,}]",
    )
    .unwrap();
    let text = shipped(text);
    let constants = constant.captures_iter(text).map(|of| of[1].to_owned());
    let constants = constants.filter(|constant| is_prior.is_match(constant));
    let literals = literal.find_iter(text).map(|of| format!("`{}`", of.as_str()));
    constants.chain(literals).map(|of| format!("{name} {of}")).collect()
}

#[test]
fn no_other_file_states_a_prior() {
    let mut known_names: Vec<&str> = OTHERS.iter().flat_map(|(_, names)| names.iter().copied()).collect();
    let sources = sources().into_iter().filter(|(name, _)| is_of_the_program(name));
    let mut violations: Vec<String> = sources.flat_map(|(name, text)| stated(&name, &text)).collect();
    violations.retain(|place| match known_names.iter().position(|other| other == place) {
        Some(at) => {
            known_names.swap_remove(at);
            false
        }
        None => true,
    });
    assert!(
        violations.is_empty(),
        "priors outside of the table of unknowns (mechanics::unknowns):\n{}",
        violations.join("\n")
    );
    assert!(known_names.is_empty(), "listed here and not in the source: {}", known_names.join(", "));
}

#[test]
fn a_prior_elsewhere_is_found() {
    let file = "host/diagnose/src/layout.rs";
    assert!(is_of_the_program(file) && !is_of_the_program("host/mechanics/src/unknowns/tip.rs"));
    for prior in [
        "const MODULUS_SD_LN: f64 = 1.5;",
        "    pub(super) const TYPICAL_LOAD_N: f64 = 0.1;",
        "static PRIORS: [f64; 2] = [0.1, 0.2];",
        "let group = Group { name, everyday: 0.01, tail };",
        "Some(Prior { mean: 0.0, sd: 1.5 })",
        "Tissue { gap_sd_ln: 0.7, rear }",
    ] {
        assert_eq!(stated(file, prior).len(), 1, "{prior}");
        assert!(stated(file, &format!("#[cfg(test)]\nmod tests {{\n{prior}\n}}")).is_empty());
    }
    for other in
        ["const STEP_M: f64 = 1e-3;", "Moments { mean: 0.0, sd: 0.0 }", "Prior { mean, sd: rig.sd() }"]
    {
        assert!(stated(file, other).is_empty(), "{other}");
    }
}
