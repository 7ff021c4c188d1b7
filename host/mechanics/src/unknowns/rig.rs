//! Needle and guides.

use super::{Prior, Unknown};

section! {
    GUIDE2_POSITION {
        name: "the position of guide 2 along the needle against what is stated", unit: "m", prior: Prior::error(0.3e-3),
        used_by: "identify, diagnose, plan",
        why: "a ruler along the rig; the guide holds somewhere along its own length",
    }
    OUTER_DIAMETER {
        name: "the needle's outer diameter against what is stated", unit: "m", prior: Prior::error(4e-6),
        used_by: "identify, diagnose, plan",
        why: "a micrometer screw is read to this; tubing of gauge 15 to 19 is sold to 0.013 mm, and the ranges of ISO 9626 are several times as \
              wide, so that who reads the diameter from the gauge states outer_diameter_sd_mm",
    }
    INNER_DIAMETER {
        name: "the needle's inner diameter against what is stated", unit: "m", prior: Prior::error(4e-6),
        used_by: "identify, diagnose, plan",
        why: "as the outer one, by plug gauges; tubing is sold to 0.038 mm, so that who reads it from the gauge states inner_diameter_sd_mm",
    }
    NEEDLE_LENGTH {
        name: "the needle's length against what is stated", unit: "m", prior: Prior::error(0.5e-3),
        used_by: "identify, diagnose, plan",
        why: "a ruler, and a bevel whose tip is not where the tube ends",
    }
    NEEDLE_STIFFNESS {
        name: "the needle's bending stiffness against what is stated", unit: "1", prior: Prior::error(0.03),
        used_by: "diagnose, identify",
        why: "of a needle of 1.27 mm over 1.0 mm; of another one it is computed from its diameters and Young's modulus",
    }
    YOUNGS_MODULUS {
        name: "Young's modulus of the needle against what is stated, its logarithm", unit: "1", prior: Prior::error(0.015),
        used_by: "diagnose, identify",
        why: "drawn stainless steel differs by as much from heat to heat",
    }
    UNSTATED_STIFFNESS {
        name: "the needle's bending stiffness over that of a solid reference of its diameter, where none is stated", unit: "1",
        prior: Prior::log_normal(1.0, 0.4),
        used_by: "steer, plan-path",
        why: "walls of one gauge differ by a factor of 1.5 in stiffness; the path determines K/(E I) alone",
    }
    CLEARANCE {
        name: "the clearance of guide 2", unit: "m", prior: Prior::error(5e-6),
        used_by: "diagnose, identify",
        why: "no bearing is without any; more is the effect rig.backlash",
    }
    GUIDE2_ZERO {
        name: "guide 2 against its zero, in all insertions", unit: "m", prior: Prior::error(50e-6),
        used_by: "predict, diagnose",
        why: "clearance, and how it was mounted",
    }
    GUIDE2_ZERO_OF_ONE {
        name: "guide 2 against its zero, in one insertion", unit: "m", prior: Prior::error(10e-6),
        used_by: "predict",
        why: "where the needle lies in the clearance",
    }
    GUIDE2_PLACE {
        name: "where guide 2 stands in a hold against the mean of its readings", unit: "m", prior: Prior::error(3e-6),
        used_by: "diagnose, identify",
        why: "no actuator's reading is right to better than this, however long it is averaged",
    }
    GUIDE2_CREEP {
        name: "where guide 2 stands in a hold against the mean of its readings, by the side that it came from", unit: "m",
        prior: Prior::error(1e-6),
        used_by: "characterize",
        why: "a tenth of a code of a potentiometer of 50 mm read in twelve bits, and about as far guide 2 creeps while it settles",
    }
    CLAMP_COMPLIANCE {
        name: "how far the needle turns in guide 1 per moment", unit: "rad/(N m)", prior: Prior::log_normal(0.05, 2.0),
        used_by: "steer, plan-path",
        why: "one standard deviation less is a clamp, of which a span of 60 mm of 18 gauge feels one part in a hundred; two more, nearly a hinge",
    }
    REAR_COMPLIANCE {
        name: "how far a needle turns at a rear of which nothing is stated", unit: "rad/(N m)", prior: Prior::log_normal(0.5, 2.0),
        range: [1e-4, 1e3],
        used_by: "diagnose, identify",
        why: "held by a hand or a chuck, from stiff to soft",
    }
    REAR_SHARE {
        name: "the share of the needle's stiffness in that of needle and rear in series, where nothing is stated of the rear", unit: "1",
        prior: Prior::normal(0.4, 0.3), range: [0.0, 1.0],
        used_by: "predict",
        why: "anything between a clamp (0) and a hinge (1): the compliance above, as a needle of 18 gauge has it that bends freely over 25 mm \
              (0.39, and 0.08 to 0.82 at one standard deviation)",
    }
    REAR_SHARE_OF_ONE {
        name: "the same share of one insertion against that of all", unit: "1", prior: Prior::error(0.03),
        used_by: "predict",
        why: "the needle is gripped again for each",
    }
    STAGE_ERROR {
        name: "a constant error of the guide of a stage over the error that is stated of it", unit: "1", prior: Prior::error(0.4),
        used_by: "steer, plan-path",
        why: "a stated error is a limit of 2.5 standard deviations",
    }
    STAGE_BACKLASH {
        name: "half the backlash of the guide of a stage over the error that is stated of it", unit: "1", prior: Prior::normal(0.25, 0.25),
        used_by: "steer, plan-path",
        why: "backlash is the largest part of what positions a stage wrongly; runs in air determine it",
    }
}
