//! What long trials of the firmware have in common: the books of its samples, and a cable that is cut now and then.

mod books;
mod cuts;

pub use books::Books;
pub use cuts::Cuts;
