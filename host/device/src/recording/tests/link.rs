//! Recordings of a device: the same rows as beside it, readable at any time.

use super::*;
use crate::link::program::PlannedStep;
use crate::link::{Client, Program, RunOptions as Run};
use crate::record::{Recorder, Ultrasound, acquire, provenance};
use crate::recording::export::{RunOptions, to_session};
use crate::recording::{Contents, RawRecorder};
use fake_device::{Act, FakeDevice, Script};
use formats::session::{self, SessionWriter, Setup};
use mechanics::{Needle, Rig};
use protocol::Step;
use std::sync::atomic::AtomicBool;

static NEVER: AtomicBool = AtomicBool::new(false);

fn setup() -> Setup {
    let rig = Rig::two_guides(Needle::gauge_18(), 0.06, 0.07);
    Setup {
        name: "phantom".to_owned(),
        rig,
        fixture_mass_kg: None,
        noise: session::Noise::default(),
        tissue: Default::default(),
    }
}

fn program() -> Program {
    let step = Step::Hold { duration_ms: 1_000 };
    Program { name: "hold".to_owned(), steps: vec![PlannedStep { step, sweep: false }] }
}

#[test]
fn an_export_has_the_very_files_that_were_written_beside_the_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let (direct, exported) = (folder.path().join("direct"), folder.path().join("exported"));
    let raw_path = folder.path().join("d30-1.mcap");
    let acts = [
        Act::Batch(32),
        Act::Lost(20),
        Act::Batch(7),
        Act::Corrupt(12),
        Act::Dropped(40),
        Act::Wait(300),
        Act::Batch(32),
        Act::Fail(Fault::ForceLimit),
    ];
    let device = FakeDevice::start(Script { program: acts.to_vec(), ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let info = RecordingInfo::new("acquire", "d30-1", 30.0, setup().to_toml(&raw_path).expect("finite"));
    let raw = RawRecorder::start(&raw_path, info, &mut client).expect("begins");
    let mut session = SessionWriter::open(&direct, &setup()).expect("opens");
    let mut writer = session.lateral("d30-1", 0.03).expect("starts");
    writer.made_with(provenance(client.hello(), None));
    let options = Run { start_us: None, stream: true, interrupted: &NEVER };
    let outcome = acquire(
        &mut client,
        &program(),
        options,
        Ultrasound::Absent,
        &mut Recorder::new(&mut writer),
        &mut (),
    );
    outcome.expect_err("the fault");
    writer.finish().expect("finishes");
    let losses = client.losses();
    let file = raw.finish().expect("finishes");

    let exported_run =
        to_session(&raw_path, &exported, &RunOptions::default(), &mut |_| {}).expect("exports");
    for name in ["session.toml", "d30-1.force.csv", "d30-1.shape.csv"] {
        let file_texts =
            [&direct, &exported].map(|session| fs::read_to_string(session.join(name)).expect(name));
        assert_eq!(file_texts[0], file_texts[1], "{name}");
    }
    let contents = exported_run.contents;
    assert_eq!(contents.bytes, file.bytes);
    assert_eq!(exported_run.rows, 71);
    assert_eq!(
        (contents.samples_missing, contents.frames_missing),
        (losses.samples_missing, losses.frames_missing)
    );
    assert_eq!((contents.samples_missing, contents.frames_missing), (72, 2));
    assert_eq!(contents.faults[0].number, 5);
    assert_eq!(contents.device.as_ref().map(|device| device.calibration_id.as_str()), Some("fake-1"));
    assert!(messages(&raw_path).iter().any(|read| read.topic == "/guide/command"));
}

#[test]
fn what_has_arrived_is_in_the_file_though_it_is_not_finished() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("a.mcap");
    let acts = [Act::Batch(32), Act::Batch(32), Act::Wait(600), Act::Complete];
    let device = FakeDevice::start(Script { program: acts.to_vec(), ..Script::default() });
    let mut client = Client::connect(&device.port).expect("connects");
    let raw = RawRecorder::start(&path, about(), &mut client).expect("begins");
    let copy = folder.path().join("copy.mcap");
    let mut written = 0;
    let options = Run { start_us: None, stream: true, interrupted: &NEVER };
    crate::link::run(&mut client, &program(), options, |_, _| {
        fs::copy(&path, &copy).expect("copies");
        if let Ok(contents) = Contents::read(&copy, &mut |_| {}) {
            assert!(contents.damage.unfinished && contents.damage.count == 0, "{contents:?}");
            written = written.max(contents.samples);
        }
        Ok::<(), crate::link::LinkError>(())
    })
    .expect("completes");
    assert_eq!(written, 64, "while the program was still running");
    raw.finish().expect("finishes");
    assert!(!Contents::read(&path, &mut |_| {}).expect("reads").damage.unfinished);
}
