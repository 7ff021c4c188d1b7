//! Guide 2 of the device as a part of the plant of [`steering::steer`].
//!
//! The device moves guide 2 and measures its position and force. The needle's side is another plant, which pushes the needle
//! and reads its tip: a motor stage with a tracker, a person who is prompted, or a simulation. A [`RigPlant`] joins the two.
//! Each guide move is one motion program of the device, with its interlocks, and ends while the needle rests; the needle's side
//! then receives the positions that were reached. Between moves the bridges are off, so that nothing moves when a run ends,
//! however it ends.

use crate::link::error::explain_latched;
use crate::link::program::move_to;
use crate::link::{Client, LinkError, Point, Program, RunOptions, Telemetry, run};
use protocol::{Fault, SPEED_LIMIT_UM_S, State, Status};
use std::sync::atomic::{AtomicBool, Ordering};
use steering::{Answer, Command, DeviceFault, End, GUIDE_SETTLING_S, Plant, PlantError, Statement};

/// Largest distance of guide 2 from its straight-needle position at the begin of a run, mm.
const HOME_MM: f64 = 0.1;
/// Largest distance of guide 2 from its position after a move, mm: several times the noise of a
/// single reading.
const SLIP_MM: f64 = 0.3;
/// Readings at the end of a move whose means are where guide 2 came to rest: as many as the device itself waits before a motion counts
/// as settled.
const REST_POINTS: usize = 100;
/// Slowest move that is requested, mm/s.
const SLOWEST_MM_S: f64 = 0.05;

/// Guide 2 of a device, and the needle's side.
pub struct RigPlant<N> {
    client: Client,
    needle: N,
    interrupted: &'static AtomicBool,
    /// Position of guide 2 as commanded last, and as measured when that move had ended, mm.
    commanded_mm: [f64; 2],
    reached_mm: [f64; 2],
    /// Time of the last answer, s.
    t_s: f64,
}

impl<N: Plant> RigPlant<N> {
    /// Joins a connected device and the needle's side. A run ends soon after `interrupted` is set.
    pub fn new(client: Client, needle: N, interrupted: &'static AtomicBool) -> Self {
        let nowhere = [0.0; 2];
        Self { client, needle, interrupted, commanded_mm: nowhere, reached_mm: nowhere, t_s: 0.0 }
    }

    /// The device's status, where it is at rest without a fault.
    fn at_rest(&mut self) -> Result<Status, PlantError> {
        let status = self.client.status().map_err(failed)?;
        match (status.fault, status.state) {
            (Some(fault), _) => Err(latched(fault)),
            (None, State::Idle) => Ok(status),
            (None, _) => Err(PlantError::Device {
                fault: DeviceFault::Other,
                cause: "the device runs a motion program of another host: end it with `guide stop`"
                    .to_owned(),
            }),
        }
    }

    fn position_mm(&self, status: &Status) -> [f64; 2] {
        self.client.displacement_m(status.position_counts).map(|m| 1e3 * m)
    }

    /// Has the device make one move, to its end; what was measured there.
    fn move_guide(&mut self, to_mm: [f64; 2], time_s: f64) -> Result<(), PlantError> {
        let distance_mm = (to_mm[0] - self.commanded_mm[0]).hypot(to_mm[1] - self.commanded_mm[1]);
        let speed_mm_s = (distance_mm / time_s).clamp(SLOWEST_MM_S, 1e-3 * f64::from(SPEED_LIMIT_UM_S));
        let step = move_to(to_mm, speed_mm_s)
            .map_err(|problem| PlantError::Device { fault: DeviceFault::Other, cause: problem.to_owned() })?;
        let mut points: Vec<Point> = Vec::new();
        let options = RunOptions { start_us: None, stream: true, interrupted: self.interrupted };
        run(&mut self.client, &Program::single("steer", step), options, |_, telemetry| {
            if let Telemetry::Samples(batch) = telemetry
                && batch.step.is_some()
            {
                points.extend(&batch.points);
            }
            Ok::<(), LinkError>(())
        })
        .map_err(failed)?;
        self.commanded_mm = to_mm;
        let last = points.len().saturating_sub(REST_POINTS);
        self.reached_mm = match points.get(last..) {
            Some(rest) if !rest.is_empty() => [0, 1].map(|axis: usize| {
                let sum_m: f64 = rest.iter().filter_map(|point| point.displacement_m.get(axis)).sum();
                1e3 * sum_m / rest.len() as f64
            }),
            // Every batch was lost on the way: a single reading.
            _ => {
                let status = self.at_rest()?;
                self.position_mm(&status)
            }
        };
        Ok(())
    }
}

impl<N: Plant> Plant for RigPlant<N> {
    fn start(&mut self) -> Result<Statement, PlantError> {
        let status = self.at_rest()?;
        let [x_mm, y_mm] = self.position_mm(&status);
        if x_mm.abs().max(y_mm.abs()) > HOME_MM {
            return Err(PlantError::Device {
                fault: DeviceFault::NotHome,
                cause: format!(
                    "guide 2 stands at x {x_mm:+.2} mm, y {y_mm:+.2} mm, expected within {HOME_MM} mm of where the needle is straight: \
                     run `guide home` first"
                ),
            });
        }
        self.reached_mm = [x_mm, y_mm];
        let mut stated = self.needle.start()?;
        let scales = self.client.hello().scales;
        let limits = &mut stated.limits;
        fn least(stated: f64, of_device: f64) -> f64 {
            if stated > 0.0 { stated.min(of_device) } else { of_device }
        }
        limits.guide_travel_mm = least(limits.guide_travel_mm, 1e-3 * f64::from(scales.travel_um));
        limits.guide_speed_mm_s = least(limits.guide_speed_mm_s, 1e-3 * f64::from(SPEED_LIMIT_UM_S));
        let force_n = 1e-3 * f64::from(status.force_limit_mn);
        limits.guide_force_n = Some(limits.guide_force_n.map_or(force_n, |stated| least(stated, force_n)));
        stated.rig.move_while_pushing = false;
        stated.rig.guide_moves_in_one_step = true;
        Ok(stated)
    }

    fn step(&mut self, command: &Command) -> Result<Answer, PlantError> {
        if self.interrupted.load(Ordering::Acquire) {
            return Err(PlantError::Interrupted);
        }
        let target_mm = [command.guide_x_mm, command.guide_y_mm];
        if target_mm != self.commanded_mm {
            self.move_guide(target_mm, (command.t_s - self.t_s - GUIDE_SETTLING_S).max(1e-3))?;
        }
        let status = self.at_rest()?;
        let now_mm = self.position_mm(&status);
        let slip_mm = (now_mm[0] - self.reached_mm[0]).hypot(now_mm[1] - self.reached_mm[1]);
        if slip_mm > SLIP_MM {
            return Err(PlantError::Device {
                fault: DeviceFault::Slipped,
                cause: format!(
                    "guide 2 has moved by {slip_mm:.2} mm since its last move had ended, expected at most {SLIP_MM} mm: does its lead \
                     screw hold it, does another host move it?"
                ),
            });
        }
        let [guide_x_mm, guide_y_mm] = self.reached_mm;
        let [force_x_n, force_y_n] = self.client.force_n(status.force_counts);
        let answer = self.needle.step(&Command { guide_x_mm, guide_y_mm, ..*command })?;
        self.t_s = command.t_s;
        Ok(Answer {
            guide_x_mm,
            guide_y_mm,
            force_x_n: Some(force_x_n),
            force_y_n: Some(force_y_n),
            ..answer
        })
    }

    fn end(&mut self) -> Result<End, PlantError> {
        self.needle.end()
    }
}

/// A latched fault as that of a run.
fn latched(fault: Fault) -> PlantError {
    let kind = match fault {
        Fault::EmergencyStop => DeviceFault::EmergencyStop,
        Fault::Restarted => DeviceFault::Restarted,
        _ => DeviceFault::Interlock,
    };
    PlantError::Device { fault: kind, cause: explain_latched(fault) }
}

/// Converts an error of the link or the device into the fault of a run.
fn failed(error: LinkError) -> PlantError {
    let fault = match &error {
        LinkError::Interrupted => return PlantError::Interrupted,
        LinkError::ProgramEnded { fault: Some(fault) } => return latched(*fault),
        LinkError::ProgramEnded { fault: None } => DeviceFault::Stopped,
        LinkError::Refused { refusal: protocol::Refusal::Faulted { fault }, .. } => return latched(*fault),
        LinkError::Restarted { .. } => DeviceFault::Restarted,
        LinkError::Gone { .. }
        | LinkError::Silent { .. }
        | LinkError::Unanswered { .. }
        | LinkError::NoAnswer { .. }
        | LinkError::Port(_) => DeviceFault::Gone,
        _ => DeviceFault::Other,
    };
    PlantError::Device { fault, cause: error.to_string() }
}
