//! Sensors: noise where neither the session nor its readings give it, zeros, clocks.

use super::{Prior, Unknown};

section! {
    FORCE_NOISE {
        name: "noise of a reading of the force", unit: "N", prior: Prior::fixed(0.05), range: [1e-3, 10.0],
        used_by: "diagnose, identify, plan, simulate",
        why: "1 % of a sensor of 5 N; none resolves better than 0.02 % of its range",
    }
    DISPLACEMENT_NOISE {
        name: "noise of a reading of the displacement of guide 2", unit: "m", prior: Prior::fixed(20e-6), range: [1e-6, 1e-3],
        used_by: "diagnose, identify, plan, simulate",
        why: "a potentiometer of 50 mm; no encoder of a stage is right to better than a micrometre",
    }
    SHAPE_NOISE {
        name: "noise of a point of a shape", unit: "m", prior: Prior::fixed(30e-6), range: [2e-6, 1e-3],
        used_by: "diagnose, identify, plan",
        why: "a pixel of a camera or an ultrasound probe, interpolated",
    }
    TIP_NOISE {
        name: "noise of a reading of the tip", unit: "m", prior: Prior::fixed(0.1e-3), range: [10e-6, 10e-3],
        used_by: "diagnose, simulate",
        why: "electromagnetic trackers scatter by about 0.1 mm at rest",
    }
    DIRECTION_NOISE {
        name: "noise of a reading of the tip's direction", unit: "rad", prior: Prior::fixed(1e-3), range: [0.1e-3, 0.1],
        used_by: "diagnose, predict",
        why: "a tracker's angle, averaged over a reading",
    }
    PLACED_POINT {
        name: "a point of a ruler in an image that is placed by hand, along the ruler", unit: "px", prior: Prior::error(0.5),
        used_by: "import camera",
        why: "a hand and an eye at the pixels of a screen",
    }
    FORCE_ZERO {
        name: "force zero of one run", unit: "N", prior: Prior::size(0.01, 1.0),
        used_by: "identify, diagnose, characterize",
        why: "what a bridge of 5 N drifts after a tare, by temperature and cable",
    }
    UNTARED_FORCE_ZERO {
        name: "the zero of a force cell that was not tared", unit: "N", prior: Prior::error(0.1),
        used_by: "identify",
        why: "2 % of a rated range of 5 N, as data sheets state it for the zero balance",
    }
    FORCE_ZERO_SETTLING {
        name: "settling of the zero in one run", unit: "N", prior: Prior::size(0.002, 1.0),
        used_by: "characterize",
        why: "drift after a tare that does not go evenly, over 5 and 20 s",
    }
    FORCE_OF_ONE_HOLD_IN_AIR {
        name: "force of one hold, in air", unit: "N", prior: Prior::size(0.001, 1.0),
        used_by: "characterize",
        why: "0.02 % of a sensor of 5 N, or 4 um of guide 2",
    }
    FORCE_GAIN {
        name: "the force sensor's gain against what is stated", unit: "1", prior: Prior::error(0.01),
        used_by: "diagnose, identify",
        why: "calibration with a weight, and how the cell is mounted",
    }
    CLOCK {
        name: "when a row's force and position were sampled", unit: "s", prior: Prior::error(5e-4),
        used_by: "characterize",
        why: "they have converters of their own",
    }
    TIP_ZERO_OF_ONE {
        name: "the zero of a tip sensor in one insertion against that of all", unit: "m", prior: Prior::size(0.3e-3, 1.5),
        used_by: "predict",
        why: "where the needle entered beside the axis",
    }
    SHARED_TIP_ZERO {
        name: "the zero of a tip sensor", unit: "m", prior: Prior::error(0.1),
        used_by: "diagnose, predict",
        why: "a tracker's origin is anywhere; one value in each plane, which determines little of a size: wide",
    }
    STEERED_TIP_ZERO {
        name: "the tip beside the axis of a stage at the surface", unit: "m", prior: Prior::error(0.15e-3),
        used_by: "steer, plan-path",
        why: "the controller is told where the surface is, and the tip rests on it before the start",
    }
    COIL_ANGLE {
        name: "angle of the sensor in the tip", unit: "rad", prior: Prior::error(50e-3),
        used_by: "diagnose, predict",
        why: "a coil of a millimetre glued into a bore that is wider; one value in each plane, which determines little of a size: wide",
    }
    TILT_OF_ONE {
        name: "tilt of the direction sensor on the needle in one insertion against that of all", unit: "rad",
        prior: Prior::size(2e-3, 1.5),
        used_by: "predict",
        why: "a sensor that sits loosely",
    }
}
