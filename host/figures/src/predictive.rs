//! Readings beside what a model predicts of them, before it knew them and after.

use super::{FONT, FigureError, GREY, WIDTH, axes, failed, legend, range};
use inference::draws::{Draws, Group};
use plotters::prelude::*;
use std::ops::Range;

const POSTERIOR: RGBColor = RGBColor(30, 90, 180);
/// Panels beside each other, at most so many in all, and the height of each, pixels.
const COLUMNS: usize = 2;
const MAX_PANELS: usize = 6;
const PANEL_HEIGHT: u32 = 300;
/// Channels that are drawn: force over time.
const FORCES: [&str; 2] = [".force_y_n", ".force_x_n"];
/// Ends of the bands.
const ENDS: [f64; 2] = [0.025, 0.975];

/// One channel of one run over time.
struct Panel {
    name: String,
    /// Time, s, and reading, N, in the order of time.
    observed: Vec<[f64; 2]>,
    prior: Vec<[f64; 2]>,
    posterior: Vec<[f64; 2]>,
}

/// Forces of the first runs over time, with the 95 % bands of prior and posterior prediction; nothing where no forces were drawn.
///
/// # Errors
/// [`FigureError`] where the drawing fails.
pub fn predictive(draws: &Draws) -> Result<Option<String>, FigureError> {
    let names = draws.variables(Group::PosteriorPredictive);
    let forces = names.filter(|name| FORCES.iter().any(|force| name.ends_with(force)));
    let panels: Vec<Panel> = forces.filter_map(|name| Panel::new(name, draws)).take(MAX_PANELS).collect();
    if panels.is_empty() {
        return Ok(None);
    }
    let rows = panels.len().div_ceil(COLUMNS);
    let mut svg = String::new();
    {
        let area = SVGBackend::with_string(&mut svg, (WIDTH, PANEL_HEIGHT * rows as u32)).into_drawing_area();
        area.fill(&WHITE).map_err(failed)?;
        for (number, (panel, part)) in panels.iter().zip(area.split_evenly((rows, COLUMNS))).enumerate() {
            let titled = part.titled(&panel.name, (FONT, 16)).map_err(failed)?;
            let times = range(panel.observed.iter().map(|[time_s, _]| *time_s));
            let forces = panel.forces();
            let mut chart = axes(&titled, times, forces.clone(), "force, N", "time, s")?;
            let bands = [
                ("prior predictive interval (95 %)", &panel.prior, GREY.mix(0.3)),
                ("posterior predictive interval (95 %)", &panel.posterior, POSTERIOR.mix(0.35)),
            ];
            for (label, band, colour) in bands {
                let at = |end: usize| {
                    let of_end =
                        panel.observed.iter().zip(band).map(move |([time_s, _], ends)| (*time_s, ends[end]));
                    of_end.map(|(time_s, force_n)| (time_s, force_n.clamp(forces.start, forces.end)))
                };
                let outline: Vec<(f64, f64)> = at(0).chain(at(1).rev()).collect();
                if outline.is_empty() {
                    continue;
                }
                chart
                    .draw_series([Polygon::new(outline, colour)])
                    .map_err(failed)?
                    .label(label)
                    .legend(move |(x, y)| Rectangle::new([(x, y - 5), (x + 16, y + 5)], colour.filled()));
            }
            let dots = panel
                .observed
                .iter()
                .map(|[time_s, force_n]| Circle::new((*time_s, *force_n), 2, BLACK.filled()));
            chart
                .draw_series(dots)
                .map_err(failed)?
                .label("measured")
                .legend(|(x, y)| Circle::new((x + 8, y), 2, BLACK.filled()));
            if number == 0 {
                legend(&mut chart)?;
            }
        }
        area.present().map_err(failed)?;
    }
    Ok(Some(svg))
}

impl Panel {
    fn new(name: &str, draws: &Draws) -> Option<Self> {
        let dimension = name.strip_suffix("_n")?;
        let times = draws.values(Group::ConstantData, &format!("{dimension}.time_s"))?;
        let measured = draws.values(Group::ObservedData, name)?;
        let mut order: Vec<usize> = (0..times.len()).collect();
        order.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
        let band = |group: Group| -> Vec<[f64; 2]> {
            let of_places: Option<Vec<[f64; 2]>> =
                order.iter().map(|place| Some(ends(draws.at(group, name, *place)?))).collect();
            of_places.unwrap_or_default()
        };
        Some(Self {
            name: dimension.to_owned(),
            observed: order
                .iter()
                .map(|place| Some([times[*place], *measured.get(*place)?]))
                .collect::<Option<_>>()?,
            prior: band(Group::PriorPredictive),
            posterior: band(Group::PosteriorPredictive),
        })
    }

    /// Axis of the forces: three times what was measured and predicted with the data, so that these are seen. The prediction before the data is cut off at its ends.
    fn forces(&self) -> Range<f64> {
        let seen = range(
            self.observed.iter().map(|[_, force_n]| *force_n).chain(self.posterior.iter().flatten().copied()),
        );
        let width = seen.end - seen.start;
        seen.start - width..seen.end + width
    }
}

fn ends(mut values: Vec<f64>) -> [f64; 2] {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1) as f64;
    ENDS.map(|end| values.get((end * last).round() as usize).copied().unwrap_or(f64::NAN))
}
