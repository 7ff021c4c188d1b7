//! The device live: what pages receive of it, and the supervision of the one that moves it.
//!
//! Every request of a page goes through [`Live::supervise`], which the program calls all the time from the thread that
//! owns the link: it hands over the motions of the page in control only, and stops the device when that page's
//! heartbeat is missing. If the program itself ends or hangs, the device stops because its host is silent, or with the
//! end of the [`Worker`].

use crate::control::{Control, HEARTBEAT_LIMIT, PageId};
use crate::frames::{Frames, FramesTap};
use crate::request::Request;
use crate::update::{ControlHolder, Outcome, RunningProgram, Update};
use device::link::{Batch, Client, Program, Telemetry};
use device::monitor::report::Report;
use device::monitor::{Event, State, UserCommand, Worker};
use std::io;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::sync::mpsc::{self, Receiver, SyncSender};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Pages that watch at a time; more are rejected.
pub const MAX_PAGES: usize = 8;
/// Requests that wait at most; a page that sends faster is disconnected.
const MAX_WAITING: usize = 256;

/// Message of a page's connection.
#[derive(Debug)]
enum FromPage {
    Requested(Request),
    /// A heartbeat for an update that was sent then.
    Heartbeat(Instant),
    Gone,
}

/// State that the connections share.
#[derive(Debug)]
pub struct SharedState {
    state: Mutex<State>,
    frames: Arc<Mutex<Frames>>,
    began: Instant,
    shown: Mutex<Shown>,
    programs: Vec<Arc<Program>>,
    requests: SyncSender<(PageId, FromPage)>,
    pages: AtomicUsize,
    next_page: AtomicU64,
}

/// State that supervision shows to the pages.
#[derive(Debug, Default)]
struct Shown {
    holder: Option<PageId>,
    notice: Option<String>,
    program: Option<RunningProgram>,
}

/// A device under supervision. Dropping it stops what runs.
#[derive(Debug)]
pub struct Live {
    feed: Arc<SharedState>,
    worker: Worker,
    requests: Receiver<(PageId, FromPage)>,
    control: Control,
}

impl Live {
    /// Follows a device that has been connected; pages can have these programs run. `compare` receives every batch of samples, and returns in
    /// words what it no longer finds in agreement with a model.
    ///
    /// # Errors
    /// Where the system gives no thread.
    pub fn start(
        client: Client,
        programs: Vec<Program>,
        mut compare: impl FnMut(&Batch) -> Vec<String> + Send + 'static,
    ) -> io::Result<Self> {
        let (sender, requests) = mpsc::sync_channel(MAX_WAITING);
        let feed = Arc::new(SharedState {
            state: Mutex::new(State::new(client.port())),
            frames: Arc::default(),
            began: Instant::now(),
            shown: Mutex::default(),
            programs: programs.into_iter().map(Arc::new).collect(),
            requests: sender,
            pages: AtomicUsize::new(0),
            next_page: AtomicU64::new(1),
        });
        let on_event = {
            let feed = Arc::clone(&feed);
            move |event| {
                let departures = match &event {
                    Event::Telemetry(Telemetry::Samples(batch)) => compare(batch),
                    _ => Vec::new(),
                };
                let (mut state, now_s) = (lock(&feed.state), feed.began.elapsed().as_secs_f64());
                state.take(event, now_s);
                departures.into_iter().for_each(|words| state.take(Event::Parted(words), now_s));
            }
        };
        let frames = Arc::clone(&feed.frames);
        let worker =
            Worker::start_tapped(client, on_event, move || Box::new(FramesTap(Arc::clone(&frames))))?;
        Ok(Self { feed, worker, requests, control: Control::default() })
    }

    /// For the connections.
    pub fn feed(&self) -> Arc<SharedState> {
        Arc::clone(&self.feed)
    }

    /// Whether the thread of the link is there.
    pub fn is_running(&self) -> bool {
        self.worker.is_running()
    }

    /// Handles what the pages request for so long, and stops the device when the page in control is not there. To be called all the time.
    pub fn supervise(&mut self, time: Duration) {
        let deadline = Instant::now() + time;
        loop {
            let received = self.requests.recv_timeout(deadline.saturating_duration_since(Instant::now()));
            // Before the request: a page that was away is not in control any more.
            if self.control.expire(Instant::now(), self.limit()) {
                let limit_ms = self.limit().min(HEARTBEAT_LIMIT).as_millis();
                self.stop(format!("stopped: no heartbeat of the page in control for {limit_ms} ms"));
            }
            match received {
                Ok((page, FromPage::Requested(request))) => self.handle(page, request),
                Ok((page, FromPage::Heartbeat(sent))) => self.control.heartbeat(page, sent),
                Ok((page, FromPage::Gone)) => {
                    if self.control.leave(page) {
                        self.stop("stopped: the page in control has gone".to_owned());
                    }
                }
                Err(_) => {}
            }
            lock(&self.feed.shown).holder = self.control.holder();
            if Instant::now() >= deadline {
                return;
            }
        }
    }

    /// The device's own limit of a silent host.
    fn limit(&self) -> Duration {
        let limit_ms = lock(&self.feed.state).status.as_ref().map(|status| status.silence_limit_ms);
        limit_ms.map_or(HEARTBEAT_LIMIT, |limit_ms| Duration::from_millis(limit_ms.into()))
    }

    fn stop(&mut self, notice: String) {
        self.worker.send(UserCommand::Stop);
        self.shows(Some(notice), None);
    }

    fn shows(&self, notice: Option<String>, program: Option<RunningProgram>) {
        let mut shown = lock(&self.feed.shown);
        (shown.notice, shown.program) = (notice, program);
    }

    fn handle(&mut self, page: PageId, request: Request) {
        let command = match request {
            Request::Stop => return self.stop("stopped by a page".to_owned()),
            Request::Take => {
                if self.control.take(page, Instant::now()) {
                    lock(&self.feed.shown).notice = None;
                }
                return;
            }
            Request::Leave => {
                if self.control.leave(page) {
                    self.stop("stopped: the page has given up control".to_owned());
                }
                return;
            }
            // Heartbeat for an update that the connection has not sent.
            Request::Heartbeat(_) => return,
            Request::Home => UserCommand::Home,
            Request::Tare => UserCommand::Tare,
            Request::Clear => UserCommand::Clear,
            Request::Retreat => UserCommand::Retreat,
            Request::Jog(by_mm) => UserCommand::Jog(by_mm.map(|mm| 1e-3 * mm)),
            Request::Run(name) => match self.feed.programs.iter().find(|program| program.name == name) {
                Some(program) => UserCommand::Run(Arc::clone(program)),
                None => return self.shows(Some(format!("not done: no program {name}")), None),
            },
        };
        if self.control.holder() != Some(page) {
            lock(&self.feed.shown).notice = Some("not done: the page has no control".to_owned());
            return;
        }
        let program = match &command {
            UserCommand::Run(program) => {
                Some(RunningProgram { name: program.name.clone(), steps: program.steps.len() })
            }
            _ => None,
        };
        self.worker.send(command);
        self.shows(None, program);
    }
}

/// A thread that has panicked while it held a lock leaves what can go on.
fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// One connected page. Dropping it reports that it has gone.
#[derive(Debug)]
pub struct PageConnection {
    feed: Arc<SharedState>,
    page: PageId,
    /// Number of the first frame that the page does not have; none where it has none.
    reached: Option<u64>,
    sent: u64,
}

impl PageConnection {
    /// A place for a page; none where all are taken.
    pub fn join(feed: &Arc<SharedState>) -> Option<Self> {
        if feed.pages.fetch_add(1, Ordering::AcqRel) >= MAX_PAGES {
            feed.pages.fetch_sub(1, Ordering::AcqRel);
            return None;
        }
        let page = feed.next_page.fetch_add(1, Ordering::AcqRel);
        Some(Self { feed: Arc::clone(feed), page, reached: None, sent: 0 })
    }

    /// Passes a request on; false where too many wait.
    pub fn request(&self, request: Request) -> bool {
        self.feed.requests.try_send((self.page, FromPage::Requested(request))).is_ok()
    }

    /// Passes on that an update was drawn that was sent then; false where too many wait.
    pub fn heartbeat(&self, sent: Instant) -> bool {
        self.feed.requests.try_send((self.page, FromPage::Heartbeat(sent))).is_ok()
    }

    /// The next update.
    pub fn update(&mut self) -> Update {
        self.sent += 1;
        let (device, outcome) = {
            let state = lock(&self.feed.state);
            (Report::new(&state, self.feed.began.elapsed().as_secs_f64()), Outcome::of(&state))
        };
        let shown = lock(&self.feed.shown);
        let control = match shown.holder {
            None => ControlHolder::None,
            Some(page) if page == self.page => ControlHolder::This,
            Some(_) => ControlHolder::Other,
        };
        Update {
            schema: "guide.live/2",
            update: self.sent,
            control,
            notice: shown.notice.clone(),
            outcome,
            program: shown.program.clone(),
            programs: self.feed.programs.iter().map(|program| program.name.clone()).collect(),
            heartbeat_limit_s: HEARTBEAT_LIMIT.as_secs_f64(),
            device,
        }
    }

    /// Bytes of the device since the last call, as they went over the link; at first those of the last half
    /// minute.
    pub fn frames(&mut self) -> Vec<u8> {
        let (bytes, next) = lock(&self.feed.frames).since(self.reached);
        // Before the first frame the page has none.
        self.reached = self.reached.or((!bytes.is_empty()).then_some(next)).map(|_| next);
        bytes
    }

    /// Number of the last update.
    pub fn sent(&self) -> u64 {
        self.sent
    }
}

impl Drop for PageConnection {
    fn drop(&mut self) {
        self.feed.pages.fetch_sub(1, Ordering::AcqRel);
        // If supervision has ended there is no device any more.
        let _ = self.feed.requests.send((self.page, FromPage::Gone));
    }
}
