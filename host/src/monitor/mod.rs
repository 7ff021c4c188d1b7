//! `guide monitor`: what the device does, live.
//!
//! The [`worker`] owns the link and tells what happens on it; the [`State`] is what is known from that; the [`view`] draws
//! it. Only the program knows of a real terminal and of keys.

pub mod health;
pub mod report;
pub mod state;
pub mod traces;
pub mod view;
pub mod worker;

mod numbers;
mod pace;
mod plots;
mod session;

#[cfg(test)]
mod testing;

pub use state::{Event, State};
pub use view::{Screen, Settings};
pub use worker::{Order, Worker};
