//! The two tasks at the serial port: bytes to commands, and items to frames.
//!
//! Both check in even while no byte arrives or the line is blocked.

use super::{Background, CHECK_IN, COMMANDS, OUTBOX, RECEIVE_COUNTERS};
use crate::board::{BootInfo, pins};
use control::calibration::{Calibration, FORCE_NN_PER_COUNT, POSITION_NM_PER_COUNT};
use control::telemetry::Item;
use control::{DESCRIPTION, OutboundMessage, PERIOD_US};
use defmt::{error, warn};
use embassy_stm32::usart::{BufferedUartRx, BufferedUartTx};
use embassy_time::{Duration, Instant, with_timeout};
use embedded_io_async::{Read, Write};
use protocol::{
    CommandReceiver, Counters, Envelope, Hello, MAX_FRAME_TO_HOST, Message, Received, Refusal, Scales, Text,
    encode_envelope,
};

/// Interval at which free space in the port's buffer is polled.
const ROOM: Duration = Duration::from_millis(10);

#[embassy_executor::task]
pub(super) async fn receive(mut port: BufferedUartRx<'static>) {
    let mut receiver = CommandReceiver::new();
    let mut buffer = [0; 64];
    let (mut line_errors, mut messages_dropped) = (0_u32, 0_u32);
    loop {
        Background::Receive.checks_in();
        match with_timeout(CHECK_IN, port.read(&mut buffer)).await {
            Err(_) => continue,
            Ok(Ok(length)) => {
                for frame in receiver.feed(buffer.get(..length).unwrap_or_default()) {
                    match frame {
                        Received::Frame(command) => COMMANDS.send(command).await,
                        Received::Unreadable(Some(id)) => {
                            let refused =
                                Item::OutboundMessage(OutboundMessage::Refused(id, Refusal::Unreadable));
                            let lost = OUTBOX.try_send(refused).is_err();
                            messages_dropped = messages_dropped.saturating_add(lost.into());
                        }
                        Received::Corrupt | Received::Overlong | Received::Unreadable(None) => {}
                    }
                }
            }
            // Overrun, framing error or noise: the affected frame fails its checksum.
            Ok(Err(_)) => line_errors = line_errors.saturating_add(1),
        }
        let losses = receiver.losses();
        RECEIVE_COUNTERS.lock(|counters| {
            counters.set(Counters {
                messages_dropped,
                frames_corrupt: losses.corrupt,
                frames_overlong: losses.overlong,
                frames_unreadable: losses.unreadable,
                line_errors,
                ..Counters::default()
            });
        });
    }
}

#[embassy_executor::task]
pub(super) async fn send(port: BufferedUartTx<'static>, boot: BootInfo, calibration: &'static Calibration) {
    let mut link = Link { port, boot_id: boot.boot_id, sequence: 0 };
    loop {
        Background::Send.checks_in();
        let Ok(item) = with_timeout(CHECK_IN, OUTBOX.receive()).await else { continue };
        let message = match item {
            Item::Batch(batch) => Message::Samples(batch),
            Item::OutboundMessage(OutboundMessage::Hello) => Message::Hello(hello(&boot, calibration)),
            Item::OutboundMessage(OutboundMessage::Ack(id)) => Message::Ack { id },
            Item::OutboundMessage(OutboundMessage::Refused(id, refusal)) => Message::Refused { id, refusal },
            Item::OutboundMessage(OutboundMessage::Event(event)) => Message::Event(event),
            Item::OutboundMessage(OutboundMessage::Status(status) | OutboundMessage::Report(status)) => {
                Message::Status(status)
            }
            Item::OutboundMessage(OutboundMessage::Connected(connection)) => {
                Message::Connected { connection }
            }
            Item::OutboundMessage(
                OutboundMessage::Safety(safety) | OutboundMessage::SafetyReport(safety),
            ) => Message::Safety(safety),
            Item::OutboundMessage(OutboundMessage::Description) => Message::Description(DESCRIPTION),
            Item::OutboundMessage(OutboundMessage::Calibration) => {
                Message::Calibration(calibration.record().clone())
            }
            // `Telemetry` handles this message and does not queue it.
            Item::OutboundMessage(OutboundMessage::Stream(_)) => continue,
        };
        link.send(message).await;
    }
}

/// Sends the outbox: numbers the frames and writes them.
struct Link {
    port: BufferedUartTx<'static>,
    boot_id: u32,
    sequence: u32,
}

impl Link {
    async fn send(&mut self, message: Message) {
        let envelope = Envelope { boot_id: self.boot_id, sequence: self.sequence, message };
        self.sequence = self.sequence.wrapping_add(1);
        let mut buffer = [0; MAX_FRAME_TO_HOST];
        match encode_envelope(&envelope, &mut buffer) {
            Ok(frame) => self.write(frame).await,
            Err(_) => error!("a message is longer than the longest frame"),
        }
    }

    /// Writes all bytes, however long the line takes. A frame that the port refuses is a gap in the sequence, which the host
    /// counts. The driver may fail to wake a writer that found too little room, so that the port is polled every [`ROOM`].
    async fn write(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            Background::Send.checks_in();
            match with_timeout(ROOM, self.port.write(bytes)).await {
                Err(_) => {}
                Ok(Ok(written)) => bytes = bytes.get(written..).unwrap_or_default(),
                Ok(Err(_)) => return warn!("the serial port refused a frame"),
            }
        }
    }
}

fn hello(boot: &BootInfo, calibration: &Calibration) -> Hello {
    Hello {
        protocol_version: protocol::VERSION,
        schema_hash: protocol::schema_hash(),
        firmware_version: Text::new(env!("CARGO_PKG_VERSION")),
        commit: Text::new(env!("FIRMWARE_GIT")),
        board: Text::new(pins::BOARD_NAME),
        reset_reason: boot.reset_reason,
        tick_hz: 1_000_000,
        now_us: Instant::now().as_micros(),
        sample_period_us: PERIOD_US,
        scales: Scales {
            position_nm_per_count: POSITION_NM_PER_COUNT,
            force_nn_per_count: FORCE_NN_PER_COUNT,
            travel_um: calibration.travel_um(),
            force_range_mn: calibration.force_range_mn(),
        },
        calibration: calibration.id(),
        last_panic: boot.last_panic.clone(),
    }
}
