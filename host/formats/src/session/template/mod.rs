//! A session to begin with: every table of the format, explained, and files with the headers of its CSV files.

/// `session.toml` with everything optional commented out: a valid session without runs.
pub const SESSION: &str = include_str!("session.toml");

/// The plan of an example: a small session on which every workflow works.
pub const EXAMPLE_PLAN: &str = include_str!("plan.toml");

/// Explained headers of the CSV files that [`SESSION`] names: file, text.
pub const TABLES: [(&str, &str); 5] = [
    (
        "d30-1.force.csv",
        "# The force series of a lateral run. Needed: time_s (increasing), displacement_y_mm (of guide 2), force_y_n (of guide 2 on the\n\
         # needle: same sign). Optional: displacement_x_mm and force_x_n together, step (of the motion program), moving (1 or 0),\n\
         # lost_before (samples lost before the row).\n\
         time_s,displacement_y_mm,force_y_n\n",
    ),
    (
        "d30-1.shape.csv",
        "# The needle's shape. Needed: z_mm (from guide 1, so the surface is at entry_mm), deflection_y_mm (from the straight needle).\n\
         # Optional: deflection_x_mm, time_s (on the clock of the force series: assigns each point to its hold; without it all\n\
         # points belong to the last hold).\n\
         z_mm,deflection_y_mm\n",
    ),
    (
        "i1.csv",
        "# An insertion. Needed: depth_mm (of the tip below the surface), tip_y_mm (from the straight needle's line). Optional: tip_x_mm,\n\
         # time_s, rotation_deg (about the needle's axis), guide2_y_mm, guide2_x_mm, base_force_y_n, tip_direction_y_mrad\n\
         # and tip_direction_x_mrad (slope of the needle at the tip; a cell may be empty).\n\
         depth_mm,tip_y_mm\n",
    ),
    (
        "s1.csv",
        "# A steering run: time (increasing), depth, position of and force on the needle's base, position of its tip; all needed.\n\
         time_s,depth_mm,base_y_mm,base_force_y_n,tip_y_mm\n",
    ),
    (
        "ref1.csv",
        "# An indentation. Needed: depth_mm, force_n (on the indenter, positive when pressed in). Contact point and force offset are\n\
         # fitted: rows from before contact help, rows of the unloading are not used.\n\
         depth_mm,force_n\n",
    ),
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::Session;
    use std::fs;

    #[test]
    fn the_template_is_a_session_and_stays_one_when_all_of_it_is_used() {
        let folder = tempfile::tempdir().expect("a folder");
        let write = |name: &str, text: &str| fs::write(folder.path().join(name), text).expect("written");
        write("session.toml", SESSION);
        let session = Session::read(folder.path()).expect("a valid session");
        assert!(session.lateral.is_empty() && session.insertion.is_empty());
        // Parts to use begin with # alone.
        let example: String = SESSION
            .lines()
            .map(|line| match line.strip_prefix('#') {
                Some(part) if !part.starts_with(' ') && !part.is_empty() => format!("{part}\n"),
                _ => format!("{line}\n"),
            })
            .collect();
        write("session.toml", &example);
        for (name, text) in TABLES {
            let columns = text.lines().last().expect("a header").split(',').count();
            write(name, &format!("{text}{}\n", vec!["1"; columns].join(",")));
        }
        let session = Session::read(folder.path()).expect("reads");
        assert_eq!((session.lateral.len(), session.insertion.len()), (1, 1));
        assert_eq!((session.steering.len(), session.indentation.len()), (1, 1));
        assert_eq!(session.lateral[0].provenance.calibration_crc, Some(0x1a2b_3c4d));
        assert_eq!(session.noise.tip_m, Some(0.05e-3));
    }
}
