//! Message types, framing and loss accounting shared by the firmware and the host.
#![no_std]
#![forbid(unsafe_code)]
#![deny(missing_docs)]
