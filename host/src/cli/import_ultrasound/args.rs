//! Options of frames that show the needle.

use super::values::{Matrix, matrix, orientation, pair, region, spacing, speed, step};
use crate::cli::import_shapes;
use anyhow::{Context, bail, ensure};
use formats::image_calibration::ImageCalibration;
use formats::session::Setup;
use imaging::frame::{Orientation, Region};
use imaging::pose::Place;
use imaging::sweep::{Deflection, Settings, Sweep};
use std::path::PathBuf;

/// Frames that show the needle.
#[derive(clap::Args)]
#[command(next_help_heading = "Frames (ultrasound)")]
pub struct FrameArgs {
    /// Sweep along the undisplaced needle: the straight line that deflections are measured from
    #[arg(long, value_name = "PATH")]
    pub(super) straight: Option<PathBuf>,
    /// Place of the straight needle in every frame, pixels, instead of --straight: the needle is then taken as parallel to the sweep
    #[arg(long, value_name = "X,Y", value_parser = pair, conflicts_with = "straight")]
    pub(super) straight_px: Option<[f64; 2]>,
    /// Size of a pixel, in place of what the file states
    #[arg(long, value_name = "X,Y", value_parser = spacing)]
    spacing_mm: Option<[f64; 2]>,
    /// Axes of the image, in place of what the file states: first axis to the marked (M) or unmarked (U) side of the probe, second to
    /// the far (F) or near (N) side (default: MF)
    #[arg(long, value_name = "MF|UF|MN|UN", value_parser = orientation)]
    orientation: Option<Orientation>,
    /// Part of the oriented frame in which the needle is, pixels
    #[arg(long, value_name = "X,Y,W,H", value_parser = region)]
    region: Option<Region>,
    /// Position of the first frame along the needle from guide 1 (default: entry_mm, the tissue's surface)
    #[arg(long, value_name = "MM")]
    sweep_start_mm: Option<f64>,
    /// Distance from one frame to the next, along the needle; negative for a sweep towards guide 1
    #[arg(long, value_name = "MM", group = "place", value_parser = step, allow_negative_numbers = true)]
    step_mm: Option<f64>,
    /// Speed of the probe, with the time stamps of the file; negative for a sweep towards guide 1
    #[arg(long, value_name = "MM_PER_S", group = "place", value_parser = speed, allow_negative_numbers = true)]
    speed_mm_per_s: Option<f64>,
    /// Field of the file that is the probe's position in millimetres, such as ProbePosition
    #[arg(long, value_name = "NAME", group = "place")]
    z_field: Option<String>,
    /// The field decreases into the tissue
    #[arg(long, requires = "z_field")]
    z_reversed: bool,
    /// Transform of the file from the probe to a tracker, such as ProbeToTracker
    #[arg(
        long,
        value_name = "NAME",
        group = "place",
        requires = "image_to_probe",
        requires = "tracker_to_guide"
    )]
    transform: Option<String>,
    /// From the image in millimetres to the probe: 16 numbers, row by row
    #[arg(long, value_name = "MATRIX", value_parser = matrix, allow_hyphen_values = true, requires = "transform")]
    image_to_probe: Option<Matrix>,
    /// From the tracker to the session's frame (x horizontal, y up, z along the needle from guide 1): 16 numbers, row by row
    #[arg(long, value_name = "MATRIX", value_parser = matrix, allow_hyphen_values = true)]
    tracker_to_guide: Option<Matrix>,
    /// Calibration of the image plane (guide calibrate-image), in place of --spacing-mm, --transform and --image-to-probe
    #[arg(long, value_name = "FILE", group = "place", requires = "tracker_to_guide", conflicts_with_all = ["spacing_mm", "image_to_probe"])]
    calibration: Option<PathBuf>,
    /// A run of the session whose frames guide acquire has taken (--frames-command): its shape is measured from them, and the straight needle from
    /// those of its first hold at zero displacement
    #[arg(long, value_name = "ID", conflicts_with_all = ["paths", "id", "force", "depth_mm", "time_s"])]
    pub run: Option<String>,
    /// Uncertainty of the position of the first frame: an error that all points of the run share
    #[arg(long, value_name = "MM", default_value_t = 0.0, value_parser = import_shapes::millimetres)]
    sweep_start_sd_mm: f64,
    /// Uncertainty of the lag of --lag-s
    #[arg(long, value_name = "SECONDS", requires = "lag_s")]
    lag_sd_s: Option<f64>,
    /// Delay of positions after images with the same time stamp; negative if images are later (default: estimated,
    /// where the probe goes forth and back; otherwise 0)
    #[arg(long, value_name = "SECONDS")]
    lag_s: Option<f64>,
}

const MISSING_PLACE: &str = "position of the frames along the needle: missing, expected --step-mm, --speed-mm-per-s, --z-field, --transform or \
     --calibration";
pub(super) const MISSING_STRAIGHT: &str = "the straight needle: missing, expected --straight, a sweep along the undisplaced needle, or --straight-px, its place in \
     the frames";

impl FrameArgs {
    /// Whether any of its options is given.
    pub fn is_requested(&self) -> bool {
        let Self {
            straight, straight_px, spacing_mm, orientation, region, sweep_start_mm, lag_s, run, ..
        } = self;
        let is_place_given =
            [&self.step_mm, &self.speed_mm_per_s, sweep_start_mm, lag_s].iter().any(|given| given.is_some());
        let image =
            straight_px.is_some() || spacing_mm.is_some() || orientation.is_some() || region.is_some();
        is_place_given
            || image
            || straight.is_some()
            || run.is_some()
            || self.sweep_start_sd_mm > 0.0
            || self.z_field.is_some()
            || self.transform.is_some()
            || self.calibration.is_some()
    }

    /// All that is missing of what a sweep needs.
    pub(super) fn missing(&self) -> Vec<&'static str> {
        let has_place = self.step_mm.is_some()
            || self.speed_mm_per_s.is_some()
            || self.z_field.is_some()
            || self.transform.is_some()
            || self.calibration.is_some();
        // A recorded run has a straight needle of its own.
        let has_straight = self.straight.is_some() || self.straight_px.is_some() || self.run.is_some();
        [(!has_place).then_some(MISSING_PLACE), (!has_straight).then_some(MISSING_STRAIGHT)]
            .into_iter()
            .flatten()
            .collect()
    }

    pub(super) fn settings(&self, setup: &Setup) -> anyhow::Result<Settings> {
        let calibration = self.calibration.as_deref().map(ImageCalibration::read).transpose()?;
        let tracker_to_guide = || self.tracker_to_guide.clone().context("--tracker-to-guide: missing");
        ensure!(
            self.tracker_to_guide.is_none() || self.transform.is_some() || calibration.is_some(),
            "--tracker-to-guide: has no meaning without a pose of the probe, expected --transform or --calibration with it"
        );
        let start_mm = self.sweep_start_mm.unwrap_or(1e3 * setup.rig.entry_m);
        let frame_place = match (self.step_mm, self.speed_mm_per_s, &self.z_field, &self.transform) {
            (Some(step_mm), ..) => Place::Step { start_mm, step_mm },
            (_, Some(mm_per_s), ..) => Place::Speed { start_mm, mm_per_s },
            (_, _, Some(name), _) => {
                Place::Field { name: name.clone(), start_mm, sign: if self.z_reversed { -1.0 } else { 1.0 } }
            }
            (_, _, _, Some(name)) => Place::Transform {
                // Files write its name with the word behind it.
                name: name.strip_suffix("Transform").unwrap_or(name).to_owned(),
                image_to_probe: self.image_to_probe.clone().context("--image-to-probe: missing")?,
                tracker_to_guide: tracker_to_guide()?,
            },
            _ => match &calibration {
                Some(of) => Place::Transform {
                    name: of.transform.clone(),
                    image_to_probe: of.image_to_probe.clone(),
                    tracker_to_guide: tracker_to_guide()?,
                },
                None => bail!(MISSING_PLACE),
            },
        };
        Ok(Settings {
            needle_mm: 1e3 * setup.rig.needle.outer_diameter_m,
            spacing_mm: calibration.map(|of| of.spacing_mm).or(self.spacing_mm),
            orientation: self.orientation,
            region: self.region,
            place: frame_place,
            lag_s: self.lag_s,
        })
    }

    /// Standard deviation of the error of the positions that all points of a sweep share: that of its start, and of the lag where
    /// the probe goes more in one direction than in the other.
    pub(super) fn shared_sd_mm(&self, sweep: &Sweep, points: &[Deflection]) -> f64 {
        let estimated_s = sweep.lag.filter(|_| self.lag_s.is_none()).map(|lag| lag.sd_s);
        let lag_sd_s = self.lag_sd_s.or(estimated_s).unwrap_or(0.0);
        let mean_mm_per_s =
            points.iter().map(|point| point.motion.mm_per_s).sum::<f64>() / points.len().max(1) as f64;
        self.sweep_start_sd_mm.hypot(lag_sd_s * mean_mm_per_s)
    }
}
