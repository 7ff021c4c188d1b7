//! Regressors of terms.

/// Regressor of a term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Regressor {
    /// No regressor.
    Constant,
    /// Depth below the surface of the place where it acts, millimetres.
    Place,
    /// The same as a share of the depth of the needle's tip.
    Share,
    /// Depth of the needle's tip below the surface, millimetres.
    Depth,
    /// Displacement of guide 2, millimetres.
    Displacement,
    /// The same along the other axis; of a shape the needle's deflection there, millimetres.
    Across,
    /// Lateral force at guide 2, newtons.
    Force,
    /// Deflection of the needle, millimetres.
    Deflection,
    /// Time since the run began, seconds.
    Time,
    /// Sign of the last motion of guide 2.
    Direction,
    /// Speed of guide 2 with that sign, millimetres per second.
    Speed,
    /// Number of the run in its session, 0 for the first.
    Run,
    /// Largest displacement of guide 2 so far in the run, millimetres.
    Use,
    /// Position along the needle from guide 1, millimetres.
    Along,
    /// Distance along the needle from its tip, millimetres.
    ToTip,
}

impl Regressor {
    /// Every one there is.
    pub const ALL: [Self; 15] = [
        Self::Constant,
        Self::Place,
        Self::Share,
        Self::Depth,
        Self::Displacement,
        Self::Across,
        Self::Force,
        Self::Deflection,
        Self::Time,
        Self::Direction,
        Self::Speed,
        Self::Run,
        Self::Use,
        Self::Along,
        Self::ToTip,
    ];

    /// Its name in ids.
    pub fn name(self) -> &'static str {
        match self {
            Self::Constant => "constant",
            Self::Place => "place",
            Self::Share => "share",
            Self::Depth => "depth",
            Self::Displacement => "displacement",
            Self::Across => "across",
            Self::Force => "force",
            Self::Deflection => "deflection",
            Self::Time => "time",
            Self::Direction => "direction",
            Self::Speed => "speed",
            Self::Run => "run",
            Self::Use => "use",
            Self::Along => "along",
            Self::ToTip => "to_tip",
        }
    }

    /// Symbol in formulas.
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Constant => "",
            Self::Place => "s",
            Self::Share => "s/D",
            Self::Depth => "D",
            Self::Displacement => "d",
            Self::Across => "across",
            Self::Force => "F",
            Self::Deflection => "u",
            Self::Time => "t",
            Self::Direction => "sign(d')",
            Self::Speed => "d'",
            Self::Run => "n",
            Self::Use => "max |d|",
            Self::Along => "z",
            Self::ToTip => "(L - z)",
        }
    }

    /// Its unit, in names and in text; nothing for a number.
    pub fn unit(self) -> &'static str {
        match self {
            Self::Place
            | Self::Depth
            | Self::Displacement
            | Self::Across
            | Self::Deflection
            | Self::Use
            | Self::Along
            | Self::ToTip => "mm",
            Self::Force => "n",
            Self::Time => "s",
            Self::Speed => "mm_per_s",
            Self::Constant | Self::Share | Self::Direction | Self::Run => "",
        }
    }

    /// From SI to that unit.
    pub(super) fn per_si(self) -> f64 {
        if self.unit().starts_with("mm") { 1e3 } else { 1.0 }
    }

    /// Its typical size in a session, in that unit.
    pub(super) fn typical(self) -> f64 {
        match self {
            Self::Place | Self::Depth | Self::ToTip => 20.0,
            Self::Along => 60.0,
            Self::Displacement | Self::Across | Self::Use | Self::Speed => 1.0,
            Self::Force => 1.0,
            Self::Deflection => 0.5,
            Self::Time => 20.0,
            Self::Run => 3.0,
            Self::Constant | Self::Share | Self::Direction => 1.0,
        }
    }
}
