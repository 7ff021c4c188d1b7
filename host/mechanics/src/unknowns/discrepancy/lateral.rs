//! In lateral runs.

use crate::unknowns::{Prior, Unknown};

section! {
    MODULUS_FROM_RUN_TO_RUN {
        name: "modulus from run to run", unit: "1", prior: Prior::size(0.01, 1.0),
        used_by: "diagnose, identify",
        why: "temperature and history of the tissue",
    }
    MODULUS_CHANGING {
        name: "modulus changing from run to run", unit: "1", prior: Prior::size(0.003, 1.0),
        used_by: "diagnose, identify",
        why: "tissue dries, warms up or is damaged, per run",
    }
    MODULUS_OVER_DEPTH {
        name: "modulus over depth", unit: "1", prior: Prior::size(0.02, 0.5),
        used_by: "diagnose, identify",
        why: "no gel sets evenly; half the usual tail, as layers and gradients are effects",
    }
    REPEATING_SHAPE {
        name: "repeating shape pattern", unit: "m", prior: Prior::size(6e-6, 1.0),
        used_by: "diagnose, identify",
        why: "texture of an image, the same in every sweep",
    }
    SMOOTH_SHAPE {
        name: "smooth shape error", unit: "m", prior: Prior::size(10e-6, 1.0),
        used_by: "diagnose, identify",
        why: "lens and beam of an image after calibration",
    }
    SHAPE_PROPORTIONAL {
        name: "shape error proportional to deflection", unit: "1", prior: Prior::size(0.01, 1.0),
        used_by: "diagnose, identify",
        why: "scale of an image over its field",
    }
    SHAPE_PROPORTIONAL_OF_RUN {
        name: "shape error proportional to deflection, of one run", unit: "1", prior: Prior::size(0.005, 1.0),
        used_by: "diagnose, identify",
        why: "how the image was set up for the run",
    }
    SHAPE_OFFSET {
        name: "shape offset of one run", unit: "m", prior: Prior::size(5e-6, 1.0),
        used_by: "diagnose, identify",
        why: "zero of an image that was set up again",
    }
    AXES {
        name: "axes not square", unit: "1", prior: Prior::size(0.01, 1.0),
        used_by: "diagnose, identify",
        why: "axes are aligned to about half a degree",
    }
    FORCE_GAIN_OF_RUN {
        name: "force gain of one run", unit: "1", prior: Prior::size(0.004, 1.0),
        used_by: "diagnose, identify",
        why: "temperature of the bridge and its amplifier",
    }
    NONLINEAR_FORCE {
        name: "nonlinear force sensor", unit: "1", prior: Prior::size(0.005, 1.0),
        used_by: "diagnose, identify",
        why: "data sheets of load cells state 0.1 to 0.5 % of the range",
    }
    FORCE_HYSTERESIS {
        name: "hysteresis of the force", unit: "1", prior: Prior::size(0.005, 1.0),
        used_by: "diagnose, identify",
        why: "data sheets of load cells, and what guides rub",
    }
    FORCE_CREEP {
        name: "creep of the force sensor", unit: "1", prior: Prior::size(0.005, 1.0),
        used_by: "diagnose, identify",
        why: "data sheets of load cells, within minutes",
    }
    FORCE_OF_HOLD {
        name: "force of one hold", unit: "N", prior: Prior::size(0.003, 1.0),
        used_by: "diagnose, identify",
        why: "tissue and guides settle a little differently each time",
    }
    FORCE_ON_THE_WAY {
        name: "force on the way", unit: "N", prior: Prior::size(0.003, 1.0),
        used_by: "diagnose, identify",
        why: "what guides rub while they move",
    }
    FORCE_DRIFT {
        name: "drift of the force in one run", unit: "N", prior: Prior::size(0.003, 1.0),
        used_by: "diagnose, identify",
        why: "temperature of the bridge within minutes",
    }
}
