//! Draws what is known of the device: title, alarms, plots, numbers, result of the last command, keys.

use super::numbers::{self, ROWS};
use super::plots::Plot;
use device::link::display;
use device::link::error::fault_text;
use device::monitor::state::{Restart, State};
use ratatui::buffer::Buffer;
use ratatui::layout::{Alignment, Rect};
use ratatui::style::{Color, Style, Stylize};
use ratatui::text::{Line, Span};
use ratatui::widgets::{Block, BorderType, Clear, Paragraph, Widget};

/// Windows of the plots, seconds.
const WINDOWS_S: [f64; 8] = [1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0];
/// The window at the start.
const FIRST_WINDOW: usize = 3;
/// Steps of a jog, millimetres.
const JOG_STEPS_MM: [f64; 6] = [0.05, 0.1, 0.2, 0.5, 1.0, 2.0];
/// The step at the start.
const FIRST_JOG_STEP: usize = 3;
/// Rows below which plots show nothing.
const MIN_PLOT_ROWS: u16 = 6;
/// Rows that the times below the lower plot take.
const TIME_ROWS: u16 = 2;

/// Most rows of words in an alarm.
const MAX_ALARM_ROWS: usize = 5;

/// Effect of every key.
const HELP: [(&str, &str); 10] = [
    ("arrow keys", "jog: left and right along x, up and down along y, 1 mm/s"),
    ("[ and ]", "shorter and longer step of a jog, 0.05 to 2 mm"),
    ("h", "home: where the needle is straight"),
    ("t", "tare: the mean force of one second becomes zero"),
    ("s or space", "stop any motion"),
    ("r", "retreat from the load of a fault; arrow keys: direction"),
    ("c", "clear the fault once its cause is gone; dismiss a restart"),
    ("+ and -", "longer and shorter time in the plots"),
    ("?", "show or hide this help"),
    ("q or Ctrl-C", "quit; a motion that runs is stopped"),
];

/// Choices of the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    window: usize,
    jog_step: usize,
    /// The help is shown.
    pub help: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self { window: FIRST_WINDOW, jog_step: FIRST_JOG_STEP, help: false }
    }
}

impl Settings {
    /// Time that the plots show, seconds.
    pub fn window_s(&self) -> f64 {
        WINDOWS_S.get(self.window).copied().unwrap_or(10.0)
    }

    /// Length of a jog, metres.
    pub fn jog_step_m(&self) -> f64 {
        1e-3 * JOG_STEPS_MM.get(self.jog_step).copied().unwrap_or(0.5)
    }

    /// RunKinds more time, or less.
    pub fn change_window(&mut self, longer: bool) {
        self.window = moved(self.window, longer, WINDOWS_S.len());
    }

    /// Makes jogs longer, or shorter.
    pub fn change_jog_step(&mut self, longer: bool) {
        self.jog_step = moved(self.jog_step, longer, JOG_STEPS_MM.len());
    }
}

fn moved(at: usize, up: bool, count: usize) -> usize {
    if up { (at + 1).min(count - 1) } else { at.saturating_sub(1) }
}

/// The whole screen.
#[derive(Debug, Clone, Copy)]
pub struct Screen<'a> {
    /// State of the device.
    pub state: &'a State,
    /// Choices of the user.
    pub settings: Settings,
    /// Now, by the clock of the state.
    pub now_s: f64,
}

/// Hands out rows from the top and from the bottom, never more than there are.
struct Rows(Rect);

impl Rows {
    fn top(&mut self, height: u16) -> Rect {
        let height = height.min(self.0.height);
        let rows = Rect { height, ..self.0 };
        self.0 = Rect { y: self.0.y + height, height: self.0.height - height, ..self.0 };
        rows
    }

    fn bottom(&mut self, height: u16) -> Rect {
        let height = height.min(self.0.height);
        self.0.height -= height;
        Rect { y: self.0.bottom(), height, ..self.0 }
    }
}

impl Widget for Screen<'_> {
    fn render(self, area: Rect, buffer: &mut Buffer) {
        let area = area.intersection(buffer.area);
        let mut rows = Rows(area);
        self.title().render(rows.top(1), buffer);
        for alarm in self.alarms() {
            alarm.draw(&mut rows, buffer);
        }
        self.keys().render(rows.bottom(1), buffer);
        self.outcome().render(rows.bottom(1), buffer);
        numbers::draw(self.state, self.now_s, rows.bottom(ROWS), buffer);
        self.plots(rows.0, buffer);
        if self.settings.help {
            help(area, buffer);
        }
    }
}

impl Screen<'_> {
    /// The screen as lines of text, for logs and documents.
    pub fn to_text(self, width: u16, height: u16) -> String {
        super::text_of(self, width, height)
    }

    fn title(&self) -> Line<'static> {
        let state = self.state;
        let mut spans = vec![" guide monitor ".bold().reversed(), format!("  {}  ", state.port).into()];
        if let Some(hello) = &state.hello {
            spans.push(
                format!("{} firmware {} ({})", hello.board, hello.firmware_version, hello.commit).into(),
            );
        }
        Line::from(spans)
    }

    /// Alarms that must not be overlooked.
    fn alarms(&self) -> Vec<Alarm> {
        let state = self.state;
        let mut alarms = Vec::new();
        if let Some(disconnection) = state.down() {
            let silent_s = state.silent_s(self.now_s).unwrap_or(self.now_s - disconnection.since_s);
            alarms.push(Alarm {
                title: format!("NO CONNECTION for {silent_s:.0} s: values are old, trying again"),
                lines: vec![disconnection.reason.clone()],
                colour: Color::Magenta,
            });
        }
        let restart = state.restart.as_ref().map(|Restart { reason, panic }| {
            let panic = panic.as_ref().map(|panic| format!("; last panic: {panic}"));
            format!("started by {}{}", display::reset_reason(*reason), panic.unwrap_or_default())
        });
        match (state.fault, restart) {
            // One panel for both: mostly the one is what the other latched.
            (Some(fault), restart) => {
                let text = fault_text(fault);
                let keys = if fault.allows_retreat() {
                    "press r to retreat from the load (arrows: direction), then press c to clear"
                } else {
                    "then press c to clear"
                };
                let mut lines = vec![text.cause.to_owned(), text.remedy.to_owned(), keys.to_owned()];
                let restarted = if restart.is_some() { ", and the device has restarted" } else { "" };
                lines.extend(restart);
                let title = format!("FAULT {}{restarted}", fault as u8);
                alarms.push(Alarm { title, lines, colour: Color::Red });
            }
            (None, Some(restart)) => alarms.push(Alarm {
                title: "THE DEVICE HAS RESTARTED: press c to dismiss".to_owned(),
                lines: vec![restart],
                colour: Color::LightYellow,
            }),
            (None, None) => {}
        }
        alarms
    }

    fn plots(&self, area: Rect, buffer: &mut Buffer) {
        if area.height < MIN_PLOT_ROWS {
            return;
        }
        let upper = (area.height - TIME_ROWS).div_ceil(2);
        let window_s = self.settings.window_s();
        let force = Plot {
            title: "force, N",
            channels: [0, 1],
            per_si: 1.0,
            least_span: 0.05,
            window_s,
            with_times: false,
        };
        let displacement = Plot {
            title: "displacement, mm",
            channels: [2, 3],
            per_si: 1e3,
            least_span: 0.05,
            window_s,
            with_times: true,
        };
        let mut rows = Rows(area);
        force.draw(self.state, self.now_s, rows.top(upper), buffer);
        displacement.draw(self.state, self.now_s, rows.0, buffer);
    }

    fn outcome(&self) -> Line<'_> {
        match &self.state.outcome {
            Some(outcome) => {
                let colour = if outcome.good { Color::Green } else { Color::LightRed };
                Line::from(format!(" {}", outcome.text)).fg(colour)
            }
            None => Line::from(""),
        }
    }

    fn keys(&self) -> Line<'static> {
        let step_mm = self.settings.jog_step_m() * 1e3;
        let keys = [
            ("t", "tare".to_owned()),
            ("arrows", format!("jog {step_mm:.2} mm")),
            ("[ ]", "step".to_owned()),
            ("h", "home".to_owned()),
            ("s", "stop".to_owned()),
            ("c", "clear".to_owned()),
            ("+ -", "time".to_owned()),
            ("?", "help".to_owned()),
            ("q", "quit".to_owned()),
        ];
        let spans = keys.into_iter().flat_map(|(key, what)| {
            [Span::from(" "), Span::from(key).bold(), Span::from(format!(" {what}")).dark_gray()]
        });
        spans.collect::<Vec<_>>().into()
    }
}

/// A panel that stays until its reason is gone.
struct Alarm {
    title: String,
    lines: Vec<String>,
    colour: Color,
}

impl Alarm {
    fn draw(self, rows: &mut Rows, buffer: &mut Buffer) {
        let width = usize::from(rows.0.width.saturating_sub(2));
        let mut lines: Vec<String> = self.lines.iter().flat_map(|line| wrapped(line, width)).collect();
        lines.truncate(MAX_ALARM_ROWS);
        let height = lines.len() as u16 + 2;
        let lines: Vec<Line> = lines.into_iter().map(Line::from).collect();
        let style = Style::new().fg(self.colour).bold();
        let block = Block::bordered()
            .border_type(BorderType::Thick)
            .border_style(style)
            .title(Line::from(format!(" {} ", self.title)).style(style).reversed())
            .title_alignment(Alignment::Center);
        Paragraph::new(lines).style(style).block(block).render(rows.top(height), buffer);
    }
}

/// A line in pieces of at most so many characters, broken between words where that is possible.
fn wrapped(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(word),
            Some(line) if line.chars().count() + 1 + word.chars().count() <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

fn help(area: Rect, buffer: &mut Buffer) {
    let width = area.width.min(76);
    let height = area.height.min(HELP.len() as u16 + 2);
    let help_area =
        Rect { x: area.x + (area.width - width) / 2, y: area.y + (area.height - height) / 2, width, height };
    let lines: Vec<Line> = HELP
        .iter()
        .map(|(key, what)| Line::from(vec![format!("{key:>12}  ").bold(), Span::from(*what)]))
        .collect();
    Clear.render(help_area, buffer);
    Paragraph::new(lines).block(Block::bordered().title(" keys ")).render(help_area, buffer);
}

#[cfg(test)]
#[path = "view_tests.rs"]
mod tests;
