//! An elastic body against springs, without any search for effects: what `guide identify` decides its foundation by.
//!
//! Noise, everyday discrepancy and evidence are those of a diagnosis, so that the two commands agree on the same runs.

use super::{
    DiagnoseError, Effect, FOUNDATION_MARGIN, Layout, Noise, Noises, Session, Support, fit_start, runs_of,
};

/// The comparison of the two foundations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FoundationEvidence {
    /// Logarithm of the evidence of the body less that of the springs.
    pub gain: f64,
    /// What it has to exceed for the body to be chosen: springs are the simpler model.
    pub margin: f64,
}

impl FoundationEvidence {
    /// Whether the evidence chooses the body.
    pub fn is_for_body(self) -> bool {
        self.gain > self.margin
    }
}

/// Compares the foundations on all runs of a session, beside the effects that are given with first values of their parameters.
///
/// # Errors
/// [`DiagnoseError`] where no run can be used or one of the two models has no fit.
pub(crate) fn foundation_evidence(
    session: &Session,
    given: &[(&'static dyn Effect, Vec<f64>)],
    poisson: f64,
) -> Result<FoundationEvidence, DiagnoseError> {
    let (runs, _) = runs_of(session)?;
    let noise = Noise::of(&runs, &session.noise);
    let effects = given.iter().map(|(effect, _)| *effect).collect();
    let layout = Layout::new(&session.rig, &runs, effects);
    let springs = fit_start(&layout, &runs, &Noises { session: noise, reference: noise }, given, &[])?;
    let body = springs.on(Support::Body { poisson })?;
    let gain = body.fitted.log_evidence - springs.fitted.log_evidence;
    Ok(FoundationEvidence { gain, margin: FOUNDATION_MARGIN })
}
