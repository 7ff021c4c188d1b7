//! Hardware-independent control of the needle guide.
#![cfg_attr(not(test), no_std)]
#![deny(missing_docs)]
