//! The thread that owns the link: hands the user's commands to the device, reports what happens, and connects again when it has gone.

use super::command::UserCommand;
use super::session::Session;
use super::state::{Event, Outcome};
use crate::link::{Client, LinkError, Tap};
use std::io;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, TryRecvError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two attempts to connect.
const RECONNECT: Duration = Duration::from_secs(1);

/// The running thread. Dropping it stops a program that runs, and ends the connection.
#[derive(Debug)]
pub struct Worker {
    commands: Option<mpsc::Sender<UserCommand>>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts with a device that has been connected. `on_event` is called for everything that happens, on the thread of the link: it
    /// must not take long.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn start(client: Client, on_event: impl FnMut(Event) + Send + 'static) -> io::Result<Self> {
        Self::spawn(client, Box::new(on_event), None)
    }

    /// The same with a tap on everything that goes over the link: a new one for every connection.
    ///
    /// # Errors
    /// As [`Self::start`].
    pub fn start_tapped(
        client: Client,
        on_event: impl FnMut(Event) + Send + 'static,
        tap: impl Fn() -> Box<dyn Tap> + Send + 'static,
    ) -> io::Result<Self> {
        Self::spawn(client, Box::new(on_event), Some(Box::new(tap)))
    }

    fn spawn(
        client: Client,
        on_event: Box<dyn FnMut(Event) + Send>,
        tap: Option<Box<dyn Fn() -> Box<dyn Tap> + Send>>,
    ) -> io::Result<Self> {
        let (sender, commands) = mpsc::channel();
        let mut link = Link { port: client.port().to_owned(), commands, on_event, tap };
        let thread = std::thread::Builder::new().name("monitor".into()).spawn(move || link.run(client))?;
        Ok(Self { commands: Some(sender), thread: Some(thread) })
    }

    /// Requests a command; its outcome is reported.
    pub fn send(&self, command: UserCommand) {
        if let Some(commands) = &self.commands {
            // If the thread has ended, the command is lost; `is_running` reports it.
            let _ = commands.send(command);
        }
    }

    /// Whether the thread runs.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// State of the thread.
struct Link {
    port: String,
    commands: Receiver<UserCommand>,
    on_event: Box<dyn FnMut(Event) + Send>,
    tap: Option<Box<dyn Fn() -> Box<dyn Tap> + Send>>,
}

impl Link {
    /// Until the user quits.
    fn run(&mut self, client: Client) {
        let mut connected = Ok(client);
        loop {
            let Err(lost) = connected.and_then(|client| self.serve(client)) else { return };
            (self.on_event)(Event::Lost(lost.to_string()));
            // A device that has restarted is there already.
            let pause = if matches!(lost, LinkError::Restarted { .. }) { Duration::ZERO } else { RECONNECT };
            if self.has_quit_within(pause) {
                return;
            }
            connected = Client::connect_within(&self.port, 1);
            // Commands given meanwhile referred to an older screen.
            if self.has_quit_within(Duration::ZERO) {
                return;
            }
        }
    }

    /// One connection, until the user quits.
    fn serve(&mut self, mut client: Client) -> Result<(), LinkError> {
        let Self { commands, on_event, tap, .. } = self;
        if let Some(tap) = tap {
            client.attach_tap(tap());
        }
        let mut session = Session::begin(client, on_event)?;
        loop {
            match waiting(commands) {
                Some(commands) => {
                    commands.into_iter().try_for_each(|command| session.handle_command(command))?
                }
                None => return session.end(),
            }
            session.poll()?;
        }
    }

    /// Waits without a connection.
    fn has_quit_within(&mut self, pause: Duration) -> bool {
        let deadline = Instant::now() + pause;
        loop {
            match self.commands.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(_) => {
                    let text = "not done: there is no connection".to_owned();
                    (self.on_event)(Event::Command(Outcome { text, good: false }));
                }
                Err(RecvTimeoutError::Timeout) => return false,
                Err(RecvTimeoutError::Disconnected) => return true,
            }
        }
    }
}

/// The commands that wait; none where the user has quit. A stop makes those before it void.
fn waiting(commands: &Receiver<UserCommand>) -> Option<Vec<UserCommand>> {
    let mut waiting = Vec::new();
    loop {
        match commands.try_recv() {
            Ok(command) => {
                if command == UserCommand::Stop {
                    waiting.clear();
                }
                waiting.push(command);
            }
            Err(TryRecvError::Empty) => return Some(waiting),
            Err(TryRecvError::Disconnected) => return None,
        }
    }
}

#[cfg(test)]
#[path = "worker_tests.rs"]
mod tests;
