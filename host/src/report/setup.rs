//! Available data: needle, rig, sensors, and every run with what it was recorded with.

use super::page::{Block, Outcome, Section, count, number, value, word, words};
use formats::session::{LateralRun, Provenance, Session};
use inference::holds::{HoldCriteria, holds};
use mechanics::Guides;

/// Needle, rig and runs.
pub(super) fn section(session: &Session) -> Section {
    let mut blocks = vec![rig(session)];
    if let Some(runs) = runs(session) {
        blocks.push(runs);
    } else {
        blocks.push(Block::Text("The session has no runs.".to_owned()));
    }
    blocks.extend(recorded_with(session));
    Section { id: "setup", title: "Rig and runs", content: Outcome::Found(blocks) }
}

fn rig(session: &Session) -> Block {
    let (rig, noise) = (&session.rig, &session.noise);
    let needle = &rig.needle;
    let mut rows = Vec::new();
    let of_needle = if needle.stiffness_known { "needle" } else { "reference needle (stiffness not known)" };
    rows.push(rig_row(
        &format!("{of_needle}, Young's modulus"),
        value(Some(1e-9 * needle.youngs_modulus_pa), 1),
        "GPa",
    ));
    rows.push(rig_row(
        &format!("{of_needle}, outer diameter"),
        mm_text(Some(needle.outer_diameter_m), 3),
        "mm",
    ));
    rows.push(rig_row(
        &format!("{of_needle}, inner diameter"),
        mm_text(Some(needle.inner_diameter_m), 3),
        "mm",
    ));
    match rig.guides {
        Guides::Two => {
            rows.push(rig_row("guide 2, from guide 1", mm_text(Some(rig.guide2_m), 1), "mm"));
            rows.push(rig_row("tissue surface, from guide 1", mm_text(Some(rig.entry_m), 1), "mm"));
        }
        Guides::One { rear_rotation_n_m_per_rad } => {
            rows.push(rig_row("tissue surface, from the only guide", mm_text(Some(rig.entry_m), 1), "mm"));
            for (plane, stiffness) in ["vertical", "horizontal"].into_iter().zip(rear_rotation_n_m_per_rad) {
                let stiffness =
                    stiffness.map_or("not known".to_owned(), |stiffness| value(Some(stiffness), 2));
                rows.push(rig_row(&format!("rotation of the needle's rear, {plane}"), stiffness, "N m/rad"));
            }
        }
    }
    let stated = [
        ("needle, length", needle.length_m.map(|m| 1e3 * m), 1, "mm"),
        ("needle, bevel angle", needle.bevel_angle_rad.map(f64::to_degrees), 1, "degrees"),
        ("fixture, mass", session.fixture_mass_kg, 3, "kg"),
        ("noise of a force reading, stated", noise.force_n, 4, "N"),
        ("noise of a displacement reading, stated", noise.displacement_m.map(|m| 1e3 * m), 4, "mm"),
        ("noise of a deflection reading, stated", noise.shape_m.map(|m| 1e3 * m), 4, "mm"),
        ("noise of a tip reading, stated", noise.tip_m.map(|m| 1e3 * m), 4, "mm"),
        ("noise of a tip direction, stated", noise.tip_direction_rad.map(|rad| 1e3 * rad), 3, "mrad"),
    ];
    let stated = stated.into_iter().filter(|(_, found, ..)| found.is_some());
    rows.extend(stated.map(|(name, found, digits, unit)| rig_row(name, value(found, digits), unit)));
    Block::table("Needle, rig and sensors", [words("quantity"), number("value"), words("unit")], rows)
}

fn rig_row(name: &str, value: String, unit: &str) -> Vec<String> {
    vec![name.to_owned(), value, unit.to_owned()]
}

fn mm_text(m: Option<f64>, digits: usize) -> String {
    value(m.map(|m| 1e3 * m), digits)
}

/// Every run; `None` where there is none.
fn runs(session: &Session) -> Option<Block> {
    let mut rows = Vec::new();
    for run in &session.lateral {
        let holds = holds(run, &HoldCriteria::default()).len();
        let depth_mm = 1e3 * run.depth_m;
        rows.push(run_row(
            &run.id,
            "lateral",
            depth_mm,
            run.force.time_s.len(),
            holds.to_string(),
            gaps(run),
        ));
    }
    for run in &session.insertion {
        rows.push(run_row(
            &run.id,
            "insertion",
            deepest_mm(&run.depth_m),
            run.depth_m.len(),
            no_value(),
            no_value(),
        ));
    }
    for run in &session.steering {
        rows.push(run_row(
            &run.id,
            "steering",
            deepest_mm(&run.depth_m),
            run.depth_m.len(),
            no_value(),
            no_value(),
        ));
    }
    for run in &session.indentation {
        rows.push(run_row(
            &run.id,
            "indentation",
            deepest_mm(&run.depth_m),
            run.depth_m.len(),
            no_value(),
            no_value(),
        ));
    }
    let columns = [
        words("run"),
        words("kind"),
        number("depth, mm"),
        number("samples"),
        number("holds"),
        number("gaps"),
    ];
    (!rows.is_empty()).then(|| Block::table("Runs", columns, rows))
}

fn no_value() -> String {
    "-".to_owned()
}

fn run_row(id: &str, kind: &str, depth_mm: f64, samples: usize, holds: String, lost: String) -> Vec<String> {
    let numbers = [value(Some(depth_mm), 1), samples.to_string(), holds, lost];
    [id.to_owned(), kind.to_owned()].into_iter().chain(numbers).collect::<Vec<_>>()
}

fn deepest_mm(depths_m: &[f64]) -> f64 {
    1e3 * depths_m.iter().copied().fold(0.0, f64::max)
}

/// Gaps of a recording and the samples lost in them, where the recorder counted them.
fn gaps(run: &LateralRun) -> String {
    let Some(lost) = &run.force.lost_before else { return "-".to_owned() };
    let gaps = lost.iter().filter(|lost| **lost > 0.0).count();
    match gaps {
        0 => "none".to_owned(),
        _ => format!("{gaps}, {} lost", count(lost.iter().sum::<f64>() as usize, "sample")),
    }
}

/// Rig and program of each run; `None` if no run states them.
fn recorded_with(session: &Session) -> Option<Block> {
    let runs_with_provenance = session.lateral.iter().filter(|run| run.provenance != Provenance::default());
    let rows: Vec<Vec<String>> = runs_with_provenance
        .map(|run| {
            let Provenance { calibration_id, calibration_crc, device, firmware, tared } = &run.provenance;
            let crc = calibration_crc.map_or("-".to_owned(), |crc| format!("{crc:08x}"));
            let tared = tared.map_or("-", |tared| if tared { "yes" } else { "no" });
            vec![
                run.id.clone(),
                word_or_dash(calibration_id),
                crc,
                word_or_dash(firmware),
                word_or_dash(device),
                tared.to_owned(),
            ]
        })
        .collect();
    let columns = [
        words("run"),
        words("calibration"),
        words("its CRC-32"),
        words("firmware"),
        words("device"),
        words("force tared"),
    ];
    (!rows.is_empty()).then(|| Block::table("What the runs were recorded with", columns, rows))
}

fn word_or_dash(text: &Option<String>) -> String {
    word(text.as_deref())
}
