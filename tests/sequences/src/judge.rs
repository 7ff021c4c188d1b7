//! Conditions that must hold for any commands.

use super::{Checked, Violation};
use control::calibration::Calibration;
use protocol::{CalibrationRecord, Fault, Outcome, PULSE_BOUND_UM, Request, START_LIMIT_US, State};

/// After a program a guide rests within its travel and this, micrometres: what the position loop leaves, and its noise.
const REST_UM: f32 = 60.0;
/// The same where a program was stopped at any time: what the loop overshoots, and what the motor rolls on.
const STOPPED_REST_UM: f32 = 150.0;
/// The same where a fault released the bridges in motion: the travel's own fault acts 200 um beyond it, and the motor rolls on.
const RELEASED_REST_UM: f32 = 300.0;
/// Motion the wrong way before it is noticed, micrometres: 0.3 mm with the actuator as designed, and what one with less friction rolls on.
const WRONG_WAY_UM: f32 = 330.0;
/// Largest motion of a guide after its fault was cleared and before it is driven again, micrometres: 50 periods after
/// the drive a lag of 12 periods leaves 1.6 % of full speed, 4 um; the rest is for the noise of a reading.
const CLEARED_UM: f32 = 20.0;
/// Time without drive after which a guide rests, milliseconds.
const REST_MS: u64 = 100;
/// Coasting distance of a motor from the first reading that exceeds a limit to its rest, micrometres: 2 periods until
/// the fault, one until the bridge is off, one of sampling, and a lag of 12 periods, at full speed.
pub const ROLLS_ON_UM: f32 = 320.0;
/// Share of that by which it may be more where a force channel fails: evidence takes up to 10 readings instead of 2
/// (`control::limits`), 160 um.
const LATER: f32 = 0.5;
/// Largest sum that retreats may add if they lead into the load, newtons: twice 1 % of the rated range of 5 N, two
/// means of 25 um on 1.1 N/mm, and what the motor rolls on.
const RETREATS_N: f32 = 0.22;

/// Observation since the last check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Device time, milliseconds; it need not begin at 0, but must not go back.
    pub now_ms: u64,
    /// A bridge drives.
    pub driven: bool,
    /// State of the controller.
    pub state: State,
    /// Latched fault.
    pub fault: Option<Fault>,
    /// True position of both axes, micrometres.
    pub position_um: [f32; 2],
    /// Largest force along either axis, as the cell has it from the calibration's zero, newtons.
    pub force_n: f32,
    /// A force channel fails; a potentiometer does.
    pub fails: [bool; 2],
    /// The fault was cleared by a command that was accepted.
    pub cleared: bool,
    /// Programs that started.
    pub started: u32,
    /// Outcome of a program.
    pub ended: Option<Outcome>,
}

/// Follows one device and its rig.
#[derive(Debug)]
pub struct LimitChecker {
    /// Allowed excess of the force above the limit, newtons.
    overshoot_n: f32,
    /// Further allowed excess since a force channel has failed.
    later_n: f32,
    /// A potentiometer has failed: where the guide is cannot be known.
    lost: bool,
    /// True force per measured one, by the calibration.
    gain: f32,
    limit_n: f32,
    /// Allowed force: the limit, or what there was when it was set; it never grows but by a command.
    allowed_n: f32,
    travel_um: f32,
    /// The guide has been within this travel.
    inside: bool,
    /// The tables have the wrong sign.
    turned: bool,
    latched: Option<Fault>,
    runs: u32,
    starts: u32,
    from_um: [f32; 2],
    /// Position of the guide when its fault was cleared, until it is driven again.
    cleared_um: Option<[f32; 2]>,
    driven_ms: u64,
    /// Outcome of the last program that drove a motor: holds alone leave the guide where it is.
    ended: Option<Outcome>,
    /// A bridge has driven since the last program ended.
    drove: bool,
    now_ms: u64,
    /// Start of a pulse, from rest, that is the last motion so far.
    pulsed_from_um: Option<[f32; 2]>,
}

impl LimitChecker {
    /// For a rig on which a motor's rolling on gives this force, with this calibration stored.
    pub fn new(overshoot_n: f32, record: &CalibrationRecord) -> Self {
        Self {
            overshoot_n,
            later_n: 0.0,
            lost: false,
            gain: 1.0,
            limit_n: 0.0,
            allowed_n: 0.0,
            travel_um: record.travel_um as f32,
            inside: false,
            turned: false,
            latched: None,
            runs: 0,
            starts: 0,
            from_um: [0.0; 2],
            cleared_um: None,
            driven_ms: 0,
            ended: None,
            drove: false,
            now_ms: 0,
            pulsed_from_um: None,
        }
    }

    /// The device has started, with this calibration.
    pub fn started(&mut self, record: &CalibrationRecord, position_um: [f32; 2]) {
        let [[designed, _], _] = Calibration::nominal_record().force_pn_per_code;
        let [[stored, _], _] = record.force_pn_per_code;
        self.gain = (designed as f32 / stored as f32).abs();
        self.travel_um = record.travel_um as f32;
        self.inside = false;
        self.turned = is_turned(record);
        (self.from_um, self.cleared_um, self.ended, self.pulsed_from_um) = (position_um, None, None, None);
        self.drove = false;
        // Four fifths of the rated range until it is set. An earlier load does not permit a larger one.
        self.limit_n = (record.force_range_mn / 5 * 4) as f32 * 1e-3 * self.gain;
        self.allowed_n = self.allowed_n.max(self.limit_n);
    }

    /// A fault or the motors' history across a restart: `before` and `after` are fault and used share of the duty.
    ///
    /// # Errors
    /// Where retained state was lost.
    pub fn kept(
        &mut self,
        before: (Option<Fault>, [f32; 2]),
        after: (Option<Fault>, [f32; 2]),
        tolerance: f32,
    ) -> Checked<()> {
        // The one of a lost calibration ends with the calibration that was stored.
        let lost = before.0.is_some_and(|fault| fault != Fault::CalibrationLost) && after.0 != before.0;
        let cooled = after.1.iter().zip(before.1).any(|(now, before)| *now < before - tolerance);
        self.latched = after.0;
        if lost || cooled {
            return Err(Violation(format!("a restart made {after:?} of {before:?}")));
        }
        Ok(())
    }

    /// A force limit was accepted.
    fn limited(&mut self, force_mn: u32, force_n: f32) {
        self.limit_n = force_mn as f32 * 1e-3 * self.gain;
        self.allowed_n = self.limit_n.max(force_n);
    }

    /// A command is about to be sent.
    pub fn sends(&mut self, request: &Request, position_um: [f32; 2]) {
        if matches!(request, Request::Run { .. } | Request::Retreat { .. } | Request::Pulse { .. }) {
            (self.from_um, self.cleared_um) = (position_um, None);
        }
        // Coasting in the period of the answer still counts as the motion before.
        if matches!(request, Request::Run { .. } | Request::Retreat { .. }) {
            self.pulsed_from_um = None;
        }
        // Before its answer: it may start at once.
        self.runs += u32::from(matches!(request, Request::Run { .. }));
    }

    /// It was answered.
    ///
    /// # Errors
    /// Where it must not have been accepted.
    pub fn answered(&mut self, request: &Request, accepted: bool, now_us: u64, force_n: f32) -> Checked<()> {
        match *request {
            Request::Run { .. } if !accepted => self.runs -= 1,
            Request::Run { start_us, .. } if start_us > now_us.saturating_add(START_LIMIT_US) => {
                return Err(Violation(format!("a start at {start_us} us is accepted at {now_us} us")));
            }
            Request::Limits { force_mn, .. } if accepted => self.limited(force_mn, force_n),
            Request::Pulse { .. } if accepted => {
                let is_at_rest = self.now_ms >= self.driven_ms + REST_MS;
                self.pulsed_from_um = is_at_rest.then_some(self.from_um);
            }
            _ => {}
        }
        Ok(())
    }

    /// Checks an observation.
    ///
    /// # Errors
    /// What does not hold.
    pub fn observe(&mut self, observed: &Observation) -> Checked<()> {
        let violated = |text| Err(Violation(text));
        self.now_ms = observed.now_ms;
        let start_um = self.pulsed_from_um.unwrap_or(observed.position_um);
        let pulsed_um =
            observed.position_um.iter().zip(start_um).map(|(um, from)| (um - from).abs()).fold(0.0, f32::max);
        if pulsed_um > PULSE_BOUND_UM as f32 {
            return violated(format!("moved {pulsed_um} um by a pulse"));
        }
        if self.latched.is_some() && observed.fault != self.latched && !observed.cleared {
            return violated(format!("{:?} went without its clear: {:?}", self.latched, observed.fault));
        }
        if observed.cleared && self.latched.is_some() && observed.fault.is_none() {
            self.cleared_um = Some(observed.position_um);
        }
        self.latched = observed.fault;
        self.cleared_um = self.cleared_um.filter(|_| !observed.driven);
        if let Some(cleared_um) = self.cleared_um {
            let moved_um = farthest(observed.position_um, cleared_um);
            if moved_um > CLEARED_UM {
                return violated(format!("rolls on by {moved_um} um after its fault was cleared"));
            }
        }
        self.drove |= observed.driven;
        if observed.ended.is_some() && std::mem::take(&mut self.drove) {
            self.ended = observed.ended;
        }
        if observed.driven && observed.fault.is_some() && observed.state != State::Retreating {
            return violated(format!("driven in {:?}", observed.fault));
        }
        self.allowed_n = self.allowed_n.min(observed.force_n.max(self.limit_n));
        let [force_fails, potentiometer_fails] = observed.fails;
        if force_fails {
            self.later_n = LATER * self.overshoot_n;
        }
        self.lost |= potentiometer_fails;
        if observed.force_n > self.allowed_n + self.overshoot_n + self.later_n + RETREATS_N {
            return violated(format!("{} N where {} N is the limit", observed.force_n, self.allowed_n));
        }
        self.starts += observed.started;
        if self.starts > self.runs {
            return violated(format!("{} programs started of {} accepted", self.starts, self.runs));
        }
        self.rests(observed)?;
        if self.turned && !self.lost {
            let moved_um = farthest(observed.position_um, self.from_um);
            if moved_um > WRONG_WAY_UM {
                return violated(format!("moved {moved_um} um by tables of the wrong sign"));
            }
        }
        Ok(())
    }

    fn rests(&mut self, observed: &Observation) -> Checked<()> {
        if observed.driven {
            self.driven_ms = observed.now_ms;
            return Ok(());
        }
        if self.turned || self.lost || observed.now_ms < self.driven_ms + REST_MS {
            return Ok(());
        }
        let distance_um = observed.position_um.iter().map(|um| um.abs()).fold(0.0, f32::max);
        let margin_um = match self.ended {
            Some(Outcome::Completed) => REST_UM,
            Some(Outcome::Stopped | Outcome::TareRejected) => STOPPED_REST_UM,
            // A restart in motion is no end that is reported.
            Some(Outcome::Faulted) | None => RELEASED_REST_UM,
        };
        if self.inside && distance_um > self.travel_um + margin_um {
            return Err(Violation(format!(
                "rests at {distance_um} um beyond a travel of {} um",
                self.travel_um
            )));
        }
        self.inside |= distance_um <= self.travel_um;
        Ok(())
    }
}

/// Larger motion of the two axes between two positions, micrometres.
pub fn farthest(at_um: [f32; 2], from_um: [f32; 2]) -> f32 {
    at_um.iter().zip(from_um).map(|(um, from)| (um - from).abs()).fold(0.0, f32::max)
}

/// The tables of a record fall where those of the rig as designed rise.
pub fn is_turned(record: &CalibrationRecord) -> bool {
    let [x, _] = &record.potentiometers;
    let [first, .., last] = x.rising_um;
    last < first
}
