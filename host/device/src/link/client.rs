//! Client of a device: sends commands and waits for their answers, and receives the stream of unsolicited messages.
//!
//! A command is sent again when no answer comes, a bounded number of times; the device carries it out once. Telemetry
//! that arrives while an answer is awaited is kept in order and handed out by [`Client::next`].

use super::display::request_name;
use super::error::LinkError;
use super::telemetry::{Telemetry, displacement_m, force_n, to_batch};
use super::timeouts::{ANSWER_TIMEOUT, REQUESTS, TRIES};
use super::wire::{LinkLosses, OpenPort, Received, Tap};
use protocol::{
    CalibrationRecord, Command, Description, Envelope, EventKind, Hello, Message, Request, Safety, Status,
};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// A connected device.
pub struct Client {
    wire: OpenPort,
    inbox: VecDeque<Telemetry>,
    boot_id: u32,
    /// Token of the connection, which every command carries.
    connection: u32,
    next_id: u16,
    hello: Hello,
    /// Number of the last frame of the greeting: what comes next follows it.
    hello_sequence: u32,
    /// Number of the frame that was taken last.
    sequence: u32,
}

impl Client {
    /// Opens a port and sends a hello.
    ///
    /// # Errors
    /// Where the port cannot be opened, there is no answer, or the answer is of another protocol.
    pub fn connect(port: &str) -> Result<Self, LinkError> {
        Self::connect_within(port, TRIES)
    }

    /// As [`Self::connect`], but gives up after `tries` hellos, which is meant for a search over several ports.
    ///
    /// # Errors
    /// As [`Self::connect`].
    pub fn connect_within(port: &str, tries: u32) -> Result<Self, LinkError> {
        let mut wire = OpenPort::open(port)?;
        let mut answer: Option<(u32, Hello)> = None;
        for id in 0..tries.max(1) {
            wire.send(&Command { id: id as u16, connection: 0, request: Request::Hello })?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(remaining) = deadline.checked_duration_since(Instant::now()) {
                let frame = match wire.receive(remaining)? {
                    Received::Frame { frame, .. } => *frame,
                    Received::HelloOfVersion(theirs) => return Err(other_version(port, theirs)),
                    Received::Nothing => continue,
                };
                match (frame.message, &answer) {
                    (Message::Hello(hello), _) => {
                        check_protocol(port, &hello)?;
                        answer = Some((frame.boot_id, hello));
                    }
                    // The token belongs to the start that sent the hello, whichever of its hellos it answers.
                    (Message::Connected { connection }, Some((boot_id, hello)))
                        if frame.boot_id == *boot_id =>
                    {
                        return Ok(Self {
                            wire,
                            inbox: VecDeque::new(),
                            boot_id: *boot_id,
                            connection,
                            // An answer to a hello that is still on its way is no answer to the next request.
                            next_id: tries.max(1) as u16,
                            hello: hello.clone(),
                            hello_sequence: frame.sequence,
                            sequence: frame.sequence,
                        });
                    }
                    _ => {}
                }
            }
        }
        Err(match answer {
            Some(_) => LinkError::Unanswered { port: port.to_owned(), command: "hello", tries },
            None => LinkError::NoAnswer { port: port.to_owned(), tries, bytes: wire.bytes() },
        })
    }

    /// Identity of the device, from its hello.
    pub fn hello(&self) -> &Hello {
        &self.hello
    }

    /// Name of the port.
    pub fn port(&self) -> &str {
        self.wire.name()
    }

    /// Number of the device's start.
    pub fn boot_id(&self) -> u32 {
        self.boot_id
    }

    /// Token of the connection, which every command of it carries.
    pub fn connection(&self) -> u32 {
        self.connection
    }

    /// Passes all further frames of the link to a tap, beginning with the hello that was received before.
    pub fn attach_tap(&mut self, mut tap: Box<dyn Tap>) {
        tap.received(&Envelope {
            boot_id: self.boot_id,
            sequence: self.hello_sequence,
            message: Message::Hello(self.hello.clone()),
        });
        self.wire.set_tap(Some(tap));
    }

    /// Ends [`Self::attach_tap`].
    pub fn detach_tap(&mut self) {
        self.wire.set_tap(None);
    }

    /// Bytes that have arrived.
    pub fn bytes(&self) -> u64 {
        self.wire.bytes()
    }

    /// Losses so far.
    pub fn losses(&self) -> LinkLosses {
        self.wire.losses()
    }

    /// Has a request carried out.
    ///
    /// # Errors
    /// [`LinkError::Refused`], [`LinkError::Unanswered`], [`LinkError::Restarted`], [`LinkError::Gone`].
    pub fn request(&mut self, request: Request) -> Result<(), LinkError> {
        if matches!(request, Request::Stream { enable: true }) {
            self.wire.stream_begins();
        }
        self.exchange(request).map(|_| ())
    }

    /// State, fault and counters of the device, now.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn status(&mut self) -> Result<Status, LinkError> {
        for _ in 0..REQUESTS {
            // The status and the answer to its request are two frames; where only the first is lost, it is requested again.
            if let Some(Message::Status(status)) = self.exchange(Request::Status)? {
                return Ok(status);
            }
        }
        Err(self.nothing_but_acks("status"))
    }

    /// The calibration that the device works with.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn calibration(&mut self) -> Result<CalibrationRecord, LinkError> {
        for _ in 0..REQUESTS {
            if let Some(Message::Calibration(record)) = self.exchange(Request::Calibration)? {
                return Ok(record);
            }
        }
        Err(self.nothing_but_acks("calibration"))
    }

    /// Tare, source of the calibration and heat of the motors, now.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn safety(&mut self) -> Result<Safety, LinkError> {
        for _ in 0..REQUESTS {
            if let Some(Message::Safety(safety)) = self.exchange(Request::Safety)? {
                return Ok(safety);
            }
        }
        Err(self.nothing_but_acks("safety"))
    }

    /// Description of the device's build.
    ///
    /// # Errors
    /// As [`Self::request`].
    pub fn description(&mut self) -> Result<Description, LinkError> {
        for _ in 0..REQUESTS {
            if let Some(Message::Description(description)) = self.exchange(Request::Describe)? {
                return Ok(description);
            }
        }
        Err(self.nothing_but_acks("describe"))
    }

    fn nothing_but_acks(&self, command: &'static str) -> LinkError {
        LinkError::AnswerMissing { port: self.wire.name().to_owned(), command, tries: REQUESTS }
    }

    /// Requests the status without waiting; the answer arrives among the unsolicited messages. The request is also a keepalive, under an
    /// id of its own each time: the device takes a repeated frame for one that the line repeats.
    ///
    /// # Errors
    /// [`LinkError::Gone`].
    pub fn request_status(&mut self) -> Result<(), LinkError> {
        let id = self.take_id()?;
        self.wire.send(&Command { id, connection: self.connection, request: Request::Status })
    }

    /// Forgets ends of programs that have been received and not been taken yet: before a program is accepted they are those of others.
    pub(super) fn forget_ends(&mut self) {
        fn is_end(telemetry: &Telemetry) -> bool {
            matches!(telemetry, Telemetry::Event(event) if matches!(event.kind, EventKind::ProgramEnded { .. }))
        }
        self.inbox.retain(|telemetry| !is_end(telemetry));
    }

    /// Next unsolicited message of the device; `None` if it sends none in time.
    ///
    /// # Errors
    /// [`LinkError::Gone`], [`LinkError::Restarted`].
    pub fn next(&mut self, timeout: Duration) -> Result<Option<Telemetry>, LinkError> {
        if let Some(telemetry) = self.inbox.pop_front() {
            return Ok(Some(telemetry));
        }
        let deadline = Instant::now() + timeout;
        while let Some(remaining) = deadline.checked_duration_since(Instant::now()) {
            self.receive(remaining)?;
            if let Some(telemetry) = self.inbox.pop_front() {
                return Ok(Some(telemetry));
            }
        }
        Ok(None)
    }

    /// Next unsolicited message that has already arrived, without waiting. Errors of the link are ignored, so that the last
    /// messages of a lost device can be received.
    pub fn waiting(&mut self) -> Option<Telemetry> {
        while self.inbox.is_empty() {
            match self.receive(Duration::ZERO) {
                // An answer that is not waited for any more.
                Ok(Some(_)) => {}
                Ok(None) if !self.inbox.is_empty() => {}
                Ok(None) | Err(_) => return None,
            }
        }
        self.inbox.pop_front()
    }

    /// Displacement in SI units of what a status or a batch has in counts.
    pub fn displacement_m(&self, counts: [i32; 2]) -> [f64; 2] {
        displacement_m(&self.hello, counts)
    }

    /// Force in SI units of what a status, an event or a batch has in counts.
    pub fn force_n(&self, counts: [i32; 2]) -> [f64; 2] {
        force_n(&self.hello, counts)
    }

    /// Sends a command until it is answered; a status or a calibration that comes directly before the answer is returned with it. A
    /// status further before was unsolicited, and may be from before the request.
    ///
    /// A request that changes something is sent again as the same frame, so that the device carries it out once. A query changes nothing, and is
    /// sent again under an id of its own: a keepalive then needs to arrive, and not its answer.
    fn exchange(&mut self, request: Request) -> Result<Option<Message>, LinkError> {
        let mut id = self.take_id()?;
        // A late answer to an earlier frame of the same query is an answer.
        let mut first_id = id;
        let mut last = None;
        for attempt in 0..TRIES {
            if attempt > 0 && is_query(&request) {
                id = self.take_id()?;
                // Ids begin again with another connection.
                first_id = first_id.min(id);
            }
            self.wire.send(&Command { id, connection: self.connection, request })?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(remaining) = deadline.checked_duration_since(Instant::now()) {
                match self.receive(remaining)? {
                    Some(Message::Ack { id: answered }) if (first_id..=id).contains(&answered) => {
                        let previous = self.sequence.wrapping_sub(1);
                        return Ok(
                            last.and_then(|(sequence, answer)| (sequence == previous).then_some(answer))
                        );
                    }
                    Some(Message::Refused { id: answered, refusal })
                        if (first_id..=id).contains(&answered) =>
                    {
                        return Err(LinkError::Refused { command: request_name(&request), refusal });
                    }
                    Some(
                        answer @ (Message::Status(_)
                        | Message::Calibration(_)
                        | Message::Safety(_)
                        | Message::Description(_)),
                    ) => {
                        last = Some((self.sequence, answer));
                    }
                    _ => {}
                }
            }
        }
        let port = self.wire.name().to_owned();
        Err(LinkError::Unanswered { port, command: request_name(&request), tries: TRIES })
    }

    /// The next id; where there are none left, of a new connection.
    fn take_id(&mut self) -> Result<u16, LinkError> {
        if self.next_id == u16::MAX {
            self.reconnect()?;
        }
        let id = self.next_id;
        self.next_id += 1;
        Ok(id)
    }

    /// Begins another connection with the same start of the device.
    fn reconnect(&mut self) -> Result<(), LinkError> {
        for _ in 0..TRIES {
            self.wire.send(&Command {
                id: u16::MAX,
                connection: self.connection,
                request: Request::Hello,
            })?;
            let deadline = Instant::now() + ANSWER_TIMEOUT;
            while let Some(remaining) = deadline.checked_duration_since(Instant::now()) {
                if let Some(Message::Connected { connection }) = self.receive(remaining)? {
                    (self.connection, self.next_id) = (connection, 0);
                    return Ok(());
                }
            }
        }
        let port = self.wire.name().to_owned();
        Err(LinkError::Unanswered { port, command: "hello", tries: TRIES })
    }

    /// Takes one frame: telemetry goes to the inbox, answers are returned.
    fn receive(&mut self, timeout: Duration) -> Result<Option<Message>, LinkError> {
        let received = self.wire.receive(timeout)?;
        let port = || self.wire.name().to_owned();
        let (message, lost_before) = match received {
            Received::Frame { frame, lost_before } if frame.boot_id == self.boot_id => {
                self.sequence = frame.sequence;
                (frame.message, lost_before)
            }
            Received::Nothing => return Ok(None),
            Received::Frame { .. } | Received::HelloOfVersion(_) => {
                return Err(LinkError::Restarted { port: port() });
            }
        };
        match message {
            Message::Samples(samples) => {
                let batch = to_batch(&self.hello, &samples, lost_before);
                let batch = batch.ok_or(LinkError::Garbled { port: port() })?;
                self.inbox.push_back(Telemetry::Samples(batch));
                Ok(None)
            }
            Message::Event(event) => {
                self.inbox.push_back(Telemetry::Event(event));
                Ok(None)
            }
            // Most of these come unsolicited; an answer is handed out both ways.
            Message::Status(status) => {
                self.inbox.push_back(Telemetry::Status(Box::new(status)));
                Ok(Some(Message::Status(status)))
            }
            answer => Ok(Some(answer)),
        }
    }
}

/// Whether a request only has something sent.
fn is_query(request: &Request) -> bool {
    matches!(request, Request::Status | Request::Calibration | Request::Safety | Request::Describe)
}

fn check_protocol(port: &str, hello: &Hello) -> Result<(), LinkError> {
    if hello.protocol_version != protocol::VERSION {
        return Err(other_version(port, hello.protocol_version));
    }
    if hello.schema_hash != protocol::schema_hash() {
        return Err(LinkError::OtherSchema {
            port: port.to_owned(),
            version: hello.protocol_version,
            commit: hello.commit.as_str().to_owned(),
        });
    }
    Ok(())
}

/// A hello of this version. One of our own that cannot be read has other fields behind the version.
pub(super) fn other_version(port: &str, theirs: u16) -> LinkError {
    if theirs == protocol::VERSION {
        return LinkError::OtherSchema {
            port: port.to_owned(),
            version: theirs,
            commit: "unknown: its hello has other fields".to_owned(),
        };
    }
    LinkError::OtherVersion { port: port.to_owned(), theirs, ours: protocol::VERSION }
}

#[cfg(test)]
impl Client {
    /// As if so many commands had been sent.
    pub(super) fn skip_ids(&mut self, next_id: u16) {
        self.next_id = next_id;
    }
}
