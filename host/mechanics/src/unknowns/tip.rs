//! Tip and path: load, angles, and what no model has of a path.

use super::{Prior, Unknown};

section! {
    LOAD {
        name: "the tip load in each plane", unit: "N", prior: Prior::normal(0.0, 1.0), scale: 0.1, range: [-50.0, 50.0],
        used_by: "diagnose",
        why: "bevels in soft tissue take some tenths of a newton",
    }
    SHARED_LOAD {
        name: "the tip load that all insertions share over what the paths require", unit: "1", prior: Prior::error(2.0),
        used_by: "predict",
        why: "wide, and in proportion, so that its size weighs no modulus against another",
    }
    LOAD_MEMORY {
        name: "the depth over which the tip load is correlated", unit: "m", prior: Prior::log_normal(0.1, 1.0),
        used_by: "predict",
        why: "from centimetres (layers) to more than the depth (a load that drifts)",
    }
    STATED_LOAD {
        name: "a tip load that a plant states without a range, over what is stated", unit: "1", prior: Prior::normal(1.0, 0.5),
        used_by: "steer, plan-path",
        why: "a value for the kind of tip and tissue, right to a half",
    }
    TYPICAL_LOAD {
        name: "the tip load of a plant that states none", unit: "N", prior: Prior::normal(0.2, 0.1),
        used_by: "steer, plan-path",
        why: "a bevel of an 18 gauge needle in a gel",
    }
    STEERED_PROCESS_NOISE {
        name: "what varies of the tip load along the bevel, share of the load, while steered", unit: "1", prior: Prior::error(0.18),
        used_by: "steer, plan-path",
        why: "not found while a needle moves: the upper end of what insertions of one kind show",
    }
    STEERED_LOAD_MEMORY {
        name: "the depth over which the tip load is correlated, while steered", unit: "m", prior: Prior::fixed(30e-3),
        used_by: "steer, plan-path",
        why: "the shorter end of what insertions show, so that the path ahead stays uncertain",
    }
    LOAD_ACROSS {
        name: "the tip load across the bevel, share of the load", unit: "1", prior: Prior::error(0.10),
        used_by: "steer, plan-path",
        why: "a bevel whose direction is known to 0.1 rad",
    }
    PROCESS_NOISE_ACROSS {
        name: "what varies of the tip load across the bevel, share of the load", unit: "1", prior: Prior::error(0.10),
        used_by: "steer, plan-path",
        why: "half of what varies along it",
    }
    CUT_ANGLE {
        name: "the angle at which a tip cuts that goes where it points", unit: "rad", prior: Prior::error(20e-3),
        used_by: "steer, plan-path",
        why: "paths of bevels of 300 mm radius and more, at knots of 10 mm",
    }
    CUT_ANGLE_ACROSS {
        name: "the same angle across the bevel", unit: "rad", prior: Prior::error(10e-3),
        used_by: "steer, plan-path",
        why: "half of that along it",
    }
    CUT_ANGLE_NOISE {
        name: "what varies of that angle along the path", unit: "rad", prior: Prior::error(2e-3),
        used_by: "steer, plan-path",
        why: "a tenth of the angle itself",
    }
    CUT_ANGLE_BESIDE_LOAD {
        name: "a cut angle beside a load", unit: "rad", prior: Prior::error(10e-3),
        used_by: "steer, plan-path",
        why: "no tip has one law alone",
    }
    ENTRY_ANGLE {
        name: "the angle of entry of one insertion against that of all, by two guides or by hand", unit: "rad", prior: Prior::size(5e-3, 1.5),
        used_by: "predict",
        why: "all sizes are found together, for any rig: wide enough for the two of a diagnosis, 3 and 15 mrad",
    }
    STAGE_ANGLE {
        name: "the angle between the needle and the axis of a stage", unit: "rad", prior: Prior::error(10e-3),
        used_by: "steer, plan-path",
        why: "as the catalogue's tip.entry_angle: a needle in a holder, aligned by eye",
    }
    DRIFT {
        name: "drift of the path of one insertion, where all sizes are found together", unit: "m", prior: Prior::size(10e-6, 1.5),
        used_by: "predict",
        why: "the likeliest size is small and the spread wide enough for the 20 to 50 um of a tracker: a typical drift of 30 um would take what \
              the tip load does to quiet paths",
    }
    SHARED_DRIFT {
        name: "drift that repeats from insertion to insertion over that of one", unit: "1", prior: Prior::error(0.5),
        used_by: "predict",
        why: "a field that is bent is so in all of them",
    }
    IRREGULARITY {
        name: "the tip about a smooth path at single depths", unit: "m", prior: Prior::size(30e-6, 1.0), range: [3e-6, 1.0],
        used_by: "predict",
        why: "a tip cuts in steps; none is smoother than the steps in which the model is solved",
    }
    MOVING_IRREGULARITY {
        name: "more of it while the needle is on its way", unit: "m", prior: Prior::size(0.1e-3, 1.0),
        used_by: "predict",
        why: "friction holds tip and tissue back until the needle rests",
    }
    UNSTEADINESS {
        name: "the direction of the tip about a smooth course at single depths", unit: "rad", prior: Prior::size(1e-3, 1.0),
        range: [30e-6, 1.0],
        used_by: "predict",
        why: "the irregularity of the path over the length of a sensor",
    }
    STEERED_IRREGULARITY {
        name: "what a steered path does that no model has", unit: "m", prior: Prior::error(60e-6),
        used_by: "steer, plan-path",
        why: "twice the irregularity of a path at rest: it is smooth, and not found while a needle moves",
    }
    IRREGULARITY_LENGTH {
        name: "the depth over which that is alike", unit: "m", prior: Prior::fixed(20e-3),
        used_by: "steer, plan-path",
        why: "a needle bends over some centimetres",
    }
    ROUGHNESS {
        name: "the error of the model of a steered path from place to place", unit: "m", prior: Prior::error(15e-6),
        used_by: "steer, plan-path",
        why: "half the irregularity of a path: the part that no smooth one has",
    }
}
