//! What the end-to-end tests and the xtask binary share.
#![deny(missing_docs)]
