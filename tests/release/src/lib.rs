//! The bundle of a release: its archives, its manifest and its checksums.
//!
//! | module | does |
//! |---|---|
//! | [`archive`] | archives whose bytes depend on their content only, and unpacking them |
//! | [`manifest`] | what is in a bundle: sizes, checksums, versions, licences |
#![forbid(unsafe_code)]
#![deny(missing_docs)]

pub mod archive;
pub mod manifest;
