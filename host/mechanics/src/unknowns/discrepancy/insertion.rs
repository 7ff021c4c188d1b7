//! In insertions. A single event determines no size, so that this is known.

use crate::unknowns::{Prior, Unknown};

section! {
    MODULUS_OF_ONE {
        name: "modulus from insertion to insertion", unit: "1", prior: Prior::size(0.03, 1.0),
        used_by: "diagnose, predict",
        why: "another track through the same tissue",
    }
    LOAD_OF_ONE {
        name: "tip load from insertion to insertion", unit: "1", prior: Prior::size(0.05, 1.0),
        used_by: "diagnose, predict",
        why: "the same bevel in the same tissue, cut anew: 2 to 10 %",
    }
    ENTRY_ANGLE {
        name: "angle of entry from insertion to insertion", unit: "rad", prior: Prior::size(3e-3, 1.0),
        used_by: "diagnose",
        why: "a needle in two guides that is set down again",
    }
    ENTRY_ANGLE_BY_HAND {
        name: "angle of entry from insertion to insertion, by one guide and a hand", unit: "rad", prior: Prior::size(15e-3, 1.0),
        used_by: "diagnose",
        why: "the hand takes the needle again, along another line",
    }
    SURFACE_OF_ONE {
        name: "surface from insertion to insertion", unit: "m", prior: Prior::size(0.2e-3, 1.0),
        used_by: "diagnose, predict",
        why: "a surface that is not flat, beside the last puncture: at most 0.2 to 0.5 mm",
    }
    ROLL_OF_ONE {
        name: "roll from insertion to insertion", unit: "rad", prior: Prior::size(0.02, 1.0),
        used_by: "diagnose",
        why: "a needle that is gripped again",
    }
    LOAD_OVER_DEPTH_OF_ONE {
        name: "tip load over depth of one insertion", unit: "1", prior: Prior::size(0.02, 1.5),
        used_by: "diagnose, predict",
        why: "tissue is uneven at the scale of a tip: from a gel to muscle by more than a factor of four",
    }
    LOAD_OVER_DEPTH {
        name: "tip load over depth", unit: "1", prior: Prior::size(0.02, 1.5),
        used_by: "diagnose, predict",
        why: "unevenness that repeats along one track",
    }
    DRIFT_OF_ONE {
        name: "drift of the path of one insertion", unit: "m", prior: Prior::size(30e-6, 1.0),
        used_by: "diagnose",
        why: "fields of trackers are bent a little, and warm up: 20 to 50 um",
    }
    SMOOTH_PATH {
        name: "smooth error of the path", unit: "m", prior: Prior::size(30e-6, 1.0),
        used_by: "diagnose",
        why: "a field that is bent is so in all insertions",
    }
    DIRECTION_DRIFT_OF_ONE {
        name: "drift of the direction of one insertion", unit: "rad", prior: Prior::size(2e-3, 1.0),
        used_by: "diagnose, predict",
        why: "a sensor some millimetres long on a needle that bends",
    }
    SMOOTH_DIRECTION {
        name: "smooth error of the direction", unit: "rad", prior: Prior::size(2e-3, 1.0),
        used_by: "diagnose",
        why: "the same in all insertions",
    }
    DIRECTION_PROPORTIONAL {
        name: "direction proportional to itself", unit: "1", prior: Prior::size(0.03, 1.0),
        used_by: "diagnose",
        why: "a sensor is some millimetres long, and behind the tip",
    }
    DIRECTION_PROPORTIONAL_OF_ONE {
        name: "direction proportional to itself, of one insertion", unit: "1", prior: Prior::size(0.02, 1.0),
        used_by: "diagnose",
        why: "a sensor that sits loosely",
    }
    TILT {
        name: "tilt of the tracker", unit: "rad", prior: Prior::error(4e-3),
        used_by: "diagnose",
        why: "two guides give the axis along which depth is measured",
    }
    TILT_BY_HAND {
        name: "tilt of the tracker, set up by hand", unit: "rad", prior: Prior::error(50e-3),
        used_by: "diagnose of one guide, predict",
        why: "axes are set by eye, and a hand takes the needle along another line; one value in each plane, which determines little of a size: \
              wide",
    }
    ROLL {
        name: "roll of the bevel", unit: "rad", prior: Prior::error(0.03),
        used_by: "diagnose",
        why: "the mark on a hub is set by eye, to two degrees",
    }
}
