//! Displacement of guide 2 over time from the frames of a clip, and its place in a force series.

use crate::figures::Displacement;
use anyhow::{bail, ensure};
use formats::foreign::{Offset, clock_contradiction};
use formats::session::ForceSeries;
use imaging::camera::{Clip, FrameResult, State};
use std::fmt::Write as _;

/// Directions of the session's axes in the image, each of length 1; x is none where the texture does not determine it.
#[derive(Debug, Clone, Copy)]
pub struct Axes {
    pub y: [f64; 2],
    pub x: Option<[f64; 2]>,
}

/// Displacement in one direction, millimetres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    pub mm: f64,
    pub sd_mm: f64,
}

/// One frame's displacement.
#[derive(Debug, Clone, Copy)]
pub struct Row {
    pub time_s: f64,
    pub y: Reading,
    pub x: Option<Reading>,
}

/// Displacement over time.
pub struct Series {
    /// Times of every frame: its time on the clock of the force series.
    pub times_s: Vec<f64>,
    /// Rows of every frame that is used.
    pub rows: Vec<Row>,
    /// Motion of the mark, millimetres, `[y, x]`, of every frame in which it was found.
    pub mark_mm: Vec<[f64; 2]>,
}

/// Remark on a rate of the user where the file states other times: by more than a frame over the clip.
pub fn rate_note(clip: &Clip, fps: Option<f64>) -> Option<String> {
    let fps = fps?;
    let stamps_s: Vec<f64> = clip.frames.iter().filter_map(|frame| frame.time_s).collect();
    let span_s = stamps_s.last()? - stamps_s.first()?;
    let steps = stamps_s.len() as f64 - 1.0;
    ((span_s - steps / fps).abs() * fps > 1.0).then(|| {
        format!(
            "the file states times of {} frames over {span_s:.3} s, {:.3} a second, and --fps {fps} is taken",
            stamps_s.len(),
            steps / span_s
        )
    })
}

/// A force series with the displacement of a clip.
pub struct Joined {
    pub series: ForceSeries,
    /// Rows that no frame has a displacement for.
    pub dropped: usize,
}

/// Displacement is interpolated between frames at most so many periods apart.
const MAX_GAP: f64 = 3.5;

impl Series {
    /// Document of a clip with pixels of this size. The first frame is at `start_s`.
    pub fn new(
        clip: &Clip,
        axes: &Axes,
        mm_per_px: f64,
        fps: Option<f64>,
        start_s: Option<f64>,
    ) -> anyhow::Result<Self> {
        let stamped: Option<Vec<f64>> = clip.frames.iter().map(|frame| frame.time_s).collect();
        let frame_times_s: Vec<f64> = match (fps, stamped) {
            (Some(fps), _) => (0..clip.frames.len()).map(|number| number as f64 / fps).collect(),
            (None, Some(stamped)) => stamped,
            (None, None) => bail!("no time stamps in the file, expected the frames per second: --fps"),
        };
        ensure!(
            frame_times_s.windows(2).all(|pair| pair[1] > pair[0]),
            "time stamps of the frames do not increase, expected the frames per second: --fps"
        );
        let first_s = frame_times_s.first().copied().unwrap_or(0.0);
        let start_s = start_s.unwrap_or(0.0);
        let times_s: Vec<f64> = frame_times_s.iter().map(|time_s| time_s - first_s + start_s).collect();
        let along = |frame: &FrameResult, direction: [f64; 2]| -> Option<Reading> {
            let template_match = frame.template?;
            let mark = frame.mark;
            let px =
                |axis: usize| template_match.shift_px[axis] - mark.map_or(0.0, |mark| mark.shift_px[axis]);
            let [a, b] = direction;
            let squared = a * a * variance(0, 0, &mark, template_match.covariance_px2)
                + 2.0 * a * b * variance(0, 1, &mark, template_match.covariance_px2)
                + b * b * variance(1, 1, &mark, template_match.covariance_px2);
            Some(Reading {
                mm: mm_per_px * (a * px(0) + b * px(1)),
                sd_mm: mm_per_px * squared.max(0.0).sqrt(),
            })
        };
        let rows =
            clip.frames.iter().zip(&times_s).filter(|(frame, _)| frame.state == State::Used).filter_map(
                |(frame, time_s)| {
                    let x = axes.x.and_then(|direction| along(frame, direction));
                    Some(Row { time_s: *time_s, y: along(frame, axes.y)?, x })
                },
            );
        let mark_mm = clip
            .frames
            .iter()
            .filter_map(|frame| {
                let mark = frame.mark?;
                let along = |[a, b]: [f64; 2]| mm_per_px * (a * mark.shift_px[0] + b * mark.shift_px[1]);
                Some([along(axes.y), axes.x.map_or(0.0, along)])
            })
            .collect();
        Ok(Self { rows: rows.collect(), mark_mm, times_s })
    }

    /// Remark on a clip whose ramps are at another time than those of the force.
    pub fn clock_note(&self, force: &ForceSeries) -> Option<String> {
        let of_force: Vec<(f64, f64)> =
            force.time_s.iter().copied().zip(force.force_y_n.iter().copied()).collect();
        let moved: Vec<(f64, f64)> = self.rows.iter().map(|row| (row.time_s, row.y.mm)).collect();
        let Offset { offset_s, sd_s, r2 } = clock_contradiction(&of_force, &moved)?;
        Some(format!(
            "the force follows the displacement best with the clip {:.3} s (sd {sd_s:.3} s) {}, where it explains {:.1} % of the force: --start-s {:.3} \
             brings them together",
            offset_s.abs(),
            if offset_s > 0.0 { "later" } else { "earlier" },
            100.0 * r2,
            self.first_s() + offset_s
        ))
    }

    /// When the first frame was taken.
    pub fn first_s(&self) -> f64 {
        self.times_s.first().copied().unwrap_or(0.0)
    }

    /// The force series with this displacement; rows at times without one are skipped.
    ///
    /// # Errors
    /// Where clip and series do not overlap.
    pub fn joined(&self, force: &ForceSeries) -> anyhow::Result<Joined> {
        let mut periods: Vec<f64> = self.times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        periods.sort_by(f64::total_cmp);
        let max_gap_s = MAX_GAP * periods.get(periods.len() / 2).copied().unwrap_or(0.0);
        let at = |time_s: f64| -> Option<Row> {
            let next_index = self.rows.partition_point(|row| row.time_s <= time_s);
            let earlier_row = self.rows.get(next_index.checked_sub(1)?)?;
            let Some(later_row) = self.rows.get(next_index) else {
                return (earlier_row.time_s == time_s).then_some(*earlier_row);
            };
            let gap_s = later_row.time_s - earlier_row.time_s;
            (gap_s <= max_gap_s)
                .then(|| between(earlier_row, later_row, time_s, (time_s - earlier_row.time_s) / gap_s))
        };
        let kept_rows: Vec<(usize, Row)> =
            force.time_s.iter().enumerate().filter_map(|(row, time_s)| Some((row, at(*time_s)?))).collect();
        ensure!(
            kept_rows.len() >= 2,
            "the clip ({}) and the force series ({}) have less than two rows in common, expected the same clock: --start-s",
            span(self.rows.first().map(|row| row.time_s), self.rows.last().map(|row| row.time_s)),
            span(force.time_s.first().copied(), force.time_s.last().copied())
        );
        let of_rows = |column: &[f64]| -> Vec<f64> {
            kept_rows.iter().filter_map(|(row, _)| column.get(*row).copied()).collect()
        };
        let of_clip = |value: fn(&Row) -> Option<f64>| -> Option<Vec<f64>> {
            kept_rows.iter().map(|(_, row)| value(row)).collect()
        };
        let has_x = force.force_x_n.is_some();
        let series = ForceSeries {
            time_s: of_rows(&force.time_s),
            displacement_y_m: of_clip(|row| Some(row.y.mm)).map(metres).unwrap_or_default(),
            force_y_n: of_rows(&force.force_y_n),
            displacement_x_m: only_x(of_clip(|row| row.x.map(|x| x.mm)), has_x),
            force_x_n: force.force_x_n.as_deref().map(of_rows),
            displacement_y_sd_m: of_clip(|row| Some(row.y.sd_mm)).map(metres),
            displacement_x_sd_m: only_x(of_clip(|row| row.x.map(|x| x.sd_mm)), has_x),
            lost_before: force.lost_before.as_deref().map(of_rows),
            marks: None,
        };
        // Horizontal force without a horizontal displacement is no pair.
        let series = match series.displacement_x_m {
            Some(_) => series,
            None => ForceSeries { force_x_n: None, ..series },
        };
        Ok(Joined { dropped: force.time_s.len() - kept_rows.len(), series })
    }

    /// A row for every frame that is used.
    pub fn csv(&self) -> String {
        let has_x = self.rows.iter().all(|row| row.x.is_some());
        let mut text = "time_s,displacement_y_mm,displacement_y_sd_mm".to_owned();
        text.push_str(if has_x { ",displacement_x_mm,displacement_x_sd_mm\n" } else { "\n" });
        for Row { time_s, y, x } in &self.rows {
            let _ = write!(text, "{time_s:.6},{:.6},{:.6}", y.mm, y.sd_mm);
            if let (true, Some(x)) = (has_x, x) {
                let _ = write!(text, ",{:.6},{:.6}", x.mm, x.sd_mm);
            }
            text.push('\n');
        }
        text
    }

    /// Displacement for its figure.
    pub fn figure(&self, clip: &Clip) -> Displacement {
        let rejected_s = clip
            .frames
            .iter()
            .zip(&self.times_s)
            .filter(|(frame, _)| frame.state != State::Used)
            .map(|(_, time_s)| *time_s);
        Displacement {
            y: self.rows.iter().map(|row| (row.time_s, row.y.mm)).collect(),
            x: self.rows.iter().filter_map(|row| Some((row.time_s, row.x?.mm))).collect(),
            rejected_s: rejected_s.collect(),
        }
    }
}

fn only_x(values: Option<Vec<f64>>, has_x: bool) -> Option<Vec<f64>> {
    values.filter(|_| has_x).map(metres)
}

fn span(first: Option<f64>, last: Option<f64>) -> String {
    format!("{:.3} to {:.3} s", first.unwrap_or(f64::NAN), last.unwrap_or(f64::NAN))
}

fn variance(
    i: usize,
    j: usize,
    mark: &Option<imaging::camera::Translation>,
    covariance_px2: [[f64; 2]; 2],
) -> f64 {
    covariance_px2[i][j] + mark.map_or(0.0, |mark| mark.covariance_px2[i][j])
}

fn metres(mm: Vec<f64>) -> Vec<f64> {
    mm.into_iter().map(|mm| 1e-3 * mm).collect()
}

/// A row between two, `share` of the way.
fn between(before: &Row, after: &Row, time_s: f64, share: f64) -> Row {
    let x = before.x.zip(after.x).map(|(a, b)| mix(a, b, share));
    Row { time_s, y: mix(before.y, after.y, share), x }
}

fn mix(a: Reading, b: Reading, share: f64) -> Reading {
    Reading {
        mm: (1.0 - share) * a.mm + share * b.mm,
        sd_mm: ((1.0 - share) * a.sd_mm).hypot(share * b.sd_mm),
    }
}
