//! Choices of the user in an identification.

use diagnose::models::{self, OtherModel};
use diagnose::{FoundationChoice, INCOMPRESSIBLE, KnownParameter, Multiples};
use formats::model_file::ModelFile;
use formats::prior_file::ModulusPrior;
use formats::session::Session;
use mechanics::continuum::Contact;
use mechanics::effects::Effect;
use mechanics::{Block, Support};
use modulus::Relation;
use readings::draws::DrawOptions;
use readings::holds::HoldCriteria;

/// Method by which Young's modulus is computed from K.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum YoungsMethod {
    /// By a published formula.
    Published(Relation),
    /// By the needle in an elastic half space, solved for this needle, rig, depth and noise.
    Continuum(Contact),
}

impl YoungsMethod {
    /// Every way there is.
    pub const ALL: [Self; 6] = [
        Self::Continuum(Contact::Bonded),
        Self::Continuum(Contact::OneSided),
        Self::Published(Relation::ALL[0]),
        Self::Published(Relation::ALL[1]),
        Self::Published(Relation::ALL[2]),
        Self::Published(Relation::ALL[3]),
    ];

    /// Its name in results and options.
    pub fn name(self) -> &'static str {
        match self {
            Self::Published(relation) => relation.name(),
            Self::Continuum(Contact::Bonded) => "continuum",
            Self::Continuum(Contact::OneSided) => "continuum-one-sided",
        }
    }

    /// Range in which it holds.
    pub fn validity(self) -> &'static str {
        match self {
            Self::Published(relation) => relation.validity(),
            Self::Continuum(Contact::Bonded) => "this needle bonded in an elastic half space, small strains",
            Self::Continuum(Contact::OneSided) => {
                "this needle held on one side only, without friction, in a hole of its own diameter"
            }
        }
    }
}

/// Choices of the user.
#[derive(Debug, Clone)]
pub struct Options {
    /// Relation that turns K into Young's modulus.
    pub relation: YoungsMethod,
    /// Poisson's ratio of the tissue; without it the session's, or 0.5.
    pub poisson: Option<f64>,
    /// Its standard deviation, which widens the interval of Young's modulus; without it the session's, or 0.
    pub poisson_sd: Option<f64>,
    /// Model of the tissue; by default the session's statement, or the choice of the evidence.
    pub foundation: Option<FoundationChoice>,
    /// Criteria for a hold.
    pub criteria: HoldCriteria,
    /// Effects whose parameters are unknown too, with their priors: the interval of K then includes them.
    pub nuisances: Vec<&'static dyn Effect>,
    /// Effects that are part of the model, with the values of their parameters.
    pub fixed: Vec<(&'static dyn Effect, Vec<f64>)>,
    /// Other models that explain what these effects were learned from: K by each is reported beside.
    pub others: Vec<OtherModel>,
    /// Uncertainty of these values if they are those of the rig: in the interval of K, in place of the catalogue's
    /// priors.
    pub known: Vec<KnownParameter>,
    /// Sizes of the discrepancy above those of an ordinary rig, as multiples.
    pub discrepancy: Multiples,
    /// Whether intervals have the model error in them; without it they are those of the noise, as if the model were exact.
    pub model_error: bool,
    /// Fit two layers to the runs of all depths.
    pub layers: bool,
    /// Profile the likelihood of the pooled K.
    pub profile: bool,
    /// Bootstrap the pooled K with so many draws; 0 for none.
    pub bootstrap: usize,
    /// Seed of the bootstrap's draws.
    pub seed: u64,
    /// Draws from the posterior beside the result.
    pub draws: Option<DrawOptions>,
    /// Prior of K from many sessions; the result with it is reported beside the one without.
    pub prior: Option<ModulusPrior>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            relation: YoungsMethod::Published(Relation::Vesic),
            poisson: None,
            poisson_sd: None,
            foundation: None,
            criteria: HoldCriteria::default(),
            nuisances: Vec::new(),
            fixed: Vec::new(),
            others: Vec::new(),
            known: Vec::new(),
            discrepancy: Multiples::new(),
            model_error: true,
            layers: false,
            profile: false,
            bootstrap: 0,
            seed: 1,
            draws: None,
            prior: None,
        }
    }
}

impl Options {
    /// With what is known of the rig (`guide characterize`): its effects with their intervals. Values that are there already stay.
    #[must_use]
    pub fn with_rig(mut self, rig: Option<&ModelFile>) -> Self {
        if let Some(rig) = rig {
            for other in &mut self.others {
                KnownParameter::take(&mut other.effects, &mut self.known, rig);
            }
            KnownParameter::take(&mut self.fixed, &mut self.known, rig);
        }
        self
    }

    /// With a model that was learned: its effects, its discrepancy, and the other models of the same file. Effects that are there already
    /// stay, in all models.
    #[must_use]
    pub fn with_model(mut self, model: &ModelFile) -> Self {
        (self.fixed, self.others) = models::of_file(&self.fixed, model);
        self.discrepancy = model.discrepancy.clone();
        self
    }
}

/// The tissue as it is modelled: what the options state, else what the session states, else the default.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct TissueModel {
    /// Springs, a body, or what the evidence decides for.
    pub foundation: FoundationChoice,
    /// Poisson's ratio.
    pub poisson: f64,
    /// Its standard deviation.
    pub poisson_sd: f64,
    /// The block that it is stated to be.
    pub block: Option<Block>,
}

impl TissueModel {
    /// For a session.
    pub fn new(options: &Options, session: &Session) -> Self {
        let stated = session.tissue;
        Self {
            foundation: options.foundation.unwrap_or_else(|| stated.foundation.into()),
            poisson: options.poisson.or(stated.poisson).unwrap_or(INCOMPRESSIBLE),
            poisson_sd: options.poisson_sd.or(stated.poisson_sd).unwrap_or(0.0),
            block: stated.block(),
        }
    }

    /// The tissue as an elastic body.
    pub fn body(&self) -> Support {
        Support::Body { poisson: self.poisson, block: self.block }
    }

    /// The same with a Poisson's ratio one standard deviation away; `None` where it is exactly known.
    pub fn other_body(&self) -> Option<Support> {
        self.body().one_sd_away(self.poisson_sd)
    }
}
