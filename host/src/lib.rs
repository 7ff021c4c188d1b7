//! Physical model, inference, link and simulated rig of the needle guide.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
