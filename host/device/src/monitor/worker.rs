//! The thread that owns the link: hands the user's orders to the device, reports what happens, and connects again when it has gone.

use super::session::Session;
use super::state::{Event, Outcome};
use crate::link::{Client, LinkError};
use std::io;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, TryRecvError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two attempts to connect.
const RECONNECT: Duration = Duration::from_secs(1);

/// What the user can have done.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// Make the present force zero.
    Tare,
    /// Move guide 2 along x and y from where it was last sent, metres.
    Jog([f64; 2]),
    /// Bring guide 2 to where the needle is straight.
    Home,
    /// End any motion at once.
    Stop,
    /// Leave the fault state.
    Clear,
    /// Move out of the load that has caused the fault, against the larger force.
    Retreat,
}

/// The running thread. Dropping it stops a program that runs, and ends the connection.
#[derive(Debug)]
pub struct Worker {
    orders: Option<mpsc::Sender<Order>>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts with a device that has been connected. `on_event` is called for everything that happens, on the thread of the link: it
    /// must not take long.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn start(client: Client, on_event: impl FnMut(Event) + Send + 'static) -> io::Result<Self> {
        let (sender, orders) = mpsc::channel();
        let mut link = Link { port: client.port().to_owned(), orders, on_event: Box::new(on_event) };
        let thread = std::thread::Builder::new().name("monitor".into()).spawn(move || link.run(client))?;
        Ok(Self { orders: Some(sender), thread: Some(thread) })
    }

    /// Has something done; its outcome is reported.
    pub fn order(&self, order: Order) {
        if let Some(orders) = &self.orders {
            // Where the thread has ended the order is lost; `is_running` reports it.
            let _ = orders.send(order);
        }
    }

    /// Whether the thread is there.
    pub fn is_running(&self) -> bool {
        self.thread.as_ref().is_some_and(|thread| !thread.is_finished())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// What the thread holds.
struct Link {
    port: String,
    orders: Receiver<Order>,
    on_event: Box<dyn FnMut(Event) + Send>,
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
            // What was ordered meanwhile was meant for what was on the screen then.
            if self.has_quit_within(Duration::ZERO) {
                return;
            }
        }
    }

    /// One connection, until the user quits.
    fn serve(&mut self, client: Client) -> Result<(), LinkError> {
        let Self { orders, on_event, .. } = self;
        let mut session = Session::begin(client, on_event)?;
        loop {
            match waiting(orders) {
                Some(orders) => orders.into_iter().try_for_each(|order| session.handle_command(order))?,
                None => return session.end(),
            }
            session.poll()?;
        }
    }

    /// Waits without a connection.
    fn has_quit_within(&mut self, pause: Duration) -> bool {
        let deadline = Instant::now() + pause;
        loop {
            match self.orders.recv_timeout(deadline.saturating_duration_since(Instant::now())) {
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

/// The orders that wait; none where the user has quit. A stop makes those before it void.
fn waiting(orders: &Receiver<Order>) -> Option<Vec<Order>> {
    let mut waiting = Vec::new();
    loop {
        match orders.try_recv() {
            Ok(order) => {
                if order == Order::Stop {
                    waiting.clear();
                }
                waiting.push(order);
            }
            Err(TryRecvError::Empty) => return Some(waiting),
            Err(TryRecvError::Disconnected) => return None,
        }
    }
}

#[cfg(test)]
#[path = "worker_tests.rs"]
mod tests;
