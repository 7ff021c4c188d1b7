//! Statement of a session about its tissue: `[tissue]` with `foundation`, `poisson` and `poisson_sd`, and its
//! walls.
//!
//! The table of a simulation's plan has the same name and further fields; those are left alone here.

use super::block::Walls;
use super::schema::POISSON;
use crate::document::{Fields, Problem, SessionError};
use mechanics::Block;
use std::fmt::Write as _;

/// Standard deviations that a Poisson's ratio can have: that of a uniform one over its whole range is 0.14.
const POISSON_SD: [f64; 2] = [0.0, 0.2];

/// Model of the tissue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FoundationKind {
    /// Independent springs (Winkler).
    Springs,
    /// An elastic body.
    Body,
}

impl FoundationKind {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Springs, Self::Body];

    /// Its name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Springs => "springs",
            Self::Body => "body",
        }
    }
}

/// Statements about the tissue; empty if there are none.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Tissue {
    /// Model of the tissue; without it the evidence of the runs decides.
    pub foundation: Option<FoundationKind>,
    /// Poisson's ratio, 0 to 0.5.
    pub poisson: Option<f64>,
    /// Standard deviation of Poisson's ratio: it widens the interval of Young's modulus from a body.
    pub poisson_sd: Option<f64>,
    /// Its walls.
    pub walls: Option<Walls>,
}

impl Tissue {
    /// Reads the table, where there is one.
    ///
    /// # Errors
    /// [`SessionError`] for the first fault found, with its place.
    pub(super) fn read(file: &Fields<'_>) -> Result<Self, SessionError> {
        let Some(fields) = file.optional_table("tissue")? else { return Ok(Self::default()) };
        let foundation = match fields.optional_text("foundation")? {
            None => None,
            Some(name) => {
                let foundation = FoundationKind::ALL.into_iter().find(|kind| kind.name() == name);
                Some(foundation.ok_or_else(|| {
                    let name = name.chars().take(40).collect();
                    fields.field_fault("foundation", Problem::Unknown(name), "\"springs\" or \"body\"")
                })?)
            }
        };
        Ok(Self {
            foundation,
            poisson: fields.optional_number("poisson", POISSON)?,
            poisson_sd: fields.optional_number("poisson_sd", POISSON_SD)?,
            walls: Walls::read(&fields)?,
        })
    }

    /// The block that the tissue is stated to be; nothing of a half space.
    pub fn block(&self) -> Option<Block> {
        self.walls.and_then(Walls::block)
    }

    /// The table as text, empty where nothing is stated.
    pub(super) fn to_toml(self) -> String {
        let mut text = String::new();
        if let Some(foundation) = self.foundation {
            let _ = writeln!(text, "foundation = \"{}\"", foundation.name());
        }
        for (field, value) in [("poisson", self.poisson), ("poisson_sd", self.poisson_sd)] {
            if let Some(value) = value {
                let _ = writeln!(text, "{field} = {value:?}");
            }
        }
        text.push_str(&self.walls.map_or_else(String::new, Walls::to_toml));
        if text.is_empty() { text } else { format!("\n[tissue]\n{text}") }
    }

    /// The first field that both state, and not alike, with both values as text.
    pub(super) fn contradicts(self, other: Self) -> Option<(&'static str, [String; 2])> {
        fn differ(
            field: &'static str,
            there: Option<String>,
            new: Option<String>,
        ) -> Option<(&'static str, [String; 2])> {
            let (stated, new) = there.zip(new)?;
            (stated != new).then_some((field, [stated, new]))
        }
        fn name(tissue: Tissue) -> Option<String> {
            tissue.foundation.map(|kind| kind.name().to_owned())
        }
        fn walls(tissue: Tissue) -> Option<String> {
            tissue.walls.map(|walls| walls.to_toml().trim_end().replace('\n', ", "))
        }
        fn text(value: Option<f64>) -> Option<String> {
            value.map(|value| value.to_string())
        }
        differ("foundation", name(self), name(other))
            .or_else(|| differ("poisson", text(self.poisson), text(other.poisson)))
            .or_else(|| differ("poisson_sd", text(self.poisson_sd), text(other.poisson_sd)))
            .or_else(|| differ("body_mm", walls(self), walls(other)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Session, SessionWriter, Setup};
    use super::*;
    use std::path::Path;

    const HEAD: &str = "[session]\nformat = 1\n[needle]\nyoungs_modulus_gpa = 200.0\nouter_diameter_mm = 1.27\n\
                        inner_diameter_mm = 1.0\n[rig]\nguide2_mm = 60.0\nentry_mm = 70.0\n";

    fn stated(table: &str) -> Result<Setup, String> {
        let text = format!("{HEAD}[tissue]\n{table}");
        Setup::parse(Path::new("rig.toml"), &text).map_err(|error| error.to_string())
    }

    #[test]
    fn wrong_values_are_named_with_their_line_and_what_is_valid() {
        fn refused(table: &str) -> String {
            stated(table).expect_err("refused")
        }
        assert_eq!(
            refused("foundation = \"gel\"\n"),
            "rig.toml:11:14: tissue.foundation: \"gel\" is not known, expected \"springs\" or \"body\""
        );
        assert_eq!(
            refused("poisson = 0.6\n"),
            "rig.toml:11:11: tissue.poisson: 0.6 is out of range, expected a number from 0 to 0.5"
        );
        assert!(refused("poisson_sd = -0.1\n").contains("tissue.poisson_sd: -0.1 is out of range"));
        assert!(refused("poison = 0.45\n").contains("there is \"poison\""));
        assert_eq!(stated("k_kpa = 12.0\n").expect("reads").tissue, Tissue::default());
        let block = "body_mm = [50.0, 60.0, 45.0]\nsides = \"held\"\n";
        fn of_field(table: &str) -> String {
            refused(table).split(": ").nth(1).unwrap_or_default().to_owned()
        }
        for (table, field) in [
            ("body_mm = [50.0, 60.0]\nsides = \"held\"\n", "tissue.body_mm"),
            ("body_mm = [50.0, 60.0, 45.0]\n", "tissue.body_mm"),
            ("sides = \"held\"\n", "tissue.sides"),
            ("sides = \"loose\"\n", "tissue.sides"),
            ("needle_at_mm = [1.0, 1.0]\n", "tissue.needle_at_mm"),
            ("body_mm = [50.0, 60.0, 4500.0]\nsides = \"held\"\n", "tissue.body_mm"),
            ("body_mm = [50.0, 60.0, 45.0]\nsides = \"far\"\n", "tissue.body_mm"),
            ("body_mm = [50.0, 60.0, 45.0]\nsides = \"free\"\nfar_side = \"free\"\n", "tissue.far_side"),
        ] {
            assert_eq!(of_field(table), field, "{table}");
        }
        assert_eq!(of_field(&format!("{block}needle_at_mm = [1.0, 30.0]\n")), "tissue.needle_at_mm");
    }

    #[test]
    fn what_is_written_is_read_and_a_contradiction_is_refused() {
        let dir = tempfile::tempdir().expect("a folder");
        let body = stated(
            "foundation = \"body\"\npoisson = 0.45\npoisson_sd = 0.02\nbody_mm = [50.1, 60.0, 45.0]\n\
             needle_at_mm = [20.3, 30.0]\nsides = \"free\"\n",
        )
        .expect("reads");
        assert_eq!(body.tissue.block().expect("a block").needle_at_m, [20.3e-3, 30e-3]);
        assert_eq!(stated("sides = \"far\"\n").expect("reads").tissue.walls, Some(Walls::Far));
        SessionWriter::open(dir.path(), &body).expect("writes");
        let read = Session::read(dir.path()).expect("reads");
        assert_eq!(read.tissue, body.tissue);
        assert_eq!(Session::survey(dir.path()).session.expect("read").tissue, body.tissue);
        assert!(Session::survey(dir.path()).unknown.is_empty());
        let open = |setup: &Setup| SessionWriter::open(dir.path(), setup).map(|_| ());
        open(&Setup { tissue: Tissue::default(), ..body.clone() })
            .expect("nothing stated is no contradiction");
        let springs = stated("foundation = \"springs\"\n").expect("reads");
        let why = open(&springs).expect_err("refused").to_string();
        assert!(why.contains("tissue.foundation: the session states body, the new run springs"), "{why}");
    }
}
