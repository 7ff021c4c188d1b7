//! The discrepancy workflow: where model and measurement disagree, which effect is missing, and what adding it is worth.

pub mod blind;
