//! Figures of a diagnosis: residuals before and after on what was held out, the ranking of effects, the gap channel by channel.

use super::{FONT, FigureError, GREY, WIDTH, axes, failed, legend, range};
use inference::diagnose::{Channel, Diagnosis, HeldOutMisfit};
use plotters::prelude::*;

const BEFORE: RGBColor = RGBColor(200, 80, 40);
const AFTER: RGBColor = RGBColor(30, 90, 180);
/// Effects in the ranking.
const RANKS: usize = 12;

/// Measured less predicted against its coordinate, one panel per channel, before and after.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn residuals(gap: &HeldOutMisfit) -> Result<String, FigureError> {
    let channels: Vec<Channel> = Channel::ALL
        .into_iter()
        .filter(|channel| gap.points.iter().any(|point| point.channel == *channel))
        .collect();
    let mut svg = String::new();
    {
        let height = 60 + 230 * channels.len().max(1) as u32;
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area
            .titled("measured minus predicted, runs held out of every fit", (FONT, 22))
            .map_err(failed)?;
        for (panel, channel) in area.split_evenly((channels.len().max(1), 1)).iter().zip(&channels) {
            let x = range(of_channel(channel, &gap.points).map(|point| point.at_mm));
            let y = range(of_channel(channel, &gap.points).flat_map(|point| [point.before, point.after]));
            let coordinate = match channel {
                Channel::ForceY | Channel::ForceX => "displacement of guide 2, mm",
                Channel::ShapeY | Channel::ShapeX => "depth below the surface, mm",
                Channel::TipY | Channel::TipX | Channel::TipDirectionY | Channel::TipDirectionX => {
                    "insertion depth, mm"
                }
            };
            let name = format!("{}, {}", channel.name(), channel.unit());
            let mut chart = axes(panel, x, y, &name, coordinate)?;
            for (name, colour, value) in [
                ("before", BEFORE, (|p| p.before) as fn(&inference::diagnose::ResidualPoint) -> f64),
                ("after", AFTER, |p| p.after),
            ] {
                let dots = of_channel(channel, &gap.points)
                    .map(|point| Circle::new((point.at_mm, value(point)), 2, colour.filled()));
                chart
                    .draw_series(dots)
                    .map_err(failed)?
                    .label(name)
                    .legend(move |(x, y)| Circle::new((x + 8, y), 4, colour.filled()));
            }
            legend(&mut chart)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn of_channel<'a>(
    channel: &'a Channel,
    points: &'a [inference::diagnose::ResidualPoint],
) -> impl Iterator<Item = &'a inference::diagnose::ResidualPoint> {
    points.iter().filter(|point| point.channel == *channel)
}

/// Log evidence of the leading effects over the starting model, and the margin that a name needs.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn ranking(found: &Diagnosis) -> Result<String, FigureError> {
    let leading: Vec<_> = found.ranking.iter().take(RANKS).collect();
    let bars: Vec<(String, f64, RGBColor)> = leading
        .iter()
        .map(|ranked| {
            let is_named = found.effects.iter().any(|effect| effect.id == ranked.id);
            (ranked.id.clone(), ranked.log_evidence_gain.max(0.0), if is_named { AFTER } else { GREY })
        })
        .collect();
    let name = "log evidence over the starting model";
    bar_chart(name, name, &bars, Some(found.margin))
}

/// Root mean square of the residuals on what was held out, before and after.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn gap(gap: &HeldOutMisfit) -> Result<String, FigureError> {
    let sides = gap.before.rmse.iter().flat_map(|(name, before)| {
        let rmse_after = gap.after.rmse.get(name).copied().unwrap_or(f64::NAN);
        [(format!("{name} before"), *before, BEFORE), (format!("{name} after"), rmse_after, AFTER)]
    });
    let bars: Vec<_> = sides.collect();
    bar_chart("root mean square of the residuals, held-out runs", "N or mm", &bars, None)
}

/// Horizontal bars with their names.
fn bar_chart(
    title: &str,
    axis: &str,
    bars: &[(String, f64, RGBColor)],
    mark: Option<f64>,
) -> Result<String, FigureError> {
    let mut svg = String::new();
    {
        let height = 130 + 30 * bars.len() as u32;
        let area = SVGBackend::with_string(&mut svg, (WIDTH, height)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        let area = area.titled(title, (FONT, 22)).map_err(failed)?;
        let most = bars
            .iter()
            .map(|(_, value, _)| *value)
            .chain(mark)
            .filter(|v| v.is_finite())
            .fold(1e-3, f64::max);
        let count = bars.len() as f64;
        let mut chart = ChartBuilder::on(&area)
            .margin(12)
            .x_label_area_size(46)
            .y_label_area_size(200)
            .build_cartesian_2d(0.0..1.05 * most, 0.0..count.max(1.0))
            .map_err(failed)?;
        chart
            .configure_mesh()
            .disable_y_mesh()
            .light_line_style(TRANSPARENT)
            .label_style((FONT, 14))
            .axis_desc_style((FONT, 16))
            .x_desc(axis)
            .x_label_formatter(&crate::tick)
            .y_labels(4 * bars.len().max(1))
            .y_label_formatter(&|y| bar_label(y, count, bars))
            .draw()
            .map_err(failed)?;
        chart
            .draw_series(bars.iter().enumerate().filter(|(_, (_, value, _))| value.is_finite()).map(
                |(number, (_, value, colour))| {
                    let top = count - number as f64 - 0.15;
                    Rectangle::new([(0.0, top - 0.7), (*value, top)], colour.filled())
                },
            ))
            .map_err(failed)?;
        if let Some(mark) = mark {
            chart.draw_series(LineSeries::new([(mark, 0.0), (mark, count)], RED)).map_err(failed)?;
        }
        area.present().map_err(failed)?;
    }
    Ok(svg)
}

fn bar_label(y: &f64, count: f64, bars: &[(String, f64, RGBColor)]) -> String {
    // Names stand in the middle of their bars, the first one on top.
    let number = count - y - 0.5;
    let is_middle = (number - number.round()).abs() < 1e-6 && number > -0.5;
    let bar = if is_middle { bars.get(number.round() as usize) } else { None };
    bar.map_or(String::new(), |(name, ..)| name.clone())
}
