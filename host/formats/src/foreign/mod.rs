//! Tables of other laboratories and programs, as runs of a session: any separator, decimal comma, encoding, header, unit and time base.
//!
//! 1. [`Grid`]: the cells of a file, as text.
//! 2. [`RawTable`]: where the rows of numbers are, what their columns are named, and in which unit they are.
//! 3. [`Mapping`]: which column is which quantity of the session, as the user states it and as names and units show.
//! 4. [`Taken`]: the series of a run, on one clock and in SI, with what was taken for what.
//!
//! Every assumption is stated: a column without a unit is an error that asks for it, and [`Taken`] states everything
//! that was found.

mod align;
mod apply;
#[cfg(feature = "bags")]
mod bag;
mod cells;
mod drift;
mod dropouts;
#[cfg(feature = "excel")]
mod excel;
mod find;
mod forms;
mod grid;
mod left_out;
mod mapping;
mod marks;
#[cfg(feature = "matlab")]
mod mat;
mod names;
mod raw;
mod readings;
mod remarks;
mod stamp;
mod stated_rate;
mod stated_unit;
mod status;
mod summary;
mod thousands;
mod unit;

pub use align::{Offset, OffsetError, clock_contradiction};
pub use apply::{Options, Taken, TakenColumn, ZOrigin, Zero, take};
pub use drift::Drift;
pub use dropouts::zeros_among_forces;
pub use grid::{Grid, of_other_format};
pub use mapping::{Choice, Mapping, Target};
pub use raw::{RawColumn, RawTable, WordColumn};
pub use remarks::{ONE_ZERO, Remark, new_zero_among_forces};
pub use stated_rate::StatedRate;
pub use stated_unit::UnitDoubt;
pub use unit::{Quantity, Unit};

use std::path::PathBuf;

/// Formats that are read as a table: names of files, and what of their formats.
pub const READ: &[[&str; 2]] = &[
    [
        ".csv, .txt, .tsv, any name",
        "between commas, semicolons, tabulators, bars or blanks; decimal points or commas; UTF-8, UTF-16 or Latin-1; preambles; units in names or below them",
    ],
    #[cfg(feature = "excel")]
    [
        ".xlsx, .xlsm, .xlsb, .xls, .ods",
        "the first sheet with readings that is shown, or the one behind #: book.xlsx#Push; without hidden rows, which .xlsb and .xls do not tell",
    ],
    #[cfg(feature = "matlab")]
    [
        ".mat",
        "MATLAB up to version 7: numeric arrays, also in structures; a matrix is a column for each of its shorter side: data.x, m(:,2)",
    ],
    #[cfg(feature = "bags")]
    [
        ".mcap",
        "bags of ROS 2: WrenchStamped, PoseStamped, PointStamped, Vector3Stamped, JointState, Float64 and Float32 in CDR, a table for each topic; chunks by zstd, lz4 or uncompressed",
    ],
];

/// Endings of tables in a folder, beside which other files may lie.
pub const ENDINGS: &[&str] = &[
    "csv",
    "txt",
    "tsv",
    "dat",
    "asc",
    "lvm",
    #[cfg(feature = "excel")]
    "xlsx",
    #[cfg(feature = "excel")]
    "xlsm",
    #[cfg(feature = "excel")]
    "xlsb",
    #[cfg(feature = "excel")]
    "xls",
    #[cfg(feature = "excel")]
    "ods",
    #[cfg(feature = "matlab")]
    "mat",
    #[cfg(feature = "bags")]
    "mcap",
];

/// Why a table is no run.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    /// The operating system refuses the file.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Report of the operating system.
        cause: std::io::Error,
    },
    /// Something in a file is not what was expected there.
    #[error("{}:{line}: {field}: {problem}, expected {expected}", path.display())]
    Cell {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column.
        field: String,
        /// Content of the file.
        problem: String,
        /// Valid content.
        expected: String,
    },
    /// A file as a whole.
    #[error("{}: {problem}, expected {expected}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// Problem.
        problem: String,
        /// Valid content.
        expected: String,
    },
    /// A mapping that means nothing here.
    #[error("{choice}: {problem}, expected {expected}")]
    Map {
        /// The choice, as it was given.
        choice: String,
        /// Problem.
        problem: String,
        /// Valid content.
        expected: String,
    },
    /// Several things that are missing, all at once.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("; "))]
    Several(Vec<Self>),
    /// Two clocks that cannot be brought together.
    #[error(transparent)]
    Offset(#[from] OffsetError),
    /// The mapping's file.
    #[error(transparent)]
    Document(#[from] crate::document::SessionError),
}

impl TableError {
    fn io(path: &std::path::Path, cause: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), cause }
    }
}

#[cfg(test)]
mod dropout_tests;
#[cfg(test)]
mod layout_tests;
#[cfg(test)]
mod left_out_tests;
#[cfg(test)]
mod positions_tests;
#[cfg(test)]
mod stated_tests;
#[cfg(test)]
mod tests;
