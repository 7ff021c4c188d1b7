//! Interface that the control logic requires of a board: three small traits, which every board implements.

pub use crate::ads131m02::ForceFault;

/// Everything that is sensed in one control period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Readings {
    /// Codes of the potentiometers of the X and Y actuators, 0 to 4095, ratiometric to their supply.
    pub potentiometer_codes: [u16; 2],
    /// Codes of the lateral force channels X and Y, 24 bit signed, or the fault that replaces them.
    pub force_codes: Result<[i32; 2], ForceFault>,
    /// The emergency-stop line is in its stop state (switch open or wire cut).
    pub emergency_stop: bool,
}

/// The sensors, read once per control period.
pub trait Sensors {
    /// Reads all of them.
    fn read(&mut self) -> Readings;
}

/// The two bridges, X and Y.
pub trait Actuators {
    /// Drives both motors with a duty of -1 to 1, PWM against brake (slow decay); 0 brakes. Values out of range are
    /// clamped, a value that is not a number brakes.
    fn drive(&mut self, duty: [f32; 2]);
    /// Both inputs of both bridges low: bridges off, motors coast.
    fn release(&mut self);
}

/// Remaining outputs and inputs: the status LED and the watchdog.
pub trait Panel {
    /// Lights the status LED.
    fn led(&mut self, on: bool);
    /// Feeds the watchdog, which otherwise resets the chip.
    fn feed_watchdog(&mut self);
}
