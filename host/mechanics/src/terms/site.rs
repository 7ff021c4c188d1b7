//! Sites of terms.

use super::Regressor;
use crate::effects::RunKinds;

/// Site of a term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Site {
    /// The reading of the lateral force: `F + f`, newtons.
    Force,
    /// Its gain: `F (1 + f)`.
    ForceGain,
    /// The measured deflection: `u + f`, millimetres.
    Shape,
    /// Its gain: `u (1 + f)`.
    ShapeGain,
    /// Position along the needle at which the shape is measured: at `z + f`, millimetres.
    ShapePosition,
    /// Part of guide 2's displacement that reaches the needle: `d + f`, millimetres.
    Guide,
    /// The modulus of the tissue: `K (1 + f)`.
    Modulus,
    /// The measured position of the tip: `y + f`, millimetres.
    Tip,
    /// Its gain: `y (1 + f)`.
    TipGain,
    /// The measured direction of the tip: `y' + f`, milliradians.
    TipDirection,
    /// Its gain: `y' (1 + f)`.
    TipDirectionGain,
    /// The load on the tip along its bevel: `w + f`, newtons.
    TipLoad,
    /// The position of the tissue itself: it reacts with `K (u - f)`, millimetres.
    Tissue,
    /// The reaction of the tissue: `K u (1 + f)`.
    Reaction,
    /// The bending stiffness of the needle: `EI (1 + f)`.
    Stiffness,
    /// The rotation of the needle in guide 1 per moment: `C + f`, rad/(N m).
    Clamp,
    /// The moment by which guide 2 resists a rotation of the needle: `M = f u'`, N m/rad.
    GuideTurn,
    /// The force by which what lies at the tip resists its deflection: `F = f u`, N/mm.
    TipSupport,
    /// A lateral force on the tip while guide 2 moves or rests, as a bevel takes it, newtons.
    TipPush,
}

/// The planes in which a term acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Scope {
    /// In both alike.
    Both,
    /// In the vertical one.
    Vertical,
    /// In the horizontal one.
    Horizontal,
}

impl Scope {
    /// Every one there is.
    pub const ALL: [Self; 3] = [Self::Both, Self::Vertical, Self::Horizontal];

    /// Whether it acts in a plane, vertical (0) or horizontal (1).
    pub fn has(self, plane: usize) -> bool {
        match self {
            Self::Both => true,
            Self::Vertical => plane == 0,
            Self::Horizontal => plane == 1,
        }
    }

    /// Suffix of a site's name.
    pub fn suffix(self) -> &'static str {
        match self {
            Self::Both => "",
            Self::Vertical => "_y",
            Self::Horizontal => "_x",
        }
    }
}

impl Site {
    /// Every one there is.
    pub const ALL: [Self; 19] = [
        Self::Force,
        Self::ForceGain,
        Self::Shape,
        Self::ShapeGain,
        Self::ShapePosition,
        Self::Guide,
        Self::Modulus,
        Self::Tip,
        Self::TipGain,
        Self::TipDirection,
        Self::TipDirectionGain,
        Self::TipLoad,
        Self::Tissue,
        Self::Reaction,
        Self::Stiffness,
        Self::Clamp,
        Self::GuideTurn,
        Self::TipSupport,
        Self::TipPush,
    ];

    /// The site and the planes of a name like `shape_y`.
    pub fn parse(name: &str) -> Option<(Self, Scope)> {
        Self::ALL.iter().find_map(|of| {
            let scope = name.strip_prefix(of.name())?;
            Scope::ALL.into_iter().find(|one| one.suffix() == scope).map(|scope| (*of, scope))
        })
    }

    /// Its name in ids.
    pub fn name(self) -> &'static str {
        match self {
            Self::Force => "force",
            Self::ForceGain => "force_gain",
            Self::Shape => "shape",
            Self::ShapeGain => "shape_gain",
            Self::ShapePosition => "shape_position",
            Self::Guide => "guide",
            Self::Modulus => "modulus",
            Self::Tip => "tip",
            Self::TipGain => "tip_gain",
            Self::TipDirection => "tip_direction",
            Self::TipDirectionGain => "tip_direction_gain",
            Self::TipLoad => "tip_load",
            Self::Tissue => "tissue",
            Self::Reaction => "reaction",
            Self::Stiffness => "stiffness",
            Self::Clamp => "clamp",
            Self::GuideTurn => "guide_turn",
            Self::TipSupport => "tip_support",
            Self::TipPush => "tip_push",
        }
    }

    /// Changed quantity, in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Force => "the force reads more",
            Self::ForceGain => "the gain of the force is larger",
            Self::Shape => "the shape reads more",
            Self::ShapeGain => "the gain of the shape is larger",
            Self::ShapePosition => "the shape is measured further along the needle",
            Self::Guide => "guide 2 moves the needle further",
            Self::Modulus => "the modulus is larger",
            Self::Tip => "the tip reads more",
            Self::TipGain => "the gain of the tip's position is larger",
            Self::TipDirection => "the direction of the tip reads more",
            Self::TipDirectionGain => "the gain of the tip's direction is larger",
            Self::TipLoad => "the load on the tip is larger",
            Self::Tissue => "the tissue itself moves further",
            Self::Reaction => "the tissue reacts more",
            Self::Stiffness => "the needle is stiffer",
            Self::Clamp => "the needle turns further in guide 1 per moment",
            Self::GuideTurn => "guide 2 resists a rotation of the needle",
            Self::TipSupport => "what lies at the tip holds it",
            Self::TipPush => "a force pushes the tip sideways",
        }
    }

    /// Symbol in formulas, and the function in it.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Force => "F_read = F +",
            Self::ForceGain => "F_read = F (1 +",
            Self::Shape => "u_read = u +",
            Self::ShapeGain => "u_read = u (1 +",
            Self::ShapePosition => "z_read at z +",
            Self::Guide => "d_needle = d +",
            Self::Modulus => "K = K_0 (1 +",
            Self::Tip => "y_read = y +",
            Self::TipGain => "y_read = y (1 +",
            Self::TipDirection => "y'_read = y' +",
            Self::TipDirectionGain => "y'_read = y' (1 +",
            Self::TipLoad => "w = w_0 +",
            Self::Tissue => "p = K (u - w), w =",
            Self::Reaction => "p = K u (1 +",
            Self::Stiffness => "EI = EI_0 (1 +",
            Self::Clamp => "C = C_0 +",
            Self::GuideTurn => "M = c u', c =",
            Self::TipSupport => "F_tip = k u, k =",
            Self::TipPush => "F_tip =",
        }
    }

    /// The unit of the function, in names and in text; nothing for a share.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Force | Self::TipLoad | Self::TipPush => "n",
            Self::Shape | Self::ShapePosition | Self::Guide | Self::Tip | Self::Tissue => "mm",
            Self::TipDirection => "mrad",
            Self::Clamp => "rad_per_n_m",
            Self::GuideTurn => "n_m_per_rad",
            Self::TipSupport => "n_per_mm",
            Self::ForceGain
            | Self::ShapeGain
            | Self::Modulus
            | Self::TipGain
            | Self::TipDirectionGain
            | Self::Reaction
            | Self::Stiffness => "",
        }
    }

    /// From that unit to SI.
    pub(super) fn si(self) -> f64 {
        match self.unit() {
            "mm" | "mrad" => 1e-3,
            "n_per_mm" => 1e3,
            _ => 1.0,
        }
    }

    /// Size that a careful laboratory would overlook, in that unit: a third of the standard deviation of the prior.
    pub(super) fn overlooked(self) -> f64 {
        match self {
            Self::Force => 0.08,
            Self::Shape => 0.08,
            Self::Guide | Self::Tissue => 0.06,
            Self::ShapePosition => 1.0,
            Self::Modulus | Self::Reaction => 0.3,
            Self::Stiffness => 0.15,
            Self::Clamp => 0.1,
            // A tenth of what 20 mm of an 18 gauge needle have, 4 EI/l = 3.1 N m/rad.
            Self::GuideTurn => 0.3,
            // A tenth of what soft tissue (K = 10 kPa) has over 100 mm, 1 N/mm.
            Self::TipSupport => 0.1,
            Self::ForceGain | Self::ShapeGain | Self::TipGain | Self::TipDirectionGain => 0.1,
            Self::Tip => 0.3,
            Self::TipDirection => 10.0,
            Self::TipLoad | Self::TipPush => 0.03,
        }
    }

    /// Kinds of runs in which it shows.
    pub fn observable_in(self) -> RunKinds {
        match self {
            Self::Modulus => RunKinds::BOTH,
            Self::Tip | Self::TipGain | Self::TipDirection | Self::TipDirectionGain | Self::TipLoad => {
                RunKinds::INSERTION
            }
            _ => RunKinds::LATERAL,
        }
    }

    /// Allowed regressors, and their planes.
    pub(super) fn regressors(self) -> &'static [(Regressor, &'static [Scope])] {
        use Regressor::{
            Across, Along, Constant, Deflection, Depth, Direction, Displacement, Force, Place, Run, Share,
            Speed, Time, ToTip, Use,
        };
        const BOTH: &[Scope] = &[Scope::Both];
        const EACH: &[Scope] = &[Scope::Vertical, Scope::Horizontal];
        const ALL: &[Scope] = &Scope::ALL;
        match self {
            Self::Force => &[
                (Constant, EACH),
                (Displacement, BOTH),
                (Across, EACH),
                (Force, BOTH),
                (Time, EACH),
                (Direction, BOTH),
                (Speed, BOTH),
                (Run, EACH),
                (Depth, EACH),
            ],
            Self::ForceGain => {
                &[(Constant, EACH), (Displacement, BOTH), (Time, BOTH), (Run, BOTH), (Depth, BOTH)]
            }
            Self::Shape => &[
                (Constant, EACH),
                (Place, ALL),
                (Share, BOTH),
                (Deflection, BOTH),
                (Across, EACH),
                (Displacement, BOTH),
                (Force, BOTH),
                (Time, EACH),
                (Run, EACH),
                (Depth, EACH),
            ],
            Self::ShapeGain => &[(Constant, EACH), (Place, BOTH), (Time, BOTH), (Run, BOTH), (Depth, BOTH)],
            Self::ShapePosition => &[(Constant, BOTH), (Place, BOTH), (Run, BOTH), (Depth, BOTH)],
            Self::Guide => &[
                (Constant, EACH),
                (Displacement, BOTH),
                (Across, EACH),
                (Force, BOTH),
                (Time, ALL),
                (Direction, BOTH),
                (Run, BOTH),
                (Depth, BOTH),
            ],
            Self::Modulus => &[
                (Place, BOTH),
                (Run, BOTH),
                (Depth, BOTH),
                (Time, BOTH),
                (Displacement, BOTH),
                (Direction, BOTH),
                (Use, BOTH),
            ],
            Self::Tip => &[(Place, ALL), (Run, EACH)],
            Self::TipGain | Self::TipDirectionGain => &[(Constant, ALL), (Run, BOTH)],
            Self::TipDirection => &[(Constant, EACH), (Place, EACH), (Run, EACH)],
            Self::TipLoad => &[(Place, BOTH), (Run, BOTH)],
            Self::Tissue => &[
                (Constant, EACH),
                (Displacement, BOTH),
                (Across, EACH),
                (Force, BOTH),
                (Time, EACH),
                (Direction, BOTH),
                (Run, EACH),
            ],
            Self::Reaction => &[(Deflection, BOTH)],
            Self::Stiffness => &[(Along, BOTH), (ToTip, BOTH)],
            Self::Clamp => &[(Run, BOTH), (Depth, BOTH)],
            Self::GuideTurn | Self::TipSupport => &[(Constant, BOTH), (Depth, BOTH)],
            Self::TipPush => &[(Constant, EACH), (Depth, EACH), (Run, EACH)],
        }
    }
}
