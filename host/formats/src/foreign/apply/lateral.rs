//! A lateral run: force and displacement on the clock of the force, with the shape.

use super::super::TableError;
use super::super::align::{Clock, Offset, contradiction, estimate};
use super::super::drift::{self, Drift};
use super::super::mapping::is_time;
use super::super::summary::LEAST_RUN;
use super::clock::{self, Timed};
use super::missing::nothing;
use super::rows::{self, shape};
use super::{Options, Part, Series, Taken, series, straight, zero};
use crate::session::ForceSeries;

/// Force and displacement on the clock of the force, with the shape.
pub(super) fn lateral(
    taken: &mut Taken,
    parts: &[Part],
    timed: &[Timed],
    options: &Options,
) -> Result<(), TableError> {
    let series = |name: &str| -> Result<Option<(usize, Series)>, TableError> {
        let Some(named_part) = parts.iter().find(|part| part.target.name == name) else { return Ok(None) };
        let table_number =
            timed.iter().position(|timed| std::ptr::eq(timed.table, named_part.table)).unwrap_or(0);
        let table_times_s = timed.get(table_number).and_then(|timed| timed.times_s.as_deref());
        let times_s = table_times_s.ok_or_else(|| clock::missing(named_part.table))?;
        Ok(Some((table_number, Series::new(named_part, times_s)?)))
    };
    let required = |name: &str| -> Result<(usize, Series), TableError> {
        series(name)?.ok_or_else(|| nothing(&[], parts))
    };
    let (force_at, force) = required("force_y_n")?;
    let (moved_at, moved) = required("displacement_y_mm")?;
    let base = timed.get(force_at);
    check_merge(taken, timed, [base, timed.get(moved_at)], options)?;
    let shift_s = |at: usize| base.zip(timed.get(at)).and_then(|(base, other)| other.shift_to(base, options));
    // Offsets are between the times that the files have.
    let origin_s = base.zip(timed.get(moved_at)).map_or(0.0, |(base, other)| other.origin_shift_s(base));
    let moved_clock = match (options.offset_s, shift_s(moved_at)) {
        (Some(offset_s), _) if moved_at != force_at => Clock::shift(origin_s + offset_s),
        (_, Some(shift_s)) if !options.by_ramps || moved_at == force_at => Clock::shift(shift_s),
        _ => {
            let on_one_origin = moved.clone().shifted(origin_s);
            let offset = estimate(&force, &on_one_origin)?;
            taken.notes.push(format!(
                "the files have clocks of their own: {:+.4} s (sd {:.4} s) is added to the times of the displacement, which then explains {:.1} % of \
                 the force (--offset-s states another offset, --merge-on a column of times that the files share)",
                offset.offset_s, offset.sd_s, 100.0 * offset.r2
            ));
            taken.offset = Some(offset);
            taken.drift = drift::estimate(&force, &on_one_origin, &offset);
            match taken.drift {
                None => Clock::shift(origin_s + offset.offset_s),
                Some(Drift { rate, sd, r2, clock }) => {
                    taken.notes.push(format!(
                        "the clocks drift: that of the displacement is taken as {:.3} % (sd {:.3} %) {} beside that of the force, and corrected, so that \
                         the displacement explains {:.1} % of the force (--offset-s takes its times as they are)",
                        100.0 * rate.abs(), 100.0 * sd, if rate < 0.0 { "fast" } else { "slow" }, 100.0 * r2
                    ));
                    Clock { offset_s: origin_s + clock.offset_s, about_s: clock.about_s - origin_s, ..clock }
                }
            }
        }
    };
    let moved = moved.on(&moved_clock);
    if taken.offset.is_none() {
        check_clocks(taken, [&force, &moved], [base, timed.get(moved_at)], parts, options);
    }
    let (force_x, moved_x) = (series("force_x_n")?, series("displacement_x_mm")?);
    let on_clock = |one: Option<(usize, Series)>| {
        one.map(|(at, series)| {
            if at == moved_at { series.on(&moved_clock) } else { series.shifted(shift_s(at).unwrap_or(0.0)) }
        })
    };
    let (force_x, moved_x) = (on_clock(force_x), on_clock(moved_x));
    let rows: Vec<(f64, [f64; 4])> = force
        .readings()
        .filter_map(|(time_s, force_n)| {
            fn of(series: &Option<Series>, time_s: f64) -> Option<f64> {
                series.as_ref().map_or(Some(0.0), |series| series.at(time_s))
            }
            Some((time_s, [force_n, moved.at(time_s)?, of(&force_x, time_s)?, of(&moved_x, time_s)?]))
        })
        .collect();
    if rows.len() < LEAST_RUN {
        fn span(series: &Series) -> String {
            series.span_s().map_or_else(String::new, |[a, b]| format!("{a:.3} to {b:.3} s"))
        }
        return Err(TableError::Map {
            choice: "time_s".to_owned(),
            problem: format!(
                "force ({}) and displacement ({}) have {} rows in common",
                span(&force),
                span(&moved),
                rows.len()
            ),
            expected: if moved_at == force_at {
                format!("{LEAST_RUN} or more rows with a number in both columns")
            } else {
                format!("{LEAST_RUN} or more: one clock (--merge-on COLUMN), or --offset-s")
            },
        });
    }
    let dropped_rows = force.len() - rows.len();
    if dropped_rows > 0 {
        taken.notes.push(format!(
            "{dropped_rows} of {} rows of the force have no displacement at their time, and are skipped",
            force.len()
        ));
    }
    let origin_s = rows.first().map_or(0.0, |(time_s, _)| *time_s);
    fn column(at: usize, rows: &[(f64, [f64; 4])]) -> Vec<f64> {
        rows.iter().map(|(_, values)| values[at]).collect()
    }
    let stride = (moved.period_s() / force.period_s()).round().max(1.0) as usize;
    let (mut y_m, mut x_m) = (column(1, &rows), moved_x.is_some().then(|| column(3, &rows)));
    for (name, values) in
        [Some(("displacement_y_mm", &mut y_m)), x_m.as_mut().map(|x_m| ("displacement_x_mm", x_m))]
            .into_iter()
            .flatten()
    {
        zero::refer_to_zero(name, values, &column(0, &rows), (options.zero, stride), &mut taken.notes);
    }
    series::check_range("displacement_y_mm", &y_m, 0.05)?;
    series::check_range("force_y_n", &column(0, &rows), 200.0)?;
    series::check_sign(&column(0, &rows), &y_m, &mut taken.notes);
    taken.force = Some(ForceSeries {
        time_s: rows.iter().map(|(time_s, _)| time_s - origin_s).collect(),
        displacement_y_m: y_m,
        force_y_n: column(0, &rows),
        displacement_x_m: x_m.filter(|_| force_x.is_some()),
        force_x_n: (force_x.is_some() && moved_x.is_some()).then(|| column(2, &rows)),
        ..ForceSeries::default()
    });
    taken.shape = shape(parts, timed, options, |at| {
        let clock = if at == moved_at { Some(moved_clock) } else { shift_s(at).map(Clock::shift) };
        clock.map(|clock| Clock { offset_s: clock.offset_s - origin_s, ..clock })
    })?;
    let end_s = rows.last().map_or(0.0, |(time_s, _)| time_s - origin_s);
    rows::check_times(taken.shape.as_ref(), end_s)?;
    if let Some((shape, force)) = taken.shape.as_mut().zip(taken.force.as_ref()) {
        straight::refer_shape(shape, force, options, &mut taken.notes)?;
    } else {
        taken.notes.push(
            "there is no shape of the needle (z_mm and deflection_y_mm, of a further table or by guide import slicer, fbg or ultrasound with --force): the run has no modulus without one"
                .to_owned(),
        );
    }
    Ok(())
}

/// Refuses a column of times that no two files share, and notes options for two files where there is one.
fn check_merge(
    taken: &mut Taken,
    timed: &[Timed],
    tables: [Option<&Timed>; 2],
    options: &Options,
) -> Result<(), TableError> {
    let [Some(of_force), Some(of_moved)] = tables else { return Ok(()) };
    if std::ptr::eq(of_force.table, of_moved.table) {
        let merge_on = options.merge_on.as_ref().map(|_| "--merge-on");
        let by_ramps = options.by_ramps.then_some("--by-ramps");
        for option in merge_on.into_iter().chain(options.offset_s.map(|_| "--offset-s")).chain(by_ramps) {
            taken.notes.push(format!(
                "{}: {option} has no effect: force and displacement are in one table, row by row",
                of_force.table.path.display()
            ));
        }
        return Ok(());
    }
    let Some(name) = &options.merge_on else { return Ok(()) };
    // A third file may share it with one of these, while the other has a clock of its own.
    if timed.iter().filter(|timed| timed.is_named(name)).count() > 1 {
        return Ok(());
    }
    let unnamed = timed.iter().filter(|timed| !timed.is_named(name));
    let paths: Vec<String> = unnamed.map(|timed| timed.table.path.display().to_string()).collect();
    Err(TableError::Map {
        choice: format!("--merge-on '{name}'"),
        problem: format!(
            "this is not the name of the column of times that is used of {}",
            paths.join(" and ")
        ),
        expected: "the name of the column of times in both files, or --offset-s where these differ"
            .to_owned(),
    })
}

/// Remarks on clocks that are taken as one, by the files or by the user, where the ramps of both contradict that.
fn check_clocks(
    taken: &mut Taken,
    [force, moved]: [&Series; 2],
    tables: [Option<&Timed>; 2],
    parts: &[Part],
    options: &Options,
) {
    let [Some(of_force), Some(of_moved)] = tables else { return };
    let is_one_table = std::ptr::eq(of_force.table, of_moved.table);
    let path = of_force.table.path.display();
    // A clock beside the one that is taken is perhaps that of the other column.
    let unused_clocks: Vec<String> = of_force
        .table
        .columns
        .iter()
        .filter(|column| {
            is_one_table && is_time(column) && !parts.iter().any(|part| std::ptr::eq(part.column, *column))
        })
        .map(|column| format!("\"{}\"", column.header))
        .collect();
    if is_one_table && unused_clocks.is_empty() {
        return;
    }
    if is_one_table {
        taken.notes.push(format!(
            "{path}: {} is another column of times, and not used: force and displacement are taken as read at once, row by row",
            unused_clocks.join(" and ")
        ));
    }
    let contradicted = contradiction(force, moved);
    let periods_s = force.period_s().hypot(moved.period_s());
    let offset = contradicted.unwrap_or(Offset { offset_s: 0.0, sd_s: periods_s, r2: 0.0 });
    if let Some(Drift { rate, sd, .. }) = drift::estimate(force, moved, &offset) {
        taken.notes.push(format!(
            "{path}: the clocks are taken as one, and the ramps show a drift between them: that of the displacement is {:.3} % (sd {:.3} %) {} \
             (--by-ramps takes offset and drift of the ramps)",
            100.0 * rate.abs(),
            100.0 * sd,
            if rate < 0.0 { "fast" } else { "slow" }
        ));
    }
    if contradicted.is_none() {
        return;
    }
    let (stated, remedy) = match (options.offset_s, is_one_table) {
        (Some(offset_s), false) => {
            ("--offset-s".to_owned(), format!("--offset-s {:.3}", offset_s + offset.offset_s))
        }
        (None, false) => {
            let stated = options
                .merge_on
                .as_ref()
                .map_or_else(|| "the clocks of both files".to_owned(), |_| "--merge-on".to_owned());
            (stated, format!("--offset-s {:.3}", offset.offset_s))
        }
        (_, true) => ("one column of times".to_owned(), "a file for each, with its own times".to_owned()),
    };
    taken.notes.push(format!(
        "{path}: {stated} and the ramps contradict each other: the force follows the displacement best with {:+.3} s (sd {:.3} s) added to the \
         displacement's times, where it explains {:.1} % of the force: {remedy} brings them together",
        offset.offset_s, offset.sd_s, 100.0 * offset.r2
    ));
}
