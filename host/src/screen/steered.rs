//! The screen of `guide steer`: target, path so far, planned path with its band, what can be reached, next action.

use super::text_of;
use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Paragraph, Widget, Wrap};
use steering::{Decision, Event, PathPoint, Probability};

/// Half of a 95 % band, standard deviations.
const HALF_BAND_SD: f64 = 1.96;
/// A guide move below this is not shown as one, mm.
const SMALLEST_SHOWN_MM: f64 = 5e-3;
/// Rows of the numbers, with the next action.
const NUMBER_ROWS: u16 = 6;
/// Rows of what no longer follows the model, where there is such a thing.
const WARNING_ROWS: u16 = 2;
/// Below these sizes a plot shows nothing.
const MIN_ROWS: u16 = 5;
const MIN_COLUMNS: u16 = 20;
/// Columns from which on the plane of the target has room beside the paths.
const WIDE: u16 = 60;
/// Colours of x and y, of the target, of what can be reached.
const COLOURS: [Color; 2] = [Color::Cyan, Color::Yellow];
const TARGET: Color = Color::Red;
const REACH: Color = Color::DarkGray;

/// View of a run on the screen: what has happened in it.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SteerView {
    target_mm: [f64; 3],
    /// Deepest tip readings: depth, x, y, mm.
    readings_mm: Vec<[f64; 3]>,
    last_seq: Option<i64>,
    depth_mm: f64,
    guide_mm: [f64; 2],
    force_n: Option<f64>,
    force_limit_n: Option<f64>,
    reachable_mm: Vec<[f64; 2]>,
    within: Vec<Probability>,
    decision: Option<Decision>,
    expected_mm: Vec<[f64; 2]>,
    /// Next action, or the outcome of the run.
    next: String,
    /// What last no longer followed the model.
    parted: Option<String>,
}

impl SteerView {
    /// Before a run to this target: x, y, depth, mm.
    pub fn new(target_mm: [f64; 3]) -> Self {
        Self { target_mm, next: "waiting for the plant's statement".to_owned(), ..Self::default() }
    }

    /// Takes in what happens.
    pub fn take(&mut self, event: &Event) {
        match event {
            Event::Statement(stated) => {
                self.force_limit_n = stated.limits.guide_force_n;
                self.next = "computing what can be reached".to_owned();
            }
            Event::Forecast { reachable_mm, within, .. } => {
                (self.reachable_mm, self.within) = (reachable_mm.clone(), within.clone());
                self.next = "push to the first stop".to_owned();
            }
            Event::Answer(answer) => {
                (self.depth_mm, self.guide_mm) = (answer.depth_mm, [answer.guide_x_mm, answer.guide_y_mm]);
                self.force_n = answer.force_x_n.zip(answer.force_y_n).map(|(x, y)| x.hypot(y));
                if answer.valid && self.last_seq != Some(answer.tip_seq) {
                    self.last_seq = Some(answer.tip_seq);
                    self.readings_mm.push([answer.depth_mm, answer.tip_x_mm, answer.tip_y_mm]);
                }
            }
            Event::Decision(decision) => {
                self.expected_mm.push(decision.expected_tip_mm);
                self.within = decision.within.clone();
                self.next = next(decision, self.target_mm[2]);
                self.decision = Some((*decision).clone());
            }
            Event::Command(_) | Event::Compared(_) | Event::End(_) | Event::Fault { .. } => {}
        }
    }

    /// Readings no longer follow the model, in words.
    pub fn parted(&mut self, sentence: String) {
        self.parted = Some(sentence);
    }

    /// The run has ended so.
    pub fn end(&mut self, how: String) {
        self.next = how;
    }

    fn path(&self) -> &[PathPoint] {
        self.decision.as_ref().map_or(&[], |decision| &decision.path)
    }
}

/// Next action by a decision, on one line of the smallest usual terminal.
fn next(decision: &Decision, target_depth_mm: f64) -> String {
    let cue = decision.cue(target_depth_mm);
    let [x, y] = decision.guide_to_mm;
    let [from_x, from_y] = decision.guide_from_mm;
    let first = match cue.turn_by_deg {
        Some(by_deg) => {
            format!("turn by {by_deg:+.0} degrees (bevel at {:.0} degrees), then ", cue.bevel_deg)
        }
        None if (x - from_x).hypot(y - from_y) > SMALLEST_SHOWN_MM => {
            format!("move guide 2 to {x:+.2}, {y:+.2} mm, then ")
        }
        None => String::new(),
    };
    format!("{first}push to {:.1} mm", cue.push_to_mm)
}

/// The whole screen.
#[derive(Debug, Clone, Copy)]
pub struct SteerScreen<'a>(pub &'a SteerView);

impl SteerScreen<'_> {
    /// The screen as lines of text, for logs and documents.
    pub fn to_text(self, width: u16, height: u16) -> String {
        text_of(self, width, height)
    }
}

impl Widget for SteerScreen<'_> {
    fn render(self, area: Rect, buffer: &mut Buffer) {
        let area = area.intersection(buffer.area);
        let warning_rows = if self.0.parted.is_some() { WARNING_ROWS } else { 0 };
        let [title, warning, plots, numbers] = Layout::vertical([
            Constraint::Length(1),
            Constraint::Length(warning_rows),
            Constraint::Min(0),
            Constraint::Length(NUMBER_ROWS),
        ])
        .areas(area);
        if let Some(parted) = &self.0.parted {
            let text = Paragraph::new(format!(" {parted}")).style(Style::new().fg(TARGET).bold());
            text.wrap(Wrap { trim: true }).render(warning, buffer);
        }
        let [x, y, depth] = self.0.target_mm;
        let name = format!("  target {x:+.2}, {y:+.2} mm at {depth:.1} mm");
        Line::from(vec![" guide steer ".bold().reversed(), name.into()]).render(title, buffer);
        self.numbers(numbers, buffer);
        let (paths, plane) = if plots.width >= WIDE {
            let [paths, plane] =
                Layout::horizontal([Constraint::Percentage(60), Constraint::Percentage(40)]).areas(plots);
            (paths, Some(plane))
        } else {
            (plots, None)
        };
        let [upper, lower] =
            Layout::vertical([Constraint::Percentage(50), Constraint::Percentage(50)]).areas(paths);
        self.path(0, upper, buffer);
        self.path(1, lower, buffer);
        if let Some(plane) = plane {
            self.plane(plane, buffer);
        }
    }
}

/// A range that holds all values, with room on both sides.
fn bounds(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = values.filter(|value| value.is_finite());
    let [low, high] =
        finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)]);
    if low > high {
        return [-1.0, 1.0];
    }
    let room = (0.08 * (high - low)).max(0.2);
    [low - room, high + room]
}

fn labels([low, high]: [f64; 2]) -> [String; 2] {
    [low, high].map(|value| format!("{value:+.1}"))
}

fn line(data: &[(f64, f64)], style: Style) -> Dataset<'_> {
    Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).style(style).data(data)
}

fn dots(data: &[(f64, f64)], marker: Marker, style: Style) -> Dataset<'_> {
    Dataset::default().marker(marker).graph_type(GraphType::Scatter).style(style).data(data)
}

fn draw(title: Line<'_>, datasets: Vec<Dataset<'_>>, [x, y]: [[f64; 2]; 2], area: Rect, buffer: &mut Buffer) {
    if area.height < MIN_ROWS || area.width < MIN_COLUMNS {
        return;
    }
    let block = Block::new().borders(Borders::TOP).border_style(Style::new().dark_gray()).title(title);
    Chart::new(datasets)
        .x_axis(axis(x))
        .y_axis(axis(y))
        .legend_position(None)
        .block(block)
        .render(area, buffer);
}

fn axis(bounds: [f64; 2]) -> Axis<'static> {
    Axis::default().bounds(bounds).labels(labels(bounds)).dark_gray()
}

impl SteerScreen<'_> {
    /// The tip along one axis over depth.
    fn path(&self, plane: usize, area: Rect, buffer: &mut Buffer) {
        let view = self.0;
        let colour = COLOURS[plane];
        let read: Vec<(f64, f64)> = view.readings_mm.iter().map(|one| (one[0], one[1 + plane])).collect();
        let (planned, low, high) =
            (edge(0.0, plane, view), edge(-HALF_BAND_SD, plane, view), edge(HALF_BAND_SD, plane, view));
        let target = [(view.target_mm[2], view.target_mm[plane])];
        let shown_mm = [&read, &low, &high].into_iter().flatten().chain(&target).map(|(_, mm)| *mm);
        let limits = [[0.0, (1.02 * view.target_mm[2]).max(1.0)], bounds(shown_mm)];
        let grey = Style::new().fg(REACH);
        let datasets = vec![
            line(&low, grey),
            line(&high, grey),
            line(&planned, Style::new().fg(colour)),
            dots(&read, Marker::Braille, Style::new().fg(colour).bold()),
            dots(&target, Marker::Dot, Style::new().fg(TARGET)),
        ];
        let name = ["x", "y"][plane];
        let title = Line::from(vec![
            Span::from(format!("tip {name}, mm")).fg(colour).bold(),
            Span::from(" over depth, mm: read, planned, 95 % "),
        ]);
        draw(title, datasets, limits, area, buffer);
    }

    /// The plane of the target.
    fn plane(&self, area: Rect, buffer: &mut Buffer) {
        let view = self.0;
        let mut reach: Vec<(f64, f64)> = view.reachable_mm.iter().map(point).collect();
        reach.extend(reach.first().copied());
        let expected: Vec<(f64, f64)> = view.expected_mm.iter().map(point).collect();
        let now: Vec<(f64, f64)> = expected.last().copied().into_iter().collect();
        let target = [(view.target_mm[0], view.target_mm[1])];
        let all = || reach.iter().chain(&expected).chain(&target);
        let limits = [bounds(all().map(|(x, _)| *x)), bounds(all().map(|(_, y)| *y))];
        let datasets = vec![
            line(&reach, Style::new().fg(REACH)),
            line(&expected, Style::new().fg(Color::Blue)),
            dots(&now, Marker::Block, Style::new().fg(Color::Blue)),
            dots(&target, Marker::Dot, Style::new().fg(TARGET)),
        ];
        draw(Line::from("at the target: reach, expected ".bold()), datasets, limits, area, buffer);
    }

    fn numbers(&self, area: Rect, buffer: &mut Buffer) {
        let view = self.0;
        let [x, y] = view.guide_mm;
        let force = view.force_n.map_or_else(String::new, |n| {
            let limit = view.force_limit_n.map_or_else(String::new, |limit| format!(" of {limit:.1}"));
            format!("   force {n:.2}{limit} N")
        });
        let probabilities: Vec<String> = view
            .within
            .iter()
            .take(3)
            .map(|one| format!("{:.0} % within {} mm", 100.0 * one.probability, one.radius_mm))
            .collect();
        let probability_text =
            if probabilities.is_empty() { "not stated".to_owned() } else { probabilities.join(", ") };
        let expected = view.decision.as_ref().map_or_else(
            || "expected     not planned yet".to_owned(),
            |decision| {
                let [x, y] = decision.expected_tip_mm;
                let [xx, _, yy] = decision.covariance_mm2;
                let sd = (0.5 * (xx + yy)).max(0.0).sqrt();
                format!(
                    "expected     {x:+.2}, {y:+.2} mm, sd {sd:.2} mm; {:.2} mm from the target unsteered",
                    decision.unsteered_miss_mm
                )
            },
        );
        let limited_by = view.decision.as_ref().and_then(|decision| decision.limited_by);
        let limited = limited_by.map_or_else(String::new, |by| format!("; the move is limited by {by}"));
        let lines = vec![
            Line::from(format!("depth        {:.1} mm   guide 2 {x:+.2}, {y:+.2} mm{force}", view.depth_mm)),
            Line::from(format!("probability  {probability_text}")),
            Line::from(expected),
            Line::from(format!("readings     {} of the tip{limited}", view.readings_mm.len())),
            Line::from(vec!["next         ".bold(), Span::from(view.next.clone()).bold()]),
        ];
        let block = Block::new().borders(Borders::TOP).border_style(Style::new().dark_gray());
        Paragraph::new(lines).block(block).render(area, buffer);
    }
}

fn point([x, y]: &[f64; 2]) -> (f64, f64) {
    (*x, *y)
}

fn edge(sds: f64, plane: usize, view: &SteerView) -> Vec<(f64, f64)> {
    view.path().iter().map(|one| (one.depth_mm, one.tip_mm[plane] + sds * one.sd_mm)).collect()
}

#[cfg(test)]
#[path = "steered_tests.rs"]
mod tests;
