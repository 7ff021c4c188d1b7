//! `guide calibrate-image`: where an ultrasound image plane is on its probe, from a sequence over a phantom of N-shaped wires.

use super::frame_pictures::{self, PictureArgs, Shown};
use super::import_ultrasound::{checksum, orientation, region, spacing};
use super::output::{Output, write_file};
use anyhow::Context;
use formats::image_calibration::ImageCalibration;
use formats::session::import::name_of;
use imaging::calibrate::phantom::Phantom;
use imaging::calibrate::solve::Errors;
use imaging::calibrate::{Calibration, Settings, State, calibrate};
use imaging::frame::{Orientation, Region};
use imaging::overlay::Picture;
use imaging::read::Sequence;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Display};
use std::path::{Path, PathBuf};

/// Calibrate an ultrasound image plane against its probe, from a sequence over a phantom of N-shaped wires
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide calibrate-image nwires.igs.mha --phantom PlusDeviceSet.xml --out image.toml\n  guide import ultrasound sweep.igs.mha \
                  --straight zero.igs.mha --calibration image.toml --tracker-to-guide 1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1 --out phantom-d"
)]
pub struct Args {
    /// Sequence over the phantom, with the transforms of probe and phantom in every frame (`.mha`, `.nrrd`)
    sequence: PathBuf,
    /// Geometry of the wires and registration of the phantom: a configuration of PLUS with `<Pattern Type="NWire">` and
    /// `<Transform From="Phantom">`
    #[arg(long, value_name = "FILE")]
    phantom: PathBuf,
    /// Calibration file to write
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Transform of the sequence from the probe to the tracker
    #[arg(long, value_name = "NAME", default_value = "ProbeToTracker")]
    transform: String,
    /// Transform of the sequence from the phantom's reference to the tracker; none where the phantom is registered to the tracker itself
    #[arg(long, value_name = "NAME", default_value = "ReferenceToTracker")]
    reference: String,
    /// Size of a pixel to about a tenth (default: of the sequence, or of the phantom's file)
    #[arg(long, value_name = "X,Y", value_parser = spacing)]
    spacing_mm: Option<[f64; 2]>,
    /// Axes of the image, where the sequence does not state them
    #[arg(long, value_name = "MF|UF|MN|UN", value_parser = orientation)]
    orientation: Option<Orientation>,
    /// Part of the oriented frame in which the wires are, pixels
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    region: Option<Region>,
    #[command(flatten)]
    pictures: PictureArgs,
}

/// Extent of a wire's echo across the beam, millimetres.
const ECHO_MM: f64 = 1.5;

#[derive(Serialize)]
struct Document {
    schema: &'static str,
    sequence: PathBuf,
    sequence_sha256: String,
    phantom: PathBuf,
    phantom_sha256: String,
    patterns: usize,
    frames: usize,
    /// Frames in each state.
    states: BTreeMap<&'static str, usize>,
    spacing_mm: [f64; 2],
    spacing_sd: [f64; 2],
    image_to_probe: [f64; 16],
    place_sd_mm: f64,
    rotation_sd_deg: f64,
    /// Delay of transforms after images; `None` if the motion does not determine it.
    lag_s: Option<f64>,
    residual_mm: f64,
    used: ErrorEntry,
    validation: ErrorEntry,
    calibration: Option<PathBuf>,
    per_frame: Vec<FrameEntry>,
}

/// Errors on a part of the frames.
#[derive(Serialize)]
struct ErrorEntry {
    frames: usize,
    slanted_wire_mean_mm: f64,
    slanted_wire_p95_mm: f64,
    in_plane_mean_mm: f64,
}

#[derive(Serialize)]
struct FrameEntry {
    state: &'static str,
    /// Wires in the order of the phantom, pixels.
    wires_px: Vec<[f64; 2]>,
}

impl ErrorEntry {
    fn new(errors: &Errors) -> Self {
        Self {
            frames: errors.frames,
            slanted_wire_mean_mm: errors.slanted_mean_mm,
            slanted_wire_p95_mm: errors.slanted_p95_mm,
            in_plane_mean_mm: errors.plane_mean_mm,
        }
    }
}

/// Runs the sub-command.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    let phantom = Phantom::read(&args.phantom)?;
    let mut sequence = Sequence::open(&args.sequence)?;
    let settings = Settings {
        about_mm_per_px: args.spacing_mm.map(|[x, y]| 0.5 * (x + y)),
        orientation: args.orientation,
        region: args.region,
        probe: args.transform.clone(),
        reference: (args.reference != "none").then(|| args.reference.clone()),
        echo_mm: ECHO_MM,
    };
    let count = sequence.header().count;
    let path = &args.sequence;
    let progress = out.progress();
    let calibrated = calibrate(&mut sequence, &phantom, &settings, |frame| {
        progress.set_message(format!("{}: frame {} of {count}", path.display(), frame + 1));
    });
    progress.finish_and_clear();
    let calibration = calibrated.with_context(|| path.display().to_string())?;
    draw(args, path, &calibration, out)?;
    let document = document(args, &phantom, &calibration)?;
    if let Some(output_path) = &args.out {
        write_file(output_path, &file(args, &calibration, &document))?;
    }
    out.result(&document, &document)
}

/// The calibration file.
fn file(args: &Args, found: &Calibration, document: &Document) -> String {
    let solution = &found.solution;
    let calibration = ImageCalibration {
        spacing_mm: solution.spacing_mm,
        transform: args.transform.clone(),
        image_to_probe: Box::new(solution.image_to_probe),
    };
    let notes = [
        ("frames", document.used.frames.to_string()),
        ("residual_mm", format!("{:.4}", solution.residual_mm)),
        ("validation_mm", format!("{:.4}", document.validation.slanted_wire_mean_mm)),
    ];
    let files = [
        (args.sequence.display().to_string(), document.sequence_sha256.clone()),
        (args.phantom.display().to_string(), document.phantom_sha256.clone()),
    ];
    calibration.to_toml(&notes, &files)
}

fn document(args: &Args, phantom: &Phantom, found: &Calibration) -> anyhow::Result<Document> {
    let solution = &found.solution;
    let states = State::ALL.into_iter().map(|state| (state.name(), count_of(state, &found.states)));
    let [fit_errors, validation] = found.errors.each_ref().map(ErrorEntry::new);
    let per_frame = found.states.iter().enumerate().map(|(number, state)| {
        let cut = found.observations.iter().find(|one| one.frame == number);
        let wires_px = cut.map(|one| one.cut.iter().flatten().copied().collect());
        FrameEntry { state: state.name(), wires_px: wires_px.unwrap_or_default() }
    });
    Ok(Document {
        schema: "guide.calibrate-image/1",
        sequence: args.sequence.clone(),
        sequence_sha256: checksum(&args.sequence)?,
        phantom: args.phantom.clone(),
        phantom_sha256: checksum(&args.phantom)?,
        patterns: phantom.patterns.len(),
        frames: found.states.len(),
        states: states.filter(|(_, count)| *count > 0).collect(),
        spacing_mm: solution.spacing_mm,
        spacing_sd: solution.sd_spacing,
        image_to_probe: solution.image_to_probe,
        place_sd_mm: solution.sd_place_mm,
        rotation_sd_deg: solution.sd_rotation_rad.to_degrees(),
        lag_s: solution.lag_s,
        residual_mm: solution.residual_mm,
        used: fit_errors,
        validation,
        calibration: args.out.clone(),
        per_frame: per_frame.collect(),
    })
}

fn count_of(state: State, states: &[State]) -> usize {
    states.iter().filter(|one| **one == state).count()
}

/// Draws what is requested.
fn draw(args: &Args, path: &Path, found: &Calibration, out: &Output) -> anyhow::Result<()> {
    let shown: Vec<Shown> = found
        .states
        .iter()
        .map(|state| Shown {
            kind: kind(*state),
            state: state.name(),
            is_used: is_used(*state),
            place: String::new(),
        })
        .collect();
    let sequence_orientation = Sequence::open(path)?.header().orientation;
    let orientation = args.orientation.or(sequence_orientation).unwrap_or_default();
    let files = [path.to_owned()];
    frame_pictures::draw(
        &args.pictures,
        &name_of(path),
        &files,
        &shown,
        |number: usize, frame: imaging::frame::Frame| {
            let cut = found.observations.iter().find(|one| one.frame == number).map(|one| one.cut.as_slice());
            let echoes_px: Vec<[f64; 2]> = cut.unwrap_or_default().iter().flatten().copied().collect();
            let frame_is_used = found.states.get(number).is_some_and(|state| is_used(*state));
            Picture::of_places(&frame.oriented(orientation), &echoes_px, frame_is_used)
        },
        out,
    )
    .map(|_| ())
}

fn is_used(state: State) -> bool {
    matches!(state, State::Used | State::Validation)
}

fn kind(state: State) -> usize {
    State::ALL.iter().position(|other| *other == state).unwrap_or(0)
}

impl Display for Document {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let states: Vec<String> =
            self.states.iter().map(|(state, count)| format!("{count} {state}")).collect();
        writeln!(f, "frames       {}: {}: {}", self.sequence.display(), self.frames, states.join(", "))?;
        let ([x, y], [sd_x, sd_y]) = (self.spacing_mm, self.spacing_sd);
        writeln!(f, "pixel        {x:.5} x {y:.5} mm (sd {:.2} %, {:.2} %)", 100.0 * sd_x, 100.0 * sd_y)?;
        let m = &self.image_to_probe;
        for (label, row) in ["image to", "probe", ""].iter().zip(m.as_chunks::<4>().0) {
            writeln!(f, "{label:<12} {:9.5} {:9.5} {:9.5} {:9.3}", row[0], row[1], row[2], row[3])?;
        }
        writeln!(f, "             sd {:.3} mm, {:.3} degrees", self.place_sd_mm, self.rotation_sd_deg)?;
        for (label, errors) in [("used", &self.used), ("validation", &self.validation)] {
            writeln!(
                f,
                "{label:<12} {} frames: slanted wires {:.2} mm mean, {:.2} mm 95 %; all wires in the image {:.2} mm mean",
                errors.frames,
                errors.slanted_wire_mean_mm,
                errors.slanted_wire_p95_mm,
                errors.in_plane_mean_mm
            )?;
        }
        match self.lag_s {
            Some(lag_s) => writeln!(f, "lag          {lag_s:.3} s, transforms behind images")?,
            None => writeln!(f, "lag          not identifiable from this sequence")?,
        }
        match &self.calibration {
            Some(path) => writeln!(f, "written      {}", path.display()),
            None => writeln!(f, "note         nothing is written: --out FILE keeps the calibration"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::call::call;
    use std::ffi::OsString;

    /// `guide import ultrasound --calibration` reads the written file.
    #[test]
    fn the_calibration_of_a_real_sequence_is_written_and_read() {
        let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("imaging/tests/data");
        let folder = tempfile::tempdir().expect("a folder");
        let image_file = folder.path().join("image.toml");
        let arguments: [OsString; 6] = [
            "calibrate-image".into(),
            data.join("plus-nwire.igs.mha").into(),
            "--phantom".into(),
            data.join("plus-fcal.xml").into(),
            "--out".into(),
            image_file.clone().into(),
        ];
        let called = call(arguments, |_| {}).expect("calibrated");
        let document: serde_json::Value = serde_json::from_str(&called.document).expect("JSON");
        let calibration = ImageCalibration::read(&image_file).expect("a calibration");
        assert_eq!(document["image_to_probe"][3].as_f64(), calibration.image_to_probe.get(3).copied());
        assert_eq!(document["schema"], "guide.calibrate-image/1");
        assert_eq!(document["per_frame"].as_array().map(Vec::len), Some(24));
    }
}
