//! Serial ports: a list of them, and opening one, with explanations of errors.

mod socket;

use serialport::{ClearBuffer, ErrorKind, SerialPortType};
use std::io::{self, Read, Write};
use std::time::Duration;

/// Line rate of the firmware, bits per second. A virtual port (USB CDC, a pty) ignores it.
pub const BAUD: u32 = 460_800;
/// Time for which one read or write waits; short, so that a closing link is noticed soon.
const READ_TIMEOUT: Duration = Duration::from_millis(20);

/// Remedy for a port that another program has open.
const IN_USE: &str = if cfg!(windows) { "close it" } else { "close it, or see who has it with `lsof PORT`" };

/// Why a port cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum PortError {
    /// No such device.
    #[error("{port}: no such port (is the board plugged in? `guide ports` lists what is there)")]
    NotThere {
        /// The port's name.
        port: String,
    },
    /// Another program uses it.
    #[error("{port}: in use by another program ({})", IN_USE.replace("PORT", port))]
    InUse {
        /// The port's name.
        port: String,
    },
    /// The user may not open it.
    #[error("{port}: permission denied (on Linux add yourself to the group `dialout` and log in again)")]
    Permission {
        /// The port's name.
        port: String,
    },
    /// It names a server, and none answers there.
    #[error(
        "{port}: no server can be reached ({cause}); expected tcp:HOST:PORT, or a socket, of one that passes a device's bytes on"
    )]
    NoServer {
        /// The port's name.
        port: String,
        /// The system's error.
        cause: io::Error,
    },
    /// It exists but is no serial port, or the system reports another error.
    #[error("{port}: cannot be opened as a serial port: {cause}")]
    Other {
        /// The port's name.
        port: String,
        /// The system's error.
        cause: serialport::Error,
    },
}

/// A port that the system lists.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PortInfo {
    /// Name to open it by.
    pub name: String,
    /// The system's description of it: product and serial number of a USB device.
    pub description: String,
}

/// Ports that the system lists, by name.
///
/// # Errors
/// The system's own error where the list cannot be had.
pub fn list() -> Result<Vec<PortInfo>, serialport::Error> {
    let mut ports: Vec<PortInfo> = serialport::available_ports()?
        .into_iter()
        .map(|port| PortInfo { description: describe(&port.port_type), name: port.port_name })
        .collect();
    ports.sort_by_cached_key(|port| by_number(&port.name));
    Ok(ports)
}

/// Orders names that end with a number by that: COM3 before COM10.
fn by_number(name: &str) -> (String, u32) {
    let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
    (stem.to_owned(), name.get(stem.len()..).and_then(|number| number.parse().ok()).unwrap_or(0))
}

fn describe(kind: &SerialPortType) -> String {
    match kind {
        SerialPortType::UsbPort(usb) => {
            let names = [&usb.manufacturer, &usb.product, &usb.serial_number];
            let known_names: Vec<&str> = names.into_iter().filter_map(|part| part.as_deref()).collect();
            format!("USB {:04x}:{:04x} {}", usb.vid, usb.pid, known_names.join(" ")).trim_end().to_owned()
        }
        SerialPortType::PciPort => "PCI".to_owned(),
        SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
        SerialPortType::Unknown => String::new(),
    }
}

/// Whether the system has a port of this name.
fn is_listed(name: &str) -> bool {
    list().is_ok_and(|ports| ports.iter().any(|port| port.name.eq_ignore_ascii_case(name)))
}

/// The two directions of an open port. Reads and writes return after [`READ_TIMEOUT`], with an error of this kind.
pub(super) struct Ends {
    pub reader: Box<dyn Read + Send>,
    pub writer: Box<dyn Write + Send>,
}

/// Opens a port: a serial one for this program alone, its buffers emptied; or a socket.
pub(super) fn open(name: &str) -> Result<Ends, PortError> {
    fn port(name: &str) -> String {
        name.to_owned()
    }
    if let Some(connected) = socket::connect(name) {
        return connected.map_err(|cause| PortError::NoServer { port: port(name), cause });
    }
    let serial = serialport::new(name, BAUD).timeout(READ_TIMEOUT).open();
    let serial = serial.map_err(|cause| match cause.kind() {
        // On Unix this kind means that the port is locked, and a port that is not there is an I/O error; on Windows it means either.
        ErrorKind::NoDevice if cfg!(unix) || is_listed(name) => PortError::InUse { port: port(name) },
        ErrorKind::NoDevice | ErrorKind::Io(std::io::ErrorKind::NotFound) => {
            PortError::NotThere { port: port(name) }
        }
        ErrorKind::Io(std::io::ErrorKind::PermissionDenied) => PortError::Permission { port: port(name) },
        _ => PortError::Other { port: port(name), cause },
    })?;
    let other = |cause| PortError::Other { port: port(name), cause };
    serial.clear(ClearBuffer::All).map_err(other)?;
    let reader = serial.try_clone().map_err(other)?;
    Ok(Ends { reader: Box::new(reader), writer: Box::new(serial) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_are_listed_by_their_numbers() {
        let mut names = ["COM10", "/dev/ttyS0", "COM3", "/dev/ttyACM2", "/dev/ttyACM10", "COM"];
        names.sort_by_cached_key(|name| by_number(name));
        assert_eq!(names, ["/dev/ttyACM2", "/dev/ttyACM10", "/dev/ttyS0", "COM", "COM3", "COM10"]);
    }
}
