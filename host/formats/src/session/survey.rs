//! Reading a session in which much may be wrong: every file is checked, every fault kept, what can be read is read.

use super::schema::{self, NEEDLE, NOISE, RIG, TISSUE};
use super::{Labels, Session, Tissue};
use super::{hardware, read, rig_model};
use crate::document::table::{Column, Table, cut_row, misspelt_columns};
use crate::document::{Fields, Place, Problem, SessionError, read_text};
use mechanics::Rig;
use std::collections::HashSet;
use std::path::{Component, Path};

/// Result of reading a session.
#[derive(Debug, Default)]
pub struct Survey {
    /// Readable content; `None` if needle, guides or the whole file could not be read.
    pub session: Option<Session>,
    /// Faults, at most one per table of the session file and per CSV file. Without faults, [`Session::read`] reads the
    /// same session.
    pub faults: Vec<SessionError>,
    /// Fields that are not part of the format, which are ignored: a misspelt one is among them.
    pub unknown: Vec<(Place, String)>,
    /// Columns that are not part of the format, with the name of one that is, is not there, and was probably intended.
    pub misspelt: Vec<(Place, String, &'static str)>,
    /// Last rows of recordings that are cut off, which are skipped.
    pub cut_rows: Vec<Place>,
    /// Files that are named in a way that leads out of the session's folder.
    pub outside: Vec<(Place, String)>,
}

const TABLES: [&str; 11] = [
    "session",
    "subject",
    "covariates",
    "needle",
    "rig",
    "noise",
    "tissue",
    "lateral",
    "insertion",
    "indentation",
    "steering",
];
const SESSION: [&str; 4] = ["format", "name", "date", "site"];
const SUBJECT: [&str; 1] = ["id"];
/// A kind of run: its table, its fields, its files with their columns and whether they may be without rows, its numbers.
struct Kind {
    name: &'static str,
    fields: &'static [&'static str],
    files: &'static [(&'static str, &'static [Column], bool)],
    numbers: &'static [(&'static str, [f64; 2])],
}

const LATERAL: Kind = Kind {
    name: "lateral",
    fields: &[
        "id",
        "depth_mm",
        "force",
        "shape",
        "calibration_id",
        "calibration_crc",
        "device",
        "firmware",
        "tared",
    ],
    files: &[("force", &schema::FORCE_COLUMNS, true), ("shape", &schema::SHAPE_COLUMNS, true)],
    numbers: &[],
};
const INSERTION: Kind = Kind {
    name: "insertion",
    fields: &["id", "path"],
    files: &[("path", &schema::INSERTION_COLUMNS, false)],
    numbers: &[],
};
const INDENTATION: Kind = Kind {
    name: "indentation",
    fields: &[
        "id",
        "indenter",
        "indenter_radius_mm",
        "indenter_half_angle_deg",
        "tissue_thickness_mm",
        "poisson",
        "data",
    ],
    files: &[("data", &schema::INDENTATION_COLUMNS, false)],
    numbers: &[("indenter_radius_mm", schema::RADIUS_MM), ("poisson", schema::POISSON)],
};
const STEERING: Kind = Kind {
    name: "steering",
    fields: &["id", "data"],
    files: &[("data", &schema::STEERING_COLUMNS, false)],
    numbers: &[],
};

impl Session {
    /// Reads all that can be read, and keeps every fault.
    pub fn survey(dir: &Path) -> Survey {
        let path = dir.join("session.toml");
        let mut survey = Survey::default();
        let parsed = read_text(&path).and_then(|text| {
            Fields::parse(&path, &text, |file| {
                survey.file(dir, file);
                Ok(())
            })
        });
        survey.keep(parsed);
        survey
    }
}

impl Survey {
    fn keep<T>(&mut self, read: Result<T, SessionError>) -> Option<T> {
        read.map_err(|fault| self.faults.push(fault)).ok()
    }

    fn file(&mut self, dir: &Path, file: &Fields<'_>) {
        self.unknown.extend(file.others(&TABLES));
        for (name, known) in [
            ("session", &SESSION[..]),
            ("subject", &SUBJECT),
            ("needle", &NEEDLE),
            ("rig", &RIG),
            ("noise", &NOISE),
            ("tissue", &TISSUE),
        ] {
            if let Ok(Some(table)) = file.optional_table(name) {
                self.unknown.extend(table.others(known));
            }
        }
        let head = file.table("session").and_then(|session| {
            session.format()?;
            session.optional_text("name")
        });
        let name = self.keep(head).flatten();
        let needle = self.keep(hardware::needle(file));
        let guides_m = self.keep(hardware::guides_m(file));
        // A fault of both is reported once.
        let guides = guides_m.and_then(|_| self.keep(hardware::guides(file)));
        // A table that is missing has been reported already.
        let tolerances = match (&needle, &guides_m) {
            (Some(_), Some(_)) => self.keep(hardware::tolerances(file)).unwrap_or_default(),
            _ => Default::default(),
        };
        let fixture_mass_kg = match file.table("rig") {
            Ok(_) => self.keep(hardware::fixture_mass_kg(file)).flatten(),
            Err(_) => None,
        };
        self.keep(rig_model::in_file(&dir.join("session.toml"), file));
        let noise = self.keep(hardware::noise(file)).unwrap_or_default();
        let tissue = self.keep(Tissue::read(file)).unwrap_or_default();
        // A fault of a table that others read too is reported once.
        if let Err(fault) = Labels::of(file)
            && !self.faults.iter().any(|known| known.to_string() == fault.to_string())
        {
            self.faults.push(fault);
        }
        let lateral = self.runs(dir, file, &LATERAL, |fields, id| read::lateral(dir, fields, id));
        let insertion = self.runs(dir, file, &INSERTION, |fields, id| read::insertion(dir, fields, id));
        let indentation = self.runs(dir, file, &INDENTATION, |fields, id| read::indentation(dir, fields, id));
        let steering = self.runs(dir, file, &STEERING, |fields, id| read::steering(dir, fields, id));
        if let (Some(needle), Some([guide2_m, entry_m]), Some(guides)) = (needle, guides_m, guides) {
            let rig = Rig { needle, guide2_m, entry_m, guides, tolerances };
            let dir = dir.to_owned();
            self.session = Some(Session {
                dir,
                name,
                rig,
                fixture_mass_kg,
                noise,
                tissue,
                lateral,
                insertion,
                indentation,
                steering,
            });
        }
    }

    /// The runs of one kind that can be read.
    fn runs<T>(
        &mut self,
        dir: &Path,
        file: &Fields<'_>,
        kind: &Kind,
        read: impl Fn(&Fields<'_>, String) -> Result<T, SessionError>,
    ) -> Vec<T> {
        let mut ids = HashSet::new();
        let mut runs = Vec::new();
        for fields in self.keep(file.tables(kind.name)).unwrap_or_default() {
            self.unknown.extend(fields.others(kind.fields));
            let id = self.keep(fields.text("id")).unwrap_or_default();
            if !id.is_empty() && !ids.insert(id.clone()) {
                let problem = Problem::Duplicate(id.clone());
                self.faults.push(fields.field_fault("id", problem, "one run per id"));
            }
            self.files(dir, &fields, kind);
            match read(&fields, id) {
                Ok(run) => runs.push(run),
                Err(first) => self.parts(dir, &fields, kind, first),
            }
        }
        runs
    }

    /// Possible mistakes in a run's files.
    fn files(&mut self, dir: &Path, fields: &Fields<'_>, kind: &Kind) {
        for (name, columns, recording) in kind.files {
            let Ok(file) = fields.text(name) else { continue };
            if !Path::new(&file)
                .components()
                .all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
            {
                self.outside.push((fields.place_of(name), format!("{}.{name}", kind.name)));
            }
            let path = dir.join(file);
            let Ok(text) = read_text(&path) else { continue };
            if let Some(cut) =
                cut_row(&path, &text).filter(|cut| *recording && !self.cut_rows.contains(&cut.place))
            {
                self.cut_rows.push(cut.place);
            }
            for one in misspelt_columns(&path, &text, columns) {
                // Two runs may share a file.
                if !self.misspelt.contains(&one) {
                    self.misspelt.push(one);
                }
            }
        }
    }

    /// Every fault of a run's parts; `first` is the one at which reading it stopped.
    fn parts(&mut self, dir: &Path, fields: &Fields<'_>, kind: &Kind, first: SessionError) {
        let fault_count = self.faults.len();
        if kind.name == LATERAL.name {
            self.keep(read::depth_mm(fields));
        }
        for (name, range) in kind.numbers {
            self.keep(fields.number(name, *range));
        }
        for (name, columns, may_be_empty) in kind.files {
            let read = if *may_be_empty { Table::read_recording } else { Table::read };
            self.keep(fields.file(dir, name, |path| read(path, columns)));
        }
        if kind.name == LATERAL.name {
            self.keep(read::provenance(fields));
        }
        // Faults between parts that are valid each for itself.
        if self.faults.len() == fault_count {
            self.faults.push(first);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    const HEAD: &str = "[session]\nformat = 1\n[needle]\nyoungs_modulus_gpa = 200\nouter_diameter_mm = 1.27\n\
                        inner_diameter_mm = 1.0\n[rig]\nguide2_mm = 60\nentry_mm = 70\n";

    fn survey(toml: &str, files: &[(&str, &str)]) -> (Survey, Vec<String>) {
        let folder = tempfile::tempdir().expect("a folder");
        for (name, text) in files.iter().chain([&("session.toml", toml)]) {
            fs::write(folder.path().join(name), text).expect("written");
        }
        let survey = Session::survey(folder.path());
        assert_eq!(survey.faults.is_empty(), Session::read(folder.path()).is_ok(), "the same as reading");
        let prefix = format!("{}{}", folder.path().display(), std::path::MAIN_SEPARATOR);
        let faults = survey.faults.iter().map(|fault| fault.to_string().replace(&prefix, "")).collect();
        (survey, faults)
    }

    #[test]
    fn a_row_that_a_full_disk_cut_off_is_skipped_and_named() {
        let toml = HEAD.to_owned()
            + "[[lateral]]\nid = \"a\"\ndepth_mm = 30\nforce = \"f.csv\"\nshape = \"s.csv\"\n";
        let force = "time_s,displacement_y_mm,force_y_n,step\n0,0,0,1\n0.001,0,0.1,1\n0.002,0.0";
        let (survey, faults) =
            survey(&toml, &[("f.csv", force), ("s.csv", "z_mm,deflection_y_mm\n80,1\n81")]);
        assert_eq!(faults, Vec::<String>::new());
        let lines: Vec<_> = survey.cut_rows.iter().map(|place| place.line).collect();
        assert_eq!(lines, [4, 3]);
        let session = survey.session.expect("it is read");
        assert_eq!((session.lateral[0].force.time_s.len(), session.lateral[0].shape.z_m.len()), (2, 1));
    }

    #[test]
    fn every_file_and_table_is_checked() {
        fn run(id: &str) -> String {
            format!("[[lateral]]\nid = \"{id}\"\ndepth_mm = 30\nforce = \"f.csv\"\nshape = \"s.csv\"\n")
        }
        let toml = HEAD.replace("entry_mm = 70", "entry_mm = 7").replace("= 1.27", "= \"1.27\"")
            + "[noise]\nforce_n = -1\nshape = 0.1\n"
            + &run("a").replace("30", "3000")
            + &run("a")
            + "[[insertion]]\nid = \"i\"\npath = \"none.csv\"\n[[insertions]]\nid = \"j\"\n[[steering]]\ndata = 1\n";
        let (survey, faults) = survey(
            &toml,
            &[("f.csv", "time_s,displacement_y_mm\n0,0\n"), ("s.csv", "z_mm,deflection_y_mm\n80,x\n")],
        );
        let begins = [
            "session.toml:5:21: needle.outer_diameter_mm: this is a string",
            "session.toml:9:12: rig.entry_mm: 7 is out of range",
            "session.toml:11:11: noise.force_n: -1 is out of range",
            "session.toml:15:12: lateral.depth_mm: 3000 is out of range",
            "f.csv:1:1: force_y_n: missing",
            "s.csv:2:4: deflection_y_mm: \"x\" is not a number",
            "session.toml:19:6: lateral.id: \"a\" appears twice",
            "f.csv:1:1: force_y_n: missing",
            "s.csv:2:4: deflection_y_mm: \"x\" is not a number",
            "session.toml:25:8: insertion.path: cannot read none.csv",
            "session.toml:28:1: steering.id: missing",
            "session.toml:29:8: steering.data: this is an integer",
        ];
        assert_eq!(faults.len(), begins.len(), "{faults:#?}");
        for (fault, begin) in faults.iter().zip(begins) {
            assert!(fault.starts_with(begin), "{fault}, expected {begin}");
        }
        assert!(survey.session.is_none());
        let unknown: Vec<&str> = survey.unknown.iter().map(|(_, name)| name.as_str()).collect();
        assert_eq!(unknown, ["insertions", "noise.shape"]);
    }

    #[test]
    fn what_is_right_is_read_beside_what_is_wrong() {
        let toml = HEAD.to_owned()
            + "[[insertion]]\nid = \"i\"\npath = \"i.csv\"\n[[insertion]]\nid = \"j\"\npath = \"none.csv\"\n";
        let (survey, faults) = survey(&toml, &[("i.csv", "depth_mm,tip_y_mm\n1,0\n")]);
        assert_eq!((faults.len(), survey.session.expect("read").insertion.len()), (1, 1));
        let (whole, faults) = self::survey(HEAD, &[]);
        assert!(faults.is_empty() && whole.unknown.is_empty() && whole.session.is_some());
        let (broken, faults) = self::survey("[session\n", &[]);
        assert!(broken.session.is_none() && faults[0].starts_with("session.toml:1:9"), "{faults:?}");
    }
}
