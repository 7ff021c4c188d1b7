//! Figures of a needle that was brought to a target: its path with the plan, and the plane of the target.

use super::{FONT, FigureError, GREY, WIDTH, axes, band, failed, legend, range};
use plotters::prelude::*;
use std::ops::Range;

/// Quantities of a run's figure, millimetres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Steered {
    /// Target: x, y, depth.
    pub target_mm: [f64; 3],
    /// Tip readings: depth, x, y.
    pub readings_mm: Vec<[f64; 3]>,
    /// Path that was planned at the last stop before the middle of the way: depth, x, y, standard deviation per axis.
    pub planned_mm: Vec<[f64; 4]>,
    /// Guide 2 at every stop, after its move: depth, x, y.
    pub guide_mm: Vec<[f64; 3]>,
    /// Corners of the set that could be reached before the first push: x, y at the target's depth.
    pub reachable_mm: Vec<[f64; 2]>,
    /// Tip that was expected at the target at every stop: x, y, standard deviation per axis.
    pub expected_mm: Vec<[f64; 3]>,
    /// Position of the tip; `None` before a run.
    pub tip_mm: Option<[f64; 2]>,
}

const PLANES: [(&str, RGBColor); 2] = [("x", RED), ("y", BLUE)];

/// Tip readings (dots), the plan (of half-way, where there was a run) with its 95 % band and the target (crosses), and below them the positions of guide 2.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn steered_path(run: &Steered) -> Result<String, FigureError> {
    let [_, _, target_depth_mm] = run.target_mm;
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, 760)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled("Path of the tip and of guide 2", (FONT, 22)).map_err(failed)?;
        let (upper_area, lower_area) = area.split_vertically(480);
        let depths = range([0.0, target_depth_mm].into_iter());
        let tips = run.readings_mm.iter().flat_map(|[_, x, y]| [*x, *y]);
        let planned = run
            .planned_mm
            .iter()
            .flat_map(|[_, x, y, sd]| [x - 2.0 * sd, x + 2.0 * sd, y - 2.0 * sd, y + 2.0 * sd]);
        let tips = range(tips.chain(planned).chain([run.target_mm[0], run.target_mm[1]]));
        let mut chart = axes(&upper_area, depths.clone(), tips, "tip, mm", "")?;
        for (plane, (name, colour)) in PLANES.into_iter().enumerate() {
            let depths: Vec<f64> = run.planned_mm.iter().map(|one| one[0]).collect();
            if depths.len() > 1 {
                chart
                    .draw_series(std::iter::once(band(
                        &depths,
                        &band_edge(-1.0, plane, &run.planned_mm),
                        &band_edge(1.0, plane, &run.planned_mm),
                        colour,
                    )))
                    .map_err(failed)?;
            }
            chart
                .draw_series(LineSeries::new(
                    run.planned_mm.iter().map(|one| (one[0], one[1 + plane])),
                    colour.stroke_width(2),
                ))
                .map_err(failed)?
                .label(format!("{name}: planned with 95 % band, measured, target"))
                .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 16, y)], colour.stroke_width(2)));
            let dots = run.readings_mm.iter().map(|one| (one[0], one[1 + plane]));
            chart
                .draw_series(dots.map(|depths| Circle::new(depths, 2, colour.stroke_width(1))))
                .map_err(failed)?;
            let target = (target_depth_mm, run.target_mm[plane]);
            chart.draw_series([Cross::new(target, 6, colour.stroke_width(2))]).map_err(failed)?;
        }
        legend(&mut chart)?;
        let guide = range(run.guide_mm.iter().flat_map(|[_, x, y]| [*x, *y]).chain([0.0]));
        let mut chart = axes(&lower_area, depths, guide, "guide 2, mm", "depth, mm")?;
        for (plane, (_, colour)) in PLANES.into_iter().enumerate() {
            let mut previous_mm = 0.0;
            let mut steps = vec![(0.0, 0.0)];
            for one in &run.guide_mm {
                steps.extend([(one[0], previous_mm), (one[0], one[1 + plane])]);
                previous_mm = one[1 + plane];
            }
            steps.push((target_depth_mm, previous_mm));
            chart.draw_series(LineSeries::new(steps, colour.stroke_width(2))).map_err(failed)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn band_edge(sign: f64, plane: usize, planned_mm: &[[f64; 4]]) -> Vec<f64> {
    planned_mm.iter().map(|one| one[1 + plane] + sign * 1.96 * one[3]).collect()
}

/// Range of all points of a run at the target's depth, along y or x.
fn extent_mm(run: &Steered, plane: usize) -> Range<f64> {
    let corners = run.reachable_mm.iter().map(|corner| corner[plane]);
    let expected = run.expected_mm.iter().map(|stop| stop[plane]);
    let tip = run.tip_mm.map(|tip_mm| tip_mm[plane]);
    range(corners.chain(expected).chain([run.target_mm[plane]]).chain(tip))
}

/// The plane of the target's depth: what could be reached, the tip as it was expected at each stop (paler, earlier) and where it is.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn steered_target(run: &Steered) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (700, 700)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled("At the target's depth", (FONT, 22)).map_err(failed)?;
        let mut chart = axes(&area, extent_mm(run, 0), extent_mm(run, 1), "y, mm", "x, mm")?;
        let corners: Vec<(f64, f64)> = run.reachable_mm.iter().map(|[x, y]| (*x, *y)).collect();
        chart
            .draw_series([Polygon::new(corners, GREY.mix(0.2))])
            .map_err(failed)?
            .label("reachable before the first push")
            .legend(|(x, y)| Rectangle::new([(x, y - 5), (x + 16, y + 5)], GREY.mix(0.2).filled()));
        let count = run.expected_mm.len().max(1) as f64;
        let expected = run.expected_mm.iter().enumerate().map(|(number, [x, y, _])| {
            let opacity = 0.2 + 0.8 * (number as f64 + 1.0) / count;
            Circle::new((*x, *y), 4, BLUE.mix(opacity).stroke_width(1))
        });
        chart
            .draw_series(expected)
            .map_err(failed)?
            .label("expected, stop by stop")
            .legend(|(x, y)| Circle::new((x + 8, y), 4, BLUE.stroke_width(1)));
        if let Some([x, y]) = run.tip_mm {
            chart
                .draw_series([Circle::new((x, y), 4, BLACK.filled())])
                .map_err(failed)?
                .label("tip")
                .legend(|(x, y)| Circle::new((x + 8, y), 4, BLACK.filled()));
        }
        chart
            .draw_series([Cross::new((run.target_mm[0], run.target_mm[1]), 7, RED.stroke_width(2))])
            .map_err(failed)?
            .label("target")
            .legend(|(x, y)| Cross::new((x + 8, y), 5, RED.stroke_width(2)));
        legend(&mut chart)?;
        area.present().map_err(failed)?;
    }
    Ok(svg)
}
