//! Reports of simulated sessions: the numbers of the analyses, every missing part, names that are no HTML, the same bytes twice.

use super::origin::FileSum;
use super::*;
use formats::session::{IndentationRun, InsertionRun, Noise, SteeringRun};
use mechanics::{Needle, Rig};
use quick_xml::Reader;
use quick_xml::events::Event;
use std::collections::BTreeSet;
use std::path::PathBuf;
use worlds::{Design, Truth, session};

fn origin() -> Origin {
    Origin {
        command: "guide report simulated --until 50".to_owned(),
        date: "2025-03-01".to_owned(),
        files: vec![FileSum { name: "session.toml".to_owned(), bytes: 12, sha256: "00ff".repeat(16) }],
    }
}

fn empty() -> Session {
    Session {
        dir: PathBuf::from("simulated"),
        name: None,
        rig: Rig::two_guides(Needle::gauge_18(), 0.06, 0.07),
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
        lateral: Vec::new(),
        insertion: Vec::new(),
        indentation: Vec::new(),
        steering: Vec::new(),
    }
}

fn html_of(session: &Session) -> String {
    let analyses = Analyses::of(session, &Options::default(), |_| {});
    let html = Report::new(session, &analyses, &origin()).html();
    assert_sound(&html);
    html
}

/// Well-formed, in one piece, small, and every colour of its figures is one that the page can change.
#[track_caller]
fn assert_sound(html: &str) {
    assert!(html.len() < 2_000_000, "{} bytes", html.len());
    for outside in ["<script", "http-equiv", "@import", "url(", "src=", "<link"] {
        assert!(!html.contains(outside), "{outside}");
    }
    let mut reader = Reader::from_str(html);
    // Only the void elements of HTML have no end.
    reader.config_mut().check_end_names = false;
    let (mut open, mut colours, mut headings) = (Vec::new(), BTreeSet::new(), Vec::new());
    loop {
        match reader.read_event().expect("well-formed") {
            Event::Start(tag) | Event::Empty(tag) if tag.name().as_ref() == "meta" => {}
            Event::Start(tag) => {
                let name = tag.name().as_ref().to_owned();
                for attribute in tag.attributes() {
                    attribute.expect("a name and a value, once");
                }
                if let Some(level) = name.strip_prefix('h').and_then(|level| level.parse::<u32>().ok()) {
                    headings.push(level);
                }
                open.push(name);
            }
            Event::End(tag) => {
                let name = tag.name().as_ref().to_owned();
                assert_eq!(open.pop(), Some(name));
            }
            Event::Empty(tag) => {
                for attribute in tag.attributes() {
                    let attribute = attribute.expect("a name and a value, once");
                    let name = attribute.key.as_ref().to_owned();
                    let value = attribute.value.into_owned();
                    if value.starts_with('#') && matches!(name.as_str(), "fill" | "stroke") {
                        colours.insert(format!("[{name}=\"{value}\"]"));
                    }
                }
            }
            Event::Eof => break,
            _ => {}
        }
    }
    assert_eq!(open, Vec::<String>::new());
    assert_eq!(headings.first(), Some(&1));
    assert!(headings.windows(2).all(|pair| pair[1] <= pair[0] + 1), "{headings:?}");
    let style = include_str!("style.css");
    let plain: Vec<_> = colours.iter().filter(|colour| !style.contains(*colour)).collect();
    assert!(plain.is_empty(), "colours without a rule: {plain:?}");
    assert_eq!(html.matches("<svg ").count(), html.matches("role=\"img\"").count());
}

#[track_caller]
fn assert_has(html: &str, parts: &[&str]) {
    for part in parts {
        assert!(html.contains(part), "{part} is not in the report");
    }
}

fn truth() -> Truth {
    let effects = vec![("tip.rate", vec![0.02])];
    Truth { k_kpa: 12.0, tip_load_n: 0.2, effects, foreign: None }
}

/// With lateral runs and insertions.
#[test]
fn a_report_has_the_numbers_of_the_analyses() {
    let mut session = session(&truth(), &Design::insertions(), 4);
    session.name = Some("phantom A".to_owned());
    let analyses = Analyses::of(&session, &Options::default(), |_| {});
    let html = Report::new(&session, &analyses, &origin()).html();
    assert_sound(&html);

    let identification = analyses.identification.found().expect("identified");
    let [low, high] = identification.pooled.ci95_kpa;
    let k = format!("{:.2} ({low:.2} to {high:.2})", identification.pooled.k_kpa);
    let youngs = format!("{:.2} (", identification.youngs_modulus_kpa.value.unwrap_or(f64::NAN));
    assert_has(&html, &["phantom A", &k, &youngs, "by continuum", "Poisson"]);
    for run in &identification.runs {
        let k_kpa = run.methods.likelihood_without_force.k_kpa.expect("a modulus");
        assert_has(&html, &[&run.id, &format!(">{k_kpa:.2} (")]);
    }
    let predicted = analyses.prediction.found().expect("predicted");
    for one in &predicted.insertions {
        assert_has(&html, &[&one.id, &format!(">{:.3}<", one.tip_force_n.expect("a load"))]);
        assert_has(&html, &[&format!(">{:.2}<", one.mae_mm.expect("measured"))]);
    }
    let diagnosed = analyses.diagnosis.found().expect("diagnosed");
    let [low, high] = diagnosed.k_ci95_kpa;
    let k = format!("{:.2} ({low:.2} to {high:.2})", diagnosed.k_kpa);
    assert_has(&html, &[diagnosed.verdict.explained(), &k, "tip.rate", "the model lacks tip.rate"]);
    assert_has(&html, &["Skipped: the session has no steering runs.", "00ff00ff", "2025-03-01"]);
    assert!(html.matches("<figure>").count() > identification.runs.len() * 3 + predicted.insertions.len());
    assert!(html.find("Warnings") < html.find("Summary"), "warnings come first");
}

#[test]
fn names_from_files_are_text() {
    let evil = "<script>alert(\"x\")</script> & 'y' ]]> \u{1}\u{7f}";
    let mut session = session(&Truth { effects: vec![], ..truth() }, &Design::four_runs(), 1);
    session.name = Some(evil.to_owned());
    for run in &mut session.lateral {
        run.id = format!("{evil}{}", run.id);
        run.provenance.calibration_id = Some(evil.to_owned());
        run.provenance.calibration_crc = Some(0x2a);
        run.provenance.firmware = Some("0.1.0 (1a2b3c4)".to_owned());
    }
    session.lateral[0].provenance.calibration_crc = Some(0x1a2b_3c4d);
    session.lateral[0].force.lost_before = Some(vec![3.0]);
    let html = html_of(&session);
    assert_has(&html, &["&lt;script&gt;alert(", "0000002a", "0.1.0 (1a2b3c4)", "1, 3 samples lost"]);
    assert_has(&html, &["runs were recorded with different calibrations"]);
    assert!(!html.contains('\u{1}') && !html.contains("alert(\"x\")</script>"));
}

#[test]
fn what_a_session_does_not_have_is_skipped() {
    let html = html_of(&empty());
    for what in ["lateral runs", "insertions", "steering runs"] {
        assert_has(&html, &[&format!("Skipped: the session has no {what}.")]);
    }
    assert_has(&html, &["neither lateral runs nor insertions", "There is no result", "simulated"]);
    assert!(!html.contains("<figure>") && !html.contains("id=\"warnings\""));
}

/// A session of nothing but runs that no analysis can use.
#[test]
fn what_fails_is_reported_in_its_section() {
    let mut bad = empty();
    let path = PathBuf::from("x.csv");
    let (id, no_values) = ("x".to_owned(), None::<Vec<f64>>);
    bad.insertion.push(InsertionRun {
        id: id.clone(),
        path: path.clone(),
        depth_m: vec![0.0],
        tip_y_m: vec![0.0],
        tip_x_m: no_values.clone(),
        time_s: no_values.clone(),
        rotation_rad: no_values.clone(),
        guide2_y_m: no_values.clone(),
        guide2_x_m: no_values.clone(),
        base_force_y_n: no_values.clone(),
        tip_direction_y_rad: no_values.clone(),
        tip_direction_x_rad: no_values,
    });
    bad.steering.push(SteeringRun {
        id: id.clone(),
        path: path.clone(),
        time_s: list(),
        depth_m: list(),
        base_y_m: list(),
        base_force_y_n: list(),
        tip_y_m: list(),
    });
    let indentation = IndentationRun {
        id,
        path,
        indenter: Default::default(),
        half_angle_rad: None,
        indenter_radius_m: 2e-3,
        tissue_thickness_m: None,
        poisson: 0.5,
        depth_m: list(),
        force_n: list(),
    };
    bad.indentation.push(indentation);
    let analyses = Analyses::of(&bad, &Options::default(), |_| {});
    let failures = analyses.failures();
    let sections: Vec<_> = failures.iter().filter_map(|failure| failure.split(' ').next()).collect();
    assert_eq!(sections, ["prediction", "tracking", "diagnosis"], "{failures:?}");
    let html = html_of(&bad);
    assert_has(
        &html,
        &["Failed: ", "[needle] length_mm: missing", "no insertion can be predicted", "indentation"],
    );
    assert_has(&html, &["id=\"warnings\""]);
}

fn list() -> Vec<f64> {
    vec![0.0, 0.001]
}

#[test]
fn days_are_given_or_those_of_files() {
    assert_eq!("today".parse(), Ok(Day::Today));
    assert!(matches!("2024-02-29".parse(), Ok(Day::Given(_))));
    for wrong in ["", "2023-02-29", "yesterday", "2024-02-29T25:00"] {
        assert!(wrong.parse::<Day>().is_err(), "{wrong}");
    }
}

#[test]
fn many_points_are_thinned() {
    let points: Vec<usize> = (0..1001).collect();
    let thinned_points = page::thinned(&points, 100);
    assert!(
        thinned_points.len() <= 100 && thinned_points.len() > 80 && thinned_points[0] == 0,
        "{}",
        thinned_points.len()
    );
    assert_eq!(page::thinned(&points, 2000), points);
    assert!(page::thinned(&points, 0).len() <= 1);
}
