//! Time that runs out: restarts, hangs and late periods.

use super::*;
use emulation::plant::NEVER;
use protocol::ResetReason;

/// The device restarts in mid-motion: it reports why, drives nothing, and has the fault acknowledged before it moves again.
fn restarts(injection: Injection, within: std::ops::RangeInclusive<u64>) -> protocol::Hello {
    let (bench, mut client) = bench(RigConfig::default());
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, injection);
    start(&mut client, &[move_y(2_500, 1_000)]);
    eventually("the device restarts", || bench.rig().resets() > 0);
    bench.rig().inject(NOTHING);
    drop(client);
    let mut client = None;
    eventually("it answers again", || {
        client = Client::connect(&bench.port()).ok();
        client.is_some()
    });
    let mut client = client.unwrap();
    assert_released(&bench, within);
    let status = client.status().unwrap();
    assert_eq!((status.state, status.fault), (State::Faulted, Some(Fault::Restarted)));
    let run = client.request(Request::Run { steps: 1, crc: 0, start_us: 0 }).unwrap_err();
    let faulted = Refusal::Faulted { fault: Fault::Restarted };
    assert!(matches!(run, LinkError::Refused { refusal, .. } if refusal == faulted), "{run}");
    clears(&bench, &mut client);
    let hello = client.hello().clone();
    drop(client);
    bench.stop().unwrap();
    hello
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_control_task_that_hangs_is_reset() {
    // The watchdog's 4 ms, from the last period that ended.
    let hello = restarts(Injection { conversion_us: NEVER, ..NOTHING }, 4..=6);
    assert_eq!((hello.reset_reason, hello.last_panic), (ResetReason::Watchdog, None));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn the_supply_sags_in_mid_motion() {
    let hello = restarts(Injection { brown_out: true, ..NOTHING }, 1..=2);
    assert_eq!((hello.reset_reason, hello.last_panic), (ResetReason::BrownOut, None));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_panic_restarts_and_is_reported() {
    let hello = restarts(Injection { panic: true, ..NOTHING }, 1..=2);
    assert_eq!(hello.reset_reason, ResetReason::Software);
    let panic = hello.last_panic.expect("the panic is reported");
    assert!(panic.contains(".rs:") && panic.contains("the plant requests a panic"), "{panic}");
}

/// Drivers panic through the log, which has their text; the device reports that one of them did.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_panic_of_a_driver_restarts_and_is_reported() {
    let hello = restarts(Injection { driver_panic: true, ..NOTHING }, 1..=2);
    assert_eq!(hello.reset_reason, ResetReason::Software);
    assert_eq!(hello.last_panic.as_deref(), Some("an assertion of a driver failed: its text is in the log"));
}

/// The guard below the stack is hit before a variable is overwritten: the panic's text, which lies below it, arrives whole.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_stack_that_overflows_restarts_and_is_reported() {
    let hello = restarts(Injection { stack_overflow: true, ..NOTHING }, 1..=2);
    assert_eq!(hello.reset_reason, ResetReason::Software);
    assert_eq!(hello.last_panic.as_deref(), Some("stack overflow"));
}

#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn a_slow_converter_makes_control_late() {
    let (bench, mut client) = bench(RigConfig::default());
    let slow = Injection { conversion_us: 700, ..NOTHING };
    bench.rig().inject_when(Trigger::Driving { for_periods: 100 }, slow);
    start(&mut client, &[move_y(2_500, 1_000)]);
    // No command is handled while control takes all the time there is.
    eventually("the bridges are off", || {
        bench.rig().reaction().is_some_and(|reaction| reaction.periods().is_some())
    });
    bench.rig().inject(NOTHING);
    await_fault(&mut client, Fault::Overrun);
    // Two conversions of 0.7 ms make a period 0.5 ms too long, so that every other one begins late, and the second is the fault.
    assert_released(&bench, 2..=12);
    clears(&bench, &mut client);
    assert!(client.status().unwrap().counters.control_overruns >= 2);
    drop(client);
    bench.stop().unwrap();
}

/// Conversions that stay slow, and one that never ends, at every start: the guide rests, and a host is answered with the reason.
#[test]
#[ignore = "needs QEMU: cargo xtask test runs it"]
fn converters_that_stay_slow_or_hang_leave_a_device_that_answers() {
    for conversion_us in [400, 700, 1_200, 2_000, NEVER] {
        let (bench, mut client) = bench(RigConfig::default());
        start(&mut client, &[move_y(2_500, 1_000)]);
        bench.rig().inject(Injection { conversion_us, ..NOTHING });
        eventually("the bridges are off", || {
            bench.rig().reaction().is_some_and(|reaction| reaction.periods().is_some())
        });
        // By now it has found out what it can do.
        let start_step = bench.rig().steps();
        eventually("time goes on", || bench.rig().steps() > start_step + 1_500);
        drop(client);
        let mut client = None;
        eventually("it answers", || {
            client = Client::connect(&bench.port()).ok();
            client.is_some()
        });
        let mut client = client.unwrap();
        let resets = bench.rig().resets();
        let (status, reason) = (client.status().unwrap(), client.hello().reset_reason);
        assert_eq!(status.state, State::Faulted, "{conversion_us} us: {status:?}");
        match conversion_us {
            // Up to here a period ends within the watchdog's time.
            400..=1_200 => assert_eq!((status.fault, resets), (Some(Fault::Overrun), 0)),
            _ => assert_eq!((status.fault, reason), (Some(Fault::Restarted), ResetReason::Watchdog)),
        }
        if conversion_us > 1_200 {
            let refusal = client.request(Request::ClearFault).unwrap_err();
            assert!(
                matches!(refusal, LinkError::Refused { refusal: Refusal::CauseRemains, .. }),
                "{refusal}"
            );
        }
        let start_step = bench.rig().steps();
        eventually("time goes on", || bench.rig().steps() > start_step + 1_000);
        assert_eq!(bench.rig().resets(), resets, "{conversion_us} us: it restarts no more");
        assert!(!bench.rig().bridges_driven());
        // Repaired, and reset or switched on again, it works.
        bench.rig().inject(Injection { brown_out: true, ..NOTHING });
        eventually("it restarts", || bench.rig().resets() > resets);
        drop(client);
        let mut client = Client::connect(&bench.port()).unwrap();
        clears(&bench, &mut client);
        drop(client);
        bench.stop().unwrap();
    }
}
