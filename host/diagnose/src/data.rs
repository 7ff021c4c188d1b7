//! A session's runs as data of the diagnosis: the motions, the measured values, and the coordinates of each value.
//!
//! Forces are averaged over short stretches: in holds over stretches whose length grows with the time since the begin of the hold, in
//! ramps over a tenth of a second. Within a hold the position of guide 2 is the mean of its readings. Outliers are skipped, by a
//! criterion that uses the readings alone and no model.

use super::cells::{Cells, cells, held, stood, stretches, travelled};
use super::misread::step_m;
use super::shapes;
use formats::session::{InsertionRun, LateralRun, SHARED_ERRORS};
use insertion::{Bin, TipPath};
use mechanics::{DriveSample, Experiment, Insertion, Lateral, Profile, Rig, ShapeImage};
use readings::holds::{Hold, HoldCriteria, holds, median, reading_sd_m, reversal_m, reversal_of_means_m};

/// A sensor in one plane.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Vertical force.
    ForceY,
    /// Horizontal force.
    ForceX,
    /// Vertical deflection.
    ShapeY,
    /// Horizontal deflection.
    ShapeX,
    /// Vertical tip position.
    TipY,
    /// Horizontal tip position.
    TipX,
    /// Vertical slope of the needle at its tip.
    TipDirectionY,
    /// Horizontal slope of the needle at its tip.
    TipDirectionX,
}

impl Channel {
    /// All channels.
    pub const ALL: [Self; 8] = [
        Self::ForceY,
        Self::ForceX,
        Self::ShapeY,
        Self::ShapeX,
        Self::TipY,
        Self::TipX,
        Self::TipDirectionY,
        Self::TipDirectionX,
    ];

    /// Its name in results.
    pub fn name(self) -> &'static str {
        match self {
            Self::ForceY => "force_y",
            Self::ForceX => "force_x",
            Self::ShapeY => "shape_y",
            Self::ShapeX => "shape_x",
            Self::TipY => "tip_y",
            Self::TipX => "tip_x",
            Self::TipDirectionY => "tip_direction_y",
            Self::TipDirectionX => "tip_direction_x",
        }
    }

    /// Unit in results.
    pub fn unit(self) -> &'static str {
        match self {
            Self::ForceY | Self::ForceX => "N",
            Self::TipDirectionY | Self::TipDirectionX => "mrad",
            _ => "mm",
        }
    }

    /// Factor from SI to that unit.
    pub fn per_si(self) -> f64 {
        match self {
            Self::ForceY | Self::ForceX => 1.0,
            _ => 1e3,
        }
    }

    /// Whether it belongs to insertions and not to lateral runs.
    pub fn is_of_insertions(self) -> bool {
        matches!(self, Self::TipY | Self::TipX | Self::TipDirectionY | Self::TipDirectionX)
    }

    /// 0 for the vertical plane, 1 for the horizontal one.
    pub fn plane(self) -> usize {
        match self {
            Self::ForceY | Self::ShapeY | Self::TipY | Self::TipDirectionY => 0,
            Self::ForceX | Self::ShapeX | Self::TipX | Self::TipDirectionX => 1,
        }
    }
}

/// Predicted values with which a measured value is compared.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Source {
    /// Mean force over drive samples.
    Force(Vec<usize>),
    /// A shape point.
    Shape(usize),
    /// A depth of an insertion.
    Tip(usize),
    /// Slope of the needle at a depth of an insertion.
    Direction(usize),
}

/// Coordinates of a measured value.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Place {
    /// Depth below the surface; for forces the depth of the needle.
    pub depth_m: f64,
    /// Displacement of guide 2 along the axis of the run.
    pub level_m: f64,
    /// Sign of the last motion of guide 2.
    pub direction: f64,
    /// Time since the hold began; `None` during a motion.
    pub hold_s: Option<f64>,
    /// Time since the run began.
    pub time_s: f64,
}

/// A measured value.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Datum {
    pub channel: Channel,
    pub measured: f64,
    pub source: Source,
    pub place: Place,
    /// Number of the hold, or of the interval of depth, to which it belongs.
    pub part: usize,
    /// Number of points of a shape at this place, of which it is the mean.
    pub points: usize,
}

impl Datum {
    /// Place of a bin of an insertion.
    fn of_bin(bin: &Bin, channel: Channel, measured: f64, source: Source) -> Self {
        let bin_place =
            Place { depth_m: bin.depth_m, level_m: 0.0, direction: 0.0, hold_s: None, time_s: 0.0 };
        Self { channel, measured, source, place: bin_place, part: (bin.depth_m / PART_M) as usize, points: 1 }
    }
}

/// Kind of the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Kind {
    Lateral,
    Insertion,
}

/// A run.
#[derive(Debug, Clone)]
pub(super) struct Run {
    pub id: String,
    pub kind: Kind,
    pub depth_m: f64,
    /// Plane in which guide 2 moved most.
    pub axis: usize,
    pub experiment: Experiment,
    pub data: Vec<Datum>,
    pub cells: Cells,
    /// Standard deviation of an error of the position that all points of its shape share, at each of them.
    pub z_shared_sd_m: Vec<f64>,
    /// Effect of each shared error of the deflections, at one standard deviation, on each point of the shape in each plane.
    pub shared_m: Vec<[[f64; SHARED_ERRORS]; 2]>,
    /// Rounding step of the shape, vertical and horizontal; nearly zero without rounding.
    pub shape_step_m: [f64; 2],
    /// Speed of an insertion; 0 where it is not recorded.
    pub speed_m_per_s: f64,
    /// Whether it belongs to the reference session.
    pub is_reference: bool,
}

/// Guide 2 has not moved in a plane if no hold is further from zero than this.
const IDLE_M: f64 = 0.05e-3;
/// Depth of a part of an insertion.
const PART_M: f64 = 20e-3;
/// Length within which a change of the rotation or of guide 2 is a step and not a ramp, and smallest rotation that counts as a step.
const STEP_LENGTH_M: f64 = 1e-3;
const ROTATION_STEP_RAD: f64 = 0.02;
/// Number of readings at rest from which on those on the way are not used.
const ENOUGH_RESTS: usize = 12;
/// Length of the cells of depth over which the speed of an insertion is measured: it is shorter than the pushes of a hand.
const SPEED_CELL_M: f64 = 0.2e-3;

impl Run {
    /// The same run with this number in its session.
    pub fn numbered(mut self, number: f64) -> Self {
        match &mut self.experiment {
            Experiment::Lateral(lateral) => lateral.order = number,
            Experiment::Insertion(insertion) => insertion.order = number,
            Experiment::LateralForce(_) | Experiment::Steering(_) => {}
        }
        self
    }

    /// A lateral run, or the reason for which it cannot be used.
    pub fn lateral(run: &LateralRun, rig: &Rig) -> Result<Self, String> {
        let holds = holds(run, &HoldCriteria::default());
        if holds.is_empty() {
            return Err(format!(
                "{}: displacement_y_mm: no hold found, expected guide 2 held still for 0.5 s or more",
                run.force_path.display()
            ));
        }
        let mut cells = cells(run, &holds);
        let most_m: [f64; 2] =
            [0, 1].map(|plane| holds.iter().map(|h| h.displacement_m()[plane].abs()).fold(0.0, f64::max));
        let axis = usize::from(most_m[1] > most_m[0]);
        let stood_m = stood(&cells, holds.len());
        let idle_m = cells.read_m.each_ref().map(|read| read.iter().sum::<f64>() / read.len() as f64);
        let level_places: Vec<Place> = hold_places(&holds, axis, run.depth_m);
        let start_s = cells.time_s.first().copied().unwrap_or_default();

        let mut data = Vec::new();
        // If the bending stiffness is unknown, the forces carry no information.
        let planes = match (rig.needle.stiffness_known, &run.force.force_x_n) {
            (false, _) => 0,
            (true, None) => 1,
            (true, Some(_)) => 2,
        };
        for plane in 0..planes {
            for stretch in stretches(&cells) {
                let usable: Vec<usize> =
                    stretch.clone().filter(|i| cells.force_n[plane][*i].is_finite()).collect();
                if usable.is_empty() {
                    continue;
                }
                let [time_s, level_m, force_n] = [&cells.time_s, &cells.read_m[axis], &cells.force_n[plane]]
                    .map(|values| usable.iter().map(|i| values[*i]).sum::<f64>() / usable.len() as f64);
                let hold = cells.hold[stretch.start];
                // Readings on the way to a hold belong to this hold.
                let next = cells.hold[stretch.start..].iter().flatten().next().copied();
                let part_index = hold.or(next).unwrap_or(holds.len() - 1);
                let mut cell_place = level_places[part_index];
                cell_place.time_s = time_s - start_s;
                cell_place.hold_s = hold.map(|_| time_s - holds[part_index].time_s[0]);
                if hold.is_none() {
                    cell_place.level_m = level_m;
                }
                data.push(Datum {
                    channel: [Channel::ForceY, Channel::ForceX][plane],
                    measured: force_n,
                    source: Source::Force(usable),
                    place: cell_place,
                    part: part_index,
                    points: 1,
                });
            }
        }
        let mut points = Vec::new();
        let (mut z_shared_sd_m, mut shared_m) = (Vec::new(), Vec::new());
        for (part, hold) in holds.iter().enumerate() {
            let shape = shapes::of_hold(run, rig.entry_m + run.depth_m, hold);
            let first = points.len();
            for mean in shape.means {
                let point = shape.places[mean.place];
                data.push(Datum {
                    channel: [Channel::ShapeY, Channel::ShapeX][mean.plane],
                    measured: mean.deflection_m,
                    source: Source::Shape(first + mean.place),
                    place: Place {
                        depth_m: point.z_m - rig.entry_m,
                        time_s: point.time_s - start_s,
                        hold_s: Some(point.time_s - hold.time_s[0]),
                        ..level_places[part]
                    },
                    part,
                    points: mean.points,
                });
            }
            points.extend(shape.places);
            z_shared_sd_m.extend(shape.indices.iter().map(|index| run.shape.shared_sd_m(*index)));
            shared_m.extend(shape.indices.iter().map(|index| run.shape.shared_errors_m(*index)));
        }
        // The data are sorted by plane, then forces before shapes.
        data.sort_by_key(|datum| (datum.channel.plane(), matches!(datum.source, Source::Shape(_))));
        let hold_cells = held(&cells);
        let reversal_m = cells.read_m.each_ref().map(|read_m| reversal_m(read_m, &hold_cells));
        let sd_m = cells.read_m.each_ref().map(|read_m| reading_sd_m(read_m, &hold_cells));
        // In a plane in which guide 2 does not move the readings are noise about a constant.
        let travelled_m = [0, 1].map(|plane| {
            if most_m[plane] <= IDLE_M {
                return vec![idle_m[plane]; cells.time_s.len()];
            }
            let (positions_m, windows) = travelled(&cells, plane, &stood_m, sd_m[plane]);
            cells.windows[plane] = windows;
            positions_m
        });
        let drive = (0..cells.time_s.len()).map(|i| DriveSample {
            time_s: cells.time_s[i],
            y_m: travelled_m[0][i],
            x_m: travelled_m[1][i],
        });
        let (id, depth_m, drive) = (run.id.clone(), run.depth_m, drive.collect());
        let experiment =
            Experiment::Lateral(Lateral { depth_m, drive, shape: points, reversal_m, order: 0.0 });
        Ok(Self {
            id,
            kind: Kind::Lateral,
            depth_m,
            axis,
            experiment,
            data,
            cells,
            z_shared_sd_m,
            shared_m,
            shape_step_m: [Some(&run.shape.y_m), run.shape.x_m.as_ref()]
                .map(|column| column.map_or(0.0, |values_m| step_m(values_m))),
            speed_m_per_s: 0.0,
            is_reference: false,
        })
    }

    /// An insertion, or the reason for which it cannot be used.
    pub fn insertion(run: &InsertionRun) -> Result<Self, String> {
        let path = TipPath::new(run).map_err(|why| format!("{}: {why}", run.path.display()))?;
        let path = at_rest(path);
        let speed_m_per_s = speed(run).unwrap_or(0.0);
        let insertion = Insertion {
            depth_m: path.bins.iter().map(|bin| bin.depth_m + if bin.leaving { 1e-7 } else { 0.0 }).collect(),
            speed_m_per_s: Profile::constant(speed_m_per_s),
            tip_direction: path.bins.iter().flat_map(|bin| bin.direction_rad).flatten().next().is_some(),
            ..path.done.clone()
        };
        let mut data = Vec::new();
        for plane in 0..path.planes {
            for (index, bin) in path.bins.iter().enumerate() {
                data.push(Datum::of_bin(
                    bin,
                    [Channel::TipY, Channel::TipX][plane],
                    bin.tip_m[plane],
                    Source::Tip(index),
                ));
            }
        }
        for plane in 0..path.planes {
            let measured = path.bins.iter().enumerate();
            let measured = measured.filter_map(|(index, bin)| Some((index, bin, bin.direction_rad[plane]?)));
            let channel = [Channel::TipDirectionY, Channel::TipDirectionX][plane];
            data.extend(
                measured
                    .map(|(index, bin, slope)| Datum::of_bin(bin, channel, slope, Source::Direction(index))),
            );
        }
        Ok(Self {
            id: run.id.clone(),
            kind: Kind::Insertion,
            depth_m: path.deepest_m,
            axis: 0,
            experiment: Experiment::Insertion(insertion),
            data,
            cells: Cells::default(),
            z_shared_sd_m: Vec::new(),
            shared_m: Vec::new(),
            shape_step_m: [0.0; 2],
            speed_m_per_s,
            is_reference: false,
        })
    }

    /// Image of its shape, at its middle point; `None` if it is not known.
    pub fn image(&self) -> Option<ShapeImage> {
        let Experiment::Lateral(lateral) = &self.experiment else { return None };
        let mut images = lateral.shape.iter().filter_map(|point| point.image);
        images.nth(lateral.shape.iter().filter(|point| point.image.is_some()).count() / 2)
    }

    /// The same run with only some of its parts.
    pub fn with_parts(&self, keep: impl Fn(usize) -> bool) -> Self {
        let data = self.data.iter().filter(|datum| keep(datum.part)).cloned().collect();
        Self { data, ..self.clone() }
    }

    /// 1 if the needle is turned during an insertion, -1 if it is not.
    pub fn turned(&self) -> f64 {
        match &self.experiment {
            Experiment::Insertion(done) if !done.rotation_rad.is_constant() => 1.0,
            _ => -1.0,
        }
    }

    /// Whether the needle is turned or guide 2 is moved (at rest or within a millimetre) in a part of an insertion: the path then
    /// has a step or a kink there, which is not noise and which the model explains.
    pub fn turns_in(&self, part: usize) -> bool {
        let Experiment::Insertion(insertion) = &self.experiment else { return false };
        let part_start_m = PART_M * part as f64;
        let cells = (PART_M / STEP_LENGTH_M).round() as usize;
        let mut profiles = std::iter::once((&insertion.rotation_rad, ROTATION_STEP_RAD))
            .chain(insertion.guide2_m.iter().flatten().map(|profile| (profile, IDLE_M)));
        profiles.any(|(profile, still)| {
            (0..cells).any(|cell| {
                let cell_m = part_start_m + STEP_LENGTH_M * cell as f64;
                (profile.after(cell_m + STEP_LENGTH_M) - profile.before(cell_m)).abs() > still
            })
        })
    }

    /// Indices of the readings of each part that has readings.
    pub fn readings_of_parts(&self) -> Vec<Vec<usize>> {
        let mut places = vec![Vec::new(); self.parts()];
        self.data.iter().enumerate().for_each(|(place, datum)| places[datum.part].push(place));
        places.retain(|readings| !readings.is_empty());
        places
    }

    /// Number of its parts.
    pub fn parts(&self) -> usize {
        self.data.iter().map(|datum| datum.part + 1).max().unwrap_or(0)
    }
}

/// The path with readings at rest only, if there are enough of them: in motion guides and needle lag behind.
fn at_rest(path: TipPath) -> TipPath {
    let resting: Vec<Bin> = path.bins.iter().filter(|bin| !bin.moving).copied().collect();
    if resting.len() < ENOUGH_RESTS { path } else { path.with_bins(resting) }
}

/// Speed of an insertion, m/s: the median over cells of depth, so that rests between pushes do not count. `None` if no times are
/// recorded or fewer than two cells are crossed.
fn speed(run: &InsertionRun) -> Option<f64> {
    let times_s = run.time_s.as_ref()?;
    // Times at which the needle first reached each face of a cell.
    let mut faces_s: Vec<f64> = Vec::new();
    let mut previous: Option<(f64, f64)> = None;
    for (depth_m, time_s) in run.depth_m.iter().copied().zip(times_s.iter().copied()) {
        let (deepest_m, since_time_s) = previous.unwrap_or((depth_m, time_s));
        if depth_m <= deepest_m {
            // The next crossing is timed from the last row of a rest.
            previous = Some((deepest_m, time_s));
            continue;
        }
        loop {
            let face_m = SPEED_CELL_M * faces_s.len() as f64;
            if face_m > depth_m {
                break;
            }
            let fraction = ((face_m - deepest_m) / (depth_m - deepest_m)).max(0.0);
            faces_s.push(since_time_s + fraction * (time_s - since_time_s));
        }
        previous = Some((depth_m, time_s));
    }
    let crossings = faces_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|seconds| *seconds > 0.0);
    let seconds: Vec<f64> = crossings.collect();
    (seconds.len() >= 2).then(|| SPEED_CELL_M / median(seconds))
}

fn hold_places(holds: &[Hold], axis: usize, depth_m: f64) -> Vec<Place> {
    // A change smaller than the standard errors of the means, from their own scatter, is not a motion.
    let errors_m = holds.iter().map(|hold| {
        let mean = [Some(hold.displacement_y_m), hold.displacement_x_m][axis];
        mean.map_or(0.0, |mean| mean.standard_error(mean.scatter))
    });
    let reversal_m = reversal_of_means_m(&errors_m.collect::<Vec<_>>());
    let mut extreme_m = 0.0;
    let mut direction = 0.0;
    holds
        .iter()
        .map(|hold| {
            let level_m = hold.displacement_m()[axis];
            let moved_m: f64 = level_m - extreme_m;
            if moved_m * direction > 0.0 || moved_m.abs() > reversal_m {
                direction = moved_m.signum();
                extreme_m = level_m;
            }
            Place { depth_m, level_m, direction, hold_s: Some(0.0), time_s: 0.0 }
        })
        .collect()
}

#[cfg(test)]
#[path = "data_tests.rs"]
mod tests;
