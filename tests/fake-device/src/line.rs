//! The line to the device: a pseudo terminal where the system has them, or a TCP connection.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

/// Waiting time of a read.
const PATIENCE: Duration = Duration::from_millis(5);

/// The device's end.
pub(crate) trait Line: Send {
    /// Bytes that have arrived, at most those that fit; none where nothing has.
    fn receive(&mut self, buffer: &mut [u8]) -> usize;

    /// Sends bytes. The host may have gone; then they are not needed.
    fn send(&mut self, bytes: &[u8]);
}

/// A line, and the name of the port that leads to it.
#[cfg(unix)]
pub(crate) fn usual() -> (Box<dyn Line>, String) {
    use serialport::{SerialPort, TTYPort};
    let (mut far_port, near_port) = TTYPort::pair().expect("a pseudo terminal");
    let port = near_port.name().expect("the port has a name");
    // Opened again by its name; kept open here it would be in use.
    drop(near_port);
    far_port.set_timeout(PATIENCE).expect("a timeout");
    (Box::new(far_port), port)
}

/// A line, and the name of the port that leads to it.
#[cfg(not(unix))]
pub(crate) fn usual() -> (Box<dyn Line>, String) {
    tcp("127.0.0.1:0")
}

/// A TCP connection at an address, to one host after the other.
pub(crate) fn tcp(address: &str) -> (Box<dyn Line>, String) {
    let listener = TcpListener::bind(address).expect("the address is free");
    listener.set_nonblocking(true).expect("a listener");
    let port = format!("tcp:{}", listener.local_addr().expect("bound"));
    (Box::new(Tcp { listener, host: None }), port)
}

#[cfg(unix)]
impl Line for serialport::TTYPort {
    fn receive(&mut self, buffer: &mut [u8]) -> usize {
        let waiting = serialport::SerialPort::bytes_to_read(self).unwrap_or_default();
        if waiting > 0 { self.read(buffer).unwrap_or_default() } else { 0 }
    }

    fn send(&mut self, bytes: &[u8]) {
        let _ = self.write_all(bytes);
    }
}

struct Tcp {
    listener: TcpListener,
    host: Option<TcpStream>,
}

impl Line for Tcp {
    fn receive(&mut self, buffer: &mut [u8]) -> usize {
        if let Ok((host, _)) = self.listener.accept() {
            host.set_nonblocking(false).expect("a stream");
            host.set_nodelay(true).expect("a stream");
            host.set_read_timeout(Some(PATIENCE)).expect("a timeout");
            self.host = Some(host);
        }
        let Some(host) = &mut self.host else { return 0 };
        match host.read(buffer) {
            Ok(count @ 1..) => count,
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => 0,
            _ => {
                self.host = None;
                0
            }
        }
    }

    fn send(&mut self, bytes: &[u8]) {
        let sent = self.host.as_mut().map(|host| host.write_all(bytes));
        if sent.is_some_and(|sent| sent.is_err()) {
            self.host = None;
        }
    }
}
