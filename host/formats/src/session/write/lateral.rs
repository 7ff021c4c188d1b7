//! Writing a lateral run: rows go to its CSV files as they come; with the first of them it is entered in `session.toml`.

use super::super::{FrameSweep, Provenance, sweeps_file};
use super::{SessionWriter, enter};
use crate::document::{SessionError, io, number, replace};
use mechanics::ShapeImage;
use std::fmt::Write as _;
use std::fs::{self, File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::PathBuf;

/// One row of a force series.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ForceRow {
    /// Time; must increase from row to row.
    pub time_s: f64,
    /// Vertical displacement of guide 2.
    pub displacement_y_m: f64,
    /// Vertical force.
    pub force_y_n: f64,
    /// Horizontal displacement of guide 2.
    pub displacement_x_m: f64,
    /// Horizontal force.
    pub force_x_n: f64,
    /// Step of the motion program, where one is running.
    pub step: Option<u32>,
    /// Whether that step moves guide 2, where it is known.
    pub moving: Option<bool>,
    /// Samples lost between the row before and this one.
    pub lost_before: u64,
}

/// One point of a shape sweep.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ShapeRow {
    /// Time.
    pub time_s: f64,
    /// Position along the needle from guide 1.
    pub z_m: f64,
    /// Vertical deflection.
    pub deflection_y_m: f64,
    /// Horizontal deflection.
    pub deflection_x_m: f64,
    /// Image of the point; written if the run is one of images ([`LateralWriter::imaged`]).
    pub image: Option<ShapeImage>,
}

/// A lateral run being written. Flushed rows are a part of the session, even if this program is killed.
#[derive(Debug)]
pub struct LateralWriter<'a> {
    session: &'a mut SessionWriter,
    id: String,
    depth_m: f64,
    provenance: Provenance,
    force: CsvFile,
    shape: CsvFile,
    has_images: bool,
    frames: Vec<FrameSweep>,
    has_rows: bool,
}

/// Columns of a shape, and those of its images.
const SHAPE_HEADER: &str = "time_s,z_mm,deflection_y_mm,deflection_x_mm";
const IMAGE_HEADER: &str = "beam_deg,probe_mm_per_s";

impl<'a> LateralWriter<'a> {
    /// A run of which nothing is written yet.
    pub(super) fn new(session: &'a mut SessionWriter, id: &str, depth_m: f64) -> Self {
        let csv = |kind: &str, header: &str| CsvFile {
            path: session.dir.join(format!("{id}.{kind}.csv")),
            rows: format!("{header}\n"),
            file: None,
            bytes: 0,
        };
        let force = csv(
            "force",
            "time_s,displacement_y_mm,force_y_n,displacement_x_mm,force_x_n,step,lost_before,moving",
        );
        let shape = csv("shape", SHAPE_HEADER);
        let provenance = Provenance::default();
        Self {
            session,
            id: id.to_owned(),
            depth_m,
            provenance,
            force,
            shape,
            has_images: false,
            frames: Vec::new(),
            has_rows: false,
        }
    }

    /// States what the run is recorded with; to be called before its first row.
    pub fn made_with(&mut self, provenance: Provenance) {
        self.provenance = provenance;
    }

    /// States that it is known how the points of the shape are imaged; to be called before its first row.
    pub fn imaged(&mut self) {
        self.has_images = true;
        self.shape.rows = format!("{SHAPE_HEADER},{IMAGE_HEADER}\n");
    }

    /// Adds a row to the force series.
    ///
    /// # Errors
    /// [`SessionError::NotFinite`], or an error of the operating system.
    pub fn force(&mut self, row: &ForceRow) -> Result<(), SessionError> {
        let mut line = self.force.numbers(&[
            ("time_s", row.time_s),
            ("displacement_y_mm", 1e3 * row.displacement_y_m),
            ("force_y_n", row.force_y_n),
            ("displacement_x_mm", 1e3 * row.displacement_x_m),
            ("force_x_n", row.force_x_n),
        ])?;
        let step = row.step.map(|step| step.to_string()).unwrap_or_default();
        let moving = row.moving.map(|moving| u8::from(moving).to_string()).unwrap_or_default();
        let _ = write!(line, ",{step},{},{moving}", row.lost_before);
        self.add(|run| &mut run.force, &line)
    }

    /// Adds a remark between the rows of the force series.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn remark(&mut self, text: &str) -> Result<(), SessionError> {
        self.add(|run| &mut run.force, &format!("# {text}"))
    }

    /// Adds a point to the shape.
    ///
    /// # Errors
    /// As [`LateralWriter::force`].
    pub fn shape(&mut self, row: &ShapeRow) -> Result<(), SessionError> {
        let mut line = self.shape.numbers(&[
            ("time_s", row.time_s),
            ("z_mm", 1e3 * row.z_m),
            ("deflection_y_mm", 1e3 * row.deflection_y_m),
            ("deflection_x_mm", 1e3 * row.deflection_x_m),
        ])?;
        if self.has_images {
            let image = row.image.unwrap_or(ShapeImage { beam_rad: f64::NAN, probe_m_per_s: f64::NAN });
            let numbers = self.shape.numbers(&[
                ("beam_deg", image.beam_rad.to_degrees()),
                ("probe_mm_per_s", 1e3 * image.probe_m_per_s),
            ])?;
            let _ = write!(line, ",{numbers}");
        }
        self.add(|run| &mut run.shape, &line)
    }

    /// Lists frames that were taken in a hold, from which the shape is yet to be measured.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn frames(&mut self, sweep: FrameSweep) -> Result<(), SessionError> {
        self.frames.push(sweep);
        let path = sweeps_file(&self.session.dir, &self.id);
        replace(&path, &FrameSweep::to_toml(&self.session.dir, &self.id, &self.frames))?;
        if self.frames.len() == 1 {
            self.session.made.push(path);
        }
        Ok(())
    }

    fn add(&mut self, file: impl Fn(&mut Self) -> &mut CsvFile, line: &str) -> Result<(), SessionError> {
        self.has_rows = true;
        let rows = &mut file(self).rows;
        rows.push_str(line);
        rows.push('\n');
        if rows.len() > MAX_PENDING_BYTES { self.flush() } else { Ok(()) }
    }

    /// Hands all rows so far to the operating system, whole rows only, so that a crash of this program loses none of them.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn flush(&mut self) -> Result<(), SessionError> {
        if !self.has_rows {
            return Ok(());
        }
        let is_new = self.force.file.is_none();
        let force = self.force.flush();
        if is_new && self.force.bytes == 0 {
            // The run has no rows: nothing is left that would be in the way of the next attempt.
            if self.force.file.take().is_some() {
                let _ = fs::remove_file(&self.force.path);
            }
            return force;
        }
        let flushed = force.and(self.shape.flush());
        if is_new {
            let series_files = [&self.force, &self.shape].into_iter().filter(|csv| csv.file.is_some());
            self.session.made.extend(series_files.map(|csv| csv.path.clone()));
        }
        // The rows of a run that could be written are a part of the session.
        let has_both = self.force.file.is_some() && self.shape.file.is_some();
        if is_new && (flushed.is_ok() || has_both) {
            let entered = self.enter();
            if entered.is_err() {
                // Files that the session does not name are no part of it, and would be in the way of the next attempt.
                for csv in [&self.force, &self.shape] {
                    let _ = fs::remove_file(&csv.path);
                }
                self.has_rows = false;
            }
            entered.and(flushed)
        } else {
            flushed
        }
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// As reported by the operating system.
    pub fn finish(mut self) -> Result<(), SessionError> {
        self.flush()
    }

    /// Enters the run in `session.toml`.
    fn enter(&mut self) -> Result<(), SessionError> {
        let path = self.session.dir.join("session.toml");
        let depth_mm = number(&path, "depth_mm", 1e3 * self.depth_m)?;
        let id = &self.id;
        let mut entry = format!(
            "\n[[lateral]]\nid = \"{id}\"\ndepth_mm = {depth_mm}\nforce = \"{id}.force.csv\"\nshape = \"{id}.shape.csv\"\n"
        );
        let Provenance { calibration_id, calibration_crc, device, firmware, tared } = self.provenance.clone();
        for (field, value) in [
            ("calibration_id", calibration_id),
            ("calibration_crc", calibration_crc.map(|crc| format!("{crc:08x}"))),
            ("device", device),
            ("firmware", firmware),
        ] {
            // The device may report nothing, and an empty string would not be read.
            if let Some(value) = value.filter(|value| !value.trim().is_empty()) {
                let _ = writeln!(entry, "{field} = {}", toml::Value::from(value));
            }
        }
        if let Some(tared) = tared {
            let _ = writeln!(entry, "tared = {tared}");
        }
        enter(&self.session.dir, &entry)?;
        self.session.lateral_ids.push(self.id.clone());
        Ok(())
    }
}

/// Rows are handed to the operating system when they are as long as this, even without a flush.
const MAX_PENDING_BYTES: usize = 1 << 20;

/// A CSV file being written: created with its first rows, which wait here until they are flushed.
#[derive(Debug)]
struct CsvFile {
    path: PathBuf,
    rows: String,
    file: Option<File>,
    /// Bytes in the file.
    bytes: u64,
}

impl CsvFile {
    /// A row.
    fn numbers(&self, cells: &[(&'static str, f64)]) -> Result<String, SessionError> {
        let cells: Result<Vec<_>, _> =
            cells.iter().map(|(name, value)| number(&self.path, name, *value)).collect();
        Ok(cells?.join(","))
    }

    /// Hands the rows so far to the operating system.
    fn flush(&mut self) -> Result<(), SessionError> {
        let file = match &mut self.file {
            Some(file) => file,
            None => {
                let new = OpenOptions::new().write(true).create_new(true).open(&self.path);
                self.file.insert(new.map_err(io(&self.path, "create"))?)
            }
        };
        let written = write_whole(file, self.rows.as_bytes());
        self.bytes += written.bytes as u64;
        self.rows.drain(..written.bytes);
        if written.outcome.is_err() {
            // A row that is cut off all the same is skipped by the reader.
            let _ = file.set_len(self.bytes).and_then(|()| file.seek(SeekFrom::End(0)));
        }
        written
            .outcome
            .map_err(io(&self.path, "write all rows (those before are whole, and read as any others)"))
    }
}

/// Result of writing rows.
struct Written {
    /// Whole rows that were written, bytes.
    bytes: usize,
    outcome: std::io::Result<()>,
}

/// Appends rows. If some of them cannot be written, as on a full disk, those that are complete count.
fn write_whole(file: &mut impl Write, rows: &[u8]) -> Written {
    let mut bytes = 0;
    let outcome = loop {
        let Some(unwritten) = rows.get(bytes..).filter(|rest| !rest.is_empty()) else { break Ok(()) };
        match file.write(unwritten) {
            Ok(0) => break Err(std::io::ErrorKind::WriteZero.into()),
            Ok(count) => bytes += count,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
            Err(error) => break Err(error),
        }
    };
    if outcome.is_err() {
        let whole = rows.get(..bytes).and_then(|rows| rows.iter().rposition(|byte| *byte == b'\n'));
        bytes = whole.map_or(0, |end| end + 1);
    }
    Written { bytes, outcome }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A disk with so much room, which takes a few bytes at a time.
    struct Disk {
        room: usize,
        kept: Vec<u8>,
    }

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let count = bytes.len().min(7).min(self.room - self.kept.len());
            if count == 0 {
                return Err(std::io::ErrorKind::StorageFull.into());
            }
            self.kept.extend_from_slice(&bytes[..count]);
            Ok(count)
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_disk_takes_whole_rows_wherever_it_is_full() {
        let rows = b"1,2,3\n4,5,6\n7,8,9\n";
        for room in 0..=rows.len() {
            let mut disk = Disk { room, kept: Vec::new() };
            let written = write_whole(&mut disk, rows);
            assert_eq!(written.bytes, room / 6 * 6, "room for {room}");
            assert_eq!(written.outcome.is_ok(), room == rows.len());
        }
    }
}
