//! Statement of a rig before its first recording: the tables that a session begins with.

use super::hardware::{fixture_mass_kg, noise, rig};
use super::schema::{NEEDLE, NOISE, RIG, TISSUE};
use super::{Noise, Tissue};
use crate::document::{Fields, SessionError, number, read_text};
use mechanics::{Guides, Rig};
use std::fmt::Write as _;
use std::path::Path;

/// Head of a new session.
#[derive(Debug, Clone, PartialEq)]
pub struct Setup {
    /// Name of the session.
    pub name: String,
    /// Needle, guides and tissue surface.
    pub rig: Rig,
    /// Mass of the fixture that moves the needle's base in steering runs, where it is known.
    pub fixture_mass_kg: Option<f64>,
    /// Standard deviations of the sensors, where they are known.
    pub noise: Noise,
    /// Statements about the tissue.
    pub tissue: Tissue,
}

impl Setup {
    /// The tables that a new session begins with.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`]; `path` is where the text is meant for.
    pub fn to_toml(&self, path: &Path) -> Result<String, SessionError> {
        let Self { name, rig, fixture_mass_kg, noise, tissue } = self;
        let mut text = "[session]\nformat = 1\n".to_owned();
        if !name.is_empty() {
            let _ = writeln!(text, "name = {}", toml::Value::from(name.as_str()));
        }
        let mut table = |name: &str, fields: &[(&'static str, Option<f64>)]| {
            if fields.iter().any(|(_, value)| value.is_some()) {
                let _ = write!(text, "\n[{name}]\n");
            }
            if name == "needle" && !rig.needle.stiffness_known {
                text.push_str("bending_stiffness = \"unknown\"\n");
            }
            for (field, value) in fields {
                if let Some(value) = value {
                    let _ = writeln!(text, "{field} = {}", number(path, field, *value)?);
                }
            }
            Ok::<(), SessionError>(())
        };
        let needle = &rig.needle;
        let (guide2_m, guides, rear) = match rig.guides {
            Guides::Two => (Some(rig.guide2_m), None, [None; 2]),
            Guides::One { rear_rotation_n_m_per_rad } => (None, Some(1.0), rear_rotation_n_m_per_rad),
        };
        table(
            "needle",
            &[
                ("youngs_modulus_gpa", Some(1e-9 * needle.youngs_modulus_pa)),
                ("outer_diameter_mm", Some(1e3 * needle.outer_diameter_m)),
                ("inner_diameter_mm", Some(1e3 * needle.inner_diameter_m)),
                ("outer_diameter_sd_mm", rig.tolerances.outer_diameter_m.map(|sd_m| 1e3 * sd_m)),
                ("inner_diameter_sd_mm", rig.tolerances.inner_diameter_m.map(|sd_m| 1e3 * sd_m)),
                ("bevel_angle_deg", needle.bevel_angle_rad.map(f64::to_degrees)),
                ("length_mm", needle.length_m.map(|length_m| 1e3 * length_m)),
            ],
        )?;
        table(
            "rig",
            &[
                ("guides", guides),
                ("guide2_mm", guide2_m.map(|guide2_m| 1e3 * guide2_m)),
                ("entry_mm", Some(1e3 * rig.entry_m)),
                ("guide2_sd_mm", rig.tolerances.guide2_m.map(|sd_m| 1e3 * sd_m)),
                ("entry_sd_mm", rig.tolerances.entry_m.map(|sd_m| 1e3 * sd_m)),
                ("rear_rotation_y_n_m_per_rad", rear[0]),
                ("rear_rotation_x_n_m_per_rad", rear[1]),
                ("fixture_mass_kg", *fixture_mass_kg),
            ],
        )?;
        table(
            "noise",
            &[
                ("force_n", noise.force_n),
                ("force_zero_n", noise.force_zero_n),
                ("displacement_mm", noise.displacement_m.map(|sd_m| 1e3 * sd_m)),
                ("shape_mm", noise.shape_m.map(|sd_m| 1e3 * sd_m)),
                ("tip_mm", noise.tip_m.map(|sd_m| 1e3 * sd_m)),
                ("tip_direction_mrad", noise.tip_direction_rad.map(|sd_rad| 1e3 * sd_rad)),
            ],
        )?;
        text.push_str(&tissue.to_toml());
        Ok(text)
    }

    /// Reads the tables `[needle]`, `[rig]`, `[noise]` and `[tissue]` of a file in the session's format, and its name where it has one:
    /// what is known of a rig before anything is recorded with it. Other tables are left alone.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub fn read(path: &Path) -> Result<Self, SessionError> {
        Self::parse(path, &read_text(path)?)
    }

    /// As [`Self::read`], from a text that was found in this file.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, SessionError> {
        Fields::parse(path, text, |file| {
            let name = match file.optional_table("session")? {
                Some(session) => session.optional_text("name")?,
                None => None,
            };
            // Omitted fields have a default, and no check follows: a misspelt name must not pass for that.
            file.none_misspelt(&["needle", "rig", "noise", "tissue"])?;
            for (table, known) in
                [("needle", &NEEDLE[..]), ("rig", &RIG), ("noise", &NOISE), ("tissue", &TISSUE)]
            {
                file.optional_table(table)?.map_or(Ok(()), |fields| fields.none_misspelt(known))?;
            }
            Ok(Self {
                name: name.unwrap_or_default(),
                rig: rig(file)?,
                fixture_mass_kg: fixture_mass_kg(file)?,
                noise: noise(file)?,
                tissue: Tissue::read(file)?,
            })
        })
    }
}
