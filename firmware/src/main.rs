//! The needle guide's program: the board, and the tasks on it. With the feature `flash` it is the image for the board, with
//! the feature `qemu` the same program for QEMU.
#![no_std]
#![no_main]

use firmware::{app, board};

#[cortex_m_rt::entry]
fn main() -> ! {
    app::start(board::take());
    loop {
        app::idle();
    }
}
