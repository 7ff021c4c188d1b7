//! An insertion: the tip over the depth, row by row.

use super::clock::Timed;
use super::rows::{part_named, pick};
use super::{Part, Zero, series, zero};
use crate::foreign::TableError;
use crate::session::InsertionRun;
use crate::session::import::{Reading, count, screen_positions};

/// Tip over depth.
pub(super) fn insertion(
    parts: &[Part],
    timed: &[Timed],
    zero: Zero,
    notes: &mut Vec<String>,
) -> Result<InsertionRun, TableError> {
    let (Some(depth), Some(tip)) = (part_named(parts, "depth_mm"), part_named(parts, "tip_y_mm")) else {
        return Err(TableError::Map {
            choice: "depth_mm".to_owned(),
            problem: "without tip_y_mm".to_owned(),
            expected: "both for an insertion; --depth-mm is the depth of a lateral run".to_owned(),
        });
    };
    let optional =
        ["tip_x_mm", "rotation_deg", "guide2_y_mm", "guide2_x_mm"].map(|name| part_named(parts, name));
    let columns: Vec<Option<Vec<f64>>> = [Some(depth), Some(tip)]
        .into_iter()
        .chain(optional)
        .map(|part_named| {
            part_named
                .map(|part_named| {
                    series::same_table(depth, part_named)?;
                    series::values(part_named)
                })
                .transpose()
        })
        .collect::<Result<_, _>>()?;
    let rows: Vec<usize> = (0..depth.column.values.len())
        .filter(|row| {
            columns.iter().flatten().all(|column| column.get(*row).is_some_and(|value| value.is_finite()))
        })
        .collect();
    let picked = |at: usize| columns.get(at).and_then(Option::as_ref).map(|values| pick(values, &rows));
    let times_s = timed
        .iter()
        .find(|timed| std::ptr::eq(timed.table, depth.table))
        .and_then(|timed| timed.times_s.as_ref());
    let times_s = times_s.map(|times_s| pick(times_s, &rows)).map(|times_s| {
        let first_s = times_s.first().copied().unwrap_or(0.0);
        times_s.into_iter().map(|time_s| time_s - first_s).collect()
    });
    let all = InsertionRun {
        depth_m: picked(0).unwrap_or_default(),
        tip_y_m: picked(1).unwrap_or_default(),
        tip_x_m: picked(2),
        rotation_rad: picked(3),
        guide2_y_m: picked(4),
        guide2_x_m: picked(5),
        time_s: times_s,
        path: depth.table.path.clone(),
        ..InsertionRun::default()
    };
    check_direction(&all.depth_m, depth)?;
    let lines: Vec<usize> = rows.iter().filter_map(|row| depth.table.lines.get(*row).copied()).collect();
    let mut run = screened(&all, &lines, notes);
    if run.depth_m.is_empty() {
        return Err(TableError::Map {
            choice: "depth_mm".to_owned(),
            problem: format!("no row has numbers for both \"{}\" and the tip", depth.column.header),
            expected: "rows with a number in every column that is taken".to_owned(),
        });
    }
    refer_depth(&mut run.depth_m, depth, zero, notes)?;
    let is_displaced =
        [&run.guide2_y_m, &run.guide2_x_m].map(|guide2_m| zero::is_displaced(guide2_m.as_deref()));
    zero::refer_tip("tip_y_mm", &run.depth_m, &mut run.tip_y_m, (zero, is_displaced[0]), notes);
    if let Some(tip_x_m) = &mut run.tip_x_m {
        zero::refer_tip("tip_x_mm", &run.depth_m, tip_x_m, (zero, is_displaced[1]), notes);
    }
    Ok(run)
}

/// The rows of a needle that goes in, and a remark on those that are none: positions that jump and come back, and a withdrawal at the end.
fn screened(run: &InsertionRun, lines: &[usize], notes: &mut Vec<String>) -> InsertionRun {
    let readings: Vec<Reading> = run
        .depth_m
        .iter()
        .zip(&run.tip_y_m)
        .enumerate()
        .map(|(row, (depth_m, y_m))| {
            let x_m = run.tip_x_m.as_ref().and_then(|x_m| x_m.get(row)).copied().unwrap_or(0.0);
            Reading { tip_m: [*depth_m, *y_m, x_m], orientation: [0.0; 4], guide_m: [0.0; 2] }
        })
        .collect();
    let reasons = screen_positions(&readings);
    for skipped in count(&reasons) {
        let line =
            skipped.first_row.checked_sub(1).and_then(|row| lines.get(row)).copied().unwrap_or_default();
        notes.push(format!(
            "{}: from line {line} on, rows that are no readings are skipped ({} in all): {}",
            run.path.display(),
            skipped.rows,
            skipped.reason
        ));
    }
    run.only(|row| reasons.get(row).is_some_and(Option::is_none))
}

/// Refuses a depth that only falls, as the position of a stage does that counts the other way.
fn check_direction(depth_m: &[f64], depth: &Part) -> Result<(), TableError> {
    let at_rest = depth_m.get(..zero::rest(depth_m)).unwrap_or_default();
    let ([first_m, highest_m], [least_m, most_m]) = (zero::range(at_rest), zero::range(depth_m));
    if most_m > highest_m || least_m >= first_m {
        return Ok(());
    }
    Err(TableError::Map {
        choice: "depth_mm".to_owned(),
        problem: format!(
            "\"{}\" goes from {:.3} to {:.3} mm and never deeper",
            depth.column.header,
            1e3 * highest_m,
            1e3 * least_m
        ),
        expected: format!(
            "the length of the needle in the tissue, which grows: a minus before the unit turns a stage round (--map '{}=depth_mm:-mm'), and --zero first \
             counts it from where it begins",
            depth.column.own_name()
        ),
    })
}

/// Counts a depth from where it begins, where the user wants that; refuses one that never reaches the tissue.
fn refer_depth(
    depth_m: &mut [f64],
    depth: &Part,
    zero: Zero,
    notes: &mut Vec<String>,
) -> Result<(), TableError> {
    if zero == Zero::First {
        let begin_m = depth_m.first().copied().unwrap_or(0.0);
        depth_m.iter_mut().for_each(|value| *value -= begin_m);
        notes
            .push(format!("depth_mm is counted from its first value: {:.4} mm is subtracted", 1e3 * begin_m));
        return Ok(());
    }
    let [shallowest_m, deepest_m] = zero::range(depth_m);
    if deepest_m <= 0.0 {
        return Err(TableError::Map {
            choice: "depth_mm".to_owned(),
            problem: format!(
                "\"{}\" is {:.3} mm at most, and the tissue begins at 0",
                depth.column.header,
                1e3 * deepest_m
            ),
            expected: "the length of the needle in the tissue: --zero first where the record begins with the tip at the surface"
                .to_owned(),
        });
    }
    if shallowest_m > zero::usual_step(depth_m) && zero == Zero::Auto {
        notes.push(format!(
            "depth_mm begins at {:.3} mm: either the recording begins at this depth, or the column is the position of a stage (--zero first counts it from its first value)",
            1e3 * shallowest_m
        ));
    }
    Ok(())
}
