//! Bring-up program: reads the sensors, drives the bridges, echoes the serial port.
#![no_std]
#![no_main]

use embassy_executor::Spawner;
use embassy_time::{Duration, Ticker};
use embedded_io_async::{Read, Write};
use firmware::board::{self, BoardActuators, BoardPanel, BoardSensors, pins};
use firmware::hal::{Actuators, Panel, Sensors};

#[embassy_executor::task]
async fn control(mut sensors: BoardSensors, mut actuators: BoardActuators) {
    let mut ticker = Ticker::every(Duration::from_micros(pins::CONTROL_PERIOD_US));
    loop {
        ticker.next().await;
        let readings = sensors.read();
        match readings.force_codes {
            Ok([x, y]) if !readings.emergency_stop => {
                actuators.drive([x as f32 / 8_388_608.0, y as f32 / 8_388_608.0]);
            }
            _ => actuators.release(),
        }
    }
}

#[embassy_executor::task]
async fn blink(mut panel: BoardPanel) {
    let mut ticker = Ticker::every(Duration::from_millis(100));
    for step in 0.. {
        panel.led(step % 2 == 0);
        panel.feed_watchdog();
        ticker.next().await;
    }
}

#[embassy_executor::main]
async fn main(spawner: Spawner) {
    let board = board::take();
    defmt::info!("firmware {=str}, {}", env!("FIRMWARE_GIT"), board.boot);
    board.control.spawn(control(board.sensors, board.actuators).expect("spawned once"));
    spawner.spawn(blink(board.panel).expect("spawned once"));
    let mut serial = board.serial;
    let mut bytes = [0; 64];
    loop {
        let count = serial.read(&mut bytes).await.expect("the serial port reads");
        serial.write_all(&bytes[..count]).await.expect("the serial port writes");
    }
}
