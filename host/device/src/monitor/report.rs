//! State of the device as one document for machines: `guide monitor --json`.

use super::state::State;
use crate::link::LinkLosses;
use crate::link::condition::{Condition, ErrorCounters};
use crate::link::display;
use crate::link::error::fault_text;
use serde::Serialize;

/// One line of `guide monitor --json`, schema `guide.monitor/1`. Unknown values are `null`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    schema: &'static str,
    port: String,
    connected: bool,
    lost_because: Option<String>,
    silent_s: Option<f64>,
    boot_id: Option<u32>,
    reset_reason: Option<&'static str>,
    last_panic: Option<String>,
    time_s: Option<f64>,
    state: Option<&'static str>,
    step: Option<u8>,
    fault: Option<Fault>,
    telemetry: Option<bool>,
    position_x_mm: Option<f64>,
    position_y_mm: Option<f64>,
    force_x_n: Option<f64>,
    force_y_n: Option<f64>,
    stiffness_x: Option<Stiffness>,
    stiffness_y: Option<Stiffness>,
    link: Link,
    device: Option<Device>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    parted: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Fault {
    number: u8,
    cause: &'static str,
    remedy: &'static str,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Stiffness {
    n_per_mm: f64,
    ci95_n_per_mm: [f64; 2],
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Link {
    bytes_per_s: f64,
    samples_per_s: f64,
    samples: u64,
    #[serde(flatten)]
    losses: LinkLosses,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
struct Device {
    #[serde(flatten)]
    condition: Condition,
    counters: ErrorCounters,
}

impl Report {
    /// Report of the present state.
    pub fn new(state: &State, now_s: f64) -> Self {
        let mean = state.mean();
        let position_mm = mean.map(|(displacement_m, _)| displacement_m.map(|metres| metres * 1e3));
        let force_n = mean.map(|(_, force_n)| force_n);
        let [stiffness_x, stiffness_y] = state.stiffness().map(|estimate| {
            estimate.map(|estimate| Stiffness {
                n_per_mm: estimate.value_n_per_m * 1e-3,
                ci95_n_per_mm: estimate.ci95_n_per_m.map(|end| end * 1e-3),
            })
        });
        let [bytes_per_s, samples_per_s] = state.health.per_second();
        let hello = state.hello.as_ref();
        let last_panic = hello.and_then(|hello| hello.last_panic.as_ref());
        Self {
            schema: "guide.monitor/1",
            port: state.port.clone(),
            connected: state.down.is_none() && state.boot_id.is_some(),
            lost_because: state.down.as_ref().map(|down| down.reason.clone()),
            silent_s: state.silent_s(now_s),
            boot_id: state.boot_id,
            reset_reason: hello.map(|hello| display::reset_reason(hello.reset_reason)),
            last_panic: last_panic.map(|text| text.as_str().to_owned()),
            time_s: state.clock_s(),
            state: state.phase.map(|(phase, _)| display::state(phase)),
            step: state.phase.and_then(|(_, step)| step),
            fault: state.fault.map(|fault| {
                let text = fault_text(fault);
                Fault { number: fault as u8, cause: text.cause, remedy: text.remedy }
            }),
            telemetry: state.status.as_ref().map(|status| status.streaming),
            position_x_mm: position_mm.map(|[x, _]| x),
            position_y_mm: position_mm.map(|[_, y]| y),
            force_x_n: force_n.map(|[x, _]| x),
            force_y_n: force_n.map(|[_, y]| y),
            stiffness_x,
            stiffness_y,
            link: Link {
                bytes_per_s,
                samples_per_s,
                samples: state.health.samples_received(),
                losses: state.health.total().losses,
            },
            device: state.status.as_deref().map(device),
            parted: state.parted.clone(),
        }
    }
}

fn device(status: &protocol::Status) -> Device {
    Device { condition: status.into(), counters: (&status.counters).into() }
}
