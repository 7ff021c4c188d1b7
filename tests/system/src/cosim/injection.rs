//! Faults of the electronics between rig and firmware for tests, and the firmware's time to release the
//! motors.

use super::PERIOD_S;
use super::line::{LINE_BAUD, Line};
use super::wiring::Wiring;
use emulation::plant::{FORCE_CODE_MAX, FULL_SCALE, POTENTIOMETER_CODE_MAX, PlantReply, PlantRequest};
use sequences::sensors::{Contacts, Failing};
use simulation::rig::{BridgeInputs, Codes};

/// Injected faults; none by default. Axes are 0 for x and 1 for y.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Injection {
    /// The emergency stop is pressed.
    pub emergency_stop: bool,
    /// The force converter's frames fail their checksum.
    pub corrupt_force: bool,
    /// The force converter has no new data.
    pub force_silent: bool,
    /// The force converter resets, once.
    pub force_reset: bool,
    /// The force codes stay what they were last.
    pub force_stuck: bool,
    /// Force added to both readings, newtons.
    pub force_spike_n: Option<[f64; 2]>,
    /// This axis reads the greatest force code.
    pub force_saturated: Option<usize>,
    /// The same for one reading; then the converter has no new data.
    pub force_saturated_once: Option<usize>,
    /// This potentiometer's wiper is at its supply.
    pub potentiometer_open: Option<usize>,
    /// This potentiometer's wiper is at ground.
    pub potentiometer_short: Option<usize>,
    /// Added to the potentiometers' codes.
    pub potentiometer_jump_codes: [i32; 2],
    /// Failure of the force channels.
    pub force_fails: Option<Failing>,
    /// Failure of the potentiometers.
    pub potentiometers_fail: Option<Failing>,
    /// Hum of the mains on the force channels at 50 Hz, newtons.
    pub hum_n: f64,
    /// This motor gets nothing, so its rod stands.
    pub jammed: Option<usize>,
    /// This motor gets that share of its voltage.
    pub weak: Option<(usize, f64)>,
    /// This motor gets that duty at every command.
    pub runaway: Option<(usize, f64)>,
    /// Time of a potentiometer's conversion beyond its normal one, microseconds; [`emulation::plant::NEVER`] for one that does
    /// not end.
    pub conversion_us: u16,
    /// Rate of the line towards the host, bits per second; by default that of [`super::LINE_BAUD`].
    pub line_baud: Option<u32>,
    /// The supply sags, once: the core resets.
    pub brown_out: bool,
    /// The program panics, once.
    pub panic: bool,
    /// The program uses up its stack, once.
    pub stack_overflow: bool,
    /// An assertion of a driver fails, once.
    pub driver_panic: bool,
    /// The firmware gets no answer: time stands still.
    pub freeze: bool,
    /// It is over by itself after so many periods; by default it lasts until another one begins. An injection that must
    /// not last longer on a computer that lets the test wait ends by the device's time.
    pub for_periods: Option<u64>,
}

/// When an injection begins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Trigger {
    /// In the next period.
    Now,
    /// When a motor has been driven for so many periods on end.
    Driving {
        /// The periods, this one included.
        for_periods: u64,
    },
    /// In this period since the start, as [`super::Cosim::steps`] counts them.
    AtStep(u64),
    /// When an axis really is at a position or further from the middle.
    Beyond {
        /// 0 for x, 1 for y.
        axis: usize,
        /// The position; its sign is the side.
        position_mm: f64,
    },
}

/// Reaction of the firmware to an injection. Periods count from the start, over all resets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Reaction {
    /// The period whose reply was the first with the injection.
    pub injected_at_step: u64,
    /// The period from whose request on no input of a bridge has been high: both motors are off, not even braked.
    pub released_at_step: Option<u64>,
    /// Requests with an input high that came after one with none.
    pub driven_after_release: u64,
}

impl Reaction {
    /// Periods from injection to release: 1 if the very next request released. `None` while it has not, or has not stayed so.
    pub fn periods(&self) -> Option<u64> {
        self.released_at_step.map(|released| released - self.injected_at_step)
    }
}

/// Everything between the rig and the firmware.
#[derive(Debug)]
pub(super) struct Electronics {
    codes_per_n: f64,
    injection: Injection,
    /// Injection from the next period on.
    next: Option<Injection>,
    /// Injection that waits for its trigger.
    pending: Option<(Trigger, Injection)>,
    reaction: Option<Reaction>,
    /// The period in which what is injected is over by itself.
    over_at: Option<u64>,
    /// A motor has been driven for so many periods on end.
    driven_periods: u64,
    /// No input has been high from this period on.
    released_since: Option<u64>,
    /// Reset that happens once and is still to come.
    reset_force: bool,
    saturates_once: bool,
    brown_out: bool,
    panic: bool,
    stack_overflow: bool,
    driver_panic: bool,
    /// Force codes of the last reply.
    force_codes: [i32; 2],
    /// The channels of force and potentiometers, with what fails of them.
    force: Contacts,
    potentiometers: Contacts,
    line: Line,
    wiring: Wiring,
    /// The emergency stop's switch.
    pressed: bool,
    periods: u64,
}

impl Electronics {
    pub(super) fn new(codes_per_n: f64, wiring: Wiring) -> Self {
        Self {
            codes_per_n,
            wiring,
            pressed: false,
            periods: 0,
            injection: Injection::default(),
            next: None,
            pending: None,
            reaction: None,
            over_at: None,
            driven_periods: 0,
            released_since: None,
            reset_force: false,
            saturates_once: false,
            brown_out: false,
            panic: false,
            stack_overflow: false,
            driver_panic: false,
            force_codes: [0; 2],
            force: Contacts::default(),
            potentiometers: Contacts::default(),
            line: Line::default(),
        }
    }

    pub(super) fn inject_when(&mut self, trigger: Trigger, injection: Injection) {
        (self.next, self.pending) = match trigger {
            Trigger::Now => (Some(injection), None),
            _ => (self.next, Some((trigger, injection))),
        };
    }

    /// Presses the emergency stop, or releases it.
    pub(super) fn press(&mut self, pressed: bool) {
        self.pressed = pressed;
    }

    pub(super) fn freezes(&self) -> bool {
        self.next.unwrap_or(self.injection).freeze
    }

    pub(super) fn reaction(&self) -> Option<Reaction> {
        self.reaction
    }

    pub(super) fn released_since(&self) -> Option<u64> {
        self.released_since
    }

    pub(super) fn bridges_driven(&self) -> bool {
        self.driven_periods > 0
    }

    /// Takes what the firmware commands in a period; the inputs that arrive at the motors. The rig is where it was at the end
    /// of the period before.
    pub(super) fn command(
        &mut self,
        period: u64,
        request: &PlantRequest,
        position_m: [f64; 2],
    ) -> BridgeInputs {
        let [x1, x2, y1, y2] = request.compare;
        self.driven_periods = if x1 != x2 || y1 != y2 { self.driven_periods + 1 } else { 0 };
        let released = request.compare == [0; 4];
        self.released_since = released.then(|| self.released_since.unwrap_or(period));
        self.observe(period, released);
        if self.over_at.is_some_and(|over_at| period >= over_at) {
            self.begin(period, Injection::default());
        }
        if let Some(injection) = self.next.take() {
            self.begin(period, injection);
        }
        let begins = self.pending.take_if(|(trigger, _)| match *trigger {
            Trigger::Now => true,
            Trigger::Driving { for_periods } => self.driven_periods >= for_periods,
            Trigger::AtStep(step) => period >= step,
            Trigger::Beyond { axis, position_mm } => {
                position_m[axis] * position_mm.signum() >= position_mm.abs() * 1e-3
            }
        });
        if let Some((_, injection)) = begins {
            self.begin(period, injection);
        }
        let commanded = [[x1, x2], [y1, y2]].map(|pair| pair.map(|x| f64::from(x) / f64::from(FULL_SCALE)));
        let commanded = self.wiring.motors(commanded, PERIOD_S);
        self.arriving(commanded)
    }

    fn begin(&mut self, period: u64, injection: Injection) {
        self.reset_force = injection.force_reset;
        self.saturates_once = injection.force_saturated_once.is_some();
        self.brown_out = injection.brown_out;
        self.panic = injection.panic;
        self.stack_overflow = injection.stack_overflow;
        self.driver_panic = injection.driver_panic;
        self.injection = injection;
        self.force = Contacts::new(injection.force_fails, period);
        self.potentiometers = Contacts::new(injection.potentiometers_fail, !period);
        self.over_at = injection.for_periods.map(|periods| period + periods);
        // The end of an injection is none: what it did can still be read.
        if injection != Injection::default() {
            let reaction =
                Reaction { injected_at_step: period, released_at_step: None, driven_after_release: 0 };
            self.reaction = Some(reaction);
        }
    }

    /// Follows the reaction to what was injected before this request.
    fn observe(&mut self, period: u64, released: bool) {
        let Some(reaction) = &mut self.reaction else { return };
        if released {
            reaction.released_at_step.get_or_insert(period);
        } else if reaction.released_at_step.take().is_some() || reaction.driven_after_release > 0 {
            reaction.driven_after_release += 1;
        }
    }

    fn arriving(&self, commanded: BridgeInputs) -> BridgeInputs {
        let Injection { jammed, weak, runaway, .. } = self.injection;
        let mut inputs = commanded;
        if let Some((axis, duty)) = runaway {
            let low = 1.0 - duty.abs();
            inputs[axis] = if duty > 0.0 { [1.0, low] } else { [low, 1.0] };
        }
        if let Some((axis, weak_axis)) = weak {
            inputs[axis] = inputs[axis].map(|high| high * weak_axis);
        }
        if let Some(axis) = jammed {
            inputs[axis] = [0.0; 2];
        }
        inputs
    }

    /// Values that the firmware senses at the end of the period.
    pub(super) fn sense(&mut self, step: u32, codes: Codes, power_off: bool) -> PlantReply {
        let injection = self.injection;
        let codes = self.wiring.codes(codes);
        self.periods += 1;
        let (is_new, is_intact) = self.wiring.converter(self.periods);
        let saturates_once = std::mem::take(&mut self.saturates_once);
        let saturated =
            injection.force_saturated.or(injection.force_saturated_once.filter(|_| saturates_once));
        self.force_codes = self.bridge(codes.bridge, saturated);
        let force_codes = self.force.read(self.force_codes, FORCE_CODE_MAX);
        let potentiometer_codes = potentiometers(&injection, codes.potentiometer).map(i32::from);
        let most = i32::from(POTENTIOMETER_CODE_MAX);
        let potentiometer_codes = self.potentiometers.read(potentiometer_codes, most).map(|code| code as u16);
        PlantReply {
            step,
            potentiometer_codes,
            force_codes,
            potentiometer_conversion_us: injection.conversion_us,
            line_bytes: self.line.bytes(injection.line_baud.unwrap_or(LINE_BAUD)),
            emergency_stop: injection.emergency_stop || self.wiring.stop_line(self.pressed),
            force_ready: is_new
                && !injection.force_silent
                && (saturates_once || injection.force_saturated_once.is_none()),
            corrupt_force_crc: injection.corrupt_force || !is_intact,
            reset_force_converter: std::mem::take(&mut self.reset_force),
            power_off,
            brown_out: std::mem::take(&mut self.brown_out) || self.wiring.sags(),
            panic: std::mem::take(&mut self.panic),
            stack_overflow: std::mem::take(&mut self.stack_overflow),
            driver_panic: std::mem::take(&mut self.driver_panic),
        }
    }

    fn bridge(&self, codes: [i32; 2], saturated: Option<usize>) -> [i32; 2] {
        let injection = &self.injection;
        if injection.force_stuck {
            return self.force_codes;
        }
        // Twenty periods of a millisecond are one of 50 Hz.
        let hum_n = injection.hum_n * (std::f64::consts::TAU * 0.05 * (self.periods % 20) as f64).sin();
        let added_n = injection.force_spike_n.unwrap_or_default().map(|n| n + hum_n);
        [0, 1].map(|axis| {
            let code = f64::from(codes[axis]) + added_n[axis] * self.codes_per_n;
            if saturated == Some(axis) {
                FORCE_CODE_MAX
            } else {
                code.round().clamp(f64::from(-FORCE_CODE_MAX - 1), f64::from(FORCE_CODE_MAX)) as i32
            }
        })
    }
}

fn potentiometers(injection: &Injection, codes: [u16; 2]) -> [u16; 2] {
    [0, 1].map(|axis| {
        if injection.potentiometer_open == Some(axis) {
            return POTENTIOMETER_CODE_MAX;
        }
        if injection.potentiometer_short == Some(axis) {
            return 0;
        }
        let code = i32::from(codes[axis]) + injection.potentiometer_jump_codes[axis];
        code.clamp(0, i32::from(POTENTIOMETER_CODE_MAX)) as u16
    })
}

#[cfg(test)]
mod tests;
