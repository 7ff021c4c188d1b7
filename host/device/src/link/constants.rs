//! Constants that the device keeps: the limits of its interlocks and the calibration of its rig.

use super::client::Client;
use super::error::LinkError;
use protocol::{CalibrationRecord, MAX_CALIBRATION, PIECE_BYTES, Request, SILENCE_LIMIT_MS};
use std::time::{Duration, Instant};

/// Time within which a device that restarts has to answer again.
const RESTART_TIME: Duration = Duration::from_secs(8);
/// Pause between two attempts to reach it.
const RETRY_PAUSE: Duration = Duration::from_millis(100);

/// Limits of the interlocks, until the device starts again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limits {
    /// Largest force along either axis, from the tare and from the calibration's zero, newtons.
    pub force_n: f64,
    /// Longest silence of the host while a program waits or runs, seconds.
    pub silence_s: f64,
}

impl Client {
    /// The limits that are set.
    ///
    /// # Errors
    /// As [`Self::status`].
    pub fn limits(&mut self) -> Result<Limits, LinkError> {
        let status = self.status()?;
        Ok(Limits {
            force_n: f64::from(status.force_limit_mn) * 1e-3,
            silence_s: f64::from(status.silence_limit_ms) * 1e-3,
        })
    }

    /// Sets limits; omitted ones are kept. Returns the limits that the device reports afterwards.
    ///
    /// # Errors
    /// [`LinkError::Limit`] for a value that the device cannot take, [`LinkError::LimitBelowZero`] for a force that no position can meet,
    /// and as [`Self::request`].
    pub fn set_limits(&mut self, force_n: Option<f64>, silence_s: Option<f64>) -> Result<Limits, LinkError> {
        let force_range_mn = self.hello().scales.force_range_mn;
        let force_mn =
            force_n.map(|force_n| milli("force", force_n, [1, force_range_mn], "N")).transpose()?;
        let silence_ms =
            silence_s.map(|silence_s| milli("silence", silence_s, SILENCE_LIMIT_MS, "s")).transpose()?;
        if let Some(force_n) = force_n {
            // The device counts the force from the calibration's zero as well as from the tare.
            let zero_n = self.safety().map(|safety| self.force_n(safety.zero_counts))?;
            let zero_n = zero_n.into_iter().map(f64::abs).fold(0.0, f64::max);
            if force_n <= zero_n {
                return Err(LinkError::LimitBelowZero { force_n, zero_n });
            }
        }
        if force_mn.is_some() || silence_ms.is_some() {
            let now = self.status()?;
            self.request(Request::Limits {
                force_mn: force_mn.unwrap_or(now.force_limit_mn),
                silence_ms: silence_ms.unwrap_or(now.silence_limit_ms),
            })?;
        }
        self.limits()
    }

    /// Stores a calibration on the device, which restarts with it. Returns the client of the restarted device.
    ///
    /// # Errors
    /// As [`Self::request`]; [`LinkError::NotBack`] and [`LinkError::CalibrationNotKept`] where the device has not come back, or
    /// not with this calibration.
    pub fn store_calibration(mut self, record: &CalibrationRecord) -> Result<Self, LinkError> {
        let mut buffer = [0; MAX_CALIBRATION];
        let encoded = record.encode(&mut buffer);
        for (piece, part) in (0u8..).zip(encoded.chunks(PIECE_BYTES)) {
            let mut bytes = [0; PIECE_BYTES];
            for (to, from) in bytes.iter_mut().zip(part) {
                *to = *from;
            }
            self.request(Request::LoadCalibration { piece, bytes })?;
        }
        let length = u8::try_from(encoded.len()).unwrap_or(u8::MAX);
        match self.request(Request::StoreCalibration { length, crc: record.crc() }) {
            // A device that restarts may not get to answering, and its port may go for a moment.
            Ok(())
            | Err(LinkError::Restarted { .. } | LinkError::Gone { .. } | LinkError::Unanswered { .. }) => {}
            Err(error) => return Err(error),
        }
        let (port, boot_id) = (self.port().to_owned(), self.boot_id());
        drop(self);
        let client = connect_after(&port, boot_id)?;
        let theirs = &client.hello().calibration;
        if theirs.crc == record.crc() && theirs.id == record.id {
            return Ok(client);
        }
        Err(LinkError::CalibrationNotKept {
            port,
            sent: named(&record.id, record.crc()),
            theirs: named(&theirs.id, theirs.crc),
        })
    }
}

/// A calibration by id and checksum, as people and files name it.
pub fn named(id: &str, crc: u32) -> String {
    format!("`{id}` ({crc:08x})")
}

/// A limit in thousandths, as the device takes it.
fn milli(name: &'static str, value: f64, range: [u32; 2], unit: &'static str) -> Result<u32, LinkError> {
    let scaled = (value * 1e3).round();
    let [least, most] = range.map(|end| f64::from(end) * 1e-3);
    if (f64::from(range[0])..=f64::from(range[1])).contains(&scaled) {
        Ok(scaled as u32)
    } else {
        Err(LinkError::Limit { name, value, least, most, unit })
    }
}

/// The device after it has restarted.
fn connect_after(port: &str, boot_id: u32) -> Result<Client, LinkError> {
    let deadline = Instant::now() + RESTART_TIME;
    loop {
        let failed = match Client::connect_within(port, 1) {
            Ok(client) if client.boot_id() != boot_id => return Ok(client),
            Ok(_) => None,
            Err(error @ (LinkError::OtherVersion { .. } | LinkError::OtherSchema { .. })) => {
                return Err(error);
            }
            Err(error) => Some(Box::new(error)),
        };
        if Instant::now() >= deadline {
            return Err(LinkError::NotBack { port: port.to_owned(), cause: failed });
        }
        std::thread::sleep(RETRY_PAUSE);
    }
}
