//! No code. Its manifest requests the features of libraries that some crates of the workspace need, for all that reads files.
//!
//! Cargo compiles a library again, with everything above it, for every set of features that a selection of crates comes to. With one set, a
//! build of the program, the tests of one crate, those of the workspace and the Python module share what they are made of, and what is
//! tested is what is shipped.
#![forbid(unsafe_code)]
#![deny(missing_docs)]
