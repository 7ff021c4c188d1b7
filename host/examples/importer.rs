//! Writes the rows of another program's files as a lateral run of a session, and reads the session back.
//!
//! The other program separates columns with semicolons and writes milliseconds, micrometres and millinewtons. It records one plane;
//! the other one was not moved.
//!
//! ```sh
//! cargo run -p host --example importer -- imported
//! guide check imported
//! ```

use anyhow::{Context, ensure};
use formats::session::{ForceRow, Noise, Session, SessionWriter, Setup, ShapeRow, Tissue};
use mechanics::{Needle, Rig};
use std::path::Path;

const FORCE: &str = "\
t/ms;pos/um;load/mN\n\
0;0;2\n100;0;0\n200;1;2\n300;-1;2\n400;-1;1\n500;0;2\n600;0;-1\n700;1;2\n800;1;1\n900;0;-1\n1000;0;2\n1100;1;-2\n\
1200;-1;-1\n1300;-1;0\n1400;-1;0\n1500;300;279\n1600;600;558\n1700;900;837\n1800;1201;1118\n1900;1201;1117\n\
2000;1201;1118\n2100;1201;1115\n2200;1200;1113\n2300;1199;1115\n2400;1201;1115\n2500;1200;1117\n2600;1200;1117\n\
2700;1201;1118\n2800;1200;1118\n2900;1201;1118\n3000;1200;1116\n3100;1199;1116\n3200;1200;1116\n3300;1199;1115\n\
3400;1200;1116\n3500;1199;1113\n3600;1201;1117\n3700;1199;1116\n3800;1199;1117\n3900;1200;1113\n4000;1200;1117\n\
4100;1201;1113\n";
const SHAPE: &str = "\
t/ms;z/mm;lift/um
3000;72;1355
3000;76;1396
3000;80;1422
3000;85;1461
3000;90;1480
3000;95;1514
";

fn main() -> anyhow::Result<()> {
    let folder = std::env::args_os().nth(1).context("expected a folder for the session")?;
    let folder = Path::new(&folder);
    let setup = Setup {
        name: "imported".to_owned(),
        rig: Rig::two_guides(Needle::gauge_18(), 0.060, 0.070),
        fixture_mass_kg: None,
        noise: Noise { force_n: Some(2e-3), shape_m: Some(5e-6), ..Noise::default() },
        tissue: Tissue::default(),
    };
    // An existing session is extended, if its needle and rig are the same; an id that is taken is an error.
    let mut session = SessionWriter::open(folder, &setup)?;
    let mut run = session.lateral("d30-1", 0.030)?;
    for row in reader(FORCE).deserialize() {
        let [time_ms, position_um, load_mn]: [f64; 3] = row?;
        run.force(&ForceRow {
            time_s: 1e-3 * time_ms,
            displacement_y_m: 1e-6 * position_um,
            force_y_n: 1e-3 * load_mn,
            ..ForceRow::default()
        })?;
    }
    for row in reader(SHAPE).deserialize() {
        let [time_ms, z_mm, lift_um]: [f64; 3] = row?;
        run.shape(&ShapeRow {
            time_s: 1e-3 * time_ms,
            z_m: 1e-3 * z_mm,
            deflection_y_m: 1e-6 * lift_um,
            ..ShapeRow::default()
        })?;
    }
    run.finish()?;

    for run in &Session::read(folder)?.lateral {
        let (readings, points) = (run.force.time_s.len(), run.shape.z_m.len());
        ensure!(readings > 0 && points > 0, "{}: no rows", run.id);
        println!(
            "{}: {readings} force readings, {points} points of the shape, {:.0} mm deep",
            run.id,
            1e3 * run.depth_m
        );
    }
    Ok(())
}

fn reader(text: &str) -> csv::Reader<&[u8]> {
    csv::ReaderBuilder::new().delimiter(b';').from_reader(str::as_bytes(text))
}
