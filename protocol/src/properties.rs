//! Properties of random messages, random streams and random damage. Host only.

use crate::{
    CalibrationId, CalibrationRecord, CalibrationSource, Command, CommandReceiver, Counters, Description,
    Envelope, EnvelopeReceiver, Event, EventKind, Fault, Hello, Incoming, KNOTS, Load, Losses,
    MAX_CALIBRATION, MAX_FRAME_TO_DEVICE, MAX_FRAME_TO_HOST, Message, Outcome, PACKED_BYTES, PIECE_BYTES,
    Packed, Packer, PotentiometerTable, Received, Receiver, Refusal, Request, ResetReason, Safety, Sample,
    Samples, Scales, SequenceTracker, State, Status, Step, Stiffness, Tare, Text, encode_command,
    encode_envelope, peek_hello_version,
};
use proptest::{collection::vec, prelude::*, sample::select};
use std::{vec, vec::Vec};

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        any::<(i32, i32, u32)>().prop_map(|(x_um, y_um, speed_um_s)| Step::Move { x_um, y_um, speed_um_s }),
        any::<u32>().prop_map(|duration_ms| Step::Hold { duration_ms }),
        any::<u32>().prop_map(|duration_ms| Step::Tare { duration_ms }),
        any::<(i32, i32, u32)>().prop_map(|(x_um, y_um, duration_ms)| Step::Ramp { x_um, y_um, duration_ms }),
    ]
}

fn command() -> impl Strategy<Value = Command> {
    let request = prop_oneof![
        select(vec![
            Request::Hello,
            Request::Status,
            Request::Stop,
            Request::ClearFault,
            Request::Calibration,
            Request::AcknowledgeCalibration,
            Request::Describe,
            Request::Safety,
        ]),
        any::<(i32, i32)>().prop_map(|(x_um, y_um)| Request::Retreat { x_um, y_um }),
        any::<(u8, i16, u8)>().prop_map(|(axis, duty_permille, duration_ms)| Request::Pulse {
            axis,
            duty_permille,
            duration_ms
        }),
        any::<bool>().prop_map(|enable| Request::Stream { enable }),
        (any::<u8>(), step()).prop_map(|(index, step)| Request::LoadStep { index, step }),
        any::<(u8, u32, u64)>().prop_map(|(steps, crc, start_us)| Request::Run { steps, crc, start_us }),
        any::<(u32, u32)>().prop_map(|(force_mn, silence_ms)| Request::Limits { force_mn, silence_ms }),
        any::<(u8, [u8; PIECE_BYTES])>().prop_map(|(piece, bytes)| Request::LoadCalibration { piece, bytes }),
        any::<(u8, u32)>().prop_map(|(length, crc)| Request::StoreCalibration { length, crc }),
    ];
    (any::<u16>(), any::<u32>(), request).prop_map(|(id, connection, request)| Command {
        id,
        connection,
        request,
    })
}

const STATES: [State; 7] = [
    State::Idle,
    State::Pending,
    State::Moving,
    State::Holding,
    State::Taring,
    State::Faulted,
    State::Retreating,
];

fn hello() -> impl Strategy<Value = Hello> {
    use ResetReason::{BrownOut, Other, Pin, PowerOn, Software, Watchdog};
    let reasons = select(vec![PowerOn, Pin, Watchdog, Software, BrownOut, Other]);
    let texts = (".{0,20}", ".{0,24}", ".{0,30}");
    let scales = any::<[u32; 4]>().prop_map(|[position, force, travel_um, force_range_mn]| Scales {
        position_nm_per_count: position,
        force_nn_per_count: force,
        travel_um,
        force_range_mn,
    });
    let calibration =
        (".{0,20}", any::<u32>()).prop_map(|(id, crc)| CalibrationId { id: Text::new(&id), crc });
    let last_panic = prop::option::of(".{0,100}");
    (any::<(u16, [u8; 8], u32, u64, u32)>(), texts, reasons, scales, calibration, last_panic).prop_map(
        |(numbers, texts, reset_reason, scales, calibration, last_panic)| Hello {
            protocol_version: numbers.0,
            schema_hash: numbers.1,
            firmware_version: Text::new(&texts.0),
            commit: Text::new(&texts.1),
            board: Text::new(&texts.2),
            reset_reason,
            tick_hz: numbers.2,
            now_us: numbers.3,
            sample_period_us: numbers.4,
            scales,
            calibration,
            last_panic: last_panic.map(|text| Text::new(&text)),
        },
    )
}

fn samples() -> impl Strategy<Value = Samples> {
    (any::<(u64, u32, u8, u8, u32)>(), select(&STATES[..]), vec(any::<u8>(), 0..=PACKED_BYTES)).prop_map(
        |((t_us, dropped, step, count, repeats_force), state, bytes)| Samples {
            t_us,
            dropped,
            state,
            step,
            count,
            packed: Packed::from_slice(&bytes).expect("as many as fit"),
            repeats_force,
        },
    )
}

fn counters() -> impl Strategy<Value = Counters> {
    any::<[u32; 13]>().prop_map(|counts| Counters {
        samples_dropped: counts[0],
        messages_dropped: counts[1],
        frames_corrupt: counts[2],
        frames_overlong: counts[3],
        frames_unreadable: counts[4],
        force_readings_bad: counts[5],
        control_overruns: counts[6],
        line_errors: counts[7],
        force_corrupt: counts[8],
        force_missing: counts[9],
        force_resets: counts[10],
        force_saturated: counts[11],
        faults: counts[12],
    })
}

fn status() -> impl Strategy<Value = Status> {
    let fault = prop::option::of(select(&Fault::ALL[..]));
    let load = any::<(u16, u16, u16, u32, u8)>().prop_map(
        |(cpu_permille, longest_period_us, latest_start_us, stack_free_bytes, outbox_most)| Load {
            cpu_permille,
            longest_period_us,
            latest_start_us,
            stack_free_bytes,
            outbox_most,
        },
    );
    let stiffness = || {
        prop::option::of(any::<(i32, u32, u32)>().prop_map(|(slope_mn_per_m, sd_mn_per_m, readings)| {
            Stiffness { slope_mn_per_m, sd_mn_per_m, readings }
        }))
    };
    let numbers = any::<(u64, u8, [i32; 2], [i32; 2], [bool; 2], [u16; 2], [u32; 2])>();
    (numbers, select(&STATES[..]), fault, counters(), load, [stiffness(), stiffness()]).prop_map(
        |(numbers, state, fault, counters, load, stiffness)| Status {
            t_us: numbers.0,
            state,
            step: numbers.1,
            fault,
            position_counts: numbers.2,
            force_counts: numbers.3,
            streaming: numbers.4[0],
            counters,
            load,
            motor_budget_permille: numbers.5,
            force_limit_mn: numbers.6[0],
            silence_limit_ms: numbers.6[1],
            stiffness,
            repeats_force: numbers.4[1],
        },
    )
}

fn table() -> impl Strategy<Value = PotentiometerTable> {
    any::<([u16; 2], [i16; KNOTS], [i16; KNOTS])>().prop_map(|(track_codes, rising_um, falling_um)| {
        PotentiometerTable { track_codes, rising_um, falling_um }
    })
}

fn calibration() -> impl Strategy<Value = CalibrationRecord> {
    (".{0,20}", [table(), table()], any::<(u32, [[i32; 2]; 2], u32)>()).prop_map(
        |(id, potentiometers, (travel_um, force_pn_per_code, force_range_mn))| CalibrationRecord {
            id: Text::new(&id),
            potentiometers,
            travel_um,
            force_pn_per_code,
            force_range_mn,
        },
    )
}

fn safety() -> impl Strategy<Value = Safety> {
    use CalibrationSource::{Nominal, NominalAcknowledged, Stored};
    let sources = select(vec![Stored, Nominal, NominalAcknowledged]);
    any::<(u64, bool, [i32; 2], [u16; 2], [bool; 2])>().prop_flat_map(move |numbers| {
        let (t_us, tared, zero_counts, cools_in_s, proven) = numbers;
        sources.clone().prop_map(move |calibration| Safety {
            t_us,
            calibration,
            tared,
            zero_counts,
            cools_in_s,
            proven,
        })
    })
}

fn description() -> impl Strategy<Value = Description> {
    any::<(u16, [u8; 8], [u8; 3], [u32; 4], u64, [u32; 2])>().prop_map(
        |(protocol_version, schema_hash, bytes, numbers, start_limit_us, silence_limit_ms)| {
            let ([max_steps, answers_remembered, connections], [speed, duration, tare, retreat]) =
                (bytes, numbers);
            Description {
                protocol_version,
                schema_hash,
                max_steps,
                speed_limit_um_s: speed,
                duration_limit_ms: duration,
                tare_limit_ms: tare,
                start_limit_us,
                retreat_limit_um: retreat,
                silence_limit_ms,
                answers_remembered,
                connections,
            }
        },
    )
}

fn event() -> impl Strategy<Value = Event> {
    let kind = prop_oneof![
        any::<u8>().prop_map(|index| EventKind::StepStarted { index }),
        any::<u8>().prop_map(|index| EventKind::StepEnded { index }),
        any::<([i32; 2], [u32; 2], [i32; 2], u32, u32, [u8; 2])>().prop_map(
            |(zero_counts, sd_counts, drift_counts_per_s, periods, readings, unique_codes)| {
                EventKind::Tared(Tare {
                    zero_counts,
                    sd_counts,
                    drift_counts_per_s,
                    periods,
                    readings,
                    unique_codes,
                })
            }
        ),
        select(vec![Outcome::Completed, Outcome::Stopped, Outcome::Faulted])
            .prop_map(|outcome| EventKind::ProgramEnded { outcome }),
        select(&Fault::ALL[..]).prop_map(|fault| EventKind::Faulted { fault }),
    ];
    (any::<u64>(), kind).prop_map(|(t_us, kind)| Event { t_us, kind })
}

fn envelope() -> impl Strategy<Value = Envelope> {
    use Refusal::{
        Busy, CalibrationInvalid, CalibrationNotAcknowledged, CauseRemains, IdUsed, NotUnderLoad, OtherBoot,
        OutOfRange, OutOfTravel, ProgramMismatch, TooLate, Unreadable,
    };
    let plain = [
        OtherBoot,
        Busy,
        OutOfTravel,
        OutOfRange,
        ProgramMismatch,
        TooLate,
        CauseRemains,
        Unreadable,
        CalibrationInvalid,
        IdUsed,
        NotUnderLoad,
        CalibrationNotAcknowledged,
    ];
    let refusal = prop_oneof![
        select(plain.to_vec()),
        select(&Fault::ALL[..]).prop_map(|fault| Refusal::Faulted { fault }),
    ];
    let message = prop_oneof![
        hello().prop_map(Message::Hello),
        any::<u16>().prop_map(|id| Message::Ack { id }),
        (any::<u16>(), refusal).prop_map(|(id, refusal)| Message::Refused { id, refusal }),
        any::<u32>().prop_map(|connection| Message::Connected { connection }),
        safety().prop_map(Message::Safety),
        description().prop_map(Message::Description),
        samples().prop_map(Message::Samples),
        event().prop_map(Message::Event),
        status().prop_map(Message::Status),
        calibration().prop_map(Message::Calibration),
    ];
    (any::<u32>(), any::<u32>(), message).prop_map(|(boot_id, sequence, message)| Envelope {
        boot_id,
        sequence,
        message,
    })
}

fn frame_of(envelope: &Envelope) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME_TO_HOST];
    encode_envelope(envelope, &mut buffer).expect("the bound suffices").to_vec()
}

/// Events and losses of a stream that arrives in chunks of this length.
fn events<T: Incoming, const N: usize>(stream: &[u8], chunk: usize) -> (Vec<Received<T>>, Losses) {
    let mut receiver = Receiver::<T, N>::new();
    let mut events = Vec::new();
    for chunk in stream.chunks(chunk) {
        events.extend(receiver.feed(chunk));
    }
    (events, receiver.losses())
}

/// Bytes of a line: arbitrary ones, ones with many delimiters, and whole frames.
fn stream() -> impl Strategy<Value = Vec<u8>> {
    let segment = prop_oneof![
        vec(any::<u8>(), 0..400),
        vec(select(vec![0, 1, 2, 0xFF]), 0..400),
        envelope().prop_map(|envelope| frame_of(&envelope)),
    ];
    vec(segment, 0..8).prop_map(|parts| parts.concat())
}

proptest! {
    #[test]
    fn every_command_survives(command in command()) {
        let mut buffer = [0; MAX_FRAME_TO_DEVICE];
        let frame = encode_command(&command, &mut buffer).expect("the bound suffices");
        let received: Vec<_> = CommandReceiver::new().feed(frame).collect();
        prop_assert_eq!(received, [Received::Frame(command)]);
    }

    #[test]
    fn every_envelope_survives(envelope in envelope()) {
        let received: Vec<_> = EnvelopeReceiver::new().feed(&frame_of(&envelope)).collect();
        prop_assert_eq!(received, [Received::Frame(envelope)]);
    }

    #[test]
    fn every_calibration_survives_and_no_part_of_it_decodes(record in calibration(), cut in any::<prop::sample::Index>()) {
        let mut buffer = [0; MAX_CALIBRATION];
        let bytes = record.encode(&mut buffer);
        prop_assert_eq!(CalibrationRecord::decode(bytes), Some(record.clone()));
        prop_assert_eq!(CalibrationRecord::decode(&bytes[..cut.index(bytes.len())]), None);
    }

    #[test]
    fn every_hello_gives_its_version(hello in hello(), boot_id: u32, sequence: u32) {
        let version = hello.protocol_version;
        let envelope = Envelope { boot_id, sequence, message: Message::Hello(hello) };
        let payload = postcard::to_slice(&envelope, &mut [0; MAX_FRAME_TO_HOST]).map(|bytes| peek_hello_version(bytes));
        prop_assert_eq!(payload, Ok(Some(version)));
    }

    #[test]
    fn any_bytes_are_survived_and_chunks_do_not_matter(stream in stream(), chunk in 1_usize..300) {
        let whole = events::<Envelope, { crate::frame::MAX_BODY_TO_HOST }>(&stream, usize::MAX);
        let host_events = events::<Envelope, { crate::frame::MAX_BODY_TO_HOST }>(&stream, chunk);
        prop_assert_eq!(whole, host_events);
        let whole = events::<Command, { crate::frame::MAX_BODY_TO_DEVICE }>(&stream, usize::MAX);
        let device_events = events::<Command, { crate::frame::MAX_BODY_TO_DEVICE }>(&stream, chunk);
        prop_assert_eq!(whole, device_events);
    }

    #[test]
    fn any_batch_unpacks_to_its_count_or_not_at_all(samples in samples(), period_us: u32) {
        if let Ok(unpacked) = samples.unpack(period_us) {
            prop_assert_eq!(unpacked.count(), usize::from(samples.count));
        }
    }

    #[test]
    fn the_packer_loses_and_reorders_nothing(
        readings in vec((any::<[i32; 4]>(), 0_u32..16, 0_u8..24, 0_u64..40), 1..300),
        small: bool,
    ) {
        const PERIOD_US: u32 = 1_000;
        let mut t_us = 0;
        let (mut state, mut dropped) = (State::Idle, 0);
        let mut packer = Packer::new(PERIOD_US);
        let (mut put, mut received, mut heads) = (Vec::new(), Vec::new(), Vec::new());
        let mut take = |batch: Option<Samples>| if let Some(batch) = batch {
            for (t_us, sample) in batch.unpack(PERIOD_US).expect("what was packed can be unpacked") {
                received.push((t_us, sample));
                heads.push((batch.state, batch.step, batch.dropped));
            }
        };
        let mut tags = Vec::new();
        for ([px, py, fx, fy], dropping, index, gap) in readings {
            let shift = if small { 24 } else { 0 };
            let sample = Sample {
                position_counts: [px >> shift, py >> shift],
                force_counts: [fx >> shift, fy >> shift],
                repeats_force: fy & 3 == 0,
            };
            t_us += u64::from(PERIOD_US) + if gap == 0 { 17 } else { 0 };
            state = STATES.get(usize::from(index)).copied().unwrap_or(state);
            dropped += u32::from(dropping == 0);
            put.push((t_us, sample));
            tags.push((state, 7, dropped));
            take(packer.push(t_us, state, 7, dropped, sample));
        }
        take(packer.flush());
        prop_assert_eq!(put, received);
        prop_assert_eq!(tags, heads);
    }

    /// Messages of version 5 and earlier lack the last field.
    #[test]
    fn samples_and_states_of_earlier_versions_are_read(samples in samples(), status in status()) {
        let samples = Samples { repeats_force: 0, ..samples };
        let status = Status { repeats_force: false, ..status };
        for message in [Message::Samples(samples), Message::Status(status)] {
            let envelope = Envelope { boot_id: 7, sequence: 8, message };
            let mut buffer = [0; 2 * MAX_FRAME_TO_HOST];
            let payload = postcard::to_slice(&envelope, &mut buffer).expect("encodes");
            let earlier = &payload[..payload.len() - 1];
            let mut plain = [0; crate::frame::MAX_PLAIN];
            plain[..earlier.len()].copy_from_slice(earlier);
            let mut line = [0; MAX_FRAME_TO_HOST];
            let frame = crate::frame::seal(&mut plain, earlier.len(), &mut line).expect("fits");
            let arrived: Vec<_> = EnvelopeReceiver::new().feed(frame).collect();
            prop_assert_eq!(arrived, [Received::Frame(envelope)]);
        }
    }

    #[test]
    fn damage_loses_the_touched_frames_and_no_other(
        envelopes in vec(envelope(), 1..12),
        damage in vec((any::<prop::sample::Index>(), 1_u8..), 1..5),
    ) {
        let mut line = Vec::new();
        let mut ends = Vec::new();
        for envelope in &envelopes {
            line.extend(frame_of(envelope));
            ends.push(line.len());
        }
        let mut touched = vec![false; envelopes.len()];
        for (at, flip) in damage {
            let byte_index = at.index(line.len());
            line[byte_index] ^= flip;
            touched[ends.partition_point(|&end| end <= byte_index)] = true;
        }
        line.push(0);
        let mut receiver = EnvelopeReceiver::new();
        let received: Vec<_> = receiver
            .feed(&line)
            .filter_map(|event| match event {
                Received::Frame(envelope) => Some(envelope),
                _ => None,
            })
            .collect();
        let sure = envelopes.iter().zip(&touched).filter(|(_, touched)| !**touched).map(|(envelope, _)| envelope);
        // Everything untouched arrives, in order; a touched frame arrives only unchanged (its damage undone by another).
        let mut expected = received.iter();
        for envelope in sure {
            prop_assert!(expected.any(|other| other == envelope), "an untouched frame was lost");
        }
        let mut sent = envelopes.iter();
        for envelope in &received {
            prop_assert!(sent.any(|other| other == envelope), "a message came out that was never sent");
        }
    }

    #[test]
    fn the_tracker_counts_every_lost_frame(kept in vec(any::<bool>(), 2..200), start: u32) {
        let mut tracker = SequenceTracker::new();
        let mut counted = 0;
        for (offset, _) in (0_u32..).zip(&kept).filter(|(offset, kept)| *offset == 0 || **kept) {
            let sequence = start.wrapping_add(offset);
            let arrival = tracker.observe(&Envelope { boot_id: 1, sequence, message: Message::Ack { id: 0 } });
            counted += u64::from(arrival.frames_missing);
        }
        let last = kept.iter().rposition(|kept| *kept).unwrap_or(0);
        let lost = kept.iter().take(last).skip(1).filter(|kept| !**kept).count();
        prop_assert_eq!(counted, lost as u64);
        prop_assert_eq!(tracker.totals().frames_missing, lost as u64);
    }
}
