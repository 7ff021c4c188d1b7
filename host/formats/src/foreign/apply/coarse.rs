//! Rows that are read faster than their clock shows: `10:59:58` ten times, then `10:59:59` ten times.

use super::Part;

/// Groups of rows of one stamp, without the first and the last one, by which the period is found: a line has two unknowns.
const INNER: usize = 2;
/// Usual steps of the clock from one stamp to the next; behind a longer one the rows begin anew. Stamps are whole numbers of the clock's
/// steps, so that one step is told from two or more in the middle between both.
const PAUSE: f64 = 1.5;

/// Rows of one stamp: the stamp, the number of the first row among those with a time, and how many there are.
struct Group {
    stamp_s: f64,
    first: usize,
    count: usize,
}

/// Spreads times evenly where stamps are those of a clock that shows fewer digits than the rows need; the rows a second then, none
/// where the times are left as they are.
///
/// Between pauses a row of number `i` was read at `a + p i`, and its stamp is that time cut off to a multiple of the clock's step. The
/// line through the middles of the groups is `a` and `p`. It counts if every row is within a period of its own step: then the rows were
/// read at one rate. Rows that repeat the one before in all columns are the same reading once more, and rows that fill columns in turn
/// have one time: both are left.
pub(super) fn spread(times_s: &mut [f64], parts: &[&Part]) -> Option<f64> {
    let rows: Vec<(usize, f64)> =
        times_s.iter().copied().enumerate().filter(|(_, time_s)| time_s.is_finite()).collect();
    if parts.is_empty() || !are_readings(&rows, parts) {
        return None;
    }
    let groups = groups(&rows);
    let mut steps: Vec<f64> = groups.windows(2).map(|pair| pair[1].stamp_s - pair[0].stamp_s).collect();
    steps.sort_by(f64::total_cmp);
    let (least_s, usual_s) = (*steps.first()?, *steps.get(steps.len() / 2)?);
    let stretches = groups.chunk_by(|a, b| b.stamp_s - a.stamp_s <= PAUSE * usual_s);
    // Rows and their times, stretch by stretch, and the rate of the longest stretch.
    let (mut spread, mut longest): (Vec<(usize, f64)>, (usize, f64)) = (Vec::new(), (0, 0.0));
    for stretch in stretches {
        let [start_s, period_s] = line(stretch, least_s)?;
        let numbers = stretch.first()?.first..stretch.last().map(|last| last.first + last.count)?;
        if numbers.len() > longest.0 {
            longest = (numbers.len(), period_s.recip());
        }
        let stretch_rows = rows.get(numbers.clone())?;
        spread.extend(
            stretch_rows
                .iter()
                .zip(numbers)
                .map(|((row, _), number)| (*row, start_s + period_s * number as f64)),
        );
    }
    if spread.windows(2).any(|pair| pair[0].1 >= pair[1].1) {
        return None;
    }
    for (row, time_s) in spread {
        times_s.iter_mut().skip(row).take(1).for_each(|time| *time = time_s);
    }
    Some(longest.1)
}

/// Time of row 0 and period of a stretch without pauses; none where its rows were not read at one rate.
fn line(groups: &[Group], step_s: f64) -> Option<[f64; 2]> {
    let inner = groups.get(1..groups.len().checked_sub(1)?).filter(|inner| inner.len() >= INNER)?;
    let middles: Vec<[f64; 2]> = inner
        .iter()
        .map(|group| [group.first as f64 + 0.5 * (group.count as f64 - 1.0), group.stamp_s + 0.5 * step_s])
        .collect();
    let n = middles.len() as f64;
    let [i0, s0] = [0, 1].map(|axis: usize| middles.iter().map(|middle| middle[axis]).sum::<f64>() / n);
    let square: f64 = middles.iter().map(|[i, _]| (i - i0).powi(2)).sum();
    let period_s = middles.iter().map(|[i, s]| (i - i0) * (s - s0)).sum::<f64>() / square;
    let start_s = s0 - period_s * i0;
    let is_even = groups.iter().all(|group| {
        let ends =
            [group.first, group.first + group.count - 1].map(|number| start_s + period_s * number as f64);
        ends[0] >= group.stamp_s - period_s && ends[1] <= group.stamp_s + step_s + period_s
    });
    (is_even && period_s > 0.0).then_some([start_s, period_s])
}

/// Rows of one stamp behind each other.
fn groups(rows: &[(usize, f64)]) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for (first, (_, stamp_s)) in rows.iter().enumerate() {
        match groups.last_mut() {
            Some(group) if group.stamp_s == *stamp_s => group.count += 1,
            _ => groups.push(Group { stamp_s: *stamp_s, first, count: 1 }),
        }
    }
    groups
}

/// Whether rows with the stamp of the row before are readings of their own: some differ from it, and most have a value in every column.
fn are_readings(rows: &[(usize, f64)], parts: &[&Part]) -> bool {
    let repeated: Vec<[usize; 2]> =
        rows.windows(2).filter(|pair| pair[0].1 == pair[1].1).map(|pair| [pair[0].0, pair[1].0]).collect();
    let full =
        repeated.iter().filter(|[_, row]| parts.iter().all(|part| part.column.value(*row).is_finite()));
    2 * full.count() > repeated.len()
        && repeated.iter().any(|[before, row]| {
            parts.iter().any(|part| part.column.value(*before).to_bits() != part.column.value(*row).to_bits())
        })
}
