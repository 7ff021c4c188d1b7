//! OpenIGTLink, the network protocol of image-guided therapy (3D Slicer, PLUS, trackers): messages go out to clients, needle shapes
//! and tips come in.
//!
//! * [`message`]: the messages and their bytes; [`wire`]: what arrives on a connection, cut into messages.
//! * [`image`]: frames of a scanner; [`capture`]: frames that become a sequence.
//! * [`server`]: clients that receive every message, none of which is waited for.
//! * [`source`]: a tracker that sends where the needle is; [`clock`]: when that was, on the device's clock; [`channel`]: both as the
//!   ultrasound of a recording; [`tracked`]: what of it is no measurement.
//!
//! No input is trusted: sizes are limited before anything is kept, checksums are compared, a peer that stops in the
//! middle of a message is left. Messages are written as protocol version 1 and 2 have them (header version 1, which
//! every peer reads); header version 2 with its metadata is read too. Coordinates on the wire are millimetres.

pub mod capture;
pub mod channel;
pub mod clock;
pub mod image;
pub mod message;
pub mod server;
pub mod source;
mod tracked;
pub mod wire;

pub use channel::Channel;
pub use message::{Content, Message, Pose};
pub use server::Publisher;
pub use source::Source;

/// The protocol's port.
pub const PORT: u16 = 18_944;

/// Why there is no connection, or why it ended.
#[derive(Debug, thiserror::Error)]
pub enum IgtlError {
    /// No address.
    #[error("`{text}`: {problem}, expected HOST or HOST:PORT")]
    Address {
        /// Text of the option.
        text: String,
        /// Problem of the text.
        problem: String,
    },
    /// No server is there.
    #[error("cannot connect to OpenIGTLink at {address}: {cause}")]
    Connect {
        /// Address.
        address: String,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The address cannot be served at.
    #[error("cannot serve OpenIGTLink at {address}: {cause}")]
    Serve {
        /// Address.
        address: String,
        /// The system's error.
        cause: std::io::Error,
    },
    /// The system gives no thread.
    #[error("cannot start a thread for OpenIGTLink: {0}")]
    Thread(std::io::Error),
}

/// Splits `HOST[:PORT]`; an IPv6 address with a port is in brackets.
///
/// # Errors
/// [`IgtlError::Address`].
pub fn host_and_port(text: &str) -> Result<(String, u16), IgtlError> {
    fn fault(problem: &str, text: &str) -> IgtlError {
        IgtlError::Address { text: text.to_owned(), problem: problem.to_owned() }
    }
    let (host, port) = match text.strip_prefix('[') {
        Some(rest) => {
            let (host, port_text) =
                rest.split_once(']').ok_or_else(|| fault("a bracket is not closed", text))?;
            (host, (!port_text.is_empty()).then(|| port_text.strip_prefix(':').unwrap_or(port_text)))
        }
        // More than one colon: an IPv6 address without a port.
        None => match text.split_once(':') {
            Some((host, port)) if !port.contains(':') => (host, Some(port)),
            _ => (text, None),
        },
    };
    if host.is_empty() {
        return Err(fault("no host", text));
    }
    let port = match port {
        Some(port) => port.parse().map_err(|_| fault("the port is no number from 0 to 65535", text))?,
        None => PORT,
    };
    Ok((host.to_owned(), port))
}

#[cfg(test)]
mod server_tests;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod tracked_tests;
