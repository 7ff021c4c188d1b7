//! Numbers that a channel gives while it measures nothing: marks such as `9999`, zeros of one that is off or is read faster than it
//! converts, and one value over and over of one that is held or at the end of its range.
//!
//! No magnitude decides, but what the channel does elsewhere in the record:
//!
//! * **Steps.** Without the mark, the channel moves from one reading to the next by `reach` at most, in `m` steps. Were the mark a reading
//!   too, the steps into it and out of it would be of the same kind; that both exceed all others has the chance
//!   `2 / ((m + 1) (m + 2))`, whatever the distribution (ranks of `m + 2` exchangeable numbers), and `1 / (m + 1)` where there
//!   is one step. Steps across the mark are among the `m`: a force that passes through zero, however fast, is no dropout.
//! * **Digits.** A reading of `d` digits consists of nines alone with the chance `10^-d`; zero is a reading like any other.
//! * **A band of zero.** Instruments write 0 for a load below a threshold. A record that begins with zeros shows by the first reading behind them
//!   how far from zero that is, and a passage from within a step of there is like it: `reach` is larger by it. Those first zeros
//!   are the time before contact, and stay.
//! * **Repetition.** A channel with noise gives the value of the reading before again with a probability `p`, and a stretch of `n` equal
//!   readings has the chance `p^(n - 1)` at each place. Its other readings show `p`: by how many repeat the one before (rule of succession), and
//!   by the longest of their `K` stretches, `k`, which is expected where `K p^k` is one. The greater counts: digits that are coarser than
//!   the noise repeat in holds, and not in ramps.
//!
//! Chances are multiplied by the number of places (Bonferroni) and count below [`CHANCE`].

use super::mapping::{Mapping, Target};
use super::unit::Quantity;
use super::{RawColumn, RawTable};
use std::path::Path;

/// Error probability of a finding, as that of the program's intervals of 95 %.
pub(super) const CHANCE: f64 = 0.05;

/// Equal readings behind each other: places among the readings.
struct Stretch {
    first: usize,
    count: usize,
}

/// Readings of a column with their rows.
pub(super) struct Readings {
    rows: Vec<usize>,
    values: Vec<f64>,
}

/// A value that is a mark of missing readings.
pub(super) struct Mark {
    /// Row of a place that shows it.
    pub row: usize,
    /// Reading beside it there.
    pub beside: f64,
    /// Largest step of the readings elsewhere.
    pub step: f64,
    /// Rows that have it.
    pub rows: Vec<usize>,
}

impl Readings {
    pub fn new(column: &RawColumn) -> Self {
        let origin = column.origin as f64;
        let finite = column.values.iter().enumerate().filter(|(_, value)| value.is_finite());
        let (rows, values) = finite.map(|(row, value)| (row, origin + value)).unzip();
        Self { rows, values }
    }

    /// Values of a kind, each once.
    pub fn values_that(&self, is: impl Fn(f64) -> bool) -> Vec<f64> {
        let mut values: Vec<f64> = self.values.iter().copied().filter(|value| is(*value)).collect();
        values.sort_by(f64::total_cmp);
        values.dedup();
        values
    }

    /// Stretches of equal readings.
    fn stretches(&self) -> Vec<Stretch> {
        let mut first = 0;
        let of_equal = self.values.chunk_by(|a, b| a == b);
        of_equal
            .map(|equal| {
                let stretch = Stretch { first, count: equal.len() };
                first += equal.len();
                stretch
            })
            .collect()
    }

    fn value(&self, stretch: &Stretch) -> f64 {
        self.values.get(stretch.first).copied().unwrap_or(f64::NAN)
    }

    fn row(&self, stretch: &Stretch) -> usize {
        self.rows.get(stretch.first).copied().unwrap_or(0)
    }

    /// Readings before and behind a stretch.
    fn beside(&self, stretch: &Stretch) -> [Option<f64>; 2] {
        let reading_before = stretch.first.checked_sub(1).and_then(|place| self.values.get(place));
        [reading_before, self.values.get(stretch.first + stretch.count)].map(Option::<&f64>::copied)
    }

    /// Whether the readings beside a stretch of zeros, one before it at least, are further from zero than this.
    fn is_beyond(&self, reach: f64, stretch: &Stretch) -> bool {
        let neighbours = self.beside(stretch);
        neighbours[0].is_some() && neighbours.iter().flatten().all(|value| value.abs() > reach)
    }

    fn rows_of(&self, stretch: &Stretch) -> impl Iterator<Item = usize> + '_ {
        self.rows.iter().skip(stretch.first).take(stretch.count).copied()
    }

    /// Largest step from one reading to the next among those of other values than these, with the rounding of a difference of two, and how many
    /// steps there are.
    fn largest_step(&self, without: &[f64]) -> (f64, usize) {
        let readings: Vec<f64> =
            self.values.iter().copied().filter(|value| !without.contains(value)).collect();
        let steps = readings.windows(2).map(|pair| (pair[1] - pair[0]).abs());
        let largest = readings.iter().fold(0.0, |largest: f64, value| largest.max(value.abs()));
        (steps.fold(0.0, f64::max) + 2.0 * f64::EPSILON * largest, readings.len().saturating_sub(1))
    }

    /// Whether this value stands for a missing reading, where a reading is it with the chance `prior`; `without` are all such values.
    pub fn mark(&self, value: f64, prior: f64, without: &[f64]) -> Option<Mark> {
        let (step, steps) = self.largest_step(without);
        let (m, stretches) = (steps as f64, self.stretches());
        let of_value: Vec<&Stretch> =
            stretches.iter().filter(|stretch| self.value(stretch) == value).collect();
        let stretch_count = of_value.len() as f64;
        let far_stretch = of_value.iter().find_map(|stretch| {
            let distances: Vec<f64> =
                self.beside(stretch).iter().flatten().map(|of| (of - value).abs()).collect();
            let chance = if distances.len() == 2 { 2.0 / ((m + 1.0) * (m + 2.0)) } else { 1.0 / (m + 1.0) };
            let is_far = !distances.is_empty() && distances.iter().all(|distance| *distance > step);
            (is_far && stretch_count * prior * chance < CHANCE).then_some(*stretch)
        })?;
        let rows = of_value.iter().flat_map(|stretch| self.rows_of(stretch)).collect();
        let neighbour = self.beside(far_stretch).iter().flatten().next().copied()?;
        Some(Mark { row: self.row(far_stretch), beside: neighbour, step, rows })
    }

    /// Zeros that stand for missing readings.
    pub fn zeros(&self) -> Option<Mark> {
        let (step, steps) = self.largest_step(&[0.0]);
        let (m, stretches) = (steps as f64, self.stretches());
        let (zeros, other_stretches): (Vec<&Stretch>, Vec<&Stretch>) =
            stretches.iter().partition(|stretch| self.value(stretch) == 0.0);
        let begins_with_zero = self.values.first() == Some(&0.0);
        let first_reading = other_stretches.first().map(|stretch| self.value(stretch))?;
        let reach = step + if begins_with_zero { first_reading.abs() } else { 0.0 };
        let (inner, at_end): (Vec<&Stretch>, Vec<&Stretch>) = zeros
            .into_iter()
            .filter(|stretch| self.beside(stretch)[0].is_some())
            .partition(|stretch| self.beside(stretch)[1].is_some());
        let shown = inner.iter().copied().find(|stretch| self.is_beyond(reach, stretch));
        let chance = inner.len() as f64 * 2.0 / ((m + 1.0) * (m + 2.0));
        let shown = shown.filter(|_| chance < CHANCE);
        // A record that ends with zeros has one step into them; that it repeats them longer than any other reading is the second sign.
        let longest = other_stretches.iter().map(|stretch| stretch.count).max().unwrap_or(0);
        let has_band = begins_with_zero && stretches.first().is_some_and(|stretch| stretch.count > longest);
        let least = if has_band || (m + 1.0).recip() >= CHANCE { usize::MAX } else { longest + 1 };
        let at_end = at_end
            .into_iter()
            .find(|stretch| self.is_beyond(reach, stretch) && (shown.is_some() || stretch.count >= least));
        // A zero that stands for no reading says nothing anywhere between readings.
        let rows: Vec<usize> = inner
            .iter()
            .copied()
            .filter(|_| shown.is_some())
            .chain(at_end)
            .flat_map(|stretch| self.rows_of(stretch))
            .collect();
        let far_stretch = shown.or(at_end)?;
        Some(Mark { row: self.row(far_stretch), beside: self.beside(far_stretch)[0]?, step, rows })
    }
}

/// The tables without what their channels write for a reading that is missing, in the columns over time that are taken.
pub(super) fn without(tables: &[RawTable], mapping: &Mapping) -> Vec<RawTable> {
    let mut tables = tables.to_vec();
    for table in &mut tables {
        for choice in &mapping.choices {
            let Target { name, quantity, .. } = choice.target;
            // A shape is a few points along the needle, and a rotation is commanded.
            let is_over_time = matches!(quantity, Quantity::Force | Quantity::Length)
                && name != "z_mm"
                && !name.starts_with("deflection_");
            let column_index = table.find(&choice.column).ok().flatten().filter(|_| is_over_time);
            let Some(column) = column_index.and_then(|column_index| table.columns.get_mut(column_index))
            else {
                continue;
            };
            table.notes.extend(take_out_zeros(column, &table.lines));
            // A guide may stand still to the last digit; a force and the tip of a needle that goes in do not.
            if quantity == Quantity::Force || name.starts_with("tip_") {
                table.notes.extend(stuck(column, &table.lines));
            }
        }
    }
    tables
}

/// Leaves the readings of a mark out of a column.
pub(super) fn leave_out(column: &mut RawColumn, mark: &Mark) {
    for row in &mark.rows {
        column.values.iter_mut().skip(*row).take(1).for_each(|value| *value = f64::NAN);
    }
}

/// Takes zeros that are no readings out of a column, and states which they were; `lines` are those of the rows.
fn take_out_zeros(column: &mut RawColumn, lines: &[usize]) -> Option<String> {
    let mark = Readings::new(column).zeros()?;
    leave_out(column, &mark);
    let (line, count) = (lines.get(mark.row)?, mark.rows.len());
    Some(format!(
        "line {line}: \"{}\" {}: such zeros between readings mark missing ones; {count} are left out",
        column.header,
        words(&mark)
    ))
}

/// Line, column and description of zeros that are no readings among the forces of a file with a session's columns; none in one that is no table.
pub fn zeros_among_forces(path: &Path) -> Option<(usize, String, String)> {
    let tables = RawTable::read(path).ok()?;
    tables.iter().find_map(|table| {
        let forces = table.columns.iter().filter(|column| column.header.starts_with("force_"));
        let (column, mark) =
            forces.filter_map(|column| Some((column, Readings::new(column).zeros()?))).next()?;
        Some((*table.lines.get(mark.row)?, column.header.clone(), words(&mark)))
    })
}

/// The sign that zeros are no readings, in words.
fn words(mark: &Mark) -> String {
    format!(
        "falls from {} to exactly 0, and elsewhere changes by {} at most from one reading to the next",
        rounded(mark.beside),
        rounded(mark.step)
    )
}

/// Remark on a force or a tip that is one value over and over.
fn stuck(column: &RawColumn, lines: &[usize]) -> Option<String> {
    let readings = Readings::new(column);
    let stretches = readings.stretches();
    let has_band = readings.values.first() == Some(&0.0) && stretches.len() > 1;
    let longest = stretches
        .iter()
        .filter(|stretch| !(has_band && readings.value(stretch) == 0.0))
        .max_by_key(|stretch| stretch.count)?;
    let value = readings.value(longest);
    let (value_stretches, other_stretches): (Vec<&Stretch>, Vec<&Stretch>) =
        stretches.iter().partition(|stretch| readings.value(stretch) == value);
    let count: usize = value_stretches.iter().map(|stretch| stretch.count).sum();
    let repeated: usize = other_stretches.iter().map(|stretch| stretch.count - 1).sum();
    let longest_else = other_stretches.iter().map(|stretch| stretch.count).max().unwrap_or(1);
    let of_succession = (repeated as f64 + 1.0) / ((repeated + other_stretches.len()) as f64 + 2.0);
    let of_longest = (other_stretches.len().max(1) as f64).powf(-1.0 / longest_else as f64);
    let again = if other_stretches.is_empty() { of_succession } else { of_succession.max(of_longest) };
    let exponent = i32::try_from(longest.count - 1).unwrap_or(i32::MAX);
    let is_chance = readings.values.len() as f64 * again.powi(exponent) >= CHANCE;
    let line = lines.get(readings.row(longest))?;
    let remark = if other_stretches.is_empty() {
        "it has no other readings"
    } else {
        "its other readings differ from each other"
    };
    (!is_chance).then(|| {
        format!(
            "line {line}: \"{}\" is exactly {value} in {} consecutive readings ({count} in all), and {remark}: is the channel at the end of its range, held or \
             not connected? They are used",
            column.header, longest.count
        )
    })
}

/// A number with few digits, for a remark.
pub(super) fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}
