//! Faults of wiring, mounting and build of a rig: faults that are there from the start and do not go away.
//!
//! They act between the simulated rig and the firmware's drivers, so that the firmware reads and drives what it would on a bench with
//! that fault. [`Kind::ALL`] lists them; [`Fault`] has an axis where the kind has one, and a size where it can be small or large.

use emulation::plant::{FORCE_CODE_MAX, POTENTIOMETER_CODE_MAX};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use simulation::rig::{BridgeInputs, Codes};
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;

/// Kind of a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// The leads of a motor are reversed.
    LeadsReversed,
    /// Both motors are at each other's bridge.
    MotorsSwapped,
    /// A half bridge does not drive upwards.
    BridgeDeadUp,
    /// A half bridge does not drive downwards.
    BridgeDeadDown,
    /// A rod is jammed, or a motor is not connected.
    Jammed,
    /// The ends of a potentiometer's track are swapped.
    PotentiometerReversed,
    /// Both potentiometers are at each other's pin.
    PotentiometersSwapped,
    /// A wiper or ground wire is open: the converter reads its greatest code.
    PotentiometerOpen,
    /// A wiper is shorted to ground.
    PotentiometerShorted,
    /// A wiper makes bad contact; size: standard deviation, codes.
    PotentiometerNoisy,
    /// The potentiometers have another supply than the converter's reference; size: its ratio.
    PotentiometerSupply,
    /// A force channel is not connected to its bridge: it reads its own noise alone.
    ForceDead,
    /// The force channels are swapped.
    ForceSwapped,
    /// A force channel is saturated.
    ForceSaturated,
    /// The force converter repeats itself.
    ForceRepeats,
    /// The force converter gives nothing.
    ForceSilent,
    /// The frames of the force converter fail their checksum.
    ForceCorrupt,
    /// The mains is on the force channels, 50 Hz; size: amplitude, newtons.
    Hum50,
    /// The same, 60 Hz.
    Hum60,
    /// A force channel drifts; size: newtons per second.
    ForceDrift,
    /// A force channel is noisy; size: multiple of the ordinary noise.
    ForceNoisy,
    /// A force channel has the wrong sign.
    ForceSign,
    /// The force cell is mounted turned about the needle; size: degrees.
    ForceTurned,
    /// A force channel reads a part of the other; size: share.
    ForceCrosstalk,
    /// A force channel has another gain; size: multiple.
    ForceGain,
    /// The emergency stop's line is tied to ground: pressing does nothing.
    StopNotWired,
    /// The emergency stop is a normally open switch.
    StopNormallyOpen,
    /// The emergency stop's line is open.
    StopOpen,
    /// The supply sags as soon as a motor has been driven; size: after so many milliseconds.
    BrownOut,
    /// The link flips bits; size: share of them. Acts on the serial line, not here.
    LossyLink,
    /// The device's clock is wrong; size: ratio to the nominal rate. Acts on the host's clock, not here.
    Clock,
}

impl Kind {
    /// Every one.
    pub const ALL: [Self; 31] = [
        Self::LeadsReversed,
        Self::MotorsSwapped,
        Self::BridgeDeadUp,
        Self::BridgeDeadDown,
        Self::Jammed,
        Self::PotentiometerReversed,
        Self::PotentiometersSwapped,
        Self::PotentiometerOpen,
        Self::PotentiometerShorted,
        Self::PotentiometerNoisy,
        Self::PotentiometerSupply,
        Self::ForceDead,
        Self::ForceSwapped,
        Self::ForceSaturated,
        Self::ForceRepeats,
        Self::ForceSilent,
        Self::ForceCorrupt,
        Self::Hum50,
        Self::Hum60,
        Self::ForceDrift,
        Self::ForceNoisy,
        Self::ForceSign,
        Self::ForceTurned,
        Self::ForceCrosstalk,
        Self::ForceGain,
        Self::StopNotWired,
        Self::StopNormallyOpen,
        Self::StopOpen,
        Self::BrownOut,
        Self::LossyLink,
        Self::Clock,
    ];

    /// The finding of `guide bringup` that names it.
    pub const fn id(self) -> &'static str {
        match self {
            Self::LeadsReversed => "motor.leads_reversed",
            Self::MotorsSwapped => "motor.swapped",
            Self::BridgeDeadUp => "motor.dead_up",
            Self::BridgeDeadDown => "motor.dead_down",
            Self::Jammed => "motor.does_not_move",
            Self::PotentiometerReversed => "potentiometer.reversed",
            Self::PotentiometersSwapped => "potentiometer.swapped",
            Self::PotentiometerOpen => "potentiometer.open",
            Self::PotentiometerShorted => "potentiometer.shorted",
            Self::PotentiometerNoisy => "potentiometer.noisy",
            Self::PotentiometerSupply => "potentiometer.supply",
            Self::ForceDead => "force.dead",
            Self::ForceSwapped => "force.swapped",
            Self::ForceSaturated => "force.saturated",
            Self::ForceRepeats => "force.repeats",
            Self::ForceSilent => "force.silent",
            Self::ForceCorrupt => "force.corrupt",
            Self::Hum50 | Self::Hum60 => "force.hum",
            Self::ForceDrift => "force.drift",
            Self::ForceNoisy => "force.noisy",
            Self::ForceSign => "force.sign",
            Self::ForceTurned => "force.turned",
            Self::ForceCrosstalk => "force.crosstalk",
            Self::ForceGain => "force.gain",
            Self::StopNotWired => "stop.not_wired",
            Self::StopNormallyOpen => "stop.normally_open",
            Self::StopOpen => "stop.open",
            Self::BrownOut => "supply.brown_out",
            Self::LossyLink => "link.lossy",
            Self::Clock => "link.clock",
        }
    }

    /// Name on a command line.
    pub fn name(self) -> String {
        let name = format!("{self:?}");
        let mut text = String::new();
        for (at, letter) in name.chars().enumerate() {
            if letter.is_uppercase() && at > 0 {
                text.push('-');
            }
            text.push(letter.to_ascii_lowercase());
        }
        text
    }

    /// It is of one axis.
    pub const fn has_axis(self) -> bool {
        matches!(
            self,
            Self::LeadsReversed
                | Self::BridgeDeadUp
                | Self::BridgeDeadDown
                | Self::Jammed
                | Self::PotentiometerReversed
                | Self::PotentiometerOpen
                | Self::PotentiometerShorted
                | Self::PotentiometerNoisy
                | Self::ForceDead
                | Self::ForceSaturated
                | Self::ForceDrift
                | Self::ForceNoisy
                | Self::ForceSign
                | Self::ForceCrosstalk
                | Self::ForceGain
        )
    }

    /// A small, a middling and a large size; nothing where it has none.
    pub const fn sizes(self) -> &'static [f64] {
        match self {
            Self::PotentiometerNoisy => &[10.0, 25.0, 80.0],
            Self::PotentiometerSupply => &[0.66, 0.76, 1.4],
            Self::Hum50 | Self::Hum60 => &[0.01, 0.05, 0.2],
            Self::ForceDrift => &[0.02, 0.05, 0.1],
            Self::ForceNoisy => &[4.0, 10.0, 25.0],
            Self::ForceTurned => &[10.0, 25.0, -40.0],
            Self::ForceCrosstalk => &[0.12, 0.25, -0.4],
            Self::ForceGain => &[0.5, 0.75, 1.4],
            Self::BrownOut => &[4.0, 8.0, 15.0],
            Self::LossyLink => &[1e-4, 3e-4, 1e-3],
            Self::Clock => &[0.9, 1.05, 1.2],
            _ => &[],
        }
    }
}

/// A fault of a rig.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fault {
    /// Kind of the fault.
    pub kind: Kind,
    /// Its axis, 0 for x and 1 for y; of no meaning where the kind has none.
    pub axis: usize,
    /// Its size; of no meaning where the kind has none.
    pub size: f64,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.kind.name())?;
        if self.kind.has_axis() {
            write!(f, ":{}", ["x", "y"][self.axis.min(1)])?;
        }
        if !self.kind.sizes().is_empty() {
            write!(f, ":{}", self.size)?;
        }
        Ok(())
    }
}

impl FromStr for Fault {
    type Err = String;

    /// `KIND`, `KIND:x`, `KIND:0.05`, `KIND:y:0.05`; without a size the middling one.
    fn from_str(text: &str) -> Result<Self, String> {
        let mut fields = text.split(':');
        let name = fields.next().unwrap_or_default();
        let kind = Kind::ALL.into_iter().find(|kind| kind.name() == name).ok_or_else(|| {
            format!("{name:?} is no fault; expected one of {}", Kind::ALL.map(Kind::name).join(", "))
        })?;
        let mut fault = Self { kind, axis: 0, size: kind.sizes().get(1).copied().unwrap_or(0.0) };
        for part in fields {
            match (part, part.parse::<f64>()) {
                ("x", _) if kind.has_axis() => fault.axis = 0,
                ("y", _) if kind.has_axis() => fault.axis = 1,
                (_, Ok(size)) if size.is_finite() && !kind.sizes().is_empty() => fault.size = size,
                _ => return Err(format!("{part:?} is neither an axis nor a size that {name} has")),
            }
        }
        Ok(fault)
    }
}

/// The faults of one rig, at work.
#[derive(Debug)]
pub(super) struct Wiring {
    faults: Vec<Fault>,
    noise: ChaCha8Rng,
    time_s: f64,
    /// Codes of a newton, and standard deviation of the ordinary noise, codes.
    codes_per_n: f64,
    noise_codes: f64,
    driven_periods: u64,
    kept: Option<[i32; 2]>,
}

/// Noise of a converter without its bridge, relative to the ordinary noise: the cell's own is the larger part.
const BARE_NOISE: f64 = 0.15;
/// A line that is corrupted fails so often: once in this many frames.
const CORRUPT_EVERY: u64 = 4;

impl Wiring {
    pub(super) fn new(faults: Vec<Fault>, seed: u64, codes_per_n: f64, noise_n: f64) -> Self {
        Self {
            faults,
            noise: ChaCha8Rng::seed_from_u64(seed),
            time_s: 0.0,
            codes_per_n,
            noise_codes: noise_n * codes_per_n,
            driven_periods: 0,
            kept: None,
        }
    }

    fn has(&self, kind: Kind) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind)
    }

    /// Inputs of the motors for the commands to the bridges.
    pub(super) fn motors(&mut self, commanded: BridgeInputs, period_s: f64) -> BridgeInputs {
        self.time_s += period_s;
        let is_driven = commanded.iter().any(|[in1, in2]| in1 != in2);
        self.driven_periods = if is_driven { self.driven_periods + 1 } else { 0 };
        let mut inputs = commanded;
        for Fault { kind, axis, .. } in &self.faults {
            let [in1, in2] = inputs[*axis];
            match kind {
                Kind::LeadsReversed => inputs[*axis] = [in2, in1],
                Kind::MotorsSwapped => inputs.reverse(),
                Kind::BridgeDeadUp if in1 > in2 => inputs[*axis] = [0.0; 2],
                Kind::BridgeDeadDown if in1 < in2 => inputs[*axis] = [0.0; 2],
                Kind::Jammed => inputs[*axis] = [0.0; 2],
                _ => {}
            }
        }
        inputs
    }

    /// The supply sags in this period.
    pub(super) fn sags(&mut self) -> bool {
        let sags = self
            .faults
            .iter()
            .any(|fault| fault.kind == Kind::BrownOut && self.driven_periods as f64 >= fault.size);
        if sags {
            self.driven_periods = 0;
        }
        sags
    }

    /// Codes of the converters with the fault.
    pub(super) fn codes(&mut self, codes: Codes) -> Codes {
        let mut potentiometer = codes.potentiometer.map(f64::from);
        let mut bridge = codes.bridge.map(f64::from);
        for fault in self.faults.clone() {
            self.potentiometer(fault, &mut potentiometer);
            self.force(fault, &mut bridge);
        }
        let limit = f64::from(FORCE_CODE_MAX);
        let mut bridge = bridge.map(|code| code.round().clamp(-limit - 1.0, limit) as i32);
        if self.has(Kind::ForceRepeats) {
            bridge = *self.kept.get_or_insert(bridge);
        }
        let most = f64::from(POTENTIOMETER_CODE_MAX);
        Codes { potentiometer: potentiometer.map(|code| code.round().clamp(0.0, most) as u16), bridge }
    }

    fn potentiometer(&mut self, Fault { kind, axis, size }: Fault, codes: &mut [f64; 2]) {
        let most = f64::from(POTENTIOMETER_CODE_MAX);
        match kind {
            Kind::PotentiometerReversed => codes[axis] = most - codes[axis],
            Kind::PotentiometersSwapped => codes.reverse(),
            Kind::PotentiometerOpen => codes[axis] = most,
            Kind::PotentiometerShorted => codes[axis] = 0.0,
            Kind::PotentiometerNoisy => codes[axis] += size * self.draw(),
            Kind::PotentiometerSupply => *codes = codes.map(|code| code * size),
            _ => {}
        }
    }

    fn force(&mut self, Fault { kind, axis, size }: Fault, codes: &mut [f64; 2]) {
        let [x, y] = *codes;
        match kind {
            Kind::ForceDead => codes[axis] = BARE_NOISE * self.noise_codes * self.draw(),
            Kind::ForceSwapped => *codes = [y, x],
            Kind::ForceSaturated => codes[axis] = f64::from(FORCE_CODE_MAX),
            Kind::Hum50 | Kind::Hum60 => {
                let hertz = if kind == Kind::Hum50 { 50.0 } else { 60.0 };
                // Interference that couples into both leads of the cell, and its third harmonic.
                let turns = hertz * self.time_s;
                let hum = size * self.codes_per_n * ((TAU * turns).sin() + 0.3 * (TAU * 3.0 * turns).sin());
                *codes = [x + hum, y + 0.7 * hum];
            }
            Kind::ForceDrift => codes[axis] += size * self.codes_per_n * self.time_s,
            Kind::ForceNoisy => {
                codes[axis] += (size * size - 1.0).max(0.0).sqrt() * self.noise_codes * self.draw();
            }
            Kind::ForceSign => codes[axis] = -codes[axis],
            Kind::ForceTurned => {
                let (sin, cos) = size.to_radians().sin_cos();
                *codes = [cos * x - sin * y, sin * x + cos * y];
            }
            Kind::ForceCrosstalk => codes[axis] += size * codes[1 - axis],
            Kind::ForceGain => codes[axis] *= size,
            _ => {}
        }
    }

    /// The force converter has a new reading, and its frame is intact.
    pub(super) fn converter(&self, period: u64) -> (bool, bool) {
        let corrupt = self.has(Kind::ForceCorrupt) && period.is_multiple_of(CORRUPT_EVERY);
        (!self.has(Kind::ForceSilent), !corrupt)
    }

    /// Level of the emergency stop's line with the switch pressed or not.
    pub(super) fn stop_line(&self, pressed: bool) -> bool {
        (pressed && !self.has(Kind::StopNotWired)) != self.has(Kind::StopNormallyOpen)
            || self.has(Kind::StopOpen)
    }

    fn draw(&mut self) -> f64 {
        StandardNormal.sample(&mut self.noise)
    }
}

#[cfg(test)]
mod tests;
