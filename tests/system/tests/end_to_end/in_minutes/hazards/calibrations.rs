//! Calibrations: which are accepted, which are noticed, and what storing one must not do.

use super::*;
use control::calibration::Calibration;
use control::slots::to_stored;
use protocol::{CalibrationRecord, CalibrationSource, MAX_CALIBRATION, PIECE_BYTES, Text};

/// Loads a calibration and requests to store it; the answer.
fn store(client: &mut Client, record: &CalibrationRecord) -> Result<(), LinkError> {
    let mut buffer = [0; MAX_CALIBRATION];
    let encoded = record.encode(&mut buffer);
    for (piece, part) in (0..).zip(encoded.chunks(PIECE_BYTES)) {
        let mut bytes = [0; PIECE_BYTES];
        bytes[..part.len()].copy_from_slice(part);
        client.request(Request::LoadCalibration { piece, bytes })?;
    }
    client.request(Request::StoreCalibration { length: encoded.len() as u8, crc: record.crc() })
}

/// Waits for the start that follows; the client of that.
fn restarted(bench: &Bench, client: Client, before: u64) -> Client {
    drop(client);
    eventually("the device restarts", || bench.rig().resets() > before);
    let mut again = None;
    eventually("it answers again", || {
        again = Client::connect(&bench.port()).ok();
        again.is_some()
    });
    again.unwrap()
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn storing_a_calibration_forgets_neither_a_fault_nor_the_heat_of_the_motors() {
    let (bench, mut client) = bench(RigConfig::default());
    assert_eq!(
        ended(&mut client, &[move_y(0, 2_000), move_y(1_500, 1_000), move_y(-1_500, 1_000)]),
        Outcome::Completed
    );
    let budget_used = client.status().unwrap().motor_budget_permille[1];
    assert!(budget_used > 50, "{budget_used}");
    bench.rig().inject(Injection { emergency_stop: true, ..NOTHING });
    await_fault(&mut client, Fault::EmergencyStop);
    let record = Calibration::nominal_record();
    let faulted = Refusal::Faulted { fault: Fault::EmergencyStop };
    assert_eq!(refusal(store(&mut client, &record)), faulted);
    bench.rig().inject(NOTHING);
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    // One that a calibration may be the cause of is kept through the restart.
    bench.rig().inject(Injection { potentiometer_jump_codes: [0, -150], ..NOTHING });
    await_fault(&mut client, Fault::Potentiometer);
    let resets = bench.rig().resets();
    store(&mut client, &record).unwrap();
    let mut client = restarted(&bench, client, resets);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::Potentiometer)));
    assert!(
        status.motor_budget_permille[1] >= budget_used,
        "{} of {budget_used}",
        status.motor_budget_permille[1]
    );
    client.request(Request::ClearFault).unwrap();
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_calibration_that_no_rig_has_is_refused() {
    let (bench, mut client) = bench(RigConfig::default());
    for power in [-3, -1, 1, 3] {
        let mut record = Calibration::nominal_record();
        record.force_pn_per_code =
            record.force_pn_per_code.map(|row| row.map(|pn| (f64::from(pn) * 10_f64.powi(power)) as i32));
        assert_eq!(
            refusal(store(&mut client, &record)),
            Refusal::CalibrationInvalid,
            "gains times 1e{power}"
        );
    }
    drop(client);
    bench.stop().unwrap();
}

/// Tables of the wrong sign, as stored.
fn turned() -> Vec<u8> {
    let mut reversed = Calibration::nominal_record();
    for table in &mut reversed.potentiometers {
        (table.rising_um, table.falling_um) = (table.rising_um.map(|um| -um), table.falling_um.map(|um| -um));
    }
    to_stored(&reversed, 3).to_vec()
}

/// Each is too short for the fault of the wrong way. Without a force to follow no axis moves that has not moved the way it was driven;
/// with one, the load may not rise over all of them.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn short_retreats_by_tables_of_the_wrong_sign_do_not_add_up() {
    const ATTEMPTS: u32 = 10;
    let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[&turned()]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    bench.rig().inject(Injection { force_saturated: Some(0), ..Injection::default() });
    eventually("the saturation is a fault", || client.status().unwrap().fault == Some(Fault::ForceRange));
    let start_mm = at_mm(&bench);
    let position_um = client.status().unwrap().position_counts;
    let axis = usize::from(position_um[1].abs() > position_um[0].abs());
    let mut retreat_um = [0; 2];
    retreat_um[axis] = -position_um[axis].signum() * position_um[axis].abs().min(1_000);
    let [x_um, y_um] = retreat_um;
    assert_eq!(refusal(client.request(Request::Retreat { x_um, y_um })), Refusal::OutOfTravel);
    // Beyond the range by something else.
    let sign = bench.rig().rig(|rig| rig.force_n())[axis].signum();
    let mut force_n = [0.0; 2];
    force_n[axis] = 5.5 * sign;
    bench.rig().inject(Injection { force_spike_n: Some(force_n), ..Injection::default() });
    for _ in 0..ATTEMPTS {
        if client.request(Request::Retreat { x_um, y_um }).is_ok() {
            eventually("it has ended", || client.status().unwrap().state == State::Faulted);
        }
    }
    let moved_mm = (at_mm(&bench)[axis] - start_mm[axis]).abs();
    println!("{moved_mm} mm in {ATTEMPTS} retreats of {retreat_um:?} um from {start_mm:?} mm");
    assert!(moved_mm < 0.4, "{moved_mm} mm in {ATTEMPTS} retreats");
    drop(client);
    bench.stop().unwrap();
}

fn at_mm(bench: &Bench) -> [f64; 2] {
    bench.rig().rig(|rig| rig.position_m()).map(|m| 1e3 * m)
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn an_axis_that_moves_the_wrong_way_is_stopped_at_once() {
    let stored = turned();
    let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[&stored]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    let start_m = bench.rig().rig(|rig| rig.position_m());
    let position_um = client.status().unwrap().position_counts;
    let target = Step::Move { x_um: position_um[0], y_um: position_um[1] + 2_000, speed_um_s: 4_000 };
    assert_eq!(ended(&mut client, &[target]), Outcome::Faulted);
    assert_eq!(client.status().unwrap().fault, Some(Fault::WrongWay));
    let end_m = bench.rig().rig(|rig| rig.position_m());
    let moved_mm = [0, 1].map(|axis| (end_m[axis] - start_m[axis]).abs() * 1e3);
    assert!(moved_mm.iter().all(|mm| *mm < 0.3), "moved by {moved_mm:?} mm");
    println!("moved by {moved_mm:?} mm");
    // The recovery: the right tables, which the fault survives, and a clear.
    let resets = bench.rig().resets();
    store(&mut client, &Calibration::nominal_record()).unwrap();
    let mut client = restarted(&bench, client, resets);
    assert_eq!(client.status().unwrap().fault, Some(Fault::WrongWay));
    eventually("the fault is cleared", || client.request(Request::ClearFault).is_ok());
    assert_eq!(ended(&mut client, &[move_y(0, 2_000)]), Outcome::Completed);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_device_without_a_calibration_does_not_move_unasked() {
    let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    assert_eq!(client.safety().unwrap().calibration, CalibrationSource::Nominal);
    let run = load(&mut client, &[move_y(0, 1_000)], 0);
    assert_eq!(refusal(client.request(run)), Refusal::CalibrationNotAcknowledged);
    client.request(Request::AcknowledgeCalibration).unwrap();
    client.request(run).unwrap();
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_calibration_that_is_lost_is_a_fault() {
    let mut damaged = to_stored(&Calibration::nominal_record(), 3);
    damaged[60] ^= 4;
    let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[&[], &damaged]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::CalibrationLost)));
    assert_eq!(refusal(client.request(Request::ClearFault)), Refusal::CauseRemains);
    let record = CalibrationRecord { id: Text::new("unit-8"), ..Calibration::nominal_record() };
    let mut client = client.store_calibration(&record).unwrap();
    assert_eq!(client.status().unwrap().state, State::Idle);
    assert_eq!(client.safety().unwrap().calibration, CalibrationSource::Stored);
    drop(client);
    bench.stop().unwrap();
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_newer_calibration_that_is_damaged_is_a_fault() {
    let (old, mut new) = (to_stored(&record_with("old"), 4), to_stored(&record_with("new"), 5));
    new[60] ^= 4;
    let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[&new, &old]).unwrap();
    let mut client = Client::connect(&bench.port()).unwrap();
    assert_eq!(client.hello().calibration.id.as_str(), "old");
    assert_eq!(client.status().unwrap().fault, Some(Fault::CalibrationLost));
    client.request(Request::AcknowledgeCalibration).unwrap();
    assert_eq!(client.status().unwrap().state, State::Idle);
    drop(client);
    bench.stop().unwrap();
}

fn record_with(id: &str) -> CalibrationRecord {
    CalibrationRecord { id: Text::new(id), ..Calibration::nominal_record() }
}

/// The driver's own writing is tried elsewhere; here each state that a power failure leaves is what the device starts with.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn power_that_fails_while_a_calibration_is_written_leaves_the_old_one_or_the_new_one() {
    let (old, new) = (to_stored(&record_with("old"), 4), to_stored(&record_with("new"), 5));
    // Erased, and cut in the first, a middle and the last double word; then whole.
    for (words, id) in [(0, "old"), (1, "old"), (9, "old"), (new.len() / 8, "new")] {
        let mut page = vec![0xFF; new.len()];
        page[..8 * words].copy_from_slice(&new[..8 * words]);
        if 8 * words + 8 <= page.len() && words > 0 {
            page[8 * words..8 * words + 4].copy_from_slice(&[0, 0x55, 0xAA, 1]);
        }
        let bench = Bench::with_flash(RigConfig::default(), 41, SPEED, HANGS, &[&page, &old]).unwrap();
        let mut client = Client::connect(&bench.port()).unwrap();
        assert_eq!(client.hello().calibration.id.as_str(), id, "{words} double words written");
        // A page that is neither erased nor whole may have been a newer one.
        let fault = (1..=9).contains(&words).then_some(Fault::CalibrationLost);
        assert_eq!(client.status().unwrap().fault, fault);
        drop(client);
        bench.stop().unwrap();
    }
}
