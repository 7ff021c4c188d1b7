//! The pipes to the plant, through semihosting.
//!
//! QEMU's console carries the binary stream of the log, so this module must not print.

use super::trap;
use crate::exit::{ExitCode, exit};
use core::ffi::CStr;
use emulation::plant::{PlantReply, PlantRequest, RECORD_BYTES};
use semihosting::fd::{AsFd, OwnedFd};
use semihosting::sys::arm_compat::{OpenMode, sys_open, sys_read_orig, sys_write_orig};

/// Both pipes.
pub(super) struct Link {
    requests: OwnedFd,
    replies: OwnedFd,
}

impl Link {
    /// Opens the pipes; waits for the plant to open its ends.
    pub(super) fn open() -> Self {
        let requests = sys_open(c"plant.req", OpenMode::WRONLY_TRUNC_BINARY);
        let replies = sys_open(c"plant.rsp", OpenMode::RDONLY_BINARY);
        match (requests, replies) {
            (Ok(requests), Ok(replies)) => Self { requests, replies },
            _ => {
                defmt::error!("no plant: the pipes plant.req and plant.rsp cannot be opened");
                exit(ExitCode::PlantGone)
            }
        }
    }

    /// One exchange; does not return if the plant ends the run.
    pub(super) fn exchange(&mut self, request: &PlantRequest) -> PlantReply {
        if !self.write(&request.to_bytes()) {
            plant_gone(request.step)
        }
        loop {
            let reply = self.next_reply(request.step);
            if reply.step == request.step {
                if reply.power_off {
                    defmt::info!(
                        "power off at step {=u32}, {=u32} accesses emulated",
                        request.step,
                        trap::count()
                    );
                    super::peripherals::power_off();
                    exit(ExitCode::PowerOff)
                }
                return reply;
            }
            // A reset may come between a request and its reply, which then waits in the pipe for the next start.
            if request.step != 0 {
                defmt::error!("the plant answers step {=u32} to step {=u32}", reply.step, request.step);
                exit(ExitCode::PlantRecord)
            }
        }
    }

    /// The next reply in the pipe.
    fn next_reply(&mut self, step: u32) -> PlantReply {
        let mut bytes = [0; RECORD_BYTES];
        if !self.read(&mut bytes) {
            plant_gone(step)
        }
        PlantReply::from_bytes(&bytes).unwrap_or_else(|error| {
            defmt::error!("bad plant reply: {}", defmt::Display2Format(&error));
            exit(ExitCode::PlantRecord)
        })
    }

    /// Writes all bytes; false if the pipe is closed.
    fn write(&self, bytes: &[u8]) -> bool {
        drain(&self.requests, bytes)
    }

    /// Fills the buffer; false if the pipe is closed.
    fn read(&self, bytes: &mut [u8]) -> bool {
        fill(&self.replies, bytes)
    }
}

/// Writes all bytes; false where that is not possible.
fn drain(to: &OwnedFd, mut bytes: &[u8]) -> bool {
    while !bytes.is_empty() {
        match sys_write_orig(to.as_fd(), bytes) {
            // The semihosting call returns the number of bytes that it did not write.
            Ok(left) if left < bytes.len() => bytes = &bytes[bytes.len() - left..],
            _ => return false,
        }
    }
    true
}

/// The plant has closed its end.
fn plant_gone(step: u32) -> ! {
    defmt::error!("the plant is gone at step {=u32}", step);
    exit(ExitCode::PlantGone)
}

/// Fills the buffer; false at the end.
fn fill(from: &OwnedFd, bytes: &mut [u8]) -> bool {
    let mut missing = bytes.len();
    while missing > 0 {
        let filled = bytes.len() - missing;
        match sys_read_orig(from.as_fd(), &mut bytes[filled..]) {
            // The semihosting call returns the number of bytes that it did not read.
            Ok(left) if left < missing => missing = left,
            _ => return false,
        }
    }
    true
}

/// Fills a buffer from a file in QEMU's working folder, as far as the file reaches.
pub(super) fn load(name: &CStr, buffer: &mut [u8]) {
    if let Ok(file) = sys_open(name, OpenMode::RDONLY_BINARY) {
        fill(&file, buffer);
    }
}

/// Writes a file in QEMU's working folder; errors are ignored.
pub(super) fn store(name: &CStr, bytes: &[u8]) {
    if let Ok(file) = sys_open(name, OpenMode::WRONLY_TRUNC_BINARY) {
        drain(&file, bytes);
    }
}

/// A recording in QEMU's working folder: single-precision numbers, least significant byte first.
pub struct Recording(OwnedFd);

impl Recording {
    /// Opens the recording; `None` if the file does not exist.
    pub fn open(name: &CStr) -> Option<Self> {
        sys_open(name, OpenMode::RDONLY_BINARY).ok().map(Self)
    }

    /// The next numbers; `None` at the end.
    pub fn numbers<const N: usize>(&mut self) -> Option<[f32; N]> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            let mut bytes = [0; 4];
            if !fill(&self.0, &mut bytes) {
                return None;
            }
            *number = f32::from_le_bytes(bytes);
        }
        Some(numbers)
    }
}
