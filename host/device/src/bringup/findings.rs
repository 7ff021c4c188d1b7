//! Findings that a bring-up can report: names, remedies, and which findings block further steps.

use crate::link::error::explain_fault;
use protocol::Fault;
use serde::Serialize;

/// A finding of the catalogue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CatalogueEntry {
    /// Its name in documents.
    pub id: &'static str,
    /// Description of the fault.
    pub what: &'static str,
    /// Remedy.
    pub remedy: &'static str,
    /// No step that depends on this one may run.
    pub blocks: bool,
}

const fn entry(id: &'static str, what: &'static str, remedy: &'static str, blocks: bool) -> CatalogueEntry {
    CatalogueEntry { id, what, remedy, blocks }
}

/// All findings.
pub const CATALOGUE: [CatalogueEntry; 41] = [
    entry(
        "link.lossy",
        "the serial link damages or loses frames",
        "shorter cable, ground next to the data lines, no hub; away from the motors' leads",
        false,
    ),
    entry(
        "link.clock",
        "the device's clock runs at a wrong rate",
        "the crystal or its solder joints, or the image is that of another board",
        false,
    ),
    entry(
        "supply.brown_out",
        "the supply sags so far that the device restarts",
        "a stronger supply for the motors, their own leads to it, 470 uF at the bridges",
        true,
    ),
    entry(
        "supply.restarted",
        "the device restarts by itself",
        "`guide status` shows the reset reason and the last panic; report a panic",
        true,
    ),
    entry(
        "stop.not_wired",
        "pressing the emergency stop does nothing",
        "connect the switch between ground and the input (B-L475E-IOT01A: A3; NUCLEO-L476RG: A2); remove a bridge from the input to ground",
        true,
    ),
    entry(
        "stop.normally_open",
        "the emergency stop is a normally open switch",
        "use the normally closed contact: a cut wire has to stop too",
        true,
    ),
    entry(
        "stop.open",
        "the line of the emergency stop is open",
        "plug in or repair the wire of the switch; release the switch",
        true,
    ),
    entry(
        "stop.stays",
        "the line of the emergency stop stays open after its release",
        "release the switch (most have to be turned); then as for an open line",
        true,
    ),
    entry(
        "force.silent",
        "the force converter gives no readings",
        "supply, clock and data-ready line of the converter",
        true,
    ),
    entry(
        "force.corrupt",
        "frames of the force converter arrive damaged",
        "shorter SPI wires, a ground beside SCLK, a lower SPI clock",
        false,
    ),
    entry(
        "force.resets",
        "the force converter resets",
        "supply of the converter and its SYNC/RESET line",
        false,
    ),
    entry(
        "force.saturated",
        "a force channel is at the end of the converter's range",
        "an open bridge wire or swapped excitation: 350 ohm between each pair of the cell; unload the needle",
        true,
    ),
    entry(
        "force.repeats",
        "the force converter repeats the same reading",
        "clock of the converter (CLKIN) and its set-up",
        true,
    ),
    entry(
        "force.dead",
        "a force channel measures nothing",
        "its two signal wires: 350 ohm between them, some mV under load",
        true,
    ),
    entry(
        "force.noisy",
        "a force channel is noisy",
        "shield of the cell at one end, twisted wires, away from the motors; reference of the converter",
        false,
    ),
    entry(
        "force.hum",
        "mains interference on the force channels",
        "ground the cell's shield at one end only, another power supply for the computer, twisted wires",
        false,
    ),
    entry(
        "force.drift",
        "a force channel drifts",
        "wait for the cell to warm up (10 min), strain relief of its cable, no draught",
        false,
    ),
    entry(
        "force.limit",
        "the force at rest exceeds the limit",
        "`guide retreat`, or open the needle's clamp",
        true,
    ),
    entry(
        "potentiometer.open",
        "a potentiometer reads its greatest code",
        "its wiper or ground wire is open",
        true,
    ),
    entry(
        "potentiometer.shorted",
        "a potentiometer reads its smallest code",
        "its wiper is shorted to ground, or its supply wire is open",
        true,
    ),
    entry(
        "potentiometer.noisy",
        "a potentiometer is noisy",
        "its wiper's contact and wires; 100 nF at the converter's pin",
        true,
    ),
    entry(
        "potentiometer.supply",
        "the supply of the potentiometers is not the converter's reference",
        "both ends of the tracks to 3.3 V (VREF) and ground of the board, not 5 V",
        true,
    ),
    entry(
        "potentiometer.off_middle",
        "a guide is far from the middle of its travel, or its potentiometer is mounted off the middle",
        "turn the rod to the middle by hand; otherwise check the mounting of the actuator",
        true,
    ),
    entry("potentiometer.jumps", "a potentiometer jumps", "its wiper's contact and wires", true),
    entry("motor.swapped", "each motor is wired to the bridge of the other", "swap the motors' plugs", true),
    entry(
        "motor.leads_reversed",
        "the leads of a motor are reversed",
        "swap the two leads of this motor",
        true,
    ),
    entry(
        "motor.dead_up",
        "a motor does not move upwards",
        "IN1 of its bridge: wire, solder, the half bridge",
        true,
    ),
    entry(
        "motor.dead_down",
        "a motor does not move downwards",
        "IN2 of its bridge: wire, solder, the half bridge",
        true,
    ),
    entry(
        "motor.does_not_move",
        "a motor does not move",
        "supply of the motors, the motor's plug, nSLEEP of its bridge; a jammed rod",
        true,
    ),
    entry(
        "motor.presses",
        "a motor presses against a stiff load during a pulse",
        "free the needle and the guide",
        true,
    ),
    entry(
        "potentiometer.swapped",
        "each potentiometer is wired to the pin of the other",
        "swap the wipers' wires (A0, A1)",
        true,
    ),
    entry(
        "potentiometer.reversed",
        "the ends of a potentiometer's track are swapped",
        "swap the two outer wires of this potentiometer",
        true,
    ),
    entry(
        "potentiometer.stuck",
        "a potentiometer does not follow its rod",
        "its wiper's wire; the coupling between rod and track",
        true,
    ),
    entry("loop.fault", "the position loop ends in a fault", "the fault's own remedy", true),
    entry(
        "loop.inaccurate",
        "the position loop does not settle where it should",
        "friction of the rod, supply of the motors, noise of the potentiometer",
        false,
    ),
    entry(
        "force.swapped",
        "the force channels are swapped",
        "swap the cell's plugs, or store a calibration that swaps the channels",
        false,
    ),
    entry(
        "force.sign",
        "a force channel has the wrong sign",
        "swap the two signal wires of this channel, or store a calibration that corrects the sign",
        false,
    ),
    entry(
        "force.turned",
        "the force cell is turned about the needle",
        "turn the cell, or store a calibration from weights",
        false,
    ),
    entry(
        "force.crosstalk",
        "a force channel reads a part of the other",
        "store a calibration from weights in several directions",
        false,
    ),
    entry(
        "force.gain",
        "the gains of the force channels differ",
        "check both with one known weight; store a calibration",
        false,
    ),
    entry(
        "force.no_response",
        "no force responds to the motion",
        "mount the needle in both guides; otherwise the cell is not in the load path",
        false,
    ),
];

/// A fault of this rig.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Finding {
    /// Name in [`CATALOGUE`].
    pub id: &'static str,
    /// Axis `x` or `y`; `None` if it concerns neither or both.
    pub axis: Option<&'static str>,
    /// Description of the fault.
    pub what: &'static str,
    /// Measured values.
    pub measured: String,
    /// Remedy.
    pub remedy: &'static str,
    /// Other findings that explain the measured values equally well.
    pub or_else: Vec<&'static str>,
}

impl Finding {
    /// The finding of this name.
    pub(super) fn new(id: &'static str, axis: Option<usize>, measured: String) -> Self {
        let entry = CatalogueEntry::of(id);
        let axis = axis.map(|axis| if axis == 0 { "x" } else { "y" });
        Self { id, axis, what: entry.what, measured, remedy: entry.remedy, or_else: Vec::new() }
    }

    /// The same with another explanation.
    pub(super) fn or(mut self, id: &'static str) -> Self {
        self.or_else.push(CatalogueEntry::of(id).id);
        self
    }

    /// No step that depends on this one may run.
    pub fn blocks(&self) -> bool {
        CatalogueEntry::of(self.id).blocks
    }
}

impl CatalogueEntry {
    fn of(id: &'static str) -> Self {
        CATALOGUE.into_iter().find(|known| known.id == id).unwrap_or(entry(id, "", "", true))
    }
}

/// The finding of a fault that is latched at rest.
pub(super) fn of_fault(fault: Fault) -> Finding {
    let id = match fault {
        Fault::EmergencyStop => "stop.stays",
        Fault::ForceSensor => "force.silent",
        Fault::ForceStuck => "force.repeats",
        Fault::ForceRange => "force.saturated",
        Fault::ForceLimit => "force.limit",
        Fault::Potentiometer => "potentiometer.jumps",
        Fault::Travel => "potentiometer.off_middle",
        Fault::Restarted => "supply.restarted",
        _ => "loop.fault",
    };
    Finding::new(id, None, explain_fault(fault))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_there_once_with_its_remedy_and_in_the_manual() {
        for (at, known) in CATALOGUE.iter().enumerate() {
            assert!(!known.what.is_empty() && !known.remedy.is_empty(), "{}", known.id);
            let (answer, page) = (
                if known.blocks { "yes" } else { "no" },
                include_str!("../../../manual/src/commands/bringup.md"),
            );
            let row = format!("| `{}` | {} | {} | {answer} |", known.id, known.what, known.remedy);
            assert!(page.lines().any(|line| line == row), "the manual has no {row}");
            assert!(CATALOGUE[..at].iter().all(|other| other.id != known.id), "{} twice", known.id);
        }
    }
}
