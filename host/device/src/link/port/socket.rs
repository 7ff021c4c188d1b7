//! Ports that are sockets: a server, on this machine or another one, that passes the bytes of a serial port on, or a simulated device.
//!
//! `tcp:HOST:PORT` is a TCP connection, the path of a Unix domain socket is one to that. Only the device's bytes go
//! over either.

use super::{Ends, READ_TIMEOUT};
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

/// Prefix of the names of TCP ports.
const TCP: &str = "tcp:";
/// Time within which a server has to accept a connection.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(3);

/// Connects to the socket of this name; `None` where the name is not one of a socket.
pub(super) fn connect(name: &str) -> Option<io::Result<Ends>> {
    match name.strip_prefix(TCP) {
        Some(address) => Some(tcp(address)),
        None => unix::connect(name),
    }
}

fn tcp(address: &str) -> io::Result<Ends> {
    let mut failed = io::Error::new(ErrorKind::NotFound, "this name has no address");
    for address in address.to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                // A command is a few bytes, and the device waits for it.
                stream.set_nodelay(true)?;
                stream.set_read_timeout(Some(READ_TIMEOUT))?;
                stream.set_write_timeout(Some(READ_TIMEOUT))?;
                return Ok(Ends {
                    reader: Box::new(Stream(stream.try_clone()?)),
                    writer: Box::new(Stream(stream)),
                });
            }
            Err(error) => failed = error,
        }
    }
    Err(failed)
}

#[cfg(unix)]
mod unix {
    use super::{Ends, READ_TIMEOUT, Stream};
    use std::io;
    use std::os::unix::fs::FileTypeExt;
    use std::os::unix::net::UnixStream;

    pub(super) fn connect(path: &str) -> Option<io::Result<Ends>> {
        let is_socket = std::fs::metadata(path).is_ok_and(|found| found.file_type().is_socket());
        is_socket.then(|| {
            let stream = UnixStream::connect(path)?;
            stream.set_read_timeout(Some(READ_TIMEOUT))?;
            stream.set_write_timeout(Some(READ_TIMEOUT))?;
            Ok(Ends { reader: Box::new(Stream(stream.try_clone()?)), writer: Box::new(Stream(stream)) })
        })
    }
}

#[cfg(not(unix))]
mod unix {
    pub(super) fn connect(_: &str) -> Option<std::io::Result<super::Ends>> {
        None
    }
}

/// A stream that reports like a serial port: a timeout as one, and an end, which a port has only where it is gone, as an error.
struct Stream<S>(S);

impl<S: Read> Read for Stream<S> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        match self.0.read(buffer) {
            Ok(0) if !buffer.is_empty() => {
                Err(io::Error::new(ErrorKind::UnexpectedEof, "the other end closed the connection"))
            }
            other => other.map_err(timeout),
        }
    }
}

impl<S: Write> Write for Stream<S> {
    fn write(&mut self, buffer: &[u8]) -> io::Result<usize> {
        self.0.write(buffer).map_err(timeout)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush().map_err(timeout)
    }
}

/// On Unix a timeout of a socket is reported as one that would block.
fn timeout(error: io::Error) -> io::Error {
    if error.kind() == ErrorKind::WouldBlock { ErrorKind::TimedOut.into() } else { error }
}

// The server passes the bytes of a pseudo terminal on.
#[cfg(all(test, unix))]
mod tests {
    use super::super::PortError;
    use crate::link::{Client, LinkError};
    use fake_device::{FakeDevice, Script};
    use serialport::TTYPort;
    use std::io::{ErrorKind, Read, Write};
    use std::net::{Shutdown, TcpListener, TcpStream};
    use std::thread::{self, JoinHandle};
    use std::time::Duration;

    /// Passes the bytes of a serial port on to the first client, until that one or the port is gone.
    fn serve(listener: TcpListener, port: String) -> JoinHandle<()> {
        thread::spawn(move || {
            let (client, _) = listener.accept().expect("a client");
            let timeout = Duration::from_millis(5);
            let mut serial: TTYPort =
                serialport::new(port, 460_800).timeout(timeout).open_native().expect("opens");
            let mut to_device = serial.try_clone_native().expect("clones");
            let mut from_client = client.try_clone().expect("clones");
            let forward = thread::spawn(move || {
                let mut bytes = [0; 256];
                while let Ok(count @ 1..) = from_client.read(&mut bytes) {
                    if to_device.write_all(&bytes[..count]).is_err() {
                        return;
                    }
                }
            });
            back(&mut serial, &client);
            let _ = client.shutdown(Shutdown::Both);
            forward.join().expect("no panic");
        })
    }

    fn back(serial: &mut TTYPort, mut client: &TcpStream) {
        let mut bytes = [0; 256];
        loop {
            let count = match serial.read(&mut bytes) {
                Ok(count @ 1..) => count,
                Err(error) if error.kind() == ErrorKind::TimedOut => 0,
                _ => return,
            };
            if client.write_all(&bytes[..count]).is_err() || is_closed(client) {
                return;
            }
        }
    }

    fn is_closed(client: &TcpStream) -> bool {
        client.set_read_timeout(Some(Duration::from_millis(1))).expect("a stream");
        matches!(client.peek(&mut [0]), Ok(0))
    }

    /// A client of a device behind a server.
    fn behind_a_server(device: &FakeDevice) -> (Client, JoinHandle<()>) {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        let name = format!("tcp:{}", listener.local_addr().expect("bound"));
        let server = serve(listener, device.port.clone());
        (Client::connect(&name).expect("connects"), server)
    }

    #[test]
    fn a_device_behind_a_server_is_like_one_at_a_port() {
        let device = FakeDevice::start(Script::default());
        let (mut client, server) = behind_a_server(&device);
        client.status().expect("answers");
        drop(client);
        server.join().expect("no panic");
    }

    #[test]
    fn a_server_that_ends_is_a_port_that_is_gone() {
        let device = FakeDevice::start(Script::default());
        let (mut client, server) = behind_a_server(&device);
        drop(device);
        let error = (0..50).find_map(|_| client.status().err()).expect("it is gone");
        assert!(matches!(error, LinkError::Gone { .. }), "{error}");
        drop(client);
        server.join().expect("no panic");
    }

    #[test]
    fn an_address_without_a_server_is_named_with_what_is_valid() {
        let unused = TcpListener::bind("127.0.0.1:0").and_then(|bound| bound.local_addr()).expect("a port");
        for name in [format!("tcp:{unused}"), "tcp:nowhere".to_owned()] {
            let error = Client::connect(&name).err().expect("nobody there");
            assert!(matches!(error, LinkError::Port(PortError::NoServer { .. })), "{error:?}");
            assert!(error.to_string().contains("tcp:HOST:PORT"), "{error}");
        }
    }
}
