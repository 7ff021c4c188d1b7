//! Figures of one lateral run: force against displacement, and what the fit leaves of every reading.

use super::{Area, FONT, FigureError, GREY, WIDTH, axes, failed, headroom, legend, range};
use formats::session::LateralRun;
use inference::identify::{ResidualResult, RunResult};
use plotters::prelude::*;

/// Samples drawn of a recording.
const SAMPLES: usize = 300;

/// Force against displacement: samples (dots), holds (circles), and the fitted beam (line).
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn force(run: &LateralRun, found: &RunResult) -> Result<String, FigureError> {
    let series = &run.force;
    let every = series.time_s.len().div_ceil(SAMPLES).max(1);
    let mut planes = vec![("vertical", BLUE, thinned(&series.displacement_y_m, &series.force_y_n, every))];
    if let (Some(displacement_m), Some(force_n)) = (&series.displacement_x_m, &series.force_x_n) {
        planes.push(("horizontal", RED, thinned(displacement_m, force_n, every)));
    }
    let used_holds: Vec<_> = found.holds.iter().filter(|hold| hold.used).collect();
    let fitted = fitted_y(found);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 480)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!("{}: force against displacement", run.id);
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let all_points = || planes.iter().flat_map(|(.., points)| points);
        let (x, y) = (range(all_points().map(|at| at.0)), range(all_points().map(|at| at.1)));
        let y = headroom(y, planes.len() + 2, 400);
        let mut chart = axes(&area, x, y, "force, N", "displacement of guide 2, mm")?;
        for (name, colour, points) in planes {
            chart
                .draw_series(points.into_iter().map(|at| Circle::new(at, 1, colour.mix(0.5).filled())))
                .map_err(failed)?
                .label(format!("{name}, one sample in {every}"))
                .legend(move |(x, y)| Circle::new((x + 8, y), 2, colour.filled()));
        }
        let means = used_holds.iter().map(|hold| (hold.displacement_y_mm, hold.force_y_n));
        chart
            .draw_series(means.map(|at| Circle::new(at, 5, BLACK.stroke_width(2))))
            .map_err(failed)?
            .label("vertical, mean of a hold")
            .legend(|(x, y)| Circle::new((x + 8, y), 4, BLACK.stroke_width(2)));
        chart
            .draw_series(LineSeries::new(fitted, GREY.stroke_width(2)))
            .map_err(failed)?
            .label("vertical, fitted")
            .legend(|(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], GREY.stroke_width(2)));
        legend(&mut chart)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn thinned(displacement_m: &[f64], force_n: &[f64], every: usize) -> Vec<(f64, f64)> {
    displacement_m.iter().zip(force_n).step_by(every).map(|(u_m, force_n)| (1e3 * u_m, *force_n)).collect()
}

/// Fitted vertical force of the holds, by displacement.
fn fitted_y(found: &RunResult) -> Vec<(f64, f64)> {
    let used_holds: Vec<_> = found.holds.iter().filter(|hold| hold.used).collect();
    let fitted =
        found.residuals.iter().filter(|one| one.channel == "force" && one.plane == "y").filter_map(|one| {
            let hold = used_holds.get(one.hold)?;
            Some((hold.displacement_y_mm, hold.force_y_n - one.sigma * hold.force_y_se_n?))
        });
    let mut fitted: Vec<(f64, f64)> = fitted.collect();
    fitted.sort_by(|a, b| a.0.total_cmp(&b.0));
    fitted
}

/// Residuals of every reading, in standard deviations: the shape along the needle, and all channels over time (the
/// middle of the hold). Noise scatters about 0, nearly all of it within the grey lines at 2.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn run_residuals(found: &RunResult) -> Result<String, FigureError> {
    let middles_s: Vec<f64> =
        found.holds.iter().filter(|hold| hold.used).map(|hold| 0.5 * (hold.from_s + hold.to_s)).collect();
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 620)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let title = format!("{}: residuals, standard deviations", found.id);
        let area = area.titled(&title, (FONT, 22)).map_err(failed)?;
        let (upper_area, lower_area) = area.split_vertically(280);
        panel(&upper_area, found, "position along the needle, mm", &point_along_needle)?;
        panel(&lower_area, found, "time, s", &|one| point_over_time(one, &middles_s))?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn point_along_needle(one: &ResidualResult) -> Option<(f64, f64)> {
    Some((one.z_mm?, one.sigma))
}

fn point_over_time(one: &ResidualResult, middles_s: &[f64]) -> Option<(f64, f64)> {
    Some((*middles_s.get(one.hold)?, one.sigma))
}

fn panel(
    area: &Area<'_>,
    found: &RunResult,
    coordinate: &str,
    place: &dyn Fn(&ResidualResult) -> Option<(f64, f64)>,
) -> Result<(), FigureError> {
    let all: Vec<(f64, f64)> = found.residuals.iter().filter_map(place).collect();
    let x = range(all.iter().map(|at| at.0));
    let y = range(all.iter().map(|at| at.1).chain([-3.0, 3.0]));
    // Room for the legend.
    let y = y.start..y.end + 0.35 * (y.end - y.start);
    let mut chart = axes(area, x.clone(), y, "measured - fitted", coordinate)?;
    for level in [-2.0, 0.0, 2.0] {
        chart.draw_series(LineSeries::new([(x.start, level), (x.end, level)], GREY)).map_err(failed)?;
    }
    for (channel, colour) in [("shape", BLUE), ("displacement", GREEN), ("force", RED)] {
        let of_channel = found.residuals.iter().filter(|one| one.channel == channel);
        let points: Vec<(f64, f64)> = of_channel.filter_map(place).collect();
        if !points.is_empty() {
            chart
                .draw_series(points.into_iter().map(|at| Circle::new(at, 3, colour.filled())))
                .map_err(failed)?
                .label(channel)
                .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
        }
    }
    legend(&mut chart)
}
