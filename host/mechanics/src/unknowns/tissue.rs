//! Tissue: modulus, surface, gap.

use super::{Prior, Unknown};

section! {
    MODULUS {
        name: "the modulus: K of springs, E of a body", unit: "Pa", prior: Prior::log_normal(15e3, 1.0), range: [50.0, 5e6],
        used_by: "identify, diagnose, predict",
        why: "soft tissue and gels, two standard deviations from 2 to 110 kPa; lateral runs determine it to a few percent, so that this matters \
              for insertions alone, whose intervals hold with it",
    }
    MODULUS_OF_REFERENCE_NEEDLE {
        name: "the modulus about a reference needle, where the needle's stiffness is not known", unit: "Pa",
        prior: Prior::log_normal(30e3, 1.5),
        used_by: "predict",
        why: "paths then determine K/(E I) only: two standard deviations reach from soft tissue about a stiff needle to stiff tissue about a \
              thin one, 600 kPa",
    }
    STATED_MODULUS {
        name: "a modulus that a plant states without a range", unit: "Pa", prior: Prior::log_normal(12e3, 0.5),
        used_by: "steer, plan-path",
        why: "a value for the kind of tissue, right to a factor of 1.6; where none is stated, that of the plants of the steering study",
    }
    INSERTION_MODULUS {
        name: "the modulus of an insertion over that of a lateral run", unit: "1", prior: Prior::log_normal(1.0, 0.1),
        range: [0.37, 2.7],
        used_by: "diagnose, predict",
        why: "faster motion, tissue that was cut: tissue that relaxes by a tenth in each decade of time is that much stiffer",
    }
    REFERENCE_RATIO {
        name: "the modulus of a session over that of its reference", unit: "1", prior: Prior::log_normal(1.0, 0.3),
        range: [0.0067, 150.0],
        used_by: "diagnose --reference",
        why: "the same preparation on another day differs by a third",
    }
    LAYER_MODULUS {
        name: "the modulus of a layer over that of the tissue", unit: "1", prior: Prior::log_normal(1.0, 0.3),
        used_by: "steer, plan-path",
        why: "layers of organs and of cast phantoms differ by a third about their mean; a path shows each only weakly",
    }
    LAYER_LENGTH {
        name: "the depth over which layers' moduli are alike", unit: "m", prior: Prior::fixed(30e-3),
        used_by: "steer, plan-path",
        why: "a layer is some centimetres thick; paths do not determine it",
    }
    SKIN {
        name: "the stiffness of skin at the surface", unit: "N/m", prior: Prior::log_normal(150.0, 1.2),
        used_by: "steer, plan-path",
        why: "from none that matters (15 N/m) to a membrane that holds the needle (1500 N/m), within two standard deviations",
    }
    FIELD_UNIFORM {
        name: "variation of stiffness within a layer that was cast, first order of its logarithm", unit: "1", prior: Prior::fixed(0.02),
        used_by: "track",
        why: "gels are cast uniform; probability 0.6 before the run",
    }
    FIELD_NEARLY_UNIFORM {
        name: "variation of stiffness within a nearly uniform layer, first order of its logarithm", unit: "1",
        prior: Prior::fixed(0.1),
        used_by: "track",
        why: "gels that set unevenly, muscle along its fibres; probability 0.3 before the run",
    }
    FIELD_VARIED {
        name: "variation of stiffness within tissue with inclusions, first order of its logarithm", unit: "1", prior: Prior::fixed(0.5),
        used_by: "track",
        why: "inclusions and cavities; probability 0.1 before the run",
    }
    SURFACE {
        name: "the place of the surface against what is stated", unit: "m", prior: Prior::error(0.3e-3),
        used_by: "identify, diagnose, predict",
        why: "a ruler beside a surface that is not flat",
    }
    SURFACE_IN_INSERTIONS {
        name: "the place of the surface that a tip indents, where no effective gap is unknown", unit: "m", prior: Prior::error(1e-3),
        used_by: "diagnose",
        why: "a tip indents the surface before it cuts, by about a millimetre; predictions have that in the effective gap",
    }
    GAP {
        name: "the gap between an only guide and the surface over what is stated, where a surface that gives way is an effect of its own",
        unit: "1", prior: Prior::log_normal(1.0, 0.15), range: [0.37, 2.7],
        used_by: "diagnose",
        why: "the guide holds the needle somewhere along its own length; more is tissue.entry_gap",
    }
    EFFECTIVE_GAP {
        name: "the effective gap of an insertion over the stated gap", unit: "1", prior: Prior::log_normal(1.0, 0.7),
        used_by: "predict",
        why: "needles are loose in guides and surfaces give way, and no effect has that in a prediction: the length that bends freely is up to four \
              times the gap, or a quarter",
    }
    GAP_OF_STAGE {
        name: "the gap between the guide of a stage and the surface", unit: "m", prior: Prior::error(0.5e-3),
        used_by: "steer, plan-path",
        why: "a measured distance, and a surface that gives way",
    }
}

/// Variation of a layer's stiffness within, each with its probability before a run.
pub const FIELD_VARIATIONS: [(Unknown, f64); 3] =
    [(FIELD_UNIFORM, 0.6), (FIELD_NEARLY_UNIFORM, 0.3), (FIELD_VARIED, 0.1)];
