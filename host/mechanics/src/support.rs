//! Support of the needle by the tissue: independent springs or an elastic body.

use super::{Block, ModelError, check};

/// Resistance of the tissue to the needle's deflection.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Support {
    /// Springs (Winkler): the force at a point of the needle depends on the deflection at that point alone. The numbers in
    /// [`Foundation`](super::Foundation) are the foundation modulus K.
    #[default]
    Springs,
    /// A linear elastic body with a free surface, to which the needle's wall and tip are bonded. The numbers in
    /// [`Foundation`](super::Foundation) are Young's modulus E at a depth.
    Body {
        /// Poisson's ratio, 0 to 0.5.
        poisson: f64,
        /// Its walls; without them it is a half space.
        block: Option<Block>,
    },
}

impl Support {
    /// An elastic half space.
    pub fn half_space(poisson: f64) -> Self {
        Self::Body { poisson, block: None }
    }

    /// Whether it is an elastic body.
    pub fn is_body(self) -> bool {
        matches!(self, Self::Body { .. })
    }

    /// Poisson's ratio of a body.
    pub fn poisson(self) -> Option<f64> {
        match self {
            Self::Springs => None,
            Self::Body { poisson, .. } => Some(poisson),
        }
    }

    /// The walls of a body that has them.
    pub fn block(self) -> Option<Block> {
        match self {
            Self::Springs => None,
            Self::Body { block, .. } => block,
        }
    }

    /// The same body with walls; springs have none.
    #[must_use]
    pub fn with_block(self, block: Option<Block>) -> Self {
        match self {
            Self::Springs => self,
            Self::Body { poisson, .. } => Self::Body { poisson, block },
        }
    }

    /// Its name in files and options.
    pub fn name(self) -> &'static str {
        if self.is_body() { "body" } else { "springs" }
    }

    /// The same body with a Poisson's ratio one standard deviation away, on the side where there is room; nothing for springs and for
    /// a ratio that is exactly known.
    pub fn one_sd_away(self, poisson_sd: f64) -> Option<Self> {
        let Self::Body { poisson, block } = self else { return None };
        let step = if poisson > poisson_sd { -poisson_sd } else { poisson_sd };
        (poisson_sd > 0.0).then(|| Self::Body { poisson: (poisson + step).clamp(0.0, 0.5), block })
    }

    /// Refuses Poisson's ratios that no elastic body has.
    ///
    /// # Errors
    /// [`ModelError::OutOfRange`].
    pub(super) fn check(self) -> Result<(), ModelError> {
        match self {
            Self::Springs => Ok(()),
            Self::Body { poisson, block } => {
                check("poisson", poisson, "0 to 0.5", (0.0..=0.5).contains(&poisson))?;
                block.map_or(Ok(()), |block| block.check())
            }
        }
    }

    /// Refuses an elastic body where only springs are modelled.
    ///
    /// # Errors
    /// [`ModelError::NotOnBody`].
    pub(super) fn needs_springs(self, what: &'static str) -> Result<(), ModelError> {
        if self.is_body() { Err(ModelError::NotOnBody { what }) } else { Ok(()) }
    }
}
