//! `guide monitor`: the live screen, its keys, and its forms for machines and for logs.

use super::followed::FollowArgs;
use super::output::Output;
use super::rig_args::{PortArgs, interrupted};
use super::terminal_end::ends_with_its_terminal;
use crate::follow::{push, sentence_now};
use crate::screen::{Screen, Settings};
use anyhow::{Context, bail};
use device::link::{Client, Telemetry};
use device::monitor::report::Report;
use device::monitor::{Event as LinkEvent, State, UserCommand, Worker};
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use std::io::{self, IsTerminal};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time between two drawings of the screen.
const FRAME: Duration = Duration::from_millis(50);
/// Time between two checks for a new status.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Least time between two lines for machines, a little less than the device takes between two statuses.
const LINE: Duration = Duration::from_millis(90);
/// Device time that is streamed for one frame as text, seconds, and its size.
const ONCE_S: f64 = 2.0;
const ONCE_SIZE: (u16, u16) = (80, 24);
/// Time limit of the command.
const ONCE_LIMIT: Duration = Duration::from_secs(60);

/// Watch the device live: force, position, stiffness, faults, link; jog, home, tare, stop and clear by keys
#[derive(clap::Args)]
#[command(
    after_help = "Example:\n  guide monitor --port /dev/ttyACM0\n  guide monitor --port /dev/ttyACM0 --json --duration-s 5"
)]
pub struct Args {
    #[command(flatten)]
    port: PortArgs,
    /// Duration, seconds (default: until q or an interrupt)
    #[arg(long, value_name = "SECONDS", value_parser = duration_s)]
    duration_s: Option<f64>,
    /// Stream two seconds of the device's time, print the screen once as plain text, 80 by 24, and end
    #[arg(long, conflicts_with = "duration_s")]
    once: bool,
    #[command(flatten)]
    follow: FollowArgs,
}

fn duration_s(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| (0.001..=1e6).contains(number));
    number.ok_or_else(|| "expected a number from 0.001 to 1000000".to_owned())
}

/// The device as it is watched: what is known, and the thread that learns it.
struct Watch {
    state: Arc<Mutex<State>>,
    worker: Arc<Worker>,
    began: Instant,
    interrupted: &'static AtomicBool,
    limit_s: f64,
}

impl Watch {
    fn begin(args: &Args) -> anyhow::Result<Self> {
        let interrupted = interrupted()?;
        let mut follower = args.follow.follower()?;
        let port = &args.port.port;
        let client = Client::connect(port)?;
        let (state, began) = (Arc::new(Mutex::new(State::new(port))), Instant::now());
        let worker = Worker::start(client, {
            let state = Arc::clone(&state);
            move |event| {
                let departures = match (&event, &mut follower) {
                    (LinkEvent::Telemetry(Telemetry::Samples(batch)), Some(follower)) => {
                        push(follower, &batch.points)
                    }
                    _ => Vec::new(),
                };
                let (mut state, now_s) = (lock(&state), began.elapsed().as_secs_f64());
                state.take(event, now_s);
                for parted in departures {
                    state.take(LinkEvent::Parted(sentence_now(&parted)), now_s);
                }
            }
        })
        .context("cannot start the link's thread")?;
        let worker = Arc::new(worker);
        Ok(Self { state, worker, began, interrupted, limit_s: args.duration_s.unwrap_or(f64::INFINITY) })
    }

    fn now_s(&self) -> f64 {
        self.began.elapsed().as_secs_f64()
    }

    fn state(&self) -> MutexGuard<'_, State> {
        lock(&self.state)
    }

    /// Whether to go on.
    fn goes_on(&self) -> anyhow::Result<bool> {
        if !self.worker.is_running() {
            bail!("the link's thread has ended");
        }
        Ok(!self.interrupted.load(Ordering::Acquire) && self.now_s() < self.limit_s)
    }
}

/// A thread that has panicked while it held the state leaves one that can be shown.
fn lock(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Runs `guide monitor`.
pub fn run(args: &Args, out: &mut Output) -> anyhow::Result<()> {
    if args.once {
        return once(&Watch::begin(args)?, out);
    }
    if out.is_json() {
        return lines(&Watch::begin(args)?, out);
    }
    if !io::stdout().is_terminal() {
        bail!("needs a terminal; for machines use `guide status --json` or `guide record`");
    }
    let watch = Watch::begin(args)?;
    let worker = Arc::downgrade(&watch.worker);
    ends_with_its_terminal(watch.interrupted, move || {
        worker.upgrade().into_iter().for_each(|worker| worker.send(UserCommand::Stop))
    })
    .context("cannot watch the terminal")?;
    // Has a panic restore the terminal too, before it prints its message.
    let mut terminal = ratatui::try_init().context("cannot use the terminal")?;
    let outcome = screen(&watch, &mut terminal);
    ratatui::restore();
    outcome
}

/// One line per status.
fn lines(watch: &Watch, out: &mut Output) -> anyhow::Result<()> {
    let (mut shown, mut line_at) = (0, None::<Instant>);
    while watch.goes_on()? {
        std::thread::sleep(POLL_INTERVAL);
        if line_at.is_some_and(|at| at.elapsed() < LINE) || watch.state().news() == shown {
            continue;
        }
        line_at = Some(Instant::now());
        let report = {
            let state = watch.state();
            shown = state.news();
            Report::new(&state, watch.now_s())
        };
        out.line(&report, "")?;
    }
    Ok(())
}

/// One frame as text.
fn once(watch: &Watch, out: &mut Output) -> anyhow::Result<()> {
    while watch.goes_on()? {
        {
            let state = watch.state();
            if let Some(disconnection) = state.down() {
                bail!("{}", disconnection.reason);
            }
            if state.streamed_s() >= ONCE_S {
                let (now_s, (width, height)) = (watch.now_s(), ONCE_SIZE);
                let screen = Screen { state: &state, settings: Settings::default(), now_s };
                return out.line(&Report::new(&state, now_s), screen.to_text(width, height));
            }
        }
        if watch.began.elapsed() > ONCE_LIMIT {
            bail!("the device has not streamed {ONCE_S} s of its time in {ONCE_LIMIT:?}");
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    bail!("interrupted")
}

/// The live screen, until the user quits.
fn screen(watch: &Watch, terminal: &mut DefaultTerminal) -> anyhow::Result<()> {
    let mut settings = Settings::default();
    while watch.goes_on()? {
        let drawn = Instant::now();
        let drawing = terminal.draw(|frame| {
            let state = watch.state();
            let screen = Screen { state: &state, settings, now_s: watch.now_s() };
            frame.render_widget(screen, frame.area());
        });
        drawing.context("cannot draw on the terminal")?;
        // All keys that wait, and at least until the next frame is due.
        while event::poll(FRAME.saturating_sub(drawn.elapsed())).context("cannot read the terminal")? {
            if let Event::Key(key) = event::read().context("cannot read the terminal")?
                && key.kind != KeyEventKind::Release
                && press(key, watch, &mut settings)
            {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// Does what a key means; true where that is to quit.
fn press(key: KeyEvent, watch: &Watch, settings: &mut Settings) -> bool {
    let send = |command| watch.worker.send(command);
    let step_m = settings.jog_step_m();
    match key.code {
        KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return true,
        KeyCode::Char('q') => return true,
        KeyCode::Char('t') => send(UserCommand::Tare),
        KeyCode::Char('h') => send(UserCommand::Home),
        KeyCode::Char('s' | ' ') => send(UserCommand::Stop),
        KeyCode::Char('r') => send(UserCommand::Retreat),
        KeyCode::Char('c') => {
            watch.state().dismiss();
            send(UserCommand::Clear);
        }
        KeyCode::Right => send(UserCommand::Jog([step_m, 0.0])),
        KeyCode::Left => send(UserCommand::Jog([-step_m, 0.0])),
        KeyCode::Up => send(UserCommand::Jog([0.0, step_m])),
        KeyCode::Down => send(UserCommand::Jog([0.0, -step_m])),
        KeyCode::Char(']') => settings.change_jog_step(true),
        KeyCode::Char('[') => settings.change_jog_step(false),
        KeyCode::Char('+' | '=') => settings.change_window(true),
        KeyCode::Char('-') => settings.change_window(false),
        KeyCode::Char('?') => settings.help = !settings.help,
        _ => {}
    }
    false
}
