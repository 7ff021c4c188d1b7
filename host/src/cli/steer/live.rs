//! The live screen of a run: on a terminal while it goes on, otherwise its last state as text.

use crate::cli::output::Output;
use crate::follow::{Parted, sentence_of_plant};
use crate::screen::{SteerScreen, SteerView};
use anyhow::{Context, ensure};
use ratatui::Terminal;
use ratatui::backend::CrosstermBackend;
use ratatui::crossterm::cursor::Show;
use ratatui::crossterm::execute;
use ratatui::crossterm::terminal::{EnterAlternateScreen, LeaveAlternateScreen};
use std::io::{self, IsTerminal, Stdout};
use std::time::{Duration, Instant};
use steering::{Event, Outcome, Run, SteerError};

/// Time between two drawings of the screen.
const FRAME: Duration = Duration::from_millis(50);
/// Size of the screen as text.
const TEXT_SIZE: (u16, u16) = (80, 24);

/// Live view of a run.
pub struct Live {
    view: SteerView,
    shown: bool,
    /// Terminal, if the output is one.
    terminal: Option<Alternate>,
    drawn: Option<Instant>,
}

/// The terminal's second screen, left again in every case. Keys are not read, so that Ctrl-C stays the signal that ends the run.
struct Alternate(Terminal<CrosstermBackend<Stdout>>);

impl Alternate {
    fn enter() -> io::Result<Self> {
        execute!(io::stdout(), EnterAlternateScreen)?;
        Ok(Self(Terminal::new(CrosstermBackend::new(io::stdout()))?))
    }
}

impl Drop for Alternate {
    fn drop(&mut self) {
        // An error of a closed terminal has no remedy.
        let _ = execute!(io::stdout(), LeaveAlternateScreen, Show);
    }
}

impl Live {
    /// For a run to a target, mm, where `shown`.
    ///
    /// # Errors
    /// Where documents are requested, or the terminal cannot be used.
    pub fn new(shown: bool, target_mm: [f64; 3], out: &Output) -> anyhow::Result<Self> {
        ensure!(!(shown && out.is_json()), "--screen: drawn for the eye, expected without --json");
        Ok(Self { view: SteerView::new(target_mm), shown, terminal: None, drawn: None })
    }

    /// Takes the terminal, where the output is one.
    ///
    /// # Errors
    /// Where it cannot be used.
    pub fn begin(&mut self) -> anyhow::Result<()> {
        if self.shown && io::stdout().is_terminal() {
            self.terminal = Some(Alternate::enter().context("cannot use the terminal")?);
        }
        Ok(())
    }

    /// Whether the screen stands for lines of text.
    pub fn is_shown(&self) -> bool {
        self.shown
    }

    /// Takes in what happens, and draws where the next frame is due.
    pub fn take(&mut self, event: &Event) {
        if !self.shown {
            return;
        }
        self.view.take(event);
        let is_due = self.drawn.is_none_or(|at| at.elapsed() >= FRAME) || matches!(event, Event::Decision(_));
        if let (Some(Alternate(terminal)), true) = (&mut self.terminal, is_due) {
            let view = &self.view;
            // A frame that cannot be drawn is missing; the run goes on.
            let _ = terminal.draw(|frame| frame.render_widget(SteerScreen(view), frame.area()));
            self.drawn = Some(Instant::now());
        }
    }

    /// Readings no longer follow the model: the next frame has it.
    pub fn parted(&mut self, parted: &Parted) {
        self.view.parted(sentence_of_plant(parted));
    }

    /// Leaves the terminal; without one the last screen is printed.
    ///
    /// # Errors
    /// Where the output cannot be written.
    pub fn end(mut self, outcome: &Result<Run, SteerError>, out: &mut Output) -> anyhow::Result<()> {
        if !self.shown {
            return Ok(());
        }
        let is_live = self.terminal.take().is_some();
        if is_live {
            return Ok(());
        }
        self.view.end(match outcome {
            Err(error) => format!("ended by {}", error.name()),
            Ok(run) => match (&run.outcome, run.miss_mm) {
                (Outcome::Arrived, Some(miss_mm)) => format!("arrived, {miss_mm:.2} mm from the target"),
                (Outcome::Arrived, None) => "arrived".to_owned(),
                (Outcome::Stopped { name, .. }, _) => format!("stopped ({name})"),
                (Outcome::Refused { distance_mm, .. }, _) => {
                    format!("refused: the target is {distance_mm:.1} mm out of reach")
                }
            },
        });
        let (width, height) = TEXT_SIZE;
        out.line(&(), SteerScreen(&self.view).to_text(width, height))
    }
}
