//! The scrolling plots: two channels against time each, extremes joined column by column, gaps left open.

use device::monitor::state::State;
use device::monitor::traces::Column;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Widget};

/// Colours of x and y.
pub const COLOURS: [Color; 2] = [Color::Cyan, Color::Yellow];
/// Colour of old values.
pub const OLD: Color = Color::DarkGray;
/// Width of the labels left of the axis.
const LABEL_WIDTH: u16 = 8;
/// Room right of the plot for the names of the traces.
const NAME_WIDTH: u16 = 2;
/// Dots of a braille cell side by side.
const DOTS: u16 = 2;

/// One plot.
pub struct Plot<'a> {
    /// Quantity, with its unit.
    pub title: &'a str,
    /// The channels of x and y.
    pub channels: [usize; 2],
    /// Value of one SI unit in that of the plot.
    pub per_si: f64,
    /// Least height of the plot in its unit, so that noise does not fill it.
    pub least_span: f64,
    /// Time that it shows, seconds.
    pub window_s: f64,
    /// Whether the times are written below.
    pub with_times: bool,
}

impl Plot<'_> {
    /// Draws it.
    pub fn draw(&self, state: &State, now_s: f64, area: Rect, buffer: &mut Buffer) {
        let area = area.intersection(buffer.area);
        let chart_area = Rect { width: area.width.saturating_sub(NAME_WIDTH), ..area };
        let columns = usize::from(chart_area.width.saturating_sub(LABEL_WIDTH + 1).max(1) * DOTS);
        // Columns stay where they are while time goes on: their ends are whole numbers of columns.
        let column_s = self.window_s / columns as f64;
        let end_s = (state.edge_s(now_s) / column_s).ceil() * column_s;
        let runs =
            self.channels.map(|channel| state.traces.runs(channel, end_s - self.window_s, end_s, columns));
        let bounds = self.bounds(&runs);
        let old = state.is_old(now_s);
        let colours = if old { [OLD; 2] } else { COLOURS };

        let lines: Vec<(Color, Vec<(f64, f64)>)> = runs
            .iter()
            .zip(colours)
            .flat_map(|(runs, colour)| runs.iter().map(move |run| (colour, self.line(run))))
            .collect();
        let datasets = lines.iter().map(|(colour, line)| {
            Dataset::default()
                .marker(Marker::Braille)
                .graph_type(GraphType::Line)
                .style(Style::new().fg(*colour))
                .data(line)
        });
        let mut x_axis = Axis::default().bounds([0.0, columns.saturating_sub(1).max(1) as f64]).dark_gray();
        if self.with_times {
            let times = [self.window_s, 0.5 * self.window_s].map(|ago_s| format!("-{ago_s} s"));
            let [first, middle] = times;
            x_axis = x_axis.labels([first, middle, "now".to_owned()]);
        }
        let y_axis = Axis::default()
            .bounds(bounds)
            .dark_gray()
            .labels(labels(bounds, self.height(area.height.saturating_sub(1))));
        let chart = Chart::new(datasets.collect()).x_axis(x_axis).y_axis(y_axis);
        let block = Block::new()
            .borders(Borders::TOP)
            .border_style(Style::new().dark_gray())
            .title(self.heading(colours));
        let inner = block.inner(chart_area);
        chart.block(block).render(chart_area, buffer);
        self.name_lines(&runs, columns, bounds, colours, inner, buffer);
    }

    fn heading(&self, [x, y]: [Color; 2]) -> Line<'_> {
        Line::from(vec![
            Span::from(format!("{}: ", self.title)).bold(),
            Span::from("x").fg(x),
            Span::from(" and "),
            Span::from("y").fg(y),
            Span::from(format!(", last {} s ", self.window_s)),
        ])
    }

    fn line(&self, run: &[Column]) -> Vec<(f64, f64)> {
        run.iter()
            .flat_map(|column| [self.point(column, column.low), self.point(column, column.high)])
            .collect()
    }

    fn point(&self, column: &Column, value: f64) -> (f64, f64) {
        (column.place as f64, value * self.per_si)
    }

    /// Rows of the lines themselves among those below the heading.
    fn height(&self, below_heading: u16) -> u16 {
        below_heading.saturating_sub(if self.with_times { 2 } else { 0 })
    }

    /// Writes x and y where the lines end.
    fn name_lines(
        &self,
        runs: &[Vec<Vec<Column>>; 2],
        columns: usize,
        [low, high]: [f64; 2],
        colours: [Color; 2],
        area: Rect,
        buffer: &mut Buffer,
    ) {
        let height = self.height(area.height);
        if height == 0 {
            return;
        }
        let rows = [0, 1].map(|axis: usize| {
            let last = runs.get(axis)?.last()?.last()?;
            // A line that has ended earlier is not named at the edge.
            let is_near_edge = last.place + columns / 20 + 2 >= columns;
            let value = 0.5 * (last.low + last.high) * self.per_si;
            let height_fraction = ((high - value) / (high - low)).clamp(0.0, 1.0);
            is_near_edge.then_some((height_fraction * f64::from(height - 1)).round() as u16)
        });
        let is_single_row = rows.first() == rows.get(1);
        for ((row, name), (colour, shift)) in rows.iter().zip(["x", "y"]).zip(colours.into_iter().zip([0, 1]))
        {
            let Some(row) = row else { continue };
            // Side by side where they meet.
            let x = area.right() + if is_single_row { shift } else { 0 };
            if let Some(cell) = buffer.cell_mut((x, area.top() + row)) {
                cell.set_symbol(name).set_fg(colour);
            }
        }
    }

    /// Round numbers around all that is shown.
    fn bounds(&self, runs: &[Vec<Vec<Column>>; 2]) -> [f64; 2] {
        let columns = runs.iter().flatten().flatten();
        let (low, high) = columns.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), column| {
            (low.min(column.low * self.per_si), high.max(column.high * self.per_si))
        });
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let lacking = (self.least_span - (high - low)).max(0.0);
        let (low, high) = (low - 0.5 * lacking, high + 0.5 * lacking);
        let step = round_step((high - low) / 4.0);
        [(low / step).floor() * step, (high / step).ceil() * step]
    }
}

/// The next greater of 1, 2, 5, 10, 20 ...
fn round_step(least: f64) -> f64 {
    let power = 10f64.powf(least.log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|step| *step >= least)
        .unwrap_or(least)
}

/// Both ends, and the middle where a row lies there.
fn labels([low, high]: [f64; 2], rows: u16) -> Vec<Line<'static>> {
    let digits = (2.0 - (high - low).log10().floor()).clamp(0.0, 6.0) as usize;
    let width = usize::from(LABEL_WIDTH);
    let middle = (rows % 2 == 1).then_some(0.5 * (low + high));
    let values = [Some(low), middle, Some(high)].into_iter().flatten();
    values.map(|value| Line::from(format!("{value:>width$.digits$}"))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_round_and_enough() {
        for (least, step) in [(0.9, 1.0), (1.0, 1.0), (1.1, 2.0), (3.0, 5.0), (7.0, 10.0), (0.012, 0.02)] {
            assert!((round_step(least) / step - 1.0).abs() < 1e-9, "{least}");
        }
    }

    #[test]
    fn bounds_hold_what_is_shown_and_are_not_narrower_than_wanted() {
        let plot = Plot {
            title: "force, N",
            channels: [0, 1],
            per_si: 1.0,
            least_span: 0.1,
            window_s: 10.0,
            with_times: true,
        };
        let [low, high] = plot.bounds(&[run_of_columns(-0.3, 1.7), run_of_columns(0.0, 0.0)]);
        assert_eq!((low, high), (-0.5, 2.0));
        let [low, high] = plot.bounds(&[run_of_columns(0.5, 0.5), Vec::new()]);
        assert!(low <= 0.45 && high >= 0.55 && high - low < 0.2, "{low} {high}");
        let [low, high] = plot.bounds(&[Vec::new(), Vec::new()]);
        assert!(low < 0.0 && high > 0.0);
    }

    fn run_of_columns(low: f64, high: f64) -> Vec<Vec<Column>> {
        vec![vec![Column { place: 0, low, high }]]
    }
}
