//! Tip readings: which are new, which are bad, and their means where the needle rested or passed.

use crate::history::{History, Place};
use crate::protocol::Answer;

/// Age of a reading, beyond delay and period of its sensor, from which on it is too old, s.
const LATE_S: f64 = 1.0;

/// Bad readings since the last good one, by what is wrong with them.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Series {
    /// Far from the band.
    pub far: usize,
    /// The same as the one before, to the digit.
    pub repeated: usize,
    /// Taken long before they arrived.
    pub late: usize,
    /// Age of the last of these, s.
    pub latest_s: f64,
}

/// Readings at one place.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Bin {
    pub place: Place,
    pub depth_m: f64,
    /// Mean, m.
    pub tip_m: [f64; 2],
    /// Variance of the mean by the sensor's noise, per axis.
    pub variance_m2: f64,
    /// Readings in it.
    pub count: usize,
    own: Vec<[f64; 3]>,
}

/// All readings of a run.
#[derive(Debug, Clone)]
pub(crate) struct Readings {
    pub bins: Vec<Bin>,
    noise_m: f64,
    delay_s: f64,
    /// Readings older than this are too old, s.
    late_s: f64,
    last_seq: Option<i64>,
    last_tip_m: Option<[f64; 2]>,
    /// When the last new good reading arrived, s.
    pub last_good_s: f64,
    /// Readings taken in this interval are of a guide that moves.
    pub skip_s: [f64; 2],
    /// Counts of all that arrived: new, rejected.
    pub counts: [usize; 2],
    /// Bad readings since the last good one.
    pub in_series: Series,
}

/// Use of an answer's reading.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ReadingStatus {
    /// The same again, or one that was taken while the guide moved.
    Old,
    /// The sensor itself reports it as bad, it repeats the last to the digit, or it is too old.
    Rejected,
    /// Far from where the tip can be, by the model.
    Far,
    /// Good.
    Good,
}

impl Readings {
    /// For a sensor of this noise, delay and time between readings.
    pub fn new(noise_m: f64, delay_s: f64, period_s: f64) -> Self {
        Self {
            bins: Vec::new(),
            noise_m,
            delay_s,
            late_s: delay_s + period_s + LATE_S,
            last_seq: None,
            last_tip_m: None,
            last_good_s: 0.0,
            skip_s: [f64::NAN; 2],
            counts: [0; 2],
            in_series: Series::default(),
        }
    }

    /// Takes in an answer; `expected` is where the tip is expected at a place, with its standard deviation, m.
    pub fn take(
        &mut self,
        answer: &Answer,
        history: &History,
        expected: impl Fn(Place) -> ([f64; 2], f64),
    ) -> ReadingStatus {
        if self.last_seq == Some(answer.tip_seq) {
            return ReadingStatus::Old;
        }
        self.last_seq = Some(answer.tip_seq);
        self.counts[0] += 1;
        let tip_m = [1e-3 * answer.tip_x_mm, 1e-3 * answer.tip_y_mm];
        // Without noise a needle at rest repeats its reading.
        let repeated = self.noise_m > 0.0 && self.last_tip_m == Some(tip_m);
        self.last_tip_m = Some(tip_m);
        let time_s = answer.tip_t_s.unwrap_or(answer.t_s - self.delay_s);
        let late = answer.t_s - time_s > self.late_s;
        if !answer.valid || repeated || late || time_s < -1e-9 {
            self.counts[1] += 1;
            self.in_series.repeated += usize::from(repeated);
            if late {
                (self.in_series.late, self.in_series.latest_s) =
                    (self.in_series.late + 1, answer.t_s - time_s);
            }
            return ReadingStatus::Rejected;
        }
        let moment = history.at(time_s.max(0.0));
        let Some(location) = history.place(time_s.max(0.0)) else {
            // Taken while the guide moved: it cannot be compared, so that it is no evidence of a good sensor either.
            return ReadingStatus::Old;
        };
        let (expected_m, sd_m) = expected(location);
        let distance_m = (tip_m[0] - expected_m[0]).hypot(tip_m[1] - expected_m[1]);
        if distance_m > 5.0 * self.noise_m.hypot(sd_m) + 0.3e-3 {
            self.counts[1] += 1;
            self.in_series.far += 1;
            return ReadingStatus::Far;
        }
        (self.last_good_s, self.in_series) = (answer.t_s, Series::default());
        if time_s > self.skip_s[0] && time_s < self.skip_s[1] {
            return ReadingStatus::Good;
        }
        self.add(location, moment.depth_m, tip_m, history);
        ReadingStatus::Good
    }

    fn add(&mut self, place: Place, depth_m: f64, tip_m: [f64; 2], history: &History) {
        let is_same_bin = |bin: &&mut Bin| match (bin.place, place) {
            (Place::Between(a, _), Place::Between(b, _)) => a == b,
            (a, b) => a == b,
        };
        let coordinates = [tip_m[0], tip_m[1], depth_m];
        match self.bins.iter_mut().rev().take(4).find(is_same_bin) {
            Some(bin) => bin.own.push(coordinates),
            None => self.bins.push(Bin {
                place,
                depth_m,
                tip_m,
                variance_m2: 0.0,
                count: 0,
                own: vec![coordinates],
            }),
        }
        let noise_m = self.noise_m;
        if let Some(bin) = self.bins.iter_mut().rev().take(4).find(is_same_bin) {
            bin.average(noise_m, &history.depths_m);
        }
    }
}

impl Bin {
    /// Expected reading of so many at a location, of a tip there.
    pub fn forecast(place: Place, depth_m: f64, tip_m: [f64; 2], noise_m: f64, count: f64) -> Self {
        let variance_m2 = noise_m * noise_m / count;
        Self { place, depth_m, tip_m, variance_m2, count: count as usize, own: Vec::new() }
    }

    /// Mean of its readings without those far from their median.
    fn average(&mut self, noise_m: f64, nodes_m: &[f64]) {
        let middle_m = [self.median_in_plane(0), self.median_in_plane(1)];
        let good: Vec<&[f64; 3]> = self
            .own
            .iter()
            .filter(|own| {
                self.own.len() < 4 || (0..2).all(|plane| (own[plane] - middle_m[plane]).abs() < 3.5 * noise_m)
            })
            .collect();
        let count = good.len().max(1) as f64;
        (self.tip_m, self.depth_m) =
            ([mean_along(0, &good, count), mean_along(1, &good, count)], mean_along(2, &good, count));
        if let Place::Between(node, _) = self.place {
            let [node_m, next_m] = [nodes_m[node], nodes_m[(node + 1).min(nodes_m.len() - 1)]];
            self.place = Place::Between(node, ((self.depth_m - node_m) / (next_m - node_m)).clamp(0.0, 1.0));
        }
        self.count = good.len();
        self.variance_m2 = noise_m * noise_m / count;
    }

    fn median_in_plane(&self, plane: usize) -> f64 {
        let mut values: Vec<f64> = self.own.iter().map(|own| own[plane]).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    }
}

fn mean_along(i: usize, good: &[&[f64; 3]], count: f64) -> f64 {
    good.iter().map(|own| own[i]).sum::<f64>() / count
}
