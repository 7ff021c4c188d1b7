//! The two H-bridges on timer outputs.
//!
//! Slow decay: one input stays high while the other carries the complement of the duty, so the motor alternates between
//! drive and brake, which keeps speed proportional to duty down to small duties. With both inputs low the motor coasts, and the
//! usual bridge drivers soon enter their sleep mode.

use super::pins::{BridgePins, bridges};
use control::hal::Actuators;
use embassy_stm32::peripherals::{TIM2, TIM3};
use embassy_stm32::timer::GeneralInstance4Channel;
use embassy_stm32::timer::simple_pwm::SimplePwmChannel;

/// The two inputs of one bridge.
struct Bridge<T: GeneralInstance4Channel> {
    in1: SimplePwmChannel<'static, T>,
    in2: SimplePwmChannel<'static, T>,
    /// Counts of a whole PWM period, read once because access to the register is slow.
    full: u32,
    enabled: bool,
}

impl<T: GeneralInstance4Channel> Bridge<T> {
    /// A released bridge.
    fn new([in1, in2]: [SimplePwmChannel<'static, T>; 2]) -> Self {
        let full = in1.max_duty_cycle();
        let mut bridge = Self { in1, in2, full, enabled: true };
        bridge.release();
        bridge
    }

    fn drive(&mut self, duty: f32) {
        // A duty of NaN brakes, as zero does: the comparison is false and the cast gives 0.
        let brake = self.full - ((duty.abs().min(1.0) * self.full as f32) as u32).min(self.full);
        let (in1, in2) = if duty > 0.0 { (self.full, brake) } else { (brake, self.full) };
        self.in1.set_duty_cycle(in1);
        self.in2.set_duty_cycle(in2);
        if !self.enabled {
            self.in1.enable();
            self.in2.enable();
            self.enabled = true;
        }
    }

    fn release(&mut self) {
        if self.enabled {
            self.in1.set_duty_cycle_fully_off();
            self.in2.set_duty_cycle_fully_off();
            self.in1.disable();
            self.in2.disable();
            self.enabled = false;
        }
    }
}

/// Both bridges.
pub struct BoardActuators {
    x: Bridge<TIM3>,
    y: Bridge<TIM2>,
}

impl BoardActuators {
    pub(super) fn new(pins: BridgePins) -> Self {
        let (x, y) = bridges(pins);
        Self { x: Bridge::new(x), y: Bridge::new(y) }
    }
}

impl Actuators for BoardActuators {
    fn drive(&mut self, duty: [f32; 2]) {
        self.x.drive(duty[0]);
        self.y.drive(duty[1]);
    }

    fn release(&mut self) {
        self.x.release();
        self.y.release();
    }
}
