//! The firmware in QEMU on the plant of the sequences, one control period at a time and in one thread: the device's clock goes on when the
//! caller lets it, so that nothing is waited for by the computer's clock.

use crate::bench::lay_out;
use crate::cosim::output::{Output, open_pipes, read_record};
use crate::images::{self, Board, Image};
use crate::pty;
use crate::qemu::{self, HANGS, Line, OUTPUT_PIPE, Qemu};
use anyhow::{Context, Result, bail};
use control::calibration::Calibration;
use control::slots::to_stored;
use emulation::plant::{
    FULL_SCALE, PlantReply, PlantRequest, RECORD_BYTES, REPLY_PIPE, REQUEST_PIPE, UNLIMITED,
};
use protocol::{Command, MAX_FRAME_TO_DEVICE, Message, encode_command};
use rustix::io::Errno;
use sequences::plant::Inputs;
use sequences::rig::{Codes, Rig};
use std::collections::VecDeque;
use std::fs::File;
use std::io::Write;
use std::os::fd::OwnedFd;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Periods whose codes are kept: a message is on its way for less.
const KEPT_PERIODS: usize = 4_096;

/// Periods in which the firmware starts.
const START_PERIODS: u32 = 50;
/// Periods in which an answer comes where the computer has time for QEMU: it takes a byte a period or two.
const PROMPT_PERIODS: u32 = 60;
/// Beyond that, how long a period waits before it goes on. QEMU's thread that takes bytes gets little of a busy computer.
const BUSY: Duration = Duration::from_millis(2);
/// Periods without an answer after which there is none.
pub const ANSWER_PERIODS: u32 = 1_500;

/// Event of the core.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Upset {
    /// The supply sags.
    BrownOut,
    /// The program panics.
    Panic,
}

/// A running firmware with its plant.
pub struct Lockstep {
    qemu: Qemu,
    requests: File,
    replies: File,
    output: Output,
    port: OwnedFd,
    folder: TempDir,
    /// The plant and its sensors.
    pub rig: Rig,
    /// Time of a potentiometer's conversion beyond its normal one, microseconds.
    pub conversion_us: u16,
    /// Event of the next period.
    pub upset: Option<Upset>,
    /// Largest force since it was taken, as the cell has it, newtons.
    pub most_n: f32,
    /// A bridge drove its motor in the last period.
    pub driven: bool,
    /// Periods since power-on, and starts after the first.
    pub periods: u64,
    /// Starts after the first.
    pub resets: u64,
    /// Codes of the latest periods since the last start, the newest last, and how many there were.
    codes: VecDeque<Codes>,
    since_start: u64,
    waiting: VecDeque<Message>,
    /// The period in which QEMU ends.
    power_off: bool,
}

impl Lockstep {
    /// Starts the image with a rig and its calibration stored.
    ///
    /// # Errors
    /// Where anything of it cannot be had.
    pub fn start(rig: Rig, limit: Duration) -> Result<Self> {
        let folder = tempfile::Builder::new().prefix("needle-guide-").tempdir()?;
        lay_out(folder.path(), &[&to_stored(&Calibration::nominal_record(), 1)])?;
        Self::power_on(folder, rig, limit)
    }

    /// Switches a board on, whose flash and number are in a folder.
    ///
    /// # Errors
    /// Where anything of it cannot be had.
    pub fn power_on(folder: TempDir, rig: Rig, limit: Duration) -> Result<Self> {
        let elf = images::build_for(Board::BL475eIot01a, Image::Qemu)?;
        let turn = qemu::turn();
        let output = Output::open(folder.path())?;
        let qemu = Qemu::start_for(Board::BL475eIot01a, Line::Socket, turn, &elf, folder.path(), limit)?;
        let pipes = open_pipes(folder.path(), &AtomicBool::new(false), Instant::now() + HANGS)?;
        let (requests, replies) = pipes.context("nothing ends the waiting")?;
        let port = pty::open(qemu.serial())?;
        let mut firmware = Self {
            qemu,
            requests,
            replies,
            output,
            port,
            folder,
            rig,
            conversion_us: 0,
            upset: None,
            most_n: 0.0,
            driven: false,
            periods: 0,
            resets: 0,
            codes: VecDeque::with_capacity(KEPT_PERIODS),
            since_start: 0,
            waiting: VecDeque::new(),
            power_off: false,
        };
        // Bytes before its serial port is set up are lost.
        for _ in 0..START_PERIODS {
            firmware.period()?;
        }
        Ok(firmware)
    }

    /// One control period.
    ///
    /// # Errors
    /// Where the firmware ended; its log is part of the error.
    pub fn period(&mut self) -> Result<()> {
        let mut record = [0; RECORD_BYTES];
        if !read_record(&mut self.requests, &mut record, &AtomicBool::new(false))? {
            bail!("the firmware ended: {:#?}", self.qemu.log());
        }
        let request = PlantRequest::from_bytes(&record).context("the firmware sent no plant record")?;
        let waiting = &mut self.waiting;
        self.output.drain(|message| waiting.push_back(message.clone()));
        // A copy of it was read; a socket that nobody empties would hold the device.
        let mut copy = [0; 1024];
        while rustix::io::read(&self.port, &mut copy).is_ok_and(|length| length > 0) {}
        if request.step == 0 && self.periods > 0 {
            self.resets += 1;
            self.since_start = 0;
            self.codes.clear();
        }
        let [x1, x2, y1, y2] = request.compare;
        self.driven = x1 != x2 || y1 != y2;
        self.rig.step([
            bridge_inputs(x1, x2, request.bridges_enabled),
            bridge_inputs(y1, y2, request.bridges_enabled),
        ]);
        self.most_n = self.most_n.max(self.rig.most_n());
        let codes = self.rig.codes();
        if self.codes.len() == KEPT_PERIODS {
            self.codes.pop_front();
        }
        self.codes.push_back(codes);
        let upset = self.upset.take();
        let reply = PlantReply {
            step: request.step,
            potentiometer_codes: codes.potentiometer,
            force_codes: codes.force,
            potentiometer_conversion_us: self.conversion_us,
            line_bytes: UNLIMITED,
            emergency_stop: codes.emergency_stop,
            force_ready: !codes.silent,
            power_off: self.power_off,
            brown_out: upset == Some(Upset::BrownOut),
            panic: upset == Some(Upset::Panic),
            ..PlantReply::default()
        };
        self.periods += 1;
        self.since_start += 1;
        // If it has ended meanwhile, the next period reports it.
        let _ = self.replies.write_all(&reply.to_bytes());
        Ok(())
    }

    /// A period in which an answer is waited for, by its number since the command was sent.
    ///
    /// # Errors
    /// As [`Self::period`].
    pub fn waiting_period(&mut self, number: u32) -> Result<()> {
        if number > PROMPT_PERIODS {
            std::thread::sleep(BUSY);
        }
        self.period()
    }

    /// The next message that the device has sent.
    pub fn receive(&mut self) -> Option<Message> {
        self.waiting.pop_front()
    }

    /// Codes that the device read for the sample of this time since its start, milliseconds, while they are kept.
    pub fn codes_at(&self, ms: u64) -> Option<Codes> {
        // The reading of a period is the reply to the request before, whose number is one less.
        let age = usize::try_from(self.since_start.checked_sub(ms)?).ok()?;
        self.codes.get(self.codes.len().checked_sub(age + 1)?).copied()
    }

    /// Puts bytes on the line to the device.
    ///
    /// # Errors
    /// Where the line fails.
    pub fn send_bytes(&mut self, mut left: &[u8]) -> Result<()> {
        while !left.is_empty() {
            match rustix::io::write(&self.port, left) {
                Ok(written) => left = left.get(written..).unwrap_or_default(),
                Err(Errno::AGAIN | Errno::INTR) => self.period()?,
                Err(error) => return Err(error).context("cannot write to the serial port"),
            }
        }
        Ok(())
    }

    /// Sends a command as it is.
    ///
    /// # Errors
    /// Where the line fails.
    pub fn send(&mut self, command: &Command) -> Result<()> {
        let mut buffer = [0; MAX_FRAME_TO_DEVICE];
        self.send_bytes(encode_command(command, &mut buffer)?)
    }

    /// The firmware's log so far.
    pub fn log(&self) -> Vec<String> {
        self.qemu.log()
    }

    /// Sends a command and lets periods pass until it is answered; the messages until then, the answer last.
    ///
    /// # Errors
    /// Where it is not answered within [`ANSWER_PERIODS`], or the line fails.
    pub fn ask(&mut self, command: &Command) -> Result<Vec<Message>> {
        self.send(command)?;
        let mut messages = Vec::new();
        for number in 0..ANSWER_PERIODS {
            self.waiting_period(number)?;
            while let Some(message) = self.receive() {
                let answers =
                    matches!(message, Message::Ack { id } | Message::Refused { id, .. } if id == command.id);
                messages.push(message);
                if answers {
                    return Ok(messages);
                }
            }
        }
        bail!("no answer to {command:?}: {messages:?}");
    }

    /// Sets another time limit, from now on.
    pub fn limit(&self, limit: Duration) {
        self.qemu.limit(limit);
    }

    /// Powers the firmware off and waits for its end; the folder then has what the board keeps.
    ///
    /// # Errors
    /// Where it does not end, or with another code than 0.
    pub fn stop(mut self) -> Result<TempDir> {
        self.power_off = true;
        self.period()?;
        let (code, log) = self.qemu.wait(HANGS)?;
        if code != 0 {
            bail!("the firmware ended with code {code}; its log: {log:#?}");
        }
        for name in [REQUEST_PIPE, REPLY_PIPE, OUTPUT_PIPE, "serial"] {
            let path = self.folder.path().join(name);
            if path.exists() {
                std::fs::remove_file(path)?;
            }
        }
        Ok(self.folder)
    }
}

fn bridge_inputs(forward: u16, backward: u16, bridges_enabled: bool) -> Inputs {
    match bridges_enabled {
        true => Inputs { forward: duty(forward), backward: duty(backward) },
        false => Inputs::OFF,
    }
}

fn duty(high: u16) -> f64 {
    f64::from(high) / f64::from(FULL_SCALE)
}
