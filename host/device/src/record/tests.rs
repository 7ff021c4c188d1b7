//! Recordings that end well and recordings that do not: what arrived is in the session.

use super::{RecordError, Recorder, Ultrasound, acquire, provenance};
use crate::link::program::PlannedStep;
use crate::link::{Client, LinkError, Program, RunOptions};
use fake_device::{self as fake, Act, FakeDevice, Script};
use formats::session::{LateralRun, Mark, Noise, Session, SessionWriter, Setup};
use mechanics::{Needle, Rig};
use protocol::{Fault, Refusal, Step};
use std::path::Path;
use std::sync::atomic::AtomicBool;

static NEVER: AtomicBool = AtomicBool::new(false);
const OPTIONS: RunOptions = RunOptions { start_us: None, stream: true, interrupted: &NEVER };
#[cfg(not(windows))]
const SWEEP: &str = r"printf 'z_mm,deflection_y_mm\n80,0.5\n90,0.25\n'";
#[cfg(windows)]
const SWEEP: &str = r#"cmd /c "echo z_mm,deflection_y_mm& echo 80,0.5& echo 90,0.25""#;
/// Prints what follows.
const SAY: &str = if cfg!(windows) { "cmd /c echo" } else { "echo" };

fn setup() -> Setup {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    Setup {
        name: "phantom".to_owned(),
        rig,
        fixture_mass_kg: None,
        noise: Noise::default(),
        tissue: Default::default(),
    }
}

fn hold(sweep: bool) -> Program {
    let step = Step::Hold { duration_ms: 1_000 };
    Program { name: "hold".to_owned(), steps: vec![PlannedStep { step, sweep }] }
}

/// Records a program on a device that behaves like this; the session as it then is, and how the recording ended.
fn record(script: Script, program: &Program) -> (Session, Result<super::Recorded, RecordError>, Vec<String>) {
    record_with(Ultrasound::Command(SWEEP), script, program)
}

/// The same with this ultrasound.
fn record_with(
    ultrasound: Ultrasound<'_>,
    script: Script,
    program: &Program,
) -> (Session, Result<super::Recorded, RecordError>, Vec<String>) {
    let folder = tempfile::tempdir().expect("a folder");
    record_in(folder.path(), ultrasound, script, program)
}

/// The same in this folder.
fn record_in(
    folder: &Path,
    ultrasound: Ultrasound<'_>,
    script: Script,
    program: &Program,
) -> (Session, Result<super::Recorded, RecordError>, Vec<String>) {
    let device = FakeDevice::start(script);
    let mut client = Client::connect(&device.port).expect("connects");
    let mut session = SessionWriter::open(folder, &setup()).expect("opens");
    let mut writer = session.lateral("d30-1", 0.03).expect("starts");
    writer.made_with(provenance(client.hello(), Some(true)));
    let ended = acquire(&mut client, program, OPTIONS, ultrasound, &mut Recorder::new(&mut writer), &mut ());
    writer.finish().expect("finishes");
    // Its lock is a file in the folder.
    drop(session);
    (Session::read(folder).expect("reads"), ended, files(folder))
}

fn files(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the folder");
    let mut names: Vec<String> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

fn playing(program: &[Act]) -> Script {
    Script { program: program.to_vec(), ..Script::default() }
}

fn samples(run: &LateralRun) -> usize {
    run.force.time_s.len()
}

#[test]
fn a_device_clock_that_steps_back_begins_a_segment_that_is_stated() {
    let program =
        [Act::Batch(32), Act::Batch(32), Act::ClockBack(50), Act::Batch(32), Act::Batch(32), Act::Complete];
    let folder = tempfile::tempdir().expect("a folder");
    let (session, ended, _) = record_in(folder.path(), Ultrasound::Absent, playing(&program), &hold(false));
    let recorded = ended.expect("completes");
    assert_eq!((recorded.samples, recorded.clock_steps, recorded.samples_missing), (128, 1, 0));
    assert_eq!(recorded.duration_s, 0.127);
    let times_s = &session.lateral[0].force.time_s;
    assert!(times_s.windows(2).all(|pair| (pair[1] - pair[0] - 1e-3).abs() < 1e-9), "{times_s:?}");
    let text = std::fs::read_to_string(folder.path().join("d30-1.force.csv")).expect("reads");
    let remarks: Vec<&str> = text.lines().filter(|line| line.starts_with('#')).collect();
    assert_eq!(remarks.len(), 1, "{remarks:?}");
    assert!(remarks[0].contains("a new segment: the device's clock has stepped back, from "), "{remarks:?}");
    assert_eq!(text.lines().position(|line| line.starts_with('#')), Some(65), "where it happened");
}

#[test]
fn samples_that_repeat_the_force_are_counted_and_left_out() {
    let program = [
        Act::Batch(32),
        Act::Saturated(true),
        Act::Batch(7),
        Act::Saturated(false),
        Act::Batch(32),
        Act::Complete,
    ];
    let (session, ended, _) = record_with(Ultrasound::Absent, playing(&program), &hold(false));
    let recorded = ended.expect("completes");
    assert_eq!((recorded.samples, recorded.samples_without_force, recorded.samples_missing), (64, 7, 0));
    let times_s = &session.lateral[0].force.time_s;
    assert!((times_s[32] - times_s[31] - 8e-3).abs() < 1e-9, "{times_s:?}");
}

#[test]
fn samples_sweeps_and_losses_are_in_the_session() {
    // 352 samples: the sweep is due 300 ms into the hold.
    let mut program = vec![Act::Batch(32); 11];
    program.insert(3, Act::Lost(20));
    program.extend([Act::Wait(300), Act::Batch(32), Act::Complete]);
    let (session, ended, _) = record(playing(&program), &hold(true));
    let recorded = ended.expect("completes");
    assert_eq!((recorded.samples, recorded.sweeps, recorded.samples_missing), (384, 1, 20));
    assert_eq!(recorded.duration_s, 0.403);
    let run = &session.lateral[0];
    assert_eq!(samples(run), 384);
    let hold_mark = Mark { step: Some(0), moving: Some(false) };
    assert_eq!(run.force.marks.as_deref(), Some(&[hold_mark; 384][..]));
    assert_eq!(run.provenance.calibration_crc, Some(fake::calibration().crc()));
    assert_eq!(run.provenance.calibration_id.as_deref(), Some("fake-1"));
    assert_eq!(run.provenance.firmware.as_deref(), Some("0.0.0 (fake)"));
    let lost = run.force.lost_before.as_ref().expect("the column");
    assert_eq!((lost[96], lost.iter().sum::<f64>()), (20.0, 20.0), "where they are missing");
    assert!((run.force.displacement_y_m[0] - 1_001e-6).abs() < 1e-9);
    assert!((run.shape.z_m[1] - 0.09).abs() < 1e-9 && (run.shape.y_m[1] - 0.25e-3).abs() < 1e-9);
    let sweep_s = run.shape.time_s.as_ref().expect("times")[0];
    assert!((sweep_s - 1.301).abs() < 1e-9, "the first sample 300 ms into the hold, not {sweep_s} s");
}

#[test]
fn frames_of_a_hold_are_listed_with_their_time() {
    let folder = tempfile::tempdir().expect("a folder");
    let frames = folder.path().join("frames.mha");
    std::fs::write(&frames, "frames").expect("a file");
    let command = format!("{SAY} '{}'", frames.display());
    let mut program = vec![Act::Batch(32); 11];
    program.extend([Act::Wait(300), Act::Batch(32), Act::Complete]);
    let (session, ended, files) = record_with(Ultrasound::Frames(&command), playing(&program), &hold(true));
    assert_eq!(ended.expect("completes").sweeps, 1);
    assert!(files.contains(&"d30-1.sweeps.toml".to_owned()), "{files:?}");
    assert!(session.lateral[0].shape.z_m.is_empty(), "the shape is yet to be measured");
}

#[test]
fn a_port_that_disappears_loses_nothing_that_had_arrived() {
    let (session, ended, _) =
        record(playing(&[Act::Batch(32), Act::Batch(8), Act::Wait(200), Act::Vanish]), &hold(false));
    assert!(matches!(ended, Err(RecordError::Link(LinkError::Gone { .. }))), "{ended:?}");
    assert_eq!(samples(&session.lateral[0]), 40);
    assert!(session.lateral[0].shape.z_m.is_empty());
}

#[test]
fn a_fault_loses_nothing_that_had_arrived() {
    let program = [Act::Batch(32), Act::Fail(Fault::ForceRange)];
    let (session, ended, _) = record(playing(&program), &hold(false));
    let fault = Some(Fault::ForceRange);
    assert!(
        matches!(ended, Err(RecordError::Link(LinkError::ProgramEnded { fault: f })) if f == fault),
        "{ended:?}"
    );
    assert_eq!(samples(&session.lateral[0]), 32);
}

#[test]
fn a_hold_that_is_over_before_its_sweep_is_an_error() {
    let (_, ended, _) = record(playing(&[Act::Complete]), &hold(true));
    assert!(matches!(ended, Err(RecordError::HoldWithoutSamples { number: 1 })), "{ended:?}");
    let program = [Act::Batch(32), Act::Complete];
    let (_, ended, _) = record(playing(&program), &hold(true));
    assert!(matches!(ended, Err(RecordError::HoldTooShort { number: 1 })), "{ended:?}");
    let mut program = vec![Act::Batch(32); 11];
    program.push(Act::Complete);
    let (session, ended, _) = record(playing(&program), &hold(true));
    assert!(matches!(ended, Err(RecordError::HoldTooShort { number: 1 })), "{ended:?}");
    assert_eq!(samples(&session.lateral[0]), 352);
}

#[test]
fn a_run_that_never_started_leaves_nothing_behind() {
    let script = Script { refusal: Some(Refusal::TooLate), ..Script::default() };
    let (session, ended, files) = record(script, &hold(false));
    assert!(matches!(ended, Err(RecordError::Link(LinkError::Refused { .. }))), "{ended:?}");
    assert!(session.lateral.is_empty());
    assert_eq!(files, ["session.toml"]);
}
