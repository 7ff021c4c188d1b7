//! The second tier: boards, programs of others, bring-up and characterization, steering, and what a minute does not hold.

mod bags;
mod boards;
mod bringup;
mod characterize;
mod followed;
mod foreign;
mod hazards;
mod hidden;
mod igtl;
mod image;
mod machine;
mod python;
mod registers;
mod steer;
mod web;
