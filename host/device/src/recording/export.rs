//! A recording as a session's lateral run, or as an array for NumPy.

use super::contents::{Contents, Survey};
use super::error::RecordingError;
use super::replay::{Replay, ReplayItem};
use crate::link::Batch;
use crate::record::{Recorder, provenance};
use formats::files::NewFile;
use formats::session::{SessionWriter, Setup};
use protocol::State;
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::path::Path;

/// Options for content that a session needs and the recording may lack; an option has precedence
/// over recorded content.
#[derive(Debug, Clone, Default)]
pub struct RunOptions {
    /// Name of the run.
    pub id: Option<String>,
    /// Insertion depth of the needle, millimetres.
    pub depth_mm: Option<f64>,
    /// Needle, guides and noise.
    pub setup: Option<Setup>,
}

/// Result of an export.
#[derive(Debug, Clone, PartialEq)]
pub struct Exported {
    /// Contents of the recording.
    pub contents: Contents,
    /// Name of the run in the session.
    pub run: Option<String>,
    /// Rows written.
    pub rows: u64,
}

/// Writes the rows that `guide record` or `guide acquire` wrote, bit for bit, as a lateral run of a session.
///
/// # Errors
/// [`RecordingError::Unknown`] where depth or rig are neither recorded nor given, [`RecordingError::NoHello`], errors of
/// the session.
pub fn to_session(
    from: &Path,
    dir: &Path,
    options: &RunOptions,
    progress: &mut dyn FnMut(u64),
) -> Result<Exported, RecordingError> {
    let mut replay = Replay::open(from)?;
    fn unknown(what: &'static str, option: &'static str, from: &Path) -> RecordingError {
        RecordingError::Unknown { path: from.to_owned(), what, option }
    }
    let tared = replay.about().and_then(|about| about.tared);
    let made_with = match replay.hello() {
        Some(hello) => provenance(hello, tared),
        None => return Err(RecordingError::NoHello { path: from.to_owned() }),
    };
    let info = replay.about().cloned();
    let depth_mm = options.depth_mm.or(info.as_ref().map(|info| info.depth_mm));
    let depth_mm = depth_mm.ok_or_else(|| unknown("the depth", "--depth-mm MM", from))?;
    let recorded_setup = info.as_ref().map(|info| Setup::parse(from, &info.rig_toml)).transpose()?;
    let setup = options.setup.clone().or(recorded_setup);
    let setup = setup.ok_or_else(|| unknown("the rig", "--rig FILE", from))?;
    let id = options
        .id
        .clone()
        .or_else(|| info.as_ref().map(|info| info.run.clone()))
        .unwrap_or_else(|| format!("d{depth_mm}-1"));
    // A program's recording has its own states only; the time before its start and after its end is not part of the run.
    let program_only = info.is_some_and(|info| info.command == "acquire");

    let mut session = SessionWriter::open(dir, &setup)?;
    let export = || {
        let mut writer = session.lateral(&id, 1e-3 * depth_mm)?;
        writer.made_with(made_with);
        let mut recorder = Recorder::new(&mut writer);
        let contents = each_batch(&mut replay, progress, |batch| {
            let is_outside_run =
                matches!(batch.state, State::Idle | State::Pending | State::Faulted | State::Retreating);
            if program_only && is_outside_run { Ok(()) } else { Ok(recorder.batch(batch)?) }
        })?;
        let rows = recorder.recorded().samples;
        writer.finish()?;
        if rows == 0 {
            Err(RecordingError::NoSamples { path: from.to_owned() })
        } else {
            Ok((contents, rows))
        }
    };
    match export() {
        Ok((contents, rows)) => Ok(Exported { contents, run: Some(id), rows }),
        Err(error) => {
            // The recording is still there: all of it or nothing, so that the same command works once there is room.
            session.undo();
            Err(error)
        }
    }
}

/// Fields of a row in an array, with their types as NumPy names them.
const FIELDS: &str = "[('time_s', '<f8'), ('displacement_x_mm', '<f8'), ('displacement_y_mm', '<f8'), ('force_x_n', '<f8'), \
     ('force_y_n', '<f8'), ('step', '<i2'), ('state', 'u1'), ('lost_before', '<u4')]";
/// Bytes before the rows: a multiple of 64, with room for any number of rows.
const NPY_HEAD_BYTES: usize = 320;

/// Writes every sample as a row of a structured array (`numpy.load`): times, positions and forces as the link gives them (not a number where
/// there was no valid reading of the force), step
/// (-1 outside a program), state (0 idle, 1 pending, 2 moving, 3 holding, 4 taring, 5 faulted), samples missing before.
///
/// # Errors
/// [`RecordingError`]; an existing file is not overwritten.
pub fn to_npy(from: &Path, to: &Path, progress: &mut dyn FnMut(u64)) -> Result<Exported, RecordingError> {
    let mut replay = Replay::open(from)?;
    if replay.hello().is_none() {
        return Err(RecordingError::NoHello { path: from.to_owned() });
    }
    let new = NewFile::create(to).map_err(RecordingError::io(to, 0, "create"))?;
    let mut npy = Npy { path: to, file: BufWriter::new(new.file()), rows: 0 };
    npy.head()?;
    let contents = each_batch(&mut replay, progress, |batch| npy.batch(batch))?;
    // Now the number of rows is known.
    npy.head()?;
    npy.file.flush().map_err(RecordingError::io(to, 0, "write"))?;
    let rows = npy.rows;
    drop(npy);
    new.finish().map_err(RecordingError::io(to, 0, "write"))?;
    Ok(Exported { contents, run: None, rows })
}

struct Npy<'a> {
    path: &'a Path,
    file: BufWriter<&'a File>,
    rows: u64,
}

impl Npy<'_> {
    fn head(&mut self) -> Result<(), RecordingError> {
        let text = format!("{{'descr': {FIELDS}, 'fortran_order': False, 'shape': ({},), }}", self.rows);
        let room = NPY_HEAD_BYTES - 10;
        let head = format!("{text:<width$}\n", width = room - 1);
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend_from_slice(&(room as u16).to_le_bytes());
        bytes.extend_from_slice(head.as_bytes());
        let io = RecordingError::io(self.path, 0, "write");
        self.file.seek(SeekFrom::Start(0)).and_then(|_| self.file.write_all(&bytes)).map_err(io)
    }

    fn batch(&mut self, batch: &Batch) -> Result<(), RecordingError> {
        let mut row = Vec::with_capacity(48 * batch.points.len());
        let mut lost_before = batch.lost_before;
        for point in &batch.points {
            let [x_m, y_m] = point.displacement_m;
            let [force_x_n, force_y_n] = if point.repeats_force { [f64::NAN; 2] } else { point.force_n };
            for value in [point.time_s, 1e3 * x_m, 1e3 * y_m, force_x_n, force_y_n] {
                row.extend_from_slice(&value.to_le_bytes());
            }
            row.extend_from_slice(&batch.step.map_or(-1, i16::from).to_le_bytes());
            row.push(batch.state as u8);
            let lost = u32::try_from(std::mem::take(&mut lost_before)).unwrap_or(u32::MAX);
            row.extend_from_slice(&lost.to_le_bytes());
        }
        let offset = NPY_HEAD_BYTES as u64 + 47 * self.rows;
        self.rows += batch.points.len() as u64;
        self.file.write_all(&row).map_err(RecordingError::io(self.path, offset, "write"))
    }
}

/// Hands out every batch that is to be used, in order.
fn each_batch(
    replay: &mut Replay,
    progress: &mut dyn FnMut(u64),
    mut take: impl FnMut(&Batch) -> Result<(), RecordingError>,
) -> Result<Contents, RecordingError> {
    let mut survey = Survey::default();
    while let Some(item) = replay.next()? {
        progress(replay.position());
        survey.observe(&item);
        if let ReplayItem::Frame { batch: Some(batch), .. } = &item {
            take(batch)?;
        }
    }
    Ok(survey.contents(replay))
}
