//! The needle guide's program: the board, and the tasks on it. With the feature `flash` it is the image for the board, with
//! the feature `qemu` the same program for QEMU.
#![no_std]
#![no_main]

use embassy_executor::Spawner;
use firmware::{app, board};

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    app::start(spawner, board::take());
}
