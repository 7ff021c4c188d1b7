//! Helpers that the monitor's tests share: a device in ordinary operation.

use device::link::{Batch, Point, Telemetry};
use device::monitor::state::{Event, State};
use protocol::{Counters, Fault, Hello, Load, ResetReason, State as Phase, Status, Stiffness, Text};

pub fn hello(now_us: u64, last_panic: Option<&str>) -> Box<Hello> {
    Box::new(Hello {
        firmware_version: Text::new("0.1.0"),
        commit: Text::new("abc1234"),
        board: Text::new("B-L475E-IOT01A"),
        reset_reason: ResetReason::Watchdog,
        now_us,
        last_panic: last_panic.map(Text::new),
        ..fake_device::hello()
    })
}

pub fn status(t_us: u64, fault: Option<Fault>) -> Status {
    Status {
        t_us,
        state: if fault.is_some() { Phase::Faulted } else { Phase::Holding },
        step: 2,
        fault,
        position_counts: [-250, 1_200],
        force_counts: [20, 37_860],
        streaming: true,
        counters: Counters { force_missing: 3, ..Counters::default() },
        load: Load { cpu_permille: 231, longest_period_us: 412, stack_free_bytes: 10_240, ..Load::default() },
        motor_budget_permille: [31, 0],
        force_limit_mn: 4_000,
        silence_limit_ms: 2_000,
        stiffness: [
            None,
            Some(Stiffness { slope_mn_per_m: 1_530_000, sd_mn_per_m: 20_000, readings: 1_000 }),
        ],
        repeats_force: false,
    }
}

/// One batch of samples from a device time on: a push along y.
pub fn batch(from_ms: u64, count: u64) -> Telemetry {
    Telemetry::Samples(Batch {
        state: Phase::Holding,
        step: Some(2),
        lost_before: 0,
        points: (from_ms..from_ms + count)
            .map(|t_ms| {
                let y_m = 1.2e-3 * (t_ms % 4_000) as f64 / 4_000.0;
                Point {
                    time_s: t_ms as f64 * 1e-3,
                    displacement_m: [-0.25e-3, y_m],
                    force_n: [0.001, 1_530.0 * y_m],
                    repeats_force: false,
                }
            })
            .collect(),
    })
}

/// State of a device that has been streaming for some seconds, by a host whose clock shows the same.
pub fn running(seconds: u64) -> State {
    let mut state = State::new("/dev/ttyACM0");
    state.take(Event::Connected { boot_id: 7, hello: hello(0, None) }, 0.0);
    for t_ms in (0..seconds * 1_000).step_by(25) {
        let now_s = (t_ms + 25) as f64 * 1e-3;
        state.take(Event::Telemetry(batch(t_ms, 25)), now_s);
        state.take(Event::Telemetry(Telemetry::Status(Box::new(status((t_ms + 25) * 1_000, None)))), now_s);
    }
    state
}
