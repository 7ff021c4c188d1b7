//! Figures of a population: forest plot, spread by group, funnel, time chart of every rig, shrinkage.

use super::{Area, FONT, FigureError, GREY, WIDTH, axes, failed, range};
use plotters::prelude::*;
use population::{GroupResult, Population, SessionRow};
use std::collections::BTreeMap;

/// Sessions in a forest plot or a shrinkage plot: more cannot be read.
const MAX_ROWS: usize = 60;
/// Pixels of a row, and of what is around them.
const ROW: u32 = 16;
const AROUND: u32 = 130;
/// Limits of a time chart, in standard deviations.
const LIMIT_SDS: f64 = 3.0;

/// All figures of a population with their names; those for which there are no data are skipped.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn population(found: &Population) -> Result<Vec<(String, String)>, FigureError> {
    let mut figures = vec![
        ("forest".to_owned(), forest(found)?),
        ("spread".to_owned(), spread(found)?),
        ("funnel".to_owned(), funnel(found)?),
        ("shrinkage".to_owned(), shrinkage(found)?),
    ];
    let mut rigs: BTreeMap<&str, Vec<(&SessionRow, f64)>> = BTreeMap::new();
    for row in &found.rows {
        if let (Some(rig), Some(day)) = (&row.rig, row.date.as_deref().and_then(day_of)) {
            rigs.entry(rig).or_default().push((row, day));
        }
    }
    for (rig, rows) in rigs.iter().filter(|(_, rows)| rows.len() > 1) {
        figures.push((format!("time-{rig}"), time_chart(found, rig, rows)?));
    }
    Ok(figures)
}

fn day_of(date: &str) -> Option<f64> {
    let iso = time::format_description::well_known::Iso8601::DATE;
    time::Date::parse(date, &iso).ok().map(|date| f64::from(date.to_julian_day()))
}

fn group<'a>(found: &'a Population, name: &str) -> Option<&'a GroupResult> {
    found.groups.iter().find(|group| group.group == name)
}

/// Draws on a white page with a title.
fn page(
    title: &str,
    height: u32,
    draw: impl FnOnce(&Area<'_>) -> Result<(), FigureError>,
) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled(title, (FONT, 22)).map_err(failed)?;
        draw(&area)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

/// Rows with a name at the left of a logarithmic axis of K.
fn rows_of_k(
    title: &str,
    names: &[String],
    values_kpa: impl Iterator<Item = f64>,
    draw: impl FnOnce(&mut super::Chart<'_, '_>) -> Result<(), FigureError>,
) -> Result<String, FigureError> {
    let count = names.len().max(1);
    page(title, AROUND + ROW * count as u32, |area| {
        let k = range(values_kpa.map(f64::ln));
        let mut chart = ChartBuilder::on(area)
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(250)
            .build_cartesian_2d(k, -0.5..count as f64 - 0.5)
            .map_err(failed)?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .light_line_style(TRANSPARENT)
            .label_style((FONT, 12))
            .axis_desc_style((FONT, 16))
            .x_desc("K, kPa (logarithmic)")
            .x_label_formatter(&|ln| format!("{:.2}", ln.exp()))
            .y_labels(2 * count + 1)
            .y_label_formatter(&|at| tick_name(at, count, names))
            .draw()
            .map_err(failed)?;
        draw(&mut chart)
    })
}

fn tick_name(at: &f64, count: usize, names: &[String]) -> String {
    let whole = (at - at.round()).abs() < 1e-6;
    let index = (count as f64 - 1.0 - at.round()) as usize;
    names.get(index).filter(|_| whole).map_or_else(String::new, |name| name.chars().take(34).collect())
}

/// Every session with its interval, and the mean and prediction of every group.
fn forest(found: &Population) -> Result<String, FigureError> {
    let mut rows: Vec<&SessionRow> = found.rows.iter().collect();
    rows.sort_by(|a, b| (&a.group, &a.session).cmp(&(&b.group, &b.session)));
    let shown = &rows[..rows.len().min(MAX_ROWS)];
    let names: Vec<String> = shown
        .iter()
        .map(|row| row.session.clone())
        .chain(found.groups.iter().map(|group| format!("mean of {}", group.group)))
        .collect();
    let ends = shown.iter().flat_map(|row| row.k_kpa.ci95);
    let ends =
        ends.chain(found.groups.iter().flat_map(|group| group.new_subject95_kpa.unwrap_or(group.k_kpa.ci95)));
    let title = match rows.len() > shown.len() {
        true => format!(
            "K of the first {} of {} sessions, and of groups (thin: a new subject)",
            shown.len(),
            rows.len()
        ),
        false => "K of sessions and groups (thin: a new subject)".to_owned(),
    };
    rows_of_k(&title, &names, ends, |chart| {
        let top = names.len() as f64 - 1.0;
        let mut line = |index: usize, [low, high]: [f64; 2], style: ShapeStyle| {
            let height = top - index as f64;
            chart
                .draw_series(LineSeries::new([(low.ln(), height), (high.ln(), height)], style))
                .map(|_| ())
                .map_err(failed)
        };
        for (index, row) in shown.iter().enumerate() {
            line(index, row.k_kpa.ci95, if row.used { BLUE } else { GREY }.stroke_width(2))?;
        }
        for (index, group) in found.groups.iter().enumerate() {
            if let Some(ends) = group.new_subject95_kpa {
                line(shown.len() + index, ends, RED.stroke_width(1))?;
            }
            line(shown.len() + index, group.k_kpa.ci95, RED.stroke_width(4))?;
        }
        let points = shown.iter().enumerate().map(|(index, row)| {
            let colour = if row.used { BLUE } else { GREY };
            Circle::new((row.k_kpa.value.ln(), top - index as f64), 3, colour.filled())
        });
        chart.draw_series(points).map(|_| ()).map_err(failed)
    })
}

/// Sessions of every group beside its mean and the interval of a new subject.
fn spread(found: &Population) -> Result<String, FigureError> {
    let names: Vec<String> = found.groups.iter().map(|group| group.group.clone()).collect();
    let of_rows = found.rows.iter().map(|row| row.k_kpa.value);
    let ends = of_rows
        .chain(found.groups.iter().flat_map(|group| group.new_subject95_kpa.unwrap_or(group.k_kpa.ci95)));
    rows_of_k("K by group: sessions, mean, and 95 % of new subjects", &names, ends, |chart| {
        let top = names.len() as f64 - 1.0;
        for (index, group) in found.groups.iter().enumerate() {
            let height = top - index as f64;
            if let Some([low, high]) = group.new_subject95_kpa {
                let bar = Rectangle::new(
                    [(low.ln(), height - 0.3), (high.ln(), height + 0.3)],
                    RED.mix(0.15).filled(),
                );
                chart.draw_series([bar]).map_err(failed)?;
            }
            let mean = group.k_kpa.value.ln();
            let line = LineSeries::new([(mean, height - 0.3), (mean, height + 0.3)], RED.stroke_width(2));
            chart.draw_series(line).map_err(failed)?;
            let of_group = found.rows.iter().filter(|row| row.group == group.group).enumerate();
            let points = of_group.map(|(number, row)| {
                // Rows of a group beside each other, not on each other.
                let jitter = 0.5 * ((number as f64 * 0.618_034).fract() - 0.5);
                let style = if row.used { BLUE.mix(0.6).filled() } else { GREY.stroke_width(1) };
                Circle::new((row.k_kpa.value.ln(), height + jitter), 3, style)
            });
            chart.draw_series(points).map_err(failed)?;
        }
        Ok(())
    })
}

/// Standard deviation of a session's ln K from its interval.
fn sd(row: &SessionRow) -> f64 {
    let [low, high] = row.k_kpa.ci95;
    (high / low).ln() / (2.0 * formats::NORMAL_975)
}

/// Distance of ln K from the group's mean.
fn distance(found: &Population, row: &SessionRow) -> Option<f64> {
    Some(row.k_kpa.value.ln() - group(found, &row.group)?.ln_k[0])
}

/// Distance from the mean against each session's own error, with the lines between which 95 % would lie without differences.
fn funnel(found: &Population) -> Result<String, FigureError> {
    let points: Vec<(f64, f64, bool)> =
        found.rows.iter().filter_map(|row| Some((distance(found, row)?, sd(row), row.used))).collect();
    page("funnel: distance from the group's mean against the session's own error", 560, |area| {
        let largest = points.iter().map(|point| point.1).fold(1e-3, f64::max) * 1.05;
        let wide = points.iter().map(|point| point.0.abs()).fold(2.0 * largest, f64::max) * 1.05;
        let mut chart = axes(
            area,
            -wide..wide,
            largest..0.0,
            "standard deviation of ln K of the session",
            "ln K minus the mean of the group",
        )?;
        for side in [-1.0, 1.0] {
            let line = [(0.0, 0.0), (side * formats::NORMAL_975 * largest, largest)];
            chart.draw_series(LineSeries::new(line, GREY)).map_err(failed)?;
        }
        let circles = points.iter().map(|(x, y, used)| {
            Circle::new((*x, *y), 3, if *used { BLUE.mix(0.6).filled() } else { RED.stroke_width(1) })
        });
        chart.draw_series(circles).map_err(failed)?;
        Ok(())
    })
}

/// K of a rig's sessions over time, against the mean of each session's group, with limits of three standard deviations.
fn time_chart(found: &Population, rig: &str, rows: &[(&SessionRow, f64)]) -> Result<String, FigureError> {
    let first = rows.iter().map(|(_, day)| *day).fold(f64::INFINITY, f64::min);
    let points: Vec<(f64, f64, f64, bool)> = rows
        .iter()
        .filter_map(|(row, day)| {
            let tau = group(found, &row.group)?.tau;
            Some((day - first, distance(found, row)?, LIMIT_SDS * tau.hypot(sd(row)), row.used))
        })
        .collect();
    let date = rows.iter().filter(|(_, day)| *day == first).find_map(|(row, _)| row.date.clone());
    let title = format!("rig {rig}: K against its group over time (grey: {LIMIT_SDS} standard deviations)");
    page(&title, 480, |area| {
        let days = range(points.iter().map(|point| point.0));
        let values = range(points.iter().flat_map(|point| [point.1, point.2, -point.2]));
        let x_name = format!("days since {}", date.unwrap_or_default());
        let mut chart = axes(area, days, values, "ln K minus the mean of the group", &x_name)?;
        for (day, _, limit, _) in &points {
            let line = LineSeries::new([(*day, -limit), (*day, *limit)], GREY.mix(0.4).stroke_width(1));
            chart.draw_series(line).map_err(failed)?;
        }
        let circles = points.iter().map(|(day, value, _, used)| {
            Circle::new((*day, *value), 4, if *used { BLUE.filled() } else { RED.stroke_width(2) })
        });
        chart.draw_series(circles).map_err(failed)?;
        Ok(())
    })
}

/// Every session's own K and the estimate that its group adds to.
fn shrinkage(found: &Population) -> Result<String, FigureError> {
    let mut rows: Vec<(&SessionRow, f64)> =
        found.rows.iter().filter_map(|row| Some((row, row.k_shrunk_kpa?.value))).collect();
    rows.sort_by(|a, b| (&a.0.group, &a.0.session).cmp(&(&b.0.group, &b.0.session)));
    rows.truncate(MAX_ROWS);
    let names: Vec<String> = rows.iter().map(|(row, _)| row.session.clone()).collect();
    let values: Vec<f64> = rows.iter().flat_map(|(row, shrunk)| [row.k_kpa.value, *shrunk]).collect();
    rows_of_k("K of sessions (open) and shrunk to the group (filled)", &names, values.into_iter(), |chart| {
        let top = names.len() as f64 - 1.0;
        for (index, (row, shrunk)) in rows.iter().enumerate() {
            let height = top - index as f64;
            let line = LineSeries::new([(row.k_kpa.value.ln(), height), (shrunk.ln(), height)], GREY);
            chart.draw_series(line).map_err(failed)?;
            let open = Circle::new((row.k_kpa.value.ln(), height), 4, BLUE.stroke_width(1));
            let full = Circle::new((shrunk.ln(), height), 4, BLUE.filled());
            chart.draw_series([open, full]).map_err(failed)?;
        }
        Ok(())
    })
}
