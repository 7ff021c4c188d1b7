//! Common parts of all files: errors with the place of a fault, fields of TOML documents, tables of numbers in CSV,
//! reading and writing of whole texts.

mod error;
mod fields;
pub(crate) mod names;
pub(crate) mod table;
mod write;

pub(crate) use error::split_message;
pub use error::{Place, Problem, SessionError, read_foreign_text, read_text};
pub use fields::Fields;
pub use write::replace;
pub(crate) use write::{io, number};
