//! Needle, guides and noise in a session file.

use super::Noise;
use super::schema::SD_MM;
use crate::document::{Fields, Problem, SessionError};
use mechanics::{Guides, Needle, Rig, Tolerances};

const MM: f64 = 1e-3;
const OUTER_MM: [f64; 2] = [0.05, 10.0];
const INNER_MM: [f64; 2] = [0.0, 10.0];
const MODULUS_GPA: [f64; 2] = [0.1, 1000.0];
/// Moment per slope of a needle's rear: from next to nothing to more than any needle takes.
const ROTATION_N_M_PER_RAD: [f64; 2] = [1e-4, 1e4];
/// A guide or a surface whose place is not known to a centimetre, and a diameter not to a millimetre, are not measured.
const LARGEST_PLACE_ERROR_MM: f64 = 10.0;
const LARGEST_DIAMETER_ERROR_MM: f64 = 1.0;
/// Uncertainty of a parameter that is not exactly known.
const UNKNOWN: &str = "unknown";

pub(super) fn rig(file: &Fields<'_>) -> Result<Rig, SessionError> {
    let needle = needle(file)?;
    let [guide2_m, entry_m] = guides_m(file)?;
    Ok(Rig { needle, guide2_m, entry_m, guides: guides(file)?, tolerances: tolerances(file)? })
}

/// A standard deviation, if it is stated, from millimetres.
fn sd_m(table: &Fields<'_>, field: &str, range_mm: [f64; 2]) -> Result<Option<f64>, SessionError> {
    Ok(table.optional_number(field, range_mm)?.map(|sd_mm| MM * sd_mm))
}

/// Uncertainty of needle and guides, if it is stated.
pub(super) fn tolerances(file: &Fields<'_>) -> Result<Tolerances, SessionError> {
    let (needle, rig) = (file.table("needle")?, file.table("rig")?);
    Ok(Tolerances {
        guide2_m: sd_m(&rig, "guide2_sd_mm", [1e-4, LARGEST_PLACE_ERROR_MM])?,
        entry_m: sd_m(&rig, "entry_sd_mm", [1e-4, LARGEST_PLACE_ERROR_MM])?,
        outer_diameter_m: sd_m(&needle, "outer_diameter_sd_mm", [1e-4, LARGEST_DIAMETER_ERROR_MM])?,
        inner_diameter_m: sd_m(&needle, "inner_diameter_sd_mm", [1e-4, LARGEST_DIAMETER_ERROR_MM])?,
    })
}

pub(super) fn needle(file: &Fields<'_>) -> Result<Needle, SessionError> {
    let needle = file.table("needle")?;
    let stiffness_known = !is_unknown(&needle, "bending_stiffness")?;
    let (outer_mm, inner_mm, modulus_gpa) = if stiffness_known {
        let outer_mm = needle.number("outer_diameter_mm", OUTER_MM)?;
        (
            outer_mm,
            needle.number("inner_diameter_mm", INNER_MM)?,
            needle.number("youngs_modulus_gpa", MODULUS_GPA)?,
        )
    } else {
        // Results refer to the usual needle then, or to one of the stated diameter that is as hollow.
        let usual = Needle::gauge_18();
        let hollow = usual.inner_diameter_m / usual.outer_diameter_m;
        let outer_mm = needle.optional_number("outer_diameter_mm", OUTER_MM)?;
        let hollow_mm = outer_mm.map_or(1e3 * usual.inner_diameter_m, |outer_mm| hollow * outer_mm);
        let outer_mm = outer_mm.unwrap_or(1e3 * usual.outer_diameter_m);
        let inner_mm = needle.optional_number("inner_diameter_mm", INNER_MM)?.unwrap_or(hollow_mm);
        let modulus_gpa = needle.optional_number("youngs_modulus_gpa", MODULUS_GPA)?;
        (outer_mm, inner_mm, modulus_gpa.unwrap_or(1e-9 * usual.youngs_modulus_pa))
    };
    if inner_mm >= outer_mm {
        let expected = format!("less than the outer diameter of {outer_mm} mm");
        return Err(needle.field_fault("inner_diameter_mm", Problem::OutOfRange(inner_mm), expected));
    }
    Ok(Needle {
        youngs_modulus_pa: 1e9 * modulus_gpa,
        outer_diameter_m: MM * outer_mm,
        inner_diameter_m: MM * inner_mm,
        bevel_angle_rad: needle.optional_number("bevel_angle_deg", [0.0, 90.0])?.map(f64::to_radians),
        length_m: needle.optional_number("length_mm", [10.0, 2000.0])?.map(|length_mm| MM * length_mm),
        stiffness_known,
    })
}

/// Whether a field states that something is not known; no other text is valid there.
fn is_unknown(fields: &Fields<'_>, field: &str) -> Result<bool, SessionError> {
    match fields.optional_text(field)? {
        None => Ok(false),
        Some(text) if text == UNKNOWN => Ok(true),
        Some(text) => Err(fields.field_fault(
            field,
            Problem::Unknown(text.chars().take(40).collect()),
            format!("\"{UNKNOWN}\", or Young's modulus and diameters instead of this field"),
        )),
    }
}

/// Guide 2 and the tissue's surface.
pub(super) fn guides_m(file: &Fields<'_>) -> Result<[f64; 2], SessionError> {
    let rig = file.table("rig")?;
    let guide2_mm = match count(&rig)? {
        1 => match rig.optional_number("guide2_mm", [0.0, 1000.0])? {
            Some(guide2_mm) if guide2_mm != 0.0 => {
                let expected = "0 or nothing, as positions are measured from the only guide";
                return Err(rig.field_fault("guide2_mm", Problem::OutOfRange(guide2_mm), expected));
            }
            _ => 0.0,
        },
        _ => rig.number("guide2_mm", [1.0, 1000.0])?,
    };
    let entry_mm = rig.number("entry_mm", [1.0, 1000.0])?;
    if entry_mm < guide2_mm {
        let expected = format!("at least guide2_mm, {guide2_mm}");
        return Err(rig.field_fault("entry_mm", Problem::OutOfRange(entry_mm), expected));
    }
    Ok([MM * guide2_mm, MM * entry_mm])
}

/// Number of guides.
fn count(rig: &Fields<'_>) -> Result<usize, SessionError> {
    Ok(rig.optional_whole("guides", [1.0, 2.0])?.map_or(2, |count| count as usize))
}

/// Mounting of the needle.
pub(super) fn guides(file: &Fields<'_>) -> Result<Guides, SessionError> {
    const FIELDS: [&str; 2] = ["rear_rotation_y_n_m_per_rad", "rear_rotation_x_n_m_per_rad"];
    let rig = file.table("rig")?;
    let has_one_guide = count(&rig)? == 1;
    let mut stiffness = [None; 2];
    for (field, stiffness) in FIELDS.into_iter().zip(&mut stiffness) {
        if !rig.names().any(|name| name == field) {
            continue;
        }
        if !has_one_guide {
            let problem = Problem::Unknown(field.to_owned());
            return Err(rig.field_fault(field, problem, "nothing here, or guides = 1: guide 1 is a clamp"));
        }
        *stiffness = match rig.optional_text(field) {
            Ok(_) => {
                is_unknown(&rig, field)?;
                None
            }
            Err(_) => Some(rig.number(field, ROTATION_N_M_PER_RAD)?),
        };
    }
    Ok(if has_one_guide { Guides::One { rear_rotation_n_m_per_rad: stiffness } } else { Guides::Two })
}

pub(super) fn fixture_mass_kg(file: &Fields<'_>) -> Result<Option<f64>, SessionError> {
    file.table("rig")?.optional_number("fixture_mass_kg", [0.0, 100.0])
}

pub(super) fn noise(file: &Fields<'_>) -> Result<Noise, SessionError> {
    let Some(noise) = file.optional_table("noise")? else { return Ok(Noise::default()) };
    Ok(Noise {
        force_n: noise.optional_number("force_n", [1e-9, 100.0])?,
        force_zero_n: noise.optional_number("force_zero_n", [1e-9, 100.0])?,
        displacement_m: sd_m(&noise, "displacement_mm", SD_MM)?,
        shape_m: sd_m(&noise, "shape_mm", SD_MM)?,
        tip_m: sd_m(&noise, "tip_mm", SD_MM)?,
        tip_direction_rad: noise.optional_scaled("tip_direction_mrad", [1e-6, 1000.0], -3)?,
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Session, SessionWriter, Setup};
    use super::*;
    use std::fs;
    use std::path::Path;

    const NEEDLE: &str =
        "[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\ninner_diameter_mm = 1.0\n";

    fn setup(text: &str) -> Result<Setup, String> {
        Setup::parse(Path::new("rig.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn reads_a_rig_with_one_guide() {
        fn read(rest: &str) -> Result<Setup, String> {
            setup(&format!("{NEEDLE}[rig]\nguides = 1\nentry_mm = 28.0\n{rest}"))
        }
        let rig = read("rear_rotation_y_n_m_per_rad = 2.5\n").expect("reads").rig;
        assert_eq!(rig.guides, Guides::One { rear_rotation_n_m_per_rad: [Some(2.5), None] });
        assert_eq!((rig.guide2_m, rig.entry_m), (0.0, 0.028));
        rig.validate().expect("a rig");
        assert_eq!(rig.rear_compliance_rad_per_n_m(0), 0.4);
        let rig = read("rear_rotation_x_n_m_per_rad = \"unknown\"\nguide2_mm = 0\n").expect("reads").rig;
        assert_eq!(rig.guides, Guides::One { rear_rotation_n_m_per_rad: [None, None] });
        for (rest, expected) in [
            ("rear_rotation_y_n_m_per_rad = 0.0\n", "rear_rotation_y_n_m_per_rad: 0 is out of range"),
            ("rear_rotation_y_n_m_per_rad = \"soft\"\n", "\"soft\" is not known, expected \"unknown\""),
            ("guide2_mm = 60.0\n", "guide2_mm: 60 is out of range, expected 0 or nothing"),
        ] {
            let refused = read(rest).expect_err("refused");
            assert!(refused.contains(expected), "{refused}");
        }
        let two = setup(&format!(
            "{NEEDLE}[rig]\nguide2_mm = 60\nentry_mm = 70\nrear_rotation_y_n_m_per_rad = 1.0\n"
        ));
        assert!(two.expect_err("refused").contains("guide 1 is a clamp"));
        let three = setup(&format!("{NEEDLE}[rig]\nguides = 3\nguide2_mm = 60\nentry_mm = 70\n"));
        assert!(three.expect_err("refused").contains("rig.guides: 3 is out of range"));
    }

    #[test]
    fn reads_a_needle_of_unknown_stiffness() {
        fn read(needle: &str) -> Result<Setup, String> {
            setup(&format!("[needle]\n{needle}[rig]\nguide2_mm = 60\nentry_mm = 70\n"))
        }
        let needle = read("bending_stiffness = \"unknown\"\n").expect("reads").rig.needle;
        assert_eq!(needle, Needle { stiffness_known: false, ..Needle::gauge_18() });
        let thick =
            read("bending_stiffness = \"unknown\"\nouter_diameter_mm = 2.54\n").expect("reads").rig.needle;
        assert!((thick.inner_diameter_m - 2e-3).abs() < 1e-12 && !thick.stiffness_known);
        assert!(
            read("bending_stiffness = \"none\"\n")
                .expect_err("refused")
                .contains("expected \"unknown\", or Young's")
        );
        assert!(read("").expect_err("refused").contains("needle.outer_diameter_mm: missing"));
    }

    /// The written table is the one that is read, and a session takes no run of another kind of
    /// rig.
    #[test]
    fn rigs_of_others_are_written_as_they_are_read() {
        let text = "[session]\nformat = 1\n[needle]\nbending_stiffness = \"unknown\"\n[rig]\nguides = 1\nentry_mm = 28.0\n\
                    rear_rotation_x_n_m_per_rad = 0.75\n[noise]\ntip_direction_mrad = 0.8\n";
        let stated = setup(text).expect("reads");
        let dir = tempfile::tempdir().expect("a folder");
        SessionWriter::open(dir.path(), &stated).expect("writes");
        let read = Session::read(dir.path()).expect("reads");
        assert_eq!((&read.rig, read.noise), (&stated.rig, stated.noise));
        SessionWriter::open(dir.path(), &stated).expect("the same rig");
        for (from, to) in [
            ("guides = 1", "guides = 2\nguide2_mm = 20.0"),
            ("\"unknown\"", "\"unknown\"\nyoungs_modulus_gpa = 70.0"),
            ("0.75", "0.5"),
        ] {
            let changed_rig = text.replace(from, to);
            let expected_rig = if from.starts_with("guides") {
                changed_rig.replace("rear_rotation_x_n_m_per_rad = 0.75\n", "")
            } else {
                changed_rig
            };
            assert!(SessionWriter::open(dir.path(), &setup(&expected_rig).expect("reads")).is_err(), "{to}");
        }
        assert!(fs::read_to_string(dir.path().join("session.toml")).expect("text").contains("guides = 1"));
    }
}
