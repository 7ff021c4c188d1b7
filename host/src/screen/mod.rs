//! The screen of `guide monitor`: the [`view`] draws the state of [`device::monitor`]. Only the program handles a real terminal and
//! keys.

pub mod view;

mod numbers;
mod plots;

#[cfg(test)]
#[path = "../../device/src/monitor/testing.rs"]
mod testing;

pub use view::{Screen, Settings};
