//! Every kind of file beside sessions and recordings.
//!
//! Input: a byte that chooses the kind, then the file.

use super::folder;
use control::calibration::Calibration;
use device::link::Program;
use device::sweep::Sweep;
use formats::calibration_file;
use formats::foreign::{Choice, Grid, Mapping, Options, RawTable, Taken, ZOrigin, Zero, take};
use formats::model_file::ModelFile;
use formats::session::Setup;
use formats::session::import::{Axis, Frame, LengthUnit, NeedlePoints, Straight, poses, slicer, trajcontrol};
use simulation::rig::config::RigConfig;
use simulation::simulate::SimulationPlan;
use std::fs;
use std::path::Path;

/// Reads one file.
///
/// # Panics
/// Where what is written of it is read as something else.
pub fn run(data: &[u8]) {
    let Some((&kind, content)) = data.split_first() else { return };
    let folder = folder();
    let (path, second_path) = (folder.path().join("file"), folder.path().join("other"));
    fs::write(&path, content).expect("writes");
    match kind % 13 {
        0 => model(&path, &second_path),
        1 => {
            if let Ok(config) = RigConfig::read(&path) {
                assert!(Setup::read(&path).is_ok(), "{config:?}");
            }
        }
        2 => program(&path),
        3 => {
            let _ = SimulationPlan::read(&path, None);
        }
        4 => calibration(&path, &second_path),
        5 => shape(slicer(&path).ok()),
        6 => {
            shape(poses(&path, None).ok());
            shape(poses(&path, Some(LengthUnit::Metres)).ok());
        }
        7 => {
            if let Ok(recording) = trajcontrol(&path) {
                let run = recording.run;
                assert_eq!(run.depth_m.len(), run.tip_y_m.len());
                assert!(run.depth_m.iter().chain(&run.tip_y_m).all(|value| value.is_finite()));
            }
        }
        8 => {
            if let Ok(text) = std::str::from_utf8(content)
                && let Ok(sweep) = Sweep::parse(text)
            {
                assert!(sweep.rows(0.0).all(|row| row.z_m.is_finite() && row.deflection_y_m.is_finite()));
            }
        }
        9 => tables(Grid::parse(&path, content).and_then(RawTable::new).map(|table| vec![table]).ok()),
        // Binary files of tables are known by their endings.
        second_path => {
            let ending = match second_path {
                10 => "mcap",
                11 => "mat",
                _ => "xlsx",
            };
            let named = path.with_extension(ending);
            fs::write(&named, content).expect("writes");
            tables(RawTable::read(&named).ok());
        }
    }
}

/// Tables of others as a run, by what names and units show and by the places of columns.
fn tables(tables: Option<Vec<RawTable>>) {
    let Some(tables) = tables else { return };
    for table in &tables {
        assert!(table.columns.iter().all(|column| column.values.len() == table.lines.len()));
    }
    fn by_place(maps: &[&str]) -> Mapping {
        Mapping { choices: maps.iter().filter_map(|text| Choice::parse(text).ok()).collect() }
    }
    const PUSH: [&str; 5] =
        ["#1=time_s:s", "#2=force_y_n:mN", "#3=displacement_y_mm:um", "#4=z_mm:mm", "#5=deflection_y_mm:mm"];
    let insertion = by_place(&["#1=depth_mm:mm", "#2=tip_y_mm:-0.1 mm", "#3=tip_x_mm:mm"]);
    for mapping in [Mapping::default(), by_place(&PUSH[..3]), by_place(&PUSH), insertion] {
        for zero in [Zero::Auto, Zero::First] {
            let z_from = Some(ZOrigin::Surface);
            let options = Options { z_from, zero, entry_m: 0.07, guide2_m: 0.06, ..Options::default() };
            if let Ok(taken) = take(&tables, &mapping, &options) {
                check(&taken);
            }
        }
    }
}

/// What is taken consists of numbers, as many in every column, at times that go on.
fn check(taken: &Taken) {
    if let Some(force) = &taken.force {
        assert!(force.time_s.windows(2).all(|pair| pair[0] < pair[1]), "{:?}", force.time_s);
        let finite_values = force.time_s.iter().chain(&force.displacement_y_m).chain(&force.force_y_n);
        assert!(finite_values.clone().all(|value| value.is_finite()), "{force:?}");
    }
    if let Some(shape) = &taken.shape {
        assert_eq!(shape.z_m.len(), shape.y_m.len());
        assert!(shape.z_m.iter().chain(&shape.y_m).all(|value| value.is_finite()), "{shape:?}");
    }
    if let Some(run) = &taken.insertion {
        assert_eq!(run.depth_m.len(), run.tip_y_m.len());
        assert!(run.depth_m.iter().chain(&run.tip_y_m).all(|value| value.is_finite()), "{run:?}");
    }
}

fn model(path: &Path, other: &Path) {
    let Ok(model) = ModelFile::read(path) else { return };
    model.write(other).expect("a model that was read is written");
    let again = ModelFile::read(other).expect("what was written is read");
    assert_eq!(again, model);
}

fn program(path: &Path) {
    let Some(path) = path.to_str() else { return };
    if let Ok(program) = Program::load(path) {
        let steps = program.device_steps();
        assert!((1..=protocol::MAX_STEPS).contains(&steps.len()), "{} steps", steps.len());
    }
}

fn calibration(path: &Path, other: &Path) {
    let Ok(record) = calibration_file::read(path) else { return };
    assert!(
        Calibration::new(record.clone()).is_ok(),
        "the device refuses what the file may hold: {record:?}"
    );
    calibration_file::write(other, &record).expect("a calibration that was read is written");
    let again = calibration_file::read(other).expect("what was written is read");
    assert_eq!(again, record);
}

/// A needle's points as a shape of a session.
fn shape(needle: Option<NeedlePoints>) {
    let Some(needle) = needle else { return };
    let up_directions = [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]];
    for axis in [Axis::Given([0.0, 0.0, 1.0]), Axis::Fitted(0.06)] {
        let straight = Straight { origin_m: None, origin_z_m: 0.0, axis, up: up_directions };
        if let Ok((shape, _)) = Frame::new(&straight, &needle).and_then(|frame| frame.shape(&needle)) {
            assert!(shape.z_m.iter().chain(&shape.y_m).all(|value| value.is_finite()), "{shape:?}");
        }
    }
}
